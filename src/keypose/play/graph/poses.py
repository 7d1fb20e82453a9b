"""The reference evaluator of pose programs: one character, NumPy, float64.

A pose is two arrays: rotations (J, 4), and everything that adds linearly in one row (L,): translations, scales, curves, the
contacts' places and whether they touch. All operations treat all of it, so nothing is lost on the way.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from keypose.arrays import Floats
from keypose.math import quat
from keypose.model import Pose, Skeleton
from keypose.play.graph.assets import ClipAsset
from keypose.play.graph.program import (
    Add,
    BeginInertial,
    Bend,
    Dead,
    Held,
    Hold,
    Inertial,
    Look,
    Mix,
    Operation,
    Over,
    PlantFeet,
    Reach,
    Remember,
    Rest,
    Sample,
)
from keypose.play.graph.transitions import extrapolated, half_lives, quintic, rotation_vector_rate


@dataclass(frozen=True, slots=True, eq=False)
class Layout:
    """Where things are in the linear row: J joints, C curves, E contacts."""

    joints: int
    curves: int
    effectors: int

    @property
    def scales(self) -> slice:
        """Of the joints."""
        return slice(3 * self.joints, 6 * self.joints)

    @property
    def curve_slice(self) -> slice:
        """Of the morph weights."""
        return slice(6 * self.joints, 6 * self.joints + self.curves)

    @property
    def effector_slice(self) -> slice:
        """Of the contacts' places."""
        start = 6 * self.joints + self.curves
        return slice(start, start + 3 * self.effectors)

    @property
    def touching_slice(self) -> slice:
        """Of the contacts' flags."""
        start = 6 * self.joints + self.curves + 3 * self.effectors
        return slice(start, start + self.effectors)

    @property
    def turn_slice(self) -> slice:
        """Of the turns of what touches with the contacts, radians about Y."""
        start = 6 * self.joints + self.curves + 4 * self.effectors
        return slice(start, start + self.effectors)

    @property
    def width(self) -> int:
        """L."""
        return 6 * self.joints + self.curves + 5 * self.effectors

    def row(self, translations: Any, scales: Any, curves: Any, effectors: Any, touching: Any) -> Floats:
        """The linear row, or rows with a batch axis."""
        batch = np.shape(translations)[:-2]
        parts = [np.reshape(a, (*batch, -1)) for a in (translations, scales, curves, effectors, touching)]
        parts.append(np.zeros((*batch, self.effectors)))
        return np.concatenate(parts, axis=-1).astype(np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class Buffer:
    """A pose: rotations (J, 4) and the linear row (L,)."""

    rotations: Floats
    linear: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Memory:
    """What a state machine remembers: the pose last seen and its velocity, and what a transition keeps of the old motion.

    Angular velocities (J, 3) rad/s in the parent's axes; linear ones (L,) per second.
    """

    last: Buffer | None = None
    spin: Floats | None = None
    velocity: Floats | None = None
    held: Buffer | None = None
    held_spin: Floats | None = None
    held_velocity: Floats | None = None
    spin_half_life: Floats | None = None
    half_life: Floats | None = None
    turn: Floats | None = None  # offset of inertialisation, rotation vectors (J, 3), and its derivative
    turn_speed: Floats | None = None
    offset: Floats | None = None
    offset_speed: Floats | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Clips:
    """The clips as rows: per clip rotations (T, J, 4) and linear (T, L)."""

    rotations: tuple[Floats, ...]
    linear: tuple[Floats, ...]
    rates_hz: tuple[float, ...]


def clip_rows(assets: Sequence[ClipAsset], layout: Layout) -> Clips:
    """Clips in the form the evaluator reads."""
    rows = [layout.row(a.translations, a.scales, a.curves, a.effectors, a.touching) for a in assets]
    return Clips(tuple(a.rotations for a in assets), tuple(rows), tuple(a.rate_hz for a in assets))


Solver = Callable[[Buffer, Any, float], Buffer]


@dataclass(frozen=True, slots=True, eq=False)
class Resources:
    """All that operations refer to by number."""

    skeleton: Skeleton
    layout: Layout
    clips: Clips
    rest: Buffer
    masks: tuple[tuple[Floats, Floats], ...]  # per mask: joints (J,), linear (L,)
    references: tuple[Buffer, ...]
    solvers: tuple[Solver, ...]


def evaluate(ops: Sequence[Operation], resources: Resources, memory: list[Memory]) -> Buffer:
    """Run a pose program; ``memory`` is brought up to date. Returns the pose on top of the stack."""
    stack: list[Buffer] = []
    for op in ops:
        match op:
            case Sample():
                stack.append(sample(resources.clips, op.clip, op.time_s))
            case Rest():
                stack.append(resources.rest)
            case Mix():
                count = len(op.weights)
                top = stack[-count:]
                del stack[-count:]
                stack.append(mixed(top, op.weights))
            case Over():
                layer, base = stack.pop(), stack.pop()
                stack.append(layered(base, layer, op, resources))
            case Add():
                pose, base = stack.pop(), stack.pop()
                stack.append(added(base, pose, op, resources))
            case Remember():
                memory[op.memory] = remembered(memory[op.memory], stack[-1], op)
            case Hold():
                memory[op.memory] = held(memory[op.memory], stack[-1])
            case Held():
                kept = memory[op.memory].held
                if kept is not None:
                    stack.append(mixed([kept, stack.pop()], (1.0 - op.weight, op.weight)))
            case Dead():
                stack.append(dead(memory[op.memory], stack.pop(), op))
            case BeginInertial():
                end, start = stack.pop(), stack.pop()
                memory[op.memory] = begun(memory[op.memory], start, end, op.dt_s)
                stack.append(end)
            case Inertial():
                stack.append(inertial(memory[op.memory], stack.pop(), op))
            case Bend():
                stack.append(bent(stack.pop(), op, resources.layout))
            case Look():
                stack.append(resources.solvers[op.chain](stack.pop(), op.target, op.weight))
            case Reach():
                stack.append(resources.solvers[op.limb](stack.pop(), op.target, op.weight))
            case PlantFeet():
                stack.append(resources.solvers[op.plant](stack.pop(), None, op.weight))
    return stack[-1]


def sample(clips: Clips, clip: int, time_s: float) -> Buffer:
    """A clip at a time: slerp between frames."""
    rotations, linear = clips.rotations[clip], clips.linear[clip]
    last = len(linear) - 1
    position = min(max(time_s * clips.rates_hz[clip], 0.0), float(last))
    frame = int(position)
    u = position - frame
    if u == 0:
        return Buffer(rotations[frame], linear[frame])
    return Buffer(
        quat.slerp(rotations[frame], rotations[frame + 1], u),
        linear[frame] + u * (linear[frame + 1] - linear[frame]),
    )


def mixed(poses: Sequence[Buffer], weights: Sequence[float]) -> Buffer:
    """The weighted mean; rotations are summed on the short side of the sum so far."""
    linear = weights[0] * poses[0].linear
    rotations = weights[0] * poses[0].rotations
    for pose, weight in zip(poses[1:], weights[1:], strict=True):
        linear = linear + weight * pose.linear
        rotations = rotations + _sided(rotations, pose.rotations, weight) * pose.rotations
    return Buffer(quat.normalize(rotations), linear)


def layered(base: Buffer, layer: Buffer, op: Over, resources: Resources) -> Buffer:
    """A layer over a base, where its mask says."""
    joints, linear = _masks(op.mask, resources)
    amount = (op.weight * joints)[:, None]
    rotations = (1.0 - amount) * base.rotations
    rotations = rotations + np.where(_dots(base.rotations, layer.rotations) < 0, -amount, amount) * layer.rotations
    share = op.weight * linear
    return Buffer(quat.normalize(rotations), (1.0 - share) * base.linear + share * layer.linear)


def added(base: Buffer, pose: Buffer, op: Add, resources: Resources) -> Buffer:
    """What a pose differs from its reference by, on top of a base; contacts stay the base's."""
    joints, linear = _masks(op.mask, resources)
    layout, reference = resources.layout, resources.references[op.reference]
    delta = quat.multiply(quat.conjugate(reference.rotations), pose.rotations)
    rotations = quat.multiply(base.rotations, quat.power(delta, op.weight * joints))
    share = op.weight * linear
    moved = base.linear + share * (pose.linear - reference.linear)
    at, still = layout.scales, reference.linear[layout.scales] == 0
    ratio = np.where(still, 1.0, pose.linear[at] / np.where(still, 1.0, reference.linear[at]))
    moved[at] = base.linear[at] * (1.0 + share[at] * (ratio - 1.0))
    fixed = slice(layout.effector_slice.start, layout.width)
    moved[fixed] = base.linear[fixed]
    return Buffer(quat.normalize(rotations), moved)


def remembered(memory: Memory, pose: Buffer, op: Remember) -> Memory:
    """The pose becomes the last one seen; its velocity is that of the step."""
    dt_s = op.dt_s
    if memory.last is None or op.fresh:
        return replace(memory, last=pose, spin=np.zeros((len(pose.rotations), 3)), velocity=np.zeros_like(pose.linear))
    if dt_s <= 0:
        return replace(memory, last=pose)
    turn = quat.to_rotation_vector(quat.difference(memory.last.rotations, pose.rotations))
    return replace(memory, last=pose, spin=turn / dt_s, velocity=(pose.linear - memory.last.linear) / dt_s)


def held(memory: Memory, target: Buffer) -> Memory:
    """Hold what was last seen, and see how far it is from the new motion."""
    if memory.last is None or memory.spin is None or memory.velocity is None:
        return memory
    turn = quat.to_rotation_vector(quat.difference(memory.last.rotations, target.rotations))
    return replace(
        memory,
        held=memory.last,
        held_spin=memory.spin,
        held_velocity=memory.velocity,
        spin_half_life=half_lives(turn, memory.spin),
        half_life=half_lives(target.linear - memory.last.linear, memory.velocity),
    )


def dead(memory: Memory, target: Buffer, op: Dead) -> Buffer:
    """The held motion, running on by itself, fading into the target."""
    m = memory
    if (
        m.held is None
        or m.held_spin is None
        or m.held_velocity is None
        or m.half_life is None
        or m.spin_half_life is None
    ):
        return target
    turn = extrapolated(m.held_spin, m.spin_half_life, op.elapsed_s)
    alone = Buffer(
        quat.multiply(quat.from_rotation_vector(turn), m.held.rotations),
        m.held.linear + extrapolated(m.held_velocity, m.half_life, op.elapsed_s),
    )
    return mixed([alone, target], (1.0 - op.weight, op.weight))


def begun(memory: Memory, start: Buffer, end: Buffer, dt_s: float) -> Memory:
    """Keep how the motion last seen differs from the new one at the same moment, in place and in velocity."""
    if memory.last is None or memory.spin is None or memory.velocity is None or dt_s <= 0:
        return replace(memory, turn=None)
    spin = quat.to_rotation_vector(quat.difference(start.rotations, end.rotations)) / dt_s
    turn = quat.difference(start.rotations, memory.last.rotations)
    vector = quat.to_rotation_vector(turn)
    return replace(
        memory,
        turn=vector,
        turn_speed=rotation_vector_rate(vector, memory.spin - quat.rotate(turn, spin)),
        offset=memory.last.linear - start.linear,
        offset_speed=memory.velocity - (end.linear - start.linear) / dt_s,
    )


def inertial(memory: Memory, pose: Buffer, op: Inertial) -> Buffer:
    """The new motion with what is left of the difference."""
    if memory.turn is None:
        return pose
    turn = quintic(memory.turn, memory.turn_speed, op.elapsed_s, op.duration_s)
    offset = quintic(memory.offset, memory.offset_speed, op.elapsed_s, op.duration_s)
    return Buffer(quat.multiply(quat.from_rotation_vector(turn), pose.rotations), pose.linear + offset)


def bent(pose: Buffer, op: Bend, layout: Layout) -> Buffer:
    """The contacts' places carried from a straight way onto an arc, each as far along it and beside it as before.

    A point that stands in the world while the root goes straight then stands while the root goes along the arc.
    """
    linear = pose.linear.copy()
    places = linear[layout.effector_slice].reshape(-1, 3)
    along = places[:, 0] * op.x + places[:, 2] * op.z
    aside_x, aside_z = places[:, 0] - along * op.x, places[:, 2] - along * op.z
    turn = op.curvature * along
    straight = along * np.sinc(turn / np.pi)
    curved = along * np.sin(turn / 2) * np.sinc(turn / (2 * np.pi))  # (1 - cos) / turn
    c, s = np.cos(turn), np.sin(turn)
    x = straight * op.x + curved * op.z + c * aside_x + s * aside_z
    z = straight * op.z - curved * op.x - s * aside_x + c * aside_z
    linear[layout.effector_slice] = np.stack([x, places[:, 1], z], axis=-1).ravel()
    linear[layout.turn_slice] += turn
    return Buffer(pose.rotations, linear)


def to_pose(buffer: Buffer, layout: Layout, dtype: Any) -> Pose:
    """The joints' local transforms."""
    j = layout.joints
    return Pose(
        buffer.linear[: 3 * j].reshape(j, 3).astype(dtype),
        buffer.rotations.astype(dtype),
        buffer.linear[layout.scales].reshape(j, 3).astype(dtype),
    )


def _masks(mask: int, resources: Resources) -> tuple[Floats, Floats]:
    if mask < 0:
        return np.ones(resources.layout.joints), np.ones(resources.layout.width)
    return resources.masks[mask]


def _dots(a: Floats, b: Floats) -> Floats:
    return np.sum(a * b, axis=-1, keepdims=True)


def _sided(total: Floats, rotations: Floats, weight: float) -> Floats:
    return np.where(_dots(total, rotations) < 0, -weight, weight)
