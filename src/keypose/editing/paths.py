"""Paths over the ground: read off a motion, bent, drawn anew, closed to a loop; and the motion carried along, feet planted."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator
from scipy.ndimage import gaussian_filter1d

from keypose.analysis.contacts import LEG_M, foot_contacts, foot_points, has_legs, leg_length
from keypose.analysis.ground import true_runs
from keypose.analysis.roles import SIDES
from keypose.arrays import Floats, checked
from keypose.editing.displacement import fit_displacement
from keypose.editing.planting import PlantOptions, knee_limit, plant_feet
from keypose.editing.reach import check_finite, found_roles
from keypose.errors import ShapeError
from keypose.evaluate import sample_morphs, sample_motion, world_rotations_positions
from keypose.math import quat
from keypose.model import Event, Motion, Pose, Skeleton

# What is slower stands, for a leg of LEG_M; contacts whose points are nearer to each other are one.
_STANDING_M_S, _SAME_PLACE_M = 0.05, 0.01


@dataclass(frozen=True, slots=True, eq=False)
class GroundPath:
    """The way of a body over the ground.

    Shapes and units: ``points`` (T, 2) metres, x and z, one for each frame; ``rate_hz`` frames a second; what is slower than
    ``standing_m_s`` stands.
    """

    points: Floats
    rate_hz: float
    standing_m_s: float = _STANDING_M_S

    def __post_init__(self) -> None:
        points = checked(np.array(self.points, np.float64), ("T", 2), "points")
        if len(points) < 1 or not np.all(np.isfinite(points)):
            raise ShapeError("points: expected at least one frame of finite numbers")
        if not (np.isfinite(self.rate_hz) and self.rate_hz > 0):
            raise ShapeError(f"rate_hz: expected a positive number, got {self.rate_hz}")
        points.setflags(write=False)
        object.__setattr__(self, "points", points)

    @property
    def lengths_m(self) -> Floats:
        """The way gone up to each frame, (T,) metres."""
        return np.append(0.0, np.cumsum(np.linalg.norm(np.diff(self.points, axis=0), axis=-1)))

    @property
    def speeds_m_s(self) -> Floats:
        """The speed in each frame, (T,)."""
        return np.linalg.norm(_velocities(self), axis=-1)

    @property
    def headings_rad(self) -> Floats:
        """The direction of travel (T,): 0 along +Z, growing towards +X, without jumps of a turn; kept while it stands."""
        velocity = _velocities(self)
        return _angles(velocity[:, 1] + 1j * velocity[:, 0], np.linalg.norm(velocity, axis=-1) > self.standing_m_s)

    @property
    def turning_rad(self) -> float:
        """How far the direction of travel turns from the first frame to the last."""
        headings = self.headings_rad
        return float(headings[-1] - headings[0])


@dataclass(frozen=True, slots=True, eq=False)
class PathResult:
    """A motion on another path.

    Shapes and units: ``path`` that it follows; ``touching`` point -> (T,) bool, the contacts that were kept (empty without
    roles of legs); ``short_m`` how far a planted foot stays from its place at most; ``knee_ratio`` the largest angular
    acceleration of a knee by that of before: more than 1.5 only where feet are out of reach, as in a path that is gone too fast
    for its turns.
    """

    motion: Motion
    touching: Mapping[str, np.ndarray]
    short_m: float
    knee_ratio: float
    path: GroundPath


def extract_path(
    motion: Motion, skeleton: Skeleton, *, roles: Mapping[str, int] | None = None, smooth_s: float = 0.5
) -> GroundPath:
    """The smoothed way of the hips (without roles, of the first root) over the ground.

    ``smooth_s`` is about the time of a step, so that the sway of walking is left out; both ends go on straight for it.

    Raises:
        ShapeError: where the motion does not fit the skeleton, has numbers that are not finite, or the time is negative.
    """
    checked(motion.pose.rotations, (..., skeleton.joint_count, 4), "rotations", "the skeleton")
    check_finite(motion)
    if not (np.isfinite(smooth_s) and smooth_s >= 0):
        raise ShapeError(f"smooth_s: expected 0 or more seconds, got {smooth_s}")
    known = found_roles(skeleton) if roles is None else roles
    joint = known.get("hips", int(np.flatnonzero(skeleton.parents < 0)[0]))
    places = world_rotations_positions(skeleton, motion.pose.broadcast())[1]
    points = np.asarray(places[:, joint], np.float64)[:, [0, 2]]
    width = 0.5 * smooth_s * motion.rate_hz
    if width > 0 and len(points) > 2:
        pad = min(int(np.ceil(4 * width)), len(points) - 1)
        # Turned about each end, a straight way goes on straight.
        before, after = 2 * points[0] - points[pad:0:-1], 2 * points[-1] - points[-2 : -pad - 2 : -1]
        points = gaussian_filter1d(np.concatenate([before, points, after]), width, axis=0)[pad : pad + len(points)]
    return GroundPath(points, motion.rate_hz, _STANDING_M_S * _size(np.asarray(places, np.float64), known))


def move_path(path: GroundPath, handles: Mapping[int, Sequence[float]], ease_s: float = 1.0) -> GroundPath:
    """A path that is moved by (x, z) metres at the frames of handles, and smoothly less within ``ease_s`` around them.

    Raises:
        ShapeError: where a handle is none of the path's frames.
    """
    if not handles:
        return path
    frames = np.array(sorted(handles), np.intp)
    offsets = np.array([handles[int(f)] for f in frames], np.float64)
    ease = max(2, round(ease_s * path.rate_hz))
    return replace(path, points=path.points + fit_displacement(frames, offsets, len(path.points), ease).values)


def bend_path(path: GroundPath, angle_rad: float, first: int = 0, last: int | None = None) -> GroundPath:
    """A path whose direction turns by an angle more between two frames, evenly along the way; a whole turn makes a circle.

    Speeds, and so the way gone in each frame, stay as they are. Positive angles turn from +Z to +X.

    Raises:
        ShapeError: where the frames are not there or do not rise.
    """
    end = len(path.points) - 1 if last is None else last
    if not 0 <= first < end < len(path.points):
        raise ShapeError(f"first, last: expected rising frames up to {len(path.points) - 1}, got {first} and {end}")
    gone = path.lengths_m
    span = gone[end] - gone[first]
    if span <= 0:
        raise ShapeError(f"frames {first} to {end}: expected a way to bend, got one that stands")
    share = np.clip((gone - gone[first]) / span, 0.0, 1.0)
    # Each step lies between two frames.
    turn = angle_rad * 0.5 * (share[1:] + share[:-1])
    return replace(path, points=path.points[0] + _stepped(_turned(np.diff(path.points, axis=0), turn)))


def turn_path(path: GroundPath, angle_rad: float, frame: int = 0) -> GroundPath:
    """A path turned as a whole about its place at a frame; positive angles turn from +Z to +X.

    Raises:
        ShapeError: where the frame is not there or the angle is not finite.
    """
    if not 0 <= frame < len(path.points):
        raise ShapeError(f"frame: expected 0 to {len(path.points) - 1}, got {frame}")
    pivot = path.points[frame]
    return replace(path, points=pivot + _turned(path.points - pivot, np.full(len(path.points), angle_rad)))


def scale_path(path: GroundPath, factor: float, frame: int = 0) -> GroundPath:
    """A path scaled about its place at a frame: longer or shorter steps in the same time.

    Raises:
        ShapeError: where the factor is not positive or the frame is not there.
    """
    if not (np.isfinite(factor) and factor > 0):
        raise ShapeError(f"factor: expected a positive number, got {factor}")
    if not 0 <= frame < len(path.points):
        raise ShapeError(f"frame: expected 0 to {len(path.points) - 1}, got {frame}")
    pivot = path.points[frame]
    return replace(path, points=pivot + factor * (path.points - pivot))


def stretch_path(path: GroundPath, factor: float, first: int = 0, last: int | None = None) -> GroundPath:
    """A path with longer or shorter steps between two frames, in the same time; what follows goes on from there.

    Raises:
        ShapeError: where the factor is not positive, or the frames are not there or do not rise.
    """
    end = len(path.points) - 1 if last is None else last
    if not (np.isfinite(factor) and factor > 0):
        raise ShapeError(f"factor: expected a positive number, got {factor}")
    if not 0 <= first < end < len(path.points):
        raise ShapeError(f"first, last: expected rising frames up to {len(path.points) - 1}, got {first} and {end}")
    steps = np.diff(path.points, axis=0)
    steps[first:end] *= factor
    return replace(path, points=path.points[0] + _stepped(steps))


def follow_points(path: GroundPath, points: Any, *, closed: bool = False, stretch: bool = False) -> GroundPath:
    """The path along a smooth curve through drawn points, gone at the same speeds.

    Shapes and units: ``points`` (K, 2) metres, x and z, two or more. What is left of a longer drawing is not gone; beyond a
    shorter one it goes on straight, or round again where it is ``closed``; with ``stretch`` steps grow or shrink so that the
    last frame is at its end.

    Raises:
        ShapeError: where there are too few points or two in a row are the same.

    Source: M. Gleicher, "Motion path editing" (I3D 2001); the curve is a cubic spline over the lengths of its chords.
    """
    drawn = checked(np.asarray(points, np.float64), ("K", 2), "points")
    if closed and len(drawn) > 2 and np.allclose(drawn[0], drawn[-1]):
        drawn = drawn[:-1]
    if len(drawn) < (3 if closed else 2) or not np.all(np.isfinite(drawn)):
        raise ShapeError(f"points: expected {3 if closed else 2} finite ones or more, got {len(drawn)}")
    if closed:
        drawn = np.concatenate([drawn, drawn[:1]])
    chords = np.linalg.norm(np.diff(drawn, axis=0), axis=-1)
    if np.any(chords <= 0):
        raise ShapeError(
            f"points: expected each to differ from the one before, got {drawn[int(np.argmin(chords))]} twice"
        )
    knots = np.append(0.0, np.cumsum(chords))
    curve = CubicSpline(knots, drawn, bc_type="periodic" if closed else "natural")
    fine = np.linspace(0.0, knots[-1], 256 * len(drawn))
    dense = curve(fine)
    along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(dense, axis=0), axis=-1)))
    gone, whole = path.lengths_m, float(along[-1])
    if stretch and gone[-1] > 0:
        gone = gone * (whole / gone[-1])
    if closed and not stretch:
        gone = np.mod(gone, whole)
    inside = np.clip(gone, 0.0, whole)
    result = curve(np.interp(inside, along, fine))
    end = curve(knots[-1], 1)
    result = result + (gone - inside)[:, None] * (end / np.linalg.norm(end))
    return replace(path, points=result)


def close_path(path: GroundPath, turns: int | None = None) -> GroundPath:
    """A path that ends where it begins, in the direction in which it begins.

    It is bent evenly until it has turned ``turns`` times (if not given, the nearest whole number but none; a positive one
    from +Z to +X), and the gap that is left goes evenly along the way.

    Raises:
        ShapeError: where the path stands, or shall turn 0 times.
    """
    own = path.turning_rad / (2 * np.pi)
    if turns is None:
        turns = int(np.rint(own)) or (1 if own >= 0 else -1)
    if turns == 0:
        raise ShapeError("turns: expected a whole number other than 0; a way that does not turn cannot close")
    bent = bend_path(path, 2 * np.pi * turns - path.turning_rad)
    gone = bent.lengths_m
    gap = bent.points[-1] - bent.points[0]
    return replace(bent, points=bent.points - (gone / gone[-1])[:, None] * gap)


def put_on_path(
    motion: Motion,
    skeleton: Skeleton,
    path: GroundPath,
    *,
    old: GroundPath | None = None,
    roles: Mapping[str, int] | None = None,
    plant: bool = True,
) -> PathResult:
    """A motion moved from its own path to another, turned with it; feet stand where they stood in contact, and do not slide.

    Where the new path is the old one moved and turned as a whole, so is the motion, and nothing else changes.

    Shapes and units: ``path`` with a point for each frame; ``old`` the path it was made from (`extract_path`, if not given).

    Raises:
        ShapeError: where a path has another number of frames.

    Source: M. Gleicher, "Motion path editing" (I3D 2001): every frame is carried from the old path's own axes to the new
    path's; then constraints are met again.
    """
    known = found_roles(skeleton) if roles is None else roles
    own = extract_path(motion, skeleton, roles=known) if old is None else old
    for name, given in (("path", path), ("old", own)):
        if len(given.points) != motion.frame_count:
            raise ShapeError(
                f"{name}: expected {motion.frame_count} points to match the motion, got {len(given.points)}"
            )
    if np.array_equal(own.points, path.points):
        return PathResult(motion, {}, 0.0, 1.0, path)
    turn = _turn_between(own, path)
    carried = _carried(motion, skeleton, own, path, turn)
    rigid = np.ptp(turn) < 1e-9 and np.allclose(path.points, _rigidly(own, path, turn), atol=1e-9)
    if not plant or not has_legs(known) or rigid:
        return PathResult(carried, {}, 0.0, 1.0, path)
    touching = _contacts(motion, skeleton, known)
    unturned = _feet_unturned(carried, skeleton, known, touching, turn)
    return PathResult(*_planted(unturned, skeleton, known, touching), path)


def retime(
    motion: Motion, skeleton: Skeleton, speed: Any, *, roles: Mapping[str, int] | None = None, plant: bool = True
) -> Motion:
    """A motion played at another speed that may change all the time, at the same rate; contacts, morphs and events with it.

    Shapes and units: ``speed`` a factor, or one for each frame (T,): 2 is twice as fast.

    Raises:
        ShapeError: where there are not T positive factors.
    """
    count = motion.frame_count
    factors = np.asarray(speed, np.float64)
    if factors.shape not in ((), (count,)) or not np.all(np.isfinite(factors)) or np.any(factors <= 0):
        raise ShapeError(f"speed: expected a positive factor or ({count},) of them, got {factors.shape}")
    if count < 2 or np.all(factors == 1.0):
        return motion
    pace = 1.0 / np.broadcast_to(factors, (count,))
    # When each old frame is played; factors go straight over from frame to frame.
    played = np.append(0.0, np.cumsum(0.5 * (pace[1:] + pace[:-1]))) / motion.rate_hz
    frames = int(np.floor(played[-1] * motion.rate_hz + 1e-6)) + 1
    old = np.interp(np.arange(frames) / motion.rate_hz, played, np.arange(count) / motion.rate_hz)
    times = motion.start_s + old
    weights = None if motion.morph_weights is None else sample_morphs(motion, motion.morph_names, times)
    events = tuple(
        Event(
            motion.start_s + float(np.interp(e.time_s - motion.start_s, np.arange(count) / motion.rate_hz, played)),
            e.name,
            e.data,
        )
        for e in motion.events
    )
    warped = replace(motion, pose=sample_motion(motion, times), morph_weights=weights, events=events)
    known = found_roles(skeleton) if roles is None else roles
    if not plant or not has_legs(known):
        return warped
    nearest = np.rint(old * motion.rate_hz).astype(np.intp)
    touching = {name: flags[nearest] for name, flags in _contacts(motion, skeleton, known).items()}
    # Contacts are those of the motion: a foot that swings slowly now touches nothing for that.
    return plant_feet(warped, skeleton, known, touching=touching).motion


def speeds_for(path: GroundPath, speed_m_s: Any, *, smooth_s: float = 0.3, most: float = 4.0) -> Floats:
    """Factors (T,) for `retime` with which a path is gone at a wanted speed, metres a second, one or (T,) of them.

    Where it stands it stays as fast as it is next to there. Factors lie between 1 / ``most`` and ``most``.

    Raises:
        ShapeError: where there are not one or T positive speeds.
    """
    wanted = np.asarray(speed_m_s, np.float64)
    count = len(path.points)
    if wanted.shape not in ((), (count,)) or not np.all(np.isfinite(wanted)) or np.any(wanted <= 0):
        raise ShapeError(f"speed_m_s: expected a positive speed or ({count},) of them, got {wanted.shape}")
    own = gaussian_filter1d(path.speeds_m_s, max(0.5 * smooth_s * path.rate_hz, 1e-6), mode="nearest")
    moving = own > path.standing_m_s
    if not moving.any():
        return np.ones(count)
    factors = np.broadcast_to(wanted, (count,)) / np.where(moving, own, 1.0)
    at = np.arange(count)
    return np.clip(np.interp(at, at[moving], factors[moving]), 1.0 / most, most)


def _velocities(path: GroundPath) -> Floats:
    if len(path.points) < 2:
        return np.zeros_like(path.points)
    return np.gradient(path.points, axis=0) * path.rate_hz


def _angles(numbers: Any, known: np.ndarray) -> Floats:
    """Angles (T,) of complex numbers without jumps; in between where they are not known."""
    at = np.arange(len(numbers))
    if not known.any():
        return np.zeros(len(numbers))
    return np.interp(at, at[known], np.unwrap(np.angle(numbers[known])))


def _turned(vectors: Floats, angle: Floats) -> Floats:
    """(N, 2) of x and z turned by (N,) angles from +Z to +X."""
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([c * vectors[:, 0] + s * vectors[:, 1], c * vectors[:, 1] - s * vectors[:, 0]], axis=-1)


def _stepped(steps: Floats) -> Floats:
    return np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])


def _turn_between(old: GroundPath, new: GroundPath) -> Floats:
    """How far the new path is turned against the old one in each frame (T,)."""
    a, b = (v[:, 1] + 1j * v[:, 0] for v in (_velocities(old), _velocities(new)))
    # The best turn of a neighbourhood of a fifth of a second; a conjugate takes the old direction away.
    width = 0.1 * old.rate_hz
    product = b * np.conj(a)
    smooth = gaussian_filter1d(product.real, width, mode="nearest") + 1j * gaussian_filter1d(
        product.imag, width, mode="nearest"
    )
    return _angles(smooth, np.abs(smooth) > old.standing_m_s**2)


def _rigidly(old: GroundPath, new: GroundPath, turn: Floats) -> Floats:
    return new.points[0] + _turned(old.points - old.points[0], np.full(len(turn), turn[0]))


def _carried(motion: Motion, skeleton: Skeleton, old: GroundPath, new: GroundPath, turn: Floats) -> Motion:
    """Every frame's roots from the old path's axes to the new one's."""
    pose = motion.pose.broadcast()
    rotations, translations = np.array(pose.rotations), np.array(pose.translations)
    yaw = _yaw(turn)
    for root in np.flatnonzero(skeleton.parents < 0):
        rotations[:, root] = quat.multiply(yaw, np.asarray(rotations[:, root], np.float64))
        level = np.asarray(translations[:, root], np.float64)[:, [0, 2]]
        translations[:, root, ::2] = new.points + _turned(level - old.points, turn)
    return replace(motion, pose=Pose(translations, quat.align_signs(rotations, axis=0), pose.scales))


def _yaw(angle: Floats) -> Floats:
    zero = np.zeros_like(angle)
    return np.stack([np.cos(0.5 * angle), zero, np.sin(0.5 * angle), zero], axis=-1)


def _contacts(motion: Motion, skeleton: Skeleton, roles: Mapping[str, int]) -> dict[str, np.ndarray]:
    places = np.asarray(world_rotations_positions(skeleton, motion.pose.broadcast())[1], np.float64)
    size = _size(places, roles)
    found = foot_contacts(roles, places, motion.rate_hz, size * LEG_M)
    points = foot_points(roles, places, found)
    return {name: _joined(flags, points[name], motion.rate_hz, size) for name, flags in found.items()}


def _size(places: Floats, roles: Mapping[str, int]) -> float:
    """How much longer a body's left leg is than LEG_M; 1 without legs."""
    if not has_legs(roles):
        return 1.0
    return leg_length(roles, places) / LEG_M


def _joined(flags: np.ndarray, track: Floats, rate_hz: float, size: float) -> np.ndarray:
    """Contacts (T,) without short gaps over which the point went nowhere: on another path each part would get a place of its own."""
    joined = flags.copy()
    for (_, stop), (start, _) in itertools.pairwise(true_runs(flags)):
        if start - stop <= 0.1 * rate_hz and np.linalg.norm(track[start] - track[stop - 1]) < _SAME_PLACE_M * size:
            joined[stop:start] = True
    return joined


def _planted(
    motion: Motion, skeleton: Skeleton, roles: Mapping[str, int], touching: Mapping[str, np.ndarray]
) -> tuple[Motion, Mapping[str, np.ndarray], float, float]:
    """The motion with feet held in the old contacts, then in those that it has now; these, what legs are short of, and knees by
    those of before.
    """
    options = PlantOptions(knee_rad_s2=knee_limit(motion, skeleton, roles))
    first = plant_feet(motion, skeleton, roles, touching=touching, options=options)
    second = plant_feet(first.motion, skeleton, roles, options=options)
    return (
        second.motion,
        second.touching,
        max(first.short_m, second.short_m),
        first.knee_ratio * second.knee_ratio,
    )


def _feet_unturned(
    motion: Motion,
    skeleton: Skeleton,
    roles: Mapping[str, int],
    touching: Mapping[str, np.ndarray],
    turn: Floats,
) -> Motion:
    """The motion with feet that do not turn with the path while they stand: all of a contact has the turn of its middle."""
    pose = motion.pose.broadcast()
    rotations = np.array(pose.rotations)
    turned = np.asarray(world_rotations_positions(skeleton, motion.pose)[0], np.float64)
    for side in SIDES:
        foot = roles[f"{side}_foot"]
        none = np.zeros(motion.frame_count, bool)
        stands = touching.get(f"{side}_heel", none) | touching.get(f"{side}_ball", none)
        if not stands.any():
            continue
        back = np.zeros(motion.frame_count)
        for start, stop in true_runs(stands):
            back[start:stop] = turn[start:stop].mean() - turn[start:stop]
        at = np.flatnonzero(stands)
        if len(at) > 1:
            inside = np.arange(at[0], at[-1] + 1)
            back[inside] = PchipInterpolator(at, back[at])(inside)
        back[: at[0]], back[at[-1] :] = back[at[0]], back[at[-1]]
        above = turned[:, int(skeleton.parents[foot])]
        rotations[:, foot] = quat.multiply(quat.conjugate(above), quat.multiply(_yaw(back), turned[:, foot]))
    return replace(motion, pose=Pose(pose.translations, quat.align_signs(rotations, axis=0), pose.scales))
