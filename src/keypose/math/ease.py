"""Easings: functions of u in 0..1 from 0 to 1 that say how a movement starts and stops; all names in `names`.

Penner's set has the families sine, quad, cubic, quart, quint, expo, circ, back, elastic and bounce, each ``_in`` (starts
slowly), ``_out`` (stops slowly) and ``_in_out``; beside them stand ``linear``, ``smoothstep``, ``smootherstep`` and the
keywords of CSS: ``ease``, ``ease_in``, ``ease_out``, ``ease_in_out``. CSS's functions are understood as text, too:
``cubic-bezier(0.25, 0.1, 0.25, 1)`` and ``steps(4, jump-end)``.

Every easing is exactly 0 at u = 0 and 1 at u = 1, and holds beyond. Published formulas of expo and elastic miss
one end by a thousandth and jump there; here their decay is brought to 0, which moves nothing by more than 0.001.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from math import inf, pi
from typing import Any

from keypose.arrays import Array
from keypose.errors import ShapeError, UnknownName
from keypose.math.elementary import take

Function = Callable[[Any, Array], Array]  # of the array namespace and u


@dataclass(frozen=True, slots=True)
class Piece:
    """A part of an easing, from ``start`` on, that is smooth in itself."""

    start: float
    value: Function
    slope: Function


@dataclass(frozen=True, slots=True)
class Easing:
    """An easing as smooth pieces one after another.

    ``cubic`` says whether each piece is a polynomial of degree three or less, which one Hermite span can be exactly.
    ``handles`` are x1, y1, x2, y2 where it is one Bezier curve in CSS's sense. ``steps`` where the pieces are constant.
    """

    name: str
    pieces: tuple[Piece, ...]
    cubic: bool = False
    handles: tuple[float, float, float, float] | None = None
    steps: bool = False

    @property
    def label(self) -> str:
        """The name for people: ``Sine in``."""
        return self.name.replace("_in_out", " in and out").replace("_", " ").capitalize()

    def __call__(self, u: Array) -> Array:
        """Values at u (*B); clamped beyond 0..1."""
        xp, u = take(u=(u, ()))
        inside = _between(xp, u)
        found = self._pieces(xp, inside, lambda piece: piece.value, from_left=False)
        found = xp.where(u <= 0, 0.0 * inside, found)
        # Steps that start with a jump have it at once.
        if self.steps:
            found = xp.where(u == 0, self.pieces[0].value(xp, inside), found)
        return xp.where(u >= 1, 0.0 * inside + 1.0, found)

    def slope(self, u: Array, from_left: bool = False) -> Array:
        """The derivative at u (*B) in 0..1; where two pieces meet that of the later one, or of the earlier ``from_left``.

        Circular easings stand upright where the circle ends: their slope is infinite there.
        """
        xp, u = take(u=(u, ()))
        return self._pieces(xp, _between(xp, u), lambda piece: piece.slope, from_left)

    def _pieces(self, xp: Any, u: Array, part: Callable[[Piece], Function], from_left: bool) -> Array:
        found = part(self.pieces[0])(xp, u)
        for piece in self.pieces[1:]:
            reached = u > piece.start if from_left else u >= piece.start
            found = xp.where(reached, part(piece)(xp, u), found)
        return found


def easing(name: str) -> Easing:
    """An easing by its name or by a function of CSS as text.

    Raises: UnknownName with the nearest name; ShapeError where the numbers of a CSS function are out of range.
    """
    text = name.strip().casefold()
    match = re.fullmatch(r"(cubic-bezier|steps)\((.*)\)", text)
    if match:
        return _css_function(name, match[1], [part.strip() for part in match[2].split(",")])
    found = _catalogue().get(text.replace("-", "_"))
    if found is None:
        raise UnknownName("easing", name, names())
    return found


def ease(name: str, u: Array) -> Array:
    """The value of an easing at u (*B), by its name; raises as `easing` does.

    Source: Penner, Programming Macromedia Flash MX (2002), chapter 7; CSS Easing Functions Level 2 (W3C).
    """
    return easing(name)(u)


def names() -> tuple[str, ...]:
    """The names of all easings."""
    return tuple(_catalogue())


def cubic_bezier(x1: float, y1: float, x2: float, y2: float) -> Easing:
    """CSS's curve from (0, 0) to (1, 1) with the handles (x1, y1) and (x2, y2); raises ShapeError unless x1 and x2 are in 0..1.

    Source: CSS Easing Functions Level 2, 2.2.
    """
    for label, x in (("x1", x1), ("x2", x2)):
        if not 0 <= x <= 1:
            raise ShapeError(f"{label}: expected 0..1, because time does not run backwards, got {x}")

    def value(xp: Any, u: Array) -> Array:
        return _bezier(_solved(xp, u, x1, x2), y1, y2)

    def slope(xp: Any, u: Array) -> Array:
        s = _solved(xp, u, x1, x2)
        dx, dy = _bezier_slope(s, x1, x2), _bezier_slope(s, y1, y2)
        upright = dx <= 0.0
        return xp.where(upright, _end_slope(xp, s, (x1, y1, x2, y2)), dy / xp.where(upright, 1.0, dx))

    name = f"cubic-bezier({x1:g}, {y1:g}, {x2:g}, {y2:g})"
    return Easing(name, (Piece(0.0, value, slope),), handles=(x1, y1, x2, y2))


STEP_POSITIONS = ("jump-end", "jump-start", "jump-none", "jump-both", "end", "start")


def steps(count: int, position: str = "jump-end") -> Easing:
    """Stairs of ``count`` equal parts of time, jumping at the end of each, at its start, at neither or at both ends.

    Raises: UnknownName for a position that does not exist; ShapeError for less than one step (two for ``jump-none``).
    Source: CSS Easing Functions Level 2, 2.3.
    """
    if position not in STEP_POSITIONS:
        raise UnknownName("step position", position, STEP_POSITIONS)
    least = 2 if position == "jump-none" else 1
    if count < least:
        raise ShapeError(f"count: expected {least} or more steps, got {count}")
    first = 1 if position in ("jump-start", "jump-both", "start") else 0
    jumps = count + {"jump-none": -1, "jump-both": 1}.get(position, 0)

    def level(height: float) -> Function:
        return lambda xp, u: 0.0 * u + height

    pieces = tuple(Piece(k / count, level((k + first) / jumps), level(0.0)) for k in range(count))
    return Easing(f"steps({count}, {position})", pieces, cubic=True, steps=True)


# --- Penner's set -------------------------------------------------------------------------------------------------------

_OVERSHOOT = 1.70158  # makes back go beyond by a tenth
_DECAY = 1 / 1024  # what 2^-10 leaves


def _sine() -> Piece:
    def value(xp: Any, u: Array) -> Array:
        s = xp.sin(0.25 * pi * u)
        return 2.0 * s * s

    return Piece(0.0, value, lambda xp, u: 0.5 * pi * xp.sin(0.5 * pi * u))


def _power(n: int) -> Piece:
    return Piece(0.0, lambda xp, u: u**n, lambda xp, u: n * u ** (n - 1))


def _expo() -> Piece:
    def value(xp: Any, u: Array) -> Array:
        return (2.0 ** (10.0 * u) - 1.0) / 1023.0

    return Piece(0.0, value, lambda xp, u: 10.0 * _LN2 * 2.0 ** (10.0 * u) / 1023.0)


_LN2 = 0.6931471805599453


def _circ() -> Piece:
    def slope(xp: Any, u: Array) -> Array:
        squared = 1.0 - u * u
        return xp.where(squared <= 0, inf, u / xp.sqrt(xp.where(squared <= 0, 1.0, squared)))

    return Piece(0.0, lambda xp, u: u * u / (1.0 + xp.sqrt(1.0 - u * u)), slope)


def _back(overshoot: float) -> Piece:
    s = overshoot
    return Piece(0.0, lambda xp, u: u * u * ((s + 1) * u - s), lambda xp, u: u * (3 * (s + 1) * u - 2 * s))


def _elastic(period: float) -> Piece:
    turn = 2 * pi * 10.0 / period  # published with a period of 3 tenths, and 4.5 for both ends

    def parts(xp: Any, u: Array) -> tuple[Array, Array, Array]:
        return (2.0 ** (10.0 * u - 10.0) - _DECAY) / (1 - _DECAY), xp.cos(turn * (1.0 - u)), xp.sin(turn * (1.0 - u))

    def value(xp: Any, u: Array) -> Array:
        grown, c, _ = parts(xp, u)
        return grown * c

    def slope(xp: Any, u: Array) -> Array:
        grown, c, s = parts(xp, u)
        return (10.0 * _LN2) * 2.0 ** (10.0 * u - 10.0) / (1 - _DECAY) * c + turn * grown * s

    return Piece(0.0, value, slope)


def _bounce() -> tuple[Piece, ...]:
    """Ends with the fall: four parabolas, each a half as long and a quarter as high as the next."""
    n, d = 7.5625, 2.75
    # As published it stops by bouncing; this is its mirror image.
    lands = (0.0, 1 / d, 2 / d, 2.5 / d, 1.0)
    heights = ((0.0, 0.0), (1.5 / d, 0.75), (2.25 / d, 0.9375), (2.625 / d, 0.984375))
    pieces: list[Piece] = []
    for part in (3, 2, 1, 0):
        middle, base = heights[part]

        def value(xp: Any, u: Array, middle: float = middle, base: float = base) -> Array:
            v = 1.0 - u - middle
            return 1.0 - (n * v * v + base)

        def slope(xp: Any, u: Array, middle: float = middle) -> Array:
            return 2.0 * n * (1.0 - u - middle)

        pieces.append(Piece(1.0 - lands[part + 1], value, slope))
    return tuple(pieces)


def _mirrored(pieces: tuple[Piece, ...]) -> tuple[Piece, ...]:
    """Out: the easing backwards."""
    ends = [*(p.start for p in pieces[1:]), 1.0]

    def mirrored(piece: Piece, start: float) -> Piece:
        return Piece(start, lambda xp, u: 1.0 - piece.value(xp, 1.0 - u), lambda xp, u: piece.slope(xp, 1.0 - u))

    return tuple(mirrored(p, 1.0 - end) for p, end in zip(reversed(pieces), reversed(ends), strict=True))


def _both(pieces: tuple[Piece, ...]) -> tuple[Piece, ...]:
    """In and out: in to the middle, then out."""

    def first(piece: Piece) -> Piece:
        # Beyond its half the function is not looked at, but must be a number.
        return Piece(
            0.5 * piece.start,
            lambda xp, u: 0.5 * piece.value(xp, _between(xp, 2.0 * u)),
            lambda xp, u: piece.slope(xp, _between(xp, 2.0 * u)),
        )

    def second(piece: Piece) -> Piece:
        return Piece(
            0.5 + 0.5 * piece.start,
            lambda xp, u: 0.5 + 0.5 * piece.value(xp, _between(xp, 2.0 * u - 1.0)),
            lambda xp, u: piece.slope(xp, _between(xp, 2.0 * u - 1.0)),
        )

    return (*(first(p) for p in pieces), *(second(p) for p in _mirrored(pieces)))


@cache
def _catalogue() -> dict[str, Easing]:
    # name: pieces going in, pieces for both ends (some families are published with other numbers there), cubic
    families: dict[str, tuple[tuple[Piece, ...], tuple[Piece, ...], bool]] = {
        "sine": ((_sine(),), (_sine(),), False),
        **{
            name: ((_power(n),), (_power(n),), n <= 3)
            for name, n in (("quad", 2), ("cubic", 3), ("quart", 4), ("quint", 5))
        },
        "expo": ((_expo(),), (_expo(),), False),
        "circ": ((_circ(),), (_circ(),), False),
        "back": ((_back(_OVERSHOOT),), (_back(1.525 * _OVERSHOOT),), True),
        "elastic": ((_elastic(3.0),), (_elastic(4.5),), False),
        "bounce": (_bounce(), _bounce(), True),
    }
    found = [Easing("linear", (_power(1),), cubic=True)]
    for name, (pieces, both, cubic) in families.items():
        found.append(Easing(f"{name}_in", pieces, cubic))
        found.append(Easing(f"{name}_out", _mirrored(pieces), cubic))
        found.append(Easing(f"{name}_in_out", _both(both), cubic))
    smooth = Piece(0.0, lambda xp, u: u * u * (3.0 - 2.0 * u), lambda xp, u: 6.0 * u * (1.0 - u))
    smoother = Piece(
        0.0,
        lambda xp, u: u * u * u * (10.0 + u * (6.0 * u - 15.0)),
        lambda xp, u: 30.0 * u * u * (1.0 - u) * (1.0 - u),
    )
    found += [Easing("smoothstep", (smooth,), cubic=True), Easing("smootherstep", (smoother,))]
    for name, handles in (
        ("ease", (0.25, 0.1, 0.25, 1.0)),
        ("ease_in", (0.42, 0.0, 1.0, 1.0)),
        ("ease_out", (0.0, 0.0, 0.58, 1.0)),
        ("ease_in_out", (0.42, 0.0, 0.58, 1.0)),
    ):
        curve = cubic_bezier(*handles)
        found.append(Easing(name, curve.pieces, handles=handles))
    return {e.name: e for e in found}


# --- CSS --------------------------------------------------------------------------------------------------------------------


def _css_function(name: str, function: str, arguments: list[str]) -> Easing:
    try:
        if function == "cubic-bezier" and len(arguments) == 4:
            x1, y1, x2, y2 = (float(a) for a in arguments)
            return cubic_bezier(x1, y1, x2, y2)
        if function == "steps" and len(arguments) in (1, 2):
            return steps(int(arguments[0]), *arguments[1:])
    except ValueError as error:
        if isinstance(error, ShapeError):
            raise
    wanted = "four numbers" if function == "cubic-bezier" else "a whole number and a position"
    raise ShapeError(f"easing '{name}': expected {wanted} in the parentheses")


def _between(xp: Any, u: Array) -> Array:
    return xp.where(u < 0, 0.0 * u, xp.where(u > 1, 0.0 * u + 1.0, u))


def _bezier(s: Array, a: float, b: float) -> Array:
    v = 1.0 - s
    return 3.0 * s * v * (v * a + s * b) + s * s * s


def _bezier_slope(s: Array, a: float, b: float) -> Array:
    v = 1.0 - s
    return 3.0 * (v * v * a + 2.0 * s * v * (b - a) + s * s * (1.0 - b))


def _solved(xp: Any, u: Array, x1: float, x2: float) -> Array:
    """The curve parameter where x is u: Newton's method, kept between bounds that close in."""
    low, high = 0.0 * u, 0.0 * u + 1.0
    s = u
    for _ in range(24):
        x = _bezier(s, x1, x2)
        low, high = xp.where(x <= u, s, low), xp.where(x >= u, s, high)
        slope = _bezier_slope(s, x1, x2)
        moved = s + (u - x) / xp.where(slope <= 0, 1.0, slope)
        s = xp.where((slope > 0) & (moved >= low) & (moved <= high), moved, 0.5 * (low + high))
    return s


def _end_slope(xp: Any, s: Array, handles: tuple[float, float, float, float]) -> Array:
    """The slope where the curve parameter has no speed along x: that of the next control point which is not on the end."""
    x1, y1, x2, y2 = handles

    def towards(points: list[tuple[float, float]]) -> float:
        for x, y in points:
            if x != 0 or y != 0:
                return y / x if x != 0 else (inf if y > 0 else -inf)
        return 1.0

    start = towards([(x1, y1), (x2, y2), (1.0, 1.0)])
    end = towards([(1 - x2, 1 - y2), (1 - x1, 1 - y1), (1.0, 1.0)])
    middle = inf if _bezier_slope(0.5, y1, y2) > 0 else -inf
    return xp.where(s <= 0, start, xp.where(s >= 1, end, middle))
