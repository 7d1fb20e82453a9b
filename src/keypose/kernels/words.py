# pyright: basic
"""Machine words as Numba functions: eight bytes of text at once, bit counts, blank masks, 128-bit products.

What the text kernels are made of. Eight characters fit one 64-bit integer, first character in the lowest byte.
"""

from __future__ import annotations

import numpy as np
from llvmlite import ir
from numba import types

from keypose.kernels.runtime import exact_inlined, intrinsic
from keypose.kernels.vectors import call_llvm, read, write

_BYTE, _WORD, _SIZE = ir.IntType(8), ir.IntType(64), ir.IntType(np.intp(0).itemsize * 8)
BLOCK = 64  # bytes looked at by `blank_mask`

CHARACTERS = np.uint64(0x3030303030303030)  # from digits to their characters and back
OVER_NINE = np.uint64(0x7676767676767676)
HIGH_BITS = np.uint64(0x8080808080808080)


@intrinsic
def address_of(typing, array):
    """The address of an array's first element, an integer.

    Helpers of the text kernels take addresses: Numba counts references of arrays that it hands on, in every round of
    the loop. Whoever takes an address keeps the array alive.
    """

    def generate(context, builder, sig, args):
        data = context.make_array(sig.args[0])(context, builder, args[0]).data
        return builder.ptrtoint(data, _SIZE)

    return types.intp(array), generate


def _pointer(context, builder, sig, args, element):
    at = context.cast(builder, args[1], sig.args[1], types.intp)
    return builder.inttoptr(builder.add(args[0], at), element.as_pointer())


def _reader(element, result):
    def typed(typing, text, at):
        def generate(context, builder, sig, args):
            return read(builder, _pointer(context, builder, sig, args, element), 1)

        return result(types.intp, at), generate

    return intrinsic(typed)


def _writer(element, kind):
    def typed(typing, text, at, value):
        def generate(context, builder, sig, args):
            write(builder, args[2], _pointer(context, builder, sig, args, element), 1)
            return context.get_dummy_value()

        return types.void(types.intp, at, kind), generate

    return intrinsic(typed)


load_byte = _reader(_BYTE, types.uint8)  # load_byte(text, at): the byte at the address text + at
load_word = _reader(_WORD, types.uint64)  # eight bytes
store_byte = _writer(_BYTE, types.uint8)
store_word = _writer(_WORD, types.uint64)


def _mask(comparison, value, doc):
    def typed(typing, text, at):
        def generate(context, builder, sig, args):
            block = ir.VectorType(_BYTE, BLOCK)
            data = read(builder, _pointer(context, builder, sig, args, block), 1)
            return builder.bitcast(
                builder.icmp_unsigned(comparison, data, ir.Constant(block, [_BYTE(value)] * BLOCK)), _WORD
            )

        return types.uint64(types.intp, at), generate

    typed.__doc__ = doc
    return intrinsic(typed)


blank_mask = _mask("<=", 32, "Bit k is set where byte at + k is a blank, 0 to 32; all 64 bytes must be readable.")
point_mask = _mask("==", 46, "Bit k is set where byte at + k is a decimal point; all 64 bytes must be readable.")


def _bit_count(name, with_flag):
    def typed(typing, word):
        def generate(context, builder, sig, args):
            flag = [ir.IntType(1)(0)] if with_flag else []
            return call_llvm(builder, f"llvm.{name}.i64", _WORD, [args[0], *flag])

        return types.uint64(types.uint64), generate

    return intrinsic(typed)


trailing_zeros = _bit_count("cttz", True)  # 64 for 0
leading_zeros = _bit_count("ctlz", True)  # 64 for 0
count_ones = _bit_count("ctpop", False)


@intrinsic
def multiply_wide(typing, a, b):
    """(high, low) halves of the 128-bit product of two uint64."""

    def generate(context, builder, sig, args):
        double = ir.IntType(128)
        product = builder.mul(builder.zext(args[0], double), builder.zext(args[1], double))
        halves = [builder.trunc(builder.lshr(product, double(64)), _WORD), builder.trunc(product, _WORD)]
        return context.make_tuple(builder, sig.return_type, halves)

    return types.UniTuple(types.uint64, 2)(types.uint64, types.uint64), generate


@intrinsic
def float_of_bits(typing, word):
    """The float64 with this bit pattern."""

    def generate(context, builder, sig, args):
        return builder.bitcast(args[0], ir.DoubleType())

    return types.float64(types.uint64), generate


@intrinsic
def bits_of_float(typing, value):
    """The bit pattern of a float64."""

    def generate(context, builder, sig, args):
        return builder.bitcast(args[0], _WORD)

    return types.uint64(types.float64), generate


@intrinsic
def product_error(typing, a, b, product):
    """a * b - product without rounding, for product = the rounded a * b."""

    def generate(context, builder, sig, args):
        a, b, product = args
        return call_llvm(builder, "llvm.fma.f64", ir.DoubleType(), [a, b, builder.fneg(product)])

    return types.float64(types.float64, types.float64, types.float64), generate


@exact_inlined
def leading_digits(word):
    """How many of the eight characters, from the first on, are digits."""
    offset = word ^ CHARACTERS
    # A byte above 9 sets its high bit; a carry spoils later bytes only, and the first one is what counts.
    beyond = ((offset + OVER_NINE) | offset) & HIGH_BITS
    return trailing_zeros(beyond) >> np.uint64(3)


@exact_inlined
def join_digits(digits):
    """The number of eight digits, one per byte; of one word or of several in a vector."""
    # Neighbouring digits into pairs, then both halves of four pairs at once.
    pairs = digits * np.uint64(10) + (digits >> np.uint64(8))
    even = (pairs & np.uint64(0x000000FF000000FF)) * np.uint64(0x000F424000000064)
    odd = ((pairs >> np.uint64(16)) & np.uint64(0x000000FF000000FF)) * np.uint64(0x0000271000000001)
    return (even + odd) >> np.uint64(32)


@exact_inlined
def digits_to_integer(word, count):
    """The number that the first ``count`` characters, all digits, spell."""
    # Push the digits to the end, so that zeros come before them; in two steps, for 64 at once is not defined.
    half = np.uint64(32) - (count << np.uint64(2))
    digits = ((word ^ CHARACTERS) << half) << half
    return join_digits(digits)


@exact_inlined
def integer_to_digits(value):
    """The eight digits of a number below 10^8, one per byte and not yet characters."""
    high = value // np.uint64(10000)
    fours = high | ((value - high * np.uint64(10000)) << np.uint64(32))
    top = ((fours * np.uint64(10486)) >> np.uint64(20)) & np.uint64(0x0000007F0000007F)
    twos = top | ((fours - top * np.uint64(100)) << np.uint64(16))
    tens = ((twos * np.uint64(103)) >> np.uint64(10)) & np.uint64(0x000F000F000F000F)
    return tens | ((twos - tens * np.uint64(10)) << np.uint64(8))
