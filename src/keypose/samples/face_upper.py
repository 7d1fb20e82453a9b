"""Face shapes of eyes, brows, cheeks and nose, written for the left side."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from keypose.arrays import Floats
from keypose.samples.face_base import Face, turned
from keypose.samples.human_head import EYE_AROUND, LID, eye_outline
from keypose.samples.shapes import bump, smoothstep
from keypose.samples.skeleton import EYE_CENTRE, EYE_RADIUS

LOOK = {"Up": (-1, 0, 24.0), "Down": (1, 0, 28.0), "Out": (0, 1, 30.0), "In": (0, -1, 30.0)}

# --- eyes ------------------------------------------------------------------------------------------------------------


def lid(face: Face, upper: float, lower: float) -> Floats:
    """Offsets of the left lids.

    ``upper`` and ``lower`` are shares of the way from the rest to the line where the closed lids meet (negative opens
    wider).
    """
    head = face.head
    p = head.points
    offsets = np.zeros_like(p)
    centre = np.array(EYE_CENTRE)
    on = (head.eye_ring > -90) & (head.side > 0)
    around = np.arange(EYE_AROUND) * 2 * np.pi / EYE_AROUND
    rim = np.stack(eye_outline(around, 0.0), 1)
    number = np.round(np.mod(head.angle[on], 2 * np.pi) / (2 * np.pi) * EYE_AROUND).astype(int) % EYE_AROUND
    margin = rim[number]
    low = np.interp(margin[:, 0], *_lid_curve(rim, lower=True))
    top = np.interp(margin[:, 0], *_lid_curve(rim, lower=False))
    # The lids meet low on the ball, and half-way near the corners, where the upper one could not follow.
    corner = 0.42 * np.cos(around)[number] ** 4 * (top - low)
    meet = low + 0.10 * (top - low) + corner
    sine = np.sin(around)[number]
    is_upper = sine > 1e-6
    is_lower = sine < -1e-6
    share = np.where(is_upper, upper, np.where(is_lower, lower, 0.0))
    travel = (meet - margin[:, 1]) * share
    travel -= np.where(is_lower, corner * share * (1 - np.clip(upper, 0, 1)), 0.0)  # a lower lid alone stays low there
    ring = head.eye_ring[on]
    follow = np.select(
        [ring >= 0, ring == -1, ring == -2], [np.array([1.0, 0.95, 0.70, 0.34])[np.clip(ring, 0, 3)], 1.0, 0.9], 0.55
    )
    q = p[on]
    moved = q.copy()
    moved[:, 1] += travel * follow
    # Stay outside the eyeball: on its sphere, a lid's thickness away.
    radius = np.select(
        [ring >= 0, ring == -1, ring == -2],
        [EYE_RADIUS + LID + 0.0004 * np.clip(ring, 0, 2), EYE_RADIUS + 0.0006, EYE_RADIUS + 0.0003],
        EYE_RADIUS - 0.0015,
    )
    flat = np.sum((moved[:, :2] - centre[:2]) ** 2, 1)
    ball = centre[2] + np.sqrt(np.maximum(radius**2 - flat, 1e-8))
    free = np.maximum(moved[:, 2], ball)
    on_ball = np.select([ring <= 1, ring == 2], [1.0, 0.75], 0.2)
    strength = np.clip(np.abs(travel) / 0.004, 0, 1)
    moved[:, 2] += (
        np.where(ring <= 0, ball - moved[:, 2], np.where(ring <= 2, free - moved[:, 2], 0.0)) * on_ball * strength
    )
    moved[:, 2] -= np.where(ring <= -2, 0.0045 * strength, 0.0)  # what is turned in stays hidden behind the lids
    offsets[on] = moved - q
    # the skin around follows a little
    near = bump(p, (centre[0], centre[1] + 0.012, 0.085), (0.040, 0.036, 0.05)) * (~on) * (head.side >= 0)
    offsets[:, 1] += near * -0.0030 * upper
    near = bump(p, (centre[0], centre[1] - 0.022, 0.085), (0.036, 0.026, 0.05)) * (~on) * (head.side >= 0)
    offsets[:, 1] += near * 0.0035 * lower
    return offsets


def _lid_curve(rim: Floats, lower: bool) -> tuple[Floats, Floats]:
    half = EYE_AROUND // 2
    curve = rim[half:] if lower else rim[: half + 1]
    curve = np.vstack([curve, rim[0]]) if lower else curve
    order = np.argsort(curve[:, 0])
    return curve[order, 0], curve[order, 1]


def blink(face: Face) -> dict[str, Floats]:
    out = face.zero()
    out["skin"] = lid(face, 1.0, 1.0)
    # The offsets run straight while the lid should roll over the ball: the ball gives way meanwhile.
    for name in ("eyes", "catchlights"):
        half = len(out[name]) // 2
        out[name][:half, 2] = -0.0042
    return out


def squint(face: Face) -> dict[str, Floats]:
    out = face.zero()
    out["skin"] = lid(face, 0.14, 1.9) + cheek_raise(face, 0.5)
    return out


def wide(face: Face) -> dict[str, Floats]:
    out = face.zero()
    out["skin"] = lid(face, -0.13, -0.45)
    return out


def look(face: Face, way: str) -> dict[str, Floats]:
    out = face.zero()
    about_x, about_y, degrees = LOOK[way]
    half = len(face.eyes) // 2
    centre = np.array(EYE_CENTRE)
    out["eyes"][:half] = turned(face.eyes[:half], centre, (about_x, about_y, 0), np.deg2rad(degrees))
    if way == "Down":
        out["skin"] = lid(face, 0.30, -0.25)
    elif way == "Up":
        out["skin"] = lid(face, -0.10, 0.35)
    return out


# --- brows, cheeks, nose ---------------------------------------------------------------------------------------------


def on_skin(face: Face, field: Callable[[Floats], Floats]) -> dict[str, Floats]:
    """A displacement field applied to the skin and to the brows that lie on it; the lids' rims stay."""
    out = face.zero()
    head = face.head
    hold = np.where(
        head.eye_ring > -90, np.array([0.0, 0.0, 0.0, 0.0, 0.15, 0.45, 0.8])[np.clip(head.eye_ring, -3, 3) + 3], 1.0
    )
    hold = np.where((head.mouth_ring < 0) & (head.mouth_ring > -90), 0.0, hold)
    out["skin"] = field(head.points) * hold[:, None]
    out["brows"] = field(face.brows)
    return out


def one_side(p: Floats, width: float = 0.006) -> Floats:
    return smoothstep(-width, width, p[:, 0])[:, None]


def brow_down(p: Floats) -> Floats:
    w = bump(p, (0.028, 1.578, 0.085), (0.044, 0.034, 0.06))[:, None] * one_side(p)
    inner = smoothstep(0.055, 0.012, p[:, 0])[:, None]
    return w * (np.array([-0.0028, -0.0075, 0.0012]) * (0.45 + 0.75 * inner))


def brow_inner_up(p: Floats) -> Floats:
    q = np.abs(p[:, 0])
    w = bump(np.stack([q, p[:, 1], p[:, 2]], 1), (0.012, 1.582, 0.09), (0.036, 0.038, 0.06))[:, None]
    return w * np.array([0.0, 0.0115, -0.0005]) + w * np.stack(
        [np.sign(p[:, 0]) * -0.0010 * smoothstep(0, 0.01, q), 0 * q, 0 * q], 1
    )


def brow_outer_up(p: Floats) -> Floats:
    w = bump(p, (0.052, 1.584, 0.075), (0.036, 0.036, 0.06))[:, None] * one_side(p)
    return w * np.array([0.0006, 0.0105, 0.0])


def cheek_raise(face: Face, amount: float) -> Floats:
    p = face.head.points
    w = bump(p, (0.047, 1.503, 0.078), (0.034, 0.026, 0.05))[:, None] * (p[:, :1] > 0)
    fixed = np.where(
        (face.head.eye_ring > -90) & (face.head.eye_ring < 2), 0.0, np.where(face.head.eye_ring >= 2, 0.5, 1.0)
    )
    return w * np.array([0.0012, 0.0055, 0.0040]) * amount * fixed[:, None]


def cheek_squint(face: Face) -> dict[str, Floats]:
    out = face.zero()
    out["skin"] = cheek_raise(face, 1.3) + lid(face, 0.0, 1.1)
    return out


def cheek_puff(face: Face) -> dict[str, Floats]:
    out = face.zero()
    head = face.head
    p = head.points
    q = np.stack([np.abs(p[:, 0]), p[:, 1], p[:, 2]], 1)
    w = bump(q, (0.047, 1.472, 0.070), (0.042, 0.036, 0.06))
    w = w * np.where(head.mouth_ring > -90, np.array([0.0, 0.1, 0.25, 0.6, 0.9])[np.clip(head.mouth_ring, 0, 4)], 1.0)
    w = np.where(head.mouth_ring < 0, w * (head.mouth_ring < -90), w)
    away = p - np.array([0.0, 1.475, 0.02])
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    out["skin"] = w[:, None] * away * 0.0150
    return out
