"""The ground under feet: level, leaning, sloping, in steps; feet that are held up make none."""

from __future__ import annotations

import numpy as np
import pytest

from keypose.analysis.ground import Ground, fit_ground, point_speeds, still_spells, true_runs
from keypose.errors import ShapeError


def walker(
    height, count: int = 12, rate_hz: float = 60.0, noise_m: float = 0.0, seed: int = 1
) -> dict[str, np.ndarray]:
    """Two feet that take turns, half a metre each time, on a ground of that height (x, z)."""
    rng = np.random.default_rng(seed)
    half = round(0.5 * rate_hz)
    frames = count * half
    tracks = {}
    for n, side in enumerate(("left", "right")):
        x = 0.1 - 0.2 * n
        path = np.empty((frames, 3))
        z = -0.5 * n
        for step in range(count):
            at = slice(step * half, (step + 1) * half)
            if step % 2 == n:
                path[at] = (x, float(height(x, z)), z)
            else:
                u = np.linspace(0, 1, half + 2)[1:-1]
                ease = u * u * (3 - 2 * u)
                low, high = float(height(x, z)), float(height(x, z + 1.0))
                path[at] = np.stack(
                    [0 * u + x, low + (high - low) * ease + 0.15 * np.sin(np.pi * u), z + ease], axis=-1
                )
                z += 1.0
        tracks[side] = path + noise_m * rng.normal(size=path.shape)
    return tracks


def fitted(tracks, kind="auto", rate_hz: float = 60.0) -> Ground:
    return fit_ground(still_spells(tracks, rate_hz, 0.25, 0.03, 3), tracks, 0.03, kind)


@pytest.mark.parametrize("noise_m", [0.0, 0.0005])
@pytest.mark.parametrize("level", [0.0, 1.3, -0.4])
def test_a_level_floor(level: float, noise_m: float) -> None:
    found = fitted(walker(lambda x, z: level, noise_m=noise_m))
    assert found.kind == "flat" and found.height_m == pytest.approx(level, abs=0.002)


@pytest.mark.parametrize("degrees", [-20.0, -5.0, 4.0, 12.0, 30.0])
def test_a_slope(degrees: float) -> None:
    rise = float(np.tan(np.radians(degrees)))
    found = fitted(walker(lambda x, z: 0.2 + rise * z + 0.02 * x, noise_m=0.0003))
    assert found.kind == "slope"
    assert found.slope[1] == pytest.approx(rise, abs=0.003) and found.height_m == pytest.approx(0.2, abs=0.01)


def test_a_floor_that_leans_by_a_degree() -> None:
    rise = float(np.tan(np.radians(1.0)))
    found = fitted(walker(lambda x, z: rise * z, count=20))
    assert found.kind == "slope" and found.slope[1] == pytest.approx(rise, rel=0.02)


def test_stairs_up_and_along_and_down() -> None:
    def height(x, z):
        k = np.maximum(np.floor(z / 0.5 + 0.5), 0)
        return 0.17 * np.minimum(np.minimum(k, 6), np.maximum(12 - k, 0))

    tracks = walker(height, count=14)
    found = fitted(tracks)
    assert found.kind == "steps" and found.steps is not None
    np.testing.assert_allclose(np.diff(np.unique(np.round(found.steps[:, 1], 4))), 0.17, atol=1e-6)
    for side in tracks:
        spells = [s for s in still_spells(tracks, 60.0, 0.25, 0.03, 3) if s.side == side]
        np.testing.assert_allclose(found.heights(np.array([s.place for s in spells])), [s.place[1] for s in spells])


def test_a_foot_held_up_makes_no_floor() -> None:
    frames = 300
    tracks = {"left": np.zeros((frames, 3)), "right": np.zeros((frames, 3))}
    tracks["left"][:, 0] = 0.2
    lifted = 0.5 * np.clip((np.arange(frames) - 30) / 20, 0, 1)
    tracks["left"][:, 1] = lifted  # up for four seconds of five
    found = fitted(tracks)
    assert found.kind == "flat" and found.height_m == 0.0
    spells = still_spells(tracks, 60.0, 0.25, 0.03, 3)
    assert [s.carries for s in spells if s.side == "left"] == [True, False]


def test_without_standing_the_ground_is_where_feet_get() -> None:
    t = np.arange(200) / 60.0
    tracks = {"left": np.stack([0 * t, 0.4 + 0.3 * np.sin(9 * t), 2.0 * t], -1)}
    assert fitted(tracks).height_m == pytest.approx(0.1, abs=0.02)
    assert fit_ground([], {}, 0.03).kind == "flat"


def test_kinds_can_be_asked_for_and_wrong_ones_are_refused() -> None:
    tracks = walker(lambda x, z: 0.1 * z)
    assert [fitted(tracks, kind).kind for kind in ("flat", "slope", "steps")] == ["flat", "slope", "steps"]
    with pytest.raises(ShapeError, match="hilly"):
        fitted(tracks, "hilly")


def test_speeds_and_runs() -> None:
    track = np.zeros((6, 3))
    track[3:, 0] = 0.1
    assert point_speeds(track, 10.0).tolist() == [0.0] * 6  # the smaller of the steps beside a frame
    track[4:, 0] = 0.3
    assert point_speeds(track, 10.0).tolist() == [0.0, 0.0, 0.0, 1.0, 0.0, 0.0]
    assert true_runs(np.array([1, 1, 0, 1, 0, 1], bool)) == [(0, 2), (3, 4), (5, 6)]
    assert point_speeds(track[:1], 10.0).tolist() == [0.0]
