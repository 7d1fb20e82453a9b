"""Reading USD: a stage as one character, its animations as clips."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from keypose.arrays import Floats
from keypose.errors import FormatError, ShapeError
from keypose.io.axes import checked_up, unit_in_metres
from keypose.io.guarded import Record
from keypose.io.notes import Notes
from keypose.io.usd import hierarchy
from keypose.io.usd import morphs as blend_shapes
from keypose.io.usd.animations import clips
from keypose.io.usd.hierarchy import Hierarchy
from keypose.io.usd.materials import materials
from keypose.io.usd.morphs import Morphs, morph_set
from keypose.io.usd.package import SUFFIXES, check_package, encoding
from keypose.io.usd.place import place_of_damage
from keypose.io.usd.process import records
from keypose.io.usd.skins import Binding, bind, moved
from keypose.io.usd.surfaces import Surface, surfaces
from keypose.model import Character, Material, Mesh, Part, Scene


def read(path: Path, *, unit: str | float | None = None, up: str | None = None) -> Scene:
    """A USD file of any kind (.usd, .usda, .usdc, .usdz) as one character with its clips; metres, Y up.

    ``unit`` (a name such as "cm", or metres per unit) and ``up`` ("X", "Y" or "Z") go over what the file says.

    Raises:
        FormatError: where the file is damaged, or too large for what it holds.
        UnknownName, ShapeError: for a unit or axis that is none.
        MissingExtra: where usd-core is not installed.
    """
    given = _Given(None if unit is None else unit_in_metres(unit), None if up is None else checked_up(up))
    for scene in _read_many([path], given):
        if isinstance(scene, FormatError):
            raise scene
        return scene
    raise FormatError("it cannot be read", path=path)


def read_many(paths: Iterable[str | PathLike[str]]) -> Iterator[Scene | FormatError]:
    """Several USD files, one after the other, with less effort than one by one; an error stands in a bad one's place.

    Raises:
        MissingExtra: where usd-core is not installed.
    """
    return _read_many(paths, _Given())


@dataclass(frozen=True, slots=True)
class _Given:
    """What goes over what the file says."""

    unit_m: float | None = None
    up: str | None = None


def _read_many(paths: Iterable[str | PathLike[str]], given: _Given) -> Iterator[Scene | FormatError]:
    files = [Path(path) for path in paths]
    refused: dict[int, FormatError] = {}
    for number, path in enumerate(files):
        try:
            kind = encoding(path)
            if path.suffix.lower() not in SUFFIXES[kind]:
                names = " or ".join(SUFFIXES[kind])
                raise FormatError(f"it is {kind}, which is read only under a name ending in {names}", where="name")
            if kind == "usdz":
                check_package(path)
        except FormatError as error:
            refused[number] = error.at(path)
    found = records([path for number, path in enumerate(files) if number not in refused])
    for number, path in enumerate(files):
        yield refused[number] if number in refused else _understood(path, next(found), given)


def _understood(path: Path, record: Record | FormatError, given: _Given) -> Scene | FormatError:
    if isinstance(record, FormatError):
        where, what = place_of_damage(path, record)
        return FormatError(what, where=where, path=path)
    try:
        return _scene(path, record, given)
    except FormatError as error:
        return error.at(path)
    except ShapeError as error:
        return FormatError(str(error), where="contents", path=path)
    except (KeyError, IndexError, TypeError, ValueError, OverflowError, np.linalg.LinAlgError) as error:
        # the process may have been led astray by the file and written nonsense
        return FormatError(f"it cannot be understood ({type(error).__name__})", where="contents", path=path)


def _scene(path: Path, record: Record, given: _Given) -> Scene:
    notes, facts = Notes(), record.facts
    for text in facts["notes"]:
        notes.add(str(text))
    unit_m = float(facts["unit_m"]) if given.unit_m is None else given.unit_m
    up = str(facts["up"]) if given.up is None else given.up
    if not (np.isfinite(unit_m) and 1e-6 < unit_m < 1e6):
        notes.add(f"its unit of {unit_m:g} m is impossible; taken as cm")
        unit_m = 0.01
    elif not facts["has_unit"] and given.unit_m is None:
        notes.add("unit: the file names none; USD then means centimetres")
    tree = hierarchy.build(record, notes, unit_m, up)
    morphs = blend_shapes.build(record, tree.same, notes)
    rest_weights = _rest_weights(record, morphs)
    parts = _Parts(path, record, tree, morphs, unit_m, notes).parts()
    animations = clips(record, tree, morphs, rest_weights, unit_m, path.stem, notes)
    for kind, count in facts["dropped"].items():
        notes.add(f"{count} {kind} prim{'s were' if count > 1 else ' was'} dropped")
    characters: tuple[Character, ...] = ()
    if tree.skeleton.joint_count:
        characters = (
            Character(
                tree.skeleton,
                tuple(parts),
                name=str(facts["default"] or path.stem),
                morph_names=tuple(morphs.names),
                rest_morph_weights=rest_weights.astype(np.float32),
                roles=tree.roles,
            ),
        )
    else:
        notes.add("the file holds nothing that has a place")
    about = {
        "encoding": encoding(path),
        "layers": int(facts["layers"]),
        "time_codes_per_second": float(facts["codes_per_s"]),
        "start_time_code": float(facts["start"]),
        "end_time_code": float(facts["end"]),
    }
    return Scene(
        characters,
        tuple(animations),
        format="usd",
        unit_m=unit_m,
        up=up,
        notes=notes.texts(),
        extras={"usd": about},
    )


def _rest_weights(record: Record, morphs: Morphs) -> Floats:
    """Weights at rest, which only keypose writes."""
    rest = np.zeros(len(morphs.names))
    for skeleton in record.facts["skeletons"]:
        own = record.facts["prims"][int(skeleton["prim"])]["own"] or {}
        names, weights = own.get("morphs"), own.get("rest_weights")
        if isinstance(names, list) and isinstance(weights, list) and len(names) == len(weights):
            for name, weight in zip(names, weights, strict=True):
                if name in morphs.names and isinstance(weight, (int, float)) and abs(weight) < 1e15:
                    rest[morphs.names.index(name)] = weight
    return rest


class _Parts:
    """The parts of a character, from the meshes of the file."""

    def __init__(
        self, path: Path, record: Record, tree: Hierarchy, morphs: Morphs, unit_m: float, notes: Notes
    ) -> None:
        self._record, self._tree, self._morphs, self._unit_m, self._notes = record, tree, morphs, unit_m, notes
        self._materials = materials(path, record, notes)

    def parts(self) -> list[Part]:
        """All parts in the order of the file's meshes."""
        found = [
            part for number, item in enumerate(self._record.facts["meshes"]) for part in self._of_mesh(number, item)
        ]
        order = [_own_place(item) for item in self._record.facts["meshes"]]
        if len(found) == len(order) and None not in order:  # as keypose has numbered them
            found = [part for _, part in sorted(zip(order, found, strict=True), key=lambda pair: pair[0] or 0)]
        return found

    def _of_mesh(self, number: int, item: Mapping[str, Any]) -> list[Part]:
        where = f"mesh '{item['name']}'"
        prim = int(item["prim"])
        binding = (
            None if item["skin"] is None else bind(self._record, item, self._tree, self._unit_m, where, self._notes)
        )
        joint = self._tree.joint_above.get(prim, -1) if binding is None else binding.joint
        if binding is None and joint == -1:
            self._notes.add(f"{where}: there is no joint that could carry it; it was left out")
            return []
        geometry = np.eye(4) if binding is None else binding.geometry
        named = {
            self._materials[m].uvs for m in (item["material"], *(s["material"] for s in item["subsets"])) if m >= 0
        }
        found = surfaces(self._record, item, next((n for n in named if n), "st"), self._unit_m, self._notes)
        own = item["own"] or {}
        group = own.get("group")
        return [
            self._part(number, item, surface, binding, joint, geometry, group if isinstance(group, int) else number)
            for surface in found
        ]

    def _part(
        self,
        number: int,
        item: Mapping[str, Any],
        surface: Surface,
        binding: Binding | None,
        joint: int | None,
        geometry: Floats,
        group: int,
    ) -> Part:
        where = f"mesh '{item['name']}'"
        linear = geometry[:3, :3] * self._unit_m
        channels = self._morphs.of_mesh.get(number, [])
        points = surface.control_points
        targets = morph_set(self._record, item, channels, self._morphs.names, points, linear, where)
        skinned = binding is not None and binding.joint is None
        return Part(
            name=surface.name,
            mesh=_placed(surface.mesh, geometry),
            material=self._material(item, surface),
            skin=binding.of(points) if binding is not None and skinned else None,
            joint=None if skinned else joint,
            morphs=None if targets is None else targets[0],
            morph_channels=None if targets is None else targets[1],
            group=group,
        )

    def _material(self, item: Mapping[str, Any], surface: Surface) -> Material:
        plain: dict[str, Any] = {"double_sided": bool(item["double_sided"])}
        if surface.material >= 0:
            found = self._materials[surface.material].material
            return Material(**{**{n: getattr(found, n) for n in Material.__dataclass_fields__}, **plain})
        if surface.color is not None:
            plain |= {"base_color": surface.color, "alpha_mode": "BLEND" if surface.color[3] < 1 else "OPAQUE"}
        return Material(**plain)


def _own_place(item: Mapping[str, Any]) -> int | None:
    place = (item["own"] or {}).get("place")
    return place if isinstance(place, int) else None


def _placed(mesh: Mesh, geometry: Floats) -> Mesh:
    """A mesh after the matrix that is applied to it before its joints."""
    if np.array_equal(geometry, np.eye(4)):
        return mesh
    positions = moved(geometry, mesh.positions).astype(np.float32)
    inverse = hierarchy.inverted(geometry[:3, :3])
    triangles = mesh.triangles[:, ::-1] if np.linalg.det(geometry[:3, :3]) < 0 else mesh.triangles
    normals = mesh.normals
    if normals is not None and inverse is not None:
        turned = np.asarray(normals, np.float64) @ inverse
        normals = (turned / np.maximum(np.linalg.norm(turned, axis=1, keepdims=True), 1e-300)).astype(np.float32)
    return Mesh(positions, triangles, normals, mesh.uvs, mesh.colors, mesh.attributes)
