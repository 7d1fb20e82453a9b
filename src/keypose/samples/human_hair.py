"""The built-in human's hair: one closed body whose strips run from a side parting down to the hairline.

The strips follow the way the hair is combed. Each lock is four strips wide, and its section rises steeply from the
groove beside it and falls gently to the next one, so that every lock seems to lie over its neighbour while the surface
has no gaps. Places are directions from a point inside the head with a height above the skin.
"""

from __future__ import annotations

import numpy as np

from keypose.arrays import Floats, Ints
from keypose.samples.human_features import scalp
from keypose.samples.shapes import smoothstep

_CENTRE = np.array([0.0, 1.565, -0.015])

# azimuth in degrees (0 in front, the left side positive) -> elevation of the hairline
_HAIRLINE = (
    (-180, -43), (-158, -42), (-140, -37), (-126, -25), (-114, -8), (-105, 3), (-96, 6), (-88, 2), (-82, -10),
    (-76, -12), (-71, -3), (-66, 8), (-58, 18), (-46, 24), (-30, 29), (-14, 34), (2, 39), (16, 43), (30, 42), (43, 34),
    (56, 21), (66, 8), (71, -3), (76, -12), (82, -10), (88, 2), (96, 6), (105, 3), (114, -8), (126, -25), (140, -37),
    (158, -42), (180, -43),
)  # fmt: skip

_PART_FRONT, _PART_BACK = (34.0, 56.0), (165.0, 74.0)  # ends of the parting, azimuth and elevation in degrees
_PART_HALF = 0.030  # half width of the parting, radians

# Widths of the locks around the head, from the front end of the parting over the right side and the back to the left.
_WIDTHS = (1.0, 1.3, 1.1, 1.35, 1.0, 0.75, 0.75, 1.0, 1.15, 1.0, 1.2, 1.05, 1.2, 1.0, 1.1, 0.95, 0.75, 0.75, 1.05, 0.9)
_LENGTHS = (1.5, 2.5, 3.5, 3.0, 2.0, 1.0, 2.0, 1.0, 3.0, 4.5, 2.5, 5.5, 3.0, 4.5, 2.5, 1.0, 2.0, 1.0, 3.0, 2.0)
_ACROSS = (0.0, 0.17, 0.42, 0.72)  # places of the strips' edges across a lock
_RELIEF = (-1.0, 0.45, 0.62, 0.12)  # and how far each stands out
_GROOVE_M = 0.0056


def _unit(azimuth: Floats, elevation: Floats) -> Floats:
    return np.stack(
        [np.sin(azimuth) * np.cos(elevation), np.sin(elevation), np.cos(azimuth) * np.cos(elevation)], axis=-1
    )


def _parting(angle: Floats) -> Floats:
    """Unit directions around the slit of the parting, 0 at its front end, positive over the right side."""
    front, back = (_unit(*np.deg2rad(np.array(end))) for end in (_PART_FRONT, _PART_BACK))
    middle, reach = (front + back) / 2, (front - back) / 2
    right = np.cross(reach, middle)
    right /= np.linalg.norm(right)
    right *= -np.sign(right[0])
    slit = middle + np.cos(angle)[:, None] * reach + _PART_HALF * np.sin(angle)[:, None] * right
    return slit / np.linalg.norm(slit, axis=1, keepdims=True)


def hair() -> tuple[Floats, Ints, Floats, Ints]:
    """Points, triangles, tints (V, 3; darker in the grooves) of the hair, and 1 for each vertex that is not
    turned in (V,)."""
    from scipy.interpolate import PchipInterpolator

    locks = len(_WIDTHS)
    widths = np.array(_WIDTHS) / np.sum(_WIDTHS)
    starts = np.concatenate([[0.0], np.cumsum(widths)[:-1]])
    turn = (starts[:, None] + widths[:, None] * np.array(_ACROSS)).reshape(-1)  # 0..1 around the head
    relief = np.tile(_RELIEF, locks)
    along_tip = np.sin(np.pi * np.tile(np.array(_ACROSS) + 0.10, locks)) ** 0.8
    longer = np.repeat(_LENGTHS, len(_ACROSS)) * along_tip
    strips = len(turn)

    start = _parting(2 * np.pi * turn)
    azimuth = 8.0 - 360.0 * turn  # where each strip ends
    azimuth = np.where(azimuth < -180, azimuth + 360, azimuth)
    line = np.array(_HAIRLINE, float)
    low = PchipInterpolator(line[:, 0], line[:, 1])(azimuth) - longer
    end = _unit(np.deg2rad(azimuth), np.deg2rad(low))

    # 1 over the forehead, 0 from the temples backwards; and 1 at the nape
    fringe = np.exp(-(((azimuth + 14) / 42) ** 2))
    nape = smoothstep(118, 150, np.abs(azimuth))

    share = np.array([0.0, 0.04, 0.10, 0.19, 0.29, 0.40, 0.51, 0.62, 0.73, 0.84, 0.93, 1.0])
    u = share[:, None]
    way = start * (1 - u[..., None]) + end * u[..., None]
    # Combed: the strips leave the parting at right angles before they turn down.
    away = start - _parting(2 * np.pi * turn + np.pi)
    away[:, 1] = 0.0
    way = way + 0.16 * (np.sin(np.pi * u) * (1 - u))[..., None] * away / np.linalg.norm(away, axis=1, keepdims=True)
    # The fringe bows forward and up; at the back the hair runs in a slow whirl.
    bow = np.sin(np.pi * u)
    way[..., 1] += 0.16 * bow * fringe
    way[..., 2] += 0.05 * bow * fringe
    behind = smoothstep(60, 140, np.abs(azimuth))
    whirl = np.stack([np.cos(np.deg2rad(azimuth)), 0 * azimuth, -np.sin(np.deg2rad(azimuth))], -1)
    way = way + 0.20 * (bow * (1 - 0.55 * u) * behind)[..., None] * whirl
    way = way / np.linalg.norm(way, axis=-1, keepdims=True)

    top = 0.0255 + 0.0085 * fringe  # metres above the skin where the hair is fullest
    tip = 0.0050 + 0.0075 * fringe + 0.0015 * nape
    full = 0.52 + 0.26 * smoothstep(-0.02, 0.07, u) + 0.22 * smoothstep(0.04, 0.36, u)
    height = top * full
    fall = smoothstep(0.52, 1.02, u)
    height = height * (1 - fall) + tip * fall + 0.004 * nape * np.sin(np.pi * u) ** 2
    depth = _GROOVE_M * smoothstep(0.0, 0.16, u) * (1 - 0.35 * smoothstep(0.7, 1.0, u))
    dome = smoothstep(0.80, 0.99, way[..., 1]) * smoothstep(0.0, 0.12, u)
    height = height + 0.007 * dome + depth * relief

    # the border turns in under itself and into the skin
    under = 0.95 * end + 0.05 * start
    inner = 0.86 * end + 0.14 * start
    rows = [way, under[None], inner[None]]
    heights = np.vstack([height, np.full((1, strips), 0.0008), np.full((1, strips), -0.006)])
    directions = np.vstack([r / np.linalg.norm(r, axis=-1, keepdims=True) for r in rows])
    points = scalp(
        np.arctan2(directions[..., 0], directions[..., 2]),
        np.arcsin(np.clip(directions[..., 1], -1, 1)),
        heights,
        _CENTRE,
    )
    count = len(points)
    index = np.arange(count * strips).reshape(count, strips)
    a, b = index[:-1], index[1:]
    a2, b2 = np.roll(a, -1, 1), np.roll(b, -1, 1)
    triangles = [np.stack([a, b, b2], -1).reshape(-1, 3), np.stack([a, b2, a2], -1).reshape(-1, 3)]
    triangles += [_lid(index[0]), _lid(index[-1])[:, ::-1]]
    flat = points.reshape(-1, 3)
    faces = np.vstack(triangles)
    corner = flat[faces]
    if np.sum(corner[:, 0] * np.cross(corner[:, 1], corner[:, 2])) < 0:
        faces = faces[:, ::-1]

    tint = 1.0 + 0.16 * np.clip(relief, -1, 1) * smoothstep(0.0, 0.2, u)
    tint = tint * (0.72 + 0.28 * smoothstep(0.0, 0.14, u)) * (1 + 0.10 * smoothstep(0.6, 1.0, u))
    tint = np.vstack([tint / np.max(tint), np.full((2, strips), 0.25)])
    shown = (np.arange(len(flat)) < len(share) * strips).astype(np.int64)
    return flat, faces, np.repeat(tint.reshape(-1, 1), 3, axis=1), shown


def _lid(ring: Ints) -> Ints:
    """Triangles across a ring, as between the two lips of a slit from its first to its middle vertex."""
    low, high = 1, len(ring) - 1
    made = [(ring[0], ring[1], ring[high])]
    while high - low > 1:
        if len(made) % 2:
            made.append((ring[low], ring[low + 1], ring[high]))
            low += 1
        else:
            made.append((ring[low], ring[high - 1], ring[high]))
            high -= 1
    return np.array(made)
