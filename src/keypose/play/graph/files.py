"""Graphs as JSON: a plain mirror of the definition, with a version; wrong files are refused with the place that is wrong."""

from __future__ import annotations

import json
import math
import types
import typing
from collections.abc import Mapping
from dataclasses import MISSING, fields, is_dataclass
from functools import cache
from os import PathLike, fspath
from pathlib import Path
from typing import Any, Literal, Union, get_args, get_origin

from keypose.errors import FormatError, UnknownName
from keypose.play.graph.checking import GraphError, check
from keypose.play.graph.definition import FORMAT, KINDS, VERSION, Graph, Node

LARGEST_BYTES = 16 << 20
_NAMES = {kind: name for name, kind in KINDS.items()}


def to_json(graph: Graph) -> str:
    """The graph as JSON text; fields at their default are left out."""
    return json.dumps({"format": FORMAT, "version": VERSION, **_encoded(graph)}, indent=1, allow_nan=False) + "\n"


def from_json(text: str | bytes) -> Graph:
    """The graph of a JSON text, checked.

    Raises:
        FormatError: where the text is no graph, its version is unknown or its definition is wrong; the message names
            the node and the field.
    """
    if len(text) > LARGEST_BYTES:
        raise FormatError(f"expected a graph of at most {LARGEST_BYTES >> 20} MiB")
    try:
        data = json.loads(text, parse_constant=_no_constant, object_pairs_hook=_once)
    except (ValueError, RecursionError) as error:
        line = f"line {error.lineno}" if isinstance(error, json.JSONDecodeError) else ""
        what = error.msg if isinstance(error, json.JSONDecodeError) else str(error)
        raise FormatError(f"no JSON: {what}", where=line) from None
    if not isinstance(data, dict) or data.get("format") != FORMAT:
        raise FormatError(f'expected an object with "format": "{FORMAT}"', where="format")
    if data.get("version") != VERSION:
        raise FormatError(f"expected version {VERSION}, got {data.get('version')!r}", where="version")
    body = {key: value for key, value in data.items() if key not in ("format", "version")}
    try:
        graph = _decoded(body, Graph, "")
    except RecursionError:
        raise FormatError("nested too deeply") from None
    try:
        check(graph)
    except GraphError as error:
        raise FormatError(str(error)) from None
    return graph


def save(graph: Graph, path: str | PathLike[str]) -> None:
    """Write a graph file (through a temporary file beside it); raises `GraphError` where the definition is wrong."""
    check(graph)
    target = Path(fspath(path))
    part = target.with_name(f".{target.name}.part")
    try:
        part.write_text(to_json(graph), encoding="utf-8")
        part.replace(target)
    finally:
        part.unlink(missing_ok=True)


def load(path: str | PathLike[str]) -> Graph:
    """Read a graph file; raises `FormatError` naming file, node and field."""
    source = Path(fspath(path))
    try:
        with source.open("rb") as file:
            data = file.read(LARGEST_BYTES + 1)
    except OSError as error:
        raise FormatError(error.strerror or "cannot be read", path=path) from None
    try:
        return from_json(data)
    except FormatError as error:
        raise error.at(path) from None


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """JSON lets a name appear twice and the last one win; here a node would be lost silently."""
    found = dict(pairs)
    if len(found) < len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"'{twice}' appears twice in one object")
    return found


def _no_constant(name: str) -> float:
    raise ValueError(f"{name} is no number of JSON")


# --- encoding -----------------------------------------------------------------------------------------------------------


def _encoded(value: Any) -> Any:
    if is_dataclass(value):
        record: dict[str, Any] = {"kind": _NAMES[type(value)]} if type(value) in _NAMES else {}
        for f in fields(value):
            item = getattr(value, f.name)
            default = f.default if f.default is not MISSING else {} if f.default_factory is not MISSING else MISSING
            if default is MISSING or item != default or type(item) is not type(default):
                record[f.name] = _encoded(item)
        return record
    if isinstance(value, Mapping):
        return {str(key): _encoded(item) for key, item in value.items()}
    if isinstance(value, tuple):
        return [_encoded(item) for item in value]
    return value


# --- decoding -----------------------------------------------------------------------------------------------------------


@cache
def _hints(kind: type[Any]) -> dict[str, Any]:
    return typing.get_type_hints(kind)


def _decoded(value: Any, kind: Any, where: str) -> Any:
    if kind == Node:
        if not isinstance(value, dict) or not isinstance(value.get("kind"), str):
            raise FormatError('expected an object with a "kind"', where=where)
        if value["kind"] not in KINDS:
            raise FormatError(str(UnknownName("kind of node", value["kind"], KINDS)), where=where)
        rest = {key: item for key, item in value.items() if key != "kind"}
        return _record(rest, KINDS[value["kind"]], where)
    if is_dataclass(kind):
        return _record(value, typing.cast("type[Any]", kind), where)
    origin = get_origin(kind)
    if origin in (Union, types.UnionType):
        return _union(value, get_args(kind), where)
    if origin is Literal:
        if value not in get_args(kind) or not isinstance(value, str):
            if isinstance(value, str):
                raise FormatError(str(UnknownName("choice", value, get_args(kind))), where=where)
            raise FormatError(f"expected one of {', '.join(map(repr, get_args(kind)))}", where=where)
        return value
    if origin is tuple:
        return _sequence(value, get_args(kind), where)
    if origin is not None and isinstance(origin, type) and issubclass(origin, Mapping):
        if not isinstance(value, dict):
            raise FormatError(f"expected an object, got {_shown(value)}", where=where)
        inner = get_args(kind)[1]
        return {key: _decoded(item, inner, _under(where, key)) for key, item in value.items()}
    return _plain(value, kind, where)


def _record(value: Any, kind: type[Any], where: str) -> Any:
    if not isinstance(value, dict):
        raise FormatError(f"expected an object, got {_shown(value)}", where=where)
    hints = _hints(kind)
    for key in value:
        if key not in hints:
            raise FormatError(str(UnknownName("field", key, hints)), where=where or "graph")
    found: dict[str, Any] = {}
    for f in fields(kind):
        if f.name in value:
            found[f.name] = _decoded(value[f.name], hints[f.name], f"{where}.{f.name}" if where else f.name)
        elif f.default is MISSING and f.default_factory is MISSING:
            raise FormatError(f"field '{f.name}' is missing", where=where or "graph")
    return kind(**found)


def _sequence(value: Any, inner: tuple[Any, ...], where: str) -> Any:
    if not isinstance(value, list):
        raise FormatError(f"expected a list, got {_shown(value)}", where=where)
    if len(inner) == 2 and inner[1] is Ellipsis:
        inner = (inner[0],) * len(value)
    if len(value) != len(inner):
        raise FormatError(f"expected {len(inner)} values, got {len(value)}", where=where)
    return tuple(_decoded(v, k, f"{where}[{i}]") for i, (v, k) in enumerate(zip(value, inner, strict=True)))


def _union(value: Any, kinds: tuple[Any, ...], where: str) -> Any:
    for kind in kinds:
        try:
            return _decoded(value, kind, where)
        except FormatError:
            continue
    expected = " or ".join(_words(kind) for kind in kinds)
    raise FormatError(f"expected {expected}, got {_shown(value)}", where=where)


def _plain(value: Any, kind: Any, where: str) -> Any:
    if kind is float and isinstance(value, (int, float)) and not isinstance(value, bool):
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        if math.isfinite(number):
            return number
        raise FormatError("the number is too large", where=where)
    if kind is int and isinstance(value, int) and not isinstance(value, bool) and abs(value) < 1 << 31:
        return value
    if kind in (bool, str) and isinstance(value, kind):
        return value
    if kind is type(None) and value is None:
        return None
    raise FormatError(f"expected {_words(kind)}, got {_shown(value)}", where=where)


def _words(kind: Any) -> str:
    if get_origin(kind) is tuple:
        return "a list"
    return {float: "a number", int: "a whole number", bool: "true or false", str: "a name", type(None): "null"}.get(
        kind, str(kind)
    )


def _shown(value: Any) -> str:
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= 40 else text[:37] + "..."


def _under(where: str, key: str) -> str:
    """``nodes['walk']`` reads as ``node 'walk'``: the place a person looks for."""
    return f"node '{key}'" if where == "nodes" else f"{where}['{key}']"
