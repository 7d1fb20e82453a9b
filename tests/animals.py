"""A dog's skeleton that no file holds: shoulder blades, paws with toes, ears, and a rest pose that stands."""

from __future__ import annotations

import numpy as np

from keypose.math import quat
from keypose.model import Pose, Skeleton

# name, parent, place (to the left, up, forward; metres)
_DOG: tuple[tuple[str, str, tuple[float, float, float]], ...] = (
    ("Base", "", (0, 0, 0)),
    ("Pelvis", "Base", (0, 0.55, -0.3)),
    ("Back1", "Pelvis", (0, 0.57, -0.15)),
    ("Back2", "Back1", (0, 0.58, 0.05)),
    ("Back3", "Back2", (0, 0.57, 0.25)),
    ("Throat1", "Back3", (0, 0.62, 0.36)),
    ("Throat2", "Throat1", (0, 0.7, 0.44)),
    ("Skull", "Throat2", (0, 0.78, 0.5)),
    ("Snout", "Skull", (0, 0.74, 0.62)),
    ("Tail1", "Pelvis", (0, 0.54, -0.4)),
    ("Tail2", "Tail1", (0, 0.5, -0.5)),
    ("Tail3", "Tail2", (0, 0.44, -0.58)),
    ("Tail4", "Tail3", (0, 0.4, -0.66)),
)
_SIDES: tuple[tuple[str, str, tuple[float, float, float]], ...] = (
    ("Blade", "Back3", (0.06, 0.6, 0.22)),
    ("Front1", "Blade", (0.1, 0.47, 0.3)),
    ("Front2", "Front1", (0.1, 0.3, 0.22)),
    ("Front3", "Front2", (0.1, 0.07, 0.24)),
    ("Front4", "Front3", (0.1, 0.01, 0.28)),
    ("Rear1", "Pelvis", (0.09, 0.5, -0.32)),
    ("Rear2", "Rear1", (0.1, 0.33, -0.24)),
    ("Rear3", "Rear2", (0.1, 0.17, -0.38)),
    ("Rear4", "Rear3", (0.1, 0.03, -0.34)),
    ("Rear5", "Rear4", (0.1, 0.0, -0.29)),
    ("Ear", "Skull", (0.05, 0.86, 0.46)),
)

ROLES = {
    "hips": "Pelvis", "spine": "Back1", "chest": "Back2", "upper_chest": "Back3", "neck": "Throat1", "head": "Skull",
    **{f"tail:{n}": f"Tail{n}" for n in (1, 2, 3, 4)},
    **{
        f"{side}_{role}": f"{name}{letter}"
        for side, letter in (("left", "L"), ("right", "R"))
        for role, name in (
            ("shoulder", "Blade"), ("upper_arm", "Front1"), ("lower_arm", "Front2"), ("hand", "Front3"),
            ("upper_leg", "Rear1"), ("lower_leg", "Rear2"), ("foot", "Rear3"), ("toes", "Rear4"),
        )
    },
}  # fmt: skip


def dog(*, turned: bool = False, facing_deg: float = 0.0) -> Skeleton:
    """The dog; ``turned`` gives every joint axes of its own, ``facing_deg`` turns it about the vertical."""
    rows = list(_DOG)
    for letter, sign in (("L", 1.0), ("R", -1.0)):
        own = {name for name, _, _ in _SIDES}
        rows += [
            (name + letter, parent + letter if parent in own else parent, (sign * x, y, z))
            for name, parent, (x, y, z) in _SIDES
        ]
    names = tuple(name for name, _, _ in rows)
    parents = np.array([names.index(parent) if parent else -1 for _, parent, _ in rows], np.int32)
    places = np.array([place for _, _, place in rows], np.float64)
    face = quat.from_axis_angle(np.array([0.0, 1.0, 0.0]), np.radians(facing_deg))
    places = quat.rotate(face, places)
    axes = np.random.default_rng(2).normal(size=(len(rows), 4)) if turned else np.tile([1.0, 0, 0, 0], (len(rows), 1))
    model = quat.normalize(axes)
    local, steps = np.array(model), np.array(places)
    for j, parent in enumerate(parents):
        if parent >= 0:
            back = quat.conjugate(model[parent])
            local[j], steps[j] = quat.multiply(back, model[j]), quat.rotate(back, places[j] - places[parent])
    return Skeleton(names, parents, Pose(steps, local, np.ones_like(places)))
