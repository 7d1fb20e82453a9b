"""From a few readable controls to the joints of the built-in human: `Controls` in, `Motion` out.

A performance is written the way an animator thinks: where the hips and the feet are, how the back, the head and the
arms lean and turn. Legs are solved in closed form so that planted feet stay planted.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from keypose.arrays import Floats
from keypose.ik import limb_rotations, solve_limb
from keypose.math import quat
from keypose.model import Motion, Pose
from keypose.samples.skeleton import FINGERS, bend_axis, hand_axes, rest_positions, skeleton, twist_axis

SIDES = ("Left", "Right")

# Of the upper arm's twist, which an elbow cannot take and a shoulder's skin not all of; the joint of twist has the rest.
_AT_THE_SHOULDER = 0.6
Track = Floats | float


def _zero3() -> Floats:
    return np.zeros(3)


@dataclass(slots=True)
class Arm:
    """One arm; angles in degrees, tracks (T,) or numbers.

    ``lift`` is the angle from hanging straight down, ``swing`` is forward, ``twist`` turns the elbow outwards;
    ``bend`` folds the elbow, ``roll`` turns the forearm's thumb inwards, ``hand`` bows the wrist to the palm,
    ``tilt`` bends it to the thumb; ``curl`` closes the fingers (0 flat, 1 fist), ``spread`` fans them out.
    """

    lift: Track = 9.0
    swing: Track = 0.0
    twist: Track = 0.0
    bend: Track = 16.0
    roll: Track = 0.0
    hand: Track = 2.0
    tilt: Track = 0.0
    curl: Track = 0.22
    spread: Track = 0.0
    shrug: Track = 0.0
    forward: Track = 0.0  # of the shoulder


@dataclass(slots=True)
class Foot:
    """One foot: where its ankle is, model space, metres; angles in degrees, tracks (T,) or numbers.

    ``pitch`` lifts the toes, ``yaw`` turns them outwards, ``toe`` bends the toe joint upwards, ``knee`` turns the
    knee outwards. ``None`` for the place keeps the foot where it is at rest.
    """

    place: Floats | None = None
    pitch: Track = 0.0
    yaw: Track = 4.0
    toe: Track = 0.0
    knee: Track = 5.0


@dataclass(slots=True)
class Controls:
    """Everything a performance says about T moments; angles are [pitch forward, yaw left, roll right] in degrees."""

    frames: int
    hips_move: Floats = field(default_factory=_zero3)  # from rest, metres, (T, 3)
    hips_turn: Floats = field(default_factory=_zero3)
    spine: Floats = field(default_factory=_zero3)  # shared by the three spine joints
    neck: Floats = field(default_factory=_zero3)
    head: Floats = field(default_factory=_zero3)
    arms: dict[str, Arm] = field(default_factory=lambda: {side: Arm() for side in SIDES})
    feet: dict[str, Foot] = field(default_factory=lambda: {side: Foot() for side in SIDES})
    morphs: Mapping[str, Track] = field(default_factory=dict[str, Track])


def animate(controls: Controls, *, name: str, rate_hz: float) -> Motion:
    """The motion of the built-in human that follows the controls; float32, signs continuous along time."""
    body = skeleton()
    count = controls.frames
    translations = np.tile(body.rest.translations.astype(np.float64), (count, 1, 1))
    translations[:, 0] = hips = rest_positions()["Hips"] + np.broadcast_to(controls.hips_move, (count, 3))

    local = {"Hips": turn(controls.hips_turn), "Neck": turn(controls.neck), "Head": turn(controls.head)}
    spine = np.asarray(controls.spine)
    local |= {joint: turn(spine * share) for joint, share in (("Spine", 0.3), ("Spine1", 0.36), ("Spine2", 0.34))}
    for side in SIDES:
        local |= _arm(side, controls.arms[side])
        local |= _leg(side, controls.feet[side], hips, local["Hips"])

    rotations = np.tile(np.array([1.0, 0, 0, 0]), (count, body.joint_count, 1))
    for joint, local_rotation in local.items():
        rotations[:, body.index(joint)] = local_rotation
    morph_names = tuple(controls.morphs)
    weights = None
    if morph_names:
        tracks = [np.broadcast_to(controls.morphs[n], (count,)) for n in morph_names]
        weights = np.clip(np.stack(tracks, axis=-1), 0, 1).astype(np.float32)
    pose = Pose(
        translations.astype(np.float32),
        quat.align_signs(rotations, axis=0).astype(np.float32),
        body.rest.scales,
    )
    return Motion(body.names, pose, rate_hz, name=name, morph_names=morph_names, morph_weights=weights)


def rotation(axis: Floats, degrees: Track) -> Floats:
    """The rotation about an axis, (*B, 4) float64."""
    return quat.from_axis_angle(np.asarray(axis, np.float64), np.radians(np.asarray(degrees, np.float64)))


def turn(angles_deg: Floats) -> Floats:
    """[pitch forward, yaw left, roll right] as a rotation: yaw, then pitch, then roll, as a body is read."""
    pitch, yaw, roll = np.moveaxis(np.asarray(angles_deg, np.float64), -1, 0)
    x, y, z = np.eye(3)
    return quat.multiply(quat.multiply(rotation(y, yaw), rotation(x, pitch)), rotation(z, -roll))


def _arm(side: str, arm: Arm) -> dict[str, Floats]:
    """Local rotations of one arm and its hand; both are written as a left arm, the right one is its mirror image."""
    x, y, z = np.eye(3)
    along, turned = twist_axis("LeftArm"), -np.asarray(arm.twist, np.float64)
    aimed = quat.multiply(rotation(x, -np.asarray(arm.swing, np.float64)), rotation(z, np.asarray(arm.lift) - 45.0))
    rest_of_twist = rotation(along, (1.0 - _AT_THE_SHOULDER) * turned)
    roll = np.asarray(arm.roll, np.float64)
    fore_along = twist_axis("LeftForeArm")
    wrist = quat.multiply(rotation(bend_axis("LeftHand"), arm.hand), rotation(hand_axes()[2], arm.tilt))
    local = {
        "Shoulder": quat.multiply(rotation(z, arm.shrug), rotation(y, -np.asarray(arm.forward, np.float64))),
        "Arm": quat.multiply(aimed, rotation(along, _AT_THE_SHOULDER * turned)),
        "ArmTwist": rest_of_twist,
        "ForeArm": quat.multiply(rest_of_twist, rotation(bend_axis("LeftForeArm"), arm.bend)),
        "ForeArmTwist": rotation(fore_along, roll / 2),
        "Hand": quat.multiply(rotation(fore_along, roll), wrist),
    }
    for place, finger in enumerate(FINGERS):
        local |= _finger(finger, place, np.asarray(arm.curl, np.float64), np.asarray(arm.spread, np.float64))
    if side == "Right":
        local = {joint: q * (1, 1, -1, -1) for joint, q in local.items()}
    return {side + joint: q for joint, q in local.items()}


def _finger(finger: str, place: int, curl: Floats, spread: Floats) -> dict[str, Floats]:
    """Three joints of a left finger; outer fingers close a little more, as a relaxed hand does."""
    if finger == "Thumb":
        angles = (curl * 28 - spread * 10, curl * 38, curl * 46)
    else:
        more = 0.86 + 0.09 * place
        angles = (curl * 74 * more, curl * 92 * more, curl * 58 * more)
    local = {
        f"Hand{finger}{number}": rotation(bend_axis(f"LeftHand{finger}{number}"), angle)
        for number, angle in enumerate(angles, start=1)
    }
    if finger != "Thumb":  # fan out from the middle finger
        fan = rotation(hand_axes()[2], spread * (2 - place) * 7)
        local[f"Hand{finger}1"] = quat.multiply(fan, local[f"Hand{finger}1"])
    return local


def _leg(side: str, foot: Foot, hips: Floats, hips_rotation: Floats) -> dict[str, Floats]:
    """Local rotations of one leg that bring the ankle to its place and the foot to its angles."""
    rest = rest_positions()
    thigh, knee, ankle = rest[f"{side}UpLeg"], rest[f"{side}Leg"], rest[f"{side}Foot"]
    out = 1.0 if side == "Left" else -1.0
    yaw = rotation(np.array([0.0, 1, 0]), out * np.asarray(foot.yaw, np.float64))
    forward = np.array([0.0, 0.0, 1.0])
    pole = quat.rotate(rotation(np.array([0.0, 1, 0]), out * np.asarray(foot.knee, np.float64)), forward)
    start = hips + quat.rotate(hips_rotation, thigh - rest["Hips"])
    target = ankle if foot.place is None else foot.place
    result = solve_limb(
        start,
        np.broadcast_to(target, start.shape),
        np.broadcast_to(pole, start.shape),
        upper_m=float(np.linalg.norm(knee - thigh)),
        lower_m=float(np.linalg.norm(ankle - knee)),
        softness_m=0.012,
    )
    direction = (ankle - thigh) / np.linalg.norm(ankle - thigh)
    rest_normal = np.cross(direction, forward)
    world_upper, world_lower = limb_rotations((knee - thigh, ankle - knee), rest_normal, start, result)
    world_foot = quat.multiply(yaw, rotation(np.array([-1.0, 0, 0]), foot.pitch))
    return {
        f"{side}UpLeg": quat.multiply(quat.conjugate(hips_rotation), world_upper),
        f"{side}Leg": quat.multiply(quat.conjugate(world_upper), world_lower),
        f"{side}Foot": quat.multiply(quat.conjugate(world_lower), world_foot),
        f"{side}ToeBase": rotation(np.array([-1.0, 0, 0]), foot.toe),
    }
