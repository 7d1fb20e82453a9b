"""The central types: what they refuse and how they say it, frozen copies, precision, batch shapes."""

from __future__ import annotations

import pickle
import subprocess
import sys
from dataclasses import FrozenInstanceError, replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import keypose.model as model
from keypose.errors import FormatError, KeyposeError, MissingExtra, ShapeError, UnknownName
from keypose.model import (
    Channel,
    Character,
    Clip,
    Curve,
    CurveKind,
    Interpolation,
    Material,
    Mesh,
    MorphSet,
    Motion,
    Part,
    Pose,
    Property,
    Scene,
    Skeleton,
    Skin,
)
from tests.synthetic import random_mesh, random_pose, random_rotations, random_skeleton, random_skin


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(31)


def test_the_public_names() -> None:
    assert sorted(model.__all__) == [
        "Attribute", "Channel", "Character", "Clip", "Constraint", "ConstraintKind", "Control", "ControlShape", "ControlSide",
        "Curve", "CurveKind", "Document", "Driver", "EULER_ORDER", "Event", "Extrapolation", "EyesModule", "Finger",
        "FingersModule", "FollowModule", "FootPivots", "ForcePlate", "HeadModule", "Image", "Interpolation", "Layer", "LayerMode",
        "LimbModule", "Marker", "Markers", "Material", "Mesh", "Module", "MorphSet", "Motion", "Part", "Placement", "Pose",
        "Property", "ROTATION_ONLY", "Rig", "Scene", "Signals", "Skeleton", "Skin", "SkinningMethod", "Space", "SpineModule",
        "StoredPose", "Tangent", "Tier", "Timeline", "Twist", "TwistModule", "module_controls", "module_joints",
    ]  # fmt: skip
    assert all(hasattr(model, name) for name in model.__all__)


def test_importing_the_model_loads_no_heavy_library() -> None:
    script = "import sys, keypose.model, keypose.evaluate, keypose.deform, keypose.analysis; print(*sys.modules)"
    loaded = set(
        subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout.split()
    )
    assert not loaded & {"numba", "scipy", "moderngl", "av", "PIL", "starlette", "torch", "jax"}


# --- arrays are frozen ------------------------------------------------------------------------------------------------


def test_arrays_are_read_only_copies(rng: np.random.Generator) -> None:
    rotations = random_rotations(rng, 3)
    pose = Pose(np.zeros((3, 3)), rotations, np.ones((3, 3)))
    rotations[:] = 0
    assert_allclose(np.linalg.norm(pose.rotations, axis=-1), 1)
    mesh, skin = random_mesh(rng, 6), random_skin(rng, random_skeleton(rng, 4), 6, 2)
    curve = Curve([0.0, 1.0], [[0.0], [1.0]])
    for array in (
        pose.rotations,
        mesh.positions,
        mesh.triangles,
        skin.weights,
        skin.joints,
        curve.times_s,
        curve.values,
    ):
        assert not array.flags.writeable
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0


def test_fields_cannot_be_set_and_replace_makes_a_new_value(rng: np.random.Generator) -> None:
    skeleton = random_skeleton(rng, 3)
    with pytest.raises(FrozenInstanceError):
        skeleton.names = ("a",)  # type: ignore[misc]
    renamed = replace(skeleton, names=("a", "b", "c"))
    assert renamed.names == ("a", "b", "c")
    assert skeleton.names == ("joint0", "joint1", "joint2")
    assert renamed.parents is skeleton.parents  # frozen arrays are shared, not copied again


def test_mappings_cannot_be_changed() -> None:
    clip = Clip({Channel("a", Property.SCALE): Curve([0.0], [[1.0, 1, 1]])})
    with pytest.raises(TypeError):
        clip.curves[Channel("b", Property.SCALE)] = clip.curve("a", Property.SCALE)  # type: ignore[index]


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_precision_is_kept_and_integers_become_float64(dtype: type) -> None:
    pose = Pose(np.zeros((2, 3), dtype), np.ones((2, 4), dtype), np.ones((2, 3), dtype))
    assert pose.translations.dtype == pose.rotations.dtype == pose.scales.dtype == dtype
    assert Mesh(np.zeros((3, 3), dtype), [[0, 1, 2]]).positions.dtype == dtype
    assert Curve([0, 1], np.zeros((2, 1), dtype)).values.dtype == dtype
    assert Curve([0, 1], [[1], [2]]).values.dtype == np.float64
    assert Curve(np.float32([0, 1]), [[1], [2]]).times_s.dtype == np.float64


# --- skeletons --------------------------------------------------------------------------------------------------------


def rest(joints: int) -> Pose:
    return Pose(np.zeros((joints, 3)), np.tile([1.0, 0, 0, 0], (joints, 1)), np.ones((joints, 3)))


@pytest.mark.parametrize(
    ("names", "parents", "pose", "message"),
    [
        (("a", "b"), [-1], rest(2), r"parents: expected \(2,\) to match the names, got \(1,\)"),
        (("a", "b"), [-1, 0], rest(3), "rest: expected one pose of 2 joints"),
        (("a", "b", "a"), [-1, 0, 1], rest(3), "names: joint 'a' appears more than once"),
        (("a", "b"), [-1, 1], rest(2), "joint 1 'b' has parent 1; a parent must come before its child"),
        (("a", "b"), [1, -1], rest(2), "joint 0 'a' has parent 1"),
        (("a", "b"), [-1, -2], rest(2), "joint 1 'b' has parent -2"),
    ],
)
def test_malformed_skeletons_are_refused(names: Any, parents: Any, pose: Pose, message: str) -> None:
    with pytest.raises(ShapeError, match=message):
        Skeleton(names, parents, pose)


def test_a_skeletons_tree() -> None:
    tree = Skeleton(("hips", "spine", "leg", "head", "prop"), [-1, 0, 0, 1, -1], rest(5))
    assert tree.joint_count == 5
    assert tree.index("head") == 3 == tree.index(3)
    for number in (-1, 5):
        with pytest.raises(ShapeError, match=f"joint: expected 0 to 4, got {number}"):
            tree.index(number)
    assert tree.indices(["leg", "hips"]) == [2, 0]
    assert tree.children(0) == [1, 2]
    assert_array_equal(tree.depths(), [0, 1, 1, 2, 0])
    for ask in (lambda: tree.index("haed"), lambda: tree.indices(["hips", "haed"])):
        with pytest.raises(UnknownName, match="no joint 'haed'; nearest: 'head'"):
            ask()


def test_an_empty_skeleton_is_allowed() -> None:
    assert Skeleton((), np.zeros(0, int), rest(0)).joint_count == 0


# --- poses and motions ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("shapes", "message"),
    [
        (((2, 3), (2, 3), (2, 3)), r"rotations: expected \(\*B, J, 4\), got \(2, 3\)"),
        (((3, 3), (2, 4), (2, 3)), r"translations: expected \(\*B, 2, 3\) to match rotations \(2, 4\), got \(3, 3\)"),
        (((2, 3), (2, 4), (2, 4)), "scales: expected"),
        (((5, 2, 3), (4, 2, 4), (2, 3)), "do not broadcast"),
    ],
)
def test_malformed_poses_are_refused(shapes: Any, message: str) -> None:
    with pytest.raises(ShapeError, match=message):
        Pose(*(np.zeros(s) for s in shapes))


def test_poses_broadcast_and_are_indexed_by_batch(rng: np.random.Generator) -> None:
    pose = Pose(rng.normal(size=(4, 3)), random_rotations(rng, 6, 2, 4), np.ones((2, 4, 3)))
    assert pose.batch_shape == (6, 2)
    assert pose.joint_count == 4
    full = pose.broadcast()
    assert [a.shape for a in (full.translations, full.rotations, full.scales)] == [
        (6, 2, 4, 3),
        (6, 2, 4, 4),
        (6, 2, 4, 3),
    ]
    assert_array_equal(full.translations[5, 1], pose.translations)
    assert pose[1].batch_shape == (2,)
    assert pose[2:5, 1].batch_shape == (3,)
    assert_array_equal(pose[3, 0].rotations, pose.rotations[3, 0])


def test_motions_count_frames_and_time(rng: np.random.Generator) -> None:
    motion = Motion(("a", "b"), random_pose(rng, (13,), 2), 24, start_s=0.5)
    assert motion.frame_count == 13
    assert motion.duration_s == 0.5
    assert_allclose(motion.times_s, 0.5 + np.arange(13) / 24)
    assert motion.with_pose(motion.pose[:5]).frame_count == 5


def test_malformed_motions_are_refused(rng: np.random.Generator) -> None:
    pose = random_pose(rng, (5,), 2)
    with pytest.raises(ShapeError, match="3 joint names for a pose of 2 joints"):
        Motion(("a", "b", "c"), pose, 30)
    with pytest.raises(ShapeError, match=r"batch shape \(T,\), got \(\)"):
        Motion(("a", "b"), pose[0], 30)
    for rate in (0, -30, np.nan, np.inf):
        with pytest.raises(ShapeError, match="rate_hz: expected a positive number"):
            Motion(("a", "b"), pose, rate)
    with pytest.raises(ShapeError, match="1 morph names without morph weights"):
        Motion(("a", "b"), pose, 30, morph_names=("smile",))
    with pytest.raises(ShapeError, match=r"morph_weights: expected \(5, 1\)"):
        Motion(("a", "b"), pose, 30, morph_names=("smile",), morph_weights=np.zeros((4, 1)))


# --- curves and clips -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("times", "values", "options", "message"),
    [
        ([], np.zeros((0, 1)), {}, "at least one key"),
        ([0.0, np.nan], np.zeros((2, 1)), {}, "times_s: expected finite numbers"),
        ([0.0, 1.0, 1.0], np.zeros((3, 1)), {}, "key 2 at 1.0 s does not come after key 1 at 1.0 s"),
        ([0.0, 1.0], np.zeros((3, 1)), {}, r"values: expected \(2, C\) to match 2 key times, got \(3, 1\)"),
        ([0.0], [[1.0, 2.0]], {"kind": CurveKind.SCALAR}, r"expected \(1, 1\) for a scalar curve"),
        ([0.0], [[1.0, 0, 0]], {"kind": CurveKind.ROTATION}, r"expected \(1, 4\) for a rotation curve"),
        (
            [0.0, 1.0],
            np.zeros((2, 1)),
            {"modes": Interpolation.HERMITE},
            r"in_tangents: a HERMITE curve needs in_tangents of shape \(2, 1\)",
        ),
        ([0.0, 1.0], np.zeros((2, 1)), {"in_tangents": np.zeros((2, 2))}, "in_tangents: expected"),
        ([0.0, 1.0], [[0.0, 1], [np.nan, 1]], {}, r"values: expected finite numbers, got \[nan, 1.0\] at key 1"),
        ([0.0], [[np.inf]], {}, r"values: expected finite numbers, got \[inf\] at key 0"),
        ([0.0], [[1.0]], {"out_tangents": [[np.nan]]}, "out_tangents: expected finite numbers"),
        ([0.0], [[1.0]], {"in_handles": [[[np.nan, 0]]]}, "in_handles: expected finite numbers"),
    ],
)
def test_malformed_curves_are_refused(times: Any, values: Any, options: dict[str, Any], message: str) -> None:
    with pytest.raises(ShapeError, match=message):
        Curve(times, values, **options)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"modes": Interpolation.BEZIER}, r"in_handles: a BEZIER curve needs in_handles of shape \(2, 1, 2\)"),
        ({"out_handles": np.full((2, 1, 2), -0.5)}, r"out_handles: expected seconds at or after the key, got -0.5 s"),
        ({"in_handles": np.full((2, 1, 2), 0.25)}, r"in_handles: expected seconds at or before the key, got 0.25 s"),
        ({"in_handles": np.zeros((2, 2))}, r"in_handles: expected \(2, 1, 2\)"),
        ({"modes": 9}, r"modes: expected Interpolation \(0 to 6\), got 9"),
        ({"modes": Interpolation.SQUAD}, "a vector curve cannot have SQUAD"),
        ({"tangent_types": np.zeros(2)}, r"tangent_types: expected \(2, 2\)"),
        ({"tangent_types": np.full((2, 2), 7)}, r"tangent_types: expected Tangent \(0 to 5\), got 7"),
        ({"kind": CurveKind.BOOLEAN}, r"a boolean curve goes in steps"),
        ({"kind": CurveKind.BOOLEAN, "modes": Interpolation.STEP}, "values: a boolean curve is 0 or 1 at its keys"),
        ({"kind": CurveKind.COLOR}, r"expected \(2, 3 or 4\) for a color curve, got \(2, 1\)"),
    ],
)
def test_malformed_handles_types_and_kinds_are_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ShapeError, match=message):
        Curve([0.0, 1.0], [[0.0], [0.5]], **options)


def test_channels_have_components_where_that_means_something() -> None:
    assert str(Channel("hips", Property.EULER, 2)) == "hips.euler.z"
    for component in (3, -1):
        with pytest.raises(ShapeError, match=f"component: expected 0, 1, 2 or None, got {component}"):
            Channel("hips", Property.TRANSLATION, component)
    for property in (Property.ROTATION, Property.WEIGHT):
        with pytest.raises(ShapeError, match=f"component: a {property.value} has no components"):
            Channel("hips", property, 0)


def test_one_mode_is_spread_over_all_keys() -> None:
    assert_array_equal(Curve([0, 1, 2], np.zeros((3, 1)), Interpolation.STEP).modes, [0, 0, 0])
    assert Curve([0, 1], np.zeros((2, 1))).key_count == 2


def test_a_clips_range_and_curves() -> None:
    clip = Clip(
        {
            Channel("hips", Property.TRANSLATION): Curve([0.5, 2.0], np.zeros((2, 3))),
            Channel("smile", Property.WEIGHT): Curve([0.25], [[1.0]]),
        }
    )
    assert (clip.start_s, clip.end_s, clip.duration_s) == (0.25, 2.0, 1.75)
    assert Clip().duration_s == 0
    with pytest.raises(UnknownName, match=r"no channel 'hip\.translation'; nearest: 'hips\.translation'"):
        clip.curve("hip", Property.TRANSLATION)


# --- meshes, skins, morphs --------------------------------------------------------------------------------------------


def test_malformed_meshes_are_refused() -> None:
    square = np.zeros((4, 3))
    for arguments, message in (
        ({"positions": np.zeros((4, 2))}, r"positions: expected \(V, 3\), got \(4, 2\)"),
        ({"triangles": [[0, 1, 4]]}, "triangles: vertex 4 does not exist; the mesh has 4"),
        ({"triangles": [[0, 1, -1]]}, "triangles: vertex -1 does not exist"),
        ({"normals": np.zeros((3, 3))}, r"normals: expected \(4, 3\)"),
        ({"colors": np.zeros((4, 3))}, r"colors: expected \(4, 4\)"),
        ({"attributes": {"TANGENT": np.zeros((5, 4))}}, "attribute TANGENT: expected 4 rows"),
    ):
        with pytest.raises(ShapeError, match=message):
            Mesh(**{"positions": square, "triangles": [[0, 1, 2]], **arguments})


def test_malformed_skins_are_refused() -> None:
    eye = np.eye(4)[None]
    for arguments, message in (
        (([0], np.zeros((2, 4, 4)), [[0]], [[1.0]]), "joint_from_mesh: expected"),
        (([0], eye, [[1]], [[1.0]]), "influence 1 is outside the palette of 1"),
        (([0], eye, [[0]], [[1.0, 0.0]]), "weights: expected"),
        (([0], eye, [[0]], [[-0.5]]), "weights: expected finite numbers >= 0"),
        (([0], eye, [[0]], [[np.nan]]), "weights: expected finite numbers >= 0"),
    ):
        with pytest.raises(ShapeError, match=message):
            Skin(*arguments)


def test_sparse_morphs_hold_what_dense_ones_do(rng: np.random.Generator) -> None:
    positions = rng.normal(size=(3, 20, 3)) * (rng.uniform(size=(3, 20, 1)) < 0.2)
    normals = rng.normal(size=(3, 20, 3)) * (rng.uniform(size=(3, 20, 1)) < 0.2)
    morphs = MorphSet.from_dense(("a", "b", "c"), positions, normals)
    assert len(morphs.vertices) < 60
    for own, expected in zip(morphs.dense(20), (positions, normals), strict=True):
        assert_array_equal(own, expected)
    assert MorphSet.from_dense(("a", "b", "c"), positions).dense(20)[1] is None
    assert morphs.index("c") == 2
    with pytest.raises(UnknownName, match="no morph target 'd'"):
        morphs.index("d")


def test_malformed_morphs_are_refused() -> None:
    for arguments, message in (
        ((("a", "a"), [0, 0, 0], [], np.zeros((0, 3))), "morph target 'a' appears more than once"),
        ((("a",), [0, 1, 1], [0], np.zeros((1, 3))), "starts: expected"),
        ((("a",), [0, 2], [0], np.zeros((1, 3))), "starts: expected numbers rising from 0 to 1"),
        ((("a", "b"), [0, 1, 0], [0], np.zeros((1, 3))), "starts: expected numbers rising"),
        ((("a",), [0, 1], [0], np.zeros((2, 3))), "position_deltas: expected"),
    ):
        with pytest.raises(ShapeError, match=message):
            MorphSet(*arguments)


# --- characters and scenes --------------------------------------------------------------------------------------------


def test_parts_have_one_binding_and_fit_their_character(rng: np.random.Generator) -> None:
    skeleton, mesh = random_skeleton(rng, 3), random_mesh(rng, 6)
    skin = random_skin(rng, skeleton, 6, 2)
    for arguments, message in (
        ({}, "part 'p': expected either a skin or a joint"),
        ({"skin": skin, "joint": 0}, "part 'p': expected either a skin or a joint"),
        ({"skin": random_skin(rng, skeleton, 5, 2)}, "the skin binds 5 vertices, the mesh has 6"),
        ({"joint": 0, "morphs": MorphSet(("a",), [0, 1], [6], np.zeros((1, 3)))}, "moves vertex 6, the mesh has 6"),
    ):
        with pytest.raises(ShapeError, match=message):
            Part("p", mesh, **arguments)
    morphs = MorphSet(("a", "b"), [0, 0, 0], [], np.zeros((0, 3)))
    assert_array_equal(Part("p", mesh, joint=0, morphs=morphs).morph_channels, [0, 1])
    for part, options, message in (
        (Part("p", mesh, joint=3), {}, "part 'p': joint 3 does not exist; the skeleton has 3"),
        (Part("p", mesh, skin=replace(skin, palette=[0, 1, 7])), {}, "part 'p': joint 7 does not exist"),
        (Part("p", mesh, joint=0, morphs=morphs), {"morph_names": ("a",)}, "part 'p': morph channel 1 of 1"),
        (Part("p", mesh, joint=0), {"roles": {"hips": 5}}, "role 'hips': joint 5 does not exist"),
        (Part("p", mesh, joint=0), {"rest_morph_weights": [1.0]}, "rest_morph_weights: expected"),
    ):
        with pytest.raises(ShapeError, match=message):
            Character(skeleton, (part,), **options)


def test_characters_count_and_find(rng: np.random.Generator) -> None:
    skeleton = random_skeleton(rng, 3)
    parts = (Part("a", random_mesh(rng, 6), joint=0), Part("b", random_mesh(rng, 9), Material("red"), joint=1))
    character = Character(skeleton, parts, "anna", ("smile", "blink"))
    assert (character.vertex_count, character.triangle_count) == (15, 5)
    assert_array_equal(character.rest_morph_weights, [0, 0])
    assert character.morph_index("blink") == 1
    with pytest.raises(UnknownName, match="no morph 'smle'; nearest: 'smile'"):
        character.morph_index("smle")
    scene = Scene((character,), (Clip(name="walk"), Clip(name="run")))
    assert scene.character is character
    assert scene.animation().name == "walk"
    assert scene.animation("run").name == "run"
    with pytest.raises(UnknownName, match="no clip 'rnu'; nearest: 'run'"):
        scene.animation("rnu")
    with pytest.raises(UnknownName, match="no character"):
        _ = Scene().character


# --- errors -----------------------------------------------------------------------------------------------------------


def test_errors_are_one_family_and_also_the_usual_python_ones() -> None:
    for error, usual in (
        (ShapeError, ValueError),
        (UnknownName, KeyError),
        (FormatError, ValueError),
        (MissingExtra, ImportError),
    ):
        assert issubclass(error, KeyposeError)
        assert issubclass(error, usual)


def test_errors_say_where_and_what_to_do() -> None:
    error = FormatError("expected a number, got 'x'", where="line 12")
    assert str(error) == "line 12: expected a number, got 'x'"
    assert str(error.at("walk.bvh")) == "walk.bvh: line 12: expected a number, got 'x'"
    assert str(UnknownName("joint", "Hpis", ["Hips", "Head"])) == "no joint 'Hpis'; nearest: 'Hips'"
    assert str(UnknownName("joint", "zzz", [])) == "no joint 'zzz'; there are none"
    assert "pip install 'keypose[usd]'" in str(MissingExtra("reading USD", "usd"))


def test_types_can_be_pickled(rng: np.random.Generator) -> None:
    """For process pools."""
    motion = Motion(("a", "b"), random_pose(rng, (5,), 2), 24)
    again = pickle.loads(pickle.dumps(motion))
    assert_array_equal(again.pose.rotations, motion.pose.rotations)
    character = Character(random_skeleton(rng, 3), (Part("a", random_mesh(rng, 6), joint=0),), roles={"hips": 0})
    assert pickle.loads(pickle.dumps(character)).roles == {"hips": 0}
    clip = Clip({Channel("a", Property.SCALE): Curve([0.0], [[1.0, 1, 1]])})
    assert list(pickle.loads(pickle.dumps(clip)).curves) == list(clip.curves)
