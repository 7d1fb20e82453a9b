"""Writing ASF and AMC: what is read back, what real files keep, rigs of other kinds."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import keypose.io
from keypose import analysis, evaluate, samples
from keypose.errors import FormatError, ShapeError, UnknownName
from keypose.math import quat
from keypose.model import Character, Clip, Motion, Pose, Scene, Skeleton
from tests.io.acclaim_files import AMC, ASF


def random_rotations(rng: np.random.Generator, *shape: int) -> np.ndarray:
    return np.asarray(quat.normalize(rng.normal(size=(*shape, 4))))


def rig(seed: int, joints: int = 9, frames: int = 7, *, moving: bool = False) -> Scene:
    """A random tree whose joints have axes of their own, and whose children start at different places."""
    rng = np.random.default_rng(seed)
    parents = [-1, *(int(rng.integers(0, j)) for j in range(1, joints))]
    rest = Pose(rng.normal(size=(joints, 3)), random_rotations(rng, joints), np.ones((joints, 3)))
    tips = tuple((j, (0.1, 0.2, -0.3)) for j in range(joints) if j not in parents)
    skeleton = Skeleton(tuple(f"joint {j}" for j in range(joints)), np.array(parents), rest, tips)
    translations = np.tile(np.asarray(rest.translations), (frames, 1, 1))
    translations[:, 0] += rng.normal(size=(frames, 3))
    if moving:
        translations += rng.normal(size=translations.shape) * 0.1
    motion = Motion(skeleton.names, Pose(translations, random_rotations(rng, frames, joints), rest.scales), 50, "dance")
    return Scene((Character(skeleton, name="rig"),), (motion,))


def underscored(scene: Scene) -> Scene:
    """The scene with the joint names that a file can hold."""
    skeleton, motion = scene.character.skeleton, scene.animations[0]
    assert isinstance(motion, Motion)
    names = (skeleton.names[0], *(name.replace(" ", "_") for name in skeleton.names[1:]))
    skeleton = Skeleton(names, skeleton.parents, skeleton.rest, skeleton.end_offsets)
    return Scene((Character(skeleton),), (Motion(names, motion.pose, motion.rate_hz, motion.name),))


def error(a: Scene, b: Scene) -> analysis.RoundtripError:
    return analysis.roundtrip_error(a.animations[0], b.animations[0], a.character.skeleton, b.character.skeleton)


@pytest.mark.data
@pytest.mark.parametrize("name", ["cmu_01_01/01_01.amc", "asf_amc/cmu_02/02_03.amc"])
@pytest.mark.parametrize("axes", ["world", "bone"])
def test_real_takes_come_back(data_dir: Path, tmp_path: Path, name: str, axes: str) -> None:
    scene = keypose.io.load(data_dir / name, axes=axes)
    notes = keypose.io.save(scene, tmp_path / "take.amc")
    assert notes == ("the skeleton is in take.asf",)
    back = keypose.io.load(tmp_path / "take.amc")
    found = error(scene, back)
    assert found.position_mm < 1e-5 and found.rotation_deg < 1e-6
    assert back.character.skeleton.names == scene.character.skeleton.names
    np.testing.assert_allclose(
        back.character.skeleton.rest.rotations, scene.character.skeleton.rest.rotations, atol=1e-9
    )
    # the same bones: dof, their order, limits, axes
    mine, theirs = (s.character.extras["acclaim"]["bones"] for s in (scene, back))
    assert mine.keys() == theirs.keys()
    for bone in mine:
        assert mine[bone].get("dof") == theirs[bone].get("dof")
        assert mine[bone].get("limits") == theirs[bone].get("limits")
        np.testing.assert_allclose(mine[bone]["axis_deg"], theirs[bone]["axis_deg"], atol=1e-9)


@pytest.mark.parametrize("moving", [False, True])
@pytest.mark.parametrize("seed", range(8))
def test_any_rig_comes_back(tmp_path: Path, seed: int, moving: bool) -> None:
    """Axes, names, rest pose, tips and motion; bones put between are taken out again."""
    scene = rig(seed, moving=moving)
    notes = keypose.io.save(scene, tmp_path / "rig.amc")
    assert any("slide" in note for note in notes) == moving
    back, expected = keypose.io.load(tmp_path / "rig.amc"), underscored(scene)
    skeleton, original = back.character.skeleton, expected.character.skeleton
    assert set(skeleton.names) == set(original.names)
    found = error(expected, back)
    assert found.position_mm < 1e-3 and found.rotation_deg < 1e-4
    order = [skeleton.index(name) for name in original.names]
    np.testing.assert_allclose(skeleton.rest.translations[order], original.rest.translations, atol=1e-9)
    dots = np.abs(np.sum(skeleton.rest.rotations[order] * np.asarray(original.rest.rotations), axis=-1))
    np.testing.assert_allclose(dots, 1, atol=1e-12)
    tips = {skeleton.names[j]: tip for j, tip in skeleton.end_offsets}
    for joint, tip in original.end_offsets:
        if joint:
            np.testing.assert_allclose(tips[original.names[joint]], tip, atol=1e-9)
    animation = back.animations[0]
    assert animation.name == "dance" and isinstance(animation, Motion) and animation.rate_hz == 50


@pytest.mark.parametrize("seed", range(3))
def test_other_programs_see_the_same_places(tmp_path: Path, seed: int) -> None:
    """Without the remark in the first line only names, axes and the bones between differ."""
    scene = underscored(rig(seed))
    keypose.io.save(scene, tmp_path / "rig.amc")
    for name in ("rig.asf", "rig.amc"):
        path = tmp_path / name
        path.write_text(path.read_text().split("\n", 1)[1])
    back = keypose.io.load(tmp_path / "rig.amc")
    here, there = scene.character.skeleton, back.character.skeleton
    motions = [s.animations[0] for s in (scene, back)]
    a = np.asarray(evaluate.world_rotations_positions(here, motions[0].pose)[1])
    b = np.asarray(evaluate.world_rotations_positions(there, motions[1].pose)[1])
    for joint, name in enumerate(here.names):
        place = there.index("root" if joint == 0 else name)
        np.testing.assert_allclose(b[:, place], a[:, joint], atol=1e-6)


def test_clips_scales_and_several_roots(tmp_path: Path) -> None:
    human = samples.load("human")
    performance = human.animation("walk")
    walk = evaluate.to_clip(performance) if isinstance(performance, Motion) else performance
    assert isinstance(walk, Clip)
    keypose.io.save([human.character, walk], tmp_path / "walk.amc")
    back = keypose.io.load(tmp_path / "walk.amc")
    found = analysis.roundtrip_error(walk, back.animations[0], human.character.skeleton, back.character.skeleton)
    assert found.position_mm < 1e-3 and found.rotation_deg < 1e-4
    rng = np.random.default_rng(1)
    scales = np.ones((4, 3)) * np.array([2.0, 0.5, 1.0, 3.0])[:, None]
    skeleton = Skeleton(
        ("a", "b", "c", "d"), np.array([-1, 0, 1, -1]), Pose(rng.normal(size=(4, 3)), random_rotations(rng, 4), scales)
    )
    pose = Pose(skeleton.rest.translations, random_rotations(rng, 5, 4), scales)
    scene = Scene((Character(skeleton),), (Motion(skeleton.names, pose, 30.0),))
    notes = keypose.io.save(scene, tmp_path / "scaled.amc")
    assert any("scaled" in note for note in notes) and any("2 roots" in note for note in notes)
    assert error(scene, keypose.io.load(tmp_path / "scaled.amc")).position_mm < 1e-3


def test_dofs_grow_where_a_bone_moves_otherwise(tmp_path: Path) -> None:
    (tmp_path / "small.asf").write_text(ASF)
    (tmp_path / "small.amc").write_text(AMC)
    scene = keypose.io.load(tmp_path / "small.amc")
    motion = scene.animations[0]
    assert isinstance(motion, Motion)
    keypose.io.save(scene, tmp_path / "same.amc")
    bones = keypose.io.load(tmp_path / "same.amc").character.extras["acclaim"]["bones"]
    assert bones["knee"]["dof"] == "rz rx" and bones["hip"]["limits"][2] == [-60, None]
    rotations = np.array(motion.pose.rotations)
    rotations[:, 2] = random_rotations(np.random.default_rng(0), 3)
    bent = Scene(scene.characters, (motion.with_pose(Pose(motion.pose.translations, rotations, motion.pose.scales)),))
    notes = keypose.io.save(bent, tmp_path / "bent.amc")
    assert any("degrees of freedom they did not have" in note for note in notes)
    back = keypose.io.load(tmp_path / "bent.amc")
    assert back.character.extras["acclaim"]["bones"]["knee"]["dof"] == "rx ry rz"
    assert error(bent, back).rotation_deg < 1e-4


def test_a_root_that_starts_elsewhere(tmp_path: Path) -> None:
    """Position is added to the root's values; orientation gives the axes in which its angles are measured."""
    text = ASF.replace("position 0 0 0", "position 1 2 3").replace("orientation 0 0 0", "orientation 0 90 0")
    (tmp_path / "small.asf").write_text(text)
    (tmp_path / "small.amc").write_text(AMC)
    scene = keypose.io.load(tmp_path / "small.amc")
    motion = scene.animations[0]
    assert isinstance(motion, Motion)
    unit_m = 0.0254 / 0.45
    np.testing.assert_allclose(motion.pose.translations[0, 0], np.array([2, 22, 6]) * unit_m, atol=1e-12)
    turn = Rotation.from_euler("y", 90, degrees=True)
    expected = turn * Rotation.from_euler("xyz", (10, 20, 30), degrees=True) * turn.inv()
    found = Rotation.from_quat(np.asarray(motion.pose.rotations)[0, 0], scalar_first=True)
    assert (found * expected.inv()).magnitude() < 1e-12
    for axes in ("world", "bone"):
        scene = keypose.io.load(tmp_path / "small.amc", axes=axes)
        keypose.io.save(scene, tmp_path / "again.amc")
        back = keypose.io.load(tmp_path / "again.amc")
        assert error(scene, back).position_mm < 1e-4
        rest = [s.character.skeleton.rest.translations for s in (scene, back)]
        np.testing.assert_allclose(rest[0], rest[1], atol=1e-9)


def test_options(tmp_path: Path) -> None:
    scene = underscored(rig(4))
    keypose.io.save(scene, tmp_path / "a.amc", unit="cm", rate_hz=25, decimals=3)
    back = keypose.io.load(tmp_path / "a.amc")
    assert back.unit_m == pytest.approx(0.01) and back.animations[0].rate_hz == 25  # type: ignore[union-attr]
    assert "length 2.54" in (tmp_path / "a.asf").read_text()
    notes = keypose.io.save(scene, tmp_path / "b.asf")
    assert any("ends in .amc" in note for note in notes) and not (tmp_path / "b.amc").exists()
    keypose.io.save(scene.character, tmp_path / "c.amc")
    assert keypose.io.load(tmp_path / "c.amc").animations[0].frame_count == 1  # type: ignore[union-attr]
    for options, kind in (
        ({"unit": "yard"}, UnknownName),
        ({"decimals": 40}, ShapeError),
        ({"animation": "jump"}, UnknownName),
    ):
        with pytest.raises(kind):
            keypose.io.save(scene, tmp_path / "d.amc", **options)
    with pytest.raises(FormatError, match="no character"):
        keypose.io.save(Scene(), tmp_path / "d.amc")
    with pytest.raises(FormatError, match="does not exist"):
        keypose.io.save(scene, tmp_path / "none" / "d.amc")
    assert not list(tmp_path.glob("*d.a*"))


def test_remarks_may_be_anything(tmp_path: Path) -> None:
    """The first line is a comment: whatever it says, the file loads."""
    for remark in ("{", "[]", "null", '{"unit_m":"a","root":3,"root_axes":[0,0,0,0],"added":{}}', "[" * 100_000,
                   '{"unit_m":NaN,"root_axes":[1e999,0,0,0],"root_position":[1e300,0,0],"added":["hip",5],"root":"hip"}'):  # fmt: skip
        (tmp_path / "a.asf").write_text(f"#!keypose {remark}\n{ASF}")
        (tmp_path / "a.amc").write_text(f"#!keypose {remark}\n{AMC}")
        scene = keypose.io.load(tmp_path / "a.amc")
        assert scene.character.skeleton.names == ("root", "hip", "knee", "foot", "spine", "head")
        assert scene.unit_m == pytest.approx(0.0254 / 0.45)
