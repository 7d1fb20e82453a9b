"""`keypose rig`: a character's controls, listed, or written as a project, with a motion on them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from keypose.cli.console import console, counted, progress_bar
from keypose.cli.inputs import AS_THEY_SAY, Reading, animation_of, body_of, open_input, read_roles
from keypose.cli.output import check_output, print_json, print_written
from keypose.errors import FormatError
from keypose.model import Character, Document, Rig, Scene, module_joints

if TYPE_CHECKING:
    from keypose.rig import RigFit


def rig_file(
    character: str,
    output: Path | None,
    *,
    motion: str | None,
    clip: str | None,
    rate_hz: float | None,
    roles: Path | None,
    reading: Reading = AS_THEY_SAY,
    as_json: bool = False,
    quiet: bool = False,
) -> None:
    """Rig a character and list its controls, or write both as a project.

    Of ``reading``, the unit and the up axis are about the character's file, skeleton and options about the motion's.

    Raises:
        FormatError: where an input has no skeleton or no motion, or the output is no project.
        KeyposeError: where the character is no humanoid.
    """
    from keypose.rig import auto_rig

    if output is not None:
        if output.suffix.lower() != ".keypose":
            raise FormatError("expected a name that ends with .keypose: only a project keeps a rig", path=output)
        check_output(output, [character, motion])
    cast = open_input(character, Reading(unit=reading.unit, up=reading.up))
    who = body_of(cast, character)
    who = replace(who, name=who.name or Path(character.removeprefix("sample:")).stem)
    rig = auto_rig(who.skeleton, None if roles is None else read_roles(roles, who.skeleton), character=who)
    if as_json:
        _print_json(rig)
    if output is None:
        if not as_json:
            _print_controls(rig)
        return
    fit, notes = None, tuple[str, ...]()
    if motion is not None:
        taken = Reading(skeleton=reading.skeleton, options=reading.options)
        fit, notes = _fitted(rig, who, motion, clip, rate_hz, taken, quiet or as_json)
    _save(rig, who, cast, fit, output)
    if not (quiet or as_json):
        _report(rig, fit, notes, output)


def _fitted(
    rig: Rig,
    who: Character,
    motion: str,
    clip: str | None,
    rate_hz: float | None,
    reading: Reading,
    quiet: bool,
) -> tuple[RigFit, tuple[str, ...]]:
    """A motion on the controls; one of another skeleton is retargeted first."""
    from keypose.evaluate import match_report, to_motion
    from keypose.rig import fit_controls

    performed = open_input(motion, reading)
    animation = animation_of(performed, motion, clip)
    own = set(match_report(animation, who.skeleton).sources)
    moved = {j for module in rig.modules for j in module_joints(module)}
    notes: tuple[str, ...] = ()
    if len(own & moved) < 0.5 * len(moved) and performed.characters:
        from keypose.retarget import retarget

        with progress_bar("retargeting", quiet=quiet) as progress:
            done = retarget(animation, performed.character.skeleton, who.skeleton, rate_hz=rate_hz, progress=progress)
        notes = ("its joints have other names; it was retargeted", *done.notes)
        frames = replace(done.motion, name=animation.name)
    else:
        frames = to_motion(animation, who.skeleton, rate_hz)
    frames = replace(frames, name=frames.name or Path(motion).stem)
    with progress_bar("fitting controls", quiet=quiet) as progress:
        return fit_controls(rig, who.skeleton, frames, progress=progress), notes


def _save(rig: Rig, who: Character, cast: Scene, fit: RigFit | None, output: Path) -> None:
    from keypose.project import add_character, import_animation
    from keypose.project.commands import SetRig
    from keypose.project.file import save

    document = add_character(Document(output.stem), who)
    (name,) = document.characters
    document = SetRig(replace(rig, name=name, character=name)).apply(document)
    for animation in cast.animations:
        document = import_animation(document, animation)
    if fit is not None:
        track = document.timeline(document.performs[name])
        place = track.layers[0].placements[0]
        keyed = replace(fit.clip, name=place.animation)
        layers = (replace(track.layers[0], placements=(replace(place, in_s=0.0),)),)
        track = replace(
            track, layers=layers, rate_hz=keyed.rate_hz or track.rate_hz, start_s=keyed.start_s, end_s=keyed.end_s
        )
        document = replace(
            document,
            clips={**document.clips, keyed.name: keyed},
            timelines={**document.timelines, track.name: track},
        )
    save(document, output)


def _report(rig: Rig, fit: RigFit | None, notes: tuple[str, ...], output: Path) -> None:
    lines: list[str] = []
    if fit is not None:
        frames = len(fit.control_pose.rotations)
        lines.append(
            f"{counted(frames, 'frame')} on the controls: joints within {_millimetres(fit.error_m)} and "
            f"{max(fit.error_deg, 1e-4):.2g} degrees; all FK {_millimetres(fit.fk_error_m)}, all IK {_millimetres(fit.ik_error_m)}"
        )
    facts = f"{counted(rig.controls.joint_count, 'control')}, {counted(len(rig.attributes), 'attribute')}"
    print_written(output, facts, notes, lines)


def _millimetres(metres: float) -> str:
    """Figures below a micrometre are rounding."""
    return f"{max(1e3 * metres, 1e-3):.3g} mm"


def _print_controls(rig: Rig) -> None:
    from rich.markup import escape
    from rich.table import Table

    out = console()
    table = Table(box=None, pad_edge=False)
    for title in ("control", "shape", "carried by", "attributes"):
        table.add_column(title, header_style="dim")
    depths = rig.controls.depths()
    for n, look in enumerate(rig.looks):
        parent = int(rig.controls.parents[n])
        carried = ", ".join(s.name for s in look.spaces) or (rig.controls.names[parent] if parent >= 0 else "")
        beside = [a.name for a in rig.attributes if a.control == look.name and a.name != look.space_attribute]
        table.add_row(
            "  " * int(depths[n]) + escape(look.name), look.shape.value, escape(carried), escape(", ".join(beside))
        )
    out.print(table)
    moved = len(rig.joints)
    out.print(
        f"[dim]{counted(rig.controls.joint_count, 'control')} and {counted(len(rig.attributes), 'attribute')} move "
        f"{counted(moved, 'joint')}[/dim]"
    )


def _print_json(rig: Rig) -> None:
    from keypose.io.native_rigs import rig_json

    print_json(rig_json(rig, lambda array: array.tolist()))
