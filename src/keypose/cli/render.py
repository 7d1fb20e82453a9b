"""`keypose render`: pictures and films without a screen."""

from __future__ import annotations

from pathlib import Path

from keypose.cli.console import progress_bar
from keypose.cli.convert import combine
from keypose.cli.inputs import Reading, open_inputs
from keypose.cli.output import print_written


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
    theme: str,
    backend: str,
    reading: Reading,
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
    scene = combine(inputs, open_inputs(inputs, reading))
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
    if not quiet:
        print_written(output, notes=(*scene.notes, *(notes or ())))
