"""The parameter section of C3D files: named groups of named values, from bytes and to bytes.

Source: The C3D File Format, A Technical User Guide (Motion Lab Systems, 2021), chapter "The Parameter Section".
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, TypeAlias

import numpy as np

from keypose.arrays import Array
from keypose.errors import FormatError

Kind: TypeAlias = Literal["char", "byte", "int", "float"]

BLOCK = 512
INTEL, DEC, MIPS = 84, 85, 86
PROCESSORS = {INTEL: "Intel", DEC: "DEC", MIPS: "MIPS"}

_KINDS: dict[int, Kind] = {-1: "char", 1: "byte", 2: "int", 4: "float"}
_TYPES: dict[str, int] = {kind: code for code, kind in _KINDS.items()}
_MOST_STRINGS = 200_000
_MOST_RECORDS = 20_000
_MOST_NOTES = 8


@dataclass(frozen=True, slots=True, eq=False)
class Parameter:
    """One parameter as the file has it: ``values`` in file order (the first of ``dims`` runs fastest).

    Shapes and units: ``values`` is a tuple of strings without their padding for kind "char" (``dims`` then begins with
    their length), else an array (N,) of int16, int8 or float32.
    """

    kind: Kind
    dims: tuple[int, ...]
    values: Any
    description: str = ""
    locked: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Group:
    """A named group of parameters; names are upper case, for C3D does not tell cases apart."""

    parameters: Mapping[str, Parameter]
    description: str = ""
    locked: bool = False


Groups: TypeAlias = dict[str, Group]


def floats(data: bytes | memoryview, processor: int) -> Array:
    """float32 of the bytes of another processor's floats, (N,)."""
    if processor == MIPS:
        return np.frombuffer(data, ">f4").astype(np.float32)
    if processor != DEC:
        return np.frombuffer(data, "<f4").astype(np.float32)
    halves = np.frombuffer(data, "<u2").reshape(-1, 2).astype(np.uint32)
    return dec_floats((halves[:, 0] << 16) | halves[:, 1])


def dec_floats(bits: Array) -> Array:
    """float32 of VAX F floats, given with their halves in IEEE's order; uint32 of any shape.

    The exponent of a VAX float is two larger than that of the same IEEE float; exponent 0 is the number 0.
    """
    exponent = bits & np.uint32(0x7F800000)
    return np.where(exponent > 0x01000000, bits - np.uint32(0x01000000), np.uint32(0)).view(np.float32)


def text(raw: bytes) -> str:
    """A string without its padding: UTF-8 where it is that, else Windows-1252."""
    raw = raw.split(b"\0", 1)[0].rstrip()
    try:
        return raw.decode("utf-8")
    except UnicodeDecodeError:
        return raw.decode("cp1252", "replace")


@dataclass(slots=True)
class _Draft:
    """A group while its parameters are collected."""

    name: str = ""
    description: str = ""
    locked: bool = False
    parameters: dict[str, Parameter] = field(default_factory=dict[str, Parameter])


def parse(data: bytes, start: int, limit: int, processor: int, notes: list[str]) -> Groups:
    """The groups of the parameter section that starts at byte ``start`` and ends before ``limit``.

    What cannot be understood is passed over and told in ``notes`` with its place: the numbers that the data section
    needs are in the header too.
    """
    reader = _Reader(data, min(limit, len(data)), processor, notes)
    return reader.groups(start + 4)


class _Reader:
    """Walks the records of the section."""

    def __init__(self, data: bytes, limit: int, processor: int, notes: list[str]) -> None:
        self.data, self.limit, self.processor, self.notes = data, limit, processor, notes
        self.order = ">" if processor == MIPS else "<"
        self.drafts: dict[int, _Draft] = {}
        self.faults = 0
        self.empty_strings = _MOST_STRINGS  # they cost no bytes in the file

    def groups(self, at: int) -> Groups:
        for _ in range(_MOST_RECORDS):
            if at + 2 > self.limit or self.data[at] == 0:
                break
            if not self.is_record(at):
                self.fault(f"byte {at}: no group or parameter begins here; the parameters behind it were not read")
                break
            following = self.record(at)
            if following <= at:
                break
            at = following
        found: Groups = {}
        for number, draft in self.drafts.items():
            name = draft.name or f"GROUP_{number}"
            if name in found:
                self.fault(f"two groups are called {name}; they were put together")
                draft.parameters = {**found[name].parameters, **draft.parameters}
            found[name] = Group(draft.parameters, draft.description, draft.locked)
        if self.faults > _MOST_NOTES:
            self.notes.append(f"{self.faults - _MOST_NOTES} more faults in the parameter section")
        return found

    def fault(self, note: str) -> None:
        self.faults += 1
        if self.faults <= _MOST_NOTES:
            self.notes.append(note)

    def is_record(self, at: int) -> bool:
        """Whether a record, or the section's end, can be at this byte."""
        if not 0 <= at < self.limit - 1:
            return False
        length = abs(int.from_bytes(self.data[at : at + 1], signed=True))
        if length == 0:
            return True
        name = self.data[at + 2 : at + 2 + length]
        return at + 4 + length <= self.limit and self.data[at + 1] != 0 and min(name) >= 32 and name.strip() != b""

    def record(self, at: int) -> int:
        """Read the record at a byte; the byte where the next one begins, or 0 after the last one."""
        length = int.from_bytes(self.data[at : at + 1], signed=True)
        number = int.from_bytes(self.data[at + 1 : at + 2], signed=True)
        name = text(self.data[at + 2 : at + 2 + abs(length)]).strip().upper()
        pointer = at + 2 + abs(length)
        (offset,) = struct.unpack_from(self.order + "H", self.data, pointer)
        draft = self.drafts.setdefault(abs(number), _Draft())
        if number < 0:
            draft.name, draft.locked = name, length < 0
            draft.description, end = self.description(pointer + 2)
        else:
            end = self.parameter(draft, name, length < 0, pointer, offset)
        if offset == 0:
            return 0
        if end > pointer + offset and not self.is_record(pointer + offset):
            self.fault(f"byte {pointer}: the way to the record behind {name} is wrong; followed its length instead")
            return end
        return pointer + offset

    def parameter(self, draft: _Draft, name: str, locked: bool, pointer: int, offset: int) -> int:
        """Read one parameter into its group; the byte behind it."""
        where = f"parameter {draft.name + ':' if draft.name else ''}{name}"
        at = pointer + 2
        if at + 2 > self.limit:
            self.fault(f"{where}: cut off at byte {self.limit}")
            return self.limit
        code, rank = struct.unpack_from("bB", self.data, at)
        dims = tuple(self.data[at + 2 : at + 2 + rank])
        at += 2 + rank
        kind = _KINDS.get(code)
        size = abs(code)
        for n in dims:
            size = min(size * n, 1 << 30)
        # the last record has no way to the next one; a wrong one is known by leading into this record
        leads_on = offset != 0 and self.is_record(pointer + offset)
        room = (pointer + offset if leads_on else self.limit) - at
        if kind is None or len(dims) < rank or size > max(room, 0):
            what = f"type {code}" if kind is None else f"{size} bytes of values where there is room for {max(room, 0)}"
            self.fault(f"byte {pointer}, {where}: {what}; its values were not read")
            draft.parameters.setdefault(name, Parameter(kind or "byte", (0,), ("",) if kind == "char" else _none(kind)))
            return at
        description, end = self.description(at + size)
        if name in draft.parameters:
            self.fault(f"{where} comes twice; the second one counts")
        values = self.values(kind, dims, self.data[at : at + size])
        draft.parameters[name] = Parameter(kind, dims, values, description, locked)
        return end

    def values(self, kind: Kind, dims: tuple[int, ...], raw: bytes) -> Any:
        if kind == "float":
            found = floats(raw, self.processor)
        elif kind == "int":
            found = np.frombuffer(raw, self.order + "i2").astype(np.int16)
        elif kind == "byte":
            found = np.frombuffer(raw, np.int8).copy()
        else:
            length = dims[0] if dims else 1
            if length == 0:
                count = 1
                for n in dims[1:]:
                    count = min(count * n, self.empty_strings)
                self.empty_strings -= count
                return ("",) * count
            return tuple(text(raw[i : i + length]) for i in range(0, len(raw), length))
        found.setflags(write=False)
        return found

    def description(self, at: int) -> tuple[str, int]:
        """The description whose length is at a byte, and the byte behind it; many files leave it out."""
        if at >= self.limit:
            return "", at
        end = at + 1 + self.data[at]
        return (text(self.data[at + 1 : end]), end) if end <= self.limit else ("", at + 1)


def _none(kind: Kind | None) -> Array:
    return np.zeros(0, {"float": np.float32, "int": np.int16}.get(kind or "", np.int8))


# --- what readers ask for ---------------------------------------------------------------------------------------------


def find(groups: Groups, group: str, name: str) -> Parameter | None:
    """A parameter, or none."""
    found = groups.get(group)
    return found.parameters.get(name) if found else None


def strings(groups: Groups, group: str, name: str) -> list[str]:
    """All strings of a parameter and of its continuations (LABELS, LABELS2, LABELS3, ...)."""
    found: list[str] = []
    number = 1
    while True:
        one = find(groups, group, name if number == 1 else f"{name}{number}")
        if one is None or one.kind != "char":
            return found
        found.extend(one.values)
        number += 1


def numbers(groups: Groups, group: str, name: str, *, unsigned: bool = False) -> Array | None:
    """The numbers of a parameter as float64 (N,), or none; int16 as unsigned if asked.

    Values that continue in NAME2, NAME3, ... are put together.
    """
    parts: list[Array] = []
    number = 1
    while True:
        one = find(groups, group, name if number == 1 else f"{name}{number}")
        if one is None or one.kind == "char":
            break
        values = one.values
        if unsigned and one.kind == "int":
            values = values.view(np.uint16)
        with np.errstate(all="ignore"):
            parts.append(values.astype(np.float64))
        number += 1
    return np.concatenate(parts) if parts else None


def number(groups: Groups, group: str, name: str, *, unsigned: bool = False) -> float | None:
    """The first number of a parameter where it is finite, or none."""
    found = numbers(groups, group, name, unsigned=unsigned)
    return float(found[0]) if found is not None and len(found) and np.isfinite(found[0]) else None


# --- making parameters ------------------------------------------------------------------------------------------------


def ints(values: Sequence[int], dims: tuple[int, ...] | None = None, description: str = "") -> Parameter:
    """An int16 parameter; values up to 65535 are stored in their 16 bits. One value without ``dims`` is a scalar."""
    array = np.asarray(values, np.int64).astype(np.uint16).view(np.int16)
    return Parameter("int", (len(array),) if dims is None else dims, array, description)


def reals(values: Any, dims: tuple[int, ...] | None = None, description: str = "") -> Parameter:
    """A float32 parameter."""
    with np.errstate(over="ignore"):
        array = np.asarray(values, np.float64).reshape(-1).astype(np.float32)
    return Parameter("float", (len(array),) if dims is None else dims, array, description)


def chars(values: Sequence[str], *, scalar: bool = False, shortest: int = 1, description: str = "") -> Parameter:
    """A parameter of strings, as long as the longest of them (255 bytes at most)."""
    length = min(max([shortest, *(len(v.encode()) for v in values)]), 255)
    return Parameter("char", (length,) if scalar else (length, len(values)), tuple(values), description)


def compose(groups: Groups) -> bytes:
    """The parameter section in Intel's order, in whole blocks.

    Raises:
        FormatError: where a group or parameter does not fit the format's fields.
    """
    if len(groups) > 127:
        raise FormatError(f"{len(groups)} groups of parameters; C3D holds 127")
    records: list[tuple[bytes, bytes]] = []  # before and behind the way to the next record
    for number, (name, group) in enumerate(groups.items(), 1):
        description = _cut(group.description, 255)
        records.append((_name(name, group.locked, -number), bytes([len(description)]) + description))
        for own, parameter in group.parameters.items():
            where = f"parameter {name}:{own}"
            records.append((_name(own, parameter.locked, number), _content(parameter, where)))
    pieces = [b"\0\0\0\0"]
    for head, body in records:
        pieces += [head, struct.pack("<H", 2 + len(body)), body]
    section = b"".join([*pieces, b"\0\0"])
    blocks = -(-len(section) // BLOCK)
    section = section.ljust(blocks * BLOCK, b"\0")
    # byte 3 counts the blocks; where it is too small readers go by the way from record to record
    return bytes([1, 0x50, min(blocks, 255), INTEL]) + section[4:]


def _name(name: str, locked: bool, number: int) -> bytes:
    raw = _cut(name, 127) or b"_"
    return struct.pack("bb", -len(raw) if locked else len(raw), number) + raw


def _content(parameter: Parameter, where: str) -> bytes:
    if len(parameter.dims) > 255 or any(n > 255 for n in parameter.dims):
        raise FormatError(f"{where}: dimensions {parameter.dims}; C3D holds up to 255 in each")
    if parameter.kind == "char":
        length = parameter.dims[0] if parameter.dims else 1
        raw = b"".join(_cut(value, length).ljust(length) for value in parameter.values) if length else b""
    elif parameter.kind == "float":
        raw = np.asarray(parameter.values, "<f4").tobytes()
    elif parameter.kind == "int":
        raw = np.asarray(parameter.values, "<i2").tobytes()
    else:
        raw = np.asarray(parameter.values, np.int8).tobytes()
    size = abs(_TYPES[parameter.kind])
    for n in parameter.dims:
        size *= n
    if len(raw) != size or size > 65000:
        raise FormatError(f"{where}: {len(raw)} bytes of values; its dimensions {parameter.dims} ask for {size}")
    description = _cut(parameter.description, 255)
    head = struct.pack("bB", _TYPES[parameter.kind], len(parameter.dims)) + bytes(parameter.dims)
    return head + raw + bytes([len(description)]) + description


def _cut(value: str, length: int) -> bytes:
    """UTF-8 of at most ``length`` bytes, cut between characters."""
    raw = value.encode()
    return raw if len(raw) <= length else raw[:length].decode("utf-8", "ignore").encode()
