"""What the readers and writers of text formats share: numbers in blocks, lines, words shown in error messages.

Large blocks of numbers go to `keypose.kernels.text`. Small ones are done here in plain Python with the same results,
bit for bit, because loading the compiled kernels takes longer than a small file does.
"""

from __future__ import annotations

import re

import numpy as np

from keypose.arrays import Floats

SMALL_BYTES = 200_000
SMALL_NUMBERS = 25_000
_WORD = re.compile(rb"[^\x00-\x20]+")
_NUMBER = re.compile(rb"[+-]?(?:[0-9]++\.?[0-9]*+|\.[0-9]++)(?:[eE][+-]?[0-9]++)?")
_DIGITS_AND_BLANKS = re.compile(rb"[\x00-\x20+\-.0-9eE]*+")
_BLANKS = bytes(32 if code <= 32 else code for code in range(256))


def parse_block(data: bytes | bytearray, start: int, end: int, *, compiled: bool | None = None) -> tuple[Floats, int]:
    """The blank-separated numbers of ``data[start:end]``, and the byte offset of the first word that is no number.

    Shapes and units:
        returns (N,) float64 and -1, or what came before the wrong word and its offset. Every byte up to 32 is a blank;
        ``nan``, ``inf``, hexadecimal and underscored numbers are wrong words.
        ``compiled`` chooses the path; by default large blocks take the compiled one.
    """
    if end - start > SMALL_BYTES if compiled is None else compiled:
        from keypose.kernels.text import parse_numbers

        return parse_numbers(data, start, end)
    if _DIGITS_AND_BLANKS.fullmatch(data, start, end):
        try:
            return np.array([float(word) for word in data[start:end].translate(_BLANKS).split()], np.float64), -1
        except ValueError:
            pass
    values: list[float] = []
    for word in _WORD.finditer(data, start, end):
        if not _NUMBER.fullmatch(word[0]):
            return np.array(values, np.float64), word.start()
        values.append(float(word[0]))
    return np.array(values, np.float64), -1


def format_rows(values: Floats, decimals: int, *, compiled: bool | None = None) -> bytes:
    """Rows of fixed-point numbers, blank-separated, each row with a line feed at its end.

    Shapes and units:
        values: (T, C) float64.
        ``compiled`` chooses the path; by default large tables take the compiled one.
    """
    if values.size > SMALL_NUMBERS if compiled is None else compiled:
        from keypose.kernels.text import format_numbers

        return format_numbers(values, decimals)
    line = " ".join([f"%.{decimals}f"] * values.shape[1]) + "\n"
    return "".join([line % tuple(row) for row in values.tolist()]).encode()


def to_number(word: str, largest: float) -> float:
    """A finite number of at most ``largest``; raises ValueError for anything else, also for 1_000, nan and inf."""
    value = float(word)
    if "_" in word or not abs(value) <= largest:
        raise ValueError(word)
    return value


def line_of(data: bytes, offset: int) -> int:
    """The line, counted from 1, of a byte; CR LF, LF and CR each end a line."""
    before = data[:offset]
    return 1 + before.count(b"\n") + before.count(b"\r") - before.count(b"\r\n")


def shown(word: str | bytes, longest: int = 32) -> str:
    """A word of a file for an error message: quoted, printable and short."""
    text = word[: 4 * longest].decode("latin-1") if isinstance(word, bytes) else word[: 4 * longest]
    text = "".join(c if c.isprintable() else "�" for c in text)
    return f"'{text[:longest]}…'" if len(text) > longest + 1 else f"'{text}'" if text else "nothing"
