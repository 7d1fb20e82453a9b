"""Reading BVH: what each part of the format means, and how what does not follow it is refused."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import keypose.io
from keypose.errors import FormatError
from keypose.io.bvh import rate_from_frame_time
from keypose.math import quat
from tests.io.bvh_files import SMALL, one_joint, turns, world_of, written

ORDERS = ["".join(p) for p in itertools.permutations("XYZ")]


def test_a_small_file_is_what_it_says(tmp_path: Path) -> None:
    scene = keypose.io.load(written(tmp_path, SMALL, "walk.bvh"), unit="cm", up="Y")
    skeleton, motion = scene.character.skeleton, scene.animation()
    assert skeleton.names == ("Hips", "Spine", "Leg") == motion.joint_names
    assert skeleton.parents.tolist() == [-1, 0, 0]
    np.testing.assert_allclose(skeleton.rest.translations, [[0, 0.9, 0], [0, 0.2, 0], [0.08, -0.05, 0]])
    assert skeleton.rest.rotations.tolist() == [[1, 0, 0, 0]] * 3
    assert skeleton.end_offsets == ((1, (0.0, 0.1, 0.0)), (2, (0.0, -0.85, 0.0)))
    assert (motion.frame_count, motion.rate_hz, motion.name) == (2, 30.0, "walk")
    assert (scene.format, scene.unit_m, scene.up) == ("bvh", 0.01, "Y")
    np.testing.assert_allclose(motion.pose.translations[1], [[0.015, 0.92, 0.025], [0, 0.2, 0], [0.08, -0.05, 0]])
    for joint, (order, angles) in enumerate([("ZYX", [11, 21, 31]), ("ZXY", [2, 3, 4]), ("ZYX", [5, 6, 7])]):
        np.testing.assert_allclose(quat.to_matrix(motion.pose.rotations[1, joint]), turns(order, angles), atol=1e-15)
    assert motion.pose.rotations.dtype == np.float64 == motion.pose.translations.dtype


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("positions", ["first", "last", "mixed"])
def test_channels_in_any_order(tmp_path: Path, order: str, positions: str) -> None:
    turn, move = [f"{axis}rotation" for axis in order], ["Zposition", "Xposition", "Yposition"]
    names = {"first": move + turn, "last": turn + move}.get(positions)
    names = names or [c for pair in zip(turn, move, strict=True) for c in pair]
    rng = np.random.default_rng(1)
    rows = rng.uniform(-170, 170, (3, 6))
    scene = keypose.io.load(written(tmp_path, one_joint(" ".join(names), rows.tolist())), unit="m", up="Y")
    pose = scene.animation().pose
    for t, row in enumerate(rows):
        value = dict(zip(names, row, strict=True))
        expected = turns(order, [value[f"{axis}rotation"] for axis in order])
        np.testing.assert_allclose(quat.to_matrix(pose.rotations[t, 0]), expected, atol=1e-14)
        np.testing.assert_allclose(pose.translations[t, 0], [value[f"{axis}position"] for axis in "XYZ"])


@pytest.mark.parametrize("channels", ["", "Yrotation", "Zrotation Xrotation", "Yposition", "Zposition Xrotation"])
def test_joints_with_less_than_three_channels(tmp_path: Path, channels: str) -> None:
    names = channels.split()
    child = f"JOINT b\n{{\nOFFSET 1 2 3\nCHANNELS {len(names)} {channels}\n}}"
    row = [5.0, 6, 7, 10, 20, 30, *(40.0 + 10 * k for k in range(len(names)))]
    text = one_joint("Xposition Yposition Zposition Zrotation Yrotation Xrotation", [row], child=child)
    pose = keypose.io.load(written(tmp_path, text), unit="m", up="Y", child_positions="replace").animation().pose
    values = dict(zip(names, row[6:], strict=True))
    turning = [c for c in names if c.endswith("rotation")]
    expected = turns("".join(c[0] for c in turning), [values[c] for c in turning])
    np.testing.assert_allclose(quat.to_matrix(pose.rotations[0, 1]), expected, atol=1e-15)
    place = [values.get(f"{axis}position", default) for axis, default in zip("XYZ", (1, 2, 3), strict=True)]
    np.testing.assert_allclose(pose.translations[0, 1], place)


@pytest.mark.parametrize(
    ("change", "joint"),
    [
        (lambda t: t.replace("\n", "\r\n"), "Hips"),
        (lambda t: t.replace("\n", "\r"), "Hips"),
        (lambda t: t.replace("\n", "\n\n"), "Hips"),
        (lambda t: "\ufeff" + t, "Hips"),
        (lambda t: "# made by hand\n" + t.replace("MOTION", "// the takes\nMOTION\n# two frames"), "Hips"),
        (lambda t: t.replace("1.5 92.0", "# second frame\n1.5 92.0"), "Hips"),
        (lambda t: t.replace("HIERARCHY", "Hierarchy").replace("JOINT", "Joint").replace("OFFSET", "offset"), "Hips"),
        (lambda t: t.replace("CHANNELS", "channels").replace("MOTION", "Motion").replace("rotation", "ROTATION"), "Hips"),
        (lambda t: t.replace("End Site", "End site"), "Hips"),
        (lambda t: t.replace("End Site", "End Site tip_of Spine"), "Hips"),
        (lambda t: t.replace("\n{", " {").replace("\n\t{", "{").replace("\n\t\t{", " {"), "Hips"),
        (lambda t: t.replace("Frames: 2", "Frames:2").replace("Frame Time: ", "Frame Time:"), "Hips"),
        (lambda t: t.replace("Frames: 2", "FRAMES:\t2").replace("Frame Time: ", "frame time\t"), "Hips"),
        (lambda t: t.replace(" ", "\t").replace("End\t", "End ").replace("Frame\t", "Frame "), "Hips"),
        (lambda t: t.replace(" 10.0 20.0 30.0", "\n10.0 2e1 +30."), "Hips"),
        (lambda t: t + "\n\n  \t\n", "Hips"),
        (lambda t: t.replace("Hips", "Left Arm (1)"), "Left Arm (1)"),
        (lambda t: t.replace("Hips", "mixamorig:Hips"), "mixamorig:Hips"),
        (lambda t: t.replace("Hips", "腰"), "腰"),
        (lambda t: t.replace("Hips", "MOTION capture"), "MOTION capture"),
        (lambda t: t.replace("OFFSET 0.0 90.0 0.0\n\tCHANNELS 6", "CHANNELS 6").replace("Xrotation\n\tJOINT Spine", "Xrotation\n\tOFFSET 0 90 0\n\tJOINT Spine"), "Hips"),
    ],
)  # fmt: skip
def test_variations_of_exporters_read_the_same(tmp_path: Path, change: object, joint: str) -> None:
    plain = keypose.io.load(written(tmp_path, SMALL))
    other = keypose.io.load(written(tmp_path, change(SMALL), "other.bvh"))
    assert other.character.skeleton.names == (joint, "Spine", "Leg")
    assert np.array_equal(world_of(plain), world_of(other))
    assert other.character.skeleton.end_offsets == plain.character.skeleton.end_offsets
    assert other.animation().rate_hz == 30


def test_names_that_are_not_utf8_are_read_as_latin_1(tmp_path: Path) -> None:
    scene = keypose.io.load(written(tmp_path, SMALL.replace("Hips", "Hüfte").encode("latin-1")))
    assert scene.character.skeleton.names[0] == "Hüfte"
    assert any("Latin-1" in note for note in scene.notes)


def test_names_that_come_twice_are_told_apart(tmp_path: Path) -> None:
    scene = keypose.io.load(written(tmp_path, SMALL.replace("Spine", "Hips").replace("Leg", "Hips_2")))
    assert scene.character.skeleton.names == ("Hips", "Hips_3", "Hips_2")
    assert any("'Hips' -> 'Hips_3'" in note for note in scene.notes)
    scene = keypose.io.load(
        written(tmp_path, SMALL.replace("JOINT Spine", "JOINT").replace("JOINT Leg", "JOINT {").replace("{\n\t{", "{"))
    )
    assert scene.character.skeleton.names == ("Hips", "joint", "joint_2")


def test_several_roots(tmp_path: Path) -> None:
    text = SMALL.replace("MOTION", "ROOT Prop\n{\nOFFSET 0 0 50\nCHANNELS 3 Xposition Yposition Zposition\n}\nMOTION")
    text = text.replace("4.0 5.0 6.0\n", "4.0 5.0 6.0 7 8 9\n").replace("5.0 6.0 7.0\n", "5.0 6.0 7.0 8 9 10\n")
    scene = keypose.io.load(written(tmp_path, text), unit="cm", root_positions="replace")
    assert scene.character.skeleton.parents.tolist() == [-1, 0, 0, -1]
    np.testing.assert_allclose(scene.animation().pose.translations[:, 3], [[0.07, 0.08, 0.09], [0.08, 0.09, 0.1]])


def test_files_with_a_skeleton_only(tmp_path: Path) -> None:
    for text in (SMALL[: SMALL.index("MOTION")], SMALL[: SMALL.index("1.0 91.0")].replace("Frames: 2", "Frames: 0")):
        scene = keypose.io.load(written(tmp_path, text))
        assert scene.character.skeleton.joint_count == 3 and scene.animations == ()


def test_a_hierarchy_of_100000_levels(tmp_path: Path) -> None:
    block = "".join(f"JOINT j{k}\n{{\nOFFSET 0 1 0\nCHANNELS 0\n" for k in range(100_000))
    text = one_joint("Xposition", [[1.0], [2.0]], child=block + "}" * 100_000)
    scene = keypose.io.load(written(tmp_path, text))
    assert scene.character.skeleton.joint_count == 100_001
    assert scene.character.skeleton.parents[-1] == 99_999


# --- positions: replace or add ------------------------------------------------------------------------------------------


def moving_children(values: list[list[float]]) -> str:
    """A chain of two children with position channels, OFFSET (0, 10, 0) and (3, 0, 0)."""
    inner = "JOINT c\n{\nOFFSET 3 0 0\nCHANNELS 3 Xposition Yposition Zposition\n}"
    outer = f"JOINT b\n{{\nOFFSET 0 10 0\nCHANNELS 3 Xposition Yposition Zposition\n{inner}\n}}"
    return one_joint("Yrotation", [[0.0, *row] for row in values], child=outer)


def test_positions_around_the_offset_replace_it(tmp_path: Path) -> None:
    path = written(tmp_path, moving_children([[0, 10, 0, 3, 0, 0], [1, 11, 0, 2, 0, 0.5]]))
    scene = keypose.io.load(path, unit="m", up="Y")
    np.testing.assert_allclose(scene.animation().pose.translations[1, 1:], [[1, 11, 0], [2, 0, 0.5]])
    assert any("replace their OFFSET" in note for note in scene.notes)
    added = keypose.io.load(path, unit="m", up="Y", child_positions="add")
    np.testing.assert_allclose(added.animation().pose.translations[1, 1:], [[1, 21, 0], [5, 0, 0.5]])


def test_positions_around_zero_are_added_to_the_offset(tmp_path: Path) -> None:
    path = written(tmp_path, moving_children([[0, 0, 0, 0, 0, 0], [1, 1, 0, -1, 0, 0.5]]))
    scene = keypose.io.load(path, unit="m", up="Y")
    np.testing.assert_allclose(scene.animation().pose.translations[1, 1:], [[1, 11, 0], [2, 0, 0.5]])
    assert any("are added to their OFFSET" in note for note in scene.notes)
    replaced = keypose.io.load(path, unit="m", up="Y", child_positions="replace")
    np.testing.assert_allclose(replaced.animation().pose.translations[1, 1:], [[1, 1, 0], [-1, 0, 0.5]])


def figure(rows: list[list[float]]) -> str:
    """A root at a height of 90 with a foot 88 below."""
    foot = "JOINT foot\n{\nOFFSET 0 -88 0\nCHANNELS 0\n}"
    return one_joint("Xposition Yposition Zposition", rows, offset="0 90 0", child=foot)


@pytest.mark.parametrize(
    ("rows", "height", "told"),
    [
        ([[0, 91, 0], [5, 89, 100]], 0.91, False),  # walking, positions replace
        ([[0, 1, 0], [5, -1, 100]], 0.91, True),  # walking, positions are changes: else the foot is 87 below ground
        ([[0, 1, 0], [5, -1, 100]], 0.01, False),  # the option wins
    ],
)
def test_root_positions_around_zero_are_added_where_the_body_would_sink(
    tmp_path: Path, rows: list[list[float]], height: float, told: bool
) -> None:
    options = {"root_positions": "replace"} if height == 0.01 else {}
    scene = keypose.io.load(written(tmp_path, figure(rows)), unit="cm", up="Y", **options)
    assert abs(scene.animation().pose.translations[0, 0, 1] - height) < 1e-12
    assert any("are added to its OFFSET" in note for note in scene.notes) == told


def test_a_body_that_lies_on_the_ground_stays_there(tmp_path: Path) -> None:
    text = figure([[0, 12, 0], [0, 12, 1]]).replace("OFFSET 0 -88 0", "OFFSET 0 -2 88")
    scene = keypose.io.load(written(tmp_path, text), unit="cm", up="Y")
    assert abs(scene.animation().pose.translations[0, 0, 1] - 0.12) < 1e-12


# --- frame times ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "rate_hz"),
    [
        ("0.0333333", 30), (".0083333", 120), ("0.016667", 60), ("0.041667", 24), ("0.04", 25), ("0.033", 30),
        ("0.0417083750417", 23.976), ("0.0417083333333", 24000 / 1001), ("0.0333666667", 30000 / 1001), ("0.033367", 30000 / 1001),
        ("0.01", 100), ("0.008333", 120), ("0.00833333", 120), ("0.0166667", 60), ("0.1", 10), ("1", 1), ("0.5", 2),
        ("0.02000000", 50), ("0.0123456789", 1 / 0.0123456789), ("3.3333333e-02", 30), ("0.005", 200), ("0.0009765625", 1024),
    ],
)  # fmt: skip
def test_rates_from_rounded_frame_times(text: str, rate_hz: float) -> None:
    assert rate_from_frame_time(float(text), text) == pytest.approx(rate_hz, rel=1e-12)


@settings(max_examples=200, deadline=None)
@given(st.integers(1, 500), st.integers(5, 12))
def test_whole_rates_survive_rounding(rate: int, digits: int) -> None:
    text = f"{1 / rate:.{digits}f}"
    found = rate_from_frame_time(float(text), text)
    # the rate itself, or another one that is written with the same digits
    assert found == rate or text in (f"{1 / found:.{digits}f}", f"{1 / found:.{digits + 6}f}"[:-6])


# --- refusals ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: "HIERARCHIE" + t[9:], "line 1: expected HIERARCHY, found 'HIERARCHIE'"),
        (lambda t: "HIERARCHY\nMOTION\n", "no ROOT in the hierarchy"),
        (lambda t: t.replace("JOINT Spine\n\t{", "JOINT Spine\n\t"), "line 8: expected '{' to open joint 'Spine', found 'OFFSET'"),
        (lambda t: t.replace("\t}\n\tJOINT Leg", "\tJOINT Leg"), "line 24: the hierarchy ends inside joint 'Hips'; a '}' is missing"),
        (lambda t: t.replace("}\nMOTION", "}\n}\nMOTION"), "line 25: '}' without an open '{'"),
        (lambda t: t.replace("\t{\n\t\tOFFSET 8", "\t{\n\t{\n\t\tOFFSET 8"), "line 17: '{' without a ROOT, JOINT or End Site"),
        (lambda t: t.replace("OFFSET 8.0 -5.0 0.0", "OFFSET 8.0 -5.0"), "line 18: OFFSET of joint 'Leg': expected three numbers, found 'CHANNELS'"),
        (lambda t: t.replace("OFFSET 8.0", "OFFSET nan"), "line 17: OFFSET of joint 'Leg': expected three numbers, found 'nan'"),
        (lambda t: t.replace("\t\tOFFSET 8.0 -5.0 0.0\n", ""), "line 22: joint 'Leg' has no OFFSET"),
        (lambda t: t.replace("\t\t\tOFFSET 0.0 10.0 0.0\n", ""), "line 12: the End Site of joint 'Spine' has no OFFSET"),
        (lambda t: t.replace("OFFSET 8.0", "OFFSET 1 1 1\nOFFSET 8.0"), "line 18: joint 'Leg' has a second OFFSET"),
        (lambda t: t.replace("CHANNELS 3 Zrotation X", "CHANNELS 2 Zrotation X"), "'Yrotation' is more than the CHANNELS count"),
        (lambda t: t.replace("CHANNELS 3 Zrotation X", "CHANNELS 4 Zrotation X"), "line 10: CHANNELS of joint 'Spine': expected 4 of Xposition … Zrotation, found 'End'"),
        (lambda t: t.replace("CHANNELS 3", "CHANNELS 3000000000"), "expected a count from 0 to 6, found '3000000000'"),
        (lambda t: t.replace("Zrotation Xrotation", "Zrotation Zrotation"), "line 9: CHANNELS of joint 'Spine': Zrotation comes twice"),
        (lambda t: t.replace("Zrotation Xrotation", "Zrotation Wrotation"), "found 'Wrotation'"),
        (lambda t: t.replace("JOINT Leg", "BONE Leg"), "line 15: expected JOINT, End Site, OFFSET, CHANNELS or a brace, found 'BONE'"),
        (lambda t: t.replace("JOINT Leg", "ROOT Leg"), "line 15: ROOT inside joint 'Hips'; a '}' is missing"),
        (lambda t: t.replace("MOTION\n", "JOINT x\n{\nOFFSET 0 0 0\n}\nMOTION\n"), "JOINT 'x' outside any ROOT"),
        (lambda t: t.replace("Frames: 2", "Frames: two"), "line 26: Frames: expected a count, found 'two'"),
        (lambda t: t.replace("Frames: 2", "Frames: -2"), "Frames: expected a count"),
        (lambda t: t.replace("Frames: 2\n", ""), "line 25: expected 'Frames:' after MOTION"),
        (lambda t: t.replace("Frames: 2", "Frames: 999999999999"), "cannot be in a file of"),
        (lambda t: t.replace("Frame Time: 0.0333333\n", ""), "expected 'Frame Time:'"),
        *[(lambda t, bad=bad: t.replace("0.0333333", bad), f"line 27: Frame Time: expected seconds above 0, found '{bad}'")
          for bad in ("0", "-0.04", "nan", "1e-300", "soon")],
        (lambda t: t.replace("20.0 30.0", "20.0x 30.0"), "line 28: expected a number, found '20.0x'"),
        (lambda t: t.replace("2.5 11.0", "2,5 11.0"), "line 29: expected a number, found '2,5'; decimals are written with a point"),
        (lambda t: t.replace("2.5 11.0", "2.5 nan"), "line 29: expected a number, found 'nan'"),
        (lambda t: t.replace("2.5 11.0", "2.5 1e40"), "line 29: frame 1, channel 3: 1e+40 is not within ±1e+09"),
        (lambda t: t.replace(" 6.0 7.0\n", " 6.0"), "line 29: expected 12 numbers in each frame, found 11 in the last line (the file was cut?)"),
        (lambda t: t.replace("1.0 91.0", "91.0"), "line 28: expected 12 numbers in each frame, found 11; --option truncated=keep, in Python load(path, truncated='keep')"),
        (lambda t: t.replace("Frames: 2", "Frames: 3"), "line 26: Frames: says 3, but the file holds 24 numbers (2 frames of 12)"),
        (lambda t: t.replace("Frames: 2", "Frames: 1"), "line 26: Frames: says 1, but the file holds 24 numbers"),
        (lambda t: t.encode("utf-16"), "UTF-16"),
        (lambda t: t.replace("CHANNELS 6 Xposition Yposition Zposition Zrotation Yrotation Xrotation", "CHANNELS 0").replace("CHANNELS 3 Zrotation Xrotation Yrotation", "CHANNELS 0").replace("CHANNELS 3 Zrotation Yrotation Xrotation", "CHANNELS 0"), "numbers follow, but no joint has channels"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_refused_with_its_line(tmp_path: Path, change: object, message: str) -> None:
    path = written(tmp_path, change(SMALL), "wrong.bvh")
    with pytest.raises(FormatError) as caught:
        keypose.io.load(path)
    assert message in str(caught.value)
    assert str(caught.value).startswith(f"{path}: ") and "\n" not in str(caught.value)


def test_lines_are_named_for_every_line_end(tmp_path: Path) -> None:
    for end in ("\n", "\r\n", "\r"):
        with pytest.raises(FormatError, match="line 29: expected a number, found 'x'"):
            keypose.io.load(written(tmp_path, SMALL.replace("2.5 11.0", "2.5 x").replace("\n", end)))


def test_whole_frames_of_a_cut_file_can_be_kept(tmp_path: Path) -> None:
    cut = written(tmp_path, SMALL[: SMALL.rindex("4.0")])
    with pytest.raises(FormatError, match="the file was cut"):
        keypose.io.load(cut)
    scene = keypose.io.load(cut, truncated="keep")
    assert scene.animation().frame_count == 1
    assert any("1 whole frames of 12 kept, 8 numbers dropped" in note for note in scene.notes)
    assert np.array_equal(world_of(scene)[0], world_of(keypose.io.load(written(tmp_path, SMALL)))[0])
    longer = keypose.io.load(written(tmp_path, SMALL.replace("Frames: 2", "Frames: 1")), truncated="keep")
    assert longer.animation().frame_count == 2


def test_poses_that_would_not_fit_in_memory_are_refused(tmp_path: Path) -> None:
    block = "".join(f"JOINT j{k}\n{{\nOFFSET 0 1 0\nCHANNELS 0\n}}\n" for k in range(20_000))
    text = one_joint("Xposition", [[1.0]] * 100_000, child=block)
    with pytest.raises(FormatError, match="nearly all without channels"):
        keypose.io.load(written(tmp_path, text))
