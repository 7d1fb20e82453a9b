"""One picture or a stream of pictures of a scene."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from keypose.arrays import Floats
from keypose.model import Scene
from keypose.render.camera import Framing
from keypose.render.settings import RenderSettings
from keypose.render.stage import Animation, Stage


def render_image(
    scene: Scene,
    animation: str | Animation | Sequence[Animation | None] | None = None,
    time_s: float = 0.0,
    settings: RenderSettings | None = None,
) -> Floats:
    """A picture of a scene at one time, (height, width, 4) uint8 sRGB with straight alpha."""
    settings = settings or RenderSettings()
    stage = Stage(scene, animation, settings)
    framing = Framing(stage, settings.camera, settings.width / settings.height)
    renderer = make_renderer(stage, settings, settings.supersample or 2)
    try:
        times = np.array([time_s], np.float64)
        return np.array(renderer.draw(stage.moments(times)[0], framing.views(times)[0]))
    finally:
        renderer.close()


def make_renderer(stage: Stage, settings: RenderSettings, supersample: int) -> Any:
    from keypose.render.gl import GlRenderer

    return GlRenderer(stage, settings, supersample)
