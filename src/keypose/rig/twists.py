"""Joints of twist: the roll of a bone or of what lies beyond it, shared out along the bone, so that skin is not wrung.

Source: swing-twist decomposition, Dobrowolski (2015).
"""

from __future__ import annotations

import numpy as np

from keypose.analysis.anatomy import ROLLING_BONES, TWIST_ASIDE, TWIST_NAME
from keypose.analysis.roles import SIDES
from keypose.arrays import Floats
from keypose.model import Twist, TwistModule
from keypose.rig.body import Body, bone_of
from keypose.rig.frames import frame, rotation, spin, to_quat
from keypose.rig.plan import rest_frames
from keypose.rig.state import State, blend

# Of a rotation's matrix: what a motion's own twist may differ by.
_SAME = 1e-4


def find_twists(body: Body) -> TwistModule | None:
    """The joints of twist of a body, by their names and places along arms and legs; None where it has none.

    A joint at the share ``u`` of a bone's length takes ``u`` of the roll; so do pieces of a forearm or shin.
    """
    names, places = body.skeleton.names, body.places
    turned = rotation(rest_frames(body.skeleton))
    taken = set(body.roles.values())
    found: list[Twist] = []
    for side in SIDES:
        for bone, end, own in ROLLING_BONES:
            a, b = body.roles[f"{side}_{bone}"], body.roles[f"{side}_{end}"]
            way = places[b] - places[a]
            length = float(np.linalg.norm(way))
            if length < 1e-9 or not body.hangs(b, a):
                continue
            near = {a}
            for j, parent in enumerate(body.parents):
                piece = body.hangs(b, j)
                if parent not in near or j in taken or (piece and own) or not (piece or TWIST_NAME.search(names[j])):
                    continue
                near.add(j)
                out = places[j] - places[a]
                u = float(out @ way) / length**2
                if np.linalg.norm(out - u * way) < TWIST_ASIDE * length and -0.1 < u < 1.1:
                    x, y, z = (float(v) for v in turned[a].T @ bone_of(way))
                    share = float(np.clip(u, 0.0, 1.0))
                    found.append(Twist(names[j], names[a], "" if own else names[b], share, (x, y, z)))
    return TwistModule("twists", tuple(found)) if found else None


def move_twists(state: State, module: TwistModule) -> None:
    """Turn the joints of twist by their share of a roll."""
    follow = module.attribute("follow")
    for twist in module.twists:
        joint = state.plan.joint(twist.joint)
        base = state.above(joint) @ state.base[joint]
        if not state.is_zero(follow):
            base = blend(state, follow, base, _followed(state, twist, base))
        state.joints[joint] = base


def fit_twists(state: State, module: TwistModule) -> None:
    """Leave joints of twist to their own channels where a motion moves them in another way."""
    for twist in module.twists:
        now = state.joint(state.plan.joint(twist.joint))
        if np.abs(rotation(_followed(state, twist, now)) - rotation(now)).max(initial=0.0) > _SAME:
            state.values[module.attribute("follow")] = np.zeros(1)


def _followed(state: State, twist: Twist, base: Floats) -> Floats:
    plan = state.plan
    joint, bone = plan.joint(twist.joint), plan.joint(twist.bone)
    axis = np.asarray(twist.axis) / np.linalg.norm(twist.axis)
    upper, rest = rotation(state.joint(bone)), rotation(plan.rest)
    if twist.end:
        end = plan.joint(twist.end)
        local, at_rest = _back(upper) @ rotation(state.joint(end)), _back(rest[bone]) @ rest[end]
        turned = local @ _back(at_rest)
        share = twist.share
    else:
        above = plan.parents[bone]
        socket = rest[above] if above >= 0 else np.eye(3)
        turned = _back(_back(socket) @ rest[bone]) @ (_back(rotation(state.above(bone))) @ upper)
        share = twist.share - 1.0
    q = to_quat(turned)
    sign = np.where(q[..., 0] < 0, -1.0, 1.0)
    angle = 2.0 * np.arctan2(sign * (q[..., 1:] @ axis), sign * q[..., 0])
    turn = spin(np.broadcast_to(axis, (*angle.shape, 3)), share * angle)
    carried = state.joint(bone)[..., :3, :3] @ turn @ (plan.rest_inverse[bone] @ plan.rest[joint])[:3, :3]
    return frame(carried, base[..., :3, 3])


def _back(turn: Floats) -> Floats:
    return np.swapaxes(turn, -1, -2)
