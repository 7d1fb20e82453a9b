"""The motion of one body on another: orientations by anatomical frames, the path of the hips by leg length."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import gaussian_filter1d

from keypose.analysis.roles import ROLES, SIDES, RoleMap, find_roles
from keypose.arrays import Floats
from keypose.editing.planting import PlantOptions, plant_feet
from keypose.errors import KeyposeError, ShapeError
from keypose.evaluate import bake, key_rate, match, resample, world_rotations_positions
from keypose.math import quat
from keypose.model import Clip, Motion, Pose, Skeleton
from keypose.retarget.body import BodyFrames, body_frames
from keypose.retarget.report import RetargetReport, body_contacts, compare_motions
from keypose.retarget.stand import find_stand

Roles = RoleMap | Mapping[str, int]

# Frames with heel and ball on the ground that are enough to say how a foot stands.
_FEWEST_FLAT = 5

# How fast hips follow the height of the feet that carry them: the width of a Gauss filter in seconds.
_HIPS_FOLLOW_S = 0.15


@dataclass(frozen=True, slots=True, eq=False)
class RetargetResult:
    """The motion on the target, how well it fits, and what was guessed.

    ``touching``: point of a foot (``left_heel``, ``left_ball`` ...) -> (T,) bool, when it touches the ground in the source.
    """

    motion: Motion
    report: RetargetReport
    source: BodyFrames
    target: BodyFrames
    touching: Mapping[str, np.ndarray]
    notes: tuple[str, ...] = ()


def retarget(
    animation: Motion | Clip,
    source: Skeleton,
    target: Skeleton,
    *,
    source_roles: Roles | None = None,
    target_roles: Roles | None = None,
    source_reference: Pose | None = None,
    target_reference: Pose | None = None,
    target_motion: Motion | None = None,
    target_ground_m: float | None = None,
    scale: float | None = None,
    plant: PlantOptions | None = PlantOptions(),
    rate_hz: float | None = None,
) -> RetargetResult:
    """A motion of one humanoid on another, by the roles of their joints.

    Bones of arms, legs and fingers point exactly where the source's do; trunk, head, shoulders and feet turn by what the
    source turns out of its reference pose, shared out along spines of other joint counts. The hips' path is scaled by leg
    length (or ``scale``), with the ankles' lowest height on the target's own. A foot is level where the source stands on heel
    and ball. Then feet in contact are planted (``plant``;
    None leaves that out). Joints without a role keep their rest pose, joints of twist take their share of the hand's.

    ``source_reference`` and ``target_reference`` are upright stands (no batch). If not given, they are the rest poses, turned
    upright where they lie, or, where a rest pose is no stand at all, the most upright frame of the motion (of
    ``target_motion``, any motion that the target has, for the target); a note says so.
    ``target_ground_m``: height of the ground under the target in its reference pose, if its lowest joint is not it.

    Raises:
        KeyposeError: where a skeleton is no humanoid.
        ShapeError: where the motion has no frames or the scale is not positive.

    Source: M. Gleicher, "Retargetting motion to new characters" (SIGGRAPH 1998), for what is to be kept: contacts.
    """
    motion = _as_motion(animation, source, rate_hz)
    if motion.frame_count == 0:
        raise ShapeError(f"motion '{motion.name}' has no frames")
    notes: list[str] = []
    maps = [_roles_of(source, source_roles, source_reference), _roles_of(target, target_roles, target_reference)]
    if source_reference is None:
        source_reference, note = find_stand(source, maps[0], motion)
        notes.extend([f"source: {note}"] if note else [])
    if target_reference is None:
        target_reference, note = find_stand(target, maps[1], target_motion)
        notes.extend([f"target: {note}"] if note else [])
    shared = set(maps[0]) & set(maps[1])
    lost = [role for role in ROLES if role in maps[0] and role not in maps[1]]
    if lost:
        notes.append(
            f"the target has no {', '.join(lost[:6])}{' ...' if len(lost) > 6 else ''}; that part of the motion is left out"
        )
    own = body_frames(source, maps[0], source_reference, only=shared)
    other = body_frames(target, maps[1], target_reference, target_ground_m, only=shared)
    if scale is not None and not (np.isfinite(scale) and scale > 0):
        raise ShapeError(f"scale: expected more than 0, got {scale}")
    ratio = other.leg_m / own.leg_m if scale is None else float(scale)
    turned, places = (np.asarray(a, np.float64) for a in world_rotations_positions(source, motion.pose.broadcast()))
    touching = body_contacts(own, places, motion.rate_hz, plant or PlantOptions())
    own = _levelled(own, turned, touching)
    model = _model_rotations(own, other, turned)
    hips = _hips_path(own, other, turned, places, model, ratio)
    moved = _as_pose(other, model, hips)
    rise = _rise(other, moved, touching, None if plant is None else motion.rate_hz)
    if np.any(rise):
        hips[:, 1] += rise
        moved = _as_pose(other, model, hips)
    result = Motion(
        target.names,
        moved,
        motion.rate_hz,
        name=motion.name,
        start_s=motion.start_s,
        morph_names=motion.morph_names,
        morph_weights=motion.morph_weights,
        events=motion.events,
    )
    if plant is not None:
        result = plant_feet(
            result, target, other.roles, touching=touching, heights=other.places[:, 1], options=plant
        ).motion
    report = compare_motions(motion, own, result, other, plant or PlantOptions())
    return RetargetResult(result, report, own, other, touching, tuple(notes))


def _as_motion(animation: Motion | Clip, skeleton: Skeleton, rate_hz: float | None) -> Motion:
    if isinstance(animation, Clip):
        rate = rate_hz or animation.rate_hz or key_rate(animation) or 30.0
        return bake(animation, skeleton, rate)
    motion = match(animation, skeleton)
    return motion if rate_hz is None or rate_hz == motion.rate_hz else resample(motion, rate_hz)


def _roles_of(skeleton: Skeleton, roles: Roles | None, pose: Pose | None) -> dict[str, int]:
    if roles is None:
        found = find_roles(skeleton, pose)
        if found.on_all_fours:
            raise KeyposeError(
                f"the skeleton of '{skeleton.names[0]}' stands on four feet; to retarget it all the same, give its roles as a map"
            )
        if found.missing:
            raise KeyposeError(
                f"the skeleton of '{skeleton.names[0]}' is no humanoid: nothing plays {', '.join(found.missing[:5])}; "
                "name its joints in a map of roles"
            )
        return dict(found.roles)
    return dict(roles.roles if isinstance(roles, RoleMap) else roles)


def _levelled(own: BodyFrames, turned: Floats, touching: Mapping[str, np.ndarray]) -> BodyFrames:
    """The source with feet that are level where heel and ball stand on the ground, whatever its reference pose says."""
    frames = dict(own.joint_from_frame)
    for side in SIDES:
        if f"{side}_heel" not in touching or f"{side}_ball" not in touching:
            continue
        flat = touching[f"{side}_heel"] & touching[f"{side}_ball"]
        if int(flat.sum()) < _FEWEST_FLAT:
            continue
        for role in (f"{side}_foot", f"{side}_toes"):
            standing = quat.multiply(turned[flat, own.roles[role]], frames[role])
            ahead = quat.rotate(standing, np.broadcast_to([0.0, 0.0, 1.0], (len(standing), 3)))
            rise = float(np.median(np.arcsin(np.clip(ahead[:, 1], -1.0, 1.0))))
            # about the foot's own left: a positive turn lowers the toes
            frames[role] = quat.multiply(frames[role], quat.from_axis_angle(np.array([1.0, 0.0, 0.0]), np.array(rise)))
    return replace(own, joint_from_frame=frames)


# --- orientations -----------------------------------------------------------------------------------------------------


def _model_rotations(own: BodyFrames, other: BodyFrames, turned: Floats) -> Floats:
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
    for joint, parent in enumerate(other.skeleton.parents):
        if joint in wanted:
            model[:, joint] = wanted[joint]
        elif parent < 0:
            model[:, joint] = other.rotations[joint]
        else:
            local = quat.multiply(quat.conjugate(other.rotations[parent]), other.rotations[joint])
            model[:, joint] = quat.multiply(model[:, parent], local)
    _share_twist(other, model)
    return model


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


def _share_twist(body: BodyFrames, model: Floats) -> None:
    """Joints of twist beside a forearm take their share of the hand's roll, by where they lie along it."""
    parents = body.skeleton.parents
    rest = np.asarray(body.skeleton.rest.rotations, np.float64)
    for side in SIDES:
        if f"{side}_lower_arm" not in body.roles or f"{side}_hand" not in body.roles:
            continue
        arm, hand = body.roles[f"{side}_lower_arm"], body.roles[f"{side}_hand"]
        bone = body.places[hand] - body.places[arm]
        length = float(bone @ bone)
        rolls = [
            j
            for j, name in enumerate(body.skeleton.names)
            if int(parents[j]) == arm and j != hand and ("twist" in name.lower() or "roll" in name.lower())
        ]
        if not rolls or length < 1e-12 or int(parents[hand]) != arm:
            continue
        local = quat.multiply(quat.conjugate(model[:, arm]), model[:, hand])
        out = quat.multiply(local, quat.conjugate(rest[hand]))
        axis = quat.rotate(quat.conjugate(body.rotations[arm]), bone / np.sqrt(length))
        twist = quat.swing_twist(out, np.broadcast_to(axis, (len(model), 3)))[1]
        for joint in rolls:
            share = float(np.clip((body.places[joint] - body.places[arm]) @ bone / length, 0.0, 1.0))
            part = quat.power(quat.shortest(twist), np.full(len(model), share))
            model[:, joint] = quat.multiply(model[:, arm], quat.multiply(part, rest[joint]))


# --- the path of the hips ---------------------------------------------------------------------------------------------


def _hips_path(
    own: BodyFrames, other: BodyFrames, turned: Floats, places: Floats, model: Floats, ratio: float
) -> Floats:
    """Where the target's hips go (T, 3): so that the middle between its hip joints follows the source's."""
    legs = [own.roles[f"{s}_upper_leg"] for s in SIDES]
    middle = places[:, legs].mean(axis=1)
    ankles = places[:, [own.roles[f"{s}_foot"] for s in SIDES], 1]
    floor = float(np.percentile(ankles.min(axis=1), 2.0))
    path = ratio * middle
    path[:, 1] = other.ground_m + other.ankle_m + ratio * (middle[:, 1] - floor)
    # from the middle between the hip joints back to the hips joint itself, as the target is built
    hips = other.roles["hips"]
    offset = other.places[[other.roles[f"{s}_upper_leg"] for s in SIDES]].mean(axis=0) - other.places[hips]
    local = quat.rotate(quat.conjugate(other.rotations[hips]), offset)
    return path - quat.rotate(model[:, hips], np.broadcast_to(local, path.shape))


def _rise(other: BodyFrames, pose: Pose, touching: Mapping[str, np.ndarray], rate_hz: float | None) -> Floats:
    """How far the hips have to go up (T,) so that feet in contact are about as high as they stand.

    Smooth in time; without a rate it is the same for all frames.

    Captured feet are some centimetres off their floor, each by its own. Left to the legs alone, knees would bend and stretch
    for that; hips that follow the feet that carry them keep the legs as they are.
    """
    places = np.asarray(world_rotations_positions(other.skeleton, pose)[1], np.float64)
    total, weight = np.zeros(len(places)), np.zeros(len(places))
    for side in SIDES:
        points = [
            np.where(touching[f"{side}_{point}"], other.places[joint, 1] - places[:, joint, 1], -np.inf)
            for point, joint in (("heel", other.roles.get(f"{side}_foot")), ("ball", other.roles.get(f"{side}_toes")))
            if joint is not None and f"{side}_{point}" in touching
        ]
        if points:
            under = np.max(points, axis=0)
            carrying = np.isfinite(under)
            total[carrying] += under[carrying]
            weight += carrying
    frames = np.flatnonzero(weight)
    if not len(frames):
        return total
    if rate_hz is None:
        return np.full(len(total), np.median(total[frames] / weight[frames]))
    # Between contacts it goes over in a straight line, and all of it is made smooth.
    curve = np.interp(np.arange(len(total)), frames, total[frames] / weight[frames])
    return gaussian_filter1d(curve, _HIPS_FOLLOW_S * rate_hz, mode="nearest")


def _as_pose(body: BodyFrames, model: Floats, hips_path: Floats) -> Pose:
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
        translations[:, hips] = hips_path
    else:
        above = body.places[parent]  # what lies above the hips stands as in the reference pose
        scale = _scale_above(body, parent)
        translations[:, hips] = quat.rotate(quat.conjugate(model[:, parent]), hips_path - above) / scale
    scales = np.broadcast_to(np.asarray(rest.scales, np.float64), (frames, *rest.scales.shape))
    dtype = np.result_type(rest.rotations)
    return Pose(translations.astype(dtype), rotations.astype(dtype), scales.astype(dtype))


def _scale_above(body: BodyFrames, joint: int) -> Floats:
    scale = np.ones(3)
    while joint >= 0:
        scale = scale * np.asarray(body.skeleton.rest.scales, np.float64)[joint]
        joint = int(body.skeleton.parents[joint])
    return scale
