"""Morph targets: deltas that add up, and absolute shapes whose weights sum to 1."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from keypose.arrays import Array, as_float, checked, gather, namespace, unified
from keypose.errors import ShapeError
from keypose.model import Mesh, MorphSet

_SUM_TOLERANCE = 1e-4  # of absolute weights: what float32 weights of a hundred targets may miss 1 by


def morph(mesh: Mesh, morphs: MorphSet, weights: Array, with_normals: bool = False) -> Any:
    """The mesh with delta morph targets: ``v = v0 + sum_m w_m d_m``.

    Shapes and units: ``weights`` (*B, M), any numbers, in the order of ``morphs.names``; returns positions (*B, V, 3)
    in metres, or with ``with_normals`` the pair of positions and unit normals. Targets without normal deltas leave
    the normals as they are.

    Raises:
        ShapeError: where the numbers of weights and targets differ, or normals are asked of a mesh that has none.

    Source: lecture notes, "Morph Targets": ``v = v0 + sum w_t (v_t - v0)``.
    """
    weights = checked(as_float(weights), (..., len(morphs.names)), "weights", "the morph targets")
    if len(morphs.vertices) and int(morphs.vertices.max()) >= mesh.vertex_count:
        raise ShapeError(
            f"morphs: a target moves vertex {int(morphs.vertices.max())}, the mesh has {mesh.vertex_count} vertices"
        )
    positions = _moved(mesh.positions, morphs, morphs.position_deltas, weights)
    if not with_normals:
        return positions
    if mesh.normals is None:
        raise ShapeError("normals: the mesh has none")
    if morphs.normal_deltas is None:
        xp = namespace(positions)
        (normals, _) = unified(mesh.normals, positions)
        return positions, xp.broadcast_to(normals, positions.shape)
    normals = _moved(mesh.normals, morphs, morphs.normal_deltas, weights)
    xp = namespace(normals)
    squared = xp.sum(normals * normals, axis=-1, keepdims=True)
    return positions, normals / xp.sqrt(xp.where(squared == 0, xp.ones_like(squared), squared))


def morph_absolute(
    targets: Mapping[str, Mesh], weights: Array, *, normalize: bool = False, with_normals: bool = False
) -> Any:
    """The weighted mean of whole shapes: ``v = sum_t w_t v_t`` with ``sum_t w_t = 1``.

    Shapes and units: ``weights`` (*B, M) in the order of ``targets``; they must sum to 1 (within 1e-4), or are divided
    by their sum with ``normalize``. Returns positions (*B, V, 3), or with ``with_normals`` positions and unit normals.

    Raises:
        ShapeError: where the targets' vertex counts differ (it names them), the weights do not sum to 1, or their sum
            is 0 and cannot be normalised.

    Source: lecture notes, "Morph Targets": ``v = sum w_t v_t, sum w_t = 1``.
    """
    _same_vertices(targets)
    names = tuple(targets)
    weights = checked(as_float(weights), (..., len(names)), "weights", f"the targets {', '.join(names)}")
    xp = namespace(weights)
    total = xp.sum(weights, axis=-1, keepdims=True)
    if normalize:
        if bool(xp.any(total == 0)):
            raise ShapeError("weights: their sum is 0; they cannot be normalised")
        weights = weights / total
    elif bool(xp.any(xp.abs(total - 1) > _SUM_TOLERANCE)):
        worst = float(np.asarray(total).ravel()[np.argmax(np.abs(np.asarray(total) - 1))])
        raise ShapeError(f"weights: absolute targets need weights that sum to 1, got {worst:g}; pass normalize=True")
    positions = _sum_of_shapes([m.positions for m in targets.values()], weights)
    if not with_normals:
        return positions
    normals = [m.normals for m in targets.values()]
    missing = [name for name, n in zip(names, normals, strict=True) if n is None]
    if missing:
        raise ShapeError(f"normals: target '{missing[0]}' has none")
    turned = _sum_of_shapes(normals, weights)
    squared = xp.sum(turned * turned, axis=-1, keepdims=True)
    return positions, turned / xp.sqrt(xp.where(squared == 0, xp.ones_like(squared), squared))


def morphs_from_shapes(neutral: Mesh, targets: Mapping[str, Mesh]) -> MorphSet:
    """Delta targets from whole shapes: ``d_t = v_t - v_neutral``; normals too where all meshes have them.

    Raises:
        ShapeError: where a target has another number of vertices than the neutral mesh (it names it).
    """
    _same_vertices({"neutral": neutral, **targets})
    positions = (
        np.stack([m.positions - neutral.positions for m in targets.values()]) if targets else np.zeros((0, 0, 3))
    )
    normals = None
    if neutral.normals is not None and targets and all(m.normals is not None for m in targets.values()):
        normals = np.stack([as_float(m.normals) - neutral.normals for m in targets.values()])
    return MorphSet.from_dense(tuple(targets), positions, normals)


def _same_vertices(targets: Mapping[str, Mesh]) -> None:
    if not targets:
        raise ShapeError("targets: expected at least one shape")
    first = next(iter(targets))
    for name, mesh in targets.items():
        if mesh.vertex_count != targets[first].vertex_count:
            raise ShapeError(
                f"target '{name}' has {mesh.vertex_count} vertices, '{first}' has {targets[first].vertex_count}; "
                "morph targets need the same vertices in the same order"
            )


def _moved(base: Array, morphs: MorphSet, deltas: Array, weights: Array) -> Array:
    """``base`` (V, 3) plus weighted sparse deltas: (*B, V, 3)."""
    if all(isinstance(a, np.ndarray) for a in (base, deltas, weights)):
        dtype = np.result_type(base, deltas)
        result = np.empty((*weights.shape[:-1], *base.shape), dtype)
        result[...] = base
        used = np.nonzero(np.any(weights != 0, axis=tuple(range(weights.ndim - 1))))[0]
        for m in used:
            rows = slice(int(morphs.starts[m]), int(morphs.starts[m + 1]))
            amount = weights[..., m].astype(dtype)[..., None, None]
            result[..., morphs.vertices[rows], :] += amount * deltas[rows]
        return result
    base, deltas, weights = unified(base, deltas, weights)
    xp = namespace(base)
    # The standard has no scatter: per target a dense block, for the library's own matrix product.
    order = np.full((len(morphs.names), base.shape[0]), len(morphs.vertices), np.int64)
    targets = np.repeat(np.arange(len(morphs.names)), np.diff(morphs.starts))
    order[targets, morphs.vertices] = np.arange(len(morphs.vertices))
    padded = xp.concat([deltas, xp.zeros_like(base[:1, :])], axis=0)
    dense = gather(padded, order.reshape(-1), 0)
    moved = xp.matmul(weights, xp.reshape(dense, (len(morphs.names), -1)))
    return base + xp.reshape(moved, (*weights.shape[:-1], *base.shape))


def _sum_of_shapes(shapes: list[Any], weights: Array) -> Array:
    if isinstance(weights, np.ndarray) and all(isinstance(s, np.ndarray) for s in shapes):
        weights = weights.astype(np.result_type(*shapes))
    *shapes, weights = unified(*shapes, weights)
    xp = namespace(weights)
    stacked = xp.stack(shapes, axis=0)
    flat = xp.matmul(weights, xp.reshape(stacked, (len(shapes), -1)))
    return xp.reshape(flat, (*weights.shape[:-1], *stacked.shape[1:]))
