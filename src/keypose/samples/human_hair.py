"""The built-in human's hair: a cap that follows the skull and broad tapered locks swept from a side parting."""

from __future__ import annotations

import numpy as np

from keypose.arrays import Floats, Ints
from keypose.samples.human_features import scalp, tube
from keypose.samples.shapes import smoothstep

_CENTRE = np.array([0.0, 1.565, -0.015])

# azimuth in degrees -> elevation of the hairline, for either side
_HAIRLINE = (
    (0, 40), (22, 38), (42, 31), (56, 18), (63, 0), (70, -16), (80, -17), (88, 4), (100, 10), (114, -6),
    (126, -28), (142, -40), (160, -45), (180, -46),
)  # fmt: skip

# A lock: control points (azimuth, elevation in degrees, height above the skin in millimetres), half width and half
# thickness in millimetres.
_LOCKS = (
    # the fringe, from the parting on the left over the brow to the right
    (((34, 56, 12), (8, 55, 27), (-22, 46, 26), (-46, 31, 17), (-62, 14, 7)), 24, 11),
    (((36, 50, 11), (16, 46, 25), (-8, 40, 25), (-30, 30, 18), (-47, 20, 9)), 20, 10),
    (((34, 64, 12), (2, 66, 28), (-36, 56, 25), (-60, 36, 17), (-76, 14, 8)), 25, 11),
    (((36, 72, 12), (-6, 78, 27), (-62, 66, 24), (-82, 42, 18), (-96, 16, 9)), 26, 11),
    (((44, 80, 12), (-60, 84, 25), (-105, 66, 23), (-112, 40, 18), (-116, 12, 9)), 27, 11),
    (((60, 84, 12), (-140, 80, 24), (-140, 60, 23), (-138, 34, 18), (-138, 4, 9)), 27, 11),
    # the short side, from the parting to the left
    (((36, 54, 12), (50, 45, 17), (60, 32, 15), (66, 18, 11), (70, 2, 4)), 20, 8),
    (((42, 62, 13), (64, 54, 19), (80, 40, 18), (88, 24, 13), (94, 8, 6)), 23, 9),
    (((52, 72, 13), (86, 64, 21), (104, 46, 20), (112, 26, 15), (117, 6, 7)), 25, 10),
    (((70, 82, 12), (128, 70, 22), (138, 50, 22), (142, 28, 17), (144, 0, 8)), 26, 10),
    # the back
    (((120, 86, 12), (170, 74, 23), (172, 52, 23), (174, 26, 18), (176, -6, 9)), 28, 11),
    (((176, 40, 10), (178, 20, 19), (180, 0, 18), (181, -18, 13), (182, -38, 4)), 26, 9),
    (((150, 36, 10), (152, 16, 19), (153, -4, 17), (155, -20, 12), (158, -38, 4)), 24, 9),
    (((-150, 36, 10), (-152, 16, 19), (-153, -4, 17), (-155, -20, 12), (-158, -38, 4)), 24, 9),
    (((126, 30, 9), (127, 12, 16), (128, -4, 14), (130, -16, 9), (134, -30, 3)), 20, 8),
    (((-126, 30, 9), (-127, 12, 16), (-128, -4, 14), (-130, -16, 9), (-134, -30, 3)), 20, 8),
    # sideburns
    (((62, 24, 5), (66, 10, 8), (68, 0, 7), (70, -10, 4), (71, -20, 0)), 11, 5),
    (((-62, 24, 5), (-66, 10, 8), (-68, 0, 7), (-70, -10, 4), (-71, -20, 0)), 11, 5),
    # two strands that break the outline on the crown
    (((28, 62, 14), (6, 68, 31), (-22, 66, 36), (-44, 58, 33), (-60, 48, 25)), 17, 10),
    (((140, 84, 14), (168, 80, 29), (176, 70, 33), (-178, 58, 29), (-174, 44, 22)), 16, 9),
)  # fmt: skip


def _curve(points: Floats, steps: int) -> Floats:
    """A Catmull-Rom curve through the points, (steps, D)."""
    p = np.vstack([2 * points[0] - points[1], points, 2 * points[-1] - points[-2]])
    t = np.linspace(0, len(points) - 1 - 1e-9, steps)
    i = t.astype(int)
    u = (t - i)[:, None]
    a, b, c, d = p[i], p[i + 1], p[i + 2], p[i + 3]
    return 0.5 * (2 * b + (c - a) * u + (2 * a - 5 * b + 4 * c - d) * u**2 + (3 * b - a - 3 * c + d) * u**3)


def cap() -> tuple[Floats, Ints]:
    """The hair close to the skull; its border sinks into the skin along the hairline."""
    around, deep = 38, 7
    azimuth = np.linspace(-np.pi, np.pi, around, endpoint=False)
    line = np.array(_HAIRLINE, float)
    at = np.concatenate([-line[:0:-1, 0], line[:-1, 0], 360 - line[::-1, 0]])
    of = np.concatenate([line[:0:-1, 1], line[:-1, 1], line[::-1, 1]])
    from scipy.interpolate import PchipInterpolator

    low = np.deg2rad(PchipInterpolator(at, of)(np.rad2deg(azimuth)))
    share = np.linspace(0.06, 1.0, deep) ** 0.9
    height = 0.0015 + 0.0120 * np.sqrt(smoothstep(1.04, 0.72, share))
    share, height = np.append(share, 0.985), np.append(height, -0.006)  # the border is turned in under itself
    elevation = np.pi / 2 - (np.pi / 2 - low)[None, :] * share[:, None]
    points = scalp(np.tile(azimuth, (deep + 1, 1)), elevation, np.repeat(height[:, None], around, 1), _CENTRE)
    top = scalp(np.zeros(1), np.full(1, np.pi / 2), height[:1], _CENTRE)
    flat, triangles = tube(points[::-1])
    flat[-1] = top[0]
    return flat, triangles


def locks() -> list[tuple[Floats, Ints]]:
    """One closed tapered body per lock."""
    steps, around = 9, 6
    u = np.linspace(0, 1, steps)
    controls = np.array([c for c, _, _ in _LOCKS], float)
    controls[..., 0] = np.rad2deg(np.unwrap(np.deg2rad(controls[..., 0]), axis=1))
    polar = np.deg2rad(controls[..., :2])
    direction = np.stack(
        [
            np.sin(polar[..., 0]) * np.cos(polar[..., 1]),
            np.sin(polar[..., 1]),
            np.cos(polar[..., 0]) * np.cos(polar[..., 1]),
        ],
        -1,
    )
    paths = np.array([_curve(np.hstack([d, c[:, 2:]]), steps) for d, c in zip(direction, controls, strict=True)])
    d = paths[..., :3] / np.linalg.norm(paths[..., :3], axis=-1, keepdims=True)
    centre = scalp(
        np.arctan2(d[..., 0], d[..., 2]), np.arcsin(np.clip(d[..., 1], -1, 1)), paths[..., 3] * 1e-3, _CENTRE
    )
    a = np.arange(around) * 2 * np.pi / around
    made: list[tuple[Floats, Ints]] = []
    for path, out, (_, wide, thick) in zip(centre, d, _LOCKS, strict=True):
        along = np.gradient(path, axis=0)
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        across = np.cross(along, out)
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        normal = np.cross(across, along)
        profile = np.sqrt(smoothstep(-0.05, 0.30, u)) * np.clip(1 - u, 0, 1) ** 0.55
        profile = profile / profile.max()
        profile = np.maximum(profile, 0.04)
        rings = (
            path[:, None]
            + across[:, None] * (1e-3 * wide * profile[:, None] * np.cos(a))[..., None]
            + normal[:, None] * (1e-3 * thick * profile[:, None] * np.sin(a))[..., None]
        )
        bend = -1e-3 * 0.30 * wide * (np.cos(a) ** 2)[None, :] * profile[:, None]  # wraps round the skull
        rings = rings + normal[:, None] * bend[..., None]
        made.append(tube(rings[:, ::-1]))
    return made
