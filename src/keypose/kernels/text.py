# pyright: basic
"""Numbers of text files: bytes to float64 and back, correctly rounded.

Reading: blanks are found 64 bytes at a time, then each number is read as two words of eight characters, integer and
fraction. With at most 15 digits and a power of ten up to 10^22 both operands of the one division are exact, so it
rounds correctly. Longer numbers go through one or two 128-bit products (Lemire), the few that even these cannot
hold through Python's float().

Source: W. D. Clinger, "How to read floating point numbers accurately", 1990; D. Lemire, "Number parsing at a gigabyte
per second", 2021; N. Mushtak, D. Lemire, "Fast number parsing without fallback", 2023.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from keypose.errors import ShapeError
from keypose.kernels.runtime import exact_inlined, exact_kernel
from keypose.kernels.vectors import pointer
from keypose.kernels.words import (
    BLOCK,
    CHARACTERS,
    HIGH_BITS,
    OVER_NINE,
    address_of,
    bits_of_float,
    blank_mask,
    count_ones,
    digits_to_integer,
    float_of_bits,
    integer_to_digits,
    join_digits,
    leading_digits,
    leading_zeros,
    load_byte,
    load_word,
    multiply_wide,
    point_mask,
    product_error,
    store_byte,
    store_word,
    trailing_zeros,
)
from keypose.kernels.wordvectors import (
    COUNT,
    any_bit,
    gather_text,
    gather_words,
    load_triplets,
    store_quotients,
)

MAX_DECIMALS = 15
_SPACE, _PLUS, _MINUS, _POINT, _ZERO, _NEWLINE, _LETTER_E = 32, 43, 45, 46, 48, 10, 101
_POWERS = 10.0 ** np.arange(23)
_INTEGER_POWERS = np.array([10**k for k in range(20)], np.uint64)
_EXACT = np.uint64(1 << 53)  # integers up to here are exact in float64
_SMALLEST, _LARGEST = -342, 308  # decimal exponents of nineteen digits that are neither 0 nor infinite
_HARD = 1024  # numbers set aside for Python in one run of the kernel

_CHUNK = 256  # numbers formatted at a time
_TEXT_CHUNK = 32 * BLOCK  # bytes whose marks are found at a time
_LONGEST = BLOCK  # marks of a single word: more points than this are in no number
_BYTE, _ONE, _THREE, _SEVEN = np.uint64(0xFF), np.uint64(1), np.uint64(3), np.uint64(7)
_EIGHT_DIGITS = np.uint64(100000000)
_ROUNDER = 4503599627370496.0  # 2^52: adding and taking it away rounds to an integer, half to even

_OK, _BAD, _FULL = 0, 1, 2
_PLAIN, _SET_ASIDE, _NO_NUMBER = 0, 1, 2


# --- Python-level entries -------------------------------------------------------------------------------------------------


def parse_numbers(data: Any, start: int = 0, end: int | None = None) -> tuple[np.ndarray, int]:
    """All numbers of a blank-separated text, with the same bits as Python's float() would give.

    Numbers are decimal with optional sign, point and exponent; "nan", "inf" and anything else stop the reading.
    Every byte up to 32 is a blank.

    Shapes and units:
        data: bytes, or an array of uint8; ``start`` and ``end`` are byte offsets.
        Returns (N,) float64 and -1, or the numbers before it and the offset of what is not a number.
    """
    text = np.frombuffer(data, np.uint8) if not isinstance(data, np.ndarray) else np.ascontiguousarray(data).reshape(-1)
    if text.dtype != np.uint8:
        raise ShapeError(f"text: expected bytes or an array of uint8, got {text.dtype}")
    if text.flags.writeable:
        text = text.view()
        text.flags.writeable = False
    end = len(text) if end is None else min(max(end, 0), len(text))
    start = min(max(start, 0), end)
    values = np.empty(_count_tokens(text, start, end, _last_block(text, start, end)))
    hard, table = np.empty((_HARD, 3), np.int64), _five_powers()
    count, at = 0, start
    while True:
        rest = _last_block(text, at, end)
        status, count, at, set_aside = _parse(text, at, end, rest, values, count, table, hard)
        for index, first, last in hard[:set_aside].tolist():
            values[index] = float(text[first:last].tobytes())
        if status != _FULL:
            return values[:count], at if status == _BAD else -1


def format_numbers(values: Any, decimals: int = 6) -> bytes:
    """Rows of fixed-point numbers as text, each rounded as Python's "%.6f" would.

    Six decimals are what BVH files usually hold; 15 keep every bit of angles in degrees above 1e-1 or so.

    Shapes and units:
        values: (rows, columns) float64.
        Returns the bytes: columns separated by one space, rows ended by a line feed.

    Raises:
        ShapeError: where a value is not finite, the array is not two-dimensional or decimals is not 0 to 15.
    """
    table = np.ascontiguousarray(values, np.float64)
    if table.ndim != 2:
        raise ShapeError(f"values: expected (rows, columns), got {table.shape}")
    if not 0 <= decimals <= MAX_DECIMALS:
        raise ShapeError(f"decimals: expected 0 to {MAX_DECIMALS}, got {decimals}")
    if not table.size:
        return b"\n" * len(table)
    largest = max(abs(float(table.max())), abs(float(table.min())))
    if not np.isfinite(largest):
        row, column = np.argwhere(~np.isfinite(table))[0]
        raise ShapeError(f"values: expected finite numbers, got {table[row, column]} in row {row}, column {column}")
    if largest >= 1e15:
        line = " ".join([f"%.{decimals}f"] * table.shape[1]) + "\n"
        return "".join(line % tuple(row) for row in table.tolist()).encode()
    width = len(str(int(largest) + 1)) + decimals + 3  # sign, digits, point, decimals, blank
    text = np.empty(table.size * width + 16, np.uint8)  # words of eight reach past the last character
    flat = table.reshape(-1).view()  # a view, so that the caller's array stays writable
    flat.flags.writeable = False
    size = _format(flat, table.shape[1], decimals, text)
    return text[:size].tobytes()


def _last_block(text: np.ndarray, start: int, end: int) -> np.ndarray:
    """A copy of the last, incomplete block, so that the kernels never touch what lies beyond ``end``."""
    block = np.zeros(BLOCK, np.uint8)
    tail = (end - start) % BLOCK
    block[:tail] = text[end - tail : end]
    return block


# --- reading ----------------------------------------------------------------------------------------------------------------


@exact_inlined
def _blanks(text, at, end, rest):
    """Blank mask of the 64 bytes from ``at``; everything from ``end`` on counts as blank.

    ``rest`` holds a copy of the last bytes before ``end``, so that nothing beyond it is touched.
    """
    if end - at >= BLOCK:
        return blank_mask(text, at)
    return blank_mask(rest, 0) | (~np.uint64(0) << np.uint64(end - at))


@exact_kernel
def _count_tokens(text, start, end, rest):
    text, rest = address_of(text), address_of(rest)
    total, before = np.uint64(0), np.uint64(1)
    for at in range(start, end, BLOCK):
        blank = _blanks(text, at, end, rest)
        total += count_ones(~blank & ((blank << np.uint64(1)) | before))
        before = blank >> np.uint64(63)
    return np.int64(total)


@exact_inlined
def _find_marks(text, block, end, rest, before, marks, count):
    """Append the places in one block where a number begins, has a point, or ends; (count, carry to the next block)."""
    if end - block >= BLOCK:
        blank, points = blank_mask(text, block), point_mask(text, block)
    else:
        beyond = ~np.uint64(0) << np.uint64(end - block)
        blank, points = blank_mask(rest, 0) | beyond, point_mask(rest, 0) & ~beyond
    found = blank ^ ((blank << np.uint64(1)) | before) | points
    total = count + np.int64(count_ones(found))
    # Eight at a time without asking; what is too much is overwritten later.
    while count < total:
        for _ in range(8):
            marks[count] = block + np.int64(trailing_zeros(found))
            found &= found - np.uint64(1)
            count += 1
    return total, blank >> np.uint64(63)


@exact_kernel
def _parse(data, start, end, rest, values, count, table, hard):
    """(status, count, place, set aside): reads until the end, a bad number, or a full list of hard ones."""
    text, rest = address_of(data), address_of(rest)
    memory = np.empty(_TEXT_CHUNK + 2 * BLOCK, np.int64)
    marks, out = pointer(memory), pointer(values)
    powers, integer_powers = address_of(_POWERS), address_of(_INTEGER_POWERS)
    safe = data.shape[0] - 32  # a number that starts up to here may be read by whole words
    before, found, set_aside = np.uint64(1), 0, 0
    plain, patience = 0, COUNT
    for chunk in range(start, end + 1, _TEXT_CHUNK):  # up to the end itself, where the last number ends
        for block in range(chunk, min(chunk + _TEXT_CHUNK, end + 1), BLOCK):
            found, before = _find_marks(text, block, end, rest, before, marks, found)
        k = 0
        while True:
            if plain == 0:
                while k + 3 * COUNT <= found and marks[k + 3 * COUNT - 1] <= safe:
                    if _eight_numbers(text, marks, k, out, count, powers, integer_powers):
                        break
                    k += 3 * COUNT
                    count += COUNT
                    patience = COUNT
                # Something unusual: the next few one by one, and more of them where it stays so.
                plain, patience = patience, min(2 * patience, 64 * COUNT)
            plain = max(plain - 1, 0)
            # One number: from the mark at k to the next that is not a point.
            last = k + 1
            while last < found and marks[last] < end and load_byte(text, marks[last]) > _SPACE:
                last += 1
            if last >= found:
                break
            first, at = marks[k], marks[last]
            k = last + 1
            value, ok = 0.0, False
            if first <= safe:
                value, ok = _common_number(text, first, at, table)
            if not ok:
                value, kind = _any_number(text, first, at, table)
                if kind == _NO_NUMBER:
                    return _BAD, count, first, set_aside
                if kind == _SET_ASIDE:
                    hard[set_aside, 0], hard[set_aside, 1], hard[set_aside, 2] = count, first, at
                    set_aside += 1
            values[count] = value
            count += 1
            if set_aside == hard.shape[0]:
                return _FULL, count, at, set_aside
        for j in range(found - k):  # the beginning of a number that goes on in the next chunk
            marks[j] = marks[k + j]
        found -= k
        if found > _LONGEST:
            return _BAD, count, marks[0], set_aside
    return _OK, count, end, set_aside


@exact_inlined
def _eight_numbers(text, marks, k, values, count, powers, integer_powers):
    """Eight numbers of at most seven digits, a point and at most seven digits; True if one is not like that.

    ``wrong`` collects bits that are set where a number is different.
    """
    first, point, last = load_triplets(marks, k)
    word = gather_text(text, first)
    negative = (((word & _BYTE) ^ np.uint64(_MINUS)) - _ONE) >> np.uint64(63)
    word = word >> (negative << _THREE)
    digits, places = point - first - negative, last - point - _ONE
    fraction = gather_text(text, point + _ONE)
    wrong = (digits >> _THREE) | (places >> _THREE) | ((digits + places - _ONE) >> np.uint64(63))
    digits, places = digits & _SEVEN, places & _SEVEN
    eight_digits, eight_places = digits << _THREE, places << _THREE
    wrong = wrong | (((word >> eight_digits) & _BYTE) ^ np.uint64(_POINT))
    wrong = wrong | ((np.uint64(_SPACE) - ((fraction >> eight_places) & _BYTE)) >> np.uint64(63))
    half = np.uint64(32) - (digits << np.uint64(2))
    word = ((word ^ CHARACTERS) << half) << half
    half = np.uint64(32) - (places << np.uint64(2))
    fraction = ((fraction ^ CHARACTERS) << half) << half
    wrong = wrong | (((word + OVER_NINE) | word | (fraction + OVER_NINE) | fraction) & HIGH_BITS)
    if any_bit(wrong):
        return True
    mantissa = join_digits(word) * gather_words(integer_powers, places) + join_digits(fraction)
    store_quotients(values, count, mantissa, powers, places, negative << np.uint64(63))
    return False


@exact_inlined
def _common_number(text, first, end, table):
    """(value, True) for a sign, up to eight digits, a point and up to sixteen digits; (0, False) for others."""
    sign = load_byte(text, first)
    negative = sign == _MINUS
    at = first + np.intp(negative or sign == _PLUS)
    word = load_word(text, at)
    digits = leading_digits(word)
    mantissa = digits_to_integer(word, digits)
    at += np.int64(digits)
    places = np.uint64(0)
    if load_byte(text, at) == _POINT:
        word = load_word(text, at + 1)
        places = leading_digits(word)
        mantissa = mantissa * _INTEGER_POWERS[places] + digits_to_integer(word, places)
        at += np.int64(places) + 1
        if places == 8 and at < end:
            word = load_word(text, at)
            more = leading_digits(word)
            mantissa = mantissa * _INTEGER_POWERS[more] + digits_to_integer(word, more)
            at += np.int64(more)
            places += more
    ok = at == end and digits + places > 0 and digits + places < 20
    if mantissa <= _EXACT:
        value = np.float64(np.int64(mantissa)) / _POWERS[places]
    else:
        value = _scaled(mantissa, -np.int64(places), table)
    return -value if negative else value, ok


@exact_kernel
def _any_number(text, first, end, table):
    """(value, kind) of a number of any length; never looks at or beyond ``end``."""
    at = first
    negative = load_byte(text, at) == _MINUS
    if negative or load_byte(text, at) == _PLUS:
        at += 1
    mantissa, exponent, kept, digits, lost, after_point = np.uint64(0), 0, 0, 0, False, False
    while at < end:
        character = load_byte(text, at)
        digit = character - np.uint8(_ZERO)  # wraps: everything but a digit is > 9
        if digit < 10:
            digits += 1
            if kept < 19:
                mantissa = mantissa * np.uint64(10) + np.uint64(digit)
                kept += mantissa != 0
                exponent -= after_point
            else:
                lost |= digit != 0
                exponent += not after_point
        elif character == _POINT and not after_point:
            after_point = True
        else:
            break
        at += 1
    if digits == 0:
        return 0.0, _NO_NUMBER
    if at < end:
        if load_byte(text, at) | 32 != _LETTER_E:
            return 0.0, _NO_NUMBER
        at += 1
        down = at < end and load_byte(text, at) == _MINUS
        if down or (at < end and load_byte(text, at) == _PLUS):
            at += 1
        if at == end:
            return 0.0, _NO_NUMBER
        written = 0
        while at < end:
            digit = load_byte(text, at) - np.uint8(_ZERO)
            if digit > 9:
                return 0.0, _NO_NUMBER
            written = min(written * 10 + np.int64(digit), 1 << 40)
            at += 1
        exponent += -written if down else written
    if lost:
        return 0.0, _SET_ASIDE
    if mantissa <= _EXACT and -22 <= exponent <= 22:
        value = np.float64(np.int64(mantissa))
        value = value / _POWERS[-exponent] if exponent < 0 else value * _POWERS[exponent]
    else:
        value = _scaled(mantissa, exponent, table)
    return -value if negative else value, _PLAIN


@exact_kernel
def _scaled(mantissa, exponent, table):
    """mantissa * 10^exponent, correctly rounded, by a 128-bit product with a power of five (Lemire, section 5)."""
    if mantissa == 0 or exponent < _SMALLEST:
        return 0.0
    if exponent > _LARGEST:
        return np.inf
    shift = leading_zeros(mantissa)
    normal = mantissa << shift
    row = exponent - _SMALLEST
    high, low = multiply_wide(normal, table[row, 0])
    if high & np.uint64(0x1FF) == np.uint64(0x1FF):  # too close to call: take the lower half of the power too
        more, _ = multiply_wide(normal, table[row, 1])
        low += more
        if low < more:
            high += np.uint64(1)
    upper = high >> np.uint64(63)
    drop = upper + np.uint64(9)
    bits = high >> drop  # 54 bits: the 53 of the result and one to round by
    power = ((217706 * exponent) >> 16) + 63 + np.int64(upper) - np.int64(shift) + 1023
    if power <= 0:  # subnormal
        if power <= -63:
            return 0.0
        bits >>= np.uint64(1 - power)
        bits = (bits + (bits & np.uint64(1))) >> np.uint64(1)
        return float_of_bits(bits)  # a carry into bit 52 makes it the smallest normal number
    if low <= 1 and -4 <= exponent <= 23 and bits & np.uint64(3) == 1 and (bits << drop) == high:
        bits &= ~np.uint64(1)  # exactly halfway: to even
    bits = (bits + (bits & np.uint64(1))) >> np.uint64(1)
    if bits >> np.uint64(53):
        bits >>= np.uint64(1)
        power += 1
    if power >= 2047:
        return np.inf
    return float_of_bits((bits & np.uint64((1 << 52) - 1)) | (np.uint64(power) << np.uint64(52)))


@cache
def _five_powers() -> np.ndarray:
    """(651, 2) uint64: the 128 leading bits of 5^k for each decimal exponent k, rounded up where k < 0."""
    rows = []
    for k in range(_SMALLEST, _LARGEST + 1):
        five = 5 ** abs(k)
        if k >= 0:
            shift = 128 - five.bit_length()
            bits = five << shift if shift >= 0 else five >> -shift
        else:
            bits = (1 << (five.bit_length() + 255)) // five + 1
            bits >>= bits.bit_length() - 128
        rows.append((bits >> 64, bits & (2**64 - 1)))
    table = np.array(rows, np.uint64)
    table.flags.writeable = False
    return table


# --- writing ----------------------------------------------------------------------------------------------------------------


@exact_kernel
def _format(values, columns, decimals, buffer):
    """How many bytes were written; every value must be below 1e15 in size."""
    text, at, column = address_of(buffer), 0, 0
    unit = _POWERS[decimals]
    fill = _INTEGER_POWERS[(8 if decimals <= 8 else 16) - decimals]
    whole, part = np.empty(_CHUNK, np.uint64), np.empty(_CHUNK, np.uint64)
    for start in range(0, values.shape[0], _CHUNK):
        count = min(_CHUNK, values.shape[0] - start)
        if not _split_plainly(values, start, count, unit, whole, part) or decimals == 0:
            _split_carefully(values, start, count, unit, whole, part)
        # Many values' digits at a time, which the compiler does in vectors; then character by character.
        long = False
        for k in range(count):
            long |= whole[k] >= _EIGHT_DIGITS
        if long or decimals > 8:
            at, column = _write_long(text, at, column, columns, decimals, fill, values, start, count, whole, part)
            continue
        for k in range(count):
            whole[k] = integer_to_digits(whole[k])
            part[k] = integer_to_digits(part[k] * fill)
        for k in range(count):
            at = _write_whole(text, at, values[start + k], whole[k])
            if decimals:
                store_byte(text, at, np.uint8(_POINT))
                store_word(text, at + 1, part[k] | CHARACTERS)
                at += decimals + 1
            column += 1
            store_byte(text, at, np.uint8(_NEWLINE if column == columns else _SPACE))
            column = 0 if column == columns else column
            at += 1
    return at


@exact_inlined
def _write_whole(text, at, value, digits):
    """Sign and integer part, without the zeros before it; the place after it."""
    store_byte(text, at, np.uint8(_MINUS))  # stays only where the value is negative
    at += np.int64(bits_of_float(value) >> np.uint64(63))
    skip = trailing_zeros(digits | np.uint64(1 << 56)) & np.uint64(0x78)  # the last digit is written in any case
    store_word(text, at, (digits | CHARACTERS) >> skip)
    return at + 8 - np.int64(skip >> np.uint64(3))


@exact_kernel
def _write_long(text, at, column, columns, decimals, fill, values, start, count, whole, part):
    """As the loop in `_format`, for more than eight digits before or after the point."""
    for k in range(count):
        top = whole[k] // _EIGHT_DIGITS
        rest = integer_to_digits(whole[k] - top * _EIGHT_DIGITS)
        if top:
            at = _write_whole(text, at, values[start + k], integer_to_digits(top))
            store_word(text, at, rest | CHARACTERS)
            at += 8
        else:
            at = _write_whole(text, at, values[start + k], rest)
        if decimals:
            store_byte(text, at, np.uint8(_POINT))
            fraction = part[k] * fill
            if decimals > 8:
                top = fraction // _EIGHT_DIGITS
                store_word(text, at + 1, integer_to_digits(top) | CHARACTERS)
                store_word(text, at + 9, integer_to_digits(fraction - top * _EIGHT_DIGITS) | CHARACTERS)
            else:
                store_word(text, at + 1, integer_to_digits(fraction) | CHARACTERS)
            at += decimals + 1
        column += 1
        store_byte(text, at, np.uint8(_NEWLINE if column == columns else _SPACE))
        column = 0 if column == columns else column
        at += 1
    return at, column


@exact_kernel
def _split_plainly(values, start, count, unit, whole, part):
    """Integer parts, and fractions in units; False where one lies halfway between two units and needs care."""
    halfway = False
    for k in range(count):
        x = abs(values[start + k])
        integer = np.int64(x)
        product = (x - np.float64(integer)) * unit
        nearest = (product + _ROUNDER) - _ROUNDER
        halfway |= abs(product - nearest) == 0.5
        carry = nearest >= unit
        whole[k] = np.uint64(integer + carry)
        part[k] = np.uint64(np.int64(0.0 if carry else nearest))
    return not halfway


@exact_kernel
def _split_carefully(values, start, count, unit, whole, part):
    """The same, rounded once and half to even, as printf does."""
    for k in range(count):
        x = abs(values[start + k])
        integer = np.int64(x)
        fraction = x - np.float64(integer)
        product = fraction * unit
        nearest = (product + _ROUNDER) - _ROUNDER
        if unit == 1.0:
            nearest = 1.0 if fraction > 0.5 or (fraction == 0.5 and integer & 1) else 0.0
        elif abs(product - nearest) == 0.5:  # the product was rounded to there; see which side it came from
            error = product_error(fraction, unit, product)
            if error > 0 and nearest < product:
                nearest += 1.0
            elif error < 0 and nearest > product:
                nearest -= 1.0
        carry = nearest >= unit
        whole[k] = np.uint64(integer + carry)
        part[k] = np.uint64(np.int64(0.0 if carry else nearest))
