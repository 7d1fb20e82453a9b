"""Contacts with the ground: when a point stands still near its lowest place."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from keypose.analysis.ground import Ground, GroundKind, fit_ground, point_speeds, still_spells, true_runs
from keypose.analysis.roles import SIDES
from keypose.arrays import Floats, as_float, checked
from keypose.errors import ShapeError
from keypose.model import Event

STILL_M = 1e-6
"""A step of a frame that is rounding and no motion, for a leg of 0.85 m."""

LEG_M = 0.85
"""The length of leg that limits in metres are meant for."""
_LEG = ("upper_leg", "lower_leg", "foot")
_FEWEST = 3  # frames in contact that are enough to say how a foot stands
_RELEASE = 1.5  # a contact ends where a limit is passed so many times over


def has_legs(roles: Mapping[str, int]) -> bool:
    """Whether roles name both legs, from hip to foot."""
    return all(f"{side}_{part}" in roles for side in SIDES for part in _LEG)


def leg_length(roles: Mapping[str, int], places: Floats) -> float:
    """The length of the left leg in the first frame of places (T, J, 3), metres."""
    hip, knee, foot = (places[0, roles[f"left_{part}"]] for part in _LEG)
    return float(np.linalg.norm(knee - hip) + np.linalg.norm(foot - knee))


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
    speed = point_speeds(points, rate_hz)
    begin = (height < height_m) & (speed < speed_m_s)
    stay = (height < release * height_m) & (speed < release * speed_m_s)
    period = frames - 1 if cyclic and frames > 2 else frames
    touching = _latched(begin[:period], stay[:period], rounds=2 if period < frames else 1)
    shortest = round(shortest_s * rate_hz)
    for n in range(count):
        touching[:, n] = ~_without_short(~touching[:, n], shortest, period < frames)
        touching[:, n] = _without_short(touching[:, n], shortest, period < frames)
    return np.concatenate([touching, touching[:1]]) if period < frames else touching


@dataclass(frozen=True, slots=True)
class Sole:
    """Where the heel's contact point lies from ankle and ball: the angle of the line from ankle to ball over the level plane
    where the foot is flat, and how far behind the ankle the heel and ahead of the ball the tip of the toes is (shares of that
    line's length).
    """

    flat: float
    behind: float = 0.3
    ahead: float = 0.45

    def heel_offsets(self, ball_from_ankle: Floats) -> Floats:
        """From the ankle to the heel (*B, 3) on the ball's level when flat; the foot may be pitched, its roll is left out."""
        return self._turned(ball_from_ankle, -self.behind * np.cos(self.flat), np.sin(self.flat))

    def tip_offsets(self, ball_from_ankle: Floats) -> Floats:
        """From the ball to the tip of straight toes (*B, 3), on the ball's level when flat."""
        return self._turned(ball_from_ankle, self.ahead * np.cos(self.flat), 0.0)

    def _turned(self, ball_from_ankle: Floats, ahead: float, up: float) -> Floats:
        """A way in the flat foot, ahead and up by shares of the line from ankle to ball, pitched as the foot is."""
        level = np.hypot(ball_from_ankle[..., 0], ball_from_ankle[..., 2])
        length = np.linalg.norm(ball_from_ankle, axis=-1)
        pitch = np.arctan2(ball_from_ankle[..., 1], level) - self.flat
        along = length * (ahead * np.cos(pitch) - up * np.sin(pitch)) / np.maximum(level, 1e-9)
        high = length * (ahead * np.sin(pitch) + up * np.cos(pitch))
        return np.stack([along * ball_from_ankle[..., 0], high, along * ball_from_ankle[..., 2]], axis=-1)


@dataclass(frozen=True, slots=True, eq=False)
class Footing:
    """How the feet of a motion stand.

    Shapes and units: ``points`` and ``touching`` hold ``left_heel``, ``left_ball`` ...: places (T, 3) in metres and flags (T,).
    A foot without toes has a heel only, its ankle. ``stand_m``: how high each side's points are over the ``ground`` where they
    stand (a joint lies inside the foot). ``soles`` (``left``, ``right``) of feet with toes; ``lean`` by how many radians the ground
    under each of them rises from heel to ball where the foot is flat, as part of its sole's angle.
    """

    points: Mapping[str, Floats]
    touching: dict[str, np.ndarray]
    ground: Ground
    stand_m: Mapping[str, float]
    soles: Mapping[str, Sole]
    rate_hz: float
    lean: Mapping[str, float]

    def heights(self, point: str) -> Floats:
        """How high (T,) a point is over where it stands, metres."""
        track = self.points[point]
        return track[:, 1] - self.ground.heights(track) - self.stand_m[point.partition("_")[0]]


@dataclass(frozen=True, slots=True)
class ContactSpan:
    """One contact: the point (``left_heel``, ``left_ball`` ...), first and last frame, times, and where it is (metres)."""

    point: str
    first: int
    last: int
    start_s: float
    end_s: float
    place: tuple[float, float, float]


def contact_spans(footing: Footing, start_s: float = 0.0) -> tuple[ContactSpan, ...]:
    """The contacts of a footing one by one, in order of time; ``start_s`` is the time of its first frame."""
    found: list[ContactSpan] = []
    for point, flags in footing.touching.items():
        for first, stop in true_runs(flags):
            x, y, z = (float(v) for v in np.median(footing.points[point][first:stop], axis=0))
            begin, end = (start_s + f / footing.rate_hz for f in (first, stop - 1))
            found.append(ContactSpan(point, first, stop - 1, begin, end, (x, y, z)))
    return tuple(sorted(found, key=lambda c: (c.first, c.point)))


def contact_events(footing: Footing, start_s: float = 0.0) -> tuple[Event, ...]:
    """The contacts of a footing as events ``left_ball.down``, ``left_ball.up``; what is down at the first frame has no ``down``."""
    found: list[Event] = []
    for point, flags in footing.touching.items():
        for word, frames in zip(("down", "up"), contact_changes(flags), strict=True):
            found += [Event(start_s + float(f) / footing.rate_hz, f"{point}.{word}") for f in frames]
    return tuple(sorted(found, key=lambda e: (e.time_s, e.name)))


def find_footing(
    roles: Mapping[str, int],
    places: Floats,
    rate_hz: float,
    leg_m: float,
    *,
    height_m: float = 0.03,
    speed_m_s: float = 0.25,
    ground: Ground | GroundKind = "auto",
    shortest_s: float = 0.05,
) -> Footing:
    """Where the ground is and when heels and balls of the feet touch it.

    Shapes and units: ``places`` (T, J, 3) metres; limits in metres and metres a second are those of a leg of 0.85 m and grow
    with ``leg_m``. ``ground`` is known, or of a kind, or (``auto``) level if that explains most of the standing, else a slope,
    else steps.

    A contact is where a point is low and slow (with hysteresis, as in `find_contacts`), from where its speed has come down to
    where it begins to rise for good: a foot that was planted before is found in just the frames in which it stands still.
    """
    size = leg_m / LEG_M
    shortest = max(2, round(shortest_s * rate_hz))
    tracks: dict[str, Floats] = {}
    ankles: dict[str, Floats] = {}
    for side in SIDES:
        if f"{side}_foot" in roles:
            ankles[side] = places[:, roles[f"{side}_foot"]].astype(np.float64)
            ball = roles.get(f"{side}_toes", roles[f"{side}_foot"])
            tracks[side] = places[:, ball].astype(np.float64)
    spells = still_spells(tracks, rate_hz, speed_m_s * size, height_m * size, shortest)
    own = fit_ground(spells, tracks, height_m * size, "auto" if isinstance(ground, Ground) else ground)
    found = ground if isinstance(ground, Ground) else own
    stand = {side: _stand(found, track, rate_hz, speed_m_s * size, height_m * size) for side, track in tracks.items()}
    soles = {
        side: _sole(ankles[side], tracks[side], rate_hz, speed_m_s * size) for side in tracks if f"{side}_toes" in roles
    }
    limits = (height_m * size, speed_m_s * size)
    touching: dict[str, np.ndarray] = {}
    # The sole's angle and the height of standing are those of the frames in contact; they are found with rough ones first.
    for _ in range(2):
        footing = Footing(_points(ankles, tracks, soles), {}, found, stand, soles, rate_hz, {})
        touching = {
            name: _touches(footing.heights(name), track, rate_hz, limits, shortest, size)
            for name, track in footing.points.items()
        }
        soles, stand = _refined(replace(footing, touching=touching), ankles)
    points = _points(ankles, tracks, soles)
    lean = {side: _lean(own, points, touching, side) for side in soles}
    return Footing(points, touching, found, stand, soles, rate_hz, lean)


def _lean(own: Ground, points: Mapping[str, Floats], touching: Mapping[str, np.ndarray], side: str) -> float:
    """How the ground on which a motion stands rises from heel to ball of a flat foot, radians."""
    down = touching[f"{side}_ball"]
    if own.kind == "flat" or not down.any():
        return 0.0
    flat = down & touching[f"{side}_heel"]
    heel, ball = (points[f"{side}_{point}"][flat if flat.any() else down] for point in ("heel", "ball"))
    between = ball - heel
    return float(np.median(np.arctan2(own.heights(ball) - own.heights(heel), np.hypot(between[:, 0], between[:, 2]))))


def _points(ankles: Mapping[str, Floats], tracks: Mapping[str, Floats], soles: Mapping[str, Sole]) -> dict[str, Floats]:
    points: dict[str, Floats] = {}
    for side, track in tracks.items():
        if side in soles:
            points[f"{side}_heel"] = ankles[side] + soles[side].heel_offsets(track - ankles[side])
            points[f"{side}_ball"] = track
        else:
            points[f"{side}_heel"] = track
    return points


def foot_contacts(
    roles: Mapping[str, int],
    places: Floats,
    rate_hz: float,
    leg_m: float,
    *,
    height_m: float = 0.03,
    speed_m_s: float = 0.25,
    ground: Ground | GroundKind = "auto",
) -> dict[str, np.ndarray]:
    """When heels (``left_heel``) and balls (``left_ball``) of the feet touch the ground, (T,) bool each; see `find_footing`."""
    return find_footing(roles, places, rate_hz, leg_m, height_m=height_m, speed_m_s=speed_m_s, ground=ground).touching


def foot_points(roles: Mapping[str, int], places: Floats, touching: Mapping[str, np.ndarray]) -> dict[str, Floats]:
    """The points (T, 3) of feet whose contacts are given (``left_heel`` ...): ball, and heel behind and under the ankle."""
    found: dict[str, Floats] = {}
    for side in SIDES:
        if f"{side}_foot" not in roles:
            continue
        ankle = places[:, roles[f"{side}_foot"]]
        if f"{side}_toes" not in roles:
            found[f"{side}_heel"] = ankle
            continue
        ball = places[:, roles[f"{side}_toes"]]
        none = np.zeros(len(places), bool)
        flat = touching.get(f"{side}_heel", none) & touching.get(f"{side}_ball", none)
        rise = _elevation(ball - ankle)
        sole = Sole(float(np.median(rise[flat] if flat.any() else rise)))
        found[f"{side}_heel"], found[f"{side}_ball"] = ankle + sole.heel_offsets(ball - ankle), ball
    return found


def _stand(ground: Ground, track: Floats, rate_hz: float, speed: float, near: float) -> float:
    """How high a point is over the ground where it stands; nothing, where that is out of the ordinary or the ground slopes."""
    if ground.kind != "flat":
        return 0.0
    height = track[:, 1] - ground.heights(track)
    standing = (point_speeds(track, rate_hz) < speed) & (np.abs(height) < near)
    return float(np.median(height[standing])) if standing.sum() >= _FEWEST else 0.0


def _sole(ankle: Floats, ball: Floats, rate_hz: float, speed: float) -> Sole:
    both = (point_speeds(ankle, rate_hz) < speed) & (point_speeds(ball, rate_hz) < speed)
    rise = _elevation(ball - ankle)
    if both.sum() >= _FEWEST:
        return Sole(float(np.median(rise[both])))
    # A foot that is never flat: the angle at which its ankle is lowest.
    return Sole(float(np.median(rise[ankle[:, 1] <= np.percentile(ankle[:, 1], 10.0)])))


def _refined(footing: Footing, ankles: Mapping[str, Floats]) -> tuple[dict[str, Sole], dict[str, float]]:
    """Soles and standing heights as they are in the frames in contact."""
    soles, stand = dict(footing.soles), dict(footing.stand_m)
    for side in stand:
        name = f"{side}_ball" if side in soles else f"{side}_heel"
        down = footing.touching[name]
        if side in soles:
            flat = down & footing.touching[f"{side}_heel"]
            if flat.any():
                rise = _elevation(footing.points[name] - ankles[side])
                soles[side] = Sole(float(np.median(rise[flat])))
        if footing.ground.kind == "flat" and down.any():
            stand[side] += float(np.median(footing.heights(name)[down]))
    return soles, stand


def _elevation(ball_from_ankle: Floats) -> Floats:
    return np.arctan2(ball_from_ankle[..., 1], np.hypot(ball_from_ankle[..., 0], ball_from_ankle[..., 2]))


def _touches(
    height: Floats, track: Floats, rate_hz: float, limits: tuple[float, float], shortest: int, size: float
) -> np.ndarray:
    """Low and slow with hysteresis, ends where the speed is still coming down or rises for good left out."""
    speed = point_speeds(track, rate_hz)
    begin = (height < limits[0]) & (speed < limits[1])
    stay = (height < _RELEASE * limits[0]) & (speed < _RELEASE * limits[1])
    touching = np.zeros(len(speed), bool)
    for start, stop in true_runs(stay):
        first = start + int(np.argmax(begin[start:stop]))
        touching[first:stop] = begin[first]
    touching = ~_without_short(~touching, shortest, False)
    touching = _without_short(touching, shortest, False)
    still = STILL_M * size * rate_hz
    for start, stop in true_runs(touching):
        low, high = start, stop - 1
        if stop < len(speed):
            while high > low and speed[high] > still and speed[high - 1] < speed[high]:
                high -= 1
        if start > 0:
            while low < high and speed[low] > still and speed[low + 1] < speed[low]:
                low += 1
        while high - low + 1 < shortest:  # a short touch keeps its slowest frames
            if high + 1 < stop and (low == start or speed[high + 1] <= speed[low - 1]):
                high += 1
            elif low > start:
                low -= 1
            else:
                break
        touching[start:low] = False
        touching[high + 1 : stop] = False
        # What moves from one exact hold to another does so on purpose.
        holds = [(a, b) for a, b in true_runs(speed[low : high + 1] <= still) if b - a >= shortest]
        for (_, left), (right, _) in itertools.pairwise(holds):
            touching[low + left : low + right] = False
    return touching


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
    for start, end in true_runs(rolled):
        open_end = not cyclic and (start == 0 or end == len(rolled))
        if end - start < shortest and not open_end:
            rolled[start:end] = False
    return np.roll(rolled, shift)
