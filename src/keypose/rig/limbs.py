"""Arms and legs: FK, IK with a pole, soft and stretching reach, and a foot that rolls over heel, ball and tip.

IK takes its lengths and whatever lies between the three joints from the base pose, so that joint channels below the rig
keep their say. Source: law of cosines; soft reach after A. Nicol, "Soft IK" (2007).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from keypose.arrays import Floats
from keypose.model import FootPivots, LimbModule
from keypose.rig.frames import (
    about,
    across,
    cross,
    frame,
    inverse,
    mixed,
    moved,
    oriented,
    rotation,
    spin,
    stretched,
    unit,
)
from keypose.rig.plan import Plan
from keypose.rig.state import State

# Of the reach: what a pole cannot say of a limb at rest, above rounding.
_ASIDE = 1e-6

# Of the reach: the middle of a straight limb goes as the square root of its reach, so that rounding shows unless the reach at
# rest is met exactly.
_AT_REST = 1e-14

PIVOTS = ("roll", "bank", "heel", "ball", "tip", "swivel")


@dataclass(frozen=True, slots=True, eq=False)
class _Limb:
    """What does not change: indices, the plane's normal in the upper and lower joints' own axes, what the pole cannot say.

    ``bend`` (3,): how far the middle joint lies at rest beside where the pole would have it, along the limb, towards the
    pole and across, as a share of the reach at rest.
    """

    joints: tuple[int, int, int]
    controls: tuple[int, int, int]
    goal: int
    pole: int
    normals: tuple[Floats, Floats]
    lengths_m: tuple[float, float, float]
    rest_reach: float
    bend: Floats
    between: tuple[tuple[int, ...], tuple[int, ...]]


@dataclass(frozen=True, slots=True, eq=False)
class _Bones:
    """The limb as its base pose has it: the two bones as vectors in the axes of the joint above them, scales included."""

    start: Floats
    upper: Floats
    lower: Floats
    scales: tuple[Floats, Floats, Floats]


@lru_cache(maxsize=64)
def _limb(plan: Plan, module: LimbModule) -> _Limb:
    joints = tuple(plan.joint(j) for j in module.joints)
    controls = tuple(plan.control(c) for c in module.controls)
    goal, pole = plan.control(module.goal), plan.control(module.pole)
    a, b, c = (plan.rest[j][:3, 3] for j in joints)
    turns = [rotation(plan.rest[j]) for j in joints]
    along = unit(c - a)
    side = across(plan.control_rest[pole][:3, 3] - a, along, b - a)
    normal = cross(along, side)
    reach = float(np.linalg.norm(c - a))
    upper_m, lower_m = float(np.linalg.norm(b - a)), float(np.linalg.norm(c - b))
    cosine, sine = _triangle(np.array(reach), np.array(upper_m), np.array(lower_m))
    missed = b - (a + upper_m * (cosine * along + sine * side))
    bend = np.array([missed @ along, missed @ side, missed @ normal]) / max(upper_m + lower_m, 1e-12)
    between = tuple(_path(plan, upper, lower) for upper, lower in ((joints[0], joints[1]), (joints[1], joints[2])))
    return _Limb(
        (joints[0], joints[1], joints[2]),
        (controls[0], controls[1], controls[2]),
        goal,
        pole,
        (turns[0].T @ normal, turns[1].T @ normal),
        (upper_m, lower_m, reach),
        reach / max(upper_m + lower_m, 1e-12),
        bend,
        (between[0], between[1]),
    )


def is_bent_aside(plan: Plan, module: LimbModule) -> bool:
    """Whether the middle joint lies at rest beside where its pole would have it: a knee that is bent backwards a little."""
    return bool(np.abs(_limb(plan, module).bend).max() > _ASIDE)


def _path(plan: Plan, upper: int, lower: int) -> tuple[int, ...]:
    """The joints below ``upper`` down to ``lower``."""
    path = [lower]
    while plan.parents[path[-1]] != upper:
        path.append(plan.parents[path[-1]])
        if path[-1] < 0:
            from keypose.errors import ShapeError

            names = plan.skeleton.names
            raise ShapeError(f"limb: joint '{names[lower]}' does not hang on '{names[upper]}'")
    return tuple(reversed(path))


def _triangle(distance: Floats, upper: Floats, lower: Floats) -> tuple[Floats, Floats]:
    """Cosine and sine of the angle at the start of a triangle."""
    safe = np.where(distance == 0, 1.0, distance) * upper * 2.0
    cosine = np.where(distance == 0, 0.0, (upper**2 + distance**2 - lower**2) / np.where(safe == 0, 1.0, safe))
    cosine = np.clip(cosine, -1.0, 1.0)
    return cosine, np.sqrt((1.0 - cosine) * (1.0 + cosine))


# ---- moving ------------------------------------------------------------------------------------------------------------


def move_limb(state: State, module: LimbModule) -> None:
    """Place the three joints, and the toes."""
    limb = _limb(state.plan, module)
    switch = np.clip(state.value(module.attribute("ik")), 0.0, 1.0)
    plan = state.plan
    forward: list[Floats] = []
    toes = module.foot if module.foot is not None and module.foot.toes_joint else None
    reaching = bool(np.any(switch != 0))
    if not (reaching and np.all(switch == 1)):
        forward = [state.control(c) @ plan.offset(c, j) for c, j in zip(limb.controls, limb.joints, strict=True)]
        if toes is not None:
            forward.append(state.control(limb.controls[2]) @ plan.control_rest_inverse[limb.controls[2]])
    solved: list[Floats] = []
    if reaching:
        stand, foot_now = _stand(state, module, limb)
        solved = _reach(state, module, limb, foot_now)
        if toes is not None:
            solved.append(stand)
    if not forward:
        placed = solved
    elif not solved:
        placed = forward
    else:
        placed = _between(forward, solved, switch)
    for joint, world in zip(limb.joints, placed, strict=False):
        state.joints[joint] = world
    if toes is not None:
        control, joint = plan.control(toes.toes_control), plan.joint(toes.toes_joint)
        world = state.put(control, placed[3] @ plan.parent_rest[control])
        state.joints[joint] = world @ plan.offset(control, joint)


def _between(first: list[Floats], second: list[Floats], share: Floats) -> list[Floats]:
    """Chains blended joint by joint on the blended joint before, so that bones keep their lengths."""
    placed = [mixed(first[0], second[0], share)]
    for n in (1, 2):
        own = mixed(inverse(first[n - 1]) @ first[n], inverse(second[n - 1]) @ second[n], share)
        k = share[..., None, None]
        world = placed[-1] @ own
        placed.append(np.where(k == 0, first[n], np.where(k == 1, second[n], world)))
    if len(first) > 3:
        # the toes' frame is told by what carries the foot
        own = mixed(inverse(first[2]) @ first[3], inverse(second[2]) @ second[3], share)
        k = share[..., None, None]
        placed.append(np.where(k == 0, first[3], np.where(k == 1, second[3], placed[2] @ own)))
    return placed


def _stand(state: State, module: LimbModule, limb: _Limb) -> tuple[Floats, Floats]:
    """Where goal and foot attributes put the toes' carrier (model-from-model at rest) and the end joint."""
    plan = state.plan
    goal = state.control(limb.goal)
    carried = goal @ plan.control_rest_inverse[limb.goal]
    end = plan.rest[limb.joints[2]]
    foot = module.foot
    if foot is None or state.is_zero(*(foot.attribute(p) for p in PIVOTS)):
        return carried, carried @ end
    return _rolled(state, foot, carried, rotation(plan.control_rest[limb.goal]), end)


def _rolled(state: State, foot: FootPivots, carried: Floats, axes: Floats, end: Floats) -> tuple[Floats, Floats]:
    value = {p: state.value(foot.attribute(p)) for p in (*PIVOTS, "roll_break")}
    roll, stop = value["roll"], value["roll_break"]

    def turn(place: tuple[float, float, float], axis: int, angle: Floats) -> Floats:
        direction = np.broadcast_to(axes[:, axis], (*angle.shape, 3))
        return about(np.asarray(place), spin(direction, angle), np.eye(4)[None])

    bank = value["bank"]
    # a foot that banks to its left lifts the right edge
    stand = (
        carried
        @ turn(foot.ball, 1, value["swivel"])
        @ turn(foot.left, 2, np.minimum(bank, 0.0))
        @ turn(foot.right, 2, np.maximum(bank, 0.0))
        @ turn(foot.heel, 0, np.minimum(roll, 0.0) + value["heel"])
        @ turn(foot.tip, 0, np.maximum(roll - stop, 0.0) + value["tip"])
    )
    lifted = turn(foot.ball, 0, np.clip(roll, 0.0, np.maximum(stop, 0.0)) + value["ball"])
    return stand, stand @ lifted @ end


def _bones(state: State, limb: _Limb) -> _Bones:
    upper = state.above(limb.joints[0]) @ state.base[limb.joints[0]]
    to_middle, to_end = (_product(state, path) for path in limb.between)
    # scales (and the shear of scales that differ by rounding) go with each joint as they are
    size = stretched(upper)[1]
    middle_size = stretched(size @ to_middle[..., :3, :3])[1]
    end_size = stretched(middle_size @ to_end[..., :3, :3])[1]
    return _Bones(
        upper[..., :3, 3],
        moved(size, to_middle[..., :3, 3]),
        moved(middle_size, to_end[..., :3, 3]),
        (size, middle_size, end_size),
    )


def _product(state: State, joints: tuple[int, ...]) -> Floats:
    result = state.base[joints[0]]
    for joint in joints[1:]:
        result = result @ state.base[joint]
    return result


def _reach(state: State, module: LimbModule, limb: _Limb, goal: Floats) -> list[Floats]:
    """The three joints with their end as near the goal as bones, softness and stretch allow."""
    bones = _bones(state, limb)
    upper_m, lower_m = _norm(bones.upper), _norm(bones.lower)
    whole = upper_m + lower_m
    wish = goal[..., :3, 3] - bones.start
    distance = _norm(wish)
    stretch = np.clip(state.value(module.attribute("stretch")), 0.0, 1.0)
    soft = np.clip(state.value(module.attribute("soft")), 0.0, 0.5) * whole
    used = _softened(distance, whole, soft)
    grow = 1.0 + stretch * (np.maximum(distance / np.maximum(used, 1e-12), 1.0) - 1.0)
    upper_m, lower_m, used = upper_m * grow, lower_m * grow, used * grow
    used = np.clip(used, np.abs(upper_m - lower_m), upper_m + lower_m)
    pole = state.control(limb.pole)[..., :3, 3] - bones.start
    none = (distance == 0)[..., None]
    along = np.where(none, np.array([0.0, -1.0, 0.0]), unit(wish))
    side = across(pole, along, np.array([0.0, 0.0, 1.0]))
    normal = cross(along, side)
    whole_rest = limb.lengths_m[0] + limb.lengths_m[1]
    near = [
        np.abs(a - b) <= _AT_REST * whole_rest for a, b in zip((upper_m, lower_m, used), limb.lengths_m, strict=True)
    ]
    still = near[0] & near[1] & near[2]
    upper_m, lower_m, used = (
        np.where(still, b, a) for a, b in zip((upper_m, lower_m, used), limb.lengths_m, strict=True)
    )
    cosine, sine = _triangle(used, upper_m, lower_m)
    middle = bones.start + upper_m[..., None] * (cosine[..., None] * along + sine[..., None] * side)
    end = bones.start + used[..., None] * along
    aside = module.attribute("rest_bend")
    if aside in state.values or np.any(still):
        share = still.astype(np.float64)
        if aside in state.values:
            faded = _fade(used / np.maximum(whole, 1e-12), limb.rest_reach)
            share = np.clip(state.values[aside], 0.0, 1.0) * faded
        share = share * whole
        shift = limb.bend * share[..., None]
        middle = middle + shift[..., :1] * along + shift[..., 1:2] * side + shift[..., 2:] * normal
    turns = []
    for n, (bone, vector) in enumerate(((bones.upper, middle - bones.start), (bones.lower, end - middle))):
        direction, own = unit(vector), unit(bone)
        twist = state.value(module.attribute(("twist", "lower_twist")[n]))
        towards = oriented(direction, across(normal, direction, side))
        if np.any(twist):
            towards = spin(direction, np.broadcast_to(twist, direction.shape[:-1])) @ towards
        own_axes = oriented(own, across(limb.normals[n], own, np.array([1.0, 0.0, 0.0])))
        turns.append(towards @ np.swapaxes(own_axes, -1, -2))
    places = (bones.start, middle, end)
    turned = (turns[0], turns[1], rotation(goal))
    return [frame(turn @ size, place) for turn, size, place in zip(turned, bones.scales, places, strict=True)]


def _fade(reach: Floats, rest: float) -> Floats:
    """1 at the reach of the rest pose, falling smoothly to 0 where the limb is straight or bent by more than a little."""
    span = np.where(reach > rest, max(1.0 - rest, 1e-9), 0.1)
    u = np.clip(1.0 - np.abs(reach - rest) / span, 0.0, 1.0)
    return u * u * (3.0 - 2.0 * u)


def _softened(distance: Floats, reach: Floats, soft: Floats) -> Floats:
    if not np.any(soft):
        return np.minimum(distance, reach)
    hard = reach - soft
    over = np.maximum(distance - hard, 0.0)
    safe = np.where(soft == 0, 1.0, soft)
    return np.where(distance > hard, hard + soft * -np.expm1(-over / safe), distance)


def _norm(v: Floats) -> Floats:
    return np.sqrt(np.vecdot(v, v))


# ---- the way back ------------------------------------------------------------------------------------------------------


def wanted_limb(state: State, module: LimbModule) -> dict[int, Floats]:
    """Goal and pole that give the limb its present places, and the twists of its bones, which are set."""
    plan, limb = state.plan, _limb(state.plan, module)
    upper, middle, end = (state.joint(j) for j in limb.joints)
    start, bend, stop = (m[..., :3, 3] for m in (upper, middle, end))
    along = unit(stop - start)
    beside = bend - start - np.sum((bend - start) * along, axis=-1, keepdims=True) * along
    # a straight limb has no plane of its own: the upper bone's roll says it
    normal = moved(rotation(upper), limb.normals[0])
    reach = _norm(bend - start) + _norm(stop - bend)
    straight = _norm(beside) < 1e-7 * reach
    rolled = across(cross(normal, along), along, normal)
    side = np.where(straight[..., None], rolled, across(beside, along, rolled))
    far = float(np.linalg.norm(plan.control_rest[limb.pole][:3, 3] - plan.rest[limb.joints[1]][:3, 3]))
    pole_place = bend + side * far
    found: dict[int, Floats] = {}
    found[limb.goal] = end @ inverse(plan.offset(limb.goal, limb.joints[2]))
    found[limb.pole] = frame(
        np.broadcast_to(rotation(plan.control_rest[limb.pole]), (*pole_place.shape[:-1], 3, 3)), pole_place
    )
    plane = cross(along, side)
    for n, (joint, vector) in enumerate(((upper, bend - start), (middle, stop - bend))):
        direction = unit(vector)
        now = across(moved(rotation(joint), limb.normals[n]), direction, plane)
        untwisted = across(plane, direction, now)
        angle = np.arctan2(np.sum(cross(untwisted, now) * direction, axis=-1), np.vecdot(untwisted, now))
        # of one turn and the same turn by a whole round, the one nearest to the frame before
        state.values[module.attribute(("twist", "lower_twist")[n])] = np.unwrap(angle) if angle.ndim else angle
    for name in ("stretch", "soft", "rest_bend"):
        if module.attribute(name) in state.values:
            state.values[module.attribute(name)] = np.zeros(1)
    if module.foot is not None:
        for pivot in PIVOTS:
            state.values[module.foot.attribute(pivot)] = np.zeros(1)
    return found


def fit_toes(state: State, module: LimbModule) -> None:
    """The toes' control for the present places of foot and toes."""
    foot = module.foot
    if foot is None or not foot.toes_joint:
        return
    plan, limb = state.plan, _limb(state.plan, module)
    control, joint = plan.control(foot.toes_control), plan.joint(foot.toes_joint)
    carrier = state.joint(limb.joints[2]) @ plan.rest_inverse[limb.joints[2]]
    frame_now = carrier @ plan.parent_rest[control]
    world = state.joint(joint) @ inverse(plan.offset(control, joint))
    state.local[control] = inverse(frame_now) @ world
    state.frames[control], state.controls[control] = frame_now, world
