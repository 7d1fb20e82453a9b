# pyright: basic
"""Forward kinematics of whole clips, in float32 and float64.

The frames of a clip are independent, so frames are put in the lanes: W frames of [frame, joint] arrays are transposed
in registers, the hierarchy is walked once for all of them, and the result is transposed back. Everything between
stays in the first-level cache.

Parents come before their children; -1 marks a root. Rotations are unit quaternions wxyz.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba import types

from keypose.errors import ShapeError
from keypose.kernels.rotations import load3, load4, quat_matrix, quat_multiply, quat_rotate, store3, store4
from keypose.kernels.runtime import WIDTH, aligned, inlined, intrinsic, kernel, readable, scratch_like
from keypose.kernels.vectors import (
    address,
    fill,
    lanes,
    load_triples,
    pointer,
    read,
    shuffle,
    splat,
    store,
    transpose,
    vector_of,
)

_INT64, _FLOAT32 = np.dtype(np.int64), np.dtype(np.float32)
_NONE, _STATIC, _MOVING = 0, 1, 2  # how a kind of local transform is given: not at all, once, or for every frame


# --- Python-level entries -------------------------------------------------------------------------------------------------


def rotations_positions(
    parents: Any,
    rotations: Any,
    translations: Any,
    roots: Any | None = None,
    out: tuple[np.ndarray, np.ndarray] | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Rotations and positions of all joints in the model's space.

    Shapes and units: rotations (F, J, 4); translations (F, J, 3), or (J, 3) for bones that keep their lengths; roots,
    if given, (F, 3) translations of the root joints. Metres. Returns (F, J, 4) and (F, J, 3) in the rotations' type;
    in ``out`` if given.

    Source: lecture notes, "Skeletal Animation": ``P = R0 (R1 (O2) + O1) + O0``.
    """
    clip = _Clip(parents, rotations, translations, None, roots)
    if out is None:
        turned, moved = np.empty(clip.shape(4), clip.dtype), np.empty(clip.shape(3), clip.dtype)
    else:
        turned, moved = out
        for array, width in zip(out, (4, 3), strict=True):
            if array.shape != clip.shape(width) or array.dtype != clip.dtype or not array.flags.carray:
                raise ShapeError(f"out: expected {clip.shape(width)} of {clip.dtype}, got {array.shape}")
    if turned.size:
        _turn_and_move(
            clip.parents, clip.rotations, clip.translations, clip.moving, clip.roots, clip.has_roots, clip.frames,
            turned.reshape(-1), moved.reshape(-1),
        )  # fmt: skip
    return clip.cut(turned), clip.cut(moved)


def matrices(
    parents: Any, rotations: Any, translations: Any, scales: Any | None = None, roots: Any | None = None
) -> np.ndarray:
    """``model_from_joint`` of all joints: products of translation * rotation * scale down the hierarchy.

    Shapes and units: rotations (F, J, 4); translations and scales (F, J, 3) or (J, 3); roots, if given, (F, 3)
    translations of the root joints. Metres. Returns (F, J, 4, 4) in the rotations' type.

    Source: glTF 2.0 specification, section 3.5.3 (a non-uniform scale above a rotation gives shear).
    """
    clip = _Clip(parents, rotations, translations, scales, roots)
    out = np.empty(clip.shape(16), clip.dtype)
    if out.size:
        _chain(
            clip.parents, clip.rotations, clip.translations, clip.moving, clip.scales, clip.scaling, clip.roots,
            clip.has_roots, clip.frames, out.reshape(-1),
        )  # fmt: skip
    return clip.cut(out).reshape(clip.true_frames, clip.true_joints, 4, 4)


def rotations_positions_lanes(
    parents: Any, rotations: np.ndarray, offsets: Any, roots: np.ndarray, out: np.ndarray | None = None
) -> np.ndarray:
    """As `rotations_positions`, with frames left in the lanes, the layout of the kernels.

    Shapes and units: rotations (F, R), where F is a multiple of the lanes L and the R numbers of a frame are 4 J, filled
    up to a multiple of L (fastest from `runtime.aligned` memory); offsets (J, 3); roots (F / L, 3, L). Returns
    (F / L, J, 7, L), wxyz and position, in ``out`` if given.
    """
    dtype = rotations.dtype
    count = WIDTH if dtype is _FLOAT32 else lane_count(dtype)
    parents, rotations = _plain(parents, _INT64), _plain(rotations, dtype)
    offsets, roots = _plain(offsets, dtype), _plain(roots, dtype)
    joints, (frames, row) = len(parents), rotations.shape
    blocks = frames // count
    if row % count or row < 4 * joints or frames % count or roots.shape != (blocks, 3, count):
        raise ShapeError(
            f"rotations: expected a multiple of {count} frames of {-(-4 * joints // count) * count} numbers"
        )
    shape = (blocks, joints, 7, count)
    if out is None:
        out = aligned(frames * joints * 7, dtype).reshape(shape)
    if out.shape != shape or out.dtype != dtype or not out.flags.carray or offsets.shape != (joints, 3):
        raise ShapeError(f"out: expected {shape} of {dtype}, and {joints} offsets")
    _turn_and_move_lanes(parents, rotations, offsets, roots, out)
    return out


def _plain(values: Any, dtype: np.dtype) -> np.ndarray:
    """The values as they are where they are an array of that type, in C order."""
    if type(values) is np.ndarray and values.dtype is dtype:
        flags = values.flags
        if flags.c_contiguous and flags.aligned:
            return values
    return np.require(values, dtype, ["C", "A"])


def lane_count(dtype: Any) -> int:
    """How many numbers of this type one vector holds."""
    return WIDTH if np.dtype(dtype) == np.float32 else WIDTH // 2


class _Clip:
    """Arguments as flat arrays of one type, with at least one vector of frames and of numbers per frame.

    Small clips are filled up with frames and joints that nobody looks at; `cut` takes them off the result.
    """

    def __init__(self, parents: Any, rotations: Any, translations: Any, scales: Any, roots: Any) -> None:
        rotations = np.asarray(rotations)
        self.dtype = np.dtype(np.float32 if rotations.dtype == np.float32 else np.float64)
        if rotations.ndim != 3 or rotations.shape[2] != 4:
            raise ShapeError(f"rotations: expected (F, J, 4), got {rotations.shape}")
        self.true_frames, self.true_joints = rotations.shape[:2]
        count = lane_count(self.dtype)
        self.frames = max(self.true_frames, count) if self.true_frames else 0
        self.joints = max(self.true_joints, -(-count // 3)) if self.true_joints else 0
        parents = np.asarray(parents)
        if parents.shape != (self.true_joints,) or np.any(parents >= np.arange(self.true_joints)):
            raise ShapeError(f"parents: expected {self.true_joints} parents that come before their children")
        self.parents = readable(self._filled(parents, (self.joints,)), np.int64)
        self.rotations = self._flat(rotations, 4, "rotations")[0]
        self.translations, self.moving = self._flat(translations, 3, "translations")
        self.scales, self.scaling = self._flat(scales, 3, "scales")
        self.has_roots = roots is not None
        roots = np.zeros((0, 3), self.dtype) if roots is None else np.asarray(roots)
        if self.has_roots and roots.shape != (self.true_frames, 3):
            raise ShapeError(f"roots: expected ({self.true_frames}, 3), got {roots.shape}")
        self.roots = readable(self._filled(roots, (self.frames if self.has_roots else 0, 3)), self.dtype)

    def _flat(self, values: Any, width: int, name: str) -> tuple[np.ndarray, int]:
        if values is None:
            return readable(np.zeros(0), self.dtype), _NONE
        values = np.asarray(values)
        if values.shape == (self.true_joints, width) and width == 3:
            return readable(self._filled(values, (self.joints, width)), self.dtype), _STATIC
        if values.shape != (self.true_frames, self.true_joints, width):
            raise ShapeError(
                f"{name}: expected ({self.true_frames}, {self.true_joints}, {width}) to match the rotations, "
                f"got {values.shape}"
            )
        return readable(self._filled(values, (self.frames, self.joints, width)), self.dtype), _MOVING

    @staticmethod
    def _filled(values: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
        if values.shape == shape:
            return values
        return np.pad(values, [(0, wanted - have) for wanted, have in zip(shape, values.shape, strict=True)])

    def shape(self, width: int) -> tuple[int, int, int]:
        return self.frames, self.joints, width

    def cut(self, values: np.ndarray) -> np.ndarray:
        """Without the frames and joints that were filled up."""
        if values.shape[:2] == (self.true_frames, self.true_joints):
            return values
        return np.ascontiguousarray(values[: self.true_frames, : self.true_joints])


# --- kernels --------------------------------------------------------------------------------------------------------------


@inlined
def _to_lanes(source, frame, columns, target):
    """L frames of ``columns`` numbers each, flat [frame][column], to [column][L].

    The last tile overlaps the one before it where the columns are no multiple of L.
    """
    count = lanes(source)
    for column in range(0, columns, count):
        column = min(column, columns - count)
        transpose(source, frame * columns + column, columns, target, column * count, count)


@inlined
def _from_lanes(source, target, frame, columns):
    """The inverse of `_to_lanes`."""
    count = lanes(source)
    for column in range(0, columns, count):
        column = min(column, columns - count)
        transpose(source, column * count, count, target, frame * columns + column, columns)


@inlined
def _splat3(array, at):
    return splat(array, at), splat(array, at + 1), splat(array, at + 2)


@kernel
def _turn_and_move(parents, rotations, translations, moving, roots, has_roots, frames, turned, moved):
    count, joints = lanes(rotations), parents.shape[0]
    turns, places = scratch_like(rotations, joints * 4 * count), scratch_like(rotations, joints * 3 * count)
    for frame in range(0, frames, count):
        frame = min(frame, frames - count)  # the last block overlaps the one before it
        _to_lanes(rotations, frame, joints * 4, turns)
        if moving == _MOVING:
            _to_lanes(translations, frame, joints * 3, places)
        for j in range(joints):
            here, place, p = j * 4 * count, j * 3 * count, parents[j]
            if p < 0 and has_roots:
                tx, ty, tz = load_triples(roots, frame * 3)
            elif moving == _MOVING:
                tx, ty, tz = load3(places, place, count)
            else:
                tx, ty, tz = _splat3(translations, j * 3)
            if p >= 0:
                pw, px, py, pz = load4(turns, p * 4 * count, count)
                ox, oy, oz = load3(places, p * 3 * count, count)
                w, x, y, z = load4(turns, here, count)
                w, x, y, z = quat_multiply(pw, px, py, pz, w, x, y, z)
                store4(turns, here, count, w, x, y, z)
                tx, ty, tz = quat_rotate(pw, px, py, pz, tx, ty, tz)
                tx, ty, tz = tx + ox, ty + oy, tz + oz
            store3(places, place, count, tx, ty, tz)
        _from_lanes(turns, turned, frame, joints * 4)
        _from_lanes(places, moved, frame, joints * 3)


@intrinsic
def _load_rotations(typing, array, at, stride):
    """L quaternions, ``stride`` elements apart, as four vectors.

    A register is put together from quaternions that lie four rows apart, so that transposing each group of four lanes
    brings all frames into their order: eight shuffles, where a transpose of whole tiles takes sixteen per joint and a
    trip through memory.
    """
    vector = vector_of(array)

    def generate(context, builder, sig, args):
        count, width = vector.lanes, min(4, vector.lanes)
        groups = range(count // width)
        step = context.cast(builder, args[2], sig.args[2], types.intp)

        def part(row, first):
            offset = builder.add(builder.mul(step, ir.Constant(step.type, row)), ir.Constant(step.type, first))
            place = address(context, builder, sig, args, 0, ir.VectorType(vector.element, width), offset)
            return read(builder, place, vector.bits // 8)

        def gathered(rows, first):
            spread = [k % width for k in range(count)]
            result = None
            for group, row in enumerate(rows):
                value = part(row, first)
                value = shuffle(builder, value, value, spread)
                mask = [ir.IntType(1)(k // width == group) for k in range(count)]
                mask = ir.Constant(ir.VectorType(ir.IntType(1), count), mask)
                result = value if result is None else builder.select(mask, value, result)
            return result

        def zipped(a, b, first):
            """Lanes ``first`` and the next of each group, by turns from a and b."""
            order = [group * width + first + k // 2 + k % 2 * count for group in groups for k in range(width)]
            return shuffle(builder, a, b, order)

        if width == 2:
            (a, b), (c, d) = ([part(row, first) for row in range(2)] for first in (0, 2))
            parts = [shuffle(builder, *pair, order) for pair in ((a, b), (c, d)) for order in ([0, 2], [1, 3])]
        else:
            r = [gathered([group * width + row for group in groups], 0) for row in range(4)]
            low, high = ((zipped(r[0], r[2], first), zipped(r[1], r[3], first)) for first in (0, 2))
            parts = [zipped(*pair, first) for pair in (low, high) for first in (0, 2)]
        return context.make_tuple(builder, sig.return_type, parts)

    return types.UniTuple(vector, 4)(array, at, stride), generate


@kernel
def _turn_and_move_lanes(parents, rotations, offsets, roots, out):
    """A parent that is the joint before, as most are, is still in registers: reading back what was just written would
    wait for it."""
    (frames, row), count, joints = rotations.shape, lanes(rotations), parents.shape[0]
    turns, bones, starts, models = pointer(rotations), pointer(offsets), pointer(roots), pointer(out)
    for block in range(frames // count):
        first, base = block * count * row, block * joints * 7 * count
        root = load3(starts, block * 3 * count, count)
        pw = px = py = pz = ox = oy = oz = root[0]
        for j in range(joints):
            here, p = base + j * 7 * count, parents[j]
            w, x, y, z = _load_rotations(turns, first + j * 4, row)
            if p < 0:
                tx, ty, tz = root
            else:
                if p != j - 1:
                    up = base + p * 7 * count
                    pw, px, py, pz = load4(models, up, count)
                    ox, oy, oz = load3(models, up + 4 * count, count)
                w, x, y, z = quat_multiply(pw, px, py, pz, w, x, y, z)
                ax, ay, az = _splat3(bones, j * 3)
                tx, ty, tz = quat_rotate(pw, px, py, pz, ax, ay, az)
                tx, ty, tz = tx + ox, ty + oy, tz + oz
            store4(models, here, count, w, x, y, z)
            store3(models, here + 4 * count, count, tx, ty, tz)
            pw, px, py, pz, ox, oy, oz = w, x, y, z, tx, ty, tz


@inlined
def _row(m0, m1, m2, a, b, c):
    return m0 * a + m1 * b + m2 * c


@kernel
def _chain(parents, rotations, translations, moving, scales, scaling, roots, has_roots, frames, out):
    count, joints = lanes(rotations), parents.shape[0]
    turns, places = scratch_like(rotations, joints * 4 * count), scratch_like(rotations, joints * 3 * count)
    sizes = scratch_like(rotations, joints * 3 * count)
    models = scratch_like(rotations, joints * 16 * count)  # [joint][16][L]; the last row of each is always 0 0 0 1
    zero, one = fill(rotations, 0.0), fill(rotations, 1.0)
    for j in range(joints):
        store4(models, (j * 16 + 12) * count, count, zero, zero, zero, one)
    for frame in range(0, frames, count):
        frame = min(frame, frames - count)
        _to_lanes(rotations, frame, joints * 4, turns)
        if moving == _MOVING:
            _to_lanes(translations, frame, joints * 3, places)
        if scaling == _MOVING:
            _to_lanes(scales, frame, joints * 3, sizes)
        for j in range(joints):
            p, here = parents[j], j * 16 * count
            if p < 0 and has_roots:
                tx, ty, tz = load_triples(roots, frame * 3)
            elif moving == _MOVING:
                tx, ty, tz = load3(places, j * 3 * count, count)
            else:
                tx, ty, tz = _splat3(translations, j * 3)
            w, x, y, z = load4(turns, j * 4 * count, count)
            a, b, c, d, e, f, g, h, i = quat_matrix(w, x, y, z)
            if scaling != _NONE:
                if scaling == _MOVING:
                    sx, sy, sz = load3(sizes, j * 3 * count, count)
                else:
                    sx, sy, sz = _splat3(scales, j * 3)
                a, d, g = a * sx, d * sx, g * sx
                b, e, h = b * sy, e * sy, h * sy
                c, f, i = c * sz, f * sz, i * sz
            if p < 0:
                store4(models, here, count, a, b, c, tx)
                store4(models, here + 4 * count, count, d, e, f, ty)
                store4(models, here + 8 * count, count, g, h, i, tz)
            else:
                for row in range(3):
                    m0, m1, m2, m3 = load4(models, (p * 16 + row * 4) * count, count)
                    at = here + row * 4 * count
                    store(models, at, _row(m0, m1, m2, a, d, g))
                    store(models, at + count, _row(m0, m1, m2, b, e, h))
                    store(models, at + 2 * count, _row(m0, m1, m2, c, f, i))
                    store(models, at + 3 * count, _row(m0, m1, m2, tx, ty, tz) + m3)
        _from_lanes(models, out, frame, joints * 16)
