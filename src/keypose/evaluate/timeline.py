"""Timelines at any times: placements in their own time, composed to layers, and layers over each other.

Inside a layer a placement lies over the earlier ones by its weight, so that a fade-in over a held pose is a crossfade.
A layer then moves only what its animations drive: REPLACE goes from what lies below towards the layer's value (lerp, and
slerp the short way), ADD composes ``previous * (value relative to rest) ^ influence`` joint by joint.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np

from keypose.arrays import Array, as_float, checked, namespace, unified
from keypose.errors import ShapeError, UnknownName
from keypose.evaluate.curves import sample_curve
from keypose.evaluate.matching import match, match_report
from keypose.evaluate.sampling import sample_clip, sample_morphs, sample_motion, sample_value
from keypose.math import ease, quat
from keypose.model import (
    Clip,
    Curve,
    Layer,
    LayerMode,
    Motion,
    Placement,
    Pose,
    Property,
    Skeleton,
    Timeline,
)

Animations = Mapping[str, Clip | Motion]

# A frame number computed from a time may miss it by rounding.
_FRAME_SLACK = 1e-6

_ROTATIONS = (Property.ROTATION, Property.EULER)


def sample_timeline(timeline: Timeline, animations: Animations, skeleton: Skeleton, times_s: Any) -> Pose:
    """The skeleton's local pose at times of any shape; what no layer drives stays at rest.

    Shapes and units: ``times_s`` (*B,) seconds of the timeline (it goes on beyond its start and end); returns a pose of
    batch shape (*B,). ``animations`` holds every animation that a placement names; they are matched to the skeleton by
    name as in `match`.

    Raises:
        ShapeError: where a time is not finite.
        UnknownName: where a placement names no animation.

    Source: lecture notes, "Rotations" (addition of rotations is multiplication, scaling scales the angle).
    """
    times = exposed_times(timeline, times_s)
    fields = _rest_fields(skeleton)
    for layer in _audible(timeline):
        drive = _layer_drive(layer, animations, skeleton, times)
        fields = [_joined(f, layer.mode, drive[f.name]) for f in fields] if drive else fields
    t, r, s = (_over(times, f.value, f.rest) for f in fields)
    return Pose(t, r, s)


def sample_timeline_morphs(
    timeline: Timeline, animations: Animations, morph_names: Sequence[str], times_s: Any, rest: Array | None = None
) -> Array:
    """Morph weights at times of any shape; what no layer drives stays at ``rest`` (zeros if not given).

    Shapes: ``times_s`` (*B,), ``morph_names`` M names, ``rest`` (M,); returns (*B, M). An ADD layer adds its weights.

    Raises:
        ShapeError: where a time is not finite or rest has another length.
        UnknownName: where a placement names no animation.
    """
    base: Array = np.zeros(len(morph_names), np.float32) if rest is None else as_float(rest)
    checked(base, (len(morph_names),), "rest", "morph_names")
    return _sample_numbers(timeline, animations, Property.WEIGHT, morph_names, times_s, base)


def sample_timeline_values(
    timeline: Timeline, animations: Animations, names: Sequence[str], times_s: Any, rest: Array
) -> Array:
    """Named numbers (`Property.VALUE` channels of one component) at times of any shape; what no layer drives is at ``rest``.

    Shapes: ``times_s`` (*B,), ``names`` M names, ``rest`` (M,); returns (*B, M) float64. An ADD layer adds how far its value
    is from rest. Values of several components, such as colours, count as not driven.

    Raises:
        ShapeError: where a time is not finite or rest has another length.
        UnknownName: where a placement names no animation.
    """
    base: Array = np.asarray(rest, np.float64)
    checked(base, (len(names),), "rest", "names")
    return _sample_numbers(timeline, animations, Property.VALUE, names, times_s, base)


def bake_timeline(
    timeline: Timeline,
    animations: Animations,
    skeleton: Skeleton,
    rate_hz: float | None = None,
    morph_names: Sequence[str] = (),
    rest_morph_weights: Array | None = None,
) -> Motion:
    """The timeline from its start to its end as a motion at its own rate, or at ``rate_hz``.

    Raises:
        ShapeError: where the rate is not positive.
        UnknownName: where a placement names no animation.
    """
    rate = timeline.rate_hz if rate_hz is None else float(rate_hz)
    if not (math.isfinite(rate) and rate > 0):
        raise ShapeError(f"rate_hz: expected more than 0, got {rate}")
    count = math.floor((timeline.end_s - timeline.start_s) * rate + _FRAME_SLACK) + 1
    times = timeline.start_s + np.arange(count) / rate
    weights = None
    if morph_names:
        weights = sample_timeline_morphs(timeline, animations, morph_names, times, rest_morph_weights)
    return Motion(
        skeleton.names,
        sample_timeline(timeline, animations, skeleton, times),
        rate,
        name=timeline.name,
        start_s=timeline.start_s,
        morph_names=tuple(morph_names),
        morph_weights=weights,
    )


@dataclass(frozen=True, slots=True, eq=False)
class KeyedValue:
    """What to key on a layer, and where it can bring about the pose that was asked for.

    Shapes: ``reachable`` (J, 3): translation, rotation and scale of each joint; False where the layer has no influence or
    another one above hides it.
    """

    pose: Pose
    reachable: Array


def value_for_result(
    timeline: Timeline, animations: Animations, skeleton: Skeleton, layer: str, time_s: float, pose: Pose
) -> KeyedValue:
    """The pose that a layer must give at a time so that the whole timeline gives ``pose``; how auto-key finds its values.

    The layer's influence is that of its placement which is active last, as if it drove every joint. ``pose`` has no batch.

    Raises:
        UnknownName: where there is no such layer, or a placement names no animation.
    """
    timeline.layer(layer)
    times = exposed_times(timeline, time_s)
    fields = _rest_fields(skeleton)
    below, above, own = fields, list[tuple[Layer, dict[str, _Drive]]](), None
    for candidate in timeline.layers:
        if candidate.name == layer:
            own = candidate
        elif candidate in _audible(timeline):
            drive = _layer_drive(candidate, animations, skeleton, times)
            if not drive:
                continue
            if own is None:
                below = [_joined(f, candidate.mode, drive[f.name]) for f in below]
            else:
                above.append((candidate, drive))
    if own is None:
        raise UnknownName("layer", layer, [known.name for known in timeline.layers])
    wanted = [pose.translations, pose.rotations, pose.scales]
    found, reachable = list[Array](), list[Array]()
    weight = _last_weight(own, animations, times) * _influence(own, times)
    share = _shares(own, skeleton.names)
    for f, under, result in zip(fields, below, wanted, strict=True):
        result, ok = as_float(result), np.ones((len(skeleton.names), 1), bool)
        for candidate, drive in reversed(above):
            result, possible = _without(f, candidate.mode, drive[f.name], result)
            ok &= np.all(possible, axis=-1, keepdims=True)
        allowed = 1.0 if own.properties is None or f.allowed_by(own.properties) else 0.0
        drive = _Drive(f.rest, np.asarray(weight)[..., None, None] * share * allowed)
        value, possible = _solved(f, own.mode, drive, under.value, result)
        found.append(value)
        reachable.append((ok & np.all(possible, axis=-1, keepdims=True))[:, 0])
    return KeyedValue(Pose(*found), np.stack(reachable, axis=1))


def exposed_times(timeline: Timeline, times_s: Any) -> Array:
    """Times as the exposure shows them: the start of the ``hold_frames`` that a time falls into, (*B,).

    Raises:
        ShapeError: where a time is not finite.
    """
    times = np.asarray(times_s, np.float64)
    if not np.all(np.isfinite(times)):
        raise ShapeError("times_s: expected finite numbers")
    if timeline.hold_frames == 0:
        return times
    step = timeline.hold_frames / timeline.rate_hz
    return timeline.start_s + np.floor((times - timeline.start_s) / step + _FRAME_SLACK) * step


def placement_duration(placement: Placement, animation: Clip | Motion) -> float:
    """Seconds of the timeline that a placement lasts."""
    if placement.time_warp is not None:
        return max(0.0, float(placement.time_warp.times_s[-1]))
    start, end = _part(placement, animation)
    return placement.cycles * (end - start) / abs(placement.speed)


def placement_times(placement: Placement, animation: Clip | Motion, times_s: Any) -> tuple[Array, Array]:
    """The animation's own times (*B,) and the placement's weights (*B,) at times (*B,) of the timeline.

    Before its start and after its end the first and last moment hold, or, at an end of the animation that is not cut off
    by ``in_s``, ``out_s`` or cycles, the animation goes on as its curves extrapolate. Without ``placement.hold`` the weight
    is 0 there. Fades are smoothsteps.
    """
    times = np.asarray(times_s, np.float64)
    duration = placement_duration(placement, animation)
    since = times - placement.start_s
    elapsed = np.clip(since, 0.0, duration)
    start, end = _part(placement, animation)
    length = end - start
    if placement.time_warp is not None:
        warped = sample_curve(placement.time_warp, elapsed)[..., 0]
        own = start + np.asarray(warped, np.float64)
    elif length == 0:
        own = np.full_like(elapsed, start)
    else:
        gone = elapsed * abs(placement.speed)
        # The end of the last cycle is the part's end, not the beginning of a further cycle.
        cycle = np.minimum(np.floor(gone / length), math.ceil(placement.cycles) - 1)
        into = np.clip(gone - cycle * length, 0.0, length)
        if placement.cycles == 1:
            backwards = placement.speed < 0
            first, last = (placement.out_s, placement.in_s) if backwards else (placement.in_s, placement.out_s)
            if first is None:
                into = into + np.minimum(since, 0.0) * abs(placement.speed)
            if last is None:
                into = into + np.maximum(since - duration, 0.0) * abs(placement.speed)
        own = start + into if placement.speed > 0 else end - into
    weight = np.ones_like(elapsed)
    if placement.weight is not None:
        weight = np.clip(np.asarray(sample_curve(placement.weight, elapsed)[..., 0], np.float64), 0.0, 1.0)
    if placement.fade_in_s > 0:
        weight = weight * ease.ease("smoothstep", np.clip(since / placement.fade_in_s, 0.0, 1.0))
    if placement.fade_out_s > 0:
        weight = weight * ease.ease("smoothstep", np.clip((duration - since) / placement.fade_out_s, 0.0, 1.0))
    if not placement.hold:
        weight = np.where((since < 0) | (since > duration), 0.0, weight)
    return own, weight


# --- layers -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Field:
    """Translations, rotations, scales or morph weights on their way through the layers: (*B, N, C) or, at first, (N, C)."""

    name: str
    rest: Array
    value: Array

    @property
    def is_rotation(self) -> bool:
        return self.name == "rotations"

    def allowed_by(self, properties: frozenset[Property]) -> bool:
        kinds = {"translations": (Property.TRANSLATION,), "rotations": _ROTATIONS, "scales": (Property.SCALE,)}
        return any(p in properties for p in kinds.get(self.name, (Property.WEIGHT,)))


@dataclass(frozen=True, slots=True)
class _Drive:
    """What a layer wants (*B, N, C) and how strongly, 0..1: (*B, N, C or 1)."""

    value: Array
    amount: Array


def _rest_fields(skeleton: Skeleton) -> list[_Field]:
    rest = skeleton.rest
    arrays = {"translations": rest.translations, "rotations": rest.rotations, "scales": rest.scales}
    return [_Field(name, array, array) for name, array in arrays.items()]


def _audible(timeline: Timeline) -> list[Layer]:
    layers = [layer for layer in timeline.layers if not layer.muted]
    solo = [layer for layer in layers if layer.solo]
    return solo or layers


def _animation(placement: Placement, animations: Animations) -> Clip | Motion:
    if placement.animation not in animations:
        raise UnknownName("animation", placement.animation, list(animations))
    return animations[placement.animation]


def _part(placement: Placement, animation: Clip | Motion) -> tuple[float, float]:
    end_s = animation.start_s + animation.duration_s
    start = animation.start_s if placement.in_s is None else placement.in_s
    end = end_s if placement.out_s is None else placement.out_s
    return start, max(start, end)


def _influence(layer: Layer, times: Array) -> Array:
    if isinstance(layer.influence, Curve):
        return np.clip(np.asarray(sample_curve(layer.influence, times)[..., 0], np.float64), 0.0, 1.0)
    return np.full(times.shape, float(layer.influence))


def _shares(layer: Layer, names: Sequence[str]) -> Array:
    if not layer.joints:
        return np.ones((len(names), 1))
    return np.array([[layer.joints.get(name, 0.0)] for name in names])


def _active(layer: Layer, animations: Animations, times: Array) -> list[tuple[Clip | Motion, Array, Array]]:
    """Animation, its own times and its weights, of the placements that have any say, earliest first."""
    placements = sorted((p for p in layer.placements if not p.muted), key=lambda p: p.start_s)
    found: list[tuple[Clip | Motion, Array, Array]] = []
    for n, placement in enumerate(placements):
        animation = _animation(placement, animations)
        own, weight = placement_times(placement, animation, times)
        if n > 0:  # only the first placement reaches back before its start
            weight = np.where(times < placement.start_s, 0.0, weight)
        if np.any(weight > 0):
            found.append((animation, own, weight))
    return found


def _last_weight(layer: Layer, animations: Animations, times: Array) -> Array:
    active = _active(layer, animations, times)
    return active[-1][2] if active else np.ones(times.shape)


def _layer_drive(layer: Layer, animations: Animations, skeleton: Skeleton, times: Array) -> dict[str, _Drive]:
    """What a layer wants of every field; empty where it has nothing to say."""
    drives: dict[str, _Drive] = {}
    rest = _rest_fields(skeleton)
    for animation, own, weight in _active(layer, animations, times):
        masks = _driven(animation, skeleton)
        if isinstance(animation, Motion):
            pose = sample_motion(match(animation, skeleton), own)
        else:
            pose = sample_clip(match(animation, skeleton), skeleton, own)
        values = {"translations": pose.translations, "rotations": pose.rotations, "scales": pose.scales}
        for field in rest:
            allowed = layer.properties is None or field.allowed_by(layer.properties)
            amount = weight[..., None, None] * masks[field.name] * (1.0 if allowed else 0.0)
            drives[field.name] = _laid_over(field, drives.get(field.name), _Drive(values[field.name], amount))
    scale = _influence(layer, times)[..., None, None] * _shares(layer, skeleton.names)
    return {name: _Drive(drive.value, drive.amount * scale) for name, drive in drives.items()}


def _sample_numbers(
    timeline: Timeline, animations: Animations, kind: Property, names: Sequence[str], times_s: Any, rest: Array
) -> Array:
    """Morph weights or values through the layers, (*B, M)."""
    times = exposed_times(timeline, times_s)
    field = _Field("morphs", rest[:, None], rest[:, None])
    for layer in _audible(timeline):
        drive = _layer_numbers(layer, animations, kind, names, rest, times)
        if drive is not None:
            field = _joined(field, layer.mode, drive)
    return _over(times, field.value, field.rest)[..., 0]


def _layer_numbers(
    layer: Layer, animations: Animations, kind: Property, names: Sequence[str], rest: Array, times: Array
) -> _Drive | None:
    if layer.properties is not None and kind not in layer.properties:
        return None
    field, drive = _Field("morphs", rest[:, None], rest[:, None]), None
    for animation, own, weight in _active(layer, animations, times):
        if isinstance(animation, Motion):
            driven = set(animation.morph_names) if kind is Property.WEIGHT else set[str]()
        else:
            single = {c: v for c, v in animation.curves.items() if c.property is kind and v.values.shape[1] == 1}
            driven = {c.target for c in single if c.component is None}
        mask = np.array([[1.0 if name in driven else 0.0] for name in names]).reshape(-1, 1)
        if kind is Property.WEIGHT:
            values = sample_morphs(animation, names, own, rest)[..., None]
        else:
            values = np.broadcast_to(rest[:, None], (*own.shape, len(names), 1)).copy()
            for n, name in enumerate(names):
                if name in driven and isinstance(animation, Clip):
                    values[..., n, :] = sample_value(animation, name, own)
        drive = _laid_over(field, drive, _Drive(values, weight[..., None, None] * mask))
    if drive is None:
        return None
    return _Drive(drive.value, drive.amount * _influence(layer, times)[..., None, None] * _shares(layer, names))


def _driven(animation: Clip | Motion, skeleton: Skeleton) -> dict[str, Array]:
    """1 where an animation drives a joint's translation (J, 3), rotation (J, 1), scale (J, 3), else 0."""
    sources = match_report(animation, skeleton).sources
    count = len(skeleton.names)
    masks = {"translations": np.zeros((count, 3)), "rotations": np.zeros((count, 1)), "scales": np.zeros((count, 3))}
    if isinstance(animation, Motion):
        for mask in masks.values():
            mask[[j for j, name in enumerate(skeleton.names) if name in sources]] = 1.0
        return masks
    joints = {sources[name]: j for j, name in enumerate(skeleton.names) if name in sources}
    for channel in animation.curves:
        joint = joints.get(channel.target)
        if joint is None or channel.property in (Property.WEIGHT, Property.VALUE):
            continue
        if channel.property in _ROTATIONS:
            masks["rotations"][joint] = 1.0
            continue
        name = "translations" if channel.property is Property.TRANSLATION else "scales"
        masks[name][joint, slice(None) if channel.component is None else channel.component] = 1.0
    return masks


# --- composition ------------------------------------------------------------------------------------------------------


def _laid_over(field: _Field, below: _Drive | None, top: _Drive) -> _Drive:
    """Two drives of one layer as one: the upper covers the lower by its amount."""
    if below is None:
        return top
    amount = top.amount + below.amount * (1.0 - top.amount)
    share = np.divide(top.amount, amount, out=np.zeros_like(amount), where=amount > 0)
    return _Drive(_mixed(field, below.value, top.value, share), amount)


def _joined(field: _Field, mode: LayerMode, drive: _Drive) -> _Field:
    """A field with one more layer over it."""
    if mode is LayerMode.REPLACE:
        value = _mixed(field, field.value, drive.value, drive.amount)
    else:
        value = _added(field, field.value, drive.value, drive.amount)
    return _Field(field.name, field.rest, value)


def _mixed(field: _Field, a: Array, b: Array, amount: Array) -> Array:
    """From a to b: exactly a where the amount is 0 and b where it is 1."""
    a, b, u, xp = _together(a, b, amount)
    if field.is_rotation:
        moved = quat.slerp(a, b, u[..., 0])
        return xp.where(u == 0, a, xp.where(u == 1, b, moved))
    d = b - a
    return xp.where(u < 0.5, a + u * d, b - (1.0 - u) * d)


def _added(field: _Field, previous: Array, value: Array, amount: Array) -> Array:
    previous, value, u, xp = _together(previous, value, amount)
    rest = _like(field.rest, value)
    if field.is_rotation:
        turn = quat.multiply(quat.conjugate(rest), value)
        return quat.normalize(quat.multiply(previous, quat.power(quat.shortest(turn), u[..., 0])))
    if field.name == "scales":
        return previous * (1.0 + u * (_ratio(xp, value, rest) - 1.0))
    return previous + u * (value - rest)


def _without(field: _Field, mode: LayerMode, drive: _Drive, result: Array) -> tuple[Array, Array]:
    """What must lie below a layer so that the result comes out above it, and where that is possible."""
    result, value, u, xp = _together(result, drive.value, drive.amount)
    if mode is LayerMode.ADD:
        rest = _like(field.rest, value)
        if field.is_rotation:
            turn = quat.power(quat.shortest(quat.multiply(quat.conjugate(rest), value)), u[..., 0])
            return quat.normalize(quat.multiply(result, quat.conjugate(turn))), np.ones(u.shape, bool)
        if field.name == "scales":
            factor = 1.0 + u * (_ratio(xp, value, rest) - 1.0)
            return xp.where(factor == 0, result, result / xp.where(factor == 0, 1.0, factor)), np.asarray(factor != 0)
        return result - u * (value - rest), np.ones(u.shape, bool)
    possible = np.asarray(u < 1)
    left = xp.where(u < 1, 1.0 - u, 1.0)
    if field.is_rotation:
        turn = quat.multiply(quat.conjugate(value), result)
        return quat.multiply(value, quat.power(quat.shortest(turn), 1.0 / left[..., 0])), possible
    return value + (result - value) / left, possible


def _solved(field: _Field, mode: LayerMode, drive: _Drive, below: Array, result: Array) -> tuple[Array, Array]:
    """The value that takes ``below`` to ``result`` with the drive's amount, and where there is one."""
    below, result, u, xp = _together(below, result, drive.amount)
    possible = np.asarray(u > 0)
    amount = xp.where(u > 0, u, 1.0)
    rest = _like(field.rest, result)
    if field.is_rotation:
        turn = quat.power(quat.shortest(quat.multiply(quat.conjugate(below), result)), 1.0 / amount[..., 0])
        return quat.normalize(quat.multiply(below if mode is LayerMode.REPLACE else rest, turn)), possible
    if mode is LayerMode.REPLACE:
        return below + (result - below) / amount, possible
    if field.name == "scales":
        ratio = _ratio(xp, result, below)
        return rest * (1.0 + (ratio - 1.0) / amount), possible & np.asarray(below != 0)
    return rest + (result - below) / amount, possible


def _ratio(xp: ModuleType, value: Array, reference: Array) -> Array:
    """value / reference; 1 where the reference is nothing, as in `keypose.evaluate.difference`."""
    return xp.where(reference == 0, 1.0, value / xp.where(reference == 0, 1.0, reference))


def _together(a: Array, b: Array, amount: Array) -> tuple[Array, Array, Array, ModuleType]:
    """Two values and an amount in one library; the amount does not raise the precision of the values."""
    if all(isinstance(x, np.ndarray) for x in (a, b, amount)):
        return a, b, np.asarray(amount, np.result_type(a, b)), np
    a, b, amount = unified(a, b, amount)
    return a, b, amount, namespace(a)


def _like(rest: Array, value: Array) -> Array:
    return unified(rest, value)[0]


def _over(times: Array, value: Array, rest: Array) -> Array:
    """A field that no layer touched has no batch yet."""
    shape = (*times.shape, *rest.shape)
    if tuple(value.shape) == shape:
        return value
    return namespace(value).broadcast_to(value, shape)
