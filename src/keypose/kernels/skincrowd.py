# pyright: basic
"""Linear-blend skinning of crowds: characters in the lanes.

    models [block][joint][12][W], rows of 3x4 matrices -> vertices [block][vertex][3 or 6][W], float32

Vertices that are moved by the same joints are a *run*: their matrices stay in registers, and each vertex costs nothing
but multiply-adds. Runs of one and two joints, which most of a body is, cost a third and a half of those of four.

`skin_crowd` takes whole blocks as they come. `skin_members` takes characters from anywhere in the crowd, listed by W:
only the matrices that the mesh needs are collected, so what is skinned together need not have been animated together.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from keypose.errors import ShapeError
from keypose.kernels.rotations import load4, store4
from keypose.kernels.runtime import CACHE_LINE, WIDTH, aligned, aligned_copy, inlined, kernel, scratch
from keypose.kernels.vectors import float32_at, int64_at, load, pointer, splat, store, store_past

if TYPE_CHECKING:
    from keypose.kernels.skin import CompiledMesh

_SLOTS = 4  # influences whose matrices the kernels hold in registers
_ROW = 12  # numbers per vertex: three weights, point (x, y, z, 1), normal, two unused
_RUN = 8  # first row, rows, whether they add to what is there, joints, four palette entries
_PAST_BYTES = 24 << 20  # an output larger than this would only push everything else out of the caches
_FLOAT32 = np.dtype(np.float32)
_NOWHERE = np.zeros(0, np.float32)

# Where `CrowdMesh.handles` holds what: sizes, then addresses.
_VERTEX_COUNT, _RUN_COUNT, _PALETTE_SIZE, _ADDS = range(4)
_RUNS, _RUN_VERTICES, _RUN_ROWS, _PALETTE, _BIND = range(4, 9)


@dataclass(frozen=True, slots=True, eq=False)
class CrowdMesh:
    """The part of a `CompiledMesh` that is for crowds. With more than four joints a vertex is in several runs."""

    runs: np.ndarray  # [run][8]
    vertices: np.ndarray  # [row]
    rows: np.ndarray  # float32 [row][12]
    palette: np.ndarray  # (P,) joints of the skeleton
    joint_from_mesh: np.ndarray  # float32 [P][12]
    handles: np.ndarray


def compile_crowd(
    groups: Any, joints: Any, weights: Any, points: Any, palette: Any, joint_from_mesh: Any, joint_count: int
) -> CrowdMesh:
    """Runs from vertices grouped by the joints that move them (-1: none), for `skin.compile_mesh`."""
    palette = np.array([] if palette is None else palette, np.int64)
    bind = aligned_copy(np.zeros((0, 3, 4)) if joint_from_mesh is None else np.asarray(joint_from_mesh)[:, :3])
    if len(palette) * 12 != bind.size or (len(palette) and (len(palette) < joint_count or palette.min() < 0)):
        raise ShapeError(f"palette: expected at least {joint_count} joints with a matrix each, got {len(palette)}")
    arrays: Any = (*_runs(groups, joints, weights, points.astype(np.float32)), palette, bind)
    adds = bool(np.any(arrays[0].reshape(-1, _RUN)[:, 2]))
    sizes = (len(points), len(arrays[0]) // _RUN, len(palette), int(adds))
    handles = np.array([*sizes, *(a.ctypes.data for a in arrays)], np.int64)
    runs, vertices, rows = arrays[:3]
    return CrowdMesh(runs, vertices, rows, palette, bind, handles)


def skin_crowd(
    mesh: CompiledMesh, models: np.ndarray, with_normals: bool = False, out: np.ndarray | None = None
) -> np.ndarray:
    """The vertices of many characters that share one mesh, characters in the lanes.

    Shapes and units: models (blocks, J, 12, W) float32 as `sample.animate_crowd` leaves them. Returns
    (blocks, V, 3 or 6, W): positions, and normals turned by the blended matrices; in ``out`` if given.
    """
    out = _checked(mesh, models, with_normals, out, len(models) if models.ndim else 0)
    _skin_blocks(models, mesh.crowd.handles, out, _past(out, len(out)))
    return out


def skin_members(
    mesh: CompiledMesh, models: np.ndarray, members: np.ndarray, blocks: np.ndarray, with_normals: bool, out: np.ndarray
) -> None:
    """The vertices of listed characters: block b of ``out`` is made from characters ``members[b * W : (b + 1) * W]``.

    Shapes and units: models (any, J, 12, W) float32; members int64 (capacity,), -1 where a lane is not used; blocks
    int64 (N,), those to be made; out (capacity / W, V, 3 or 6, W) float32.
    """
    _checked(mesh, models, with_normals, out, len(members) // WIDTH)
    _skin_members(models, mesh.crowd.handles, members, blocks, out, _past(out, len(blocks)))


def quantized_members(
    mesh: CompiledMesh, models: np.ndarray, members: np.ndarray, blocks: np.ndarray, roots: np.ndarray, unit_m: float
) -> np.ndarray:
    """The skin matrices of listed characters, seen from their roots, in 16 bits, as a graphics card takes them.

    Shapes and units: models, members and blocks as in `skin_members`; roots (count, 3) float64, x, z and yaw of all
    characters. Returns (N * W, P, 12) int16, rows of 3x4 matrices: turns and scales in units of 2^-14, places in units of
    ``unit_m``. What does not fit is cut off; rows of unused lanes mean nothing.
    """
    _checked(mesh, models, False, _NOWHERE, 0)
    out = np.empty((len(blocks) * WIDTH, len(mesh.crowd.palette), 12), np.int16)
    _quantize_members(models, mesh.crowd.handles, members, blocks, roots, np.float32(1.0 / unit_m), out)
    return out


def _past(out: np.ndarray, blocks: int) -> bool:
    """Whether so many blocks are worth being written past the caches, and may be."""
    return blocks * out[:1].nbytes >= _PAST_BYTES and out.ctypes.data % CACHE_LINE == 0


def _checked(mesh: CompiledMesh, models: Any, with_normals: bool, out: Any, blocks: int) -> np.ndarray:
    if models.ndim != 4 or models.shape[2:] != (12, WIDTH) or models.dtype != _FLOAT32 or not models.flags.carray:
        raise ShapeError(f"models: expected (blocks, J, 12, {WIDTH}) of float32, got {models.shape} of {models.dtype}")
    palette = mesh.crowd.palette
    if not len(palette) or palette.max() >= models.shape[1]:
        raise ShapeError(f"mesh: expected one compiled with a palette of at most {models.shape[1]} joints")
    if with_normals and not mesh.with_normals:
        raise ShapeError("normals: the mesh was compiled without them")
    shape = (blocks, mesh.vertex_count, 6 if with_normals else 3, WIDTH)
    if out is None:
        return aligned(int(np.prod(shape))).reshape(shape)
    if out is _NOWHERE:
        return out
    if out.shape != shape or out.dtype != _FLOAT32 or not out.flags.carray:
        raise ShapeError(f"out: expected {shape} of float32, got {out.shape} of {out.dtype}")
    return out


def _runs(groups: Any, joints: Any, weights: Any, points: Any) -> tuple[np.ndarray, ...]:
    table: list[Any] = []
    vertices: list[np.ndarray] = []
    rows: list[np.ndarray] = []
    start = 0
    for group in groups:
        used = joints[group[0]]
        used = used[used >= 0]
        group = np.sort(group)
        for at in range(0, max(len(used), 1), _SLOTS):
            four = used[at : at + _SLOTS]
            weight = np.zeros((len(group), _SLOTS), np.float32)
            weight[:, : len(four)] = weights[group, at : at + len(four)]
            slots = np.zeros(_SLOTS, np.int64)
            slots[: len(four)] = four
            total = weight.sum(axis=1, keepdims=True)
            row = np.zeros((len(group), _ROW), np.float32)
            row[:, :3] = np.divide(weight, total, where=total > 0, out=np.zeros_like(weight))[:, 1:]
            row[:, 3:6], row[:, 6:7] = points[group, :3] * total, total
            row[:, 7 : 4 + points.shape[1]] = points[group, 3:] * total
            table.append([start, len(group), int(at > 0), len(four), *slots])
            vertices.append(group)
            rows.append(row)
            start += len(group)
    joined = np.concatenate(vertices) if vertices else np.zeros(0, np.int64)
    return (
        np.array(table, np.int64).reshape(-1), joined.astype(np.int64),
        aligned_copy(np.concatenate(rows) if rows else np.zeros(0)),
    )  # fmt: skip


# --- kernels --------------------------------------------------------------------------------------------------------------


@inlined
def _combine(m0, m1, m2, bind, column):
    return m0 * splat(bind, column) + m1 * splat(bind, column + 4) + m2 * splat(bind, column + 8)


@inlined
def _bound(models, at, bind, column, out, to):
    """One row of a model matrix times the inverse bind matrix."""
    m0, m1, m2, m3 = load4(models, at, WIDTH)
    store4(
        out, to, WIDTH,
        _combine(m0, m1, m2, bind, column), _combine(m0, m1, m2, bind, column + 1),
        _combine(m0, m1, m2, bind, column + 2), _combine(m0, m1, m2, bind, column + 3) + m3,
    )  # fmt: skip


@kernel
def _palette_matrices(models, at, palette, size, bind, out):
    """out [palette][12][W] = model of the joint * inverse bind matrix."""
    for p in range(size):
        for row in range(3):
            k = 4 * row * WIDTH
            _bound(models, at + palette[p] * 12 * WIDTH + k, bind, p * 12, out, p * 12 * WIDTH + k)


@kernel
def _member_matrices(models, stride, members, palette, size, bind, near, out):
    """The same for W characters from anywhere; an unused lane gets what the lane before has."""
    for p in range(size):
        joint = palette[p] * 12 * WIDTH
        place = np.int64(0)
        for lane in range(WIDTH):
            if members[lane] >= 0:
                place = (members[lane] // WIDTH) * stride + members[lane] % WIDTH
            for k in range(12):
                near[k * WIDTH + lane] = models[place + joint + k * WIDTH]
        for row in range(3):
            k = 4 * row * WIDTH
            _bound(near, k, bind, p * 12, out, p * 12 * WIDTH + k)


@inlined
def _differences(bones, a, b, at):
    """Four entries of bone b less those of bone a."""
    a0, a1, a2, a3 = load4(bones, a + at, WIDTH)
    b0, b1, b2, b3 = load4(bones, b + at, WIDTH)
    return b0 - a0, b1 - a1, b2 - a2, b3 - a3


@inlined
def _mixed(a, wb, b, wc, c, wd, d):
    return a + wb * b + wc * c + wd * d


@inlined
def _give(out, to, value, adds, past):
    if past:
        store_past(out, to, value)
    elif adds:
        store(out, to, value + load(out, to))
    else:
        store(out, to, value)


@inlined
def _put_row(rows, here, e0, e1, e2, e3, vertex, row, adds, normals, past, out, at):
    """One coordinate of a vertex, and of its normal, from a row of the blended matrix."""
    to = at + ((6 if normals else 3) * vertex + row) * WIDTH
    point = e0 * splat(rows, here + 3) + e1 * splat(rows, here + 4)
    point = point + e2 * splat(rows, here + 5) + e3 * splat(rows, here + 6)
    _give(out, to, point, adds, past)
    if normals:
        turned = e0 * splat(rows, here + 7) + e1 * splat(rows, here + 8) + e2 * splat(rows, here + 9)
        _give(out, to + 3 * WIDTH, turned, adds, past)


@kernel
def _skin_run_one(bones, a, rows, vertices, start, count, adds, normals, past, out, at):
    """Vertices moved by one bone."""
    a0, a1, a2, a3 = load4(bones, a, WIDTH)
    b0, b1, b2, b3 = load4(bones, a + 4 * WIDTH, WIDTH)
    c0, c1, c2, c3 = load4(bones, a + 8 * WIDTH, WIDTH)
    for v in range(start, start + count):
        here, vertex = _ROW * v, vertices[v]
        _put_row(rows, here, a0, a1, a2, a3, vertex, 0, adds, normals, past, out, at)
        _put_row(rows, here, b0, b1, b2, b3, vertex, 1, adds, normals, past, out, at)
        _put_row(rows, here, c0, c1, c2, c3, vertex, 2, adds, normals, past, out, at)


@kernel
def _skin_run_two(bones, a, b, rows, vertices, start, count, adds, normals, past, out, at):
    """Vertices moved by the same two bones: the blended matrix is A + wb (B - A)."""
    a0, a1, a2, a3 = load4(bones, a, WIDTH)
    a4, a5, a6, a7 = load4(bones, a + 4 * WIDTH, WIDTH)
    a8, a9, aa, ab = load4(bones, a + 8 * WIDTH, WIDTH)
    b0, b1, b2, b3 = _differences(bones, a, b, 0)
    b4, b5, b6, b7 = _differences(bones, a, b, 4 * WIDTH)
    b8, b9, ba, bb = _differences(bones, a, b, 8 * WIDTH)
    for v in range(start, start + count):
        here, vertex = _ROW * v, vertices[v]
        w = splat(rows, here)
        _put_row(
            rows, here, a0 + w * b0, a1 + w * b1, a2 + w * b2, a3 + w * b3, vertex, 0, adds, normals, past, out, at
        )
        _put_row(
            rows, here, a4 + w * b4, a5 + w * b5, a6 + w * b6, a7 + w * b7, vertex, 1, adds, normals, past, out, at
        )
        _put_row(
            rows, here, a8 + w * b8, a9 + w * b9, aa + w * ba, ab + w * bb, vertex, 2, adds, normals, past, out, at
        )


@kernel
def _skin_run(bones, a, b, c, d, rows, vertices, start, count, adds, normals, past, out, at):
    """Vertices moved by the same four bones, whose matrices stay in registers.

    With weights that sum to 1 the blended matrix is A + wb (B - A) + wc (C - A) + wd (D - A): one multiply-add less per
    entry. The rows hold weights of sum 1, and point and normal times what they summed to.
    """
    for row in range(3):
        k = 4 * row * WIDTH
        a0, a1, a2, a3 = load4(bones, a + k, WIDTH)
        b0, b1, b2, b3 = _differences(bones, a, b, k)
        c0, c1, c2, c3 = _differences(bones, a, c, k)
        d0, d1, d2, d3 = _differences(bones, a, d, k)
        for v in range(start, start + count):
            here = _ROW * v
            wb, wc, wd = splat(rows, here), splat(rows, here + 1), splat(rows, here + 2)
            e0, e1 = _mixed(a0, wb, b0, wc, c0, wd, d0), _mixed(a1, wb, b1, wc, c1, wd, d1)
            e2, e3 = _mixed(a2, wb, b2, wc, c2, wd, d2), _mixed(a3, wb, b3, wc, c3, wd, d3)
            _put_row(rows, here, e0, e1, e2, e3, vertices[v], row, adds, normals, past, out, at)


@kernel
def _skin_run_narrow(bones, a, b, c, d, rows, vertices, start, count, adds, normals, out, at, near):
    """The same for machines of sixteen registers: the differences wait in the first-level cache, at ``near``."""
    for k in range(0, 12 * WIDTH, 4 * WIDTH):
        a0, a1, a2, a3 = load4(bones, a + k, WIDTH)
        store4(near, 4 * k, WIDTH, a0, a1, a2, a3)
        a0, a1, a2, a3 = _differences(bones, a, b, k)
        store4(near, 4 * k + 4 * WIDTH, WIDTH, a0, a1, a2, a3)
        a0, a1, a2, a3 = _differences(bones, a, c, k)
        store4(near, 4 * k + 8 * WIDTH, WIDTH, a0, a1, a2, a3)
        a0, a1, a2, a3 = _differences(bones, a, d, k)
        store4(near, 4 * k + 12 * WIDTH, WIDTH, a0, a1, a2, a3)
    for v in range(start, start + count):
        here = _ROW * v
        wb, wc, wd = splat(rows, here), splat(rows, here + 1), splat(rows, here + 2)
        x, y, z, s = splat(rows, here + 3), splat(rows, here + 4), splat(rows, here + 5), splat(rows, here + 6)
        nx, ny, nz = splat(rows, here + 7), splat(rows, here + 8), splat(rows, here + 9)
        for row in range(3):
            k = 16 * row * WIDTH
            a0, a1, a2, a3 = load4(near, k, WIDTH)
            b0, b1, b2, b3 = load4(near, k + 4 * WIDTH, WIDTH)
            c0, c1, c2, c3 = load4(near, k + 8 * WIDTH, WIDTH)
            d0, d1, d2, d3 = load4(near, k + 12 * WIDTH, WIDTH)
            e0, e1 = _mixed(a0, wb, b0, wc, c0, wd, d0), _mixed(a1, wb, b1, wc, c1, wd, d1)
            e2, e3 = _mixed(a2, wb, b2, wc, c2, wd, d2), _mixed(a3, wb, b3, wc, c3, wd, d3)
            to = at + ((6 if normals else 3) * vertices[v] + row) * WIDTH
            _give(out, to, e0 * x + e1 * y + e2 * z + e3 * s, adds, False)
            if normals:
                _give(out, to + 3 * WIDTH, e0 * nx + e1 * ny + e2 * nz, adds, False)


@kernel
def _skin_block(handles, bones, near, normals, past, out, at):
    runs, vertices, numbers = int64_at(handles[_RUNS]), int64_at(handles[_RUN_VERTICES]), float32_at(handles[_RUN_ROWS])
    each = 12 * WIDTH
    for r in range(0, _RUN * handles[_RUN_COUNT], _RUN):
        start, count, adds, joints = runs[r], runs[r + 1], runs[r + 2] != 0, runs[r + 3]
        a, b, c, d = runs[r + 4] * each, runs[r + 5] * each, runs[r + 6] * each, runs[r + 7] * each
        if joints <= 1:
            _skin_run_one(bones, a, numbers, vertices, start, count, adds, normals, past, out, at)
        elif WIDTH != 16:
            _skin_run_narrow(bones, a, b, c, d, numbers, vertices, start, count, adds, normals, out, at, near)
        elif joints == 2:
            _skin_run_two(bones, a, b, numbers, vertices, start, count, adds, normals, past, out, at)
        else:
            _skin_run(bones, a, b, c, d, numbers, vertices, start, count, adds, normals, past, out, at)


@kernel
def _skin_blocks(models, handles, out, past):
    blocks, joints, rows, size = out.shape[0], models.shape[1], out.shape[2], handles[_PALETTE_SIZE]
    memory, beside = scratch(size * 12 * WIDTH), scratch(48 * WIDTH)
    models, out, bones, near = pointer(models), pointer(out), pointer(memory), pointer(beside)
    palette, bind = int64_at(handles[_PALETTE]), float32_at(handles[_BIND])
    past = past and WIDTH == 16 and handles[_ADDS] == 0
    for block in range(blocks):
        _palette_matrices(models, block * joints * 12 * WIDTH, palette, size, bind, bones)
        _skin_block(handles, bones, near, rows == 6, past, out, block * handles[_VERTEX_COUNT] * rows * WIDTH)


@kernel
def _skin_members(models, handles, members, blocks, out, past):
    joints, rows, size, count = models.shape[1], out.shape[2], handles[_PALETTE_SIZE], blocks.shape[0]
    memory, beside = scratch(size * 12 * WIDTH), scratch(48 * WIDTH)
    models, out, bones, near = pointer(models), pointer(out), pointer(memory), pointer(beside)
    palette, bind, lanes = int64_at(handles[_PALETTE]), float32_at(handles[_BIND]), np.zeros(WIDTH, np.int64)
    past = past and WIDTH == 16 and handles[_ADDS] == 0
    for n in range(count):
        if _collect(models, joints, members, blocks[n] * WIDTH, lanes, palette, size, bind, near, bones):
            _skin_block(handles, bones, near, rows == 6, past, out, blocks[n] * handles[_VERTEX_COUNT] * rows * WIDTH)


@kernel
def _collect(models, joints, members, first, lanes, palette, size, bind, near, bones):
    """The matrices of W listed characters; whether there is one among them."""
    neighbours, used = True, np.int64(-1)
    for lane in range(WIDTH):
        if members[first + lane] >= 0 and used < 0:
            used = members[first + lane]
    if used < 0:
        return False
    for lane in range(WIDTH):
        used = members[first + lane] if members[first + lane] >= 0 else used
        lanes[lane] = used
        neighbours = neighbours and used == lanes[0] + lane
    if neighbours and lanes[0] % WIDTH == 0:
        _palette_matrices(models, lanes[0] * joints * 12, palette, size, bind, bones)
    else:
        _member_matrices(models, joints * 12 * WIDTH, pointer(lanes), palette, size, bind, near, bones)
    return True


@kernel
def _quantize_members(models, handles, members, blocks, roots, per_m, out):
    joints, size = models.shape[1], handles[_PALETTE_SIZE]
    memory, beside, turned = scratch(size * 12 * WIDTH), scratch(48 * WIDTH), scratch(16 * WIDTH)
    models, bones, near = pointer(models), pointer(memory), pointer(beside)
    palette, bind, lanes = int64_at(handles[_PALETTE]), float32_at(handles[_BIND]), np.zeros(WIDTH, np.int64)
    for n in range(blocks.shape[0]):
        if not _collect(models, joints, members, blocks[n] * WIDTH, lanes, palette, size, bind, near, bones):
            continue
        for lane in range(WIDTH):
            x, z, yaw = roots[lanes[lane], 0], roots[lanes[lane], 1], roots[lanes[lane], 2]
            turned[12 * WIDTH + lane], turned[13 * WIDTH + lane] = np.cos(yaw), np.sin(yaw)
            turned[14 * WIDTH + lane], turned[15 * WIDTH + lane] = x, z
        cos, sin = load(turned, 12 * WIDTH), load(turned, 13 * WIDTH)
        away_x, away_z = load(turned, 14 * WIDTH), load(turned, 15 * WIDTH)
        for p in range(size):
            at = p * 12 * WIDTH
            for k in range(4):
                x, y = load(bones, at + k * WIDTH), load(bones, at + (4 + k) * WIDTH)
                z = load(bones, at + (8 + k) * WIDTH)
                unit = np.float32(16384.0)
                if k == 3:
                    x, z, unit = x - away_x, z - away_z, per_m
                store(turned, k * WIDTH, (cos * x - sin * z) * unit)
                store(turned, (4 + k) * WIDTH, y * unit)
                store(turned, (8 + k) * WIDTH, (sin * x + cos * z) * unit)
            for lane in range(WIDTH):
                for k in range(12):
                    value = min(max(turned[k * WIDTH + lane], np.float32(-32767.0)), np.float32(32767.0))
                    out[n * WIDTH + lane, p, k] = np.int16(np.rint(value))
