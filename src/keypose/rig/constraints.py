"""Constraints: a control or joint copied from others, limited, aimed or carried.

All work in model space on what the owner does by itself, and mix by their weight. ``keep_offset`` keeps the owner to its
targets as it stood at rest.
"""

from __future__ import annotations

import numpy as np

from keypose.arrays import Floats
from keypose.math import euler, quat
from keypose.model import Constraint, ConstraintKind
from keypose.rig.frames import (
    across,
    frame,
    inverse,
    lengths,
    mixed,
    moved,
    oriented,
    rotation,
    to_matrix,
    to_quat,
    unit,
)
from keypose.rig.modules import turn_between
from keypose.rig.plan import Plan
from keypose.rig.state import State

_KIND = ConstraintKind


def constrained(state: State, constraint: Constraint, world: Floats, above: Floats, rest_turn: Floats) -> Floats:
    """The owner's place under a constraint.

    Shapes: ``world`` (N, 4, 4) model-from-owner; ``above`` (N, 4, 4) the frame that it is local to; ``rest_turn`` (4,) its local
    rotation at rest.
    """
    weight = np.full(1, constraint.weight)
    if constraint.weight_attribute:
        weight = weight * np.clip(state.value(constraint.weight_attribute), 0.0, 1.0)
    if not np.any(weight):
        return world
    if constraint.kind is _KIND.LIMIT_POSITION:
        low, high = (np.where(constraint.axes, b, s * np.inf) for b, s in ((constraint.low, -1), (constraint.high, 1)))
        held = frame(world[..., :3, :3], np.clip(world[..., :3, 3], low, high))
    elif constraint.kind in (_KIND.LIMIT_ROTATION, _KIND.LIMIT_SCALE):
        held = above @ _limited(constraint, inverse(above) @ world, rest_turn)
    else:
        held = _copied(state, constraint, world)
    world, held = np.broadcast_arrays(world, held)
    if np.all(weight == 1):
        return held
    return mixed(world, held, np.broadcast_to(weight, world.shape[:-2]))


def _limited(constraint: Constraint, local: Floats, rest_turn: Floats) -> Floats:
    low, high = (np.where(constraint.axes, b, s * np.inf) for b, s in ((constraint.low, -1), (constraint.high, 1)))
    size = lengths(local[..., :3, :3])
    if constraint.kind is _KIND.LIMIT_SCALE:
        return frame(rotation(local) * np.clip(size, low, high)[..., None, :], local[..., :3, 3])
    turned = quat.multiply(quat.conjugate(np.asarray(rest_turn, np.float64)), to_quat(rotation(local)))
    angles = euler.from_quat(turned, "XYZ")
    inside = np.clip(angles, low, high)
    # what is inside stays bit for bit
    kept = np.all(inside == angles, axis=-1)[..., None, None]
    linear = to_matrix(quat.multiply(np.asarray(rest_turn, np.float64), euler.to_quat(inside, "XYZ")))
    return np.where(kept, local, frame(linear * size[..., None, :], local[..., :3, 3]))


def _copied(state: State, constraint: Constraint, world: Floats) -> Floats:
    targets, offsets = zip(*(_target(state, constraint, name) for name in constraint.targets), strict=True)
    shares = np.asarray(constraint.shares or [1.0] * len(targets))
    shares = shares / shares.sum()
    if constraint.kind is _KIND.AIM:
        return _aimed(state, constraint, world, targets, shares)
    carried = [t @ o for t, o in zip(targets, offsets, strict=True)]
    if constraint.kind is _KIND.PARENT:
        # the owner's own motion out of rest goes on top, so that it can still be keyed
        owner_rest = _rest(state.plan, constraint.owner)
        return _mean(carried, shares) @ (np.linalg.inv(owner_rest) @ world if constraint.keep_offset else np.eye(4))
    place, turned, size = world[..., :3, 3], rotation(world), lengths(world[..., :3, :3])
    axes = np.asarray(constraint.axes)
    if constraint.kind is _KIND.COPY_POSITION:
        # an offset of place alone: how the target is turned does not matter
        shifts = [_shift(state.plan, constraint, name) for name in constraint.targets]
        wish = sum(s * (t[..., :3, 3] + shift) for s, t, shift in zip(shares, targets, shifts, strict=True))
        place = np.where(axes, wish, place)
    elif constraint.kind is _KIND.COPY_SCALE:
        rest_size = [
            lengths(_rest(state.plan, constraint.owner)[:3, :3]) / lengths(_rest(state.plan, name)[:3, :3])
            if constraint.keep_offset
            else np.ones(3)
            for name in constraint.targets
        ]
        parts = zip(shares, targets, rest_size, strict=True)
        size = np.where(axes, sum(s * lengths(t[..., :3, :3]) * r for s, t, r in parts), size)
    else:
        wish = rotation(_mean(carried, shares))
        if all(constraint.axes):
            turned = wish
        else:
            angles = np.where(axes, euler.from_quat(to_quat(wish), "XYZ"), euler.from_quat(to_quat(turned), "XYZ"))
            turned = to_matrix(euler.to_quat(angles, "XYZ"))
    return frame(turned * size[..., None, :], place)


def _aimed(state: State, constraint: Constraint, world: Floats, targets: tuple[Floats, ...], shares: Floats) -> Floats:
    place = world[..., :3, 3]
    wish = sum(s * t[..., :3, 3] for s, t in zip(shares, targets, strict=True)) - place
    axis = unit(np.asarray(constraint.aim_axis))
    if constraint.keep_offset:
        # what points at the targets at rest goes on pointing at them
        plan = state.plan
        owner = _rest(plan, constraint.owner)
        there = sum(s * _rest(plan, n)[:3, 3] for s, n in zip(shares, constraint.targets, strict=True)) - owner[:3, 3]
        if np.any(there):
            axis = unit(rotation(owner).T @ there)
    turned = rotation(world)
    now = moved(turned, axis)
    size = lengths(world[..., :3, :3])[..., None, :]
    if constraint.up_axis is None:
        return frame((turn_between(now, wish) @ turned) * size, place)
    own_up = across(np.asarray(constraint.up_axis), axis, np.eye(3)[np.argmin(np.abs(axis))])
    direction = np.where(np.any(wish, axis=-1, keepdims=True), unit(wish), now)
    up = np.broadcast_to(np.asarray(constraint.up), direction.shape)
    if constraint.keep_offset:
        owner = _rest(state.plan, constraint.owner)
        up = np.broadcast_to(rotation(owner) @ own_up, direction.shape)
    posed_up = across(up, direction, moved(turned, own_up))
    return frame(oriented(direction, posed_up) @ np.swapaxes(oriented(axis, own_up), -1, -2) * size, place)


def _target(state: State, constraint: Constraint, name: str) -> tuple[Floats, Floats]:
    """Where a target is, and the owner in the target's frame at rest (or nothing)."""
    plan = state.plan
    world = state.control(plan.control(name)) if name in plan.rig.controls.names else state.joint(plan.joint(name))
    if not constraint.keep_offset:
        return world, np.eye(4)
    return world, np.linalg.inv(_rest(plan, name)) @ _rest(plan, constraint.owner)


def _shift(plan: Plan, constraint: Constraint, name: str) -> Floats:
    if not constraint.keep_offset:
        return np.zeros(3)
    return _rest(plan, constraint.owner)[:3, 3] - _rest(plan, name)[:3, 3]


def _rest(plan: Plan, name: str) -> Floats:
    if name in plan.rig.controls.names:
        return plan.control_rest[plan.control(name)]
    return plan.rest[plan.joint(name)]


def _mean(frames: list[Floats], shares: Floats) -> Floats:
    """The mean of frames by shares that sum to 1: places and scales evenly, rotations by `quat.average`."""
    if len(frames) == 1:
        return frames[0]
    frames = list(np.broadcast_arrays(*frames))
    stacked = np.stack(frames, axis=-3)
    place = np.sum(shares[:, None] * stacked[..., :3, 3], axis=-2)
    size = np.sum(shares[:, None] * lengths(stacked[..., :3, :3]), axis=-2)
    turned = quat.average(to_quat(rotation(stacked)), np.broadcast_to(shares, stacked.shape[:-2]))
    return frame(to_matrix(turned) * size[..., None, :], place)
