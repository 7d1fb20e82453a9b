"""Spaces that carry a control together: weights, matching, keys."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from keypose.errors import ShapeError, UnknownName
from keypose.math import quat
from keypose.model import Channel, Clip, Curve, CurveKind, Interpolation, Property
from keypose.rig import sample_rig, solve_rig, switch_space
from keypose.rig.baking import alone
from tests.rig.bodies import human, human_rig, moved, places, random_controls

RNG = np.random.default_rng


def test_spaces_mix_evenly_in_place_and_by_slerp_in_rotation() -> None:
    skeleton, rig = human().skeleton, human_rig()
    hand = rig.controls.index("hand_ik.L")
    moves = {
        "spine.1": ((0, 0, 0), (0.3, 0.9, 0.1)),
        "root": ((1.0, 0, 0.5), (0, 0.4, 0)),
        "neck_control": ((0,) * 3, (0, 1, 0)),
    }
    controls = moved(rig, moves)
    alone = {
        label: solve_rig(rig, skeleton, controls, {"hand_ik.L.space": float(n)}).model_from_control[hand]
        for n, label in enumerate(s.name for s in rig.control("hand_ik.L").spaces)
    }
    shares = np.linspace(0.0, 1.0, 11)
    steps = {"hand_ik.L.space.chest": shares, "hand_ik.L.space.head": 1.0 - shares}
    by_weights = solve_rig(rig, skeleton, controls, steps).model_from_control[:, hand]
    places = alone["head"][:3, 3] + shares[:, None] * (alone["chest"][:3, 3] - alone["head"][:3, 3])
    assert np.abs(by_weights[:, :3, 3] - places).max() < 1e-12
    whole = Rotation.from_matrix(np.stack([alone["head"][:3, :3], alone["chest"][:3, :3]]))
    assert np.degrees((whole[0].inv() * whole[1]).magnitude()) > 20
    expected = Slerp([0.0, 1.0], whole)(shares).as_matrix()
    assert np.abs(by_weights[:, :3, :3] - expected).max() < 1e-12
    # the space that is chosen has what the weights leave, and weights above 1 in all count by their shares
    rest = solve_rig(rig, skeleton, controls, {"hand_ik.L.space": 4.0, "hand_ik.L.space.chest": shares})
    assert np.abs(rest.model_from_control[:, hand] - by_weights).max() < 1e-12
    much = solve_rig(rig, skeleton, controls, {"hand_ik.L.space.chest": 1.0, "hand_ik.L.space.head": 1.0})
    assert np.abs(much.model_from_control[hand] - by_weights[5]).max() < 1e-12


def test_three_spaces_mix_without_a_jump_at_nothing() -> None:
    skeleton, rig = human().skeleton, human_rig()
    hand = rig.controls.index("hand_ik.L")
    controls = moved(rig, {"spine.1": ((0, 0, 0), (0.3, 0.9, 0.1)), "root": ((1, 0, 0), (0, 0.4, 0))})
    weights = {"hand_ik.L.space.chest": 0.3, "hand_ik.L.space.head": 0.2, "hand_ik.L.space.world": 0.5}
    three = solve_rig(rig, skeleton, controls, weights).model_from_control[hand]
    alone = [
        solve_rig(rig, skeleton, controls, {"hand_ik.L.space": float(n)}).model_from_control[hand, :3, 3]
        for n in range(5)
    ]
    assert np.abs(three[:3, 3] - (0.3 * alone[3] + 0.2 * alone[4] + 0.5 * alone[1])).max() < 1e-12
    nearly = solve_rig(rig, skeleton, controls, weights | {"hand_ik.L.space.pelvis": 1e-9}).model_from_control[hand]
    assert np.abs(three - nearly).max() < 1e-8


@pytest.mark.parametrize("before", [{"root": 1.0}, {"chest": 0.5, "world": 0.5}])
@pytest.mark.parametrize(
    "after", [{"chest": 0.5, "root": 0.5}, {"head": 0.2, "world": 0.5, "pelvis": 0.3}, {"chest": 3.0}]
)
def test_mixing_spaces_leaves_a_control_where_it_is(before: dict[str, float], after: dict[str, float]) -> None:
    skeleton, rig = human().skeleton, human_rig()
    values = {"arm.L.ik": 1.0, "spine.ik": 0.5}
    hand = rig.controls.index("hand_ik.L")
    first, given = switch_space(rig, skeleton, "hand_ik.L", before, random_controls(rig, RNG(11), (5,)), values)
    was = solve_rig(rig, skeleton, first, given)
    controls, changed = switch_space(rig, skeleton, "hand_ik.L", after, first, given)
    now = solve_rig(rig, skeleton, controls, changed)
    assert np.abs(was.model_from_control[:, hand] - now.model_from_control[:, hand]).max() < 1e-9
    assert np.abs(places(skeleton, was.pose) - places(skeleton, now.pose)).max() < 1e-9
    assert sum(float(changed[f"hand_ik.L.space.{label}"].max()) for label in after) == pytest.approx(
        1.0 if len(after) > 1 else 0.0
    )
    # and it is carried by them: chest and root alone do not agree with the mixture once the chest turns
    turned = quat.multiply(
        controls.rotations[:, rig.controls.index("spine.1")], quat.from_rotation_vector([0.0, 0.7, 0.0])
    )
    turns = np.array(controls.rotations)
    turns[:, rig.controls.index("spine.1")] = turned
    moved_hand = solve_rig(rig, skeleton, replace(controls, rotations=turns), changed).model_from_control[:, hand]
    steps = np.linalg.norm(moved_hand[:, :3, 3] - now.model_from_control[:, hand, :3, 3], axis=-1)
    assert steps.min() > 0.01


def test_weights_of_spaces_are_keyed() -> None:
    skeleton, rig = human().skeleton, human_rig()
    name = "hand_ik.L.space.chest"
    keys = {
        Channel(name, Property.VALUE): Curve([0.0, 1.0], [[0.0], [1.0]], Interpolation.LINEAR, kind=CurveKind.SCALAR)
    }
    spine = quat.multiply(
        rig.controls.rest.rotations[rig.controls.index("spine.1")], quat.from_rotation_vector([0.4, 0.8, 0])
    )
    keys[Channel("spine.1", Property.ROTATION)] = Curve([0.0], spine[None], kind=CurveKind.ROTATION)
    found = sample_rig(rig, skeleton, alone(Clip(keys, "c", 30.0)), {"c": Clip(keys, "c", 30.0)}, [0.0, 0.5, 1.0])
    hand = found.model_from_control[:, rig.controls.index("hand_ik.L"), :3, 3]
    assert np.linalg.norm(hand[2] - hand[0]) > 0.05
    assert np.abs(hand[1] - (hand[0] + hand[2]) / 2).max() < 1e-9
    assert found.values[name].tolist() == [0.0, 0.5, 1.0]


def test_weights_that_say_nothing_are_refused() -> None:
    skeleton, rig = human().skeleton, human_rig()
    with pytest.raises(ShapeError, match=r"expected a weight above 0"):
        switch_space(rig, skeleton, "hand_ik.L", {"chest": 0.0}, rig.controls.rest)
    bare = replace(rig, attributes=tuple(a for a in rig.attributes if ".space." not in a.name))
    with pytest.raises(UnknownName, match=r"hand_ik.L.space.chest"):
        switch_space(bare, skeleton, "hand_ik.L", {"chest": 0.5, "root": 0.5}, rig.controls.rest)
