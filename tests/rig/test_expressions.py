"""Expressions of drivers: Python's own arithmetic is the reference; nothing is ever executed."""

from __future__ import annotations

import math

import numpy as np
import pytest

from keypose.errors import ShapeError, UnknownName
from keypose.rig import parse_expression
from keypose.rig.expressions import FUNCTIONS

NAMES = {"a": 1.25, "b": -0.5, "c": 3.0, "zero": 0.0}
PYTHON = {
    "sin": math.sin, "cos": math.cos, "tan": math.tan, "sqrt": math.sqrt, "exp": math.exp, "log": math.log,
    "abs": abs, "min": min, "max": max, "floor": math.floor, "ceil": math.ceil, "round": round, "asin": math.asin,
    "acos": math.acos, "atan": math.atan, "atan2": math.atan2, "radians": math.radians, "degrees": math.degrees,
    "pi": math.pi, "tau": math.tau,
    "sign": lambda x: (x > 0) - (x < 0),
    "clamp": lambda x, low, high: min(max(x, low), high),
    "lerp": lambda x, y, u: x + (y - x) * u,
    "smoothstep": lambda low, high, x: (lambda u: u * u * (3 - 2 * u))(min(max((x - low) / (high - low), 0), 1)),
}  # fmt: skip


@pytest.mark.parametrize(
    "text",
    [
        "a + b * c", "(a + b) * c", "a - b - c", "a / b / c", "-a ** 2", "2 ** -1", "2 ** 3 ** 2", "-2 ** 2", "a % c", "b % c",
        "-b % -c", "1e-3 + .5", "2.", "1.5e2", "a < b", "a > b", "a <= a", "a != b", "a == a", "a < b or c > a", "a and zero",
        "not a", "not not a", "not zero and b", "a if c > 2 else b", "a if zero else b if zero else c", "+-+a", "a--b",
        "sin(a) + cos(b * pi)", "min(a, b, c)", "max(a, 2)", "clamp(c, a, 2)", "lerp(a, b, 0.25)", "smoothstep(0, 4, c)",
        "sqrt(abs(b))", "exp(b) - log(c)", "atan2(a, b)", "asin(b) + acos(b) + atan(c)", "floor(b) + ceil(a) + round(c)",
        "degrees(a) + radians(b)", "sign(b) * tau", "tan(b)", "((((a))))", "(a > 0) * 2",
    ],
)  # fmt: skip
def test_numbers_are_those_of_python(text: str) -> None:
    # the reference alone executes the text, and it is written above
    wanted = float(eval(text, {"__builtins__": {}}, PYTHON | NAMES))
    if " and " in text or " or " in text:
        wanted = float(bool(wanted))
    assert float(parse_expression(text)(NAMES)) == pytest.approx(wanted, rel=1e-14, abs=1e-14)


def test_random_arithmetic_agrees_with_python() -> None:
    rng = np.random.default_rng(5)

    def build(depth: int) -> str:
        if depth == 0 or rng.random() < 0.2:
            return str(rng.choice(["a", "b", "c", "2", "0.5", "pi"]))
        kind = rng.integers(4)
        one, two = build(depth - 1), build(depth - 1)
        if kind == 0:
            return f"({one} {rng.choice(list('+-*'))} {two})"
        if kind == 1:
            return f"{rng.choice(['sin', 'cos', 'abs', 'atan'])}({one})"
        if kind == 2:
            return f"{rng.choice(['min', 'max'])}({one}, {two})"
        return f"({one} if {two} > {build(0)} else -{one})"

    for _ in range(300):
        text = build(4)
        wanted = float(eval(text, {"__builtins__": {}}, PYTHON | NAMES))
        assert float(parse_expression(text)(NAMES)) == pytest.approx(wanted, rel=1e-12, abs=1e-12), text


def test_names_with_dots_and_braces_and_whole_arrays() -> None:
    expression = parse_expression("foot.L.roll * 2 + {Left Hand.001}.twist.x - index.1.L.rotation.z")
    assert expression.names == ("foot.L.roll", "Left Hand.001.twist.x", "index.1.L.rotation.z")
    values = {n: np.arange(6.0).reshape(2, 3) * k for k, n in enumerate(expression.names, 1)}
    assert np.allclose(expression(values), np.arange(6.0).reshape(2, 3) * (2 + 2 - 3))


def test_every_function_is_compared_with_python() -> None:
    assert set(FUNCTIONS) <= set(PYTHON)


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("", "expected a number"), ("a +", "got 'the end'"), ("a b", "expected an operator"), ("(a", r"expected '\)'"),
        ("a)", "expected an operator"), ("a < b < c", "do not chain"), ("min(a)", "expected 2 to 16 arguments"),
        ("sin(a, b)", "expected 1 arguments"), ("a if b", "expected 'else'"), ("a @ b", "cannot read '@ b'"),
        ("1.2.3", "cannot read"), ("2x", "cannot read"), ("'text'", "cannot read"), ("[a]", "cannot read"), ("a = b", "cannot read"),
        ("a.__class__()", "no function"), ("__import__(a)", "no function"), ("eval(a)", "no function"), ("sine(a)", "nearest: 'sign'|nearest: 'sin'"),
        ("(" * 100 + "a" + ")" * 100, "nested too deeply"), ("2 ** " * 100 + "a", "nested too deeply"), ("a+" * 5000 + "a", "at most 4096"),
    ],
)  # fmt: skip
def test_what_is_no_expression_is_refused_and_says_where(text: str, what: str) -> None:
    with pytest.raises((ShapeError, UnknownName), match=what):
        parse_expression(text)


def test_a_name_without_a_value_is_named() -> None:
    with pytest.raises(UnknownName, match="no channel 'arm'; nearest: 'arms'"):
        parse_expression("arm + 1")({"arms": 1.0})


def test_what_has_no_value_is_not_finite_and_raises_no_warning() -> None:
    with np.errstate(all="raise"):
        for text in ("1 / zero", "zero / zero", "log(b)", "sqrt(b)", "exp(1000)", "b ** 0.5"):
            assert not np.isfinite(parse_expression(text)(NAMES))
