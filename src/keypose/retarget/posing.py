"""Orientations of the target's joints by anatomical frames, the path of its hips, and both as a pose."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from keypose.analysis.roles import SIDES
from keypose.arrays import Floats
from keypose.math import quat
from keypose.model import Pose
from keypose.retarget.attach import accumulated_scales
from keypose.retarget.body import BodyFrames
from keypose.retarget.twist import share_rolls


def model_rotations(own: BodyFrames, other: BodyFrames, turned: Floats) -> Floats:
    """model_from_joint rotations (T, J, 4) of the target."""
    frames = turned.shape[0]
    wanted: dict[int, Floats] = {}
    for role, joint in other.roles.items():
        if role in own.roles and role in own.joint_from_frame:
            frame = quat.multiply(turned[:, own.roles[role]], own.joint_from_frame[role])
            # the body may face another way than the source in its reference pose: frames know, so nothing is left to do
            wanted[joint] = quat.multiply(frame, quat.conjugate(other.joint_from_frame[role]))
    for chain in (("hips", "neck"), ("neck", "head")):
        wanted.update(_spine(own, other, turned, *chain))
    model = np.empty((frames, other.skeleton.joint_count, 4))
    for joint in range(other.skeleton.joint_count):
        model[:, joint] = wanted[joint] if joint in wanted else _resting(other, model, joint)
    rolled = share_rolls(other, model)
    for joint, rotation in rolled.items():
        model[:, joint] = rotation
    for joint, parent in enumerate(other.skeleton.parents):  # what hangs on them goes along
        if joint not in wanted and joint not in rolled and int(parent) in rolled:
            rolled[joint] = model[:, joint] = _resting(other, model, joint)
    return model


def _resting(body: BodyFrames, model: Floats, joint: int) -> Floats:
    """A joint as it is in the reference pose, on a parent that has turned."""
    parent = int(body.skeleton.parents[joint])
    if parent < 0:
        return body.rotations[joint]
    return quat.multiply(model[:, parent], quat.multiply(quat.conjugate(body.rotations[parent]), body.rotations[joint]))


def _between(body: BodyFrames, low: str, high: str) -> list[int]:
    """The joints above ``low`` up to, and without, ``high``."""
    if low not in body.roles or high not in body.roles:
        return []
    path, joint = list[int](), int(body.skeleton.parents[body.roles[high]])
    while joint >= 0 and joint != body.roles[low]:
        path.append(joint)
        joint = int(body.skeleton.parents[joint])
    return path[::-1] if joint == body.roles[low] else []


def _spine(own: BodyFrames, other: BodyFrames, turned: Floats, low: str, high: str) -> dict[int, Floats]:
    """Turns out of the reference pose, shared out along a chain of another number of joints."""
    if low not in own.roles or low not in other.roles:
        return {}
    top = high if high in own.roles and high in other.roles else "head"
    first = [own.roles[low]] if low == "neck" else []
    theirs = [*first, *_between(own, low, top)]
    ours = [*([other.roles[low]] if low == "neck" else []), *_between(other, low, top)]
    if not theirs or not ours or top not in own.roles or top not in other.roles:
        return {}
    deltas = [
        quat.multiply(
            quat.multiply(turned[:, j], quat.conjugate(own.rotations[j])),
            quat.multiply(own.facing, quat.conjugate(other.facing)),
        )
        for j in theirs
    ]
    at = _middles(own, theirs, own.roles[top])
    found: dict[int, Floats] = {}
    for n, (joint, place) in enumerate(zip(ours, _middles(other, ours, other.roles[top]), strict=True)):
        if len(ours) == len(theirs):
            delta = deltas[n]
        else:
            k = int(np.clip(np.searchsorted(at, place) - 1, 0, max(len(at) - 2, 0)))
            if len(at) == 1:
                delta = deltas[0]
            else:
                u = float(np.clip((place - at[k]) / max(at[k + 1] - at[k], 1e-12), 0.0, 1.0))
                delta = quat.slerp(deltas[k], deltas[k + 1], np.full(len(turned), u))
        found[joint] = quat.multiply(delta, other.rotations[joint])
    return found


def _middles(body: BodyFrames, joints: Sequence[int], top: int) -> Floats:
    """Where the middle of each joint's bone lies along the chain, 0..1."""
    places = body.places[[*joints, top]]
    lengths = np.linalg.norm(np.diff(places, axis=0), axis=1)
    ends = np.cumsum(lengths)
    return (ends - 0.5 * lengths) / max(float(ends[-1]), 1e-12)


# --- the path of the hips ---------------------------------------------------------------------------------------------


def hips_path(
    own: BodyFrames, other: BodyFrames, turned: Floats, places: Floats, model: Floats, ratio: float
) -> Floats:
    """Where the target's hips go (T, 3): so that the middle between its hip joints follows the source's."""
    legs = [own.roles[f"{s}_upper_leg"] for s in SIDES]
    middle = places[:, legs].mean(axis=1)
    path = ratio * middle
    path[:, 1] = other.ground_m + other.ankle_m + ratio * (middle[:, 1] - ankle_floor_m(own, places))
    # from the middle between the hip joints back to the hips joint itself, as the target is built
    hips = other.roles["hips"]
    offset = other.places[[other.roles[f"{s}_upper_leg"] for s in SIDES]].mean(axis=0) - other.places[hips]
    local = quat.rotate(quat.conjugate(other.rotations[hips]), offset)
    return path - quat.rotate(model[:, hips], np.broadcast_to(local, path.shape))


def ankle_floor_m(body: BodyFrames, places: Floats) -> float:
    """How low the ankles of a body go in a motion (T, J, 3), but for the rarest frames."""
    ankles = places[:, [body.roles[f"{s}_foot"] for s in SIDES], 1]
    return float(np.percentile(ankles.min(axis=1), 2.0))


def as_pose(body: BodyFrames, model: Floats, path: Floats) -> Pose:
    """Local transforms from rotations in the model's space and the place of the hips."""
    skeleton = body.skeleton
    frames = len(model)
    rest = skeleton.rest
    rotations = np.empty_like(model)
    for joint, parent in enumerate(skeleton.parents):
        if parent < 0:
            rotations[:, joint] = model[:, joint]
        else:
            rotations[:, joint] = quat.multiply(quat.conjugate(model[:, parent]), model[:, joint])
    rotations = quat.align_signs(quat.normalize(rotations), axis=0)
    translations = np.broadcast_to(np.asarray(rest.translations, np.float64), (frames, *rest.translations.shape)).copy()
    hips = body.roles["hips"]
    parent = int(skeleton.parents[hips])
    if parent < 0:
        translations[:, hips] = path
    else:
        above = _place(body, model, parent)  # what lies above the hips does not move
        translations[:, hips] = (
            quat.rotate(quat.conjugate(model[:, parent]), path - above)
            / accumulated_scales(skeleton, np.asarray(rest.scales, np.float64))[parent]
        )
    scales = np.broadcast_to(np.asarray(rest.scales, np.float64), (frames, *rest.scales.shape))
    dtype = np.result_type(rest.rotations)
    return Pose(translations.astype(dtype), rotations.astype(dtype), scales.astype(dtype))


def _place(body: BodyFrames, model: Floats, joint: int) -> Floats:
    """Where a joint is in the model's space (T, 3) with rest translations up to the root."""
    parent, rest = int(body.skeleton.parents[joint]), body.skeleton.rest
    offset = np.asarray(rest.translations, np.float64)[joint]
    if parent < 0:
        return np.broadcast_to(offset, (len(model), 3))
    sizes = accumulated_scales(body.skeleton, np.asarray(rest.scales, np.float64))
    way = np.broadcast_to(sizes[parent] * offset, (len(model), 3))
    return _place(body, model, parent) + quat.rotate(model[:, parent], way)
