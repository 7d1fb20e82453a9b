"""Squash and stretch: the volume is kept at every moment, the shape follows the path, contacts are found."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from keypose import evaluate, samples
from keypose.editing.selection import Selection
from keypose.editing.squash import squash_and_stretch, stretch_matrices, trajectory_deformation, volume_error
from keypose.errors import ShapeError, UnknownName
from keypose.model import Channel, Clip, Curve, Interpolation, Pose, Property, Skeleton

SCALE = Channel("Squash", Property.SCALE)
PATH = Channel("Ball", Property.TRANSLATION)


def bounce():
    return samples.load("bounce").animations[0]


def body():
    return samples.load("ball").character


@pytest.mark.parametrize("size", [2, 3])
def test_matrices_are_exponentials_of_determinant_one(size, rng):
    strain = rng.normal(size=200)
    axes = rng.normal(size=(200, size))
    axes /= np.linalg.norm(axes, axis=-1, keepdims=True)
    found = stretch_matrices(strain, axes)
    np.testing.assert_allclose(np.linalg.det(found), 1, rtol=1e-13)
    for s, d, m in zip(strain[:20], axes, found, strict=False):
        exponent = s * (size * np.outer(d, d) - np.eye(size)) / (size - 1)
        np.testing.assert_allclose(m, expm(exponent), atol=1e-13)
    np.testing.assert_allclose(np.einsum("nij,nj->ni", found, axes), np.exp(strain)[:, None] * axes, atol=1e-13)


def test_the_mesh_keeps_its_volume_at_any_moment(rng):
    """By the divergence theorem on the deformed triangles, at moments that are no keys."""
    ball = body()
    triangles = np.concatenate([p.mesh.positions[p.mesh.triangles] for p in ball.parts])

    def volume(points):
        return (
            np.einsum("...i,...i->...", points[..., 0, :], np.cross(points[..., 1, :], points[..., 2, :])).sum(-1) / 6
        )

    times = np.sort(rng.uniform(0, bounce().end_s, 400))
    pose = evaluate.sample_clip(bounce(), ball.skeleton, times)
    pose = Pose(*(np.asarray(a, np.float64) for a in (pose.translations, pose.rotations, pose.scales)))
    model = evaluate.world(ball.skeleton, pose)[:, 3]
    moved = triangles.astype(np.float64) @ np.swapaxes(model[:, :3, :3], -1, -2)[:, None] + model[:, None, None, :3, 3]
    np.testing.assert_allclose(volume(moved), volume(triangles.astype(np.float64)), rtol=1e-6)
    np.testing.assert_allclose(np.linalg.det(model[:, :3, :3]), 1, atol=1e-6)


def test_scales_are_smooth_keys_that_keep_the_volume():
    scales = bounce().curves[SCALE]
    assert volume_error(scales) < 1e-6
    dense = evaluate.sample_curve(scales, np.linspace(0, scales.times_s[-1], 200_001))
    assert np.abs(np.prod(dense, axis=-1) - 1).max() < 1e-6
    assert dense[:, 1].max() > 1.2 and dense[:, 1].min() < 0.75


@pytest.mark.parametrize(
    "stretch, squash, contact", [(1.0, 1.5, 0.02), (0.0, 1.5, 0.05), (0.5, 0.0, 0.0), (0.9, 1.2, 0.4)]
)
def test_the_volume_is_kept_however_wild(stretch, squash, contact):
    plain = Clip({PATH: bounce().curves[PATH]}, rate_hz=25)
    made = squash_and_stretch(plain, body().skeleton, stretch=stretch, squash=squash, contact_s=contact)
    assert volume_error(made.curves[SCALE]) < 1e-6


def test_stretched_along_the_path_and_flat_on_the_ground():
    clip, skeleton = bounce(), body().skeleton
    at = np.arange(0.02, 3.0, 0.003)
    model = evaluate.world(skeleton, evaluate.sample_clip(clip, skeleton, at))[:, 3, :3, :3].astype(float)
    path = clip.curves[PATH]
    velocity = (evaluate.sample_curve(path, at + 1e-4) - evaluate.sample_curve(path, at - 1e-4)) / 2e-4
    speed = np.linalg.norm(velocity, axis=-1)
    strain = model @ np.swapaxes(model, -1, -2)
    length, axis = np.linalg.eigh(strain)
    flying = evaluate.sample_curve(path, at)[:, 1] > 0.25 + 0.12
    long = flying & (speed > 2.0)
    cosine = np.abs(np.einsum("ni,ni->n", axis[..., 2], velocity / speed[:, None]))
    assert long.sum() > 50 and np.degrees(np.arccos(np.clip(cosine[long], 0, 1))).max() < 1.0
    assert np.all(np.sqrt(length[long, 2]) > 1.03)
    down = np.nonzero((at > 0.54) & (at < 0.58))[0]
    assert np.all(np.abs(axis[down, 1, 0]) > 0.999) and np.all(np.sqrt(length[down, 0]) < 0.8)
    # it rests on the ground while it is flat
    lowest = evaluate.world(skeleton, evaluate.sample_clip(clip, skeleton, at))[down, 1, 1, 3]
    np.testing.assert_allclose(lowest, 0, atol=1e-6)


def test_contacts_are_found_where_the_keys_are():
    path = bounce().curves[PATH]
    times = np.linspace(0, path.times_s[-1], 2400)
    found = trajectory_deformation(times, evaluate.sample_curve(path, times), breaks_s=path.times_s)
    np.testing.assert_allclose(found.impacts_s[:2], [0.56, 1.52], atol=1e-9)  # the middles of the first two touches
    assert len(found.impacts_s) >= 4
    circle = np.stack([np.cos(times), np.sin(times)], axis=-1)
    smooth = trajectory_deformation(times, circle)
    assert len(smooth.impacts_s) == 0 and np.ptp(smooth.strain[5:-5]) < 1e-3
    wall = np.stack([np.abs(times - 2.0), 0 * times], axis=-1)  # in two dimensions, against a wall at 2 s
    hit = trajectory_deformation(times, wall, 0.2, 0.5)
    assert hit.impacts_s == pytest.approx([2.0], abs=3e-3)
    worst = int(np.argmin(hit.strain))
    assert hit.strain[worst] == pytest.approx(-0.5, abs=0.05) and abs(hit.axes[worst, 0]) > 0.999


def test_what_stands_still_keeps_its_shape():
    still = trajectory_deformation(np.linspace(0, 1, 50), np.zeros((50, 3)))
    assert np.all(still.strain == 0) and len(still.impacts_s) == 0


def test_without_a_joint_that_turns_the_own_axes_share_the_strain():
    skeleton = Skeleton(("Box",), np.array([-1]), Pose(np.zeros((1, 3)), [[1.0, 0, 0, 0]], [[2.0, 2.0, 2.0]]))
    path = Curve([0, 1], [[0.0, 0, 0], [3, 3, 0]], Interpolation.LINEAR)
    made = squash_and_stretch(Clip({Channel("Box", Property.TRANSLATION): path}), skeleton, stretch=0.3)
    scales = made.curves[Channel("Box", Property.SCALE)]
    assert volume_error(scales, np.array([2.0, 2, 2])) < 1e-6
    middle = evaluate.sample_curve(scales, 0.5) / 2
    np.testing.assert_allclose(middle, np.exp([0.075, 0.075, -0.15]), rtol=1e-6)


def test_the_amounts_are_amounts():
    plain = Clip({PATH: bounce().curves[PATH]}, rate_hz=25)
    none = squash_and_stretch(plain, body().skeleton, stretch=0.0, squash=0.0)
    np.testing.assert_array_equal(none.curves[SCALE].values, 1)
    part = squash_and_stretch(plain, body().skeleton, Selection(start_s=1.0, end_s=2.0))
    assert part.curves[SCALE].times_s[0] == 1.0 and part.curves[SCALE].times_s[-1] == 2.0


def test_wrong_input_is_named():
    with pytest.raises(ShapeError, match="2 or 3 components"):
        trajectory_deformation(np.arange(5.0), np.zeros((5, 4)))
    with pytest.raises(ShapeError, match="rising"):
        trajectory_deformation(np.zeros(5), np.zeros((5, 3)))
    with pytest.raises(ShapeError, match="squash: expected 0 or more"):
        trajectory_deformation(np.arange(5.0), np.zeros((5, 3)), squash=-1)
    with pytest.raises(UnknownName, match="nearest: 'Ball'"):
        squash_and_stretch(bounce(), body().skeleton, joint="Bal")
