"""USDZ packages: what is checked before the library sees one, and the pictures inside or beside a file.

Source: Pixar, "USDZ File Format Specification", version 1.3: a zip archive whose files are stored, not compressed.
"""

from __future__ import annotations

import zipfile
from pathlib import Path, PurePosixPath

from keypose.errors import FormatError

SUFFIXES = {"usda": (".usda", ".usd"), "usdc": (".usdc", ".usd"), "usdz": (".usdz",)}
MOST_FILES = 10_000
LARGEST_PICTURE = 64 << 20
_SIGNATURES = ((b"\x89PNG\r\n\x1a\n", "image/png"), (b"\xff\xd8\xff", "image/jpeg"))
_LAYERS = (".usd", ".usda", ".usdc")
_ENCRYPTED = 0x1


def encoding(path: Path) -> str:
    """What a file is, whatever its name: ``usda``, ``usdc`` or ``usdz``."""
    with path.open("rb") as file:
        head = file.read(8)
    return "usdz" if head[:4] == b"PK\x03\x04" else "usdc" if head == b"PXR-USDC" else "usda"


def check_package(path: Path) -> None:
    """Refuse a package that is no plain USDZ.

    Raises:
        FormatError: naming the file inside that is compressed, encrypted, larger than the package or outside of it.
    """
    size = path.stat().st_size
    entries = _entries(path)
    if not entries:
        raise FormatError("the package is empty", where="directory")
    if len(entries) > MOST_FILES:
        raise FormatError(f"the package holds {len(entries):,} files, more than {MOST_FILES:,}", where="directory")
    total = 0
    for entry in entries:
        where = f"'{entry.filename[:100]}'"
        if entry.compress_type != zipfile.ZIP_STORED:
            raise FormatError("it is compressed, which USDZ does not allow", where=where)
        if entry.flag_bits & _ENCRYPTED:
            raise FormatError("it is encrypted", where=where)
        parts = PurePosixPath(entry.filename).parts
        if not parts or ".." in parts or parts[0].startswith("/") or "\\" in entry.filename or ":" in parts[0]:
            raise FormatError("its name leads out of the package", where=where)
        total += entry.file_size
        if entry.file_size != entry.compress_size or total > size:
            raise FormatError(f"it claims {entry.file_size:,} bytes; the package has {size:,}", where=where)
    if PurePosixPath(entries[0].filename).suffix.lower() not in _LAYERS:
        raise FormatError("the first file of the package is no USD layer", where=f"'{entries[0].filename[:100]}'")


def picture(path: Path, resolved: str) -> tuple[str, bytes] | str:
    """Kind and bytes of a picture that a file names, or why there is none.

    ``resolved`` is its place as the library found it: a path, or ``package.usdz[name]``; empty where it found none.
    """
    if not resolved:
        return "is not there"
    package, bracket, inner = resolved.partition("[")
    try:
        if bracket:
            if Path(package).resolve() != path.resolve():
                return "lies in another package"
            data = _packed(path, inner.rstrip("]"))
        else:
            file = Path(resolved).resolve()
            if not file.is_relative_to(path.resolve().parent):
                return "leads out of the file's folder"
            if not file.is_file():
                return "is not there"
            data = file.read_bytes() if file.stat().st_size <= LARGEST_PICTURE else None
    except (OSError, ValueError, FormatError):
        return "cannot be read"
    if data is None:
        return f"is larger than {LARGEST_PICTURE >> 20} MiB"
    kind = next((mime for mark, mime in _SIGNATURES if data.startswith(mark)), "")
    return (kind, data) if kind else "is neither PNG nor JPEG"


def _packed(path: Path, name: str) -> bytes | None:
    for entry in _entries(path):
        if entry.filename == name and entry.compress_type == zipfile.ZIP_STORED:
            if entry.file_size > LARGEST_PICTURE:
                return None
            try:
                with zipfile.ZipFile(path) as archive:
                    return archive.read(entry)
            except (zipfile.BadZipFile, NotImplementedError, RuntimeError, EOFError) as error:
                raise FormatError(str(error), where=name) from None
    raise FormatError("is not there", where=name)


def _entries(path: Path) -> list[zipfile.ZipInfo]:
    try:
        with zipfile.ZipFile(path) as archive:
            return archive.infolist()
    except (zipfile.BadZipFile, NotImplementedError, ValueError, EOFError, UnicodeDecodeError) as error:
        raise FormatError(f"the package's directory is damaged ({error})", where="directory") from None
