"""What a picture should look like: size, camera, theme, overlays, backend."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from keypose.errors import ShapeError, UnknownName

BACKENDS = ("auto", "gl", "cpu")
ARRANGEMENTS = ("auto", "as_is", "row")
MAX_PIXELS = 1 << 26
Rgb: TypeAlias = tuple[float, float, float]
Picture: TypeAlias = NDArray[np.uint8]  # (H, W, 4), rows from top to bottom


def _check_range(name: str, value: float, low: float, high: float) -> None:
    if not (math.isfinite(value) and low <= value <= high):
        raise ShapeError(f"{name}: expected a number from {low:g} to {high:g}, got {value}")


@dataclass(frozen=True, slots=True)
class Camera:
    """Where a picture is taken from; what is not given is chosen so that the whole performance fits.

    Shapes and units:
        azimuth_deg: 0 looks at the face of a character that faces +Z; positive turns to its left side.
        elevation_deg: above the horizon.
        fov_deg: vertical opening angle (not used by an orthographic camera).
        target: (x, y, z) metres to look at; None frames the subject.
        distance: metres from the target; None frames the subject.
        margin: share of the picture left free on every side when framing.
        follow: True moves with the subject, False stays, None follows a subject that travels far.
    """

    azimuth_deg: float = 32.0
    elevation_deg: float = 10.0
    fov_deg: float = 28.0
    orthographic: bool = False
    target: tuple[float, float, float] | None = None
    distance: float | None = None
    margin: float = 0.09
    follow: bool | None = None

    def __post_init__(self) -> None:
        _check_range("azimuth_deg", self.azimuth_deg, -36000, 36000)
        _check_range("elevation_deg", self.elevation_deg, -89.9, 89.9)
        _check_range("fov_deg", self.fov_deg, 1, 150)
        _check_range("margin", self.margin, 0, 0.45)
        if self.distance is not None:
            _check_range("distance", self.distance, 1e-6, 1e9)
        if self.target is not None:
            if len(self.target) != 3:
                raise ShapeError(f"target: expected (x, y, z), got {len(self.target)} numbers")
            for value in self.target:
                _check_range("target", value, -1e9, 1e9)

    @classmethod
    def _at(cls, azimuth_deg: float, elevation_deg: float, changes: Mapping[str, Any]) -> Camera:
        options: dict[str, Any] = {"azimuth_deg": azimuth_deg, "elevation_deg": elevation_deg, **changes}
        return cls(**options)

    @classmethod
    def front(cls, **changes: Any) -> Camera:
        """Straight at the face."""
        return cls._at(0.0, 4.0, changes)

    @classmethod
    def side(cls, **changes: Any) -> Camera:
        """At the character's left side."""
        return cls._at(90.0, 4.0, changes)

    @classmethod
    def back(cls, **changes: Any) -> Camera:
        """At the character's back."""
        return cls._at(180.0, 4.0, changes)

    @classmethod
    def top(cls, **changes: Any) -> Camera:
        """From above."""
        return cls._at(0.0, 80.0, changes)

    @classmethod
    def three_quarter(cls, **changes: Any) -> Camera:
        """Between front and left side, from slightly above: the default."""
        return cls(**changes)

    @classmethod
    def preset(cls, name: str, **changes: Any) -> Camera:
        """A camera by its name: front, side, back, top or three_quarter; raises `UnknownName`."""
        if name not in CAMERA_PRESETS:
            raise UnknownName("camera", name, CAMERA_PRESETS)
        return getattr(cls, name)(**changes)

    def turned(self, angle_deg: float) -> Camera:
        """The same camera, farther around the subject."""
        return replace(self, azimuth_deg=self.azimuth_deg + angle_deg)


CAMERA_PRESETS = ("front", "side", "back", "top", "three_quarter")


def srgb(code: str) -> Rgb:
    """Linear RGB of a colour written as ``"#rrggbb"``."""
    digits = code.removeprefix("#")
    if len(digits) != 6:
        raise ShapeError(f"colour: expected '#rrggbb', got '{code}'")
    values = [int(digits[i : i + 2], 16) / 255 for i in (0, 2, 4)]
    r, g, b = (v / 12.92 if v <= 0.04045 else ((v + 0.055) / 1.055) ** 2.4 for v in values)
    return (r, g, b)


def encoded(color: Rgb) -> Rgb:
    """sRGB values 0..1 of linear RGB, as they are shown."""
    r, g, b = (12.92 * c if c <= 0.0031308 else 1.055 * c ** (1 / 2.4) - 0.055 for c in color)
    return (r, g, b)


@dataclass(frozen=True, slots=True)
class Theme:
    """Colours (linear RGB) and light strengths of the studio in which the subject stands.

    The backdrop runs from ``zenith`` over ``horizon`` to the floor, which is ``floor`` under the subject and
    becomes the horizon farther away. ``grid`` is what a line does to the floor's colour.
    """

    name: str
    zenith: Rgb
    horizon: Rgb
    floor: Rgb
    grid: Rgb
    grid_strength: float
    shadow: Rgb  # colour the floor takes in full shadow
    key: Rgb
    fill: Rgb
    rim: Rgb
    sky_ambient: Rgb
    ground_ambient: Rgb
    clay: Rgb  # surfaces without a material of their own
    bone_left: Rgb
    bone_right: Rgb
    bone_center: Rgb
    text: Rgb


LIGHT = Theme(
    name="light",
    zenith=srgb("#cdd7e3"),
    horizon=srgb("#eef1f5"),
    floor=srgb("#e6e9ee"),
    grid=srgb("#8d99aa"),
    grid_strength=0.42,
    shadow=srgb("#77829a"),
    key=(1.06, 1.02, 0.96),
    fill=(0.17, 0.17, 0.19),
    rim=(0.34, 0.36, 0.40),
    sky_ambient=(0.39, 0.41, 0.45),
    ground_ambient=(0.26, 0.25, 0.24),
    clay=srgb("#c9c3ba"),
    bone_left=srgb("#2f86d6"),
    bone_right=srgb("#e8663f"),
    bone_center=srgb("#6b7686"),
    text=srgb("#3b4656"),
)
DARK = Theme(
    name="dark",
    zenith=srgb("#12151b"),
    horizon=srgb("#2b313b"),
    floor=srgb("#353c48"),
    grid=srgb("#8391a6"),
    grid_strength=0.30,
    shadow=srgb("#0d1015"),
    key=(1.08, 1.03, 0.96),
    fill=(0.12, 0.14, 0.18),
    rim=(0.55, 0.62, 0.74),
    sky_ambient=(0.25, 0.28, 0.33),
    ground_ambient=(0.14, 0.14, 0.15),
    clay=srgb("#c9c3ba"),
    bone_left=srgb("#4aa3f0"),
    bone_right=srgb("#ff8259"),
    bone_center=srgb("#d3d8e0"),
    text=srgb("#d7dde6"),
)
THEMES = {"light": LIGHT, "dark": DARK}


@dataclass(frozen=True, slots=True)
class RenderSettings:
    """All choices of a picture or a film.

    Shapes and units:
        width, height: pixels.
        rate_hz: pictures per second of a film.
        start_s, end_s: the stretch of the animation that a film shows; None is all of it.
        theme: "light", "dark" or a `Theme`.
        transparent: no backdrop; the floor keeps only its shadow.
        mesh, skeleton, joint_axes: what is drawn; bones and axes are drawn over the mesh. A character without a mesh
            always shows its skeleton.
        ghosts_s: times before (negative) and after the shown one, at which the subject is drawn faintly.
        supersample: pictures are drawn this many times larger and reduced; None is 2 for stills and 1 for films.
        backend: "gl" (OpenGL), "cpu" (software), or "auto": OpenGL where there is a driver.
        arrangement: "as_is" keeps the characters where they are, "row" stands them side by side, "auto" does so where
            they would overlap.
        floor: height of the floor in metres; None finds it.
        quality: 0 (small file) to 100 (best) for films.
        sheet_frames: pictures on a contact sheet.
        turntable_s: seconds of one round of a turntable of a still subject.

    Raises:
        ShapeError: where a number is out of range.
        UnknownName: where a theme, backend or arrangement does not exist.
    """

    width: int = 1280
    height: int = 720
    rate_hz: float = 30.0
    start_s: float | None = None
    end_s: float | None = None
    camera: Camera = field(default_factory=Camera)
    theme: str | Theme = "light"
    transparent: bool = False
    mesh: bool = True
    skeleton: bool = False
    joint_axes: bool = False
    ghosts_s: tuple[float, ...] = ()
    grid: bool = True
    ground: bool = True
    shadows: bool = True
    supersample: int | None = None
    backend: str = "auto"
    arrangement: str = "auto"
    floor: float | None = None
    quality: int = 75
    sheet_frames: int = 12
    turntable_s: float = 6.0

    def __post_init__(self) -> None:
        for name, high in (("width", 16384), ("height", 16384), ("sheet_frames", 400)):
            value = getattr(self, name)
            if int(value) != value:
                raise ShapeError(f"{name}: expected a whole number, got {value}")
            _check_range(name, value, 1, high)
        if self.width * self.height > MAX_PIXELS:
            raise ShapeError(f"width x height: expected at most {MAX_PIXELS} pixels, got {self.width}x{self.height}")
        _check_range("rate_hz", self.rate_hz, 0.1, 1000)
        _check_range("quality", self.quality, 0, 100)
        _check_range("turntable_s", self.turntable_s, 0.1, 3600)
        if self.supersample is not None:
            _check_range("supersample", self.supersample, 1, 4)
        for name in ("start_s", "end_s", "floor"):
            value = getattr(self, name)
            if value is not None:
                _check_range(name, value, -1e9, 1e9)
        if self.start_s is not None and self.end_s is not None and self.end_s < self.start_s:
            raise ShapeError(f"end_s: {self.end_s} lies before start_s {self.start_s}")
        if isinstance(self.theme, str) and self.theme not in THEMES:
            raise UnknownName("theme", self.theme, THEMES)
        if self.backend not in BACKENDS:
            raise UnknownName("backend", self.backend, BACKENDS)
        if self.arrangement not in ARRANGEMENTS:
            raise UnknownName("arrangement", self.arrangement, ARRANGEMENTS)

    @property
    def colors(self) -> Theme:
        """The theme's colours."""
        return THEMES[self.theme] if isinstance(self.theme, str) else self.theme
