"""Rotation splines: exact keys, continuity, SciPy's splines, published constructions, singular points, the browser's half."""

from __future__ import annotations

import json
import subprocess
from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, RotationSpline, Slerp

from keypose.errors import ShapeError, UnknownName
from keypose.math import quat
from keypose.math import rotation_splines as rs
from tests.io.gltf_node import ROOT, node_executable

METHODS = ("squad", "spherical_bezier", "log_cubic")
CONTROLS = {
    "squad": rs.squad_controls,
    "spherical_bezier": rs.spherical_bezier_controls,
    "log_cubic": rs.log_cubic_controls,
}
CURVES = {"squad": rs.squad, "spherical_bezier": rs.spherical_bezier, "log_cubic": rs.log_cubic}


def track(count, largest, rng, even=False):
    """Keys whose neighbours are at most ``largest`` radians apart, signs at random, at uneven times."""
    steps = rng.normal(size=(count - 1, 3))
    steps *= (largest * rng.random(count - 1) / np.linalg.norm(steps, axis=1))[:, None]
    keys = [quat.normalize(rng.normal(size=4))]
    for step in steps:
        keys.append(quat.multiply(keys[-1], quat.from_rotation_vector(step)))
    times = np.arange(count) * 0.5 if even else np.cumsum(rng.uniform(0.2, 1.2, count))
    return np.array(keys) * rng.choice([-1, 1], count)[:, None], times


def scipys(q):
    return Rotation.from_quat(np.asarray(q, float)[..., [1, 2, 3, 0]])


def rates(function, at, h=1e-4):
    """Angular velocity and acceleration in the body's frame, by differences of rotations."""
    r = [function(at + k * h) for k in (-1, 0, 1)]
    before, after = (quat.to_rotation_vector(quat.multiply(quat.conjugate(a), b)) / h for a, b in pairwise(r))
    return 0.5 * (before + after), (after - before) / h


@pytest.mark.parametrize("method", METHODS)
def test_keys_are_exact_bit_for_bit(method, library, rng):
    q, t = track(9, 2.5, rng)
    q = library.array(q)
    found = library.numpy(rs.interpolate(q, t, t, method))
    np.testing.assert_array_equal(found, library.numpy(q))
    np.testing.assert_array_equal(library.numpy(rs.interpolate(q, t, [t[0] - 1, t[-1] + 1], method)), found[[0, -1]])
    spans = CONTROLS[method](q, t)
    ends = library.numpy(CURVES[method](q[:-1], spans, 1.0))
    assert quat.angle_between(ends, found[1:]).max() < 40 * library.eps
    everywhere = library.numpy(rs.interpolate(q, t, np.linspace(t[0], t[-1], 500), method))
    assert np.abs(np.linalg.norm(everywhere, axis=-1) - 1).max() < 20 * library.eps


@pytest.mark.parametrize("method", METHODS)
def test_the_angular_velocity_has_no_jump_at_uneven_keys(method, rng):
    for largest in (0.3, 2.0, 3.1):
        q, t = track(12, largest, rng)
        controls = CONTROLS[method](q, t)
        start, end = rs.end_velocities(controls, np.diff(t), method)
        np.testing.assert_allclose(end[:-1], start[1:], atol=1e-13 * np.abs(start).max())
        # the velocities stated are those of the curve: one-sided differences of second order
        h = 1e-5
        for k in range(11):
            key, span = q[k], t[k + 1] - t[k]
            one, two = (
                quat.to_rotation_vector(quat.multiply(quat.conjugate(key), CURVES[method](key, controls[k], s * h)))
                for s in (1, 2)
            )
            np.testing.assert_allclose((2 * one - 0.5 * two) / (h * span), start[k], atol=1e-5 * np.abs(start).max())
            one, two = (
                quat.to_rotation_vector(
                    quat.multiply(quat.conjugate(q[k + 1]), CURVES[method](key, controls[k], 1 - s * h))
                )
                for s in (1, 2)
            )
            np.testing.assert_allclose(-(2 * one - 0.5 * two) / (h * span), end[k], atol=1e-5 * np.abs(start).max())


def test_only_the_log_cubic_keeps_the_acceleration(rng):
    q, t = track(9, 1.5, rng)
    jumps = {}
    for method in METHODS:
        sides = [
            [rates(lambda s, m=method: rs.interpolate(q, t, s, m), k + d)[1] for k in t[1:-1]] for d in (-2e-4, 2e-4)
        ]
        jumps[method] = np.abs(np.subtract(*sides)).max() / np.abs(sides).max()
    assert jumps["log_cubic"] < 5e-3
    assert jumps["squad"] > 0.05 and jumps["spherical_bezier"] > 0.05


def test_the_log_cubic_is_scipys_rotation_spline(rng):
    """One curve: SciPy stops its iteration at 1e-9 or after ten rounds, so that it is the less exact of the two."""
    for largest, tolerance in ((0.5, 1e-11), (1.5, 1e-9), (2.0, 1e-6)):
        for count in (2, 3, 4, 8, 33):
            q, t = track(count, largest, rng)
            at = np.linspace(t[0], t[-1], 301)
            expected = RotationSpline(t, scipys(q))(at).as_quat()[:, [3, 0, 1, 2]]
            assert quat.angle_between(rs.interpolate(q, t, at, "log_cubic"), expected).max() < tolerance


def test_two_keys_are_joined_by_slerp_and_constant_speed_stays(rng):
    q, t = track(2, 3.0, rng)
    at = np.linspace(t[0], t[1], 50)
    expected = Slerp(t, scipys(q))(at).as_quat()[:, [3, 0, 1, 2]]
    axis, speed = quat.normalize(rng.normal(size=4))[1:], 0.9
    times = np.cumsum(rng.uniform(0.1, 1.5, 10))
    turning = quat.from_axis_angle(axis, speed * times)
    between = np.linspace(times[0], times[-1], 200)
    for method in METHODS:
        assert quat.angle_between(rs.interpolate(q, t, at, method), expected).max() < 1e-14
        found = rs.interpolate(turning, times, between, method)
        assert quat.angle_between(found, quat.from_axis_angle(axis, speed * between)).max() < 1e-13


def test_smooth_motions_are_met_ever_closer():
    """Twice the keys leave an eighth of the error or less: third order inside, away from the ends."""

    def motion(s):
        return quat.multiply(quat.from_axis_angle([0, 1, 0], np.sin(2 * s)), quat.from_axis_angle([1, 0, 0], 0.7 * s))

    at = np.linspace(1.0, 3.0, 400)
    for method in METHODS:
        errors = []
        for count in (17, 33):
            t = np.linspace(0, 4, count)
            errors.append(quat.angle_between(rs.interpolate(motion(t), t, at, method), motion(at)).max())
        assert errors[1] < errors[0] / 7.0


def test_squad_has_shoemakes_inner_points_at_even_times(rng):
    q, t = track(7, 1.5, rng, even=True)
    q = quat.align_signs(q)
    outgoing, incoming = rs.control_points(q, rs.squad_controls(q, t))
    for k in range(1, 6):
        forth, back = (quat.log(quat.multiply(quat.conjugate(q[k]), q[k + s])) for s in (1, -1))
        inner = quat.multiply(q[k], quat.exp(-0.25 * (forth + back)))
        for point in (outgoing[k], incoming[k - 1]):
            assert quat.angle_between(point, inner) < 1e-14
    # and squad is slerp of slerps
    for u in (0.2, 0.5, 0.9):
        expected = quat.slerp(quat.slerp(q[:-1], q[1:], u), quat.slerp(outgoing, incoming, u), 2 * u * (1 - u))
        assert quat.angle_between(rs.squad(q[:-1], rs.squad_controls(q, t), u), expected).max() < 1e-13


def test_bezier_controls_are_doubled_and_bisected_at_even_times(rng):
    def double(p, r):
        return 2 * np.dot(p, r) * r - p

    def bisect(p, r):
        return (p + r) / np.linalg.norm(p + r)

    q, t = track(7, 1.5, rng, even=True)
    q = quat.align_signs(q)
    outgoing, incoming = rs.control_points(q, rs.spherical_bezier_controls(q, t))
    for k in range(1, 6):
        a = bisect(double(q[k - 1], q[k]), q[k + 1])
        b = double(a, q[k])
        assert quat.angle_between(outgoing[k], quat.slerp(q[k], a, 1 / 3)) < 1e-14
        assert quat.angle_between(incoming[k - 1], quat.slerp(q[k], b, 1 / 3)) < 1e-14


def test_given_control_points_make_de_casteljaus_curve(rng):
    """Against arcs by SciPy's Slerp, all points within a quarter turn so that no arc is ambiguous."""
    base = quat.normalize(rng.normal(size=4))
    points = quat.multiply(base, quat.from_rotation_vector(rng.uniform(-0.7, 0.7, size=(4, 3))))
    p0, c0, c1, p1 = points
    controls = rs.controls_of(np.stack([p0, p1]), c0[None], -c1[None])
    for u in np.linspace(0, 1, 9):
        level = list(scipys(points))
        while len(level) > 1:
            level = [Slerp([0, 1], Rotation.concatenate([a, b]))([u])[0] for a, b in pairwise(level)]
        found = rs.spherical_bezier(p0, controls[0], u)
        assert (level[0].inv() * scipys(found)).magnitude() < 1e-14
    back = rs.control_points(np.stack([p0, p1]), controls)
    np.testing.assert_allclose(back[0][0], c0, atol=1e-15)
    np.testing.assert_allclose(back[1][0], c1, atol=1e-15)


def test_a_curve_does_not_depend_on_signs_or_on_the_frame(rng):
    q, t = track(8, 2.0, rng)
    at = np.linspace(t[0], t[-1], 100)
    left, right = (quat.normalize(rng.normal(size=4)) for _ in "lr")
    for method in METHODS:
        plain = rs.interpolate(q, t, at, method)
        flipped = rs.interpolate(q * rng.choice([-1, 1], 8)[:, None], t, at, method)
        assert quat.angle_between(plain, flipped).max() < 1e-13
        moved = rs.interpolate(quat.multiply(quat.multiply(left, q), right), t, at, method)
        assert quat.angle_between(moved, quat.multiply(quat.multiply(left, plain), right)).max() < 1e-13
        later = rs.interpolate(q, 3 * t + 5, 3 * at + 5, method)
        assert quat.angle_between(plain, later).max() < 1e-12
        if method != "log_cubic":  # whose logarithm is taken from the key that starts the span
            backwards = rs.interpolate(q[::-1], -t[::-1], -at, method)
            assert quat.angle_between(plain, backwards).max() < 1e-12


def test_curves_of_one_set_of_times_go_together(library, rng):
    q = np.stack([track(6, 1.5, rng)[0] for _ in range(5)], axis=1)
    t = np.cumsum(rng.uniform(0.2, 1, 6))
    at = np.linspace(t[0], t[-1], 21).reshape(3, 7)
    for method in METHODS:
        found = library.numpy(rs.interpolate(library.array(q), t, at, method))
        assert found.shape == (3, 7, 5, 4)
        for g in range(5):
            alone = rs.interpolate(q[:, g], t, at, method)
            assert quat.angle_between(found[..., g, :].astype(float), alone).max() < 60 * library.eps


@pytest.mark.parametrize("method", METHODS)
def test_singular_points_are_finite_and_defined(method, rng):
    identity = quat.identity()
    half = np.array(
        [[1.0, 0, 0, 0], [0, 1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 1, 0], [0, 1, 0, 0], [-1, 0, 0, 0]]
    )
    t = np.array([0, 1, 1.001, 5, 5.5, 6, 7])
    same = np.broadcast_to(identity, (4, 4))
    for q, times in ((half, t), (same, np.arange(4.0)), (np.array([[0, 0, 0, 1.0]]), np.zeros(1))):
        at = np.linspace(times[0], times[-1], 400)
        found = rs.interpolate(q, times, at, method)
        np.testing.assert_allclose(np.linalg.norm(found, axis=-1), 1, atol=1e-14)
    np.testing.assert_array_equal(rs.interpolate(same, np.arange(4.0), at * 0 + 1.5, method)[0], identity)


@pytest.mark.parametrize("method", METHODS)
def test_nothing_tears_even_between_wild_keys(method, rng):
    """Steps of up to 140 degrees at uneven times: neighbouring samples stay neighbours."""
    for _ in range(20):
        q, t = track(8, 2.4, rng)
        at = np.linspace(t[0], t[-1], 20001)
        found = rs.interpolate(q, t, at, method)
        assert quat.angle_between(found[:-1], found[1:]).max() < 0.05
        inside = np.diff(np.searchsorted(t, at, side="right")) == 0  # a new span starts with its own key's sign
        dots = np.sum(found[:-1] * found[1:], axis=-1)
        assert np.all(dots[inside] > 0.99)


@pytest.mark.parametrize("method", METHODS)
def test_gradients_flow_to_the_keys(method, torch, rng):
    q, t = track(5, 1.2, rng)
    keys = torch.tensor(q, requires_grad=True)
    at = np.linspace(t[0] + 0.05, t[-1] - 0.05, 6)
    weights = rng.normal(size=(6, 4))

    def value(k):
        return (rs.interpolate(k, t, at, method) * torch.tensor(weights)).sum()

    value(keys).backward()
    for index in ((0, 1), (2, 0), (3, 3), (4, 2)):
        h = 1e-6
        sides = []
        for s in (1, -1):
            moved = q.copy()
            moved[index] += s * h
            sides.append(float(value(torch.tensor(moved))))
        assert float(keys.grad[index]) == pytest.approx((sides[0] - sides[1]) / (2 * h), abs=1e-6)


def test_wrong_input_is_named():
    q = np.broadcast_to(quat.identity(), (3, 4))
    with pytest.raises(ShapeError, match="times_s"):
        rs.squad_controls(q, [0, 1])
    with pytest.raises(ShapeError, match="strictly increasing"):
        rs.log_cubic_controls(q, [0, 1, 1])
    with pytest.raises(ShapeError, match="at least one key"):
        rs.squad_controls(q[:0], [])
    with pytest.raises(UnknownName, match="nearest: 'squad'"):
        rs.interpolate(q, [0, 1, 2], 0.5, "squat")  # pyright: ignore[reportArgumentType]
    with pytest.raises(ShapeError, match="outgoing"):
        rs.controls_of(q, q, q[:2])


CLIENT = """
import { rotationControls, rotationSpline, endVelocities } from MODULE;
import { readFileSync } from "node:fs";
const answers = JSON.parse(readFileSync(0, "utf8")).map(({ method, values, times, us }) => {
  const name = method.replace("_", "-"), keys = Float64Array.from(values.flat()), t = Float64Array.from(times);
  const controls = rotationControls(name, keys, t), rows = [], out = new Float64Array(6);
  for (let s = 0; s < t.length - 1; s++)
    for (const u of us) { rotationSpline(name, keys, controls, s, u, out, 1); rows.push([...out.slice(1, 5)]); }
  return { rows, velocities: [...endVelocities(name, controls, t)] };
});
process.stdout.write(JSON.stringify(answers));
"""


def test_the_browsers_half_is_equal(rng):
    module = (ROOT / "client/src/anim/rotation-splines.ts").as_uri()
    us = [0.0, 0.03, 0.25, 0.5, 0.77, 1.0]
    tasks = [
        (method, *track(count, largest, rng))
        for method in METHODS
        for count, largest in ((1, 1.0), (2, 1.0), (3, 0.01), (5, 1.5), (30, 0.3), (30, 2.0), (12, 2.8))
    ]
    given = [{"method": m, "values": q.tolist(), "times": t.tolist(), "us": us} for m, q, t in tasks]
    done = subprocess.run(
        [node_executable(), "--no-warnings", "--input-type=module", "-e", CLIENT.replace("MODULE", json.dumps(module))],
        input=json.dumps(given), capture_output=True, text=True, timeout=60, check=True,
    )  # fmt: skip
    for (method, q, t), answer in zip(tasks, json.loads(done.stdout), strict=True):
        if len(t) == 1:
            assert answer == {"rows": [], "velocities": []}
            continue
        controls = CONTROLS[method](q, t)
        expected = CURVES[method](q[:-1, None], controls[:, None], np.array(us))
        np.testing.assert_allclose(np.reshape(answer["rows"], expected.shape), expected, atol=1e-12)
        np.testing.assert_array_equal(np.reshape(answer["rows"], expected.shape)[:, 0], q[:-1])
        velocities = np.stack(rs.end_velocities(controls, np.diff(t), method), axis=1)
        np.testing.assert_allclose(np.reshape(answer["velocities"], velocities.shape), velocities, atol=1e-11)
