"""Film files: H.264 in MP4, VP9 in WebM, and GIF; encoded in a thread beside the drawing."""

from __future__ import annotations

import queue
import threading
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from keypose.errors import FormatError
from keypose.render.settings import Picture

# encoders in order of preference, by suffix
_ENCODERS = {".mp4": ("libx264", "libopenh264"), ".webm": ("libvpx-vp9", "libsvtav1", "libaom-av1"), ".gif": ("gif",)}
_QUEUE = 6  # pictures that may wait for the encoder
FILM_SUFFIXES = tuple(_ENCODERS)


def even_size(suffix: str, width: int, height: int) -> tuple[int, int]:
    """The size that a film of that kind can have: video shares its colours among blocks of 2x2 pixels."""
    return (width, height) if suffix == ".gif" else (width + width % 2, height + height % 2)


def find_encoder(suffix: str) -> str:
    """The encoder for a kind of film; raises `FormatError` where the installed PyAV has none."""
    av = _av()
    for name in _ENCODERS[suffix]:
        try:
            av.codec.Codec(name, "w")
        except (ValueError, av.error.FFmpegError):
            continue
        return name
    others = " or ".join(s for s in _ENCODERS if s != suffix)
    raise FormatError(
        f"the installed PyAV has no encoder for {suffix} ({', '.join(_ENCODERS[suffix])}); write {others} instead"
    )


class Film:
    """A film file that is written picture by picture.

    Shapes and units: pictures are (height, width, 4 or 3) uint8 sRGB. ``samples`` are a few of them, for the colours of
    a GIF. Errors of the encoder are raised by the next `add`, or at the end.
    """

    def __init__(
        self,
        path: Path,
        width: int,
        height: int,
        rate_hz: float,
        quality: int = 75,
        samples: Sequence[Picture] = (),
    ) -> None:
        self._av = _av()
        suffix = path.suffix.lower()
        self._size, self._gif = (width, height), suffix == ".gif"
        encoder = find_encoder(suffix)
        self._rate = Fraction(rate_hz).limit_denominator(1001)
        options = {"movflags": "+faststart"} if suffix == ".mp4" else {}
        self._container = self._av.open(str(path), "w", format=suffix[1:], container_options=options)
        stream = self._stream = self._container.add_stream(encoder, rate=self._rate)
        stream.width, stream.height = width, height
        stream.time_base = 1 / self._rate
        if self._gif:
            stream.pix_fmt = "pal8"
            self._palette = _Palette(self._av, width, height, self._rate, samples)
        else:
            stream.pix_fmt = "yuv420p"
            stream.options = _options(encoder, quality)
            context = stream.codec_context
            context.color_range, context.colorspace, context.color_primaries, context.color_trc = 1, 1, 1, 1
        self._count = 0
        self._error: BaseException | None = None
        self._waiting: queue.Queue[Picture | None] = queue.Queue(_QUEUE)
        self._thread = threading.Thread(target=self._work, name="film encoder", daemon=True)
        self._thread.start()

    def __enter__(self) -> Film:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._waiting.put(None)
        self._thread.join()
        try:
            self._container.close()
        except self._av.error.FFmpegError as failed:
            self._error = self._error or failed
        if error is None:
            self._check()

    def add(self, picture: Picture) -> None:
        """The next picture; it must not be changed afterwards."""
        self._check()
        self._waiting.put(picture)

    def _check(self) -> None:
        if self._error is not None:
            raise FormatError(f"the film could not be encoded: {self._error}") from self._error

    def _work(self) -> None:
        while (picture := self._waiting.get()) is not None:
            if self._error is not None:
                continue  # emptying the queue, so that nobody waits
            try:
                self._encode(picture)
            except Exception as error:  # raised again in the drawing thread
                self._error = error
        if self._error is None:
            try:
                self._mux(None)
            except Exception as error:
                self._error = error

    def _encode(self, picture: Picture) -> None:
        frame = _frame(self._av, picture)
        frame.pts, frame.time_base = self._count, 1 / self._rate
        self._count += 1
        if self._gif:
            frame = self._palette.apply(frame)
        else:
            frame = frame.reformat(format="yuv420p", dst_colorspace="ITU709", dst_color_range="MPEG")
            frame.pts, frame.time_base = self._count - 1, 1 / self._rate
        self._mux(frame)

    def _mux(self, frame: Any) -> None:
        for packet in self._stream.encode(frame):
            self._container.mux(packet)


class _Palette:
    """The 255 colours that serve a whole GIF best, and their ordered dithering, which stands still in time."""

    def __init__(self, av: Any, width: int, height: int, rate: Fraction, samples: Sequence[Picture]) -> None:
        self._av = av
        making = av.filter.Graph()
        source = making.add_buffer(width=width, height=height, format="rgba", time_base=1 / rate)
        maker = making.add("palettegen", "stats_mode=full:reserve_transparent=0:max_colors=256")
        sink = making.add("buffersink")
        source.link_to(maker)
        maker.link_to(sink)
        making.configure()
        for index, sample in enumerate(samples):
            frame = _frame(av, sample)
            frame.pts, frame.time_base = index, 1 / rate
            source.push(frame)
        source.push(None)
        self._colors = sink.pull()
        self._rate, self._graph, self._size = rate, None, (width, height)

    def apply(self, frame: Any) -> Any:
        """A picture in the palette's colours."""
        if self._graph is None:
            self._graph = self._build()
        self._source.push(frame)
        return self._sink.pull()

    def _build(self) -> Any:
        graph = self._av.filter.Graph()
        width, height = self._size
        self._source = graph.add_buffer(width=width, height=height, format="rgba", time_base=1 / self._rate)
        colors = graph.add_buffer(width=16, height=16, format=self._colors.format.name, time_base=1 / self._rate)
        user = graph.add("paletteuse", "dither=bayer:bayer_scale=3:diff_mode=rectangle")
        self._sink = graph.add("buffersink")
        self._source.link_to(user, 0, 0)
        colors.link_to(user, 0, 1)
        user.link_to(self._sink)
        graph.configure()
        self._colors.pts, self._colors.time_base = 0, 1 / self._rate
        colors.push(self._colors)
        colors.push(None)
        return graph


def _frame(av: Any, picture: Picture) -> Any:
    if picture.shape[-1] == 3:
        picture = np.concatenate([picture, np.full((*picture.shape[:2], 1), 255, np.uint8)], axis=-1)
    return av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="rgba")


def _options(encoder: str, quality: int) -> dict[str, str]:
    if encoder == "libx264":
        return {"crf": str(round(41 - 0.29 * quality)), "preset": "veryfast"}
    if encoder == "libvpx-vp9":
        speed = {"deadline": "good", "cpu-used": "5", "row-mt": "1", "b": "0"}
        return {"crf": str(round(58 - 0.38 * quality)), **speed}
    if encoder == "libsvtav1":
        return {"crf": str(round(60 - 0.36 * quality)), "preset": "9"}
    if encoder == "libaom-av1":
        return {"crf": str(round(58 - 0.38 * quality)), "cpu-used": "8", "b": "0"}
    return {}


def _av() -> Any:
    import av
    import av.error  # pyright: ignore[reportUnusedImport]
    import av.filter  # pyright: ignore[reportUnusedImport]

    return av
