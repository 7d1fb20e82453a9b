"""The built-in human: all parts, their materials, weights and face shapes put together into a `Character`."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

import numpy as np

from keypose.arrays import Floats, Ints
from keypose.model import Character, Material, Mesh, MorphSet, Part, Skin
from keypose.samples import human_clothes, human_details, human_features, human_hair, human_hands, human_head
from keypose.samples.human_face import FEATURES, MORPHS, Face, face_shapes
from keypose.samples.human_features import Piece
from keypose.samples.human_head import HeadMesh
from keypose.samples.shapes import smoothstep
from keypose.samples.skeleton import enlarged, head_scale, rest_positions, roles, skeleton
from keypose.samples.subdivision import Surface, mirrored_name, subdivide, triangulated

NAME = "Robin"

Color = tuple[float, float, float, float]


def _srgb(code: str) -> Color:
    """Linear RGBA of an sRGB hex code, for palettes as designers write them."""
    v = np.array([int(code[i : i + 2], 16) for i in (0, 2, 4)]) / 255
    r, g, b = np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4)
    return (float(r), float(g), float(b), 1.0)


MATERIALS = {
    "skin": Material("skin", _srgb("F0B995"), roughness=0.62),
    "mouth": Material("mouth", _srgb("6E2228"), roughness=0.55),
    "jacket": Material("jacket", _srgb("1F6F7A"), roughness=0.78),
    "sleeves": Material("sleeves", _srgb("F1E4CB"), roughness=0.72),
    "ribbing": Material("ribbing", _srgb("E9A63A"), roughness=0.85),
    "shirt": Material("shirt", _srgb("E2603F"), roughness=0.85),
    "neckband": Material("neckband", _srgb("C9502F"), roughness=0.88),
    "trousers": Material("trousers", _srgb("2F3B5C"), roughness=0.88),
    "turn_ups": Material("turn_ups", _srgb("6C80AC"), roughness=0.88),
    "sneakers": Material("sneakers", _srgb("E2603F"), roughness=0.6),
    "rubber": Material("rubber", _srgb("F4EEE2"), roughness=0.55),
    "hair": Material("hair", _srgb("643527"), roughness=0.5),
    "brows": Material("brows", _srgb("4A261C"), roughness=0.7),
    "lashes": Material("lashes", _srgb("2A1714"), roughness=0.6),
    "eyes": Material("eyes", (1.0, 1.0, 1.0, 1.0), roughness=0.12),
    "catchlights": Material("catchlights", (1.0, 1.0, 1.0, 1.0), emissive=(0.9, 0.9, 0.9), roughness=0.3),
    "teeth": Material("teeth", (1.0, 1.0, 1.0, 1.0), roughness=0.3),
    "tongue": Material("tongue", _srgb("C9605F"), roughness=0.45),
}

_GROUPS = {  # group of a cage -> part, material
    "body": ("jacket", "jacket"),
    "stripe": ("stripes", "sleeves"),
    "shirt": ("shirt", "shirt"),
    "neckband": ("neckband", "neckband"),
    "sleeve": ("sleeves", "sleeves"),
    "rib": ("ribbing", "ribbing"),
    "collar": ("collar", "ribbing"),
    "trousers": ("trousers", "trousers"),
    "turn_up": ("turn_ups", "turn_ups"),
    "upper": ("sneakers", "sneakers"),
    "sole": ("soles", "rubber"),
    "trim": ("sneaker_trim", "rubber"),
    "skin": ("hands", "skin"),
}


def vertex_normals(points: Floats, triangles: Ints) -> Floats:
    """Unit vertex normals (V, 3), faces weighted by their angle at the vertex.

    Source: G. Thürmer, C. Wüthrich, "Computing vertex normals from polygonal facets", 1998.
    """
    corners = points[triangles]
    ahead = np.roll(corners, -1, 1) - corners
    behind = np.roll(corners, 1, 1) - corners
    face = np.cross(ahead[:, 0], behind[:, 0])
    face /= np.maximum(np.linalg.norm(face, axis=1, keepdims=True), 1e-20)
    cosine = np.sum(ahead * behind, -1) / np.maximum(
        np.linalg.norm(ahead, axis=-1) * np.linalg.norm(behind, axis=-1), 1e-20
    )
    angle = np.arccos(np.clip(cosine, -1, 1))
    normals = np.zeros_like(points)
    for axis in range(3):
        normals[:, axis] = np.bincount(
            triangles.reshape(-1), (angle * face[:, axis, None]).reshape(-1), minlength=len(points)
        )
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-20)


def packed_skin(weights: Floats, influences: int = 4) -> Skin:
    """The skin of dense weights (V, J): the strongest influences, normalised, over the joints really used."""
    order = np.argsort(-weights, axis=1, kind="stable")[:, :influences]
    kept = np.take_along_axis(weights, order, 1)
    kept[kept < 0.015] = 0.0  # traces that subdivision carried far; they would only cost influences
    kept /= kept.sum(1, keepdims=True)
    used = np.unique(order[kept > 0])
    slot = np.zeros(weights.shape[1], np.int32)
    slot[used] = np.arange(len(used))
    joints = np.where(kept > 0, slot[order], 0)
    body = skeleton()
    places = rest_positions()
    matrices = np.tile(np.eye(4), (len(used), 1, 1))
    matrices[:, :3, 3] = [-places[body.names[j]] for j in used]
    return Skin(used, matrices.astype(np.float32), joints, kept.astype(np.float32))


def _dense(weights: Mapping[str, float], count: int) -> Floats:
    row = np.zeros(skeleton().joint_count)
    for name, w in weights.items():
        row[skeleton().index(name)] = w
    return np.tile(row, (count, 1))


def _part(
    name: str,
    material: str,
    points: Floats,
    triangles: Ints,
    weights: Floats,
    normals: Floats | None = None,
    colors: Floats | None = None,
    group: int = 0,
    moves: Floats | None = None,
    turns: Floats | None = None,
) -> Part:
    """A part of the vertices that the triangles use; ``moves`` and ``turns`` (M, V, 3) are its morphs' offsets."""
    used, inverse = np.unique(triangles, return_inverse=True)
    if normals is None:
        normals = vertex_normals(points, triangles)
    rgba = None
    if colors is not None:
        rgba = np.ones((len(used), 4), np.float32)
        rgba[:, :3] = colors[used]
    mesh = Mesh(
        points[used].astype(np.float32),
        inverse.reshape(-1, 3).astype(np.int32),
        normals[used].astype(np.float32),
        colors=rgba,
    )
    morphs, channels = None, None
    if moves is not None:
        turns = normal_turns(points, triangles, moves) if turns is None else turns
        shifts, bends = moves[:, used].astype(np.float32), turns[:, used].astype(np.float32)
        shifts[np.max(np.abs(shifts), -1) < 2e-6] = 0
        bends[np.max(np.abs(bends), -1) < 2e-3] = 0
        channels = np.nonzero(np.any(shifts != 0, axis=(1, 2)))[0]
        if len(channels):
            names = tuple(MORPHS[c] for c in channels)
            morphs = MorphSet.from_dense(names, shifts[channels], bends[channels])
        else:
            channels = None
    return Part(
        name, mesh, MATERIALS[material], packed_skin(weights[used]), morphs=morphs, morph_channels=channels, group=group
    )


def normal_turns(points: Floats, triangles: Ints, moves: Floats) -> Floats:
    """How each morph changes the unit normals, (M, V, 3)."""
    rest = vertex_normals(points, triangles)
    turns = np.zeros_like(moves)
    for m, offsets in enumerate(moves):
        moved = np.any(offsets != 0, axis=1)
        touched = triangles[np.any(moved[triangles], axis=1)]
        if not len(touched):
            continue
        ring = np.zeros(len(points), bool)
        ring[touched] = True
        around = triangles[np.any(ring[triangles], axis=1)]
        turns[m, ring] = (vertex_normals(points + offsets, around) - rest)[ring]
    return turns


def _surface_parts(surface: Surface, group: int) -> list[Part]:
    """One part per material of a subdivided cage; normals run smoothly over the seams between them."""
    triangles = triangulated(surface.quads, surface.points)
    normals = vertex_normals(surface.points, triangles)
    of = np.repeat(np.array(surface.groups), 2)
    return [
        _part(*_GROUPS[g], surface.points, triangles[of == g], surface.weights, normals, group=group)
        for g in dict.fromkeys(surface.groups)
    ]


def jaw_share(points: Floats, head: HeadMesh | None = None) -> Floats:
    """How much the skin follows the jaw, (V,) 0..1."""
    y, z = points[:, 1], points[:, 2]
    line = np.interp(z, [-0.02, 0.02, 0.06, 0.10], [1.500, 1.490, 1.474, 1.4645])
    below = smoothstep(0.014, -0.022, y - line)
    share = below * smoothstep(-0.012, 0.045, z) * smoothstep(1.395, 1.418, y + 0.25 * z)
    if head is not None:
        ring = head.mouth_ring
        on_lips = ring > -90
        t = np.clip(np.abs(points[:, 0]) / human_head.MOUTH_HALF, 0, 1)
        corner = 0.30
        # The opening is round: the lower lip hangs from the corners like an arch, the upper one dips only beside them.
        lower = corner + (1 - corner) * np.sqrt(1 - t**2.7)
        lip = np.where(head.angle < 0, lower, corner * t**5)
        blend = np.where(ring >= 0, np.array([1.0, 1.0, 1.0, 0.85, 0.45])[np.clip(ring, 0, 4)], 1.0)
        share = np.where(on_lips, share * (1 - blend) + lip * blend, share)
        share = np.where(ring == -7, 0.5, share)
    return share


def _head_weights(head: HeadMesh, jaw_share: Floats) -> Floats:
    points = head.points
    body = skeleton()
    weights = np.zeros((len(points), body.joint_count))
    y, z = points[:, 1], points[:, 2]
    bend = smoothstep(1.395, 1.462, y + 0.35 * (z + 0.03))
    low = smoothstep(1.385, 1.345, y)
    jaw = jaw_share * bend
    weights[:, body.index("Jaw")] = jaw
    weights[:, body.index("Head")] = bend - jaw
    weights[:, body.index("Neck")] = (1 - bend) * (1 - 0.4 * low)
    weights[:, body.index("Spine2")] = (1 - bend) * 0.4 * low
    return weights


def _skin_tint(head: HeadMesh) -> Floats:
    rosy = human_head.blush(head.points)[:, None]
    tint = 1 - rosy * np.array([0.02, 0.30, 0.25])
    ring = head.mouth_ring
    lips = np.select([ring == 0, ring == 1, ring == 2, ring == -1], [1.0, 1.0, 0.45, 1.0], 0.0)[:, None]
    return tint * (1 - lips * np.array([0.14, 0.50, 0.42]))


def _mouth_tint(head: HeadMesh) -> Floats:
    """The mouth grows dark behind the lips."""
    depth = np.clip(-1 - head.mouth_ring, 0, 6)
    return np.repeat(np.array([1.0, 0.9, 0.55, 0.25, 0.12, 0.08, 0.08])[depth][:, None], 3, axis=1)


def _joined(pieces: list[Piece]) -> Piece:
    """Several pieces as one mesh; they keep their own weights."""
    offsets = np.cumsum([0, *(len(p.points) for p in pieces)])
    return Piece(
        np.vstack([p.points for p in pieces]),
        np.vstack([p.triangles + o for p, o in zip(pieces, offsets, strict=False)]),
        {},
        np.vstack([p.colors for p in pieces if p.colors is not None]) if pieces[0].colors is not None else None,
        np.concatenate([p.follows for p in pieces if p.follows is not None]) if pieces[0].follows is not None else None,
    )


def _piece_part(name: str, material: str, pieces: list[Piece], moves: Floats | None = None) -> Part:
    """A part of the head."""
    whole = _joined(pieces)
    weights = np.vstack([_dense(p.weights, len(p.points)) for p in pieces])
    points = enlarged(whole.points)
    if moves is not None:
        moves = moves * head_scale(whole.points)
    return _part(name, material, points, whole.triangles, weights, None, whole.colors, moves=moves)


def _soft_normals(points: Floats, triangles: Ints, shown: Ints) -> Floats:
    """Normals of hair: leant away from the skull, so that the locks read as one volume; what is turned in at the
    border does not bend those of what is ``shown`` (V,; 0 or 1)."""
    outside = vertex_normals(points, triangles[np.all(shown[triangles] > 0, axis=1)])
    normals = vertex_normals(points, triangles)
    normals = np.where(shown[:, None] > 0, 0.65 * outside + 0.35 * normals, normals)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    out = points - enlarged(np.array([0.0, 1.565, -0.015]))
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    lean = smoothstep(-0.55, 0.05, np.sum(normals * out, 1))
    normals = normals + (lean * shown)[:, None] * out
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


def joint_mirror(names: tuple[str, ...]) -> Ints:
    """For every joint the index of the same joint on the other side, (J,)."""
    return np.array([names.index(mirrored_name(n)) for n in names])


def _detail_part(name: str, material: str, details: list[human_details.Detail]) -> Part:
    offsets = np.cumsum([0, *(len(p) for p, _, _ in details)])
    triangles = np.vstack([t + o for (_, t, _), o in zip(details, offsets, strict=False)])
    return _part(
        name, material, np.vstack([p for p, _, _ in details]), triangles, np.vstack([w for _, _, w in details])
    )


def _face_parts() -> list[Part]:
    """Head, mouth and everything on them that the face shapes move."""
    head = human_head.build_head()
    jaw = jaw_share(head.points, head)
    pieces = {
        "brows": [human_features.eyebrow(1), human_features.eyebrow(-1)],
        "eyes": [human_features.eyeball(1), human_features.eyeball(-1)],
        "catchlights": [human_features.catchlight(1), human_features.catchlight(-1)],
        "upper_teeth": [human_features.teeth(True)],
        "lower_teeth": [human_features.teeth(False)],
        "tongue": [human_features.tongue()],
    }
    face = Face(head, jaw, **{name: _joined(p).points for name, p in pieces.items()})
    shapes = face_shapes(face)
    moves = {feature: np.stack([getattr(shapes[m], feature) for m in MORPHS]) for feature in FEATURES}
    points = enlarged(head.points)
    skin_moves = moves["skin"] * head_scale(head.points)
    normals = vertex_normals(points, head.triangles)
    turns = normal_turns(points, head.triangles, skin_moves)
    weights = _head_weights(head, jaw)
    outside, bag = head.triangles[~head.inside], head.triangles[head.inside]
    lashes = _lashes(head)
    material = {"upper_teeth": "teeth", "lower_teeth": "teeth"}
    return [
        _part("head", "skin", points, outside, weights, normals, _skin_tint(head), 6, skin_moves, turns),
        _part("mouth", "mouth", points, bag, weights, normals, _mouth_tint(head), 6, skin_moves, turns),
        *(_piece_part(n, material.get(n, n), p, moves[n]) for n, p in pieces.items()),
        _piece_part("lashes", "lashes", lashes, _lash_moves(head, lashes, moves["skin"])),
    ]


@cache
def human() -> Character:
    """The built-in human, built once per process and always the same."""
    names = skeleton().names
    parts: list[Part] = []
    cages = (human_clothes.jacket, human_clothes.shirt, human_clothes.trousers, human_clothes.shoes, human_hands.hands)
    surfaces = [subdivide(cage(), names) for cage in cages]
    surfaces[3].points[:, 1] = np.maximum(surfaces[3].points[:, 1], 0.0)  # soles are flat
    for number, surface in enumerate(surfaces, start=1):
        parts += _surface_parts(surface, number)
    jacket, trousers, shoes = surfaces[0], surfaces[2], surfaces[3]
    swap = joint_mirror(names)

    def pair(left: list[human_details.Detail]) -> list[human_details.Detail]:
        return [*left, *((p * (-1, 1, 1), t[:, ::-1], w[:, swap]) for p, t, w in left)]

    parts.append(_detail_part("zip", "ribbing", human_details.zip_fastener(jacket)))
    parts.append(_detail_part("star", "sleeves", [human_details.star(jacket)]))
    parts.append(_detail_part("pockets", "ribbing", pair(human_details.jacket_pockets(jacket))))
    seams = [*pair(human_details.seams(trousers)), *human_details.fly(trousers)]
    parts.append(_detail_part("seams", "turn_ups", seams))
    parts.append(_detail_part("laces", "rubber", pair(human_details.laces(shoes))))
    parts += _face_parts()
    ear_points, ear_triangles, deep = human_features.ears()
    tint = 1 - deep[:, None] * np.array([0.03, 0.16, 0.15])
    parts.append(
        _part("ears", "skin", enlarged(ear_points), ear_triangles, _dense({"Head": 1}, len(ear_points)), colors=tint)
    )
    points, triangles, shade, shown = human_hair.hair()
    points = enlarged(points)
    normals = _soft_normals(points, triangles, shown)
    parts.append(_part("hair", "hair", points, triangles, _dense({"Head": 1}, len(points)), normals, shade))
    return Character(skeleton(), tuple(parts), NAME, MORPHS, roles=roles())


def _lashes(head: HeadMesh) -> list[Piece]:
    made: list[Piece] = []
    for side in (1, -1):
        angle = np.where(head.angle < -1.5, head.angle + 2 * np.pi, head.angle)
        ids = np.nonzero((head.eye_ring == 0) & (head.side == side) & (angle > -0.05) & (angle < np.pi + 0.05))[0]
        ids = ids[np.argsort(angle[ids])]
        made.append(human_features.lashes(head.points[ids] * (side, 1, 1), ids, side))
    return made


def _lash_moves(head: HeadMesh, lashes: list[Piece], skin: Floats) -> Floats:
    """The lashes' offsets (M, V, 3): they go with the lids, and on a closing eye their ends lie down along the line."""
    made: list[Floats] = []
    for piece, name in zip(lashes, ("eyeBlinkLeft", "eyeBlinkRight"), strict=True):
        if piece.follows is None:
            continue
        rooted = skin[:, piece.follows].copy()
        ring = np.arange(len(piece.points) - 2) // human_features.LASH_AROUND
        u = np.append(ring / ring[-1], [0.0, 1.0])
        ends = np.maximum(smoothstep(0.36, 0.04, u), 0.8 * smoothstep(0.70, 1.0, u))
        rooted[MORPHS.index(name)] -= 0.85 * ends[:, None] * (piece.points - head.points[piece.follows])
        made.append(rooted)
    return np.concatenate(made, axis=1)
