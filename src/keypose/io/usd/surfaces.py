"""UsdGeom meshes as parts of a character: polygons cut, corners joined to vertices, faces sorted by their material."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from keypose.arrays import Ints
from keypose.errors import FormatError
from keypose.io.guarded import Record, sane
from keypose.io.normals import smooth_normals
from keypose.io.notes import Notes
from keypose.io.polygons import distinct, triangulate
from keypose.model import Mesh

_UV_NAMES = ("st", "st0", "UVMap", "uv", "map1")
_WIDEST = 4  # of what is kept as an attribute


@dataclass(frozen=True, slots=True)
class Surface:
    """The faces of a mesh that have one material: triangles, and the point of each vertex."""

    name: str
    material: int  # number in the file, -1 for none
    mesh: Mesh
    control_points: Ints
    color: tuple[float, float, float, float] | None  # of the whole mesh


@dataclass(frozen=True, slots=True)
class _Column:
    """What varies from vertex to vertex, by its name in a mesh; ``rows`` are of points, or of corners."""

    name: str
    by_corner: bool
    values: NDArray[np.float32]


def surfaces(record: Record, item: Mapping[str, Any], uvs: str, unit_m: float, notes: Notes) -> list[Surface]:
    """The parts of a mesh; ``uvs`` is the name of the texture coordinates that its picture wants."""
    return _Reader(record, item, uvs, unit_m, notes).surfaces()


class _Reader:
    def __init__(self, record: Record, item: Mapping[str, Any], uvs: str, unit_m: float, notes: Notes) -> None:
        self._record, self._item, self._uvs, self._notes = record, item, uvs, notes
        self._where = f"mesh '{item['name']}'"
        self._positions = self._array("positions", 3) * unit_m
        if not sane(self._positions):
            raise FormatError("a vertex position is impossible", where=self._where)
        self._corners, self._faces = self._polygons()

    def _array(self, name: str, width: int = 1) -> Any:
        reference = self._item[name]
        if reference is None:
            return np.zeros((0, width)) if width > 1 else np.zeros(0, np.int64)
        return self._record.floats(reference, width) if width > 1 else self._record.integers(reference, self._where)

    def _polygons(self) -> tuple[Ints, Ints]:
        """The point of each corner, and the first corner and number of corners of each face."""
        counts, corners = self._array("counts"), self._array("corners")
        if (len(counts) and counts.min() < 0) or int(counts.sum()) != len(corners):
            raise FormatError(
                f"its faces have {int(counts.sum())} corners, {len(corners)} are there", where=self._where
            )
        if len(corners) and (corners.min() < 0 or corners.max() >= len(self._positions)):
            bad = corners.max() if corners.max() >= len(self._positions) else corners.min()
            raise FormatError(f"vertex {bad} does not exist; there are {len(self._positions)}", where=self._where)
        return corners, np.stack([np.cumsum(counts) - counts, counts], axis=1)

    def surfaces(self) -> list[Surface]:
        """One for each material."""
        triangles, face_of = triangulate(self._positions, self._corners, self._faces, self._where)
        kept = ~np.isin(face_of, self._array("holes"))
        triangles, face_of = triangles[kept], face_of[kept]
        if not len(triangles):
            self._notes.add(f"{self._where}: it has no faces and was left out")
            return []
        if self._item["left_handed"]:
            triangles = triangles[:, ::-1]
        color, columns = self._columns()
        if self._item["subdivision"]:
            self._notes.add(f"{self._where}: it is meant as a subdivision surface; its cage was read")
            if not any(c.name == "normals" for c in columns):
                points = smooth_normals(self._positions, self._corners[triangles])
                columns.append(_Column("normals", False, points.astype(np.float32)))
        subset_of = np.full(len(self._faces), -1)
        for number, subset in enumerate(self._item["subsets"]):
            faces = self._record.integers(subset["faces"], self._where)
            faces = faces[(faces >= 0) & (faces < len(subset_of))]
            subset_of[faces] = number
        found: list[Surface] = []
        for number in np.unique(subset_of[face_of]).tolist():
            subset = self._item["subsets"][number] if number >= 0 else None
            material = int(self._item["material"]) if subset is None or subset["material"] < 0 else subset["material"]
            mine = triangles[subset_of[face_of] == number]
            mesh, control_points = self._mesh(mine, columns, whole=len(mine) == len(triangles))
            found.append(Surface(self._name(subset), material, mesh, control_points, color))
        return found

    def _name(self, subset: Mapping[str, Any] | None) -> str:
        name = str(self._item["name"])
        return name if subset is None else f"{name}_{subset['name']}"

    # --- what varies over the surface ---------------------------------------------------------------------------------

    def _columns(self) -> tuple[tuple[float, float, float, float] | None, list[_Column]]:
        columns, plain = list[_Column](), dict[str, Any]()
        names = self._uv_names()
        for item in self._item["primvars"]:
            name, width = str(item["name"]), int(item["width"])
            values = self._record.array(item["values"], width)
            if values.dtype.kind != "f" or width > _WIDEST:
                continue
            with np.errstate(over="ignore", invalid="ignore"):
                values = values.astype(np.float32)
            if not np.all(np.isfinite(values)):
                self._notes.add(f"{self._where}: its {name} hold numbers that are not finite and were dropped")
                continue
            if len(values) == 1 and item["interpolation"] == "constant":
                plain[name] = values[0]
                continue
            spread = self._spread(name, str(item["interpolation"]), values)
            if spread is not None:
                known = {"normals": "normals", "displayColor": "displayColor", "displayOpacity": "displayOpacity"}
                columns.append(_Column(names.get(name, known.get(name, name)), *spread))
        return self._plain_color(plain), self._colored(columns, plain)

    def _uv_names(self) -> dict[str, str]:
        """What each set of texture coordinates is called here; the first is the one that the material wants."""
        found = [
            str(i["name"]) for i in self._item["primvars"] if i["width"] == 2 and (i["is_uv"] or i["name"] in _UV_NAMES)
        ]
        order = [self._uvs, *_UV_NAMES]
        found.sort(key=lambda name: (order.index(name) if name in order else len(order), name))
        return {name: "uvs" if place == 0 else f"TEXCOORD_{place}" for place, name in enumerate(found)}

    def _spread(self, name: str, interpolation: str, values: NDArray[np.float32]) -> tuple[bool, Any] | None:
        """Values of points or of corners."""
        sizes = {"vertex": len(self._positions), "varying": len(self._positions), "faceVarying": len(self._corners)}
        sizes |= {"uniform": len(self._faces)}
        size = sizes.get(interpolation, 1)
        if interpolation == "constant" or len(values) != size:
            self._notes.add(f"{self._where}: its {name} do not fit its {interpolation} and were dropped")
            return None
        if interpolation == "uniform":
            return True, np.repeat(values, self._faces[:, 1], axis=0)
        return interpolation == "faceVarying", values

    def _plain_color(self, plain: Mapping[str, Any]) -> tuple[float, float, float, float] | None:
        color = plain.get("displayColor")
        if color is None or len(color) != 3:
            return None
        opacity = plain.get("displayOpacity", np.ones(1))
        red, green, blue, alpha = (min(max(float(v), 0.0), 1.0) for v in (*color, opacity[0]))
        return red, green, blue, alpha

    def _colored(self, columns: Sequence[_Column], plain: Mapping[str, Any]) -> list[_Column]:
        """The columns with colour and opacity in one."""
        by_name = {column.name: column for column in columns}
        color, opacity = by_name.pop("displayColor", None), by_name.pop("displayOpacity", None)
        if color is not None and color.values.shape[1] == 3:
            if opacity is not None and (opacity.by_corner != color.by_corner or opacity.values.shape[1] != 1):
                self._notes.add(f"{self._where}: its displayOpacity varies otherwise than its colours and was dropped")
                opacity = None
            alpha = opacity.values if opacity is not None else np.ones((len(color.values), 1), np.float32)
            if opacity is None and len(plain.get("displayOpacity", ())) == 1:
                alpha = alpha * plain["displayOpacity"]
            by_name["colors"] = _Column("colors", color.by_corner, np.concatenate([color.values, alpha], axis=1))
        for name, width in (("normals", 3), ("uvs", 2)):
            if name in by_name and by_name[name].values.shape[1] != width:
                self._notes.add(f"{self._where}: its {name} have {by_name.pop(name).values.shape[1]} components")
        return list(by_name.values())

    # --- vertices -----------------------------------------------------------------------------------------------------

    def _mesh(self, triangles: Ints, columns: Sequence[_Column], *, whole: bool) -> tuple[Mesh, Ints]:
        corner_columns = [c for c in columns if c.by_corner]
        if corner_columns:
            used = np.unique(triangles)
            rows = [self._corners[used].astype(np.uint32)[:, None]]
            rows += [np.ascontiguousarray(c.values[used] + np.float32(0)).view(np.uint32) for c in corner_columns]
            first, inverse = distinct(np.concatenate(rows, axis=1))
            order = np.lexsort((first, self._corners[used[first]]))  # as the points are, so that they keep their order
            rank = np.empty(len(order), np.int64)
            rank[order] = np.arange(len(order))
            vertex_of_corner = np.zeros(int(used.max()) + 1, np.int64)
            vertex_of_corner[used] = rank[inverse]
            corner = used[first[order]]
            control_points, indices = self._corners[corner], vertex_of_corner[triangles]
        else:
            corner = np.zeros(0, np.int64)
            indices = self._corners[triangles]
            control_points = np.arange(len(self._positions)) if whole else np.unique(indices)
            if not whole:
                indices = np.searchsorted(control_points, indices)
        found = {c.name: c.values[corner if c.by_corner else control_points] for c in columns}
        positions = self._positions[control_points].astype(np.float32)
        normals = found.pop("normals", None)
        if normals is not None:
            normals = _unit(normals, positions, indices)
        for name in found:
            if name == "uvs" or name.startswith("TEXCOORD_"):
                found[name] = np.stack(
                    [found[name][:, 0], 1 - found[name][:, 1]], axis=1
                )  # the origin is at the top here
        mesh = Mesh(positions, indices, normals, found.pop("uvs", None), found.pop("colors", None), found)
        return mesh, control_points


def _unit(normals: NDArray[np.float32], points: NDArray[np.float32], triangles: Ints) -> NDArray[np.float32]:
    lengths = np.linalg.norm(normals.astype(np.float64), axis=1)
    known = lengths > 1e-12
    off = known & (np.abs(lengths - 1) > 1e-6)
    result = np.where(off[:, None], normals / np.where(off, lengths, 1.0)[:, None], normals).astype(np.float32)
    if not np.all(known):
        result[~known] = smooth_normals(points, triangles)[~known]
    return result
