"""Props that are not placed on the target by hand stand as high over the ground there as in the source, scaled."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from keypose import samples
from keypose.evaluate import world_rotations_positions
from keypose.model import Motion, Skeleton
from keypose.retarget import HandOptions, Prop, retarget
from keypose.retarget.hands import prop_places


def lowered(skeleton: Skeleton, by_m: float) -> Skeleton:
    """The skeleton with its rest pose so much lower, as captures have it whose hips rest at the origin."""
    translations = np.array(skeleton.rest.translations)
    translations[np.asarray(skeleton.parents) < 0, 1] -= by_m
    return replace(skeleton, rest=replace(skeleton.rest, translations=translations))


@pytest.mark.parametrize("size", [0.8, 1.5])
def test_the_height_of_a_rest_pose_does_not_move_a_prop(size: float) -> None:
    walk = samples.load("walk")
    skeleton, motion = walk.character.skeleton, walk.animations[0]
    assert isinstance(motion, Motion)
    other = replace(skeleton, rest=replace(skeleton.rest, translations=size * np.asarray(skeleton.rest.translations)))
    places = np.asarray(world_rotations_positions(skeleton, motion.pose)[1], np.float64)
    hand = places[30, skeleton.names.index("LeftHand")]
    found = []
    for source in (skeleton, lowered(skeleton, 0.9)):
        done = retarget(motion, source, other, hands=HandOptions(props=[Prop(hand)]))
        here, there = prop_places(Prop(hand), done.source, places, done.target, size)
        np.testing.assert_allclose(here[0], hand)
        found.append((there[0], done.motion.pose.broadcast().rotations))
    np.testing.assert_allclose(found[1][0], found[0][0], atol=1e-6)
    np.testing.assert_allclose(found[1][1], found[0][1], atol=1e-5)
    np.testing.assert_allclose(found[0][0][[0, 2]], size * hand[[0, 2]], atol=1e-6)
    assert found[0][0][1] == pytest.approx(
        size * hand[1], abs=0.04 * size
    )  # the walk's ground is at 0 but for its soles
