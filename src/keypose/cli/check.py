"""`keypose check`: the doctor."""

from __future__ import annotations

import json
import shlex
from dataclasses import asdict
from typing import Any

from keypose.cli.console import console
from keypose.cli.inputs import open_input

_SIGNS = {"fact": "[blue]fact[/blue]   ", "guess": "[yellow]guess[/yellow]  ", "warning": "[red]warning[/red]"}


def print_check(reference: str, *, as_json: bool, unit: str | None, up: str | None) -> bool:
    """Print how a file was understood and what is wrong with it; whether nothing is."""
    from keypose.analysis import examine
    from keypose.io.axes import unit_name

    found = examine(open_input(reference, unit=unit, up=up))
    facts = {"file": reference, "unit": unit_name(found.facts["unit_m"]), **found.facts}
    if as_json:
        rows = [{**asdict(f), "fix": _command(f.fix, reference)} for f in found.findings]
        print(json.dumps({**facts, "findings": rows}, indent=1, ensure_ascii=False))
        return not found.warnings
    from rich.markup import escape
    from rich.table import Table

    out = console()
    out.print(f"[bold]{escape(reference)}[/bold]  [dim]{escape(str(facts['format']))}[/dim]")
    table = Table(box=None, show_header=False, pad_edge=False, padding=(0, 2, 0, 0))
    for name, text in _lines(facts):
        table.add_row(f"  [dim]{name}[/dim]", escape(text))
    out.print(table)
    for f in sorted(found.findings, key=lambda f: ("warning", "guess", "fact").index(f.level)):
        out.print(f"  {_SIGNS[f.level]} {escape(f.topic)}: {escape(f.text)}")
        if f.fix:
            out.print(f"          [dim]{escape(_command(f.fix, reference))}[/dim]")
    count = len(found.warnings)
    out.print("  [green]nothing wrong[/green]" if not count else f"  [red]{count} warning{'s' * (count != 1)}[/red]")
    return not count


def _command(fix: str, reference: str) -> str:
    return fix.replace("FILE", shlex.quote(reference)) if fix.startswith("keypose") else fix


def _lines(facts: dict[str, Any]) -> list[tuple[str, str]]:
    lines = [("unit, up", f"{facts['unit']}, {facts['up']} up")]
    if facts.get("forward"):
        sides = "" if facts["handedness"] == "right" else f", {facts['handedness']}"
        lines.append(("faces", facts["forward"] + sides))
    if facts.get("rest_pose"):
        pairs = facts["sides"]["pairs"]
        text = f"{facts['rest_pose']} pose" if facts["rest_pose"] in ("T", "A") else facts["rest_pose"]
        lines.append(("rest", f"{text}; {pairs} joint pair{'s' * (pairs != 1)} left and right" if pairs else text))
    if facts.get("stature_m"):
        lines.append(("stature", f"{facts['stature_m']:.2f} m, lowest point {facts['ground_m']:+.3f} m"))
    if facts.get("euler_orders"):
        orders = ", ".join(f"{order} x{count}" for order, count in facts["euler_orders"].items())
        odd = facts["euler_exceptions"]
        few = ", ".join(f"{name} {order}" for name, order in list(odd.items())[:4])
        lines.append(("Euler orders", orders + (f" ({few})" if odd else "")))
    if facts.get("rate_hz"):
        lines.append(("rate", f"{facts['rate_hz']:.6g} Hz"))
    if facts.get("clips"):
        lines.append(("clips", str(facts["clips"])))
    if facts.get("markers"):
        lines.append(("markers", f"{facts['markers']}, {100 * facts['missing_share']:.2g}% missing"))
    signals = facts.get("signals", ())
    lines += [(s["kind"], f"{s['channels']} channels at {s['rate_hz']:.6g} Hz") for s in signals]
    if facts.get("force_plates"):
        lines.append(("force plates", str(facts["force_plates"])))
    return lines
