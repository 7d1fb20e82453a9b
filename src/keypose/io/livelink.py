"""Live Link Face takes (.csv): weights of ARKit's 52 face shapes, and rotations of head and eyes, frame by frame.

The columns are morph channels under ARKit's own names (``eyeBlinkLeft``); head and eye rotations are channels too
(``headYaw``), in radians. The time code counts frames of 60 Hz with a fraction, and the camera does not keep to them: the
rate is measured over the take, and frames that were not recorded are filled in.

Source: Epic Games, "Recording Face Animation on iOS Device" (Unreal Engine documentation).
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from keypose.arrays import Array, Floats
from keypose.errors import FormatError, ShapeError
from keypose.io import atomic
from keypose.io.text import format_rows, parse_block, shown, to_number
from keypose.model import Clip, Motion, Pose, Property, Scene

# parts of the face, each with the shapes that the app lists for it
_EYE = ("EyeBlink", "EyeLookDown", "EyeLookIn", "EyeLookOut", "EyeLookUp", "EyeSquint", "EyeWide")
_MOUTH = (
    "JawForward", "JawRight", "JawLeft", "JawOpen", "MouthClose", "MouthFunnel", "MouthPucker", "MouthRight", "MouthLeft",
    *(f"Mouth{what}{side}" for what in ("Smile", "Frown", "Dimple", "Stretch") for side in ("Left", "Right")),
    "MouthRollLower", "MouthRollUpper", "MouthShrugLower", "MouthShrugUpper",
    *(f"Mouth{what}{side}" for what in ("Press", "LowerDown", "UpperUp") for side in ("Left", "Right")),
)  # fmt: skip
_REST = (
    "BrowDownLeft", "BrowDownRight", "BrowInnerUp", "BrowOuterUpLeft", "BrowOuterUpRight", "CheekPuff", "CheekSquintLeft",
    "CheekSquintRight", "NoseSneerLeft", "NoseSneerRight", "TongueOut",
)  # fmt: skip
_ROTATIONS = tuple(f"{part}{angle}" for part in ("Head", "LeftEye", "RightEye") for angle in ("Yaw", "Pitch", "Roll"))
COLUMNS = (*(f"{name}{side}" for side in ("Left", "Right") for name in _EYE), *_MOUTH, *_REST, *_ROTATIONS)
"""The 61 columns in the order of the app."""

_LARGEST_BYTES = 1 << 30
_LARGEST = 1e6
_MOST_FRAMES_FILLED = 10
_RATES_HZ = (24.0, 25.0, 30.0, 60.0)
_TIMECODE = re.compile(r"(\d{1,3}):(\d{1,2}):(\d{1,2})[:;](\d{1,3}(?:\.\d{1,9})?)")
_SECONDS_A_DAY = 86400.0


def read(path: Path, *, timecode_rate_hz: float | None = None) -> Scene:
    """Read a take as one `Motion` of morph weights.

    Shapes and units: ``timecode_rate_hz`` is the rate that the frames of the time code count; 60, or a lower usual one
    where no frame number needs more, if not given.

    Raises:
        FormatError: at the first line that does not follow the format.
        ShapeError: for a rate that is not positive.
    """
    if timecode_rate_hz is not None and not (np.isfinite(timecode_rate_hz) and timecode_rate_hz > 0):
        raise ShapeError(f"timecode_rate_hz: expected a positive number, got {timecode_rate_hz}")
    size = path.stat().st_size
    if size > _LARGEST_BYTES:
        raise FormatError(f"{size >> 20} MiB; at most {_LARGEST_BYTES >> 20} MiB are read", path=path)
    notes: list[str] = []
    names, table = _table(path.read_bytes(), notes)
    seconds, frames, values = table[:, 0], table[:, 1], table[:, 2:]
    counted = timecode_rate_hz or _counted_rate(seconds, frames, notes)
    times = seconds + frames / counted
    times = times + _SECONDS_A_DAY * np.concatenate([[0], np.cumsum(np.diff(times) < -_SECONDS_A_DAY / 2)])
    values = _held(values, notes)
    values, rate_hz = _uniform(times, values, counted, notes)
    channels = tuple(name[:1].lower() + name[1:] for name in names)
    nothing = Pose(np.zeros((len(values), 0, 3)), np.zeros((len(values), 0, 4)), np.zeros((len(values), 0, 3)))
    motion = Motion((), nothing, rate_hz, path.stem, morph_names=channels, morph_weights=values)
    extras = {"livelink": {"first_timecode_s": float(times[0]), "timecode_rate_hz": counted}}
    return Scene((), (motion,), "livelink", notes=tuple(notes), extras=extras)


def _table(data: bytes, notes: list[str]) -> tuple[list[str], Floats]:
    """Column names, and rows of seconds, frame number and values (NaN where a row has none)."""
    if b"\0" in data:
        raise FormatError("a null byte; this is no text", where=f"byte {data.index(0)}")
    text = data.removeprefix(b"\xef\xbb\xbf").replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    head, _, body = text.partition(b"\n")
    header = [word.strip() for word in head.decode("utf-8", "replace").split(",")]
    if len(header) < 3 or header[0].lower() != "timecode" or header[1].lower() != "blendshapecount":
        raise FormatError(
            "of .csv files only takes of Live Link Face are understood, which begin with Timecode,BlendshapeCount,…; "
            f"got {shown(head)}",
            where="line 1",
        )
    names = header[2:]
    seen: set[str] = set()
    twice = next((n for n in names if n.lower() in seen or seen.add(n.lower())), None)
    if twice is not None or not all(names):
        raise FormatError(f"column {shown(twice or '')} is there twice or has no name", where="line 1")
    known = {name.lower() for name in COLUMNS}
    strange = [name for name in names if name.lower() not in known]
    missing = len(known) - (len(names) - len(strange))
    if strange or missing:
        notes.append(f"{missing} of the usual 61 columns are missing, {len(strange)} are others")
    width = len(names) + 5
    rows = body.count(b"\n") + (bool(body) and not body.endswith(b"\n"))
    plain = body.replace(b",", b" ").replace(b":", b" ")
    numbers, wrong = parse_block(plain, 0, len(plain))
    regular = wrong < 0 and rows and numbers.size == rows * width and body.count(b":") == 3 * rows
    if regular and body.count(b",") == rows * (len(names) + 1):
        table = numbers.reshape(rows, width)
        whole = np.all(table[:, :3] == np.floor(table[:, :3]))
        in_range = np.all((table[:, :4] >= 0) & (table[:, :4] < (100, 60, 60, 1000))) and np.all(
            np.abs(table) <= _LARGEST
        )
        if whole and in_range and np.all(table[:, 4] == len(names)):
            seconds = table[:, :3] @ (3600.0, 60.0, 1.0)
            return names, np.concatenate([seconds[:, None], table[:, 3:4], table[:, 5:]], axis=1)
    return names, _lines(body, len(names), notes)


def _lines(body: bytes, count: int, notes: list[str]) -> Floats:
    rows: list[list[float]] = []
    other_counts = 0
    for number, line in enumerate(body.split(b"\n"), 2):
        if not line.strip():
            continue
        where = f"line {number}"
        words = [word.strip() for word in line.decode("utf-8", "replace").split(",")]
        match = _TIMECODE.fullmatch(words[0])
        if match is None or int(match[1]) >= 100 or int(match[2]) >= 60 or int(match[3]) >= 60:
            raise FormatError(f"expected a time code HH:MM:SS:FF.fff, got {shown(words[0])}", where=where)
        values = words[2:]
        empty = not any(values)
        if len(values) != count and not empty:
            raise FormatError(f"{len(values)} values; the header has {count}", where=where)
        other_counts += len(words) > 1 and words[1] != str(count) and not empty
        row = [int(match[1]) * 3600.0 + int(match[2]) * 60.0 + int(match[3]), float(match[4])]
        if empty:
            row += [np.nan] * count
        else:
            for word in values:
                try:
                    row.append(to_number(word, _LARGEST) if word else np.nan)
                except ValueError:
                    raise FormatError(f"expected a number, got {shown(word)}", where=where) from None
        rows.append(row)
    if not rows:
        raise FormatError("no frames", where="end of file")
    if other_counts:
        notes.append(f"{other_counts} frames say another BlendshapeCount than there are columns ({count})")
    return np.array(rows)


def _counted_rate(seconds: Floats, frames: Floats, notes: list[str]) -> float:
    highest = float(frames.max())
    if seconds[-1] - seconds[0] >= 2:  # long enough that every frame number appears
        rate_hz = next((rate for rate in _RATES_HZ if highest < rate), 60.0)
    else:
        rate_hz = 60.0
    if rate_hz != 60.0:
        notes.append(f"the time code counts {rate_hz:g} frames a second, for no frame number needs more")
    elif highest >= 60:
        raise FormatError(
            f"frame {highest:g} of a time code that counts 60 a second; name its rate with timecode_rate_hz"
        )
    return rate_hz


def _held(values: Floats, notes: list[str]) -> Floats:
    """Values that are missing are those of the frame before, of the first that has some at the start, else 0."""
    gone = ~np.isfinite(values)
    if not gone.any():
        return values
    frames = int(gone.any(axis=1).sum())
    notes.append(
        f"{frames} of {len(values)} frames lack values (no face was seen); they keep those of the frame before"
    )
    index = np.where(gone, -1, np.arange(len(values))[:, None])
    index = np.maximum.accumulate(index, axis=0)
    first = np.argmax(~gone, axis=0)
    index = np.where(index < 0, first, index)
    return np.nan_to_num(np.take_along_axis(values, index, axis=0), nan=0.0)


def _uniform(times: Floats, values: Floats, counted: float, notes: list[str]) -> tuple[Floats, float]:
    """The values at a uniform rate, and the rate."""
    if len(times) < 2:
        return values, counted
    steps = np.diff(times)
    back = np.nonzero(steps <= 0)[0]
    if len(back):
        notes.append(f"{len(back)} time codes do not come after the one before, the first in line {int(back[0]) + 3}; frames are "
                     f"taken at {counted:g} Hz")  # fmt: skip
        return values, counted
    step = float(np.median(steps))
    span = float(times[-1] - times[0])
    count = round(span / step)
    if count == len(steps) and np.max(np.abs(times - times[0] - np.arange(len(times)) * span / count)) <= 0.5 * step:
        rate_hz = _snapped(count / span, span, counted)
        drift = counted / rate_hz
        if abs(drift - 1) > 1e-6:
            notes.append(f"the time code steps by {drift:.4g} frames: {rate_hz:.6g} Hz, not {counted:g}")
        return values, rate_hz
    if count > _MOST_FRAMES_FILLED * len(times):
        notes.append(f"the time code has a gap of {float(steps.max()):.3g} s; frames are taken at {counted:g} Hz")
        return values, counted
    rate_hz = _snapped(1 / step, step, counted)
    grid = np.arange(round(span * rate_hz) + 1) / rate_hz
    filled = np.stack([np.interp(grid, times - times[0], column) for column in values.T], axis=1)
    notes.append(
        f"frames are missing or late (the longest step is {float(steps.max()) * rate_hz:.3g} frames); {len(times)} frames became {len(grid)} at "
        f"{rate_hz:.6g} Hz"
    )
    return filled, rate_hz


def _snapped(rate_hz: float, span: float, counted: float) -> float:
    """A usual rate, where the digits of the time code cannot tell it from the measured one."""
    tolerance = 1.5e-3 / counted  # of both ends together, in seconds; fractions have three digits
    usual = (*_RATES_HZ, 48.0, 50.0, 100.0, 120.0, *(r * 1000 / 1001 for r in (24, 30, 60, 120)))
    return next((rate for rate in usual if abs(span * rate_hz / rate - span) <= tolerance), rate_hz)


def write(scene: Scene, path: Path, *, rate_hz: float | None = None) -> tuple[str, ...]:
    """Write the morph weights of the scene's first animation that has any, in the app's 61 columns.

    Channels are found by ARKit's names in any case; those that are not there are 0. The time code starts where that of
    the take started, else at 0, and counts 60 frames a second.

    Shapes and units: ``rate_hz`` is the rate of the frames; that of the animation, else 60, if not given.

    Raises:
        FormatError: where no animation drives any of the 61, or the file cannot be written.
    """
    from keypose.evaluate import sample_morphs

    notes: list[str] = []
    chosen = next((a for a in scene.animations if any(n.lower() in _BY_NAME for n in _channels(a))), None)
    if chosen is None:
        raise FormatError("no animation drives any of ARKit's face shapes", path=path)
    if len(scene.animations) > 1:
        notes.append(f"one animation fits into the file: '{chosen.name}' of {len(scene.animations)}")
    channels = _channels(chosen)
    rate = rate_hz or chosen.rate_hz or 60.0
    if not (np.isfinite(rate) and rate > 0):
        raise ShapeError(f"rate_hz: expected a positive number, got {rate_hz}")
    if isinstance(chosen, Motion) and rate == chosen.rate_hz:
        weights: Array = np.asarray(chosen.morph_weights, np.float64)
    else:
        start = chosen.start_s
        times = start + np.arange(int(np.floor(chosen.duration_s * rate + 1e-6)) + 1) / rate
        weights = np.asarray(sample_morphs(chosen, channels, times), np.float64)
    table = np.zeros((len(weights), len(COLUMNS)))
    dropped: list[str] = []
    for number, name in enumerate(channels):
        column = _BY_NAME.get(name.lower())
        if column is None:
            dropped.append(name)
        else:
            table[:, column] = weights[:, number]
    if dropped:
        shown_names = ", ".join(dropped[:6]) + (", …" if len(dropped) > 6 else "")
        notes.append(f"{len(dropped)} morph channels have no column and were not written: {shown_names}")
    if isinstance(chosen, Motion) and chosen.joint_names:
        notes.append("joints have no columns; only morph weights were written")
    kept = scene.extras.get("livelink")
    first = kept.get("first_timecode_s", 0.0) if isinstance(kept, dict) else 0.0
    first = first if isinstance(first, float) and 0 <= first < _SECONDS_A_DAY else 0.0
    rows = format_rows(table, 10).replace(b" ", b",").splitlines()
    lines = [f"Timecode,BlendshapeCount,{','.join(COLUMNS)}".encode()]
    lines += [f"{_timecode(first + k / rate)},{len(COLUMNS)},".encode() + row for k, row in enumerate(rows)]
    with atomic.replacing(path) as temporary:
        temporary.write_bytes(b"\n".join(lines) + b"\n")
    return tuple(notes)


_BY_NAME = {name.lower(): column for column, name in enumerate(COLUMNS)}


def _channels(animation: Motion | Clip) -> tuple[str, ...]:
    if isinstance(animation, Motion):
        return animation.morph_names
    return tuple(channel.target for channel in animation.curves if channel.property is Property.WEIGHT)


def _timecode(seconds: float) -> str:
    thousandths = round(seconds % _SECONDS_A_DAY * 60_000)
    whole, rest = divmod(thousandths, 60_000)
    return f"{whole // 3600 % 24:02}:{whole // 60 % 60:02}:{whole % 60:02}:{rest // 1000:02}.{rest % 1000:03}"
