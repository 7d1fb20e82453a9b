"""The verbs and their options; each one's work is in its own module, imported when it runs."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from keypose.cli.arguments import (
    ClipOption,
    FormatOptions,
    Host,
    JsonOption,
    NoBrowser,
    OneInput,
    Port,
    QuietOption,
    RateOption,
    Remote,
    SkeletonFile,
    Theme,
    UnitOption,
    UpOption,
    examples,
)
from keypose.cli.verbs import verbs

app = typer.Typer(
    help="Character animation: look at it, convert it, render it, measure it.",
    epilog="Wherever a FILE is asked, sample:NAME names a built-in character or performance: sample:human, sample:walk.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _version(asked: bool) -> None:
    if asked:
        import keypose

        typer.echo(f"keypose {keypose.__version__}")
        raise typer.Exit


def _formats(asked: bool) -> None:
    if asked:
        from keypose.cli.options import print_formats

        print_formats()
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Options before the verb."""


@app.command(epilog=examples("keypose demo", "keypose demo --no-browser --port 8123"))
def demo(host: Host = "127.0.0.1", port: Port = 0, no_browser: NoBrowser = False, allow_remote: Remote = False) -> None:
    """Open the studio on the built-in character, walking; its Play page lets you drive it."""
    from keypose.cli.studio import open_studio

    open_studio(["sample:human"], host=host, port=port, open_browser=not no_browser, allow_remote=allow_remote)


_StudioInputs = Annotated[
    list[str] | None, typer.Argument(metavar="FILE", help="Files, or sample:NAME.", show_default=False)
]


@app.command(epilog=examples("keypose studio walk.bvh character.glb", "keypose studio --no-browser --port 8123"))
def studio(
    files: _StudioInputs = None,
    host: Host = "127.0.0.1",
    port: Port = 0,
    no_browser: NoBrowser = False,
    allow_remote: Remote = False,
) -> None:
    """Open files in the browser studio; more can be dropped on its page."""
    from keypose.cli.studio import open_studio

    open_studio(files or [], host=host, port=port, open_browser=not no_browser, allow_remote=allow_remote)


@app.command(
    epilog=examples(
        "keypose play [dim]# the built-in character: WASD, Shift, Space[/dim]",
        "keypose play game.json [dim]# your graph; its clips lie beside it[/dim]",
        "keypose play walk.bvh character.glb [dim]# no graph: to look at[/dim]",
    )
)
def play(
    files: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="GRAPH|FILE",
            help="A graph's JSON, locomotion, or files to look at; locomotion if not given.",
            show_default=False,
        ),
    ] = None,
    host: Host = "127.0.0.1",
    port: Port = 0,
    no_browser: NoBrowser = False,
    allow_remote: Remote = False,
) -> None:
    """Drive a character through an animation graph with keyboard or gamepad, in the browser studio."""
    from keypose.cli.studio import open_studio

    references = files or ["sample:locomotion"]
    open_studio(references, host=host, port=port, open_browser=not no_browser, allow_remote=allow_remote)


@app.command(
    epilog=examples(
        "keypose info walk.bvh", "keypose info character.glb --json | jq .clips", "keypose info sample:human"
    )
)
def info(
    file: OneInput,
    json: JsonOption = False,
    unit: UnitOption = None,
    up: UpOption = None,
    skeleton: SkeletonFile = None,
    option: FormatOptions = None,
) -> None:
    """Say what a file holds, and everything that was guessed, repaired or dropped on reading it."""
    from keypose.cli.info import print_info
    from keypose.cli.inputs import Reading

    print_info(file, reading=Reading(unit, up, skeleton, option or ()), as_json=json)


@app.command(
    epilog=examples(
        "keypose check walk.bvh",
        "keypose check character.glb --json | jq .findings",
        "keypose check take.bvh --strict [dim]# exit code 1 where anything is wrong[/dim]",
        "keypose check take.bvh --quality --json [dim]# skating feet, pops, loops in figures[/dim]",
        "keypose check take.bvh --fail-on 'skate>2,sink>1' [dim]# exit code 1; also limits.toml[/dim]",
        "keypose check take.bvh --plot quality.png [dim]# contacts, sliding, pops over time[/dim]",
    )
)
def check(
    file: OneInput,
    json: JsonOption = False,
    strict: Annotated[bool, typer.Option("--strict", help="Fail where there is a warning.")] = False,
    quality: Annotated[
        bool, typer.Option("--quality", help="Measure the motions: sliding feet, pops, overlaps, loops.")
    ] = False,
    against: Annotated[
        str | None,
        typer.Option("--against", metavar="FILE", help="Compare with another take, of this skeleton or of another."),
    ] = None,
    fail_on: Annotated[
        list[str] | None,
        typer.Option("--fail-on", metavar="DEMANDS", help="skate>2,sink>1 or a .toml or .json: exit code 1 if so."),
    ] = None,
    plot: Annotated[
        Path | None, typer.Option("--plot", metavar="PNG", help="Draw the first motion's quality over time.")
    ] = None,
    theme: Annotated[Theme, typer.Option("--theme", help="Light or dark, for --plot.")] = Theme.light,
    clip: ClipOption = None,
    unit: UnitOption = None,
    up: UpOption = None,
    skeleton: SkeletonFile = None,
    option: FormatOptions = None,
) -> None:
    """Say how a file was understood (unit, axes, facing, rest pose, size, rates), and what is wrong with it."""
    from keypose.cli.check import QualityAsked, print_check, print_quality
    from keypose.cli.inputs import Reading

    reading = Reading(unit, up, skeleton, option or ())
    if quality or against is not None or fail_on or plot is not None:
        asked = QualityAsked(against, fail_on or (), plot, theme.value)
        if not print_quality(file, asked, clip=clip, reading=reading, as_json=json):
            raise typer.Exit(1)
        return
    if not print_check(file, reading=reading, as_json=json) and strict:
        raise typer.Exit(1)


@app.command(
    epilog=examples(
        "keypose convert take.bvh take.glb",
        "keypose convert walk.bvh character.glb walking.glb",
        "keypose convert character.glb run.bvh --clip Run --rate 60",
        "keypose convert take.fbx take.glb --strict [dim]# exit code 1 where anything was lost[/dim]",
        "keypose convert 01_01.amc take.bvh --skeleton 01.asf",
        "keypose convert take.bvh take.npz --option layout=amass",
        "keypose convert --formats [dim]# all formats with their options[/dim]",
    )
)
def convert(
    files: Annotated[
        list[str], typer.Argument(metavar="IN... OUT", help="Files to read, then the one to write.", show_default=False)
    ],
    clip: ClipOption = None,
    rate: RateOption = None,
    unit: UnitOption = None,
    up: UpOption = None,
    out_unit: Annotated[
        str | None, typer.Option("--out-unit", help="Unit to write (BVH; else as it was read).")
    ] = None,
    order: Annotated[str | None, typer.Option("--order", help="Rotation order to write (BVH), such as ZXY.")] = None,
    quiet: QuietOption = False,
    strict: Annotated[
        bool, typer.Option("--strict", help="Fail where the result is not within the limits, or lacks something.")
    ] = False,
    limit_mm: Annotated[
        float, typer.Option("--limit-mm", help="For --strict: joints, vertices, markers.", min=0)
    ] = 1e-3,
    limit_deg: Annotated[float, typer.Option("--limit-deg", help="For --strict: rotations.", min=0)] = 1e-4,
    limit_relative: Annotated[
        float,
        typer.Option("--limit-relative", help="For --strict: places, as a share of the size; for large ones.", min=0),
    ] = 0.0,
    skeleton: SkeletonFile = None,
    option: FormatOptions = None,
    skip: Annotated[int, typer.Option("--skip", help="Leave out so many frames at the start.", min=0)] = 0,
    scale: Annotated[float, typer.Option("--scale", help="Multiply all lengths.", min=1e-9)] = 1.0,
    turn: Annotated[
        float, typer.Option("--turn", help="Turn about the vertical, in degrees; 90 brings +Z to +X.")
    ] = 0.0,
    lift: Annotated[float, typer.Option("--raise", help="Lift everything by so many metres.")] = 0.0,
    influences: Annotated[
        int | None, typer.Option("--influences", help="Joints that may move a vertex, at most.", min=1, max=64)
    ] = None,
    formats: Annotated[
        bool, typer.Option("--formats", callback=_formats, is_eager=True, help="List all formats and their options.")
    ] = False,
) -> None:
    """Convert between formats, read the result back and print how exact it is."""
    from keypose.cli.convert import Changes, Strictness, convert_files
    from keypose.cli.inputs import Reading

    if len(files) < 2:
        raise typer.BadParameter("expected at least one input and the output", param_hint="IN... OUT")
    convert_files(
        files[:-1],
        Path(files[-1]),
        clip=clip,
        changes=Changes(skip, scale, turn, lift, rate, influences),
        out_unit=out_unit,
        order=order,
        reading=Reading(unit, up, skeleton, option or ()),
        quiet=quiet,
        strictness=Strictness(strict, limit_mm, limit_deg, limit_relative),
    )


app.registered_commands += verbs.registered_commands


class Backend(StrEnum):
    """What draws."""

    auto = "auto"
    gl = "gl"
    cpu = "cpu"


class View(StrEnum):
    """Where the camera stands."""

    front = "front"
    side = "side"
    back = "back"
    top = "top"
    three_quarter = "three-quarter"


@app.command(
    epilog=examples(
        "keypose render character.glb out.mp4",
        "keypose render walk.bvh walk.gif --size 480x480 --view side",
        "keypose render sample:human portrait.png --time 0.5",
        "keypose render sample:walk sheet.png --sheet 12",
        "keypose render sample:human around.mp4 --turntable",
    )
)
def render(
    files: Annotated[
        list[str],
        typer.Argument(
            metavar="IN... OUT", help="Files to draw, then the .png, .gif, .mp4 or .webm.", show_default=False
        ),
    ],
    clip: ClipOption = None,
    size: Annotated[str, typer.Option("--size", help="Width x height in pixels.")] = "1280x720",
    rate: Annotated[float, typer.Option("--rate", help="Frames per second.", min=1, max=240)] = 30.0,
    time: Annotated[float | None, typer.Option("--time", help="Moment of a still picture, in seconds.")] = None,
    start: Annotated[float | None, typer.Option("--start", help="First moment, in seconds.")] = None,
    end: Annotated[float | None, typer.Option("--end", help="Last moment, in seconds.")] = None,
    view: Annotated[View, typer.Option("--view", help="Where the camera stands.")] = View.three_quarter,
    follow: Annotated[bool, typer.Option("--follow", help="Let the camera travel with the character.")] = False,
    turntable: Annotated[bool, typer.Option("--turntable", help="Turn once around the character.")] = False,
    sheet: Annotated[int, typer.Option("--sheet", help="Number of frames on a contact sheet.", min=0, max=400)] = 0,
    bones: Annotated[bool, typer.Option("--bones", help="Draw the skeleton over the mesh.")] = False,
    skeleton: SkeletonFile = None,
    theme: Annotated[Theme, typer.Option("--theme", help="Light or dark.")] = Theme.light,
    backend: Annotated[Backend, typer.Option("--backend", help="OpenGL, or the software rasteriser.")] = Backend.auto,
    unit: UnitOption = None,
    up: UpOption = None,
    quiet: QuietOption = False,
) -> None:
    """Draw a picture, a video, a contact sheet or a turntable, without a screen."""
    from keypose.cli.inputs import Reading
    from keypose.cli.render import render_files

    if len(files) < 2:
        raise typer.BadParameter("expected at least one input and the output", param_hint="IN... OUT")
    width, _, height = size.lower().partition("x")
    if not (width.isdecimal() and height.isdecimal() and 16 <= int(width) <= 8192 and 16 <= int(height) <= 8192):
        raise typer.BadParameter(f"'{size}': expected WIDTHxHEIGHT, each from 16 to 8192", param_hint="--size")
    render_files(
        files[:-1],
        Path(files[-1]),
        clip=clip,
        size=(int(width), int(height)),
        rate_hz=rate,
        time_s=time,
        span_s=(start, end),
        view=view.value,
        follow=follow,
        turntable=turntable,
        sheet=sheet,
        bones=bones,
        theme=theme.value,
        backend=backend.value,
        reading=Reading(unit, up, skeleton),
        quiet=quiet,
    )


@app.command(
    epilog=examples(
        "keypose graph sample:locomotion out.glb --seconds 6",
        "keypose graph game.json out.mp4 --inputs keys.json",
        """echo '[{"at_s": 0, "set": {"speed": 1.2}}, {"at_s": 2, "set": {"jump": true}}]' > keys.json""",
    )
)
def graph(
    graph: Annotated[str, typer.Argument(metavar="GRAPH", help="A graph's JSON, or sample:NAME.", show_default=False)],
    output: Annotated[
        Path, typer.Argument(metavar="OUT", help="A .glb, .gltf or .bvh, or a picture or film.", show_default=False)
    ],
    inputs: Annotated[
        Path | None, typer.Option("--inputs", help="JSON of parameters over time; the graph's defaults if not given.")
    ] = None,
    seconds: Annotated[float, typer.Option("--seconds", help="How long to run.", min=0.01, max=3600)] = 5.0,
    rate: Annotated[float, typer.Option("--rate", help="Steps per second.", min=1, max=1000)] = 60.0,
    quiet: QuietOption = False,
) -> None:
    """Run an animation graph headless and bake what it does into a file."""
    from keypose.cli.graph import bake_graph

    bake_graph(graph, output, inputs=inputs, duration_s=seconds, rate_hz=rate, quiet=quiet)


@app.command(epilog=examples("keypose bench", "keypose bench kernels --json kernels.json"))
def bench(
    name: Annotated[
        str | None,
        typer.Argument(metavar="NAME", help="kernels, bvh, fk, runtime, io, curves, ik; all if not given."),
    ] = None,
    json: Annotated[Path | None, typer.Option("--json", metavar="FILE", help="Write the results as JSON.")] = None,
    rounds: Annotated[int, typer.Option("--rounds", help="How often every case is timed.", min=3, max=500)] = 15,
) -> None:
    """Measure this machine: our kernels beside other libraries and the machine's own limits, as ratios."""
    from keypose.cli.bench import run_bench

    run_bench(name, json, rounds)
