"""Markers as dots: where they are seen, gone where not, and nothing else needs to be known to draw them."""

from __future__ import annotations

import numpy as np
import pytest

from keypose.errors import ShapeError
from keypose.model import Markers, Scene
from keypose.render import RenderSettings, render_image
from keypose.render.dots import marker_scene
from keypose.render.settings import LIGHT


def _markers() -> Markers:
    positions = np.zeros((5, 4, 3))
    positions[..., 0] = (-0.5, 0.5, 0.0, 3.0)
    positions[..., 1] = 1.0 + 0.1 * np.arange(5)[:, None]
    positions[1:3, 0] = np.nan
    positions[:, 2] = np.nan
    return Markers(("LWRA", "RWRA", "never", "*1"), positions, 30.0)


def test_each_marker_has_a_dot_that_follows_it() -> None:
    markers = _markers()
    scene = marker_scene(markers, LIGHT)
    motion = scene.animation()
    # a middle, and the markers that are labelled and seen at all
    assert [name.split()[-1] for name in motion.joint_names] == ["middle", "LWRA", "RWRA"]
    seen = markers.visible[:, 0]
    np.testing.assert_allclose(motion.pose.translations[seen, 1], markers.positions[seen, 0])
    np.testing.assert_allclose(motion.pose.translations[:, 2], markers.positions[:, 1])
    # a gap is filled from the nearest side, and hidden
    np.testing.assert_allclose(motion.pose.translations[1:3, 1], markers.positions[[0, 3], 0])
    assert (motion.pose.scales[1:3, 1] < 0.01).all() and (motion.pose.scales[seen, 1] == 1).all()


def test_a_picture_shows_the_dots_in_their_colours() -> None:
    settings = RenderSettings(width=160, height=120, backend="cpu")
    scene = Scene(markers=(_markers(),))

    def colored(time_s: float, left: bool) -> int:
        picture = render_image(scene, time_s=time_s, settings=settings)[..., :3].astype(int)
        red, blue = picture[..., 0], picture[..., 2]
        return int(((blue - red if left else red - blue) > 60).sum())

    assert colored(0.0, True) > 5 and colored(0.0, False) > 5
    assert colored(1 / 30, True) == 0 and colored(1 / 30, False) > 5  # the left one is not seen there


def test_markers_that_are_never_seen() -> None:
    empty = Scene(markers=(Markers(("A",), np.full((3, 1, 3), np.nan), 30.0),))
    with pytest.raises(ShapeError, match="ever seen"):
        render_image(empty)
