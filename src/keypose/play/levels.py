"""Levels of detail of a character: fewer triangles, fewer joints, seldomer updates, each with its error stated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from keypose import deform
from keypose.arrays import Array, Floats, Ints
from keypose.deform.rebinding import rebind
from keypose.deform.simplify import SurfaceError, simplify, surface_error
from keypose.errors import ShapeError, UnknownName
from keypose.evaluate import world
from keypose.math import rigid
from keypose.model import Character, Mesh, Part, Pose, Skeleton, Skin

_INFLUENCES = 4
_SMOOTH = 0.64  # cosine of the sharpest edge that may become round
_GUESSED_TURN = 1.0  # chord of sixty degrees: how far a joint may turn where no example says it


@dataclass(frozen=True, slots=True)
class LevelSpec:
    """What one level of detail shall be.

    Units:
        triangles: share of the character's triangles, 0..1; at least ``fewest`` of them, or all.
        joint_error_m: joints are dropped that move no vertex by more than this from where it is without them; 0 keeps all.
        every: the steps from one update to the next.
        above: the level is for characters taller than this share of the view's height.
        capacity: characters at most; who is too much goes to the next level. None: no limit.
        without: names of parts that are left out.
    """

    triangles: float = 1.0
    joint_error_m: float = 0.0
    every: int = 1
    above: float = 0.0
    capacity: int | None = None
    without: tuple[str, ...] = ()
    fewest: int = 12


# A level is used where its largest error on the surface is about a pixel and a half on a screen of 1,080 lines.
DEFAULT = (
    LevelSpec(above=0.35),
    LevelSpec(0.35, 0.01, above=0.14, fewest=2500),
    LevelSpec(0.12, 0.03, 2, above=0.05, fewest=800),
    LevelSpec(0.04, 0.05, 4, fewest=300),
)
_PERSON_M = 1.7


@dataclass(frozen=True, slots=True, eq=False)
class Level:
    """One level of detail: the whole character as one mesh and one skin of up to four influences.

    Shapes and units:
        mesh: V vertices and F triangles in the model's space, colours the materials' and the vertices' own.
        skin: its palette holds the joints that are kept and move something.
        parts: (V,) part of the character that each vertex comes from; vertices: (V,) which one of it.
        error: between this surface and the character's own, in rest, of the parts that are kept.
        motion_error: of its vertices in the example poses; None where no examples were given.
    """

    spec: LevelSpec
    mesh: Mesh
    skin: Skin
    parts: Ints
    vertices: Ints
    joint_count: int
    error: SurfaceError
    motion_error: SurfaceError | None
    compiled: Any = field(repr=False)

    @property
    def triangle_count(self) -> int:
        """F."""
        return len(self.mesh.triangles)


def build(
    character: Character,
    specs: Sequence[LevelSpec] | None = None,
    examples: Pose | None = None,
    importance: dict[str, float] | None = None,
) -> tuple[Level, ...]:
    """The levels of detail of a character, the finest first.

    Triangles go by edge collapses that move no vertex, so every vertex keeps its weights; weights of dropped joints go to
    the nearest kept joint above, and what they moved stays as it is in the mean of ``examples``, poses (N,) of what
    the character will do. Without examples every joint is taken to turn by up to sixty degrees. ``importance`` says
    by name which parts' errors count more. Morph targets are left out.

    Without ``specs`` the levels are `DEFAULT`, whose lengths are those for a person, made to the character's size.

    Raises:
        ShapeError: where a number is out of range, levels do not come from fine to coarse, or nothing can be skinned.
        UnknownName: for a part that is not there.
    """
    names = [part.name for part in character.parts]
    for name in [*(n for s in specs or () for n in s.without), *(importance or {})]:
        if name not in names:
            raise UnknownName("part", name, names)
    rest = world(character.skeleton, character.skeleton.rest)
    bound = [_bound(part, rest) for part in character.parts]
    if not any(len(part.mesh.triangles) for part in bound):
        raise ShapeError(f"character '{character.name}': there is no triangle to make levels from")
    if specs is None:
        size = max(float(np.ptp(np.concatenate([p.mesh.positions for p in bound]), axis=0).max()), 1e-9)
        specs = [replace(s, joint_error_m=s.joint_error_m * size / _PERSON_M) for s in DEFAULT]
    _check_specs(specs)
    moves = _joint_moves(character, bound, examples)
    relaxed = world(character.skeleton, _mean(examples) if examples is not None else character.skeleton.rest)
    made: list[Level] = []
    for spec in specs:
        parts = [p for p in bound if p.name not in spec.without and len(p.mesh.triangles)]
        kept = np.asarray(character.skeleton.parents) < 0
        kept |= (moves > spec.joint_error_m) | (spec.joint_error_m == 0)
        for joint in range(len(kept) - 1, -1, -1):  # what is kept keeps its parents
            if kept[joint] and character.skeleton.parents[joint] >= 0:
                kept[character.skeleton.parents[joint]] = True
        made.append(_level(character, spec, bound, parts, kept, relaxed, examples, importance or {}))
    return tuple(made)


def _check_specs(specs: Sequence[LevelSpec]) -> None:
    if not specs:
        raise ShapeError("specs: expected at least one level")
    for n, spec in enumerate(specs):
        if not 0 < spec.triangles <= 1 or spec.joint_error_m < 0 or spec.every < 1 or spec.above < 0 or spec.fewest < 0:
            raise ShapeError(
                f"specs[{n}]: expected triangles in (0, 1], joint_error_m and above and fewest >= 0, every >= 1: {spec}"
            )
        if spec.capacity is not None and spec.capacity < 0:
            raise ShapeError(f"specs[{n}]: expected a capacity >= 0, got {spec.capacity}")
        if n and spec.above >= specs[n - 1].above:
            raise ShapeError(f"specs[{n}]: expected above less than the {specs[n - 1].above} of the level before")
    if specs[-1].above != 0 or specs[-1].capacity is not None:
        raise ShapeError("specs: expected the last level to take everyone: above 0, capacity None")


def _level(
    character: Character, spec: LevelSpec, whole: list[_Bound], parts: list[_Bound], kept: Any, relaxed: Array,
    examples: Pose | None, importance: dict[str, float],
) -> Level:  # fmt: skip
    skeleton = character.skeleton
    shown = parts if kept.all() else [_rebound(part, skeleton, kept, relaxed) for part in parts]
    counts = [p.mesh.vertex_count for p in shown]
    offsets = np.concatenate([[0], np.cumsum(counts)])
    triangles = np.concatenate([p.mesh.triangles + o for p, o in zip(shown, offsets, strict=False)])
    rest = np.concatenate([p.mesh.positions for p in parts])  # a seam is one where the original is
    palette, binds, joints, weights = _joined_skins(shown)
    number = {id(p): n for n, p in enumerate(whole)}
    of = np.repeat([number[id(p)] for p in parts], counts)
    colors = np.concatenate([p.colors for p in shown])
    normals = np.concatenate([_normals(p.mesh) for p in shown])
    if spec.triangles < 1:
        total = sum(len(p.mesh.triangles) for p in whole)
        dense = np.zeros((len(weights), len(palette)), np.float32)
        np.add.at(dense, (np.arange(len(weights))[:, None], joints), weights)
        first, normals = _welded(np.concatenate([of[:, None], rest, dense, colors], axis=1, dtype=np.float32), normals)
        factor = np.repeat([importance.get(p.name, 1.0) for p in shown], counts)
        target = max(round(spec.triangles * total), min(total, spec.fewest))
        features = np.concatenate([dense, colors[:, :3]], axis=1)
        triangles = simplify(rest, first[triangles], target, features=features, importance=factor)
    used, inverse = np.unique(triangles, return_inverse=True)
    triangles = inverse.reshape(-1, 3).astype(np.int32)
    of = of[used]
    own = np.concatenate([np.arange(n) for n in counts])[used]
    positions = np.concatenate([p.mesh.positions for p in shown])[used]
    mesh = Mesh(positions, triangles, normals[used], colors=colors[used])
    entries, slots = np.unique(joints[used][weights[used] > 0], return_inverse=True)
    joints = np.where(weights[used] > 0, joints[used], -1)
    joints[joints >= 0] = slots.reshape(-1)
    skin = Skin(palette[entries], binds[entries], np.maximum(joints, 0), weights[used])
    error = SurfaceError(0.0, 0.0)
    if spec.triangles < 1:
        error = surface_error(rest[used], triangles, rest, np.concatenate(
            [p.mesh.triangles + o for p, o in zip(parts, offsets, strict=False)]))  # fmt: skip
    motion = None if examples is None else _motion_error(character, whole, of, own, mesh, skin, examples)
    from keypose.kernels.skin import compile_mesh

    compiled = compile_mesh(skin.joints, skin.weights, positions, mesh.normals, skin.palette, skin.joint_from_mesh)
    return Level(spec, mesh, skin, of, own, int(kept.sum()), error, motion, compiled)


def _welded(rows: Floats, normals: Array) -> tuple[Ints, Array]:
    """For every vertex the first one that is the same (V, C) but for a normal within some fifty degrees, and the normals (V, 3)
    that those then share: files often have vertices of their own for every triangle."""
    keys = np.ascontiguousarray(rows).view(np.dtype((np.void, rows.shape[1] * rows.itemsize))).ravel()
    _, group = np.unique(keys, return_inverse=True)
    group = group.reshape(-1)
    order = np.argsort(group, kind="stable")
    first, normals = np.arange(len(rows)), np.array(normals)
    for same in np.split(order, np.nonzero(np.diff(group[order]))[0] + 1):
        while len(same) > 1:
            near = normals[same] @ normals[same[0]] > _SMOOTH
            near[0] = True
            first[same[near]] = same[0]
            mean = normals[same[near]].sum(axis=0)
            normals[same[0]] = mean / max(float(np.linalg.norm(mean)), 1e-30)
            same = same[~near]
    return first, normals


@dataclass(frozen=True, slots=True, eq=False)
class _Bound:
    """A part with a skin of exactly four influences."""

    name: str
    mesh: Mesh
    skin: Skin
    colors: Array


def _bound(part: Part, rest: Array) -> _Bound:
    """A part that hangs on a joint is put into the rest pose and bound to that joint alone."""
    mesh, skin, count = part.mesh, part.skin, part.mesh.vertex_count
    if skin is None:
        carrier = np.asarray(rest, np.float64)[part.joint]
        positions = rigid.transform_points(carrier, np.asarray(mesh.positions, np.float64)).astype(mesh.positions.dtype)
        normals = (
            None if mesh.normals is None else deform.transform_normals(carrier, np.asarray(mesh.normals, np.float64))
        )
        mesh = Mesh(positions, mesh.triangles, normals)
        away = np.linalg.inv(carrier)[None].astype(np.float32)
        skin = Skin(np.array([part.joint]), away, np.zeros((count, 1), int), np.ones((count, 1), np.float32))
    packed, _ = deform.pack(skin, _INFLUENCES)
    colors = np.tile(np.asarray(part.material.base_color, np.float32), (count, 1))
    if part.mesh.colors is not None:
        colors = colors * np.asarray(part.mesh.colors, np.float32)
    return _Bound(part.name, mesh, packed, colors)


def _rebound(part: _Bound, skeleton: Skeleton, kept: Any, relaxed: Array) -> _Bound:
    mesh, skin = rebind(part.mesh, part.skin, skeleton, kept, relaxed)
    packed, _ = deform.pack(skin, _INFLUENCES)
    return _Bound(part.name, mesh, packed, part.colors)


def _normals(mesh: Mesh) -> Array:
    if mesh.normals is not None:
        return mesh.normals
    corners = np.asarray(mesh.positions)[mesh.triangles]
    faces = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros((mesh.vertex_count, 3))
    for k in range(3):
        np.add.at(normals, mesh.triangles[:, k], faces)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.where(lengths > 0, normals / np.maximum(lengths, 1e-30), (0.0, 1.0, 0.0)).astype(mesh.positions.dtype)


def _joined_skins(parts: Sequence[_Bound]) -> tuple[Ints, Floats, Ints, Floats]:
    """One palette of all pairs of joint and inverse bind matrix, and the joints and weights of all vertices in it."""
    skins = [p.skin for p in parts]
    rows = [
        np.concatenate([s.palette[:, None], np.reshape(s.joint_from_mesh, (-1, 16))], axis=1).astype(np.float64)
        for s in skins
    ]
    pairs, slots = np.unique(np.concatenate(rows), axis=0, return_inverse=True)
    starts = np.concatenate([[0], np.cumsum([len(r) for r in rows])])
    joints = [slots.reshape(-1)[a + s.joints] for a, s in zip(starts, skins, strict=False)]
    return (
        pairs[:, 0].astype(np.int32), pairs[:, 1:].reshape(-1, 4, 4).astype(np.float32),
        np.concatenate(joints), np.concatenate([np.asarray(s.weights, np.float32) for s in skins]),
    )  # fmt: skip


def _mean(examples: Pose) -> Pose:
    """The middle of some poses."""
    rotations = np.asarray(examples.rotations, np.float64)
    signs = np.where(np.sum(rotations * rotations[:1], axis=-1, keepdims=True) < 0, -1.0, 1.0)
    mean = (rotations * signs).mean(axis=0)
    mean /= np.linalg.norm(mean, axis=-1, keepdims=True)
    return Pose(np.mean(examples.translations, axis=0), mean, np.mean(examples.scales, axis=0))


def _joint_moves(character: Character, parts: Sequence[_Bound], examples: Pose | None) -> Floats:
    """How far each joint moves the farthest of the vertices that hang on it, from where they are without it, (J,)."""
    skeleton = character.skeleton
    count = skeleton.joint_count
    rest = np.asarray(world(skeleton, skeleton.rest), np.float64)
    # Boxes of what each joint carries, joints below included, in the joint's own space.
    corners: list[list[Floats]] = [[] for _ in range(count)]
    for part in parts:
        skin = part.skin
        positions = np.asarray(part.mesh.positions, np.float64)
        for slot, joint in enumerate(skin.palette.tolist()):
            mine = np.any((skin.joints == slot) & (skin.weights > 0.1), axis=1)
            if not mine.any():
                continue
            points = positions[mine] @ skin.joint_from_mesh[slot, :3, :3].T + skin.joint_from_mesh[slot, :3, 3]
            low, high = points.min(axis=0), points.max(axis=0)
            box = np.array([[(low, high)[(c >> a) & 1][a] for a in range(3)] for c in range(8)])
            inside = box @ rest[joint, :3, :3].T + rest[joint, :3, 3]
            while joint >= 0:
                corners[joint].append(inside)
                joint = int(skeleton.parents[joint])
    moves = np.zeros(count)
    mean = None if examples is None else _mean(examples)
    for joint in range(count):
        if not corners[joint]:
            continue
        at = np.linalg.inv(rest[joint])
        points = np.concatenate(corners[joint]) @ at[:3, :3].T + at[:3, 3]
        if examples is None or mean is None:
            moves[joint] = _GUESSED_TURN * float(np.linalg.norm(points, axis=1).max())
            continue
        here = _local(examples, joint)
        still = _local(mean, joint)
        ends = np.einsum("nrc,pc->npr", here[:, :3, :3], points) + here[:, None, :3, 3]
        away = ends - (points @ still[0, :3, :3].T + still[0, :3, 3])
        moves[joint] = float(np.linalg.norm(away, axis=-1).max())
    return moves


def _local(pose: Pose, joint: int) -> Floats:
    parts = (np.asarray(a, np.float64)[..., joint, :] for a in (pose.translations, pose.rotations, pose.scales))
    return np.reshape(rigid.from_trs(*parts), (-1, 4, 4))


def _motion_error(
    character: Character, whole: Sequence[_Bound], parts: Ints, vertices: Ints, mesh: Mesh, skin: Skin, examples: Pose
) -> SurfaceError:
    """How far the level's vertices are from the character's own, over the examples."""
    models = world(character.skeleton, examples)
    moved = deform.skin(mesh, skin, models)
    worst, squares = 0.0, 0.0
    for n, part in enumerate(whole):
        mine = np.nonzero(parts == n)[0]
        if not len(mine):
            continue
        true = deform.skin(part.mesh, part.skin, models)[:, vertices[mine]]
        away = np.sum((moved[:, mine] - true) ** 2, axis=-1)
        worst, squares = max(worst, float(away.max())), squares + float(away.sum())
    return SurfaceError(float(np.sqrt(worst)), float(np.sqrt(squares / max(moved.shape[0] * len(parts), 1))))
