"""The journal: every edit of a project that is not saved yet, so that none is lost when the studio ends without warning.

A journal begins with the whole document and goes on with one record per edit, undo and redo. A record is its length, the
CRC-32 of its payload, and the payload: a safetensors block whose metadata has the fields as JSON under ``record``. The first
record that is cut off or damaged ends a journal; everything before it counts.
"""

from __future__ import annotations

import contextlib
import hashlib
import struct
import threading
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from keypose.arrays import Array
from keypose.errors import FormatError
from keypose.io.json_values import Json, parse_json
from keypose.io.native import Storing, document_bytes, document_from_bytes, fetching, json_text
from keypose.io.tensors import pack_tensors, unpack_tensors
from keypose.model import Document
from keypose.project.commands import Command, apply_all, read_command
from keypose.project.disk import Disk, write_whole
from keypose.project.history import History

MAGIC = b"keypose journal 1\n"
SUFFIX = ".journal"
_HEAD = struct.Struct("<II")


# ---- records -----------------------------------------------------------------------------------------------------------


def begin_record(document: Document, path: str, saved: str, at_s: float) -> bytes:
    """The first record: the document as it is, where it is saved, and the digest of what is saved there."""
    return _snapshot({"kind": "begin", "path": path, "saved": saved, "at_s": at_s, "name": document.name}, document)


def edit_record(commands: Sequence[Command], label: str, merge: str, at_s: float) -> bytes:
    """An edit."""
    store = Storing()
    fields = {
        "kind": "edit",
        "label": label,
        "merge": merge,
        "at_s": at_s,
        "commands": [command.to_json(store) for command in commands],
    }
    return _framed(fields, store.arrays)


def move_record(kind: str) -> bytes:
    """``undo`` or ``redo``."""
    return _framed({"kind": kind}, {})


def document_record(document: Document, label: str, at_s: float) -> bytes:
    """A step whose other side lies before the journal's beginning: the document it leads to."""
    return _snapshot({"kind": "document", "label": label, "at_s": at_s}, document)


def saving_record(digest: str, path: str) -> bytes:
    """The document is about to be saved: where the file has this digest, nothing is left to recover."""
    return _framed({"kind": "saving", "digest": digest, "path": path}, {})


def digest_of(data: bytes) -> str:
    """What files are told apart by."""
    return hashlib.sha256(data).hexdigest()


def _snapshot(fields: dict[str, Any], document: Document) -> bytes:
    return _framed(fields, {"document": np.frombuffer(document_bytes(document), np.uint8)})


def _framed(fields: dict[str, Any], arrays: Mapping[str, Array]) -> bytes:
    payload = pack_tensors(arrays, {"record": json_text(fields)})
    if len(payload) >= 1 << 32:
        raise FormatError(f"an edit of {len(payload) >> 20} MiB; at most 4096 MiB can be kept")
    return _HEAD.pack(len(payload), zlib.crc32(payload)) + payload


# ---- writing -----------------------------------------------------------------------------------------------------------


class Journal:
    """A journal that is being written. `write` hands a record to the system, `sync` waits until it cannot be lost.

    One that was found is cut to its good ``size`` and goes on from there; ``safe`` says that so much survives already.
    """

    def __init__(self, disk: Disk, path: Path, size: int, *, safe: bool = False) -> None:
        self.path = path
        self.broken = False
        """Whether something failed, so that a new journal has to take its place."""
        self._disk = disk
        self._handle: int | None = disk.reopen(path, size)
        self._size, self._synced = size, size if safe else 0
        self._syncing = threading.Lock()

    @classmethod
    def create(cls, disk: Disk, path: Path, records: Sequence[bytes]) -> Journal:
        """A journal of these records, the first its beginning; it is there whole or not at all, and safe on return."""
        data = b"".join([MAGIC, *records])
        write_whole(disk, path, data, 0o600)
        return cls(disk, path, len(data), safe=True)

    @property
    def size(self) -> int:
        """In bytes."""
        return self._size

    def write(self, record: bytes) -> None:
        """Append a record. After a failure the journal is `broken`: what would follow would follow on something missing."""
        if self._handle is None or self.broken:
            raise OSError("the journal is closed")
        try:
            self._disk.write(self._handle, record)
        except BaseException:
            self.broken = True
            raise
        self._size += len(record)

    def sync(self) -> None:
        """Return when all that was written before survives; calls that wait together share one wait."""
        wanted = self._size
        with self._syncing:
            if self._synced >= wanted or self._handle is None:
                return
            reached = self._size
            try:
                self._disk.sync(self._handle)
            except BaseException:
                self.broken = True  # what the system has forgotten cannot be known
                raise
            self._synced = reached

    def close(self) -> None:
        """Write no more; the file stays."""
        with self._syncing:
            if self._handle is not None:
                with contextlib.suppress(OSError):
                    self._disk.close(self._handle)
                self._handle = None

    def remove(self) -> None:
        """Nobody needs it any more."""
        self.close()
        self._disk.remove(self.path)


# ---- reading -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class Record:
    """A record: its fields and arrays."""

    fields: Json
    arrays: Mapping[str, Array]

    @property
    def kind(self) -> str:
        """What it records."""
        return self.fields.text("kind")


@dataclass(frozen=True, slots=True, eq=False)
class Journaled:
    """What a journal holds: its beginning, what came after, and how many of its bytes are good."""

    begin: Record
    records: tuple[Record, ...]
    size: int

    @property
    def path(self) -> str:
        """Where the project was saved; empty for one that never was."""
        return self.begin.fields.text("path")

    @property
    def saved(self) -> str:
        """The digest of what was saved there."""
        return self.begin.fields.text("saved")

    @property
    def edits(self) -> int:
        """How many edits, undos and redos there are."""
        return sum(record.kind != "saving" for record in self.records)


def read_journal(data: bytes) -> Journaled:
    """A journal up to its first record that is cut off or damaged.

    Raises:
        FormatError: where it is none, or nothing of it can be used.
    """
    if not data.startswith(MAGIC):
        raise FormatError("no journal of keypose, or one of another version", where="byte 0")
    records: list[Record] = []
    at = len(MAGIC)
    while at + _HEAD.size <= len(data):
        length, check = _HEAD.unpack_from(data, at)
        end = at + _HEAD.size + length
        if end > len(data):
            break
        payload = memoryview(data)[at + _HEAD.size : end]
        if zlib.crc32(payload) != check:
            break
        arrays, metadata = unpack_tensors(payload)
        text = metadata.get("record")
        if not isinstance(text, str):
            break
        records.append(Record(parse_json(text.encode("utf-8", "surrogatepass")), arrays))
        at = end
    if not records or records[0].kind != "begin":
        raise FormatError("the journal has no beginning", where=f"byte {len(MAGIC)}")
    return Journaled(records[0], tuple(records[1:]), at)


def replay(journaled: Journaled) -> History:
    """The history that a journal holds, from its beginning.

    Raises:
        FormatError: where its document is damaged or an edit cannot be applied; names the place.
    """
    history = History(_document(journaled.begin))
    for record in journaled.records:
        fields = record.fields
        match record.kind:
            case "edit":
                fetch = fetching(record.arrays)
                commands = [read_command(item, fetch) for item in fields.items("commands")]
                document = apply_all(history.document, commands)
                at_s = fields.need("at_s").as_number()
                history.do(document, fields.text("label"), merge=fields.text("merge"), at_s=at_s)
            case "document":
                history.do(_document(record), fields.text("label"), at_s=fields.need("at_s").as_number())
            case "undo":
                history.undo()
            case "redo":
                history.redo()
            case "saving":
                pass
            case other:
                raise FormatError(f"the journal was written by a newer keypose: it has a record '{other[:40]}'")
    return history


def _document(record: Record) -> Document:
    if "document" not in record.arrays:
        raise FormatError("the journal holds no document", where="document")
    return document_from_bytes(record.arrays["document"].tobytes())
