"""`keypose convert`: read, write, read back, and print the proof."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from keypose.cli.console import console
from keypose.cli.inputs import open_inputs, unit_option
from keypose.errors import FormatError
from keypose.model import Clip, Motion, Scene


class ConversionError(FormatError):
    """The file that was written does not hold what it should."""


def convert_files(
    inputs: list[str],
    output: Path,
    *,
    clip: str | None,
    rate_hz: float | None,
    unit: str | None,
    up: str | None,
    out_unit: str | None,
    order: str | None,
    quiet: bool,
    strict: bool = False,
    limit_mm: float = 1e-3,
    limit_deg: float = 1e-4,
) -> None:
    """Write the inputs as one file and print how far the file read back is from what was written.

    Raises:
        ConversionError: with ``strict``, where it is farther than the limits or something was not kept.
    """
    from keypose import io
    from keypose.io.registry import format_of_suffix, unknown_format

    chosen = format_of_suffix(output)
    if chosen is None or not chosen.write:  # told before anything is read
        raise unknown_format(output, writing=True)
    scene = combine(inputs, open_inputs(inputs, unit=unit, up=up))
    if clip is not None:
        scene = replace(scene, animations=(scene.animation(clip),))
    options: dict[str, Any] = {
        "rate_hz": rate_hz,
        "unit": None if out_unit is None else unit_option(out_unit),
        "order": order,
    }
    write_notes = io.save(scene, output, **{name: value for name, value in options.items() if value is not None})
    if quiet and not strict:
        return
    from keypose.analysis import scene_error

    error = scene_error(scene, _read_back(scene, output, out_unit))
    if strict and not error.within(limit_mm, limit_deg):
        worst = "; ".join(error.lines())
        raise ConversionError(
            f"not within {limit_mm:g} mm and {limit_deg:g} degrees of what was read: {worst}", path=output
        )
    if quiet:
        return
    from rich.markup import escape

    out = console()
    out.print(f"[green]wrote[/green] {escape(str(output))} [dim]({output.stat().st_size:,} bytes)[/dim]")
    for note in (*scene.notes, *write_notes):
        out.print(f"  [yellow]note[/yellow] {escape(note)}")
    for line in [*_unsaid(scene, output, out_unit), *error.lines()]:
        out.print(f"  {escape(line)}")


def _bvh_conventions(scene: Scene, out_unit: str | None) -> dict[str, Any]:
    from keypose.io.bvh_writer import written_as

    unit_m, up = written_as(scene.character, unit=None if out_unit is None else unit_option(out_unit))
    return {"unit": unit_m, "up": up}


def _conventions(scene: Scene, output: Path, out_unit: str | None) -> dict[str, Any]:
    """Unit and axes of a written file whose format says them not at all or in part; empty for others."""
    suffix = output.suffix.lower()
    if suffix == ".bvh":
        return _bvh_conventions(scene, out_unit)
    if suffix in (".trc", ".csm"):
        from keypose.io.marker_tables import written_as

        unit_m, up = written_as(scene, suffix[1:].upper(), None if out_unit is None else unit_option(out_unit))
        return {"unit": unit_m, "up": up}
    return {}


def _read_back(scene: Scene, output: Path, out_unit: str | None) -> Scene:
    """The file as it was meant: one that does not say its unit or axes is read in those it was written in."""
    from keypose import io

    return io.load(output, **_conventions(scene, output, out_unit))


def _unsaid(scene: Scene, output: Path, out_unit: str | None) -> list[str]:
    """A warning where a reader of the file would guess another unit or axis than was written."""
    from keypose import io
    from keypose.io.axes import unit_name

    meant = _conventions(scene, output, out_unit)
    if not meant:
        return []
    guessed = io.load(output)
    if abs(guessed.unit_m / meant["unit"] - 1) < 1e-6 and guessed.up == meant["up"]:
        return []
    return [
        f"{output.suffix[1:].upper()} does not say its {'axes' if guessed.format == 'trc' else 'unit and axes'}: read it with "
        f"--unit {unit_name(meant['unit']).removesuffix(' m')} --up {meant['up']}; it looks like "
        f"{unit_name(guessed.unit_m)}, {guessed.up} up"
    ]


def combine(names: list[str], scenes: list[Scene]) -> Scene:
    """One scene of several: motions go to the first character with meshes, matched by joint names.

    Raises:
        FormatError: where a motion has too few of the character's joints to be its own.
    """
    if len(scenes) == 1:
        return scenes[0]
    from keypose.evaluate import match, match_report

    base = next((i for i, s in enumerate(scenes) if any(c.parts for c in s.characters)), 0)
    skeleton = scenes[base].character.skeleton
    animations, notes = list(scenes[base].animations), list(scenes[base].notes)
    for i, scene in enumerate(scenes):
        if i == base:
            continue
        added: list[Motion | Clip] = []
        for animation in scene.animations:
            report = match_report(animation, skeleton)
            animated = len(report.sources) + len(report.unused)
            if len(report.sources) * 2 < animated:
                raise FormatError(
                    f"only {len(report.sources)} of its {animated} animated joints have a namesake in {names[base]}; "
                    "the skeletons differ, so the motion cannot be applied by name",
                    path=names[i],
                )
            notes.extend(f"{names[i]}: {note}" for note in report.notes)
            added.append(match(animation, skeleton))
        notes.extend(scene.notes)
        # The order of the inputs is the order of the clips.
        animations = animations + added if i > base else added + animations
    return replace(scenes[base], animations=tuple(animations), notes=tuple(dict.fromkeys(notes)))
