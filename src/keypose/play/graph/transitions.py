"""How an old motion dies out: the quintic of inertialisation and the extrapolation of dead blending."""

from __future__ import annotations

from typing import Any

import numpy as np

from keypose.arrays import Floats


def quintic(x0: Any, v0: Any, elapsed_s: float, duration_s: float) -> Any:
    """What is left of an offset after a time: a quintic from (x0, v0) to rest at 0 with no acceleration and no jerk.

    Shapes and units: x0, v0 of any shape, per second. An offset that already runs towards zero fast gets less time
    (5 times what it would take, at least a third of the duration), so that it does not shoot far through zero; its first
    acceleration is never against the way to zero. An offset that is nearly zero is treated as one that runs away from it, with
    a smooth passage between the two cases: which side of zero it is on must not matter.

    Source: D. Bollo, "Inertialization: High-Performance Animation Transitions in Gears of War" (GDC 2018), with
    three changes: it works on each component of a vector instead of on its length; an offset that runs away from zero
    keeps its speed instead of losing it, because the speed across or outward would jump otherwise; and it is continuous at 0.
    """
    x0, v0 = np.asarray(x0, np.float64), np.asarray(v0, np.float64)
    side = np.where(x0 < 0, -1.0, 1.0)
    x, v = side * x0, side * v0
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        reached = np.where(v < 0, -x / (v * duration_s), 0.0)  # share of the duration in which it would be at zero
    t1 = duration_s * np.maximum(np.minimum(5.0 * reached, 1.0), 1.0 - 10.0 * reached)
    a0 = np.minimum(15.0 * reached, 1.0) * np.maximum((-8.0 * v * t1 - 20.0 * x) / t1**2, 0.0)
    # In units of the duration: the powers of a short one would vanish.
    u = np.minimum(elapsed_s / t1, 1.0)
    a, w = a0 * t1 * t1, v * t1
    c5 = -(a + 6.0 * w + 12.0 * x) / 2
    c4 = (3.0 * a + 16.0 * w + 30.0 * x) / 2
    c3 = -(3.0 * a + 12.0 * w + 20.0 * x) / 2
    left = ((((c5 * u + c4) * u + c3) * u + a / 2) * u + w) * u + x
    return np.where(u >= 1.0, 0.0, side * left)


def rotation_vector_rate(vector: Floats, spin: Floats) -> Floats:
    """How fast the rotation vector of a rotation changes that turns with an angular velocity in the outer axes.

    Shapes and units: both (*B, 3), rad and rad/s. The inverse of the left Jacobian of SO(3), by its series near 0.

    Source: J. Sola et al., "A micro Lie theory for state estimation in robotics" (2018), equation 146.
    """
    squared = np.sum(vector * vector, axis=-1, keepdims=True)
    angle = np.sqrt(np.maximum(squared, 1e-4))
    factor = np.where(
        squared > 1e-4, (1.0 - 0.5 * angle / np.tan(0.5 * angle)) / np.maximum(squared, 1e-4), 1 / 12 + squared / 720
    )
    across = np.cross(vector, spin)
    return spin - 0.5 * across + factor * np.cross(vector, across)


SHORTEST_HALF_LIFE_S, LONGEST_HALF_LIFE_S = 0.05, 0.5


def half_lives(difference: Floats, velocity: Floats) -> Floats:
    """How long the old velocity lasts, per component: long where it leads towards the new motion, short where it does not.

    Source: D. Holden, "Dead Blending" (2023): proportional to difference / velocity, between two limits.
    """
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        ratio = np.where(velocity != 0, difference / velocity, LONGEST_HALF_LIFE_S)
    return np.clip(ratio, SHORTEST_HALF_LIFE_S, LONGEST_HALF_LIFE_S)


def extrapolated(velocity: Floats, half_life_s: Floats, elapsed_s: float) -> Floats:
    """How far something gets whose velocity halves every half-life: the integral of ``v 2^(-t / half_life)``."""
    rate = np.log(2.0) / half_life_s
    return velocity * -np.expm1(-rate * elapsed_s) / rate
