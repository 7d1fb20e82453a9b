"""The head of the built-in human: an implicit form, meshed with edge loops around the eyes and the mouth.

The form is a smooth union of simple bodies (`head_field`). Loops of points around each eye and the mouth and a grid
that grows coarser towards the back lie on it; the triangulation is the Delaunay triangulation of their directions as
seen from inside the head (the convex hull of the unit directions), so the loops keep their edges and the rest adapts.
The mouth is triangulated a little open and then closed. Only the left half is built; the right one mirrors it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from keypose.arrays import Floats, Ints
from keypose.samples.shapes import bump, capsule, carve, cast, ellipsoid, smoothstep, union
from keypose.samples.skeleton import EYE_CENTRE, EYE_RADIUS

CENTRE = np.array([0.0, 1.525, -0.012])  # the rays of the triangulation start here
MOUTH_Y = 1.4640
MOUTH_HALF = 0.0265
LID = 0.0028  # the lid's thickness over the eyeball
_EX, _EY, _EZ = EYE_CENTRE

EYE_AROUND = 20
MOUTH_AROUND = 17  # of a half ring, from below the middle over the corner to above the middle

EYE_OFFSETS = (0.0, 0.0026, 0.0060, 0.0100)
# of each mouth ring: half width, upper and lower height, forward shift of the upper and lower lip
MOUTH_RINGS = (
    (0.0265, 0.0000, 0.0000, -0.0012, -0.0012),
    (0.0270, 0.0035, 0.0037, 0.0030, 0.0030),
    (0.0286, 0.0066, 0.0079, 0.0024, 0.0022),
    (0.0324, 0.0110, 0.0124, 0.0002, -0.0006),
    (0.0385, 0.0165, 0.0182, 0.0000, 0.0000),
)


@dataclass(frozen=True, slots=True, eq=False)
class HeadMesh:
    """The head's skin with its mouth bag: V vertices; ring tags steer the face shapes.

    Shapes and units:
        points: (V, 3) metres.
        triangles: (F, 3).
        inside: (F,) bool, the triangles of the mouth bag.
        eye_ring, mouth_ring: (V,) ring number counted outward from the rim (negative inside), -99 elsewhere.
        angle: (V,) angle on that ring: 0 at the outer corner, positive above.
        side: (V,) +1 left, -1 right, 0 in the middle.
        image: (V,) index of each vertex' mirror image.
    """

    points: Floats
    triangles: Ints
    inside: Ints
    eye_ring: Ints
    mouth_ring: Ints
    angle: Floats
    side: Floats
    image: Ints


def head_field(p: Floats) -> Floats:
    """Distance to the head's skin without lips and ears; symmetric in x."""
    q = np.stack([np.abs(p[..., 0]), p[..., 1], p[..., 2]], -1)
    d = ellipsoid(q, (0, 1.592, -0.020), (0.1035, 0.099, 0.113), 2.15)
    d = union(d, ellipsoid(q, (0, 1.522, 0.008), (0.0910, 0.0900, 0.0880), 2.5), 0.035)
    d = union(d, ellipsoid(q, (0, 1.455, 0.046), (0.043, 0.030, 0.046), 2.1), 0.050)  # jaw
    d = union(d, ellipsoid(q, (0, 1.4390, 0.0790), (0.0190, 0.0155, 0.0195)), 0.030)  # chin
    d = union(d, ellipsoid(q, (0.048, 1.4985, 0.060), (0.031, 0.025, 0.030)), 0.030)  # cheek
    d = union(d, capsule(q, (0, 1.33, -0.036), (0, 1.48, -0.028), 0.0465, 0.045), 0.030)  # neck
    d = union(d, ellipsoid(q, (0, 1.4675, 0.076), (0.031, 0.026, 0.0225)), 0.022)  # muzzle
    d = carve(d, ellipsoid(q, (_EX - 0.004, _EY, 0.120), (0.026, 0.020, 0.0235)), 0.030)  # eye socket
    d = union(d, capsule(q, (0, 1.548, 0.0895), (0, 1.519, 0.1060), 0.0050, 0.0075), 0.020)  # nose
    d = union(d, ellipsoid(q, (0, 1.5090, 0.1095), (0.0120, 0.0105, 0.0120)), 0.012)
    d = union(d, ellipsoid(q, (0.0095, 1.5055, 0.1010), (0.0070, 0.0068, 0.0085)), 0.009)
    return union(d, ellipsoid(q, (_EX, _EY, _EZ), (EYE_RADIUS + 0.0021,) * 3), 0.008)  # lids


def skin_normal(p: Floats) -> Floats:
    """Unit normals of the head's form near its surface."""
    h = 1e-4
    steps = np.eye(3) * h
    n = np.stack([head_field(p + s) - head_field(p - s) for s in steps], -1)
    return n / np.linalg.norm(n, axis=-1, keepdims=True)


def on_face(x: Floats, y: Floats) -> Floats:
    """The point of the face seen straight from the front at (x, y)."""
    origins = np.stack([x, y, np.zeros_like(x)], -1)
    return cast(head_field, origins, np.tile([0.0, 0.0, 1.0], (len(x), 1)), 0.16)


def eye_outline(angle: Floats, offset: float) -> tuple[Floats, Floats]:
    """The left eye's opening, widened by ``offset`` metres: x, y of points by angle (0 outer corner, up positive)."""
    c, s = np.cos(angle), np.sin(angle)
    half_width = 0.0228 + offset * np.where(c > 0, 1.0, 0.72)
    up, low = 0.0174 + offset * 1.02, 0.0148 + offset * 0.98
    x = half_width * c
    y = np.where(s > 0, up, low) * np.sign(s) * np.abs(s) ** 0.92
    lean = 0.0012 * c + 0.0012 * np.clip(s, 0, 1) * c  # the outer corner lies a little higher
    return _EX + x, _EY + y + lean


def mouth_line(x: Floats) -> Floats:
    """Height of the closed mouth at x: corners lift in a slight smile."""
    t = np.abs(x) / MOUTH_HALF
    return MOUTH_Y + 0.0044 * t**2.0 - 0.0003 * np.exp(-((t / 0.40) ** 2))


def mouth_outline(ring: int, angle: Floats) -> tuple[Floats, Floats, Floats]:
    """Left half of a mouth ring: x, y and forward shift by angle."""
    half, up, low, ahead_up, ahead_low = MOUTH_RINGS[ring]
    c, s = np.cos(angle), np.sin(angle)
    x = half * np.clip(c, 0, 1) ** 0.92
    bow = 1 - 0.16 * np.exp(-((x / 0.0045) ** 2)) * (s > 0) if ring in (1, 2) else np.ones_like(x)
    y = mouth_line(np.minimum(x, MOUTH_HALF)) + np.where(s > 0, up * bow, low) * np.sign(s) * np.abs(s) ** 1.15
    taper = np.abs(s) ** 0.8
    return x, y, np.where(s > 0, ahead_up, ahead_low) * (taper if ring else 1.0)


def _loops() -> tuple[Floats, Floats, Ints, Ints, Floats]:
    """Loop points of the left half: places, places for the triangulation, eye ring, mouth ring, angle."""
    places: list[Floats] = []
    design: list[Floats] = []
    eye: list[Ints] = []
    mouth: list[Ints] = []
    angles: list[Floats] = []
    around = np.arange(EYE_AROUND) * 2 * np.pi / EYE_AROUND
    centre = np.array(EYE_CENTRE)
    for ring, offset in enumerate(EYE_OFFSETS):
        x, y = eye_outline(around, offset)
        p = on_face(x, y)
        out = np.stack([x, y, np.full_like(x, 0.0)], 1) - (_EX, _EY, 0)
        lift = (EYE_RADIUS + LID + (0.0, 0.0006, 0.0, 0.0)[ring]) ** 2 - np.sum(out[:, :2] ** 2, 1)
        ball = np.stack([x, y, centre[2] + np.sqrt(np.maximum(lift, 1e-6))], 1)
        if ring == 0:
            p = ball
        elif ring == 1:
            p = np.where((p[:, 2] < ball[:, 2])[:, None], ball, p)
        places.append(p)
        design.append(p)
        eye.append(np.full(EYE_AROUND, ring))
        mouth.append(np.full(EYE_AROUND, -99))
        angles.append(np.where(around > np.pi, around - 2 * np.pi, around))
    half = np.linspace(-np.pi / 2, np.pi / 2, MOUTH_AROUND)
    for ring in range(len(MOUTH_RINGS)):
        x, y, ahead = mouth_outline(ring, half)
        x[[0, -1]] = 0.0
        p = on_face(x, y)
        p[:, 2] += ahead
        gap = (
            0.0055
            * np.sign(np.round(np.sin(half), 9))
            * np.clip(np.cos(np.pi / 2 * np.minimum(x / MOUTH_HALF, 1)), 0, 1) ** 0.7
        )
        opened = on_face(x, y + gap * (1.0, 0.95, 0.85, 0.6, 0.3)[ring])
        opened[[0, -1], 0] = 0.0
        places.append(p)
        design.append(opened)
        eye.append(np.full(len(x), -99))
        mouth.append(np.full(len(x), ring))
        angles.append(half)
    return np.vstack(places), np.vstack(design), np.concatenate(eye), np.concatenate(mouth), np.concatenate(angles)


def _grid(loops: Floats) -> Floats:
    """Points of the left half between the loops: fine on the face and the nose, coarser towards the back."""
    candidates: list[Floats] = []
    # the nose, from the front
    xs = np.arange(6) * 0.0044
    for number, y in enumerate(np.arange(1.4895, 1.556, 0.0044)):
        row = xs + (0.0022 if number % 2 else 0.0)
        row = row[row <= 0.0165 if y > 1.515 else row <= 0.0245]
        row = np.concatenate([[0.0], row[row > 0.003]])
        candidates.append(on_face(row, np.full(len(row), y)))
    # everything else, by direction from the middle of the head
    for number, elevation in enumerate(np.deg2rad(np.arange(-64, 90, 7.0))):
        front = 0.112 if elevation < 0.6 else 0.19
        step = front / np.cos(elevation)
        azimuth = [0.0]
        while azimuth[-1] < np.pi:
            coarse = 1.0 + 1.1 * smoothstep(0.9, 1.5, azimuth[-1])
            azimuth.append(azimuth[-1] + step * float(coarse))
        a = np.array(azimuth) * np.pi / azimuth[-1]
        if number % 2:
            a = np.concatenate([[0.0], (a[1:] + a[:-1]) / 2, [np.pi]])
        d = np.stack(
            [np.sin(a) * np.cos(elevation), np.full(len(a), np.sin(elevation)), np.cos(a) * np.cos(elevation)], 1
        )
        d[[0, -1], 0] = 0.0
        candidates.append(cast(head_field, np.tile(CENTRE, (len(d), 1)), d, 0.24))
    candidates.append(cast(head_field, CENTRE[None], np.array([[0.0, 1.0, 0.0]]), 0.24))
    points = np.vstack(candidates)
    points = points[points[:, 0] > -1e-9]
    directions = _directions(points)
    taken = list(_directions(loops))
    kept: list[int] = []
    inside = _inside_loops(points)
    known = np.array(taken)
    for i, direction in enumerate(directions):
        if inside[i]:
            continue
        nose = points[i, 2] > 0.098 and points[i, 0] < 0.022 and points[i, 1] > 1.488
        under_hair = points[i, 1] > 1.60 or (points[i, 2] < -0.05 and points[i, 1] > 1.54)
        gap = 0.024 if nose else 0.20 if under_hair else 0.062 if direction[2] > 0.1 else 0.095
        on_middle = points[i, 0] < 1e-9
        if not on_middle and direction[0] < 0.5 * gap:
            continue
        if np.min(np.sum((known - direction) ** 2, 1)) < gap * gap:
            continue
        kept.append(i)
        known = np.vstack([known, direction])
    return points[kept]


def _directions(points: Floats) -> Floats:
    d = points - CENTRE
    return d / np.linalg.norm(d, axis=-1, keepdims=True)


def _inside_loops(points: Floats) -> Any:
    """Whether a point lies within the outermost ring of the eye or the mouth (front half only)."""
    front = points[:, 2] > 0.03
    x, y = points[:, 0] - _EX, points[:, 1] - _EY
    offset = EYE_OFFSETS[-1] + 0.001
    half = 0.0228 + offset * np.where(x > 0, 1.0, 0.72)
    high = np.where(y > 0, 0.0174, 0.0148) + offset
    eye = (x / half) ** 2 + (y / high) ** 2 < 1.0
    width, up, low, _, _ = MOUTH_RINGS[-1]
    v = points[:, 1] - MOUTH_Y - 0.001
    mouth = (points[:, 0] / (width + 0.001)) ** 2 + (v / (np.where(v > 0, up, low) + 0.001)) ** 2 < 1.0
    return front & (eye | mouth)


_NECK_RING = 9  # half ring of points where the neck ends
NECK_Y = 1.345


def _neck() -> Floats:
    """Half rings of the neck from the collar up, (N, 3); the first is the open end."""
    rows: list[Floats] = []
    for y in (NECK_Y, 1.372, 1.398):
        a = np.linspace(0, np.pi, _NECK_RING)
        d = np.stack([np.sin(a), np.zeros(len(a)), np.cos(a)], 1)
        d[[0, -1], 0] = 0.0
        origins = np.tile([0.0, y, -0.033], (len(a), 1))
        rows.append(cast(head_field, origins, d, 0.09))
    return np.vstack(rows)


def build_head() -> HeadMesh:
    """The head, its neck and the mouth bag."""
    from scipy.spatial import ConvexHull

    places, design, eye, mouth, angle = _loops()
    neck = _neck()
    grid = _grid(np.vstack([design, neck]))
    plain = np.full(len(neck) + len(grid), -99)
    points = np.vstack([places, neck, grid])
    directions = _directions(np.vstack([design, neck, grid]))
    eye, mouth = np.concatenate([eye, plain]), np.concatenate([mouth, plain])
    angle = np.concatenate([angle, np.zeros(len(plain))])
    hull = ConvexHull(directions)
    faces = hull.simplices.astype(np.int64)
    a, b, c = (directions[faces[:, i]] for i in range(3))
    flipped = np.sum(np.cross(b - a, c - a) * (a + b + c), -1) < 0
    faces[flipped] = faces[flipped][:, ::-1]
    middle = np.abs(directions[:, 0]) < 1e-7
    rim = np.zeros(len(points), bool)
    rim[len(places) : len(places) + _NECK_RING] = True
    hidden = np.all(middle[faces], 1) | np.all((eye == 0)[faces], 1) | np.all((mouth == 0)[faces], 1)
    hidden |= np.all(rim[faces], 1)
    faces = faces[~hidden]
    points[middle, 0] = 0.0
    points, faces, eye, mouth, angle, inside = _inner_rims(points, faces, eye, mouth, angle)
    return _mirror(points, faces, eye, mouth, angle, inside)


def _inner_rims(
    points: Floats, faces: Ints, eye: Ints, mouth: Ints, angle: Floats
) -> tuple[Floats, Ints, Ints, Ints, Floats, Ints]:
    """Turn the lids in onto the eyeball and the lips into the bag of the mouth."""
    centre = np.array(EYE_CENTRE)
    new_points: list[Floats] = [points]
    new_eye, new_mouth, new_angle = [eye], [mouth], [angle]
    new_faces: list[Ints] = []
    count = len(points)
    previous = np.nonzero(eye == 0)[0]
    previous = previous[np.argsort(np.mod(angle[previous], 2 * np.pi))]
    around = angle[previous]
    rim = points[previous] - centre
    unit = rim / np.linalg.norm(rim, axis=1, keepdims=True)
    spread = unit * (1, 1, 0)
    spread = spread / np.linalg.norm(spread, axis=1, keepdims=True)
    for ring, (radius, outward) in enumerate(
        ((EYE_RADIUS + 0.0004, 0.0), (EYE_RADIUS + 0.0002, 0.35), (EYE_RADIUS - 0.0015, 0.9))
    ):
        d = unit + outward * spread
        d = d / np.linalg.norm(d, axis=1, keepdims=True)
        ids = np.arange(count, count + EYE_AROUND)
        count += EYE_AROUND
        new_points.append(centre + radius * d)
        new_eye.append(np.full(EYE_AROUND, -1 - ring))
        new_mouth.append(np.full(EYE_AROUND, -99))
        new_angle.append(around)
        nxt, below = np.roll(previous, -1), np.roll(ids, -1)
        new_faces += [np.stack([previous, nxt, ids], 1), np.stack([nxt, below, ids], 1)]
        previous = ids
    skin_faces = len(faces) + sum(len(f) for f in new_faces)
    previous = np.nonzero(mouth == 0)[0]
    previous = previous[np.argsort(angle[previous])]
    rim = points[previous]
    around = angle[previous]
    s = np.sin(around)
    s = np.sign(np.round(s, 9)) * np.abs(s) ** 0.7
    for ring, (back, height, narrow) in enumerate(
        (
            (0.0030, 0.0022, 0.99),
            (0.0046, 0.0110, 1.00),
            (0.0160, 0.0160, 1.13),
            (0.0400, 0.0150, 1.00),
            (0.0560, 0.0060, 0.30),
        )
    ):
        p = rim.copy()
        p[:, 0] *= narrow
        p[:, 1] += s * height
        p[:, 2] -= back
        if ring >= 2:
            p[:, 2] = np.minimum(p[:, 2], 0.100 - back)
        ids = np.arange(count, count + MOUTH_AROUND)
        count += MOUTH_AROUND
        new_points.append(p)
        new_eye.append(np.full(MOUTH_AROUND, -99))
        new_mouth.append(np.full(MOUTH_AROUND, -1 - ring))
        new_angle.append(around)
        new_faces += [
            np.stack([previous[:-1], previous[1:], ids[:-1]], 1),
            np.stack([previous[1:], ids[1:], ids[:-1]], 1),
        ]
        previous = ids
    end = np.array([[0.0, MOUTH_Y, 0.04]])
    new_points.append(end)
    new_eye.append(np.array([-99]))
    new_mouth.append(np.array([-7]))
    new_angle.append(np.zeros(1))
    new_faces.append(np.stack([previous[:-1], previous[1:], np.full(MOUTH_AROUND - 1, count)], 1))
    faces = np.vstack([faces, *new_faces])
    inside = np.zeros(len(faces), bool)
    inside[skin_faces + 2 * (MOUTH_AROUND - 1) :] = True
    return (
        np.vstack(new_points),
        faces,
        np.concatenate(new_eye),
        np.concatenate(new_mouth),
        np.concatenate(new_angle),
        inside,
    )


def _mirror(points: Floats, faces: Ints, eye: Ints, mouth: Ints, angle: Floats, inside: Ints) -> HeadMesh:
    middle = np.abs(points[:, 0]) < 1e-9
    points[middle, 0] = 0.0
    image = np.arange(len(points))
    image[~middle] = len(points) + np.arange(int((~middle).sum()))
    other = points[~middle] * (-1, 1, 1)
    return HeadMesh(
        np.vstack([points, other]),
        np.vstack([faces, image[faces][:, ::-1]]),
        np.concatenate([inside, inside]),
        np.concatenate([eye, eye[~middle]]),
        np.concatenate([mouth, mouth[~middle]]),
        np.concatenate([angle, angle[~middle]]),
        np.concatenate([np.where(middle, 0.0, 1.0), np.full(int((~middle).sum()), -1.0)]),
        np.concatenate([image, np.nonzero(~middle)[0]]),
    )


def blush(p: Floats) -> Floats:
    """How rosy the skin is: cheeks, tip of the nose."""
    q = np.stack([np.abs(p[:, 0]), p[:, 1], p[:, 2]], 1)
    return np.clip(
        bump(q, (0.052, 1.497, 0.075), (0.033, 0.026, 0.05)) + 0.7 * bump(q, (0, 1.505, 0.125), (0.018, 0.016, 0.02)),
        0,
        1,
    )
