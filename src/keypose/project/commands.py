"""Commands: what an edit does to a document, as values that can be written down and done again.

Each has ``kind``, its name in JSON, and ``apply``. Applying makes a new document; nothing is changed in place. A command
that cannot be applied raises a `KeyposeError` that says why.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cache
from types import MappingProxyType, UnionType
from typing import Any, ClassVar, Protocol, TypeVar, get_args, get_origin, get_type_hints

from keypose.errors import KeyposeError, ShapeError
from keypose.evaluate.performing import FILM_HZ
from keypose.io import native_values as values
from keypose.io.json_values import Json
from keypose.io.native_characters import character_json, read_character
from keypose.io.native_rigs import read_rig, rig_json
from keypose.io.native_values import Fetch, Store
from keypose.model import Channel, Character, Clip, Curve, Document, Motion, Placement, Rig, StoredPose, Timeline
from keypose.project.document import add_character, check, check_name, import_animation, renamed

_Item = TypeVar("_Item")


class Command(Protocol):
    """A change of a document."""

    kind: ClassVar[str]

    def apply(self, document: Document) -> Document:
        """The changed document; raises `KeyposeError` where this cannot be done."""
        ...

    def to_json(self, store: Store) -> dict[str, Any]:
        """The fields, arrays handed to ``store``."""
        ...


def _no_orders() -> Mapping[str, str]:
    return {}


@dataclass(frozen=True, slots=True, eq=False)
class SetCurves:
    """Put curves into a clip and take channels out of it; a clip that does not exist is made."""

    kind: ClassVar[str] = "set_curves"
    clip: str
    curves: Mapping[Channel, Curve]
    removed: tuple[Channel, ...] = ()
    euler_orders: Mapping[str, str] = field(default_factory=_no_orders)

    def __post_init__(self) -> None:
        object.__setattr__(self, "curves", MappingProxyType(dict(self.curves)))
        object.__setattr__(self, "euler_orders", MappingProxyType(dict(self.euler_orders)))

    def apply(self, document: Document) -> Document:
        """The document with the clip changed."""
        check_name(self.clip, "clip")
        clip = document.clips.get(self.clip) or Clip({}, self.clip, FILM_HZ)
        gone = set(self.removed)
        curves = {channel: curve for channel, curve in clip.curves.items() if channel not in gone} | dict(self.curves)
        orders = {**clip.euler_orders, **self.euler_orders}
        changed = replace(clip, curves=curves, euler_orders=orders)
        return replace(document, clips={**document.clips, self.clip: changed})

    def to_json(self, store: Store) -> dict[str, Any]:
        """The fields."""
        return {
            "kind": self.kind,
            "clip": self.clip,
            "curves": [values.curve_json(channel, curve, store) for channel, curve in self.curves.items()],
            "removed": [values.channel_json(channel) for channel in self.removed],
            "euler_orders": dict(self.euler_orders),
        }


@dataclass(frozen=True, slots=True, eq=False)
class _Removal:
    """What a command that takes something away says: its name."""

    kind: ClassVar[str]
    name: str

    def to_json(self, store: Store) -> dict[str, Any]:
        """The fields."""
        return {"kind": self.kind, "name": self.name}


@dataclass(frozen=True, slots=True, eq=False)
class SetClip:
    """Put a clip in place of the one of its name."""

    kind: ClassVar[str] = "set_clip"
    clip: Clip

    def apply(self, document: Document) -> Document:
        """The document with the clip."""
        check_name(self.clip.name, "clip")
        return replace(document, clips={**document.clips, self.clip.name: self.clip})

    def to_json(self, store: Store) -> dict[str, Any]:
        """The fields."""
        return {"kind": self.kind, "clip": values.clip_json(self.clip, store)}


@dataclass(frozen=True, slots=True, eq=False)
class RemoveClip(_Removal):
    """Remove a clip and its placements."""

    kind: ClassVar[str] = "remove_clip"

    def apply(self, document: Document) -> Document:
        """The document without the clip."""
        document.clip(self.name)
        clips = _without(document.clips, self.name)
        timelines = _placements(document, lambda p: None if p.animation == self.name else p)
        return replace(document, clips=clips, timelines=timelines)


@dataclass(frozen=True, slots=True, eq=False)
class SetTimeline:
    """Put a timeline in place of the one of its name."""

    kind: ClassVar[str] = "set_timeline"
    timeline: Timeline

    def apply(self, document: Document) -> Document:
        """The document with the timeline."""
        check_name(self.timeline.name, "timeline")
        return replace(document, timelines={**document.timelines, self.timeline.name: self.timeline})

    def to_json(self, store: Store) -> dict[str, Any]:
        """The fields."""
        return {"kind": self.kind, "timeline": values.timeline_json(self.timeline, store)}


@dataclass(frozen=True, slots=True, eq=False)
class RemoveTimeline(_Removal):
    """Remove a timeline; what it moved is moved by none."""

    kind: ClassVar[str] = "remove_timeline"

    def apply(self, document: Document) -> Document:
        """The document without the timeline."""
        document.timeline(self.name)
        timelines = _without(document.timelines, self.name)
        performs = {who: name for who, name in document.performs.items() if name != self.name}
        return replace(document, timelines=timelines, performs=performs)


@dataclass(frozen=True, slots=True, eq=False)
class SetPose:
    """Put a pose into the library, in place of the one of its name."""

    kind: ClassVar[str] = "set_pose"
    pose: StoredPose

    def apply(self, document: Document) -> Document:
        """The document with the pose."""
        check_name(self.pose.name, "pose")
        return replace(document, poses={**document.poses, self.pose.name: self.pose})

    def to_json(self, store: Store) -> dict[str, Any]:
        """The fields."""
        return {"kind": self.kind, "pose": values.pose_json(self.pose)}


@dataclass(frozen=True, slots=True, eq=False)
class RemovePose(_Removal):
    """Take a pose out of the library."""

    kind: ClassVar[str] = "remove_pose"

    def apply(self, document: Document) -> Document:
        """The document without the pose."""
        document.pose(self.name)
        return replace(document, poses=_without(document.poses, self.name))


@dataclass(frozen=True, slots=True, eq=False)
class SetRig:
    """Give a character a rig, in place of the one of its name."""

    kind: ClassVar[str] = "set_rig"
    rig: Rig

    def apply(self, document: Document) -> Document:
        """The document with the rig."""
        check_name(self.rig.name, "rig")
        document.character(self.rig.character)
        return replace(document, rigs={**document.rigs, self.rig.name: self.rig})

    def to_json(self, store: Store) -> dict[str, Any]:
        """The fields."""
        return {"kind": self.kind, "rig": rig_json(self.rig, store)}


@dataclass(frozen=True, slots=True, eq=False)
class RemoveRig(_Removal):
    """Take a rig off its character; keys on its controls stay in their clips and move nothing."""

    kind: ClassVar[str] = "remove_rig"

    def apply(self, document: Document) -> Document:
        """The document without the rig."""
        document.rig(self.name)
        return replace(document, rigs=_without(document.rigs, self.name))


@dataclass(frozen=True, slots=True, eq=False)
class SetPerformance:
    """Let a timeline move a character; none where ``timeline`` is empty."""

    kind: ClassVar[str] = "set_performance"
    character: str
    timeline: str

    def apply(self, document: Document) -> Document:
        """The document with the performance."""
        document.character(self.character)
        performs = _without(document.performs, self.character)
        if self.timeline:
            performs[self.character] = document.timeline(self.timeline).name
        return replace(document, performs=performs)

    def to_json(self, store: Store) -> dict[str, Any]:
        """The fields."""
        return {"kind": self.kind, "character": self.character, "timeline": self.timeline}


@dataclass(frozen=True, slots=True, eq=False)
class Rename:
    """Give a project, character, clip, timeline, pose or rig another name; whatever names it follows."""

    kind: ClassVar[str] = "rename"
    what: str
    name: str
    to: str

    def apply(self, document: Document) -> Document:
        """The document with the new name."""
        name, to = self.name, self.to
        if self.what == "project":
            check_name(to, "project")
            return replace(document, name=to)
        if self.what not in _KINDS:
            raise ShapeError(f"what: expected project, {', '.join(_KINDS)}, got {self.what[:40]!r}")
        mapping: Mapping[str, Any] = getattr(document, _KINDS[self.what])
        items = renamed(mapping, self.what, name, to)
        items[to] = replace(items[to], name=to)
        changes: dict[str, Any] = {_KINDS[self.what]: items}
        if self.what == "clip":
            changes["timelines"] = _placements(
                document, lambda p: replace(p, animation=to) if p.animation == name else p
            )
        elif self.what == "timeline":
            changes["performs"] = {who: to if t == name else t for who, t in document.performs.items()}
        elif self.what == "character":
            changes["performs"] = {to if who == name else who: t for who, t in document.performs.items()}
            changes["rigs"] = {
                key: replace(rig, character=to) if rig.character == name else rig for key, rig in document.rigs.items()
            }
        return replace(document, **changes)

    def to_json(self, store: Store) -> dict[str, Any]:
        """The fields."""
        return {"kind": self.kind, "what": self.what, "name": self.name, "to": self.to}


_KINDS = {"character": "characters", "clip": "clips", "timeline": "timelines", "pose": "poses", "rig": "rigs"}

Setting = str | float | bool


@dataclass(frozen=True, slots=True, eq=False)
class SetSettings:
    """Keep settings with the project; None removes one."""

    kind: ClassVar[str] = "set_settings"
    settings: Mapping[str, Setting | None]

    def __post_init__(self) -> None:
        object.__setattr__(self, "settings", MappingProxyType(dict(self.settings)))

    def apply(self, document: Document) -> Document:
        """The document with the settings."""
        merged = {**document.settings, **self.settings}
        return replace(document, settings={name: value for name, value in merged.items() if value is not None})

    def to_json(self, store: Store) -> dict[str, Any]:
        """The fields."""
        return {"kind": self.kind, "settings": dict(self.settings)}


@dataclass(frozen=True, slots=True, eq=False)
class AddCharacter:
    """Add a character with a timeline and an empty clip (`keypose.project.add_character`)."""

    kind: ClassVar[str] = "add_character"
    character: Character

    def apply(self, document: Document) -> Document:
        """The document with the character."""
        return add_character(document, self.character)

    def to_json(self, store: Store) -> dict[str, Any]:
        """The fields."""
        return {"kind": self.kind, "character": character_json(self.character, store)}


@dataclass(frozen=True, slots=True, eq=False)
class RemoveCharacter(_Removal):
    """Remove a character and its rig; its timeline and clips stay."""

    kind: ClassVar[str] = "remove_character"

    def apply(self, document: Document) -> Document:
        """The document without the character."""
        document.character(self.name)
        characters = _without(document.characters, self.name)
        performs = _without(document.performs, self.name)
        rigs = {key: rig for key, rig in document.rigs.items() if rig.character != self.name}
        return replace(document, characters=characters, performs=performs, rigs=rigs)


def import_clip(document: Document, animation: Clip | Motion) -> SetClip:
    """The command that puts a copy of an animation into a document, under a free name."""
    imported = import_animation(document, animation)
    return SetClip(next(clip for name, clip in imported.clips.items() if name not in document.clips))


def _without(items: Mapping[str, _Item], name: str) -> dict[str, _Item]:
    """The same mapping less one name."""
    return {key: item for key, item in items.items() if key != name}


def _placements(document: Document, change: Callable[[Placement], Placement | None]) -> dict[str, Timeline]:
    """The timelines with every placement changed or (None) left out; what does not change stays the same object."""
    timelines: dict[str, Timeline] = {}
    for name, timeline in document.timelines.items():
        layers: list[Any] = []
        for layer in timeline.layers:
            placements = tuple(p for p in map(change, layer.placements) if p is not None)
            same = len(placements) == len(layer.placements) and all(
                a is b for a, b in zip(placements, layer.placements, strict=True)
            )
            layers.append(layer if same else replace(layer, placements=placements))
        same = all(a is b for a, b in zip(layers, timeline.layers, strict=True))
        timelines[name] = timeline if same else replace(timeline, layers=tuple(layers))
    return timelines


def apply_all(document: Document, commands: Iterable[Command]) -> Document:
    """The document after all commands, which are checked together at the end: all or none.

    Raises:
        KeyposeError: where one cannot be applied, or the result names what is not there.
        ShapeError: where one is no command, or holds what is not of its field's type.
    """
    for command in commands:
        _check_types(command)
        document = command.apply(document)
    check(document)
    return document


def _check_types(command: Command) -> None:
    """A command made in Python is as sound as one from JSON: it holds what its fields are declared to hold."""
    if type(command) not in _COMMANDS:
        known = ", ".join(known.__name__ for known in _COMMANDS)
        raise ShapeError(f"commands: expected {known}, got {type(command).__name__}")
    hints = _hints(type(command))
    for field_ in fields(command):  # pyright: ignore[reportArgumentType]
        held = getattr(command, field_.name)
        if not _fits(held, hints[field_.name]):
            raise ShapeError(f"{command.kind}.{field_.name}: expected {field_.type}, got {held!r:.60}")


@cache
def _hints(kind: type) -> dict[str, Any]:
    return get_type_hints(kind)


def _fits(value: Any, hint: Any) -> bool:
    """Whether a value is of a type as annotations write it, and what is inside it too."""
    whole, inside = get_origin(hint) or hint, get_args(hint)
    if whole is UnionType:
        return any(_fits(value, each) for each in inside)
    if not isinstance(value, (int, float) if whole is float else whole):
        return False
    if issubclass(whole, Mapping):
        return all(_fits(key, inside[0]) and _fits(item, inside[1]) for key, item in value.items())
    return whole is not tuple or all(_fits(item, inside[0]) for item in value)


# ---- from JSON ---------------------------------------------------------------------------------------------------------


def _settings(item: Json) -> dict[str, Setting | None]:
    found: dict[str, Setting | None] = {}
    for name, value in item.members("settings"):
        if isinstance(value.value, (bool, str)) or value.value is None:
            found[name] = value.value
        else:
            found[name] = value.as_number()
    return found


_READERS: dict[str, Callable[[Json, Fetch], Command]] = {
    SetCurves.kind: lambda item, fetch: SetCurves(
        item.text("clip"),
        values.read_curves(item, "curves", fetch),
        tuple(values.read_channel(each) for each in item.items("removed")),
        values.read_orders(item),
    ),
    SetClip.kind: lambda item, fetch: SetClip(values.read_clip(item.need("clip"), fetch)),
    RemoveClip.kind: lambda item, fetch: RemoveClip(item.text("name")),
    SetTimeline.kind: lambda item, fetch: SetTimeline(values.read_timeline(item.need("timeline"), fetch)),
    RemoveTimeline.kind: lambda item, fetch: RemoveTimeline(item.text("name")),
    SetPose.kind: lambda item, fetch: SetPose(values.read_pose(item.need("pose"))),
    RemovePose.kind: lambda item, fetch: RemovePose(item.text("name")),
    SetRig.kind: lambda item, fetch: SetRig(read_rig(item.need("rig"), fetch)),
    RemoveRig.kind: lambda item, fetch: RemoveRig(item.text("name")),
    SetPerformance.kind: lambda item, fetch: SetPerformance(item.text("character"), item.text("timeline")),
    Rename.kind: lambda item, fetch: Rename(item.text("what"), item.text("name"), item.text("to")),
    SetSettings.kind: lambda item, fetch: SetSettings(_settings(item)),
    AddCharacter.kind: lambda item, fetch: AddCharacter(read_character(item.need("character"), fetch)),
    RemoveCharacter.kind: lambda item, fetch: RemoveCharacter(item.text("name")),
}

_COMMANDS = (
    SetCurves, SetClip, RemoveClip, SetTimeline, RemoveTimeline, SetPose, RemovePose, SetRig, RemoveRig, SetPerformance,
    Rename, SetSettings, AddCharacter, RemoveCharacter,
)  # fmt: skip

PAGE_KINDS = tuple(kind for kind in _READERS if kind not in (AddCharacter.kind, RemoveCharacter.kind))
"""Commands that a page may send as they are."""


def read_command(item: Json, fetch: Fetch, kinds: Iterable[str] = tuple(_READERS)) -> Command:
    """A command of one of the kinds; raises `FormatError` naming the place."""
    kind = item.text("kind")
    if kind not in kinds:
        item.need("kind").fail(f"no command '{kind[:40]}'; known: {', '.join(kinds)}")
    try:
        return _READERS[kind](item, fetch)
    except KeyposeError as error:
        if getattr(error, "where", ""):
            raise
        item.fail(str(error))
