"""`keypose convert`: read, write, read back, and print the proof."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from keypose.cli.inputs import AS_THEY_SAY, Reading, open_chosen, unit_option
from keypose.cli.options import choose, parameters
from keypose.cli.output import not_an_input, print_written
from keypose.errors import FormatError
from keypose.model import Clip, Motion, Scene


class ConversionError(FormatError):
    """The file that was written does not hold what it should."""


@dataclass(frozen=True, slots=True)
class Changes:
    """What is changed between reading and writing, in this order; nothing by default."""

    skip: int = 0
    scale: float = 1.0
    turn_deg: float = 0.0
    raise_m: float = 0.0
    rate_hz: float | None = None
    influences: int | None = None


@dataclass(frozen=True, slots=True)
class Strictness:
    """What the file read back may differ by; ``relative`` is a share of the size of everything."""

    fail: bool = False
    limit_mm: float = 1e-3
    limit_deg: float = 1e-4
    relative: float = 0.0


def convert_files(
    inputs: list[str],
    output: Path,
    *,
    clip: str | None,
    changes: Changes,
    out_unit: str | None,
    order: str | None,
    reading: Reading = AS_THEY_SAY,
    quiet: bool = False,
    strictness: Strictness | None = None,
) -> None:
    """Write the inputs as one file and print how far the file read back is from what was written.

    Raises:
        ConversionError: where it must not, and is farther than the limits or lacks something.
    """
    from keypose import io
    from keypose.io.registry import format_of_suffix, unknown_format

    strictness = strictness or Strictness()
    chosen = format_of_suffix(output)
    if chosen is None or not chosen.write:  # told before anything is read
        raise unknown_format(output, writing=True)
    not_an_input(output, inputs)
    given = choose(reading.options, inputs, output)
    scene = combine(inputs, open_chosen(inputs, given, reading))
    if clip is not None:
        scene = replace(scene, animations=(scene.animation(clip),))
    known = parameters(chosen.writer())
    writing = {"unit": None if out_unit is None else unit_option(out_unit), "order": order}
    writing = {name: value for name, value in writing.items() if value is not None} | given.writing
    if changes.rate_hz is not None and "rate_hz" in known:
        writing["rate_hz"] = changes.rate_hz
        changes = replace(changes, rate_hz=None)
    scene, change_notes = changed(scene, changes)
    write_notes = io.save(scene, output, **writing)
    if quiet and not strictness.fail:
        return
    from keypose.analysis import scene_error

    written_unit = writing.get("unit")
    error = scene_error(scene, _read_back(scene, output, written_unit))
    if strictness.fail and not error.within(strictness.limit_mm, strictness.limit_deg, strictness.relative):
        worst = "; ".join(error.lines())
        limit_mm = max(strictness.limit_mm, strictness.relative * error.size_mm)
        asked = f"{limit_mm:.3g} mm and {strictness.limit_deg:g} degrees"
        raise ConversionError(f"written, but not all that was read within {asked}: {worst}", path=output)
    if quiet:
        return
    notes = (*scene.notes, *change_notes, *write_notes)
    print_written(output, notes=notes, lines=[*_unsaid(scene, output, written_unit), *error.lines()])


def changed(scene: Scene, changes: Changes) -> tuple[Scene, list[str]]:
    """The scene with the changes, and what is to be said of them.

    Raises:
        ShapeError: where the scene has nothing that a change is about.
    """
    from keypose.analysis import cures

    notes: list[str] = []
    if changes.skip:
        scene = cures.without_first(scene, changes.skip)
    if changes.scale != 1.0:
        scene = cures.scaled(scene, changes.scale)
    if changes.turn_deg:
        scene = cures.turned(scene, changes.turn_deg)
    if changes.raise_m:
        scene = cures.raised(scene, changes.raise_m)
    if changes.rate_hz is not None:
        scene = cures.at_rate(scene, changes.rate_hz)
    if changes.influences is not None:
        scene, notes = cures.packed(scene, changes.influences)
    return scene, notes


def _bvh_conventions(scene: Scene, out_unit: str | float | None) -> dict[str, Any]:
    from keypose.io.bvh_writer import written_as

    unit_m, up = written_as(scene.character, unit=out_unit)
    return {"unit": unit_m, "up": up}


def _conventions(scene: Scene, output: Path, out_unit: str | float | None) -> dict[str, Any]:
    """Unit and axes of a written file whose format says them not at all or in part; empty for others."""
    suffix = output.suffix.lower()
    if suffix == ".bvh":
        return _bvh_conventions(scene, out_unit)
    if suffix in (".trc", ".csm"):
        from keypose.io.marker_tables import written_as

        unit_m, up = written_as(scene, suffix[1:].upper(), out_unit)
        return {"unit": unit_m, "up": up}
    return {}


def _read_back(scene: Scene, output: Path, out_unit: str | float | None) -> Scene:
    """The file as it was meant: one that does not say its unit or axes is read in those it was written in."""
    from keypose import io

    return io.load(output, **_conventions(scene, output, out_unit))


def _unsaid(scene: Scene, output: Path, out_unit: str | float | None) -> list[str]:
    """A warning where a reader of the file would guess another unit or axis than was written."""
    from keypose import io
    from keypose.io.axes import unit_name

    meant = _conventions(scene, output, out_unit)
    if not meant:
        return []
    guessed = io.load(output)
    if abs(guessed.unit_m / meant["unit"] - 1) < 1e-6 and guessed.up == meant["up"]:
        return []
    return [
        f"{output.suffix[1:].upper()} does not say its {'axes' if guessed.format == 'trc' else 'unit and axes'}: read it with "
        f"--unit {unit_name(meant['unit']).removesuffix(' m')} --up {meant['up']}; it looks like "
        f"{unit_name(guessed.unit_m)}, {guessed.up} up"
    ]


def combine(names: list[str], scenes: list[Scene]) -> Scene:
    """One scene of several: motions go to the first character with meshes, matched by joint names.

    Raises:
        FormatError: where a motion has too few of the character's joints to be its own.
    """
    if len(scenes) == 1:
        return scenes[0]
    from keypose.evaluate import match, match_report

    base = next((i for i, s in enumerate(scenes) if any(c.parts for c in s.characters)), 0)
    skeleton = scenes[base].character.skeleton
    animations, notes = list(scenes[base].animations), list(scenes[base].notes)
    for i, scene in enumerate(scenes):
        if i == base:
            continue
        added: list[Motion | Clip] = []
        for animation in scene.animations:
            report = match_report(animation, skeleton)
            animated = len(report.sources) + len(report.unused)
            if len(report.sources) * 2 < animated:
                raise FormatError(
                    f"only {len(report.sources)} of its {animated} animated joints have a namesake in {names[base]}; "
                    "the skeletons differ, so the motion cannot be applied by name",
                    path=names[i],
                )
            notes.extend(f"{names[i]}: {note}" for note in report.notes)
            added.append(match(animation, skeleton))
        notes.extend(scene.notes)
        # The order of the inputs is the order of the clips.
        animations = animations + added if i > base else added + animations
    return replace(scenes[base], animations=tuple(animations), notes=tuple(dict.fromkeys(notes)))
