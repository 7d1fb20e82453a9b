"""The quality of a motion as a strip of time: contacts, sliding, sinking and floating, jerks and pops."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from keypose.analysis.ground import true_runs
from keypose.analysis.quality import Quality, QualityTracks
from keypose.arrays import Floats
from keypose.errors import ShapeError

_DRAWN = 2  # drawn so many times as large, then made smaller: edges are smooth


@dataclass(frozen=True, slots=True)
class _Colors:
    page: str
    panel: str
    line: str
    text: str
    dim: str
    left: str
    right: str
    bad: str
    air: str


_THEMES = {
    "light": _Colors("#f4f6f9", "#ffffff", "#dfe4eb", "#1d2733", "#6b7888", "#2f6fd6", "#e0653a", "#c62842", "#f3d9a4"),
    "dark": _Colors("#12161c", "#1a2029", "#2c3542", "#e8edf4", "#8d9bad", "#5b9bff", "#ff8a5c", "#ff5a70", "#6b5526"),
}


def draw_quality(
    tracks: QualityTracks, quality: Quality, name: str = "", *, width: int = 1400, theme: str = "light"
) -> np.ndarray:
    """A picture (H, W, 4) uint8 of what feet and jerks do over time.

    Bars are contacts of heels (thin) and balls (thick); the curve under them is how fast the foot that stands slides, then how
    deep feet sink, where the body floats, and the steps of acceleration, with pops marked.

    Raises:
        ShapeError: for an unknown theme, or fewer than 320 pixels of width.
    """
    if theme not in _THEMES or width < 320:
        raise ShapeError(
            f"chart: expected a theme of {', '.join(_THEMES)} and a width of 320 or more, got {theme} and {width}"
        )
    return _Chart(tracks, quality, name, width * _DRAWN, _THEMES[theme]).picture()


class _Chart:
    def __init__(self, tracks: QualityTracks, quality: Quality, name: str, width: int, colors: _Colors) -> None:
        from PIL import Image, ImageDraw, ImageFont

        self.tracks, self.quality, self.colors = tracks, quality, colors
        self.unit = max(_DRAWN, round(width / 700))  # about a pixel of a page 700 wide
        u = self.unit
        self.left, self.right = 92 * u, width - 14 * u
        self.frames = len(tracks.jerk_m_s3)
        heights = {"contacts": 54 * u, "slide": 62 * u, "sink": 44 * u, "jerk": 62 * u}
        feet = tracks.feet is not None
        rows = ["contacts", "slide", "sink", "jerk"] if feet else ["jerk"]
        self.top = 46 * u
        total = self.top + sum(heights[r] + 8 * u for r in rows) + 20 * u
        self.image: Any = Image.new("RGB", (width, total), colors.page)
        self.pen: Any = ImageDraw.Draw(self.image)
        self.font: Any = ImageFont.load_default(9 * u)
        self.large: Any = ImageFont.load_default(12 * u)
        self._title(name)
        y = self.top
        for row in rows:
            self._panel(y, heights[row])
            getattr(self, f"_{row}")(y, heights[row])
            y += heights[row] + 8 * u
        self._axis(y)

    def picture(self) -> np.ndarray:
        """The finished picture."""
        from PIL import Image

        size = (self.image.width // _DRAWN, self.image.height // _DRAWN)
        return np.array(self.image.resize(size, Image.Resampling.LANCZOS).convert("RGBA"))

    def _x(self, frame: float | Floats) -> Any:
        return self.left + (self.right - self.left) * (np.asarray(frame) + 0.5) / self.frames

    def _text(self, x: float, y: float, text: str, color: str, *, large: bool = False, anchor: str = "la") -> None:
        self.pen.text((x, y), text, fill=color, font=self.large if large else self.font, anchor=anchor)

    def _title(self, name: str) -> None:
        q, u = self.quality, self.unit
        self._text(14 * u, 8 * u, name or "motion", self.colors.text, large=True)
        words = [f"{q.frames} frames at {q.rate_hz:g} Hz"]
        if q.skate_cm_s is not None:
            words += [
                f"slide {q.skate_cm_s:.1f} cm/s",
                f"sink {q.sink_cm or 0.0:.1f} cm",
                f"floating {q.float_share or 0.0:.0%}",
            ]
        words += [f"jerk {q.jerk_m_s3:.0f} m/s3", f"{len(q.pops)} pop{'s' * (len(q.pops) != 1)}"]
        if q.limit_deg is not None:
            words.append(f"limits {q.limit_deg:.0f} deg")
        self._text(14 * u, 26 * u, "   ".join(words), self.colors.dim)

    def _panel(self, y: int, height: int) -> None:
        self.pen.rectangle((self.left, y, self.right, y + height), fill=self.colors.panel)
        for second in range(1, int(self.frames / self.tracks.rate_hz) + 1):
            x = float(self._x(second * self.tracks.rate_hz - 0.5))
            if self._step() == 1 or second % self._step() == 0:
                self.pen.line((x, y, x, y + height), fill=self.colors.line, width=max(1, self.unit // 2))

    def _label(self, y: float, text: str, color: str | None = None) -> None:
        self._text(self.left - 8 * self.unit, y, text, color or self.colors.dim, anchor="rm")

    def _contacts(self, y: int, height: int) -> None:
        feet = self.tracks.feet
        if feet is None:
            return
        for n, side in enumerate(("left", "right")):
            color = getattr(self.colors, side)
            middle = y + height * (0.27 + 0.46 * n)
            self._label(middle, side, color)
            for point, thick in (("heel", 0.08), ("ball", 0.17)):
                flags = feet.footing.touching.get(f"{side}_{point}")
                if flags is None:
                    continue
                offset = -0.13 * height if point == "heel" else 0.06 * height
                for start, stop in true_runs(flags):
                    x0, x1 = float(self._x(start - 0.5)), float(self._x(stop - 0.5))
                    top = middle + offset
                    self.pen.rounded_rectangle(
                        (x0, top, max(x1, x0 + 2), top + thick * height), self.unit * 2, fill=color
                    )

    def _slide(self, y: int, height: int) -> None:
        feet = self.tracks.feet
        if feet is None:
            return
        top = _round_up(
            max(max((float(np.nanmax(s, initial=0.0)) for s in feet.slide_cm_s.values()), default=0.0), 5.0)
        )
        self._scale(y, height, "slide", top, "cm/s")
        for side, speed in feet.slide_cm_s.items():
            for start, stop in true_runs(np.isfinite(speed)):
                self._curve(
                    y, height, np.arange(start, stop) + 0.5, speed[start:stop] / top, getattr(self.colors, side)
                )

    def _sink(self, y: int, height: int) -> None:
        feet = self.tracks.feet
        if feet is None:
            return
        top = _round_up(max(float(feet.sink_cm.max()), 2.0))
        for start, stop in true_runs(feet.floats):
            x0, x1 = float(self._x(start - 0.5)), float(self._x(stop - 0.5))
            self.pen.rectangle((x0, y, x1, y + height), fill=self.colors.air)
        self._scale(y, height, "sink", top, "cm", down=True)
        depth = np.clip(feet.sink_cm / top, 0.0, 1.0)
        xs = self._x(np.arange(self.frames, dtype=np.float64))
        shape = [
            (float(xs[0]), y),
            *((float(x), y + height * float(d)) for x, d in zip(xs, depth, strict=True)),
            (float(xs[-1]), y),
        ]
        self.pen.polygon(shape, fill=self.colors.bad)
        if feet.floats.any():
            first = true_runs(feet.floats)[0]
            self._text(
                float(self._x(first[0])) + 3 * self.unit,
                y + height - 3 * self.unit,
                "floats",
                self.colors.dim,
                anchor="ls",
            )

    def _jerk(self, y: int, height: int) -> None:
        top = _round_up(max(float(self.tracks.pop.max(initial=0.0)), 15.0))
        self._scale(y, height, "steps of", top, "times")
        self._label(y + height * 0.5 + 11 * self.unit, "acceleration")
        self._curve(y, height, np.arange(self.frames, dtype=np.float64), self.tracks.pop / top, self.colors.text)
        taken: list[
            tuple[float, float, float]
        ] = []  # (left, right, height) of names: of those too near, the worst pop has its name
        for frame, joint, times in self.quality.pops:
            x, high = float(self._x(frame)), y + height * (1.0 - min(times / top, 1.0))
            r = 3 * self.unit
            self.pen.ellipse((x - r, high - r, x + r, high + r), fill=self.colors.bad)
            long = float(self.pen.textlength(joint, font=self.font)) + 2 * r
            start = x - 2 * r - long if x + 2 * r + long > self.right else x + 2 * r
            if all(start > b or start + long < a or abs(high - h) > 11 * self.unit for a, b, h in taken):
                self._text(
                    start if start > x else start + long,
                    high,
                    joint,
                    self.colors.bad,
                    anchor="lm" if start > x else "rm",
                )
                taken.append((start, start + long, high))

    def _scale(self, y: int, height: int, title: str, top: float, unit: str, *, down: bool = False) -> None:
        u = self.unit
        self._label(y + height * 0.5, title)
        ends = (f"{top:g}", f"0 {unit}") if not down else (f"0 {unit}", f"{top:g}")
        self._label(y + 6 * u, ends[0])
        self._label(y + height - 6 * u, ends[1])

    def _curve(self, y: int, height: int, frames: Floats, share: Floats, color: str) -> None:
        xs = self._x(frames)
        points = [(float(x), y + height * (1.0 - float(np.clip(s, 0.0, 1.0)))) for x, s in zip(xs, share, strict=True)]
        if len(points) == 1:
            points.append((points[0][0] + self.unit, points[0][1]))
        self.pen.line(points, fill=color, width=round(1.3 * self.unit), joint="curve")

    def _step(self) -> int:
        seconds = self.frames / self.tracks.rate_hz
        return next((n for n in (1, 2, 5, 10, 20, 60, 120, 300) if seconds / n <= 16), 600)

    def _axis(self, y: int) -> None:
        seconds = self.frames / self.tracks.rate_hz
        for second in range(0, int(seconds) + 1, self._step()):
            x = float(self._x(second * self.tracks.rate_hz - 0.5))
            if x <= self.right - 4 * self.unit:
                self._text(
                    x,
                    y - 3 * self.unit,
                    f"{self.tracks.start_s + second:g} s",
                    self.colors.dim,
                    anchor="ma" if second else "la",
                )


def _round_up(value: float) -> float:
    scale = 10.0 ** np.floor(np.log10(value))
    return float(next(m for m in (1.0, 1.5, 2.0, 3.0, 5.0, 7.5, 10.0) if m * scale >= value * 0.999) * scale)
