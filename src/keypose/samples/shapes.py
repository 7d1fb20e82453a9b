"""Small tools of implicit modelling: signed distances of simple bodies, smooth unions, and rays that find the surface."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from keypose.arrays import Floats

Field = Callable[[Floats], Floats]


def smoothstep(low: float, high: float, x: Floats | float) -> Floats:
    """0 below ``low``, 1 above ``high``, a smooth cubic between; ``low`` may be the greater one."""
    u = np.clip((np.asarray(x, np.float64) - low) / (high - low), 0.0, 1.0)
    return u * u * (3.0 - 2.0 * u)


def bump(p: Floats, centre: tuple[float, ...], radii: tuple[float, ...]) -> Floats:
    """A smooth bell, 1 at the centre and 0 outside the ellipsoid."""
    d = np.sum(((p - centre) / np.asarray(radii)) ** 2, axis=-1)
    return np.clip(1.0 - d, 0.0, 1.0) ** 2


def ellipsoid(p: Floats, centre: tuple[float, ...], radii: tuple[float, ...], power: float = 2.0) -> Floats:
    """Distance (first order) to a superellipsoid; ``power`` above 2 makes it boxier."""
    r = np.asarray(radii)
    q = np.abs(p - centre) / r
    k = np.maximum(np.sum(q**power, axis=-1) ** (1.0 / power), 1e-9)
    gradient = k[..., None] ** (1.0 - power) * q ** (power - 1.0) / r
    return (k - 1.0) / np.maximum(np.linalg.norm(gradient, axis=-1), 1e-9)


def capsule(p: Floats, a: tuple[float, ...], b: tuple[float, ...], radius_a: float, radius_b: float) -> Floats:
    """Distance to a tapered capsule (radius blended along the axis)."""
    start, end = np.asarray(a), np.asarray(b)
    axis = end - start
    u = np.clip((p - start) @ axis / (axis @ axis), 0.0, 1.0)
    return np.linalg.norm(p - start - u[..., None] * axis, axis=-1) - (radius_a + (radius_b - radius_a) * u)


def union(a: Floats, b: Floats, blend: float) -> Floats:
    """Smooth union: a fillet of about ``blend`` metres.

    Source: I. Quilez, "Smooth minimum" (polynomial form).
    """
    h = np.maximum(blend - np.abs(a - b), 0.0) / blend
    return np.minimum(a, b) - h * h * blend * 0.25


def carve(a: Floats, b: Floats, blend: float) -> Floats:
    """Body ``a`` without body ``b``, smoothly."""
    return -union(-a, b, blend)


def cast(field: Field, origins: Floats, directions: Floats, reach: float, steps: int = 48) -> Floats:
    """Where rays from outside first meet the surface: (N, 3); the rays start ``reach`` away and come in."""
    t = np.full(len(origins), reach)
    for _ in range(steps):
        distance = field(origins + t[:, None] * directions)
        t = t - 0.85 * distance
        if np.max(np.abs(distance)) < 1e-7:
            break
    return origins + t[:, None] * directions
