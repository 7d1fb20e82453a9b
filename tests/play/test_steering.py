"""Pedestrians: they get where they want, keep apart and inside, stand and wave; always the same from the same seed."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import KDTree

from keypose.errors import ShapeError, UnknownName
from keypose.play import steering as st

DT = 1 / 30


def walked(count: int, behaviour: st.Behaviour, seconds: float, seed: int = 1, every_s: float = 0.5):
    """A crowd of points that do at once what is asked of them: the states seen every so often."""
    radius = max(8.0, 1.5 * np.sqrt(count))
    roots = st.place(count, radius, seed)
    s = st.init(count, radius, behaviour, seed)
    seen: list[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]] = []
    waits = 0.0
    for _ in range(round(seconds / DT)):
        st.step(s, roots, DT)
        roots[:, 2] += np.radians(s.turn) * DT
        roots[:, 0] += np.sin(roots[:, 2]) * s.speed * DT
        roots[:, 1] += np.cos(roots[:, 2]) * s.speed * DT
        waits += DT
        if waits >= every_s - 1e-9:
            waits = 0.0
            seen.append((roots.copy(), s.speed.copy(), s.wave.copy(), s.goals.copy()))
    return s, roots, seen


@pytest.mark.parametrize("behaviour", st.BEHAVIOURS)
def test_they_keep_apart_and_inside(behaviour):
    s, _, seen = walked(120, behaviour, 30)
    nearest = np.array([KDTree(r[:, :2]).query(r[:, :2], k=2)[0][:, 1] for r, *_ in seen])
    assert np.mean(nearest < 0.4) < 0.05  # narrower than shoulders: seldom, and soon over
    assert np.median(nearest) > 0.7
    assert max(float(np.linalg.norm(r[:, :2], axis=1).max()) for r, *_ in seen) < s.radius_m + 0.5


def test_avoiding_is_what_keeps_them_apart(monkeypatch):
    def together() -> float:
        _, _, seen = walked(120, "stream", 15)
        nearest = np.array([KDTree(r[:, :2]).query(r[:, :2], k=2)[0][:, 1] for r, *_ in seen])
        return float(np.mean(nearest < 0.4))

    with_care = together()
    monkeypatch.setattr(st, "_avoidance", lambda places, *_: np.zeros_like(places))
    monkeypatch.setattr(st, "_free_way", lambda places, *_: np.full(len(places), np.inf))
    monkeypatch.setattr(st, "_spread", lambda *_: None)
    assert together() > 4 * with_care


def test_they_go_and_rest_and_nobody_stands_for_ever():
    _, _, seen = walked(100, "wander", 60)
    going = np.array([speed > 0 for _, speed, *_ in seen])
    assert 0.2 < going.mean() < 0.98
    assert np.all(going.any(axis=0))
    late = going[len(going) // 2 :]
    assert late.any(axis=0).mean() > 0.97  # no jam that never ends
    assert sum(float(wave.sum()) for *_, wave, _ in seen) > 0


def test_followers_are_near_their_leaders():
    s, roots, _ = walked(48, "follow", 30)
    led = np.nonzero(s.leader >= 0)[0]
    assert len(led) == 44
    gap = np.linalg.norm(roots[led, :2] - roots[s.leader[led], :2], axis=1)
    others = np.linalg.norm(roots[led, :2] - np.roll(roots[s.leader[led], :2], 12, axis=0), axis=1)
    assert np.median(gap) < 6 < np.median(others)


def test_streams_go_two_ways_and_a_gathering_comes_to_the_middle():
    _, roots, seen = walked(80, "stream", 12)
    moves = roots[:, 0] - seen[0][0][:, 0]
    assert np.mean(moves > 1) > 0.2 and np.mean(moves < -1) > 0.2
    _, roots, seen = walked(60, "gather", 30)
    assert np.median(np.linalg.norm(roots[:, :2], axis=1)) < 0.75 * np.median(np.linalg.norm(seen[0][0][:, :2], axis=1))
    assert np.mean([speed > 0 for _, speed, *_ in seen[-4:]]) < 0.3  # they stand
    inward = np.sum(-roots[:, :2] * np.stack([np.sin(roots[:, 2]), np.cos(roots[:, 2])], axis=1), axis=1)
    assert np.mean(inward > 0.7 * np.linalg.norm(roots[:, :2], axis=1)) > 0.6  # and look at the middle


def test_the_same_seed_gives_the_same_crowd():
    first, second, other = (walked(40, "wander", 5, seed)[1] for seed in (3, 3, 4))
    assert np.array_equal(first, second)
    assert not np.array_equal(first, other)


def test_places_are_apart():
    for count, radius in ((1, 8.0), (100, 15.0), (1000, 48.0)):
        roots = st.place(count, radius, 2)
        assert roots.shape == (count, 3)
        assert np.linalg.norm(roots[:, :2], axis=1).max() <= radius
        if count > 1:
            assert KDTree(roots[:, :2]).query(roots[:, :2], k=2)[0][:, 1].min() > 0.7


def test_speeds_are_those_of_a_graph_and_looks_are_ahead():
    s, _, seen = walked(100, "wander", 20)
    speeds = np.concatenate([speed for _, speed, *_ in seen])
    assert np.all((speeds == 0) | (speeds >= 1.2)) and speeds.max() < 4.0
    assert np.abs(s.turn).max() <= 110
    assert np.all(s.look_at[s.look > 0, 2] > 0)


def test_what_does_not_fit_is_refused():
    with pytest.raises(ShapeError, match="count"):
        st.init(0, 5.0)
    with pytest.raises(ShapeError, match="radius"):
        st.init(5, 0.0)
    with pytest.raises(UnknownName, match="wander"):
        st.init(5, 5.0, "wandr")  # type: ignore[arg-type]
    s = st.init(5, 5.0)
    with pytest.raises(ShapeError, match="roots"):
        st.step(s, np.zeros((4, 3)), DT)
    with pytest.raises(UnknownName, match="stream"):
        st.turn_to(s, "steam")  # type: ignore[arg-type]
