"""Bytes of a glTF file: GLB chunks, embedded data, and files beside it.

Source: glTF 2.0 Specification, section 4 (GLB file format) and 2.8 (URIs).
"""

from __future__ import annotations

import binascii
import re
import struct
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import unquote_to_bytes

from keypose.errors import FormatError
from keypose.io.notes import Notes

MAGIC = b"glTF"
JSON_CHUNK = 0x4E4F534A
BIN_CHUNK = 0x004E4942


@dataclass(frozen=True, slots=True)
class Container:
    """The parts of one file: its JSON text, the binary chunk (of a GLB) and the folder of its other files."""

    json: bytes
    chunk: memoryview | None
    folder: Path


def open_container(path: Path, notes: Notes) -> Container:
    """The parts of a .glb or .gltf file; which of the two it is, is seen from its first bytes.

    Raises:
        FormatError: where a GLB's header or chunks are damaged, or the file is empty.
    """
    data = path.read_bytes()
    folder = path.resolve().parent
    if data[:4] != MAGIC:
        if not data[:4096].removeprefix(b"\xef\xbb\xbf").lstrip().startswith(b"{"):
            what = "is neither GLB, which starts with 'glTF', nor JSON" if data.strip() else "is empty"
            raise FormatError(f"the file {what}", where="byte 0")
        return Container(data, None, folder)
    if len(data) < 12:
        raise FormatError("the GLB header is cut off", where=f"byte {len(data)}")
    _, version, length = struct.unpack_from("<4sII", data)
    if version != 2:
        raise FormatError(f"expected GLB version 2, got {version}", where="byte 4")
    if length > len(data):
        raise FormatError(f"the file is cut off: expected {length} bytes, got {len(data)}", where=f"byte {len(data)}")
    if length < len(data):
        notes.add(f"{len(data) - length} bytes after the end of the GLB were ignored")
    json, chunk = None, None
    view = memoryview(data)[:length]
    offset = 12
    while offset < length:
        if offset + 8 > length:
            raise FormatError("a chunk header is cut off", where=f"byte {offset}")
        size, kind = struct.unpack_from("<II", view, offset)
        start = offset + 8
        if start + size > length:
            raise FormatError(
                f"a chunk of {size} bytes does not fit; {length - start} bytes are left", where=f"byte {offset}"
            )
        if json is None:
            if kind != JSON_CHUNK:
                raise FormatError("expected the JSON chunk first", where=f"byte {offset}")
            json = bytes(view[start : start + size])
        elif kind == BIN_CHUNK and chunk is None:
            chunk = view[start : start + size]
        offset = start + size
    if json is None:
        raise FormatError("the JSON chunk is missing", where="byte 12")
    return Container(json, chunk, folder)


_DATA_URI = re.compile(r"data:(?P<type>[^;,]*)(?:;[^;,]*)*?(?P<base64>;base64)?,", re.IGNORECASE)
_SCHEME = re.compile(r"[A-Za-z][A-Za-z0-9+.\-]+:")


def is_data_uri(uri: str) -> bool:
    """Whether the bytes are in the URI itself."""
    return uri[:5].lower() == "data:"


def decode_data_uri(uri: str, where: str) -> tuple[str, bytes]:
    """Media type and bytes of a ``data:`` URI; raises `FormatError` where it is malformed."""
    head = _DATA_URI.match(uri[:1024])
    if head is None:
        raise FormatError("the data URI has no comma", where=where)
    body = uri[head.end() :]
    if head["base64"] is None:
        return head["type"], unquote_to_bytes(body)
    try:
        raw = unquote_to_bytes(body) if "%" in body else body.encode("ascii")
        raw = raw.translate(None, b" \t\r\n").rstrip(b"=")
        return head["type"], binascii.a2b_base64(raw + b"=" * (-len(raw) % 4), strict_mode=True)
    except (ValueError, binascii.Error) as error:
        raise FormatError(f"the base64 data is malformed: {error}", where=where) from None


def resolve(folder: Path, uri: str, where: str) -> Path:
    """The file a relative URI names; raises `FormatError` for anything outside the file's own folder."""
    if _SCHEME.match(uri) or uri.startswith("//"):
        raise FormatError(f"'{_shown(uri)}' is not fetched; only files beside the glTF are read", where=where)
    try:
        name = unquote_to_bytes(uri.split("?")[0].split("#")[0]).decode("utf-8").replace("\\", "/")
    except UnicodeDecodeError:
        raise FormatError(f"'{_shown(uri)}' is no UTF-8 file name", where=where) from None
    if not name or "\0" in name:
        raise FormatError(f"'{_shown(uri)}' names no file", where=where)
    try:
        path = (folder / name).resolve()
        inside = not name.startswith("/") and path.is_relative_to(folder.resolve())
    except (OSError, RuntimeError, ValueError):
        raise FormatError(f"'{_shown(uri)}' names no file", where=where) from None
    if not inside:
        raise FormatError(f"'{_shown(uri)}' lies outside the folder of the glTF; it is not read", where=where)
    return path


def read_beside(folder: Path, uri: str, limit: int, where: str) -> bytes | None:
    """Up to ``limit`` bytes of the file a relative URI names; None where there is no such file."""
    path = resolve(folder, uri, where)
    try:
        if not path.is_file():
            return None
        with path.open("rb") as file:
            return file.read(limit)
    except OSError as error:
        raise FormatError(f"'{_shown(uri)}' cannot be read: {error.strerror}", where=where) from None


def _shown(uri: str) -> str:
    return uri if len(uri) <= 60 else uri[:57] + "..."
