"""`keypose skin`: a mesh bound to a skeleton with automatic weights, written as a file or drawn, with the figures."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path

from keypose.cli.console import progress_bar
from keypose.cli.inputs import file_word, open_input
from keypose.cli.output import check_output, print_written, write_scene
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
        FormatError: where the output's format cannot be written or holds no weights, or an input has no mesh or no skeleton.
        UnknownName: for a joint or a clip that does not exist.
    """
    from keypose.deform import skin_character
    from keypose.io.registry import format_of_suffix, formats
    from keypose.model import SkinningMethod

    check_output(output, [mesh, skeleton])
    held = format_of_suffix(output)
    if held is not None and output.suffix.lower() not in held.skins:
        known = " ".join(suffix for entry in formats() for suffix in entry.skins)
        raise FormatError(f"a {output.suffix} file holds no weights; those that do: {known}", path=output)
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
    notes = [*report.notes, *write_scene(scene, output, quiet=quiet or as_json)]
    if as_json:
        print(json.dumps({**asdict(report), "notes": notes}, indent=1))
    elif not quiet:
        facts = f"{file_word(bound.vertex_count, 'vertex', 'vertices')}, {file_word(own.skeleton.joint_count, 'joint')}"
        print_written(output, facts, notes, report.lines())
