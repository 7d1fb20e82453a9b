"""Small things sewn onto the built-in human's clothes: zip, star, laces. They take place and weights from the cloth."""

from __future__ import annotations

import numpy as np

from keypose.arrays import Floats, Ints
from keypose.samples.human_features import tube
from keypose.samples.skeleton import rest_positions
from keypose.samples.subdivision import Surface, triangulated

Detail = tuple[Floats, Ints, Floats]  # points, triangles, dense weights


def _landing(cloth: Surface, at: Floats, axis: int, side: int = 1) -> tuple[Floats, Floats]:
    """Where lines along ``axis`` (2: from the front, 1: from above; ``side`` -1: from the back) through ``at`` (N, 3)
    meet the cloth first: the points (N, 3) and their weights (N, J)."""
    plane = [i for i in range(3) if i != axis]
    triangles = triangulated(cloth.quads, cloth.points)
    corners = cloth.points[triangles]
    a, b, c = (corners[:, i][:, plane] for i in range(3))
    p = at[:, None, plane]
    area = _cross(b - a, c - a)
    area = np.where(np.abs(area) < 1e-12, 1e-12, area)
    u = _cross(p - a, c - a) / area
    v = _cross(b - a, p - a) / area
    share = np.stack([1 - u - v, u, v], -1)
    inside = np.min(share, -1) >= -1e-6
    depth = np.where(inside, side * np.einsum("nfk,fk->nf", share, corners[:, :, axis]), -np.inf)
    hit = np.argmax(depth, 1)
    rows = np.arange(len(at))
    best = share[rows, hit]
    points = at.copy()
    points[:, axis] = side * depth[rows, hit]
    return points, np.einsum("nk,nkj->nj", best, cloth.weights[triangles[hit]])


def _cross(a: Floats, b: Floats) -> Floats:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def _swept(
    cloth: Surface, path: Floats, axis: int, profile: tuple[tuple[float, float], ...], across: int, side: int = 1
) -> Detail:
    """A bar along ``path`` (N, 3) on the cloth; ``profile`` gives its section as (across, above the cloth) metres."""
    rings: list[Floats] = []
    weights: list[Floats] = []
    for over, above in profile:
        at = path.copy()
        at[:, across] += over
        points, w = _landing(cloth, at, axis, side)
        points[:, axis] += side * above
        rings.append(points)
        weights.append(w)
    points, triangles = tube(np.stack(rings, 1))
    dense = np.stack(weights, 1).reshape(len(points) - 2, -1)
    dense = np.vstack([dense, dense[: len(profile)].mean(0), dense[-len(profile) :].mean(0)])
    return points, _outward(points, triangles), dense


def _outward(points: Floats, triangles: Ints) -> Ints:
    a, b, c = (points[triangles[:, i]] for i in range(3))
    return triangles if np.sum(a * np.cross(b, c)) > 0 else triangles[:, ::-1]


def zip_fastener(jacket: Surface) -> list[Detail]:
    """The zip down the front, with its slider."""
    low = (0.929, 0.945, 0.961, 0.976, 0.984, 0.990, 0.997, 1.008, 1.025, 1.06)  # close together over the hem's fold
    y = np.concatenate([low, np.linspace(1.10, 1.364, 8)])
    path = np.stack([0 * y, y, 0 * y], 1)
    band = _swept(jacket, path, 2, ((-0.0050, -0.0020), (-0.0040, 0.0018), (0.0040, 0.0018), (0.0050, -0.0020)), 0)
    y = np.linspace(1.326, 1.352, 5)
    path = np.stack([0 * y, y, 0 * y], 1)
    pull = _swept(jacket, path, 2, ((-0.0032, 0.0), (-0.0024, 0.0048), (0.0024, 0.0048), (0.0032, 0.0)), 0)
    return [band, pull]


def jacket_pockets(jacket: Surface) -> list[Detail]:
    """The slanted welt of the left pocket of the jacket."""
    u = np.linspace(0, 1, 5)
    path = np.stack([0.092 + 0.034 * u, 1.088 - 0.075 * u, 0 * u], 1)
    return [_swept(jacket, path, 2, ((-0.0075, -0.002), (-0.0060, 0.0022), (0.0060, 0.0022), (0.0075, -0.002)), 0)]


_STITCH = ((-0.0018, -0.0006), (0.0, 0.0019), (0.0018, -0.0006))


def seams(trousers: Surface) -> list[Detail]:
    """Seams on the left half of the trousers: the front pocket and the back pocket."""
    u = np.linspace(0, 1, 9)
    front = np.stack([0.082 + 0.066 * u**1.5, 0.925 - 0.078 * u**0.8, 0 * u], 1)
    corners = np.array([(0.048, 0.878), (0.049, 0.852), (0.050, 0.826), (0.081, 0.812), (0.112, 0.830), (0.113, 0.880)])
    made = [_swept(trousers, front, 2, _STITCH, 0)]
    for a, b in ((0, 2), (2, 3), (3, 4), (4, 5), (5, 0)):
        steps = np.linspace(0, 1, 4)[:, None]
        line = np.hstack([corners[a] * (1 - steps) + corners[b] * steps, 0 * steps])
        across = 1 if abs(corners[a][0] - corners[b][0]) > abs(corners[a][1] - corners[b][1]) else 0
        made.append(_swept(trousers, line, 2, _STITCH, across, side=-1))
    return made


def fly(trousers: Surface) -> list[Detail]:
    """The stitched curve beside the zip of the trousers."""
    path = np.array(
        [(0.021, y, 0) for y in np.linspace(0.925, 0.868, 5)]
        + [(0.018, 0.857, 0), (0.010, 0.849, 0), (0.001, 0.845, 0)]
    )
    return [_swept(trousers, path, 2, _STITCH, 0)]


def star(jacket: Surface) -> Detail:
    """A five-pointed star on the left of the chest."""
    a = np.arange(10) * np.pi / 5 + np.pi / 2 + 0.10
    radius = np.where(np.arange(10) % 2 == 0, 0.0215, 0.0108)
    outline = np.stack([0.078 + radius * np.cos(a), 1.252 + radius * np.sin(a), 0 * a], 1)
    middle = outline.mean(0)
    rings: list[Floats] = []
    weights: list[Floats] = []
    for share, above in ((1.0, -0.0012), (0.95, 0.0012), (0.5, 0.0024)):
        points, w = _landing(jacket, middle + (outline - middle) * share, 2)
        points[:, 2] += above
        rings.append(points)
        weights.append(w)
    points, triangles = tube(np.array(rings))
    top, w = _landing(jacket, middle[None], 2)
    points[-1] = top[0] + (0, 0, 0.0028)
    points[-2] = top[0] - (0, 0, 0.003)
    return points, _outward(points, triangles), np.vstack([*weights, w, w])


def laces(shoes: Surface) -> list[Detail]:
    """Four bars of laces on each sneaker."""
    ankle = rest_positions()["LeftFoot"]
    left = np.max(shoes.points[shoes.quads], axis=1)[:, 0] > 0
    one = Surface(shoes.points, shoes.quads[left], (), shoes.weights)
    made: list[Detail] = []
    for number, forward in enumerate((0.066, 0.085, 0.104, 0.123)):
        half = 0.0155 - 0.0008 * number
        x = np.linspace(-half, half, 4)
        turn = np.deg2rad(5.0)
        z = ankle[2] + 0.022 + forward
        path = np.stack(
            [ankle[0] + (forward + 0.02) * np.sin(turn) + x * np.cos(turn) - 0.002, 0 * x, z - x * np.sin(turn)], 1
        )
        section = ((-0.0036, -0.001), (-0.0028, 0.0024), (0.0028, 0.0024), (0.0036, -0.001))
        made.append(_swept(one, path, 1, section, 2))
    return made
