"""Pictures, contact sheets, turntables and films of a scene."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import Any, Protocol, TypeAlias

import numpy as np

from keypose.arrays import Floats
from keypose.errors import FormatError, ShapeError
from keypose.io.atomic import replacing
from keypose.model import Scene
from keypose.render.camera import Framing, View
from keypose.render.film import FILM_SUFFIXES, Film, even_size, find_encoder
from keypose.render.settings import Picture, RenderSettings
from keypose.render.sheet import compose, layout
from keypose.render.stage import Animation, Moment, Stage

Play: TypeAlias = str | Animation | Sequence[Animation | None] | None
Progress: TypeAlias = Callable[[int, int], None]

_CHUNK = 64  # moments that are evaluated together
_GIF_SAMPLES = 16  # pictures that decide a GIF's colours


class Renderer(Protocol):
    """What draws: `keypose.render.gl.GlRenderer` or `keypose.render.cpu.CpuRenderer`."""

    name: str

    def draw(self, moment: Moment, view: View) -> Picture:
        """One picture, (H, W, 4) uint8 sRGB with straight alpha."""
        ...

    def close(self) -> None:
        """Give memory back."""
        ...


def render_image(
    scene: Scene, animation: Play = None, time_s: float = 0.0, settings: RenderSettings | None = None
) -> Picture:
    """A picture of a scene at one time.

    Shapes and units: returns (height, width, 4) uint8 sRGB with straight alpha; ``animation`` is the name of one of the
    scene's animations, a `Clip` or `Motion`, or one of these (or None) for each character; not given, the scene's first
    one. `REST` shows the rest pose. The camera frames this moment, or the stretch from ``start_s`` to ``end_s`` if given.

    Raises:
        ShapeError, UnknownName: where the scene has nothing to draw, or an animation does not exist.
    """
    settings = settings or RenderSettings()
    if settings.start_s is None and settings.end_s is None:
        settings = replace(settings, start_s=time_s, end_s=time_s)  # frame this moment, not the whole performance
    stage = Stage(scene, animation, settings)
    framing = Framing(stage, settings.camera, settings.width / settings.height)
    renderer = make_renderer(stage, settings, settings.supersample or 2)
    try:
        return next(_pictures(stage, framing, renderer, np.array([time_s], np.float64)))
    finally:
        renderer.close()


def render_frames(
    scene: Scene, animation: Play = None, settings: RenderSettings | None = None
) -> Iterator[tuple[float, Picture]]:
    """The time and picture (height, width, 4) of every frame of an animation, one after the other."""
    settings = settings or RenderSettings()
    stage = Stage(scene, animation, settings)
    framing = Framing(stage, settings.camera, settings.width / settings.height)
    renderer = make_renderer(stage, settings, settings.supersample or 1)
    times = stage.frame_times()
    try:
        for time_s, picture in zip(times, _pictures(stage, framing, renderer, times), strict=True):
            yield float(time_s), picture
    finally:
        renderer.close()


def contact_sheet(
    scene: Scene,
    animation: Play = None,
    settings: RenderSettings | None = None,
    turntable: bool = False,
    progress: Progress | None = None,
) -> Picture:
    """One page (height, width, 4) uint8 of evenly spaced frames with their numbers.

    A still subject, or one on a ``turntable``, is shown from all sides instead, with the angles.
    """
    settings = settings or RenderSettings()
    stage = Stage(scene, animation, settings)
    times = stage.frame_times()
    around = turntable or len(times) == 1
    if around:
        count = settings.sheet_frames
        angles = np.arange(count) * (360 / count)
        labels = [f"{angle:.0f}°" for angle in angles]
        times = np.full(count, times[0])
    else:
        count = min(settings.sheet_frames, len(times))
        frames = np.unique(np.rint(np.linspace(0, len(times) - 1, count)).astype(int))
        angles, times = np.zeros(len(frames)), times[frames]
        labels = [f"{frame}   {time:.2f} s" for frame, time in zip(frames, times, strict=True)]
    framing = Framing(stage, settings.camera, 1.0, turning=around)
    grid = layout(len(times), settings.width, settings.height, framing.aspect * 1.12)
    cell = replace(settings, width=grid.cell[0], height=grid.cell[1])
    framing = Framing(stage, settings.camera, grid.cell[0] / grid.cell[1], turning=around)
    renderer = make_renderer(stage, cell, settings.supersample or 2)
    try:
        pictures: list[Picture] = []
        for picture in _pictures(stage, framing, renderer, times, angles):
            pictures.append(picture)
            if progress:
                progress(len(pictures), len(times))
    finally:
        renderer.close()
    return compose(pictures, labels, settings.width, settings.height, grid, settings.colors)


def render_file(
    scene: Scene,
    path: str | PathLike[str],
    animation: Play = None,
    time_s: float | None = None,
    settings: RenderSettings | None = None,
    sheet: bool = False,
    turntable: bool = False,
    progress: Progress | None = None,
) -> tuple[str, ...]:
    """Draw a scene into a file chosen by its suffix: .png, .gif, .mp4 or .webm; returns notes of what was changed.

    ``time_s`` is the moment of a still picture (and of a turntable's still subject); ``sheet`` makes a contact sheet;
    ``turntable`` goes once round the subject; ``progress`` is called with (pictures done, pictures in all).

    Raises:
        FormatError: where the suffix is not one of these, the place is not writable, or an encoder is missing.
        ShapeError, UnknownName: as `render_image`.
    """
    settings, path = settings or RenderSettings(), Path(path)
    suffix = path.suffix.lower()
    if suffix != ".png" and suffix not in FILM_SUFFIXES:
        raise FormatError(f"expected a file name ending in .png, {', '.join(FILM_SUFFIXES)}, got '{suffix}'", path=path)
    if sheet and suffix != ".png":
        raise FormatError(f"a contact sheet is one picture; expected a .png, got '{suffix}'", path=path)
    if suffix in FILM_SUFFIXES:
        try:
            find_encoder(suffix)
        except FormatError as error:
            raise error.at(path) from None
        return _render_film(scene, path, animation, time_s, settings, turntable, progress)
    if sheet or turntable:
        if time_s is not None:
            settings = replace(settings, start_s=time_s, end_s=time_s)
        picture = contact_sheet(scene, animation, settings, turntable, progress)
    else:
        if time_s is None:
            time_s = Stage(scene, animation, settings).start_s
        picture = render_image(scene, animation, time_s, settings)
    with replacing(path) as temporary:
        write_png(picture, temporary, opaque=not settings.transparent)
    return ()


def write_png(picture: Picture, path: Path, opaque: bool = True) -> None:
    """A picture (H, W, 4) uint8 as PNG; ``opaque`` leaves the alpha channel out."""
    from PIL import Image

    Image.fromarray(np.ascontiguousarray(picture[..., :3]) if opaque else picture).save(path, "png")


def make_renderer(stage: Stage, settings: RenderSettings, supersample: int) -> Renderer:
    """The backend that the settings ask for; "auto" takes OpenGL where there is a driver, else the software rasteriser."""
    if settings.backend != "cpu":
        from keypose.render.gl import GlRenderer, NoDriverError

        try:
            return GlRenderer(stage, settings, supersample)
        except NoDriverError:
            if settings.backend == "gl":
                raise
    from keypose.render.cpu import CpuRenderer

    return CpuRenderer(stage, settings, supersample)


def _render_film(
    scene: Scene,
    path: Path,
    animation: Play,
    time_s: float | None,
    settings: RenderSettings,
    turntable: bool,
    progress: Progress | None,
) -> tuple[str, ...]:
    notes: list[str] = []
    suffix = path.suffix.lower()
    width, height = even_size(suffix, settings.width, settings.height)
    if (width, height) != (settings.width, settings.height):
        notes.append(f"{settings.width}x{settings.height} became {width}x{height}: video needs even numbers of pixels")
    if settings.transparent:
        notes.append(f"{suffix} has no transparency here: the backdrop is drawn")
    settings = replace(settings, width=width, height=height, transparent=False)
    stage = Stage(scene, animation, settings)
    framing = Framing(stage, settings.camera, width / height, turning=turntable)
    times, angles = stage.frame_times(), None
    if turntable:
        count = max(2, round(settings.turntable_s * settings.rate_hz))
        angles = np.arange(count) * (360 / count)
        elapsed = np.arange(count) / settings.rate_hz
        if time_s is not None or len(times) == 1:
            times = np.full(count, stage.start_s if time_s is None else time_s)
        else:
            times = stage.start_s + np.mod(elapsed, max(stage.end_s - stage.start_s, 1 / settings.rate_hz))
    elif time_s is not None:
        times = np.array([time_s], np.float64)
    if not np.all(np.isfinite(times)):
        raise ShapeError("time_s: expected a finite number")
    renderer = make_renderer(stage, settings, settings.supersample or 1)
    try:
        samples: list[Picture] = []
        if suffix == ".gif":
            some = np.unique(np.rint(np.linspace(0, len(times) - 1, _GIF_SAMPLES)).astype(int))
            samples = list(_pictures(stage, framing, renderer, times[some], None if angles is None else angles[some]))
        with (
            replacing(path) as temporary,
            Film(temporary, width, height, settings.rate_hz, settings.quality, samples) as film,
        ):
            for done, picture in enumerate(_pictures(stage, framing, renderer, times, angles), 1):
                film.add(picture)
                if progress:
                    progress(done, len(times))
    except FormatError as error:
        raise (error if error.path else error.at(path)) from None
    finally:
        renderer.close()
    return tuple(notes)


def _pictures(
    stage: Stage, framing: Framing, renderer: Renderer, times_s: Floats, angles_deg: Any = None
) -> Iterator[Picture]:
    for start in range(0, len(times_s), _CHUNK):
        part = slice(start, start + _CHUNK)
        views = framing.views(times_s[part], None if angles_deg is None else angles_deg[part])
        for moment, view in zip(stage.moments(times_s[part]), views, strict=True):
            yield renderer.draw(moment, view)
