"""`keypose retarget`: the motion of one character on another, written as a file or drawn, with the figures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from keypose.cli.console import console, progress_bar
from keypose.cli.convert import not_an_input
from keypose.cli.inputs import open_input
from keypose.errors import FormatError
from keypose.model import Motion, Scene, Skeleton

if TYPE_CHECKING:
    from keypose.analysis import RoleMap

FILMS = (".png", ".gif", ".mp4", ".webm")


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
) -> None:
    """Put a motion on a character and write the character with it.

    Raises:
        FormatError: where the output's format cannot be written, or an input has no motion or no skeleton.
    """
    from keypose import io
    from keypose.editing.planting import PlantOptions
    from keypose.io.registry import format_of_suffix, unknown_format
    from keypose.retarget import retarget

    film = output.suffix.lower() in FILMS
    chosen = format_of_suffix(output)
    if not film and (chosen is None or not chosen.write):  # told before anything is read
        raise unknown_format(output, writing=True)
    not_an_input(output, [motion, character])
    performed = open_input(motion, unit=unit, up=up, skeleton=skeleton, options=options)
    cast = open_input(character)
    for scene, name in ((performed, motion), (cast, character)):
        if not scene.characters:
            raise FormatError("it has no skeleton", path=name)
    if not performed.animations:
        raise FormatError("it has no motion", path=motion)
    animation = performed.animations[0] if clip is None else performed.animation(clip)
    source, target = performed.character, cast.character
    own = next((a for a in cast.animations if isinstance(a, Motion)), None)
    result = retarget(
        animation,
        source.skeleton,
        target.skeleton,
        source_roles=_roles(source_roles, source.skeleton, source.roles),
        target_roles=_roles(target_roles, target.skeleton, target.roles),
        target_motion=own if own is not None and own.joint_names == target.skeleton.names else None,
        target_ground_m=_ground(cast),
        rate_hz=rate_hz,
        scale=scale,
        plant=PlantOptions() if plant else None,
    )
    scene = Scene((target,), (replace(result.motion, name=animation.name or Path(motion).stem),), unit_m=cast.unit_m)
    if film:
        from keypose.render import RenderSettings, render_file

        with progress_bar(f"drawing {output.name}", quiet=quiet) as progress:
            notes = render_file(scene, output, settings=RenderSettings(), progress=progress)
    else:
        notes = io.save(scene, output)
    if quiet:
        return
    from rich.markup import escape

    out = console()
    out.print(
        f"[green]wrote[/green] {escape(str(output))} [dim]({output.stat().st_size:,} bytes, "
        f"{result.motion.frame_count:,} frames at {result.motion.rate_hz:g} Hz)[/dim]"
    )
    for note in (*result.notes, *(notes or ())):
        out.print(f"  [yellow]note[/yellow] {escape(note)}")
    for line in result.report.lines():
        out.print(f"  {escape(line)}")


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
    from keypose.analysis import find_roles, roles_from_json

    if path is not None:
        try:
            return roles_from_json(path.read_text(encoding="utf-8"), skeleton)
        except OSError as error:
            raise FormatError(error.strerror or str(error), path=path) from None
    if known:
        found = find_roles(skeleton, known=known)
        return found if not found.missing else None
    return None


def _ground(scene: Scene) -> float | None:
    """The lowest point of the character's surface at rest: what stands on the ground."""
    from keypose import deform, evaluate

    character = scene.character
    if not any(part.skin is not None for part in character.parts):
        return None
    standing = deform.deform_character(character, evaluate.world(character.skeleton, character.skeleton.rest))
    lowest = [float(vertices[:, 1].min()) for vertices in standing if len(vertices)]
    return min(lowest, default=None)
