"""`keypose clean`: feet held still where they touch the ground, with the figures before and after, and the contacts as a table."""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from keypose.cli.console import console, counted, progress_bar
from keypose.cli.inputs import AS_THEY_SAY, Reading, motion_of, open_input, read_roles
from keypose.cli.output import (
    check_output,
    motion_facts,
    motion_words,
    not_an_input,
    print_json,
    print_written,
    write_scene,
)
from keypose.errors import FormatError, KeyposeError, ShapeError
from keypose.model import Character, Motion, Scene

if TYPE_CHECKING:
    from keypose.analysis.contacts import Footing
    from keypose.analysis.ground import Ground, GroundKind
    from keypose.analysis.quality import Quality
    from keypose.editing.planting import HipsMode, PlantResult

SCHEMA, CONTACTS_SCHEMA = "keypose.clean/1", "keypose.contacts/1"

_FIGURES = (
    ("feet in contact slide, mean", "skate_cm_s", "cm/s"),
    ("at most", "worst_skate_cm_s", "cm/s"),
    ("feet sink, at most", "sink_cm", "cm"),
)


def clean_file(
    source: str,
    output: Path,
    *,
    clip: str | None = None,
    ground: str = "auto",
    hips: str = "free",
    level_feet: bool = True,
    loop: bool = False,
    floor_m: float | None = None,
    contacts: Path | None = None,
    events: bool = False,
    roles: Path | None = None,
    rate_hz: float | None = None,
    reading: Reading = AS_THEY_SAY,
    as_json: bool = False,
    quiet: bool = False,
) -> None:
    """Plant the feet of a motion, write it with its character and print what changed.

    ``ground``: a kind of `GROUND_KINDS`, or the ground's height under the feet in metres as text. ``floor_m``: the whole is lifted
    or lowered so that its ground is there.

    Raises:
        FormatError: where the output's format cannot be written, or the input has no motion.
        KeyposeError: where the skeleton has no legs.
        ShapeError: where the ground is neither a kind nor a height.
    """
    from keypose.analysis.contacts import contact_events
    from keypose.analysis.quality import measure_quality
    from keypose.editing.planting import PlantOptions, plant_feet, put_on_floor
    from keypose.io.atomic import check_place

    check_output(output, [source])
    if contacts is not None:
        not_an_input(contacts, [source])
        if contacts.suffix.lower() not in (".json", ".csv"):
            raise FormatError("expected a .json or a .csv for contacts", path=contacts)
        check_place(contacts)
    if floor_m is not None and not np.isfinite(floor_m):
        raise ShapeError(f"--floor: expected a height in metres, got {floor_m}")
    scene = open_input(source, reading)
    motion = motion_of(scene, source, clip, rate_hz)
    if motion.frame_count < 2:
        raise FormatError("it has one frame only; feet are planted in a motion", path=source)
    character = scene.character
    body = character.skeleton
    known = _roles(roles, character)
    asked = PlantOptions(
        ground=_ground(ground, character, known), level_feet=level_feet, hips=cast("HipsMode", hips), loop=loop
    )
    with progress_bar("planting feet", quiet=quiet or as_json) as progress:
        done = plant_feet(motion, body, known, options=asked, progress=progress)
    made = done.motion
    if floor_m is not None:
        made = put_on_floor(made, body, done.footing, floor_m + _sole_m(character, known))
    if events:
        added = contact_events(done.footing, made.start_s)
        made = replace(made, events=tuple(sorted((*made.events, *added), key=lambda e: e.time_s)))
    made = replace(made, name=motion.name or Path(source).stem)
    cleaned = Scene((character,), (made,), unit_m=scene.unit_m)
    notes = write_scene(cleaned, output, quiet=quiet or as_json)
    if contacts is not None:
        write_contacts(contacts, source, made, done.footing)
    if quiet and not as_json:
        return
    before, after = (
        measure_quality(m, body, known, touching=done.touching, ground=done.footing.ground)
        for m in (motion, done.motion)
    )
    if as_json:
        print_json({**motion_facts(output, made), **_facts(done, before, after), "notes": notes})
    else:
        print_written(output, motion_words(made), notes)
        _print(done, before, after)


def write_contacts(path: Path, source: str, motion: Motion, footing: Footing) -> None:
    """Write contacts as JSON or CSV, one a row: point, first and last frame, times in seconds, place in metres."""
    from keypose.analysis.contacts import contact_spans
    from keypose.io.atomic import replacing

    rows = [asdict(span) for span in contact_spans(footing, motion.start_s)]
    with replacing(path) as fresh:
        if path.suffix.lower() == ".json":
            facts = {
                "schema": CONTACTS_SCHEMA,
                "file": source,
                "motion": motion.name,
                "rate_hz": motion.rate_hz,
                "frames": motion.frame_count,
                "ground": footing.ground.describe(),
                "contacts": rows,
            }
            fresh.write_text(json.dumps(facts, indent=1) + "\n", encoding="utf-8")
            return
        with fresh.open("w", newline="", encoding="utf-8") as file:
            table = csv.writer(file)
            table.writerow(["point", "first", "last", "start_s", "end_s", "x_m", "y_m", "z_m"])
            for row in rows:
                place = [f"{v:.6f}" for v in row.pop("place")]
                table.writerow([*(f"{v:.6f}" if isinstance(v, float) else v for v in row.values()), *place])


def _roles(path: Path | None, character: Character) -> Mapping[str, int]:
    from keypose.analysis import find_roles

    if path is not None:
        return read_roles(path, character.skeleton).roles
    found = find_roles(character.skeleton, known=character.roles or None)
    if found.on_all_fours:
        raise KeyposeError("feet cannot be planted: it stands on four feet; give its hind legs as a map of roles")
    return found.roles


def _ground(text: str, character: Character, roles: Mapping[str, int]) -> Ground | GroundKind:
    """A kind of ground, or a known one: level, at a height under the soles."""
    from keypose.analysis.ground import GROUND_KINDS, Ground

    if text in GROUND_KINDS:
        return text
    try:
        height = float(text)
    except ValueError:
        height = np.nan
    if not np.isfinite(height):
        raise ShapeError(f"ground: expected {', '.join(GROUND_KINDS)} or a height in metres, got '{text}'")
    return Ground(height + _sole_m(character, roles))


def _sole_m(character: Character, roles: Mapping[str, int]) -> float:
    """How high balls of the feet (ankles, without toes) are over what the character stands on at rest."""
    from keypose.evaluate import world_rotations_positions
    from keypose.retarget import ground_under

    skeleton = character.skeleton
    places = np.asarray(world_rotations_positions(skeleton, skeleton.rest)[1], np.float64)
    lowest = ground_under(character)
    lowest = float(places[:, 1].min()) if lowest is None else lowest
    joints = [roles.get(f"{side}_toes", roles[f"{side}_foot"]) for side in ("left", "right")]
    return max(0.0, float(places[joints, 1].mean()) - lowest)


def _count(touching: Mapping[str, np.ndarray]) -> int:
    """How often heels and balls come down."""
    from keypose.analysis.ground import true_runs

    return sum(len(true_runs(flags)) for flags in touching.values())


def _facts(done: PlantResult, before: Quality, after: Quality) -> dict[str, Any]:
    """The figures for programs; those of feet before and after, in cm/s and cm."""
    return {
        "schema": SCHEMA,
        "ground": done.footing.ground.describe(),
        "contacts": _count(done.touching),
        "feet_moved_cm": 100 * float(done.moved_m.max(initial=0.0)),
        "hips_moved_cm": 100 * float(done.hips_m.max(initial=0.0)),
        "knee_ratio": done.knee_ratio,
        "settled": done.settled,
        "before": {name: getattr(before, name) for _, name, _ in _FIGURES},
        "after": {name: getattr(after, name) for _, name, _ in _FIGURES},
    }


def _print(done: PlantResult, before: Quality, after: Quality) -> None:
    from rich.markup import escape
    from rich.table import Table

    out = console()
    if not done.moved_m.any():
        out.print("  feet stand still already: nothing was changed")
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 2), header_style="dim")
    for title in ("", "before", "after"):
        table.add_column(title, justify="left" if not title else "right")
    for title, name, unit in _FIGURES:
        cells = [getattr(q, name) for q in (before, after)]
        table.add_row(title, *("-" if v is None else f"{v:.2f} {unit}" for v in cells))
    table.add_row("knees accelerate, at most", "1.00 times", f"{done.knee_ratio:.2f} times")
    out.print(table)
    out.print(
        f"  {counted(_count(done.touching), 'contact')} of heels and balls; feet moved "
        f"{100 * done.moved_m.max(initial=0.0):.1f} cm at most, hips {100 * done.hips_m.max(initial=0.0):.1f} cm"
    )
    out.print(f"  ground: {escape(done.footing.ground.describe())}")
    if not done.settled:
        out.print("  [yellow]note[/yellow] contacts did not settle: planting again will change something")
