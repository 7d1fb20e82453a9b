"""What feet do with the ground, frame by frame: contacts, sliding, sinking, floating."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from keypose.analysis.contacts import Footing, find_footing, foot_points, has_legs, leg_length
from keypose.analysis.ground import Ground
from keypose.analysis.roles import SIDES
from keypose.arrays import Floats

_GRAVITY = 9.81

# Parts of the body that may lie or sit on the ground, and how thick they are as shares of the leg's length.
_OTHER_SUPPORTS = {
    "hips": 0.2, "head": 0.25, "chest": 0.2,
    **{f"{s}_{r}": t for s in SIDES for r, t in (("hand", 0.1), ("lower_arm", 0.1), ("lower_leg", 0.12), ("upper_arm", 0.15))},
}  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class FeetTracks:
    """What feet do in every frame.

    Shapes and units: ``slide_cm_s`` side -> (T,) level speed of the point that carries, NaN in the air; ``sink_cm`` (T,) how deep
    the lowest point of a foot is under the ground; ``floats`` (T,) whether nothing carries the body and it does not fall.
    """

    footing: Footing
    slide_cm_s: Mapping[str, Floats]
    sink_cm: Floats
    floats: np.ndarray


def follow_feet(
    roles: Mapping[str, int],
    places: Floats,
    rate_hz: float,
    *,
    ground: Ground | None = None,
    touching: Mapping[str, np.ndarray] | None = None,
) -> FeetTracks | None:
    """What feet do in places (T, J, 3); None for a body without two legs.

    Where the ground is known, feet are taken to stand on it with their lowest points; contacts that are given are not looked for.
    """
    if not has_legs(roles):
        return None
    leg = leg_length(roles, places)
    footing = find_footing(roles, places, rate_hz, leg, ground="auto" if ground is None else ground)
    if touching is not None:
        footing = replace(footing, touching=dict(touching))
    slides = {side: _slide(side, footing) for side in SIDES}
    low = np.min([footing.heights(name) for name in footing.points], axis=0)
    return FeetTracks(footing, slides, -100.0 * np.minimum(low, 0.0), _floats(roles, places, footing, low, leg))


def carried_speeds(
    roles: Mapping[str, int], places: Floats, touching: Mapping[str, np.ndarray], rate_hz: float
) -> Floats:
    """Level speeds in cm/s (N,) of the points that carry: a foot's ball while it is down, else its heel.

    Only steps that begin and end in contact count; ``touching`` is that of `foot_contacts`.
    """
    points = foot_points(roles, places, touching)
    found = [_steps(side, points, touching, len(places), rate_hz) for side in SIDES]
    every = np.concatenate(found) if found else np.zeros(0)
    return every[np.isfinite(every)]


def _steps(
    side: str, points: Mapping[str, Floats], touching: Mapping[str, np.ndarray], frames: int, rate_hz: float
) -> Floats:
    """Level speed (T - 1,) of the point that carries through each step, NaN where none does."""
    none = np.zeros(frames, bool)
    ball, heel = touching.get(f"{side}_ball", none), touching.get(f"{side}_heel", none)
    found = np.full(max(frames - 1, 0), np.nan)
    for name, flag in ((f"{side}_ball", ball), (f"{side}_heel", heel & ~ball)):
        if name in points:
            step = np.diff(points[name], axis=0)
            carried = flag[1:] & flag[:-1]
            found[carried] = 100.0 * rate_hz * np.hypot(step[carried, 0], step[carried, 2])
    return found


def _slide(side: str, footing: Footing) -> Floats:
    frames = len(next(iter(footing.points.values())))
    steps = _steps(side, footing.points, footing.touching, frames, footing.rate_hz)
    return np.concatenate([steps, [np.nan]]) if frames else steps


def _floats(roles: Mapping[str, int], places: Floats, footing: Footing, low: Floats, leg: float) -> np.ndarray:
    """Frames (T,) in which nothing carries the body and it does not fall either."""
    nothing = np.zeros(len(places), bool)
    if len(places) < 5 or "hips" not in roles:
        return nothing
    for side, sole in footing.soles.items():
        # on its toes a foot stands on their tips
        ankle, ball = (places[:, roles[f"{side}_{part}"]] for part in ("foot", "toes"))
        tip = ball + sole.tip_offsets(ball - ankle)
        low = np.minimum(low, tip[:, 1] - footing.ground.heights(tip) - footing.stand_m[side])
    carried = np.any(list(footing.touching.values()), axis=0) | (low < 0.05 * leg)
    for role, thick in _OTHER_SUPPORTS.items():
        if role in roles:
            place = places[:, roles[role]]
            carried |= place[:, 1] - footing.ground.heights(place) < thick * leg
    trunk = places[:, [roles[r] for r in ("hips", "chest", "spine", "head") if r in roles], 1].mean(axis=1)
    # over a tenth of a second, or the noise of a capture hides what gravity does
    half = max(1, round(0.05 * footing.rate_hz))
    if len(trunk) <= 2 * half:
        return nothing
    fall = np.zeros(len(trunk))
    rate = footing.rate_hz / half
    fall[half:-half] = (trunk[2 * half :] - 2 * trunk[half:-half] + trunk[: -2 * half]) * rate**2
    inner = nothing.copy()
    inner[half:-half] = True
    return inner & ~carried & (fall > -0.4 * _GRAVITY)
