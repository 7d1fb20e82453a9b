"""`keypose skin`: a mesh bound to a skeleton with automatic weights, written as a file or drawn, with the figures."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path

from keypose.cli.console import console, progress_bar
from keypose.cli.convert import not_an_input
from keypose.cli.inputs import open_input
from keypose.cli.retarget import FILMS
from keypose.errors import FormatError
from keypose.model import Scene


def skin_file(
    mesh: str,
    output: Path,
    *,
    skeleton: str | None,
    joints: Sequence[str] | None,
    influences: int,
    strength: float,
    dual_quaternion: bool,
    clip: str | None,
    as_json: bool,
    unit: str | None,
    up: str | None,
    options: Sequence[str],
    quiet: bool,
) -> None:
    """Bind the meshes of a file and write them with skeleton and motions.

    Raises:
        FormatError: where the output's format cannot be written, or an input has no mesh or no skeleton.
        UnknownName: for a joint or a clip that does not exist.
    """
    from keypose import io
    from keypose.deform import skin_character
    from keypose.io.registry import format_of_suffix, unknown_format
    from keypose.model import SkinningMethod

    film = output.suffix.lower() in FILMS
    chosen = format_of_suffix(output)
    if not film and (chosen is None or not chosen.write):  # told before anything is read
        raise unknown_format(output, writing=True)
    not_an_input(output, [mesh] if skeleton is None else [mesh, skeleton])
    shape = open_input(mesh, unit=unit, up=up, options=options)
    bodies = [c for c in shape.characters if c.parts]
    if not bodies:
        raise FormatError("it has no mesh", path=mesh)
    cast = shape if skeleton is None else open_input(skeleton)
    if not cast.characters:
        raise FormatError("it has no skeleton", path=skeleton or mesh)
    body = bodies[0]
    own = body if skeleton is None else cast.character
    with progress_bar("spreading heat", quiet=quiet or as_json) as progress:
        bound, report = skin_character(
            body,
            skeleton=None if skeleton is None else own.skeleton,
            joints=joints,
            max_influences=influences,
            strength=strength,
            method=SkinningMethod.DUAL_QUATERNION if dual_quaternion else SkinningMethod.LINEAR,
            progress=progress,
        )
    animations = cast.animations if clip is None else (cast.animation(clip),)
    scene = Scene((replace(bound, roles=own.roles),), animations, unit_m=shape.unit_m)
    if film:
        from keypose.render import RenderSettings, render_file

        with progress_bar(f"drawing {output.name}", quiet=quiet or as_json) as progress:
            notes = render_file(scene, output, settings=RenderSettings(), progress=progress)
    else:
        notes = io.save(scene, output)
    if as_json:
        print(json.dumps({**asdict(report), "notes": [*report.notes, *(notes or ())]}, indent=1))
        return
    if quiet:
        return
    from rich.markup import escape

    out = console()
    out.print(
        f"[green]wrote[/green] {escape(str(output))} [dim]({output.stat().st_size:,} bytes, "
        f"{bound.vertex_count:,} vertices, {own.skeleton.joint_count} joints)[/dim]"
    )
    for note in (*report.notes, *(notes or ())):
        out.print(f"  [yellow]note[/yellow] {escape(note)}")
    for line in report.lines():
        out.print(f"  {escape(line)}")
