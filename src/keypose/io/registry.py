"""The table of file formats and the choice among them: by content first, then by suffix.

Readers and writers are named, not imported, so that ``import keypose.io`` is light and a format costs nothing until a
file of its kind is met.
"""

from __future__ import annotations

import importlib
import inspect
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from keypose.errors import FormatError, UnknownName
from keypose.io.asf import is_amc, is_asf

HEAD_BYTES = 4096


@dataclass(frozen=True, slots=True)
class Format:
    """One file format.

    ``read`` and ``write`` name functions as ``module:function``:
    ``read(path: Path, **options) -> Scene``, ``write(scene: Scene, path: Path, **options) -> notes or None``.
    ``sniff`` says from the first bytes of a file whether it is of this format; an empty ``write`` means read only.
    ``every_curve`` says that the writer stores curves of all kinds as they are; others are given plain clips
    (`keypose.evaluate.plain_clip`). ``skins`` are the suffixes whose files hold meshes with weights of joints.
    """

    name: str
    suffixes: tuple[str, ...]
    sniff: Callable[[bytes], bool]
    read: str
    write: str = ""
    every_curve: bool = False
    skins: tuple[str, ...] = ()

    def reader(self) -> Callable[..., Any]:
        """The reading function, imported now."""
        return _function(self.read)

    def writer(self) -> Callable[..., Any]:
        """The writing function, imported now; `FormatError` where the format is only read."""
        if not self.write:
            raise FormatError(f"{self.name} files can be read but not written")
        return _function(self.write)


def _is_bvh(head: bytes) -> bool:
    for line in head.removeprefix(b"\xef\xbb\xbf").splitlines():
        line = line.strip()
        if line and not line.startswith((b"#", b"//")):
            return line[:9].upper() == b"HIERARCHY"
    return False


def _is_gltf(head: bytes) -> bool:
    text = head.removeprefix(b"\xef\xbb\xbf").lstrip()
    return head.startswith(b"glTF") or (text.startswith(b"{") and b'"asset"' in text)


def _is_c3d(head: bytes) -> bool:
    # the first block of a C3D file is mostly zeros; no text is
    return len(head) >= 512 and head[0] > 0 and head[1] == 0x50 and b"\0\0" in head[:512]


def _is_trc(head: bytes) -> bool:
    return head.removeprefix(b"\xef\xbb\xbf").lstrip()[:12].lower() == b"pathfiletype"


def _is_csm(head: bytes) -> bool:
    text = head.removeprefix(b"\xef\xbb\xbf").lstrip().lower()
    return text.startswith(b"$") and (b"$order" in text or b"$firstframe" in text)


def _is_obj(head: bytes) -> bool:
    for line in head.removeprefix(b"\xef\xbb\xbf").splitlines():
        words = line.split()
        if words and not words[0].startswith(b"#"):
            # a vertex or the library of materials comes first in nearly every file; the rest have their suffix
            return words[0] == b"mtllib" or (words[0] == b"v" and len(words) in (4, 5, 7, 8))
    return False


def _is_makehuman(head: bytes) -> bool:
    text = head.removeprefix(b"\xef\xbb\xbf").lstrip()
    return text.startswith(b"{") and b'"bones"' in text and b'"rotation_plane"' in text


def _is_fbx(head: bytes) -> bool:
    text = head.removeprefix(b"\xef\xbb\xbf").lstrip()
    return head.startswith(b"Kaydara FBX Binary") or text.startswith((b"; FBX", b";FBX", b"FBXHeaderExtension"))


def _is_collada(head: bytes) -> bool:
    return re.search(rb"<(?:[A-Za-z_][\w.-]*:)?COLLADA[\s>]", head) is not None


def _is_usd(head: bytes) -> bool:
    if head.startswith(b"PK\x03\x04"):  # a package, whose first file is a layer
        name = head[30 : 30 + int.from_bytes(head[26:28], "little")]
        return name.lower().endswith((b".usd", b".usda", b".usdc"))
    return head.startswith((b"PXR-USDC", b"#usda "))


def _is_npz(head: bytes) -> bool:
    return head.startswith(b"PK\x03\x04") and b".npy" in head[30:100]


def _is_project(head: bytes) -> bool:
    return head[8:9] == b"{" and b'"keypose_project"' in head[:200]


def _is_safetensors(head: bytes) -> bool:
    return head[8:9] == b"{" and b'"__metadata__"' in head


def _no_mark(head: bytes) -> bool:
    """Of formats that only their suffix tells."""
    return False


def _is_osim(head: bytes) -> bool:
    return b"<OpenSimDocument" in head


def _is_opensim_table(head: bytes) -> bool:
    return re.search(rb"(?im)^endheader\s*$", head) is not None and re.search(rb"(?im)^time\b", head) is not None


def _is_livelink(head: bytes) -> bool:
    return head.removeprefix(b"\xef\xbb\xbf")[:25].lower().replace(b" ", b"") == b"timecode,blendshapecount,"


def _is_textgrid(head: bytes) -> bool:
    text = head[:200].replace(b"\0", b"")  # UTF-16 too
    return b"ooTextFile" in text and b"TextGrid" in text


_formats: dict[str, Format] = {}


def register(entry: Format) -> None:
    """Add a format, or replace the one of the same name."""
    _formats[entry.name] = entry


register(Format("bvh", (".bvh",), _is_bvh, "keypose.io.bvh:read", "keypose.io.bvh:write"))
register(
    Format(
        "gltf",
        (".gltf", ".glb", ".vrm", ".vrma"),
        _is_gltf,
        "keypose.io.gltf.vrm:read",
        "keypose.io.gltf.vrm:write",
        skins=(".gltf", ".glb", ".vrm"),
    ),
)
register(Format("fbx", (".fbx",), _is_fbx, "keypose.io.fbx:read", "keypose.io.fbx:write", skins=(".fbx",)))
register(Format("asf", (".asf",), is_asf, "keypose.io.acclaim:read", "keypose.io.acclaim:write"))
register(Format("amc", (".amc",), is_amc, "keypose.io.acclaim:read", "keypose.io.acclaim:write"))
register(
    Format("collada", (".dae",), _is_collada, "keypose.io.collada:read", "keypose.io.collada:write", skins=(".dae",))
)
register(
    Format(
        "usd",
        (".usd", ".usda", ".usdc", ".usdz"),
        _is_usd,
        "keypose.io.usd:read",
        "keypose.io.usd:write",
        skins=(".usd", ".usda", ".usdc", ".usdz"),
    ),
)
register(Format("makehuman", (".mhskel",), _is_makehuman, "keypose.io.makehuman:read"))
register(Format("c3d", (".c3d",), _is_c3d, "keypose.io.c3d:read", "keypose.io.c3d:write"))
register(Format("trc", (".trc",), _is_trc, "keypose.io.trc:read", "keypose.io.trc:write"))
register(Format("csm", (".csm",), _is_csm, "keypose.io.csm:read", "keypose.io.csm:write"))
register(Format("osim", (".osim",), _is_osim, "keypose.io.opensim:read_model"))
register(Format("opensim", (".mot", ".sto"), _is_opensim_table, "keypose.io.opensim:read_table"))
register(Format("obj", (".obj",), _is_obj, "keypose.io.obj:read", "keypose.io.obj:write"))
register(Format("livelink", (".csv",), _is_livelink, "keypose.io.livelink:read", "keypose.io.livelink:write"))
register(Format("textgrid", (".textgrid",), _is_textgrid, "keypose.io.textgrid:read", "keypose.io.textgrid:write"))
register(Format("hts", (".lab",), _no_mark, "keypose.io.labels:read"))
register(Format("npz", (".npz",), _is_npz, "keypose.io.arrays_npz:read", "keypose.io.arrays_npz:write"))
register(
    Format(
        "keypose",
        (".keypose",),
        _is_project,
        "keypose.io.native:read",
        "keypose.io.native:write",
        every_curve=True,
        skins=(".keypose",),
    )
)
register(
    Format(
        "safetensors",
        (".safetensors",),
        _is_safetensors,
        "keypose.io.arrays_safetensors:read",
        "keypose.io.arrays_safetensors:write",
    )
)


def formats() -> tuple[Format, ...]:
    """All known formats."""
    return tuple(_formats.values())


def format_of_content(head: bytes) -> Format | None:
    """The format whose mark the first bytes of a file carry."""
    return next((entry for entry in _formats.values() if entry.sniff(head)), None)


def format_of_suffix(path: Path) -> Format | None:
    """The format that a file name ends in."""
    suffix = path.suffix.lower()
    return next((entry for entry in _formats.values() if suffix in entry.suffixes), None)


def unknown_format(path: Path, *, writing: bool) -> FormatError:
    """The error for a file of no known kind; it names the kinds there are."""
    known = [s for entry in _formats.values() if entry.write or not writing for s in entry.suffixes]
    what = f"unknown suffix '{path.suffix}'" if path.suffix else "the name has no suffix"
    if not writing:
        what = f"not recognised by its content, and {what}"
    return FormatError(f"{what}; known: {' '.join(known)}", path=path)


def checked_options(function: Callable[..., Any], options: Mapping[str, Any], kind: str) -> Mapping[str, Any]:
    """``options`` themselves; raises `UnknownName` with the nearest name for one that ``function`` does not take."""
    parameters = inspect.signature(function).parameters.values()
    if any(p.kind is inspect.Parameter.VAR_KEYWORD for p in parameters):
        return options
    known: Iterable[str] = [p.name for p in parameters if p.kind is inspect.Parameter.KEYWORD_ONLY]
    for name in options:
        if name not in known:
            raise UnknownName(f"{kind} option", name, known)
    return options


def _function(reference: str) -> Callable[..., Any]:
    module, _, name = reference.partition(":")
    return getattr(importlib.import_module(module), name)
