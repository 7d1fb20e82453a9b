"""The same functions on JAX arrays: values, gradients, and compilation by jax.jit."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from keypose import deform, evaluate
from keypose.model import Channel, Clip, Curve, CurveKind, Pose, Property, SkinningMethod
from tests.synthetic import random_mesh, random_pose, random_rotations, random_skeleton, random_skin

pytestmark = pytest.mark.slow
jax = pytest.importorskip("jax")


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(61)


def test_poses_and_vertices_agree_with_numpy(rng: np.random.Generator) -> None:
    skeleton, mesh = random_skeleton(rng, 4), random_mesh(rng, 5)
    binding = random_skin(rng, skeleton, 5, 2)

    def everything(a: tuple[object, ...], b: tuple[object, ...]) -> list[object]:
        pose, other = Pose(*a), Pose(*b)
        mixed = evaluate.blend([pose, other], [0.4, 0.6])
        layered = evaluate.add(pose, evaluate.difference(other, pose))
        model_from_joint = evaluate.world(skeleton, mixed)
        rotations, positions = evaluate.world_rotations_positions(skeleton, layered)
        moved = [deform.skin(mesh, binding, model_from_joint, method) for method in SkinningMethod]
        return [model_from_joint, rotations, positions, *moved]

    poses = [random_pose(rng, (), 4, scaled=True) for _ in range(2)]
    plain = [(p.translations, p.rotations, p.scales) for p in poses]
    single = [tuple(jax.numpy.asarray(a, dtype="float32") for a in arrays) for arrays in plain]
    for own, expected in zip(jax.jit(everything)(*single), everything(*plain), strict=True):
        assert own.dtype == "float32"
        assert_allclose(np.asarray(own), expected, atol=1e-4)


def test_clips_of_jax_values(rng: np.random.Generator) -> None:
    skeleton, values, times = random_skeleton(rng, 3), random_rotations(rng, 4), np.linspace(-0.5, 3.5, 9)

    def pose(rotations: object) -> Pose:
        curve = Curve(np.arange(4), rotations, kind=CurveKind.ROTATION)
        return evaluate.sample_clip(Clip({Channel("joint1", Property.ROTATION): curve}), skeleton, times)

    own = pose(jax.numpy.asarray(values, dtype="float32"))
    assert_allclose(np.asarray(own.rotations), pose(values).rotations, atol=1e-6)


def test_jit_and_gradients_from_rotations_to_vertices(rng: np.random.Generator) -> None:
    skeleton, mesh = random_skeleton(rng, 4), random_mesh(rng, 6)
    binding = random_skin(rng, skeleton, 6, 2)
    rest = skeleton.rest
    target = rng.normal(size=(6, 3))

    def error(rotations: object, library: object = jax.numpy) -> object:
        model_from_joint = evaluate.world(skeleton, Pose(rest.translations, rotations, rest.scales))
        moved = deform.skin(mesh, binding, model_from_joint, "dual_quaternion")
        return library.sum((moved - library.asarray(target)) ** 2)

    rotations = random_rotations(rng, 4)
    gradient = jax.jit(jax.grad(error))(jax.numpy.asarray(rotations, dtype="float32"))
    step = 1e-6
    for index in np.ndindex(4, 4):
        change = np.zeros((4, 4))
        change[index] = step
        slope = (error(rotations + change, np) - error(rotations - change, np)) / (2 * step)
        assert_allclose(float(gradient[index]), slope, rtol=2e-3, atol=2e-3)
