"""Writing what a verb made: refused early, as a file or drawn, and said."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from keypose.cli.console import console, counted, progress_bar
from keypose.errors import FormatError
from keypose.model import Motion, Scene

_DRAWN = (".png", ".gif", ".mp4", ".webm")


def check_output(output: Path, inputs: Sequence[str | None] = ()) -> None:
    """Refuse an output before any work is done for it: a format that is not written, an input, a place that takes no file.

    Raises:
        FormatError: where that is so.
    """
    from keypose.io.atomic import check_place
    from keypose.io.registry import format_of_suffix, unknown_format

    chosen = format_of_suffix(output)
    if not _is_drawn(output) and (chosen is None or not chosen.write):
        raise unknown_format(output, writing=True)
    not_an_input(output, inputs)
    check_place(output)


def not_an_input(output: Path, inputs: Sequence[str | None]) -> None:
    """A file that is read is never written over: what the output's format cannot hold would be lost.

    Raises:
        FormatError: where the output is one of the inputs.
    """
    for name in inputs:
        if name is None or name.startswith("sample:"):
            continue
        if output.exists() and Path(name).exists() and output.samefile(name):
            raise FormatError("is one of the inputs, which would be lost; name another file to write", path=output)


def write_scene(scene: Scene, output: Path, *, quiet: bool) -> list[str]:
    """Save a scene, or draw it where the output is a picture or a film; returns what is to be said of that."""
    if _is_drawn(output):
        from keypose.render import RenderSettings, render_file

        with progress_bar(f"drawing {output.name}", quiet=quiet) as progress:
            return list(render_file(scene, output, settings=RenderSettings(), progress=progress) or ())
    from keypose import io

    return list(io.save(scene, output))


def print_written(output: Path, facts: str = "", notes: Iterable[str] = (), lines: Iterable[str] = ()) -> None:
    """Say that a file was written, what is in it, and what is to be known about it."""
    from rich.markup import escape

    out = console()
    inside = ", ".join(part for part in (f"{output.stat().st_size:,} bytes", facts) if part)
    out.print(f"[green]wrote[/green] {escape(str(output))} [dim]({escape(inside)})[/dim]")
    for note in notes:
        out.print(f"  [yellow]note[/yellow] {escape(note)}")
    for line in lines:
        out.print(f"  {escape(line)}")


def motion_words(motion: Motion) -> str:
    """``125 frames at 60 Hz``."""
    return f"{counted(motion.frame_count, 'frame')} at {motion.rate_hz:g} Hz"


def motion_facts(output: Path, motion: Motion) -> dict[str, Any]:
    """The file that was written, and the frames in it, for programs."""
    return {"file": str(output), "frames": motion.frame_count, "rate_hz": motion.rate_hz}


def print_json(facts: Mapping[str, Any]) -> None:
    """One object for programs."""
    print(json.dumps(facts, indent=1, ensure_ascii=False))


def _is_drawn(output: Path) -> bool:
    return output.suffix.lower() in _DRAWN
