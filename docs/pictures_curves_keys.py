"""Draws the picture of docs/curves.md: ``python docs/pictures_curves_keys.py`` (writes docs/images)."""

from __future__ import annotations

import numpy as np
from pictures_principles import BLUE, CORAL, FAINT, GOLD, GREEN, INK, Graph, Sheet

from keypose.editing.modes import set_interpolation, set_tangent_types
from keypose.evaluate import sample_curve
from keypose.math import tangents
from keypose.model import Curve, CurveKind, Interpolation, Tangent

TIMES = np.array([0.0, 0.5, 0.8, 1.7, 2.0, 3.0])
VALUES = np.array([0.0, 1.0, 1.05, -0.2, 0.6, 0.6])[:, None]


def main() -> None:
    """The same six keys with every type of tangent, and four points joined by knots of four kinds."""
    sheet = Sheet(1000, 500)
    line = Curve(TIMES, VALUES, Interpolation.LINEAR, kind=CurveKind.SCALAR)
    every = range(len(TIMES))
    step = set_interpolation(line, every, Interpolation.STEP).curve
    curves = {
        "steps and lines": (step, line),
        "VECTOR and FLAT": (
            set_tangent_types(line, every, Tangent.VECTOR),
            set_tangent_types(line, every, Tangent.FLAT),
        ),
        "AUTO and CLAMPED": (
            set_tangent_types(line, every, Tangent.AUTO),
            set_tangent_types(line, every, Tangent.CLAMPED),
        ),
    }
    for n, (title, pair) in enumerate(curves.items()):
        box = (16 + 326 * n, 16, 328 + 326 * n, 242)
        sheet.panel(box)
        for m, (word, color) in enumerate(zip(title.split(" and "), (BLUE, CORAL), strict=True)):
            sheet.text(box[0] + 14 + 90 * m, box[1] + 10, word, color)
        graph = Graph(sheet, (box[0] + 18, box[1] + 44, box[2] - 18, box[3] - 20), (0, 3), (-0.45, 1.25))
        graph.levels((0, 0.5, 1))
        for curve, color in zip(pair, (BLUE, CORAL), strict=True):
            graph.curve(curve, color)
        if n:
            _handles(graph, pair[1])
    _paths(sheet)
    _tcb(sheet)
    sheet.save("curve-tangents.png")


def _handles(graph: Graph, curve: Curve) -> None:
    for k, time in enumerate(curve.times_s):
        for side, there in ((curve.in_handles, k > 0), (curve.out_handles, k < curve.key_count - 1)):
            if side is not None and there:
                seconds, value = side[k, 0]
                ends = [graph.at(time, curve.values[k, 0]), graph.at(time + seconds, curve.values[k, 0] + value)]
                graph.sheet.line(ends, FAINT, 1)
                graph.sheet.dot(*ends[1], 2.4, FAINT)


def _paths(sheet: Sheet) -> None:
    """A path in the plane: what the distances of its knots do."""
    points = np.array([[0.0, 0.2], [0.9, 1.0], [1.05, 0.95], [1.15, 0.1], [2.6, 0.9], [3.0, 0.0]])
    times = np.arange(6.0)
    for n, (knots, color) in enumerate((("uniform", CORAL), ("centripetal", GREEN), ("chordal", BLUE))):
        box = (16 + 218 * n, 258, 220 + 218 * n, 484)
        sheet.panel(box, f"Catmull-Rom, {knots}")
        back, out = tangents.catmull_rom(points, times, knots)
        curve = Curve(times, points, Interpolation.HERMITE, back, out)
        graph = Graph(sheet, (box[0] + 14, box[1] + 50, box[2] - 14, box[3] - 24), (0.0, 3.0), (-0.1, 1.15))
        path = sample_curve(curve, np.linspace(0, 5, 700))
        sheet.line(graph.at(path[:, 0], path[:, 1]), color, 2.2)
        for x, y in points:
            sheet.diamond(*graph.at(x, y))


def _tcb(sheet: Sheet) -> None:
    box = (670, 258, 980, 484)
    sheet.panel(box, "tension, continuity and bias of the middle key")
    times, values = np.array([0.0, 1.0, 2.0]), np.array([0.0, 0.75, 1.0])[:, None]
    graph = Graph(sheet, (box[0] + 18, box[1] + 44, box[2] - 18, box[3] - 34), (0, 2), (-0.1, 1.2))
    graph.levels((0, 0.5, 1))
    for n, (name, setting, color) in enumerate(
        (("0", (0, 0, 0), INK), ("t = 1", (1, 0, 0), BLUE), ("c = -1", (0, -1, 0), GREEN), ("b = 1", (0, 0, 1), CORAL))
    ):
        t, c, b = (np.array([0.0, x, 0.0]) for x in setting)
        back, out = tangents.kochanek_bartels(values, times, t, c, b)
        graph.curve(Curve(times, values, Interpolation.HERMITE, back, out, CurveKind.SCALAR), color, keys=n == 0)
        sheet.text(box[0] + 24 + 70 * n, box[3] - 24, name, color)
    sheet.diamond(*graph.at(1.0, 0.75), GOLD)


if __name__ == "__main__":
    main()
