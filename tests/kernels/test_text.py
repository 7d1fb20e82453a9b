"""Numbers of text files: the bits of Python's float(), the characters of its "%.6f", and damaged text."""

from __future__ import annotations

import math
import random
import struct

import numpy as np
import pytest

from keypose.errors import ShapeError
from keypose.kernels.text import MAX_DECIMALS, format_numbers, parse_numbers


def random_double(rng):
    while True:
        value = struct.unpack("d", struct.pack("Q", rng.getrandbits(64)))[0]
        if math.isfinite(value):
            return value


def random_words(rng, count):
    makers = [
        lambda: repr(random_double(rng)),
        lambda: f"{rng.uniform(-1000, 1000):.6f}",
        lambda: f"{rng.uniform(-1, 1) * 10 ** rng.uniform(-320, 307):.{rng.randrange(25)}e}",
        lambda: f"{rng.uniform(-1, 1) * 10 ** rng.uniform(-6, 17):.{rng.randrange(22)}f}",
        lambda: repr(rng.uniform(-180, 180)),
        lambda: f"{rng.getrandbits(rng.randrange(1, 80))}e{rng.randrange(-345, 310)}",
        lambda: rng.choice(["0", "-0", "+5", "5.", ".5", "-.5", "1E5", "1e+5", "00012", "0.0000000000000000000000001"]),
    ]
    return [rng.choice(makers)() for _ in range(count)]


def assert_bits(got, wanted):
    got, wanted = np.asarray(got, float), np.asarray(wanted, float)
    assert got.shape == wanted.shape
    different = np.nonzero(got.view(np.uint64) != wanted.view(np.uint64))[0]
    assert not len(different), (got[different[:3]], wanted[different[:3]])


@pytest.mark.parametrize("seed", range(6))
def test_every_number_has_the_bits_of_float(seed):
    rng = random.Random(seed)
    words = random_words(rng, 20_000)
    blanks = [" ", "  ", "\n", "\r\n", "\t", " \x0b\x0c "]
    text = "".join(word + rng.choice(blanks) for word in words)
    values, wrong = parse_numbers(text.encode())
    assert wrong == -1
    assert_bits(values, [float(word) for word in words])


def test_halfway_cases_and_the_ends_of_the_range():
    words = [
        "9007199254740993", "9007199254740993.0", "9007199254740992.99999999999999999999", "1.7976931348623157e308",
        "1.7976931348623159e308", "4.9406564584124654e-324", "2.4703282292062327e-324", "2.4703282292062328e-324",
        "2.2250738585072011e-308", "2.2250738585072014e-308", "123456789012345678901234567890", "1e23", "8.5e22",
        "0." + "0" * 400 + "1", "1" + "0" * 400, "0e999999999999999999999", "1e-999999999999999999999", "6.02214076e23",
        "1e400", "-1e400", "9223372036854775808", "18446744073709551616", "0.1e1", "1.00000000000000011102230246251565",
    ]  # fmt: skip
    values, wrong = parse_numbers(" ".join(words).encode())
    assert wrong == -1
    assert_bits(values, [float(word) for word in words])


def test_more_hard_numbers_than_one_run_sets_aside():
    words = [f"0.1{k:030d}7" for k in range(5000)]
    values, wrong = parse_numbers(("\n".join(words)).encode())
    assert wrong == -1
    assert_bits(values, [float(word) for word in words])


@pytest.mark.parametrize(
    "word",
    ["nan", "NaN", "inf", "-inf", "1_000", "0x10", "1e", "1e+", "e5", "-", "+", ".", "-.", "1.2.3", "1-2", "--1", "1,2",
     "12a", "\xff", "1e5.0", "}", "1" * 30 + "x", "0." + "1" * 30 + "x"],
)  # fmt: skip
@pytest.mark.parametrize("before", ["", "1 2.5 ", "3 " * 100])
@pytest.mark.parametrize("after", ["", " 7", " 8" * 100])
def test_what_is_no_number_stops_the_reading_at_its_offset(word, before, after):
    values, wrong = parse_numbers((before + word + after).encode("latin-1"))
    assert wrong == len(before)
    assert_bits(values, [float(w) for w in before.split()])


@pytest.mark.parametrize("size", [0, 1, 7, 23, 24, 25, 63, 64, 65, 127, 128, 129, 200])
def test_nothing_beyond_the_end_is_read_at_any_length(size):
    text = ("-12.345678 3.5 7 " * 20).encode()
    whole = np.frombuffer(text + b"9" * 100, np.uint8)
    for start in (0, 1, 11, 12):
        piece = text[start : start + size]
        values, wrong = parse_numbers(whole, start, min(start + size, len(text)))
        try:
            assert_bits(values, [float(w) for w in piece.split()])
            assert wrong == -1
        except ValueError:  # the cut left a lone sign
            assert wrong >= 0


def test_random_bytes_never_hang_or_crash():
    rng = random.Random(11)
    for _ in range(3000):
        alphabet = rng.choice([bytes(range(256)), b"0123456789.-+eE \n", b"0123456789 ", b"nan 1.5\x00"])
        data = bytes(rng.choice(alphabet) for _ in range(rng.randrange(200)))
        values, wrong = parse_numbers(data)
        words = data.translate(bytes(32 if c <= 32 else c for c in range(256))).split()
        if wrong >= 0:
            assert data[wrong] > 32
        else:
            assert_bits(values, [float(w) for w in words])


def test_offsets_beyond_the_text_are_brought_back():
    assert parse_numbers(b"1 2", -5, 99)[0].tolist() == [1, 2]
    assert parse_numbers(b"1 2", 3, 1)[0].tolist() == []
    assert parse_numbers(bytearray(b"1 2"))[0].tolist() == [1, 2]
    with pytest.raises(ShapeError, match="uint8"):
        parse_numbers(np.zeros(3))


@pytest.mark.parametrize("decimals", range(MAX_DECIMALS + 1))
def test_rounding_is_that_of_printf(decimals):
    rng = np.random.default_rng(decimals)
    spread = [rng.normal(0, 10.0**k, 400) for k in range(-9, 13)]
    halves = [np.arange(400) / 2.0**k for k in (1, 2, 3, 5, 8, 13, 20)]
    ties = [(np.arange(400) + 0.5) / 10.0**k for k in range(7)]
    edges = [
        np.array([0.0, -0.0, 0.9999999999999999, 9.9999999, 99999999.99999999, 99999999.5, 1e8, 1e14, 123456789.0])
    ]
    values = np.concatenate(spread + halves + ties + edges)
    values = np.concatenate([values, -values])
    values = np.resize(values, (len(values) // 7, 7))
    wanted = "".join(" ".join(f"{v:.{decimals}f}" for v in row) + "\n" for row in values.tolist())
    assert format_numbers(values, decimals) == wanted.encode()


def test_huge_values_take_another_way_to_the_same_text():
    values = np.array([[1e15, -1e300], [0.1, 5e-324]])
    assert (
        format_numbers(values, 3) == "".join(" ".join(f"{v:.3f}" for v in r) + "\n" for r in values.tolist()).encode()
    )


def test_twelve_decimals_of_angles_come_back_within_half_a_unit():
    values = np.random.default_rng(0).uniform(-180, 180, (500, 9))
    back, wrong = parse_numbers(format_numbers(values, 12))
    assert wrong == -1 and abs(back.reshape(values.shape) - values).max() <= 5.3e-13


def test_shapes_and_values_that_cannot_be_written():
    assert format_numbers(np.zeros((3, 0))) == b"\n\n\n"
    assert format_numbers(np.zeros((0, 3))) == b""
    assert format_numbers([[1, 2]], 0) == b"1 2\n"
    values = np.ones((4, 3))
    for bad in (np.nan, np.inf, -np.inf):
        values[2, 1] = bad
        with pytest.raises(ShapeError, match="row 2, column 1"):
            format_numbers(values)
    with pytest.raises(ShapeError, match="decimals"):
        format_numbers(np.ones((1, 1)), 16)
    with pytest.raises(ShapeError, match=r"rows, columns"):
        format_numbers(np.ones(3))
    frozen = np.ones((2, 2))
    frozen.flags.writeable = False
    assert format_numbers(frozen, 1) == b"1.0 1.0\n1.0 1.0\n"
