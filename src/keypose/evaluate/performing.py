"""Documents as scenes: what its characters do, for all who know clips and motions but no timelines."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import replace

from keypose.evaluate.baking import to_clip
from keypose.evaluate.timeline import bake_timeline
from keypose.model import (
    Character,
    Clip,
    Document,
    Layer,
    LayerMode,
    Motion,
    Placement,
    Scene,
    Timeline,
)

LONGEST_NAME = 200
BASE_LAYER = "Base"
FILM_HZ = 25.0
"""Frames per second of new clips and timelines: film's (lecture notes)."""

Solver = Callable[[Document, Timeline, Character, float | None], Motion | None]
"""What moves a character in another way than its timeline's joint channels alone, as a rig does; None where nothing does."""


def perform(
    document: Document,
    character: str | None = None,
    timeline: str | None = None,
    rate_hz: float | None = None,
    solver: Solver | None = None,
) -> Scene:
    """The characters of a document with what their timelines make of them, then the clips that no timeline uses.

    A timeline that only plays a clip as it is gives that clip, with its keys; any other is baked at its rate or ``rate_hz``.
    With ``character``, that one alone with its own ``timeline`` (or another one that is named), and nothing else. Rigs are known
    to `keypose.rig.perform`, which gives its ``solver``.

    Raises:
        UnknownName: for a character, timeline or clip that is not there.
        ShapeError: where the rate is not positive.
    """
    if character is not None:
        who = document.character(character)
        name = document.performs.get(character, "") if timeline is None else timeline
        performed = () if not name else (performance(document, document.timeline(name), who, rate_hz, solver),)
        return Scene((who,), performed, format="keypose")
    animations: list[Clip | Motion] = []
    used: set[str] = set()
    for name, track in document.timelines.items():
        used |= {p.animation for layer in track.layers for p in layer.placements}
        who = next((c for c, t in document.performs.items() if t == name), None)
        if who is not None:
            animations.append(performance(document, track, document.character(who), rate_hz, solver))
    animations += [clip for name, clip in document.clips.items() if name not in used]
    return Scene(tuple(document.characters.values()), tuple(animations), format="keypose")


def performance(
    document: Document,
    timeline: Timeline,
    character: Character,
    rate_hz: float | None = None,
    solver: Solver | None = None,
) -> Clip | Motion:
    """What a timeline makes of a character: the clip that it only plays, or a motion baked from its start to its end.

    Raises:
        UnknownName: where a placement names no clip.
        ShapeError: where the rate is not positive.
    """
    solved = None if solver is None else solver(document, timeline, character, rate_hz)
    if solved is not None:
        return replace(solved, name=timeline.name)
    alone = None if rate_hz is not None else _only_clip(document, timeline)
    if alone is not None:
        return alone
    motion = bake_timeline(
        timeline, document.clips, character.skeleton, rate_hz, character.morph_names, character.rest_morph_weights
    )
    return replace(motion, name=timeline.name)


def to_document(scene: Scene, name: str = "") -> Document:
    """A document of a scene: its characters, its animations as clips, and a timeline that plays the first to the first.

    Motions become one key per frame (`to_clip`). Names that are there twice are numbered.
    """
    characters: dict[str, Character] = {}
    for character in scene.characters:
        free = unique_name(character.name or "Character", characters)
        characters[free] = replace(character, name=free)
    clips: dict[str, Clip] = {}
    for animation in scene.animations:
        clip = to_clip(animation, reduce_constant=True) if isinstance(animation, Motion) else animation
        free = unique_name(clip.name or "Clip", clips)
        rate = animation.rate_hz if isinstance(animation, Motion) else clip.rate_hz
        clips[free] = replace(clip, name=free, rate_hz=rate)
    timelines: dict[str, Timeline] = {}
    performs: dict[str, str] = {}
    if characters and clips:
        who, clip = next(iter(characters)), next(iter(clips.values()))
        placed = Placement(clip.name, clip.start_s)
        track = Timeline(
            (Layer(BASE_LAYER, (placed,)),),
            who,
            clip.rate_hz or FILM_HZ,
            min(0.0, clip.start_s),
            max(0.0, clip.end_s),
        )
        timelines[who], performs[who] = track, who
    return Document(name, characters, clips, timelines, performs=performs)


def unique_name(wanted: str, taken: Collection[str]) -> str:
    """``wanted`` where it is free, else with the first free number behind it; cut to what a name may be."""
    wanted = "".join(c for c in wanted if c.isprintable()).strip()[: LONGEST_NAME - 8] or "Unnamed"
    name, number = wanted, 2
    while name in taken:
        name, number = f"{wanted} {number}", number + 1
    return name


def _only_clip(document: Document, timeline: Timeline) -> Clip | None:
    """The clip of a timeline that plays one clip in the clip's own time and does nothing else; else None."""
    heard = [layer for layer in timeline.layers if not layer.muted]
    solo = [layer for layer in heard if layer.solo]
    heard = [layer for layer in (solo or heard) if any(not p.muted for p in layer.placements)]
    if len(heard) != 1 or timeline.hold_frames or not _is_plain(heard[0]):
        return None
    placed = [p for p in heard[0].placements if not p.muted]
    if len(placed) != 1:
        return None
    (place,) = placed
    clip = document.clip(place.animation)
    begin = clip.start_s if place.in_s is None else place.in_s
    as_it_is = (
        place.speed == 1
        and place.cycles == 1
        and place.fade_in_s == place.fade_out_s == 0
        and place.time_warp is None
        and place.weight is None
        and place.hold
        and place.start_s == begin
        and begin <= clip.start_s
        and (place.out_s is None or place.out_s >= clip.end_s)
    )
    inside = not clip.curves or (timeline.start_s <= clip.start_s and clip.end_s <= timeline.end_s)
    return clip if as_it_is and inside else None


def _is_plain(layer: Layer) -> bool:
    return layer.mode is LayerMode.REPLACE and layer.influence == 1 and not layer.joints and layer.properties is None
