"""Squash and stretch from a trajectory: long along the motion where it is fast, flat where it changes direction, volume kept.

The deformation is one number, the strain (the logarithm of the length along an axis), and that axis. Along the axis things are
e^strain times as long and across it e^(-strain / (D - 1)), in D = 2 or 3 dimensions: the logarithms add up to 0, and the
determinant is 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from keypose.arrays import Array, checked
from keypose.editing.selection import EVERYTHING, Selection, chosen_joints, with_curves
from keypose.errors import ShapeError, UnknownName
from keypose.evaluate import sample_clip, sample_curve, world_rotations_positions
from keypose.math import quat, spline
from keypose.model import Channel, Clip, Curve, CurveKind, Interpolation, Pose, Property, Skeleton

VOLUME_TOLERANCE = 5e-7
"""How far the determinant may be from 1 anywhere, between keys too."""

# A trajectory is looked at so often in a second.
_RATE_HZ = 480.0
# A change of velocity within two looks counts as an impact from this share of the largest speed on.
_IMPACT_SHARE = 0.15
# Landing and taking off within so many seconds are one contact.
_LONGEST_CONTACT_S = 0.4


@dataclass(frozen=True, slots=True, eq=False)
class Deformation:
    """Strain (T,) and the axis (T, D) that it is along, unit vectors, at times (T,); ``impacts_s`` (N,) are the impacts found."""

    times_s: Array
    strain: Array
    axes: Array
    impacts_s: Array


@dataclass(frozen=True, slots=True)
class _Contact:
    start_s: float
    end_s: float
    normal: Array
    strength: float


def trajectory_deformation(
    times_s: Array,
    positions: Array,
    stretch: float = 0.25,
    squash: float = 0.4,
    contact_s: float = 0.06,
    breaks_s: Sequence[float] = (),
) -> Deformation:
    """The strain of something that moves along positions (T, D) in metres at rising times (T,) s, in 2D or 3D.

    ``stretch`` is the strain at the highest speed, ``squash`` the one (with the sign changed) at a contact that turns that speed
    back; a contact squashes for ``contact_s`` before and after it. The axis is that of the velocity, and at contacts that of the
    change of velocity. ``breaks_s`` are times where impacts may lie exactly: an impact is taken to be at the nearest one.

    Raises: ShapeError where shapes disagree, times do not rise or an amount is negative.
    Source: lecture notes, Traditional Animation: stretch along the direction of movement when going fast, squash when changing
    direction.
    """
    times, path = np.asarray(times_s, np.float64), np.asarray(positions, np.float64)
    checked(times, ("T",), "times_s")
    checked(path, (len(times), "D"), "positions", "times_s")
    if path.shape[1] not in (2, 3):
        raise ShapeError(f"positions: expected 2 or 3 components, got {path.shape[1]}")
    if len(times) < 3 or np.any(np.diff(times) <= 0):
        raise ShapeError("times_s: expected three or more rising times")
    for label, number in (("stretch", stretch), ("squash", squash), ("contact_s", contact_s)):
        if number < 0:
            raise ShapeError(f"{label}: expected 0 or more, got {number}")
    parts = np.diff(path, axis=0) / np.diff(times)[:, None]
    before, after = np.concatenate([parts[:1], parts]), np.concatenate([parts, parts[-1:]])
    velocity = 0.5 * (before + after)
    fastest = float(np.linalg.norm(parts, axis=-1).max())
    if fastest < 1e-9:
        still = np.zeros(len(times))
        return Deformation(times, still, np.broadcast_to(np.eye(path.shape[1])[1], path.shape), np.zeros(0))
    contacts = _contacts(times, parts, fastest, np.asarray(breaks_s, np.float64))
    speed = np.linalg.norm(velocity, axis=-1) / fastest
    strain = stretch * 2.0 * speed**2 / (1.0 + speed**2)
    axes = _directions(velocity, 1e-3 * fastest)
    for contact in contacts:
        weight, touching = _ramps(times, contact, contact_s)
        # While it touches it is not stretched, and the axis is the one that it is flat along.
        strain = (1 - touching) * strain - weight * squash * contact.strength
        side = np.where(axes @ contact.normal < 0, -1.0, 1.0)[:, None]
        turned = (1 - touching)[:, None] * side * axes + touching[:, None] * contact.normal
        length = np.linalg.norm(turned, axis=-1, keepdims=True)
        axes = np.where(length > 1e-9, turned / np.where(length > 1e-9, length, 1.0), axes)
    return Deformation(times, strain, axes, np.array([0.5 * (c.start_s + c.end_s) for c in contacts]))


def stretch_matrices(strain: Array, axes: Array) -> Array:
    """The matrices (T, D, D), of determinant 1, of strains (T,) along unit axes (T, D), in 2D or 3D."""
    strain, axes = np.asarray(strain, np.float64), np.asarray(axes, np.float64)
    size = axes.shape[-1]
    across = np.exp(-strain / (size - 1))[..., None, None]
    along = np.exp(strain)[..., None, None]
    return across * np.eye(size) + (along - across) * axes[..., :, None] * axes[..., None, :]


def squash_and_stretch(
    clip: Clip,
    skeleton: Skeleton,
    selection: Selection = EVERYTHING,
    joint: str = "",
    scale_joint: str = "",
    level_joint: str = "",
    stretch: float = 0.25,
    squash: float = 0.4,
    contact_s: float = 0.06,
) -> Clip:
    """The clip with the scale of a joint animated from the path of another: squash and stretch with the volume kept.

    ``joint`` is the one whose path is looked at (the first chosen one), ``scale_joint`` the one that is scaled: a joint named
    Squash below it, else ``joint`` itself. Where ``level_joint`` (or a child of the scaled joint, named Level) is there, the
    scaled joint turns its Y axis to the direction of the strain, and the level joint turns back, so that what hangs below is
    stretched along the motion without being turned; otherwise the strain is shared among the scaled joint's own axes.

    Between keys the determinant stays within `VOLUME_TOLERANCE` of 1: the scale's tangents add up to none in the logarithm, and
    keys are added until the polynomial that the determinant is between two keys keeps within it.

    Raises: UnknownName for joints that do not exist; ShapeError for negative amounts.
    """
    joint = joint or _first(chosen_joints(clip, selection, skeleton.names), skeleton)
    moving = skeleton.index(joint)
    scale_joint = scale_joint or _below(skeleton, moving, "Squash") or joint
    scaled = skeleton.index(scale_joint)
    level_joint = level_joint or _below(skeleton, scaled, "Level")
    start = clip.start_s if selection.start_s is None else selection.start_s
    end = clip.end_s if selection.end_s is None else selection.end_s
    keyed = sorted({float(t) for curve in clip.curves.values() for t in curve.times_s if start <= t <= end})
    times = _looks(start, end, keyed, _RATE_HZ if contact_s <= 0 else max(_RATE_HZ, 24.0 / contact_s))
    pose = sample_clip(clip, skeleton, times)
    rotations, positions = world_rotations_positions(
        skeleton, Pose(*(np.asarray(a, np.float64) for a in (pose.translations, pose.rotations, pose.scales)))
    )
    found = trajectory_deformation(times, positions[:, moving], stretch, squash, contact_s, keyed)
    parent = int(skeleton.parents[scaled])
    axes = found.axes
    if parent >= 0:
        axes = quat.rotate(quat.conjugate(rotations[:, parent]), axes)
    turn = _turns(axes) if level_joint else None
    share = np.array([-0.5, 1.0, -0.5]) if turn is not None else 1.5 * axes**2 - 0.5
    logs = found.strain[:, None] * share  # of the scale; they add up to 0, and so do their slopes
    slopes = np.gradient(logs, times, axis=0)
    at = _refined(times, logs, slopes, _key_times(times, found.impacts_s, clip.rate_hz or 25.0))
    log_scale, slope = _cubic(times, logs, slopes, at)
    rest = skeleton.rest
    values = np.asarray(rest.scales[scaled], np.float64) * np.exp(log_scale)
    made: dict[Channel, Curve] = {
        Channel(scale_joint, Property.SCALE): Curve(
            at, values, Interpolation.HERMITE, values * slope, values * slope, CurveKind.VECTOR
        )
    }
    if turn is not None:
        keyed_turn = sample_curve(Curve(times, turn, kind=CurveKind.ROTATION), at)
        for name, rotation in ((scale_joint, keyed_turn), (level_joint, quat.conjugate(keyed_turn))):
            own = np.asarray(rest.rotations[skeleton.index(name)], np.float64)
            made[Channel(name, Property.ROTATION)] = Curve(at, quat.multiply(rotation, own), kind=CurveKind.ROTATION)
    return with_curves(clip, made)


def volume_error(scales: Curve, rest: Array | None = None) -> float:
    """The largest |determinant - 1| of a curve of scales (K, 3) relative to a rest scale (3,), at keys and between them.

    Between two keys the determinant of smooth keys is a polynomial of degree nine at most; it is measured at 33 places of
    each span, between which nothing of that degree can hide.
    """
    checked(scales.values, ("K", 3), "scales")
    base = 1.0 if rest is None else float(np.prod(np.asarray(rest, np.float64)))
    edges = scales.times_s
    at = (edges[:-1, None] + np.diff(edges)[:, None] * np.linspace(0, 1, 34)[None, :-1]).ravel()
    found = np.prod(sample_curve(scales, np.append(at, edges[-1])).astype(np.float64), axis=-1) / base
    return float(np.abs(found - 1).max())


# --- impacts ----------------------------------------------------------------------------------------------------------------


def _contacts(times: Array, parts: Array, fastest: float, breaks: Array) -> list[_Contact]:
    """Impacts of a trajectory with velocities ``parts`` (T - 1, D) between times, landing and taking off as one."""
    change = np.linalg.norm(parts[2:] - parts[:-2], axis=-1) if len(parts) > 2 else np.zeros(0)
    spans = times[3:] - times[:-3] if len(times) > 3 else np.zeros(0)
    # What gravity or an animator's ease does in the same time is no impact.
    usual = 6.0 * np.median(change / np.maximum(spans, 1e-9)) * spans if len(change) else change
    sudden = np.nonzero((change > _IMPACT_SHARE * fastest) & (change > usual))[0]
    groups = np.split(sudden, np.nonzero(np.diff(sudden) > 2)[0] + 1) if len(sudden) else []
    events: list[tuple[float, int, int]] = []
    for group in groups:
        peak = int(group[np.argmax(change[group])])
        at = float(0.5 * (times[peak + 1] + times[peak + 2]))
        near = breaks[np.abs(breaks - at) < 4 / _RATE_HZ] if len(breaks) else breaks
        if len(near):
            at = float(near[np.argmin(np.abs(near - at))])
        events.append((at, int(group[0]), int(group[-1]) + 2))
    contacts: list[_Contact] = []
    n = 0
    while n < len(events):
        start, first, last = events[n]
        end = start
        if n + 1 < len(events) and events[n + 1][0] - start < _LONGEST_CONTACT_S:
            away = parts[min(events[n + 1][2], len(parts) - 1)] - parts[first]
            between = parts[last : events[n + 1][1] + 1] @ away
            # Landed and not yet taken off: it may slide, but keeps to what it touches.
            if len(between) and float(np.abs(between).max()) < 0.15 * float(away @ away):
                end, _, last = events[n + 1]
                n += 1
        turned = parts[min(last, len(parts) - 1)] - parts[first]
        size = float(np.linalg.norm(turned))
        if size > 0:
            contacts.append(_Contact(start, end, turned / size, min(1.0, size / (2 * fastest))))
        n += 1
    return contacts


def _ramps(times: Array, contact: _Contact, contact_s: float) -> tuple[Array, Array]:
    """How flat it is, 1 in the middle of a contact, and whether it touches, 1 all through it; both come and go smoothly."""
    middle, half = 0.5 * (contact.start_s + contact.end_s), 0.5 * (contact.end_s - contact.start_s)
    # Something that stays on the ground is squashed there; what only touches it must begin before.
    reach = contact_s if half == 0 else 0.5 * contact_s
    if reach <= 0 and half == 0:
        return np.zeros(len(times)), np.zeros(len(times))
    away = np.abs(times - middle)
    flat = np.clip(1.0 - away / (half + reach), 0.0, 1.0)
    touching = np.clip(1.0 - (away - half) / max(reach, 1e-9), 0.0, 1.0)
    return flat * flat * (3 - 2 * flat), touching * touching * (3 - 2 * touching)


def _directions(velocity: Array, least: float) -> Array:
    """Unit directions (T, D); where it hardly moves the direction is that before it, or the first one there is."""
    speed = np.linalg.norm(velocity, axis=-1)
    fast = np.nonzero(speed > least)[0]
    held = fast[np.clip(np.searchsorted(fast, np.arange(len(speed)), side="right") - 1, 0, None)]
    return velocity[held] / speed[held, None]


def _turns(axes: Array) -> Array:
    """Rotations (T, 4) that bring Y to the line of each axis (T, 3), without jumps: an axis has two ends, and the nearer counts."""
    found = np.empty((len(axes), 4))
    here, at = np.array([1.0, 0, 0, 0]), np.array([0.0, 1.0, 0.0])
    for n, axis in enumerate(axes):
        ahead = axis if np.dot(at, axis) >= 0 else -axis
        half = np.append(1.0 + np.dot(at, ahead), np.cross(at, ahead))
        here = quat.normalize(quat.multiply(half / np.linalg.norm(half), here))
        at = ahead
        found[n] = here
    return found


def _looks(start: float, end: float, keyed: Sequence[float], rate_hz: float) -> Array:
    """Times at a rate, and those of the keys in the place of the nearest ones, so that no two are very close."""
    end = max(end, start + 3.0 / rate_hz)
    count = int(np.ceil((end - start) * min(rate_hz, 5000.0))) + 1
    times = np.linspace(start, end, count)
    if len(keyed):
        at = np.asarray(keyed, np.float64)
        times[np.clip(np.rint((at - start) / (end - start) * (count - 1)).astype(np.intp), 0, count - 1)] = at
    return times


def _key_times(times: Array, impacts: Array, rate_hz: float) -> Array:
    """The first and last time, frames and impacts."""
    frames = np.arange(np.ceil(times[0] * rate_hz - 1e-6), np.floor(times[-1] * rate_hz + 1e-6) + 1) / rate_hz
    wanted = np.unique(np.clip(np.concatenate([[times[0], times[-1]], frames, impacts]), times[0], times[-1]))
    return wanted[np.concatenate([[True], np.diff(wanted) > 1e-6])]


def _cubic(times: Array, logs: Array, slopes: Array, at: Array) -> tuple[Array, Array]:
    """The smooth curve through logarithms (T, 3) with slopes, and its slope, at times (N,)."""
    k = np.clip(np.searchsorted(times, at, side="right") - 1, 0, len(times) - 2)
    span = times[k + 1] - times[k]
    parts = logs[k], slopes[k], logs[k + 1], slopes[k + 1], (at - times[k]) / span, span
    return spline.hermite(*parts), spline.hermite_derivative(*parts)


def _refined(times: Array, logs: Array, slopes: Array, at: Array) -> Array:
    """More key times, until the product of the three scales keeps within the tolerance between all of them."""
    u = np.linspace(0, 1, 34)[1:-1, None]
    for _ in range(30):
        log_scale, slope = _cubic(times, logs, slopes, at)
        scale = np.exp(log_scale)
        rate = scale * slope
        between = spline.hermite(scale[:-1], rate[:-1], scale[1:], rate[1:], u, np.diff(at))
        off = np.abs(np.prod(between, axis=-1) - 1).max(axis=0) > 0.8 * VOLUME_TOLERANCE
        if not np.any(off):
            break
        at = np.sort(np.concatenate([at, 0.5 * (at[:-1] + at[1:])[off]]))
    return at


def _first(joints: tuple[str, ...], skeleton: Skeleton) -> str:
    if not joints:
        raise UnknownName("joint with keys", "", skeleton.names)
    return joints[0]


def _below(skeleton: Skeleton, joint: int, name: str) -> str:
    """The name of a joint below another whose own name is or ends with a word, else nothing."""
    inside = {joint}
    for j, parent in enumerate(skeleton.parents):
        if int(parent) in inside:
            inside.add(j)
            if skeleton.names[j].casefold().endswith(name.casefold()):
                return skeleton.names[j]
    return ""
