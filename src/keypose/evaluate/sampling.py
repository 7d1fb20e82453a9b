"""Clips and motions at any times: poses, morph weights and named values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from keypose.arrays import Array, as_float, checked, gather, namespace, unified
from keypose.errors import ShapeError, UnknownName
from keypose.evaluate.curves import choose, column, finite_times, groups, sample_curve, sample_group
from keypose.math import euler, quat, spline
from keypose.model import (
    EULER_ORDER,
    Channel,
    Clip,
    Curve,
    CurveKind,
    Motion,
    Pose,
    Property,
    Skeleton,
)

_WIDTHS = {
    Property.TRANSLATION: 3,
    Property.ROTATION: 4,
    Property.EULER: 3,
    Property.SCALE: 3,
    Property.WEIGHT: 1,
}


def sample_clip(clip: Clip, skeleton: Skeleton, times_s: Any) -> Pose:
    """The skeleton's local pose at times of any shape; what the clip does not animate stays at rest.

    Shapes and units: ``times_s`` (*B,) seconds; returns a pose of batch shape (*B,). Channels of joints that the
    skeleton does not have are passed over; `unmatched` lists them. A curve of one component goes over what the curve of the
    whole property or the rest pose gives; of Euler angles, the rest pose's own angles.

    Raises:
        ShapeError: where a time is not finite or a curve has the wrong number of components for its property.
    """
    times = finite_times(times_s)
    rest = skeleton.rest
    joints = {name: j for j, name in enumerate(skeleton.names)}
    return Pose(
        _over_rest(_drivers(clip, Property.TRANSLATION, joints), rest.translations, times),
        _rotations(clip, joints, rest.rotations, times),
        _over_rest(_drivers(clip, Property.SCALE, joints), rest.scales, times),
    )


def sample_value(clip: Clip, name: str, times_s: Any) -> Array:
    """A named value (`Property.VALUE`) of a clip at times of any shape: a number, a colour, or 0 and 1 of a switch.

    Shapes and units: ``times_s`` (*B,) seconds; returns (*B, C). Curves of single components go over that of the whole value;
    without one, a value has as many components as curves drive, and those that none drives are 0.

    Raises:
        ShapeError: where a time is not finite or a curve of one component has several.
        UnknownName: where the clip drives no value of that name.
    """
    times = finite_times(times_s)
    curves = {c: v for c, v in clip.curves.items() if c.property is Property.VALUE}
    whole = curves.get(Channel(name, Property.VALUE))
    own = [_Driver(0, c.component, _checked_part(c, v)) for c, v in curves.items() if c.target == name]
    if not own:
        raise UnknownName("value", name, list(dict.fromkeys(c.target for c in curves)))
    if whole is not None and all(d.component is None for d in own):
        return sample_curve(whole, times)
    width = max(0 if d.component is None else d.component + 1 for d in own)
    rest = np.zeros((1, width if whole is None else whole.values.shape[1]), np.float32)
    if width > rest.shape[1]:
        raise ShapeError(f"value '{name}': component {width - 1} of a curve of {rest.shape[1]}")
    return _over_rest(own, rest, times)[..., 0, :]


def sample_morphs(
    animation: Clip | Motion, morph_names: Sequence[str], times_s: Any, rest: Array | None = None, loop: bool = False
) -> Array:
    """Morph weights at times of any shape; what the animation does not drive stays at ``rest`` (zeros if not given).

    Shapes: ``times_s`` (*B,), ``morph_names`` M names, ``rest`` (M,); returns (*B, M). ``loop`` is for motions only:
    a clip's curves say themselves how they go on.
    """
    times = finite_times(times_s)
    count = len(morph_names)
    columns = {name: m for m, name in enumerate(morph_names)}
    base: Array = np.zeros(count, np.float32) if rest is None else as_float(rest)
    checked(base, (count,), "rest", "morph_names")
    if isinstance(animation, Motion):
        return _motion_morphs(animation, morph_names, times, base, loop)
    return _over_rest(_drivers(animation, Property.WEIGHT, columns), base[:, None], times)[..., 0]


def sample_motion(motion: Motion, times_s: Any, loop: bool = False) -> Pose:
    """The pose of a motion at times of any shape: slerp of rotations and lerp of the rest between two frames.

    Shapes and units: ``times_s`` (*B,) seconds; returns batch shape (*B,). Outside the motion the first or last frame
    holds; with ``loop`` time goes round with period ``motion.duration_s``, so that the last frame is the same moment
    as the first. At the time of a frame the pose is the frame's own, bit for bit.
    """
    frames, following, share = _motion_frames(motion, finite_times(times_s), loop)
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
    times = finite_times(times_s)
    if loop and animation.duration_s > 0:
        times = _wrapped(times, animation.start_s, animation.end_s)
    if any(channel.property is not Property.WEIGHT for channel in unmatched(animation, skeleton)):
        animation = match(animation, skeleton)
    return sample_clip(animation, skeleton, times)


def unmatched(clip: Clip, skeleton: Skeleton, morph_names: Sequence[str] = ()) -> tuple[Channel, ...]:
    """The clip's channels that drive nothing: joints and morphs whose names do not exist. Named values need no joint."""
    joints, morphs = set(skeleton.names), set(morph_names)
    return tuple(
        c
        for c in clip.curves
        if c.property is not Property.VALUE and c.target not in (morphs if c.property is Property.WEIGHT else joints)
    )


def _wrapped(times: Array, start: float, end: float) -> Array:
    """Times brought into start..end by whole cycles; times that are already there stay as they are."""
    inside = (times >= start) & (times <= end)
    return np.where(inside, times, start + np.mod(times - start, end - start))


# --- clips ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Driver:
    """A curve that drives row ``row`` of an array (N, C), or one component of that row."""

    row: int
    component: int | None
    curve: Curve


def _drivers(clip: Clip, property: Property, rows: Mapping[str, int]) -> list[_Driver]:
    return [
        _Driver(rows[channel.target], channel.component, _checked_curve(channel, curve))
        for channel, curve in clip.curves.items()
        if channel.property is property and channel.target in rows
    ]


def _checked_curve(channel: Channel, curve: Curve) -> Curve:
    width = 1 if channel.component is not None else _WIDTHS[channel.property]
    if curve.values.shape[1] != width:
        raise ShapeError(f"curve {channel}: expected values of shape (K, {width}), got {tuple(curve.values.shape)}")
    if (channel.property is Property.ROTATION) is not (curve.kind is CurveKind.ROTATION):
        asked = "the kind ROTATION" if channel.property is Property.ROTATION else "another kind than ROTATION"
        raise ShapeError(f"curve {channel}: expected {asked}, got {curve.kind.name}")
    return curve


def _checked_part(channel: Channel, curve: Curve) -> Curve:
    if channel.component is not None and curve.values.shape[1] != 1:
        raise ShapeError(f"curve {channel}: expected values of shape (K, 1), got {tuple(curve.values.shape)}")
    return curve


def _rotations(clip: Clip, joints: Mapping[str, int], rest: Array, times: Array) -> Array:
    """Rotations (*B, J, 4) of quaternion curves and of Euler angles."""
    drivers = _drivers(clip, Property.ROTATION, joints)
    angles = _drivers(clip, Property.EULER, joints)
    rotations = _over_rest(drivers, rest, times)
    if not angles:
        return rotations
    names = {j: name for name, j in joints.items()}
    for order in sorted({clip.euler_orders.get(names[d.row], EULER_ORDER) for d in angles}):
        own = [d for d in angles if clip.euler_orders.get(names[d.row], EULER_ORDER) == order]
        rows = sorted({d.row for d in own})
        at_rest = euler.from_quat(gather(rest, np.asarray(rows), 0), order)
        sampled = _over_rest([replace(d, row=rows.index(d.row)) for d in own], at_rest, times)
        rotations = _with_rows(rotations, rows, euler.to_quat(sampled, order))
    return rotations


def _over_rest(drivers: Sequence[_Driver], rest: Array, times: Array) -> Array:
    """Rows of ``rest`` (N, C) replaced by curves sampled at times (*B,): (*B, N, C).

    Curves with the same keys, as exporters write them for all joints, are evaluated together. Curves of one component go
    over what the rest or a curve of all components gives.
    """
    curves = [d.curve for d in drivers]
    sampled = [(members, sample_group([curves[i] for i in members], times)) for members in groups(curves)]
    # Curves of all components first.
    sampled = [
        ([i for i in members if (drivers[i].component is None) is whole], members, values)
        for whole in (True, False)
        for members, values in sampled
    ]
    shape = (*times.shape, *rest.shape)
    if all(isinstance(a, np.ndarray) for a in (rest, *(values for _, _, values in sampled))):
        result = np.empty(shape, np.result_type(rest, *(values for _, _, values in sampled)))
        result[...] = rest
        for chosen, members, values in sampled:
            if chosen == members and chosen and drivers[chosen[0]].component is None:
                result[..., [drivers[i].row for i in members], :] = values
                continue
            for i in chosen:
                driver, value = drivers[i], values[..., members.index(i), :]
                if driver.component is None:
                    result[..., driver.row, :] = value
                else:
                    result[..., driver.row, driver.component] = value[..., 0]
        result.setflags(write=False)  # so that the frozen types take it over without a copy
        return result
    rest, *arrays = unified(rest, *(values for _, _, values in sampled))
    xp = namespace(rest)
    columns: list[Array] = [xp.broadcast_to(rest[n, :], (*times.shape, rest.shape[1])) for n in range(rest.shape[0])]
    for (chosen, members, _), values in zip(sampled, arrays, strict=True):
        for i in chosen:
            driver, value = drivers[i], values[..., members.index(i), :]
            if driver.component is not None:
                parts = [columns[driver.row][..., c] for c in range(rest.shape[1])]
                parts[driver.component] = value[..., 0]
                value = xp.stack(parts, axis=-1)
            columns[driver.row] = value
    return xp.stack(columns, axis=-2)


def _with_rows(array: Array, rows: Sequence[int], values: Array) -> Array:
    """An array (*B, N, C) with some rows replaced by values (*B, R, C)."""
    if isinstance(array, np.ndarray) and isinstance(values, np.ndarray):
        result = array.astype(np.result_type(array, values))
        result[..., list(rows), :] = values
        result.setflags(write=False)
        return result
    array, values = unified(array, values)
    columns = [array[..., n, :] for n in range(array.shape[-2])]
    for n, row in enumerate(rows):
        columns[row] = values[..., n, :]
    return namespace(array).stack(columns, axis=-2)


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
    u = column(xp, share, array)
    moved = quat.slerp(at, to, u) if rotation else spline.lerp(at, to, u)
    return choose(xp, share == 0, at, moved)


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
