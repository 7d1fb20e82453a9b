"""What the face shapes move, and the small tools they share."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from keypose.arrays import Floats
from keypose.samples.human_head import HeadMesh

FEATURES = ("skin", "brows", "eyes", "catchlights", "upper_teeth", "lower_teeth", "tongue")


@dataclass(frozen=True, slots=True, eq=False)
class Face:
    """What the shapes move, at rest: places (V, 3) by feature; eyes and brows hold the left half first, then the right."""

    head: HeadMesh
    jaw: Floats
    brows: Floats
    eyes: Floats
    catchlights: Floats
    upper_teeth: Floats
    lower_teeth: Floats
    tongue: Floats

    def zero(self) -> dict[str, Floats]:
        """No offset anywhere."""
        places = {name: getattr(self, name) for name in FEATURES[1:]}
        return {"skin": np.zeros_like(self.head.points)} | {n: np.zeros_like(p) for n, p in places.items()}


def turned(p: Floats, centre: Floats, axis: tuple[float, float, float], angle: float) -> Floats:
    """Offsets of a rotation by ``angle`` about a unit axis through ``centre``."""
    k = np.asarray(axis, np.float64)
    r = p - centre
    c, s = np.cos(angle), np.sin(angle)
    return r * c + np.cross(k, r) * s + k * (r @ k)[:, None] * (1 - c) - r


def skin_only(face: Face, skin: Floats) -> dict[str, Floats]:
    """Offsets of the skin alone."""
    out = face.zero()
    out["skin"] = skin
    return out
