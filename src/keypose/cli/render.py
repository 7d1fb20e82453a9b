"""`keypose render`: pictures and films without a screen."""

from __future__ import annotations

from pathlib import Path

from keypose.cli.console import console, progress_bar
from keypose.cli.convert import combine
from keypose.cli.inputs import open_inputs


def render_files(
    inputs: list[str],
    output: Path,
    *,
    clip: str | None,
    size: tuple[int, int],
    rate_hz: float,
    time_s: float | None,
    span_s: tuple[float | None, float | None],
    view: str,
    follow: bool,
    turntable: bool,
    sheet: int,
    bones: bool,
    skeleton: str | None,
    theme: str,
    backend: str,
    unit: str | None,
    up: str | None,
    quiet: bool,
) -> None:
    """Draw the inputs into one file, chosen by its suffix."""
    from keypose.render import Camera, RenderSettings, render_file

    settings = RenderSettings(
        width=size[0],
        height=size[1],
        rate_hz=rate_hz,
        start_s=span_s[0],
        end_s=span_s[1],
        camera=Camera.preset(view.replace("-", "_"), follow=True if follow else None),
        theme=theme,
        skeleton=bones,
        backend=backend,
        sheet_frames=sheet or 12,
    )
    scene = combine(inputs, open_inputs(inputs, unit=unit, up=up, skeleton=skeleton))
    with progress_bar(f"drawing {output.name}", quiet=quiet) as progress:
        notes = render_file(
            scene,
            output,
            animation=clip,
            time_s=time_s,
            settings=settings,
            sheet=bool(sheet),
            turntable=turntable,
            progress=progress,
        )
    if quiet:
        return
    from rich.markup import escape

    out = console()
    out.print(f"[green]wrote[/green] {escape(str(output))} [dim]({output.stat().st_size:,} bytes)[/dim]")
    for note in (*scene.notes, *(notes or ())):
        out.print(f"  [yellow]note[/yellow] {escape(note)}")
