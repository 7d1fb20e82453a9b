"""Writing BVH: what is read back is what was there."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import keypose.io
from keypose.errors import FormatError, ShapeError, UnknownName
from keypose.math import quat
from keypose.model import Channel, Character, Clip, Curve, CurveKind, Motion, Part, Pose, Property, Scene, Skeleton
from tests.io.bvh_files import SMALL, differences, one_joint, still, world_of, written

# what the format is promised to keep: 1e-3 mm and 1e-4 degrees
MM, DEG = 1e-3, 1e-4


def saved(scene: Scene, folder: Path, **options: object) -> Scene:
    """The scene after a round through a file."""
    keypose.io.save(scene, folder / "saved.bvh", **options)
    return keypose.io.load(folder / "saved.bvh")


def random_scene(rng: np.random.Generator, joints: int, frames: int, *, roots: int = 1, moving: bool = False) -> Scene:
    """A character of no file: a tree whose order is not depth first, with rest rotations and any motion."""
    parents = np.array([-1] * roots + [int(rng.integers(0, j)) for j in range(roots, joints)])
    turns = rng.normal(size=(frames + 1, joints, 4))
    turns /= np.linalg.norm(turns, axis=-1, keepdims=True)
    rest = Pose(rng.normal(size=(joints, 3)) * 0.3, turns[-1], np.ones((joints, 3)))
    skeleton = Skeleton(tuple(f"j{k}" for k in range(joints)), parents, rest)
    move = np.repeat(rest.translations[None], frames, axis=0)
    move[:, parents < 0] += rng.normal(size=(frames, roots, 3))
    if moving:
        move += rng.normal(size=move.shape) * 0.05
    motion = Motion(skeleton.names, Pose(move, turns[:-1], np.ones((joints, 3))), 30.0, "dance")
    return Scene((Character(skeleton, name="c"),), (motion,))


def aligned(scene: Scene, like: Scene) -> Scene:
    """The scene with its joints in the order of another one."""
    order = [scene.character.skeleton.index(name) for name in like.character.skeleton.names]
    parents = scene.character.skeleton.parents[order]
    place = np.argsort(order)
    skeleton, motion = scene.character.skeleton, scene.animations[0]

    def picked(pose: Pose) -> Pose:
        return Pose(pose.translations[..., order, :], pose.rotations[..., order, :], pose.scales[..., order, :])

    names = tuple(skeleton.names[j] for j in order)
    moved = Skeleton(names, np.where(parents < 0, -1, place[parents]), picked(skeleton.rest))
    return Scene((Character(moved),), (replace(motion, joint_names=names, pose=picked(motion.pose)),))


def test_a_file_is_written_as_it_was_read(tmp_path: Path) -> None:
    path = written(tmp_path, SMALL)
    scene = keypose.io.load(path)
    assert keypose.io.save(scene, tmp_path / "again.bvh") == ()

    def words(file: Path) -> list[str]:
        return [
            f"{float(w):.4f}" if w[-1].isdigit() and w[0] in "-.0123456789" else w for w in file.read_text().split()
        ]

    assert words(tmp_path / "again.bvh") == words(path)
    again = keypose.io.load(tmp_path / "again.bvh")
    assert again.notes == scene.notes and again.character.extras == scene.character.extras


@pytest.mark.parametrize("unit", ["m", "cm", "mm", "inch", "foot", "dm", "cmu", 0.05])
@pytest.mark.parametrize("up", ["X", "Y", "Z"])
def test_any_unit_and_axis(tmp_path: Path, unit: str | float, up: str) -> None:
    scene = random_scene(np.random.default_rng(2), 12, 5)
    keypose.io.save(scene, tmp_path / "a.bvh", unit=unit, up=up)
    again = keypose.io.load(tmp_path / "a.bvh", unit=unit, up=up, root_positions="replace")
    moved, turned = differences(scene, aligned(again, scene))
    assert moved < MM and turned < DEG


@pytest.mark.parametrize("order", ["XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYX"])
def test_any_order(tmp_path: Path, order: str) -> None:
    scene = random_scene(np.random.default_rng(3), 12, 5)
    again = saved(scene, tmp_path, order=order)
    assert again.character.extras["bvh"]["channels"]["j5"] == " ".join(f"{axis}rotation" for axis in order)
    moved, turned = differences(
        scene, aligned(keypose.io.load(tmp_path / "saved.bvh", unit="cm", up="Y", root_positions="replace"), scene)
    )
    assert moved < MM and turned < DEG
    mixed = keypose.io.load(written(tmp_path, SMALL))
    assert max(differences(mixed, saved(mixed, tmp_path, order=order))) < DEG


def test_large_clips_take_the_compiled_path_with_the_same_result(tmp_path: Path) -> None:
    scene = random_scene(np.random.default_rng(4), 30, 1000)
    keypose.io.save(scene, tmp_path / "large.bvh", order="YXZ")
    assert (tmp_path / "large.bvh").stat().st_size > 500_000
    again = keypose.io.load(tmp_path / "large.bvh", unit="cm", up="Y", root_positions="replace")
    moved, turned = differences(scene, aligned(again, scene))
    assert moved < MM and turned < DEG
    # a few frames of it go the small way
    small = Scene(scene.characters, (scene.animations[0].with_pose(scene.animations[0].pose[:20]),))
    keypose.io.save(small, tmp_path / "small.bvh", order="YXZ")
    head = (tmp_path / "large.bvh").read_text().split("Frame Time")[1].splitlines()[1:21]
    assert (tmp_path / "small.bvh").read_text().split("Frame Time")[1].splitlines()[1:] == head


@settings(max_examples=40, deadline=None)
@given(
    st.lists(st.tuples(*[st.sampled_from([0.0, 90.0, -90.0, 180.0, 89.9999999, 45.0, 270.0, -180.0, 1e-5])] * 3), min_size=1, max_size=6),
    st.sampled_from(["XYZ", "ZXY", "YZX", "ZYX"]),
)  # fmt: skip
def test_gimbal_lock_loses_no_rotation(
    tmp_path_factory: pytest.TempPathFactory, angles: list[tuple[float, ...]], order: str
) -> None:
    folder = tmp_path_factory.mktemp("lock")
    channels = " ".join(f"{axis}rotation" for axis in "ZXY")
    scene = keypose.io.load(written(folder, one_joint(channels, [list(a) for a in angles])), unit="m", up="Y")
    assert differences(scene, saved(scene, folder, order=order))[1] < DEG


def test_angles_run_on_without_jumps(tmp_path: Path) -> None:
    turning = np.linspace(0, 1500, 200)
    rows = [[float(t), 60 * float(np.sin(t / 100)), 3.0] for t in turning]
    scene = keypose.io.load(written(tmp_path, one_joint("Zrotation Yrotation Xrotation", rows)), unit="m", up="Y")
    for order, options in (("ZYX", {}), ("XYZ", {"order": "XYZ"})):
        keypose.io.save(scene, tmp_path / "out.bvh", **options)
        table = np.array([line.split() for line in (tmp_path / "out.bvh").read_text().splitlines()[-200:]], float)
        assert np.abs(np.diff(table, axis=0)).max() < (9 if order == "ZYX" else 90)
        if order == "ZYX":
            np.testing.assert_allclose(table, rows, atol=1e-5)


def test_joints_that_move_get_position_channels(tmp_path: Path) -> None:
    scene = random_scene(np.random.default_rng(5), 10, 6, moving=True)
    keypose.io.save(scene, tmp_path / "a.bvh")
    again = keypose.io.load(tmp_path / "a.bvh", unit="cm", up="Y", root_positions="replace")
    moved, turned = differences(scene, aligned(again, scene))
    assert moved < MM and turned < DEG
    assert all("Xposition" in channels for channels in again.character.extras["bvh"]["channels"].values())


@settings(max_examples=150, deadline=None)
@given(
    st.lists(st.tuples(*[st.floats(-2, 2)] * 3), min_size=3, max_size=3),
    st.lists(st.tuples(*[st.floats(-2, 2)] * 3), min_size=3, max_size=3),
    st.floats(0.001, 0.5),
)
def test_the_reader_understands_the_writers_positions(
    tmp_path_factory: pytest.TempPathFactory,
    offsets: list[tuple[float, ...]],
    moves: list[tuple[float, ...]],
    sway: float,
) -> None:
    """Whatever lies between rest and motion: replace or add is written so that the reader's rules choose the same."""
    folder = tmp_path_factory.mktemp("rules")
    skeleton = still(["a", "b", "c"], [-1, 0, 1], [list(o) for o in offsets])
    values = np.array([moves, np.array(moves) + sway])
    pose = Pose(values, np.tile((1.0, 0, 0, 0), (2, 3, 1)), np.ones((3, 3)))
    scene = Scene((Character(skeleton),), (Motion(skeleton.names, pose, 25.0),))
    keypose.io.save(scene, folder / "a.bvh", unit="m")
    again = keypose.io.load(folder / "a.bvh", unit="m", up="Y")
    assert differences(scene, again)[0] < MM


def test_a_root_that_moves_around_zero_above_its_offset(tmp_path: Path) -> None:
    """Lying on the ground, walking below it: the reader's rule for roots must not move the written file."""
    for heights in ([0.1, 0.12], [-0.9, -0.88], [0.95, 0.9], [0.3, 0.3]):
        skeleton = still(["hip", "foot"], [-1, 0], [[0, 0.94, 0], [0, -0.9, 0]])
        values = np.array([[[0, height, 0], [0, -0.9, 0]] for height in heights])
        pose = Pose(values, np.tile((1.0, 0, 0, 0), (2, 2, 1)), np.ones((2, 3)))
        scene = Scene((Character(skeleton),), (Motion(skeleton.names, pose, 25.0),))
        keypose.io.save(scene, tmp_path / "a.bvh")
        assert differences(scene, keypose.io.load(tmp_path / "a.bvh", unit="cm", up="Y"))[0] < MM


def test_files_whose_root_is_added_stay_that_way(tmp_path: Path) -> None:
    foot = "JOINT foot\n{\nOFFSET 0 -88 0\nCHANNELS 0\n}"
    text = one_joint("Xposition Yposition Zposition", [[0, 1, 0], [5, -1, 100]], offset="0 90 0", child=foot)
    scene = keypose.io.load(written(tmp_path, text))
    again = saved(scene, tmp_path)
    assert again.character.extras == scene.character.extras and max(differences(scene, again)) < DEG


@pytest.mark.parametrize("lying", [True, False])
def test_rest_poses_of_z_up_worlds_come_back(tmp_path: Path, lying: bool) -> None:
    text = SMALL.replace("0.0 90.0 0.0", "0.0 0.0 90.0").replace("0.0 20.0 0.0", "0.0 0.0 20.0") if lying else SMALL
    scene = keypose.io.load(written(tmp_path, text), up="Z")
    assert scene.up == "Z" and scene.character.extras["bvh"]["rest_turned"] is lying
    rest = scene.character.skeleton.rest
    np.testing.assert_allclose(rest.translations[0], [0, 0.9, 0], atol=1e-15)  # upright in both cases
    keypose.io.save(scene, tmp_path / "again.bvh")
    again = keypose.io.load(tmp_path / "again.bvh", up="Z")
    np.testing.assert_allclose(again.character.skeleton.rest.translations, rest.translations, atol=1e-15)
    np.testing.assert_allclose(again.character.skeleton.rest.rotations, rest.rotations, atol=1e-15)
    assert max(differences(scene, again)) < DEG


def test_channels_grow_only_where_the_motion_needs_them(tmp_path: Path) -> None:
    child = "JOINT b\n{\nOFFSET 0 1 0\nCHANNELS 1 Xrotation\n}"
    scene = keypose.io.load(
        written(tmp_path, one_joint("Yrotation", [[10, 20], [20, 30]], child=child)), unit="m", up="Y"
    )
    channels = scene.character.extras["bvh"]["channels"]
    assert saved(scene, tmp_path).character.extras["bvh"]["channels"] == channels
    motion = scene.animations[0]
    rotations = np.array(motion.pose.rotations)
    rotations[:, 1] = quat.multiply(rotations[:, 1], quat.from_axis_angle(np.array((0, 0, 1.0)), np.array(0.3)))
    edited = replace(scene, animations=(motion.with_pose(replace(motion.pose, rotations=rotations)),))
    notes = keypose.io.save(edited, tmp_path / "edited.bvh")
    assert any("'b'" in note and "channels" in note for note in notes)
    again = keypose.io.load(tmp_path / "edited.bvh", unit="m", up="Y")
    assert differences(edited, again)[1] < DEG
    assert again.character.extras["bvh"]["channels"]["a"] == "Yrotation"


def test_clips_are_baked_and_motions_resampled(tmp_path: Path) -> None:
    skeleton = still(["hip"], [-1], [[0, 1, 0]])
    turn = quat.from_axis_angle(np.array((0, 1.0, 0)), np.array([0.0, 1.0]))
    clip = Clip({Channel("hip", Property.ROTATION): Curve(np.array([0.0, 1.0]), turn, kind=CurveKind.ROTATION)}, "turn")
    notes = keypose.io.save([skeleton, clip], tmp_path / "a.bvh")
    assert any("30 Hz" in note for note in notes)
    motion = keypose.io.load(tmp_path / "a.bvh").animations[0]
    assert (motion.frame_count, motion.rate_hz) == (31, 30)
    keypose.io.save([skeleton, clip], tmp_path / "a.bvh", rate_hz=12.5)
    assert keypose.io.load(tmp_path / "a.bvh").animations[0].frame_count == 13
    keypose.io.save([skeleton, motion], tmp_path / "a.bvh", rate_hz=10)
    again = keypose.io.load(tmp_path / "a.bvh").animations[0]
    assert (again.frame_count, again.rate_hz) == (11, 10)
    np.testing.assert_allclose(again.pose.rotations, motion.pose.rotations[::3], atol=1e-8)


@pytest.mark.parametrize("rate", [23.976, 24000 / 1001, 29.97, 30.0, 47.3, 120.0, 0.5, 1000.0])
def test_rates_come_back(tmp_path: Path, rate: float) -> None:
    scene = random_scene(np.random.default_rng(1), 3, 4)
    scene = replace(scene, animations=(replace(scene.animations[0], rate_hz=rate),))
    assert saved(scene, tmp_path).animations[0].rate_hz == pytest.approx(rate, rel=1e-10)


def test_scales_become_lengths(tmp_path: Path) -> None:
    scene = random_scene(np.random.default_rng(6), 10, 5)
    motion = scene.animations[0]
    scales = np.repeat(np.random.default_rng(0).uniform(0.5, 2, (5, 10, 1)), 3, axis=-1)
    scaled = replace(scene, animations=(motion.with_pose(replace(motion.pose, scales=scales)),))
    notes = keypose.io.save(scaled, tmp_path / "a.bvh")
    assert any("no scale" in note for note in notes)
    again = keypose.io.load(tmp_path / "a.bvh", unit="cm", up="Y", root_positions="replace")
    # joints stay where they are; matrices differ by the scale, so compare positions
    wanted, found = world_of(scaled)[..., :3, 3], world_of(aligned(again, scaled))[..., :3, 3]
    assert np.abs(wanted - found).max() * 1e3 < MM


def test_what_bvh_cannot_hold_is_said(tmp_path: Path) -> None:
    from keypose.model import Mesh

    scene = random_scene(np.random.default_rng(7), 4, 3)
    mesh = Mesh(np.zeros((3, 3)), np.array([[0, 1, 2]]))
    first = replace(
        scene.character, parts=(Part("body", mesh, joint=0),), morph_names=("smile",), rest_morph_weights=None
    )
    late = replace(scene.animations[0], start_s=1.5)
    both = Scene((first, scene.character), (late, replace(late, name="other")))
    notes = " | ".join(keypose.io.save(both, tmp_path / "a.bvh"))
    for word in ("character 'c'", "mesh", "'other'", "1.5 s", "morph"):
        assert word in notes
    notes = " | ".join(keypose.io.save(both, tmp_path / "a.bvh", animation="other"))
    assert "'dance'" in notes and "'other'" not in notes
    with pytest.raises(UnknownName, match="nearest: 'dance'"):
        keypose.io.save(both, tmp_path / "a.bvh", animation="dancing")


def test_several_roots_of_other_origin_get_a_common_one(tmp_path: Path) -> None:
    scene = random_scene(np.random.default_rng(8), 8, 4, roots=3)
    notes = keypose.io.save(scene, tmp_path / "a.bvh")
    assert any("3 roots" in note for note in notes)
    again = keypose.io.load(tmp_path / "a.bvh", unit="cm", up="Y")
    assert again.character.skeleton.names[0] == "Root" and np.count_nonzero(again.character.skeleton.parents < 0) == 1
    places = [again.character.skeleton.index(name) for name in scene.character.skeleton.names]
    assert np.abs(world_of(again)[:, places][..., :3, 3] - world_of(scene)[..., :3, 3]).max() * 1e3 < MM


def test_names_and_end_sites(tmp_path: Path) -> None:
    skeleton = still(["Left Arm", "a{b}\n", "tip"], [-1, 0, 1], [[0, 1, 0]] * 3)
    notes = keypose.io.save(skeleton, tmp_path / "a.bvh")
    again = keypose.io.load(tmp_path / "a.bvh")
    assert again.character.skeleton.names == ("Left Arm", "a_b__", "tip") and any("a_b__" in note for note in notes)
    assert again.character.skeleton.end_offsets == ((2, (0.0, 0.0, 0.0)),)
    twice = keypose.io.load(written(tmp_path, SMALL.replace("Spine", "Hips")))
    keypose.io.save(twice, tmp_path / "a.bvh")
    assert (tmp_path / "a.bvh").read_text().count(" Hips\n") == 2


def test_extras_that_went_through_other_hands_do_no_harm(tmp_path: Path) -> None:
    scene = keypose.io.load(written(tmp_path, SMALL))
    wanted = world_of(scene)
    wrong: list[object] = [
        None,
        5,
        "text",
        {"unit_m": -1, "up": "W", "channels": 3},
        {"channels": {"Hips": "Xpos Xpos"}},
    ]
    wrong += [
        {"channels": {"Hips": 7, "Leg": "Xrotation Xrotation"}, "frame_time": "soon", "rate_hz": "x", "added_roots": 4}
    ]
    for extras in wrong:
        changed = replace(scene, characters=(replace(scene.character, extras={"bvh": extras}),))
        keypose.io.save(changed, tmp_path / "a.bvh")
        assert np.abs(world_of(keypose.io.load(tmp_path / "a.bvh", unit="cm", up="Y")) - wanted).max() < 1e-6


def test_wrong_options_and_places(tmp_path: Path) -> None:
    scene = keypose.io.load(written(tmp_path, SMALL))
    for options, error in (
        ({"order": "zyx"}, UnknownName),
        ({"order": "ZYZ"}, UnknownName),
        ({"decimals": 30}, ShapeError),
    ):
        with pytest.raises(error):
            keypose.io.save(scene, tmp_path / "a.bvh", **options)
    with pytest.raises(FormatError, match="does not exist"):
        keypose.io.save(scene, tmp_path / "no" / "a.bvh")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["take.bvh"]


def test_long_chains_are_exact_and_do_not_explode(tmp_path: Path) -> None:
    rng = np.random.default_rng(9)
    count = 60
    skeleton = still([f"j{k}" for k in range(count)], list(range(-1, count - 1)), [[0, 0.1, 0]] * count)
    turns = quat.exp(rng.normal(size=(20, count, 3)) * 0.1)
    pose = Pose(np.repeat(skeleton.rest.translations[None], 20, axis=0), turns, np.ones((count, 3)))
    scene = Scene((Character(skeleton),), (Motion(skeleton.names, pose, 25.0),))
    keypose.io.save(scene, tmp_path / "a.bvh")
    moved, turned = differences(scene, keypose.io.load(tmp_path / "a.bvh", unit="cm", up="Y"))
    assert moved < MM and turned < DEG
    deep = still([f"j{k}" for k in range(20_000)], list(range(-1, 19_999)), [[0, 0.1, 0]] * 20_000)
    keypose.io.save(deep, tmp_path / "deep.bvh")
    assert (tmp_path / "deep.bvh").stat().st_size < 20_000_000
