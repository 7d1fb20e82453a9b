"""The numbers of one picture that both backends share: one row of 4 floats after the other, as in ``frame.glsl``."""

from __future__ import annotations

import numpy as np

from keypose.arrays import Floats
from keypose.render.camera import View
from keypose.render.settings import RenderSettings, encoded

# rows of the packed frame; matrices are stored column by column and take four rows
CLIP_FROM_WORLD, WORLD_FROM_CLIP, LIGHT_FROM_WORLD, WORLD_FROM_LIGHT = 0, 4, 8, 12
EYE, FORWARD, KEY, FILL, RIM, CENTER, FOCUS = 16, 17, 18, 19, 20, 21, 22
KEY_COLOR, FILL_COLOR, RIM_COLOR, SKY_AMBIENT, GROUND_AMBIENT = 23, 24, 25, 26, 27
ZENITH, HORIZON, FLOOR_COLOR, GRID_COLOR, SHADOW_COLOR, PIXELS = 28, 29, 30, 31, 32, 33
ROWS = 34


def pack_frame(view: View, settings: RenderSettings, width: int, height: int) -> Floats:
    """The frame of a view, (ROWS, 4) float32; width and height are of the picture that is drawn, in pixels."""
    theme = settings.colors
    rows = np.zeros((ROWS, 4), np.float64)
    for row, matrix in (
        (CLIP_FROM_WORLD, view.clip_from_world),
        (WORLD_FROM_CLIP, np.linalg.inv(view.clip_from_world)),
        (LIGHT_FROM_WORLD, view.light_from_world),
        (WORLD_FROM_LIGHT, np.linalg.inv(view.light_from_world)),
    ):
        rows[row : row + 4] = matrix.T
    for row, vector, last in (
        (EYE, view.eye, float(view.orthographic)),
        (FORWARD, view.forward, view.floor),
        (KEY, view.key, float(settings.shadows)),
        (FILL, view.fill, theme.grid_strength * settings.grid),
        (RIM, view.rim, float(settings.transparent)),
        (CENTER, view.center, view.radius),
        (FOCUS, view.focus, view.reach),
        (KEY_COLOR, theme.key, view.cell),
        (FILL_COLOR, theme.fill, 0.0),
        (RIM_COLOR, theme.rim, 0.0),
        (SKY_AMBIENT, theme.sky_ambient, 0.0),
        (GROUND_AMBIENT, theme.ground_ambient, 0.0),
        (ZENITH, encoded(theme.zenith), 0.0),
        (HORIZON, encoded(theme.horizon), 0.0),
        (FLOOR_COLOR, encoded(theme.floor), 0.0),
        (GRID_COLOR, encoded(theme.grid), 0.0),
        (SHADOW_COLOR, encoded(theme.shadow), 0.0),
    ):
        rows[row, :3], rows[row, 3] = vector, last
    rows[PIXELS] = (width, height, 1 / width, 1 / height)
    return rows.astype(np.float32)
