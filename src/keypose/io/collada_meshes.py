"""COLLADA's geometries: polygons with an index for each input become triangles with one.

Source: COLLADA 1.4.1 specification, chapter 5 (mesh, triangles, polylist, polygons, trifans, tristrips, vertices).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from keypose.arrays import Floats, Ints
from keypose.io.collada_xml import Document, Element, counted
from keypose.io.text import shown
from keypose.model import Mesh

_PRIMITIVES = ("triangles", "polylist", "polygons", "trifans", "tristrips")
_MOST_CORNERS = 50_000_000


@dataclass(slots=True, eq=False)
class Surface:
    """One primitive of a geometry: ``points`` (V,) is the point of the geometry that each vertex stands on."""

    mesh: Mesh
    points: Ints
    material: str


@dataclass(slots=True, eq=False)
class Geometry:
    """A geometry's primitives; ``positions`` (P, 3) are its points in metres."""

    name: str
    positions: Floats
    surfaces: list[Surface] = field(default_factory=list[Surface])


@dataclass(slots=True)
class _Input:
    semantic: str
    source: Element
    offset: int
    number: int


def read_geometry(document: Document, element: Element, unit_m: float) -> Geometry | None:
    """A geometry with its polygons cut into triangles; None where it is no mesh."""
    mesh = element.first("mesh") or element.first("convex_mesh")
    if mesh is None:
        document.note(f"geometry {shown(element.named())} is no mesh and was dropped")
        return None
    positions = _positions(document, mesh, unit_m)
    geometry = Geometry(element.named() or "mesh", positions)
    for primitive in mesh.children:
        if primitive.tag in ("lines", "linestrips"):
            document.note(f"lines of geometry {shown(element.named())} were dropped")
        elif primitive.tag in _PRIMITIVES:
            surface = _surface(document, primitive, positions)
            if surface is not None:
                geometry.surfaces.append(surface)
    return geometry


def _positions(document: Document, mesh: Element, unit_m: float) -> Floats:
    vertices = mesh.first("vertices")
    if vertices is None:
        raise mesh.error("it has no <vertices>")
    source = document.inputs(vertices).get("POSITION")
    if source is None:
        raise vertices.error("it has no POSITION")
    return document.table(source, 3)[:, :3] * unit_m


def _inputs(document: Document, primitive: Element) -> tuple[list[_Input], int]:
    """The inputs, those of <vertices> in place of VERTEX, and the number of indices per corner."""
    found: list[_Input] = []
    width = 0
    for element in primitive.all("input"):
        offset, number = counted(element, "offset", 0), counted(element, "set", 0)
        if offset > 64:
            raise element.error(f"offset {offset} makes no sense")
        width = max(width, offset + 1)
        target = document.target(element, "source")
        if element.get("semantic") == "VERTEX":
            found.append(_Input("VERTEX", target, offset, number))
            found += [
                _Input(semantic, source, offset, 0)
                for semantic, source in document.inputs(target).items()
                if semantic != "POSITION"
            ]
        else:
            found.append(_Input(element.get("semantic"), target, offset, number))
    return found, width


def _surface(document: Document, primitive: Element, positions: Floats) -> Surface | None:
    inputs, width = _inputs(document, primitive)
    corners = next((i.offset for i in inputs if i.semantic == "VERTEX"), None)
    if corners is None:
        if primitive.first("p") is not None:
            raise primitive.error("it has no VERTEX input")
        return None
    indices, sizes = _polygons(document, primitive, width)
    if not len(sizes):
        return None
    if len(indices) > _MOST_CORNERS:
        raise primitive.error(f"{len(indices)} corners; at most {_MOST_CORNERS} are read")
    used = [i for i in inputs if i.semantic in ("VERTEX", "NORMAL", "TEXCOORD", "COLOR")]
    # the points lead, so that vertices come in their order
    offsets = [corners, *sorted({i.offset for i in used} - {corners})]
    keys = indices[:, offsets]
    if keys.size and keys.min() < 0:
        raise primitive.error("a negative index")
    limits = dict.fromkeys(offsets, 1 << 40)
    for item in used:
        limits[item.offset] = min(
            limits[item.offset],
            len(positions) if item.semantic == "VERTEX" else len(document.table(item.source)),
        )
    for column, offset in enumerate(offsets):
        top = int(keys[:, column].max(initial=-1))
        if top >= limits[offset]:
            raise primitive.error(f"index {top} is beyond the {limits[offset]} items of its source")
    if len(offsets) == 1 and limits[corners] == len(positions):
        vertices, of_corner = np.arange(len(positions))[:, None], keys[:, 0]  # one index for all: nothing is split
    else:
        vertices, of_corner = _unique_rows(keys)
    where = {offset: vertices[:, column] for column, offset in enumerate(offsets)}
    points = where[corners]
    normals = uvs = colors = None
    attributes: dict[str, Floats] = {}
    sets = sorted(i.number for i in used if i.semantic == "TEXCOORD")
    for item in used:
        if item.semantic == "VERTEX":
            continue
        table = document.table(item.source)[where[item.offset]]
        if item.semantic == "NORMAL" and normals is None and table.shape[1] >= 3:
            normals = _unit_normals(table[:, :3])
        elif item.semantic == "TEXCOORD" and table.shape[1] >= 2:
            coordinates = np.stack([table[:, 0], 1 - table[:, 1]], axis=1)  # the origin moves to the top
            if uvs is None and item.number == sets[0]:
                uvs = coordinates
            else:
                attributes.setdefault(f"TEXCOORD_{max(sets.index(item.number), 1)}", coordinates)
        elif item.semantic == "COLOR" and colors is None and table.shape[1] >= 3:
            alpha = table[:, 3:4] if table.shape[1] > 3 else np.ones((len(table), 1))
            colors = np.concatenate([table[:, :3], alpha], axis=1)
    triangles = of_corner[_fans(sizes)] if primitive.tag != "tristrips" else of_corner[_strips(sizes)]
    distinct = (
        (triangles[:, 0] != triangles[:, 1])
        & (triangles[:, 1] != triangles[:, 2])
        & (triangles[:, 2] != triangles[:, 0])
    )
    if normals is not None and not np.any(normals):
        normals = None
    mesh = Mesh(positions[points], triangles[distinct], normals, uvs, colors, attributes)
    return Surface(mesh, points, primitive.get("material"))


def _polygons(document: Document, primitive: Element, width: int) -> tuple[Ints, Ints]:
    """The indices (C, width) of all corners, and the number of corners of each polygon, fan or strip."""
    lists: list[Ints] = []
    if primitive.tag == "polygons" and primitive.first("ph") is not None:
        document.note("holes in polygons were filled")
    for element in primitive.children:
        holder = element.first("p") if element.tag == "ph" else element if element.tag == "p" else None
        if holder is not None:
            lists.append(holder.integers())
            if len(lists[-1]) % width:
                raise holder.error(f"{len(lists[-1])} indices are no multiple of {width}")
    corners = np.concatenate(lists).reshape(-1, width) if lists else np.zeros((0, width), np.int64)
    if primitive.tag == "polylist":
        element = primitive.first("vcount")
        sizes = element.integers() if element is not None else np.zeros(0, np.int64)
        if sizes.size and sizes.min() < 0:
            raise primitive.error("vcount: a negative number")
    elif primitive.tag == "triangles":
        if len(corners) % 3:
            raise primitive.error(f"{len(corners)} corners are no multiple of 3")
        sizes = np.full(len(corners) // 3, 3, np.int64)
    else:
        sizes = np.array([len(values) // width for values in lists], np.int64)
    if int(sizes.sum()) != len(corners):
        raise primitive.error(f"its polygons have {int(sizes.sum())} corners, <p> has {len(corners)}")
    return corners, sizes


def _fans(sizes: Ints) -> Ints:
    """Corners (F, 3) of the triangles that polygons of these sizes are cut into, from their first corner."""
    counts = np.maximum(sizes - 2, 0)
    first = np.repeat(np.cumsum(sizes) - sizes, counts)
    step = np.arange(int(counts.sum())) - np.repeat(np.cumsum(counts) - counts, counts)
    return np.stack([first, first + step + 1, first + step + 2], axis=1)


def _strips(sizes: Ints) -> Ints:
    """Corners (F, 3) of the triangles of strips; every other one is turned."""
    counts = np.maximum(sizes - 2, 0)
    first = np.repeat(np.cumsum(sizes) - sizes, counts)
    step = np.arange(int(counts.sum())) - np.repeat(np.cumsum(counts) - counts, counts)
    odd = step % 2
    return np.stack([first + step, first + step + 1 + odd, first + step + 2 - odd], axis=1)


def _unique_rows(keys: Ints) -> tuple[Ints, Ints]:
    """The different rows, sorted, and the place of each row among them."""
    packed = np.zeros(len(keys), np.int64)
    for column in range(keys.shape[1]):
        span = int(keys[:, column].max(initial=0)) + 1
        if int(packed.max(initial=0)) >= (1 << 62) // span:
            unique, inverse = np.unique(keys, axis=0, return_inverse=True)
            return unique, inverse.reshape(-1)
        packed = packed * span + keys[:, column]
    _, first, inverse = np.unique(packed, return_index=True, return_inverse=True)
    return keys[first], inverse.reshape(-1)


def _unit_normals(normals: Floats) -> Floats:
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.divide(normals, length, out=np.tile((0.0, 1.0, 0.0), (len(normals), 1)), where=length > 1e-12)
