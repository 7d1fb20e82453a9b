"""Blocks of numbers: the small path in Python and the compiled one give the same, bit for bit."""

from __future__ import annotations

import random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from keypose.io import text
from keypose.io.text import format_rows, line_of, parse_block, shown
from keypose.kernels.text import format_numbers, parse_numbers

_LETTERS = "0123456789.+-eE \t\n\r\f\0\x1f_nainfxX,#\xff"


def both(data: bytes, start: int, end: int) -> None:
    """The two readers agree on the numbers, and on the place of what is none."""
    assert end - start <= text.SMALL_BYTES
    values, wrong = parse_block(data, start, end)
    fast_values, fast_wrong = parse_numbers(data, start, end)
    assert wrong == fast_wrong
    assert values.view(np.uint64).tolist() == fast_values.view(np.uint64).tolist()


@settings(max_examples=300, deadline=None)
@given(st.text(st.sampled_from(_LETTERS), max_size=60), st.integers(0, 9), st.integers(0, 9))
def test_both_readers_agree_on_anything(word: str, head: int, tail: int) -> None:
    data = word.encode("latin-1")
    both(data, min(head, len(data)), max(min(head, len(data)), len(data) - tail))


def test_both_readers_agree_on_numbers_of_every_kind() -> None:
    dice = random.Random(5)
    words = ["0", "-0", "+0.0", "1.", ".5", "-.25", "1e5", "1E-05", "+3e+2", "1e999", "-1e999", "1e-400", "5e-324"]
    words += ["123456789012345678901234567890", "0.1234567890123456789", "9007199254740993", "1e22", "1e23"]
    words += [repr(dice.uniform(-1e3, 1e3)) for _ in range(300)] + [f"{dice.gauss(0, 90):.6f}" for _ in range(300)]
    words += [repr(dice.random() * 10 ** dice.randint(-300, 300)) for _ in range(300)]
    data = "".join(word + dice.choice((" ", "\t", "\r\n", "\r", "  \n")) for word in words).encode()
    both(data, 0, len(data))
    values, wrong = parse_block(data, 0, len(data))
    assert wrong == -1 and values.tolist() == [float(word) for word in words]


@pytest.mark.parametrize(
    "word", ["nan", "inf", "-Infinity", "1_0", "0x10", "1,5", "1.2.3", "--1", "1e", "e5", ".", "1-2", "٣"]
)
def test_what_is_no_number_is_found(word: str) -> None:
    data = f"1 2.5\n{word} 4".encode()
    both(data, 0, len(data))
    values, wrong = parse_block(data, 0, len(data))
    assert values.tolist() == [1, 2.5] and wrong == 6


@pytest.mark.parametrize("decimals", [0, 1, 3, 6, 8, 9])
def test_both_writers_agree(decimals: int) -> None:
    rng = np.random.default_rng(decimals)
    values = rng.normal(size=(200, 7)) * 10.0 ** rng.integers(-9, 6, size=(200, 7))
    values[0] = [0.0, -0.0, 0.5, -0.5, 1e-12, -1e-12, 2.5]
    values[1] = np.round(values[1], 3)
    assert format_rows(values, decimals) == format_numbers(values, decimals)
    lines = format_rows(values, decimals).decode().splitlines()
    assert lines == [" ".join(f"{v:.{decimals}f}" for v in row) for row in values.tolist()]


def test_no_rows_and_no_columns() -> None:
    assert format_rows(np.zeros((0, 3)), 6) == b""
    assert format_rows(np.zeros((2, 0)), 6) == b"\n\n"
    assert parse_block(b"", 0, 0)[0].shape == (0,)


def test_lines_are_counted_for_every_line_end() -> None:
    data = b"a\nb\r\nc\rd\n\ne"
    assert [line_of(data, data.index(c)) for c in b"abcde"] == [1, 2, 3, 4, 6]


def test_words_in_messages_are_short_and_printable() -> None:
    assert shown("Hips") == "'Hips'" and shown(b"") == "nothing"
    assert shown(b"\x00\n\x1b[31m") == "'���[31m'"
    assert len(shown(b"x" * 10_000_000)) < 40
