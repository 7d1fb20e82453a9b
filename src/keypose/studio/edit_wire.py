"""The project in the editor's messages, and a page's edits out of their containers, with everything checked."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from keypose.arrays import Array
from keypose.errors import FormatError, KeyposeError
from keypose.io import native_values as values
from keypose.io.json_values import Json
from keypose.model import Channel, Clip, Document
from keypose.project.commands import PAGE_KINDS, Command, read_command
from keypose.project.document import Difference
from keypose.studio import edit_messages as messages
from keypose.studio.container import Body, unpack

EDIT_LIMIT_BYTES = 256 * 1024 * 1024
MOST_COMMANDS = 20_000
LONGEST_LABEL = 200

_TYPES = {"float64": np.dtype("<f8"), "uint8": np.dtype("u1"), "uint32": np.dtype("<u4")}
"""Elements that an edit may hold."""


# ---- to the page -------------------------------------------------------------------------------------------------------


def storing(body: Body) -> values.Store:
    """Puts arrays into a body: numbers in double precision, so that they survive exactly; bytes as bytes."""
    return lambda array: body.add(array, "uint8" if array.dtype == np.uint8 else "float64")


def project_clip(clip: Clip, store: values.Store) -> messages.ProjectClip:
    """A whole clip."""
    return messages.ProjectClip(**values.clip_json(clip, store))


def difference_fields(found: Difference, store: values.Store) -> dict[str, Any]:
    """The fields of `ProjectChanged` that say what changed."""
    return {
        "clips": [
            messages.ClipChange(
                name=change.clip.name,
                rate_hz=change.clip.rate_hz,
                euler_orders=dict(change.clip.euler_orders),
                curves=[values.curve_json(channel, curve, store) for channel, curve in change.curves.items()],  # type: ignore[misc]
                removed=[messages.ChannelData(**values.channel_json(channel)) for channel in change.removed],
            )
            for change in found.clips
        ],
        "removed_clips": list(found.removed_clips),
        "timelines": [values.timeline_json(timeline, store) for timeline in found.timelines],
        "removed_timelines": list(found.removed_timelines),
        "poses": [values.pose_json(pose) for pose in found.poses],
        "removed_poses": list(found.removed_poses),
    }


def document_fields(document: Document, store: values.Store) -> dict[str, Any]:
    """The fields of `ProjectState` that hold the document, less its characters."""
    return {
        "clips": [project_clip(clip, store) for clip in document.clips.values()],
        "timelines": [values.timeline_json(timeline, store) for timeline in document.timelines.values()],
        "poses": [values.pose_json(pose) for pose in document.poses.values()],
        "settings": dict(document.settings),
    }


# ---- from the page -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class Edit:
    """A checked `EditRequest`."""

    id: str
    label: str
    merge: str
    commands: tuple[Command, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Operation:
    """A checked `OperateRequest`; ``keys`` holds a channel's selected keys, None for all."""

    id: str
    operator: str
    clip: str
    character: str
    keys: dict[Channel, Array | None]
    start_s: float | None
    end_s: float | None
    parameters: dict[str, Any]


def read_edit(data: bytes) -> Edit:
    """An edit; raises `FormatError` naming the field that is wrong."""
    header, fetch = opened(data, "edit")
    commands = header.items("commands")
    if not 0 < len(commands) <= MOST_COMMANDS:
        header.fail(f"expected 1 to {MOST_COMMANDS} commands, got {len(commands)}")
    return Edit(
        _short(header, "id"),
        _short(header, "label"),
        _short(header, "merge"),
        tuple(read_command(command, fetch, PAGE_KINDS) for command in commands),
    )


def read_operation(data: bytes) -> Operation:
    """A request to run an operator; raises `FormatError` naming the field that is wrong."""
    header, fetch = opened(data, "operate")
    keys: dict[Channel, Array | None] = {}
    for each in header.items("channels"):
        chosen = each.get("keys")
        indices = None if chosen is None or chosen.value is None else fetch(chosen)
        if indices is not None and (
            indices.dtype != np.uint32 or indices.ndim != 1 or np.any(indices[1:] <= indices[:-1])
        ):
            each.fail("keys: expected rising indices (N,) uint32")
        keys[values.read_channel(each.need("channel"))] = indices
    return Operation(
        _short(header, "id"),
        _short(header, "operator"),
        header.text("clip"),
        header.text("character"),
        keys,
        values.maybe_number(header, "start_s"),
        values.maybe_number(header, "end_s"),
        {name: _parameter(value) for name, value in header.members("parameters")},
    )


def opened(data: bytes, kind: str) -> tuple[Json, values.Fetch]:
    """Header and arrays of a page's container; raises `FormatError` where it is damaged or of another kind."""
    fields, body = unpack(data)
    try:
        json.dumps(fields, ensure_ascii=False).encode()
    except UnicodeEncodeError:
        raise FormatError("a text holds half of a character (a lone surrogate)", where="byte 8") from None
    header = Json(fields, "")
    if header.text("type") != kind:
        header.fail(f"expected a container of type '{kind}'")
    return header, _fetching(body)


def _fetching(body: memoryview) -> Callable[[Json], Array]:
    """Takes arrays out of a body; what does not fit its bytes or is not finite is refused."""

    def fetch(ref: Json) -> Array:
        element = ref.text("element")
        if element not in _TYPES:
            ref.fail(f"expected {', '.join(_TYPES)}, got {element[:20]!r}")
        dtype = _TYPES[element]
        shape = tuple(n.as_integer() for n in ref.items("shape"))
        if not 0 < len(shape) <= 3:
            ref.fail(f"expected 1 to 3 dimensions, got {len(shape)}")
        offset, size = ref.integer("offset"), ref.integer("bytes")
        count = 1
        for n in shape:
            count *= n
        if count * dtype.itemsize != size:
            ref.fail(f"{size} bytes for {count} numbers of {dtype.itemsize} bytes")
        if offset + size > len(body):
            ref.fail(f"its bytes {offset} to {offset + size} are beyond the {len(body)} that are there")
        array = np.frombuffer(body[offset : offset + size], dtype).reshape(shape)
        if element == "float64" and not np.all(np.isfinite(array)):
            ref.fail("expected finite numbers")
        return array

    return fetch


def _short(header: Json, key: str) -> str:
    text = header.text(key)
    if len(text) > LONGEST_LABEL:
        header.need(key).fail(f"{len(text)} characters; at most {LONGEST_LABEL}")
    return text


def _parameter(value: Json) -> str | float | bool | list[float]:
    if isinstance(value.value, (str, bool)):
        return value.value
    if isinstance(value.value, list):
        return list(Json({"list": value.value}, value.where).numbers("list", None) or ())
    return value.as_number()


def complaint(error: Exception) -> str:
    """What is told of an error, in whole characters."""
    if isinstance(error, MemoryError):
        return "too large"
    text = str(error) if isinstance(error, KeyposeError) else f"{type(error).__name__}: {error}"
    return text.encode("utf-8", "replace").decode()
