"""`keypose check`: the doctor."""

from __future__ import annotations

import json
import shlex
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from keypose.cli.console import console
from keypose.cli.inputs import open_input
from keypose.errors import FormatError
from keypose.model import Motion, Scene, Skeleton

_SIGNS = {
    "warning": "[red]warning[/red]",
    "guess": "[yellow]guess[/yellow]  ",
    "loss": "[yellow]loss[/yellow]   ",
    "repair": "[yellow]repair[/yellow] ",
    "fact": "[blue]fact[/blue]   ",
}


_TIMES = ("textgrid", "hts", "livelink")  # have no space


def print_check(
    reference: str,
    *,
    as_json: bool,
    unit: str | None,
    up: str | None,
    skeleton: str | None = None,
    options: Sequence[str] = (),
) -> bool:
    """Print how a file was understood and what is wrong with it; whether nothing is."""
    from keypose.analysis import examine
    from keypose.io.axes import unit_name

    found = examine(open_input(reference, unit=unit, up=up, skeleton=skeleton, options=options))
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
    for f in sorted(found.findings, key=lambda f: [*_SIGNS].index(f.level)):
        out.print(f"  {_SIGNS[f.level]} {escape(f.topic)}: {escape(f.text)}")
        if f.fix:
            out.print(f"          [dim]{escape(_command(f.fix, reference))}[/dim]")
    count = len(found.warnings)
    out.print("  [green]nothing wrong[/green]" if not count else f"  [red]{count} warning{'s' * (count != 1)}[/red]")
    return not count


def print_quality(
    reference: str,
    *,
    as_json: bool,
    against: str | None,
    clip: str | None,
    unit: str | None,
    up: str | None,
    skeleton: str | None = None,
    options: Sequence[str] = (),
) -> None:
    """Print the figures of a file's motions, or of one beside another take.

    Raises:
        FormatError: where a file has no motion of a skeleton.
    """
    from keypose.analysis import compare_takes, measure_quality

    scene = open_input(reference, unit=unit, up=up, skeleton=skeleton, options=options)
    body, motions = _motions(scene, reference, clip)
    other = None if against is None else _motions(open_input(against, unit=unit, up=up), against, clip)[1][0]
    rows: list[dict[str, Any]] = []
    out = console()
    for motion in motions:
        quality = measure_quality(motion, body, scene.character.roles or None)
        difference = None if other is None else compare_takes(motion, other, body)
        if as_json:
            row = {"name": motion.name, **asdict(quality)}
            rows.append(row if difference is None else {**row, "difference": asdict(difference)})
            continue
        from rich.markup import escape

        out.print(
            f"[bold]{escape(motion.name or reference)}[/bold]  [dim]{quality.frames} frames, {quality.rate_hz:g} Hz[/dim]"
        )
        for line in (*quality.lines(), *(difference.lines() if difference is not None else ())):
            out.print(f"  {escape(line)}")
    if as_json:
        print(json.dumps({"file": reference, "quality": rows}, indent=1, ensure_ascii=False))


def _motions(scene: Scene, reference: str, clip: str | None) -> tuple[Skeleton, list[Motion]]:
    """The skeleton and its animations as motions; only the named one if a name is given."""
    from keypose.evaluate import bake, key_rate

    if not scene.characters or not scene.animations:
        raise FormatError("it has no motion of a skeleton", path=reference)
    body = scene.character.skeleton
    chosen = scene.animations if clip is None else (scene.animation(clip),)
    motions = [
        a if isinstance(a, Motion) else bake(a, body, a.rate_hz or key_rate(a) or 30.0)
        for a in chosen
        if a.duration_s > 0
    ]
    if not motions:
        raise FormatError("its motions have one frame only", path=reference)
    return body, motions


def _command(fix: str, reference: str) -> str:
    """A command with FILE and OUT made into names; a sample is written in a format that holds all of it."""
    if not fix:
        return ""
    source = Path(reference.removeprefix("sample:"))
    words = [source.name if word == "FILE" else word for word in fix.split()]
    for place, word in enumerate(words):
        if word.startswith("OUT"):
            words[place] = f"{source.stem}-fixed{word.removeprefix('OUT') or _suffix(reference)}"
    if "FILE" in fix:
        words[words.index(source.name)] = reference
    return shlex.join(words)


def _suffix(reference: str) -> str:
    """Of the file itself where its format is written, else of one that holds as much."""
    from keypose.io.registry import format_of_suffix

    path = Path(reference)
    chosen = None if reference.startswith("sample:") else format_of_suffix(path)
    return path.suffix if chosen is not None and chosen.write else ".glb"


def _lines(facts: dict[str, Any]) -> list[tuple[str, str]]:
    lines: list[tuple[str, str]] = []
    if facts["format"] not in _TIMES:
        lines.append(("unit, up", f"{facts['unit']}, {facts['up']} up"))
    if facts["forward"] or facts.get("forward_moving"):
        way = facts["forward"] or f"{facts['forward_moving']} where it stands in the motion"
        hand = "left and right as named" if facts["handedness"] == "right" else "left and right swapped"
        lines.append(("faces", f"{way}, {hand}" if facts["handedness"] else way))
    if facts["euler_orders"]:
        orders = ", ".join(f"{order} x{count}" for order, count in facts["euler_orders"].items())
        odd = facts["euler_exceptions"]
        few = ", ".join(f"{name} {order}" for name, order in list(odd.items())[:4])
        lines.append(("Euler orders", orders + (f" ({few}{', …' if len(odd) > 4 else ''})" if odd else "")))
    if facts["rest_pose"]:
        pairs = facts["sides"]["pairs"]
        text = f"{facts['rest_pose']} pose" if facts["rest_pose"] in ("T", "A") else facts["rest_pose"]
        lines.append(("rest", f"{text}; {pairs} joint pair{'s' * (pairs != 1)} left and right" if pairs else text))
    if facts["stature_m"]:
        lines.append(("stature", f"{facts['stature_m']:.2f} m, lowest joint {facts['ground_m']:+.3f} m"))
    if facts.get("meshes"):
        m = facts["meshes"]
        size = " x ".join(f"{v:.3g}" for v in m["size_m"])
        lines.append(("meshes", f"{m['parts']} part{'s' * (m['parts'] != 1)}, {m['vertices']:,} vertices, {size} m"))
    if facts["rate_hz"]:
        lines.append(("rate", f"{facts['rate_hz']:.6g} Hz"))
    if facts["clips"]:
        lines.append(("clips", str(facts["clips"])))
    if facts["markers"]:
        low, high = facts.get("marker_height_m", (0.0, 0.0))
        missing = f"{100 * facts['missing_share']:.2g}% missing"
        lines.append(("markers", f"{facts['markers']}, {missing}, {low:.2f} to {high:.2f} m high"))
    signals = facts.get("signals", ())
    lines += [(s["kind"], f"{s['channels']} channels at {s['rate_hz']:.6g} Hz") for s in signals]
    if facts.get("force_plates"):
        lines.append(("force plates", str(facts["force_plates"])))
    for tier in facts.get("tiers", ()):
        lines.append(
            (tier["name"] or "tier", f"{tier['labels']} labels, {tier['start_s']:.3f} to {tier['end_s']:.3f} s")
        )
    return lines
