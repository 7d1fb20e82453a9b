"""Figures that stand for a skeleton: octahedral bones with joint spheres, and joint axes.

A figure is a `Character` made for drawing: each bone and each sphere hangs rigidly on a joint of its own, so that
both backends draw it as they draw any skinned mesh.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import numpy as np

from keypose import evaluate
from keypose.arrays import Array, Floats, Ints
from keypose.model import Character, Material, Mesh, Part, Pose, Skeleton, Skin
from keypose.render.settings import Rgb, Theme

_LEFT = re.compile(r"(?i:left)|(?:^|[\W_])[lL](?:$|[\W_])|(?:^|[\W_])[lL](?=[A-Z])|[a-z0-9]L(?:$|[\W_0-9])")
_RIGHT = re.compile(r"(?i:right)|(?:^|[\W_])[rR](?:$|[\W_])|(?:^|[\W_])[rR](?=[A-Z])|[a-z0-9]R(?:$|[\W_0-9])")
_AXIS_COLORS = ((0.80, 0.06, 0.07), (0.12, 0.55, 0.05), (0.05, 0.22, 0.90))


@dataclass(frozen=True, slots=True, eq=False)
class Figure:
    """A drawable character of P pieces and the rule that moves them with a skeleton of J joints.

    Shapes and units:
        joints: (P,) the joint each piece hangs on.
        tips: (P,) the joint a bone points to, -1 for what does not stretch.
        axes: (P, 3) unit direction of the bone in its joint's space.
        lengths: (P,) metres at rest, in the space of the model.
    """

    character: Character
    joints: Ints
    tips: Ints
    axes: Floats
    lengths: Floats

    def matrices(self, world_from_joint: Floats) -> Floats:
        """Matrices of the pieces (T, P, 4, 4) float32 from those of the joints (T, J, 4, 4)."""
        world = np.asarray(world_from_joint, np.float64)
        rotations = _unscaled(world[..., :3, :3])
        result = np.zeros((len(world), len(self.joints), 4, 4))
        result[..., :3, :3] = rotations[:, self.joints]
        result[..., :3, 3] = world[:, self.joints][..., :3, 3]
        result[..., 3, 3] = 1
        bones = np.nonzero(self.tips >= 0)[0]
        if len(bones):
            places = world[..., :3, 3]
            spans = places[:, self.tips[bones]] - places[:, self.joints[bones]]
            result[:, bones, :3, :3] = _aimed(result[:, bones, :3, :3], self.axes[bones], spans, self.lengths[bones])
        return result.astype(np.float32)


def side_of(name: str) -> int:
    """1 for a joint of the left side, -1 for one of the right, 0 where the name does not say."""
    left, right = bool(_LEFT.search(name)), bool(_RIGHT.search(name))
    return int(left) - int(right)


def sides(skeleton: Skeleton) -> Ints:
    """(J,) 1 left, -1 right, 0 centre: by the names, or by the rest pose where no name tells."""
    found = np.array([side_of(name) for name in skeleton.names], np.int32)
    if (found > 0).any() and (found < 0).any():
        return found
    x = np.asarray(evaluate.world(skeleton, skeleton.rest), np.float64)[:, 0, 3]
    x = x - np.median(x)
    return np.where(np.abs(x) > 0.04 * max(float(np.ptp(x)), 1e-12), np.sign(x), 0).astype(np.int32)


def figure_joints(skeleton: Skeleton) -> Ints:
    """The joints that make a figure: roots with nothing below (cameras' places, props) are none beside a real tree."""
    parents = np.asarray(skeleton.parents)
    above = np.bincount(parents[parents >= 0], minlength=len(parents)) > 0
    found = np.flatnonzero((parents >= 0) | above)
    return found if len(found) else np.arange(len(parents))


def bones_figure(skeleton: Skeleton, theme: Theme) -> Figure | None:
    """Octahedral bones and joint spheres, coloured by side; None for a skeleton without joints."""
    if not skeleton.joint_count:
        return None
    world = np.asarray(evaluate.world(skeleton, skeleton.rest), np.float64)
    places, rotations = world[:, :3, 3], _unscaled(world[:, :3, :3])
    joints, tips, ends = _bones(skeleton, world)
    spans = ends - places[joints]
    lengths = np.linalg.norm(spans, axis=1)
    kept = lengths > 1e-6 * max(float(lengths.max(initial=0.0)), 1e-12)
    joints, tips, spans, lengths = joints[kept], tips[kept], spans[kept], lengths[kept]
    shown = figure_joints(skeleton)
    unit = _unit(places[shown], lengths)
    axes = np.einsum("bji,bj->bi", rotations[joints], spans / lengths[:, None])
    girths = np.minimum(0.115 * lengths, 0.021 * unit)
    girths[_leads(skeleton, joints, tips, lengths)] *= 0.22

    radii = np.full(skeleton.joint_count, np.inf)
    np.minimum.at(radii, joints, girths)
    reached = tips >= 0
    np.minimum.at(radii, tips[reached], girths[reached])
    radii = np.where(np.isfinite(radii), 0.86 * radii, 0.02 * unit)

    colors = _colors(skeleton, theme)
    builder = _Builder()
    for b in range(len(joints)):
        # a bone takes the colour of what it leads to: the collar bone of the arm, not of the spine
        color = colors[tips[b]] if tips[b] >= 0 else colors[joints[b]]
        builder.add(*_octahedron(axes[b], float(lengths[b]), float(girths[b])), color)
    for j in shown:
        builder.add(*_sphere(float(radii[j]), 2 if radii[j] > 0.008 * unit else 1), colors[j] * 0.82)
    pieces = len(shown)
    every = shown.astype(np.int32)
    return Figure(
        builder.character("bones", Material("bones", (1, 1, 1, 1), roughness=0.55)),
        np.concatenate([joints, every]),
        np.concatenate([tips, np.full(pieces, -1, np.int32)]),
        np.concatenate([axes, np.tile([0.0, 1.0, 0.0], (pieces, 1))]),
        np.concatenate([lengths, np.ones(pieces)]),
    )


def dots(radius: float, colors: Floats) -> Character:
    """A sphere for each of the colours (P, 3), bound to a joint of its own; metres."""
    builder = _Builder()
    for color in colors:
        builder.add(*_sphere(radius, 2), color)
    return builder.character("dots", Material("dots", (1, 1, 1, 1), roughness=0.45))


def axes_figure(skeleton: Skeleton) -> Figure | None:
    """Three small arrows at every joint: X red, Y green, Z blue."""
    count = skeleton.joint_count
    if not count:
        return None
    world = np.asarray(evaluate.world(skeleton, skeleton.rest), np.float64)
    joints, _, ends = _bones(skeleton, world)
    lengths = np.linalg.norm(ends - world[joints, :3, 3], axis=1)
    unit = _unit(world[:, :3, 3], lengths)
    reach = np.full(count, np.inf)
    positive = lengths > 0
    np.minimum.at(reach, joints[positive], 0.55 * lengths[positive])
    reach = np.minimum(np.where(np.isfinite(reach), reach, 0.03 * unit), 0.05 * unit)
    builder = _Builder()
    for j in range(count):
        for axis, color in enumerate(_AXIS_COLORS):
            direction = np.eye(3)[axis]
            builder.add(*_arrow(direction, float(reach[j])), np.asarray(color), new_piece=axis == 0)
    return Figure(
        builder.character("axes", Material("axes", (1, 1, 1, 1), unlit=True)),
        np.arange(count, dtype=np.int32),
        np.full(count, -1, np.int32),
        np.tile([0.0, 1.0, 0.0], (count, 1)),
        np.ones(count),
    )


def _bones(skeleton: Skeleton, world: Floats) -> tuple[Ints, Ints, Floats]:
    """Every bone's joint, the joint at its tip (-1 for an end site) and the tip's place at rest."""
    tips = np.nonzero(skeleton.parents >= 0)[0].astype(np.int32)
    joints = skeleton.parents[tips]
    ends = world[tips, :3, 3]
    if skeleton.end_offsets:
        leaves = np.array([joint for joint, _ in skeleton.end_offsets], np.int32)
        offsets = np.array([offset for _, offset in skeleton.end_offsets], np.float64)
        sites = (world[leaves, :3, :3] @ offsets[..., None])[..., 0] + world[leaves, :3, 3]
        joints, tips = np.concatenate([joints, leaves]), np.concatenate([tips, np.full(len(leaves), -1, np.int32)])
        ends = np.concatenate([ends, sites])
    return joints.astype(np.int32), tips.astype(np.int32), ends


def _leads(skeleton: Skeleton, joints: Ints, tips: Ints, lengths: Floats) -> Array:
    """Which bones only lead from a root on the floor to the hips: a lone, long first bone before a body branches off.

    Drawn at full thickness they look like a third leg.
    """
    children = np.bincount(skeleton.parents[skeleton.parents >= 0], minlength=skeleton.joint_count)
    lone = (skeleton.parents[joints] < 0) & (children[joints] == 1) & (tips >= 0)
    branching = np.where(tips >= 0, children[tips], 0) >= 2
    return lone & branching & (lengths > 3 * (np.median(lengths) if len(lengths) else 0.0))


def _unit(places: Floats, lengths: Floats) -> float:
    """A length that the thickness of bones is measured by: the reach of the rest pose."""
    extent = float(np.linalg.norm(np.ptp(places, axis=0))) if len(places) else 0.0
    # a lone bone, or a rest pose folded up into one point, still has the lengths of its bones
    return max(0.8 * extent, float(lengths.max(initial=0.0))) or 1.0


def _colors(skeleton: Skeleton, theme: Theme) -> Floats:
    by_side: dict[int, Rgb] = {1: theme.bone_left, -1: theme.bone_right, 0: theme.bone_center}
    return np.array([by_side[int(s)] for s in sides(skeleton)], np.float64)


def _unscaled(matrices: Floats) -> Floats:
    """The rotations of 3x3 matrices whose columns may be scaled; a flattened joint keeps a valid direction."""
    lengths = np.linalg.norm(matrices, axis=-2, keepdims=True)
    flat = np.any(lengths < 1e-12, axis=(-1, -2), keepdims=True)
    return np.where(flat, np.eye(3), matrices / np.where(lengths < 1e-12, 1.0, lengths))


def _aimed(rotations: Floats, axes: Floats, spans: Floats, lengths: Floats) -> Floats:
    """Turn each piece by the shortest way so that its axis points along the span, and stretch it to the span."""
    now = np.linalg.norm(spans, axis=-1)
    heading = (rotations @ axes[..., None])[..., 0]
    # a bone without length points nowhere: it keeps its joint's direction
    wanted = np.where(now[..., None] > 0, spans / np.where(now > 0, now, 1.0)[..., None], heading)
    cross, cosine = np.cross(heading, wanted), np.sum(heading * wanted, axis=-1)
    skew = np.zeros((*cross.shape, 3))
    skew[..., 0, 1], skew[..., 0, 2], skew[..., 1, 2] = -cross[..., 2], cross[..., 1], -cross[..., 0]
    skew -= np.swapaxes(skew, -1, -2)
    # Rodrigues' formula between unit vectors; opposite directions turn half round any normal axis
    factor = 1 / np.where(cosine > -1 + 1e-9, 1 + cosine, 1.0)
    turn = np.eye(3) + skew + (skew @ skew) * factor[..., None, None]
    helper = np.where(np.abs(heading[..., :1]) < 0.9, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
    normal = np.cross(heading, helper)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    half = 2 * normal[..., :, None] * normal[..., None, :] - np.eye(3)
    turn = np.where((cosine > -1 + 1e-9)[..., None, None], turn, half)
    ratio = now / lengths
    # what grows far beyond its rest length is no bone but the way of a root from its origin: it thins out
    girth = np.clip((2.2 - ratio) / 0.6, 0.0, 1.0)
    along = axes[:, :, None] * axes[:, None, :]
    stretch = girth[..., None, None] * (np.eye(3) - along) + (ratio * (girth > 0))[..., None, None] * along
    return turn @ rotations @ stretch


class _Builder:
    """Collects pieces into one mesh in which piece p is bound to joint p."""

    def __init__(self) -> None:
        self.positions: list[Floats] = []
        self.normals: list[Floats] = []
        self.colors: list[Floats] = []
        self.triangles: list[Ints] = []
        self.pieces: list[Ints] = []
        self.vertex_count, self.piece_count = 0, 0

    def add(self, positions: Floats, normals: Floats, triangles: Ints, color: Array, new_piece: bool = True) -> None:
        self.piece_count += new_piece
        self.positions.append(positions)
        self.normals.append(normals)
        self.colors.append(np.tile([*color, 1.0], (len(positions), 1)))
        self.triangles.append(triangles + self.vertex_count)
        self.pieces.append(np.full((len(positions), 1), self.piece_count - 1, np.int32))
        self.vertex_count += len(positions)

    def character(self, name: str, material: Material) -> Character:
        count = self.piece_count
        mesh = Mesh(
            np.concatenate(self.positions).astype(np.float32),
            np.concatenate(self.triangles),
            normals=np.concatenate(self.normals).astype(np.float32),
            colors=np.concatenate(self.colors).astype(np.float32),
        )
        skin = Skin(
            np.arange(count),
            np.broadcast_to(np.eye(4, dtype=np.float32), (count, 4, 4)),
            np.concatenate(self.pieces),
            np.ones((self.vertex_count, 1), np.float32),
        )
        rest = Pose(np.zeros((count, 3)), np.tile([1.0, 0, 0, 0], (count, 1)), np.ones((count, 3)))
        pieces = Skeleton(tuple(f"{name}{i}" for i in range(count)), np.full(count, -1), rest)
        return Character(pieces, (Part(name, mesh, material, skin=skin),), name=name)


def _side_axes(direction: Floats) -> tuple[Floats, Floats]:
    helper = np.array([0.0, 0.0, 1.0]) if abs(direction[2]) < 0.9 else np.array([1.0, 0.0, 0.0])
    x = np.cross(direction, helper)
    x /= np.linalg.norm(x)
    return x, np.cross(x, direction)


def _octahedron(direction: Floats, length: float, girth: float) -> tuple[Floats, Floats, Ints]:
    """The classic bone: a square ring near the joint, a point at each end; flat faces."""
    x, z = _side_axes(direction)
    ring = [
        direction * min(1.5 * girth, 0.4 * length) + girth * (sx * x + sz * z)
        for sx, sz in ((1, 1), (-1, 1), (-1, -1), (1, -1))
    ]
    tail = direction * length
    faces: list[Any] = []
    for i in range(4):
        a, b = ring[i], ring[(i + 1) % 4]
        faces += [[np.zeros(3), b, a], [tail, a, b]]
    corners = np.array(faces)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    outward = np.sum(normals * (corners.mean(axis=1) - direction * 0.3 * length), axis=1)
    corners = np.where((outward < 0)[:, None, None], corners[:, ::-1], corners)
    normals = np.where((outward < 0)[:, None], -normals, normals)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return corners.reshape(-1, 3), np.repeat(normals, 3, axis=0), np.arange(len(faces) * 3).reshape(-1, 3)


def _sphere(radius: float, level: int) -> tuple[Floats, Floats, Ints]:
    vertices, triangles = _icosphere(level)
    return vertices * radius, vertices, triangles


def _arrow(direction: Floats, length: float) -> tuple[Floats, Floats, Ints]:
    """A six-sided stick that ends in a point."""
    x, z = _side_axes(direction)
    angles = np.arange(6) * (np.pi / 3)
    around = np.cos(angles)[:, None] * x + np.sin(angles)[:, None] * z
    rows = ((0.0, 0.03), (0.72, 0.03), (0.72, 0.085))
    positions = np.concatenate([length * (along * direction + girth * around) for along, girth in rows])
    positions = np.concatenate([positions, [length * direction]])
    normals = np.concatenate([np.tile(around, (3, 1)), [direction]])
    triangles: list[tuple[int, int, int]] = []
    for i in range(6):
        j = (i + 1) % 6
        for row in (0, 6):
            triangles += [(row + i, row + 6 + i, row + j), (row + j, row + 6 + i, row + 6 + j)]
        triangles.append((12 + i, 18, 12 + j))
    return positions, normals, np.array(triangles)


def _icosphere(level: int) -> tuple[Floats, Ints]:
    golden = (1 + 5**0.5) / 2
    corners = [(-1, golden, 0), (1, golden, 0), (-1, -golden, 0), (1, -golden, 0)]
    corners += [(0, -1, golden), (0, 1, golden), (0, -1, -golden), (0, 1, -golden)]
    corners += [(golden, 0, -1), (golden, 0, 1), (-golden, 0, -1), (-golden, 0, 1)]
    vertices = [np.array(c, float) / np.linalg.norm(c) for c in corners]
    faces = [(0, 11, 5), (0, 5, 1), (0, 1, 7), (0, 7, 10), (0, 10, 11), (1, 5, 9), (5, 11, 4), (11, 10, 2), (10, 7, 6)]
    faces += [(7, 1, 8), (3, 9, 4), (3, 4, 2), (3, 2, 6), (3, 6, 8), (3, 8, 9), (4, 9, 5), (2, 4, 11), (6, 2, 10)]
    faces += [(8, 6, 7), (9, 8, 1)]
    for _ in range(level):
        middles: dict[tuple[int, int], int] = {}

        def middle(a: int, b: int, middles: dict[tuple[int, int], int] = middles) -> int:
            key = (min(a, b), max(a, b))
            if key not in middles:
                point = vertices[a] + vertices[b]
                vertices.append(point / np.linalg.norm(point))
                middles[key] = len(vertices) - 1
            return middles[key]

        finer: list[tuple[int, int, int]] = []
        for a, b, c in faces:
            ab, bc, ca = middle(a, b), middle(b, c), middle(c, a)
            finer += [(a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca)]
        faces = finer
    return np.array(vertices), np.array(faces)
