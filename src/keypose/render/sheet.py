"""Contact sheets: many small pictures of one performance on one page, with their numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from keypose.render.settings import Picture, Rgb, Theme, encoded

_GAP = 6  # pixels between the pictures, on a page of a thousand


@dataclass(frozen=True, slots=True)
class Layout:
    """Where the pictures of a sheet lie: each is ``cell`` (width, height) pixels."""

    columns: int
    rows: int
    cell: tuple[int, int]
    gap: int
    origin: tuple[int, int]

    def place(self, index: int) -> tuple[int, int]:
        """Left and top pixel of a picture."""
        row, column = divmod(index, self.columns)
        width, height = self.cell
        return self.origin[0] + column * (width + self.gap), self.origin[1] + row * (height + self.gap)


def layout(count: int, width: int, height: int, aspect: float) -> Layout:
    """The grid that shows ``count`` subjects of an aspect ratio (width over height) largest on a page of that size."""
    gap = max(1, round(_GAP * min(width, height) / 1000)) if min(width, height) >= 64 else 0
    best: tuple[float, int, int] | None = None
    for columns in range(1, count + 1):
        rows = -(-count // columns)
        cell_width = (width - gap * (columns + 1)) / columns
        cell_height = (height - gap * (rows + 1)) / rows
        if cell_width < 1 or cell_height < 1:
            continue
        scale = min(cell_width / aspect, cell_height)
        # of grids that show it equally large, the one with the fewest empty places
        score = scale * (1 - 0.15 * (columns * rows - count) / count)
        if best is None or score > best[0]:
            best = (score, columns, rows)
    columns, rows = (best[1], best[2]) if best else (count, 1)
    cell = (max(1, (width - gap * (columns + 1)) // columns), max(1, (height - gap * (rows + 1)) // rows))
    used = columns * (cell[0] + gap) - gap, rows * (cell[1] + gap) - gap
    return Layout(columns, rows, cell, gap, ((width - used[0]) // 2, (height - used[1]) // 2))


def compose(
    pictures: Sequence[Picture], labels: Sequence[str], width: int, height: int, grid: Layout, theme: Theme
) -> Picture:
    """The page: (height, width, 4) uint8."""
    image, drawing, font = _pillow()
    page = image.new("RGBA", (width, height), _code(theme.zenith))
    for index, (picture, label) in enumerate(zip(pictures, labels, strict=True)):
        left, top = grid.place(index)
        page.paste(image.fromarray(picture), (left, top))
        size = max(9, round(min(grid.cell[1] * 0.055, grid.cell[0] * 0.068, 40)))
        if grid.cell[1] > 3 * size and grid.cell[0] > 3 * size:
            pen = drawing.Draw(page)
            place = (left + 0.7 * size, top + 0.5 * size)
            pen.text(place, label, fill=_code(theme.text), font=font.load_default(size))
    return np.array(page)


def _code(color: Rgb) -> tuple[int, int, int, int]:
    r, g, b = (round(255 * v) for v in encoded(color))
    return (r, g, b, 255)


def _pillow() -> tuple[Any, Any, Any]:
    from PIL import Image, ImageDraw, ImageFont

    return Image, ImageDraw, ImageFont
