import numpy as np
import pytest

from keypose.errors import ShapeError, UnknownName
from keypose.render import CAMERA_PRESETS, Camera, RenderSettings
from keypose.render.camera import direction
from keypose.render.settings import encoded, srgb


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"width": 0}, "width"),
        ({"height": 20000}, "height"),
        ({"width": 10.5}, "width"),
        ({"rate_hz": 0}, "rate_hz"),
        ({"rate_hz": float("nan")}, "rate_hz"),
        ({"quality": 101}, "quality"),
        ({"width": 16000, "height": 16000}, "width x height"),
        ({"supersample": 0}, "supersample"),
        ({"start_s": 2.0, "end_s": 1.0}, "end_s"),
        ({"floor": float("inf")}, "floor"),
    ],
)
def test_numbers_out_of_range_are_named(changes, named):
    with pytest.raises(ShapeError, match=named):
        RenderSettings(**changes)


def test_unknown_choices_name_the_nearest():
    with pytest.raises(UnknownName, match="nearest: 'light'"):
        RenderSettings(theme="ligth")
    with pytest.raises(UnknownName, match="nearest: 'auto'"):
        RenderSettings(backend="autos")
    with pytest.raises(UnknownName, match="arrangement"):
        RenderSettings(arrangement="heap")
    with pytest.raises(UnknownName, match="nearest: 'front'"):
        Camera.preset("frnt")


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"fov_deg": 0}, "fov_deg"),
        ({"elevation_deg": 90}, "elevation_deg"),
        ({"margin": 0.5}, "margin"),
        ({"distance": -1}, "distance"),
        ({"target": (0, 1)}, "target"),
        ({"target": (0, 1, float("nan"))}, "target"),
    ],
)
def test_cameras_are_checked(changes, named):
    with pytest.raises(ShapeError, match=named):
        Camera(**changes)


def test_presets_look_from_where_they_say():
    found = {name: Camera.preset(name) for name in CAMERA_PRESETS}
    towards = {name: direction(c.azimuth_deg, c.elevation_deg) for name, c in found.items()}
    assert towards["front"][2] > 0.99  # the character faces +Z: the camera stands there
    assert towards["side"][0] > 0.99  # its left side is +X
    assert towards["back"][2] < -0.99
    assert towards["top"][1] > 0.98
    assert min(towards["three_quarter"]) > 0.1
    assert Camera.preset("front", fov_deg=50).fov_deg == 50


def test_colours_go_to_linear_and_back():
    for code in ("#000000", "#0a0b0c", "#7f8081", "#ffffff", "#e8663f"):
        values = np.rint(np.array(encoded(srgb(code))) * 255).astype(int)
        assert "#" + "".join(f"{v:02x}" for v in values) == code
    assert srgb("#bcbcbc")[0] == pytest.approx(0.5029, abs=1e-4)  # IEC 61966-2-1
    with pytest.raises(ShapeError, match="#rrggbb"):
        srgb("#fff")
