"""What projects are made of: new ones, characters and clips put into them, checks, and the difference of two."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import Any

from keypose.errors import ShapeError, UnknownName
from keypose.evaluate import to_clip
from keypose.evaluate.performing import BASE_LAYER, FILM_HZ, LONGEST_NAME, unique_name
from keypose.model import (
    Channel,
    Character,
    Clip,
    Curve,
    Document,
    Layer,
    Motion,
    Placement,
    Property,
    Rig,
    Timeline,
)
from keypose.rig.plan import check_rig

LARGEST_SETTINGS = 1 << 20
_JOINT = "joint:"


def add_character(document: Document, character: Character) -> Document:
    """The document with a character, a timeline that moves it, and an empty clip for its keys.

    The three are named after the character, numbered where its name is taken. The clip lies on the timeline's only layer so
    that its time is the timeline's.
    """
    wanted = character.name or "Character"
    name = unique_name(wanted, document.characters)
    track = unique_name(name, document.timelines)
    clip = unique_name(name, document.clips)
    timeline = Timeline((Layer(BASE_LAYER, (Placement(clip, in_s=0.0),)),), track, FILM_HZ)
    return replace(
        document,
        characters={**document.characters, name: replace(character, name=name)},
        clips={**document.clips, clip: Clip({}, clip, FILM_HZ)},
        timelines={**document.timelines, track: timeline},
        performs={**document.performs, name: track},
    )


def import_animation(document: Document, animation: Clip | Motion) -> Document:
    """The document with a copy of an animation as a clip; a motion becomes one key per frame (`evaluate.to_clip`).

    Joints of another body that are called like a control here are written as ``joint:NAME``, which moves no control.
    """
    clip = to_clip(animation, reduce_constant=True) if isinstance(animation, Motion) else animation
    name = unique_name(clip.name or "Clip", document.clips)
    controls = {control for rig in document.rigs.values() for control in rig.controls.names}
    alike = foreign_joints(document, clip, controls) & controls
    if alike:
        curves = {
            replace(c, target=f"{_JOINT}{c.target}") if moves_a_joint(c) and c.target in alike else c: curve
            for c, curve in clip.curves.items()
        }
        orders = {f"{_JOINT}{n}" if n in alike else n: order for n, order in clip.euler_orders.items()}
        clip = replace(clip, curves=curves, euler_orders=orders)
    return replace(document, clips={**document.clips, name: replace(clip, name=name)})


def foreign_joints(document: Document, clip: Clip, controls: Collection[str]) -> frozenset[str]:
    """The joints of a clip that no character here has; none where all of those are controls, as in clips keyed on a rig."""
    own = {name for character in document.characters.values() for name in character.skeleton.names}
    strange = {channel.target for channel in clip.curves if moves_a_joint(channel)} - own
    return frozenset() if strange <= set(controls) else frozenset(strange)


def moves_a_joint(channel: Channel) -> bool:
    """Whether a channel is one of a joint or control, not of a morph or a value."""
    return channel.property not in (Property.WEIGHT, Property.VALUE)


def check_name(name: str, kind: str) -> None:
    """Raises `ShapeError` for a name that is empty, too long or not printable."""
    if not name.strip():
        raise ShapeError(f"{kind}: expected a name, got nothing")
    if len(name) > LONGEST_NAME:
        raise ShapeError(f"{kind}: a name of {len(name)} characters; at most {LONGEST_NAME}")
    if not name.isprintable():
        raise ShapeError(f"{kind}: {name[:40]!r} holds characters that cannot be shown")


def check(document: Document) -> None:
    """Whether all names that the document uses are there.

    Raises:
        UnknownName: where a placement names no clip, a performance no character or timeline, or a rig no character or joint;
            names the nearest.
        ShapeError: where a setting is not finite, they are too large, or two rigs move one character.
    """
    for timeline in document.timelines.values():
        for layer in timeline.layers:
            for placement in layer.placements:
                document.clip(placement.animation)
    for character, timeline in document.performs.items():
        document.character(character)
        document.timeline(timeline)
    moved: dict[str, str] = {}
    for name, rig in document.rigs.items():
        if rig.character in moved:
            raise ShapeError(f"rigs '{moved[rig.character]}' and '{name}': both move character '{rig.character}'")
        moved[rig.character] = name
        check_rig(rig, document.character(rig.character).skeleton)
    size = sum(len(name) + (len(value) if isinstance(value, str) else 8) for name, value in document.settings.items())
    if size > LARGEST_SETTINGS:
        raise ShapeError(f"settings: {size} characters; at most {LARGEST_SETTINGS}")
    for name, value in document.settings.items():
        if isinstance(value, float) and not math.isfinite(value):
            raise ShapeError(f"setting '{name}': expected a finite number, got {value}")


# ---- the difference ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class ClipDifference:
    """Curves of a clip that are new or other than before, and channels that have none any more."""

    clip: Clip
    curves: Mapping[Channel, Curve]
    removed: tuple[Channel, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Difference:
    """What turns one document into another: new values of what changed, names of what is gone.

    ``characters`` and ``settings`` say only whether any of them changed.
    """

    clips: tuple[ClipDifference, ...] = ()
    removed_clips: tuple[str, ...] = ()
    timelines: tuple[Timeline, ...] = ()
    removed_timelines: tuple[str, ...] = ()
    poses: tuple[Any, ...] = ()
    removed_poses: tuple[str, ...] = ()
    characters: bool = False
    settings: bool = False
    rigs: tuple[Rig, ...] = ()
    removed_rigs: tuple[str, ...] = ()


def difference(before: Document, after: Document) -> Difference:
    """What changed from one document to another; curves that hold the same numbers did not."""
    clips: list[ClipDifference] = []
    for name, clip in after.clips.items():
        old = before.clips.get(name)
        if clip is old:
            continue
        known = {} if old is None else old.curves
        curves = {
            channel: curve
            for channel, curve in clip.curves.items()
            if channel not in known or not same_curve(curve, known[channel])
        }
        removed = tuple(channel for channel in known if channel not in clip.curves)
        clips.append(ClipDifference(clip, curves, removed))
    return Difference(
        tuple(clips),
        _gone(before.clips, after.clips),
        _changed(before.timelines, after.timelines),
        _gone(before.timelines, after.timelines),
        _changed(before.poses, after.poses),
        _gone(before.poses, after.poses),
        dict(before.characters) != dict(after.characters) or dict(before.performs) != dict(after.performs),
        dict(before.settings) != dict(after.settings),
        _changed(before.rigs, after.rigs),
        _gone(before.rigs, after.rigs),
    )


def same_curve(one: Curve, other: Curve) -> bool:
    """Whether two curves hold the same numbers."""
    if one is other:
        return True
    if (one.kind, one.before, one.after) != (other.kind, other.before, other.after):
        return False
    names = ("times_s", "values", "modes", "in_tangents", "out_tangents", "in_handles", "out_handles", "tangent_types")
    return all(_same_array(getattr(one, name), getattr(other, name)) for name in names)


def _same_array(one: Any, other: Any) -> bool:
    if one is other or one is None or other is None:
        return one is other
    # as bytes: 0 and -0 are not the same number to whoever divides by it
    return one.dtype == other.dtype and one.shape == other.shape and one.tobytes() == other.tobytes()


def _gone(before: Mapping[str, Any], after: Mapping[str, Any]) -> tuple[str, ...]:
    return tuple(name for name in before if name not in after)


def _changed(before: Mapping[str, Any], after: Mapping[str, Any]) -> tuple[Any, ...]:
    return tuple(value for name, value in after.items() if before.get(name) is not value)


def renamed(mapping: Mapping[str, Any], kind: str, name: str, to: str) -> dict[str, Any]:
    """A mapping whose ``name`` is called ``to``, in its place; the value has to be renamed by the caller.

    Raises:
        UnknownName: where there is no such name.
        ShapeError: where the new name is taken or none.
    """
    if name not in mapping:
        raise UnknownName(kind, name, mapping)
    check_name(to, kind)
    if to != name and to in mapping:
        raise ShapeError(f"{kind}: the name '{to}' is taken")
    return {to if key == name else key: value for key, value in mapping.items()}
