"""Constraints against closed forms, drivers against the numbers that they are made of, circles refused by name."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from keypose import evaluate
from keypose.errors import ShapeError, UnknownName
from keypose.math import euler, quat
from keypose.model import (
    Attribute,
    Channel,
    Constraint,
    ConstraintKind,
    Control,
    Curve,
    CurveKind,
    Driver,
    FollowModule,
    Interpolation,
    Pose,
    Property,
    Rig,
    Skeleton,
    Space,
)
from keypose.rig import check_rig, evaluate_rig, solve_rig
from tests.rig.bodies import human, human_rig, moved

KIND = ConstraintKind


def chain(count: int, prefix: str, step: float = 0.5) -> Skeleton:
    """A straight chain whose joints are turned at rest, each in its own way."""
    rng = np.random.default_rng(count)
    turns = quat.normalize(rng.normal(size=(count, 4)))
    places = np.tile([0.1, step, -0.2], (count, 1))
    return Skeleton(
        tuple(f"{prefix}{n}" for n in range(count)), np.arange(count) - 1, Pose(places, turns, np.ones((count, 3)))
    )


def flat_controls(names: tuple[str, ...]) -> Skeleton:
    """Controls side by side, each under none."""
    rng = np.random.default_rng(7)
    count = len(names)
    return Skeleton(
        names,
        np.full(count, -1),
        Pose(rng.normal(size=(count, 3)), quat.normalize(rng.normal(size=(count, 4))), np.ones((count, 3))),
    )


def small_rig(
    *constraints: Constraint, drivers: tuple[Driver, ...] = (), attributes: tuple[Attribute, ...] = ()
) -> Rig:
    controls = flat_controls(("a", "b", "c"))
    return Rig(
        "small",
        "",
        controls,
        tuple(Control(n) for n in controls.names),
        (Attribute("w", "a", 1.0), *attributes),
        (FollowModule("j", ("J0",), ("a",)),),
        constraints,
        drivers,
    )


SKELETON = chain(4, "J")


def solved(rig: Rig, moves=None, **values: float):
    return solve_rig(rig, SKELETON, moved(rig, moves or {}), values)


def rest_of(rig: Rig) -> np.ndarray:
    return evaluate.world(rig.controls, rig.controls.rest)


def rotation_of(m: np.ndarray) -> np.ndarray:
    return quat.from_matrix(m[..., :3, :3])


TURN = np.array([0.3, -0.8, 0.5])
MOVES = {"b": ((0.4, -0.3, 0.2), TURN), "c": ((-1.0, 0.5, 0.1), (0.2, 0.1, -0.9)), "a": ((0.1, 0.2, 0.3), (0.5, 0, 0))}


# ---- constraints -------------------------------------------------------------------------------------------------------


def test_every_constraint_that_keeps_its_offset_leaves_the_rest_pose_alone() -> None:
    for kind in (KIND.COPY_POSITION, KIND.COPY_ROTATION, KIND.COPY_SCALE, KIND.PARENT, KIND.AIM):
        rig = small_rig(Constraint("k", kind, "a", ("b", "c")))
        assert np.abs(solved(rig).model_from_control - rest_of(rig)).max() < 1e-12, kind
        rig = small_rig(Constraint("k", kind, "J2", ("b",)))
        assert np.abs(solved(rig).pose.rotations - SKELETON.rest.rotations).max() < 1e-9, kind


def test_copying_a_place() -> None:
    rig = small_rig(Constraint("k", KIND.COPY_POSITION, "a", ("b",), keep_offset=False))
    now = solved(rig, MOVES).model_from_control
    assert np.allclose(now[0, :3, 3], now[1, :3, 3])
    assert np.allclose(rotation_of(now[0]), rotation_of(solved(small_rig(), MOVES).model_from_control[0]))
    rig = small_rig(Constraint("k", KIND.COPY_POSITION, "a", ("b",)))
    now = solved(rig, MOVES).model_from_control
    assert np.allclose(now[0, :3, 3], now[1, :3, 3] + rest_of(rig)[0, :3, 3] - rest_of(rig)[1, :3, 3])
    rig = small_rig(Constraint("k", KIND.COPY_POSITION, "a", ("b",), keep_offset=False, axes=(True, False, True)))
    own, now = (solved(r, MOVES).model_from_control for r in (small_rig(), rig))
    assert np.allclose(now[0, :3, 3], [now[1, 0, 3], own[0, 1, 3], now[1, 2, 3]])


def test_shares_and_weights_mix_places() -> None:
    rig = small_rig(
        Constraint("k", KIND.COPY_POSITION, "a", ("b", "c"), (1.0, 3.0), 0.5, "w", keep_offset=False),
    )
    own = solved(small_rig(), MOVES).model_from_control
    for w in (0.0, 0.4, 1.0):
        now = solved(rig, MOVES, w=w).model_from_control
        wish = 0.25 * own[1, :3, 3] + 0.75 * own[2, :3, 3]
        assert np.allclose(now[0, :3, 3], own[0, :3, 3] + 0.5 * w * (wish - own[0, :3, 3]))


def test_copying_a_rotation_and_a_scale() -> None:
    rig = small_rig(Constraint("k", KIND.COPY_ROTATION, "a", ("b",), keep_offset=False, weight=0.25))
    own, now = (solved(r, MOVES).model_from_control for r in (small_rig(), rig))
    wish = quat.slerp(rotation_of(own[0]), rotation_of(own[1]), 0.25)
    assert quat.angle_between(rotation_of(now[0]), wish) < 1e-7
    assert np.allclose(now[0, :3, 3], own[0, :3, 3])
    rig = small_rig(Constraint("k", KIND.COPY_SCALE, "a", ("b",), axes=(True, True, False)))
    scales = np.array([[1.0, 1, 1], [2.0, 3.0, 4.0], [1, 1, 1]])
    rest = rig.controls.rest
    now = solve_rig(rig, SKELETON, Pose(rest.translations, rest.rotations, scales)).model_from_control[0]
    assert np.allclose(np.linalg.norm(now[:3, :3], axis=0), [2.0, 3.0, 1.0])


def test_a_child_of_others_goes_with_them_and_keeps_its_own_keys() -> None:
    rig = small_rig(Constraint("k", KIND.PARENT, "a", ("b",)))
    rest = rest_of(rig)
    free, now = (solved(r, MOVES).model_from_control for r in (small_rig(), rig))
    assert np.allclose(now[0], now[1] @ np.linalg.inv(rest[1]) @ free[0])


def test_an_aimed_axis_points_at_its_target() -> None:
    axis, up_axis = np.array([0.0, 0.0, 1.0]), (0.0, 1.0, 0.0)
    rig = small_rig(Constraint("k", KIND.AIM, "a", ("b",), keep_offset=False, aim_axis=(0, 0, 1)))
    own, now = (solved(r, MOVES).model_from_control for r in (small_rig(), rig))
    wish = now[1, :3, 3] - now[0, :3, 3]
    assert np.allclose(now[0, :3, :3] @ axis, wish / np.linalg.norm(wish))
    short = quat.from_two_vectors(own[0, :3, :3] @ axis, wish)
    assert quat.angle_between(rotation_of(now[0]), quat.multiply(short, rotation_of(own[0]))) < 1e-7
    rig = small_rig(Constraint("k", KIND.AIM, "a", ("b",), keep_offset=False, aim_axis=(0, 0, 1), up_axis=up_axis))
    now = solved(rig, MOVES).model_from_control
    assert quat.angle_between(rotation_of(now[0]), quat.look_rotation(now[1, :3, 3] - now[0, :3, 3])) < 1e-7


def test_limits_hold_and_leave_alone_what_is_inside() -> None:
    low, high = (-0.1, -0.2, -0.3), (0.1, 0.2, 0.3)
    rig = small_rig(Constraint("k", KIND.LIMIT_ROTATION, "a", low=low, high=high))
    assert np.array_equal(solved(rig).model_from_control, solved(small_rig()).model_from_control)
    rest = rig.controls.rest.rotations[0]
    angles = np.array([0.5, 0.15, -0.9])
    rotations = np.array(rig.controls.rest.rotations)
    rotations[0] = quat.multiply(rest, euler.to_quat(angles, "XYZ"))
    now = solve_rig(rig, SKELETON, replace(rig.controls.rest, rotations=rotations)).model_from_control[0]
    assert np.allclose(euler.from_quat(quat.multiply(quat.conjugate(rest), rotation_of(now)), "XYZ"), [0.1, 0.15, -0.3])
    rig = small_rig(Constraint("k", KIND.LIMIT_POSITION, "a", axes=(False, True, False), low=(0, 0, 0), high=(0, 0, 0)))
    own, now = (solved(r, MOVES).model_from_control for r in (small_rig(), rig))
    assert np.allclose(now[0, :3, 3], own[0, :3, 3] * [1, 0, 1])
    rig = small_rig(Constraint("k", KIND.LIMIT_SCALE, "a", low=(0.5, 0.5, 0.5), high=(2, 2, 2)))
    scales = np.array([[0.1, 1.0, 9.0], [1, 1, 1], [1, 1, 1]])
    rest_pose = rig.controls.rest
    now = solve_rig(rig, SKELETON, Pose(rest_pose.translations, rest_pose.rotations, scales)).model_from_control[0]
    assert np.allclose(np.linalg.norm(now[:3, :3], axis=0), [0.5, 1.0, 2.0])


def test_what_hangs_on_a_constrained_joint_follows() -> None:
    rig = small_rig(Constraint("k", KIND.COPY_POSITION, "J2", ("b",), keep_offset=False))
    found = solved(rig, MOVES)
    now, free = evaluate.world(SKELETON, found.pose), evaluate.world(SKELETON, solved(small_rig(), MOVES).pose)
    assert np.allclose(now[2, :3, 3], found.model_from_control[1, :3, 3])
    assert np.allclose(np.linalg.inv(now[2]) @ now[3], np.linalg.inv(free[2]) @ free[3])
    assert np.allclose(now[:2], free[:2])


def test_controls_that_their_module_places_can_be_held_too() -> None:
    skeleton = human().skeleton
    for control, moves in (
        ("index.2.L", {"index.2.L": ((0, 0, 0), (1.5, 0, 0))}),
        ("toes.L", {"toes.L": ((0, 0, 0), (1.5, 0, 0))}),
    ):
        limit = Constraint("k", KIND.LIMIT_ROTATION, control, low=(-0.5, -0.5, -0.5), high=(0.5, 0.5, 0.5))
        held = replace(human_rig(), constraints=(limit,))
        n = held.controls.index(control)
        free, now = (solve_rig(r, skeleton, moved(r, moves)).model_from_control[n] for r in (human_rig(), held))
        assert quat.angle_between(rotation_of(free), rotation_of(now)) == pytest.approx(1.0, abs=1e-6)


def test_constraints_in_batches_are_those_one_by_one() -> None:
    kinds = (KIND.PARENT, KIND.AIM, KIND.COPY_ROTATION, KIND.LIMIT_ROTATION)
    held = [
        Constraint(k.value, k, "a" if n else "J3", () if k is KIND.LIMIT_ROTATION else ("b", "c"), low=(0, 0, 0))
        for n, k in enumerate(kinds)
    ]
    rig = small_rig(*held)
    rng = np.random.default_rng(3)
    rest = rig.controls.rest
    many = Pose(rest.translations + rng.normal(size=(6, 3, 3)), quat.normalize(rng.normal(size=(6, 3, 4))), rest.scales)
    whole = solve_rig(rig, SKELETON, many)
    for n in range(6):
        assert np.abs(solve_rig(rig, SKELETON, many[n]).pose.rotations - whole.pose.rotations[n]).max() < 1e-9


# ---- drivers -----------------------------------------------------------------------------------------------------------


def test_a_driver_moves_a_control_by_what_others_do() -> None:
    drivers = (
        Driver(Channel("b", Property.TRANSLATION, 1), "2 * a.translation.x + w"),
        Driver(Channel("b", Property.EULER, 2), "a.rotation.x * 0.5"),
    )
    rig = small_rig(drivers=drivers)
    free, now = (solved(r, {"a": ((0.3, 0, 0), (0.4, 0, 0))}, w=0.25) for r in (small_rig(), rig))
    local = np.linalg.inv(now.model_from_frame[1]) @ now.model_from_control[1]
    before = np.linalg.inv(free.model_from_frame[1]) @ free.model_from_control[1]
    assert np.allclose(local[:3, 3], before[:3, 3] + [0, 0.85, 0])
    turned = quat.multiply(rotation_of(before), quat.from_axis_angle([0.0, 0, 1.0], 0.2))
    assert quat.angle_between(rotation_of(local), turned) < 1e-7


def test_driven_keys_look_up_a_curve() -> None:
    curve = Curve([0.0, 1.0], [[0.0], [10.0]], Interpolation.LINEAR, kind=CurveKind.SCALAR)
    rig = small_rig(
        attributes=(Attribute("x", "a", 0, -9, 9), Attribute("y", "a", 0, -99, 99)),
        drivers=(Driver(Channel("y", Property.VALUE), "x / 2", curve),),
    )
    assert solve_rig(rig, SKELETON, None, {"x": np.array([-1.0, 0.5, 1.0, 9.0])}).values["y"].tolist() == [
        0,
        2.5,
        5,
        10,
    ]


def test_drivers_run_after_what_they_read_in_whatever_order_they_stand() -> None:
    attributes = tuple(Attribute(n, "a", 0, -99, 99) for n in "pqr")
    drivers = tuple(Driver(Channel(n, Property.VALUE), e) for n, e in (("r", "q + 1"), ("q", "p * 2"), ("p", "w + 3")))
    assert float(solved(small_rig(attributes=attributes, drivers=drivers), w=1.0).values["r"]) == 9.0


def test_a_circle_of_drivers_is_spelled_out() -> None:
    attributes = tuple(Attribute(n, "a") for n in "pq")
    drivers = tuple(Driver(Channel(n, Property.VALUE), e) for n, e in (("p", "q"), ("q", "p + 1")))
    with pytest.raises(ShapeError, match=r"in a circle: driver of \w\.value -> driver of \w\.value -> driver of"):
        check_rig(small_rig(attributes=attributes, drivers=drivers), SKELETON)


def test_a_morph_and_a_twist_joint_are_driven_by_joints() -> None:
    drivers = (
        Driver(Channel("smile", Property.WEIGHT), "clamp({J1}.rotation.x, 0, 1)"),
        Driver(Channel("J3", Property.EULER, 1), "0.5 * J2.twist.y"),
    )
    rig = small_rig(drivers=drivers)
    turns = np.array(SKELETON.rest.rotations)
    turns[1] = quat.multiply(turns[1], quat.from_axis_angle([1.0, 0, 0], 0.6))
    turns[2] = quat.multiply(turns[2], quat.from_axis_angle([0, 1.0, 0], -1.2))
    base = Pose(SKELETON.rest.translations, turns, SKELETON.rest.scales)
    found = solve_rig(rig, SKELETON, None, None, base)
    assert float(found.values["smile"]) == pytest.approx(0.6)
    wanted = quat.multiply(turns[3], quat.from_axis_angle([0, 1.0, 0], -0.6))
    assert quat.angle_between(found.pose.rotations[3], wanted) < 1e-7


def test_what_reads_joints_cannot_move_controls() -> None:
    attributes = (Attribute("p", "a"),)
    for channel in (Channel("p", Property.VALUE), Channel("b", Property.TRANSLATION, 0)):
        rig = small_rig(attributes=attributes, drivers=(Driver(channel, "J1.rotation.x"),))
        with pytest.raises(ShapeError, match="can drive joints and morphs"):
            check_rig(rig, SKELETON)


def test_a_driver_without_a_value_leaves_its_attribute_where_it_is() -> None:
    rig = small_rig(attributes=(Attribute("p", "a", 0.75),), drivers=(Driver(Channel("p", Property.VALUE), "1 / w"),))
    values = solve_rig(rig, SKELETON, None, {"w": np.array([0.0, 1.0])}).values["p"]
    assert values.tolist() == [0.75, 1.0]


# ---- what is refused ---------------------------------------------------------------------------------------------------


def test_circles_of_controls_and_constraints_are_refused_by_name() -> None:
    rig = small_rig(Constraint("k", KIND.PARENT, "a", ("b",)), Constraint("l", KIND.PARENT, "b", ("c",)))
    check_rig(rig, SKELETON)
    rig = replace(rig, constraints=(*rig.constraints, Constraint("m", KIND.AIM, "c", ("a",))))
    with pytest.raises(ShapeError, match="in a circle: control 'a' -> control 'b' -> control 'c' -> control 'a'"):
        check_rig(rig, SKELETON)
    rig = small_rig(Constraint("k", KIND.COPY_POSITION, "a", ("J3",)))
    with pytest.raises(ShapeError, match=r"circle: .*control 'a' -> module 'j'|module 'j' -> control 'a'"):
        check_rig(rig, SKELETON)
    looks = list(rig.looks)
    looks[1] = replace(looks[1], spaces=(Space("c", "c"),))
    looks[2] = replace(looks[2], spaces=(Space("b", "b"),))
    with pytest.raises(ShapeError, match="circle"):
        check_rig(replace(small_rig(), looks=tuple(looks)), SKELETON)


def test_names_that_are_not_there_are_named() -> None:
    with pytest.raises(UnknownName, match="no control or joint 'bb'"):
        check_rig(small_rig(Constraint("k", KIND.PARENT, "a", ("bb",))), SKELETON)
    with pytest.raises(UnknownName, match="no joint 'J0'"):
        check_rig(small_rig(), chain(2, "K"))
    with pytest.raises(UnknownName, match=r"attribute .driver of w.value. 'wv'; nearest: 'w'"):
        check_rig(small_rig(drivers=(Driver(Channel("w", Property.VALUE), "wv"),)), SKELETON)
    with pytest.raises(ShapeError, match=r"driver of w.value: expression"):
        check_rig(small_rig(drivers=(Driver(Channel("w", Property.VALUE), "1 +"),)), SKELETON)
    with pytest.raises(ShapeError, match="control 'J1' has the name of a joint"):
        controls = flat_controls(("a", "J1"))
        check_rig(
            Rig(
                "r",
                "",
                controls,
                tuple(Control(n) for n in controls.names),
                modules=(FollowModule("j", ("J0",), ("a",)),),
            ),
            SKELETON,
        )


@pytest.mark.parametrize(
    ("make", "what"),
    [
        (lambda: Constraint("k", KIND.PARENT, "a"), "at least one target"),
        (lambda: Constraint("k", KIND.LIMIT_SCALE, "a", ("b",)), "has no targets"),
        (lambda: Constraint("k", KIND.PARENT, "a", ("b",), (1.0, 2.0)), "a share of 0 or more for each of 1"),
        (lambda: Constraint("k", KIND.PARENT, "a", ("b",), weight=2.0), "weight of 0..1"),
        (lambda: Constraint("k", KIND.LIMIT_POSITION, "a", low=(1, 0, 0), high=(0, 0, 0)), "low at most high"),
        (lambda: Constraint("k", KIND.AIM, "a", ("b",), aim_axis=(0, 0, 0)), "no direction"),
        (lambda: Driver(Channel("a", Property.ROTATION), "1"), "one component of a translation or of angles"),
        (lambda: Driver(Channel("a", Property.EULER), "1"), "one component"),
        (lambda: Attribute("a", "b", 2.0), "a default of 0.0..1.0"),
        (lambda: Control("a", size_m=0), "a size above 0"),
        (lambda: Control("a", spaces=(Space("x"), Space("x", "b"))), "space 'x' is there twice"),
        (lambda: FollowModule("m", ("a",), ()), "as many joints and controls"),
        (lambda: replace(human_rig(), looks=human_rig().looks[1:]), "the look of each control"),
        (lambda: replace(human_rig(), modules=(*human_rig().modules, FollowModule("x", ("Hips",), ("root",)))), "joint 'Hips' is there twice"),
        (lambda: replace(human_rig(), attributes=(*human_rig().attributes, Attribute("arm.L.ik", "root"))), "attribute 'arm.L.ik' is there twice"),
    ],
)  # fmt: skip
def test_data_that_cannot_be_is_refused(make, what: str) -> None:
    with pytest.raises(ShapeError, match=what):
        make()


def test_a_constraint_on_a_joint_of_the_human_holds() -> None:
    rig = replace(
        human_rig(), constraints=(Constraint("k", KIND.COPY_ROTATION, "RightHand", ("LeftHand",), keep_offset=False),)
    )
    skeleton = human().skeleton
    pose = evaluate_rig(rig, skeleton, moved(rig, {"hand.L": ((0, 0, 0), (0.4, 0.2, 0.1))}))
    turned = evaluate.world_rotations_positions(skeleton, pose)[0]
    assert quat.angle_between(turned[skeleton.index("RightHand")], turned[skeleton.index("LeftHand")]) < 1e-7
