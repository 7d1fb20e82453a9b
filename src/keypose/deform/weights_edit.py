"""Changing skin weights: fewer influences, smoothing, the other side of the body, another mesh."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np

from keypose.arrays import Floats, Ints
from keypose.deform.packing import pack
from keypose.deform.weights_nearest import nearest_on
from keypose.deform.weights_surface import weld
from keypose.errors import ShapeError, UnknownName
from keypose.model import Mesh, Skeleton, Skin

_LEAST_WEIGHT = 1e-4
_SAME = 1e-4  # of the size: a vertex so near to the mirror plane is on it
_PAIR = 0.05  # of the size: joints so far from each other's mirror image are no pair
_SIDES = ("left", "right")


def limit_influences(binding: Skin, influences: int = 4, *, threshold: float = 0.0) -> Skin:
    """The skin with at most ``influences`` joints per vertex and no weight below ``threshold``; weights sum to 1 again.

    The largest weight of a vertex always stays.

    Raises:
        ShapeError: where ``influences`` is not positive or ``threshold`` is not in [0, 1).
    """
    if not 0.0 <= threshold < 1.0:
        raise ShapeError(f"threshold: expected a number in [0, 1), got {threshold}")
    packed, _ = pack(binding, influences)
    weights = np.asarray(packed.weights, np.float64)
    weights = weights / np.maximum(weights.sum(axis=1, keepdims=True), 1e-30)
    least = np.minimum(threshold, weights.max(axis=1, initial=0.0, keepdims=True))
    weights = np.where(weights >= least, weights, 0.0)
    weights /= np.maximum(weights.sum(axis=1, keepdims=True), 1e-30)
    joints = np.where(weights > 0, packed.joints, 0)
    return Skin(packed.palette, packed.joint_from_mesh, joints, weights.astype(binding.weights.dtype), binding.method)


def smooth_weights(
    binding: Skin,
    mesh: Mesh,
    *,
    amount: float = 0.5,
    iterations: int = 1,
    vertices: Any = None,
    max_influences: int | None = None,
) -> Skin:
    """The skin with weights evened out over the surface: each time every vertex goes ``amount`` of the way to the mean of its neighbours.

    Vertices at the same place are one; meshes that touch have to be smoothed as one. ``vertices`` are flags (V,) or indices of those that may change; at most
    ``max_influences`` joints hold a vertex, as many as before if not given.

    Raises:
        ShapeError: where skin and mesh do not fit, ``amount`` is not in [0, 1] or ``iterations`` is negative.
    """
    from scipy.sparse import coo_array, dia_array

    _fits(binding, mesh)
    if not 0.0 <= amount <= 1.0:
        raise ShapeError(f"amount: expected a number in [0, 1], got {amount}")
    if iterations < 0:
        raise ShapeError(f"iterations: expected 0 or more, got {iterations}")
    surface = weld([mesh])
    points = surface.point_of[0]
    free = _flags(vertices, mesh.vertex_count)
    movable = np.bincount(points, free, minlength=len(surface.points)) > 0
    dense = _mean_by_point(_dense(binding), points, len(surface.points))
    edges = surface.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    graph = coo_array((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), (len(dense), len(dense))).tocsr()
    graph = graph + graph.T
    graph.data[:] = 1.0
    degree = np.asarray(graph.sum(axis=1)).reshape(-1)
    movable &= degree > 0
    mean = dia_array(((1.0 / np.maximum(degree, 1.0))[None], [0]), graph.shape) @ graph
    for _ in range(iterations):
        dense[movable] += amount * ((mean @ dense)[movable] - dense[movable])
    changed = _skin_of(dense[points], binding, max_influences or binding.influence_count)
    return _mixed(binding, changed, movable[points])


def mirror_weights(
    binding: Skin,
    mesh: Mesh,
    skeleton: Skeleton,
    *,
    source: Literal["left", "right"] = "left",
    pairs: dict[str, str] | None = None,
) -> Skin:
    """The skin with the weights of one side of the body mirrored to the other, as the bound pose has them.

    The plane is x = 0 in the mesh's space, left is x > 0. Each vertex of the other side takes the weights of the surface
    at its mirror image; on the plane both sides are averaged. Joints go in pairs by their places in the bound pose, the
    hierarchy telling apart what lies together, or as ``pairs`` (name -> name, one direction is enough) says.

    Raises:
        ShapeError: where skin and mesh do not fit.
        UnknownName: for another side or a joint that does not exist.
    """
    _fits(binding, mesh)
    if source not in _SIDES:
        raise UnknownName("side", str(source), _SIDES)
    positions = np.asarray(mesh.positions, np.float64)
    size = float(np.linalg.norm(np.ptp(positions, axis=0)))
    partner = mirrored_joints(binding, skeleton, size, pairs)
    other = np.arange(skeleton.joint_count)
    palette = np.asarray(binding.palette)
    # A joint whose partner holds nothing yet joins the palette, bound where its partner's mirror image is.
    missing = [int(partner[j]) for j in palette if partner[j] >= 0 and partner[j] not in palette]
    binds = np.asarray(binding.joint_from_mesh, np.float64)
    other[partner >= 0] = partner[partner >= 0]
    flip = np.diag([-1.0, 1.0, 1.0, 1.0])
    added = [flip @ binds[list(palette).index(other[j])] @ flip for j in missing]
    wide = Skin(
        np.concatenate([palette, np.array(missing, np.int32)]),
        np.concatenate([binds, np.array(added).reshape(-1, 4, 4)]).astype(binding.joint_from_mesh.dtype),
        binding.joints,
        binding.weights,
        binding.method,
    )
    slot_of = {int(j): slot for slot, j in enumerate(wide.palette)}
    swap = np.array([slot_of[int(other[j])] for j in wide.palette], np.int64)
    dense = _dense(wide)
    sign = 1.0 if source == "left" else -1.0
    side = positions[:, 0] * sign
    near = _SAME * size
    target = side < -near
    middle = np.abs(side) <= near
    triangles = np.asarray(mesh.triangles, np.int64)
    giving = triangles[(side[triangles] >= -near).all(axis=1) & (side[triangles] > near).any(axis=1)]
    if not len(giving):
        raise ShapeError(f"mesh: expected triangles on the {source} side (x {'>' if sign > 0 else '<'} 0), got none")
    images = positions[target] * np.array([-1.0, 1.0, 1.0])
    triangle, shares, _ = nearest_on(positions, giving, images)
    mirrored = np.einsum("nk,nkj->nj", shares, dense[giving[triangle]])
    result = dense.copy()
    result[target] = mirrored[:, swap]
    result[middle] = 0.5 * (dense[middle] + dense[middle][:, swap])
    changed = _skin_of(result, wide, binding.influence_count)
    return _mixed(wide, changed, target | middle)


def mirrored_joints(binding: Skin, skeleton: Skeleton, size_m: float, pairs: dict[str, str] | None = None) -> Ints:
    """The joint at each joint's mirror image about x = 0 in the bound pose (J,), itself in the middle, -1 for none."""
    from keypose.evaluate import world

    rest = np.asarray(world(skeleton, skeleton.rest), np.float64)
    bound = np.full((skeleton.joint_count, 4, 4), np.nan)
    bound[np.asarray(binding.palette)] = np.linalg.inv(np.asarray(binding.joint_from_mesh, np.float64))
    anchored = np.nonzero(~np.isnan(bound[:, 0, 0]))[0]
    to_mesh = bound[anchored[0]] @ np.linalg.inv(rest[anchored[0]]) if len(anchored) else np.eye(4)
    for joint, parent in enumerate(skeleton.parents.tolist()):
        if np.isnan(bound[joint, 0, 0]):
            if parent < 0:
                bound[joint] = to_mesh @ rest[joint]
            else:
                bound[joint] = bound[parent] @ np.linalg.solve(rest[parent], rest[joint])
    places = bound[:, :3, 3]
    images = places * np.array([-1.0, 1.0, 1.0])
    partner = np.full(skeleton.joint_count, -1, np.int64)
    for left, right in (pairs or {}).items():
        a, b = skeleton.index(left), skeleton.index(right)
        partner[a], partner[b] = b, a
    depths = skeleton.depths()
    parents = np.asarray(skeleton.parents)
    for joint in range(skeleton.joint_count):
        if partner[joint] >= 0:
            continue
        above = int(parents[joint])
        # Partners hang on partners; twins at one place are told apart by that and by how deep they are.
        fitting = (partner < 0) & (depths == depths[joint])
        if above >= 0 and partner[above] >= 0:
            fitting &= parents == partner[above]
        options = np.nonzero(fitting)[0]
        if not len(options):
            continue
        ways = np.linalg.norm(places[options] - images[joint], axis=1)
        best = int(options[np.argmin(ways)])
        if ways.min() <= _PAIR * size_m:
            partner[joint], partner[best] = best, joint
    return partner


def transfer_weights(binding: Skin, mesh: Mesh, target: Mesh, *, max_influences: int | None = None) -> Skin:
    """A skin for another mesh in the same space: every vertex takes the weights of the nearest place of the bound surface.

    Raises:
        ShapeError: where skin and mesh do not fit, or the bound mesh has no triangle.
    """
    _fits(binding, mesh)
    if not len(mesh.triangles):
        raise ShapeError("mesh: expected triangles to take weights from, got none")
    positions = np.asarray(mesh.positions, np.float64)
    triangles = np.asarray(mesh.triangles, np.int64)
    triangle, shares, _ = nearest_on(positions, triangles, np.asarray(target.positions, np.float64))
    dense = np.einsum("nk,nkj->nj", shares, _dense(binding)[triangles[triangle]])
    return _skin_of(dense, binding, max_influences or binding.influence_count)


# --- pieces -----------------------------------------------------------------------------------------------------------


def _fits(binding: Skin, mesh: Mesh) -> None:
    if len(binding.joints) != mesh.vertex_count:
        raise ShapeError(f"skin: it binds {len(binding.joints)} vertices, the mesh has {mesh.vertex_count}")


def _flags(vertices: Any, count: int) -> Any:
    if vertices is None:
        return np.ones(count, bool)
    chosen = np.asarray(vertices)
    if chosen.dtype == bool:
        if chosen.shape != (count,):
            raise ShapeError(f"vertices: expected {count} flags, got {chosen.shape}")
        return chosen
    if chosen.size and (chosen.min() < 0 or chosen.max() >= count):
        raise ShapeError(f"vertices: expected indices below {count}, got {int(chosen.max())}")
    flags = np.zeros(count, bool)
    flags[chosen.astype(np.int64)] = True
    return flags


def _dense(binding: Skin) -> Floats:
    """Weights (V, P) of all joints of the palette, rows summing to 1 where anything holds."""
    dense = np.zeros((len(binding.joints), len(binding.palette)))
    np.add.at(dense, (np.arange(len(dense))[:, None], binding.joints), np.asarray(binding.weights, np.float64))
    total = dense.sum(axis=1, keepdims=True)
    return dense / np.where(total > 0, total, 1.0)


def _mean_by_point(values: Floats, points: Ints, count: int) -> Floats:
    from scipy.sparse import csr_array

    here = csr_array((np.ones(len(points)), (points, np.arange(len(points)))), (count, len(points)))
    return (here @ values) / np.bincount(points, minlength=count)[:, None]


def _skin_of(dense: Floats, like: Skin, most: int) -> Skin:
    """A skin of the largest ``most`` weights of (V, P), with palette and binds of another."""
    width = max(min(most, dense.shape[1]), 1)
    order = np.argsort(-dense, axis=1, kind="stable")[:, :width]
    weights = np.take_along_axis(dense, order, axis=1)
    weights[weights < _LEAST_WEIGHT] = 0.0
    weights /= np.maximum(weights.sum(axis=1, keepdims=True), 1e-30)
    joints = np.where(weights > 0, order, 0)
    return Skin(like.palette, like.joint_from_mesh, joints, weights.astype(like.weights.dtype), like.method)


def _mixed(before: Skin, after: Skin, changed: Any) -> Skin:
    """The rows of one skin where ``changed`` (V,), else those of the other, untouched."""
    width = max(before.influence_count, after.influence_count)
    joints = np.zeros((len(before.joints), width), np.int32)
    weights = np.zeros((len(before.joints), width), before.weights.dtype)
    for rows, skin in ((~changed, before), (changed, after)):
        joints[rows, : skin.influence_count] = skin.joints[rows]
        weights[rows, : skin.influence_count] = skin.weights[rows]
    return Skin(before.palette, before.joint_from_mesh, joints, weights, before.method)
