"""Reading FBX of any version through ufbx: what it found as one character and its clips."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from keypose.errors import FormatError, ShapeError
from keypose.io.fbx import hierarchy
from keypose.io.fbx.animations import clips
from keypose.io.fbx.hierarchy import Hierarchy, affine
from keypose.io.fbx.materials import materials
from keypose.io.fbx.morphs import Morphs, morph_set
from keypose.io.fbx.morphs import build as build_morphs
from keypose.io.fbx.place import place_of_damage
from keypose.io.fbx.process import records
from keypose.io.fbx.surfaces import DQ_ATTRIBUTE, Binding, Surface, Surfaces, bind
from keypose.io.guarded import Record
from keypose.io.notes import Notes
from keypose.math import rigid
from keypose.model import Character, Material, Mesh, Part, Scene

_DROPPED = {
    "constraints": "constraints were dropped; what they do is only kept where it has keys",
    "line_curves": "line curves were dropped",
    "nurbs_curves": "NURBS curves were dropped",
    "nurbs_surfaces": "NURBS surfaces were dropped",
    "lod_groups": "groups of levels of detail are plain nodes here; all levels are shown",
}


def read(path: Path) -> Scene:
    """An FBX file, binary or ASCII, as one character and its animation stacks as clips; metres, Y up, facing +Z.

    Every node is a joint. Stacks are baked, with all their layers, at the frame rate of the file.

    Raises:
        FormatError: where the file is damaged, or too large for what it holds.
        MissingExtra: where ufbx is not installed.
    """
    for scene in read_many([path]):
        if isinstance(scene, FormatError):
            raise scene
        return scene
    raise FormatError("it cannot be read", path=path)


def read_many(paths: Iterable[str | PathLike[str]]) -> Iterator[Scene | FormatError]:
    """Several FBX files, one after the other, with less effort than one by one; an error stands in a bad one's place."""
    files = [Path(path) for path in paths]
    for path, record in zip(files, records(files), strict=True):
        if isinstance(record, FormatError):
            yield FormatError(record.what, where=record.where or place_of_damage(path), path=path)
            continue
        try:
            yield _scene(path, record)
        except FormatError as error:
            yield error.at(path)
        except ShapeError as error:
            yield FormatError(str(error), path=path)
        except (KeyError, IndexError, TypeError, ValueError, OverflowError) as error:
            # the process may have been led astray by the file and written nonsense
            yield FormatError(
                f"it cannot be understood ({type(error).__name__})", where=place_of_damage(path), path=path
            )


def _scene(path: Path, record: Record) -> Scene:
    notes = Notes()
    facts = record.facts
    for text, count in facts["warnings"]:
        if "UTF-8" not in text:  # names of the author's machine in another encoding, of no concern
            notes.add(f"repaired: {text}" + (f" ({count} times)" if count > 1 else ""))
    for text in facts["notes"]:
        notes.add(str(text))
    unit_m = float(facts["unit_m"])
    if not (np.isfinite(unit_m) and 1e-6 < unit_m < 1e6):
        notes.add(f"its unit of {unit_m:g} m is impossible; taken as cm")
        unit_m = 0.01
    tree = hierarchy.build(record, unit_m, notes)
    morphs = build_morphs(record, notes)
    parts = _Parts(record, tree, morphs, unit_m, notes).parts()
    animations = clips(record, tree, morphs, unit_m, notes)
    for name, text in _DROPPED.items():
        if facts["dropped"][name]:
            notes.add(text)
    characters: tuple[Character, ...] = ()
    if tree.skeleton.joint_count:
        characters = (
            Character(
                tree.skeleton,
                tuple(parts),
                name=path.stem,
                morph_names=morphs.names,
                rest_morph_weights=morphs.rest_weights.astype(np.float32),
                roles=tree.roles,
                extras={"fbx": {"bones": list(tree.bones)}, "euler_orders": dict(tree.euler_orders)},
            ),
        )
    else:
        notes.add("the file holds no nodes")
    about = {
        "version": facts["version"],
        "encoding": "ascii" if facts["ascii"] else "binary",
        "creator": facts["creator"],
        "application": facts["application"],
        "rate_hz": float(facts["rate_hz"]),
    }
    return Scene(
        characters,
        tuple(animations),
        format="fbx",
        unit_m=unit_m,
        up=_up(facts["up"]),
        notes=notes.texts(),
        extras={"fbx": about},
    )


def _up(axis: Sequence[int]) -> str:
    return "XYZ"[axis[0]] if 0 <= axis[0] < 3 else "Y"


class _Parts:
    """The parts of a character, from the nodes that show meshes."""

    def __init__(self, record: Record, tree: Hierarchy, morphs: Morphs, unit_m: float, notes: Notes) -> None:
        self._record, self._tree, self._morphs, self._unit_m, self._notes = record, tree, morphs, unit_m, notes
        self._materials = materials(record, notes)
        self._surfaces = Surfaces(record, unit_m, notes)
        self._group = 0

    def parts(self) -> list[Part]:
        """All parts in the order of the file's meshes."""
        facts = self._record.facts["nodes"]
        showing = [node for node in self._tree.nodes if int(facts[node]["mesh"]) >= 0]
        showing.sort(key=lambda node: int(facts[node]["mesh"]))
        return [part for node in showing for part in self._of_node(node, facts[node])]

    def _of_node(self, node: int, item: Mapping[str, Any]) -> list[Part]:
        number = int(item["mesh"])
        mesh = self._record.facts["meshes"][number]
        joint = self._tree.joint_of_node.get(node)
        base = str(mesh["name"] or item["name"] or f"mesh_{number}")
        where = f"mesh '{base}'"
        surfaces = self._surfaces.surfaces(number, where)
        if not surfaces:
            return []
        count = surfaces[0].control_point_count
        binding = bind(self._record, mesh["skins"], node, count, self._tree, self._unit_m, where, self._notes)
        carrier = joint if joint is not None else self._tree.joint_above.get(node)
        if binding is None and carrier is None:
            raise FormatError("the mesh follows a node that is no joint", where=where)
        geometry = np.eye(4)
        if binding is None and item["geometry"] is not None:
            geometry = affine(item["geometry"], self._unit_m, where)
        place: dict[str, Any] = {} if joint is None else {"node": self._tree.skeleton.names[joint]}
        if len(mesh["morphs"]) > 1:
            self._notes.add(f"{where}: it has {len(mesh['morphs'])} blend deformers; their targets were joined")
        targets = [target for deformer in mesh["morphs"] for target in self._morphs.targets[deformer]]
        names = str(mesh["parts"]).split("\n")
        if not mesh["parts"] or len(names) != len(surfaces):
            names = [base if len(surfaces) == 1 else f"{base}_{index}" for index in range(len(surfaces))]
        parts: list[Part] = []
        for index, surface in enumerate(surfaces):
            morphs = channels = None
            if targets:
                linear = geometry[:3, :3] * self._unit_m
                points = surface.control_points
                morphs, channels = morph_set(self._record, targets, self._morphs.names, points, count, linear, where)
            parts.append(
                Part(
                    name=names[index],
                    mesh=_with_mixture(_moved(surface.mesh, geometry), surface, binding),
                    material=self._material(item, mesh, surface.slot),
                    skin=None if binding is None else binding.of(surface.control_points),
                    joint=carrier if binding is None else None,
                    morphs=morphs,
                    morph_channels=channels,
                    group=self._group,
                    extras={"fbx": place} if place else {},
                )
            )
        self._group += 1
        return parts

    def _material(self, node: Mapping[str, Any], mesh: Mapping[str, Any], slot: int) -> Material:
        slots = node["materials"] or mesh["materials"]
        if slot < len(slots) and 0 <= slots[slot] < len(self._materials):
            return self._materials[slots[slot]]
        return Material()


def _moved(mesh: Mesh, geometry: Any) -> Mesh:
    """A mesh in its node's space, moved there by the node's geometric transform."""
    if np.array_equal(geometry, np.eye(4)):
        return mesh
    positions = rigid.transform_points(geometry, np.asarray(mesh.positions, np.float64)).astype(np.float32)
    determinant = np.linalg.det(geometry[:3, :3])
    triangles = mesh.triangles[:, ::-1] if determinant < 0 else mesh.triangles
    normals = mesh.normals
    if normals is not None and determinant != 0:
        turned = np.asarray(normals, np.float64) @ np.linalg.inv(geometry[:3, :3])
        normals = (turned / np.maximum(np.linalg.norm(turned, axis=1, keepdims=True), 1e-300)).astype(np.float32)
    return Mesh(positions, triangles, normals, mesh.uvs, mesh.colors, mesh.attributes)


def _with_mixture(mesh: Mesh, surface: Surface, binding: Binding | None) -> Mesh:
    if binding is None or binding.dual_quaternion is None:
        return mesh
    amount = np.asarray(binding.dual_quaternion, np.float32)[surface.control_points, None]
    attributes = {**mesh.attributes, DQ_ATTRIBUTE: amount}
    return Mesh(mesh.positions, mesh.triangles, mesh.normals, mesh.uvs, mesh.colors, attributes)
