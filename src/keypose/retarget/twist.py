"""The roll of a limb, shared out along it: joints of twist beside a bone, and bones in several pieces.

A forearm whose hand turns over, or an upper arm that turns in its socket, rolls little by little along its length. With all
of the roll in one joint the skin is wrung like the wrapper of a sweet.
"""

from __future__ import annotations

import numpy as np

from keypose.analysis.anatomy import ROLLING_BONES, TWIST_ASIDE, TWIST_NAME
from keypose.analysis.roles import SIDES
from keypose.arrays import Floats
from keypose.math import quat
from keypose.retarget.body import BodyFrames


def share_rolls(body: BodyFrames, model: Floats) -> dict[int, Floats]:
    """Rotations in the model's space (T, 4) of joints that take a share of a limb's roll; ``model`` (T, J, 4) as it is without.

    A joint of twist at the share ``u`` of a bone's length takes ``u`` of the roll. Of a bone in several pieces each takes what
    is due where it begins, or, in an upper arm or thigh, which rolls in its socket, where it ends.
    """
    found: dict[int, Floats] = {}
    for side in SIDES:
        for bone, end, own in ROLLING_BONES:
            if f"{side}_{bone}" in body.roles and f"{side}_{end}" in body.roles:
                a, b = body.roles[f"{side}_{bone}"], body.roles[f"{side}_{end}"]
                pieces = _pieces(body, a, b)
                shares = _shares(body, a, b, own, pieces)
                if shares:
                    rolled = _rolled(body, model, a, b, own, shares)
                    if own and pieces[0] in rolled and len(pieces) > 1:
                        _aim(body, model, pieces, b, rolled)
                    found.update(rolled)
    return found


def _pieces(body: BodyFrames, a: int, b: int) -> list[int]:
    """The joints that a bone from ``a`` to ``b`` is made of, ``a`` first; none where ``b`` does not hang on ``a``."""
    path, joint = list[int](), int(body.skeleton.parents[b])
    while joint >= 0 and joint != a:
        path.append(joint)
        joint = int(body.skeleton.parents[joint])
    return [a, *path[::-1]] if joint == a else []


def _aim(body: BodyFrames, model: Floats, pieces: list[int], b: int, rolled: dict[int, Floats]) -> None:
    """Pieces that do not lie on one line point elsewhere when each has its own roll: bring their end back (in ``rolled``)."""

    def carried(rotation: Floats, joint: int, way: Floats) -> Floats:
        turn = quat.multiply(rotation, quat.conjugate(body.rotations[joint]))
        return quat.rotate(turn, np.broadcast_to(way, (len(turn), 3)))

    ends = [*pieces[1:], b]
    now = np.sum(
        [carried(rolled[j], j, body.places[end] - body.places[j]) for j, end in zip(pieces, ends, strict=True)], axis=0
    )
    wanted = carried(model[:, pieces[0]], pieces[0], body.places[b] - body.places[pieces[0]])
    turn = quat.from_two_vectors(*(way / np.linalg.norm(way, axis=-1, keepdims=True) for way in (now, wanted)))
    for joint in pieces:
        rolled[joint] = quat.multiply(turn, rolled[joint])


def _shares(body: BodyFrames, a: int, b: int, own: bool, pieces: list[int]) -> dict[int, float]:
    """Joint -> share of the roll."""
    parents = body.skeleton.parents
    bone = body.places[b] - body.places[a]
    length = float(np.linalg.norm(bone))
    if not pieces or length < 1e-9:
        return {}

    def along(j: int) -> tuple[float, float]:
        out = body.places[j] - body.places[a]
        u = float(out @ bone) / length**2
        return u, float(np.linalg.norm(out - u * bone)) / length

    shares: dict[int, float] = {}
    if len(pieces) > 1 and all(along(j)[1] < TWIST_ASIDE for j in pieces):
        starts = [float(np.clip(along(j)[0], 0.0, 1.0)) for j in pieces]
        for n, j in enumerate(pieces):
            if own:
                shares[j] = starts[n + 1] if n + 1 < len(pieces) else 1.0
            elif n > 0:
                shares[j] = starts[n]
    taken = set(body.roles.values())
    near = {a}
    for j, parent in enumerate(parents):
        if int(parent) in near and j not in taken and j not in pieces and TWIST_NAME.search(body.skeleton.names[j]):
            near.add(j)
            u, aside = along(j)
            if aside < TWIST_ASIDE and -0.1 < u < 1.1:
                shares[j] = float(np.clip(u, 0.0, 1.0))
    return shares


def _rolled(body: BodyFrames, model: Floats, a: int, b: int, own: bool, shares: dict[int, float]) -> dict[int, Floats]:
    bone = body.places[b] - body.places[a]
    bone = bone / np.linalg.norm(bone)
    base, of = (int(body.skeleton.parents[a]), a) if own else (a, b)
    if base < 0:
        return {}
    rest = quat.multiply(quat.conjugate(body.rotations[base]), body.rotations[of])
    local = quat.multiply(quat.conjugate(model[:, base]), model[:, of])
    axis = quat.rotate(quat.conjugate(body.rotations[base]), bone)
    swing, twist = quat.swing_twist(quat.multiply(local, quat.conjugate(rest)), np.broadcast_to(axis, (len(model), 3)))
    angle = np.unwrap(2.0 * np.arctan2(twist[:, 1:] @ axis, twist[:, 0]))
    angle -= 2.0 * np.pi * np.rint(np.median(angle) / (2.0 * np.pi))
    start = quat.multiply(model[:, base], swing) if own else model[:, base]
    back = quat.conjugate(body.rotations[base])
    return {
        j: quat.multiply(
            quat.multiply(start, quat.from_axis_angle(np.broadcast_to(axis, (len(model), 3)), share * angle)),
            quat.multiply(back, body.rotations[j]),
        )
        for j, share in shares.items()
    }
