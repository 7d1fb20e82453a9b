"""The motion of one body on another: orientations by anatomical frames, the hips' path by leg length, feet that hold."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from keypose.analysis.contacts import foot_contacts
from keypose.analysis.roles import RoleMap, find_roles, joints_by_role
from keypose.arrays import Floats, finite
from keypose.editing.planting import PlantOptions, plant_feet
from keypose.errors import KeyposeError, ShapeError
from keypose.evaluate import to_motion, world_rotations_positions
from keypose.model import Clip, Motion, Pose, Skeleton
from keypose.retarget.attach import attach_limbs
from keypose.retarget.body import BodyFrames, body_frames
from keypose.retarget.footing import Footing, all_touching, carried_by, footings, lengthened, levelled, rise
from keypose.retarget.hands import HandOptions, keep_hands
from keypose.retarget.posing import as_pose, hips_path, model_rotations
from keypose.retarget.report import RetargetReport, compare_motions
from keypose.retarget.stand import find_stand

Roles = RoleMap | Mapping[str, int]
Progress = Callable[[int, int], None]

# Percent that are done when contacts are found, bones turned, feet planted, hands kept; shares of the time, about.
_FOUND, _POSED, _PLANTED, _MOVED = 10, 30, 90, 95
_NEW_CONTACT_S = 0.1  # a contact that the source has not is planted if it lasts for so long
_PLANT_ROUNDS = 6  # at most: contacts grow by a few frames, and as a rule are the same after two or three


@dataclass(frozen=True, slots=True, eq=False)
class RetargetResult:
    """The motion on the target, how well it fits, and what was guessed.

    ``touching``: point of a foot (``left_heel``, ``left_ball`` ...) -> (T,) bool, when it touches the ground: as in the source, and as
    long as it does on the target.
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
    hands: HandOptions | None = None,
    rate_hz: float | None = None,
    progress: Progress | None = None,
) -> RetargetResult:
    """A motion of one body on another, by the roles of their joints: humanoids, or animals on all fours.

    Bones of arms, legs and fingers point exactly where the source's do; trunk, head, shoulders and feet turn by what the
    source turns out of its reference pose, shared out along spines of other joint counts. The hips' path is scaled by leg
    length (or ``scale``); they follow the height of the feet that carry them. Then feet in contact are planted (``plant``;
    None leaves that out), and hands keep their place beside body and props (``hands``). Rolls are shared out along limbs;
    joints without a role keep their place beside their parent.

    ``source_reference`` and ``target_reference`` are upright stands (no batch). If not given, they are the rest poses, turned
    upright where they lie; where a rest pose is no stand at all, `find_stand` looks for one in the motion (in ``target_motion``,
    any motion that the target has, for the target). A note says so. `bind_stand` has the pose that a skin was bound in.
    ``target_ground_m``: height of the ground under the target in its reference pose (`ground_under`), if its lowest joint is
    not it. ``progress`` is called with (percent done, 100).

    Raises:
        KeyposeError: where a skeleton is no humanoid or animal, or only one of the two stands on four feet.
        ShapeError: where the motion has no frames or joints at no place, the scale is not positive, or a prop has other frames.

    Source: M. Gleicher, "Retargetting motion to new characters" (SIGGRAPH 1998), for what is to be kept: contacts.
    """
    motion = to_motion(animation, source, rate_hz)
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
    lost = [role for role in maps[0] if role not in maps[1]]
    if lost:
        notes.append(
            f"the target has no {', '.join(lost[:6])}{' ...' if len(lost) > 6 else ''}; that part of the motion is left out"
        )
    if scale is not None and not (np.isfinite(scale) and scale > 0):
        raise ShapeError(f"scale: expected more than 0, got {scale}")
    shared = set(maps[0]) & set(maps[1])
    own = body_frames(source, maps[0], source_reference, only=shared)
    whole = body_frames(target, maps[1], target_reference, target_ground_m, only=shared)
    attached = attach_limbs(target, maps[1])
    other = whole
    if attached is not None:
        names = ", ".join(target.names[joint] for joint in attached.changed)
        notes.append(f"target: {names} hang outside their limbs; they follow them")
        stand = None if target_reference is None else attached.pose_in(target_reference)
        other = body_frames(attached.skeleton, attached.roles(maps[1]), stand, target_ground_m, only=shared)
    if own.on_all_fours != other.on_all_fours:
        raise KeyposeError("one body stands on four feet and the other on two; that motion cannot be taken over")
    show = progress or _silent
    moved, feet, own = _moved(motion, own, other, scale, plant, show)
    off_m = None
    if hands is not None:
        turned, places = _world(source, motion.pose)
        ratio = other.leg_m / own.leg_m if scale is None else float(scale)
        held = keep_hands(own, turned, places, other, moved, hands, ratio, motion.rate_hz)
        moved, off_m = held.pose, held.off_m
    if attached is not None:
        moved = attached.pose_out(moved)
    show(_MOVED, 100)
    result = replace(motion, joint_names=target.names, pose=moved)
    touching = all_touching(feet)
    report = compare_motions(motion, own, result, whole, plant or PlantOptions(), touching)
    if off_m is not None:
        report = replace(report, hands_off_cm=100.0 * float(off_m.mean()) if len(off_m) else 0.0)
    show(100, 100)
    return RetargetResult(result, report, own, whole, touching, tuple(notes))


def _moved(
    motion: Motion,
    own: BodyFrames,
    other: BodyFrames,
    scale: float | None,
    plant: PlantOptions | None,
    show: Progress,
) -> tuple[Pose, list[Footing], BodyFrames]:
    """The target's pose with its feet planted, when they touch the ground, and the source with level feet."""
    turned, places = _world(own.skeleton, motion.pose)
    options = plant or PlantOptions()
    feet = footings(own, other, places, motion.rate_hz, options)
    if not own.on_all_fours:
        own = levelled(own, turned, feet[0].touching)
    show(_FOUND, 100)
    model = model_rotations(own, other, turned)
    hips = hips_path(own, other, turned, places, model, other.leg_m / own.leg_m if scale is None else float(scale))
    moved = as_pose(other, model, hips)
    feet = carried_by(other, moved, feet)
    up = rise(other, moved, feet, None if plant is None else motion.rate_hz)
    if np.any(up):
        hips[:, 1] += up
        moved = as_pose(other, model, hips)
    show(_POSED, 100)
    if plant is not None:
        planted: list[Footing] = []
        told = _part(show, _POSED / 100, (_PLANTED - _POSED) / 100)
        for n, pair in enumerate(feet):
            how = plant if pair.hind else replace(plant, hips="still")
            moved, touching = _planted(
                motion.rate_hz, moved, other, pair, how, _part(told, n / len(feet), 1 / len(feet))
            )
            planted.append(replace(pair, touching=touching))
        feet = planted
    return moved, feet, own


def _planted(
    rate_hz: float, moved: Pose, other: BodyFrames, pair: Footing, options: PlantOptions, show: Progress
) -> tuple[Pose, Mapping[str, np.ndarray]]:
    """A pose with a pair of feet planted, and when they touch the ground.

    A foot of another shape comes down and leaves more flatly than that of the source, and would slide where it touches already,
    or still: contacts are as long as they are on this body.
    """
    shell = Motion(other.skeleton.names, moved, rate_hz)
    planted, touching = moved, dict(pair.touching)
    for turn in range(_PLANT_ROUNDS):
        planted = plant_feet(
            shell, other.skeleton, pair.other, touching=touching, heights=other.places[:, 1], options=options,
            progress=_part(show, turn / _PLANT_ROUNDS, 1 / _PLANT_ROUNDS),
        ).motion.pose  # fmt: skip
        places = np.asarray(world_rotations_positions(other.skeleton, planted)[1], np.float64)
        now = foot_contacts(
            pair.other, places, rate_hz, other.leg_m, height_m=options.height_m, speed_m_s=options.speed_m_s
        )
        longer = lengthened(touching, now, round(_NEW_CONTACT_S * rate_hz))
        if turn + 1 == _PLANT_ROUNDS or all(np.array_equal(longer[p], flags) for p, flags in touching.items()):
            break
        touching = longer
    return planted, touching


def _part(show: Progress, begin: float, share: float) -> Progress:
    """A function for the progress of a part that begins somewhere, of one that is told in hundredths."""
    return lambda done, total: show(round(100 * (begin + share * done / total)), 100)


def _silent(done: int, total: int) -> None:
    """Nobody wants to know."""


def _world(skeleton: Skeleton, pose: Pose) -> tuple[Floats, Floats]:
    turned, places = world_rotations_positions(skeleton, pose.broadcast())
    return np.asarray(turned, np.float64), finite(np.asarray(places, np.float64), "places of the motion's joints")


def _roles_of(skeleton: Skeleton, roles: Roles | None, pose: Pose | None) -> dict[str, int]:
    if roles is None:
        found = find_roles(skeleton, pose)
        if found.missing:
            raise KeyposeError(
                f"the skeleton of '{skeleton.names[0]}' is no humanoid or animal: nothing plays {', '.join(found.missing[:5])}; "
                "name its joints in a map of roles"
            )
        return dict(found.roles)
    return joints_by_role(roles, skeleton)
