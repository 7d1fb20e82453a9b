"""The face shapes of the built-in human: the 52 shapes of ARKit and the 15 visemes of Oculus as vertex offsets.

Shapes are displacement fields over the face, written for the left side; the right side is their mirror image. What
rides on the skin (brows, lashes) moves with it, and eyeballs, teeth and tongue move as the shape asks. Visemes are
sums of the elementary shapes, so everything adds up as morph targets do.

Source: names after Apple's ARBlendShapeLocation and Meta's "Viseme Reference" (Oculus LipSync).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from keypose.arrays import Floats
from keypose.samples.human_head import EYE_AROUND, LID, MOUTH_HALF, MOUTH_Y, HeadMesh, eye_outline, mouth_line
from keypose.samples.shapes import bump, smoothstep
from keypose.samples.skeleton import EYE_CENTRE, EYE_RADIUS, rest_positions

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
    "viseme_FF": {"jawOpen": 0.07, "mouthRollLower": 0.8, "mouthUpperUp": 0.55, "mouthShrugLower": 0.35},
    "viseme_TH": {"jawOpen": 0.20, "tongueUp": 0.6, "tongueOut": 0.42, "mouthUpperUp": 0.3, "mouthLowerDown": 0.35},
    "viseme_DD": {"jawOpen": 0.17, "tongueUp": 1.0, "mouthUpperUp": 0.3, "mouthLowerDown": 0.45},
    "viseme_kk": {"jawOpen": 0.26, "mouthUpperUp": 0.3, "mouthLowerDown": 0.3, "mouthStretch": 0.15},
    "viseme_CH": {"jawOpen": 0.06, "mouthFunnel": 0.65, "mouthPucker": 0.12, "mouthUpperUp": 0.2, "mouthLowerDown": 0.3},
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

_JAW_OPEN = np.deg2rad(23.0)
_LOOK = {"Up": (-1, 0, 24.0), "Down": (1, 0, 28.0), "Out": (0, 1, 30.0), "In": (0, -1, 30.0)}


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


FEATURES = ("skin", "brows", "eyes", "catchlights", "upper_teeth", "lower_teeth", "tongue")


@dataclass(frozen=True, slots=True, eq=False)
class Face:
    """What the shapes move, at rest: places (V, 3) by feature; eyes and brows hold the left half first, then the right."""

    head: HeadMesh
    jaw: Floats
    brows: Floats
    eyes: Floats
    catchlights: Floats
    upper_teeth: Floats
    lower_teeth: Floats
    tongue: Floats

    def zero(self) -> dict[str, Floats]:
        """No offset anywhere."""
        places = {name: getattr(self, name) for name in FEATURES[1:]}
        return {"skin": np.zeros_like(self.head.points)} | {n: np.zeros_like(p) for n, p in places.items()}


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


# --- eyes ------------------------------------------------------------------------------------------------------------


def _lid(face: Face, upper: float, lower: float, close: bool = False) -> Floats:
    """Offsets of the left lids.

    ``upper`` and ``lower`` are shares of the way from the rest to the line where the closed lids meet (negative opens
    wider).
    """
    head = face.head
    p = head.points
    offsets = np.zeros_like(p)
    centre = np.array(EYE_CENTRE)
    on = (head.eye_ring > -90) & (head.side > 0)
    around = np.arange(EYE_AROUND) * 2 * np.pi / EYE_AROUND
    rim = np.stack(eye_outline(around, 0.0), 1)
    number = np.round(np.mod(head.angle[on], 2 * np.pi) / (2 * np.pi) * EYE_AROUND).astype(int) % EYE_AROUND
    margin = rim[number]
    opposite = rim[(EYE_AROUND // 2 - number) % EYE_AROUND]
    opposite = np.stack([margin[:, 0], np.interp(margin[:, 0], *_lid_curve(rim, lower=True))], 1)
    top = np.interp(margin[:, 0], *_lid_curve(rim, lower=False))
    meet = opposite[:, 1] + 0.10 * (top - opposite[:, 1])
    sine = np.sin(around)[number]
    is_upper = sine > 1e-6
    is_lower = sine < -1e-6
    share = np.where(is_upper, upper, np.where(is_lower, lower, 0.0))
    travel = (meet - margin[:, 1]) * share
    ring = head.eye_ring[on]
    follow = np.select([ring >= 0, ring == -1, ring == -2], [np.array([1.0, 0.95, 0.70, 0.34])[np.clip(ring, 0, 3)], 1.0, 0.9], 0.55)
    q = p[on]
    moved = q.copy()
    moved[:, 1] += travel * follow
    # Stay outside the eyeball: on its sphere, a lid's thickness away.
    radius = np.select([ring >= 0, ring == -1, ring == -2], [EYE_RADIUS + LID + 0.0004 * np.clip(ring, 0, 2), EYE_RADIUS + 0.0006, EYE_RADIUS + 0.0003], EYE_RADIUS - 0.0015)
    flat = np.sum((moved[:, :2] - centre[:2]) ** 2, 1)
    ball = centre[2] + np.sqrt(np.maximum(radius**2 - flat, 1e-8))
    free = np.maximum(moved[:, 2], ball)
    on_ball = np.select([ring <= 1, ring == 2], [1.0, 0.75], 0.2)
    strength = np.clip(np.abs(travel) / 0.004, 0, 1)
    moved[:, 2] += np.where(ring <= 0, ball - moved[:, 2], np.where(ring <= 2, free - moved[:, 2], 0.0)) * on_ball * strength
    offsets[on] = moved - q
    # the skin around follows a little
    near = bump(p, (centre[0], centre[1] + 0.012, 0.085), (0.040, 0.036, 0.05)) * (~on) * (head.side >= 0)
    offsets[:, 1] += near * -0.0030 * upper
    near = bump(p, (centre[0], centre[1] - 0.022, 0.085), (0.036, 0.026, 0.05)) * (~on) * (head.side >= 0)
    offsets[:, 1] += near * 0.0035 * lower
    return offsets


def _lid_curve(rim: Floats, lower: bool) -> tuple[Floats, Floats]:
    half = EYE_AROUND // 2
    curve = rim[half:] if lower else rim[: half + 1]
    curve = np.vstack([curve, rim[0]]) if lower else curve
    order = np.argsort(curve[:, 0])
    return curve[order, 0], curve[order, 1]


def _blink(face: Face) -> dict[str, Floats]:
    out = face.zero()
    out["skin"] = _lid(face, 1.0, 1.0)
    # The offsets run straight while the lid should roll over the ball: the ball gives way meanwhile.
    for name in ("eyes", "catchlights"):
        half = len(out[name]) // 2
        out[name][:half, 2] = -0.0042
    return out


def _squint(face: Face) -> dict[str, Floats]:
    out = face.zero()
    out["skin"] = _lid(face, 0.14, 1.9) + _cheek_raise(face, 0.5)
    return out


def _wide(face: Face) -> dict[str, Floats]:
    out = face.zero()
    out["skin"] = _lid(face, -0.13, -0.45)
    return out


def _look(face: Face, way: str) -> dict[str, Floats]:
    out = face.zero()
    about_x, about_y, degrees = _LOOK[way]
    half = len(face.eyes) // 2
    centre = np.array(EYE_CENTRE)
    out["eyes"][:half] = _turned(face.eyes[:half], centre, (about_x, about_y, 0), np.deg2rad(degrees))
    if way == "Down":
        out["skin"] = _lid(face, 0.30, -0.25)
    elif way == "Up":
        out["skin"] = _lid(face, -0.10, 0.35)
    return out


def _turned(p: Floats, centre: Floats, axis: tuple[float, float, float], angle: float) -> Floats:
    """Offsets of a rotation by ``angle`` about a unit axis through ``centre``."""
    k = np.asarray(axis, np.float64)
    r = p - centre
    c, s = np.cos(angle), np.sin(angle)
    return r * c + np.cross(k, r) * s + k * (r @ k)[:, None] * (1 - c) - r


# --- brows, cheeks, nose ---------------------------------------------------------------------------------------------


def _on_skin(face: Face, field: Callable[[Floats], Floats]) -> dict[str, Floats]:
    """A displacement field applied to the skin and to the brows that lie on it; the lids' rims stay."""
    out = face.zero()
    head = face.head
    hold = np.where(head.eye_ring > -90, np.array([0.0, 0.0, 0.0, 0.0, 0.15, 0.45, 0.8])[np.clip(head.eye_ring, -3, 3) + 3], 1.0)
    hold = np.where((head.mouth_ring < 0) & (head.mouth_ring > -90), 0.0, hold)
    out["skin"] = field(head.points) * hold[:, None]
    out["brows"] = field(face.brows)
    return out


def _one_side(p: Floats, width: float = 0.006) -> Floats:
    return smoothstep(-width, width, p[:, 0])[:, None]


def _brow_down(p: Floats) -> Floats:
    w = bump(p, (0.028, 1.578, 0.085), (0.044, 0.034, 0.06))[:, None] * _one_side(p)
    inner = smoothstep(0.055, 0.012, p[:, 0])[:, None]
    return w * (np.array([-0.0028, -0.0075, 0.0012]) * (0.45 + 0.75 * inner))


def _brow_inner_up(p: Floats) -> Floats:
    q = np.abs(p[:, 0])
    w = bump(np.stack([q, p[:, 1], p[:, 2]], 1), (0.012, 1.582, 0.09), (0.036, 0.038, 0.06))[:, None]
    return w * np.array([0.0, 0.0115, -0.0005]) + w * np.stack([np.sign(p[:, 0]) * -0.0010 * smoothstep(0, 0.01, q), 0 * q, 0 * q], 1)


def _brow_outer_up(p: Floats) -> Floats:
    w = bump(p, (0.052, 1.584, 0.075), (0.036, 0.036, 0.06))[:, None] * _one_side(p)
    return w * np.array([0.0006, 0.0105, 0.0])


def _cheek_raise(face: Face, amount: float) -> Floats:
    p = face.head.points
    w = bump(p, (0.047, 1.503, 0.078), (0.034, 0.026, 0.05))[:, None] * (p[:, :1] > 0)
    fixed = np.where((face.head.eye_ring > -90) & (face.head.eye_ring < 2), 0.0, np.where(face.head.eye_ring >= 2, 0.5, 1.0))
    return w * np.array([0.0012, 0.0055, 0.0040]) * amount * fixed[:, None]


def _cheek_squint(face: Face) -> dict[str, Floats]:
    out = face.zero()
    out["skin"] = _cheek_raise(face, 1.3) + _lid(face, 0.0, 1.1)
    return out


def _cheek_puff(face: Face) -> dict[str, Floats]:
    out = face.zero()
    head = face.head
    p = head.points
    q = np.stack([np.abs(p[:, 0]), p[:, 1], p[:, 2]], 1)
    w = bump(q, (0.047, 1.472, 0.070), (0.042, 0.036, 0.06))
    w = w * np.where(head.mouth_ring > -90, np.array([0.0, 0.1, 0.25, 0.6, 0.9])[np.clip(head.mouth_ring, 0, 4)], 1.0)
    w = np.where(head.mouth_ring < 0, w * (head.mouth_ring < -90), w)
    away = p - np.array([0.0, 1.475, 0.02])
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    out["skin"] = w[:, None] * away * 0.0150
    return out


def _sneer(face: Face) -> dict[str, Floats]:
    def field(p: Floats) -> Floats:
        wing = bump(p, (0.012, 1.507, 0.102), (0.020, 0.022, 0.03))[:, None] * _one_side(p, 0.008)
        fold = bump(p, (0.022, 1.500, 0.092), (0.026, 0.030, 0.04))[:, None] * _one_side(p)
        return wing * np.array([0.0014, 0.0046, -0.0012]) + fold * np.array([0.001, 0.0034, 0.001]) + 0.35 * _brow_down(p)

    out = _on_skin(face, field)
    out["skin"] = out["skin"] + 0.35 * _upper_up(face)["skin"]
    return out


# --- jaw -------------------------------------------------------------------------------------------------------------


def _jaw(face: Face, move: Callable[[Floats], Floats]) -> dict[str, Floats]:
    """A rigid movement of the jaw: the skin by its share, the lower teeth and the tongue entirely."""
    out = face.zero()
    out["skin"] = move(face.head.points) * face.jaw[:, None]
    out["lower_teeth"] = move(face.lower_teeth)
    out["tongue"] = move(face.tongue)
    return out


def _jaw_open(face: Face) -> dict[str, Floats]:
    hinge = rest_positions()["Jaw"]
    out = _jaw(face, lambda p: _turned(p, hinge, (1, 0, 0), float(_JAW_OPEN)))
    # Opening pulls the corners of the mouth in and the cheeks long.
    p = face.head.points
    q = np.stack([np.abs(p[:, 0]), p[:, 1], p[:, 2]], 1)
    corner = bump(q, (MOUTH_HALF, MOUTH_Y, 0.09), (0.022, 0.020, 0.04)) * (face.head.mouth_ring > -2)
    out["skin"][:, 0] -= np.sign(p[:, 0]) * 0.0035 * corner
    hollow = bump(q, (0.055, 1.470, 0.062), (0.030, 0.036, 0.04))
    hollow = np.where(face.head.mouth_ring > -90, 0.0, hollow)
    out["skin"][:, 0] -= np.sign(p[:, 0]) * 0.0040 * hollow
    return out


# --- lips ------------------------------------------------------------------------------------------------------------


def _lips(face: Face, reach: float = 1.0) -> tuple[Floats, Floats, Floats]:
    """How much each skin vertex belongs to the lips, to the upper and to the lower one, (V,)."""
    head = face.head
    p = head.points
    q = np.stack([np.abs(p[:, 0]), p[:, 1], p[:, 2]], 1)
    ring = head.mouth_ring
    outer = np.array([1.0, 1.0, 1.0, 0.74, 0.40])[np.clip(ring, 0, 4)]
    inner = np.array([0.9, 0.25, 0.0, 0.0, 0.0, 0.0, 0.0])[np.clip(-1 - ring, 0, 6)]
    around = bump(q, (0, MOUTH_Y, 0.09), (0.062, 0.046, 0.06)) * 0.5 * reach
    lips = np.where(ring >= 0, outer, np.where(ring > -90, inner, np.minimum(around, 0.4)))
    s = np.where(ring > -90, np.sin(head.angle), np.clip((p[:, 1] - MOUTH_Y) / 0.012, -1, 1))
    upper = smoothstep(0.0, 0.75, s)
    lower = smoothstep(0.0, -0.75, s)
    return lips, upper, lower


def _skin_only(face: Face, skin: Floats) -> dict[str, Floats]:
    out = face.zero()
    out["skin"] = skin
    return out


def _corner(face: Face) -> Floats:
    """How much each skin vertex follows the left corner of the mouth, (V,)."""
    p, ring = face.head.points, face.head.mouth_ring
    w = bump(p, (MOUTH_HALF + 0.001, MOUTH_Y + 0.003, 0.090), (0.046, 0.040, 0.06))
    along = np.clip(p[:, 0] / MOUTH_HALF, 0, 1) ** 1.6
    on_lips = (ring >= 0) & (ring <= 2)
    w = np.where(on_lips, along * 0.9 + 0.1 * w, np.where(ring == 3, 0.5 * w + 0.5 * along, w))
    bag = np.array([1.0, 0.7, 0.3, 0.0, 0.0, 0.0, 0.0])[np.clip(-1 - ring, 0, 6)] * along
    w = np.where((ring < 0) & (ring > -90), bag, w)
    return w * smoothstep(-0.012, 0.012, p[:, 0])


def _smile(face: Face) -> dict[str, Floats]:
    w = _corner(face)[:, None]
    skin = w * np.array([0.0080, 0.0092, -0.0052]) + _cheek_raise(face, 0.75)
    return _skin_only(face, skin + 0.35 * _lid(face, 0.0, 1.0))


def _frown(face: Face) -> dict[str, Floats]:
    return _skin_only(face, _corner(face)[:, None] * np.array([0.0008, -0.0088, -0.0012]))


def _dimple(face: Face) -> dict[str, Floats]:
    return _skin_only(face, _corner(face)[:, None] * np.array([0.0048, 0.0016, -0.0062]))


def _stretch(face: Face) -> dict[str, Floats]:
    lips, upper, lower = _lips(face)
    thin = (face.head.mouth_ring >= 1) * lips * (lower - upper) * 0.0008
    skin = _corner(face)[:, None] * np.array([0.0105, -0.0022, -0.0062])
    skin[:, 1] += thin * smoothstep(-0.01, 0.01, face.head.points[:, 0])
    return _skin_only(face, skin)


def _half(face: Face) -> Floats:
    """The left half of the mouth with a soft border in the middle and a taper towards the corner, (V,)."""
    x = face.head.points[:, 0]
    return smoothstep(-0.010, 0.010, x) * smoothstep(1.02, 0.45, x / MOUTH_HALF)


def _upper_up(face: Face) -> dict[str, Floats]:
    lips, upper, _ = _lips(face)
    w = (lips * upper * _half(face))[:, None]
    return _skin_only(face, w * np.array([0.0, 0.0078, 0.0010]))


def _lower_down(face: Face) -> dict[str, Floats]:
    lips, _, lower = _lips(face)
    w = (lips * lower * _half(face))[:, None]
    return _skin_only(face, w * np.array([0.0, -0.0082, 0.0004]))


def _press(face: Face) -> dict[str, Floats]:
    """Lips pressed together: the red of the lips thins and draws in."""
    p, ring = face.head.points, face.head.mouth_ring
    line = mouth_line(np.clip(p[:, 0], -MOUTH_HALF, MOUTH_HALF))
    toward = (line - p[:, 1]) * np.where(ring >= 0, np.array([0.0, 0.45, 0.42, 0.20, 0.08])[np.clip(ring, 0, 4)], 0.0)
    back = np.where(ring >= 0, np.array([0.4, 1.0, 0.8, 0.3, 0.0])[np.clip(ring, 0, 4)], 0.0) * -0.0014
    side = smoothstep(-0.010, 0.010, p[:, 0])
    skin = np.stack([0 * toward, toward * side, back * side], 1)
    return _skin_only(face, skin + 0.25 * _dimple(face)["skin"])


def _roll(face: Face, is_upper: bool) -> dict[str, Floats]:
    """A lip rolled inwards over the teeth."""
    p, ring = face.head.points, face.head.mouth_ring
    _, upper, lower = _lips(face)
    w = (upper if is_upper else lower) * smoothstep(1.0, 0.6, np.abs(p[:, 0]) / MOUTH_HALF)
    line = mouth_line(np.clip(p[:, 0], -MOUTH_HALF, MOUTH_HALF))
    pull = np.where(ring >= 0, np.array([0.0, 0.85, 0.70, 0.38, 0.14])[np.clip(ring, 0, 4)], 0.0)
    back = np.where(ring >= 0, np.array([1.0, 1.0, 0.55, 0.12, 0.0])[np.clip(ring, 0, 4)], (ring == -1) * 1.0) * -0.0044
    sign = 1.0 if is_upper else -1.0
    inside = np.where((ring == 0) | (ring == -1), 0.0010 * sign, 0.0)
    skin = np.stack([0 * w, ((line - p[:, 1]) * pull + inside) * w, back * w], 1)
    return _skin_only(face, skin)


def _shrug(face: Face, is_upper: bool) -> dict[str, Floats]:
    lips, upper, lower = _lips(face)
    p = face.head.points
    taper = smoothstep(1.05, 0.3, np.abs(p[:, 0]) / MOUTH_HALF)
    if is_upper:
        return _skin_only(face, (lips * upper * taper)[:, None] * np.array([0.0, 0.0040, 0.0034]))
    chin = bump(p, (0, 1.443, 0.095), (0.034, 0.026, 0.04)) * (face.head.mouth_ring < -90)
    both = lips * (lower + 0.55 * upper) * taper  # the lower lip pushes the upper one up
    return _skin_only(face, both[:, None] * np.array([0.0, 0.0044, 0.0032]) + chin[:, None] * np.array([0.0, 0.0040, 0.0012]))


def _funnel(face: Face) -> dict[str, Floats]:
    lips, upper, lower = _lips(face)
    p, ring = face.head.points, face.head.mouth_ring
    skin = np.zeros_like(p)
    skin[:, 0] = -p[:, 0] * 0.36 * lips
    round_ = np.sqrt(np.clip(1 - (p[:, 0] / MOUTH_HALF) ** 2, 0, 1))
    outward = np.where(ring >= 0, np.array([1.0, 1.0, 0.92, 0.62, 0.30])[np.clip(ring, 0, 4)], lips)
    skin[:, 1] = outward * round_ * (0.0068 * upper - 0.0074 * lower)
    ahead = np.where(ring >= 0, np.array([0.75, 1.0, 0.95, 0.62, 0.30])[np.clip(ring, 0, 4)], lips * 0.8)
    skin[:, 2] = 0.0085 * ahead
    return _skin_only(face, skin)


def _pucker(face: Face) -> dict[str, Floats]:
    lips, upper, lower = _lips(face)
    p, ring = face.head.points, face.head.mouth_ring
    skin = np.zeros_like(p)
    skin[:, 0] = -p[:, 0] * 0.50 * lips
    ahead = np.where(ring >= 0, np.array([0.72, 1.0, 0.95, 0.58, 0.28])[np.clip(ring, 0, 4)], lips * 0.7)
    skin[:, 2] = 0.0110 * ahead
    full = np.where(ring >= 0, np.array([0.0, 0.9, 1.0, 0.5, 0.15])[np.clip(ring, 0, 4)], 0.0)
    centre = smoothstep(1.0, 0.2, np.abs(p[:, 0]) / MOUTH_HALF)
    skin[:, 1] = full * centre * (0.0017 * upper - 0.0019 * lower) - 0.0022 * lips * (np.abs(p[:, 0]) / MOUTH_HALF) ** 2
    return _skin_only(face, skin)


def _sideways(face: Face) -> dict[str, Floats]:
    lips, _, _ = _lips(face)
    p = face.head.points
    round_face = -0.0022 * np.clip(p[:, 0] / MOUTH_HALF, -1, 1)
    skin = lips[:, None] * np.stack([np.full(len(p), 0.0100), 0.0008 * np.sign(p[:, 0]) + 0 * p[:, 0], round_face], 1)
    return _skin_only(face, skin)


def _close(face: Face, jaw_open: Floats) -> dict[str, Floats]:
    """What closes the lips again over an open jaw: `jawOpen` and `mouthClose` together keep them sealed."""
    head = face.head
    lips, upper, _ = _lips(face)
    ring = head.mouth_ring
    # Opposite points of a ring share their x; how far the jaw has parted them is shared out between the lips.
    amount = np.where(ring >= 0, np.array([1.0, 0.97, 0.92, 0.62, 0.30])[np.clip(ring, 0, 4)], 0.0)
    amount = np.where(ring == -1, 0.97, np.where(ring == -2, 0.8, np.where(ring == -3, 0.4, amount)))
    amount = np.where(ring < -90, lips * 0.5, amount)
    parted = np.zeros_like(head.points)
    rim = np.nonzero(ring == 0)[0]
    middle = rim[(head.side[rim] == 0) & (head.angle[rim] < 0)][0]
    corner = rim[np.argmin(np.abs(head.angle[rim]))]
    t = np.clip(np.abs(head.points[:, :1]) / MOUTH_HALF, 0, 1)
    span = np.sqrt(1 - t**2)
    meeting = jaw_open[corner] * (1 - span) + (0.30 * jaw_open[middle]) * span  # where the sealed lips lie
    meeting[:, 0] = 0.0
    parted = meeting - jaw_open * np.array([0.0, 1.0, 1.0])
    return _skin_only(face, parted * amount[:, None] + 0 * upper[:, None])


# --- tongue ----------------------------------------------------------------------------------------------------------


def _tongue_out(face: Face) -> dict[str, Floats]:
    out = face.zero()
    u = np.clip((face.tongue[:, 2] - 0.030) / 0.047, 0, 1)
    out["tongue"][:, 2] = 0.052 * u**1.2
    out["tongue"][:, 1] = 0.0085 * np.sin(np.pi * np.clip(u * 0.72, 0, 1)) - 0.004 * smoothstep(0.75, 1.0, u)
    return out


def _tongue_up(face: Face) -> dict[str, Floats]:
    out = face.zero()
    u = np.clip((face.tongue[:, 2] - 0.030) / 0.047, 0, 1)
    out["tongue"][:, 1] = 0.0125 * smoothstep(0.25, 1.0, u)
    return out


def face_shapes(face: Face) -> dict[str, Offsets]:
    """The offsets of all 67 shapes by name, in the order of `MORPHS`."""
    left: dict[str, dict[str, Floats]] = {
        "eyeBlinkLeft": _blink(face),
        **{f"eyeLook{way}Left": _look(face, way) for way in _LOOK},
        "eyeSquintLeft": _squint(face),
        "eyeWideLeft": _wide(face),
        "mouthSmileLeft": _smile(face),
        "mouthFrownLeft": _frown(face),
        "mouthDimpleLeft": _dimple(face),
        "mouthStretchLeft": _stretch(face),
        "mouthPressLeft": _press(face),
        "mouthLowerDownLeft": _lower_down(face),
        "mouthUpperUpLeft": _upper_up(face),
        "browDownLeft": _on_skin(face, _brow_down),
        "browOuterUpLeft": _on_skin(face, _brow_outer_up),
        "cheekSquintLeft": _cheek_squint(face),
        "noseSneerLeft": _sneer(face),
        "jawLeft": _jaw(face, lambda p: np.tile([0.0085, 0.0, 0.0], (len(p), 1))),
        "mouthLeft": _sideways(face),
    }
    opened = _jaw_open(face)
    middle: dict[str, dict[str, Floats]] = {
        "jawOpen": opened,
        "jawForward": _jaw(face, lambda p: np.tile([0.0, 0.0, 0.0085], (len(p), 1))),
        "mouthClose": _close(face, opened["skin"]),
        "mouthFunnel": _funnel(face),
        "mouthPucker": _pucker(face),
        "mouthRollLower": _roll(face, False),
        "mouthRollUpper": _roll(face, True),
        "mouthShrugLower": _shrug(face, False),
        "mouthShrugUpper": _shrug(face, True),
        "browInnerUp": _on_skin(face, _brow_inner_up),
        "cheekPuff": _cheek_puff(face),
        "tongueOut": _tongue_out(face),
        "tongueUp": _tongue_up(face),
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
