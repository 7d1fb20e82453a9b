"""`keypose check`: the doctor, and the quality of motions."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from keypose.cli.console import console
from keypose.cli.inputs import AS_THEY_SAY, Reading, open_input, open_inputs
from keypose.cli.output import not_an_input, print_json, print_written
from keypose.errors import FormatError
from keypose.model import Motion, Pose, Scene, Skeleton

if TYPE_CHECKING:
    from keypose.analysis import Quality, RoleMap

_SIGNS = {
    "warning": "[red]warning[/red]",
    "guess": "[yellow]guess[/yellow]  ",
    "loss": "[yellow]loss[/yellow]   ",
    "repair": "[yellow]repair[/yellow] ",
    "fact": "[blue]fact[/blue]   ",
}


_TIMES = ("textgrid", "hts", "livelink")  # have no space


def print_check(reference: str, *, reading: Reading = AS_THEY_SAY, as_json: bool = False) -> bool:
    """Print how a file was understood and what is wrong with it; whether nothing is."""
    from keypose.analysis import examine
    from keypose.io.axes import unit_name

    found = examine(open_input(reference, reading))
    facts = {"file": reference, "unit": unit_name(found.facts["unit_m"]), **found.facts}
    if as_json:
        rows = [{**asdict(f), "fix": _command(f.fix, reference)} for f in found.findings]
        print_json({**facts, "findings": rows})
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


SCHEMA = "keypose.quality/1"


@dataclass(frozen=True, slots=True)
class QualityAsked:
    """What `keypose check --quality` is asked for: another take to compare with, demands, a picture, a theme."""

    against: str | None = None
    fail_on: Sequence[str] = ()
    plot: Path | None = None
    theme: str = "light"


def print_quality(
    reference: str,
    asked: QualityAsked,
    *,
    clip: str | None = None,
    reading: Reading = AS_THEY_SAY,
    as_json: bool = False,
) -> bool:
    """Print the figures of a file's motions, or of one beside another take; whether all demands are met.

    Raises:
        FormatError: where a file has no motion of a skeleton.
        UnknownName, ShapeError: where a demand cannot be read.
    """
    from keypose.analysis import find_roles, measure_quality
    from keypose.analysis.quality_demands import read_demands, unmet
    from keypose.io.atomic import check_place

    demands = [d for text in asked.fail_on for d in read_demands(text)]
    if asked.plot is not None and asked.plot.suffix.lower() != ".png":
        raise FormatError("expected a .png for the picture", path=asked.plot)
    if asked.plot is not None:
        not_an_input(asked.plot, [reference, asked.against])
        check_place(asked.plot)
    scene, *others = open_inputs([reference, *([] if asked.against is None else [asked.against])], reading)
    body, motions = _motions(scene, reference, clip)
    known = scene.character.roles
    found = find_roles(body, known=known or None)
    roles = dict(found.roles)
    rows: list[dict[str, Any]] = []
    out = console()
    failed = 0
    for motion in motions:
        quality = measure_quality(motion, body, found, stand=None if found.missing else _stand(body, roles, motion))
        row = quality_json(motion.name, quality)
        beside = _compared(motion, body, roles, others[0], asked.against, row) if others and asked.against else []
        lacking = unmet(row, demands)
        failed += len(lacking)
        rows.append({**row, "failed": list(lacking)} if demands else row)
        if asked.plot is not None and motion is motions[0]:
            _draw(asked, motion, body, found, quality, reference)
        if as_json:
            continue
        from rich.markup import escape

        out.print(
            f"[bold]{escape(motion.name or reference)}[/bold]  [dim]{quality.frames} frames, {quality.rate_hz:g} Hz[/dim]"
        )
        for line in (*quality.lines(), *beside):
            out.print(f"  {escape(line)}")
        for line in lacking:
            out.print(f"  [red]failed[/red] {escape(line)}")
    if as_json:
        print_json({"schema": SCHEMA, "file": reference, "quality": rows})
    elif asked.plot is not None:
        print_written(asked.plot)
    return not failed


def quality_json(name: str, quality: Quality) -> dict[str, Any]:
    """A motion's figures as they are printed with ``--json``; docs/check.md describes every field."""
    row: dict[str, Any] = {"name": name, **asdict(quality)}
    row["pops"] = [{"frame": f, "joint": j, "times": t} for f, j, t in quality.pops]
    row["limit_breaks"] = [{"joint": j, "degrees": d, "frame": f, "share": s} for j, d, f, s in quality.limit_breaks]
    return row


def _compared(
    motion: Motion, body: Skeleton, roles: Mapping[str, int], other: Scene, against: str, row: dict[str, Any]
) -> list[str]:
    """A motion beside another take: joint by joint on one skeleton, else by the directions of bones."""
    from keypose.analysis import compare_takes, find_roles, foot_contacts
    from keypose.analysis.contacts import has_legs, leg_length
    from keypose.evaluate import match_report, world_rotations_positions
    from keypose.retarget import compare_with_reference

    theirs, motions = _motions(other, against, None)
    take = motions[0]
    found = match_report(take, body)
    if len(found.sources) * 2 >= len(found.sources) + len(found.unused):
        difference = compare_takes(motion, take, body)
        row["difference"] = asdict(difference)
        return difference.lines()
    their_roles = dict(find_roles(theirs, known=other.character.roles or None).roles)
    places = np.asarray(world_rotations_positions(body, motion.pose.broadcast())[1], np.float64)
    touching = foot_contacts(roles, places, motion.rate_hz, leg_length(roles, places)) if has_legs(roles) else {}
    report = compare_with_reference(motion, body, roles, take, theirs, their_roles, touching)
    row["direction"] = asdict(report)
    return report.lines()


def _stand(body: Skeleton, roles: Mapping[str, int], motion: Motion) -> Pose | None:
    """An upright pose of the skeleton where its rest pose is none; None where nothing is known of it."""
    from keypose.errors import KeyposeError
    from keypose.retarget import find_stand

    try:
        return find_stand(body, roles, motion)[0]
    except KeyposeError:
        return None


def _draw(
    asked: QualityAsked, motion: Motion, body: Skeleton, roles: RoleMap, quality: Quality, reference: str
) -> None:
    from PIL import Image

    from keypose.analysis.quality import quality_tracks
    from keypose.analysis.quality_chart import draw_quality
    from keypose.io.atomic import replacing

    if asked.plot is None:
        return
    picture = draw_quality(
        quality_tracks(motion, body, roles), quality, motion.name or Path(reference).stem, theme=asked.theme
    )
    with replacing(asked.plot) as path:
        Image.fromarray(picture).save(path, format="PNG")


def _motions(scene: Scene, reference: str, clip: str | None) -> tuple[Skeleton, list[Motion]]:
    """The skeleton and its animations as motions; only the named one if a name is given."""
    from keypose.evaluate import to_motion

    if not scene.characters or not scene.animations:
        raise FormatError("it has no motion of a skeleton", path=reference)
    body = scene.character.skeleton
    chosen = scene.animations if clip is None else (scene.animation(clip),)
    motions = [to_motion(a, body) for a in chosen if a.duration_s > 0]
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
