"""`keypose graph`: run an animation graph headless, bake it, and say what happened when."""

from __future__ import annotations

from pathlib import Path

from keypose.cli.console import console, progress_bar
from keypose.errors import FormatError


def bake_graph(
    reference: str, output: Path, *, inputs: Path | None, duration_s: float, rate_hz: float, quiet: bool
) -> None:
    """Run a graph from its first state and write its motion on its character."""
    from keypose import io
    from keypose.io.registry import format_of_suffix, unknown_format
    from keypose.play import graph as g
    from keypose.samples import PREFIX, graphs, open_scene

    film = output.suffix.lower() in (".png", ".gif", ".mp4", ".webm")
    chosen = format_of_suffix(output)
    if not film and (chosen is None or not chosen.write):
        raise unknown_format(output, writing=True)
    definition = graphs.load(reference.removeprefix(PREFIX)) if reference.startswith(PREFIX) else g.load(reference)
    given: tuple[g.Inputs, ...] = ()
    if inputs is not None:
        try:
            given = g.inputs_from_json(inputs.read_bytes())
        except FormatError as error:
            raise error.at(inputs) from None
    run = g.run(definition, given, duration_s=duration_s, rate_hz=rate_hz, open_scene=open_scene)
    if film:
        from keypose.render import RenderSettings, render_file

        with progress_bar(f"drawing {output.name}", quiet=quiet) as progress:
            notes = render_file(run.scene(), output, settings=RenderSettings(), progress=progress)
    else:
        notes = io.save(run.scene(), output)
    if quiet:
        return
    from rich.markup import escape

    out = console()
    lines = [(t, f"{c.machine}: {c.source} → {c.target} ({c.kind}, {c.duration_s:g} s)") for t, c in run.changes]
    lines += [(t, f"event {e.name} of {e.clip}") for t, e in run.events]
    for time_s, line in sorted(lines):
        out.print(f"  [dim]{time_s:7.3f} s[/dim]  {escape(line)}")
    out.print(f"[green]wrote[/green] {escape(str(output))} [dim]({output.stat().st_size:,} bytes)[/dim]")
    for note in notes or ():
        out.print(f"  [yellow]note[/yellow] {escape(note)}")
