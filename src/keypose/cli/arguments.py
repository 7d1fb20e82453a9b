"""What several verbs take: their arguments and options, in one wording."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

OneInput = Annotated[str, typer.Argument(metavar="FILE", help="A file, or sample:NAME.", show_default=False)]
MotionInput = Annotated[
    str, typer.Argument(metavar="MOTION", help="A file with a motion, or sample:NAME.", show_default=False)
]
SceneOutput = Annotated[
    Path, typer.Argument(metavar="OUT", help="The file to write, or a picture or film.", show_default=False)
]
ClipOption = Annotated[str | None, typer.Option("--clip", help="Name of the animation; the first one if not given.")]
# No capture is faster; what asks for more would fill the memory with frames.
RateOption = Annotated[
    float | None, typer.Option("--rate", help="Frames per second of the output.", min=0.001, max=100_000)
]
UnitOption = Annotated[
    str | None,
    typer.Option("--unit", help="Unit of a file that does not say: m, cm, mm, inch, foot, or metres as a number."),
]
UpOption = Annotated[str | None, typer.Option("--up", help="Up axis of a file that does not say: X, Y or Z.")]
SkeletonFile = Annotated[
    str | None, typer.Option("--skeleton", metavar="FILE", help="The ASF skeleton of an AMC motion.")
]
RolesOption = Annotated[
    Path | None, typer.Option("--roles", metavar="MAP", help="Roles of the joints (keypose roles).")
]
FormatOptions = Annotated[
    list[str] | None,
    typer.Option(
        "--option", "-o", metavar="NAME=VALUE", help="An option of the format; keypose convert --formats lists them."
    ),
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON object.")]
QuietOption = Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors.")]
Host = Annotated[str, typer.Option(help="Address to listen on; only this machine can reach the default.")]
Port = Annotated[int, typer.Option(help="Port to listen on; 0 takes a free one.", min=0, max=65535)]
Remote = Annotated[
    bool,
    typer.Option(
        "--allow-remote", help="Let --host be an address that other machines reach. Anyone with the URL can look."
    ),
]
NoBrowser = Annotated[bool, typer.Option("--no-browser", help="Only print the URL.")]


class Theme(StrEnum):
    """The look of the picture."""

    light = "light"
    dark = "dark"


def examples(*lines: str) -> str:
    """The end of a verb's help: what a user may type."""
    return "[bold]Examples[/bold]\n\n" + "\n\n".join(f"[dim]$[/dim] {line}" for line in lines)
