"""Sight through voxels and past triangles against plain calculations."""

from __future__ import annotations

import numpy as np

from keypose.deform.weights_sight import sight_of
from keypose.deform.weights_solid import Solid, solid_of
from keypose.deform.weights_surface import weld
from tests.deform.test_weights import joined, shifted, tube


def test_triangles_block_as_linear_algebra_says() -> None:
    """In a box that is all solid, only triangles are in the way."""
    mesh = tube(rings=9, around=11)
    surface = weld([mesh])
    solid = Solid(np.ones((30, 12, 14), bool), np.array([-0.5, -0.8, -0.9]), 0.17)
    rng = np.random.default_rng(5)
    points = rng.integers(0, len(surface.points), 1500)
    goals = rng.uniform([0.1, -0.7, -0.8], [4.3, 1.1, 1.3], (1500, 3))
    seen = sight_of(surface, solid).sees(points, goals)
    a, b, c = (surface.points[surface.triangles[:, k]] for k in range(3))
    starts = surface.points[points]
    # start + t (goal - start) = a + u (b - a) + v (c - a)
    columns = np.broadcast_arrays((goals - starts)[:, None], (a - b)[None], (a - c)[None])
    t, u, v = np.moveaxis(np.linalg.solve(np.stack(columns, axis=-1), (a - starts[:, None])[..., None])[..., 0], -1, 0)
    through = (t > 0) & (t < 1) & (u >= 0) & (v >= 0) & (u + v <= 1)
    through &= (surface.triangles[None] != points[:, None, None]).all(axis=-1)
    assert 0.1 < seen.mean() < 0.9
    assert (seen == through.any(axis=1)).mean() < 2e-3  # ways through an edge may go either way


def test_a_hair_between_two_bodies_is_seen() -> None:
    """Two tubes far closer than a voxel: nothing on one is seen from the other."""
    one = tube(rings=9)
    gap = 1e-4
    two = joined(one, type(one)(shifted(one.positions, 0, 0, 1.0 + gap), one.triangles))
    surface = weld([two])
    solid = solid_of(surface, 100_000)
    assert solid.voxel_m > 50 * gap
    sight = sight_of(surface, solid)
    mine = np.nonzero(surface.points[:, 2] < 0.5 + gap / 2)[0]
    inside = np.stack([np.clip(surface.points[mine, 0], 0.1, 3.9), *np.zeros((2, len(mine)))], axis=1)
    assert sight.sees(mine, inside).mean() > 0.99
    across = shifted(inside, 0, 0, 1.0 + gap)
    leaving = surface.points[mine, 2] < 0.4  # a way from the touching line itself crosses nothing of its own shell
    assert not sight.sees(mine[leaving], across[leaving]).any()


def test_what_is_not_solid_blocks_open_shells() -> None:
    mesh = tube(closed=False)
    surface = weld([mesh])
    solid = solid_of(surface, 200_000)
    sight = sight_of(surface, solid)
    middle = np.nonzero(np.abs(surface.points[:, 0] - 2.0) < 0.5)[0]
    on_axis = surface.points[middle] * [1, 0, 0]
    assert sight.sees(middle, on_axis).all()
    assert not sight.sees(middle, surface.points[middle] * [1, 2, 2]).any()
    assert not sight.sees(middle, shifted(on_axis, 40, 0, 0)).any()  # out of the box
