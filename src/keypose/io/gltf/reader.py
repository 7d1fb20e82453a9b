"""Reading glTF 2.0: .gltf, .glb, and VRM's .vrm and .vrma."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from keypose.errors import FormatError, ShapeError
from keypose.io.gltf import hierarchy, humanoid
from keypose.io.gltf.accessors import PER_ITEM, Arrays
from keypose.io.gltf.animations import Animations, MorphChannels, MorphInstance
from keypose.io.gltf.container import open_container
from keypose.io.gltf.document import parse
from keypose.io.gltf.hierarchy import OWN, Hierarchy
from keypose.io.gltf.items import Document, MeshItem
from keypose.io.gltf.materials import Materials
from keypose.io.gltf.surfaces import Surfaces, target_names
from keypose.io.json_values import Json, parse_json
from keypose.io.notes import Notes
from keypose.model import Character, Part, Scene

Understand = Callable[[Scene, Json, Document, Hierarchy, Notes], Scene]


def read(path: Path) -> Scene:
    """The default scene of a glTF file as one character, and its animations as clips.

    Every node is a joint of the skeleton, every primitive a part; metres, Y up, as glTF has them.

    Raises:
        FormatError: where the file is damaged or requires an extension that is not supported.
        MissingExtra: where it is compressed and the library for that is not installed.
    """
    return read_with(path, None)


def read_with(path: Path, understand: Understand | None) -> Scene:
    """As `read`; ``understand`` completes the scene with what root extensions say."""
    notes = Notes()
    try:
        container = open_container(path, notes)
        root = parse_json(container.json)
        document = parse(root)
        arrays = Arrays(document, container, notes)
        materials = Materials(document, arrays, container, notes)
        with np.errstate(
            over="ignore", invalid="ignore"
        ):  # checks take sums of squares; what is too large for one is looked at again
            return _scene(path, root, document, arrays, materials, notes, understand)
    except FormatError as error:
        raise error.at(path) from None
    except RecursionError:
        raise FormatError("brackets are nested too deeply", where="JSON", path=path) from None
    except ShapeError as error:  # what no check of ours names better
        raise FormatError(str(error), path=path) from None


def _scene(
    path: Path,
    root: Json,
    document: Document,
    arrays: Arrays,
    materials: Materials,
    notes: Notes,
    understand: Understand | None,
) -> Scene:
    tree, scene_name = hierarchy.build(document, notes)
    surfaces = Surfaces(document, arrays, notes)
    animations = Animations(document, arrays, notes)
    channels = animations.channels(_morph_instances(document, tree, notes), _own_morph_order(document))
    clips = animations.clips(tree.skeleton.names, tree.joint_of_node, channels)
    parts = _parts(document, tree, arrays, surfaces, materials, channels, notes)
    _note_what_is_dropped(document, tree, notes)
    characters: tuple[Character, ...] = ()
    if tree.skeleton.joint_count:
        roles = {**_own_roles(document, tree), **humanoid.roles(root, tree.joint_of_node, notes)}
        extras: dict[str, Any] = {"gltf": {"nodes": dict(tree.node_extras)}} if tree.node_extras else {}
        characters = (
            Character(
                skeleton=tree.skeleton,
                parts=tuple(parts),
                name=scene_name or path.stem,
                morph_names=channels.names,
                rest_morph_weights=channels.rest_weights,
                roles=roles,
                extras=extras,
            ),
        )
    else:
        notes.add("the file holds no nodes")
    scene = Scene(characters, tuple(clips), format="gltf", extras=_extras(document))
    scene = _restored(scene, document)
    if understand is not None:
        scene = understand(scene, root, document, tree, notes)
    return replace(scene, notes=notes.texts())


def _morph_instances(document: Document, tree: Hierarchy, notes: Notes) -> list[MorphInstance]:
    instances: list[MorphInstance] = []
    for index in tree.nodes:
        node = document.nodes[index]
        if node.mesh is None:
            continue
        mesh = document.meshes[node.mesh]
        targets = target_names(mesh, notes)
        if not targets:
            continue
        weights = mesh.weights if node.weights is None else node.weights
        if weights is not None and len(weights) != len(targets):
            where = f"{mesh.where if node.weights is None else node.where}.weights"
            raise FormatError(f"{len(weights)} weights for {len(targets)} morph targets", where=where)
        joint = tree.joint_of_node.get(index)
        name = (node.name or mesh.name or f"node_{index}") if joint is None else tree.skeleton.names[joint]
        instances.append(MorphInstance(index, name, targets, weights or (0.0,) * len(targets)))
    return instances


def _parts(
    document: Document,
    tree: Hierarchy,
    arrays: Arrays,
    surfaces: Surfaces,
    materials: Materials,
    channels: MorphChannels,
    notes: Notes,
) -> list[Part]:
    parts: list[Part] = []
    group = 0
    for index in tree.nodes:
        node = document.nodes[index]
        if node.mesh is None:
            continue
        mesh = document.meshes[node.mesh]
        joint = tree.joint_of_node.get(index)
        node_name = None if joint is None else tree.skeleton.names[joint]
        if joint is None:
            joint = tree.joint_above.get(index)
        base = mesh.name or node.name or f"mesh_{node.mesh}"
        for number, primitive in enumerate(mesh.primitives):
            surface = surfaces.surface(node.mesh, number)
            if surface is None:
                continue
            arrays.take(PER_ITEM, node.where)
            skin = None
            if node.skin is not None:
                skin = surfaces.skin(node.skin, node.mesh, number, tree.joint_of_node)
                if skin is None:
                    notes.add(f"{primitive.where}: it has no joints and follows its node instead of skins[{node.skin}]")
            if skin is None and joint is None:
                raise FormatError("the mesh follows a node that is no joint", where=node.where)
            morphs = surface.morphs
            parts.append(
                Part(
                    name=_part_name(primitive.extras, base if len(mesh.primitives) == 1 else f"{base}_{number}"),
                    mesh=surface.mesh,
                    material=materials.material(primitive.material),
                    skin=skin,
                    joint=joint if skin is None else None,
                    morphs=morphs,
                    morph_channels=None if morphs is None else channels.of_node[index],
                    group=group,
                    extras=_part_extras(mesh, primitive.extras, node_name),
                )
            )
        group += 1
    return parts


def _part_extras(mesh: MeshItem, primitive: Mapping[str, Any], node: str | None) -> dict[str, Any]:
    """What the writer needs to put the part back where it was."""
    kept = {k: v for k, v in primitive.items() if k != OWN}
    place: dict[str, Any] = {}
    if mesh.name and len(mesh.primitives) > 1:  # of a single part, the part has the name
        place["mesh"] = mesh.name
    if node is not None:
        place["node"] = node
    if mesh.extras:
        place["mesh_extras"] = dict(mesh.extras)
    return {**kept, "gltf": place} if place else kept


def _part_name(extras: Mapping[str, Any], name: str) -> str:
    own = extras.get(OWN)
    given = own.get("name") if isinstance(own, dict) else None
    return given if isinstance(given, str) else name


def _own(document: Document) -> Mapping[str, Any]:
    """What keypose itself has written about the whole file."""
    extras = document.asset.get("extras")
    own = extras.get(OWN) if isinstance(extras, dict) else None
    return own if isinstance(own, dict) else {}


def _own_morph_order(document: Document) -> list[str]:
    order = _own(document).get("morphs")
    return order if isinstance(order, list) and all(isinstance(name, str) for name in order) else []


def _own_roles(document: Document, tree: Hierarchy) -> dict[str, int]:
    """Roles that keypose has written into the nodes."""
    roles: dict[str, int] = {}
    for node, joint in tree.joint_of_node.items():
        role = hierarchy.own_extras(document.nodes[node].extras).get("role")
        if isinstance(role, str):
            roles.setdefault(role, joint)
    return roles


def _note_what_is_dropped(document: Document, tree: Hierarchy, notes: Notes) -> None:
    others = sorted({name for n in tree.nodes for name in document.nodes[n].others if name != "camera"})
    if any("camera" in document.nodes[n].others for n in tree.nodes):
        notes.add("cameras were dropped; their nodes are kept")
    if others:
        notes.add(f"node extensions were dropped: {', '.join(others)}")
    if "KHR_animation_pointer" in document.used:
        notes.add("KHR_animation_pointer: animation of anything but nodes and morph weights was dropped")


def _extras(document: Document) -> dict[str, Any]:
    kept: dict[str, Any] = {"asset": {k: v for k, v in document.asset.items() if k != "extras"}}
    asset_extras = document.asset.get("extras")
    if isinstance(asset_extras, dict):
        kept["asset_extras"] = {k: v for k, v in asset_extras.items() if k != OWN}
    if document.scenes:
        scene = document.scenes[document.scene or 0]
        if scene.extras:
            kept["scene_extras"] = dict(scene.extras)
    if document.extras:
        kept["extras"] = dict(document.extras)
    if document.extensions:
        kept["extensions"] = dict(document.extensions)
    return {"gltf": {k: v for k, v in kept.items() if v}}


def _restored(scene: Scene, document: Document) -> Scene:
    """The scene with what keypose kept of the file it was converted from."""
    own = _own(document)
    source = own.get("source")
    kept = {k: v for k, v in source.items() if k != "gltf"} if isinstance(source, dict) else {}
    character = own.get("character")
    if isinstance(character, dict) and len(scene.characters) == 1:
        restored = {k: v for k, v in character.items() if k != "gltf"}
        scene = replace(scene, characters=(replace(scene.character, extras={**restored, **scene.character.extras}),))
    unit, up = own.get("unit_m"), own.get("up")
    known = isinstance(unit, (int, float)) and not isinstance(unit, bool) and np.isfinite(unit) and unit > 0
    return replace(
        scene,
        extras={**scene.extras, **kept},
        unit_m=float(unit) if known and unit is not None else scene.unit_m,
        up=up if up in ("X", "Y", "Z") else scene.up,
    )
