"""The built-in human's clothes as control cages: bomber jacket, trousers with turned-up hems, sneakers.

Only the left half is written down; `Cage.mirrored` adds the right one. Places are metres in the rest pose.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np

from keypose.arrays import Floats
from keypose.samples.skeleton import hand_axes, rest_positions
from keypose.samples.subdivision import Cage

_HALF = np.arange(9) * np.pi / 8  # from the front middle over the left side to the back middle


def _half_ring(y: float, width: float, front: float, back: float, z: float = 0.0, boxy: float = 0.88) -> Floats:
    """Nine points of the left half of a torso section, (9, 3); ``boxy`` < 1 flattens front and back."""
    sine, cosine = np.sin(_HALF), np.cos(_HALF)
    x = width * np.abs(sine) ** boxy
    depth = np.where(cosine > 0, front, back) * np.sign(cosine) * np.abs(cosine) ** boxy
    x[[0, 8]] = 0.0
    return np.stack([x, np.full(9, y), z + depth], 1)


def _mix(a: Mapping[str, float], b: Mapping[str, float], u: float) -> dict[str, float]:
    return {j: (1 - u) * a.get(j, 0.0) + u * b.get(j, 0.0) for j in dict.fromkeys([*a, *b])}


def _spine(y: float) -> dict[str, float]:
    """Weights of the trunk by height: each vertebra takes over smoothly from the one below."""
    heights = (0.96, 1.045, 1.15, 1.26)
    names = ("Hips", "Spine", "Spine1", "Spine2")
    shares = np.interp(y, heights, np.arange(4.0))
    low = int(min(np.floor(shares), 2))
    u = float(shares - low)
    return {names[low]: 1 - u, names[low + 1]: u}


# --- jacket ----------------------------------------------------------------------------------------------------------

# height, half width, front, back
_TRUNK = (
    (0.940, 0.146, 0.102, 0.108),
    (0.926, 0.157, 0.112, 0.118),
    (0.943, 0.158, 0.112, 0.118),
    (0.960, 0.157, 0.111, 0.117),
    (0.980, 0.157, 0.112, 0.116),
    (0.991, 0.168, 0.123, 0.124),
    (1.028, 0.171, 0.127, 0.124),
    (1.110, 0.158, 0.120, 0.112),
    (1.198, 0.163, 0.126, 0.117),
)
_RIB_ROWS, _STRIPE_ROW = 4, 2

_CHEST = np.array(
    [
        (0, 1.245, 0.125), (0.066, 1.245, 0.121), (0.120, 1.245, 0.098), (0.160, 1.246, 0.030), (0.166, 1.238, -0.006),
        (0.161, 1.246, -0.044), (0.124, 1.247, -0.098), (0.067, 1.250, -0.117), (0, 1.250, -0.120),
    ]
)  # fmt: skip
_ARMHOLE = np.array(
    [
        (0, 1.292, 0.115), (0.062, 1.294, 0.112), (0.114, 1.299, 0.091), (0.150, 1.308, 0.056), (0.170, 1.300, -0.010),
        (0.151, 1.309, -0.076), (0.117, 1.308, -0.103), (0.065, 1.308, -0.119), (0, 1.308, -0.120),
    ]
)  # fmt: skip
_SHOULDERS = np.array(
    [
        (0, 1.333, 0.093), (0.053, 1.336, 0.090), (0.097, 1.349, 0.073), (0.1480, 1.361, 0.019), (0.1480, 1.3715, -0.014),
        (0.1480, 1.363, -0.047), (0.100, 1.363, -0.090), (0.055, 1.360, -0.106), (0, 1.358, -0.108),
    ]
)  # fmt: skip
_NECKLINE = np.array(
    [
        (0, 1.358, 0.064), (0.031, 1.362, 0.059), (0.055, 1.373, 0.042), (0.069, 1.388, 0.013), (0.073, 1.398, -0.020),
        (0.067, 1.402, -0.050), (0.052, 1.404, -0.073), (0.029, 1.405, -0.086), (0, 1.405, -0.090),
    ]
)  # fmt: skip

_TRAPEZIUS = np.outer([-3, -3, -2, 2.5, 4, 2, -1, -3, -3], [0, 1e-3, 0])  # between neck and shoulder


def _between(before: Floats, a: Floats, b: Floats, after: Floats) -> Floats:
    """The middle of the Catmull-Rom curve from ``a`` to ``b``."""
    return (9 * (a + b) - before - after) / 16


def _shoulder_weights(k: int, row: float) -> dict[str, float]:
    """Weights of the chest above the armpits; ``row`` is 0 at the armpit, 4 on the shoulder, 6 at the neckline."""
    chest = {"Spine2": 1.0}
    lower = {"Spine2": 0.75, "Spine1": 0.25}
    base = _mix(lower, chest, min(row / 2, 1.0))
    side = (0.0, 0.05, 0.3, 0.78, 1.0, 0.78, 0.32, 0.06, 0.0)[k]
    clavicle = side * (0.25, 0.4, 0.58, 0.72, 0.8, 0.6, 0.25)[int(row)]
    weights = _mix(base, {"LeftShoulder": 1.0}, clavicle)
    arm = {3: 0.3, 4: 0.42, 5: 0.3, 2: 0.05, 6: 0.06}.get(k, 0.0) * (1.0, 1.0, 1.0, 0.9, 0.62, 0.12, 0.0)[int(row)]
    weights = _mix(weights, {"LeftArm": 1.0}, arm)
    return _mix(weights, {"Neck": 1.0}, 0.25 if row == 6 else 0.0)


def arm_point(s: float, angle: float, radius: float) -> Floats:
    """A point at distance ``s`` from the shoulder along the left arm; angle 0 is on top, a quarter turn in front."""
    places = rest_positions()
    along, front, palm = hand_axes()
    shoulder, elbow, wrist = places["LeftArm"], places["LeftForeArm"], places["LeftHand"]
    upper = float(np.linalg.norm(elbow - shoulder))
    lower = float(np.linalg.norm(wrist - elbow))
    if s < upper:
        centre = shoulder + (elbow - shoulder) * s / upper
    elif s < upper + lower:
        centre = elbow + (wrist - elbow) * (s - upper) / lower
    else:
        centre = wrist + along * (s - upper - lower)
    return centre + radius * (np.cos(angle) * -palm + np.sin(angle) * front)


# distance along the arm on top and below; radius on top, below, and towards the front; group of the quads that follow
_SLEEVE = (
    (-0.001, 0.086, 0.0450, 0.0590, 0.0650, "body"),
    (0.025, 0.098, 0.0508, 0.0565, 0.0600, "sleeve"),
    (0.064, 0.124, 0.0552, 0.0560, 0.0585, "sleeve"),
    (0.122, 0.154, 0.0548, 0.0540, 0.0562, "sleeve"),
    (0.200, 0.204, 0.0518, 0.0515, 0.0532, "sleeve"),
    (0.238, 0.234, 0.0512, 0.0508, 0.0525, "sleeve"),
    (0.263, 0.263, 0.0510, 0.0510, 0.0525, "sleeve"),
    (0.294, 0.298, 0.0505, 0.0505, 0.0515, "sleeve"),
    (0.367, 0.367, 0.0482, 0.0482, 0.0490, "sleeve"),
    (0.447, 0.447, 0.0435, 0.0435, 0.0440, "rib"),
    (0.455, 0.455, 0.0370, 0.0370, 0.0390, "rib"),
    (0.467, 0.467, 0.0362, 0.0362, 0.0386, "stripe"),
    (0.482, 0.482, 0.0362, 0.0362, 0.0386, "rib"),
    (0.497, 0.497, 0.0352, 0.0352, 0.0376, "rib"),
    (0.470, 0.470, 0.0285, 0.0285, 0.0305, ""),
)  # fmt: skip
# How much of the first loops still follows the trunk: on top, where the deltoid stays round, and in the armpit.
_TRUNK_SHARE = ((0.55, 0.46), (0.20, 0.34), (0.04, 0.12))


def arm_weights(s: float) -> dict[str, float]:
    """Weights along the free arm: the twist joints take over towards the elbow and towards the wrist."""
    elbow = 0.262
    bend = float(np.clip((s - elbow) / 0.085 + 0.5, 0, 1))
    bend = bend * bend * (3 - 2 * bend)
    shed = float(np.clip(1 - (s - 0.03) / 0.19, 0, 1))
    gather = float(np.clip((s - 0.30) / 0.165, 0, 1))
    upper = {"LeftArm": shed, "LeftArmTwist": 1 - shed}
    lower = {"LeftForeArm": 1 - gather, "LeftForeArmTwist": gather}
    hand = float(np.clip((s - 0.475) / 0.05, 0, 1))
    return _mix(_mix(upper, lower, bend), {"LeftHand": 1.0}, hand)


def _sleeve(cage: Cage, hole: Sequence[int]) -> None:
    previous = list(hole)
    angles = np.arange(12) * np.pi / 6
    group = "body"  # the seam lies on the first regular loop, where it runs smoothly
    for number, (top, below, above, under, front, following) in enumerate(_SLEEVE):
        lean = (1 - np.cos(angles)) / 2
        along = top + (below - top) * lean
        across = above + (under - above) * lean
        radius = 1.0 / np.sqrt((np.cos(angles) / across) ** 2 + (np.sin(angles) / front) ** 2)
        points = [arm_point(float(s), float(a), float(r)) for s, a, r in zip(along, angles, radius, strict=True)]
        weights = [arm_weights(float(s)) for s in along]
        if number < len(_TRUNK_SHARE):
            trunk = {"LeftShoulder": 0.62, "Spine2": 0.38}
            on_top, in_armpit = _TRUNK_SHARE[number]
            shares = on_top + (in_armpit - on_top) * lean
            weights = [_mix(w, trunk, float(u)) for w, u in zip(weights, shares, strict=True)]
        ring = cage.ring(points, weights)
        cage.bridge(previous, ring, group)
        previous, group = ring, following


def jacket() -> Cage:
    """Bomber jacket: groups "body", "sleeve", "rib" (hem, cuffs), "collar" and "zip"."""
    cage = Cage()
    rows: list[list[int]] = []
    for y, width, front, back in _TRUNK:
        points = _half_ring(y, width, front, back)
        weights = _spine(y)
        if y < 1.0:
            thigh = (0.0, 0.02, 0.04, 0.06, 0.06, 0.06, 0.04, 0.02, 0.0)
            each = [_mix(weights, {"LeftUpLeg": 1.0}, t * (1.0 - y) / 0.08) for t in thigh]
            rows.append(cage.ring(points, each))
        else:
            rows.append(cage.ring(points, weights))
    for number, (low, high) in enumerate(pairwise(rows)):
        group = "stripe" if number == _STRIPE_ROW else "rib" if number < _RIB_ROWS else "body"
        cage.bridge(low, high, group, closed=False)
    trunk_top = np.array([cage.points[i] for i in rows[-1]])
    upper = [
        _CHEST,
        _between(trunk_top, _CHEST, _ARMHOLE, _SHOULDERS),
        _ARMHOLE,
        _between(_CHEST, _ARMHOLE, _SHOULDERS, _NECKLINE),
        _SHOULDERS,
        (_SHOULDERS + _NECKLINE) / 2 + _TRAPEZIUS,
        _NECKLINE,
    ]
    yoke: list[list[int]] = []
    for row, points in enumerate(upper):
        yoke.append(
            [
                cage.add(p, _shoulder_weights(k, row)) if not (k == 4 and 0 < row < 4) else -1
                for k, p in enumerate(points)
            ]
        )
    cage.bridge(rows[-1], yoke[0], "body", closed=False)
    for row, (low, high) in enumerate(pairwise(yoke)):
        for k in range(8):
            if row < 4 and k in (3, 4):
                continue  # the armhole
            cage.face((low[k], low[k + 1], high[k + 1], high[k]), "body")
    hole = [yoke[4][4], *(yoke[r][3] for r in (4, 3, 2, 1, 0)), yoke[0][4], *(yoke[r][5] for r in (0, 1, 2, 3, 4))]
    _sleeve(cage, hole)
    _collar(cage, yoke[6])
    return cage.mirrored()


def _collar(cage: Cage, neckline: Sequence[int]) -> None:
    """A ribbed stand-up collar, open a little at the throat."""
    rows = (  # share of the radius, lift
        (0.970, 0.012),
        (0.940, 0.033),
        (0.872, 0.0345),
        (0.850, -0.010),
    )
    previous = list(neckline)
    front = np.clip(np.cos(_HALF), 0, 1) ** 2
    for share, lift in rows:
        points = (_NECKLINE - (0, 0, -0.016)) * (share, 1, share) + (0, 0, -0.016)
        points[:, 1] += lift * (1 - 0.30 * front)
        points[:, 2] += 0.22 * lift * front - 0.05 * lift * (1 - front)
        neck = float(np.clip(0.25 + lift * 8, 0.1, 0.5))
        ring = cage.ring(points, {"Spine2": 1 - neck, "Neck": neck})
        cage.bridge(previous, ring, "collar", closed=False)
        previous = ring


def shirt() -> Cage:
    """What shows of the T-shirt inside the collar: groups "shirt" and, as its ribbed neckline, "neckband"."""
    cage = Cage()
    previous: list[int] = []
    rows = [(_NECKLINE - (0, 0, -0.016)) * (0.895, 1, 0.895) + (0, -0.007, -0.016)]
    around = np.cos(_HALF)
    for radius, behind, lift in (
        (0.0600, 0.046, 0.0035),
        (0.0560, 0.047, 0.015),
        (0.0515, 0.046, 0.0145),
        (0.045, 0.040, 0.006),
    ):
        deep = np.where(around > 0, radius * 1.03, behind)
        ring = np.stack([radius * np.sin(_HALF), 0 * _HALF, deep * around - 0.033], 1)
        ring[[0, 8], 0] = 0.0
        ring[:, 1] = np.interp(around, [-1, 1], [1.399, 1.363]) + lift
        rows.append(ring)
    for number, points in enumerate(rows):
        neck = (0.2, 0.35, 0.6, 0.65, 0.6)[number]
        ids = cage.ring(points, {"Spine2": 1 - neck, "Neck": neck})
        if previous:
            cage.bridge(previous, ids, "shirt" if number == 1 else "neckband", closed=False)
        previous = ids
    return cage.mirrored()


# --- trousers --------------------------------------------------------------------------------------------------------

_WAIST = (  # height, half width, front, back, weight of the thigh at front, side, back
    (0.975, 0.134, 0.093, 0.100, 0.00, 0.00, 0.00),
    (0.918, 0.153, 0.098, 0.113, 0.06, 0.08, 0.06),
    (0.876, 0.161, 0.094, 0.118, 0.26, 0.30, 0.24),
)
_SEAT = np.array(
    [
        (0, 0.818, 0.060), (0.052, 0.822, 0.084), (0.106, 0.828, 0.083), (0.151, 0.834, 0.048), (0.168, 0.838, -0.004),
        (0.157, 0.834, -0.060), (0.114, 0.826, -0.104), (0.054, 0.818, -0.112), (0, 0.808, -0.083),
    ]
)  # fmt: skip
_CROTCH = ((0, 0.797, -0.052), (0, 0.789, -0.012), (0, 0.796, 0.028))  # from the back to the front

# height, radius across, radius in depth, shift in depth
_LEG_ROWS = (
    (0.765, 0.0800, 0.0900, -0.006),
    (0.655, 0.0746, 0.0818, 0.001),
    (0.524, 0.0641, 0.0674, 0.003),
    (0.486, 0.0626, 0.0659, 0.004),
    (0.448, 0.0616, 0.0649, 0.001),
    (0.370, 0.0597, 0.0644, -0.006),
    (0.260, 0.0553, 0.0598, -0.006),
    (0.153, 0.0512, 0.0546, 0.000),
    (0.149, 0.0568, 0.0603, 0.000),
    (0.114, 0.0566, 0.0601, 0.002),
    (0.130, 0.0473, 0.0508, 0.002),
)
_TURN_UP = 7  # the row where the turned-up hem begins


def _leg_weights(y: float) -> dict[str, float]:
    knee = float(np.clip((0.486 - y) / 0.11 + 0.5, 0, 1))
    knee = knee * knee * (3 - 2 * knee)
    shed = float(np.clip((y - 0.60) / 0.22, 0, 1))
    thigh = {"LeftUpLeg": shed, "LeftUpLegTwist": 1 - shed}
    return _mix(thigh, {"LeftLeg": 1.0}, knee)


def trousers() -> Cage:
    """Trousers: groups "trousers" and "turn_up"."""
    cage = Cage()
    rows: list[list[int]] = []
    around = np.sin(_HALF) ** 2
    for y, width, front, back, at_front, at_side, at_back in _WAIST:
        ends = np.where(np.cos(_HALF) > 0, at_front, at_back) * np.clip(np.abs(np.sin(_HALF)) * 2, 0.3, 1)
        thigh = ends + (at_side - ends) * around
        trunk = _spine(y)
        each = [_mix(trunk, {"LeftUpLeg": 1.0}, float(t)) for t in thigh]
        rows.append(cage.ring(_half_ring(y, width, front, back), each))
    middle = {"Hips": 0.7, "LeftUpLeg": 0.15, "RightUpLeg": 0.15}
    shares = (0.0, 0.52, 0.62, 0.66, 0.66, 0.62, 0.52, 0.42, 0.0)
    seat_weights = [middle if k in (0, 8) else _mix({"Hips": 1}, {"LeftUpLeg": 1}, u) for k, u in enumerate(shares)]
    seat = cage.ring(_SEAT, seat_weights)
    rows.append(seat)
    for low, high in zip(rows[1:], rows, strict=False):
        cage.bridge(low, high, "trousers", closed=False)
    crotch = cage.ring(_CROTCH, {"Hips": 0.6, "LeftUpLeg": 0.2, "RightUpLeg": 0.2})
    previous = [*seat, *crotch]
    places = rest_positions()
    hip, knee, ankle = places["LeftUpLeg"], places["LeftLeg"], places["LeftFoot"]
    angles = np.pi / 2 + (np.arange(12) - 4) * np.pi / 6
    for number, (y, across, deep, shift) in enumerate(_LEG_ROWS):
        centre = np.array(
            [
                np.interp(y, [p[i] for p in ()] or [ankle[1], knee[1], hip[1]], [ankle[i], knee[i], hip[i]])
                for i in range(3)
            ]
        )
        centre[1] = y
        centre[2] += shift
        points = np.stack([across * np.sin(angles), np.zeros(12), deep * np.cos(angles)], 1) + centre
        if number == 0:
            points[:, 0] = np.maximum(points[:, 0], 0.0125)
            points[:, 1] += 0.018 * np.clip(np.sin(angles), -1, 1)
        weights = _leg_weights(y)
        if number < 2:
            inner = (1 - np.sin(angles)) / 2
            share = (0.16 + 0.10 * inner, 0.02 + 0.03 * inner)[number]
            each = [_mix(weights, {"Hips": 1.0}, float(u)) for u in share]
            ring = cage.ring(points, each)
        else:
            ring = cage.ring(points, weights)
        cage.bridge(ring, previous, "turn_up" if number > _TURN_UP else "trousers")
        previous = ring
    return cage.mirrored()


# --- sneakers --------------------------------------------------------------------------------------------------------

# height at heel and toe, heel and toe ends along the foot, half width, boxiness, group of the quads below this row
_SHOE = (
    (0.000, 0.004, -0.089, 0.199, 0.0470, 0.82, ""),
    (0.026, 0.025, -0.093, 0.203, 0.0495, 0.82, "sole"),
    (0.030, 0.029, -0.087, 0.197, 0.0455, 0.84, "sole"),
    (0.056, 0.058, -0.086, 0.190, 0.0468, 0.86, "upper"),
    (0.087, 0.087, -0.081, 0.147, 0.0420, 0.94, "upper"),
    (0.116, 0.118, -0.074, 0.056, 0.0395, 1.00, "upper"),
    (0.129, 0.131, -0.068, 0.044, 0.0365, 1.00, "trim"),
)


def _shoe_weights(z: float, y: float) -> dict[str, float]:
    toes = float(np.clip((z - 0.098) / 0.055 + 0.5, 0, 1))
    toes = toes * toes * (3 - 2 * toes)
    shin = float(np.clip((y - 0.085) / 0.06, 0, 1)) * 0.55
    return _mix(_mix({"LeftFoot": 1.0}, {"LeftToeBase": 1.0}, toes), {"LeftLeg": 1.0}, shin)


def shoes() -> Cage:
    """A pair of sneakers: groups "sole", "upper" and "trim"; closed, with the opening turned in."""
    cage = Cage()
    angles = np.arange(12) * np.pi / 6
    ankle = rest_positions()["LeftFoot"]
    turn = np.deg2rad(5.0)
    previous: list[int] = []
    for heel_y, toe_y, heel_z, toe_z, half, boxy, group in _SHOE:
        sine, cosine = np.sin(angles), np.cos(angles)
        middle, reach = (heel_z + toe_z) / 2, (toe_z - heel_z) / 2
        z = middle + reach * np.sign(cosine) * np.abs(cosine) ** boxy
        share = (z - heel_z) / (toe_z - heel_z)
        # A foot is widest at the ball and bends inwards: the big toe's side runs straight.
        broad = 1 + 0.16 * np.sin(np.clip(share, 0, 1) * np.pi * 1.05 - 0.55) * min(reach / 0.13, 1)
        x = half * broad * np.sign(sine) * np.abs(sine) ** 0.8 - 0.006 * np.sin(np.clip(share, 0, 1) * np.pi)
        y = heel_y + (toe_y - heel_y) * share
        y = y + 0.010 * np.clip((z - 0.12) / 0.08, 0, 1) ** 2 * (y < 0.03)  # toe spring
        local_z = z
        points = np.stack(
            [
                ankle[0] + x * np.cos(turn) + (local_z + 0.02) * np.sin(turn),
                y,
                ankle[2] + 0.022 + local_z * np.cos(turn) - x * np.sin(turn),
            ],
            1,
        )
        ring = cage.ring(points, [_shoe_weights(p[2], p[1]) for p in points])
        if previous:
            cage.bridge(previous, ring, group)
        else:
            cage.face(ring[::-1], "sole")
        previous = ring
    cage.face(previous, "trim")
    return cage.mirrored()
