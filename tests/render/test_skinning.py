"""The shader's skinning equals `keypose.deform`."""

from dataclasses import replace

import numpy as np
import pytest

from keypose import deform, io, samples
from keypose.model import Character, Part, Pose, Scene, Skeleton, SkinningMethod
from keypose.render import RenderSettings
from keypose.render.stage import Stage
from keypose.render.surfaces import surfaces
from tests.conftest import data_files
from tests.render.conftest import arm, wave

pytestmark = pytest.mark.gl


def worst(scene, animation=None, moments=4):
    """Largest difference of positions, in sizes of the subject, and of normals, between the GPU and `keypose.deform`."""
    from keypose.render.gl import GlRenderer

    settings = RenderSettings(width=16, height=16)
    stage = Stage(scene, animation, settings)
    renderer = GlRenderer(stage, settings, 1)
    position = normal = 0.0
    for moment in stage.moments(np.linspace(stage.start_s, stage.end_s, moments)):
        renderer.skin(moment)
        for surface, points, directions in renderer.read_skinned():
            has_normals = surface.part.mesh.normals is not None
            expected = deform.deform_part(
                surface.character,
                surface.part,
                moment.matrices[surface.drawn],
                moment.morph_weights[surface.drawn],
                with_normals=has_normals,
            )
            if has_normals:
                expected, expected_normals = expected
                normal = max(normal, float(np.abs(directions - expected_normals).max()))
            position = max(position, float(np.abs(points - expected).max()) / stage.size)
    renderer.close()
    return position, normal


@pytest.mark.parametrize("influences", [1, 2, 4, 6, 8])
def test_any_number_of_influences_up_to_eight(influences):
    character = arm(influences)
    position, normal = worst(Scene((character,), (wave(character),)))
    assert position < 1e-5
    assert normal < 1e-4


def test_dual_quaternions():
    character = arm(4)
    part = character.parts[0]
    dual = replace(part, skin=replace(part.skin, method=SkinningMethod.DUAL_QUATERNION))
    position, normal = worst(Scene((replace(character, parts=(dual,)),), (wave(character),)))
    assert position < 1e-5
    assert normal < 1e-4


def test_hundreds_of_joints():
    count = 700
    base = arm()
    skin = base.parts[0].skin
    rest = Pose(np.zeros((count, 3)), np.tile([1.0, 0, 0, 0], (count, 1)), np.ones((count, 3)))
    offsets = np.random.default_rng(0).normal(scale=0.1, size=(count, 3))
    skeleton = Skeleton(
        tuple(f"j{i}" for i in range(count)), np.full(count, -1), Pose(offsets, rest.rotations, rest.scales)
    )
    joints = np.random.default_rng(1).integers(0, count, skin.joints.shape)
    many = type(skin)(np.arange(count), np.tile(np.eye(4), (count, 1, 1)), joints, skin.weights)
    part = Part("many", base.parts[0].mesh, skin=many)
    assert worst(Scene((Character(skeleton, (part,)),)), moments=1)[0] < 1e-5


def test_more_influences_than_eight_keep_the_largest():
    character = arm(8)
    skin = character.parts[0].skin
    wide = type(skin)(
        skin.palette,
        skin.joint_from_mesh,
        np.concatenate([skin.joints, skin.joints], axis=1),
        np.concatenate([skin.weights * 0.999, skin.weights * 0.001], axis=1),
    )
    part = Part("wide", character.parts[0].mesh, skin=wide)
    stage = Stage(Scene((Character(character.skeleton, (part,)),)), None, RenderSettings())
    (surface,) = surfaces(stage)
    assert surface.joints.shape[1] == 8
    np.testing.assert_allclose(surface.weights.sum(axis=1), 1, atol=1e-6)
    np.testing.assert_allclose(surface.weights.max(axis=1), skin.weights.max(axis=1), atol=2e-3)


@pytest.mark.parametrize("name", ["walk", "talk"])
def test_the_built_in_human(name):
    position, normal = worst(samples.load(name), moments=2)
    assert position < 1e-5
    assert normal < 1e-3


@pytest.mark.data
@pytest.mark.parametrize(
    "path",
    [p for stem in ("khronos/Fox.glb", "khronos/cesium_man.gltf", "cc0/robot.glb", "cc0/Knight.glb", "khronos/MorphStressTest.gltf") for p in data_files(f"gltf/{stem}")],
    ids=lambda p: p.stem,
)  # fmt: skip
def test_real_files(path):
    position, normal = worst(io.load(path), moments=3)
    assert position < 1e-5
    assert normal < 2e-3  # normals of nearly folded triangles lose digits


def test_large_pictures_take_fewer_samples():
    from keypose.render.gl import _sampling

    assert _sampling(RenderSettings(width=1280, height=720), 2, 16384, 8) == (2, 4)
    assert _sampling(RenderSettings(width=1280, height=720), 1, 16384, 8) == (1, 8)
    assert _sampling(RenderSettings(width=1280, height=720), 1, 16384, 4) == (1, 4)
    assert _sampling(RenderSettings(width=8192, height=8192), 2, 16384, 8) == (1, 2)
    assert _sampling(RenderSettings(width=3000, height=2000), 4, 4096, 8)[0] == 1
