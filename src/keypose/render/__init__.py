"""Pictures and films of scenes, without a screen."""

from keypose.render.picture import render_image
from keypose.render.settings import Camera, RenderSettings, Theme

__all__ = ["Camera", "RenderSettings", "Theme", "render_image"]
