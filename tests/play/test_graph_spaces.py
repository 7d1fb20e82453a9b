"""Blend spaces: weights are a partition of unity at every point of every layout."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from keypose.play.graph.spaces import bands, line, plane

NUMBERS = st.floats(-1e6, 1e6, allow_nan=False)
SMALL = st.integers(-4, 4).map(float)


@given(st.lists(NUMBERS, min_size=1, max_size=8), NUMBERS)
def test_line_is_a_partition(places: list[float], at: float) -> None:
    weights = line(places).weights(at)
    assert min(weights) >= 0 and sum(weights) == pytest.approx(1)
    inside = min(max(at, min(places)), max(places))
    scale = max(map(abs, places)) + 1
    assert sum(w * p for w, p in zip(weights, places, strict=True)) == pytest.approx(inside, abs=1e-9 * scale)


@pytest.mark.parametrize("make", [plane, bands])
@settings(deadline=None, max_examples=200)
@given(points=st.lists(st.tuples(SMALL, SMALL), min_size=1, max_size=9), x=NUMBERS, y=NUMBERS)
def test_plane_is_a_partition(make, points: list[tuple[float, float]], x: float, y: float) -> None:
    """Any layout: single, repeated and collinear samples too."""
    weights = make(points).weights(x, y)
    assert len(weights) == len(points)
    assert min(weights) >= 0 and sum(weights) == pytest.approx(1)


@pytest.mark.parametrize("make", [plane, bands])
@settings(deadline=None)
@given(points=st.lists(st.tuples(SMALL, SMALL), min_size=1, max_size=9, unique=True))
def test_at_a_sample_it_plays_alone(make, points: list[tuple[float, float]]) -> None:
    space = make(points)
    for i, (x, y) in enumerate(points):
        assert space.weights(x, y)[i] == pytest.approx(1)


@settings(deadline=None)
@given(points=st.lists(st.tuples(SMALL, SMALL), min_size=3, max_size=9, unique=True), seed=st.integers(0, 99))
def test_delaunay_reproduces_points_inside(points: list[tuple[float, float]], seed: int) -> None:
    """Barycentric weights: the weighted mean of the places is the point itself."""
    shares = np.random.default_rng(seed).dirichlet(np.ones(len(points)))
    x, y = shares @ np.array(points)
    weights = plane(points).weights(float(x), float(y))
    assert np.array(weights) @ np.array(points) == pytest.approx([x, y], abs=1e-9)
    assert sum(w > 1e-9 for w in weights) <= 3


def test_outside_the_hull_the_nearest_place_plays() -> None:
    space = plane([(0, 0), (2, 0), (0, 2), (2, 2)])
    assert space.weights(1.0, -5.0) == pytest.approx([0.5, 0.5, 0, 0])
    assert space.weights(9.0, 9.0) == pytest.approx([0, 0, 0, 1])


def test_weights_are_continuous() -> None:
    rng = np.random.default_rng(3)
    points = [(float(x), float(y)) for x, y in rng.normal(size=(12, 2))]
    for space in (plane(points), bands(points)):
        steps: list[float] = []
        for count in (1001, 10001, 100001):
            x = np.linspace(-3, 3, count)[: count // 2 : max(count // 10001, 1)]
            near = x + 6 / (count - 1)
            pairs = [(space.weights(a, np.sin(a)), space.weights(b, np.sin(b))) for a, b in zip(x, near, strict=True)]
            steps.append(max(np.abs(np.subtract(*pair)).max() for pair in pairs))
        assert steps[1] < 0.2 * steps[0] and steps[2] < 0.2 * steps[1]


def test_far_and_tiny_layouts() -> None:
    for scale in (1e-6, 1.0, 1e6):
        points = [(1e3 * scale, 0.0), (1e3 * scale + scale, 0.0), (1e3 * scale, scale)]
        weights = plane(points).weights(1e3 * scale + 0.25 * scale, 0.25 * scale)
        assert weights == pytest.approx([0.5, 0.25, 0.25], rel=1e-6)


def test_samples_at_one_place_share() -> None:
    assert line([1.0, 1.0, 2.0]).weights(0.0) == [0.5, 0.5, 0.0]
    assert plane([(0, 0), (0, 0), (1, 0), (0, 1)]).weights(0.0, 0.0) == pytest.approx([0.5, 0.5, 0, 0])
