"""`keypose retarget`: the motion of one character on another, written as a file or drawn, with the figures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from keypose.cli.console import console, progress_bar
from keypose.cli.inputs import baked, file_word, open_input, read_roles
from keypose.cli.output import check_output, print_written, write_scene
from keypose.errors import FormatError, ShapeError
from keypose.model import Character, Clip, Motion, Pose, Scene, Skeleton

if TYPE_CHECKING:
    from keypose.analysis import RoleMap
    from keypose.retarget import Prop, RetargetResult

# Where bones are further off on average, a reference pose that is no stand is the usual cause.
_FAR_OFF_DEG = 5.0
_FAR_OFF_HINT = (
    "the bones' directions are far off: a reference pose may be no stand; name frames that stand upright with "
    "--target-reference FRAME or FILE:FRAME (--source-reference for the motion's)"
)


def retarget_file(
    motion: str,
    character: str,
    output: Path,
    *,
    clip: str | None,
    rate_hz: float | None,
    scale: float | None,
    plant: bool,
    source_roles: Path | None,
    target_roles: Path | None,
    unit: str | None,
    up: str | None,
    quiet: bool,
    skeleton: str | None = None,
    options: Sequence[str] = (),
    source_reference: str | None = None,
    target_reference: str | None = None,
    hands: bool = False,
    props: Sequence[str] = (),
    against: str | None = None,
) -> None:
    """Put a motion on a character and write the character with it.

    ``source_reference`` and ``target_reference`` say which frames stand: 'FRAME' of the two files, or 'FILE:FRAME'; ``props`` places as text
    (see `parse_prop`); ``against`` a file with somebody else's result, which is compared.

    Raises:
        FormatError: where the output's format cannot be written, or an input has no motion or no skeleton.
        ShapeError: where a frame is outside its motion, or a place is none.
    """
    from keypose.editing.planting import PlantOptions
    from keypose.retarget import HandOptions, ground_under, retarget

    check_output(output, [motion, character, against])
    held = HandOptions(props=[parse_prop(text) for text in props]) if hands or props else None
    performed = open_input(motion, unit=unit, up=up, skeleton=skeleton, options=options)
    cast = open_input(character)
    theirs = None if against is None else open_input(against)
    for scene, name in ((performed, motion), (cast, character)):
        if not scene.characters:
            raise FormatError("it has no skeleton", path=name)
    if not performed.animations:
        raise FormatError("it has no motion", path=motion)
    animation = performed.animations[0] if clip is None else performed.animation(clip)
    if theirs is not None and not (theirs.characters and theirs.animations):
        raise FormatError("it has no skeleton with a motion", path=against)
    source, target = performed.character, cast.character
    target_map = _roles(target_roles, target.skeleton, target.roles)
    stand, stand_note = _stand(cast, target_map, target_reference, character)
    with progress_bar("retargeting", quiet=quiet) as progress:
        result = retarget(
            animation,
            source.skeleton,
            target.skeleton,
            source_roles=_roles(source_roles, source.skeleton, source.roles),
            target_roles=target_map,
            source_reference=None if source_reference is None else _reference(performed, source_reference, motion),
            target_reference=stand,
            target_motion=_own_motion(cast) if stand is None else None,
            target_ground_m=ground_under(target, stand),
            rate_hz=rate_hz,
            scale=scale,
            plant=PlantOptions() if plant else None,
            hands=held,
            progress=progress,
        )
    scene = Scene((target,), (replace(result.motion, name=animation.name or Path(motion).stem),), unit_m=cast.unit_m)
    beside = [] if theirs is None or quiet else _compared(result, target.skeleton, theirs)
    notes = [*result.notes, *stand_note, *write_scene(scene, output, quiet=quiet)]
    if quiet:
        return
    if result.report.mean_direction_deg > _FAR_OFF_DEG:
        notes.append(_FAR_OFF_HINT)
    facts = f"{file_word(result.motion.frame_count, 'frame')} at {result.motion.rate_hz:g} Hz"
    print_written(output, facts, notes, [*result.report.lines(), *beside])


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


def _own_motion(cast: Scene) -> Motion | None:
    """A motion of the target's own in frames, None where its file has none."""
    skeleton = cast.character.skeleton
    for animation in cast.animations:
        if isinstance(animation, Motion) and animation.joint_names == skeleton.names:
            return animation
        if isinstance(animation, Clip) and animation.duration_s > 0:
            return baked(animation, skeleton)
    return None


def _reference(scene: Scene, asked: str, name: str) -> Pose:
    """The pose of a frame that stands: 'FRAME' of the scene, or 'FILE:FRAME' of another file of the same rig, or 'FILE:rest'."""
    from keypose.retarget import pose_of_other

    file, _, number = asked.rpartition(":")
    if not (number.isdecimal() or (file and number == "rest")):
        raise ShapeError(f"reference pose: expected FRAME, FILE:FRAME or FILE:rest, got '{asked}'")
    of, where = (open_input(file), file) if file else (scene, name)
    if not of.characters:
        raise FormatError("it has no skeleton", path=where)
    if number == "rest":
        pose = of.character.skeleton.rest
    elif of.animations:
        pose = _frame(of.animations[0], of.character, int(number), where)
    else:
        raise FormatError("it has no motion whose frame could be the reference pose", path=where)
    return pose if not file else pose_of_other(scene.character.skeleton, of.character.skeleton, pose)


def _frame(animation: Motion | Clip, character: Character, frame: int, name: str) -> Pose:
    """A frame of a motion as a pose."""
    from keypose.evaluate import key_rate, match, sample

    if isinstance(animation, Motion):
        motion = match(animation, character.skeleton)
        count = motion.frame_count
        if 0 <= frame < count:
            pose = motion.pose.broadcast()
            return Pose(pose.translations[frame], pose.rotations[frame], pose.scales[frame])
    else:
        rate = animation.rate_hz or key_rate(animation) or 30.0
        count = round(animation.duration_s * rate) + 1
        if 0 <= frame < count:
            return sample(animation, character.skeleton, animation.start_s + frame / rate)
    raise ShapeError(f"reference frame of {name}: expected 0 to {count - 1}, got {frame}")


def _compared(result: RetargetResult, skeleton: Skeleton, theirs: Scene) -> list[str]:
    """What the result is beside somebody else's."""
    from keypose.analysis import find_roles
    from keypose.evaluate import match
    from keypose.retarget import compare_with_reference

    body, animation = theirs.character, theirs.animations[0]
    if isinstance(animation, Clip):
        animation = baked(animation, body.skeleton)
    found = find_roles(body.skeleton, known=body.roles or None)
    report = compare_with_reference(
        result.motion,
        skeleton,
        result.target.roles,
        match(animation, body.skeleton),
        body.skeleton,
        found.roles,
        result.touching,
    )
    return report.lines()


def print_roles(
    reference: str, output: Path | None, *, as_json: bool, unit: str | None, up: str | None, skeleton: str | None
) -> bool:
    """Print which joint plays which role, or write that as a map; returns whether everything needed was found."""
    import json

    from keypose.analysis import find_roles

    scene = open_input(reference, unit=unit, up=up, skeleton=skeleton)
    if not scene.characters:
        raise FormatError("it has no skeleton", path=reference)
    character = scene.character
    found = find_roles(character.skeleton, known=character.roles or None)
    names = character.skeleton.names
    if output is not None:
        from keypose.io.atomic import replacing

        with replacing(output) as path:
            path.write_text(found.to_json(character.skeleton) + "\n", encoding="utf-8")
    if as_json:
        rows: dict[str, Any] = {
            role: {"joint": names[j], "confidence": found.confidence[role]} for role, j in found.roles.items()
        }
        roles = {"roles": rows, "missing": list(found.missing), "notes": list(found.notes)}
        print(json.dumps(roles, indent=1))
        return found.is_humanoid
    _print_table(found, character.skeleton)
    return found.is_humanoid


def _print_table(found: RoleMap, skeleton: Skeleton) -> None:
    from rich.markup import escape
    from rich.table import Table

    out = console()
    table = Table(box=None, pad_edge=False)
    for title in ("role", "joint", "sure"):
        table.add_column(title, header_style="dim", justify="right" if title == "sure" else "left")
    for role, joint in found.roles.items():
        sure = found.confidence[role]
        shade = "green" if sure >= 0.9 else "yellow" if sure > 0.5 else "red"
        table.add_row(role, escape(skeleton.names[joint]), f"[{shade}]{sure:.0%}[/{shade}]")
    out.print(table)
    for note in found.notes:
        out.print(f"[yellow]note[/yellow] {escape(note)}")
    if found.missing:
        out.print(f"[red]no humanoid:[/red] nothing plays {', '.join(found.missing)}")


def _roles(path: Path | None, skeleton: Skeleton, known: Any) -> RoleMap | None:
    from keypose.analysis import find_roles

    if path is not None:
        return read_roles(path, skeleton)
    if known:
        found = find_roles(skeleton, known=known)
        return found if not found.missing else None
    return None
