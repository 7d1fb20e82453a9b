"""`keypose graph`: run an animation graph headless, bake it, and say what happened when."""

from __future__ import annotations

from pathlib import Path

from keypose.cli.console import console
from keypose.cli.output import check_output, print_written, write_scene
from keypose.errors import FormatError


def bake_graph(
    reference: str, output: Path, *, inputs: Path | None, duration_s: float, rate_hz: float, quiet: bool
) -> None:
    """Run a graph from its first state and write its motion on its character.

    Raises:
        FormatError: where the graph or its inputs cannot be read, or the output's format cannot be written.
    """
    from keypose.play import graph as g
    from keypose.samples import PREFIX, graphs, open_scene

    check_output(output)
    definition = graphs.load(reference.removeprefix(PREFIX)) if reference.startswith(PREFIX) else g.load(reference)
    given: tuple[g.Inputs, ...] = ()
    if inputs is not None:
        try:
            given = g.inputs_from_json(inputs.read_bytes())
        except FormatError as error:
            raise error.at(inputs) from None
    run = g.run(definition, given, duration_s=duration_s, rate_hz=rate_hz, open_scene=open_scene)
    notes = write_scene(run.scene(), output, quiet=quiet)
    if quiet:
        return
    from rich.markup import escape

    out = console()
    lines = [(t, f"{c.machine}: {c.source} → {c.target} ({c.kind}, {c.duration_s:g} s)") for t, c in run.changes]
    lines += [(t, f"event {e.name} of {e.clip}") for t, e in run.events]
    for time_s, line in sorted(lines):
        out.print(f"  [dim]{time_s:7.3f} s[/dim]  {escape(line)}")
    print_written(output, notes=notes)
