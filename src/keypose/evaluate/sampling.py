"""Curves, clips and motions at any times.

Semantics are glTF's: STEP holds, LINEAR is a straight line (slerp the short way for rotations), HERMITE is CUBICSPLINE
(tangents in units per second, scaled by the span; rotations are normalised afterwards). At the time of a key the value is
the key's own, bit for bit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np

from keypose.arrays import Array, as_float, checked, gather, namespace, unified
from keypose.errors import ShapeError
from keypose.math import quat, spline
from keypose.model import (
    Channel,
    Clip,
    Curve,
    CurveKind,
    Extrapolation,
    Interpolation,
    Motion,
    Pose,
    Property,
    Skeleton,
)

_WIDTHS = {Property.TRANSLATION: 3, Property.ROTATION: 4, Property.SCALE: 3, Property.WEIGHT: 1}


def sample_curve(curve: Curve, times_s: Any) -> Array:
    """The curve's values at times of any shape.

    Shapes and units: ``times_s`` (*B,) seconds; returns (*B, C) in the precision of ``curve.values``. Gradients flow to
    values and tangents, not to times. Before the first and after the last key, ``curve.before`` and ``curve.after``
    decide; a curve of one key is constant.

    Raises:
        ShapeError: where a time is not finite.

    Source: glTF 2.0 specification, appendix C; lecture notes, "Keyframing" (linear and Hermite interpolation).
    """
    return _sample_group([curve], _finite_times(times_s))[..., 0, :]


def sample_clip(clip: Clip, skeleton: Skeleton, times_s: Any) -> Pose:
    """The skeleton's local pose at times of any shape; what the clip does not animate stays at rest.

    Shapes and units: ``times_s`` (*B,) seconds; returns a pose of batch shape (*B,). Channels of joints that the
    skeleton does not have are passed over; `unmatched` lists them.

    Raises:
        ShapeError: where a time is not finite or a curve has the wrong number of components for its property.
    """
    times = _finite_times(times_s)
    rest = skeleton.rest
    joints = {name: j for j, name in enumerate(skeleton.names)}
    parts: dict[Property, Array] = {}
    for property, at_rest in (
        (Property.TRANSLATION, rest.translations),
        (Property.ROTATION, rest.rotations),
        (Property.SCALE, rest.scales),
    ):
        found = [
            (joints[channel.target], _checked_curve(channel, curve))
            for channel, curve in clip.curves.items()
            if channel.property is property and channel.target in joints
        ]
        parts[property] = _over_rest([j for j, _ in found], [c for _, c in found], at_rest, times)
    return Pose(parts[Property.TRANSLATION], parts[Property.ROTATION], parts[Property.SCALE])


def sample_morphs(
    animation: Clip | Motion, morph_names: Sequence[str], times_s: Any, rest: Array | None = None, loop: bool = False
) -> Array:
    """Morph weights at times of any shape; what the animation does not drive stays at ``rest`` (zeros if not given).

    Shapes: ``times_s`` (*B,), ``morph_names`` M names, ``rest`` (M,); returns (*B, M). ``loop`` is for motions only:
    a clip's curves say themselves how they go on.
    """
    times = _finite_times(times_s)
    count = len(morph_names)
    columns = {name: m for m, name in enumerate(morph_names)}
    base: Array = np.zeros(count, np.float32) if rest is None else as_float(rest)
    checked(base, (count,), "rest", "morph_names")
    if isinstance(animation, Motion):
        return _motion_morphs(animation, morph_names, times, base, loop)
    found = [
        (columns[channel.target], _checked_curve(channel, curve))
        for channel, curve in animation.curves.items()
        if channel.property is Property.WEIGHT and channel.target in columns
    ]
    return _over_rest([m for m, _ in found], [c for _, c in found], base[:, None], times)[..., 0]


def sample_motion(motion: Motion, times_s: Any, loop: bool = False) -> Pose:
    """The pose of a motion at times of any shape: slerp of rotations and lerp of the rest between two frames.

    Shapes and units: ``times_s`` (*B,) seconds; returns batch shape (*B,). Outside the motion the first or last frame
    holds; with ``loop`` time goes round with period ``motion.duration_s``, so that the last frame is the same moment
    as the first. At the time of a frame the pose is the frame's own, bit for bit.
    """
    frames, following, share = _motion_frames(motion, _finite_times(times_s), loop)
    pose = motion.pose
    return Pose(
        _between(pose.translations, frames, following, share),
        _between(pose.rotations, frames, following, share, rotation=True),
        _between(pose.scales, frames, following, share),
    )


def sample(animation: Clip | Motion, skeleton: Skeleton, times_s: Any, loop: bool = False) -> Pose:
    """The skeleton's pose from a clip or a motion, which is first matched to the skeleton by name.

    Shapes and units: ``times_s`` (*B,) seconds; returns batch shape (*B,). With ``loop`` time goes round with the
    animation's duration. Ask for many times at once, or use `match` before asking one by one.
    """
    from keypose.evaluate.matching import match

    if isinstance(animation, Motion):
        return sample_motion(match(animation, skeleton), times_s, loop)
    times = _finite_times(times_s)
    if loop and animation.duration_s > 0:
        times = _wrapped(times, animation.start_s, animation.end_s)
    if any(channel.property is not Property.WEIGHT for channel in unmatched(animation, skeleton)):
        animation = match(animation, skeleton)
    return sample_clip(animation, skeleton, times)


def unmatched(clip: Clip, skeleton: Skeleton, morph_names: Sequence[str] = ()) -> tuple[Channel, ...]:
    """The clip's channels that drive nothing: joints and morphs whose names do not exist."""
    joints, morphs = set(skeleton.names), set(morph_names)
    return tuple(c for c in clip.curves if c.target not in (morphs if c.property is Property.WEIGHT else joints))


# --- curves -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Location:
    """Where times fall on a curve: times brought into its range, spans, and what extrapolation has to add."""

    span: np.ndarray[Any, np.dtype[np.intp]]  # index of the key that starts the span
    following: np.ndarray[Any, np.dtype[np.intp]]
    span_s: np.ndarray[Any, np.dtype[np.float64]]
    share: np.ndarray[Any, np.dtype[np.float64]]  # u in [0, 1)
    cycles: np.ndarray[Any, np.dtype[np.float64]] | None  # whole cycles to add, for CYCLE_OFFSET
    before_s: np.ndarray[Any, np.dtype[np.float64]] | None  # time before the first key (<= 0), for LINEAR
    after_s: np.ndarray[Any, np.dtype[np.float64]] | None  # time after the last key (>= 0), for LINEAR


def _finite_times(times_s: Any) -> np.ndarray[Any, np.dtype[np.float64]]:
    times = np.asarray(times_s, np.float64)
    if not np.all(np.isfinite(times)):
        raise ShapeError("times_s: expected finite numbers")
    return times


def _checked_curve(channel: Channel, curve: Curve) -> Curve:
    width = _WIDTHS[channel.property]
    if curve.values.shape[1] != width:
        raise ShapeError(
            f"curve {channel.target}.{channel.property.value}: expected values of shape (K, {width}), "
            f"got {tuple(curve.values.shape)}"
        )
    if channel.property is Property.ROTATION and curve.kind is not CurveKind.ROTATION:
        raise ShapeError(f"curve {channel.target}.rotation: expected the kind ROTATION, got {curve.kind.name}")
    return curve


def _wrapped(times: Array, start: float, end: float) -> Array:
    """Times brought into start..end by whole cycles; times that are already there stay as they are."""
    inside = (times >= start) & (times <= end)
    return np.where(inside, times, start + np.mod(times - start, end - start))


def _locate(keys: Array, times: Array, before: Extrapolation, after: Extrapolation) -> _Location:
    start, end = keys[0], keys[-1]
    early, late = times < start, times > end
    cycles = before_s = after_s = None
    inside = np.clip(times, start, end)
    if len(keys) > 1 and (np.any(early) or np.any(late)):
        for outside, rule in ((early, before), (late, after)):
            if rule is Extrapolation.LINEAR:
                if outside is early:
                    before_s = np.where(early, times - start, 0.0)
                else:
                    after_s = np.where(late, times - end, 0.0)
            elif rule is Extrapolation.PING_PONG:
                phase = np.mod(times - start, 2 * (end - start))
                inside = np.where(outside, start + np.minimum(phase, 2 * (end - start) - phase), inside)
            elif rule in (Extrapolation.CYCLE, Extrapolation.CYCLE_OFFSET):
                # divmod, so that whole cycles and the rest agree to the last bit.
                whole, rest = np.divmod(times - start, end - start)
                inside = np.where(outside, start + rest, inside)
                if rule is Extrapolation.CYCLE_OFFSET:
                    whole = np.where(outside, whole, 0.0)
                    cycles = whole if cycles is None else cycles + whole
    inside = np.clip(inside, start, end)
    span = np.clip(np.searchsorted(keys, inside, side="right") - 1, 0, len(keys) - 1)
    following = np.minimum(span + 1, len(keys) - 1)
    span_s = keys[following] - keys[span]
    share = (inside - keys[span]) / np.where(span_s > 0, span_s, 1.0)
    return _Location(span, following, span_s, share, cycles, before_s, after_s)


def _sample_group(curves: Sequence[Curve], times: Array) -> Array:
    """Curves that share key times, modes and kind, evaluated together: (*B, G, C)."""
    first = curves[0]
    where = _locate(first.times_s, times, first.before, first.after)
    values = [c.values for c in curves]
    xp = namespace(*values)
    is_rotation = first.kind is CurveKind.ROTATION
    at, to = _rows(xp, values, where.span), _rows(xp, values, where.following)
    share = _numbers(xp, where.share, at)
    modes = first.modes[where.span]
    present = {int(m) for m in np.unique(modes[where.share != 0])}
    result = at
    if Interpolation.LINEAR in present:
        moved = quat.slerp(at, to, share) if is_rotation else spline.lerp(at, to, share)
        result = _where(xp, modes == Interpolation.LINEAR, moved, result)
    if Interpolation.HERMITE in present:
        outgoing = _rows(xp, [c.out_tangents for c in curves], where.span)
        incoming = _rows(xp, [c.in_tangents for c in curves], where.following)
        moved = spline.hermite(at, outgoing, to, incoming, share, _numbers(xp, where.span_s, at))
        if is_rotation:
            moved = quat.normalize(moved)
        result = _where(xp, modes == Interpolation.HERMITE, moved, result)
    result = _where(xp, where.share == 0, at, result)
    if where.cycles is not None:
        result = _add_cycles(xp, curves, result, where.cycles)
    if where.before_s is not None:
        result = _extend(xp, curves, result, where.before_s, at_start=True)
    if where.after_s is not None:
        result = _extend(xp, curves, result, where.after_s, at_start=False)
    return result


def _rows(xp: ModuleType, tables: Sequence[Array], index: Array) -> Array:
    """Rows of each table at an index of any shape, side by side: (*B, G, C)."""
    if not isinstance(tables[0], np.ndarray):
        flat = [gather(t, index.reshape(-1), 0) for t in tables]
        return xp.reshape(xp.stack(flat, axis=-2), (*index.shape, len(tables), tables[0].shape[1]))
    if len(tables) == 1:
        return tables[0][index][..., None, :]
    return np.stack([t[index] for t in tables], axis=-2)


def _numbers(xp: ModuleType, numbers: Array, like: Array) -> Array:
    """NumPy numbers (*B,) as (*B, 1), one for all of a group, in the library and precision of ``like``."""
    if isinstance(like, np.ndarray):
        return np.asarray(numbers, like.dtype)[..., None]
    return xp.astype(unified(np.asarray(numbers), like)[0], like.dtype)[..., None]


def _where(xp: ModuleType, condition: Array, yes: Array, no: Array) -> Array:
    if np.all(condition):
        return yes
    if not np.any(condition):
        return no
    return xp.where(xp.asarray(condition)[..., None, None], yes, no)


def _ends(xp: ModuleType, curves: Sequence[Curve], key: int) -> Array:
    return xp.stack([c.values[key] for c in curves], axis=0)


def _add_cycles(xp: ModuleType, curves: Sequence[Curve], result: Array, cycles: Array) -> Array:
    """Each whole cycle starts where the one before it ended."""
    first, last = _ends(xp, curves, 0), _ends(xp, curves, -1)
    count = _numbers(xp, cycles, result)
    if curves[0].kind is CurveKind.ROTATION:
        # Bring one cycle's turn to the power of the number of cycles, before the rotation inside the cycle.
        moved = quat.multiply(quat.power(quat.multiply(last, quat.conjugate(first)), count), result)
    else:
        moved = result + count[..., None] * (last - first)
    return _where(xp, cycles != 0, moved, result)


def _extend(xp: ModuleType, curves: Sequence[Curve], result: Array, outside_s: Array, at_start: bool) -> Array:
    """Go on with the speed at the end: straight lines, and constant angular velocity for rotations."""
    key, span = (0, 0) if at_start else (-1, -2)
    first = curves[0]
    mode = int(first.modes[span])
    span_s = float(first.times_s[1] - first.times_s[0] if at_start else first.times_s[-1] - first.times_s[-2])
    end = _ends(xp, curves, key)
    elapsed = _numbers(xp, outside_s, result)
    if mode == Interpolation.STEP:
        return result
    if mode == Interpolation.HERMITE:
        tangents = [c.out_tangents if at_start else c.in_tangents for c in curves]
        velocity = xp.stack([t[key] for t in tangents if t is not None], axis=0)
    else:
        velocity = (_ends(xp, curves, span + 1) - _ends(xp, curves, span)) / span_s
    if first.kind is not CurveKind.ROTATION:
        return _where(xp, outside_s != 0, end + elapsed[..., None] * velocity, result)
    if mode == Interpolation.HERMITE:
        # q' = (half angular velocity) q; only the part along the sphere turns, normalising removes the other.
        half_velocity = quat.multiply(velocity, quat.conjugate(end))[..., 1:]
    else:
        half_velocity = (
            quat.to_rotation_vector(quat.difference(_ends(xp, curves, span), _ends(xp, curves, span + 1))) / 2 / span_s
        )
    moved = quat.multiply(quat.exp(elapsed[..., None] * half_velocity), end)
    return _where(xp, outside_s != 0, moved, result)


def _groups(curves: Sequence[Curve]) -> list[list[int]]:
    """Indices of curves that share key times, modes, kind, precision and extrapolation."""
    # Exporters reuse one time array for many channels: compare contents only where the arrays differ.
    contents: dict[int, bytes] = {}

    def content(array: Array) -> bytes:
        if id(array) not in contents:
            contents[id(array)] = array.tobytes()
        return contents[id(array)]

    groups: dict[tuple[Any, ...], list[int]] = {}
    for i, curve in enumerate(curves):
        key = (
            content(curve.times_s),
            content(curve.modes),
            curve.kind is CurveKind.ROTATION,
            id(curve.before),
            id(curve.after),
            curve.out_tangents is None,
            curve.values.dtype,
        )
        groups.setdefault(key, []).append(i)
    return list(groups.values())


def _over_rest(rows: list[int], curves: list[Curve], rest: Array, times: Array) -> Array:
    """Rows of ``rest`` (N, C) replaced by curves sampled at times (*B,): (*B, N, C).

    Curves with the same keys, as exporters write them for all joints, are evaluated together.
    """
    sampled = [(members, _sample_group([curves[i] for i in members], times)) for members in _groups(curves)]
    shape = (*times.shape, *rest.shape)
    if all(isinstance(a, np.ndarray) for a in (rest, *(s for _, s in sampled))):
        result = np.empty(shape, np.result_type(rest, *(s for _, s in sampled)))
        result[...] = rest
        for members, values in sampled:
            result[..., [rows[i] for i in members], :] = values
        result.setflags(write=False)  # so that the frozen types take it over without a copy
        return result
    rest, *arrays = unified(rest, *(s for _, s in sampled))
    xp = namespace(rest)
    columns: list[Array] = [xp.broadcast_to(rest[n, :], (*times.shape, rest.shape[1])) for n in range(rest.shape[0])]
    for (members, _), values in zip(sampled, arrays, strict=True):
        for g, i in enumerate(members):
            columns[rows[i]] = values[..., g, :]
    return xp.stack(columns, axis=-2)


# --- motions ----------------------------------------------------------------------------------------------------------


def _motion_frames(motion: Motion, times: Array, loop: bool) -> tuple[Array, Array, Array]:
    """Frame, next frame and share u between them, for times (*B,)."""
    last = motion.frame_count - 1
    if last < 0:
        raise ShapeError(f"motion '{motion.name}' has no frames")
    if loop and last > 0:
        times = _wrapped(times, motion.start_s, motion.start_s + motion.duration_s)
    position = np.clip((times - motion.start_s) * motion.rate_hz, 0, last)
    nearest = np.rint(position)
    on_frame = motion.start_s + nearest / motion.rate_hz == times
    frames = np.where(on_frame, nearest, np.floor(position)).astype(np.intp)
    return frames, np.minimum(frames + 1, last), np.where(on_frame, 0.0, position - frames)


def _between(array: Array, frames: Array, following: Array, share: Array, rotation: bool = False) -> Array:
    """Frames of (T, N, C) or (N, C) at positions between them: (*B, N, C)."""
    xp = namespace(array)
    if array.ndim == 2:
        return xp.broadcast_to(array, (*frames.shape, *array.shape))
    if isinstance(array, np.ndarray):
        at = array[frames]
        if not np.any(share):
            at.setflags(write=False)
            return at
        to = array[following]
    else:
        shape = (*frames.shape, *array.shape[1:])
        at = xp.reshape(gather(array, frames.reshape(-1), 0), shape)
        to = xp.reshape(gather(array, following.reshape(-1), 0), shape)
    u = _numbers(xp, share, array)
    moved = quat.slerp(at, to, u) if rotation else spline.lerp(at, to, u)
    return _where(xp, share == 0, at, moved)


def _motion_morphs(motion: Motion, names: Sequence[str], times: Array, rest: Array, loop: bool) -> Array:
    shape = (*times.shape, len(names))
    columns = [(m, motion.morph_names.index(name)) for m, name in enumerate(names) if name in motion.morph_names]
    if motion.morph_weights is None or not columns:
        return np.broadcast_to(rest, shape).copy() if isinstance(rest, np.ndarray) else rest
    frames, following, share = _motion_frames(motion, times, loop)
    weights = _between(motion.morph_weights[:, :, None], frames, following, share)[..., 0]
    source = dict(columns)
    rest, weights = unified(rest, weights)
    xp = namespace(weights)
    parts = [
        weights[..., source[m]] if m in source else xp.broadcast_to(rest[m], times.shape) for m in range(len(names))
    ]
    return xp.stack(parts, axis=-1)
