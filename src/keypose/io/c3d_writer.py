"""Writing C3D: floats in Intel's order, with everything that the file had it came from.

Parameters, labels, scales and the order of points are taken over from the scene's ``extras["c3d"]``; a parameter that
still says the truth is written as it was.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from keypose.arrays import Array
from keypose.errors import FormatError
from keypose.io.atomic import replacing
from keypose.io.axes import UNITS_M, Turn, checked_up, right_of, screen_turn, turn_out, unit_in_metres, unit_of_word
from keypose.io.c3d_data import KINDS, Header, Kept, compose_header, pack_points, screen
from keypose.io.c3d_events import event_parameters, read_events
from keypose.io.c3d_parameters import (
    BLOCK,
    INTEL,
    Group,
    Parameter,
    chars,
    compose,
    find,
    ints,
    number,
    numbers,
    reals,
    strings,
)
from keypose.io.c3d_plates import plate_parameters, read_plates
from keypose.io.marker_tables import MARKER_FORMATS
from keypose.model import Markers, Scene, Signals

_WORDS = {"m": "m", "dm": "dm", "cm": "cm", "mm": "mm", "inch": "in", "foot": "ft"}
_MOST = 65535
_MOST_NAMES = 255  # of one parameter: a dimension is one byte
_BASE_GROUPS = ("POINT", "ANALOG", "FORCE_PLATFORM")
_DESCRIPTIONS = {
    "POINT": "3-D point parameters",
    "ANALOG": "Analog data parameters",
    "FORCE_PLATFORM": "Force platform parameters",
    "TRIAL": "Trial parameters",
    "EVENT": "Event parameters",
}


def write(
    scene: Scene,
    path: Path,
    *,
    unit: str | float | None = None,
    up: str | None = None,
) -> tuple[str, ...]:
    """Write a scene's markers, signals, plates and events; returns notes of what the file does not hold.

    Shapes and units: ``unit`` is "m", "dm", "cm", "mm", "inch" or "foot", ``up`` "X", "Y" or "Z". Without them the
    unit is that of the marker file it came from, else millimetres, and the axes are those of the C3D file it came from,
    else Z is up, as labs have it.

    Raises:
        FormatError: where there is nothing that a C3D file could hold, or too much of it.
    """
    plan = _Plan(scene, unit, up)
    content = plan.content()
    with replacing(path) as temporary:
        temporary.write_bytes(content)
    return tuple(plan.notes)


@dataclass(slots=True)
class _Column:
    """One point over time: values (T, 3) in the file's units, seen (T,), fourth word (T,)."""

    values: Array
    visible: Array
    fourth: Array | None
    description: str = ""
    kind: str = ""
    unit: str = ""


class _Plan:
    """What goes where; collects notes on the way."""

    def __init__(self, scene: Scene, unit: str | float | None, up: str | None) -> None:
        self.scene = scene
        self.notes: list[str] = []
        kept = scene.extras.get("c3d")
        self.kept = kept if isinstance(kept, Kept) else None
        self.parameters = (
            {name: dict(group.parameters) for name, group in self.kept.groups.items()} if self.kept else {}
        )
        self.heads = (
            {name: (group.description, group.locked) for name, group in self.kept.groups.items()} if self.kept else {}
        )
        for name in _BASE_GROUPS:
            self.parameters.setdefault(name, {})
        is_marker_file = scene.format in MARKER_FORMATS
        self.unit_m = unit_in_metres(unit) if unit is not None else scene.unit_m if is_marker_file else 0.001
        self.unit_word = self.word_of_unit()
        self.right_up, self.turn = self.axes(None if up is None else checked_up(up))
        self.leave_out()
        self.sets = self.marker_sets()
        self.frames, self.rate_hz, self.first = self.time_line()

    def word_of_unit(self) -> str:
        name = next((name for name in _WORDS if abs(UNITS_M[name] / self.unit_m - 1) < 1e-9), None)
        if name is None:
            raise FormatError(f"a unit of {self.unit_m:g} m has no name in C3D; choose one of {', '.join(_WORDS)}")
        return _WORDS[name]

    def axes(self, up: str | None) -> tuple[tuple[str, str], Turn]:
        chosen = None
        if self.kept is not None:
            chosen = screen(self.kept.groups, up)
            if up is None and (chosen is None or chosen[1][-1] != self.scene.up):  # it was read with the option up
                chosen = screen(self.kept.groups, self.scene.up)
        if chosen is None:
            letter = up or (self.scene.up if self.scene.format == "c3d" else "Z")
            chosen = (right_of(letter), f"+{letter}")
        return chosen, screen_turn(*chosen)

    def leave_out(self) -> None:
        scene = self.scene
        if not (scene.markers or scene.signals):
            raise FormatError("there are no markers and no signals; a C3D file holds nothing else")
        if scene.characters:
            self.notes.append(f"{len(scene.characters)} characters are not in the file: C3D holds markers")
        if scene.animations:
            self.notes.append(f"{len(scene.animations)} animations are not in the file: C3D holds markers")

    # --- time ---

    def marker_sets(self) -> list[Markers]:
        sets = list(self.scene.markers[:1])
        for other in self.scene.markers[1:]:
            if other.frame_count == sets[0].frame_count and other.rate_hz == sets[0].rate_hz:
                sets.append(other)
            else:
                self.notes.append(f"markers '{other.name}' are not in the file: another length or rate than the first")
        return sets

    def time_line(self) -> tuple[int, float, int]:
        """Frames, their rate and the number of the first one."""
        if self.sets:
            return self.sets[0].frame_count, self.sets[0].rate_hz, self.sets[0].start_frame
        computed = next((s for s in self.scene.signals if s.values.ndim == 3), None)
        first = self.kept.header.first if self.kept else 1
        if computed is not None:
            return len(computed.values), computed.rate_hz, int(computed.extras.get("start_frame", first))
        analog = self.scene.signals[0]
        samples = max(self.kept.header.samples, 1) if self.kept else 1
        return -(-len(analog.values) // samples), analog.rate_hz / samples, first

    # --- data ---

    def content(self) -> bytes:
        columns = self.columns()
        scale, points = self.points(columns)
        names, analog, samples = self.analog()
        self.point_parameters(columns, scale)
        self.analog_parameters(names, samples)
        self.plates(names)
        self.events()
        self.trial()
        words = 4 * len(columns) + analog.shape[1]
        if len(columns) > _MOST or analog.shape[1] > _MOST:
            raise FormatError(
                f"{len(columns)} points and {analog.shape[1]} analog values in a frame; C3D holds {_MOST}"
            )
        # the parameters name the block where the data begin, which depends on their own length
        section = self.section(0)
        section = self.section(2 + len(section) // BLOCK)
        header = self.header(len(columns), analog.shape[1], samples, scale, 2 + len(section) // BLOCK)
        data = np.empty((self.frames, words), "<f4")
        data[:, : 4 * len(columns)] = points.reshape(self.frames, -1)
        data[:, 4 * len(columns) :] = analog
        content = b"".join((compose_header(header), section, data.tobytes()))
        return content + b"\0" * (-len(content) % BLOCK)

    def header(self, points: int, analog: int, samples: int, scale: float, block: int) -> Header:
        last = self.first + self.frames - 1
        kept = self.kept.header if self.kept else None
        gap, events = (kept.gap, kept.events) if kept else (0, ())
        first, last = min(max(self.first, 0), _MOST), min(max(last, 0), _MOST)
        return Header(2, INTEL, points, analog, first, last, gap, -scale, block, samples, self.rate_hz, events)

    def section(self, data_block: int) -> bytes:
        self.set("POINT", "DATA_START", ints([data_block], ()))
        groups = {
            name: Group(parameters, *self.heads.get(name, (_DESCRIPTIONS.get(name, ""), False)))
            for name, parameters in self.parameters.items()
        }
        return compose(groups)

    def columns(self) -> dict[str, _Column]:
        """All points by name, in the order of the file they came from, new ones last."""
        found: dict[str, _Column] = {}
        for markers in self.sets:
            self.add_markers(markers, found)
        for signals in self.scene.signals:
            if signals.values.ndim == 3:
                self.add_computed(signals, found)
        if self.kept is None:
            return found
        known = [name for name, _ in self.kept.points if name in found]
        return {name: found[name] for name in dict.fromkeys([*known, *found])}

    def add_markers(self, markers: Markers, found: dict[str, _Column]) -> None:
        values = turn_out(np.asarray(markers.positions, np.float64), self.turn, self.unit_m)
        visible: Array = np.asarray(markers.visible) & np.isfinite(values).all(axis=-1)
        fourth = self.fourth(markers)
        descriptions = markers.extras.get("descriptions", ())
        for i, name in enumerate(markers.names):
            described = str(descriptions[i]) if i < len(descriptions) else ""
            column = _Column(values[:, i], visible[:, i], None if fourth is None else fourth[:, i], described)
            found[self.free_name(name, found)] = column

    def add_computed(self, signals: Signals, found: dict[str, _Column]) -> None:
        if len(signals.values) != self.frames or abs(signals.rate_hz - self.rate_hz) > 1e-6 * self.rate_hz:
            self.notes.append(f"signals '{signals.name}' are not in the file: another length or rate than the markers")
            return
        values = np.asarray(signals.values, np.float64)
        visible: Array = np.isfinite(values).all(axis=-1)
        fourth: Any = signals.extras.get("fourth_words")
        descriptions = signals.extras.get("descriptions", ())
        kind = next((name for name, kind in KINDS.items() if kind == signals.kind), signals.kind.upper() + "S")
        for i, name in enumerate(signals.names):
            described = str(descriptions[i]) if i < len(descriptions) else ""
            words = None if fourth is None else fourth[:, i]
            column = _Column(values[:, i], visible[:, i], words, described, kind, signals.units[i])
            found[self.free_name(name, found)] = column

    def free_name(self, name: str, found: Mapping[str, _Column]) -> str:
        free, count = name, 1
        while free in found:
            count += 1
            free = f"{name}_{count}"
        if free != name:
            self.notes.append(f"point '{name}' comes twice; the second one is '{free}' in the file")
        return free

    def residual_scale(self) -> float:
        """The file's scale: of floats it only says what one step of a residual's byte is."""
        scale = abs(self.kept.header.scale) if self.kept else 0.0
        if not (np.isfinite(scale) and 0 < scale < 1e9):
            scale = abs(number(self.kept.groups, "POINT", "SCALE") or 0.0) if self.kept else 0.0
        largest = 0.0
        for markers in self.sets:
            if markers.residuals is not None and markers.residuals.size:
                values = np.asarray(markers.residuals, np.float64)
                largest = max(largest, float(np.where(np.isfinite(values), values, 0.0).max()) / self.unit_m)
        same_unit = self.scene.format == "c3d" and abs(self.unit_m / self.scene.unit_m - 1) < 1e-9
        if scale and not same_unit:
            scale *= self.scene.unit_m / self.unit_m
        if not scale or largest > 255.49 * scale:
            if scale:
                self.notes.append("residuals are larger than the file's scale allows; it was made coarser")
            scale = largest / 255 if largest else 0.1
        return float(np.float32(scale))

    def fourth(self, markers: Markers) -> Array | None:
        if markers.residuals is None and markers.cameras is None:
            return None
        words = np.zeros((markers.frame_count, len(markers.names)), np.int32)
        if markers.residuals is not None:
            residuals = np.asarray(markers.residuals, np.float64) / (self.unit_m * self.residual_scale())
            words |= np.clip(np.rint(np.where(np.isfinite(residuals), residuals, 0.0)), 0, 255).astype(np.int32)
        if markers.cameras is not None:
            cameras = np.asarray(markers.cameras)
            if (cameras & ~127).any():
                self.notes.append("cameras beyond the seventh are not in the file")
            words |= (cameras & 127) << 8
        return words

    def points(self, columns: Mapping[str, _Column]) -> tuple[float, Array]:
        out = np.zeros((self.frames, len(columns), 4), np.float32)
        for i, column in enumerate(columns.values()):
            out[:, i] = pack_points(column.values, column.visible, 0 if column.fourth is None else column.fourth)
        return self.residual_scale(), out

    def analog(self) -> tuple[list[str], Array, int]:
        """Names of the channels, their words (T, C * samples), and the samples in each frame."""
        sets = [s for s in self.scene.signals if s.values.ndim == 2]
        samples = max(1, round(sets[0].rate_hz / self.rate_hz)) if sets else 1
        if not sets and self.kept is not None:
            samples = max(self.kept.header.samples, 1)
        names: list[str] = []
        pieces: list[Array] = []
        self.channels: dict[str, tuple[str, str]] = {}  # name -> unit, description
        for signals in sets:
            if abs(signals.rate_hz - samples * self.rate_hz) > 1e-4 * signals.rate_hz:
                self.notes.append(
                    f"signals '{signals.name}' are not in the file: {signals.rate_hz:g} Hz are not {samples} samples in "
                    f"each frame of {self.rate_hz:g} Hz"
                )
                continue
            wanted = samples * self.frames
            values = np.asarray(signals.values, np.float64)
            if len(values) != wanted:
                self.notes.append(f"signals '{signals.name}' have {len(values)} samples; the frames hold {wanted}")
                padded = np.zeros((wanted, values.shape[1]))
                padded[: len(values)] = values[:wanted]
                values = padded
            descriptions = signals.extras.get("descriptions", ())
            for i, name in enumerate(signals.names):
                described = str(descriptions[i]) if i < len(descriptions) else ""
                free, count = name, 1
                while free in self.channels:
                    count += 1
                    free = f"{name}_{count}"
                self.channels[free] = (signals.units[i], described)
                names.append(free)
            pieces.append(values)
        values = np.concatenate(pieces, axis=1) if pieces else np.zeros((samples * self.frames, 0))
        scales, offsets = self.channel_scales(names)
        with np.errstate(all="ignore"):
            raw = np.where(scales != 0, values / np.where(scales != 0, scales, 1.0) + offsets, 0.0)
            words = raw.astype(np.float32)
        return names, words.reshape(self.frames, -1) if len(names) else np.zeros((self.frames, 0), np.float32), samples

    def channel_scales(self, names: Sequence[str]) -> tuple[Array, Array]:
        """SCALE * GEN_SCALE and OFFSET of each channel: those of the file it came from, else 1 and 0."""
        scales, offsets = np.ones(len(names)), np.zeros(len(names))
        self.own_scales = np.ones(len(names))
        if self.kept is None:
            return scales, offsets
        groups = self.kept.groups
        unsigned = next(iter(strings(groups, "ANALOG", "FORMAT")), "").strip().upper() == "UNSIGNED"
        found, zeros = numbers(groups, "ANALOG", "SCALE"), numbers(groups, "ANALOG", "OFFSET", unsigned=unsigned)
        general = number(groups, "ANALOG", "GEN_SCALE")
        general = 1.0 if general is None else general
        place = {name: i for i, (name, _) in enumerate(self.kept.analog)}
        whole = zeros is not None and bool(
            (np.isfinite(zeros) & (zeros == np.rint(zeros)) & (abs(zeros) < 65536)).all()
        )
        for i, name in enumerate(names):
            own = place.get(name)
            if own is not None:
                one = _nth(found, own, len(self.kept.analog), 1.0)
                self.own_scales[i] = one
                scales[i] = one * general
                offsets[i] = _nth(zeros, own, len(self.kept.analog), 0.0) if whole else 0.0
            else:
                scales[i] = general or 1.0
        return scales, offsets

    # --- parameters ---

    def set(self, group: str, name: str, made: Parameter) -> None:
        """Put a parameter in its place; one that says the same already stays as it is."""
        own = self.parameters.setdefault(group, {})
        old = own.get(name)
        if old is not None:
            if old.kind == made.kind and _same(old, made):
                return
            made = replace(made, description=made.description or old.description, locked=old.locked)
        own[name] = made

    def set_strings(self, group: str, name: str, values: Sequence[str]) -> None:
        """A list of strings, continued in NAME2, NAME3, ... beyond 255; lists that say the same stay."""
        own = self.parameters.setdefault(group, {})
        there = strings({group: Group(own)}, group, name)
        missing = len(values) - len(there)  # what is beyond the end counts as empty; names of nothing do no harm
        if name in own and (there + [""] * missing)[: len(values)] == list(values):
            return
        number = 2
        while own.pop(f"{name}{number}", None) is not None:
            number += 1
        pieces = [values[i : i + _MOST_NAMES] for i in range(0, len(values), _MOST_NAMES)] or [values]
        for number, piece in enumerate(pieces, 1):
            self.set(group, name if number == 1 else f"{name}{number}", chars(piece))

    def point_parameters(self, columns: Mapping[str, _Column], scale: float) -> None:
        labels = dict(self.kept.points) if self.kept else {}
        self.set("POINT", "USED", ints([len(columns)], ()))
        self.set("POINT", "SCALE", reals([-scale], ()))
        self.set("POINT", "RATE", reals([self.rate_hz], ()))
        self.set("POINT", "FRAMES", ints([min(self.frames, _MOST)], ()))
        if self.frames > _MOST:
            self.set("POINT", "LONG_FRAMES", reals([self.frames], ()))
        else:
            self.parameters["POINT"].pop("LONG_FRAMES", None)
        old = next(iter(strings({"POINT": Group(self.parameters["POINT"])}, "POINT", "UNITS")), "")
        said = unit_of_word(old)
        # not cut short, which has to be guessed
        whole = said is not None and old.strip().casefold() in (said, f"{said}s")
        if said is None or not whole or abs(UNITS_M[said] / self.unit_m - 1) > 1e-9:
            self.set("POINT", "UNITS", chars([self.unit_word], scalar=True, shortest=2))
        for name, axis in zip(("X_SCREEN", "Y_SCREEN"), self.right_up, strict=True):
            self.set("POINT", name, chars([axis], scalar=True, shortest=2))
        self.set_strings("POINT", "LABELS", [labels.get(name, name) for name in columns])
        self.set_strings("POINT", "DESCRIPTIONS", [column.description for column in columns.values()])
        for kind in dict.fromkeys(column.kind for column in columns.values() if column.kind):
            listed = strings({"POINT": Group(self.parameters["POINT"])}, "POINT", kind)
            names = [labels.get(name, name) for name, column in columns.items() if column.kind == kind]
            if not set(names) <= {label.strip() for label in listed}:
                self.set_strings("POINT", kind, names)
            unit = next((c.unit for c in columns.values() if c.kind == kind), "")
            if unit:
                self.set("POINT", f"{kind.removesuffix('S')}_UNITS", chars([unit], scalar=True))

    def analog_parameters(self, names: Sequence[str], samples: int) -> None:
        labels = dict(self.kept.analog) if self.kept else {}
        kept_names = [name for name, _ in self.kept.analog] if self.kept else []
        self.set("ANALOG", "USED", ints([len(names)], ()))
        self.set("ANALOG", "RATE", reals([self.rate_hz * samples], ()))
        if "GEN_SCALE" not in self.parameters["ANALOG"]:
            self.set("ANALOG", "GEN_SCALE", reals([1.0], ()))
        offset = self.parameters["ANALOG"].get("OFFSET")
        offsets = self.channel_scales(names)[1]
        scale = self.parameters["ANALOG"].get("SCALE")
        # without channels other readers expect an empty list
        if list(names) != kept_names or scale is None or (not names and len(scale.values)):
            self.set("ANALOG", "SCALE", reals(self.own_scales))
            self.set("ANALOG", "OFFSET", ints(offsets.astype(np.int64).tolist()))
        elif offset is None or offset.kind != "int":  # other readers refuse offsets that are no integers
            self.set("ANALOG", "OFFSET", ints(offsets.astype(np.int64).tolist()))
        self.set_strings("ANALOG", "LABELS", [labels.get(name, name) for name in names])
        self.set_strings("ANALOG", "DESCRIPTIONS", [self.channels[name][1] for name in names])
        units = [self.channels[name][0] for name in names]
        there = strings({"ANALOG": Group(self.parameters["ANALOG"])}, "ANALOG", "UNITS")
        if len(there) != 1 or any(unit != there[0] for unit in units):
            self.set_strings("ANALOG", "UNITS", units)

    def plates(self, channels: Sequence[str]) -> None:
        plates = self.scene.plates
        if self.kept is not None:
            unheard: list[str] = []
            # read from the old parameters in the new place: if that gives the scene's plates, they are true as they are
            names = [name for name, _ in self.kept.analog]
            old = read_plates(self.kept.groups, self.turn, self.unit_m, names, unheard)
            if (
                names == list(channels)
                and len(old) == len(plates)
                and all(_same_plate(a, b) for a, b in zip(old, plates, strict=True))
            ):
                if "USED" not in self.parameters["FORCE_PLATFORM"]:
                    self.set("FORCE_PLATFORM", "USED", ints([0], ()))
                return
        wires = find(self.kept.groups, "FORCE_PLATFORM", "CHANNEL") if self.kept else None
        made = plate_parameters(plates, self.turn, self.unit_m, channels, self.notes)
        if not plates and wires is None:
            made = {"USED": made["USED"]}
        for name, parameter in made.items():
            self.set("FORCE_PLATFORM", name, parameter)
        if "ZERO" not in self.parameters["FORCE_PLATFORM"]:
            self.set("FORCE_PLATFORM", "ZERO", ints([1, 0]))

    def events(self) -> None:
        events: Any = self.scene.extras.get("events", ())
        if self.kept is not None:
            old = read_events(self.kept.groups, self.kept.header, self.first, self.rate_hz)
            if tuple(events) == old:
                return
        if events or "EVENT" in self.parameters:
            for name in [n for n in self.parameters.get("EVENT", {}) if len(events) != 0]:
                # lists beside these would no longer have the right length
                del self.parameters["EVENT"][name]
            for name, parameter in event_parameters(events[:_MOST_NAMES], self.first, self.rate_hz).items():
                self.set("EVENT", name, parameter)
            if len(events) > _MOST_NAMES:
                self.notes.append(f"{len(events) - _MOST_NAMES} events are not in the file: C3D holds {_MOST_NAMES}")

    def trial(self) -> None:
        last = self.first + self.frames - 1
        if "TRIAL" not in self.parameters and last <= _MOST - 1:
            return
        for name, frame in (("ACTUAL_START_FIELD", self.first), ("ACTUAL_END_FIELD", last)):
            if name in self.parameters.get("TRIAL", {}) or last > _MOST - 1:
                self.set("TRIAL", name, ints([frame & _MOST, frame >> 16], (2,)))


def _same(old: Parameter, made: Parameter) -> bool:
    if made.kind == "char":
        return tuple(old.values) == tuple(made.values)
    return bool(np.array_equal(np.asarray(old.values), np.asarray(made.values)))


def _same_plate(a: Any, b: Any) -> bool:
    def near(x: Any, y: Any) -> bool:
        if x is None or y is None:
            return x is y
        return x.shape == y.shape and bool(np.allclose(x, y, rtol=1e-12, atol=1e-12))

    return (a.kind, a.channels) == (b.kind, b.channels) and all(
        near(getattr(a, name), getattr(b, name)) for name in ("corners", "origin", "calibration")
    )


def _nth(values: Array | None, index: int, count: int, default: float) -> float:
    """A channel's own number as the reader takes it."""
    if values is None or not len(values):
        return default
    if len(values) == 1 and count > 1:
        index = 0
    return float(values[index]) if index < len(values) and np.isfinite(values[index]) else default
