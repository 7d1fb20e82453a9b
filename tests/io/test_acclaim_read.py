"""Reading ASF and AMC: the real files' facts, the rules of the format, the same take in other formats, every refusal."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import keypose.io
from keypose import evaluate
from keypose.errors import FormatError, UnknownName
from keypose.io.axes import UNITS_M
from keypose.math import quat
from keypose.model import Motion
from tests.conftest import ROOT
from tests.io.acclaim_files import AMC, ASF

CMU_M = 0.0254 / 0.45


@pytest.fixture
def take(tmp_path: Path) -> Path:
    (tmp_path / "small.asf").write_text(ASF)
    (tmp_path / "small_01.amc").write_text(AMC)
    return tmp_path / "small_01.amc"


def motion_of(scene: keypose.model.Scene) -> Motion:
    motion = scene.animation()
    assert isinstance(motion, Motion)
    return motion


def turn(axis: str, degrees: float) -> np.ndarray:
    """A plain rotation matrix, written out."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return {
        "x": np.array([[1, 0, 0], [0, c, -s], [0, s, c]]),
        "y": np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]),
        "z": np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]),
    }[axis]


# --- facts of real files ----------------------------------------------------------------------------------------------------


@pytest.mark.data
@pytest.mark.parametrize(
    ("name", "frames"),
    [
        ("cmu_01_01/01_01.amc", 2751),
        ("asf_amc/cmu_02/02_01.amc", 343),
        ("asf_amc/cmu_02/02_02.amc", 298),
        ("asf_amc/cmu_02/02_03.amc", 173),
        ("asf_amc/cmu_02/02_04.amc", 483),
        ("asf_amc/cmu_02/02_05.amc", 1854),
    ],
)
def test_facts_of_real_takes(data_dir: Path, name: str, frames: int) -> None:
    scene = keypose.io.load(data_dir / name)
    motion = motion_of(scene)
    assert (scene.format, motion.frame_count, motion.rate_hz) == ("amc", frames, 120.0)
    assert scene.character.skeleton.joint_count == 31  # the root and 30 bones
    assert scene.unit_m == pytest.approx(CMU_M)
    positions = np.asarray(evaluate.world_rotations_positions(scene.character.skeleton, motion.pose)[1])
    skeleton = scene.character.skeleton
    feet = positions[:, [skeleton.index("ltoes"), skeleton.index("rtoes")], 1]
    assert np.median(np.ptp(positions[..., 1], axis=1)) > 1.2
    assert -0.1 < np.median(feet.min(axis=1)) < 0.15  # on the ground


@pytest.mark.data
@pytest.mark.parametrize("name", ["cmu_01_01/01.asf", "asf_amc/cmu_02/02.asf"])
def test_facts_of_real_skeletons(data_dir: Path, name: str) -> None:
    scene = keypose.io.load(data_dir / name)
    skeleton = scene.character.skeleton
    assert scene.format == "asf" and not scene.animations and skeleton.joint_count == 31
    positions = np.asarray(evaluate.world(skeleton, skeleton.rest))[:, :3, 3]
    assert 1.3 < np.ptp(positions[:, 1]) < 1.7
    left, right = skeleton.index("lhand"), skeleton.index("rhand")
    assert positions[left, 0] > 0.5 and positions[right, 0] < -0.5  # faces +Z: its left is +X
    assert dict(skeleton.end_offsets)[skeleton.index("ltoes")][2] > 0.05
    assert np.all(np.asarray(skeleton.rest.rotations) == (1, 0, 0, 0))
    bone = scene.character.extras["acclaim"]["bones"]["rclavicle"]
    assert bone["dof"] == "ry rz" and len(bone["limits"]) == 2


@pytest.mark.data
def test_a_motion_without_a_skeleton_beside_it(data_dir: Path) -> None:
    path = data_dir / "asf_amc/misc/zeros.amc"
    with pytest.raises(FormatError, match="holds no skeleton"):
        keypose.io.load(path)
    scene = keypose.io.load(path, skeleton=data_dir / "asf_amc/cmu_02/02.asf")
    motion, rest = motion_of(scene), scene.character.skeleton.rest
    assert motion.frame_count == 7
    np.testing.assert_allclose(motion.pose.rotations[3], rest.rotations, atol=1e-15)
    np.testing.assert_allclose(motion.pose.translations[3], rest.translations, atol=1e-15)


@pytest.mark.data
def test_the_same_take_as_bvh(data_dir: Path) -> None:
    """cgspeed's conversion: one more frame, every orientation, and every place down to where it drops an offset."""
    acclaim, bvh = keypose.io.load(data_dir / "cmu_01_01/01_01.amc"), keypose.io.load(data_dir / "cmu_01_01/01_01.bvh")
    a, b = motion_of(acclaim), motion_of(bvh)
    assert b.frame_count == a.frame_count + 1
    mine, theirs = acclaim.character.skeleton, bvh.character.skeleton
    np.testing.assert_array_equal(mine.parents, theirs.parents)
    turns, places = (np.asarray(x) for x in evaluate.world_rotations_positions(mine, a.pose))
    other_turns, other_places = (np.asarray(x) for x in evaluate.world_rotations_positions(theirs, b.pose[1:]))
    assert np.degrees(np.asarray(quat.angle_between(turns, other_turns))).max() < 1e-3
    distance = np.linalg.norm(places - other_places, axis=-1).max(axis=0)
    same = np.linalg.norm(np.asarray(mine.rest.translations) - theirs.rest.translations, axis=-1) < 1e-4
    for joint, parent in enumerate(mine.parents):
        same[joint] &= parent < 0 or same[parent]
    assert same.sum() == 14  # legs and spine; the BVH puts neck and shoulders at the thorax's start
    assert distance[same].max() < 1e-5
    assert distance[~same].min() > 0.1


@pytest.mark.data
def test_the_same_take_as_markers(data_dir: Path) -> None:
    markers = keypose.io.load(data_dir / "cmu_01_01/01_01.c3d").markers[0]
    motion = motion_of(keypose.io.load(data_dir / "cmu_01_01/01_01.amc"))
    names = [next(n for n in markers.names if n.endswith(word)) for word in ("LFWT", "RFWT", "LBWT", "RBWT")]
    waist = np.nanmean(np.asarray(markers.positions)[:, [markers.names.index(n) for n in names]], axis=1)
    root = np.asarray(motion.pose.broadcast().translations)[:, 0]
    # AMC's (x, y, z) is (y, z, x) of the Z-up capture volume, which is a turn about Y of what was loaded Y up
    distance = np.linalg.norm(root - waist @ turn("y", -90).T, axis=-1)
    assert 0.023 < np.nanmedian(distance) < 0.025
    assert np.nanmin(distance) > 1e-4 and np.nanmax(distance) < 0.046


# --- the rules, on a small file ---------------------------------------------------------------------------------------------


def test_positions_by_hand(take: Path) -> None:
    """Column-vector products of matrices written out here: parent, then C M C^-1, then the bone."""
    scene = keypose.io.load(take)
    skeleton, motion = scene.character.skeleton, motion_of(scene)
    positions = np.asarray(evaluate.world_rotations_positions(skeleton, motion.pose)[1])
    for frame, (root, hip, knee, spine) in enumerate(
        [
            ((1, 20, 3, 10, 20, 30), (5, 6, 7), (40, -3), (0, 0, 0)),
            ((1.5, 20, 3, 11, 21, 31), (5.5, 6, 7.25), (41, -3), (0.5, 10, 0.25)),
            ((2, 20, 3, 12, 22, 32), (6, 6, 7.5), (42, -3.5), (1, 20, 0.5)),
        ]
    ):
        at = np.array(root[:3], float)
        world = turn("z", root[5]) @ turn("y", root[4]) @ turn("x", root[3])
        axis = turn("z", 30)
        at_knee_world = world @ axis @ turn("z", hip[2]) @ turn("y", hip[1]) @ turn("x", hip[0]) @ axis.T
        at_knee = at + at_knee_world @ (0, -2, 0)
        axis = turn("x", 30) @ turn("y", 20) @ turn("z", 10)  # ZYX: the first angle is about Z
        foot_world = at_knee_world @ axis @ turn("x", knee[1]) @ turn("z", knee[0]) @ axis.T
        at_foot = at_knee + foot_world @ (0, -3, 0)
        at_spine = at + world @ (spine[0], 0, 0)
        at_head = at_spine + world @ turn("y", spine[1]) @ (0, 5 + spine[2], 0)
        for name, place in {"root": at, "knee": at_knee, "foot": at_foot, "spine": at_spine, "head": at_head}.items():
            np.testing.assert_allclose(positions[frame, skeleton.index(name)], place * CMU_M, atol=1e-12, err_msg=name)


def test_bone_axes_move_the_same(take: Path) -> None:
    world, bone = keypose.io.load(take), keypose.io.load(take, axes="bone")
    poses = [evaluate.world_rotations_positions(s.character.skeleton, motion_of(s).pose) for s in (world, bone)]
    np.testing.assert_allclose(poses[0][1], poses[1][1], atol=1e-12)
    # at rest each joint has its bone's axes
    skeleton = bone.character.skeleton
    rest = np.asarray(evaluate.world(skeleton, skeleton.rest))
    np.testing.assert_allclose(rest[skeleton.index("hip"), :3, :3], turn("z", 30), atol=1e-12)
    knee = turn("x", 30) @ turn("y", 20) @ turn("z", 10)
    np.testing.assert_allclose(rest[skeleton.index("knee"), :3, :3], knee, atol=1e-12)
    ends = [dict(s.character.skeleton.end_offsets) for s in (world, bone)]
    assert ends[0].keys() == ends[1].keys()


def test_radians_are_degrees(take: Path) -> None:
    degrees = keypose.io.load(take)
    lines = []
    for line in AMC.replace(":DEGREES", ":RADIANS").splitlines():
        word, *numbers = line.split()
        dofs = {"root": "tttrrr", "hip": "rrr", "knee": "rr", "spine": "trl", "head": "r"}.get(word, "")
        if dofs:
            turned = [repr(np.radians(float(n))) if d == "r" else n for n, d in zip(numbers, dofs, strict=True)]
            line = " ".join([word, *map(str, turned)]).replace("np.float64(", "").replace(")", "")
        lines.append(line)
    take.write_text("\n".join(lines))
    radians = keypose.io.load(take)
    np.testing.assert_allclose(motion_of(degrees).pose.rotations, motion_of(radians).pose.rotations, atol=1e-14)


def test_the_fast_way_and_the_slow_way_agree(take: Path) -> None:
    """A comment, a blank line or another order of bones sends a file the general way."""
    fast = motion_of(keypose.io.load(take))
    swapped = AMC.replace("knee 41e0 -3\nspine 0.5 10 0.25\n", "spine 0.5 10 0.25  # leans\n\nknee 41e0 -3\n")
    assert swapped != AMC
    for text in (
        swapped,
        AMC.replace("\n", "\r\n"),
        AMC.replace("\n", "\r"),
        AMC.rstrip(),
        AMC.replace("hip 6", "  hip\t6 "),
    ):
        take.write_text(text, newline="")
        slow = motion_of(keypose.io.load(take))
        np.testing.assert_array_equal(fast.pose.rotations, slow.pose.rotations)
        np.testing.assert_array_equal(fast.pose.translations, slow.pose.translations)


def test_large_files_are_read_in_blocks(tmp_path: Path) -> None:
    (tmp_path / "small.asf").write_text(ASF)
    rng = np.random.default_rng(3)
    values = rng.uniform(-90, 90, (30_000, 12)).round(4)
    spread = [(0, 6), (6, 9), (9, 11), (11, 12)]
    names = ("root", "hip", "knee", "head")
    text = ":FULLY-SPECIFIED\n:DEGREES\n" + "".join(
        f"{k}\n"
        + "".join(f"{n} {' '.join(map(repr, row[a:b].tolist()))}\n" for n, (a, b) in zip(names, spread, strict=True))
        for k, row in enumerate(values, 1)
    )
    path = tmp_path / "small_2.amc"
    path.write_text(text)
    assert path.stat().st_size > 3 << 19
    scene = keypose.io.load(path)
    motion = motion_of(scene)
    assert motion.frame_count == 30_000
    assert any("spine" in note and "stay at rest" in note for note in scene.notes)
    np.testing.assert_allclose(motion.pose.translations[:, 0], values[:, :3] * CMU_M, rtol=1e-15)
    head = motion.pose.rotations[:, scene.character.skeleton.index("head")]
    # about the head's X axis, which its axis of 90 degrees about Y turns to -Z
    np.testing.assert_allclose(np.abs(head[:, 3]), np.abs(np.sin(np.radians(values[:, 11]) / 2)), atol=1e-12)
    # one wrong number far inside is found with its line
    lines = text.splitlines()
    lines[5 * 20_000 + 3] += "x"
    path.write_text("\n".join(lines))
    with pytest.raises(FormatError, match=f"line {5 * 20_000 + 4}: .*expected a number"):
        keypose.io.load(path)


def test_bones_that_are_left_out_stay_as_they_were(take: Path) -> None:
    text = AMC.replace(":FULLY-SPECIFIED\n", "").replace("knee 41e0 -3\n", "").replace("head 12\n", "")
    take.write_text(text)
    scene = keypose.io.load(take)
    motion, skeleton = motion_of(scene), scene.character.skeleton
    knee = motion.pose.rotations[:, skeleton.index("knee")]
    np.testing.assert_array_equal(knee[0], knee[1])
    head = motion.pose.rotations[:, skeleton.index("head")]
    np.testing.assert_allclose(head[0], (1, 0, 0, 0), atol=1e-15)
    assert abs(head[1, 0]) < 0.999
    assert any("left out of some frames" in note for note in scene.notes)


def test_the_unit(tmp_path: Path) -> None:
    path = tmp_path / "a.asf"
    path.write_text(ASF)
    assert keypose.io.load(path).unit_m == pytest.approx(UNITS_M["cmu"])
    assert keypose.io.load(path, unit="cm").unit_m == 0.01
    for line in ("  length 1.0\n", ""):
        path.write_text(ASF.replace("  length 0.45\n", line))
        scene = keypose.io.load(path)
        assert scene.unit_m == 0.01 and any("no human's" in note for note in scene.notes)


@pytest.mark.data
def test_the_unit_of_a_human_that_does_not_say(data_dir: Path, tmp_path: Path) -> None:
    text = (data_dir / "cmu_01_01/01.asf").read_text().replace("length 0.45", "", 1)
    path = tmp_path / "01.asf"
    path.write_text(text)
    scene = keypose.io.load(path)
    assert scene.unit_m == pytest.approx(UNITS_M["cmu"]) and any("taken as cmu" in note for note in scene.notes)


def test_finding_the_skeleton(take: Path) -> None:
    folder = take.parent
    other = ASF.replace("name knee", "name joint").replace("hip knee", "hip joint").replace("knee foot", "joint foot")
    (folder / "a.asf").write_text(other)
    assert keypose.io.load(take).notes[0] == "skeleton: small.asf"
    (folder / "small.asf").rename(folder / "zzz.ASF")  # neither name: the one whose bones fit
    assert keypose.io.load(take).notes[0] == "skeleton: zzz.ASF"
    (folder / "zzz.ASF").unlink()
    with pytest.raises(FormatError, match=r"a\.asf has no bone 'knee'"):
        keypose.io.load(take)
    with pytest.raises(FormatError, match="no bone 'knee'"):
        keypose.io.load(take, skeleton=folder / "a.asf")
    with pytest.raises(FormatError, match=r"none\.asf"):
        keypose.io.load(take, skeleton=str(folder / "none.asf"))


def test_a_skeleton_beside_it_in_a_command(take: Path, tmp_path: Path) -> None:
    from keypose.cli.inputs import Reading, open_inputs

    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    skeleton = str((tmp_path / "small.asf").rename(elsewhere / "body.asf"))
    with pytest.raises(FormatError, match="--skeleton"):
        open_inputs([str(take)])
    for order in ([str(take), skeleton], [skeleton, str(take)]):
        scenes = open_inputs(order, Reading(unit="cm"))
        taken = scenes[order.index(str(take))]
        assert motion_of(taken).frame_count == 3 and taken.unit_m == 0.01


def test_rate_and_first_frame(take: Path) -> None:
    assert motion_of(keypose.io.load(take)).rate_hz == 120
    assert motion_of(keypose.io.load(take, rate_hz=60)).rate_hz == 60
    text = AMC.replace("\n1\n", "\n13\n").replace("\n2\n", "\n14\n").replace("\n3\n", "\n15\n")
    take.write_text(text.replace(":DEGREES", ":DEGREES\n:SAMPLES-PER-SECOND 30"))
    motion = motion_of(keypose.io.load(take))
    assert motion.rate_hz == 30 and motion.start_s == pytest.approx(12 / 30)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("\n2\nroot", "\n4\nroot", "line 10: frame 4 follows frame 1; expected 2"),
        ("knee 41e0 -3", "knee 41e0", r"line 13: frame 2: bone 'knee' has 2 dof in the skeleton, found 1 numbers"),
        ("knee 41e0 -3", "knee 41e0 nan", "line 13: bone 'knee': expected a number, found 'nan'"),
        ("knee 41e0 -3", "knee 41e0 1e300", "line 13: bone 'knee': expected a number, found '1e300'"),
        ("knee 41e0 -3", "elbow 41e0 -3", "line 13: frame 2: the skeleton has no bone 'elbow'"),
        ("knee 41e0 -3", "hip 1 2 3", "line 13: frame 2: bone 'hip' comes twice"),
        ("head -12.000\n", "", "line 15: frame 2 has no values for bone 'head'"),
        ("head 1\n", "", "frame 3 has no values for bone 'head'.*truncated='keep'"),
        (":DEGREES\n1", ":DEGREES\nx", "line 4: expected a frame number, found 'x'"),
    ],
)
def test_faults_of_motions(take: Path, old: str, new: str, message: str) -> None:
    assert old in AMC
    take.write_text(AMC.replace(old, new))
    with pytest.raises(FormatError, match=message) as error:
        keypose.io.load(take)
    assert str(take) in str(error.value)


def test_a_cut_file_is_kept_on_demand(take: Path) -> None:
    for cut in ("head 1\n", "spine 1 20 0.5\nhead 1\n", " 0.5\nhead 1\n"):
        take.write_text(AMC.removesuffix(cut))
        with pytest.raises(FormatError):
            keypose.io.load(take)
        scene = keypose.io.load(take, truncated="keep")
        assert motion_of(scene).frame_count == 2 and any("was cut" in note for note in scene.notes)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("length 2", "length two", "line 20: length of bone 'hip': expected a number, found 'two'"),
        ("dof rz rx", "dof rz rz", "line 33: dof of bone 'knee': 'rz' comes twice"),
        ("dof rz rx", "dof rz rw", "line 33: dof of bone 'knee': expected some of"),
        ("name knee", "name hip", "line 34: a second bone 'hip'"),
        ("hip knee", "hip knees", "hierarchy: there is no bone 'knees'"),
        ("knee foot", "knee knee", "'knee' is below 'hip' already"),
        ("root hip spine", "root spine", "bone 'hip' does not hang on the root"),
        ("(-70.0 70.0)", "(-70.0 70.0", "limits of bone 'hip': expected pairs"),
        ("axis 0 0 30  XYZ", "axis 0 0 30", "axis of bone 'hip': expected an order of X, Y and Z, found nothing"),
        ("     name foot\n", "", "has no name"),
        ("  end\n  begin\n     id 2", "  begin\n     id 2", "begin inside bone 'hip'"),
        ("order TX", "order TW", "order: expected some of"),
        (":root\n", "", "the file has no :root"),
    ],
)
def test_faults_of_skeletons(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in ASF
    path = tmp_path / "a.asf"
    path.write_text(ASF.replace(old, new, 1))
    with pytest.raises(FormatError, match=message):
        keypose.io.load(path)


def test_limits_are_kept_in_degrees(tmp_path: Path) -> None:
    path = tmp_path / "a.asf"
    path.write_text(ASF)
    bones = keypose.io.load(path).character.extras["acclaim"]["bones"]
    assert bones["hip"]["limits"] == [[-160, 20], [-70, 70], [-60, None]]
    assert bones["knee"] == {"axis_deg": [10, 20, 30], "axis_order": "ZYX", "dof": "rz rx"}
    path.write_text(ASF.replace("           (-60.0 inf)\n", ""))
    scene = keypose.io.load(path)
    assert "limits" not in scene.character.extras["acclaim"]["bones"]["hip"]
    assert any("3 dof and 2 limits" in note for note in scene.notes)


def test_options_that_do_not_exist(take: Path) -> None:
    for options in ({"axes": "local"}, {"truncated": "cut"}, {"unit": "yard"}, {"skelton": "a"}):
        with pytest.raises(UnknownName):
            keypose.io.load(take, **options)


def test_the_page_in_the_docs() -> None:
    import doctest

    result = doctest.testfile(str(ROOT / "docs/formats/acclaim.md"), module_relative=False, encoding="utf-8")
    assert result.attempted > 5 and not result.failed
