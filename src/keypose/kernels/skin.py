# pyright: basic
"""Linear-blend skinning of one character and of many frames.

A mesh is compiled once (`compile_mesh`): vertices that are moved by the same joints are put together, influences of
weight zero are dropped. *Vertices* are in the lanes, and the matrices, which are the same for all of them, are read as
single numbers: matrices (P, 4, 4) -> positions (V, 3). Crowds are in `keypose.kernels.skincrowd`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from keypose.errors import ShapeError
from keypose.kernels.fk import lane_count
from keypose.kernels.runtime import aligned_copy, flat, inlined, kernel, scratch_like
from keypose.kernels.skincrowd import CrowdMesh, compile_crowd
from keypose.kernels.vectors import (
    fill,
    int64_at,
    lanes,
    load,
    maximum,
    pointer,
    pointer_like,
    rsqrt,
    splat,
    store_triples,
)

_POSITIONS, _SAME_MATRICES, _OWN_MATRICES = 0, 1, 2  # what becomes of normals
_MATRICES = ((4, 4), (3, 4))
_NOTHING = {np.dtype(t): np.zeros(0, t) for t in (np.float32, np.float64)}

# Where `CompiledMesh.handles` holds what: sizes, then addresses.
_VERTEX_COUNT, _CHUNK_COUNT, _COLUMNS = range(3)
_CHUNKS, _JOINTS, _WEIGHTS, _POINTS, _VERTICES = range(3, 8)


@dataclass(frozen=True, slots=True, eq=False)
class CompiledMesh:
    """A mesh and its skin in the order the kernels like; made by `compile_mesh`.

    Chunks, for one character: L vertices (the lanes of the type) and the joints that move any of them.

    The arrays belong to the kernels; ``handles`` holds their sizes and addresses, because handing over one array is
    quicker than ten. ``crowd`` is the same for crowds, with the palette and the inverse bind matrices.
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
    handles: np.ndarray
    crowd: CrowdMesh


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
    groups, sorted_joints, sorted_weights = _groups(joints, weights)
    chunks = _chunks(groups, joints.shape[1], sorted_joints, sorted_weights, points, lane_count(dtype))
    crowd = compile_crowd(groups, sorted_joints, sorted_weights, points, palette, joint_from_mesh, joint_count)
    sizes = (count, len(chunks[0]) // 5, points.shape[1])
    handles = np.array([*sizes, *(a.ctypes.data for a in chunks)], np.int64)
    made: Any = (*chunks, handles, crowd)
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
