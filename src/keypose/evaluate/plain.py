"""Clips in the plain form that every format and player knows: whole channels in steps, lines and Hermite cubics."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from keypose.arrays import Array
from keypose.errors import ShapeError
from keypose.evaluate.curves import sample_curve
from keypose.evaluate.matching import match_report
from keypose.evaluate.sampling import sample_clip
from keypose.math import quat
from keypose.model import (
    EULER_ORDER,
    Channel,
    Clip,
    Curve,
    CurveKind,
    Extrapolation,
    Interpolation,
    Pose,
    Property,
    Skeleton,
)

TOLERANCE = 1e-5
"""Metres, radians or ratios that a curve may be off where it cannot be exact."""

_MOST_HALVINGS = 32
_SHORTEST_S = 1e-6
_MOST_CYCLES = 1000
# Places in a span that are compared; a third and two thirds are exact.
_LOOKED_AT = np.array([0.02, 0.1, 0.2, 0.45, 0.5, 0.55, 0.8, 0.9, 0.98])
_OF_ANGLES = (Extrapolation.LINEAR, Extrapolation.CYCLE_OFFSET)  # other of angles than of rotations
_ENDLESS = (Extrapolation.CYCLE, Extrapolation.CYCLE_OFFSET, Extrapolation.PING_PONG)


@dataclass(frozen=True, slots=True, eq=False)
class PlainClip:
    """A plain clip and how far it is from the one it was made of.

    ``error`` is the largest distance within the keys, in metres, radians or ratios; 0 where nothing was converted.
    ``converted`` counts the channels that were, ``notes`` say what a plain clip cannot hold.
    """

    clip: Clip
    error: float
    converted: int
    notes: tuple[str, ...] = ()


def is_plain(clip: Clip) -> bool:
    """Whether a clip has whole channels of poses and weights alone, in STEP, LINEAR and HERMITE."""
    return all(_is_plain(channel, curve) for channel, curve in clip.curves.items())


def plain_clip(clip: Clip, skeleton: Skeleton, tolerance: float = TOLERANCE) -> PlainClip:
    """The clip with whole translation, rotation, scale and weight channels in STEP, LINEAR and HERMITE alone.

    Bezier spans whose handles have a third of the span, and single components that share keys and modes, are exact to
    rounding; other Bezier spans, Euler angles and splines on the sphere become Hermite spans, halved until they stay within
    ``tolerance`` (metres, radians, ratios). Curves that are plain stay the same objects. Named values are left out and
    noted. ``skeleton`` gives what its joints rest at, matched by name.

    Raises:
        ShapeError: where the tolerance is not positive or a curve has the wrong number of components.
    """
    if not (np.isfinite(tolerance) and tolerance > 0):
        raise ShapeError(f"tolerance: expected more than 0, got {tolerance}")
    if is_plain(clip):
        return PlainClip(clip, 0.0, 0)
    sources = match_report(clip, skeleton).sources
    at_rest = {other: (skeleton.index(own), skeleton) for own, other in sources.items()}
    notes: list[str] = []
    values = dict.fromkeys(c.target for c in clip.curves if c.property is Property.VALUE)
    if values:
        notes.append(f"clip '{clip.name}': {len(values)} named values, such as '{next(iter(values))}', have no place")
    whole: dict[tuple[str, Property], dict[Channel, Curve]] = {}
    for channel, curve in clip.curves.items():
        if channel.property is not Property.VALUE:
            drives = Property.ROTATION if channel.property is Property.EULER else channel.property
            whole.setdefault((channel.target, drives), {})[channel] = curve
    curves: dict[Channel, Curve] = {}
    worst, converted = 0.0, 0
    for (target, property), parts in whole.items():
        own = Channel(target, property)
        if len(parts) == 1 and own in parts and _is_plain(own, parts[own]):
            curves[own] = parts[own]
            continue
        converted += 1
        joint, known = at_rest.get(target, (0, None))
        curves[own], error = _converted(clip, own, parts, joint, known, tolerance, notes)
        worst = max(worst, error)
    return PlainClip(replace(clip, curves=curves, euler_orders={}), worst, converted, tuple(dict.fromkeys(notes)))


def _is_plain(channel: Channel, curve: Curve) -> bool:
    if channel.component is not None or channel.property in (Property.EULER, Property.VALUE):
        return False
    return bool(np.all(curve.modes[: max(curve.key_count - 1, 1)] <= Interpolation.HERMITE))


def _converted(
    clip: Clip,
    own: Channel,
    parts: Mapping[Channel, Curve],
    joint: int,
    skeleton: Skeleton | None,
    tolerance: float,
    notes: list[str],
) -> tuple[Curve, float]:
    """One whole channel of curves that drive it together, and its error."""
    rotation = own.property is Property.ROTATION
    kind = CurveKind.ROTATION if rotation else CurveKind.SCALAR if own.property is Property.WEIGHT else CurveKind.VECTOR
    at = _sampler(clip, own, parts, joint, skeleton)
    start = min(float(c.times_s[0]) for c in parts.values())
    end = max(float(c.times_s[-1]) for c in parts.values())
    before = _one_rule([(c.before, float(c.times_s[0]) == start or c.key_count == 1) for c in parts.values()])
    after = _one_rule([(c.after, float(c.times_s[-1]) == end or c.key_count == 1) for c in parts.values()])
    turns = any(c.property is Property.EULER for c in parts)
    other = [rule is None or (turns and rule in _OF_ANGLES) for rule in (before, after)]
    if any(other):
        notes.append(f"clip '{clip.name}': beyond its keys '{own}' goes on in another way")
    rules = {"before": before or Extrapolation.HOLD, "after": after or Extrapolation.HOLD}
    times = _breaks(parts.values(), start, end)
    if len(times) == 1:
        return Curve(times, at(times), Interpolation.STEP, kind=kind, **rules), 0.0
    modes, jumps = _piece_modes(parts, times, rotation)
    fit = _fitted(at, times[:-1], times[1:], modes, jumps, rotation, tolerance)
    return _assembled(fit, at, kind, rules), fit.error


def _sampler(
    clip: Clip, own: Channel, parts: Mapping[Channel, Curve], joint: int, skeleton: Skeleton | None
) -> Callable[[Array], Array]:
    """The whole channel's values (T, C) in double precision at times (T,)."""
    if len(parts) == 1 and own in parts:
        curve = parts[own]
        return lambda times: np.asarray(sample_curve(curve, times), np.float64)
    zero, one = np.zeros((1, 3)), np.ones((1, 3))
    rest = Pose(zero, np.array([[1.0, 0, 0, 0]]), one)
    if skeleton is not None:
        r = skeleton.rest
        rest = Pose(*(np.asarray(a, np.float64)[joint : joint + 1] for a in (r.translations, r.rotations, r.scales)))
    alone = Skeleton((own.target,), np.array([-1]), rest)
    order = clip.euler_orders.get(own.target, EULER_ORDER)
    small = Clip(dict(parts), euler_orders={own.target: order})
    field = {Property.TRANSLATION: "translations", Property.ROTATION: "rotations", Property.SCALE: "scales"}

    def at(times: Array) -> Array:
        return np.asarray(getattr(sample_clip(small, alone, times), field[own.property])[..., 0, :], np.float64)

    return at


def _one_rule(rules: Sequence[tuple[Extrapolation, bool]]) -> Extrapolation | None:
    """The rule by which all curves go on together; None where each has its own way. Constants go along with all."""
    if len({rule for rule, _ in rules}) == 1 and (rules[0][0] is Extrapolation.HOLD or all(last for _, last in rules)):
        return rules[0][0]
    return None


def _breaks(curves: Any, start: float, end: float) -> Array:
    """Times of all keys between start and end, also where curves come round again."""
    found = [np.array([start, end])]
    for curve in curves:
        keys = curve.times_s
        first, last = float(keys[0]), float(keys[-1])
        found.append(keys)
        length = last - first
        if length <= 0:
            continue
        for rule, gap, sign in ((curve.before, first - start, -1), (curve.after, end - last, 1)):
            if gap > 0 and rule in _ENDLESS:
                for cycle in range(1, min(int(gap / length) + 1, _MOST_CYCLES) + 1):
                    mirrored = rule is Extrapolation.PING_PONG and cycle % 2 == 1
                    found.append((first + last - keys[::-1] if mirrored else keys) + sign * cycle * length)
    times = np.unique(np.concatenate(found))
    times = times[(times >= start) & (times <= end)]
    # Keys come round beside others by rounding alone.
    near = np.diff(times) < 1e-9 * max(1.0, abs(start), abs(end))
    return times[~np.concatenate([[False], near])] if len(times) > 1 else times


def _piece_modes(parts: Mapping[Channel, Curve], times: Array, rotation: bool) -> tuple[Array, Array]:
    """STEP or LINEAR where all curves of a piece are, else HERMITE; and whether the value may jump at its end."""
    modes: list[Array] = []
    jumps = np.zeros(len(times) - 1, bool)
    for channel, curve in parts.items():
        keys = curve.times_s
        own = curve.modes[np.clip(np.searchsorted(keys, times[:-1], side="right") - 1, 0, len(keys) - 1)].astype(int)
        if rotation and channel.property is Property.EULER:
            own = np.where(own == Interpolation.LINEAR, Interpolation.HERMITE, own)  # of angles, not of rotations
        outside = (times[:-1] < keys[0]) | (times[:-1] >= keys[-1])
        holds = len(keys) == 1 or curve.before is curve.after is Extrapolation.HOLD
        jumps |= (own == Interpolation.STEP) | (outside & (curve.before in _ENDLESS or curve.after in _ENDLESS))
        modes.append(np.where(outside, -1 if holds else Interpolation.HERMITE, own))
    table = np.stack(modes)
    highest = table.max(axis=0)
    # What holds still goes along with lines; steps go with nothing but steps.
    stepping = np.all((table == Interpolation.STEP) | (table == -1), axis=0)
    straight = np.all((table == Interpolation.LINEAR) | (table == -1), axis=0) & (highest >= 0)
    merged = np.where(stepping, Interpolation.STEP, np.where(straight, Interpolation.LINEAR, Interpolation.HERMITE))
    return merged, jumps


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """Spans (N,), in order: their times, values at both ends (N, C), changes of the tangents over a span, and modes."""

    starts: Array
    ends: Array
    first: Array
    last: Array
    leaving: Array
    arriving: Array
    modes: Array
    jumps: Array
    error: float


def _fitted(
    at: Callable[[Array], Array],
    starts: Array,
    ends: Array,
    modes: Array,
    jumps: Array,
    rotation: bool,
    tolerance: float,
) -> _Fit:
    """Hermite spans through the curve's values at both ends, a third and two thirds; halved where they stray between."""
    done: list[tuple[Array, ...]] = []
    worst = 0.0
    for halving in range(_MOST_HALVINGS + 1):
        # Where a curve jumps at the end of a span, its last value there is the one just before.
        edges = np.where(jumps, np.nextafter(ends, -np.inf), ends)
        inner = np.concatenate([[0.0, 1 / 3, 2 / 3], _LOOKED_AT])
        times = np.concatenate([starts[:, None] + inner * (ends - starts)[:, None], edges[:, None]], axis=1)
        times = np.minimum(times, edges[:, None])
        values = at(times.ravel()).reshape(*times.shape, -1)
        if rotation:
            values = quat.align_signs(values, axis=1)
        first, last = values[:, 0], values[:, -1]
        rise = last - first

        def blend(u: Any, a: Array = first, b: Array = last) -> Array:
            w = u * u * (3 - 2 * u)
            return (1 - w) * a + w * b

        r1, r2 = values[:, 1] - blend(1 / 3), values[:, 2] - blend(2 / 3)
        leaving, arriving = 9 * r1 - 4.5 * r2, 4.5 * r1 - 9 * r2
        u = _LOOKED_AT[None, :, None]
        steps, straight = (modes == int(m) for m in (Interpolation.STEP, Interpolation.LINEAR))
        bent = blend(u, first[:, None], last[:, None]) + u * (1 - u) * (
            (1 - u) * leaving[:, None] - u * arriving[:, None]
        )
        lines = first[:, None] + u * rise[:, None]
        if rotation:
            bent = quat.normalize(bent)
            lines = quat.slerp(
                first[:, None], last[:, None], np.broadcast_to(_LOOKED_AT, (len(first), len(_LOOKED_AT)))
            )
        have = np.where(steps[:, None, None], first[:, None], np.where(straight[:, None, None], lines, bent))
        want = values[:, 3:-1]
        off = quat.angle_between(have, want) if rotation else np.max(np.abs(have - want), axis=-1)
        error = np.max(off, axis=1)
        good = (error <= tolerance) | (halving == _MOST_HALVINGS) | (ends - starts < _SHORTEST_S)
        worst = max(worst, float(error[good].max(initial=0.0)))
        done.append(tuple(a[good] for a in (starts, ends, first, last, leaving, arriving, modes, jumps)))
        if np.all(good):
            break
        a, b, m = starts[~good], ends[~good], modes[~good]
        middle = 0.5 * (a + b)
        starts, ends, modes = np.concatenate([a, middle]), np.concatenate([middle, b]), np.concatenate([m, m])
        jumps = np.concatenate([np.zeros(len(a), bool), jumps[~good]])
    columns = [np.concatenate(c) for c in zip(*done, strict=True)]
    order = np.argsort(columns[0], kind="stable")
    starts, ends, first, last, leaving, arriving, modes, jumps = (c[order] for c in columns)
    return _Fit(starts, ends, first, last, leaving, arriving, modes, jumps, worst)


def _assembled(fit: _Fit, at: Callable[[Array], Array], kind: CurveKind, rules: Mapping[str, Extrapolation]) -> Curve:
    """The spans as one curve; where it jumps, a key just before the jump."""
    following = np.concatenate([fit.first[1:], at(fit.ends[-1:])])
    # Rotations of one span are on one side of the sphere; its neighbour may be on the other.
    if kind is CurveKind.ROTATION:
        same = np.minimum(np.abs(fit.last - following).max(axis=1), np.abs(fit.last + following).max(axis=1))
    else:
        same = np.abs(fit.last - following).max(axis=1)
    spans = fit.ends - fit.starts
    jumps = fit.jumps & (same > 1e-6) & (fit.modes != Interpolation.STEP)
    gap = np.minimum(np.abs(fit.ends) * 2.0**-22 + 1e-6, 0.25 * spans)
    keys: list[tuple[Array, ...]] = []
    none = np.zeros(fit.first.shape[1])
    entering, side = none, 1.0
    for n in range(len(spans)):
        leaving, arriving = fit.leaving[n] / spans[n], fit.arriving[n] / spans[n]
        keys.append((fit.starts[n], side * fit.first[n], entering, side * leaving, fit.modes[n]))
        entering = side * arriving
        if jumps[n]:
            keys.append((fit.ends[n] - gap[n], side * fit.last[n], entering, none, int(Interpolation.STEP)))
            entering = none
        if kind is CurveKind.ROTATION and np.dot(side * fit.last[n], following[n]) < 0:
            side = -1.0
        else:
            side = 1.0
    keys.append((fit.ends[-1], side * following[-1], entering, none, int(Interpolation.LINEAR)))
    times, values, ins, outs, modes = (np.array(column) for column in zip(*keys, strict=True))
    tangents = (ins, outs) if np.any(modes == Interpolation.HERMITE) else (None, None)
    return Curve(times, values, modes.astype(np.uint8), *tangents, kind, **rules)
