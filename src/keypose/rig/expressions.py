"""Expressions of drivers: arithmetic over named channels, parsed by hand, never executed as code.

A grammar of numbers, names, ``+ - * / % **``, comparisons (1 or 0), ``and or not``, ``a if c else b``, and the functions
of `FUNCTIONS`. Precedence is Python's. A name is words with dots between (``foot.L.roll``); any other stands in
braces (``{Left Hand}.rotation.x``). All of it works on arrays.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NoReturn

import numpy as np

from keypose.arrays import Array
from keypose.errors import ShapeError, UnknownName

LONGEST = 4096
_DEEPEST = 64

Evaluate = Callable[[Mapping[str, Array]], Array]


def _smoothstep(low: Array, high: Array, x: Array) -> Array:
    u = np.clip((x - low) / (high - low), 0.0, 1.0)
    return u * u * (3.0 - 2.0 * u)


FUNCTIONS: Mapping[str, tuple[Callable[..., Array], int, int]] = {
    "min": (lambda *a: np.minimum.reduce(np.broadcast_arrays(*a)), 2, 16),
    "max": (lambda *a: np.maximum.reduce(np.broadcast_arrays(*a)), 2, 16),
    "clamp": (lambda x, low, high: np.minimum(np.maximum(x, low), high), 3, 3),
    "lerp": (lambda a, b, u: a + (b - a) * u, 3, 3),
    "smoothstep": (_smoothstep, 3, 3),
    "abs": (np.abs, 1, 1),
    "sign": (np.sign, 1, 1),
    "floor": (np.floor, 1, 1),
    "ceil": (np.ceil, 1, 1),
    "round": (np.round, 1, 1),
    "sqrt": (np.sqrt, 1, 1),
    "exp": (np.exp, 1, 1),
    "log": (np.log, 1, 1),
    "sin": (np.sin, 1, 1),
    "cos": (np.cos, 1, 1),
    "tan": (np.tan, 1, 1),
    "asin": (np.arcsin, 1, 1),
    "acos": (np.arccos, 1, 1),
    "atan": (np.arctan, 1, 1),
    "atan2": (np.arctan2, 2, 2),
    "radians": (np.radians, 1, 1),
    "degrees": (np.degrees, 1, 1),
}
"""Name -> function and the least and greatest number of its arguments."""

CONSTANTS: Mapping[str, float] = {"pi": float(np.pi), "tau": float(2 * np.pi)}

_TOKEN = re.compile(
    r"\s*(?:(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)(?![\w.])"
    r"|(?P<name>(?:\{[^{}]+\}|[^\W\d]\w*)(?:\.\w+)*)"
    r"|(?P<sign>\*\*|<=|>=|==|!=|[-+*/%<>(),]))"
)
_WORDS = ("and", "or", "not", "if", "else")

_ARITHMETIC: Mapping[str, Callable[[Array, Array], Array]] = {
    "+": np.add, "-": np.subtract, "*": np.multiply, "/": np.divide, "%": np.mod, "**": np.power,
    "<": np.less, ">": np.greater, "<=": np.less_equal, ">=": np.greater_equal, "==": np.equal, "!=": np.not_equal,
}  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Expression:
    """A parsed expression: its text, the names that it reads, and its value (`__call__`) for arrays by name."""

    text: str
    names: tuple[str, ...]
    evaluate: Evaluate

    def __call__(self, values: Mapping[str, Any]) -> Array:
        """The value for values (*B,) by name; what has none (a division by zero, a root of -1) is not finite.

        Raises:
            UnknownName: where a name has no value.
        """
        for name in self.names:
            if name not in values:
                raise UnknownName("channel", name, values)
        with np.errstate(all="ignore"):
            return np.asarray(self.evaluate(values), np.float64)


@lru_cache(maxsize=1024)
def parse_expression(text: str) -> Expression:
    """An expression parsed.

    Raises:
        ShapeError: where the text is none; says the column and what was expected.
        UnknownName: for a function that does not exist.
    """
    return _Parser(text).whole()


class _Parser:
    def __init__(self, text: str) -> None:
        if len(text) > LONGEST:
            raise ShapeError(f"expression: {len(text)} characters; at most {LONGEST}")
        self.text, self.place, self.depth = text, 0, 0
        self.names: dict[str, None] = {}
        self.tokens: list[tuple[str, str, int]] = []
        at = 0
        while text[at:].strip():
            found = _TOKEN.match(text, at)
            if found is None:
                at += len(text[at:]) - len(text[at:].lstrip())
                self.fail(f"cannot read {text[at : at + 12]!r}", at)
            kind = found.lastgroup or ""
            token = found.group(kind)
            self.tokens.append(("word" if token in _WORDS else kind, token, found.start(kind)))
            at = found.end()
        self.tokens.append(("end", "the end", len(text)))

    def whole(self) -> Expression:
        value = self.choice()
        if self.kind != "end":
            self.fail(f"expected an operator or the end, got '{self.token}'")
        return Expression(self.text, tuple(self.names), value)

    # ---- tokens

    @property
    def kind(self) -> str:
        return self.tokens[self.place][0]

    @property
    def token(self) -> str:
        return self.tokens[self.place][1]

    def take(self, *wanted: str) -> str:
        """The token where it is one of those wanted, and on to the next; else nothing."""
        if self.token in wanted and self.kind in ("sign", "word"):
            self.place += 1
            return self.tokens[self.place - 1][1]
        return ""

    def fail(self, what: str, at: int | None = None) -> NoReturn:
        column = (self.tokens[self.place][2] if at is None else at) + 1
        raise ShapeError(f"expression {self.text[:60]!r}, column {column}: {what}")

    # ---- grammar, loosest first

    def choice(self) -> Evaluate:
        self.depth += 1
        if self.depth > _DEEPEST:
            self.fail("brackets are nested too deeply")
        value = self.either()
        if self.take("if"):
            condition = self.either()
            if not self.take("else"):
                self.fail(f"expected 'else', got '{self.token}'")
            yes, no = value, self.choice()
            value = lambda v: np.where(np.not_equal(condition(v), 0), yes(v), no(v))  # noqa: E731
        self.depth -= 1
        return value

    def either(self) -> Evaluate:
        value = self.both()
        while self.take("or"):
            value = _logical(np.logical_or, value, self.both())
        return value

    def both(self) -> Evaluate:
        value = self.negation()
        while self.take("and"):
            value = _logical(np.logical_and, value, self.negation())
        return value

    def negation(self) -> Evaluate:
        flips = 0
        while self.take("not"):
            flips += 1
        value = self.comparison()
        if not flips:
            return value
        return lambda v: np.equal(np.not_equal(value(v), 0), flips % 2 == 0).astype(np.float64)

    def comparison(self) -> Evaluate:
        value = self.sum()
        if sign := self.take("<", ">", "<=", ">=", "==", "!="):
            value = _operation(sign, value, self.sum())
            if self.token in ("<", ">", "<=", ">=", "==", "!="):
                self.fail("comparisons do not chain; use 'and'")
        return value

    def sum(self) -> Evaluate:
        value = self.product()
        while sign := self.take("+", "-"):
            value = _operation(sign, value, self.product())
        return value

    def product(self) -> Evaluate:
        value = self.signed()
        while sign := self.take("*", "/", "%"):
            value = _operation(sign, value, self.signed())
        return value

    def signed(self) -> Evaluate:
        negative = False
        while sign := self.take("-", "+"):
            negative ^= sign == "-"
        value = self.power()
        return (lambda v: np.negative(value(v))) if negative else value

    def power(self) -> Evaluate:
        base = self.atom()
        if not self.take("**"):
            return base
        self.depth += 1
        if self.depth > _DEEPEST:
            self.fail("powers are nested too deeply")
        exponent = self.signed()
        self.depth -= 1
        return _operation("**", base, exponent)

    def atom(self) -> Evaluate:
        kind, token = self.kind, self.token
        if self.take("("):
            value = self.choice()
            self.close()
            return value
        if kind == "number":
            self.place += 1
            number = float(token)
            return lambda v: number
        if kind != "name":
            self.fail(f"expected a number, a name or '(', got '{token}'")
        self.place += 1
        if self.take("("):
            return self.call(token)
        if token in CONSTANTS:
            number = CONSTANTS[token]
            return lambda v: number
        name = token.replace("{", "").replace("}", "")
        self.names[name] = None
        return lambda v: v[name]

    def call(self, name: str) -> Evaluate:
        if name not in FUNCTIONS:
            raise UnknownName("function", name, FUNCTIONS)
        function, least, most = FUNCTIONS[name]
        arguments = [self.choice()]
        while self.take(","):
            arguments.append(self.choice())
        self.close()
        if not least <= len(arguments) <= most:
            count = str(least) if least == most else f"{least} to {most}"
            self.fail(f"{name}: expected {count} arguments, got {len(arguments)}")
        return lambda v: function(*(a(v) for a in arguments))

    def close(self) -> None:
        if not self.take(")"):
            self.fail(f"expected ')', got '{self.token}'")


def _operation(sign: str, a: Evaluate, b: Evaluate) -> Evaluate:
    function = _ARITHMETIC[sign]
    if sign in ("+", "-", "*", "/", "%", "**"):
        return lambda v: function(np.asarray(a(v), np.float64), b(v))
    return lambda v: function(a(v), b(v)).astype(np.float64)


def _logical(function: Callable[[Array, Array], Array], a: Evaluate, b: Evaluate) -> Evaluate:
    return lambda v: function(np.not_equal(a(v), 0), np.not_equal(b(v), 0)).astype(np.float64)
