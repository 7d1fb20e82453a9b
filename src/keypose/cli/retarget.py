"""`keypose retarget`: the motion of one character on another, written as a file or drawn, with the figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from keypose.cli.console import progress_bar
from keypose.cli.inputs import (
    AS_THEY_SAY,
    Reading,
    animation_of,
    body_of,
    open_input,
    read_roles,
)
from keypose.cli.output import check_output, motion_facts, motion_words, print_json, print_written, write_scene
from keypose.errors import FormatError, ShapeError
from keypose.model import Character, Clip, Motion, Pose, Scene, Skeleton

if TYPE_CHECKING:
    from keypose.analysis import RoleMap
    from keypose.retarget import Prop

SCHEMA = "keypose.retarget/1"

# Where bones are further off on average, a reference pose that is no stand is the usual cause.
_FAR_OFF_DEG = 5.0
_FAR_OFF_HINT = (
    "the bones' directions are far off: a reference pose may be no stand; name frames that stand upright with "
    "--target-reference FRAME or FILE:FRAME (--source-reference for the motion's)"
)


@dataclass(frozen=True, slots=True)
class RetargetAsked:
    """What is asked for, as the command line says it.

    ``source_reference`` and ``target_reference`` say which frames stand: 'FRAME' of the two files, or 'FILE:FRAME'; ``props``
    places as text (see `parse_prop`); ``against`` a file with somebody else's result, which is compared.
    """

    scale: float | None = None
    plant: bool = True
    source_roles: Path | None = None
    target_roles: Path | None = None
    source_reference: str | None = None
    target_reference: str | None = None
    hands: bool = False
    props: Sequence[str] = ()
    against: str | None = None


def retarget_file(
    motion: str,
    character: str,
    output: Path,
    asked: RetargetAsked,
    *,
    clip: str | None = None,
    rate_hz: float | None = None,
    reading: Reading = AS_THEY_SAY,
    as_json: bool = False,
    quiet: bool = False,
) -> None:
    """Put a motion on a character and write the character with it; ``reading`` is about the motion's file.

    Raises:
        FormatError: where the output's format cannot be written, or an input has no motion or no skeleton.
        ShapeError: where a frame is outside its motion, or a place is none.
    """
    from keypose.editing.planting import PlantOptions
    from keypose.retarget import HandOptions, ground_under, retarget
    from keypose.retarget.scenes import compare_with_scene, own_motion

    check_output(output, [motion, character, asked.against])
    held = HandOptions(props=[parse_prop(text) for text in asked.props]) if asked.hands or asked.props else None
    performed = open_input(motion, reading)
    cast = open_input(character)
    theirs = None if asked.against is None else open_input(asked.against)
    source, target = body_of(performed, motion), body_of(cast, character)
    animation = animation_of(performed, motion, clip)
    if theirs is not None and not (theirs.characters and theirs.animations):
        raise FormatError("it has no skeleton with a motion", path=asked.against)
    target_map = _roles(asked.target_roles, target.skeleton, target.roles)
    stand, stand_note = _stand(cast, target_map, asked.target_reference, character)
    start = asked.source_reference
    with progress_bar("retargeting", quiet=quiet or as_json) as progress:
        result = retarget(
            animation,
            source.skeleton,
            target.skeleton,
            source_roles=_roles(asked.source_roles, source.skeleton, source.roles),
            target_roles=target_map,
            source_reference=None if start is None else _reference(performed, start, motion),
            target_reference=stand,
            target_motion=own_motion(target, cast.animations) if stand is None else None,
            target_ground_m=ground_under(target, stand),
            rate_hz=rate_hz,
            scale=asked.scale,
            plant=PlantOptions() if asked.plant else None,
            hands=held,
            progress=progress,
        )
    made = replace(result.motion, name=animation.name or Path(motion).stem)
    scene = Scene((target,), (made,), unit_m=cast.unit_m)
    notes = [*result.notes, *stand_note, *write_scene(scene, output, quiet=quiet or as_json)]
    if result.report.mean_direction_deg > _FAR_OFF_DEG:
        notes.append(_FAR_OFF_HINT)
    if quiet and not as_json:
        return
    beside = None
    if theirs is not None:
        beside = compare_with_scene(result, target.skeleton, theirs.character, theirs.animations[0])
    if as_json:
        against = None if beside is None else asdict(beside)
        print_json(
            {
                "schema": SCHEMA,
                **motion_facts(output, made),
                **asdict(result.report),
                "against": against,
                "notes": notes,
            }
        )
        return
    lines = [*result.report.lines(), *([] if beside is None else beside.lines())]
    print_written(output, motion_words(made), notes, lines)


def parse_prop(text: str) -> Prop:
    """A prop's place 'x,y,z' in metres of the source's world, or 'x,y,z:x,y,z' with the place in the target's.

    Raises:
        ShapeError: where the text says something else.
    """
    from keypose.retarget import Prop

    try:
        places = [np.array([float(number) for number in part.split(",")]) for part in text.split(":")]
    except ValueError:
        places = []
    if len(places) not in (1, 2) or any(place.shape != (3,) or not np.isfinite(place).all() for place in places):
        raise ShapeError(f"prop: expected x,y,z or x,y,z:x,y,z in metres, got '{text}'")
    return Prop(*places)


def _stand(cast: Scene, roles: RoleMap | None, asked: str | None, name: str) -> tuple[Pose | None, tuple[str, ...]]:
    """The target's reference pose where it is not the rest pose, and what is to be said about it."""
    from keypose.analysis import find_roles
    from keypose.retarget import bind_stand

    character = cast.character
    if asked is not None:
        return _reference(cast, asked, name), ()
    found = find_roles(character.skeleton) if roles is None else roles
    bound = None if found.missing else bind_stand(character, found.roles)
    said = "target: the rest pose is no upright stand; the pose in which the skin was bound is taken for one"
    return bound, () if bound is None else (said,)


def _reference(scene: Scene, asked: str, name: str) -> Pose:
    """The pose of a frame that stands: 'FRAME' of the scene, or 'FILE:FRAME' of another file of the same rig, or 'FILE:rest'."""
    from keypose.retarget import pose_of_other

    file, _, number = asked.rpartition(":")
    if not (number.isdecimal() or (file and number == "rest")):
        raise ShapeError(f"reference pose: expected FRAME, FILE:FRAME or FILE:rest, got '{asked}'")
    of, where = (open_input(file), file) if file else (scene, name)
    body = body_of(of, where)
    if number == "rest":
        pose = body.skeleton.rest
    elif of.animations:
        pose = _frame(of.animations[0], body, int(number), where)
    else:
        raise FormatError("it has no motion whose frame could be the reference pose", path=where)
    return pose if not file else pose_of_other(scene.character.skeleton, body.skeleton, pose)


def _frame(animation: Motion | Clip, character: Character, frame: int, name: str) -> Pose:
    """A frame of a motion as a pose."""
    from keypose.evaluate import frame_rate, match, sample

    if isinstance(animation, Motion):
        count = animation.frame_count
        if 0 <= frame < count:
            return match(animation, character.skeleton).pose[frame]
    else:
        rate = frame_rate(animation)
        count = round(animation.duration_s * rate) + 1
        if 0 <= frame < count:
            return sample(animation, character.skeleton, animation.start_s + frame / rate)
    raise ShapeError(f"reference frame of {name}: expected 0 to {count - 1}, got {frame}")


def _roles(path: Path | None, skeleton: Skeleton, known: Mapping[str, int]) -> RoleMap | None:
    from keypose.analysis import find_roles

    if path is not None:
        return read_roles(path, skeleton)
    if known:
        found = find_roles(skeleton, known=known)
        return found if not found.missing else None
    return None
