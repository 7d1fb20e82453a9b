"""The joints of the built-in human: names, places, roles, and the axes its joints bend about.

The rest pose is a relaxed A-pose: arms 45 degrees below the horizontal, palms towards the thighs, thumbs forward,
feet on y = 0, facing +Z; the character's left is +X. **Every rest rotation is the identity**, so a joint's local
axes are the model's axes, and a local rotation reads as "turn about this model axis, as seen in the rest pose".
`bend_axis` gives the axis that a positive angle bends the joint about.

The twist joints (``LeftArmTwist``, ``LeftForeArmTwist``, ``LeftUpLegTwist``) are side branches that turn about the bone:
the skin near the far end of the bone follows them, so a wrist's roll shared out to the forearm's twist joint does not
wring the sleeve. Left alone, they change nothing.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from keypose.arrays import Floats
from keypose.errors import UnknownName
from keypose.model import Pose, Skeleton

ARM_DROP = np.pi / 4  # angle of the arms below the horizontal

FINGERS = ("Thumb", "Index", "Middle", "Ring", "Pinky")

_CENTRE = (  # name, parent, place in metres
    ("Hips", "", (0.0, 0.915, 0.0)),
    ("Spine", "Hips", (0.0, 0.985, 0.0)),
    ("Spine1", "Spine", (0.0, 1.085, 0.0)),
    ("Spine2", "Spine1", (0.0, 1.195, -0.006)),
    ("Neck", "Spine2", (0.0, 1.375, -0.022)),
    ("Head", "Neck", (0.0, 1.45, -0.012)),
    ("Jaw", "Head", (0.0, 1.5, 0.005)),
)
JAW_HINGE = _CENTRE[-1][2]

_SHOULDER = (0.155, 1.338, -0.016)
_UPPER_ARM_M, _LOWER_ARM_M = 0.262, 0.238
_ELBOW_BACK_M = 0.006  # a hair behind the line from shoulder to wrist, so that the bend plane is never in doubt

# Of the hand, in (along the fingers, towards the thumb, out of the palm), metres from the wrist.
_FINGERS: dict[str, tuple[tuple[float, float, float], ...]] = {
    "Thumb": ((0.022, 0.022, 0.008), (0.052, 0.046, 0.017), (0.082, 0.063, 0.022), (0.108, 0.074, 0.026)),
    "Index": ((0.088, 0.0300, 0.000), (0.126, 0.0345, 0.003), (0.152, 0.0365, 0.008), (0.172, 0.0375, 0.014)),
    "Middle": ((0.091, 0.0095, -0.002), (0.133, 0.0105, 0.002), (0.161, 0.0105, 0.008), (0.183, 0.0105, 0.015)),
    "Ring": ((0.087, -0.0110, 0.000), (0.125, -0.0135, 0.004), (0.152, -0.0150, 0.010), (0.173, -0.0155, 0.017)),
    "Pinky": ((0.080, -0.0300, 0.003), (0.109, -0.0355, 0.007), (0.130, -0.0385, 0.012), (0.149, -0.0405, 0.018)),
}

_LEG = (
    ("LeftUpLeg", "Hips", (0.092, 0.885, 0.0)),
    ("LeftUpLegTwist", "LeftUpLeg", (0.096, 0.69, 0.004)),
    ("LeftLeg", "LeftUpLeg", (0.101, 0.485, 0.008)),
    ("LeftFoot", "LeftLeg", (0.106, 0.098, -0.022)),
    ("LeftToeBase", "LeftFoot", (0.118, 0.026, 0.098)),
)

# Of the head at life size, see `enlarged`.
EYE_CENTRE = (0.0385, 1.5415, 0.0645)
EYE_RADIUS = 0.031
HEAD_TOP = (0.0, 1.69, -0.02)
TOE_END = (0.127, 0.022, 0.172)

HAND_SCALE = 1.07  # a little larger than life: hands and head carry the acting
HEAD_SCALE = 1.075
_HEAD_PIVOT = np.array([0.0, 1.395, -0.025])


def head_scale(points: Floats) -> Floats:
    """How much larger than life the head is at points modelled at life size, (..., 1): 1 at the collar."""
    u = np.clip((np.asarray(points, np.float64)[..., 1:2] - 1.35) / 0.07, 0.0, 1.0)
    return 1.0 + (HEAD_SCALE - 1.0) * u * u * (3.0 - 2.0 * u)


def enlarged(points: Floats) -> Floats:
    """Where points of the head (..., 3), modelled at life size, lie on the character."""
    return _HEAD_PIVOT + head_scale(points) * (points - _HEAD_PIVOT)


_ROLES = {
    "Hips": "hips",
    "Spine": "spine",
    "Spine1": "chest",
    "Spine2": "upper_chest",
    "Neck": "neck",
    "Head": "head",
    "Jaw": "jaw",
    "LeftEye": "left_eye",
    "LeftShoulder": "left_shoulder",
    "LeftArm": "left_upper_arm",
    "LeftForeArm": "left_lower_arm",
    "LeftHand": "left_hand",
    "LeftUpLeg": "left_upper_leg",
    "LeftLeg": "left_lower_leg",
    "LeftFoot": "left_foot",
    "LeftToeBase": "left_toes",
    "LeftHandThumb1": "left_thumb_metacarpal",
    "LeftHandThumb2": "left_thumb_proximal",
    "LeftHandThumb3": "left_thumb_distal",
} | {
    f"LeftHand{finger}{number}": f"left_{finger.lower().replace('pinky', 'little')}_{bone}"
    for finger in FINGERS[1:]
    for number, bone in ((1, "proximal"), (2, "intermediate"), (3, "distal"))
}


def hand_axes() -> tuple[Floats, Floats, Floats]:
    """Unit axes of the left hand at rest: along the fingers, towards the thumb, out of the palm; (3,) each."""
    along = np.array([np.cos(ARM_DROP), -np.sin(ARM_DROP), 0.0])
    thumb = np.array([0.0, 0.0, 1.0])
    return along, thumb, np.cross(thumb, -along)


def _left_side() -> list[tuple[str, str, tuple[float, ...]]]:
    along, thumb, palm = hand_axes()
    shoulder = np.array(_SHOULDER)
    wrist = shoulder + (_UPPER_ARM_M + _LOWER_ARM_M) * along + 0.004 * thumb
    elbow = shoulder + _UPPER_ARM_M * along - _ELBOW_BACK_M * thumb
    joints: list[tuple[str, str, tuple[float, ...]]] = [
        ("LeftShoulder", "Spine2", (0.028, 1.336, 0.004)),
        ("LeftArm", "LeftShoulder", _SHOULDER),
        ("LeftArmTwist", "LeftArm", tuple((shoulder + elbow) / 2)),
        ("LeftForeArm", "LeftArm", tuple(elbow)),
        ("LeftForeArmTwist", "LeftForeArm", tuple(elbow + (wrist - elbow) * 0.55)),
        ("LeftHand", "LeftForeArm", tuple(wrist)),
    ]
    for finger, places in _FINGERS.items():
        parent = "LeftHand"
        for number, (a, t, p) in enumerate(places[:3], start=1):
            name = f"LeftHand{finger}{number}"
            joints.append((name, parent, tuple(wrist + HAND_SCALE * (a * along + t * thumb + p * palm))))
            parent = name
    return [*joints, *_LEG]


def _finger_tips() -> dict[str, tuple[float, ...]]:
    """Tips of the fingers, relative to their last joints."""
    axes = np.stack(hand_axes())
    return {
        f"LeftHand{finger}3": tuple(HAND_SCALE * (np.array(places[3]) - places[2]) @ axes)
        for finger, places in _FINGERS.items()
    }


def _mirrored(name: str) -> str:
    return name.replace("Left", "Right")


def _mirror(place: tuple[float, ...]) -> tuple[float, ...]:
    return (-place[0], *place[1:])


def _table() -> list[tuple[str, str, tuple[float, ...]]]:
    """Name, parent and model-space place of every joint, parents first."""
    left = _left_side()
    eyes = [("LeftEye", "Head", EYE_CENTRE), ("RightEye", "Head", _mirror(EYE_CENTRE))]
    arm = [j for j in left if "Leg" not in j[0] and "Foot" not in j[0] and "Toe" not in j[0]]
    leg = [j for j in left if j not in arm]
    sides = [
        (_mirrored(n) if flip else n, _mirrored(p) if flip else p, _mirror(x) if flip else x)
        for limb in (arm, leg)
        for flip in (False, True)
        for n, p, x in limb
    ]
    head = [(n, p, tuple(enlarged(np.array(x)))) for n, p, x in (*_CENTRE[5:], *eyes)]
    return [*_CENTRE[:5], *head, *sides]


@cache
def skeleton() -> Skeleton:
    """The skeleton of the built-in human: 61 joints, identity rest rotations, metres."""
    table = _table()
    names = tuple(name for name, _, _ in table)
    place = {name: np.array(x) for name, _, x in table}
    parents = [names.index(parent) if parent else -1 for _, parent, _ in table]
    translations = np.array([x if not parent else place[name] - place[parent] for name, parent, x in table])
    rest = Pose(
        translations.astype(np.float32),
        np.tile(np.array([1, 0, 0, 0], np.float32), (len(names), 1)),
        np.ones((len(names), 3), np.float32),
    )
    tips: dict[str, tuple[float, ...]] = {"Head": tuple(enlarged(np.array(HEAD_TOP)) - place["Head"])}
    tips["LeftToeBase"] = tuple(np.array(TOE_END) - place["LeftToeBase"])
    tips |= _finger_tips()
    tips |= {_mirrored(name): _mirror(tip) for name, tip in tips.items() if name.startswith("Left")}
    ends = tuple((names.index(n), (float(t[0]), float(t[1]), float(t[2]))) for n, t in tips.items())
    return Skeleton(names, np.array(parents), rest, tuple(sorted(ends)))


@cache
def rest_positions() -> dict[str, Floats]:
    """Model-space place of every joint in the rest pose by name, (3,) metres, float64."""
    places: dict[str, Floats] = {}
    for name, _, place in _table():
        array = np.array(place)
        array.setflags(write=False)
        places[name] = array
    return places


def roles() -> dict[str, int]:
    """Role ("hips", "left_upper_arm", ...) -> joint index; the vocabulary is VRM's humanoid in snake_case."""
    names = skeleton().names
    both = dict(_ROLES)
    both |= {_mirrored(n): r.replace("left_", "right_") for n, r in _ROLES.items() if n.startswith("Left")}
    return {role: names.index(name) for name, role in both.items()}


def bend_axis(name: str) -> Floats:
    """The local unit axis (3,) that a positive angle bends the joint about.

    Elbows and knees fold, fingers curl into the palm, the spine, the neck and the head bow forward, the jaw opens,
    the thigh lifts forward, the foot points its toes up, the upper arm lifts sideways, eyes look down.

    Raises:
        UnknownName: for a joint that the built-in skeleton does not have.
    """
    if name not in skeleton().names:
        raise UnknownName("joint", name, skeleton().names)
    _, _, palm = hand_axes()
    plain = name.removeprefix("Left").removeprefix("Right")
    if plain.startswith("Hand") and plain != "Hand":
        axis = np.array([0.0, 0.0, -1.0])  # along x palm: curl towards the palm
        if plain.startswith("HandThumb"):
            bone = twist_axis("Left" + plain)
            axis = np.cross(bone, 0.8 * palm - 0.6 * np.array([0.0, 0.0, 1.0]))  # the thumb folds across the palm
    elif plain in ("ForeArm", "ForeArmTwist"):
        axis = palm  # swings the forearm forward
    elif plain == "Hand":
        axis = np.array([0.0, 0.0, -1.0])
    elif plain in ("Arm", "ArmTwist", "Shoulder"):
        axis = np.array([0.0, 0.0, 1.0])
    elif plain in ("UpLeg", "UpLegTwist", "Foot", "ToeBase"):
        return np.array([-1.0, 0.0, 0.0])
    else:
        return np.array([1.0, 0.0, 0.0])
    axis = axis / np.linalg.norm(axis)
    # A rotation is mirrored in the plane x = 0 by turning its axis' y and z round.
    return axis * (1, -1, -1) if name.startswith("Right") else axis


def twist_axis(name: str) -> Floats:
    """The local unit axis (3,) along the bone, from the joint to the next joint of its chain.

    Raises:
        UnknownName: for a joint that the built-in skeleton does not have.
    """
    places, body = rest_positions(), skeleton()
    joint = body.index(name)
    chain = [c for c in body.children(joint) if "Twist" not in body.names[c]]
    ends = dict(body.end_offsets)
    if joint in ends:
        along = np.array(ends[joint])
    elif name.endswith("Twist"):
        along = twist_axis(name.removesuffix("Twist"))
    elif name.endswith("Eye"):
        along = np.array([0.0, 0.0, 1.0])
    elif not chain:
        along = np.array([0.0, -0.085, 0.09])  # the jaw: hinge to chin
    else:
        along = places[body.names[chain[0]]] - places[name]
        if name.endswith("Hand"):
            along = hand_axes()[0] * ((1, 1, 1) if name.startswith("Left") else (-1, 1, 1))
    return along / np.linalg.norm(along)
