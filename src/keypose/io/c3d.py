"""C3D files: markers, analog channels, force plates and what was computed from them, read and written.

C3D is the format of motion capture labs. All its encodings are read (integers and floats of Intel, DEC and MIPS
processors) and everything is kept: residuals and camera masks with the markers, every parameter in the scene's
``extras["c3d"]``, so that writing the file again loses nothing. Points that the file declares to be angles, forces,
moments, powers or scalars become `Signals`, for they are no places in space.

Source: The C3D File Format, A Technical User Guide (Motion Lab Systems, 2021).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import numpy as np

from keypose.arrays import Array
from keypose.errors import FormatError, UnknownName
from keypose.io.axes import (
    UNITS_M,
    Turn,
    checked_up,
    guess_markers_up,
    right_of,
    screen_turn,
    turn_in,
    unit_in_metres,
    unit_of_word,
)
from keypose.io.c3d_data import KINDS, Kept, parse_header, read_words, screen, seen
from keypose.io.c3d_events import read_events
from keypose.io.c3d_parameters import BLOCK, find, number, numbers, parse, strings
from keypose.io.c3d_plates import read_plates
from keypose.io.c3d_writer import write as write
from keypose.io.marker_tables import unique_names
from keypose.io.text import shown
from keypose.model import Markers, Scene, Signals

__all__ = ["Kept", "read", "write"]

_DEFAULT_RATE_HZ = 100.0
_SAMPLED_FRAMES = 9


def read(
    path: Path,
    *,
    unit: str | float | None = None,
    up: str = "auto",
    truncated: Literal["refuse", "keep"] = "refuse",
) -> Scene:
    """Read a C3D file as markers, signals and force plates.

    Shapes and units: ``unit`` is a name ("mm") or metres per file unit, ``up`` is "X", "Y", "Z" or "auto"; without them
    POINT:UNITS and POINT:X_SCREEN and Y_SCREEN say them, else millimetres and what the markers show.
    ``truncated="keep"`` loads the whole frames of a file that was cut off.

    Raises:
        FormatError: where the header or the data section is not whole, with the byte.
        UnknownName: for an option's value that does not exist.
    """
    if truncated not in ("refuse", "keep"):
        raise UnknownName("choice", str(truncated), ("refuse", "keep"))
    given_unit = None if unit is None else unit_in_metres(unit)
    given_up = None if up == "auto" else checked_up(up)
    return _Reader(path.read_bytes(), path.stem, truncated == "keep").scene(given_unit, given_up)


class _Reader:
    """Gives the numbers their meaning; collects notes on the way."""

    def __init__(self, data: bytes, name: str, keep_whole_frames: bool) -> None:
        self.data, self.name, self.keep_whole_frames = data, name, keep_whole_frames
        self.notes: list[str] = []
        self.header = header = parse_header(data)
        start = (header.parameter_block - 1) * BLOCK
        data_start = (header.data_block - 1) * BLOCK
        limit = data_start if data_start > start else len(data)
        self.groups = parse(data, start, limit, header.processor, self.notes)
        self.scale, self.is_float = self.point_scale()
        self.points = self.point_count()
        self.samples, self.channels = self.analog_layout()
        self.first, announced = self.frame_range()
        self.rate_hz = self.rate()
        self.start = self.data_start(start)
        self.frames = self.frames_there(announced)

    # --- counts ---

    def point_scale(self) -> tuple[float, bool]:
        """|POINT:SCALE| and whether the data are floats, which its sign says."""
        for scale in (self.header.scale, number(self.groups, "POINT", "SCALE")):
            if scale is not None and np.isfinite(scale) and scale != 0 and abs(scale) < 1e9:
                return abs(scale), scale < 0
        raise FormatError(f"the scale is {self.header.scale:g}; it says the number format", where="byte 12")

    def point_count(self) -> int:
        used = number(self.groups, "POINT", "USED", unsigned=True)
        if used is not None and int(used) != self.header.points:
            self.notes.append(f"POINT:USED says {used:g} points, the header {self.header.points}; the header counts")
        return self.header.points

    def analog_layout(self) -> tuple[int, int]:
        """Samples per frame, and channels."""
        words, samples = self.header.analog_words, max(self.header.samples, 1)
        used = int(number(self.groups, "ANALOG", "USED", unsigned=True) or 0)
        if words == 0:
            return samples, 0
        if used and used * samples != words:
            frame = 4 * self.points + used * samples
            if words == used and self.fits(frame):
                self.notes.append(
                    f"the header counts {words} analog values in a frame, but there are {samples} of each of the "
                    f"{used} channels"
                )
                return samples, used
            if words % used == 0:
                self.notes.append(
                    f"the header says {samples} analog samples in a frame; {words} values of {used} channels are {words // used}"
                )
                return words // used, used
            self.notes.append(f"ANALOG:USED says {used} channels; the header has {words // samples}")
        if words % samples:
            raise FormatError(
                f"{words} analog values in a frame are not a whole number of channels with {samples} samples each",
                where="byte 4",
            )
        return samples, words // samples

    def fits(self, words: int) -> bool:
        frames = self.header.last - self.header.first + 1
        return (self.header.data_block - 1) * BLOCK + frames * words * (4 if self.is_float else 2) <= len(self.data)

    def frame_range(self) -> tuple[int, int]:
        """The number of the first frame, and how many there are; long trials do not fit the header's 16 bits."""
        header = self.header
        first, count = header.first, header.last - header.first + 1
        actual = [numbers(self.groups, "TRIAL", f"ACTUAL_{which}_FIELD", unsigned=True) for which in ("START", "END")]
        ends = [_long(values) for values in actual]
        begin, end = ends
        if begin is not None and end is not None and end >= begin and (end > 65534 or count < 1):
            return begin, end - begin + 1
        if header.last == 65535 or count < 1:
            frames = number(self.groups, "POINT", "LONG_FRAMES")
            short = number(self.groups, "POINT", "FRAMES", unsigned=True)
            longest = max(int(frames or 0), int(short or 0))
            if 0 < longest < 1 << 32 and longest != count:
                self.notes.append(f"the header's last frame is {header.last}; POINT:FRAMES says {longest} frames")
                return first, longest
        if count < 1:
            raise FormatError(f"frames {header.first} to {header.last}: there are none", where="byte 6")
        said = number(self.groups, "POINT", "FRAMES", unsigned=True)
        if said is not None and int(said) not in (count, count & 0xFFFF):
            self.notes.append(f"POINT:FRAMES says {said:g} frames, the header {count}; the header counts")
        return first, count

    def rate(self) -> float:
        given, header = number(self.groups, "POINT", "RATE"), self.header.rate_hz
        for rate in (given, header):
            if rate is not None and 1e-3 <= rate <= 1e6:  # also not so for what is not a number
                if rate == given and 1e-3 <= header <= 1e6 and abs(header - rate) > 1e-3 * rate:
                    self.notes.append(f"POINT:RATE is {rate:g} Hz, the header says {header:g}; POINT:RATE counts")
                return float(rate)
        self.notes.append(f"the file says no frame rate; taken as {_DEFAULT_RATE_HZ:g} Hz")
        return _DEFAULT_RATE_HZ

    def data_start(self, parameters: int) -> int:
        start = (self.header.data_block - 1) * BLOCK
        if start > parameters and start <= len(self.data):
            return start
        block = int(number(self.groups, "POINT", "DATA_START", unsigned=True) or 0)
        if (block - 1) * BLOCK > parameters and (block - 1) * BLOCK <= len(self.data):
            self.notes.append(f"the header's data block is {self.header.data_block}; POINT:DATA_START {block} counts")
            return (block - 1) * BLOCK
        raise FormatError(f"the data begin in block {self.header.data_block}, which is not there", where="byte 16")

    def frames_there(self, announced: int) -> int:
        words = 4 * self.points + self.channels * self.samples
        if not words:
            return 0
        size = words * (4 if self.is_float else 2)
        there = (len(self.data) - self.start) // size
        if there >= announced:
            return announced
        if not self.keep_whole_frames:
            raise FormatError(
                f"{announced} frames of {size} bytes were announced, {there} are there (the file was cut?); "
                "--option truncated=keep, in Python load(path, truncated='keep'), takes those",
                where=f"byte {len(self.data)}",
            )
        self.notes.append(f"{announced} frames were announced; {there} whole ones are there and were kept")
        return there

    # --- what they mean ---

    def scene(self, unit_m: float | None, up: str | None) -> Scene:
        header = self.header
        words = read_words(
            self.data,
            self.start,
            self.frames,
            self.points,
            self.channels * self.samples,
            header.processor,
            self.is_float,
        )
        labels, names = self.point_names()
        if unit_m is None:
            unit_m = self.unit()
        kinds = self.point_kinds(labels)
        with np.errstate(all="ignore"):
            visible, fourth = seen(words)
            scale = 1.0 if self.is_float else self.scale
            places = [i for i in range(self.points) if not kinds[i]]
            turn, up = self.turn(up, [names[i] for i in places], words.points, visible, places)
            markers = self.markers(words.points, visible, fourth, places, names, turn, unit_m, scale)
            signals = self.computed(words.points, visible, fourth, kinds, names, scale)
            analog_names, analog = self.analog(words.analog)
            plates = read_plates(self.groups, turn, unit_m, [name for _, name in analog_names], self.notes)
        kept = Kept(
            self.groups,
            header,
            tuple(zip(names, labels, strict=True)),
            tuple((name, label) for label, name in analog_names),
        )
        extras: dict[str, Any] = {"c3d": kept}
        events = read_events(self.groups, header, self.first, self.rate_hz)
        if events:
            extras["events"] = events
        return Scene(
            format="c3d",
            unit_m=unit_m,
            up=up,
            notes=tuple(self.notes),
            extras=extras,
            markers=markers,
            signals=signals + analog,
            plates=plates,
        )

    def point_names(self) -> tuple[list[str], list[str]]:
        """The file's labels, and the names that keypose gives: none is empty or comes twice."""
        labels = strings(self.groups, "POINT", "LABELS")
        if len(labels) < self.points:
            self.notes.append(f"{self.points - len(labels)} of {self.points} points have no label")
        labels = (labels + [""] * self.points)[: self.points]
        return labels, unique_names(labels, "point", self.notes)

    def unit(self) -> float:
        word = next(iter(strings(self.groups, "POINT", "UNITS")), "")
        unit = unit_of_word(word)
        if unit is None:
            self.notes.append(f"unit: POINT:UNITS is {shown(word)}; taken as mm")
        elif word.strip().casefold() not in (unit, f"{unit}s"):
            self.notes.append(f"unit: POINT:UNITS is {shown(word)}; taken as {unit}")
        return UNITS_M[unit or "mm"]

    def turn(
        self, up: str | None, names: list[str], points: Array, visible: Array, places: list[int]
    ) -> tuple[Turn, str]:
        """The turn to Y up, and the file's up axis."""
        chosen = screen(self.groups, up)
        if chosen is not None:
            if chosen[1][0] == "-":
                self.notes.append(f"up axis: POINT:Y_SCREEN is {chosen[1]}; the world was turned over")
            return screen_turn(*chosen), chosen[1][-1]
        sampled = np.unique(np.linspace(0, max(self.frames - 1, 0), _SAMPLED_FRAMES).astype(np.intp))[: self.frames]
        some = np.where(visible[sampled][:, places, None], points[sampled][:, places, :3], np.nan).astype(np.float64)
        found, note = guess_markers_up(names, some, self.floor(), "Z")
        self.notes.append(note)
        return screen_turn(right_of(found), found), found

    def floor(self) -> Array:
        """Corners (P, 4, 3) of the force plates, in the file's space."""
        corners = numbers(self.groups, "FORCE_PLATFORM", "CORNERS")
        count = min(
            int(number(self.groups, "FORCE_PLATFORM", "USED") or 0), 0 if corners is None else len(corners) // 12
        )
        if corners is None or count < 1:
            return np.zeros((0, 4, 3))
        corners = corners[: 12 * count].reshape(count, 4, 3)
        return corners[np.isfinite(corners).all(axis=(1, 2))]

    def point_kinds(self, labels: list[str]) -> list[str]:
        """The parameter that says what each point is: "ANGLES" and so on; empty for markers."""
        listed: dict[str, str] = {}
        declared = list(KINDS)
        groups = find(self.groups, "POINT", "TYPE_GROUPS")
        if groups is not None and groups.kind == "char":
            # pairs of the parameter's name and the type's name
            declared += [name.strip().upper() for name in groups.values[::2]]
        for kind in dict.fromkeys(declared):
            for label in strings(self.groups, "POINT", kind) if kind and kind != "LABELS" else ():
                if label.strip():
                    listed.setdefault(label.strip(), kind)
        # modelled markers are places too
        return ["" if "MARKER" in (kind := listed.get(label.strip(), "")) else kind for label in labels]

    def markers(
        self,
        points: Array,
        visible: Array,
        fourth: Array,
        places: list[int],
        names: list[str],
        turn: Turn,
        unit_m: float,
        scale: float,
    ) -> tuple[Markers, ...]:
        if not places:
            return ()
        if len(places) < self.points:
            points, visible, fourth = points[:, places], visible[:, places], fourth[:, places]
        positions = turn_in(points, turn, scale * unit_m)
        positions[~visible] = np.nan
        residuals, cameras = self.quality(visible, fourth, unit_m)
        for array in (positions, visible, residuals, cameras):
            if array is not None:
                array.setflags(write=False)  # handed over: the markers then need not copy them
        return (
            Markers(
                tuple(names[i] for i in places),
                positions,
                self.rate_hz,
                visible,
                residuals,
                cameras,
                self.first,
                self.name,
                {"descriptions": self.descriptions(places)},
            ),
        )

    def descriptions(self, places: list[int]) -> tuple[str, ...]:
        found = strings(self.groups, "POINT", "DESCRIPTIONS")
        return tuple(found[i] if i < len(found) else "" for i in places)

    def quality(self, visible: Array, fourth: Array, unit_m: float) -> tuple[Array | None, Array | None]:
        """Residuals (T, N) in metres, NaN where not seen, and camera masks (T, N); none where all are 0."""
        fourth = np.where(visible, fourth, 0)
        if not fourth.any():
            return None, None
        low, high = fourth & 255, fourth >> 8
        residuals = None
        if low.any():
            residuals = (low * (self.scale * unit_m)).astype(np.float32)
            residuals[~visible] = np.nan
        return residuals, high.astype(np.int32) if high.any() else None

    def computed(
        self, points: Array, visible: Array, fourth: Array, kinds: list[str], names: list[str], scale: float
    ) -> tuple[Signals, ...]:
        """What was computed from the markers, kind by kind; its axes are those of segments and stay as they are."""
        found: list[Signals] = []
        for kind in dict.fromkeys(filter(None, kinds)):
            places = [i for i, own in enumerate(kinds) if own == kind]
            values = points[:, places, :3].astype(np.float64) * scale
            values[~visible[:, places]] = np.nan
            unit = next(iter(strings(self.groups, "POINT", f"{kind.removesuffix('S')}_UNITS")), "")
            extras: dict[str, Any] = {"descriptions": self.descriptions(places), "start_frame": self.first}
            words = np.where(visible[:, places], fourth[:, places], 0)
            if words.any():
                extras["fourth_words"] = words.astype(np.int32)
            values.setflags(write=False)
            known = tuple(names[i] for i in places)
            found.append(
                Signals(
                    known,
                    values,
                    self.rate_hz,
                    (unit,) * len(known),
                    KINDS.get(kind, kind.removesuffix("S").lower()),
                    kind.lower(),
                    extras,
                )
            )
        return tuple(found)

    def analog(self, words: Array) -> tuple[list[tuple[str, str]], tuple[Signals, ...]]:
        """(label, name) of the channels, and their values: (raw - OFFSET) * SCALE * GEN_SCALE."""
        if not self.channels:
            return [], ()
        labels = strings(self.groups, "ANALOG", "LABELS")
        labels = (labels + [""] * self.channels)[: self.channels]
        names = unique_names(labels, "channel", self.notes)
        unsigned = next(iter(strings(self.groups, "ANALOG", "FORMAT")), "").strip().upper() == "UNSIGNED"
        offsets = self.per_channel("OFFSET", 0.0, unsigned=unsigned)
        general = number(self.groups, "ANALOG", "GEN_SCALE")
        scales = self.per_channel("SCALE", 1.0) * (1.0 if general is None else general)
        if not self.is_float and unsigned:
            words = words.astype(np.int16).view(np.uint16)
        values = words.reshape(-1, self.channels).astype(np.float64)
        values -= offsets
        values *= scales
        values.setflags(write=False)
        rate = self.rate_hz * self.samples
        said = number(self.groups, "ANALOG", "RATE")
        if said is not None and said > 0 and abs(said - rate) > 1e-3 * rate:
            self.notes.append(f"ANALOG:RATE is {said:g} Hz; {self.samples} samples in each frame make {rate:g} Hz")
        units = strings(self.groups, "ANALOG", "UNITS")
        units = units * self.channels if len(units) == 1 else units
        units = (units + [""] * self.channels)[: self.channels]
        descriptions = strings(self.groups, "ANALOG", "DESCRIPTIONS")
        extras = {"descriptions": tuple((descriptions + [""] * self.channels)[: self.channels])}
        signals = Signals(tuple(names), values, rate, tuple(units), "analog", "analog", extras)
        return list(zip(labels, names, strict=True)), (signals,)

    def per_channel(self, name: str, default: float, *, unsigned: bool = False) -> Array:
        """One number for each channel; a single one counts for all."""
        found = numbers(self.groups, "ANALOG", name, unsigned=unsigned)
        values = np.full(self.channels, default)
        if found is None:
            return values
        if len(found) == 1 and self.channels > 1:
            found = np.repeat(found, self.channels)
        if len(found) < self.channels:
            self.notes.append(
                f"ANALOG:{name} has {len(found)} values for {self.channels} channels; the rest is {default:g}"
            )
        count = min(len(found), self.channels)
        values[:count] = np.where(np.isfinite(found[:count]), found[:count], default)
        return values


def _long(values: Array | None) -> int | None:
    """A frame number in two 16-bit words, the low one first, or in one number."""
    if values is None or not len(values) or not np.isfinite(values).all():
        return None
    total = values[0] + (65536 * values[1] if len(values) > 1 else 0)
    return int(total) if 0 <= total < 1 << 32 else None
