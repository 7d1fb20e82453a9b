"""Contacts with the ground: when a point stands still near its lowest place."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from keypose.arrays import Floats, as_float, checked
from keypose.errors import ShapeError

_LEG_M = 0.85  # the length of leg that limits in metres are meant for


def find_contacts(
    positions: Any,
    rate_hz: float,
    *,
    height_m: float = 0.03,
    speed_m_s: float = 0.5,
    release: float = 1.5,
    floor_m: Any = None,
    shortest_s: float = 0.05,
    cyclic: bool = False,
) -> np.ndarray:
    """Which points touch the ground in which frame, (T, N) bool.

    Shapes and units:
        positions: (T, N, 3) metres in the world, Y up.
        height_m, speed_m_s: a contact begins where the point is lower than this over the floor and slower than this;
            it ends where one of them passes ``release`` times its limit (hysteresis).
        floor_m: height of the floor under each point (N,) or for all; if not given, each point's own lowest place.
        shortest_s: shorter contacts, and shorter gaps between two contacts, are left out.
        cyclic: the last frame is the same moment as the first, so a contact may go on over the seam.

    Raises:
        ShapeError: where a shape or a limit does not fit.

    Source: thresholds on height and speed as in Ikemoto, Arikan and Forsyth, "Knowing when to put your foot down"
    (I3D 2006), whose classifier learns from such labels.
    """
    points = checked(as_float(positions), ("T", "N", 3), "positions").astype(np.float64)
    if not (np.isfinite(rate_hz) and rate_hz > 0):
        raise ShapeError(f"rate_hz: expected a positive number, got {rate_hz}")
    if not (height_m > 0 and speed_m_s > 0 and release >= 1 and shortest_s >= 0):
        raise ShapeError("height_m, speed_m_s: expected positive numbers, release >= 1 and shortest_s >= 0")
    frames, count = points.shape[:2]
    if frames == 0:
        return np.zeros((0, count), bool)
    floor = points[..., 1].min(axis=0) if floor_m is None else np.broadcast_to(as_float(floor_m), (count,))
    height = points[..., 1] - floor
    speed = _speeds(points, rate_hz)
    begin = (height < height_m) & (speed < speed_m_s)
    stay = (height < release * height_m) & (speed < release * speed_m_s)
    period = frames - 1 if cyclic and frames > 2 else frames
    touching = _latched(begin[:period], stay[:period], rounds=2 if period < frames else 1)
    shortest = round(shortest_s * rate_hz)
    for n in range(count):
        touching[:, n] = ~_without_short(~touching[:, n], shortest, period < frames)
        touching[:, n] = _without_short(touching[:, n], shortest, period < frames)
    return np.concatenate([touching, touching[:1]]) if period < frames else touching


def foot_contacts(
    roles: Mapping[str, int],
    places: Floats,
    rate_hz: float,
    leg_m: float,
    *,
    height_m: float = 0.03,
    speed_m_s: float = 0.25,
) -> dict[str, np.ndarray]:
    """When heels (``left_heel``) and balls (``left_ball``) of the feet touch the ground, (T,) bool each.

    Shapes and units: ``places`` (T, J, 3) metres; limits in metres and metres a second are those of a leg of 0.85 m and
    grow with ``leg_m``. The ankle stands for the heel and the toe joint for the ball; the ground under each is its own lowest
    height, without the lowest two in a hundred frames.
    """
    size = leg_m / _LEG_M
    points = {"heel": "foot", "ball": "toes"}
    found: dict[str, np.ndarray] = {}
    for side in ("left", "right"):
        for point, role in points.items():
            if f"{side}_{role}" not in roles:
                continue
            joint = roles[f"{side}_{role}"]
            track = places[:, joint : joint + 1]
            floor = np.percentile(track[..., 1], 2.0)
            found[f"{side}_{point}"] = find_contacts(
                track, rate_hz, height_m=height_m * size, speed_m_s=speed_m_s * size, floor_m=floor
            )[:, 0]
    return found


def contact_changes(touching: Any, cyclic: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Frames at which a contact begins and frames at which it has ended, of one point (T,) bool.

    With ``cyclic`` (last frame = first moment) the seam counts as a neighbour; else a contact that is there in the first
    frame has no beginning.
    """
    track = checked(np.asarray(touching, bool), ("T",), "touching")
    if len(track) < 2:
        return np.zeros(0, np.intp), np.zeros(0, np.intp)
    if cyclic:
        track = track[:-1]
        before = np.roll(track, 1)
    else:
        before = np.concatenate([track[:1], track[:-1]])
    return np.nonzero(track & ~before)[0], np.nonzero(~track & before)[0]


def _speeds(points: Floats, rate_hz: float) -> Floats:
    """Speed at each frame (T, N): the smaller of the steps before and after, so that a landing counts at once."""
    if len(points) < 2:
        return np.zeros(points.shape[:2])
    steps = np.linalg.norm(np.diff(points, axis=0), axis=-1) * rate_hz
    return np.minimum(np.concatenate([steps[:1], steps]), np.concatenate([steps, steps[-1:]]))


def _latched(begin: np.ndarray, stay: np.ndarray, rounds: int) -> np.ndarray:
    """On from ``begin`` for as long as ``stay``; going round twice settles what the seam begins with."""
    result = np.zeros_like(begin)
    on = np.zeros(begin.shape[1], bool)
    for _ in range(rounds):
        for frame in range(len(begin)):
            on = begin[frame] | (on & stay[frame])
            result[frame] = on
    return result


def _without_short(track: np.ndarray, shortest: int, cyclic: bool) -> np.ndarray:
    """Runs of True shorter than ``shortest`` frames become False; runs at an open end are kept."""
    if shortest < 2 or track.all() or not track.any():
        return track
    result = track.copy()
    shift = int(np.argmin(track)) if cyclic else 0
    rolled = np.roll(result, -shift)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], rolled, [False]]).astype(np.int8)))
    for start, end in zip(edges[::2], edges[1::2], strict=True):
        open_end = not cyclic and (start == 0 or end == len(rolled))
        if end - start < shortest and not open_end:
            rolled[start:end] = False
    return np.roll(rolled, shift)
