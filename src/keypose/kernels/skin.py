# pyright: basic
"""Linear-blend skinning of one character, of many frames, and of crowds.

A mesh is compiled once (`compile_mesh`): vertices that are moved by the same joints are put together, influences of
weight zero are dropped. One character then has *vertices* in the lanes, and the matrices, which are the same for all
of them, are read as single numbers. A crowd has *characters* in the lanes; the matrices of a run of vertices stay in
registers, and each vertex costs nothing but multiply-adds.

    one character    matrices (P, 4, 4)                     -> positions (V, 3)
    crowd            models [block][joint][12][W], 3x4 rows -> positions [block][vertex][3][W], float32
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from keypose.errors import ShapeError
from keypose.kernels.fk import lane_count
from keypose.kernels.rotations import load4, store4
from keypose.kernels.runtime import WIDTH, aligned, aligned_copy, flat, inlined, kernel, scratch, scratch_like
from keypose.kernels.vectors import (
    fill,
    float32_at,
    int64_at,
    lanes,
    load,
    maximum,
    pointer,
    pointer_like,
    rsqrt,
    splat,
    store,
    store_triples,
)

_SLOTS = 4  # influences whose matrices a crowd's kernel holds in registers
_ROW = 12  # numbers per vertex: three weights, point (x, y, z, 1), normal, two unused

_POSITIONS, _SAME_MATRICES, _OWN_MATRICES = 0, 1, 2  # what becomes of normals
_MATRICES = ((4, 4), (3, 4))
_NOTHING = {np.dtype(t): np.zeros(0, t) for t in (np.float32, np.float64)}
_FLOAT32 = np.dtype(np.float32)

# Where `CompiledMesh.handles` holds what: sizes, then addresses.
_VERTEX_COUNT, _CHUNK_COUNT, _COLUMNS, _RUN_COUNT, _PALETTE_SIZE = range(5)
_CHUNKS, _JOINTS, _WEIGHTS, _POINTS, _VERTICES, _RUNS, _RUN_VERTICES, _RUN_ROWS, _PALETTE, _BIND = range(5, 15)


@dataclass(frozen=True, slots=True, eq=False)
class CompiledMesh:
    """A mesh and its skin in the order the kernels like; made by `compile_mesh`.

    Chunks, for one character: L vertices (the lanes of the type) and the joints that move any of them.
    Runs, for crowds: vertices that share up to four joints; with more joints a vertex is in several runs, which add up.

    The arrays belong to the kernels; ``handles`` holds their sizes and addresses, because handing over one array is
    quicker than ten. The palette and the inverse bind matrices are for crowds only.
    """

    dtype: np.dtype
    vertex_count: int
    joint_count: int  # palette entries that the mesh refers to
    with_normals: bool
    # [chunk][first joint, joints, first weight, vertices, first output if they are neighbours else -1]
    chunks: np.ndarray
    chunk_joints: np.ndarray
    chunk_weights: np.ndarray  # [joint of chunk][L]
    chunk_points: np.ndarray  # [chunk][3 or 6][L]
    chunk_vertices: np.ndarray  # [chunk][L]
    # [run][first row, rows, adds to what is there, four joints]
    runs: np.ndarray
    run_vertices: np.ndarray  # [row]
    run_rows: np.ndarray  # float32 [row][12], see `_skin_run`
    palette: np.ndarray  # (P,) joints of the skeleton
    joint_from_mesh: np.ndarray  # float32 [P][12]
    handles: np.ndarray


# --- Python-level entries -------------------------------------------------------------------------------------------------


def compile_mesh(
    joints: Any,
    weights: Any,
    positions: Any,
    normals: Any | None = None,
    palette: Any | None = None,
    joint_from_mesh: Any | None = None,
) -> CompiledMesh:
    """A mesh ready to be skinned many times, in the type of its positions.

    Shapes and units: joints (V, K) palette indices, weights (V, K), positions (V, 3) and normals (V, 3); for crowds also
    palette (P,) joints of the skeleton and joint_from_mesh (P, 3 or 4, 4) inverse bind matrices.
    """
    positions = np.asarray(positions)
    dtype = np.dtype(np.float32 if positions.dtype == np.float32 else np.float64)
    positions = np.ascontiguousarray(positions, dtype)
    joints, weights = np.asarray(joints, np.int64), np.asarray(weights, dtype)
    count = len(positions)
    if positions.shape != (count, 3) or joints.ndim != 2 or joints.shape != weights.shape or len(joints) != count:
        raise ShapeError(f"mesh: expected (V, 3) and (V, K), got {positions.shape}, {joints.shape}, {weights.shape}")
    if joints.size and joints.min() < 0:
        raise ShapeError(f"joints: expected indices from 0, got {joints.min()}")
    points = positions if normals is None else np.concatenate([positions, np.asarray(normals, dtype)], axis=1)
    if points.shape[1] not in (3, 6):
        raise ShapeError(f"normals: expected {positions.shape}, got {(count, points.shape[1] - 3)}")
    joint_count = int(joints.max()) + 1 if joints.size else 0
    palette = np.array([] if palette is None else palette, np.int64)
    bind = aligned_copy(np.zeros((0, 3, 4)) if joint_from_mesh is None else np.asarray(joint_from_mesh)[:, :3])
    if len(palette) * 12 != bind.size or (len(palette) and (len(palette) < joint_count or palette.min() < 0)):
        raise ShapeError(f"palette: expected at least {joint_count} joints with a matrix each, got {len(palette)}")
    groups, sorted_joints, sorted_weights = _groups(joints, weights)
    chunks = _chunks(groups, joints.shape[1], sorted_joints, sorted_weights, points, lane_count(dtype))
    runs = _runs(groups, sorted_joints, sorted_weights, points.astype(np.float32))
    arrays = (*chunks, *runs, palette, bind)
    sizes = (count, len(chunks[0]) // 5, points.shape[1], len(runs[0]) // 7, len(palette))
    handles = np.array([*sizes, *(a.ctypes.data for a in arrays)], np.int64)
    made: Any = (*arrays, handles)
    return CompiledMesh(dtype, count, joint_count, normals is not None, *made)


def skin(
    mesh: CompiledMesh,
    matrices: Any,
    normal_matrices: Any | None = None,
    with_normals: bool = False,
    out: tuple[np.ndarray, np.ndarray | None] | None = None,
) -> tuple[np.ndarray, np.ndarray | None]:
    """Positions, and normals if asked for, of a compiled mesh moved by palette matrices.

    Normals are turned by the blended matrix as it is, or by blended ``normal_matrices``, then with length 1.

    Shapes and units: matrices (*B, P, 4, 4) or (*B, P, 3, 4); normal_matrices (*B, P, 3, 3). Returns (*B, V, 3) each,
    the second None without normals; in ``out`` if given, which must fit.

    Source: lecture notes, "Skinning": ``T(v) = sum_j w_j R_j v``.
    """
    matrices = np.asarray(matrices)
    if matrices.ndim < 3 or matrices.shape[-2:] not in _MATRICES or matrices.shape[-3] < mesh.joint_count:
        raise ShapeError(f"matrices: expected (*B, {mesh.joint_count} or more, 4, 4), got {matrices.shape}")
    if with_normals and not mesh.with_normals:
        raise ShapeError("normals: the mesh was compiled without them")
    batch, palette = matrices.shape[:-3], matrices.shape[-3]
    shape = (*batch, mesh.vertex_count, 3)
    mode, turning = _POSITIONS, _NOTHING[mesh.dtype]
    if with_normals:
        mode = _SAME_MATRICES if normal_matrices is None else _OWN_MATRICES
    if mode == _OWN_MATRICES:
        own = np.asarray(normal_matrices, mesh.dtype)
        if own.shape != (*batch, palette, 3, 3):
            raise ShapeError(f"normal_matrices: expected {(*batch, palette, 3, 3)}, got {own.shape}")
        turning = flat(own, mesh.dtype)
    if out is None:
        moved, turned = np.empty(shape, mesh.dtype), np.empty(shape, mesh.dtype) if with_normals else None
    else:
        moved, turned = out
        for array in out if with_normals else out[:1]:
            if array is None or array.shape != shape or array.dtype != mesh.dtype or not array.flags.c_contiguous:
                raise ShapeError(f"out: expected {shape} of {mesh.dtype}")
    if moved.size:
        target = moved.reshape(-1)
        _skin_poses(
            mesh.chunk_points, mesh.handles, flat(matrices, mesh.dtype), matrices.shape[-2] * 4, palette, turning,
            mode, target, target if turned is None else turned.reshape(-1),
        )  # fmt: skip
    return moved, turned


def linear_blend(matrices: Any, joints: Any, weights: Any, positions: Any, normals: Any | None = None) -> Any:
    """Linear-blend skinning of a mesh that is used once; `compile_mesh` and `skin` are faster for many times.

    Shapes and units: matrices (*B, P, 4, 4), joints and weights (V, K), positions and normals (V, 3). Returns
    (*B, V, 3), or a pair of them with normals.
    """
    mesh = compile_mesh(joints, weights, positions, normals)
    moved, turned = skin(mesh, matrices, with_normals=normals is not None)
    return moved if normals is None else (moved, turned)


def skin_crowd(
    mesh: CompiledMesh, models: np.ndarray, with_normals: bool = False, out: np.ndarray | None = None
) -> np.ndarray:
    """The vertices of many characters that share one mesh, characters in the lanes.

    Shapes and units: models (blocks, J, 12, W) float32 as `sample.animate_crowd` leaves them. Returns
    (blocks, V, 3 or 6, W): positions, and normals turned by the blended matrices; in ``out`` if given.
    """
    if models.ndim != 4 or models.shape[2:] != (12, WIDTH) or models.dtype != _FLOAT32 or not models.flags.carray:
        raise ShapeError(f"models: expected (blocks, J, 12, {WIDTH}) of float32, got {models.shape} of {models.dtype}")
    if not len(mesh.palette) or mesh.palette.max() >= models.shape[1]:
        raise ShapeError(f"mesh: expected one compiled with a palette of at most {models.shape[1]} joints")
    if with_normals and not mesh.with_normals:
        raise ShapeError("normals: the mesh was compiled without them")
    shape = (len(models), mesh.vertex_count, 6 if with_normals else 3, WIDTH)
    if out is None:
        out = aligned(int(np.prod(shape))).reshape(shape)
    if out.shape != shape or out.dtype != _FLOAT32 or not out.flags.carray:
        raise ShapeError(f"out: expected {shape} of float32, got {out.shape} of {out.dtype}")
    _skin_blocks(models, mesh.handles, out)
    return out


# --- compiling a mesh -----------------------------------------------------------------------------------------------------


def _groups(joints: np.ndarray, weights: np.ndarray) -> tuple[list[np.ndarray], np.ndarray, np.ndarray]:
    """Vertices by the set of joints that move them; joints and weights sorted the same way in all of a group.

    A joint without weight is -1 and stands last.
    """
    if not joints.size:
        return [np.arange(len(joints))] if len(joints) else [], joints, weights
    unused = np.where(weights == 0, np.iinfo(np.int64).max, joints)
    order = np.argsort(unused, axis=1, kind="stable")
    joints = np.take_along_axis(np.where(weights == 0, -1, joints), order, axis=1)
    weights = np.take_along_axis(weights, order, axis=1)
    vertices = np.lexsort((np.arange(len(joints)), *joints.T[::-1]))
    differs = np.any(np.diff(joints[vertices], axis=0) != 0, axis=1)
    return np.split(vertices, np.nonzero(differs)[0] + 1), joints, weights


def _chunks(groups: Any, width: int, joints: Any, weights: Any, points: Any, count: int) -> tuple[np.ndarray, ...]:
    """Groups cut into chunks of ``count`` vertices; what is left of each is put together with its neighbours' rests.

    Putting two rests together never costs more than two chunks, for together they have at most the joints of both.
    """
    full: list[np.ndarray] = []
    rests: list[np.ndarray] = []
    for group in groups:
        whole = len(group) // count * count
        full.extend(group[:whole].reshape(-1, count))
        rests.append(group[whole:])
    rest = np.concatenate(rests) if rests else np.zeros(0, np.int64)
    full.extend(rest[k : k + count] for k in range(0, len(rest), count))
    full.sort(key=lambda chunk: int(chunk.min()))  # writes go forward through memory
    table = np.zeros((len(full), 5), np.int64)
    chunk_joints: list[np.ndarray] = []
    chunk_weights: list[np.ndarray] = []
    chunk_points = np.zeros((len(full), points.shape[1], count), points.dtype)
    chunk_vertices = np.zeros((len(full), count), np.int64)
    first = 0
    for c, chunk in enumerate(full):
        chunk = np.sort(chunk)
        own, own_weights = joints[chunk], weights[chunk]
        used = np.unique(own[own >= 0])
        spread = np.zeros((len(used), count), points.dtype)
        for k in range(width):
            valid = np.nonzero(own[:, k] >= 0)[0]
            np.add.at(spread, (np.searchsorted(used, own[valid, k]), valid), own_weights[valid, k])
        neighbours = len(chunk) and chunk[-1] - chunk[0] == len(chunk) - 1
        table[c] = first, len(used), first * count, len(chunk), chunk[0] if neighbours else -1
        chunk_joints.append(used)
        chunk_weights.append(spread)
        chunk_points[c, :, : len(chunk)] = points[chunk].T
        chunk_vertices[c, : len(chunk)] = chunk
        first += len(used)
    joined = np.concatenate(chunk_joints) if full else np.zeros(0, np.int64)
    spread = np.concatenate(chunk_weights) if full else np.zeros(0, points.dtype)
    return (
        table.reshape(-1), joined.astype(np.int64), aligned_copy(spread, points.dtype),
        aligned_copy(chunk_points, points.dtype), chunk_vertices.reshape(-1),
    )  # fmt: skip


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
            table.append([start, len(group), int(at > 0), *slots])
            vertices.append(group)
            rows.append(row)
            start += len(group)
    joined = np.concatenate(vertices) if vertices else np.zeros(0, np.int64)
    return (
        np.array(table, np.int64).reshape(-1), joined.astype(np.int64),
        aligned_copy(np.concatenate(rows) if rows else np.zeros(0)),
    )  # fmt: skip


# --- one character: vertices in the lanes ---------------------------------------------------------------------------------


@inlined
def _row3(array, at):
    return splat(array, at), splat(array, at + 1), splat(array, at + 2)


@kernel
def _skin_poses(points, handles, matrices, size, palette, turning, mode, moved, turned):
    memory = scratch_like(points, 3 * lanes(points))
    poses = moved.shape[0] // (handles[_VERTEX_COUNT] * 3)
    matrices, turning, moved, turned = pointer(matrices), pointer(turning), pointer(moved), pointer(turned)
    numbers = handles[_VERTEX_COUNT] * 3
    for pose in range(poses):
        _skin_pose(
            handles[_CHUNK_COUNT], pointer(memory), int64_at(handles[_CHUNKS]), int64_at(handles[_JOINTS]),
            pointer_like(points, handles[_WEIGHTS]), pointer(points), int64_at(handles[_VERTICES]), handles[_COLUMNS],
            matrices, pose * palette * size, size, turning, pose * palette * 9, mode, moved, turned, pose * numbers,
        )  # fmt: skip


@kernel
def _skin_pose(
    chunk_count, few, chunks, joints, weights, points, vertices, rows, matrices, first_matrix, size, turning, first_turning, mode,
    moved, turned, at,
):  # fmt: skip
    count = lanes(points)
    zero = fill(points, 0.0)
    for c in range(chunk_count):
        first, used, weight_at = chunks[5 * c], chunks[5 * c + 1], chunks[5 * c + 2]
        filled, target = chunks[5 * c + 3], chunks[5 * c + 4]
        here = c * rows * count
        x, y, z = load(points, here), load(points, here + count), load(points, here + 2 * count)
        if mode == _POSITIONS:
            px, py, pz = zero, zero, zero
            for k in range(first, first + used):
                m = first_matrix + joints[k] * size
                weight = load(weights, weight_at + (k - first) * count)
                a, b, d = _row3(matrices, m)
                px = px + weight * (splat(matrices, m + 3) + a * x + b * y + d * z)
                a, b, d = _row3(matrices, m + 4)
                py = py + weight * (splat(matrices, m + 7) + a * x + b * y + d * z)
                a, b, d = _row3(matrices, m + 8)
                pz = pz + weight * (splat(matrices, m + 11) + a * x + b * y + d * z)
            _put(moved, at, vertices, c * count, filled, target, few, px, py, pz)
            continue
        a0, a1, a2, a3 = zero, zero, zero, zero
        b0, b1, b2, b3 = zero, zero, zero, zero
        c0, c1, c2, c3 = zero, zero, zero, zero
        for k in range(first, first + used):
            m = first_matrix + joints[k] * size
            weight = load(weights, weight_at + (k - first) * count)
            a0, a1 = a0 + weight * splat(matrices, m), a1 + weight * splat(matrices, m + 1)
            a2, a3 = a2 + weight * splat(matrices, m + 2), a3 + weight * splat(matrices, m + 3)
            b0, b1 = b0 + weight * splat(matrices, m + 4), b1 + weight * splat(matrices, m + 5)
            b2, b3 = b2 + weight * splat(matrices, m + 6), b3 + weight * splat(matrices, m + 7)
            c0, c1 = c0 + weight * splat(matrices, m + 8), c1 + weight * splat(matrices, m + 9)
            c2, c3 = c2 + weight * splat(matrices, m + 10), c3 + weight * splat(matrices, m + 11)
        px, py, pz = a0 * x + a1 * y + a2 * z + a3, b0 * x + b1 * y + b2 * z + b3, c0 * x + c1 * y + c2 * z + c3
        _put(moved, at, vertices, c * count, filled, target, few, px, py, pz)
        x, y, z = load(points, here + 3 * count), load(points, here + 4 * count), load(points, here + 5 * count)
        if mode == _OWN_MATRICES:
            a0, a1, a2, b0, b1, b2, c0, c1, c2 = zero, zero, zero, zero, zero, zero, zero, zero, zero
            for k in range(first, first + used):
                m = first_turning + joints[k] * 9
                weight = load(weights, weight_at + (k - first) * count)
                a0, a1 = a0 + weight * splat(turning, m), a1 + weight * splat(turning, m + 1)
                a2, b0 = a2 + weight * splat(turning, m + 2), b0 + weight * splat(turning, m + 3)
                b1, b2 = b1 + weight * splat(turning, m + 4), b2 + weight * splat(turning, m + 5)
                c0, c1 = c0 + weight * splat(turning, m + 6), c1 + weight * splat(turning, m + 7)
                c2 = c2 + weight * splat(turning, m + 8)
        px, py, pz = a0 * x + a1 * y + a2 * z, b0 * x + b1 * y + b2 * z, c0 * x + c1 * y + c2 * z
        if mode == _OWN_MATRICES:
            length = rsqrt(maximum(px * px + py * py + pz * pz, fill(points, 1e-30)))  # zero stays zero
            px, py, pz = px * length, py * length, pz * length
        _put(turned, at, vertices, c * count, filled, target, few, px, py, pz)


@inlined
def _put(out, at, vertices, first, filled, target, few, x, y, z):
    """Write the points of a chunk: at once where they are neighbours, else one by one."""
    if filled == lanes(few) and target >= 0:
        store_triples(out, at + 3 * target, x, y, z)
    else:
        store_triples(few, 0, x, y, z)
        for k in range(filled):
            to = at + 3 * vertices[first + k]
            out[to], out[to + 1], out[to + 2] = few[3 * k], few[3 * k + 1], few[3 * k + 2]


# --- crowds: characters in the lanes --------------------------------------------------------------------------------------


@inlined
def _combine(m0, m1, m2, bind, column):
    return m0 * splat(bind, column) + m1 * splat(bind, column + 4) + m2 * splat(bind, column + 8)


@kernel
def _palette_matrices(models, at, palette, size, bind, out):
    """out [palette][12][W] = model of the joint * inverse bind matrix."""
    for p in range(size):
        for row in range(3):
            k, column = 4 * row * WIDTH, p * 12
            m0, m1, m2, m3 = load4(models, at + palette[p] * 12 * WIDTH + k, WIDTH)
            store4(
                out, p * 12 * WIDTH + k, WIDTH,
                _combine(m0, m1, m2, bind, column), _combine(m0, m1, m2, bind, column + 1),
                _combine(m0, m1, m2, bind, column + 2), _combine(m0, m1, m2, bind, column + 3) + m3,
            )  # fmt: skip


@inlined
def _differences(bones, a, b, at):
    """Four entries of bone b less those of bone a."""
    a0, a1, a2, a3 = load4(bones, a + at, WIDTH)
    b0, b1, b2, b3 = load4(bones, b + at, WIDTH)
    return b0 - a0, b1 - a1, b2 - a2, b3 - a3


@inlined
def _mixed(a, wb, b, wc, c, wd, d):
    return a + wb * b + wc * c + wd * d


@kernel
def _skin_run(bones, a, b, c, d, rows, vertices, start, count, adds, normals, out, at):
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
            _put_row(rows, here, e0, e1, e2, e3, vertices[v], row, adds, normals, out, at)


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
            point = e0 * x + e1 * y + e2 * z + e3 * s
            if adds:
                point = point + load(out, to)
            store(out, to, point)
            if normals:
                turned = e0 * nx + e1 * ny + e2 * nz
                to += 3 * WIDTH
                if adds:
                    turned = turned + load(out, to)
                store(out, to, turned)


@inlined
def _put_row(rows, here, e0, e1, e2, e3, vertex, row, adds, normals, out, at):
    """One coordinate of a vertex, and of its normal, from a row of the blended matrix."""
    to = at + ((6 if normals else 3) * vertex + row) * WIDTH
    point = e0 * splat(rows, here + 3) + e1 * splat(rows, here + 4)
    point = point + e2 * splat(rows, here + 5) + e3 * splat(rows, here + 6)
    if adds:
        point = point + load(out, to)
    store(out, to, point)
    if normals:
        turned = e0 * splat(rows, here + 7) + e1 * splat(rows, here + 8) + e2 * splat(rows, here + 9)
        to += 3 * WIDTH
        if adds:
            turned = turned + load(out, to)
        store(out, to, turned)


@kernel
def _skin_blocks(models, handles, out):
    blocks, joints, rows = out.shape[0], models.shape[1], out.shape[2]
    size, each = handles[_PALETTE_SIZE], 12 * WIDTH
    memory, beside = scratch(size * each), scratch(48 * WIDTH)
    models, out, bones, near = pointer(models), pointer(out), pointer(memory), pointer(beside)
    runs, vertices, numbers = int64_at(handles[_RUNS]), int64_at(handles[_RUN_VERTICES]), float32_at(handles[_RUN_ROWS])
    for block in range(blocks):
        _palette_matrices(
            models, block * joints * each, int64_at(handles[_PALETTE]), size, float32_at(handles[_BIND]), bones
        )
        at = block * handles[_VERTEX_COUNT] * rows * WIDTH
        for r in range(handles[_RUN_COUNT]):
            start, count, adds = runs[7 * r], runs[7 * r + 1], runs[7 * r + 2] != 0
            a, b, c, d = runs[7 * r + 3] * each, runs[7 * r + 4] * each, runs[7 * r + 5] * each, runs[7 * r + 6] * each
            if WIDTH == 16:
                _skin_run(bones, a, b, c, d, numbers, vertices, start, count, adds, rows == 6, out, at)
            else:
                _skin_run_narrow(bones, a, b, c, d, numbers, vertices, start, count, adds, rows == 6, out, at, near)
