"""`keypose skin`: a mesh bound to a skeleton with automatic weights, written as a file or drawn, with the figures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path

from keypose.cli.console import counted, progress_bar
from keypose.cli.inputs import AS_THEY_SAY, Reading, body_of, open_input
from keypose.cli.output import check_output, print_json, print_written, write_scene
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
    reading: Reading = AS_THEY_SAY,
    as_json: bool = False,
    quiet: bool = False,
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
    shape = open_input(mesh, reading)
    bodies = [c for c in shape.characters if c.parts]
    if not bodies:
        raise FormatError("it has no mesh", path=mesh)
    cast = shape if skeleton is None else open_input(skeleton)
    body = bodies[0]
    own = body if skeleton is None else body_of(cast, skeleton)
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
        print_json({**asdict(report), "notes": notes})
    elif not quiet:
        facts = f"{counted(bound.vertex_count, 'vertex', 'vertices')}, {counted(own.skeleton.joint_count, 'joint')}"
        print_written(output, facts, notes, report.lines())
