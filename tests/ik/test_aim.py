"""Joints and chains that look at something: exact, upright, within limits, and without jumps where none is needed."""

from __future__ import annotations

import numpy as np
import pytest

from keypose.errors import ShapeError, UnknownName
from keypose.evaluate import world_rotations_positions
from keypose.ik import aim_chain, aim_joint
from keypose.math import quat
from keypose.model import Pose, Skeleton

rotation = pytest.importorskip("scipy.spatial.transform").Rotation

FORWARD, UP, NONE = np.array([0, 0, 1.0]), np.array([0, 1.0, 0]), np.array([1.0, 0, 0, 0])


def unit(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def to_scipy(q: np.ndarray) -> rotation:
    return rotation.from_quat(np.roll(np.asarray(q, np.float64), -1, axis=-1))


def angle(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    a, b = unit(a), unit(b)
    return 2 * np.arctan2(np.linalg.norm(a - b, axis=-1), np.linalg.norm(a + b, axis=-1))


def joints(count: int = 300, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return unit(rng.normal(size=(count, 4))), rng.normal(size=(count, 3)), rng.normal(size=(count, 3)) * 3


# --- one joint --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("dtype", "tolerance"), [(np.float64, 1e-14), (np.float32, 2e-6)])
def test_the_axis_points_at_the_target_and_nothing_rolls(dtype: type, tolerance: float) -> None:
    q, place, target = (a.astype(dtype) for a in joints())
    axis = unit(np.random.default_rng(1).normal(size=(300, 3))).astype(dtype)
    result = aim_joint(q, place, target, axis=axis)
    assert result.rotation.dtype == result.error_rad.dtype == dtype
    assert angle(to_scipy(result.rotation).apply(axis), target - place).max() < tolerance
    # The turn is the shortest: its axis is across both directions.
    turn = (to_scipy(result.rotation) * to_scipy(q).inv()).as_rotvec()
    assert np.abs(np.sum(turn * to_scipy(q).apply(axis), 1)).max() < 10 * tolerance


@pytest.mark.parametrize("by_place", [False, True])
def test_up_agrees_with_scipy(by_place: bool) -> None:
    q, place, target = joints()
    rng = np.random.default_rng(2)
    axis, up_axis, up = unit(rng.normal(size=3)), unit(rng.normal(size=3)), rng.normal(size=(300, 3))
    where = {"up_at": place + up} if by_place else {"up": up}
    got = aim_joint(q, place, target, axis=axis, up_axis=up_axis, up_fade_rad=0.0, **where)
    for n in range(300):
        wanted, _ = rotation.align_vectors([target[n] - place[n], up[n]], [axis, up_axis], weights=[np.inf, 1])
        assert (to_scipy(got.rotation[n]) * wanted.inv()).magnitude() < 1e-7
    # Faded, it is the same wherever the target is not near the vertical.
    faded = aim_joint(q, place, target, axis=axis, up_axis=up_axis, **where)
    way = angle(target - place, up)
    level = np.minimum(way, np.pi - way) > np.pi / 18
    assert level.sum() > 250
    assert np.allclose(quat.angle_between(faded.rotation, got.rotation)[level], 0, atol=1e-7)
    assert faded.error_rad.max() < 1e-14


@pytest.mark.parametrize("softness", [0.0, 0.3])
def test_limits_are_kept_and_softness_only_adds_to_them(softness: float) -> None:
    q, place, target = joints(2000)
    result = aim_joint(q, place, target, limit_rad=1.0, softness_rad=softness, up=UP)
    before, after = (to_scipy(r).apply(FORWARD) for r in (q, result.rotation))
    whole, swung, left = angle(before, target - place), angle(before, after), angle(after, target - place)
    assert swung.max() <= 1.0 + 1e-12
    free = whole < 1.0 - softness
    assert left[free].max() < 1e-14
    assert np.allclose(swung + left, whole, atol=1e-12)  # on the way there
    assert np.allclose(result.error_rad, left, atol=1e-14)
    order = np.argsort(whole)
    assert np.all(np.diff(swung[order]) > -1e-12)


def swept(way: np.ndarray, **options: object) -> np.ndarray:
    """Rotations of a joint that looks along +Z when its target moves along directions (N, 3)."""
    return aim_joint(NONE, np.zeros(3), way, **options).rotation  # pyright: ignore[reportArgumentType]


def speeds(q: np.ndarray, step: float) -> np.ndarray:
    return np.asarray(quat.angle_between(q[1:], q[:-1])) / step


def over_the_top(aside: float, samples: int = 20001) -> tuple[np.ndarray, float]:
    """A target from before the face over the top to behind, passing the zenith at a distance."""
    turn = np.linspace(0, np.pi, samples)
    return np.stack([np.full(samples, aside), np.sin(turn), np.cos(turn)], -1), np.pi / (samples - 1)


def test_overhead_there_is_no_flip() -> None:
    for aside in (0.3, 0.1, 0.02, -0.02, 1e-3):
        way, step = over_the_top(aside)
        assert speeds(swept(way, up=UP), step).max() < 30  # by 10 degrees of a target's way half a turn is done
    sharp = swept(over_the_top(1e-3)[0], up=UP, up_fade_rad=0.0)
    assert speeds(sharp, over_the_top(1e-3)[1]).max() > 500
    straight, step = over_the_top(0.0)
    ahead = straight[:, 2] >= 0
    assert speeds(swept(straight[ahead], up=UP), step).max() < 1 + 1e-6
    # With a limit that a neck has, nothing jumps on the whole way but where the target is straight behind.
    far = np.arccos(straight[:, 2]) < np.pi - 0.05
    assert speeds(swept(straight[far], up=UP, limit_rad=1.2), step).max() < 2


def test_behind_release_lets_go_without_a_jump() -> None:
    turn = np.linspace(0, 2 * np.pi, 20001)
    way = np.stack([np.sin(turn), 0 * turn, np.cos(turn)], -1)
    step = 2 * np.pi / 20000
    assert speeds(swept(way, limit_rad=1.2), step).max() > 1000
    free = swept(way, limit_rad=1.2, release_rad=0.8, up=UP)
    assert speeds(free, step).max() < 3
    assert np.allclose(np.abs(free[10000, 0]), 1, atol=1e-6)
    kept = aim_joint(NONE, np.zeros(3), way, release_rad=0.8).error_rad
    assert kept[np.abs(turn - np.pi) > 0.81].max() < 1e-14


@pytest.mark.parametrize("up", [None, UP, np.zeros(3), FORWARD])
def test_singular_targets_are_defined(up: np.ndarray | None) -> None:
    ways = np.array([[0, 0, 0], [0, 0, 1], [0, 0, -1], [0, 1, 0], [0, -1, 0], [0, 0, 1e-200], [0, 1e-9, -1]])
    result = aim_joint(NONE, np.zeros(3), ways, up=up)
    assert np.all(np.isfinite(result.rotation))
    assert np.allclose(np.linalg.norm(result.rotation, axis=1), 1)
    seen = np.any(ways != 0, axis=1) & (np.abs(ways).max(axis=1) > 1e-100)
    assert angle(to_scipy(result.rotation[seen]).apply(FORWARD), ways[seen]).max() < 1e-8
    assert result.error_rad[seen].max() < 1e-8


def test_weight_is_a_share_of_the_turn() -> None:
    q, place, target = joints()
    assert np.allclose(aim_joint(q, place, target, up=UP, weight=0.0).rotation, q, atol=1e-15)
    whole = aim_joint(q, place, target).rotation
    for weight in (0.25, 0.7):
        part = aim_joint(q, place, target, weight=weight).rotation
        assert np.allclose(quat.angle_between(q, part), weight * quat.angle_between(q, whole), atol=1e-7)
    each = aim_joint(q, place, target, weight=np.linspace(0, 1, 300))
    assert np.allclose(quat.angle_between(each.rotation[-1], whole[-1]), 0, atol=1e-7)
    assert np.allclose(each.rotation[0], q[0])


def test_mirrored_targets_give_mirrored_rotations() -> None:
    _, _, target = joints()
    a = aim_joint(NONE, np.zeros(3), target, up=UP, limit_rad=1.0).rotation
    b = aim_joint(NONE, np.zeros(3), target * [-1, 1, 1], up=UP, limit_rad=1.0).rotation
    assert np.allclose(quat.angle_between(a, b * [1, 1, -1, -1]), 0, atol=1e-7)


def test_torch_gives_the_same() -> None:
    torch = pytest.importorskip("torch")
    q, place, target = joints(20)
    ours = aim_joint(q, place, target, up=UP, limit_rad=1.0, softness_rad=0.2)
    theirs = aim_joint(
        *(torch.tensor(a) for a in (q, place, target)), up=torch.tensor(UP), limit_rad=1.0, softness_rad=0.2
    )
    assert np.allclose(theirs.rotation.numpy(), ours.rotation, atol=1e-12)


# --- chains -----------------------------------------------------------------------------------------------------------------

NAMES = ("hips", "spine", "chest", "collar", "neck", "head", "left_eye", "right_eye", "foot")
PARENTS = np.array([-1, 0, 1, 2, 3, 4, 5, 5, 0])
PLACES = np.array(
    [[0, 1, 0], [0, 0.1, 0], [0, 0.2, 0.01], [0, 0.1, 0], [0, 0.1, 0], [0, 0.1, 0.02], [0.03, 0.06, 0.08],
     [-0.03, 0.06, 0.08], [0, -1, 0]]
)  # fmt: skip
LOOKING = ("spine", "chest", "neck", "head")
EYES = ("left_eye", "right_eye")


def figure() -> Skeleton:
    return Skeleton(NAMES, PARENTS, Pose(PLACES, np.tile(NONE, (9, 1)), np.ones((9, 3))))


def posed(count: int = 100, seed: int = 0, size: float = 0.2) -> Pose:
    rng = np.random.default_rng(seed)
    turns = np.asarray(quat.from_rotation_vector(rng.normal(0, size, (count, 9, 3))))
    return Pose(np.broadcast_to(PLACES, (count, 9, 3)), turns, np.ones((count, 9, 3)))


def looks(pose: Pose, joint: str) -> tuple[np.ndarray, np.ndarray]:
    turned, places = world_rotations_positions(figure(), pose)
    n = NAMES.index(joint)
    return places[..., n, :], to_scipy(turned[..., n, :].reshape(-1, 4)).apply(FORWARD).reshape(places[..., n, :].shape)


def targets(count: int = 100, seed: int = 1) -> np.ndarray:
    """Before the figure, near and far."""
    rng = np.random.default_rng(seed)
    way = unit(rng.normal(size=(count, 3)) * [1, 0.5, 0.3] + [0, 0, 0.8])
    return np.array([0, 1.6, 0]) + way * rng.uniform(0.5, 10, (count, 1))


def test_the_last_joint_looks_at_the_target() -> None:
    goal, start = targets(), posed()
    result = aim_chain(figure(), start, LOOKING, goal, shares=(0.1, 0.2, 0.3, 0.4))
    place, way = looks(result.pose, "head")
    assert angle(way, goal - place).max() < 1e-9
    assert result.error_rad.shape == (100, 1)
    assert result.error_rad.max() < 1e-9
    untouched = [n for n, name in enumerate(NAMES) if name not in LOOKING]
    assert np.array_equal(result.pose.rotations[:, untouched], start.rotations[:, untouched])


def test_far_targets_are_shared_out_as_asked() -> None:
    shares = np.array([0.1, 0.2, 0.3, 0.4])
    for yaw in (0.2, 1.0, -2.0):
        goal = 1e7 * np.array([np.sin(yaw), 0, np.cos(yaw)])
        result = aim_chain(figure(), figure().rest, LOOKING, goal, shares=shares)
        turned = quat.to_rotation_vector(result.pose.rotations)[[1, 2, 4, 5]]
        assert np.allclose(turned, np.outer(shares * yaw, UP), atol=1e-6)


def test_limited_joints_leave_their_part_to_the_others() -> None:
    yaw = 1.5
    goal = 1e7 * np.array([np.sin(yaw), 0, np.cos(yaw)])
    limits = (0.1, 0.6, 0.25, 0.8)
    result = aim_chain(figure(), figure().rest, LOOKING, goal, limits_rad=limits)
    turned = quat.to_rotation_vector(result.pose.rotations)[[1, 2, 4, 5]] @ UP
    assert np.allclose(turned, [0.1, 0.575, 0.25, 0.575], atol=1e-6)  # the two that may share the rest
    assert result.error_rad.max() < 1e-9
    goal = 1e7 * np.array([np.sin(2.5), 0, np.cos(2.5)])
    most = aim_chain(figure(), figure().rest, LOOKING, goal, limits_rad=limits)
    assert np.allclose(quat.to_rotation_vector(most.pose.rotations)[[1, 2, 4, 5]] @ UP, limits, atol=1e-6)
    assert np.allclose(most.error_rad, 2.5 - sum(limits), atol=1e-6)


def test_limits_are_kept_for_any_target_and_reached_where_they_suffice() -> None:
    rng = np.random.default_rng(4)
    goal = np.array([0, 1.6, 0]) + 2 * unit(rng.normal(size=(500, 3)))
    start, limits = posed(500), (0.1, 0.3, 0.4, 0.7)
    result = aim_chain(figure(), start, LOOKING, goal, limits_rad=limits)
    for name, limit in zip(LOOKING, limits, strict=True):
        n = NAMES.index(name)
        assert quat.angle_between(result.pose.rotations[:, n], start.rotations[:, n]).max() < limit + 1e-7
    place, way = looks(start, "head")
    whole = angle(way, goal - place)
    assert result.error_rad[whole < 0.9 * sum(limits)].max() < 1e-9
    assert (whole < 0.9 * sum(limits)).sum() > 100
    place, way = looks(result.pose, "head")
    assert np.allclose(result.error_rad[:, 0], angle(way, goal - place), atol=1e-9)


def test_eyes_converge_on_a_near_target() -> None:
    goal = np.concatenate([targets(), np.array([[0, 1.75, 0.4], [0.05, 1.7, 0.35]])])
    start = posed(102, size=0.1)
    result = aim_chain(figure(), start, LOOKING, goal, ends=EYES, shares=(0.1, 0.1, 0.2, 0.3, 0.3))
    assert result.error_rad.shape == (102, 2)
    for eye in EYES:
        place, way = looks(result.pose, eye)
        assert angle(way, goal - place).max() < 1e-9
    # The sight lines cross as the triangle of the eyes and the target says.
    (left, a), (right, b) = looks(result.pose, EYES[0]), looks(result.pose, EYES[1])
    assert np.allclose(angle(a, b), angle(goal - left, goal - right), atol=1e-9)
    assert angle(a, b)[-2:].min() > 0.1
    head, before = result.pose.rotations[:, 5], start.rotations[:, 5]
    assert quat.angle_between(head, before).max() > 0.1


def test_eyes_at_their_limit_let_the_head_do_more() -> None:
    goal = np.array([3.0, 1.7, 2.0])
    free = aim_chain(figure(), figure().rest, ("head",), goal, ends=EYES, shares=(0.2, 0.8))
    held = aim_chain(figure(), figure().rest, ("head",), goal, ends=EYES, shares=(0.2, 0.8), limits_rad=(np.pi, 0.3))
    for result in (free, held):
        assert result.error_rad.max() < 1e-9
    eyes = [np.asarray(quat.angle_between(r.pose.rotations[6:8], NONE)).max() for r in (free, held)]
    heads = [float(quat.angle_between(r.pose.rotations[5], NONE)) for r in (free, held)]
    assert eyes[0] > 0.5
    assert eyes[1] <= 0.3 + 1e-9
    assert heads[1] > heads[0] + 0.3


def test_weight_and_softness_leave_a_part() -> None:
    goal, start = targets(), posed()
    place, way = looks(start, "head")
    whole = angle(way, goal - place)
    for weight in (0.0, 0.3, np.linspace(0, 1, 100)):
        result = aim_chain(figure(), start, LOOKING, goal, weight=weight)
        assert np.allclose(result.error_rad[:, 0], (1 - np.asarray(weight)) * whole, atol=1e-9)
    none = aim_chain(figure(), start, LOOKING, goal, weight=0.0)
    assert np.allclose(none.pose.rotations, start.rotations, atol=1e-12)
    soft = aim_chain(figure(), start, LOOKING, goal, limits_rad=(0.1, 0.2, 0.2, 0.3), softness_rad=0.3)
    hard = aim_chain(figure(), start, LOOKING, goal, limits_rad=(0.1, 0.2, 0.2, 0.3))
    assert np.all(soft.error_rad >= hard.error_rad - 1e-9)
    assert soft.error_rad[whole < 0.5].max() < 1e-9


def test_up_keeps_the_head_level() -> None:
    goal, start = targets(), posed()
    result = aim_chain(figure(), start, LOOKING, goal, up=UP)
    turned, _ = world_rotations_positions(figure(), result.pose)
    side = to_scipy(turned[:, 5]).apply([1.0, 0, 0])
    assert np.abs(side[:, 1]).max() < 1e-9
    assert result.error_rad.max() < 1e-9
    free = aim_chain(figure(), start, LOOKING, goal)
    tilted, _ = world_rotations_positions(figure(), free.pose)
    assert np.abs(to_scipy(tilted[:, 5]).apply([1.0, 0, 0])[:, 1]).max() > 0.1


def test_batches_and_precision() -> None:
    start = posed(6)
    goal = targets(6).reshape(2, 3, 3)
    pose = Pose(
        *(
            np.asarray(a).reshape(2, 3, *a.shape[1:]).astype(np.float32)
            for a in (start.translations, start.rotations, start.scales)
        )
    )
    result = aim_chain(figure(), pose, LOOKING, goal, ends=EYES)
    assert result.pose.rotations.shape == (2, 3, 9, 4)
    assert result.pose.rotations.dtype == np.float32
    one = aim_chain(
        figure(), Pose(start.translations[4], start.rotations[4], start.scales[4]), LOOKING, goal[1, 1], ends=EYES
    )
    assert np.allclose(result.pose.rotations[1, 1], one.pose.rotations, atol=1e-5)
    many = aim_chain(figure(), figure().rest, LOOKING, goal)
    assert many.pose.rotations.shape == (2, 3, 9, 4)


def test_wrong_input_is_named() -> None:
    q, place, target = joints(3)
    body, rest, goal = figure(), figure().rest, np.ones(3)
    with pytest.raises(ShapeError, match="up, up_at"):
        aim_joint(q, place, target, up=UP, up_at=UP)
    with pytest.raises(ShapeError, match="target: expected"):
        aim_joint(q, place, np.zeros(2))
    with pytest.raises(ShapeError, match="limit_rad"):
        aim_joint(q, place, target, limit_rad=4.0)
    with pytest.raises(ShapeError, match="softness_rad"):
        aim_joint(q, place, target, limit_rad=1.0, softness_rad=2.0)
    with pytest.raises(ShapeError, match="release_rad"):
        aim_joint(q, place, target, release_rad=-1.0)
    with pytest.raises(ShapeError, match="up_fade_rad"):
        aim_joint(q, place, target, up_fade_rad=2.0)
    with pytest.raises(ShapeError, match="'spine' does not hang below 'head'"):
        aim_chain(body, rest, ("head", "spine"), goal)
    with pytest.raises(ShapeError, match="'foot' does not hang below 'head'"):
        aim_chain(body, rest, ("head",), goal, ends=("foot",))
    with pytest.raises(UnknownName, match="neckk"):
        aim_chain(body, rest, ("neckk",), goal)
    with pytest.raises(ShapeError, match="at least one"):
        aim_chain(body, rest, (), goal)
    with pytest.raises(ShapeError, match="shares: expected"):
        aim_chain(body, rest, LOOKING, goal, shares=(1.0, 1.0))
    with pytest.raises(ShapeError, match="the last above it"):
        aim_chain(body, rest, ("neck", "head"), goal, shares=(1.0, 0.0))
    with pytest.raises(ShapeError, match="limits_rad"):
        aim_chain(body, rest, ("neck", "head"), goal, limits_rad=(1.0, 7.0))
    with pytest.raises(ShapeError, match="axis: expected"):
        aim_chain(body, rest, ("neck", "head"), goal, axis=(0.0, 0.0, 0.0))
