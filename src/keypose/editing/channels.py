"""Channels taken apart and put together: single components, and Euler angles for quaternions and back."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from keypose.arrays import Array
from keypose.editing.keys import insert_keys
from keypose.editing.modes import set_interpolation
from keypose.editing.tangents import with_handles, with_tangents, with_types
from keypose.errors import ShapeError, UnknownName
from keypose.evaluate import plain_clip, sample_clip, sample_curve
from keypose.math import euler, quat
from keypose.model import (
    EULER_ORDER,
    Channel,
    Clip,
    Curve,
    CurveKind,
    Interpolation,
    Property,
    Skeleton,
)

_SIDES = ("in_tangents", "out_tangents", "in_handles", "out_handles")


def separate_components(clip: Clip, target: str, property: Property) -> Clip:
    """The clip with one curve for each component of a channel in place of the whole; nothing moves.

    Raises: UnknownName where the clip has no such channel; ShapeError for rotations, which have no single components (but
        Euler angles do: see `to_euler`), and for weights.
    """
    curve = clip.curve(target, property)
    if property in (Property.ROTATION, Property.WEIGHT) or curve.values.shape[1] > 3:
        raise ShapeError(f"{target}.{property.value}: it has no single components; make a rotation Euler angles first")
    curves: dict[Channel, Curve] = {}
    for channel, old in clip.curves.items():
        if channel != Channel(target, property):
            curves[channel] = old
            continue
        for c in range(old.values.shape[1]):
            own = Channel(target, property, c)
            if own not in clip.curves:  # one that was there already drove its component before, too
                curves[own] = component_of(old, c)
    return replace(clip, curves=curves)


def component_of(curve: Curve, component: int) -> Curve:
    """One component of a curve as a scalar curve with the same keys, sides and extrapolation."""
    sides = {n: None if (a := getattr(curve, n)) is None else a[:, component : component + 1] for n in _SIDES}
    values = curve.values[:, component : component + 1]
    return replace(curve, values=values, kind=CurveKind.SCALAR, **sides)


def join_components(clip: Clip, skeleton: Skeleton, target: str, property: Property) -> tuple[Clip, float]:
    """The clip with one whole curve in place of curves of single components, and how far it is from them at most.

    Exact to rounding: each curve gets the keys of the others, and where their interpolations differ all become Bezier. Only
    where one goes in steps beside others, or they go on differently beyond their keys, is a plain curve fitted
    (`keypose.evaluate.plain_clip`). A component that no curve drives stays where it rests in the skeleton.

    Raises: UnknownName where no curve drives a single component of the channel.
    """
    own = Channel(target, property)
    parts = {c: v for c, v in clip.curves.items() if c.target == target and c.property is property}
    if all(c.component is None for c in parts):
        known = [str(c) for c in clip.curves if c.component is not None]
        raise UnknownName("channel of single components", str(own), known)
    joined, error = _joined(clip, skeleton, own, parts)
    curves: dict[Channel, Curve] = {}
    for channel, curve in clip.curves.items():
        if channel not in parts:
            curves[channel] = curve
        elif own not in curves:
            curves[own] = joined
    return replace(clip, curves=curves), error


def to_euler(
    clip: Clip, skeleton: Skeleton, joint: str, order: str = EULER_ORDER, rate_hz: float | None = None
) -> tuple[Clip, float]:
    """The clip with a joint's rotation as Euler angles, and the largest angle in radians between both.

    Angles are keyed, straight between keys and unrolled, at the joint's keys and at all frames of ``rate_hz`` (the clip's, else
    25); with a rate of 0 at the keys alone.

    Raises: UnknownName where the clip does not turn the joint by quaternions, or for an order that does not exist.
    """
    old = clip.curve(joint, Property.ROTATION)
    if order not in euler.CONVENTIONS:
        raise UnknownName("Euler order", order, euler.CONVENTIONS)
    rate = (clip.rate_hz or 25.0) if rate_hz is None else float(rate_hz)
    keys = old.times_s
    times = keys
    if rate > 0:
        frames = np.arange(np.ceil(keys[0] * rate - 1e-6), np.floor(keys[-1] * rate + 1e-6) + 1) / rate
        right = np.clip(np.searchsorted(keys, frames), 0, len(keys) - 1)
        near = np.minimum(np.abs(keys[right] - frames), np.abs(keys[np.maximum(right - 1, 0)] - frames))
        times = np.sort(np.concatenate([keys, frames[near > 1e-6]]))
    values = np.asarray(sample_curve(old, times), np.float64)
    angles = euler.unroll(euler.from_quat(values, order), order) if len(times) > 1 else euler.from_quat(values, order)
    own = np.clip(np.searchsorted(keys, times, side="right") - 1, 0, len(keys) - 1)
    stepping = np.asarray(old.modes)[own] == Interpolation.STEP
    modes = np.where(stepping, Interpolation.STEP, Interpolation.LINEAR)
    curve = Curve(times, angles, modes, kind=CurveKind.EULER, before=old.before, after=old.after)
    error = 0.0
    between = (times[:-1, None] + np.diff(times)[:, None] * (np.arange(8) + 0.5) / 8).ravel()
    if len(between):
        turned = euler.to_quat(sample_curve(curve, between), order)
        error = float(np.max(quat.angle_between(turned, np.asarray(sample_curve(old, between), np.float64))))
    curves = {
        Channel(joint, Property.EULER) if c == Channel(joint, Property.ROTATION) else c: v
        for c, v in clip.curves.items()
    }
    curves[Channel(joint, Property.EULER)] = curve
    return replace(clip, curves=curves, euler_orders={**clip.euler_orders, joint: order}), error


def to_rotations(clip: Clip, skeleton: Skeleton, joint: str, tolerance: float = 1e-4) -> tuple[Clip, float]:
    """The clip with a joint's Euler angles as one rotation curve, and the largest angle in radians between both.

    Raises: UnknownName where the clip has no Euler angles of the joint; ShapeError where the tolerance is not positive.
    """
    parts = {c: v for c, v in clip.curves.items() if c.target == joint and c.property is Property.EULER}
    if not parts:
        known = list(dict.fromkeys(c.target for c in clip.curves if c.property is Property.EULER))
        raise UnknownName("joint with Euler angles", joint, known)
    plain = plain_clip(Clip(parts, clip.name, euler_orders=clip.euler_orders), skeleton, tolerance)
    own = Channel(joint, Property.ROTATION)
    curves = {c: v for c, v in clip.curves.items() if c not in parts} | {own: plain.clip.curves[own]}
    orders = {name: order for name, order in clip.euler_orders.items() if name != joint}
    return replace(clip, curves=curves, euler_orders=orders), plain.error


# --- parts ------------------------------------------------------------------------------------------------------------


def _joined(clip: Clip, skeleton: Skeleton, own: Channel, parts: dict[Channel, Curve]) -> tuple[Curve, float]:
    whole = parts.get(own)
    kind = CurveKind.EULER if own.property is Property.EULER else CurveKind.VECTOR
    start = min(float(c.times_s[0]) for c in parts.values())
    rest = _at_rest(clip, skeleton, own, start)
    curves = [parts.get(Channel(own.target, own.property, c)) for c in range(3)]
    curves = [
        (component_of(whole, c) if whole is not None else _still(start, rest[c])) if curve is None else curve
        for c, curve in enumerate(curves)
    ]
    moving = [c for c in curves if c.key_count > 1] or curves
    ends = {(float(c.times_s[0]), float(c.times_s[-1]), c.before, c.after) for c in moving}
    if len(ends) == 1:
        joined = _stacked(curves, moving[0], kind)
        if joined is not None:
            return joined, 0.0
    plain = plain_clip(Clip(parts, clip.name, euler_orders=clip.euler_orders), skeleton)
    if own.property is not Property.EULER:
        return plain.clip.curves[own], plain.error
    turned = Clip(plain.clip.curves, clip.name, clip.rate_hz)
    order = clip.euler_orders.get(own.target, EULER_ORDER)
    angles, error = to_euler(turned, skeleton, own.target, order)
    return angles.curves[own], plain.error + error


def _still(time_s: float, value: float) -> Curve:
    return Curve([time_s], [[value]], Interpolation.LINEAR, kind=CurveKind.SCALAR)


def _at_rest(clip: Clip, skeleton: Skeleton, own: Channel, time_s: float) -> Array:
    if own.target not in skeleton.names:
        return np.ones(3) if own.property is Property.SCALE else np.zeros(3)
    row = skeleton.index(own.target)
    pose = sample_clip(Clip(), skeleton, time_s)
    if own.property is Property.EULER:
        return np.asarray(euler.from_quat(pose.rotations[row], clip.euler_orders.get(own.target, EULER_ORDER)))
    return np.asarray(pose.translations[row] if own.property is Property.TRANSLATION else pose.scales[row])


def _stacked(curves: list[Curve], model: Curve, kind: CurveKind) -> Curve | None:
    """Curves of one component side by side, with the keys of all; None where steps go beside other spans."""
    times = np.unique(np.concatenate([c.times_s for c in curves if c.key_count > 1] or [model.times_s]))
    filled: list[Curve] = []
    for curve in curves:
        if curve.key_count == 1:
            values = np.repeat(np.asarray(curve.values), len(times), axis=0)
            filled.append(Curve(times, values, Interpolation.LINEAR, kind=CurveKind.SCALAR))
            continue
        filled.append(insert_keys(curve, times).curve)
    if len({c.key_count for c in filled}) > 1:  # handles that overlap asked for keys of their own
        times = np.unique(np.concatenate([c.times_s for c in filled]))
        filled = [insert_keys(c, times).curve for c in filled]
        if len({c.key_count for c in filled}) > 1:
            return None
    modes = np.stack([np.asarray(c.modes) for c in filled])
    constant = np.array([len(np.unique(np.asarray(c.values))) == 1 for c in filled])
    differ = np.any(modes != modes[0], axis=0)
    differ[-1] = False
    steps = modes == Interpolation.STEP
    modes = np.where(constant[:, None] & steps.any(axis=0), Interpolation.STEP, modes)
    differ = np.any(modes != modes[0], axis=0)
    differ[-1] = False
    if np.any(differ & (modes == Interpolation.STEP).any(axis=0)):
        return None
    spans = np.nonzero(differ)[0]
    made: list[Curve] = []
    for curve, own in zip(filled, modes, strict=True):
        even = replace(curve, modes=own.astype(np.uint8)) if not np.array_equal(own, curve.modes) else curve
        if len(spans):
            even = set_interpolation(_pinned(even), spans, Interpolation.BEZIER).curve
        made.append(even)
    fields: dict[str, Any] = {}
    for names, make in ((_SIDES[:2], with_tangents), (_SIDES[2:], with_handles), (("tangent_types",), with_types)):
        if any(getattr(c, names[0]) is not None for c in made):
            made = [make(c) for c in made]
    for name in _SIDES:
        sides = [getattr(c, name) for c in made]
        fields[name] = None if sides[0] is None else np.concatenate(sides, axis=1)
    types = [c.tangent_types for c in made]
    if types[0] is not None:
        same = np.all([np.array_equal(t, types[0]) for t in types])
        fields["tangent_types"] = types[0] if same else np.zeros_like(types[0])
    values = np.concatenate([np.asarray(c.values) for c in made], axis=1)
    return replace(
        model, times_s=made[0].times_s, values=values, modes=made[0].modes, kind=kind,
        **{"tangent_types": None, **fields},
    )  # fmt: skip


def _pinned(curve: Curve) -> Curve:
    """The curve with sides that nothing moves: handles of its lines along their chords, all types FREE."""
    return replace(with_handles(curve), tangent_types=None)
