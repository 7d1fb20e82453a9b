"""`keypose roles`: which joint plays which role in the body, listed, or written as a map to be corrected by hand."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from keypose.cli.console import console
from keypose.cli.inputs import AS_THEY_SAY, Reading, body_of, open_input
from keypose.cli.output import not_an_input, print_json
from keypose.errors import FormatError
from keypose.model import Skeleton

if TYPE_CHECKING:
    from keypose.analysis import RoleMap


def print_roles(reference: str, output: Path | None, *, reading: Reading = AS_THEY_SAY, as_json: bool = False) -> bool:
    """Print which joint plays which role, or write that as a map; returns whether everything needed was found.

    Raises:
        FormatError: where the file has no skeleton, or the map's name is not that of another file ending with .json.
    """
    from keypose.analysis import find_roles
    from keypose.io.atomic import check_place, replacing

    if output is not None:
        not_an_input(output, [reference])
        if output.suffix.lower() != ".json":
            raise FormatError("expected a name that ends with .json for the map", path=output)
        check_place(output)
    character = body_of(open_input(reference, reading), reference)
    found = find_roles(character.skeleton, known=character.roles or None)
    names = character.skeleton.names
    if output is not None:
        with replacing(output) as path:
            path.write_text(found.to_json(character.skeleton) + "\n", encoding="utf-8")
    if as_json:
        rows: dict[str, Any] = {
            role: {"joint": names[j], "confidence": found.confidence[role]} for role, j in found.roles.items()
        }
        print_json({"roles": rows, "missing": list(found.missing), "notes": list(found.notes)})
    else:
        _print_table(found, character.skeleton)
    return not found.missing


def _print_table(found: RoleMap, skeleton: Skeleton) -> None:
    from rich.markup import escape
    from rich.table import Table

    out = console()
    table = Table(box=None, pad_edge=False)
    for title in ("role", "joint", "sure"):
        table.add_column(title, header_style="dim", justify="right" if title == "sure" else "left")
    for role, joint in found.roles.items():
        sure = found.confidence[role]
        shade = "green" if sure >= 0.9 else "yellow" if sure > 0.5 else "red"
        table.add_row(role, escape(skeleton.names[joint]), f"[{shade}]{sure:.0%}[/{shade}]")
    out.print(table)
    for note in found.notes:
        out.print(f"[yellow]note[/yellow] {escape(note)}")
    if found.missing:
        out.print(f"[red]no humanoid or animal:[/red] nothing plays {', '.join(found.missing)}")
