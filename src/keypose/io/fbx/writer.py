"""Writing FBX 7.4, binary: skeletons, skins, blend shapes, materials and animation."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

import keypose
from keypose.errors import FormatError, ShapeError
from keypose.evaluate import world
from keypose.io import atomic
from keypose.io.axes import unit_in_metres
from keypose.io.fbx.binary import CREATION_TIME, FILE_ID, VERSION, Long, Node, encode, node, properties
from keypose.io.fbx.out_animations import CUSTOM_MODE, TIME_MODES, AnimationWriter, Written, common_rate
from keypose.io.fbx.out_materials import MaterialWriter
from keypose.io.fbx.out_nodes import LIMB, MESH, NULL, Objects, add_models
from keypose.io.fbx.out_surfaces import Group, SurfaceWriter, group_parts
from keypose.io.notes import Notes, beyond_meshes
from keypose.model import Character, Scene


def write(scene: Scene, path: Path, *, unit: str | float = "cm", rate_hz: float | None = None) -> tuple[str, ...]:
    """Write a scene as binary FBX 7.4, Y up, facing +Z; returns notes of what was changed or could not be held.

    Shapes and units: ``unit`` is a name ("cm") or metres per file unit; ``rate_hz`` the frame rate, at which every
    animation gets a key; without it the highest of the animations' own, else 30 Hz.

    Raises:
        FormatError: where the place cannot be written or the content is too large.
        UnknownName, ShapeError: for a unit or rate that is none.
    """
    if rate_hz is not None and not (np.isfinite(rate_hz) and rate_hz > 0):
        raise ShapeError(f"rate_hz: expected a positive number, got {rate_hz}")
    scale = 1.0 / unit_in_metres(unit)
    notes = Notes()
    objects = Objects()
    materials = MaterialWriter(objects, notes)
    written = [_character(objects, materials, character, scale, notes) for character in scene.characters]
    if len(written) > 1:
        notes.add(f"{len(written)} characters are in one hierarchy; FBX does not keep them apart")
    rate = float(rate_hz) if rate_hz is not None else common_rate(scene.animations, notes)
    animations = AnimationWriter(objects, written, rate, scale, notes)
    for animation in scene.animations:
        animations.add(animation)
    for name, items in (("marker sets", scene.markers), ("signals", scene.signals), ("force plates", scene.plates)):
        if items:
            notes.add(f"{len(items)} {name} were dropped: FBX has no place for them")
    try:
        data = encode(_document(objects, animations.takes, rate, scale))
    except FormatError as error:
        raise error.at(path) from None
    with atomic.replacing(path) as temporary:
        temporary.write_bytes(data)
    return notes.texts()


def _character(
    objects: Objects, materials: MaterialWriter, character: Character, scale: float, notes: Notes
) -> Written:
    groups = group_parts(character, notes)
    for text in beyond_meshes(character):
        notes.add(text)
    kinds, bones = _kinds(character, groups)
    models = add_models(objects, character, kinds, bones, scale)
    surfaces = SurfaceWriter(objects, materials, scale, notes)
    world_from_joint = world(character.skeleton, character.skeleton.rest)
    for group in groups:
        surfaces.add(character, group, models, np.asarray(world_from_joint))
    driven = {morph for morph, _ in surfaces.blend_channels}
    idle = [name for morph, name in enumerate(character.morph_names) if morph not in driven]
    if idle:
        shown = ", ".join(idle[:6]) + (", …" if len(idle) > 6 else "")
        notes.add(f"character '{character.name}': {len(idle)} morph channels drive nothing and were dropped: {shown}")
    return Written(character, models, surfaces.blend_channels)


def _kinds(character: Character, groups: Sequence[Group]) -> tuple[list[str], frozenset[int]]:
    """What each joint is in the file, and which are bones."""
    names = character.skeleton.names
    about = character.extras.get("fbx")
    given = about.get("bones") if isinstance(about, dict) else None
    showing = {g.joint for g in groups if g.joint is not None and not g.carried}
    deforming = {int(j) for p in character.parts if p.skin is not None for j in p.skin.palette}
    bones = {j for j, name in enumerate(names) if not isinstance(given, list) or name in given} | deforming
    bones -= showing
    kinds = [MESH if j in showing else LIMB if j in bones else NULL for j in range(len(names))]
    return kinds, frozenset(bones)


def _document(objects: Objects, takes: Sequence[tuple[str, int, int]], rate: float, scale: float) -> list[Node]:
    creator = f"keypose {keypose.__version__}"
    header = node("FBXHeaderExtension")
    header.add("FBXHeaderVersion", 1003)
    header.add("FBXVersion", VERSION)
    header.add("EncryptionType", 0)
    stamp = header.add("CreationTimeStamp")
    stamp.add("Version", 1000)
    for name, value in zip(
        ("Year", "Month", "Day", "Hour", "Minute", "Second", "Millisecond"), (1970, 1, 1, 10, 0, 0, 0), strict=True
    ):
        stamp.add(name, value)
    header.add("Creator", creator)
    documents = node("Documents")
    documents.add("Count", 1)
    document = documents.add("Document", Long(1_000_000), "Scene", "Scene")
    document.children.append(properties([("ActiveAnimStackName", "KString", "", "", takes[0][0] if takes else "")]))
    document.add("RootNode", Long(0))
    definitions = node("Definitions")
    definitions.add("Version", 100)
    definitions.add("Count", sum(objects.counts.values()) + 1)
    for kind, count in {"GlobalSettings": 1, **objects.counts}.items():
        definitions.add("ObjectType", kind).add("Count", count)
    takes_node = node("Takes")
    takes_node.add("Current", takes[0][0] if takes else "")
    return [
        header,
        node("FileId", FILE_ID),
        node("CreationTime", CREATION_TIME),
        node("Creator", creator),
        _settings(takes, rate, scale),
        documents,
        node("References"),
        definitions,
        node("Objects", children=objects.nodes),
        node("Connections", children=objects.connections),
        takes_node,
    ]


def _settings(takes: Sequence[tuple[str, int, int]], rate: float, scale: float) -> Node:
    settings = node("GlobalSettings")
    settings.add("Version", 1000)
    unit = 100.0 / scale  # FBX counts its units in centimetres
    axes = (("UpAxis", 1), ("FrontAxis", 2), ("CoordAxis", 0))
    rows = [
        row
        for name, axis in axes
        for row in ((name, "int", "Integer", "", axis), (f"{name}Sign", "int", "Integer", "", 1))
    ]
    rows += [
        ("OriginalUpAxis", "int", "Integer", "", -1),
        ("OriginalUpAxisSign", "int", "Integer", "", 1),
        ("UnitScaleFactor", "double", "Number", "", unit),
        ("OriginalUnitScaleFactor", "double", "Number", "", unit),
        ("TimeMode", "enum", "", "", TIME_MODES.get(rate, CUSTOM_MODE)),
        ("TimeSpanStart", "KTime", "Time", "", Long(takes[0][1] if takes else 0)),
        ("TimeSpanStop", "KTime", "Time", "", Long(takes[0][2] if takes else 0)),
        ("CustomFrameRate", "double", "Number", "", rate if rate not in TIME_MODES else -1.0),
    ]
    settings.children.append(properties(rows))
    return settings
