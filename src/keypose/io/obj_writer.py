"""Writing OBJ files: the meshes of a scene at rest, their materials, and each morph target as a file of its own."""

from __future__ import annotations

import re
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from keypose.arrays import Floats, Ints
from keypose.errors import FormatError
from keypose.io import atomic
from keypose.io.axes import unit_in_metres
from keypose.io.notes import Notes, UniqueNames, beyond_meshes
from keypose.io.obj_materials import checked_name, library_text
from keypose.io.text import format_rows
from keypose.model import Character, Material, Scene

UNIT_COMMENT = re.compile(rb"(?m)^# keypose unit_m ([0-9.eE+-]{1,30})\s*$")
_SUFFIXES = {"image/png": ".png", "image/jpeg": ".jpg"}


@dataclass(frozen=True, slots=True)
class _Surface:
    """One part: lists that faces index, and the corners of its triangles (T, 3) in each of them."""

    name: str
    material: str
    positions: Floats
    colors: Floats | None
    uvs: Floats | None
    normals: Floats | None
    corners: tuple[Ints, Ints | None, Ints | None]
    targets: dict[int, Floats]  # morph channel -> moved positions


def write(
    scene: Scene, path: Path, *, unit: str | float | None = None, decimals: int = 7, targets: bool = False
) -> tuple[str, ...]:
    """Write the meshes of a scene, as they are at rest; returns notes of what OBJ cannot hold.

    Materials go into a .mtl beside the file, with their pictures. Vertices that lie at one place and move alike are
    written once. With ``targets`` the folder ``NAME_targets`` beside the file gets one OBJ for each morph channel.

    Shapes and units: ``unit`` as for `read`; if not given that of the OBJ file the scene came from, else metres.
    ``decimals`` of positions, 1 to 15.

    Raises:
        FormatError: where there is no mesh, or the file cannot be written.
    """
    if not 1 <= decimals <= 15:
        raise FormatError(f"decimals: expected 1 to 15, got {decimals}", path=path)
    unit_m = (scene.unit_m if scene.format == "obj" else 1.0) if unit is None else unit_in_metres(unit)
    notes = Notes()
    names = UniqueNames()
    materials: dict[str, Material] = {}
    surfaces: list[_Surface] = []
    channels: list[str] = []
    for character in scene.characters:
        first = len(channels)
        channels += character.morph_names
        surfaces += _surfaces(character, first, names, materials, unit_m, targets)
    if not surfaces:
        raise FormatError("the scene has no mesh, and OBJ holds nothing else", path=path)
    _note_losses(scene, notes, targets)
    with ExitStack() as files:
        pictures = _write_pictures(files, path, materials, notes)
        library = ""
        if materials:
            library = path.with_suffix(".mtl").name
            beside = files.enter_context(atomic.replacing(path.with_suffix(".mtl")))
            beside.write_text(library_text(materials, pictures), encoding="utf-8", newline="\n")
        files.enter_context(atomic.replacing(path)).write_bytes(_text(surfaces, None, library, unit_m, decimals))
    if targets and channels:
        folder = path.with_name(f"{path.stem}_targets")
        folder.mkdir(exist_ok=True)
        unique = UniqueNames()
        for channel, name in enumerate(channels):
            stem = re.sub(r'[\x00-\x1f/\\:*?"<>|]', "_", name).strip(" .")[:100] or f"target_{channel}"
            with atomic.replacing(folder / f"{unique.add(stem)}.obj") as temporary:
                temporary.write_bytes(_text(surfaces, channel, library and f"../{library}", unit_m, decimals))
    return notes.texts()


def _note_losses(scene: Scene, notes: Notes, targets: bool) -> None:
    if any(part.skin is not None for c in scene.characters for part in c.parts):
        notes.add("OBJ holds no joints: the meshes are written in the rest pose, without skeleton and skin weights")
    if scene.animations:
        notes.add(f"OBJ holds no animation: {len(scene.animations)} were not written")
    morphs = sum(len(c.morph_names) for c in scene.characters)
    if morphs and not targets:
        notes.add(f"{morphs} morph channels were not written; targets=True writes an OBJ file for each")
    if any(part.mesh.attributes for c in scene.characters for part in c.parts):
        notes.add("further attributes of vertices were not written")
    for text in [text for character in scene.characters for text in beyond_meshes(character)]:
        notes.add(text)


def _surfaces(
    character: Character,
    first: int,
    names: UniqueNames,
    materials: dict[str, Material],
    unit_m: float,
    targets: bool,
) -> list[_Surface]:
    from keypose.deform import deform_part
    from keypose.evaluate import world

    skeleton = character.skeleton
    model_from_joint = np.asarray(world(skeleton, skeleton.rest), np.float64)
    rest = np.asarray(character.rest_morph_weights, np.float64)
    found: list[_Surface] = []
    for part in character.parts:
        has_normals = part.mesh.normals is not None
        moved = deform_part(character, part, model_from_joint, rest, has_normals)
        positions, normals = moved if has_normals else (moved, None)
        positions = np.asarray(positions, np.float64) / unit_m
        shapes: dict[int, Floats] = {}
        used = [] if part.morph_channels is None or not targets else part.morph_channels.tolist()
        for channel in dict.fromkeys(used):
            weights = rest + (np.arange(len(rest)) == channel)
            shapes[first + channel] = np.asarray(deform_part(character, part, model_from_joint, weights)) / unit_m
        colors = None if part.mesh.colors is None else _srgb(np.asarray(part.mesh.colors)[:, :3])
        kept, place = _welded([positions, *shapes.values(), *([] if colors is None else [colors])])
        uvs = None if part.mesh.uvs is None else np.asarray(part.mesh.uvs, np.float64) * (1, -1) + (0, 1)
        uv_kept, uv_place = (None, None) if uvs is None else _welded([uvs])
        normal_kept, normal_place = (None, None) if normals is None else _welded([np.asarray(normals, np.float64)])
        triangles = part.mesh.triangles
        found.append(
            _Surface(
                names.add(checked_name(part.name or "part", "part")),
                _material_name(part.material, materials),
                positions[kept],
                None if colors is None else colors[kept],
                None if uvs is None else uvs[uv_kept],
                None if normals is None else np.asarray(normals)[normal_kept],
                (
                    place[triangles],
                    None if uv_place is None else uv_place[triangles],
                    None if normal_place is None else normal_place[triangles],
                ),
                {channel: shape[kept] for channel, shape in shapes.items()},
            )
        )
    return found


def _srgb(linear: Floats) -> Floats:
    linear = np.clip(linear.astype(np.float64), 0.0, 1.0)
    return np.where(linear <= 0.0031308, linear * 12.92, 1.055 * linear ** (1 / 2.4) - 0.055)


def _welded(columns: list[Floats]) -> tuple[Ints, Ints]:
    """Rows that are different from all before, and for every row its place among them."""
    rows = np.ascontiguousarray(np.concatenate(columns, axis=1) + 0.0)  # one zero only
    keys = rows.view(np.dtype((np.void, rows.dtype.itemsize * rows.shape[1]))).ravel()
    _, first, inverse = np.unique(keys, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    return first[order], rank[inverse]


def _material_name(material: Material, materials: dict[str, Material]) -> str:
    if material == Material() or not (material.name or material.base_color_image or _differs(material)):
        return ""
    name = checked_name(material.name or "material", "material")
    number = 1
    unique = name
    while unique in materials and materials[unique] is not material:
        if not _unlike(materials[unique], material):
            return unique
        number += 1
        unique = f"{name}_{number}"
    materials[unique] = material
    return unique


def _looks(material: Material) -> tuple[Any, ...]:
    image = material.base_color_image
    return (material.base_color, material.metallic, material.roughness, material.emissive, image and image.data)


def _differs(material: Material) -> bool:
    return _looks(material) != _looks(Material())


def _unlike(a: Material, b: Material) -> bool:
    return _looks(a) != _looks(b)


def _write_pictures(files: ExitStack, path: Path, materials: dict[str, Material], notes: Notes) -> dict[str, str]:
    pictures: dict[str, str] = {}
    written: dict[bytes, str] = {}
    unique = UniqueNames()
    for name, material in materials.items():
        image = material.base_color_image
        if image is None:
            continue
        suffix = _SUFFIXES.get(image.mime_type)
        if image.data is None or suffix is None:
            notes.add(f"material '{name}': its picture is missing or neither PNG nor JPEG and was not written")
            continue
        if image.data not in written:
            stem = re.sub(r"[^\w.-]", "_", image.name or name).strip(".") or "picture"
            file = unique.add(f"{path.stem}_{stem}") + suffix
            files.enter_context(atomic.replacing(path.with_name(file))).write_bytes(image.data)
            written[image.data] = file
        pictures[name] = written[image.data]
    return pictures


def _text(surfaces: list[_Surface], channel: int | None, library: str, unit_m: float, decimals: int) -> bytes:
    import keypose

    lines = [f"# keypose {keypose.__version__}\n# keypose unit_m {unit_m!r}\n".encode()]
    if library:
        lines.append(f"mtllib {library}\n".encode())
    counts = [1, 1, 1]
    for surface in surfaces:
        lines.append(f"o {surface.name}\n".encode())
        positions = surface.positions if channel is None else surface.targets.get(channel, surface.positions)
        if surface.colors is not None:
            positions = np.concatenate([positions, surface.colors], axis=1)
        lines.append(_rows("v", positions, decimals))
        lines += [] if surface.uvs is None else [_rows("vt", surface.uvs, 7)]
        lines += [] if surface.normals is None else [_rows("vn", surface.normals, 7)]
        if surface.material:
            lines.append(f"usemtl {surface.material}\n".encode())
        elif library:
            lines.append(b"usemtl\n")
        lines.append(b"s 1\n" if surface.normals is not None else b"s off\n")
        lines.append(_faces(surface.corners, counts))
        counts[0] += len(surface.positions)
        counts[1] += 0 if surface.uvs is None else len(surface.uvs)
        counts[2] += 0 if surface.normals is None else len(surface.normals)
    return b"".join(lines)


def _rows(keyword: str, values: Floats, decimals: int) -> bytes:
    if not len(values):
        return b""
    rows = format_rows(np.ascontiguousarray(values, np.float64), decimals)
    start = f"{keyword} ".encode()
    return start + rows[:-1].replace(b"\n", b"\n" + start) + b"\n"


def _faces(corners: tuple[Ints, Ints | None, Ints | None], first: list[int]) -> bytes:
    position, uv, normal = corners
    if not len(position):
        return b""
    columns = [position.ravel() + first[0]]
    word = "%d"
    if uv is not None:
        columns.append(uv.ravel() + first[1])
        word += "/%d"
    if normal is not None:
        columns.append(normal.ravel() + first[2])
        word += "/%d" if uv is not None else "//%d"
    line = f"f {word} {word} {word}\n"
    table = np.stack(columns, axis=1).reshape(len(position), -1)
    return "".join([line % tuple(row) for row in table.tolist()]).encode()
