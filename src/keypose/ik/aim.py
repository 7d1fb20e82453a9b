"""Joints that point at something: one joint with its up axis and limit, and chains that share the turn (spine to eyes)."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from math import pi

import numpy as np

from keypose.arrays import Array, Floats, as_float, checked, namespace, unified
from keypose.errors import ShapeError
from keypose.evaluate import world_rotations_positions
from keypose.ik.limb import softened
from keypose.ik.limits import Vector
from keypose.ik.tasks import Joint
from keypose.math import quat
from keypose.model import Pose, Skeleton

_FORWARD: Vector = (0.0, 0.0, 1.0)
_UP: Vector = (0.0, 1.0, 0.0)
_ENOUGH_RAD = 1e-12
_ROUNDS = 8  # of a chain whose joints reach their limits on the way


@dataclass(frozen=True, slots=True, eq=False)
class AimResult:
    """A joint that points at something: world rotation (*B, 4), and the angle (*B,) that is left to the target, radians."""

    rotation: Array
    error_rad: Array


@dataclass(frozen=True, slots=True, eq=False)
class AimChainResult:
    """A pose whose chain looks at something: ``error_rad`` (*B, E) is what is left to the target at each of its ends."""

    pose: Pose
    error_rad: Floats


def aim_joint(
    rotation: Array,
    position: Array,
    target: Array,
    *,
    axis: Array = _FORWARD,
    up_axis: Array = _UP,
    up: Array | None = None,
    up_at: Array | None = None,
    up_fade_rad: float = pi / 18,
    limit_rad: float = pi,
    softness_rad: float = 0.0,
    release_rad: float = 0.0,
    weight: Array = 1.0,
) -> AimResult:
    """Turn a joint so that one of its axes points at a target.

    Shapes and units:
        rotation: (*B, 4) world rotation without aiming; position, target: (*B, 3) metres.
        axis: (*B, 3) the joint's own axis that points; up_axis: (*B, 3) its own axis that ``up`` is for.
        up: (*B, 3) direction, or up_at: (*B, 3) place of an object, to which ``up_axis`` comes as near as the aim allows.
            Without either the joint takes the shortest way and does not roll.
        up_fade_rad: as the target comes so near to ``up`` or its opposite, where no roll is right, ``up`` counts for less
            and less, so that targets overhead are reached without a flip.
        limit_rad: how far the axis swings from where it is without aiming; softness_rad: angle before that over which it
            slows down (see `keypose.ik.solve_limb`).
        release_rad: angle about straight behind in which the joint lets go of the target, so that one that passes behind
            meets no jump from one side to the other. 0 for a joint that never lets go.
        weight: number or (*B,).

    The axis points at the target exactly where no limit is in the way. A target on the joint turns nothing; one straight
    behind is reached by the half turn of `keypose.math.quat.from_two_vectors`. What is left of a half plane, beyond overhead
    and within ``up_fade_rad`` of it, is where two rolls meet: no rule that depends on the target alone can do without.

    Raises:
        ShapeError: where a shape or a number does not fit, or both ``up`` and ``up_at`` are given.
    """
    if up is not None and up_at is not None:
        raise ShapeError("up, up_at: expected a direction or a place, got both")
    _check_angles(limit_rad, softness_rad, release_rad)
    if not 0 <= up_fade_rad <= pi / 2:
        raise ShapeError(f"up_fade_rad: expected an angle from 0 to pi / 2, got {up_fade_rad}")
    above = up if up_at is None else up_at
    given = {"rotation": rotation, "position": position, "target": target, "axis": axis, "up_axis": up_axis}
    if above is not None:
        given["up" if up_at is None else "up_at"] = above
    known = [as_float(a) for a in given.values()]
    for name, array, size in zip(given, known, (4, 3, 3, 3, 3, 3), strict=False):
        checked(array, (..., size), name)
    q, position, target = unified(*known[:3])
    xp = namespace(q)
    dtype = xp.result_type(q, position, target)  # constants and directions follow
    axis, up_axis, *rest = (xp.astype(a, dtype) for a in unified(q, *known[3:])[1:])
    start, way = quat.rotate(q, axis), target - position
    here = _norm(xp, way) == 0
    way = xp.where(here, start, way)
    turn, _ = _swing(xp, start, way, limit_rad, softness_rad, release_rad)
    if rest:
        vertical = rest[0] if up_at is None else rest[0] - position
        swung = quat.multiply(turn, q)
        turn = quat.multiply(
            _roll(xp, quat.rotate(swung, axis), quat.rotate(swung, up_axis), vertical, up_fade_rad), turn
        )
    turned = quat.normalize(quat.multiply(quat.power(turn, xp.asarray(weight, dtype=q.dtype)), q))
    return AimResult(turned, _angle(xp, quat.rotate(turned, axis), way))


def aim_chain(
    skeleton: Skeleton,
    pose: Pose,
    joints: Sequence[Joint],
    target: Array,
    *,
    ends: Sequence[Joint] = (),
    axis: Array = _FORWARD,
    shares: Sequence[float] | None = None,
    limits_rad: Sequence[float] | None = None,
    softness_rad: float = 0.0,
    release_rad: float = 0.0,
    up: Array | None = None,
    up_axis: Array = _UP,
    weight: Array = 1.0,
) -> AimChainResult:
    """Let a chain of joints look at a target, each with its share of the turn: spine, chest, neck, head and eyes.

    Shapes and units:
        pose of batch shape (*B,); target (*B, 3) metres in the model's space; weight a number or (*B,).
        joints: from the root side on, each below the one before; joints between them keep their local rotations.
        ends: joints below the last that look each by itself, so that two eyes converge. Without any the last joint looks.
        axis: (3,) axis that looks, in the end's own axes; (E, 3) for one each.
        shares: of the whole turn, one per joint and one more for all ends; all alike if not given. What a joint cannot do
            for its limit the others do, and the ends always do what is left.
        limits_rad: how far each joint turns from its pose, in the order of ``shares``.
        softness_rad, release_rad: as of `aim_joint`, for the whole turn.
        up: (*B, 3) direction to which ``up_axis`` of the last joint comes as near as its aim allows.

    Within the limits every end looks at the target exactly.

    Raises:
        UnknownName: where a joint does not exist.
        ShapeError: where joints are no chain, or a shape or a number does not fit.
    """
    chain = _Gaze(skeleton, pose, joints, ends, target, axis)
    steps = len(chain.joints) + bool(len(ends))
    part = np.full(steps, 1.0 / steps) if shares is None else np.asarray(shares, np.float64)
    most = np.full(steps, pi) if limits_rad is None else np.asarray(limits_rad, np.float64)
    checked(part, (steps,), "shares")
    checked(most, (steps,), "limits_rad")
    if not (np.all(part >= 0) and part[-1] > 0):
        raise ShapeError(f"shares: expected none below 0 and the last above it, got {part.tolist()}")
    if not (np.all(most >= 0) and np.all(most <= pi)):
        raise ShapeError(f"limits_rad: expected angles from 0 to pi, got {most.tolist()}")
    _check_angles(pi, softness_rad, release_rad)
    share = np.broadcast_to(np.asarray(weight, np.float64), chain.batch).reshape(-1)
    origin, way = chain.gaze()
    whole = _angle(np, way, chain.target - origin)
    limit = min(float(most.sum()), pi)
    left = whole - share * _limited(np, whole, limit, min(softness_rad, limit), release_rad)  # shall be left at the end
    vertical = None if up is None else np.broadcast_to(checked(as_float(up), (..., 3), "up"), (*chain.batch, 3))
    room = np.broadcast_to(most, (len(whole), steps)).copy()
    for number in range(_ROUNDS):
        for n in range(len(chain.joints)):
            chain.turn(n, left, part[n:], room[:, n:])
        if vertical is not None and number == 0:
            chain.roll(np.asarray(up_axis, np.float64), vertical.reshape(-1, 3), share)
        if ends:
            chain.turn_ends(left, room[:, -1])
        if np.all((chain.errors().max(axis=1) <= left + _ENOUGH_RAD) | (room.sum(axis=1) <= _ENOUGH_RAD)):
            break
    return AimChainResult(chain.result(), chain.errors().reshape(*chain.batch, -1))


class _Gaze:
    """The chain of N poses and its ends: world rotations and places, in float64."""

    def __init__(
        self,
        skeleton: Skeleton,
        pose: Pose,
        joints: Sequence[Joint],
        ends: Sequence[Joint],
        target: Array,
        axis: Array,
    ) -> None:
        if not joints:
            raise ShapeError("joints: expected at least one")
        self.skeleton, self.pose = skeleton, pose
        self.joints, self.tips = ([skeleton.index(j) for j in group] for group in (joints, ends))
        pairs = [*itertools.pairwise(self.joints), *((self.joints[-1], tip) for tip in self.tips)]
        for above, below in pairs:
            if not _hangs(skeleton, below, above):
                raise ShapeError(f"joints: '{skeleton.names[below]}' does not hang below '{skeleton.names[above]}'")
        goal = checked(np.asarray(as_float(target), np.float64), (..., 3), "target")
        self.batch = np.broadcast_shapes(pose.batch_shape, goal.shape[:-1])
        self.target = np.broadcast_to(goal, (*self.batch, 3)).reshape(-1, 3)
        self.index = [*self.joints, *self.tips]
        turned, places = (np.asarray(a, np.float64) for a in world_rotations_positions(skeleton, pose))
        self.before = turned
        self.turned = np.broadcast_to(turned, (*self.batch, *turned.shape[-2:]))[..., self.index, :]
        self.turned = self.turned.reshape(-1, len(self.index), 4).copy()
        self.old = self.turned.copy()
        self.places = np.broadcast_to(places, (*self.batch, *places.shape[-2:]))[..., self.index, :]
        self.places = self.places.reshape(-1, len(self.index), 3).copy()
        self.lookers = slice(len(self.joints), None) if self.tips else slice(len(self.joints) - 1, None)
        count = len(self.tips) or 1
        axes = np.asarray(axis, np.float64)
        if axes.shape not in ((3,), (count, 3)) or not np.all(np.linalg.norm(axes, axis=-1) > 0):
            raise ShapeError(f"axis: expected a direction (3,) or one for each of {count} ends, got {axes.tolist()}")
        self.axes = np.broadcast_to(axes / np.linalg.norm(axes, axis=-1, keepdims=True), (count, 3))

    def looks(self) -> tuple[Floats, Floats]:
        """Where the ends are and where they look, (N, E, 3) each."""
        turned = self.turned[:, self.lookers]
        return self.places[:, self.lookers], quat.rotate(turned, np.broadcast_to(self.axes, (*turned.shape[:-1], 3)))

    def gaze(self) -> tuple[Floats, Floats]:
        """The same for all ends together, (N, 3) each; ends that look in opposite directions follow the first."""
        places, ways = self.looks()
        way = ways.mean(axis=1)
        return places.mean(axis=1), np.where(np.linalg.norm(way, axis=-1, keepdims=True) < 1e-6, ways[:, 0], way)

    def errors(self) -> Floats:
        """The angle that is left at every end (N, E)."""
        places, ways = self.looks()
        return _angle(np, ways, _seen(self.target[:, None] - places, ways))

    def turn(self, n: int, left: Floats, shares: Floats, room: Floats) -> None:
        """Give joint n its share of what is to be done by it and those after it; ``room`` of each is what it still may."""
        origin, way = self.gaze()
        seen = _seen(self.target - origin, way)
        angle = _angle(np, way, seen)
        part = np.minimum(_shared_out(np.maximum(angle - left, 0.0), shares, room), room[:, 0])
        room[:, 0] -= part
        self._apply(n, slice(n, None), _part_of_swing(way, seen, angle, part))

    def turn_ends(self, left: Floats, room: Floats) -> None:
        """Let every end look at the target by itself."""
        places, ways = self.looks()
        used = np.zeros_like(room)
        for e in range(len(self.tips)):
            seen = _seen(self.target - places[:, e], ways[:, e])
            angle = _angle(np, ways[:, e], seen)
            part = np.minimum(np.maximum(angle - left, 0.0), room)
            used = np.maximum(used, part)
            at = len(self.joints) + e
            self._apply(at, slice(at, at + 1), _part_of_swing(ways[:, e], seen, angle, part))
        room -= used

    def roll(self, up_axis: Floats, vertical: Floats, weight: Floats) -> None:
        """Turn the last joint about where it looks until it is upright."""
        last = len(self.joints) - 1
        _, way = self.gaze()
        upright = quat.rotate(self.turned[:, last], np.broadcast_to(up_axis, way.shape))
        turn = quat.power(_roll(np, way, upright, vertical, pi / 18), weight)
        self._apply(last, slice(last, None), turn)

    def _apply(self, n: int, below: slice, turn: Floats) -> None:
        here, turn = self.places[:, n : n + 1], turn[:, None]
        away, following = self.places[:, below] - here, self.turned[:, below]
        self.places[:, below] = here + quat.rotate(np.broadcast_to(turn, (*away.shape[:-1], 4)), away)
        self.turned[:, below] = quat.normalize(quat.multiply(np.broadcast_to(turn, following.shape), following))

    def result(self) -> Pose:
        """The whole pose; what is not in the chain keeps its local rotation."""
        rotations = np.array(np.broadcast_to(self.pose.rotations, (*self.batch, *self.pose.rotations.shape[-2:])))
        flat = rotations.reshape(-1, *rotations.shape[-2:])
        everything = np.broadcast_to(self.before, (*self.batch, *self.before.shape[-2:])).reshape(*flat.shape)
        for n, joint in enumerate(self.index):
            parent, local = int(self.skeleton.parents[joint]), self.turned[:, n]
            if parent >= 0:
                above = everything[:, parent]
                if n > 0:  # all between it and the chain's joint above turn with that
                    m = min(n, len(self.joints)) - 1
                    above = quat.multiply(quat.multiply(self.turned[:, m], quat.conjugate(self.old[:, m])), above)
                local = quat.multiply(quat.conjugate(above), local)
            flat[:, joint] = local
        return Pose(self.pose.translations, flat.reshape(rotations.shape), self.pose.scales)


def _shared_out(angle: Floats, shares: Floats, room: Floats) -> Floats:
    """The first one's part (N,) of angles that are shared out, none above its room (N, k): the others do more then."""
    full = (shares <= 0) & np.ones_like(room, bool)
    parts = np.zeros_like(room)
    for _ in range(len(shares)):
        rest = angle - np.sum(np.where(full, parts, 0.0), axis=1)
        total = np.sum(np.where(full, 0.0, shares), axis=1)
        each = np.where(full, parts, shares * (rest / np.where(total > 0, total, 1.0))[:, None])
        over = ~full & (each > room)
        parts, full = np.where(over, room, each), full | over
        if not np.any(over):
            break
    return parts[:, 0]


def _swing(
    xp: Array, start: Array, way: Array, limit_rad: float, softness_rad: float, release_rad: float
) -> tuple[Array, Array]:
    """The shortest turn from one direction towards another as far as the limit lets it go, and the angle between them."""
    angle = _angle(xp, start, way)
    allowed = _limited(xp, angle, limit_rad, softness_rad, release_rad)
    part = xp.where(angle > 0, allowed / xp.where(angle > 0, angle, xp.ones_like(angle)), xp.ones_like(angle))
    return quat.power(quat.from_two_vectors(start, way), part), angle


def _part_of_swing(start: Floats, way: Floats, angle: Floats, part: Floats) -> Floats:
    return quat.power(quat.from_two_vectors(start, way), np.where(angle > 0, part / np.maximum(angle, 1e-300), 0.0))


def _limited(xp: Array, angle: Array, limit_rad: float, softness_rad: float, release_rad: float) -> Array:
    """How far a swing by an angle may go."""
    if limit_rad < pi or softness_rad > 0:
        limit = xp.full_like(angle, limit_rad)
        angle, whole = xp.minimum(softened(xp, angle, limit, xp.full_like(angle, softness_rad)), limit), angle
    else:
        whole = angle
    return angle if release_rad == 0 else angle * _smooth(xp, (pi - whole) / release_rad)


def _roll(xp: Array, along: Array, upright: Array, vertical: Array, fade_rad: float) -> Array:
    """The turn about where a joint looks that brings its up axis to the vertical; less of it where that is where it looks."""
    along = along / _norm(xp, along)
    height = _norm(xp, vertical)
    vertical = vertical / xp.where(height == 0, xp.ones_like(height), height)
    side, wanted = (v - xp.sum(v * along, axis=-1, keepdims=True) * along for v in (upright, vertical))
    angle = xp.atan2(
        xp.sum(along * xp.linalg.cross(*xp.broadcast_arrays(side, wanted)), axis=-1), xp.sum(side * wanted, axis=-1)
    )
    sine = _norm(xp, wanted)[..., 0]
    fade = xp.where(sine > 0, xp.ones_like(sine), xp.zeros_like(sine))
    if fade_rad > 0:
        fade = _smooth(xp, sine / float(np.sin(fade_rad)))
    return quat.from_axis_angle(along, angle * fade)


def _smooth(xp: Array, x: Array) -> Array:
    """From 0 at 0 to 1 at 1 without a jump in speed."""
    x = xp.clip(x, 0.0, 1.0)
    return x * x * (3 - 2 * x)


def _angle(xp: Array, a: Array, b: Array) -> Array:
    """The angle (*B,) between directions of any length."""
    a, b = xp.broadcast_arrays(a, b)
    return xp.atan2(_norm(xp, xp.linalg.cross(a, b))[..., 0], xp.sum(a * b, axis=-1))


def _norm(xp: Array, v: Array) -> Array:
    return xp.sqrt(xp.sum(v * v, axis=-1, keepdims=True))


def _seen(way: Floats, looks: Floats) -> Floats:
    """Where the target is; what is on the joint itself is seen where it looks."""
    return np.where(np.any(way != 0, axis=-1, keepdims=True), way, looks)


def _hangs(skeleton: Skeleton, joint: int, top: int) -> bool:
    while joint >= 0:
        joint = int(skeleton.parents[joint])
        if joint == top:
            return True
    return False


def _check_angles(limit_rad: float, softness_rad: float, release_rad: float) -> None:
    if not 0 <= limit_rad <= pi:
        raise ShapeError(f"limit_rad: expected an angle from 0 to pi, got {limit_rad}")
    if not 0 <= softness_rad <= limit_rad:
        raise ShapeError(f"softness_rad: expected an angle from 0 to the limit {limit_rad}, got {softness_rad}")
    if not 0 <= release_rad <= pi:
        raise ShapeError(f"release_rad: expected an angle from 0 to pi, got {release_rad}")
