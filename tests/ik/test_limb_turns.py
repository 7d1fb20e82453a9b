"""Limbs of whole poses, one by one and in crowds: reach, plane, hinge, weight, and the kernel beside NumPy."""

from __future__ import annotations

import numpy as np
import pytest

from keypose.errors import ShapeError
from keypose.ik import LimbTurns, solve_limb, solve_limbs
from keypose.math import quat

rotation = pytest.importorskip("scipy.spatial.transform").Rotation

PRECISIONS = [(np.float64, 2e-14), (np.float32, 6e-6)]


def limbs(count: int = 500, dtype: type = np.float64, seed: int = 0) -> dict[str, np.ndarray]:
    """Limbs of all kinds that reach their targets."""
    rng = np.random.default_rng(seed)
    start = rng.normal(size=(count, 3))
    middle = start + rng.normal(size=(count, 3)) * 0.3
    end = middle + rng.normal(size=(count, 3)) * 0.3
    upper, lower = np.linalg.norm(middle - start, axis=1), np.linalg.norm(end - middle, axis=1)
    way = rng.normal(size=(count, 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    distance = np.abs(upper - lower) + (upper + lower - np.abs(upper - lower)) * rng.uniform(0.02, 0.98, count)
    points = {"start": start, "middle": middle, "end": end, "target": start + way * distance[:, None]}
    return {name: p.astype(dtype) for name, p in {**points, "pole": rng.normal(size=(count, 3))}.items()}


def turned(points: dict[str, np.ndarray], turns: LimbTurns) -> tuple[np.ndarray, np.ndarray]:
    """Where middle and end are afterwards, by SciPy."""

    def by(q: np.ndarray, v: np.ndarray) -> np.ndarray:
        return rotation.from_quat(np.roll(np.asarray(q, np.float64), -1, axis=-1)).apply(v)

    stretch = np.asarray(turns.stretch)[:, None]
    upper, lower = points["middle"] - points["start"], points["end"] - points["middle"]
    middle = points["start"] + stretch * by(turns.start, upper)
    return middle, middle + stretch * by(turns.start, by(turns.middle, lower))


def unit(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def slow(points: dict[str, np.ndarray], monkeypatch: pytest.MonkeyPatch, **options: object) -> LimbTurns:
    """The same by NumPy, whatever the size."""
    with monkeypatch.context() as patch:
        patch.setattr("keypose.ik.limb.kernels_for", lambda *_: None)
        return solve_limbs(**points, **options)


@pytest.fixture(autouse=True)
def kernels() -> None:
    """Loaded kernels are used from a few dozen limbs on."""
    import keypose.kernels.limbs  # noqa: F401


@pytest.mark.parametrize("count", [20, 500])  # NumPy, kernel
@pytest.mark.parametrize(("dtype", "tolerance"), PRECISIONS)
def test_turns_reach_the_target_in_the_plane_of_the_pole(dtype: type, tolerance: float, count: int) -> None:
    points = limbs(count, dtype)
    turns = solve_limbs(**points)
    assert turns.start.dtype == turns.middle.dtype == turns.error_m.dtype == dtype
    middle, end = turned(points, turns)
    assert np.abs(end - points["target"]).max() < tolerance
    assert np.abs(turns.error_m).max() < tolerance
    along = unit(points["target"].astype(np.float64) - points["start"])
    pole = points["pole"].astype(np.float64)
    side = unit(pole - along * np.sum(pole * along, 1, keepdims=True))
    bend = middle - points["start"]
    assert np.abs(np.sum(np.cross(along, side) * bend, 1)).max() < tolerance
    assert np.all(np.sum(side * bend, 1) > 0)
    for q in (turns.start, turns.middle):
        assert np.allclose(np.linalg.norm(q, axis=1), 1, atol=tolerance)


@pytest.mark.parametrize("softness", [0.0, 0.2])
@pytest.mark.parametrize("stretch", [1.0, 1.3])
def test_turns_go_where_solve_limb_says(softness: float, stretch: float) -> None:
    points = limbs(400)
    points["target"] = points["start"] + 1.6 * (points["target"] - points["start"])  # some out of reach
    turns = solve_limbs(**points, softness=softness, max_stretch=stretch)
    upper, lower = (np.linalg.norm(points[b] - points[a], axis=1) for a, b in (("start", "middle"), ("middle", "end")))
    places = solve_limb(
        points["start"], points["target"], points["pole"],
        upper_m=upper, lower_m=lower, softness_m=softness * (upper + lower), max_stretch=stretch,
    )  # fmt: skip
    middle, end = turned(points, turns)
    assert np.abs(end - places.end).max() < 1e-13
    assert np.abs(middle - places.middle).max() < 1e-7  # a straight limb's bend is the root of rounding
    assert np.abs(turns.stretch - places.stretch).max() < 1e-13
    assert np.abs(turns.error_m - places.error_m).max() < 1e-13


@pytest.mark.parametrize("hinged", [False, True])
@pytest.mark.parametrize(
    "options", [{}, {"softness": 0.1}, {"softness": 0.1, "max_stretch": 1.25}, {"max_stretch": 1.25}]
)
@pytest.mark.parametrize(("dtype", "tolerance"), PRECISIONS)
def test_kernel_and_numpy_agree(
    dtype: type, tolerance: float, options: dict[str, float], hinged: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    points = limbs(1003, dtype, seed=3)
    points["target"][:300] = points["start"][:300] + 2 * (points["target"][:300] - points["start"][:300])
    if hinged:
        rng = np.random.default_rng(1)
        normal = np.cross(points["middle"] - points["start"], points["end"] - points["middle"])
        points["hinge"] = (unit(normal) * np.sign(rng.normal(size=(1003, 1))) + rng.normal(0, 0.1, (1003, 3))).astype(
            dtype
        )
    weight = np.random.default_rng(2).uniform(0, 1, 1003)
    weight[:500] = 1
    mine, other = solve_limbs(**points, weight=weight, **options), slow(points, monkeypatch, weight=weight, **options)
    for name in ("stretch", "error_m"):
        assert np.abs(getattr(mine, name) - getattr(other, name)).max() < tolerance
    # Turns are worse known where the limb is nearly straight or folded, before or after; not so where its end goes.
    for a, b in ((mine.start, other.start), (mine.middle, other.middle)):
        off = quat.angle_between(a.astype(np.float64), b.astype(np.float64))
        assert np.percentile(off, 90) < 2 * tolerance
        assert off.max() < 3000 * tolerance
    (_, end), (_, same) = turned(points, mine), turned(points, other)
    assert np.abs(end - same)[:500].max() < 10 * tolerance


def singular(dtype: type) -> dict[str, np.ndarray]:
    """Straight, folded, target on the start joint, pole along the limb, no pole, and all of that at once."""
    down = np.array([0, -1.0, 0])
    cases = [
        # middle, end, target, pole
        (0.4 * down, 0.8 * down, [0.1, -0.5, 0.2], [0, 0, 1]),
        (0.4 * down, 0.8 * down, 0.8 * down, [0, 0, 1]),
        (0.4 * down, 0.8 * down, 2 * down, [0, 0, 1]),
        (0.4 * down, 0.8 * down, -0.5 * down, [0, 1, 0]),
        (0.4 * down, 0 * down, [0.1, -0.5, 0.2], [0, 0, 1]),
        (0.4 * down, 0 * down, [0, 0, 0], [0, 0, 1]),
        (0.4 * down, 0.1 * down, [0.1, 0, 0], [1, 0, 0]),
        ([0.1, -0.4, 0], [0, -0.8, 0.1], [0, 0, 0], [0, 0, 1]),
        ([0.1, -0.4, 0], [0, -0.8, 0.1], [0, 0, 0], [0, 0, 0]),
        ([0.1, -0.4, 0], [0, -0.8, 0.1], [0, -0.5, 0], [0, 3, 0]),
        ([0.1, -0.4, 0], [0, -0.8, 0.1], [0, -0.5, 0], [0, 0, 0]),
        ([0.1, -0.4, 0], [0, -0.8, 0.1], [0, 0.8, -0.1], [0, 0, 1]),
    ]
    start = np.zeros((len(cases), 3))
    middle, end, target, pole = (np.array([c[k] for c in cases], np.float64) for k in range(4))
    points = {"start": start, "middle": middle, "end": end, "target": target, "pole": pole}
    return {name: np.tile(p, (9, 1)).astype(dtype) for name, p in points.items()}


@pytest.mark.parametrize("compiled", [False, True])
@pytest.mark.parametrize("hinged", [False, True])
@pytest.mark.parametrize(("dtype", "tolerance"), PRECISIONS)
def test_singular_limbs_reach_what_they_can(
    dtype: type, tolerance: float, hinged: bool, compiled: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    points = singular(dtype)
    if hinged:
        points["hinge"] = np.cross(points["middle"] - points["start"], [0, 0, 0.7]).astype(dtype)
        points["hinge"][11] = 0
    turns = solve_limbs(**points) if compiled else slow(points, monkeypatch)
    assert all(np.all(np.isfinite(getattr(turns, name))) for name in ("start", "middle", "stretch", "error_m"))
    _, end = turned(points, turns)
    if not hinged:
        distance = np.linalg.norm(end - points["target"], axis=1)
        assert np.abs(distance - turns.error_m).max() < 30 * tolerance
        upper, lower = (
            np.linalg.norm(points[b] - points[a], axis=1) for a, b in (("start", "middle"), ("middle", "end"))
        )
        wanted = np.linalg.norm(points["target"] - points["start"], axis=1)
        least = np.maximum(wanted - upper - lower, np.abs(upper - lower) - wanted)
        assert np.abs(turns.error_m - np.maximum(least, 0)).max() < 30 * tolerance
        other = slow(points, monkeypatch)
        middle, same = turned(points, turns)[0], turned(points, other)[0]
        assert np.abs(middle - same).max() < np.sqrt(tolerance)  # a straight limb's bend is the root of rounding


def test_a_limb_with_a_bone_of_no_length_does_not_turn() -> None:
    points = limbs(200)
    points["middle"][:50] = points["start"][:50]
    points["end"][25:75] = points["middle"][25:75]
    for part in (slice(0, 200), slice(20, 30)):  # kernel, NumPy
        turns = solve_limbs(**{name: p[part] for name, p in points.items()})
        lost = np.arange(200)[part] < 75
        assert np.allclose(turns.start[lost], [1, 0, 0, 0])
        assert np.allclose(turns.middle[lost], [1, 0, 0, 0])
        assert not np.any(np.isnan(turns.start))


@pytest.mark.parametrize("count", [30, 300])
def test_weight_goes_from_nothing_to_everything(count: int) -> None:
    points = limbs(count)
    none, half, whole = (solve_limbs(**points, weight=w) for w in (0.0, np.full(count, 0.5), 1.0))
    assert np.allclose(none.start, [1, 0, 0, 0], atol=1e-15)
    assert np.allclose(none.middle, [1, 0, 0, 0], atol=1e-15)
    for a, b in ((half.start, whole.start), (half.middle, whole.middle)):  # nlerp's middle is slerp's
        assert np.allclose(quat.angle_between(quat.multiply(a, a), b), 0, atol=1e-6)


def test_a_limb_on_its_target_stays() -> None:
    points = limbs(300)
    points["target"] = points["end"]
    points["pole"] = points["middle"] - points["start"]
    turns = solve_limbs(**points)
    assert np.allclose(np.abs(turns.start[:, 0]), 1, atol=1e-12)
    assert np.allclose(np.abs(turns.middle[:, 0]), 1, atol=1e-12)


def test_mirrored_limbs_turn_mirrored() -> None:
    points = limbs(300)
    turns = solve_limbs(**points)
    flip = np.array([-1.0, 1, 1])
    other = solve_limbs(**{name: p * flip for name, p in points.items()})
    for a, b in ((turns.start, other.start), (turns.middle, other.middle)):
        assert np.allclose(quat.angle_between(a, b * [1, 1, -1, -1]), 0, atol=1e-6)


def test_a_hinge_turns_about_its_axis_only_and_sets_an_overbent_limb_right() -> None:
    # A knee that bends 5 degrees the wrong way, and knees that are straight, all with the hinge along X.
    bend = np.deg2rad(np.array([-5.0, -1e-4, 0.0, 1e-4, 5.0, 60.0]))
    start, middle = np.zeros((6, 3)), np.tile([0, -0.4, 0.0], (6, 1))
    end = middle + 0.4 * np.stack([0 * bend, -np.cos(bend), -np.sin(bend)], -1)
    hinge = np.array([1.0, 0, 0])
    turns = solve_limbs(start, middle, end, np.array([0, -0.7, 0]), np.array([0, 0, 1.0]), hinge=hinge)
    points = {"start": start, "middle": middle, "end": end}
    knee, ankle = turned(points, turns)
    assert np.allclose(ankle, [0, -0.7, 0], atol=1e-15)
    assert np.allclose(knee, knee[0], atol=1e-12)  # all come to the same pose, whatever rounding says of their planes
    assert knee[0, 2] > 0.1
    assert np.allclose(turns.middle[:, 2:], 0, atol=1e-15)
    # The upper bone turns about the hinge too: nothing twists it.
    assert np.allclose(turns.start[:, 2:], 0, atol=1e-12)
    without = solve_limbs(start, middle, end, np.array([0, -0.7, 0]), np.array([0, 0, 1.0]))
    assert np.abs(without.start[0, 2:]).max() > 0.5  # the wrong way is turned about to the pole, twisting the thigh


@pytest.mark.parametrize("count", [40, 400])
def test_a_skew_hinge_still_reaches(count: int) -> None:
    points = limbs(count, seed=5)
    a, b = points["middle"] - points["start"], points["end"] - points["middle"]
    axis = unit(np.cross(a, b)) + 0.2 * np.random.default_rng(0).normal(size=(count, 3))
    turns = solve_limbs(**points, hinge=axis)
    along = np.abs(np.sum(np.asarray(turns.middle)[:, 1:] * unit(axis), 1))
    assert np.allclose(along, np.linalg.norm(np.asarray(turns.middle)[:, 1:], axis=1), atol=1e-12)
    _, end = turned(points, turns)
    reached = turns.error_m < 1e-9
    assert reached.mean() > 0.9
    assert np.abs(end - points["target"])[reached].max() < 1e-9
    assert np.allclose(np.linalg.norm(end - points["target"], axis=1), turns.error_m, atol=1e-9)
    # The hinge stands across the pole and the limb.
    after = quat.rotate(turns.start, unit(axis))
    line = unit(points["target"] - points["start"])
    side = points["pole"] - line * np.sum(points["pole"] * line, 1, keepdims=True)
    assert np.abs(np.sum(after * unit(side), 1)).max() < 1e-9


def test_batches_broadcast() -> None:
    points = limbs(12)
    target = points["target"].reshape(3, 4, 3)
    start, middle, end, pole = (points[n][:4] for n in ("start", "middle", "end", "pole"))
    for repeat in (1, 40):  # NumPy, kernel
        many = np.tile(target, (repeat, 1, 1))
        turns = solve_limbs(start, middle, end, many, pole)
        assert turns.start.shape == (3 * repeat, 4, 4)
        assert turns.error_m.shape == turns.stretch.shape == (3 * repeat, 4)
        one = solve_limbs(start[2], middle[2], end[2], target[1, 2], pole[2])
        assert one.start.shape == (4,)
        assert np.allclose(turns.start[1, 2], one.start, atol=1e-12)


def test_other_array_libraries_and_their_gradients() -> None:
    torch = pytest.importorskip("torch")
    points = limbs(6)
    ours = solve_limbs(**points, max_stretch=1.1, softness=0.1)
    tensors = {name: torch.tensor(p, requires_grad=name == "target") for name, p in points.items()}
    theirs = solve_limbs(**tensors, max_stretch=1.1, softness=0.1)
    assert np.allclose(theirs.start.detach().numpy(), ours.start, atol=1e-12)
    theirs.start.sum().backward()
    assert torch.all(torch.isfinite(tensors["target"].grad))


def test_lanes_give_what_arrays_give() -> None:
    from keypose.kernels.limbs import turn_lanes
    from keypose.kernels.runtime import WIDTH, aligned

    points = limbs(5 * WIDTH, np.float32)
    rows = np.concatenate([*(p.T for p in points.values()), np.full((1, 5 * WIDTH), 0.7)])
    lanes = aligned(rows.size).reshape(5, 16, WIDTH)
    lanes[:] = rows.reshape(16, 5, WIDTH).transpose(1, 0, 2)
    out = turn_lanes(lanes, 0.1, 1.2).transpose(0, 2, 1).reshape(-1, 10)
    turns = solve_limbs(**points, weight=0.7, softness=0.1, max_stretch=1.2)
    assert np.abs(out[:, :4] - turns.start).max() < 1e-6
    assert np.abs(out[:, 4:8] - turns.middle).max() < 1e-6
    assert np.abs(out[:, 8] - turns.stretch).max() < 1e-6
    assert np.abs(out[:, 9] - turns.error_m).max() < 1e-6
    for wrong in (lanes[:, :15], lanes.astype(np.float64), lanes.transpose(1, 0, 2)):
        with pytest.raises(ShapeError, match="limbs: expected"):
            turn_lanes(wrong)
    with pytest.raises(ShapeError, match="out: expected"):
        turn_lanes(lanes, out=np.zeros((5, 8, WIDTH), np.float32))


def test_wrong_input_is_named() -> None:
    points = limbs(3)
    with pytest.raises(ShapeError, match="pole: expected"):
        solve_limbs(**{**points, "pole": np.zeros(2)})
    with pytest.raises(ShapeError, match="softness"):
        solve_limbs(**points, softness=1.0)
    with pytest.raises(ShapeError, match="max_stretch"):
        solve_limbs(**points, max_stretch=0.9)
    with pytest.raises(ShapeError, match="hinge: expected"):
        solve_limbs(**points, hinge=np.zeros((3, 2)))
