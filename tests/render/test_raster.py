"""The software rasteriser's geometry."""

import numpy as np
import pytest

from keypose.render import raster
from keypose.render.shade import barycentric

W, H = 64, 48


def draw(clip, triangles, offsets=raster.OFFSETS_4):
    clip, triangles = np.asarray(clip, np.float64), np.asarray(triangles, np.int32)
    setups = np.empty((len(triangles), raster.COLUMNS))
    raster.set_up(clip, triangles, W, H, setups)
    depth = np.ones((H, W, len(offsets)), np.float32)
    visible = np.full((H, W, len(offsets)), -1, np.int32)
    touched = np.tile([W, 0], (H, 1)).astype(np.int64)
    for t in range(len(triangles)):
        raster.draw_triangle(setups[t], t, offsets, len(offsets), 0.5, 0, H, depth, visible, touched)
    return setups, depth, visible, touched


def square(z, w=1.0):
    return [[-w, -w, z * w, w], [w, -w, z * w, w], [w, w, z * w, w], [-w, w, z * w, w]]


def test_a_mesh_leaves_no_gaps():
    random = np.random.default_rng(0)
    # a grid of jittered corners over more than the picture, each cell cut into two triangles
    n = 12
    x, y = np.meshgrid(np.linspace(-1.3, 1.3, n), np.linspace(-1.3, 1.3, n))
    jitter = random.uniform(-0.08, 0.08, (2, n, n))
    w = random.uniform(0.5, 3.0, n * n)
    corners = np.stack([(x + jitter[0]).ravel() * w, (y + jitter[1]).ravel() * w, 0 * w, w], axis=1)
    cells = [
        (j * n + i, j * n + i + 1, (j + 1) * n + i, (j + 1) * n + i + 1) for j in range(n - 1) for i in range(n - 1)
    ]
    _, _, visible, _ = draw(corners, [t for a, b, c, d in cells for t in ((a, b, d), (a, d, c))])
    assert (visible >= 0).all()


def test_the_share_of_samples_is_the_area():
    # in the units of the picture: half of 40 x 30 pixels
    x0, y0, x1, y1 = 10, 8, 50, 38
    ndc = [[2 * x / W - 1, 1 - 2 * y / H, 0, 1] for x, y in ((x0, y0), (x1, y0), (x0, y1))]
    for offsets in (raster.OFFSETS_4, raster.OFFSETS_8):
        _, _, visible, _ = draw(ndc, [[0, 1, 2]], offsets)
        assert (visible >= 0).mean() * W * H == pytest.approx(600, rel=0.01)


def test_the_nearest_wins_in_any_order():
    corners = square(0.5) + square(-0.2)
    near = [[4, 5, 6], [4, 6, 7]]
    far = [[0, 1, 2], [0, 2, 3]]
    for triangles, winners in ((near + far, {0, 1}), (far + near, {2, 3})):
        _, depth, visible, _ = draw(corners, triangles)
        assert set(np.unique(visible)) == winners
        np.testing.assert_allclose(depth, -0.2, atol=1e-6)


def test_interpolation_is_perspective_correct():
    # a floor running away from the eye: at a pixel, the point of the plane that the pixel's ray hits
    plane = np.array([[-3.0, -1, -1], [3, -1, -1], [3, -1, -9], [-3, -1, -9]])
    f = 1.5
    clip = np.stack([f * plane[:, 0], f * plane[:, 1], -plane[:, 2] - 1.5, -plane[:, 2]], axis=1)
    setups, _, visible, _ = draw(clip, [[0, 1, 2], [0, 2, 3]])
    checked = 0
    for y, x, s in np.argwhere(visible >= 0)[::37]:
        t = visible[y, x, s]
        px, py = x + 0.5, y + 0.5
        ndc = np.array([2 * px / W - 1, 1 - 2 * py / H])
        depth = f / -ndc[1]  # where the ray is at height -1
        if not 1.2 < depth < 8.5:
            continue
        corners = plane[[[0, 1, 2], [0, 2, 3]][t]]
        point = np.array(barycentric(setups[t], px, py)) @ corners
        np.testing.assert_allclose(point, [ndc[0] * depth / f, -1, -depth], atol=1e-9 * depth + 1e-9)
        checked += 1
    assert checked > 20


def test_what_lies_behind_the_eye_does_not_show():
    behind = square(0.0, w=-1.0)
    assert (draw(behind, [[0, 1, 2], [0, 2, 3]])[2] < 0).all()
    # one corner behind: what is before the eye shows, and only that
    crossing = [[-0.5, -0.5, 0.0, 1.0], [0.5, -0.5, 0.0, 1.0], [0.0, -0.5, 0.0, -1.0]]
    _, _, visible, _ = draw(crossing, [[0, 1, 2]])
    shown = np.argwhere(visible >= 0)
    assert len(shown)
    assert shown[:, 0].min() >= H * 3 // 4 - 1  # below the edge at y = -0.5, where the plane runs off to infinity


def test_degenerate_and_broken_triangles_are_left_out():
    corners = [*square(0.0), [np.nan, 0, 0, 1], [np.inf, 0, 0, 1], [1e200, 1e200, 0, 1e200]]
    _, _, visible, touched = draw(corners, [[0, 0, 1], [0, 1, 1], [0, 1, 4], [0, 2, 5], [0, 1, 6]])
    assert (visible < 0).all() or set(np.unique(visible)) <= {-1, 4}
    assert touched[:, 0].min() >= 0
    assert touched[:, 1].max() <= W


def test_touched_rows_hold_everything_drawn():
    random = np.random.default_rng(3)
    for _ in range(20):
        corners = np.concatenate([random.uniform(-1.5, 1.5, (3, 2)), np.zeros((3, 1)), np.ones((3, 1))], axis=1)
        _, _, visible, touched = draw(corners, [[0, 1, 2]])
        for y, x, _ in np.argwhere(visible >= 0):
            assert touched[y, 0] <= x < touched[y, 1]


def test_bins_hold_every_triangle_once_per_band():
    random = np.random.default_rng(4)
    corners = np.concatenate([random.uniform(-1, 1, (90, 2)), np.zeros((90, 1)), np.ones((90, 1))], axis=1)
    triangles = np.arange(90, dtype=np.int32).reshape(-1, 3)
    setups = np.empty((30, raster.COLUMNS))
    raster.set_up(corners, triangles, W, H, setups)
    starts, members = raster.bin_triangles(setups, 16, 3)
    for band in range(3):
        expected = [
            t
            for t in range(30)
            if setups[t, raster.TOP] // 16 <= band <= setups[t, raster.BOTTOM] // 16
            and setups[t, raster.BOTTOM] >= setups[t, raster.TOP]
        ]
        assert members[starts[band] : starts[band + 1]].tolist() == expected


def test_a_blur_keeps_the_sum_and_is_even():
    plane = np.zeros((32, 32, 1), np.float32)
    plane[16, 15] = 1.0
    out = np.zeros_like(plane)
    weights = np.exp(-0.5 * (np.arange(9) / 3.0) ** 2)
    raster.blur(plane, weights / (weights[0] + 2 * weights[1:].sum()), out)
    assert out.sum() == pytest.approx(1, abs=1e-5)
    np.testing.assert_allclose(out[16, 15 - 8 : 15 + 9, 0], out[16 - 8 : 16 + 9, 15, 0], atol=1e-7)
