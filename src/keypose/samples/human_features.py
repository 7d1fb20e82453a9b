"""The separate features of the built-in human's face: eyeballs, teeth, tongue, eyebrows, lashes, ears.

Each function returns a `Piece`; what lies on the skin takes the skin's place from `keypose.samples.human_head`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from keypose.arrays import Floats, Ints
from keypose.samples.human_head import MOUTH_Y, head_field, on_face, skin_normal
from keypose.samples.shapes import cast, smoothstep
from keypose.samples.skeleton import EYE_CENTRE, EYE_RADIUS
from keypose.samples.subdivision import Cage, Weights, subdivide

SCLERA = (0.80, 0.79, 0.77)
PUPIL = (0.012, 0.010, 0.014)
IRIS_DARK, IRIS_LIGHT = (0.030, 0.135, 0.150), (0.19, 0.50, 0.44)
LASH_AROUND = 4
LIMBUS = (0.010, 0.045, 0.055)


@dataclass(frozen=True, slots=True, eq=False)
class Piece:
    """A closed mesh under construction.

    Shapes and units:
        points: (V, 3) metres; ``triangles`` (F, 3).
        colors: (V, 3) linear, or None for the material's own.
        weights: of all vertices, by joint name.
        follows: (V,) the vertex of the head's skin that a vertex moves with, or None.
    """

    points: Floats
    triangles: Ints
    weights: Weights
    colors: Floats | None = None
    follows: Ints | None = None


def tube(rings: Floats, closed_ends: bool = True) -> tuple[Floats, Ints]:
    """Points and triangles of a swept tube: ``rings`` (R, N, 3), each counter-clockwise seen from the far end."""
    count, around, _ = rings.shape
    points = rings.reshape(-1, 3)
    index = np.arange(count * around).reshape(count, around)
    a, b = index[:-1], index[1:]
    a2, b2 = np.roll(a, -1, 1), np.roll(b, -1, 1)
    triangles = [np.stack([a, a2, b2], -1).reshape(-1, 3), np.stack([a, b2, b], -1).reshape(-1, 3)]
    if closed_ends:
        start, end = len(points), len(points) + 1
        points = np.vstack([points, rings[0].mean(0), rings[-1].mean(0)])
        triangles.append(np.stack([np.full(around, start), np.roll(index[0], -1), index[0]], -1))
        triangles.append(np.stack([np.full(around, end), index[-1], np.roll(index[-1], -1)], -1))
    return points, np.vstack(triangles)


def mirrored_piece(points: Floats, triangles: Ints) -> tuple[Floats, Ints]:
    """The mirror image in x = 0."""
    return points * (-1, 1, 1), triangles[:, ::-1]


def eyeball(side: int) -> Piece:
    """An eyeball with pupil, iris and limbal ring as colours on its own loops; it looks along +Z."""
    around = 24
    degrees = np.array([15.2, 15.8, 22.5, 31.0, 34.4, 36.4, 37.8, 52.0, 96.0])
    colors = [PUPIL, IRIS_DARK, IRIS_DARK, IRIS_DARK, LIMBUS, LIMBUS, *[SCLERA] * 3]
    polar = np.deg2rad(degrees)[:, None]
    azimuth = (np.arange(around) * 2 * np.pi / around)[None, :]
    unit = np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar) + 0 * azimuth], -1)
    tint = np.repeat(np.array(colors)[:, None, :], around, 1)
    glow = np.clip(0.55 - 0.62 * np.sin(azimuth), 0, 1)  # light falls in from above and gathers below
    for ring, share in ((1, 0.35), (2, 0.85), (3, 1.0)):
        mix = (glow * share)[0, :, None]
        tint[ring] = np.array(IRIS_DARK) * (1 - mix) + np.array(IRIS_LIGHT) * mix
    shade = 1 - 0.22 * smoothstep(0.35, 0.9, unit[..., 1])  # the upper lid's shadow
    tint *= shade[..., None]
    points = np.vstack([unit.reshape(-1, 3), [[0, 0, 1]], [[0, 0, -1]]])
    index = np.arange(len(degrees) * around).reshape(-1, around)
    a, b = index[:-1], index[1:]
    a2, b2 = np.roll(a, -1, 1), np.roll(b, -1, 1)
    first, last = index[0], index[-1]
    front, back = len(points) - 2, len(points) - 1
    triangles = np.vstack(
        [
            np.stack([a, b, b2], -1).reshape(-1, 3),
            np.stack([a, b2, a2], -1).reshape(-1, 3),
            np.stack([np.full(around, front), first, np.roll(first, -1)], -1),
            np.stack([np.full(around, back), np.roll(last, -1), last], -1),
        ]
    )
    tint = np.vstack([tint.reshape(-1, 3), [PUPIL], [SCLERA]])
    centre = np.array(EYE_CENTRE)
    points = points * EYE_RADIUS + centre
    joint = "LeftEye"
    if side < 0:
        points, triangles = mirrored_piece(points, triangles)
        joint = "RightEye"
    return Piece(points, triangles, {joint: 1.0}, tint)


def catchlight(side: int) -> Piece:
    """The two reflections that bring an eye to life; they lie on the ball and do not turn with it."""
    pieces: list[tuple[Floats, Ints]] = []
    offset = 0
    for x, y, radius in ((-0.30, 0.33, 0.0040), (0.24, -0.26, 0.0021)):
        forward = np.array([x, y, np.sqrt(1 - x * x - y * y)])
        right = np.cross([0.0, 1.0, 0.0], forward)
        right /= np.linalg.norm(right)
        up = np.cross(forward, right)
        a = np.arange(7) * np.pi / 3.5
        circle = np.cos(a)[:, None] * right + np.sin(a)[:, None] * up
        rings = [
            forward * EYE_RADIUS * 0.985 + circle * radius,
            (forward + circle * radius / EYE_RADIUS) * (EYE_RADIUS + 0.0002),
            (forward + circle * radius * 0.6 / EYE_RADIUS) * (EYE_RADIUS + 0.0005),
        ]
        points, triangles = tube(np.array(rings))
        points[-1] = forward * (EYE_RADIUS + 0.0006)
        pieces.append((points, triangles + offset))
        offset += len(points)
    points = np.vstack([p for p, _ in pieces])
    triangles = np.vstack([t for _, t in pieces])
    centre = np.array(EYE_CENTRE) * (side, 1, 1)
    return Piece(points + centre, triangles, {"Head": 1.0})


def teeth(upper: bool) -> Piece:
    """A row of teeth: one closed arch with a soft notch between teeth."""
    steps = 17
    u = np.linspace(-1, 1, steps)
    half, depth = (0.0228, 0.0190) if upper else (0.0180, 0.0130)
    front = 0.0965 if upper else 0.0915
    angle = u * np.deg2rad(82)
    x = half * np.sin(angle) / np.sin(np.deg2rad(82))
    z = front - depth * (1 - np.cos(angle))
    tangent = np.stack([np.gradient(x), 0 * x, np.gradient(z)], 1)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    outward = np.stack([-tangent[:, 2], 0 * x, tangent[:, 0]], 1)
    notch = np.abs(np.cos(np.linspace(-4, 4, steps) * np.pi / 2))
    full = 0.70 + 0.30 * np.sqrt(1 - notch**4)
    root = MOUTH_Y + (0.0120 if upper else -0.0135)
    edge = MOUTH_Y + (-0.0026 if upper else -0.0056)
    edge = edge + (0.0007 if upper else -0.0006) * (1 - full) / 0.30 + (0.0052 if upper else -0.0016) * u**2
    profile = ((0.0, 0.0), (0.0024, 0.3), (0.0022, 0.80), (0.0004, 1.0), (-0.0026, 0.3))
    rings = np.empty((steps, len(profile), 3))
    for k, (out, down) in enumerate(profile):
        push = out * (0.80 + 0.20 * full)
        rings[:, k] = np.stack([x, root + (edge - root) * down, z], 1) + push[:, None] * outward
    if not upper:
        rings = rings[:, ::-1]
    points, triangles = tube(rings)
    gum = np.array((0.62, 0.20, 0.19))
    enamel = np.array((0.83, 0.80, 0.74))
    down = np.array([p[1] for p in profile])
    down = np.tile(down if upper else down[::-1], steps)
    down = np.concatenate([down, [0.3, 0.3]])
    mix = smoothstep(0.05, 0.25, down)[:, None]
    # They stand in the lips' shadow: darker towards the gum and the corners.
    side = np.append(np.repeat(np.abs(u), len(profile)), [1.0, 1.0])
    shade = (1 - (0.62 if upper else 0.92) * smoothstep(0.25, 1.0, side)) * (0.62 + 0.38 * smoothstep(0.1, 1.0, down))
    tint = (gum * (1 - mix) + enamel * mix) * shade[:, None]
    return Piece(points, triangles, {"Head" if upper else "Jaw": 1.0}, tint)


def tongue() -> Piece:
    """A soft tongue resting behind the lower teeth; its tip is at the front."""
    u = np.linspace(0.0, 1.0, 8)
    z = 0.036 + 0.051 * u
    half = (
        0.0145 * smoothstep(-0.35, 0.3, u) * np.sqrt(np.clip(1 - np.clip((u - 0.55) / 0.47, 0, 1) ** 2, 0, 1)) + 0.0004
    )
    thick = 0.0052 * np.sqrt(np.clip(1 - np.clip((u - 0.6) / 0.42, 0, 1) ** 2, 0, 1)) + 0.0003
    a = np.arange(10) * 2 * np.pi / 10
    rings = np.empty((len(u), 10, 3))
    rings[..., 0] = half[:, None] * np.cos(a)
    top = np.where(np.sin(a) > 0, 0.8, 1.0)
    groove = -0.0012 * np.exp(-((np.cos(a) / 0.35) ** 2)) * (np.sin(a) > 0)
    rings[..., 1] = MOUTH_Y - 0.0095 - 0.002 * u[:, None] ** 2 + thick[:, None] * np.sin(a) * top + groove
    rings[..., 2] = z[:, None]
    points, triangles = tube(rings)
    return Piece(points, triangles, {"Jaw": 1.0})


def eyebrow(side: int) -> Piece:
    """A tapered brow, thick towards the nose."""
    u = np.linspace(0, 1, 10)
    x = 0.0165 + 0.0485 * u
    y = 1.5755 + 0.0125 * np.sin(np.pi * (0.12 + 0.72 * u)) - 0.0035 * u**2
    half = 0.0060 * np.clip(1 - u, 0, 1) ** 0.45 * np.sqrt(np.clip((u + 0.012) / 0.16, 0, 1)) + 0.0004
    base = on_face(x, y)
    normal = skin_normal(base)
    along = np.gradient(base, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    across = np.cross(normal, along)
    a = np.arange(6) * np.pi / 3
    rise = 0.42 * half + 0.0004
    rings = (
        base[:, None]
        + normal[:, None] * (rise[:, None] * np.sin(a))[..., None]
        + across[:, None] * (half[:, None] * np.cos(a))[..., None]
    )
    points, triangles = tube(rings)
    if side < 0:
        points, triangles = mirrored_piece(points, triangles)
    return Piece(points, triangles, {"Head": 1.0})


def lashes(rim: Floats, rim_ids: Ints, side: int) -> Piece:
    """The dark line of the upper lid with a small wing; ``rim`` (N, 3) are the left lid's points from the outer corner
    over the top to the inner corner, ``rim_ids`` the skin vertices they follow."""
    u = np.linspace(0, 1, len(rim))
    centre = np.array(EYE_CENTRE)
    outward = rim - centre
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    radial = outward * (1, 1, 0)
    radial /= np.linalg.norm(radial, axis=1, keepdims=True)
    along = np.gradient(rim, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    thick = 0.0021 * np.sin(np.pi * np.clip(u * 0.86 + 0.12, 0, 1)) ** 0.7 * (1 - 0.45 * u) + 0.0003
    length = 0.0042 * (1 - u) ** 1.6 + 0.0012
    a = np.arange(LASH_AROUND) * 2 * np.pi / LASH_AROUND
    up = np.cross(along, outward)
    up *= np.sign(np.sum(up * radial, 1, keepdims=True))
    middle = rim + outward * 0.0002 + up * thick[:, None] * 0.35
    reach = outward * 0.75 + radial * 0.55
    reach /= np.linalg.norm(reach, axis=1, keepdims=True)
    swell = np.clip(np.cos(a), 0, None)
    rings = (
        middle[:, None]
        + reach[:, None] * (thick[:, None] * np.cos(a) * 0.6 + length[:, None] * swell)[..., None]
        + up[:, None] * (thick[:, None] * np.sin(a))[..., None]
    )
    rings[0] = rings[0].mean(0) + 0.35 * (rings[0] - rings[0].mean(0)) + np.array([0.0028, 0.0022, -0.0006])
    points, triangles = tube(rings)
    follows = np.concatenate([np.repeat(rim_ids, LASH_AROUND), rim_ids[[0, -1]]])
    if _signed_volume(points, triangles) < 0:
        triangles = triangles[:, ::-1]
    if side < 0:
        points, triangles = mirrored_piece(points, triangles)
    return Piece(points, triangles, {"Head": 1.0}, follows=follows)


def _signed_volume(points: Floats, triangles: Ints) -> float:
    a, b, c = (points[triangles[:, i]] for i in range(3))
    return float(np.sum(a * np.cross(b, c)) / 6)


def ears() -> tuple[Floats, Ints, Floats]:
    """Both ears: points, triangles, and how deep in the shell a vertex lies (V,) for shading."""
    cage = Cage()
    centre = np.array([0.0985, 1.5275, -0.018])
    out = np.array([0.93, 0.06, 0.36])
    out /= np.linalg.norm(out)
    back = np.array([0.30, 0.10, -0.95])
    back -= out * (back @ out)
    back /= np.linalg.norm(back)
    up = np.cross(out, back)
    up *= np.sign(up[1])
    a = np.arange(8) * np.pi / 4
    c, s = np.cos(a), np.sin(a)  # 0 at the back, a quarter turn at the top
    shape = 1 + 0.10 * s + 0.10 * np.cos(a - 0.9)
    wide, high = 0.0190 * shape, 0.0290 * shape * (1 - 0.10 * (s < 0))
    rings = ((0.50, -0.016), (0.98, 0.002), (1.0, 0.0075), (0.82, 0.0085), (0.58, 0.0020))
    previous: list[int] = []
    for number, (share, rise) in enumerate(rings):
        hug = 0.010 * np.clip(-c, 0, 1) if number else 0 * c  # the front edge melts into the cheek
        points = centre + np.outer(wide * share * c, back) + np.outer(high * share * s, up) + np.outer(rise - hug, out)
        ring = cage.ring(points, {"Head": 1.0})
        if previous:
            cage.bridge(previous, ring, "skin")
        else:
            cage.face(ring[::-1], "skin")
        previous = ring
    cage.face(previous, "skin")
    surface = subdivide(cage.mirrored(), ("Head",))
    triangles = np.vstack([surface.quads[:, [0, 1, 2]], surface.quads[:, [0, 2, 3]]])
    p = surface.points
    side = np.sign(p[:, :1])
    local = (p * np.hstack([side, np.ones_like(side), np.ones_like(side)])) - centre
    radial = np.sqrt((local @ back / 0.0190) ** 2 + (local @ up / 0.0285) ** 2)
    deep = smoothstep(0.78, 0.45, radial) * (local @ out > -0.004)
    return p, triangles, deep


def scalp(azimuth: Floats, elevation: Floats, height: Floats, centre: Floats) -> Floats:
    """Points at a height above the head's skin, by direction from ``centre`` (radians; azimuth 0 in front, left positive)."""
    d = np.stack([np.sin(azimuth) * np.cos(elevation), np.sin(elevation), np.cos(azimuth) * np.cos(elevation)], -1)
    flat = d.reshape(-1, 3)
    hit = cast(head_field, np.tile(centre, (len(flat), 1)), flat, 0.26)
    return (hit + flat * np.asarray(height).reshape(-1, 1)).reshape(d.shape)
