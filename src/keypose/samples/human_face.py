"""The face shapes of the built-in human: the 52 shapes of ARKit and the 15 visemes of Oculus as vertex offsets.

Shapes are displacement fields over the face, written for the left side; the right side is their mirror image. What
rides on the skin (brows, lashes) moves with it, and eyeballs, teeth and tongue move as the shape asks. Visemes are
sums of the elementary shapes, so everything adds up as morph targets do.

Source: names after Apple's ARBlendShapeLocation and Meta's "Viseme Reference" (Oculus LipSync).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from keypose.arrays import Floats
from keypose.samples import face_lower as lower
from keypose.samples import face_upper as upper
from keypose.samples.face_base import FEATURES, Face

__all__ = ["ARKIT", "FEATURES", "MORPHS", "VISEMES", "Face", "Offsets", "face_shapes"]

ARKIT = (
    "eyeBlinkLeft", "eyeLookDownLeft", "eyeLookInLeft", "eyeLookOutLeft", "eyeLookUpLeft", "eyeSquintLeft",
    "eyeWideLeft", "eyeBlinkRight", "eyeLookDownRight", "eyeLookInRight", "eyeLookOutRight", "eyeLookUpRight",
    "eyeSquintRight", "eyeWideRight", "jawForward", "jawLeft", "jawRight", "jawOpen", "mouthClose", "mouthFunnel",
    "mouthPucker", "mouthLeft", "mouthRight", "mouthSmileLeft", "mouthSmileRight", "mouthFrownLeft", "mouthFrownRight",
    "mouthDimpleLeft", "mouthDimpleRight", "mouthStretchLeft", "mouthStretchRight", "mouthRollLower", "mouthRollUpper",
    "mouthShrugLower", "mouthShrugUpper", "mouthPressLeft", "mouthPressRight", "mouthLowerDownLeft",
    "mouthLowerDownRight", "mouthUpperUpLeft", "mouthUpperUpRight", "browDownLeft", "browDownRight", "browInnerUp",
    "browOuterUpLeft", "browOuterUpRight", "cheekPuff", "cheekSquintLeft", "cheekSquintRight", "noseSneerLeft",
    "noseSneerRight", "tongueOut",
)  # fmt: skip

_BOTH = ("mouthPress", "mouthUpperUp", "mouthLowerDown", "mouthStretch", "mouthSmile", "mouthDimple", "mouthFrown")

# Each viseme as a sum of elementary shapes; names without a side stand for both sides.
VISEMES: dict[str, dict[str, float]] = {
    "viseme_sil": {"mouthPress": 0.15},
    "viseme_PP": {"mouthPress": 0.8, "mouthRollUpper": 0.45, "mouthRollLower": 0.45, "mouthPucker": 0.08},
    "viseme_FF": {"jawOpen": 0.07, "mouthRollLower": 0.8, "mouthUpperUp": 0.42, "mouthShrugLower": 0.35},
    "viseme_TH": {"jawOpen": 0.20, "tongueUp": 0.6, "tongueOut": 0.42, "mouthUpperUp": 0.3, "mouthLowerDown": 0.35},
    "viseme_DD": {"jawOpen": 0.17, "tongueUp": 1.0, "mouthUpperUp": 0.3, "mouthLowerDown": 0.45},
    "viseme_kk": {"jawOpen": 0.26, "mouthUpperUp": 0.3, "mouthLowerDown": 0.3, "mouthStretch": 0.15},
    "viseme_CH": {
        "jawOpen": 0.06,
        "mouthFunnel": 0.65,
        "mouthPucker": 0.12,
        "mouthUpperUp": 0.2,
        "mouthLowerDown": 0.3,
    },
    "viseme_SS": {"jawOpen": 0.03, "mouthStretch": 0.3, "mouthSmile": 0.15, "mouthUpperUp": 0.5, "mouthLowerDown": 0.7},
    "viseme_nn": {"jawOpen": 0.13, "tongueUp": 0.9, "mouthUpperUp": 0.2, "mouthLowerDown": 0.35},
    "viseme_RR": {"jawOpen": 0.12, "mouthFunnel": 0.5, "mouthPucker": 0.2, "mouthLowerDown": 0.15},
    "viseme_aa": {"jawOpen": 0.68, "mouthUpperUp": 0.25, "mouthLowerDown": 0.2},
    "viseme_E": {"jawOpen": 0.30, "mouthStretch": 0.45, "mouthSmile": 0.2, "mouthUpperUp": 0.3, "mouthLowerDown": 0.3},
    "viseme_I": {"jawOpen": 0.14, "mouthSmile": 0.35, "mouthStretch": 0.35, "mouthUpperUp": 0.4, "mouthLowerDown": 0.5},
    "viseme_O": {"jawOpen": 0.42, "mouthFunnel": 0.6, "mouthPucker": 0.35},
    "viseme_U": {"jawOpen": 0.12, "mouthPucker": 0.75, "mouthFunnel": 0.4},
}

MORPHS = (*ARKIT, *VISEMES)


@dataclass(frozen=True, slots=True, eq=False)
class Offsets:
    """The offsets of one shape: of the head's skin and of each separate feature, (V, 3) metres."""

    skin: Floats
    brows: Floats
    eyes: Floats
    catchlights: Floats
    upper_teeth: Floats
    lower_teeth: Floats
    tongue: Floats

    def __add__(self, other: Offsets) -> Offsets:
        return Offsets(*(getattr(self, n) + getattr(other, n) for n in FEATURES))

    def __mul__(self, factor: float) -> Offsets:
        return Offsets(*(getattr(self, n) * factor for n in FEATURES))


def _mirror(face: Face, offsets: dict[str, Floats]) -> dict[str, Floats]:
    """The same shape on the other side."""
    flip = np.array([-1.0, 1.0, 1.0])
    mirrored = {"skin": offsets["skin"][face.head.image] * flip}
    for name in ("brows", "eyes", "catchlights"):
        left, right = np.split(offsets[name], 2)
        mirrored[name] = np.concatenate([right, left]) * flip
    # teeth and tongue are single bodies: their shapes are written for both sides
    for name in ("upper_teeth", "lower_teeth", "tongue"):
        mirrored[name] = offsets[name] * flip
    return mirrored


def face_shapes(face: Face) -> dict[str, Offsets]:
    """The offsets of all 67 shapes by name, in the order of `MORPHS`."""
    left: dict[str, dict[str, Floats]] = {
        "eyeBlinkLeft": upper.blink(face),
        **{f"eyeLook{way}Left": upper.look(face, way) for way in upper.LOOK},
        "eyeSquintLeft": upper.squint(face),
        "eyeWideLeft": upper.wide(face),
        "mouthSmileLeft": lower.smile(face),
        "mouthFrownLeft": lower.frown(face),
        "mouthDimpleLeft": lower.dimple(face),
        "mouthStretchLeft": lower.stretch(face),
        "mouthPressLeft": lower.press(face),
        "mouthLowerDownLeft": lower.lower_down(face),
        "mouthUpperUpLeft": lower.upper_up(face),
        "browDownLeft": upper.on_skin(face, upper.brow_down),
        "browOuterUpLeft": upper.on_skin(face, upper.brow_outer_up),
        "cheekSquintLeft": upper.cheek_squint(face),
        "noseSneerLeft": lower.sneer(face),
        "jawLeft": lower.jaw_move(face, lambda p: np.tile([0.0085, 0.0, 0.0], (len(p), 1))),
        "mouthLeft": lower.sideways(face),
    }
    opened = lower.jaw_open(face)
    middle: dict[str, dict[str, Floats]] = {
        "jawOpen": opened,
        "jawForward": lower.jaw_move(face, lambda p: np.tile([0.0, 0.0, 0.0085], (len(p), 1))),
        "mouthClose": lower.seal(face, opened["skin"]),
        "mouthFunnel": lower.funnel(face),
        "mouthPucker": lower.pucker(face),
        "mouthRollLower": lower.roll(face, False),
        "mouthRollUpper": lower.roll(face, True),
        "mouthShrugLower": lower.shrug(face, False),
        "mouthShrugUpper": lower.shrug(face, True),
        "browInnerUp": upper.on_skin(face, upper.brow_inner_up),
        "cheekPuff": upper.cheek_puff(face),
        "tongueOut": lower.tongue_out(face),
        "tongueUp": lower.tongue_up(face),
    }
    elementary = {n: Offsets(**o) for n, o in (left | middle).items()}
    elementary |= {n.replace("Left", "Right"): Offsets(**_mirror(face, o)) for n, o in left.items()}
    shapes = {name: elementary[name] for name in ARKIT}
    for viseme, recipe in VISEMES.items():
        total = Offsets(**face.zero())
        for name, amount in recipe.items():
            for side in (name + "Left", name + "Right") if name in _BOTH else (name,):
                total = total + elementary[side] * amount
        shapes[viseme] = total
    return shapes
