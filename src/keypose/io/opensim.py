"""OpenSim: models (.osim) as characters, and tables (.mot, .sto) of their coordinates as motions, or of anything as signals.

The space stays that of the file, metres with Y up; OpenSim's bodies face +X. A table of coordinates needs its model, which is
looked for beside it.

Source: OpenSim documentation, "Storage (.sto) Files", "Motion (.mot) Files", "OpenSim Models".
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from keypose.arrays import Floats
from keypose.errors import FormatError
from keypose.io.collada_xml import parse_xml
from keypose.io.marker_tables import decoded, numbered_lines, parse_table, unique_names
from keypose.io.opensim_model import Model, check_size, parse_model
from keypose.io.text import shown
from keypose.model import Character, Motion, Scene, Signals

__all__ = ["read_model", "read_table"]

_MOST_BYTES = 1 << 30
_MOST_MODELS = 32
_LARGEST_MODEL = 1 << 27  # of those that are looked through
_UNEVEN = 0.1  # of a step: what rounding of times may be off by
_DEFAULT_RATE_HZ = 60.0
_FACING = "axes: taken as OpenSim has them, Y up and bodies that face +X"


def read_model(path: Path) -> Scene:
    """Read an OpenSim model as a character at rest, one joint for each body where the body is jointed.

    Coordinates, markers and masses are in ``extras["opensim"]``; muscles, meshes and constraints are not read.

    Raises:
        FormatError: where the file is no well-formed model, with the line.
    """
    model = parse_model(parse_xml(path))
    return Scene((_character(model, path),), (), "osim", 1.0, "Y", (*model.notes, _FACING))


def read_table(path: Path, *, skeleton: str | Path | None = None) -> Scene:
    """Read a table of coordinates of a model as its character and one `Motion`, of anything else as `Signals` alone.

    ``skeleton`` names the model; without it the folder is searched for one that has the columns' coordinates. The columns are
    in the scene's signals as the file has them.

    Raises:
        FormatError: at the first thing that does not follow the format, with its line; where the model named has none of the
            columns.
    """
    size = path.stat().st_size
    if size > _MOST_BYTES:
        raise FormatError(f"{size >> 20} MiB; at most {_MOST_BYTES >> 20} MiB are read")
    table = _Table(path.read_bytes(), path.stem)
    notes = table.notes
    times, rate_hz = table.times()
    found = _model_of(path, table.coordinates(), skeleton, notes)
    scenes: tuple[Character, ...] = ()
    motions: tuple[Motion, ...] = ()
    angles: frozenset[str] = frozenset()
    if found is not None:
        model, where = found
        angles = frozenset(name for name, one in model.coordinates.items() if one.is_angle)
        scenes = (_character(model, where),)
        if len(times):
            notes.append(f"skeleton: {where.name}")
            check_size(len(times), len(model.joints), size)
            names = tuple(joint.body for joint in model.joints)
            pose = model.pose(table.values_of(model), len(times))
            motions = (Motion(names, pose, rate_hz, table.name, float(times[0])),)
        notes += [*model.notes, _FACING]
    signals = (table.signals(rate_hz, angles),) if table.names else ()
    return Scene(scenes, motions, "opensim", 1.0, "Y", tuple(notes), signals=signals)


def _character(model: Model, path: Path) -> Character:
    return Character(model.skeleton(), name=model.name or path.stem, extras={"opensim": model.extras()})


def _model_of(
    path: Path, wanted: Mapping[str, int], named: str | Path | None, notes: list[str]
) -> tuple[Model, Path] | None:
    """The model that is named, else one of the folder that has most of the columns as coordinates."""
    if named is not None:
        where = Path(named)
        try:
            model = parse_model(parse_xml(where))
        except OSError as error:
            raise FormatError(f"the model cannot be read: {error.strerror or error}", path=where) from None
        except FormatError as error:
            raise (error if error.path else error.at(where)) from None
        if not any(name in model.coordinates for name in wanted):
            raise FormatError(f"none of its columns is a coordinate of {where.name}", path=path)
        return model, where
    best: tuple[Model, Path] | None = None
    most = max(0.5 * len(wanted), 0.5)
    for where in _models_beside(path):
        try:
            model = parse_model(parse_xml(where))
        except (OSError, FormatError):
            continue
        count = sum(name in model.coordinates for name in wanted)
        if count > most:
            best, most = (model, where), count
    if best is None:
        notes.append(
            "skeleton: no model beside the file has its columns as coordinates; they are signals (load(path, skeleton='….osim'))"
        )
    return best


def _models_beside(path: Path) -> list[Path]:
    try:
        files = sorted(p for p in path.parent.iterdir() if p.suffix.lower() == ".osim")
        return [p for p in files if p.stat().st_size <= _LARGEST_MODEL][:_MOST_MODELS]
    except OSError:
        return []


@dataclass(slots=True, eq=False)
class _Columns:
    """Labels of a table, the line of each row, and its cells."""

    labels: list[str]
    lines: list[int]
    rows: list[bytes]


class _Table:
    """A table of numbers under a header that ends with ``endheader``; the first column is time."""

    def __init__(self, data: bytes, name: str) -> None:
        self.notes: list[str] = []
        self.header: dict[str, str] = {}
        columns = self.columns(data)
        width = max([len(columns.labels), *(row.count(b"\t") + 1 for row in columns.rows)])
        values = parse_table(columns.rows, columns.lines, width, len(data))
        if width > len(columns.labels):
            self.notes.append(f"{width - len(columns.labels)} columns without a label were dropped")
        self.time = values[:, 0]
        wrong = np.flatnonzero(~np.isfinite(self.time))
        wrong = wrong if len(wrong) else np.flatnonzero(np.diff(self.time) <= 0) + 1
        if len(wrong):
            raise FormatError(
                "times must be numbers that rise from row to row", where=f"line {columns.lines[wrong[0]]}"
            )
        self.labels = columns.labels[1:]
        self.names = unique_names(self.labels, "column", self.notes)
        self.values = values[:, 1 : len(columns.labels)]
        self.name = self.header.get("name", "") or name
        self.declared(len(values), width)

    def columns(self, data: bytes) -> _Columns:
        lines = numbered_lines(data)
        end = next((i for i, (_, line) in enumerate(lines) if line.strip().lower() == b"endheader"), None)
        if end is None:
            raise FormatError("expected a header that ends with 'endheader'", where=f"line {len(lines)}")
        for _, line in lines[:end]:
            text = decoded(line).strip()
            key, equals, value = text.partition("=")
            if not equals:
                key, _, value = text.partition(" ")
            self.header.setdefault(key.strip().casefold(), value.strip())
        body = [(number, line) for number, line in lines[end + 1 :] if line.strip()]
        if not body:
            raise FormatError("the file ends before the labels of its columns", where=f"line {len(lines)}")
        number, first = body[0]
        labels = [decoded(word) for word in (first.split(b"\t") if b"\t" in first else first.split())]
        labels = [label.strip() for label in labels]
        while labels and not labels[-1]:
            labels.pop()
        if not labels or labels[0].casefold() != "time":
            raise FormatError(
                f"expected labels that begin with 'time', found {shown(first.strip())}", where=f"line {number}"
            )
        rows = [b"\t".join(line.split()) for _, line in body[1:]]
        return _Columns(labels, [number for number, _ in body[1:]], rows)

    def declared(self, rows: int, columns: int) -> None:
        """Tell where the header counts otherwise than the rows, which decide."""
        for keys, what, count in (
            (("nrows", "datarows"), "rows", rows),
            (("ncolumns", "datacolumns"), "columns", columns),
        ):
            said = next((self.header[key] for key in keys if key in self.header), "")
            if re.fullmatch(r"[0-9]{1,9}", said) and int(said) != count:
                self.notes.append(f"the header says {said} {what}, the table has {count}")

    def times(self) -> tuple[Floats, float]:
        """Times at an even rate, to which the values are brought, and the rate."""
        count = len(self.time)
        if count < 2:
            if count:
                self.notes.append("frame rate: one row says none; taken as 60 Hz")
            return self.time, _DEFAULT_RATE_HZ
        start, span = float(self.time[0]), float(self.time[-1] - self.time[0])
        step = span / (count - 1)
        grid = start + step * np.arange(count)
        if np.abs(self.time - grid).max() <= _UNEVEN * step:
            return grid, _near_whole(1.0 / step)
        step = float(np.median(np.diff(self.time)))
        frames = min(round(span / step) + 1, 10 * count)
        step = span / max(frames - 1, 1)
        grid = start + step * np.arange(frames)
        self.values = np.stack([np.interp(grid, self.time, column) for column in self.values.T], axis=-1).reshape(
            frames, -1
        )
        self.notes.append(f"frame rate: times are uneven; {count} rows were brought to {frames} at {1.0 / step:.6g} Hz")
        self.time = grid
        return grid, 1.0 / step

    def coordinates(self) -> dict[str, int]:
        """Columns by the coordinate that they would be: their label, or the one in a path that ends with /value."""
        found: dict[str, int] = {}
        for column, label in enumerate(self.labels):
            name = label.removesuffix("/value") if label.startswith("/") else label
            if not (label.startswith("/") and not label.endswith("/value")):
                found.setdefault(name.rpartition("/")[2], column)
        return found

    def values_of(self, model: Model) -> dict[str, Floats]:
        """Values of a model's coordinates, radians and metres."""
        columns = {name: at for name, at in self.coordinates().items() if name in model.coordinates}
        factor = np.pi / 180.0 if self.in_degrees() else 1.0
        holes = [name for name, at in columns.items() if not np.isfinite(self.values[:, at]).all()]
        if holes:
            self.notes.append(f"{len(holes)} coordinates have gaps, which were filled: {holes[0]}")
        still = sorted(set(model.coordinates) - set(columns))
        if still:
            self.notes.append(f"{len(still)} coordinates have no column and stay as they start: {still[0]}")
        return {
            name: _filled(self.values[:, at]) * (factor if model.coordinates[name].is_angle else 1.0)
            for name, at in columns.items()
        }

    def in_degrees(self) -> bool:
        """Whether angles are in degrees: what the header says; motions of SIMM, which do not say it, always."""
        said = self.header.get("indegrees", "").lower()
        return said in ("yes", "true") if said else "datacolumns" in self.header

    def signals(self, rate_hz: float, angles: frozenset[str]) -> Signals:
        """All columns as the file has them."""
        named = {at: name for name, at in self.coordinates().items()}
        turned = "deg" if self.in_degrees() else "rad"
        units: Sequence[str] = [turned if named.get(at) in angles else "" for at in range(len(self.names))]
        return Signals(
            tuple(self.names), self.values, rate_hz, tuple(units), "coordinate" if angles else "scalar", self.name
        )


def _filled(values: Floats) -> Floats:
    seen = np.isfinite(values)
    if seen.all() or not seen.any():
        return np.nan_to_num(values, nan=0.0)
    at = np.arange(len(values))
    return np.interp(at, at[seen], values[seen])


def _near_whole(rate_hz: float) -> float:
    """A whole rate where rounded times cannot tell it from the measured one."""
    whole = round(rate_hz)
    return float(whole) if whole and abs(rate_hz / whole - 1.0) < 1e-3 else rate_hz
