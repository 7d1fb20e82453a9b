"""Materials beside an OBJ file (.mtl): colour, opacity, roughness, metal, glow and the picture of the colour.

Source: Wavefront Technologies, "MTL material format", v4.2; the metal and roughness statements are those of the
physically based extension (Exocortex).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path, PurePosixPath, PureWindowsPath

from keypose.errors import FormatError
from keypose.io.notes import Notes
from keypose.io.text import shown, to_number
from keypose.model import Image, Material

_LARGEST_BYTES = 16 << 20
_LARGEST_IMAGE = 64 << 20
_MAGIC = ((b"\x89PNG\r\n\x1a\n", "image/png"), (b"\xff\xd8\xff", "image/jpeg"))
_WIDTHS = {"Kd": 3, "Ke": 3, "d": 1, "Tr": 1, "Ns": 1, "Pr": 1, "Pm": 1}


def read_materials(obj: Path, libraries: Iterable[str], notes: Notes) -> dict[str, Material]:
    """The materials of the libraries that lie beside the file; what is missing or wrong in them is noted."""
    found: dict[str, Material] = {}
    for name in dict.fromkeys(libraries):
        path = beside(obj, name)
        if path is None or not path.is_file():
            notes.add(f"the material library {shown(name)} is not beside the file; materials have only their names")
            continue
        if path.stat().st_size > _LARGEST_BYTES:
            notes.add(f"the material library {shown(name)} is larger than {_LARGEST_BYTES >> 20} MiB and was not read")
            continue
        for material, items in _items(path, notes).items():
            found.setdefault(material, _material(material, items, path, notes))
    return found


def beside(file: Path, name: str) -> Path | None:
    """A file that another names, in its own folder or below; None for anything that leads elsewhere."""
    parts = PurePosixPath(name.replace("\\", "/")).parts
    if not parts or ".." in parts or parts[0].startswith("/") or PureWindowsPath(name).drive or "\0" in name:
        return None
    path = file.parent.joinpath(*parts)
    inside = path.resolve().is_relative_to(file.parent.resolve())
    return path if inside else None


def _items(path: Path, notes: Notes) -> Mapping[str, dict[str, str]]:
    materials: dict[str, dict[str, str]] = {}
    items: dict[str, str] = {}
    ignored: dict[str, None] = {}
    for line in path.read_bytes().decode("utf-8", "replace").splitlines():
        keyword, _, rest = line.partition("#")[0].strip().partition(" ")
        if keyword == "newmtl":
            items = materials.setdefault(rest.strip(), {})
        elif keyword in _WIDTHS or keyword == "map_Kd":
            items[keyword] = rest.strip()
        elif keyword and keyword.isprintable() and len(keyword) < 24:
            ignored[keyword] = None
    if ignored:
        notes.add(f"{path.name}: material statements that were dropped: {', '.join(list(ignored)[:12])}")
    return materials


def _material(name: str, items: Mapping[str, str], path: Path, notes: Notes) -> Material:
    values: dict[str, list[float]] = {}
    for key, width in _WIDTHS.items():
        if key in items:
            try:
                values[key] = [to_number(word, 1e6) for word in items[key].split()[:width]]
                if len(values[key]) < width:
                    raise ValueError
            except ValueError:
                values.pop(key, None)
                notes.add(f"{path.name}: material {shown(name)}: {key} {shown(items[key])} is no colour or number")

    def unit(key: str, default: float) -> float:
        return min(max(values.get(key, [default])[0], 0.0), 1.0)

    r, g, b = (min(max(v, 0.0), 1.0) for v in values.get("Kd", [0.8, 0.8, 0.8]))
    opacity = unit("d", 1.0 - unit("Tr", 0.0))
    shiny = unit("Ns", 1.0 - 0.8) if "Ns" not in values else min(max(values["Ns"][0], 0.0), 1000.0) / 1000.0
    roughness = unit("Pr", 0.8 if "Ns" not in values else 1.0 - shiny**0.5)
    glow = values.get("Ke", [0.0, 0.0, 0.0])
    image = None
    if "map_Kd" in items:
        image = _picture(items["map_Kd"], path, notes)
        if image is not None and "Kd" not in values:
            r, g, b = 1.0, 1.0, 1.0
    return Material(
        name=name,
        base_color=(r, g, b, opacity),
        metallic=unit("Pm", 0.0),
        roughness=roughness,
        emissive=(max(glow[0], 0.0), max(glow[1], 0.0), max(glow[2], 0.0)),
        base_color_image=image,
        alpha_mode="BLEND" if opacity < 1.0 else "OPAQUE",
    )


def _picture(words: str, path: Path, notes: Notes) -> Image | None:
    if words.startswith("-"):
        notes.add(f"{path.name}: options of map_Kd were dropped: {shown(words)}")
        words = words.split()[-1]
    file = beside(path, words)
    if file is None or not file.is_file():
        notes.add(f"{path.name}: the picture {shown(words)} is not beside the file")
        return None
    if file.stat().st_size > _LARGEST_IMAGE:
        notes.add(f"{path.name}: the picture {shown(words)} is larger than {_LARGEST_IMAGE >> 20} MiB")
        return None
    data = file.read_bytes()
    kind = next((mime for magic, mime in _MAGIC if data.startswith(magic)), "")
    if not kind:
        notes.add(f"{path.name}: the picture {shown(words)} is neither PNG nor JPEG")
        return None
    return Image(file.stem, kind, data)


def library_text(materials: Mapping[str, Material], pictures: Mapping[str, str]) -> str:
    """The text of a .mtl file; ``pictures`` gives the file name of a material's picture."""
    lines: list[str] = []
    for name, material in materials.items():
        r, g, b, opacity = material.base_color
        lines += [f"newmtl {name}", f"Kd {r:.7g} {g:.7g} {b:.7g}"]
        if any(material.emissive):
            lines.append("Ke {:.7g} {:.7g} {:.7g}".format(*material.emissive))
        shiny = 1000.0 * (1.0 - material.roughness) ** 2
        lines += [f"Ns {shiny:.7g}", f"Pr {material.roughness:.7g}", f"Pm {material.metallic:.7g}", f"d {opacity:.7g}"]
        if name in pictures:
            lines.append(f"map_Kd {pictures[name]}")
        lines.append("")
    return "\n".join(lines)


def checked_name(name: str, what: str) -> str:
    """A name that fits in one line of an OBJ file; raises `FormatError`."""
    if any(not c.isprintable() for c in name):
        raise FormatError(f"the {what} name {shown(name)} does not fit into one line")
    return name
