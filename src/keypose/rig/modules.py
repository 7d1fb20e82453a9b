"""How joints follow controls: one function for each kind of module, and the way back for fitting.

``move`` places a module's joints; ``wanted`` says where its controls would have to be to give joints their present places.
"""

from __future__ import annotations

import numpy as np

from keypose.arrays import Floats
from keypose.model import (
    EyesModule,
    FingersModule,
    FollowModule,
    HeadModule,
    LimbModule,
    Module,
    SpineModule,
    TwistModule,
)
from keypose.rig import limbs, twists
from keypose.rig.frames import about, frame, inverse, lengths, moved, rotation, shared, spin, to_matrix, unit
from keypose.rig.state import State, blend

# Of eyes: what a rotation's matrix may differ by before it counts as roll.
_ROLL = 1e-3


def move(state: State, module: Module) -> None:
    """Place the joints of a module by its controls and values."""
    if isinstance(module, LimbModule):
        limbs.move_limb(state, module)
    elif isinstance(module, SpineModule):
        _move_spine(state, module)
    elif isinstance(module, HeadModule):
        _move_head(state, module)
    elif isinstance(module, EyesModule):
        _move_eyes(state, module)
    elif isinstance(module, FingersModule):
        _move_fingers(state, module)
    elif isinstance(module, TwistModule):
        twists.move_twists(state, module)
    else:
        _follow(state, module)


def wanted(state: State, module: Module) -> dict[int, Floats]:
    """Model-from-control of the controls that give a module's joints their present places; sets values that it needs.

    Controls that the module places itself (`plan.owned_controls`) are not among them; see `fit_owned`.
    """
    plan = state.plan
    found: dict[int, Floats] = {}
    if isinstance(module, FollowModule) and module.carrier:
        carrier = plan.control(module.carrier)
        found[carrier] = state.joint(plan.joint(module.joints[0])) @ inverse(
            plan.offset(carrier, plan.joint(module.joints[0]))
        )
    if isinstance(module, (FollowModule, LimbModule, SpineModule, HeadModule)):
        for joint, control in _pairs(state, module):
            found[control] = state.joint(joint) @ inverse(plan.offset(control, joint))
    if isinstance(module, LimbModule):
        found.update(limbs.wanted_limb(state, module))
    elif isinstance(module, SpineModule):
        goal, top = plan.control(module.goal), plan.joint(module.joints[-1])
        found[goal] = state.joint(top) @ inverse(plan.offset(goal, top))
    elif isinstance(module, EyesModule):
        for joint, control in _pairs(state, module):
            # straight ahead of the eye, as far as at rest
            found[control] = state.joint(joint) @ plan.rest_inverse[joint] @ plan.control_rest[control]
            aimed = _aimed(state, joint, found[control], control)
            if np.abs(rotation(aimed) - rotation(state.joint(joint))).max(initial=0.0) > _ROLL:
                # they roll, which no target says: their own channels go on
                state.values[module.attribute("look")] = np.zeros(1)
    elif isinstance(module, TwistModule):
        twists.fit_twists(state, module)
    return found


def fit_owned(state: State, module: Module) -> None:
    """Set the local transforms of the controls that a module places itself, from the places of its joints."""
    plan = state.plan
    if isinstance(module, FingersModule):
        hand = plan.joint(module.hand)
        for finger in module.fingers:
            carrier = state.joint(hand) @ plan.rest_inverse[hand]
            frame_now = carrier @ plan.parent_rest[plan.control(finger.controls[0])]
            for joint, control in _pairs(state, finger):
                world = state.joint(joint) @ inverse(plan.offset(control, joint))
                state.local[control] = inverse(frame_now) @ world
                state.frames[control], state.controls[control] = frame_now, world
                frame_now = world
    elif isinstance(module, LimbModule):
        limbs.fit_toes(state, module)


def _pairs(state: State, item: object) -> list[tuple[int, int]]:
    joints, controls = item.joints, item.controls  # type: ignore[attr-defined]
    return [(state.plan.joint(j), state.plan.control(c)) for j, c in zip(joints, controls, strict=True)]


def _follow(state: State, module: FollowModule | SpineModule | HeadModule) -> None:
    for joint, control in _pairs(state, module):
        state.joints[joint] = state.control(control) @ state.plan.offset(control, joint)


# ---- spine -------------------------------------------------------------------------------------------------------------


def _move_spine(state: State, module: SpineModule) -> None:
    _follow(state, module)
    switch = module.attribute("ik")
    if state.is_zero(switch):
        return
    plan = state.plan
    joints = [plan.joint(j) for j in module.joints]
    goal = plan.control(module.goal)
    target = state.control(goal) @ plan.offset(goal, joints[-1])
    # IK bends what FK gives, so that controls fitted on both sides agree
    straight = [state.joint(j) for j in joints]
    turn = rotation(target) @ np.swapaxes(rotation(straight[-1]), -1, -2)
    count = len(joints)
    # every joint turns by its part of what the chest turns, and carries what lies above
    bent: list[Floats] = []
    place = straight[0][..., :3, 3]
    for n, at_rest in enumerate(straight):
        part = shared(turn, np.array((n + 1) / count))
        bent.append(frame(part @ at_rest[..., :3, :3], place))
        if n + 1 < count:
            place = place + moved(part, straight[n + 1][..., :3, 3] - at_rest[..., :3, 3])
    if count > 1:
        start, wish = bent[0][..., :3, 3], target[..., :3, 3]
        now = bent[-1][..., :3, 3] - start
        need = wish - start
        swing = turn_between(now, need)
        reach = np.sqrt(np.vecdot(now, now))
        ratio = np.sqrt(np.vecdot(need, need)) / np.where(reach == 0, 1.0, reach)
        grow = 1.0 + np.clip(state.value(module.attribute("stretch")), 0.0, 1.0) * (ratio - 1.0)
        for n, joint_frame in enumerate(bent):
            where = start + moved(swing, joint_frame[..., :3, 3] - start) * grow[..., None]
            linear = joint_frame[..., :3, :3]
            bent[n] = frame(swing @ linear if n + 1 < count else linear, where)
    size = lengths(target[..., :3, :3])
    bent[-1] = frame(rotation(target) * size[..., None, :], bent[-1][..., :3, 3])
    for joint, before, solved in zip(joints, straight, bent, strict=True):
        state.joints[joint] = blend(state, switch, before, solved)


# ---- head and eyes -----------------------------------------------------------------------------------------------------


def _move_head(state: State, module: HeadModule) -> None:
    _follow(state, module)
    look = module.attribute("look")
    if state.is_zero(look):
        return
    plan = state.plan
    joints = [plan.joint(j) for j in module.joints]
    target = plan.control(module.target)
    weight = np.clip(state.value(look), 0.0, 1.0)
    place = state.control(target)[..., :3, 3]
    head = joints[-1]
    ahead = plan.rest_inverse[head] @ plan.control_rest[target][:, 3]
    for n, share in enumerate(module.shares):
        last = state.joint(head)
        now, wish = moved(last, ahead[:3]), place - last[..., :3, 3]
        part = shared(turn_between(now, wish), weight * share)
        start = state.joint(joints[n])[..., :3, 3]
        for joint in joints[n:]:
            state.joints[joint] = about(start, part, state.joint(joint))


def _move_eyes(state: State, module: EyesModule) -> None:
    look = module.attribute("look")
    weight = np.clip(state.value(look), 0.0, 1.0)
    for joint, control in _pairs(state, module):
        base = state.above(joint) @ state.base[joint]
        if np.any(weight):
            base = blend(state, look, base, _aimed(state, joint, state.control(control), control))
        state.joints[joint] = base


def _aimed(state: State, joint: int, target: Floats, control: int) -> Floats:
    """An eye turned out of its rest pose towards a target, the short way."""
    plan = state.plan
    turns = to_matrix(np.asarray(plan.skeleton.rest.rotations[joint], np.float64))
    local = state.base[joint]
    still = state.above(joint) @ frame(turns * lengths(local[..., :3, :3])[..., None, :], local[..., :3, 3])
    ahead = (plan.rest_inverse[joint] @ plan.control_rest[control][:, 3])[:3]
    place = still[..., :3, 3]
    return about(place, turn_between(moved(still, ahead), target[..., :3, 3] - place), still)


def turn_between(now: Floats, wish: Floats) -> Floats:
    """The shortest rotation (N, 3, 3) from one direction to another; none where either has no length."""
    a, b = np.broadcast_arrays(unit(now), unit(wish))
    c = np.vecdot(a, b)
    axis = np.cross(a, b)
    # (1 + c) vanishes for opposite directions: those turn by half a turn about any axis across
    opposite = c < -1.0 + 1e-12
    safe = np.where(opposite, 1.0, 1.0 + c)[..., None, None]
    zero = np.zeros(axis.shape[:-1])
    x, y, z = axis[..., 0], axis[..., 1], axis[..., 2]
    skew = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(*axis.shape[:-1], 3, 3)
    turn = np.eye(3) + skew + skew @ skew / safe
    if np.any(opposite):
        other = np.eye(3)[np.argmin(np.abs(a), axis=-1)]
        half = unit(np.cross(a, other))
        turn = np.where(opposite[..., None, None], spin(half, np.full(c.shape, np.pi)), turn)
    still = (np.vecdot(a, a) == 0) | (np.vecdot(b, b) == 0)
    return np.where(still[..., None, None], np.eye(3), turn)


# ---- fingers -----------------------------------------------------------------------------------------------------------


def _move_fingers(state: State, module: FingersModule) -> None:
    plan = state.plan
    hand = plan.joint(module.hand)
    carrier = state.joint(hand) @ plan.rest_inverse[hand]
    curl, spread = module.attribute("curl"), module.attribute("spread")
    for finger in module.fingers:
        own = f"{finger.name}.curl"
        curled, fanned = not state.is_zero(curl, own), finger.spread != 0 and not state.is_zero(spread)
        amount = state.value(curl) + state.value(own)
        frame_now = carrier @ plan.parent_rest[plan.control(finger.controls[0])]
        for n, (joint, control) in enumerate(_pairs(state, finger)):
            if curled or fanned:
                turn = np.eye(3)[None]
                if fanned and n == 0:
                    turn = _about_axis(2, state.value(spread) * finger.spread)
                if curled:
                    turn = turn @ _about_axis(0, amount * finger.bends[n])
                # values bend the finger before its control does, so that a key goes on from there
                local_rest = plan.local_rest[control]
                frame_used = frame_now @ local_rest @ frame(turn, np.zeros(3)) @ inverse(local_rest)
            else:
                frame_used = frame_now
            world = state.put(control, frame_used)
            state.joints[joint] = world @ plan.offset(control, joint)
            frame_now = world


def _about_axis(axis: int, angle: Floats) -> Floats:
    return spin(np.broadcast_to(np.eye(3)[axis], (*angle.shape, 3)), angle)
