"""The built-in human, posed."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from keypose.deform import deform_character
from keypose.evaluate import world
from keypose.math import quat
from keypose.model import Character, Pose
from keypose.samples.human import human
from keypose.samples.skeleton import bend_axis


@pytest.fixture(scope="session")
def character() -> Character:
    return human()


@pytest.fixture(scope="session")
def posed(character: Character) -> Callable[..., dict[str, np.ndarray]]:
    """Vertices by part with joints bent (degrees about their bend axes) or rotated (quaternions), and morphs set."""

    def pose(
        bends: dict[str, float] | None = None,
        rotations: dict[str, np.ndarray] | None = None,
        morphs: dict[str, float] | None = None,
    ) -> dict[str, np.ndarray]:
        skeleton = character.skeleton
        local = np.array(skeleton.rest.rotations)
        for name, degrees in (bends or {}).items():
            local[skeleton.index(name)] = quat.from_axis_angle(bend_axis(name), np.radians(degrees))
        for name, rotation in (rotations or {}).items():
            local[skeleton.index(name)] = rotation
        weights = np.zeros(len(character.morph_names), np.float32)
        for name, value in (morphs or {}).items():
            weights[character.morph_index(name)] = value
        model_from_joint = world(skeleton, Pose(skeleton.rest.translations, local, skeleton.rest.scales))
        vertices = deform_character(character, model_from_joint, weights)
        return {part.name: np.asarray(v) for part, v in zip(character.parts, vertices, strict=True)}

    return pose
