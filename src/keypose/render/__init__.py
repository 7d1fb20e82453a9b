"""Pictures, contact sheets, turntables and films of scenes, without a screen."""

from keypose.render.picture import contact_sheet, render_file, render_frames, render_image
from keypose.render.settings import CAMERA_PRESETS, DARK, LIGHT, Camera, RenderSettings, Theme
from keypose.render.stage import REST

__all__ = [
    "CAMERA_PRESETS",
    "DARK",
    "LIGHT",
    "REST",
    "Camera",
    "RenderSettings",
    "Theme",
    "contact_sheet",
    "render_file",
    "render_frames",
    "render_image",
]
