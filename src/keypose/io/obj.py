"""OBJ files: static meshes, and sets of them with the same faces as morph targets.

An OBJ file has no joints: its meshes hang on one. It names neither unit nor axes; both are options, and the guess of
the unit is noted.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

import numpy as np

from keypose.arrays import Floats, Ints
from keypose.errors import FormatError, ShapeError
from keypose.io.axes import checked_up, guess_mesh_unit, unit_in_metres, y_up_rotation
from keypose.io.normals import smooth_normals
from keypose.io.notes import Notes, UniqueNames
from keypose.io.obj_materials import read_materials
from keypose.io.obj_pieces import Piece, picked, piece, sparse_targets
from keypose.io.obj_polygons import triangulate
from keypose.io.obj_text import ObjText, read_text
from keypose.io.obj_writer import UNIT_COMMENT
from keypose.io.obj_writer import write as write
from keypose.math import quat
from keypose.model import Character, Material, Mesh, Part, Pose, Scene, Skeleton

__all__ = ["read", "write"]

_HEAD_BYTES = 4096
_MOST_PARTS = 10_000
_MAKEHUMAN_JOINTS = re.compile(r"joint-[a-z]")
Targets = str | PathLike[str] | Sequence[str | PathLike[str]]


def read(path: Path, *, unit: str | float | None = None, up: str = "Y", targets: Targets | None = None) -> Scene:
    """Read an OBJ file as one character of one joint.

    Every combination of object, group and material is a `Part`. Polygons are cut into triangles; vertices are split
    where faces give them several texture coordinates or normals. A file without normals gets smooth ones, unless it
    switches smoothing off.

    Shapes and units: ``unit`` is a name ("cm") or metres per file unit; ``up`` is "X", "Y" or "Z". ``targets`` are
    OBJ files with the same faces, or a folder of them (those with other faces are passed over): each becomes a morph
    target named after its file.

    Raises:
        FormatError: at the first line that does not follow the format, or where a target has other faces.
        UnknownName: for a unit or an axis that does not exist.
    """
    given_unit = None if unit is None else unit_in_metres(unit)
    up = checked_up(up)
    notes = Notes()
    text = read_text(path, notes)
    if not len(text.positions):
        raise FormatError("no vertices", where="end of file")
    unit_m = _unit(path, text, notes) if given_unit is None else given_unit
    reader = _Reader(path, text, unit_m, up, notes)
    shapes = [] if targets is None else _targets(path, targets, text, notes)
    return reader.scene(shapes)


def _unit(path: Path, text: ObjText, notes: Notes) -> float:
    with path.open("rb") as file:
        said = UNIT_COMMENT.search(file.read(_HEAD_BYTES))
    if said:
        try:
            return unit_in_metres(float(said[1]))
        except (ValueError, ShapeError):
            notes.add("the file's own remark about its unit makes no sense and was passed over")
    if any(_MAKEHUMAN_JOINTS.match(group.group) for group in text.groups):
        notes.add("unit: the file names none; taken as dm, for its groups are those of a MakeHuman mesh")
        return 0.1
    unit_m, note = guess_mesh_unit(float(np.ptp(text.positions, axis=0).max()))
    notes.add(note)
    return unit_m


@dataclass(frozen=True, slots=True)
class _Shape:
    name: str
    positions: Floats


def _targets(path: Path, targets: Targets, base: ObjText, notes: Notes) -> list[_Shape]:
    listed = [targets] if isinstance(targets, (str, PathLike)) else list(targets)
    shapes: list[_Shape] = []
    names = UniqueNames()
    for item in map(Path, listed):
        is_folder = item.is_dir()
        files = sorted(item.glob("*.[oO][bB][jJ]")) if is_folder else [item]
        for file in files:
            if file.is_file() and file.resolve() == path.resolve():
                continue
            if not file.is_file():
                raise FormatError("no such file", path=file)
            try:
                other = read_text(file, Notes())
            except FormatError as error:
                raise error.at(file) from None
            difference = _difference(base, other)
            if difference and not is_folder:
                raise FormatError(f"is no target of {path.name}: {difference}", path=file)
            if difference:
                notes.add(f"{file.name} is no target: {difference}")
                continue
            shapes.append(_Shape(names.add(file.stem), other.positions))
    return shapes


def _difference(base: ObjText, other: ObjText) -> str:
    for what, a, b in (
        ("vertices", len(base.positions), len(other.positions)),
        ("faces", len(base.sizes), len(other.sizes)),
    ):
        if a != b:
            return f"it has {b} {what}, not {a}"
    if not np.array_equal(base.sizes, other.sizes):
        return f"face {int(np.nonzero(base.sizes != other.sizes)[0][0]) + 1} has another number of corners"
    wrong = np.nonzero(base.corners[:, 0] != other.corners[:, 0])[0]
    if len(wrong):
        face = int(np.searchsorted(np.cumsum(base.sizes), wrong[0], side="right"))
        return f"face {face + 1} has other vertices"
    return ""


class _Reader:
    """Gives the arrays their meaning."""

    def __init__(self, path: Path, text: ObjText, unit_m: float, up: str, notes: Notes) -> None:
        self.path, self.text, self.unit_m, self.up, self.notes = path, text, unit_m, up, notes
        self.positions = self.turned(text.positions * unit_m)
        self.triangles, self.faces = triangulate(text.positions, text.corners[:, 0], text.sizes)
        self.vertices = text.corners[self.triangles, 0] if len(self.triangles) else np.zeros((0, 3), np.int64)
        self.smooth = None if len(text.normals) else smooth_normals(self.positions, self.vertices)

    def turned(self, rows: Floats) -> Floats:
        return rows if self.up == "Y" else np.asarray(quat.rotate(y_up_rotation(self.up), rows))

    def scene(self, shapes: Sequence[_Shape]) -> Scene:
        text = self.text
        self.note_faces()
        materials = read_materials(self.path, text.libraries, self.notes)
        moved: list[tuple[Ints, Floats]] = []
        turns: list[Floats] = []
        for shape in shapes:
            positions = self.turned(shape.positions * self.unit_m)
            index = np.nonzero(np.any(shape.positions != text.positions, axis=1))[0]
            moved.append((index, positions[index] - self.positions[index]))
            if self.smooth is not None:
                turns.append(smooth_normals(positions, self.vertices) - self.smooth)
        names = [shape.name for shape in shapes]
        parts = self.parts(materials, names, moved, turns if self.smooth is not None else None)
        identity = np.zeros((1, 3)), np.array([[1.0, 0.0, 0.0, 0.0]]), np.ones((1, 3))
        skeleton = Skeleton((self.path.stem,), np.array([-1]), Pose(*identity))
        extras = {"obj": {"vertices": len(text.positions), "faces": len(text.sizes)}}
        character = Character(skeleton, tuple(parts), self.path.stem, tuple(names), extras=extras)
        return Scene((character,), (), "obj", self.unit_m, self.up, self.notes.texts())

    def note_faces(self) -> None:
        text, notes = self.text, self.notes
        larger = int(np.count_nonzero(text.sizes > 3))
        if larger:
            notes.add(f"{larger} of {len(text.sizes)} faces have more than three corners and were cut into triangles")
        few = int(np.count_nonzero(text.sizes < 3))
        if few:
            notes.add(f"{few} faces with fewer than three corners were dropped")
        unused = len(text.positions) - len(np.unique(self.vertices))
        if unused and len(self.triangles):
            notes.add(f"{unused} of {len(text.positions)} vertices are in no face and were dropped")
        if not len(self.triangles):
            notes.add("the file has no faces; its vertices are a mesh without triangles")
        if self.smooth is not None and any(not group.flat for group in text.groups):
            notes.add("normals: the file has none; smooth ones were computed")

    def parts(
        self,
        materials: dict[str, Material],
        names: list[str],
        moved: list[tuple[Ints, Floats]],
        turns: list[Floats] | None,
    ) -> list[Part]:
        text = self.text
        if not len(self.triangles):
            every = np.arange(len(text.positions))
            none = np.full(len(every), -1)
            whole = Piece(every, none, none, np.zeros((0, 3), np.int64))
            return [self.part("", whole, Material(), names, moved, None, True, {})]
        parts: list[Part] = []
        unique = UniqueNames()
        of_triangle = text.face_groups[self.faces]
        order = np.argsort(of_triangle, kind="stable")
        ends = np.searchsorted(of_triangle[order], np.arange(len(text.groups) + 1))
        used = int(np.count_nonzero(np.diff(ends)))
        if used > _MOST_PARTS:
            raise FormatError(f"{used} combinations of object, group and material; at most {_MOST_PARTS} are read")
        for number, group in enumerate(text.groups):
            mine = self.triangles[order[ends[number] : ends[number + 1]]]
            if not len(mine):
                continue
            pieces = [p for p in (group.object, group.group, group.material) if p]
            name = unique.add(" ".join(pieces) if len(text.groups) > 1 else (pieces or [""])[0])
            material = materials.get(group.material, Material(name=group.material))
            kept = {k: v for k, v in (("object", group.object), ("group", group.group)) if v}
            parts.append(
                self.part(name, piece(text.corners, mine), material, names, moved, turns, group.flat, {"obj": kept})
            )
        return parts

    def part(
        self,
        name: str,
        found: Piece,
        material: Material,
        names: list[str],
        moved: list[tuple[Ints, Floats]],
        turns: list[Floats] | None,
        flat: bool,
        extras: dict[str, object],
    ) -> Part:
        text = self.text
        normals = picked(text.normals, found.normals)
        if normals is not None:
            length = np.linalg.norm(normals, axis=1, keepdims=True)
            if np.any(length < 1e-12):
                self.notes.add("normals of no length or missing were replaced by +Y")
            normals = np.where(length < 1e-12, (0.0, 1.0, 0.0), normals / np.maximum(length, 1e-12))
            normals = self.turned(normals)
        elif self.smooth is not None and not flat:
            normals = self.smooth[found.positions]
        uvs = picked(text.uvs, found.uvs)
        colors = None
        if text.colors is not None:
            srgb = np.clip(np.nan_to_num(text.colors[found.positions], nan=1.0), 0.0, 1.0)
            linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
            colors = np.concatenate([linear, np.ones((len(linear), 1))], axis=1).astype(np.float32)
        mesh = Mesh(
            self.positions[found.positions].astype(np.float32),
            found.triangles,
            None if normals is None else normals.astype(np.float32),
            None if uvs is None else np.stack([uvs[:, 0], 1.0 - uvs[:, 1]], axis=1).astype(np.float32),
            colors,
        )
        smooth = turns if normals is not None and not len(text.normals) else None
        morphs = sparse_targets(names, moved, found.positions, smooth) if names else None
        return Part(name=name or self.path.stem, mesh=mesh, material=material, joint=0, morphs=morphs, extras=extras)
