"""The built-in human's hands as a control cage: a palm, four fingers and a thumb, each finger with its own edge loops.

Coordinates inside this module are of the left hand: along the fingers, towards the thumb, out of the palm, metres from
the wrist.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise

import numpy as np

from keypose.arrays import Floats
from keypose.samples.human_clothes import arm_weights
from keypose.samples.skeleton import FINGERS, HAND_SCALE, hand_axes, rest_positions
from keypose.samples.subdivision import Cage

# Palm sections: five places across (thumb side first) of the back and of the palm, (towards the thumb, out of the palm).
_PALM = (  # along, weights, back, palm
    (-0.030, ((0.0235, -0.009), (0.0140, -0.0170), (0.0, -0.0195), (-0.0140, -0.0170), (-0.0235, -0.009)),
             ((0.0235, 0.010), (0.0140, 0.0175), (0.0, 0.0195), (-0.0140, 0.0170), (-0.0235, 0.009))),
    (0.014, ((0.0295, -0.008), (0.0170, -0.0165), (0.000, -0.0185), (-0.0170, -0.0160), (-0.0295, -0.007)),
            ((0.0310, 0.013), (0.0190, 0.0220), (0.001, 0.0190), (-0.0170, 0.0200), (-0.0300, 0.013))),
    (0.050, ((0.0370, -0.009), (0.0210, -0.0165), (0.001, -0.0180), (-0.0205, -0.0155), (-0.0375, -0.006)),
            ((0.0365, 0.012), (0.0210, 0.0180), (0.001, 0.0155), (-0.0200, 0.0185), (-0.0365, 0.014))),
    (0.082, ((0.0410, -0.0100), (0.0205, -0.0155), (0.0, -0.0165), (-0.0205, -0.0145), (-0.0405, -0.0070)),
            ((0.0400, 0.0100), (0.0205, 0.0135), (0.0, 0.0130), (-0.0205, 0.0140), (-0.0395, 0.0120))),
)  # fmt: skip
_FRONT_OF_WEB = np.array([0.0, 0.010, 0.013, 0.008, -0.004])  # how far each knuckle line lies ahead of the last section

_RADII = {"Thumb": 0.0136, "Index": 0.0113, "Middle": 0.0116, "Ring": 0.0112, "Pinky": 0.0100}


def _model(point: Floats) -> Floats:
    along, thumb, palm = hand_axes()
    axes = np.stack([along, thumb, palm])
    return rest_positions()["LeftHand"] + point @ axes


def _finger_places(finger: str) -> Floats:
    """Joints and tip of a finger in hand coordinates, (4, 3)."""
    places = rest_positions()
    axes = np.stack(hand_axes())
    joints = np.array([places[f"LeftHand{finger}{n}"] for n in (1, 2, 3)])
    inside = (joints - places["LeftHand"]) @ axes.T
    last = inside[2] - inside[1]
    turned = last + np.array([-0.002, 0.0, 0.004])
    return np.vstack([inside, inside[2] + turned / np.linalg.norm(turned) * np.linalg.norm(last) * 0.86])


def _finger_rings(finger: str, skip_base: bool) -> list[tuple[Floats, Floats, float, dict[str, float]]]:
    """Centre, direction, radius and weights of the loops along a finger: pairs of loops hold the form at each joint."""
    p = _finger_places(finger)
    a, b, c, tip = p
    one, two, three = (f"LeftHand{finger}{n}" for n in (1, 2, 3))
    d1, d2, d3 = ((v / np.linalg.norm(v)) for v in (b - a, c - b, tip - c))
    radius = _RADII[finger] * HAND_SCALE
    n1, n3 = float(np.linalg.norm(b - a)), float(np.linalg.norm(tip - c))
    rings = [
        (a + d1 * n1 * 0.52, d1, radius * 1.02, {one: 1.0}),
        (b - d1 * 0.0065, (d1 * 2 + d2) / 3, radius * 1.03, {one: 0.86, two: 0.14}),
        (b + d2 * 0.0065, (d1 + d2 * 2) / 3, radius * 1.01, {one: 0.14, two: 0.86}),
        (c, (d2 + d3) / 2, radius * 0.98, {two: 0.5, three: 0.5}),
        (c + d3 * n3 * 0.70, d3, radius * 0.88, {three: 1.0}),
        (c + d3 * n3 * 0.99, d3, radius * 0.56, {three: 1.0}),
    ]
    return rings[1:] if skip_base else rings


def _loop(centre: Floats, direction: Floats, radius: float, side: Floats) -> Floats:
    """Four corners around a finger: back thumb side, back little side, palm little side, palm thumb side."""
    direction = direction / np.linalg.norm(direction)
    side = side - direction * (side @ direction)
    side = side / np.linalg.norm(side)
    palm = np.cross(side, -direction)
    diagonal = radius * 0.7071
    return np.array(
        [centre + diagonal * (side * s + palm * o) for s, o in ((1.0, -1.02), (-1.0, -1.02), (-1.0, 0.98), (1.0, 0.98))]
    )


def _grow(cage: Cage, base: list[int], finger: str, side: Floats, skip_base: bool = False) -> None:
    """A finger out of the four corners ``base``."""
    previous = base
    rings = _finger_rings(finger, skip_base)
    for centre, direction, radius, weights in rings:
        ring = cage.ring([_model(q) for q in _loop(centre, direction, radius, side)], weights)
        cage.bridge(ring, previous, "skin")
        previous = ring
    cage.face(previous[::-1], "skin")


def hands() -> Cage:
    """Both hands: group "skin"; each hand is closed (its wrist ends inside the sleeve)."""
    cage = Cage()
    sections: list[list[int]] = []
    hand = {"LeftHand": 1.0}
    for number, (along, back, palm) in enumerate(_PALM):
        ring = [(along, *q) for q in back] + [(along, *q) for q in reversed(palm)]
        points = np.array(ring)
        points *= (1.02, HAND_SCALE, HAND_SCALE, HAND_SCALE)[number]
        weights: list[Mapping[str, float]] = [hand] * 10
        if number < 1:
            weights = [arm_weights(0.5 + along)] * 10
        if number == 2:  # the ball of the thumb follows it, the heel of the hand does not
            weights = [{"LeftHand": 0.85, "LeftHandThumb1": 0.15} if k in (0, 9) else hand for k in range(10)]
            weights[8] = {"LeftHand": 0.7, "LeftHandThumb1": 0.3}
        if number == 3:
            points[:5, 0] += _FRONT_OF_WEB
            points[5:, 0] += _FRONT_OF_WEB[::-1] + 0.006  # the palm reaches further than the back
            mixed: list[Mapping[str, float]] = []
            for k in range(5):
                fingers = [FINGERS[1 + f] for f in (k - 1, k) if 0 <= f < 4]
                mixed.append({"LeftHand": 0.5} | {f"LeftHand{f}1": 0.5 / len(fingers) for f in fingers})
            weights = [*mixed, *reversed(mixed)]
        sections.append(cage.ring([_model(q) for q in points], weights))
    cage.face(sections[0], "skin")
    thumb_at = (1, 9)  # the quad of the thumb's side between sections 1 and 2
    for number, (near, far) in enumerate(pairwise(sections)):
        for k in range(10):
            if (number, k) == thumb_at:
                continue
            n = (k + 1) % 10
            cage.face((near[n], near[k], far[k], far[n]), "skin")
    last = sections[-1]
    across = np.array([0.0, 1.0, 0.0])
    for f, finger in enumerate(FINGERS[1:]):
        base = [last[f], last[f + 1], last[8 - f], last[9 - f]]
        _grow(cage, base, finger, across)
    near, far = sections[1], sections[2]
    _grow(cage, [far[0], far[9], near[9], near[0]], "Thumb", np.array([0.35, -0.1, -0.80]))
    return cage.mirrored()
