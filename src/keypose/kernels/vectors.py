# pyright: basic
"""SIMD vectors as a Numba type.

Numba leaves vectorisation to LLVM's loop passes, which give up or use half the register for no visible reason.
Here a value of type ``Vector`` *is* one LLVM ``<W x float>`` (or ``<W/2 x double>``), so the machine code is what the
source says:

    v = load(array, i)               # W neighbours of a flat float32 array, W/2 of a float64 one
    v = 2.0 * v + splat(array, k)    # + - * / between vectors, and with plain numbers
    store(array, i, v)

The element type follows the array, so a kernel is written once for both precisions; ``lanes(array)`` is the number of
lanes. Arithmetic may fuse a * b + c; nothing else of fast-math is allowed, so NaN stays NaN.
"""

from __future__ import annotations

import operator

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import lower_builtin, models, register_model

from keypose.kernels.runtime import FEATURES, WIDTH, intrinsic

FLAGS = ("contract", "nsz")
_INT = ir.IntType(32)


class Vector(types.Type):
    """``lanes`` floating-point numbers of ``bits`` bits each."""

    def __init__(self, bits: int, lanes: int) -> None:
        self.bits, self.lanes = bits, lanes
        super().__init__(name=f"Vector(float{bits}, {lanes})")

    @property
    def element(self) -> ir.Type:
        """The LLVM type of one lane."""
        return ir.FloatType() if self.bits == 32 else ir.DoubleType()

    @property
    def scalar(self) -> types.Float:
        """The Numba type of one lane."""
        return types.float32 if self.bits == 32 else types.float64

    @property
    def llvm(self) -> ir.VectorType:
        """The LLVM type of the whole vector."""
        return ir.VectorType(self.element, self.lanes)


class IndexVector(types.Type):
    """``lanes`` 32-bit integers: where `permute` takes each lane from."""

    def __init__(self, lanes: int) -> None:
        self.lanes = lanes
        super().__init__(name=f"IndexVector({lanes})")


@register_model(Vector)
class _VectorModel(models.PrimitiveModel):
    def __init__(self, manager, vector):
        super().__init__(manager, vector, vector.llvm)


@register_model(IndexVector)
class _IndexModel(models.PrimitiveModel):
    def __init__(self, manager, vector):
        super().__init__(manager, vector, ir.VectorType(_INT, vector.lanes))


class LonePointer(types.CPointer):
    """A bare address of numbers that are worked on one by one: its vectors have a single lane."""

    def __init__(self, dtype: types.Type) -> None:
        super().__init__(dtype)
        self.name = f"{dtype}*alone"


register_model(LonePointer)(models.PointerModel)

FLOATS = Vector(32, WIDTH)
DOUBLES = Vector(64, WIDTH // 2)
INDICES = IndexVector(WIDTH)


def vector_of(array: types.Array | types.CPointer) -> Vector:
    """The vector type that belongs to an array's or pointer's elements."""
    if isinstance(array, LonePointer):
        return Vector(64 if array.dtype == types.float64 else 32, 1)
    return DOUBLES if array.dtype == types.float64 else FLOATS


# --- building blocks of the code generators ------------------------------------------------------------------------------


def constant(vector: Vector, value: float) -> ir.Constant:
    """The same number in every lane, as an LLVM constant."""
    return ir.Constant(vector.llvm, [vector.element(value)] * vector.lanes)


def shuffle(builder, a, b, order):
    """Lanes of ``a`` (0 to n-1) and ``b`` (n to 2n-1) in a fixed order."""
    return builder.shuffle_vector(a, b, ir.Constant(ir.VectorType(_INT, len(order)), [_INT(k) for k in order]))


def broadcast(builder, scalar, lanes):
    """One scalar in every lane."""
    undefined = ir.Constant(ir.VectorType(scalar.type, lanes), ir.Undefined)
    return shuffle(builder, builder.insert_element(undefined, scalar, _INT(0)), undefined, [0] * lanes)


def address(context, builder, sig, args, which, element, offset=None):
    """Pointer to the element of argument ``which``, an array or pointer, at the index in the next (plus ``offset``)."""
    data = args[which]
    if isinstance(sig.args[which], types.Array):
        data = context.make_array(sig.args[which])(context, builder, data).data
    index = context.cast(builder, args[which + 1], sig.args[which + 1], types.intp)
    if offset is not None:
        index = builder.add(index, offset)
    return builder.bitcast(builder.gep(data, [index]), element.as_pointer())


def read(builder, pointer, align):
    """A load that promises only the alignment of one element; aligned data still runs at full speed."""
    value = builder.load(pointer)
    value.align = align
    return value


def write(builder, value, pointer, align):
    """A store that promises only the alignment of one element."""
    builder.store(value, pointer).align = align


def call_llvm(builder, name, result, args):
    """Call an LLVM intrinsic function by its full name."""
    shape = ir.FunctionType(result, [a.type for a in args])
    return builder.call(cgutils.get_or_insert_function(builder.module, shape, name), args)


# --- memory -----------------------------------------------------------------------------------------------------------------


@intrinsic
def pointer(typing, array):
    """The bare address of a flat array, which all functions of this module take in place of the array.

    Numba counts references whenever an array is handed to a helper that branches, in every round of a loop; a pointer
    costs nothing. The array itself must stay alive, as a kernel's arguments do.
    """

    def generate(context, builder, sig, args):
        return context.make_array(sig.args[0])(context, builder, args[0]).data

    return types.CPointer(array.dtype)(array), generate


@intrinsic
def pointer_alone(typing, array):
    """The same address with vectors of one lane: what all functions of this module do with it, they do to one number.

    For a kernel that is written for many at once and has only one: the processor's widest instructions take longer.
    """

    def generate(context, builder, sig, args):
        return context.make_array(sig.args[0])(context, builder, args[0]).data

    return LonePointer(array.dtype)(array), generate


def _pointer_from(dtype, doc):
    def typed(typing, place):
        def generate(context, builder, sig, args):
            place = context.cast(builder, args[0], sig.args[0], types.intp)
            return builder.inttoptr(place, context.get_data_type(dtype).as_pointer())

        return types.CPointer(dtype)(place), generate

    typed.__doc__ = doc
    return intrinsic(typed)


float32_at = _pointer_from(types.float32, "An address as a pointer to float32.")
float64_at = _pointer_from(types.float64, "An address as a pointer to float64.")
uint8_at = _pointer_from(types.uint8, "An address as a pointer to uint8.")
int16_at = _pointer_from(types.int16, "An address as a pointer to int16.")
int32_at = _pointer_from(types.int32, "An address as a pointer to int32.")
int64_at = _pointer_from(types.int64, "An address as a pointer to int64.")


@intrinsic
def pointer_like(typing, array, place):
    """An address as a pointer to the element type of an array."""
    dtype = array.dtype

    def generate(context, builder, sig, args):
        place = context.cast(builder, args[1], sig.args[1], types.intp)
        return builder.inttoptr(place, context.get_data_type(dtype).as_pointer())

    return types.CPointer(dtype)(array, place), generate


@intrinsic
def lanes(typing, array):
    """How many elements of this array one vector holds; a compile-time constant."""
    count = vector_of(array).lanes

    def generate(context, builder, sig, args):
        return context.get_constant(types.intp, count)

    return types.intp(array), generate


@intrinsic
def load(typing, array, index):
    """Neighbouring elements from ``index`` on."""
    vector = vector_of(array)

    def generate(context, builder, sig, args):
        return read(builder, address(context, builder, sig, args, 0, vector.llvm), vector.bits // 8)

    return vector(array, index), generate


@intrinsic
def load_sixteen(typing, array, index):
    """Sixteen neighbouring elements whatever the width: one 4x4 matrix (several registers on narrow machines)."""
    vector = Vector(vector_of(array).bits, 16)

    def generate(context, builder, sig, args):
        return read(builder, address(context, builder, sig, args, 0, vector.llvm), vector.bits // 8)

    return vector(array, index), generate


@intrinsic
def load_numbers(typing, array, index):
    """W neighbours of a float32 or int16 array, as float32 lanes."""

    def generate(context, builder, sig, args):
        if array.dtype == types.float32:
            return read(builder, address(context, builder, sig, args, 0, FLOATS.llvm), 4)
        short = ir.VectorType(ir.IntType(16), WIDTH)
        value = read(builder, address(context, builder, sig, args, 0, short), 2)
        return builder.sitofp(builder.sext(value, ir.VectorType(_INT, WIDTH)), FLOATS.llvm)

    return FLOATS(array, index), generate


@intrinsic
def load_indices(typing, array, index):
    """W neighbouring int32 values, to `permute` with."""

    def generate(context, builder, sig, args):
        return read(builder, address(context, builder, sig, args, 0, ir.VectorType(_INT, WIDTH)), 4)

    return INDICES(array, index), generate


@intrinsic
def store(typing, array, index, value):
    """Write all lanes from ``index`` on."""

    def generate(context, builder, sig, args):
        write(builder, args[2], address(context, builder, sig, args, 0, args[2].type), value.bits // 8)
        return context.get_dummy_value()

    return types.void(array, index, value), generate


@intrinsic
def store_past(typing, array, index, value):
    """Write all lanes from ``index`` on past the caches; the place must be aligned to the whole vector.

    For large outputs that nobody reads soon: memory is not read before it is written.
    """

    def generate(context, builder, sig, args):
        place = address(context, builder, sig, args, 0, args[2].type)
        stored = builder.store(args[2], place)
        stored.align = value.lanes * value.bits // 8
        stored.set_metadata("nontemporal", builder.module.add_metadata([_INT(1)]))
        return context.get_dummy_value()

    return types.void(array, index, value), generate


@intrinsic
def splat(typing, array, index):
    """One array element in every lane: a single broadcasting load."""
    vector = vector_of(array)

    def generate(context, builder, sig, args):
        pointer = address(context, builder, sig, args, 0, vector.element)
        return broadcast(builder, read(builder, pointer, vector.bits // 8), vector.lanes)

    return vector(array, index), generate


@intrinsic
def fill(typing, array, number):
    """A number in every lane of a vector that fits ``array``."""
    vector = vector_of(array)

    def generate(context, builder, sig, args):
        return broadcast(builder, context.cast(builder, args[1], sig.args[1], vector.scalar), vector.lanes)

    return vector(array, number), generate


# --- arithmetic -----------------------------------------------------------------------------------------------------------


def _define_operator(op, instruction):
    @infer_global(op)  # pyright: ignore[reportOptionalCall]
    class _Typing(AbstractTemplate):
        def generic(self, args, kws):
            vectors = {a for a in args if isinstance(a, Vector)}
            known = all(isinstance(a, (Vector, types.Number)) for a in args)
            if len(args) == 2 and len(vectors) == 1 and known:
                return signature(*vectors, *map(types.unliteral, args))

    def generate(context, builder, sig, args):
        vector = sig.return_type
        a, b = (
            value
            if isinstance(kind, Vector)
            else broadcast(builder, context.cast(builder, value, kind, vector.scalar), vector.lanes)
            for value, kind in zip(args, sig.args, strict=True)
        )
        return getattr(builder, instruction)(a, b, flags=FLAGS)

    for pair in ((Vector, Vector), (Vector, types.Number), (types.Number, Vector)):
        lower_builtin(op, *pair)(generate)


_define_operator(operator.add, "fadd")
_define_operator(operator.sub, "fsub")
_define_operator(operator.mul, "fmul")
_define_operator(operator.truediv, "fdiv")


def _suffix(vector):
    return f"v{vector.lanes}f{vector.bits}"


def _bit_pattern(builder, vector, value):
    return builder.bitcast(value, ir.VectorType(ir.IntType(vector.bits), vector.lanes))


def _bit_constant(vector, value):
    integer = ir.IntType(vector.bits)
    return ir.Constant(ir.VectorType(integer, vector.lanes), [integer(value)] * vector.lanes)


def _unary(generate, doc):
    def typed(typing, a):
        def lower(context, builder, sig, args):
            return generate(builder, a, args[0])

        return a(a), lower

    typed.__doc__ = doc
    return intrinsic(typed)


def _binary(generate, doc):
    def typed(typing, a, b):
        def lower(context, builder, sig, args):
            return generate(builder, a, *args)

        return a(a, b), lower

    typed.__doc__ = doc
    return intrinsic(typed)


def _sqrt(builder, vector, x):
    return call_llvm(builder, f"llvm.sqrt.{_suffix(vector)}", vector.llvm, [x])


def _absolute(builder, vector, x):
    return call_llvm(builder, f"llvm.fabs.{_suffix(vector)}", vector.llvm, [x])


def _maximum(builder, vector, a, b):
    return builder.select(builder.fcmp_ordered(">", a, b), a, b)


def _flip_sign(builder, vector, a, b):
    sign = builder.and_(_bit_pattern(builder, vector, b), _bit_constant(vector, -(1 << (vector.bits - 1))))
    return builder.bitcast(builder.xor(_bit_pattern(builder, vector, a), sign), vector.llvm)


def _rsqrt(builder, vector, x):
    if vector == FLOATS and vector.lanes == 16 and "avx512f" in FEATURES:  # 14 good bits
        extra = [constant(vector, 0.0), ir.Constant(ir.IntType(16), -1)]
        guess = call_llvm(builder, "llvm.x86.avx512.rsqrt14.ps.512", vector.llvm, [x, *extra])
    elif vector == FLOATS and vector.lanes == 8 and "avx" in FEATURES:  # 12 good bits
        guess = call_llvm(builder, "llvm.x86.avx.rsqrt.ps.256", vector.llvm, [x])
    else:
        return builder.fdiv(constant(vector, 1.0), _sqrt(builder, vector, x), flags=FLAGS)
    # One Newton step doubles the good bits: y * (1.5 - 0.5 * x * y * y).
    half = builder.fmul(builder.fmul(x, constant(vector, 0.5), flags=FLAGS), guess, flags=FLAGS)
    rest = builder.fsub(constant(vector, 1.5), builder.fmul(half, guess, flags=FLAGS), flags=FLAGS)
    return builder.fmul(guess, rest, flags=FLAGS)


sqrt = _unary(_sqrt, "Square root.")
absolute = _unary(_absolute, "The lanes without their signs.")
rsqrt = _unary(_rsqrt, "1 / sqrt(x), to about 23 bits for float32.")
maximum = _binary(_maximum, "The greater of each two lanes; b where one of them is NaN.")
flip_sign = _binary(_flip_sign, "a where b >= 0, -a where b < 0.")


@intrinsic
def add_halves(typing, a, b):
    """a + b, which fuses with neither: a long sum cut in two takes half as long where nothing else is to be done."""

    def generate(context, builder, sig, args):
        return builder.fadd(*args, flags=("nsz",))

    return a(a, b), generate


@intrinsic
def permute(typing, a, order):
    """Lane k of the result is lane ``order[k]`` of ``a``; a float32 vector only."""

    def generate(context, builder, sig, args):
        value, where = args
        if WIDTH == 16 and "avx512f" in FEATURES:
            return call_llvm(builder, "llvm.x86.avx512.permvar.sf.512", FLOATS.llvm, [value, where])
        if WIDTH == 8 and "avx2" in FEATURES:
            return call_llvm(builder, "llvm.x86.avx2.permps", FLOATS.llvm, [value, where])
        out = ir.Constant(FLOATS.llvm, ir.Undefined)
        for k in range(WIDTH):
            lane = builder.and_(builder.extract_element(where, _INT(k)), _INT(WIDTH - 1))
            out = builder.insert_element(out, builder.extract_element(value, lane), _INT(k))
        return out

    return FLOATS(FLOATS, INDICES), generate


# --- between layouts ----------------------------------------------------------------------------------------------------------


@intrinsic
def transpose(typing, source, at, stride, target, target_at, target_stride):
    """W rows of W elements, ``stride`` apart, become the columns of ``target``.

    Exchanges the off-diagonal quarters, then those of each quarter and so on: W log2(W) register shuffles instead of
    W * W moves of single numbers.
    """
    vector = vector_of(source)

    def generate(context, builder, sig, args):
        count = vector.lanes

        def row(which, k):
            step = context.cast(builder, args[which + 2], sig.args[which + 2], types.intp)
            return address(
                context, builder, sig, args, which, vector.llvm, builder.mul(step, ir.Constant(step.type, k))
            )

        rows = [read(builder, row(0, k), vector.bits // 8) for k in range(count)]
        half = count // 2
        while half:
            upper = [k if not k & half else count + k - half for k in range(count)]
            lower = [k + half if not k & half else count + k for k in range(count)]
            for k in range(count):
                if not k & half:
                    a, b = rows[k], rows[k + half]
                    rows[k], rows[k + half] = shuffle(builder, a, b, upper), shuffle(builder, a, b, lower)
            half //= 2
        for k in range(count):
            write(builder, rows[k], row(3, k), vector.bits // 8)
        return context.get_dummy_value()

    return types.void(source, at, stride, target, target_at, target_stride), generate


def _at(context, builder, sig, args, vector, k):
    offset = ir.Constant(ir.IntType(64 if context.address_size == 64 else 32), k * vector.lanes)
    return address(context, builder, sig, args, 0, vector.llvm, offset)


@intrinsic
def load_quads(typing, array, at):
    """W groups of four neighbours (quaternions, one after another) as four vectors."""
    vector = vector_of(array)

    def generate(context, builder, sig, args):
        count = vector.lanes
        even, odd = [2 * k for k in range(count)], [2 * k + 1 for k in range(count)]
        r = [read(builder, _at(context, builder, sig, args, vector, k), vector.bits // 8) for k in range(4)]
        # Splitting even from odd places twice sorts by place modulo four.
        even_a, even_b = shuffle(builder, r[0], r[1], even), shuffle(builder, r[2], r[3], even)
        odd_a, odd_b = shuffle(builder, r[0], r[1], odd), shuffle(builder, r[2], r[3], odd)
        parts = [
            shuffle(builder, even_a, even_b, even),
            shuffle(builder, odd_a, odd_b, even),
            shuffle(builder, even_a, even_b, odd),
            shuffle(builder, odd_a, odd_b, odd),
        ]
        return context.make_tuple(builder, sig.return_type, parts)

    return types.UniTuple(vector, 4)(array, at), generate


@intrinsic
def store_quads(typing, array, at, a, b, c, d):
    """The inverse of `load_quads`: four vectors as W groups of four neighbours."""
    vector = vector_of(array)

    def generate(context, builder, sig, args):
        count = vector.lanes
        low = [k // 2 + (k & 1) * count for k in range(count)]
        high = [count // 2 + k for k in low]
        a, b, c, d = args[2:]
        ac_low, ac_high = shuffle(builder, a, c, low), shuffle(builder, a, c, high)
        bd_low, bd_high = shuffle(builder, b, d, low), shuffle(builder, b, d, high)
        rows = [
            shuffle(builder, ac_low, bd_low, low),
            shuffle(builder, ac_low, bd_low, high),
            shuffle(builder, ac_high, bd_high, low),
            shuffle(builder, ac_high, bd_high, high),
        ]
        for k, row in enumerate(rows):
            write(builder, row, _at(context, builder, sig, args, vector, k), vector.bits // 8)
        return context.get_dummy_value()

    return types.void(array, at, vector, vector, vector, vector), generate


def _merge(builder, parts, places):
    """A vector whose lane k is lane ``places[k][1]`` of ``parts[places[k][0]]``, by one shuffle per further part."""
    count = len(places)
    result = shuffle(builder, parts[0], parts[1], [lane + count * part if part < 2 else 0 for part, lane in places])
    for later in range(2, len(parts)):
        order = [count + lane if part == later else k for k, (part, lane) in enumerate(places)]
        result = shuffle(builder, result, parts[later], order)
    return result


@intrinsic
def load_triples(typing, array, at):
    """W groups of three neighbours (points, one after another) as three vectors."""
    vector = vector_of(array)

    def generate(context, builder, sig, args):
        count = vector.lanes
        rows = [read(builder, _at(context, builder, sig, args, vector, k), vector.bits // 8) for k in range(3)]
        parts = [_merge(builder, rows, [divmod(3 * k + axis, count) for k in range(count)]) for axis in range(3)]
        return context.make_tuple(builder, sig.return_type, parts)

    return types.UniTuple(vector, 3)(array, at), generate


@intrinsic
def store_triples(typing, array, at, a, b, c):
    """The inverse of `load_triples`: three vectors as W groups of three neighbours."""
    vector = vector_of(array)

    def generate(context, builder, sig, args):
        count = vector.lanes
        for row in range(3):
            places = [((row * count + k) % 3, (row * count + k) // 3) for k in range(count)]
            merged = _merge(builder, args[2:], places)
            write(builder, merged, _at(context, builder, sig, args, vector, row), vector.bits // 8)
        return context.get_dummy_value()

    return types.void(array, at, vector, vector, vector), generate
