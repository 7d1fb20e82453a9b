"""Automatic skin weights: any mesh on any skeleton."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from keypose.arrays import Array, Floats, Ints, checked
from keypose.deform.weights_bones import Bones, bones_of, mounts_of
from keypose.deform.weights_bound import bound_pose
from keypose.deform.weights_heat import sources_of, spread
from keypose.deform.weights_nearest import nearest_on
from keypose.deform.weights_pieces import Pieces, sort_pieces
from keypose.deform.weights_sight import sight_of
from keypose.deform.weights_solid import Solid, solid_of
from keypose.deform.weights_surface import Surface, weld
from keypose.errors import ShapeError, UnknownName
from keypose.evaluate import world
from keypose.model import Character, Mesh, Part, Skeleton, Skin, SkinningMethod

_INSIDE = 1 / 3  # of a bone has to be in the body
_MISFIT = 0.5  # of the joints without a bone in the body are a skeleton that stands elsewhere
_FIT = "does the mesh fit the skeleton's rest pose, in the same unit and place?"
_STIFF = 0.02  # of the size; pieces so small that go along do not bend
_LEAST_WEIGHT = 1e-3
_EVEN = 1e-9  # where all are the same, they stay so

Progress = Callable[[int, int], None]


@dataclass(frozen=True, slots=True)
class WeightsReport:
    """How automatic weights came about.

    Pieces are what hangs together after vertices at the same place were welded. ``heated`` ones took the heat of bones;
    ``attached`` ones go along with the surface beside them; ``rigid`` ones belong to the one joint in their middle.
    ``vertices_around_corners`` saw no bone and took the one that is nearest through the body.
    """

    vertices: int
    points: int
    pieces: int
    heated: int
    attached: int
    rigid: int
    open_pieces: int
    vertices_around_corners: int
    influences: int
    influences_before: int
    mean_lost_weight: float
    joints: tuple[str, ...]
    joints_without: tuple[str, ...]
    notes: tuple[str, ...] = ()

    def lines(self) -> list[str]:
        """The figures as lines of text."""
        pieces = "1 piece" if self.pieces == 1 else f"{self.pieces} pieces"
        joints = "1 joint moves" if len(self.joints) == 1 else f"{len(self.joints)} joints move"
        found = [
            f"{self.vertices:,} vertices at {self.points:,} places, {pieces}: {self.heated} by bone heat, "
            f"{self.attached} go along with the surface beside them, {self.rigid} with one joint",
            f"{joints} something, {len(self.joints_without)} nothing",
            f"at most {self.influences} influences, {self.influences_before} before; "
            f"{100 * self.mean_lost_weight:.2g} % of the weight lost by that on average",
        ]
        if self.open_pieces:
            open_ones = "1 heated piece is" if self.open_pieces == 1 else f"{self.open_pieces} heated pieces are"
            found.append(f"{open_ones} open: what is enclosed was found with voxels")
        if self.vertices_around_corners:
            found.append(f"{self.vertices_around_corners:,} places see no bone: nearest one through the body")
        return found


@dataclass(frozen=True, slots=True, eq=False)
class AutomaticWeights:
    """One skin for each mesh, and how they came about."""

    skins: tuple[Skin, ...]
    report: WeightsReport


def automatic_weights(
    meshes: Mesh | Sequence[Mesh],
    skeleton: Skeleton,
    *,
    model_from_joint: Array | None = None,
    joints: Sequence[int | str] | None = None,
    max_influences: int = 4,
    strength: float = 1.0,
    method: SkinningMethod | str = SkinningMethod.LINEAR,
    progress: Progress | None = None,
) -> AutomaticWeights:
    """Skins that bind meshes to a skeleton by the heat that bones give off to the surface they see.

    Vertices at the same place get the same weights, also in different meshes. Pieces without a bone inside, close to
    others, go along with these; small ones around a leaf joint (eyes) belong to it. Meshes may be open, overlap, or have
    degenerate triangles and loose vertices.

    Shapes and units: meshes are in the model's space; ``model_from_joint`` (J, 4, 4) is the pose that they fit, the rest
    pose if not given. ``joints`` are those that may move something, all if not given; each vertex follows at most
    ``max_influences``. ``strength`` narrows (>1) or widens (<1) the zones where joints blend.

    Raises:
        ShapeError: where there is no vertex, a position is not finite, or a number is out of range.
        UnknownName: for a joint or skinning method that does not exist.

    Source: I. Baran, J. Popović, "Automatic rigging and animation of 3D characters", 2007 (bone heat); O. Dionne,
    M. de Lasa, "Geodesic voxel binding for production character meshes", 2013 (what open meshes enclose).
    """
    meshes = [meshes] if isinstance(meshes, Mesh) else list(meshes)
    if max_influences < 1:
        raise ShapeError(f"max_influences: expected at least 1, got {max_influences}")
    if not (np.isfinite(strength) and strength > 0):
        raise ShapeError(f"strength: expected a number above 0, got {strength}")
    if method not in tuple(SkinningMethod):
        raise UnknownName("skinning method", method, SkinningMethod)
    pose = world(skeleton, skeleton.rest) if model_from_joint is None else model_from_joint
    pose = np.asarray(pose, np.float64)
    checked(pose, (skeleton.joint_count, 4, 4), "model_from_joint", "the skeleton")
    surface = weld(meshes)
    solid = solid_of(surface)
    chosen = (
        _named(skeleton, joints)
        if joints is not None
        else _of_the_body(skeleton, pose[:, :3, 3], solid.holds(pose[:, :3, 3]))
    )
    found, report = _weigh(surface, solid, skeleton, pose, chosen, strength, max_influences, progress)
    binds = np.linalg.inv(pose)
    skins: list[Skin] = []
    for mesh, points in zip(meshes, surface.point_of, strict=True):
        skins.append(_skin(found[points], binds, max_influences, mesh.positions.dtype, SkinningMethod(method)))
    moving = {int(j) for bound in skins for j in bound.palette[np.unique(bound.joints[bound.weights > 0])]}
    report = replace(
        report,
        influences=max((int(np.count_nonzero(s.weights, axis=1).max(initial=0)) for s in skins), default=0),
        joints=tuple(skeleton.names[j] for j in sorted(moving)),
        joints_without=tuple(skeleton.names[j] for j in chosen if j not in moving),
    )
    return AutomaticWeights(tuple(skins), report)


def skin_character(
    character: Character,
    *,
    skeleton: Skeleton | None = None,
    joints: Sequence[int | str] | None = None,
    max_influences: int = 4,
    strength: float = 1.0,
    method: SkinningMethod | str = SkinningMethod.LINEAR,
    progress: Progress | None = None,
) -> tuple[Character, WeightsReport]:
    """The character with automatic weights in place of its skins and rigid bindings; see `automatic_weights`.

    Parts, morphs, the pose that the character was bound in and everything else stay. Where ``joints`` are not given,
    those are taken that its skins used, if it has any. With another ``skeleton``, whose rest pose stands where the meshes
    stand, the character gets that one in place of its own, and loses the roles of its joints.

    Raises:
        ShapeError: where the character has no mesh.
    """
    if not character.parts:
        raise ShapeError(f"character '{character.name}': it has no mesh to bind")
    bound = bound_pose(character)
    if joints is None and skeleton is None:
        joints = _used(character) or None
    done = automatic_weights(
        bound.meshes,
        skeleton or character.skeleton,
        model_from_joint=None if skeleton else bound.model_from_joint,
        joints=joints,
        max_influences=max_influences,
        strength=strength,
        method=method,
        progress=progress,
    )
    parts: list[Part] = []
    for part, skin, carrier in zip(character.parts, done.skins, bound.model_from_mesh, strict=True):
        binds = np.asarray(skin.joint_from_mesh, np.float64) @ carrier
        skin = replace(skin, joint_from_mesh=binds.astype(part.mesh.positions.dtype))
        parts.append(replace(part, skin=skin, joint=None))
    if skeleton is not None:
        return replace(character, skeleton=skeleton, parts=tuple(parts), roles={}), done.report
    return replace(character, parts=tuple(parts)), done.report


def _used(character: Character) -> list[int]:
    """The joints that move something now."""
    found: set[int] = set()
    for part in character.parts:
        if part.skin is not None:
            moved = np.unique(part.skin.joints[np.asarray(part.skin.weights) > 0])
            found.update(np.asarray(part.skin.palette)[moved].tolist())
    return sorted(found)


def _named(skeleton: Skeleton, joints: Sequence[int | str]) -> list[int]:
    found = {skeleton.index(joint) for joint in joints}
    if not found:
        raise ShapeError("joints: expected at least one that may move something")
    return sorted(found)


def _of_the_body(skeleton: Skeleton, places: Floats, inside: Any) -> list[int]:
    """All joints but mounts and those that only carry others: outside the body above the first fork, and leaves beside it."""
    below = [1] * skeleton.joint_count
    for joint in range(skeleton.joint_count - 1, -1, -1):
        if skeleton.parents[joint] >= 0:
            below[int(skeleton.parents[joint])] += below[joint]
    children: list[list[int]] = [[] for _ in below]
    for joint, parent in enumerate(skeleton.parents.tolist()):
        if parent >= 0:
            children[parent].append(joint)
    carriers = mounts_of(skeleton, places)
    row = [j for j in range(skeleton.joint_count) if skeleton.parents[j] < 0]
    while True:
        branches = [j for j in row if below[j] > 1]
        if not branches:  # no fork at all: a tail, a rope
            return [j for j in range(skeleton.joint_count) if j not in mounts_of(skeleton, places)]
        if len(branches) > 1:
            break
        carriers.update(j for j in row if below[j] == 1)
        if not inside[branches[0]]:
            carriers.add(branches[0])
        row = children[branches[0]]
    return [j for j in range(skeleton.joint_count) if j not in carriers]


def _weigh(
    surface: Surface,
    solid: Solid,
    skeleton: Skeleton,
    pose: Floats,
    chosen: list[int],
    strength: float,
    most: int,
    progress: Progress | None,
) -> tuple[Floats, WeightsReport]:
    """Weights (P, J) of all points."""
    bones = bones_of(skeleton, pose, chosen, solid.reach if len(surface.triangles) else None)
    pieces = sort_pieces(surface, skeleton, pose[:, :3, 3], chosen, bones)
    bones, notes = _heating(solid, bones, skeleton, set(pieces.owner.values()))
    heated = np.isin(np.arange(surface.shell_count), pieces.heated)
    mine = np.nonzero(heated[surface.shell_of])[0]
    weights = np.zeros((len(surface.points), skeleton.joint_count))
    bent, before, lost = 0, 1, 0.0
    if len(mine):
        sources = sources_of(sight_of(surface, solid), mine, bones, skeleton.joint_count, strength)
        reached = np.bincount(surface.shell_of[mine], sources.heat > 0, minlength=surface.shell_count) > 0
        cold = [s for s in pieces.heated if not reached[s]]
        warm = reached[surface.shell_of[mine]]
        pieces.heated = [s for s in pieces.heated if reached[s]]
        pieces.attached += cold
        used = mine[warm]
        weights[used] = spread(surface, surface.triangles_of(reached), used, sources.rows(warm), progress)
        bent = int(np.count_nonzero(sources.bent))
        before = int(np.count_nonzero(weights > _LEAST_WEIGHT, axis=1).max(initial=0))
        # what goes along follows the surface as it will move, with few influences
        order, kept, total = _largest(weights[used], most)
        weights[used] = 0.0
        weights[used[:, None], order] = kept
        lost = float((1.0 - total).sum() / max(len(used), 1))
    for shell, joint in pieces.owner.items():
        weights[surface.shell_of == shell, joint] = 1.0
    _attach(surface, pieces, weights, bones)
    report = WeightsReport(
        vertices=sum(map(len, surface.point_of)),
        points=len(surface.points),
        pieces=surface.shell_count,
        heated=len(pieces.heated),
        attached=len(pieces.attached) + len(pieces.held),
        rigid=len(pieces.owner),
        open_pieces=int(np.count_nonzero(~surface.closed[pieces.heated])),
        vertices_around_corners=bent,
        influences=0,
        influences_before=before,
        mean_lost_weight=lost,
        joints=(),
        joints_without=(),
        notes=tuple(notes),
    )
    return weights, report


def _heating(solid: Solid, bones: Bones, skeleton: Skeleton, owners: set[int]) -> tuple[Bones, list[str]]:
    """The bones that give off heat: those in the body, without joints that have a piece of their own."""
    notes: list[str] = []
    others = ~np.isin(bones.joints, list(owners))
    if others.any():
        bones = bones.kept(others)
    inside = solid.inside_shares(bones) >= _INSIDE
    if not inside.any():
        notes.append(f"no bone is inside the mesh: {_FIT}")
        return bones, notes
    outside = [skeleton.names[j] for j in dict.fromkeys(bones.joints[~inside].tolist())]
    outside = [name for name in outside if skeleton.index(name) not in set(bones.joints[inside].tolist())]
    if outside:
        shown = ", ".join(outside[:5]) + (", ..." if len(outside) > 5 else "")
        have = "1 joint has" if len(outside) == 1 else f"{len(outside)} joints have"
        notes.append(f"{have} no bone inside the mesh: {shown}")
        if len(outside) > _MISFIT * len(set(bones.joints.tolist())):
            notes.append(f"most bones are outside: {_FIT}")
    return bones.kept(inside), notes


def _attach(surface: Surface, pieces: Pieces, weights: Floats, bones: Bones) -> None:
    """Give what goes along its weights, in place."""
    along = [*pieces.attached, *pieces.held]
    if not along:
        return
    body = surface.triangles_of(np.isin(np.arange(surface.shell_count), [*pieces.heated, *pieces.owner]))
    mine = np.nonzero(np.isin(surface.shell_of, along))[0]
    if len(body):
        triangle, shares, _ = nearest_on(surface.points, body, surface.points[mine])
        weights[mine] = np.einsum("nk,nkj->nj", shares, weights[body[triangle]])
    else:
        _, ways = bones.nearest(surface.points[mine])
        weights[mine, bones.joints[np.argmin(ways, axis=1)]] = 1.0
    for shell in along:
        own = np.nonzero(surface.shell_of == shell)[0]
        if shell in pieces.held:
            weights[own] = weights[pieces.held[shell]].mean(axis=0)
        elif np.linalg.norm(np.ptp(surface.points[own], axis=0)) < _STIFF * surface.size_m:
            weights[own] = weights[own].mean(axis=0)


def _largest(weights: Floats, most: int) -> tuple[Ints, Floats, Floats]:
    """The ``most`` largest of weights (V, J), joints and values (V, K) with a sum of 1, and what was their sum before.

    The next smaller one takes its own share off from all, the more the nearer they are to it, so that no joint comes and
    goes at once from one vertex to the next.
    """
    width = min(most, weights.shape[1])
    ranks = min(width + 1, weights.shape[1])
    order = np.argpartition(-weights, ranks - 1, axis=1)[:, :ranks]
    order = np.take_along_axis(order, np.argsort(-np.take_along_axis(weights, order, 1), axis=1, kind="stable"), 1)
    ranked = np.take_along_axis(weights, order, axis=1)
    kept = ranked[:, :width]
    total = kept.sum(axis=1)
    if ranks > width:
        next_one = ranked[:, width:]
        kept = kept - next_one * (next_one / np.maximum(kept, 1e-30)) + _EVEN
    kept = np.where(kept < _LEAST_WEIGHT * kept.sum(axis=1, keepdims=True), 0.0, kept)
    return order[:, :width], kept / kept.sum(axis=1, keepdims=True), total


def _skin(weights: Floats, binds: Floats, most: int, dtype: Any, method: SkinningMethod) -> Skin:
    """A skin of the largest ``most`` of weights (V, J)."""
    order, kept, _ = _largest(weights, most)
    palette, slots = np.unique(order[kept > 0], return_inverse=True)
    joints = np.zeros(order.shape, np.int32)
    joints[kept > 0] = slots.reshape(-1)
    return Skin(palette.astype(np.int32), binds[palette].astype(dtype), joints, kept.astype(np.float32), method)
