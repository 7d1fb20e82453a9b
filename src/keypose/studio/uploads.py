"""Dropped files: unpacked into a temporary folder, opened, and the folder removed again."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any

from keypose.errors import FormatError, KeyposeError
from keypose.model import Scene
from keypose.studio.container import array, unpack

if TYPE_CHECKING:
    from keypose.studio.graphs import OpenedGraph

MOST_FILES = 2000

_COMPANIONS = {".bin", ".png", ".jpg", ".jpeg", ".webp", ".ktx2", ".txt", ".md", ".license", ".mtl"}
"""Suffixes of files that belong to another dropped file and are not opened by themselves."""


def safe_name(name: str) -> PurePosixPath:
    """The relative path of a dropped file, without anything that could lead out of a folder.

    Raises:
        FormatError: where nothing is left of the name.
    """
    parts = [
        re.sub(r'[\x00-\x1f<>:"|?*]', "_", part)[:150]
        for part in name.replace("\\", "/").split("/")
        if part not in ("", ".", "..")
    ]
    if not parts or len(parts) > 16:
        raise FormatError(f"a dropped file has no usable name: {name[:80]!r}")
    return PurePosixPath(*parts)


@dataclass(frozen=True, slots=True)
class Upload:
    """What came of dropped files: ``(name, scene)`` of each, graphs, and one line for each that failed."""

    scenes: list[tuple[str, Scene]] = field(default_factory=list[tuple[str, Scene]])
    graphs: list[OpenedGraph] = field(default_factory=list["OpenedGraph"])
    errors: list[str] = field(default_factory=list[str])


def open_upload(data: bytes, open_file: Callable[[Path], Scene], report: Callable[[str, float], None]) -> Upload:
    """Open the files of an upload container.

    Raises:
        FormatError: where the container itself is damaged.
    """
    header, body = unpack(data)
    files: Any = header.get("files")
    if header.get("type") != "upload" or not isinstance(files, list) or not 0 < len(files) <= MOST_FILES:
        raise FormatError(f"expected an upload of 1 to {MOST_FILES} files")
    result = Upload()
    with tempfile.TemporaryDirectory(prefix="keypose-") as folder:
        names: list[PurePosixPath] = []
        for entry in files:
            if (
                not isinstance(entry, dict)
                or not isinstance(entry.get("name"), str)
                or not isinstance(entry.get("bytes"), dict)
            ):
                raise FormatError("expected a name and bytes for each file of an upload")
            name = safe_name(entry["name"])
            path = Path(folder, name)
            try:
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(array(body, entry["bytes"]))
            except OSError as error:
                raise FormatError(f"'{name}' cannot be stored: {error.strerror}") from None
            names.append(name)
        wanted = [n for n in names if n.suffix.lower() not in _COMPANIONS] or names[:1]
        for count, name in enumerate(wanted):
            report(name.name, count / len(wanted))
            try:
                if name.suffix.lower() == ".json":
                    result.graphs.append(_open_graph(Path(folder, name)))
                else:
                    result.scenes.append((name.name, open_file(Path(folder, name))))
            except (KeyposeError, OSError, MemoryError) as error:
                result.errors.append((str(error) or f"{name}: too large").replace(f"{folder}/", ""))
    return result


def _open_graph(path: Path) -> OpenedGraph:
    """A dropped graph, built while what it needs is still there."""
    from keypose.studio.graphs import built, graph_file

    return built(graph_file(f"dropped:{path.name}", path, only_beside=True), path)
