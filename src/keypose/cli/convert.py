"""`keypose convert`: read, write, read back, and print the proof."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from keypose.cli.console import console
from keypose.cli.inputs import file_word, open_input
from keypose.errors import FormatError
from keypose.model import Scene


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
) -> None:
    """Write the inputs as one file and print how far the file read back is from what was written."""
    from keypose import io
    from keypose.io.registry import format_for_writing

    format_for_writing(output)  # an unknown suffix is told before anything is read
    scene = combine(inputs, [open_input(reference, unit=unit, up=up) for reference in inputs])
    if clip is not None:
        scene = replace(scene, animations=(scene.animation(clip),))
    options: dict[str, Any] = {"rate_hz": rate_hz, "unit": out_unit, "order": order}
    write_notes = io.save(scene, output, **{name: value for name, value in options.items() if value is not None})
    if quiet:
        return
    from rich.markup import escape

    out = console()
    out.print(f"[green]wrote[/green] {escape(str(output))} [dim]({output.stat().st_size:,} bytes)[/dim]")
    for note in (*scene.notes, *write_notes):
        out.print(f"  [yellow]note[/yellow] {escape(note)}")
    for line in proof(scene, io.load(output)):
        out.print(f"  {escape(line)}")


def combine(names: list[str], scenes: list[Scene]) -> Scene:
    """One scene of several: motions go to the first character with meshes, matched by joint names.

    Raises:
        FormatError: where a motion has too few of the character's joints to be its own.
    """
    if len(scenes) == 1:
        return scenes[0]
    from keypose.evaluate import bind

    base = next((i for i, s in enumerate(scenes) if any(c.parts for c in s.characters)), 0)
    character = scenes[base].character
    animations = list(scenes[base].animations) if base == 0 else []
    notes = list(scenes[base].notes)
    for i, scene in enumerate(scenes):
        if i == base:
            continue
        for animation in scene.animations:
            bound, share = bind(animation, character)
            if share < 0.5:
                raise FormatError(
                    f"{share:.0%} of its animated joints exist in {names[base]}; the two skeletons differ, so the motion "
                    "cannot be applied by name",
                    path=names[i],
                )
            if share < 1:
                notes.append(
                    f"{names[i]}: {share:.0%} of the animated joints exist in {names[base]}; the others are left out"
                )
            animations.append(bound)
        notes.extend(scene.notes)
    if base != 0:
        animations.extend(scenes[base].animations)
    return replace(scenes[base], animations=tuple(animations), notes=tuple(dict.fromkeys(notes)))


def proof(written: Scene, read: Scene) -> list[str]:
    """Lines that say how far the animation read back is from the one written."""
    from keypose.analysis import roundtrip_error

    if not written.characters or not read.characters:
        return []
    source, result = written.character, read.character
    if not read.animations:
        error = roundtrip_error(source.skeleton, None, result.skeleton, None)
        return [f"rest pose, read back: {error}"]
    worst: Any = None
    for animation in read.animations:
        original = next((a for a in written.animations if a.name == animation.name), written.animations[0])
        error = roundtrip_error(source.skeleton, original, result.skeleton, animation)
        if worst is None or (error.position_mm, error.rotation_deg) > (worst.position_mm, worst.rotation_deg):
            worst = error
    lines = [f"read back: {worst}"]
    if len(read.animations) > 1:
        lines[0] = f"{file_word(len(read.animations), 'clip')} read back, the worst: {worst}"
    if len(read.animations) < len(written.animations):
        lines.append(f"kept {len(read.animations)} of {len(written.animations)} clips; choose one with --clip")
    return lines
