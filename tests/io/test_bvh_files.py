"""Real BVH files: facts measured by other tools, other readers' world positions, and round trips."""

from __future__ import annotations

import re
import warnings
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

import keypose.io
from keypose.io.axes import y_up_rotation
from keypose.math import quat
from keypose.model import Scene
from tests.io.bvh_files import differences, world_of

pytestmark = pytest.mark.data

_ROW = re.compile(
    r"^\| `((?:bvh|makehuman|cmu_01_01)/[^`]*\.bvh)` .*?\| (\d+) joints, (\d+) channels, (\d+) frames, ([\d.]+) fps; "
    r"channels (.*?)(?:; CRLF)?; root ([^;|]*?)(?:; extent at middle frame ([\d.]+) x ([\d.]+) x ([\d.]+))?(?:; positions .*?)? \|$",
    re.MULTILINE,
)

# unit and up axis as a person would say: the CMU database, tools that write centimetres, MakeHuman's decimetres. The
# README names the worlds that are Z up and MakeHuman's unit; nobody knows the unit of fair1.
_UNITS = {"cmu_01_01": "cmu", "bvh/cmu_cgspeed": "cmu", "makehuman": "dm", "bvh/fair1": None}
_Z_UP = ("bvh/fair1", "makehuman")


@dataclass(frozen=True)
class Facts:
    """What the README says about one file."""

    name: str
    joints: int
    channels: int
    frames: int
    rate: str
    channel_names: str
    root: str
    extent: tuple[str, ...]


@pytest.fixture(scope="module")
def facts(data_dir: Path) -> dict[str, Facts]:
    """The README's table of BVH files."""
    found = {}
    for row in _ROW.findall((data_dir / "README.md").read_text()):
        name, joints, channels, frames, rate, names, root, *extent = row
        found[name] = Facts(
            name, int(joints), int(channels), int(frames), rate, names, root, tuple(filter(None, extent))
        )
    return found


@pytest.fixture(scope="module")
def scenes(data_dir: Path, facts: dict[str, Facts]) -> dict[str, Scene]:
    """Every file, loaded without options."""
    return {name: keypose.io.load(data_dir / name) for name in facts}


def test_the_table_names_every_file(data_dir: Path, facts: dict[str, Facts]) -> None:
    files = {str(p.relative_to(data_dir)) for p in data_dir.glob("*/**/*.bvh")}
    assert files == set(facts) and len(facts) == 29


def test_facts_measured_by_other_tools(facts: dict[str, Facts], scenes: dict[str, Scene]) -> None:
    for name, fact in facts.items():
        scene = scenes[name]
        skeleton, motion = scene.character.skeleton, scene.animation()
        assert skeleton.joint_count == fact.joints, name
        assert motion.frame_count == fact.frames, name
        assert f"{motion.rate_hz:.4g}" == fact.rate, name
        assert skeleton.names[0] == fact.root, name
        lists = [c.split() for c in scene.character.extras["bvh"]["channels"].values()]
        assert sum(map(len, lists)) == fact.channels, name
        counted = Counter(" ".join(c) for c in lists)
        assert fact.channel_names.split(r" \| ") == [f"{key} x{count}" for key, count in counted.most_common(3)], name


def file_positions(scene: Scene, frame: int, *, with_ends: bool) -> np.ndarray:
    """Positions (N, 3) of joints, and end sites, at one frame, in the file's own unit and axes."""
    matrices = world_of(
        Scene(scene.characters, (scene.animation().with_pose(scene.animation().pose[frame : frame + 1]),))
    )[0]
    points = [*matrices[:, :3, 3]]
    if with_ends:
        points += [
            matrices[j, :3, :3] @ offset + matrices[j, :3, 3] for j, offset in scene.character.skeleton.end_offsets
        ]
    return quat.rotate(quat.conjugate(y_up_rotation(scene.up)), np.array(points)) / scene.unit_m


def test_extents_at_the_middle_frame(facts: dict[str, Facts], scenes: dict[str, Scene]) -> None:
    for name, fact in facts.items():
        if fact.extent:
            points = file_positions(scenes[name], fact.frames // 2, with_ends=True)
            assert tuple(f"{e:.3g}" for e in np.ptp(points, axis=0)) == fact.extent, name


def test_units_and_axes_are_what_people_say(scenes: dict[str, Scene]) -> None:
    for name, scene in scenes.items():
        folder = next((f for f in _UNITS if name.startswith(f)), "")
        unit = _UNITS.get(folder, "cm")
        if unit:
            assert scene.unit_m == keypose.io.axes.UNITS_M[unit], name
        assert scene.up == ("Z" if name.startswith(_Z_UP) else "Y"), name
        assert any(note.startswith("unit: ") for note in scene.notes), name
        assert any(note.startswith("up axis: ") for note in scene.notes), name


def test_characters_stand_on_the_ground_with_their_heads_up(scenes: dict[str, Scene]) -> None:
    for name, scene in scenes.items():
        joints = [n.casefold() for n in scene.character.skeleton.names]
        head = next((j for j, n in enumerate(joints) if n.endswith("head")), None)
        if head is None or "pybvh_edge" in name or "face" in name or "tpose" in name:
            continue
        positions = world_of(scene)[..., :3, 3]
        lowest = positions[..., 1].min(axis=1)
        assert 0.8 < np.median(positions[:, head, 1]) < 1.8, name
        assert abs(np.median(lowest)) < 0.2, name


def test_position_channels_of_children(scenes: dict[str, Scene]) -> None:
    for name in ("bvh/geno/Geno_bind.bvh", "bvh/geno/Geno_stance.bvh"):
        scene = scenes[name]
        assert scene.character.extras["bvh"]["child_positions"] == "replace"
        # unanimated: the joints keep the lengths of the rest pose
        lengths = np.linalg.norm(scene.animation().pose.translations[:, 1:], axis=-1)
        rest = np.linalg.norm(scene.character.skeleton.rest.translations[1:], axis=-1)
        np.testing.assert_allclose(lengths, np.broadcast_to(rest, lengths.shape), atol=1e-6)
    assert scenes["makehuman/tpose.bvh"].character.extras["bvh"]["child_positions"] == "add"


def test_the_same_takes_on_two_rigs_are_equally_high(scenes: dict[str, Scene]) -> None:
    """Files of one source, one with the root on the ground and one with the pelvis as root over its own OFFSET."""
    on_ground, on_pelvis = scenes["bvh/cmu_iclone_007/007_01.bvh"], scenes["bvh/cmu_iclone_007/007_02.bvh"]
    heights = []
    for scene in (on_ground, on_pelvis):
        hip = scene.character.skeleton.index("CC_Base_Hip")
        heights.append(float(np.median(world_of(scene)[:, hip, 1, 3])))
    assert abs(heights[0] - heights[1]) < 0.12
    assert on_pelvis.character.extras["bvh"]["added_roots"] == ["CC_Base_Hip"]


def test_every_file_comes_back_the_same(scenes: dict[str, Scene], tmp_path: Path) -> None:
    for name, scene in scenes.items():
        target = tmp_path / Path(name).name
        assert keypose.io.save(scene, target) == (), name
        again = keypose.io.load(target)
        moved, turned = differences(scene, again)
        assert moved < 1e-3 and turned < 1e-4, name
        assert (again.unit_m, again.up, again.notes) == (scene.unit_m, scene.up, scene.notes), name
        assert again.character.extras == scene.character.extras, name
        assert again.animation().rate_hz == scene.animation().rate_hz, name


def test_every_file_survives_other_units_and_orders(scenes: dict[str, Scene], tmp_path: Path) -> None:
    for name, scene in scenes.items():
        keypose.io.save(scene, tmp_path / "other.bvh", unit="m", up="Z", order="YXZ")
        again = keypose.io.load(tmp_path / "other.bvh", unit="m", up="Z")
        moved, turned = differences(scene, again)
        assert moved < 1e-3 and turned < 1e-4, name


def test_files_come_back_through_glb(scenes: dict[str, Scene], tmp_path: Path) -> None:
    """BVH -> GLB -> BVH: GLB holds float32, and carries what the writer needs to know of the first file."""
    for name in (
        "bvh/fair1/dab.bvh",
        "bvh/geno/Geno_stance.bvh",
        "makehuman/tpose.bvh",
        "bvh/cmu_iclone_007/007_02.bvh",
    ):
        scene = scenes[name]
        keypose.io.save(scene, tmp_path / "a.glb")
        keypose.io.save(keypose.io.load(tmp_path / "a.glb"), tmp_path / "a.bvh")
        again = keypose.io.load(tmp_path / "a.bvh")
        moved, turned = differences(scene, again)
        assert moved < 1e-3 and turned < 1e-4, name
        assert again.character.skeleton.names == scene.character.skeleton.names, name
        assert (again.unit_m, again.up) == (scene.unit_m, scene.up), name


def peer_positions(check: Callable[[str, np.ndarray], None], data_dir: Path, facts: dict[str, Facts]) -> int:
    """Calls ``check`` for every file that pybvh reads, with its joint positions (T, J, 3); how many those are."""
    pybvh = pytest.importorskip("pybvh")
    from pybvh.spatial_coord import frames_to_node_positions

    compared = 0
    for name in facts:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                theirs = pybvh.read_bvh_file(data_dir / name)
            except ValueError:
                continue  # position channels on child joints: pybvh has no model for them
        nodes = np.asarray(frames_to_node_positions(theirs))
        keep = [i for i, node in enumerate(theirs.nodes) if not node.is_end_site()]
        check(name, nodes[:, keep])
        compared += 1
    return compared


def test_world_positions_equal_pybvh(data_dir: Path, facts: dict[str, Facts]) -> None:
    def check(name: str, theirs: np.ndarray) -> None:
        # pybvh always takes root positions as they are, in the file's own axes and unit
        scene = keypose.io.load(data_dir / name, unit="m", up="Y", root_positions="replace")
        ours = world_of(scene)[..., :3, 3]
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-9 * np.abs(theirs).max(), err_msg=name)

    assert peer_positions(check, data_dir, facts) == 26


def test_child_positions_equal_pymotion(data_dir: Path) -> None:
    """PyMotion reads position channels of children, and lets them replace OFFSET."""
    bvh = pytest.importorskip("pymotion.io.bvh")
    for name in ("bvh/geno/Geno_bind.bvh", "bvh/geno/Geno_stance.bvh"):
        theirs = bvh.BVH()
        theirs.load(str(data_dir / name))
        rotations, positions, *_ = theirs.get_data()
        scene = keypose.io.load(data_dir / name, unit="m", up="Y")
        pose = scene.animation().pose
        np.testing.assert_allclose(pose.translations, positions, atol=1e-9)
        same = np.abs(np.sum(pose.rotations * rotations, axis=-1))
        np.testing.assert_allclose(same, 1, atol=1e-9)
