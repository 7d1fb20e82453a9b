"""Face shapes of jaw, lips and tongue; those of one side are written for the left."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from keypose.arrays import Floats
from keypose.samples.face_base import Face, skin_only, turned
from keypose.samples.face_upper import brow_down, cheek_raise, lid, on_skin, one_side
from keypose.samples.human_head import MOUTH_HALF, MOUTH_Y, mouth_line
from keypose.samples.shapes import bump, smoothstep
from keypose.samples.skeleton import JAW_HINGE

JAW_OPEN = np.deg2rad(23.0)

# --- jaw -------------------------------------------------------------------------------------------------------------


def jaw_move(face: Face, move: Callable[[Floats], Floats]) -> dict[str, Floats]:
    """A rigid movement of the jaw: the skin by its share, the lower teeth and the tongue entirely."""
    out = face.zero()
    out["skin"] = move(face.head.points) * face.jaw[:, None]
    out["lower_teeth"] = move(face.lower_teeth)
    out["tongue"] = move(face.tongue)
    return out


def jaw_open(face: Face) -> dict[str, Floats]:
    hinge = np.array(JAW_HINGE)
    out = jaw_move(face, lambda p: turned(p, hinge, (1, 0, 0), float(JAW_OPEN)))
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


def _corner(face: Face) -> Floats:
    """How much each skin vertex follows the left corner of the mouth, (V,)."""
    p, ring = face.head.points, face.head.mouth_ring
    w = bump(p, (MOUTH_HALF + 0.001, MOUTH_Y + 0.003, 0.090), (0.046, 0.040, 0.06))
    along = np.clip(p[:, 0] / MOUTH_HALF, 0, 1) ** 1.8
    on_lips = (ring >= 0) & (ring <= 2)
    w = np.where(on_lips, along * 0.9 + 0.1 * w, np.where(ring == 3, 0.5 * w + 0.5 * along, w))
    bag = np.array([1.0, 0.7, 0.3, 0.0, 0.0, 0.0, 0.0])[np.clip(-1 - ring, 0, 6)] * along
    w = np.where((ring < 0) & (ring > -90), bag, w)
    return w * smoothstep(-0.012, 0.012, p[:, 0])


def smile(face: Face) -> dict[str, Floats]:
    w = _corner(face)[:, None]
    skin = w * np.array([0.0082, 0.0082, -0.0052]) + cheek_raise(face, 0.75)
    return skin_only(face, skin + 0.35 * lid(face, 0.0, 1.0))


def frown(face: Face) -> dict[str, Floats]:
    return skin_only(face, _corner(face)[:, None] * np.array([0.0008, -0.0088, -0.0012]))


def dimple(face: Face) -> dict[str, Floats]:
    return skin_only(face, _corner(face)[:, None] * np.array([0.0048, 0.0016, -0.0062]))


def stretch(face: Face) -> dict[str, Floats]:
    lips, upper, lower = _lips(face)
    thin = (face.head.mouth_ring >= 1) * lips * (lower - upper) * 0.0008
    skin = _corner(face)[:, None] * np.array([0.0105, -0.0022, -0.0062])
    skin[:, 1] += thin * smoothstep(-0.01, 0.01, face.head.points[:, 0])
    return skin_only(face, skin)


def _half(face: Face) -> Floats:
    """The left half of the mouth with a soft border in the middle and a taper towards the corner, (V,)."""
    x = face.head.points[:, 0]
    return smoothstep(-0.010, 0.010, x) * smoothstep(1.02, 0.45, x / MOUTH_HALF)


def upper_up(face: Face) -> dict[str, Floats]:
    lips, upper, _ = _lips(face)
    w = (lips * upper * _half(face))[:, None]
    return skin_only(face, w * np.array([0.0, 0.0078, 0.0010]))


def lower_down(face: Face) -> dict[str, Floats]:
    lips, _, lower = _lips(face)
    w = (lips * lower * _half(face))[:, None]
    return skin_only(face, w * np.array([0.0, -0.0082, 0.0004]))


def press(face: Face) -> dict[str, Floats]:
    """Lips pressed together: the red of the lips thins and draws in."""
    p, ring = face.head.points, face.head.mouth_ring
    line = mouth_line(np.clip(p[:, 0], -MOUTH_HALF, MOUTH_HALF))
    toward = (line - p[:, 1]) * np.where(ring >= 0, np.array([0.0, 0.45, 0.42, 0.20, 0.08])[np.clip(ring, 0, 4)], 0.0)
    back = np.where(ring >= 0, np.array([0.4, 1.0, 0.8, 0.3, 0.0])[np.clip(ring, 0, 4)], 0.0) * -0.0014
    side = smoothstep(-0.010, 0.010, p[:, 0])
    skin = np.stack([0 * toward, toward * side, back * side], 1)
    return skin_only(face, skin + 0.25 * dimple(face)["skin"])


def roll(face: Face, is_upper: bool) -> dict[str, Floats]:
    """A lip rolled inwards over the teeth."""
    p, ring = face.head.points, face.head.mouth_ring
    _, upper, lower = _lips(face)
    w = (upper if is_upper else lower) * smoothstep(1.0, 0.6, np.abs(p[:, 0]) / MOUTH_HALF)
    line = mouth_line(np.clip(p[:, 0], -MOUTH_HALF, MOUTH_HALF))
    pull = np.where(ring >= 0, np.array([0.0, 0.85, 0.70, 0.38, 0.14])[np.clip(ring, 0, 4)], 0.0)
    back = np.where(ring >= 0, np.array([1.0, 1.0, 0.55, 0.12, 0.0])[np.clip(ring, 0, 4)], (ring == -1) * 1.0) * -0.0044
    sign = 1.0 if is_upper else -1.0
    inside = np.where((ring == 0) | (ring == -1), 0.0002 * sign, 0.0)
    skin = np.stack([0 * w, ((line - p[:, 1]) * pull + inside) * w, back * w], 1)
    return skin_only(face, skin)


def shrug(face: Face, is_upper: bool) -> dict[str, Floats]:
    lips, upper, lower = _lips(face)
    p = face.head.points
    taper = smoothstep(1.05, 0.3, np.abs(p[:, 0]) / MOUTH_HALF)
    if is_upper:
        return skin_only(face, (lips * upper * taper)[:, None] * np.array([0.0, 0.0040, 0.0034]))
    chin = bump(p, (0, 1.443, 0.095), (0.034, 0.026, 0.04)) * (face.head.mouth_ring < -90)
    both = lips * (lower + 0.55 * upper) * taper  # the lower lip pushes the upper one up
    return skin_only(
        face, both[:, None] * np.array([0.0, 0.0044, 0.0032]) + chin[:, None] * np.array([0.0, 0.0040, 0.0012])
    )


def _rounded(face: Face, narrow: float) -> tuple[Floats, Floats]:
    """What every rounded shape does: offsets that draw the corners in and take the smile out of the lips' line, and
    how much each vertex opens with its lip, (V,), positive above."""
    lips, upper, lower = _lips(face)
    p, ring = face.head.points, face.head.mouth_ring
    t = np.clip(np.abs(p[:, 0]) / MOUTH_HALF, 0, 1)
    skin = np.zeros_like(p)
    skin[:, 0] = -p[:, 0] * narrow * lips
    skin[:, 1] = -0.0052 * t**2 * lips
    # On the lips the opening is a circle; the skin around them follows softly.
    on_lips = (ring >= 0) & (ring <= 2)
    above = np.where(on_lips, np.sign(np.round(face.head.angle, 9)), upper - lower)
    return skin, above * np.sqrt(1 - t**2)


def _teeth_behind(face: Face, back: float, apart: float) -> dict[str, Floats]:
    """No offsets but of the teeth: rounded lips cover them, so they stand back and keep out of the opening."""
    out = face.zero()
    out["upper_teeth"] += np.array([0.0, apart, -back])
    out["lower_teeth"] += np.array([0.0, -apart, -back])
    return out


def funnel(face: Face) -> dict[str, Floats]:
    lips, _, _ = _lips(face)
    ring = face.head.mouth_ring
    skin, opening = _rounded(face, 0.40)
    outward = np.where(ring >= 0, np.array([1.0, 1.0, 0.92, 0.62, 0.30])[np.clip(ring, 0, 4)], lips)
    skin[:, 1] += outward * opening * np.where(opening > 0, 0.0072, 0.0070)
    ahead = np.where(ring >= 0, np.array([0.75, 1.0, 0.95, 0.62, 0.30])[np.clip(ring, 0, 4)], lips * 0.8)
    skin[:, 2] = 0.0085 * ahead
    return _teeth_behind(face, 0.0050, 0.0052) | {"skin": skin}


def pucker(face: Face) -> dict[str, Floats]:
    lips, _, _ = _lips(face)
    ring = face.head.mouth_ring
    skin, opening = _rounded(face, 0.52)
    ahead = np.where(ring >= 0, np.array([0.72, 1.0, 0.95, 0.58, 0.28])[np.clip(ring, 0, 4)], lips * 0.7)
    skin[:, 2] = 0.0110 * ahead
    full = np.where(ring >= 0, np.array([0.0, 0.9, 1.0, 0.5, 0.15])[np.clip(ring, 0, 4)], 0.0)
    skin[:, 1] += full * opening * 0.0019
    return _teeth_behind(face, 0.0050, 0.0040) | {"skin": skin}


def sideways(face: Face) -> dict[str, Floats]:
    lips, _, _ = _lips(face)
    p = face.head.points
    round_face = -0.0022 * np.clip(p[:, 0] / MOUTH_HALF, -1, 1)
    skin = lips[:, None] * np.stack([np.full(len(p), 0.0100), 0.0008 * np.sign(p[:, 0]) + 0 * p[:, 0], round_face], 1)
    return skin_only(face, skin)


def seal(face: Face, jaw_open: Floats) -> dict[str, Floats]:
    """What closes the lips again over an open jaw: `jawOpen` and `mouthClose` together keep them sealed."""
    head = face.head
    lips, _, _ = _lips(face)
    ring = head.mouth_ring
    # Opposite points of a ring share their x; how far the jaw has parted them is shared out between the lips.
    amount = np.where(ring >= 0, np.array([1.0, 0.97, 0.92, 0.62, 0.30])[np.clip(ring, 0, 4)], 0.0)
    amount = np.where(ring == -1, 0.97, np.where(ring == -2, 0.8, np.where(ring == -3, 0.4, amount)))
    amount = np.where(ring < -90, lips * 0.5, amount)
    rim = np.nonzero(ring == 0)[0]
    middle = rim[(head.side[rim] == 0) & (head.angle[rim] < 0)][0]
    corner = rim[np.argmin(np.abs(head.angle[rim]))]
    t = np.clip(np.abs(head.points[:, :1]) / MOUTH_HALF, 0, 1)
    span = np.sqrt(1 - t**2)
    meeting = jaw_open[corner] * (1 - span) + (0.30 * jaw_open[middle]) * span  # where the sealed lips lie
    meeting[:, 0] = 0.0
    parted = meeting - jaw_open * np.array([0.0, 1.0, 1.0])
    return skin_only(face, parted * amount[:, None])


def sneer(face: Face) -> dict[str, Floats]:
    def field(p: Floats) -> Floats:
        wing = bump(p, (0.012, 1.507, 0.102), (0.020, 0.022, 0.03))[:, None] * one_side(p, 0.008)
        fold = bump(p, (0.022, 1.500, 0.092), (0.026, 0.030, 0.04))[:, None] * one_side(p)
        return (
            wing * np.array([0.0014, 0.0046, -0.0012]) + fold * np.array([0.001, 0.0034, 0.001]) + 0.35 * brow_down(p)
        )

    out = on_skin(face, field)
    out["skin"] = out["skin"] + 0.35 * upper_up(face)["skin"]
    return out


# --- tongue ----------------------------------------------------------------------------------------------------------


def tongue_out(face: Face) -> dict[str, Floats]:
    out = face.zero()
    u = np.clip((face.tongue[:, 2] - 0.036) / 0.051, 0, 1)
    out["tongue"][:, 2] = 0.046 * u**1.2
    out["tongue"][:, 1] = 0.0085 * np.sin(np.pi * np.clip(u * 0.72, 0, 1)) - 0.004 * smoothstep(0.75, 1.0, u)
    return out


def tongue_up(face: Face) -> dict[str, Floats]:
    out = face.zero()
    u = np.clip((face.tongue[:, 2] - 0.036) / 0.051, 0, 1)
    out["tongue"][:, 1] = 0.0125 * smoothstep(0.25, 1.0, u)
    return out
