"""Every function in every array library: the same values, the right precision, gradients that are right and finite."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from keypose.math import dualquat, ease, euler, quat, rigid, rotation_splines, spline

PI = np.pi
IDENTITY = [1.0, 0, 0, 0]
RNG = np.random.default_rng(3)


def some_quats(*shape):
    q = RNG.normal(size=(*shape, 4))
    return q / np.linalg.norm(q, axis=-1, keepdims=True)


def some(*shape):
    return RNG.normal(size=shape)


def some_motions(*shape):
    return dualquat.from_rigid(some_quats(*shape), some(*shape, 3))


def some_matrices(n):
    return rigid.from_trs(some(n, 3), some_quats(n), RNG.uniform(0.5, 2, size=(n, 3)))


def smooth_quats():
    """Six rotations, each some way from the one before."""
    q = [some_quats()]
    for step in some(5, 3):
        q.append(quat.multiply(q[-1], quat.from_rotation_vector(0.6 * step)))
    return np.array(q)


KEY_TIMES = np.array([0.0, 0.4, 1.5, 1.9, 3.0, 3.3])
U = RNG.uniform(0.1, 0.9, size=4)

# name -> (function, inputs); inputs that a gradient would leave the manifold with are normalised inside.
CASES = {
    "quat.multiply": (quat.multiply, (some_quats(4), some_quats(4))),
    "quat.conjugate": (quat.conjugate, (some_quats(4),)),
    "quat.inverse": (quat.inverse, (some(4, 4),)),
    "quat.normalize": (quat.normalize, (some(4, 4),)),
    "quat.shortest": (quat.shortest, (some_quats(4),)),
    "quat.rotate": (quat.rotate, (some_quats(4), some(4, 3))),
    "quat.from_axis_angle": (quat.from_axis_angle, (some(4, 3), some(4))),
    "quat.to_axis_angle": (quat.to_axis_angle, (some_quats(4),)),
    "quat.exp": (quat.exp, (some(4, 3),)),
    "quat.exp small": (quat.exp, (0.01 * some(4, 3),)),
    "quat.log": (quat.log, (some(4, 4),)),
    "quat.log small": (quat.log, (IDENTITY + 0.01 * some(4, 4),)),
    "quat.from_rotation_vector": (quat.from_rotation_vector, (some(4, 3),)),
    "quat.to_rotation_vector": (quat.to_rotation_vector, (some_quats(4),)),
    "quat.slerp": (quat.slerp, (some_quats(4), some_quats(4), U)),
    "quat.slerp near": (
        lambda a, d, u: quat.slerp(quat.normalize(a), quat.normalize(a + 0.01 * d), u),
        (some_quats(4), some(4, 4), U),
    ),
    "quat.nlerp": (quat.nlerp, (some_quats(4), some_quats(4), U)),
    "quat.power": (quat.power, (some_quats(4), U)),
    "quat.difference": (quat.difference, (some_quats(4), some_quats(4))),
    "quat.angle_between": (quat.angle_between, (some_quats(4), some_quats(4))),
    "quat.average": (quat.average, (some_quats(2, 5), RNG.uniform(1, 2, size=(2, 5)))),
    "quat.swing_twist": (quat.swing_twist, (some_quats(4), some(4, 3))),
    "quat.align_signs": (quat.align_signs, (some_quats(6),)),
    "quat.to_matrix": (quat.to_matrix, (some_quats(4),)),
    "quat.from_matrix": (quat.from_matrix, (quat.to_matrix(some_quats(4)),)),
    "quat.to_sixd": (quat.to_sixd, (some_quats(4),)),
    "quat.from_sixd": (quat.from_sixd, (some(4, 6),)),
    "quat.from_two_vectors": (quat.from_two_vectors, (some(4, 3), some(4, 3))),
    "quat.look_rotation": (quat.look_rotation, (some(4, 3), some(4, 3))),
    "dualquat.from_rigid": (dualquat.from_rigid, (some_quats(4), some(4, 3))),
    "dualquat.to_rigid": (dualquat.to_rigid, (some_motions(4),)),
    "dualquat.multiply": (dualquat.multiply, (some_motions(4), some_motions(4))),
    "dualquat.normalize": (dualquat.normalize, (some(4, 8),)),
    "dualquat.transform_points": (dualquat.transform_points, (some_motions(4), some(4, 3))),
    "dualquat.exp": (dualquat.exp, (some(4, 6),)),
    "dualquat.log": (dualquat.log, (some_motions(4),)),
    "dualquat.sclerp": (dualquat.sclerp, (some_motions(4), some_motions(4), U)),
    "dualquat.blend": (dualquat.blend, (some_motions(4, 3), RNG.uniform(0.2, 1, size=(4, 3)))),
    "rigid.from_trs": (rigid.from_trs, (some(4, 3), some_quats(4), some(4, 3))),
    "rigid.to_trs": (rigid.to_trs, (some_matrices(4),)),
    "rigid.inverse": (rigid.inverse, (some_matrices(4),)),
    "rigid.compose": (rigid.compose, (some_matrices(4), some_matrices(4))),
    "rigid.transform_points": (rigid.transform_points, (some_matrices(4), some(4, 3))),
    "rigid.transform_vectors": (rigid.transform_vectors, (some_matrices(4), some(4, 3))),
    "spline.parameter": (spline.parameter, (some(4), some(4) - 3, some(4) + 3)),
    "spline.lerp": (spline.lerp, (some(4, 2), some(4, 2), U)),
    "spline.hermite": (spline.hermite, (*(some(4, 2) for _ in range(4)), U, U + 1)),
    "spline.hermite_derivative": (spline.hermite_derivative, (*(some(4, 2) for _ in range(4)), U, U + 1)),
    **{f"euler.to_quat {o}": (partial(euler.to_quat, order=o), (some(4, 3),)) for o in ("XYZ", "zyx", "ZXZ", "yzy")},
    **{
        f"euler.from_quat {o}": (partial(euler.from_quat, order=o), (some_quats(4),))
        for o in ("XZY", "zxy", "YXY", "xyx")
    },
    "euler.gimbal_distance": (partial(euler.gimbal_distance, order="XYZ"), (some(4, 3),)),
    "euler.unroll": (partial(euler.unroll, order="XYZ"), (3 * some(6, 3),)),
    "rotation_splines.squad": (rotation_splines.squad, (some_quats(4), 0.4 * some(4, 3, 3), U)),
    "rotation_splines.spherical_bezier": (rotation_splines.spherical_bezier, (some_quats(4), 0.4 * some(4, 3, 3), U)),
    "rotation_splines.log_cubic": (rotation_splines.log_cubic, (some_quats(4), 0.4 * some(4, 3, 3), U)),
    "rotation_splines.squad_controls": (partial(rotation_splines.squad_controls, times_s=KEY_TIMES), (smooth_quats(),)),
    "rotation_splines.spherical_bezier_controls": (
        partial(rotation_splines.spherical_bezier_controls, times_s=KEY_TIMES),
        (smooth_quats(),),
    ),
    "rotation_splines.log_cubic_controls": (
        partial(rotation_splines.log_cubic_controls, times_s=KEY_TIMES[:4]),
        (smooth_quats()[:4],),
    ),
    "rotation_splines.end_velocities": (
        partial(rotation_splines.end_velocities, method="log_cubic"),
        (0.4 * some(4, 3, 3), U),
    ),
    "ease.ease": (partial(ease.ease, "elastic_in_out"), (U,)),
}
every_case = pytest.mark.parametrize("name", CASES)


def outputs(result):
    return result if isinstance(result, tuple) else (result,)


@every_case
def test_the_libraries_agree(name, library):
    function, inputs = CASES[name]
    reference = outputs(function(*inputs))
    results = outputs(function(*(library.array(x) for x in inputs)))
    for got, expected in zip(results, reference, strict=True):
        np.testing.assert_allclose(library.numpy(got), expected, atol=400 * library.eps, rtol=100 * library.eps)


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_jax_agrees_compiled(dtype):
    jax = pytest.importorskip("jax", reason="jax is not installed")
    eps = float(np.finfo(dtype).eps)
    before = jax.config.jax_enable_x64
    jax.config.update("jax_enable_x64", dtype == "float64")
    try:
        inputs = {name: [jax.numpy.asarray(x, dtype=dtype) for x in arrays] for name, (_, arrays) in CASES.items()}
        everything = jax.jit(lambda given: {name: outputs(CASES[name][0](*arrays)) for name, arrays in given.items()})
        results = everything(inputs)
    finally:
        jax.config.update("jax_enable_x64", before)
    for name, (function, arrays) in CASES.items():
        for got, expected in zip(results[name], outputs(function(*arrays)), strict=True):
            assert str(got.dtype) == dtype, name
            np.testing.assert_allclose(np.asarray(got), expected, atol=400 * eps, rtol=100 * eps, err_msg=name)


@every_case
def test_gradients_are_finite_differences(name, torch):
    function, inputs = CASES[name]
    tensors = tuple(torch.tensor(x, dtype=torch.float64, requires_grad=True) for x in inputs)
    assert torch.autograd.gradcheck(function, tensors, eps=1e-6, atol=2e-6, rtol=1e-5)


HALF_TURN, NEARLY = [0.0, 1.0, 0.0, 0.0], [1.0, 1e-9, 0.0, 0.0]
LOCKED = [
    [np.cos(0.3), np.sin(0.3), 0, 0],
    [np.cos(PI / 4), 0, np.sin(PI / 4), 0],
    [0.5, 0.5, 0.5, 0.5],
    [0.5, -0.5, 0.5, -0.5],
]
NO_MOTION = [1.0, 0, 0, 0, 0, 0, 0, 0]

SINGULAR = {
    **{
        f"{method} through equals and half turns": (
            lambda q, method=method: rotation_splines.interpolate(q, [0.0, 1, 2], [0.0, 0.3, 1, 1.7], method),
            [[IDENTITY] * 3, [IDENTITY, HALF_TURN, IDENTITY], [IDENTITY, [-1.0, 0, 0, 0], HALF_TURN]],
        )
        for method in ("squad", "spherical_bezier", "log_cubic")
    },
    "normalize zero": (quat.normalize, [[0.0, 0, 0, 0]]),
    "inverse of zero": (quat.inverse, [[0.0, 0, 0, 0]]),
    "no axis": (lambda v: quat.from_axis_angle(v, 1.0), [[0.0, 0, 0]]),
    "axis of nothing": (quat.to_axis_angle, [IDENTITY, [-1.0, 0, 0, 0], HALF_TURN, NEARLY]),
    "exp at zero": (quat.exp, [[0.0, 0, 0], [1e-200, 0, 0], [1e-9, 0, 0]]),
    "log at one, minus one and half a turn": (quat.log, [IDENTITY, [-1.0, 0, 0, 0], HALF_TURN, NEARLY, [0.0, 0, 0, 0]]),
    "rotation vector": (quat.to_rotation_vector, [IDENTITY, [-1.0, 0, 0, 0], HALF_TURN, NEARLY]),
    "no rotation vector": (quat.from_rotation_vector, [[0.0, 0, 0]]),
    "power": (lambda q: quat.power(q, 0.5), [IDENTITY, [-1.0, 0, 0, 0], HALF_TURN]),
    "slerp of equals and opposites": (
        lambda q: quat.slerp(q, q, 0.3) + quat.slerp(q, -q, 0.3) + quat.slerp(q, quat.multiply(q, HALF_TURN), 0.3),
        [IDENTITY, HALF_TURN],
    ),
    "slerp to a constant": (lambda q: quat.slerp(q, IDENTITY, 0.3), [IDENTITY, [-1.0, 0, 0, 0], HALF_TURN, NEARLY]),
    "nlerp": (lambda q: quat.nlerp(q, IDENTITY, 0.5), [IDENTITY, [-1.0, 0, 0, 0], HALF_TURN]),
    "angle to itself": (lambda q: quat.angle_between(q, IDENTITY), [IDENTITY, [-1.0, 0, 0, 0], HALF_TURN, NEARLY]),
    "average of equals": (quat.average, [[IDENTITY] * 3, [IDENTITY, [-1.0, 0, 0, 0], HALF_TURN], [HALF_TURN] * 3]),
    "average without weight": (lambda w: quat.average([IDENTITY, HALF_TURN], w), [[0.0, 0.0], [1.0, 1.0]]),
    "swing by half a turn": (lambda q: quat.swing_twist(q, [0.0, 1, 0]), [HALF_TURN, IDENTITY, [0.0, 0, 1, 0]]),
    "no twist axis": (lambda v: quat.swing_twist(NEARLY, v), [[0.0, 0, 0]]),
    "matrices at every branch": (
        quat.from_matrix,
        [np.eye(3), *(np.diag(d) for d in ([1.0, -1, -1], [-1, 1, -1], [-1, -1, 1]))],
    ),
    "sixd": (quat.from_sixd, [[0.0] * 6, [1.0, 0, 0, 2, 0, 0], [1.0, 0, 0, 0, 1, 0], [0.0, 0, 1, 0, 0, 0]]),
    "two vectors": (
        lambda v: quat.from_two_vectors(v, [0.0, 0, 1]),
        [[0.0, 0, 0], [0.0, 0, 1], [0.0, 0, -1], [1.0, 0, 0]],
    ),
    "look along up": (quat.look_rotation, [[0.0, 1, 0], [0.0, -1, 0], [0.0, 0, 0], [0.0, 0, 1]]),
    **{f"lock of {o}": (partial(euler.from_quat, order=o), [IDENTITY, HALF_TURN, *LOCKED]) for o in euler.CONVENTIONS},
    "dual zero": (dualquat.normalize, [[0.0] * 8, NO_MOTION]),
    "screw of nothing": (dualquat.log, [NO_MOTION, [-1.0, 0, 0, 0, 0, 1, 0, 0], [1.0, 0, 0, 0, 0, 1, 2, 3]]),
    "exp of no screw": (dualquat.exp, [[0.0] * 6, [0.0, 0, 0, 1, 2, 3]]),
    "sclerp of equals": (lambda d: dualquat.sclerp(d, NO_MOTION, 0.3), [NO_MOTION, [1.0, 0, 0, 0, 0, 1, 0, 0]]),
    "blend that cancels": (lambda w: dualquat.blend([NO_MOTION, NO_MOTION], w), [[0.0, 0.0], [1.0, -1.0]]),
    "flattened matrices": (
        rigid.to_trs,
        [np.diag(d) for d in ([0.0, 0, 0, 1], [0, 2, 0, 1], [1, 1, 0, 1], [-1, 1, 1, 1])],
    ),
    "inverse of flat": (rigid.inverse, [np.diag([1.0, 0, 1, 1])]),
    "spans of no length": (lambda t: spline.parameter(1.0, t, 1.0), [1.0]),
    "hermite in no time": (lambda t: spline.hermite_derivative([0.0], [1.0], [1.0], [1.0], 0.5, t), [0.0]),
}


@pytest.mark.parametrize("name", SINGULAR)
def test_gradients_are_finite_at_singular_points(name, torch):
    function, points = SINGULAR[name]
    for dtype in (torch.float64, torch.float32):
        for point in points:
            x = torch.tensor(np.asarray(point), dtype=dtype, requires_grad=True)
            results = outputs(function(x))
            for result in results:
                assert result.dtype == dtype
                assert torch.isfinite(result).all(), point
            # Every output separately: a NaN must not hide in a sum.
            for value in torch.cat([r.reshape(-1) for r in results]):
                (gradient,) = torch.autograd.grad(value, x, retain_graph=True, allow_unused=True)
                assert gradient is None or torch.isfinite(gradient).all(), (point, gradient)


def test_the_gradient_at_the_identity_is_the_true_one(torch):
    """Not only finite: exp and log have unit slope there, and slerp shares its motion between the ends."""
    zero = torch.zeros(3, dtype=torch.float64)
    slope = torch.autograd.functional.jacobian(quat.exp, zero)
    np.testing.assert_allclose(slope, np.eye(4)[:, 1:], atol=1e-15)
    one = torch.tensor(IDENTITY, dtype=torch.float64)
    np.testing.assert_allclose(torch.autograd.functional.jacobian(quat.log, one), np.eye(4)[1:], atol=1e-15)
    shares = torch.autograd.functional.jacobian(lambda b: quat.slerp(one, b, 0.3), one)
    np.testing.assert_allclose(shares[1:, 1:], 0.3 * np.eye(3), atol=1e-15)
    mean = torch.autograd.functional.jacobian(quat.average, torch.stack([one] * 4))
    np.testing.assert_allclose(mean[1:, :, 1:], np.repeat(np.eye(3)[:, None], 4, 1) / 4, atol=1e-15)


def test_jax_gradients_are_finite_at_singular_points():
    jax = pytest.importorskip("jax", reason="jax is not installed")
    names = ["log at one, minus one and half a turn", "exp at zero", "average of equals", "two vectors", "lock of XYZ"]
    for name in names:
        function, points = SINGULAR[name]
        slopes = jax.jit(jax.vmap(jax.jacrev(function)))(jax.numpy.asarray(points, dtype="float32"))
        assert np.isfinite(np.asarray(slopes)).all(), name


def test_a_rotation_is_found_by_descent(torch):
    """Gradients do the work they are for: an optimiser that starts exactly at the identity finds a rotation."""
    target = quat.from_axis_angle(torch.tensor([1.0, 2, -1]), torch.tensor(2.5))
    cloud = torch.tensor(RNG.normal(size=(10, 3)), dtype=torch.float32)
    v = torch.zeros(3, requires_grad=True)
    adam = torch.optim.Adam([v], lr=0.1)
    for _ in range(200):
        adam.zero_grad()
        loss = ((quat.rotate(quat.from_rotation_vector(v), cloud) - quat.rotate(target, cloud)) ** 2).mean()
        loss.backward()
        adam.step()
    assert float(quat.angle_between(quat.from_rotation_vector(v.detach()), target)) < 1e-2


def test_pymotion_agrees():
    """An independent library for animation, with the same wxyz convention."""
    peer = pytest.importorskip("pymotion.rotations.quat", reason="upc-pymotion is not installed")
    dual = pytest.importorskip("pymotion.rotations.dual_quat")
    a, b, v, w, t = some_quats(50), some_quats(50), some(50, 3), some(50, 3), some(50, 3)
    np.testing.assert_allclose(quat.multiply(a, b), peer.mul(a, b), atol=1e-14)
    np.testing.assert_allclose(quat.rotate(a, v), peer.mul_vec(a, v), atol=1e-14)
    for u in (0.0, 0.3, 1.0):  # its slerp adds an epsilon to the sine
        np.testing.assert_allclose(quat.shortest(quat.slerp(a, b, u)), quat.shortest(peer.slerp(a, b, u)), atol=2e-6)
    np.testing.assert_allclose(
        quat.rotate(quat.from_two_vectors(v, w), v), peer.mul_vec(peer.from_to(v, w), v), atol=1e-6
    )
    np.testing.assert_allclose(dualquat.from_rigid(a, t), dual.from_rotation_translation(a, t), atol=1e-14)
    flipped = a * np.where(some(50, 1) < 0, -1, 1)
    np.testing.assert_array_equal(quat.align_signs(flipped), peer.unroll(flipped, 0))
