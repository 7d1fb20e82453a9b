"""Evaluation of rigs: from controls and values to the pose of the joints, for any number of poses at once."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from keypose.arrays import Array, Floats, as_float, checked
from keypose.errors import ShapeError, UnknownName
from keypose.evaluate.curves import sample_curve
from keypose.math import euler, quat
from keypose.model import Pose, Property, Rig, Skeleton
from keypose.rig.constraints import constrained
from keypose.rig.frames import frame, frames_of, inverse, lengths, rotation, spin, to_quat
from keypose.rig.modules import move
from keypose.rig.plan import CONTROL, Driven, Part, plan_of
from keypose.rig.state import State, defaults

# Rounding, in metres and factors.
_SAME = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class RigResult:
    """What a rig makes of controls.

    Shapes and units:
        pose: the joints' local pose, batch shape (*B,).
        model_from_control: (*B, N, 4, 4) where controls are, metres.
        model_from_frame: (*B, N, 4, 4) what the local transform of each control is relative to, in the space that it has:
            ``inverse(model_from_frame) @ wish`` is the local transform that puts a control where it is wished.
        values: (*B,) by name: attributes after drivers, and weights of morphs that are driven.
    """

    pose: Pose
    model_from_control: Array
    model_from_frame: Array
    values: Mapping[str, Array]


def evaluate_rig(
    rig: Rig,
    skeleton: Skeleton,
    control_pose: Pose | None = None,
    values: Mapping[str, Any] | None = None,
    base_pose: Pose | None = None,
) -> Pose:
    """The pose of the joints that controls and values give; see `solve_rig` for the places of controls as well.

    Shapes and units: ``control_pose`` local transforms of the N controls, (*B,); ``values`` (*B,) by attribute; ``base_pose``
    local transforms of the J joints, (*B,), for what no module moves. What is not given is at rest or default. Computed in
    float64, returned in the precision of the base pose.

    Raises:
        ShapeError: where shapes do not fit, or the rig does not fit the skeleton.
        UnknownName: where a value is no attribute of the rig, or the rig names a joint that is not there.
    """
    return solve_rig(rig, skeleton, control_pose, values, base_pose).pose


def solve_rig(
    rig: Rig,
    skeleton: Skeleton,
    control_pose: Pose | None = None,
    values: Mapping[str, Any] | None = None,
    base_pose: Pose | None = None,
) -> RigResult:
    """`evaluate_rig`, with where every control is and what it is relative to.

    Raises:
        ShapeError, UnknownName: as `evaluate_rig`.
    """
    state, batch = begin(rig, skeleton, control_pose, values, base_pose)
    base = skeleton.rest if base_pose is None else base_pose
    run(state)
    pose, late = finish(state, batch, base)
    found = {name: np.broadcast_to(value, (state.count,)).reshape(batch) for name, value in late.items()}
    return RigResult(
        pose,
        _unflattened(state.controls, batch, state.count),
        _unflattened(state.frames, batch, state.count),
        MappingProxyType(found),
    )


def begin(
    rig: Rig,
    skeleton: Skeleton,
    control_pose: Pose | None,
    values: Mapping[str, Any] | None,
    base_pose: Pose | None,
) -> tuple[State, tuple[int, ...]]:
    """A checked state before anything is moved, and the batch shape."""
    plan = plan_of(rig, skeleton)
    controls = rig.controls.rest if control_pose is None else control_pose
    base = skeleton.rest if base_pose is None else base_pose
    checked(controls.rotations, (..., rig.controls.joint_count, 4), "control_pose", f"the controls of rig '{rig.name}'")
    checked(base.rotations, (..., skeleton.joint_count, 4), "base_pose", "the skeleton")
    known = defaults(rig.attributes)
    given = {name: np.asarray(as_float(value), np.float64) for name, value in (values or {}).items()}
    for name, value in given.items():
        if name not in known:
            raise UnknownName("attribute", name, known)
        if not np.all(np.isfinite(value)):
            raise ShapeError(f"value '{name}': expected finite numbers")
    shapes = [controls.batch_shape, base.batch_shape, *(v.shape for v in given.values())]
    try:
        batch = np.broadcast_shapes(*shapes)
    except ValueError:
        raise ShapeError(f"control_pose, values, base_pose: batch shapes {shapes[:6]} do not broadcast") from None
    count = math.prod(batch)
    for name, value in given.items():
        known[name] = value.reshape(1) if value.ndim == 0 else np.broadcast_to(value, batch).reshape(count)
    state = State(
        plan, count, frames_of(_batched(controls, batch), count), frames_of(_batched(base, batch), count), known
    )
    return state, batch


def run(state: State) -> None:
    """Drivers that read no joints, then controls and modules in order."""
    plan = state.plan
    for driven in plan.drivers:
        _drive(state, driven, None)
    for kind, index in plan.order:
        if kind == CONTROL:
            state.put(index, state.frame(index))
        else:
            move(state, plan.rig.modules[index])


def finish(state: State, batch: tuple[int, ...], base: Pose) -> tuple[Pose, dict[str, Floats]]:
    """The local pose of the joints, after constraints on joints and drivers that read them; and all values."""
    plan = state.plan
    joints = plan.moved
    local = np.zeros((0, state.count, 4, 4))
    if joints:
        local = inverse(_stacked(state, [state.above(j) for j in joints])) @ _stacked(
            state, [state.joint(j) for j in joints]
        )
    if plan.joint_constraints or plan.late_drivers:
        held = _held(state, dict(zip(joints, local, strict=True)))
        joints = tuple(sorted(held))
        local = _stacked(state, [held[j] for j in joints])
    return _pose(state, joints, local, batch, base), state.values


def _stacked(state: State, frames: Sequence[Floats]) -> Floats:
    """Frames as one array (M, N, 4, 4)."""
    result = np.empty((len(frames), state.count, 4, 4))
    for n, each in enumerate(frames):
        result[n] = each
    return result


def _held(state: State, local: Mapping[int, Floats]) -> dict[int, Floats]:
    """Local frames after constraints on joints, what hangs on them following, and after late drivers."""
    plan = state.plan
    changed: dict[int, Floats] = dict(local)
    after = state.copy()
    for joint in plan.joint_order:
        above = after.above(joint)
        own = changed.get(joint, state.base[joint])
        world = above @ own
        for constraint in plan.joint_constraints.get(joint, ()):
            turn = plan.skeleton.rest.rotations[joint]
            world = constrained(after, constraint, world, above, np.asarray(turn, np.float64))
            changed[joint] = inverse(above) @ world
        after.joints[joint] = world
    for driven in plan.late_drivers:
        _drive(state, driven, changed)
    return changed


def _pose(state: State, joints: tuple[int, ...], local: Floats, batch: tuple[int, ...], base: Pose) -> Pose:
    """The base pose with other local frames (M, N, 4, 4) for M joints."""
    count, index = state.count, list(joints)
    if not index:
        return base
    dtype = np.result_type(base.rotations, base.translations)
    full = _batched(base, batch)
    arrays = [
        np.array(np.broadcast_to(a, (*batch, *a.shape[-2:])).reshape(count, *a.shape[-2:]), np.float64)
        for a in (full.translations, full.rotations, full.scales)
    ]
    frames = np.swapaxes(local, 0, 1)
    before = np.swapaxes(_stacked(state, [state.base[j] for j in index]), 0, 1)
    # what differs from the base pose by rounding alone is the base pose, bit for bit
    same = np.abs(frames - before).max(axis=(-2, -1)) < _SAME
    size = lengths(frames[..., :3, :3])
    known = arrays[2][:, index]
    size = np.where(np.abs(size - np.abs(known)) < _SAME * np.maximum(1.0, np.abs(known)), np.abs(known), size)
    # a joint that is mirrored at rest stays mirrored along the same axes
    signs = np.where(known < 0, -1.0, 1.0)
    turned = to_quat(rotation(frames) * signs[..., None, :])
    towards = np.sum(turned * arrays[1][:, index], axis=-1, keepdims=True)
    found = (frames[..., :3, 3], np.where(towards < 0, -turned, turned), size * signs)
    for array, values in zip(arrays, found, strict=True):
        array[:, index] = np.where(same[..., None], array[:, index], values)
    t, r, s = (a.reshape(*batch, *a.shape[1:]).astype(dtype) for a in arrays)
    return Pose(t, r, s)


# ---- drivers -----------------------------------------------------------------------------------------------------------


def _drive(state: State, driven: Driven, local: dict[int, Floats] | None) -> None:
    names: dict[str, Floats] = {}
    for name in driven.expression.names:
        part = state.plan.parts.get(name)
        names[name] = state.values.get(name, np.zeros(1)) if part is None else _component(state, part, local)
    result = np.atleast_1d(driven.expression(names))
    if driven.driver.curve is not None:
        finite = np.isfinite(result)
        result = np.where(finite, sample_curve(driven.driver.curve, np.where(finite, result, 0.0))[..., 0], np.nan)
    channel, part = driven.driver.channel, driven.part
    if part is None:
        # what has no value (a division by zero) leaves the attribute where it is, and a morph at 0
        instead = state.values.get(channel.target, np.zeros(1))
        state.values[channel.target] = np.where(np.isfinite(result), result, instead)
        return
    result = np.where(np.isfinite(result), result, 0.0)
    before = state.local[part.control] if part.control is not None else _own(state, part.joint or 0, local)
    axis = np.eye(3)[part.axis]
    if channel.property is Property.TRANSLATION:
        added = frame(np.eye(3), result[..., None] * axis)
        after = np.array(np.broadcast_to(before, np.broadcast_shapes(before.shape, added.shape)))
        after[..., :3, 3] += added[..., :3, 3]
    else:
        after = before @ frame(spin(np.broadcast_to(axis, (*result.shape, 3)), result), np.zeros(3))
    if part.control is not None:
        state.local[part.control] = after
    elif local is not None:  # joints are driven last
        local[part.joint or 0] = after


def _own(state: State, joint: int, local: dict[int, Floats] | None) -> Floats:
    base = state.base[joint]
    return base if local is None else local.get(joint, base)


def _component(state: State, part: Part, local: dict[int, Floats] | None) -> Floats:
    """A number of a control's or joint's own transform, (N,): metres or radians out of rest, factors of scale."""
    plan = state.plan
    if part.control is not None:
        own, rest = state.local[part.control], plan.rig.controls.rest
        index = part.control
    else:
        index = part.joint or 0
        own, rest = _own(state, index, local), plan.skeleton.rest
    if part.kind == "translation":
        return own[..., part.axis, 3] - float(rest.translations[index, part.axis])
    if part.kind == "scale":
        return lengths(own[..., :3, :3])[..., part.axis]
    turned = quat.multiply(quat.conjugate(np.asarray(rest.rotations[index], np.float64)), to_quat(rotation(own)))
    if part.kind == "rotation":
        return euler.from_quat(turned, "XYZ")[..., part.axis]
    return 2.0 * np.arctan2(*_short(turned, part.axis))


def _short(turned: Floats, axis: int) -> tuple[Floats, Floats]:
    """Sine and cosine of half the twist about an axis, the short way."""
    sign = np.where(turned[..., 0] < 0, -1.0, 1.0)
    return sign * turned[..., 1 + axis], sign * turned[..., 0]


# ---- shapes ------------------------------------------------------------------------------------------------------------


def _batched(pose: Pose, batch: tuple[int, ...]) -> Pose:
    """A pose whose batch is that of all, where it has one."""
    if not pose.batch_shape or pose.batch_shape == batch:
        return pose
    arrays = (np.broadcast_to(a, (*batch, *a.shape[-2:])) for a in (pose.translations, pose.rotations, pose.scales))
    return Pose(*arrays)


def _unflattened(found: list[Floats | None], batch: tuple[int, ...], count: int) -> Floats:
    result = np.empty((len(found), count, 4, 4))
    for n, each in enumerate(found):
        result[n] = np.eye(4) if each is None else each
    return np.moveaxis(result, 0, 1).reshape(*batch, len(found), 4, 4)
