"""Two-bone limbs: lengths, reach, pole, and the places where the textbook formula breaks."""

from __future__ import annotations

import numpy as np
import pytest

from keypose.errors import ShapeError
from keypose.ik import limb_rotations, rotation_between_frames, solve_limb
from keypose.math import quat

UPPER, LOWER = 0.45, 0.4


def _random(seed: int = 0, count: int = 500, dtype: type = np.float64):
    rng = np.random.default_rng(seed)
    start = rng.normal(size=(count, 3))
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    distance = rng.uniform(0.06, 0.84, (count, 1))
    return start.astype(dtype), (start + direction * distance).astype(dtype), rng.normal(size=(count, 3)).astype(dtype)


@pytest.mark.parametrize(("dtype", "tolerance"), [(np.float64, 1e-12), (np.float32, 2e-6)])
def test_reaches_targets_keeps_lengths_and_precision(dtype: type, tolerance: float) -> None:
    start, target, pole = _random(dtype=dtype)
    result = solve_limb(start, target, pole, upper_m=UPPER, lower_m=LOWER)
    assert result.middle.dtype == result.error_m.dtype == dtype
    assert np.max(result.error_m) < tolerance
    assert np.allclose(np.linalg.norm(result.middle - start, axis=1), UPPER, atol=tolerance)
    assert np.allclose(np.linalg.norm(result.end - result.middle, axis=1), LOWER, atol=tolerance * 10)


def test_bends_towards_the_pole() -> None:
    start, target, pole = _random(1)
    result = solve_limb(start, target, pole, upper_m=UPPER, lower_m=LOWER)
    along = (target - start) / np.linalg.norm(target - start, axis=1, keepdims=True)
    across = pole - np.sum(pole * along, axis=1, keepdims=True) * along
    bend = result.middle - start
    bend = bend - np.sum(bend * along, axis=1, keepdims=True) * along
    cosine = np.sum(bend * across, axis=1) / np.linalg.norm(bend, axis=1) / np.linalg.norm(across, axis=1)
    assert np.allclose(cosine, 1, atol=1e-9)
    assert np.allclose(np.sum(result.normal * along, axis=1), 0, atol=1e-12)


def test_out_of_reach_stretches_straight_and_says_by_how_much() -> None:
    result = solve_limb(np.zeros(3), np.array([0.0, -2.0, 0.0]), np.array([0, 0, 1.0]), upper_m=UPPER, lower_m=LOWER)
    assert np.allclose(result.end, [0, -0.85, 0])
    assert np.isclose(result.error_m, 2 - 0.85)


@pytest.mark.parametrize(
    ("target", "pole"),
    [
        ([0, 0, 0], [0, 0, 1]),
        ([0, -0.5, 0], [0, 1, 0]),
        ([0, -0.5, 0], [0, 0, 0]),
        ([0, 0, 0], [0, 0, 0]),
        ([0.05, 0, 0], [1, 0, 0]),
        ([0.02, 0, 0], [0, 1, 0]),
    ],
)
@pytest.mark.parametrize("lower", [0.4, 0.45])
def test_singular_cases_are_finite_and_keep_lengths(target: list[float], pole: list[float], lower: float) -> None:
    start = np.zeros(3)
    result = solve_limb(start, np.array(target, float), np.array(pole, float), upper_m=UPPER, lower_m=lower)
    assert np.all(np.isfinite(result.middle))
    assert np.isclose(np.linalg.norm(result.middle), UPPER)
    assert np.isclose(np.linalg.norm(result.end - result.middle), lower)
    assert np.isclose(np.linalg.norm(result.normal), 1)


def test_soft_reach_is_continuous_in_speed_and_never_locks() -> None:
    distance = np.linspace(0.6, 1.2, 6001)
    target = np.stack([0 * distance, -distance, 0 * distance], -1)
    pole = np.array([0, 0, 1.0])
    soft = solve_limb(np.zeros(3), target, pole, upper_m=UPPER, lower_m=LOWER, softness_m=0.05)
    hard = solve_limb(np.zeros(3), target, pole, upper_m=UPPER, lower_m=LOWER)

    def jerk(result) -> float:
        return float(np.max(np.abs(np.diff(result.middle[:, 2], n=2))))

    assert jerk(soft) < jerk(hard) / 20
    assert np.all(np.linalg.norm(soft.end, axis=1) < UPPER + LOWER)


def test_soft_reach_grows_with_the_target_and_comes_earlier_with_more_softness() -> None:
    distance = np.linspace(0.06, 3.0, 4001)
    target, pole = np.stack([distance, 0 * distance, 0 * distance], -1), np.array([0, 0, 1.0])
    ends = np.stack(
        [
            solve_limb(np.zeros(3), target, pole, upper_m=UPPER, lower_m=LOWER, softness_m=softness).end[:, 0]
            for softness in (0.0, 0.01, 0.05, 0.2, 0.6)
        ]
    )
    assert np.all(np.diff(ends, axis=1) > -1e-15)
    assert np.all(np.diff(ends, axis=0) < 1e-15)
    before = distance < UPPER + LOWER - 0.2
    assert np.allclose(ends[3, before], distance[before], atol=1e-15)


@pytest.mark.parametrize("softness", [0.0, 0.05, 0.3])
@pytest.mark.parametrize("most", [1.0, 1.05, 1.5, 3.0])
def test_stretch_is_kept_within_its_factor_and_reaches_what_it_can(softness: float, most: float) -> None:
    distance = np.linspace(0.06, 4.0, 8001)
    target, pole = np.stack([0 * distance, -distance, 0 * distance], -1), np.array([0, 0, 1.0])
    result = solve_limb(np.zeros(3), target, pole, upper_m=UPPER, lower_m=LOWER, softness_m=softness, max_stretch=most)
    reach = UPPER + LOWER
    for bone, length in ((result.middle, UPPER), (result.end - result.middle, LOWER)):
        assert np.allclose(np.linalg.norm(bone, axis=1), result.stretch * length, atol=1e-12)
    assert np.all(result.stretch >= 1)
    assert np.all(result.stretch <= most)
    assert np.all(np.diff(result.stretch) > -1e-12)
    assert np.all(np.diff(-result.end[:, 1]) > -1e-12)
    # The end is on the target as long as the factor may still grow freely.
    slow = min(softness / reach, most - 1)
    free = (distance < reach - softness) | ((result.stretch < most - slow - 1e-9) & (most > 1))
    assert np.max(result.error_m[free], initial=0) < 1e-12
    if softness < 0.1:  # more softness lets go of the target before full reach
        assert np.any(free & (distance > reach)) == (most > 1 + slow)
    if softness == 0:
        assert np.allclose(result.stretch, np.clip(distance / reach, 1, most))


def test_soft_stretch_is_continuous_in_speed() -> None:
    def jumps(samples: int) -> float:
        distance = np.linspace(0.5, 2.0, samples)
        target = np.stack([0 * distance, -distance, 0 * distance], -1)
        result = solve_limb(
            np.zeros(3), target, np.array([0, 0, 1.0]), upper_m=UPPER, lower_m=LOWER, softness_m=0.05, max_stretch=1.4
        )
        speeds = np.diff(np.concatenate([result.middle, result.end, result.stretch[:, None]], 1), axis=0)
        return float(np.max(np.abs(np.diff(speeds, axis=0)))) * samples

    assert jumps(40001) < 0.3 * jumps(10001)  # a jump in speed would stay what it is


def test_agrees_with_the_law_of_cosines_in_fifty_digits() -> None:
    mpmath = pytest.importorskip("mpmath")
    with mpmath.workdps(50):
        for distance in ("0.0500001", "0.3", "0.8499999", "0.84999999999"):
            upper, lower, d = mpmath.mpf(UPPER), mpmath.mpf(LOWER), mpmath.mpf(float(distance))
            angle = mpmath.acos((upper**2 + d**2 - lower**2) / (2 * upper * d))
            wanted = [float(upper * mpmath.sin(angle)), float(upper * mpmath.cos(angle))]
            got = solve_limb(
                np.zeros(3), np.array([0, float(distance), 0]), np.array([1.0, 0, 0]), upper_m=UPPER, lower_m=LOWER
            )
            # The distance of the limb from being straight is known to rounding only; Heron's formula adds nothing to that.
            slack = min(float(upper + lower - d), float(d - abs(upper - lower)))
            assert got.middle[:2] == pytest.approx(wanted, abs=1e-15 + 4e-16 / np.sqrt(slack))


def test_lengths_may_differ_within_a_batch() -> None:
    start, target, pole = _random(4, 50)
    upper = np.linspace(0.2, 0.6, 50)
    together = solve_limb(start, target, pole, upper_m=upper, lower_m=LOWER, softness_m=upper / 10, max_stretch=1.2)
    for n in range(50):
        one = solve_limb(
            start[n], target[n], pole[n], upper_m=upper[n], lower_m=LOWER, softness_m=upper[n] / 10, max_stretch=1.2
        )
        assert np.allclose(together.middle[n], one.middle, atol=1e-14)
        assert np.isclose(together.stretch[n], one.stretch)


def test_rotations_carry_the_rest_bones_onto_the_limb() -> None:
    start, target, pole = _random(2, 200)
    result = solve_limb(start, target, pole, upper_m=UPPER, lower_m=LOWER)
    rest = (np.array([0.1, -UPPER, 0.02]), np.array([0.0, -LOWER, -0.03]))
    upper, lower = limb_rotations(rest, np.array([1.0, 0, 0]), start, result)
    for rotation, bone, there in (
        (upper, rest[0], result.middle - start),
        (lower, rest[1], result.end - result.middle),
    ):
        turned = quat.rotate(rotation, bone / np.linalg.norm(bone))
        assert np.allclose(turned, there / np.linalg.norm(there, axis=1, keepdims=True), atol=1e-12)
        assert np.allclose(np.linalg.norm(rotation, axis=1), 1)


def test_frames_that_agree_need_no_rotation() -> None:
    along, normal = np.array([0.3, -1, 0.2]), np.array([1.0, 0.2, 0])
    rotation = rotation_between_frames(along, normal, along, normal)
    assert np.allclose(np.abs(rotation[0]), 1)


def test_wrong_input_is_named() -> None:
    origin, pole = np.zeros(3), np.array([0, 0, 1.0])
    with pytest.raises(ShapeError, match="target: expected"):
        solve_limb(origin, np.zeros(2), pole, upper_m=1, lower_m=1)
    with pytest.raises(ShapeError, match="positive lengths"):
        solve_limb(origin, origin, pole, upper_m=0, lower_m=1)
    with pytest.raises(ShapeError, match="softness_m"):
        solve_limb(origin, origin, pole, upper_m=1, lower_m=1, softness_m=2)
    with pytest.raises(ShapeError, match="positive lengths"):
        solve_limb(origin, origin, pole, upper_m=np.array([1.0, -1.0]), lower_m=1)
    with pytest.raises(ShapeError, match="max_stretch"):
        solve_limb(origin, origin, pole, upper_m=1, lower_m=1, max_stretch=0.5)
