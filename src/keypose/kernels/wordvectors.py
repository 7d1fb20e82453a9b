# pyright: basic
"""Eight 64-bit words as a Numba type: the text kernels' way to read eight numbers at once.

One register with AVX-512. Elsewhere LLVM takes them apart, and eight numbers at once are still faster than one by one:
2.4, 1.8 and 1.1 times as fast as the floor of `docs/speed.md` with AVX-512, AVX2 and SSE2.
"""

from __future__ import annotations

import operator

from llvmlite import ir
from numba import types
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import lower_builtin, models, register_model

from keypose.kernels.runtime import intrinsic
from keypose.kernels.vectors import broadcast, call_llvm, read, shuffle, write

COUNT = 8

_WORD, _BIT = ir.IntType(64), ir.IntType(1)
_VECTOR = ir.VectorType(_WORD, COUNT)
_FLOATS = ir.VectorType(ir.DoubleType(), COUNT)


class Words(types.Type):
    """Eight uint64."""

    def __init__(self) -> None:
        super().__init__(name=f"Words({COUNT})")


WORDS = Words()


@register_model(Words)
class _WordsModel(models.PrimitiveModel):
    def __init__(self, manager, words):
        super().__init__(manager, words, _VECTOR)


def _define(op, instruction):
    @infer_global(op)  # pyright: ignore[reportOptionalCall]
    class _Typing(AbstractTemplate):
        def generic(self, args, kws):
            fitting = all(isinstance(a, (Words, types.Integer)) for a in args)
            if len(args) == 2 and fitting and any(isinstance(a, Words) for a in args):
                return signature(WORDS, *map(types.unliteral, args))

    def generate(context, builder, sig, args):
        a, b = (
            value
            if isinstance(kind, Words)
            else broadcast(builder, context.cast(builder, value, kind, types.uint64), 8)
            for value, kind in zip(args, sig.args, strict=True)
        )
        return getattr(builder, instruction)(a, b)

    for pair in ((Words, Words), (Words, types.Integer), (types.Integer, Words)):
        lower_builtin(op, *pair)(generate)


_define(operator.add, "add")
_define(operator.sub, "sub")
_define(operator.mul, "mul")
_define(operator.and_, "and_")
_define(operator.or_, "or_")
_define(operator.xor, "xor")
_define(operator.lshift, "shl")  # by less than 64
_define(operator.rshift, "lshr")


def _gather(builder, start, offsets, element):
    """Elements at byte addresses start + offsets."""
    places = builder.add(broadcast(builder, start, COUNT), offsets)
    vector = ir.VectorType(element, COUNT)
    pointers = builder.inttoptr(places, ir.VectorType(element.as_pointer(), COUNT))
    name = f"llvm.masked.gather.v{COUNT}{'i64' if element == _WORD else 'f64'}.v{COUNT}p0"
    every = ir.Constant(ir.VectorType(_BIT, COUNT), [_BIT(1)] * COUNT)
    return call_llvm(builder, name, vector, [pointers, ir.IntType(32)(1), every, ir.Constant(vector, ir.Undefined)])


@intrinsic
def load_triplets(typing, marks, index):
    """Three vectors of every third of the 24 int64 from ``marks[index]`` on; marks is a pointer."""

    def generate(context, builder, sig, args):
        at = context.cast(builder, args[1], sig.args[1], types.intp)
        block = ir.VectorType(_WORD, 3 * COUNT)
        whole = read(builder, builder.bitcast(builder.gep(args[0], [at]), block.as_pointer()), 8)
        parts = [shuffle(builder, whole, whole, range(k, 3 * COUNT, 3)) for k in range(3)]
        return context.make_tuple(builder, sig.return_type, parts)

    return types.UniTuple(WORDS, 3)(marks, index), generate


@intrinsic
def gather_text(typing, text, places):
    """Eight bytes of text, as one word, at each of eight places."""

    def generate(context, builder, sig, args):
        return _gather(builder, args[0], args[1], _WORD)

    return WORDS(types.intp, WORDS), generate


@intrinsic
def gather_words(typing, table, places):
    """Entries of a table of uint64; table is an address."""

    def generate(context, builder, sig, args):
        return _gather(builder, args[0], builder.shl(args[1], ir.Constant(_VECTOR, [_WORD(3)] * COUNT)), _WORD)

    return WORDS(types.intp, WORDS), generate


@intrinsic
def store_quotients(typing, values, index, numerators, table, places, signs):
    """values[index:+8] = numerators / table[places] with the sign bits flipped as ``signs`` says."""

    def generate(context, builder, sig, args):
        values, index, numerators, table, places, signs = args
        offsets = builder.shl(places, ir.Constant(_VECTOR, [_WORD(3)] * COUNT))
        denominators = _gather(builder, table, offsets, ir.DoubleType())
        quotients = builder.fdiv(builder.sitofp(numerators, _FLOATS), denominators)
        result = builder.xor(builder.bitcast(quotients, _VECTOR), signs)
        at = context.cast(builder, index, sig.args[1], types.intp)
        write(builder, result, builder.bitcast(builder.gep(values, [at]), _VECTOR.as_pointer()), 8)
        return context.get_dummy_value()

    return types.void(values, index, WORDS, types.intp, WORDS, WORDS), generate


@intrinsic
def any_bit(typing, words):
    """Whether a bit is set in any of the words."""

    def generate(context, builder, sig, args):
        combined = call_llvm(builder, f"llvm.vector.reduce.or.v{COUNT}i64", _WORD, [args[0]])
        return builder.icmp_unsigned("!=", combined, _WORD(0))

    return types.boolean(WORDS), generate
