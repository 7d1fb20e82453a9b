"""Legs that reach their planted feet: knees and hips turned."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from keypose.arrays import Floats
from keypose.editing.planting_paths import FootPath, norms
from keypose.evaluate import world_rotations_positions
from keypose.math import quat
from keypose.model import Skeleton


@dataclass(frozen=True, slots=True, eq=False)
class Leg:
    """One leg of a motion.

    Shapes and units: joints ``upper``, ``lower``, ``foot``; places (T, 3) of ``hip``, ``knee``, ``ankle`` in metres; ``bend`` (T, 3)
    unit, across the leg, the way the knee goes.
    """

    upper: int
    lower: int
    foot: int
    hip: Floats
    knee: Floats
    ankle: Floats
    bend: Floats

    @property
    def length(self) -> Floats:
        """Of both bones together (T,)."""
        return norms(self.knee - self.hip) + norms(self.ankle - self.knee)


def find_leg(side: str, roles: Mapping[str, int], skeleton: Skeleton, turned: Floats, places: Floats) -> Leg:
    """The leg of a side: ``turned`` (T, J, 4) and ``places`` (T, J, 3) in the model."""
    upper, lower, foot = (roles[f"{side}_{part}"] for part in ("upper_leg", "lower_leg", "foot"))
    hip, knee, ankle = places[:, upper], places[:, lower], places[:, foot]
    pole = _pole(hip, knee, ankle, turned[:, upper], _forward(skeleton, upper, lower, foot))
    line = ankle - hip
    along = line / np.maximum(norms(line), 1e-12)[:, None]
    pole = pole - along * np.sum(pole * along, axis=-1, keepdims=True)
    return Leg(upper, lower, foot, hip, knee, ankle, pole / np.maximum(norms(pole), 1e-12)[:, None])


def knee_angles(leg: Leg) -> Floats:
    """How far the knee is bent in every frame (T,), radians."""
    thigh, shank = leg.knee - leg.hip, leg.ankle - leg.knee
    return np.arctan2(norms(np.cross(thigh, shank)), np.sum(thigh * shank, axis=-1))


def reached_angles(leg: Leg, distance: Floats) -> Floats:
    """How far the knee is bent (T,) where the ankle is so far from the hip."""
    a, b = norms(leg.knee - leg.hip), norms(leg.ankle - leg.knee)
    return np.arccos(np.clip((distance**2 - a * a - b * b) / np.maximum(2.0 * a * b, 1e-12), -1.0, 1.0))


def bend_leg(
    leg: Leg, skeleton: Skeleton, turned: Floats, hips: Floats, path: FootPath, rotations: Floats, carries: bool
) -> Floats:
    """Turn a leg's joints (in ``rotations`` (T, J, 4), changed in place) so that its foot follows its path; the distance left (T,).

    The knee turns about its hinge until the ankle is as far from the hip as wanted, then the whole leg swings over. What needs
    no change is not changed. ``carries``: the foot's joint hangs on the leg and turns with it.
    """
    thigh, shank = leg.knee - leg.hip, leg.ankle - leg.knee
    line = leg.ankle - leg.hip
    wanted = leg.ankle + path.shift - leg.hip - hips
    along = line / np.maximum(norms(line), 1e-12)[:, None]
    hinge = np.cross(leg.bend, along)  # turning about it bends the knee
    hinge /= np.maximum(norms(hinge), 1e-12)[:, None]
    a, b = norms(thigh), norms(shank)
    reach = np.clip(norms(wanted), np.abs(a - b), a + b)
    # thigh . turned shank = across + size cos(angle - start), as the part along the hinge does not turn
    across = np.sum(thigh * hinge, axis=-1) * np.sum(shank * hinge, axis=-1)
    cosine = np.sum(thigh * shank, axis=-1) - across
    sine = np.sum(thigh * np.cross(hinge, shank), axis=-1)
    start = np.arctan2(sine, cosine)
    size = np.maximum(np.hypot(cosine, sine), 1e-12)
    angle = start + np.arccos(np.clip(((reach**2 - a * a - b * b) / 2.0 - across) / size, -1.0, 1.0))
    bend = quat.from_axis_angle(hinge, angle)
    reached = thigh + quat.rotate(bend, shank)
    swing = quat.from_two_vectors(reached, wanted)
    whole = quat.multiply(swing, bend)
    parents = skeleton.parents
    above = int(parents[leg.upper])
    new_upper = quat.multiply(swing, turned[:, leg.upper])
    rotations[:, leg.upper] = new_upper if above < 0 else quat.multiply(quat.conjugate(turned[:, above]), new_upper)
    over_knee = quat.multiply(swing, turned[:, int(parents[leg.lower])])
    rotations[:, leg.lower] = quat.multiply(quat.conjugate(over_knee), quat.multiply(whole, turned[:, leg.lower]))
    over_foot = turned[:, int(parents[leg.foot])]
    if carries:
        over_foot = quat.multiply(whole, over_foot)
    rotations[:, leg.foot] = quat.multiply(quat.conjugate(over_foot), quat.multiply(path.turn, turned[:, leg.foot]))
    return norms(wanted - quat.rotate(swing, reached))


def _forward(skeleton: Skeleton, upper: int, lower: int, foot: int) -> Floats:
    """Where the knee bends, in the upper joint's axes: across the leg at rest, forwards."""
    turned, places = (np.asarray(a, np.float64) for a in world_rotations_positions(skeleton, skeleton.rest))
    line = places[foot] - places[upper]
    along = line / max(float(np.linalg.norm(line)), 1e-12)
    bend = places[lower] - places[upper]
    bend = bend - along * float(bend @ along)
    if float(np.linalg.norm(bend)) < 1e-3 * float(np.linalg.norm(line)):
        bend = np.array([0.0, 0.0, 1.0]) - along * float(along[2])
    return quat.rotate(quat.conjugate(turned[upper]), bend / max(float(np.linalg.norm(bend)), 1e-12))


def _pole(hip: Floats, knee: Floats, ankle: Floats, turned: Floats, forward: Floats) -> Floats:
    """Where the knee is, across the leg; a leg that is nearly straight takes the way it bends at rest (T, 3)."""
    line = ankle - hip
    along = line / np.maximum(norms(line), 1e-12)[:, None]
    out = (knee - hip) - along * np.sum((knee - hip) * along, axis=-1, keepdims=True)
    bent = norms(out)[:, None]
    limit = 0.03 * norms(knee - hip)[:, None]
    share = np.clip(1.0 - bent / limit, 0.0, 1.0)
    return out + share * limit * quat.rotate(turned, np.broadcast_to(forward, hip.shape))
