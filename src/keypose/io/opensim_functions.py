"""Functions of one number as OpenSim models have them: how far a joint turns or slides where a coordinate has a value.

Source: OpenSim's documentation of Function; the spline is that of G. Forsythe, M. Malcolm and C. Moler, "Computer Methods for
Mathematical Computations" (1977), section 4.4, which SIMM used.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from keypose.arrays import Floats
from keypose.io.collada_xml import Element

Function = Callable[[Floats], Floats]
"""Of values (T,) of a coordinate, (T,)."""

_MOST_KNOTS = 10_000
_DEEPEST = 20


def parse_function(element: Element, deep: int = 0) -> tuple[Function, bool]:
    """A function of a file, and whether it is the coordinate itself, to a sign; raises `FormatError` for kinds unknown."""
    if deep > _DEEPEST:
        raise element.error(f"functions nested more than {_DEEPEST} deep")
    match element.tag:
        case "Constant":
            value = _one(element, "value", 0.0)
            return (lambda at: np.full(at.shape, value)), False
        case "LinearFunction":
            slope, offset = _some(element, "coefficients", 2).tolist()
            return (lambda at: slope * at + offset), abs(slope) == 1.0 and offset == 0.0
        case "PolynomialFunction":
            powers = _some(element, "coefficients")
            return (lambda at: np.polyval(powers, at)), False
        case "MultiplierFunction":
            scale = _one(element, "scale", 1.0)
            inner, plain = parse_function(_inner(element), deep + 1)
            return (lambda at: scale * inner(at)), plain and abs(scale) == 1.0
        case "PiecewiseLinearFunction":
            x, y = _points(element)
            return (lambda at: np.interp(at, x, y)), False
        case "SimmSpline" | "NaturalCubicSpline":
            return spline_through(*_points(element)), False
        case _:
            raise element.error("a kind of function that is not read")


def spline_through(x: Floats, y: Floats) -> Function:
    """The cubic spline through points (N,) whose ends have the third derivatives of the cubics through the last four points.

    Beyond its ends it goes on straight.
    """
    bend = _second_derivatives(x, y)
    step = np.diff(x)
    first = (y[1] - y[0]) / step[0] - step[0] * (2.0 * bend[0] + bend[1]) / 6.0
    last = (y[-1] - y[-2]) / step[-1] + step[-1] * (bend[-2] + 2.0 * bend[-1]) / 6.0

    def value(at: Floats) -> Floats:
        k = np.clip(np.searchsorted(x, at, side="right") - 1, 0, len(x) - 2)
        inside = np.clip(at, x[0], x[-1])
        a, b, h = x[k + 1] - inside, inside - x[k], step[k]
        curve = (bend[k] * a**3 + bend[k + 1] * b**3) / (6.0 * h)
        curve += (y[k] / h - bend[k] * h / 6.0) * a + (y[k + 1] / h - bend[k + 1] * h / 6.0) * b
        return curve + first * np.minimum(at - x[0], 0.0) + last * np.maximum(at - x[-1], 0.0)

    return value


def _second_derivatives(x: Floats, y: Floats) -> Floats:
    count = len(x)
    if count < 3:
        return np.zeros(count)
    step = np.diff(x)
    slope = np.diff(y) / step
    system, right = np.zeros((count, count)), np.zeros(count)
    inner = np.arange(1, count - 1)
    system[inner, inner - 1], system[inner, inner + 1] = step[:-1], step[1:]
    system[inner, inner] = 2.0 * (step[:-1] + step[1:])
    right[1:-1] = 6.0 * np.diff(slope)
    system[0, :2], system[-1, -2:] = (-1.0, 1.0), (-1.0, 1.0)
    if count > 3:
        right[0] = step[0] * 6.0 * _third_difference(x[:4], y[:4])
        right[-1] = step[-1] * 6.0 * _third_difference(x[-4:], y[-4:])
    return np.linalg.solve(system, right)


def _third_difference(x: Floats, y: Floats) -> float:
    for width in (1, 2, 3):
        y = np.diff(y) / (x[width:] - x[:-width])
    return float(y[0])


def _inner(element: Element) -> Element:
    """The function inside another, which older files wrap once more."""
    held = element.first("function")
    if held is not None:
        inside = held.children[0] if held.children else None
    else:
        inside = next((child for child in element.children if child.tag not in ("scale", "coordinates", "axis")), None)
    if inside is None:
        raise element.error("it has no function")
    return inside


def function_of(element: Element) -> tuple[Function, bool]:
    """The function that a transform axis holds; as `parse_function`."""
    return parse_function(_inner(element))


def _some(element: Element, tag: str, count: int | None = None) -> Floats:
    found = element.first(tag)
    if found is None:
        raise element.error(f"it has no <{tag}>")
    return found.numbers(count)


def _one(element: Element, tag: str, default: float) -> float:
    found = element.first(tag)
    return default if found is None else float(found.numbers(1)[0])


def _points(element: Element) -> tuple[Floats, Floats]:
    x, y = _some(element, "x"), _some(element, "y")
    if len(x) != len(y) or not 2 <= len(x) <= _MOST_KNOTS:
        raise element.error(f"expected 2 to {_MOST_KNOTS} points, as many x as y; found {len(x)} and {len(y)}")
    if not (np.diff(x) > 1e-9 * max(1.0, float(np.abs(x).max()))).all():
        raise element.error("the x of its points do not rise")
    return x, y
