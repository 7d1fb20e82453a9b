"""Where a foot touches the ground: heel, ball, tip and edges, from the joints and, where there is one, the surface."""

from __future__ import annotations

import numpy as np

from keypose.arrays import Floats
from keypose.model import FootPivots
from keypose.rig.body import Body


def foot_pivots(
    body: Body, side: str, name: str, toes_control: str, end_role: str = "foot", toes_role: str = "toes"
) -> FootPivots:
    """The pivots of a foot, or of the hand of an animal on all fours, at rest, on the ground under it."""
    up, heading = body.up, body.heading(side, end_role, toes_role)
    across = np.cross(up, heading)
    ankle = body.places[body.roles[f"{side}_{end_role}"]]
    toes = body.roles.get(f"{side}_{toes_role}")
    length = body.foot_m
    ball = body.places[toes] if toes is not None else ankle + 0.5 * length * heading
    end = None if toes is None else body.tip(toes)
    forward = float((ball - ankle) @ heading)
    tip = max(forward + 0.3 * length, float((end - ankle) @ heading) if end is not None else 0.0)
    heel, low = -0.22 * length, body.ground_m
    width = (-0.2 * length, 0.2 * length)
    sole = _sole(body, body.roles[f"{side}_{end_role}"])
    if sole is not None:
        ahead, beside = (sole - ankle) @ heading, (sole - ball) @ across
        heel, tip, low = float(ahead.min()), float(ahead.max()), float((sole @ up).min())
        width = (float(beside.min()), float(beside.max()))

    def on_ground(place: Floats) -> tuple[float, float, float]:
        at = place + up * (low - float(place @ up))
        return float(at[0]), float(at[1]), float(at[2])

    return FootPivots(
        name,
        on_ground(ankle + heel * heading),
        on_ground(ball),
        on_ground(ankle + tip * heading),
        on_ground(ball + width[1] * across),
        on_ground(ball + width[0] * across),
        "" if toes is None else body.skeleton.names[toes],
        toes_control,
    )


def _sole(body: Body, foot: int) -> Floats | None:
    """The vertices (V, 3) that move most with a foot and lie near the ground."""
    if body.surface is None:
        return None
    from keypose import deform, evaluate

    character = body.surface
    mine = {foot}
    for joint, parent in enumerate(body.parents):
        if parent in mine:
            mine.add(joint)
    standing = deform.deform_character(character, evaluate.world(character.skeleton, character.skeleton.rest))
    found: list[Floats] = []
    for part, vertices in zip(character.parts, standing, strict=True):
        if part.skin is None:
            continue
        own = np.isin(part.skin.palette, list(mine))[part.skin.joints]
        held = np.sum(np.where(own, part.skin.weights, 0.0), axis=-1) > 0.5
        found.append(np.asarray(vertices, np.float64)[held])
    vertices = np.concatenate(found) if found else np.zeros((0, 3))
    if len(vertices) < 8:
        return None
    height = vertices @ body.up
    return vertices[height < height.min() + 0.25 * body.foot_m]
