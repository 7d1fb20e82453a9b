"""Compiled clips: read-only animation in a fraction of the memory, sampled at any time in any order."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from keypose.arrays import Array
from keypose.errors import FormatError, ShapeError, UnknownName
from keypose.evaluate import key_rate, match, sample_clip, sample_morphs, sample_motion
from keypose.model import Clip, Event, Motion, Pose, Property, Skeleton
from keypose.play import clipfile, compress, store
from keypose.play.proof import Budget, Frames, decode_frames
from keypose.play.store import Decoder, Packed

_USUAL_HZ = 60.0
_MOST_FRAMES = 1 << 24


@dataclass(frozen=True, slots=True)
class CompileError:
    """The largest error of a compiled clip, found by comparing it with its source at four times the rate.

    max_m: metres, at points ``shell_m`` off every joint in model space. joint: where it is closest to (or beyond) what it
    may be, or "" where that is a morph weight. time_s: when. ratio: that error relative to what is allowed there.
    """

    max_m: float
    joint: str
    time_s: float
    ratio: float

    @property
    def holds(self) -> bool:
        """Whether the error is nowhere greater than asked for."""
        return self.ratio <= 1.0


@dataclass(frozen=True, slots=True, eq=False)
class CompiledClip:
    """A clip that can only be played: constant numbers stripped, the others quantised within a proven error.

    Shapes and units: ``rate_hz`` frames per second, from ``start_s``; ``loop`` says what times outside mean. ``decoder``
    holds the arrays of `keypose.kernels.decode`.
    """

    name: str
    joint_names: tuple[str, ...]
    morph_names: tuple[str, ...]
    rate_hz: float
    start_s: float
    frame_count: int
    loop: bool
    tolerance_m: float
    shell_m: float
    error: CompileError
    events: tuple[Event, ...]
    byte_count: int  # of the whole file
    packed: Packed = field(repr=False)
    decoder: Decoder = field(repr=False)

    @property
    def duration_s(self) -> float:
        """Time from the first frame to the last."""
        return (self.frame_count - 1) / self.rate_hz

    @property
    def end_s(self) -> float:
        """Time of the last frame."""
        return self.start_s + self.duration_s

    @property
    def raw_byte_count(self) -> int:
        """Bytes of the same frames as float32 translations, rotations, scales and morph weights."""
        return self.frame_count * (10 * len(self.joint_names) + len(self.morph_names)) * 4

    @property
    def ratio(self) -> float:
        """How many times smaller than the raw frames the file is."""
        return self.raw_byte_count / self.byte_count


def compile_clip(
    animation: Clip | Motion,
    skeleton: Skeleton,
    *,
    tolerance_m: float = 1e-4,
    shell_m: float = 0.03,
    overrides: Mapping[str, float] | None = None,
    rate_hz: float | None = None,
    loop: bool = False,
    morph_tolerance: float = 1e-3,
    morph_names: Sequence[str] | None = None,
) -> CompiledClip:
    """An animation of a skeleton, compressed so that no point of the body is ever off by more than a tolerance.

    Shapes and units:
        tolerance_m: largest error in model space of the points ``shell_m`` off every joint, on its three axes.
        overrides: joint name -> its own tolerance in metres.
        rate_hz: frames per second (the motion's own rate or the rate of the clip's keys if not given; 60 where there is
            none). Where the straight way between frames would miss the source, up to 32 times as many samples are taken.
        morph_tolerance: largest error of a morph weight. morph_names: which (all that the animation has if not given).

    The result says what error was measured, at all frames and three times between each two; where the tolerance cannot be
    met (a key that jumps between two frames, numbers too great for float32), ``error.holds`` is False.

    Raises:
        ShapeError: where a tolerance or the rate is not positive, or the animation is empty or not finite.
        UnknownName: where an override names no joint.

    Source: N. Frechette, "Animation Compression Library" (2017), for error at virtual vertices.
    """
    for name, value in (("tolerance_m", tolerance_m), ("shell_m", shell_m), ("morph_tolerance", morph_tolerance)):
        if not (math.isfinite(value) and value > 0):
            raise ShapeError(f"{name}: expected a positive number, got {value}")
    if skeleton.joint_count == 0:
        raise ShapeError(f"clip '{animation.name}': the skeleton has no joints")
    tolerances = np.full(skeleton.joint_count, float(tolerance_m))
    for joint, value in (overrides or {}).items():
        if not (math.isfinite(value) and value > 0):
            raise ShapeError(f"overrides: expected a positive number of metres for '{joint}', got {value}")
        tolerances[skeleton.index(joint)] = value
    budget = Budget(tolerances, float(shell_m), float(morph_tolerance))
    names = _morph_names(animation) if morph_names is None else tuple(morph_names)
    truth = _source(animation, skeleton, names)
    start, end, rate = _range(animation, rate_hz)
    times = _frame_times(start, end, rate)
    rate = (len(times) - 1) / (end - start) if len(times) > 1 else rate
    events = [[e.time_s, e.name, e.data] for e in animation.events] if isinstance(animation, Motion) else []
    info: dict[str, Any] = {
        "name": animation.name, "joints": list(skeleton.names), "morphs": list(names), "frames": len(times),
        "rate_hz": rate, "start_s": start, "loop": bool(loop), "tolerance_m": float(tolerance_m),
        "shell_m": float(shell_m), "events": events,
    }  # fmt: skip
    packed, measured = compress.encode(skeleton, truth, times, info, budget)
    where = skeleton.names[measured.joint] if measured.joint >= 0 else ""
    info["error"] = {"max_m": measured.error_m, "joint": where, "time_s": measured.time_s, "ratio": measured.ratio}
    return _compiled(packed)


def sample(
    clip: CompiledClip, times_s: Array | float, skeleton: Skeleton | None = None, *, loop: bool | None = None
) -> Pose:
    """The pose at any times, in any order: batch shape that of ``times_s``, float32.

    Times outside the clip are clamped to its ends, or wrapped where it loops (``loop`` overrides the clip's own; a loop is
    as long as from the first frame to the last, which should be alike). With a ``skeleton`` the joints come in its order.

    Raises:
        ShapeError: where a time is not finite.
        UnknownName: where the skeleton has a joint that the clip has not.
    """
    decoded, shape = _decoded(clip, times_s, loop)
    translations, rotations, scales = (
        a.reshape(*shape, *a.shape[1:]) for a in (decoded.translations, decoded.rotations, decoded.scales)
    )
    if skeleton is not None and skeleton.names != clip.joint_names:
        index = {n: i for i, n in enumerate(clip.joint_names)}
        for name in skeleton.names:
            if name not in index:
                raise UnknownName("joint", name, clip.joint_names)
        rows = [index[n] for n in skeleton.names]
        translations, rotations, scales = (np.take(a, rows, axis=-2) for a in (translations, rotations, scales))
    for array in (translations, rotations, scales):
        array.setflags(write=False)
    return Pose(translations, rotations, scales)


def sample_weights(clip: CompiledClip, times_s: Array | float, *, loop: bool | None = None) -> Array:
    """The morph weights at any times, (*B, M) float32, for ``clip.morph_names``; raises as `sample`."""
    decoded, shape = _decoded(clip, times_s, loop)
    return decoded.weights.reshape(*shape, len(clip.morph_names))


def sample_rows(clip: CompiledClip, times_s: Array | float, *, loop: bool | None = None) -> Array:
    """Poses in the decoder's own layout, (N, 10, padded joints) float32 for times (N,).

    Rows are w, x, y, z, three of translation and three of scale; joints are filled up to a multiple of 16 with ones that
    stay at the identity. Raises as `sample`.
    """
    from keypose.kernels.decode import decode_at
    from keypose.kernels.runtime import aligned

    times = _checked_times(times_s).ravel()
    d = clip.decoder
    out = aligned(len(times) * d.stride)
    decode_at(
        d.layout,
        d.tables,
        d.book,
        d.codes,
        clip.start_s,
        clip.rate_hz,
        clip.loop if loop is None else loop,
        times,
        aligned(d.room),
        out,
    )
    rows = out.reshape(len(times), d.stride)[:, : store.ROWS * d.padded]
    return rows.reshape(len(times), store.ROWS, d.padded)


def to_bytes(clip: CompiledClip) -> bytes:
    """The clip as the bytes of a file; the same clip always gives the same bytes."""
    return clipfile.to_bytes(clip.packed)


def from_bytes(data: bytes) -> CompiledClip:
    """The clip that `to_bytes` made these bytes of.

    Raises:
        FormatError: where they are no compiled clip, of another version, changed or cut; it names the place.
    """
    packed = clipfile.from_bytes(data)
    try:
        return _compiled(packed, len(data))
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        if isinstance(error, FormatError):
            raise
        raise FormatError(f"the header does not hold together: {error}", where=f"byte {clipfile.HEADER_AT}") from None


def _compiled(packed: Packed, byte_count: int | None = None) -> CompiledClip:
    info = packed.info
    error = info["error"]
    return CompiledClip(
        info["name"],
        tuple(info["joints"]),
        tuple(info["morphs"]),
        float(info["rate_hz"]),
        float(info["start_s"]),
        int(info["frames"]),
        bool(info["loop"]),
        float(info["tolerance_m"]),
        float(info["shell_m"]),
        CompileError(float(error["max_m"]), str(error["joint"]), float(error["time_s"]), float(error["ratio"])),
        tuple(Event(float(time_s), str(name), str(data)) for time_s, name, data in info["events"]),
        len(clipfile.to_bytes(packed)) if byte_count is None else byte_count,
        packed,
        store.decoder(packed),
    )


def _checked_times(times_s: Array | float) -> Array:
    times = np.asarray(times_s, np.float64)
    if not np.all(np.isfinite(times)):
        raise ShapeError("times_s: expected finite numbers")
    return times


def _decoded(clip: CompiledClip, times_s: Array | float, loop: bool | None) -> tuple[Frames, tuple[int, ...]]:
    times = _checked_times(times_s)
    wraps = clip.loop if loop is None else loop
    return decode_frames(clip.packed, clip.decoder, times.ravel(), wraps), times.shape


# --- the source ---------------------------------------------------------------------------------------------------------


def _morph_names(animation: Clip | Motion) -> tuple[str, ...]:
    if isinstance(animation, Motion):
        return animation.morph_names
    return tuple(dict.fromkeys(c.target for c in animation.curves if c.property is Property.WEIGHT))


def _source(animation: Clip | Motion, skeleton: Skeleton, morph_names: tuple[str, ...]) -> Callable[[Array], Frames]:
    """What the clip really does at times (F,), float64, checked."""
    matched = match(animation, skeleton)
    rest = np.zeros(len(morph_names))

    def at(times: Array) -> Frames:
        if isinstance(matched, Motion):
            pose = sample_motion(matched, times)
        else:
            pose = sample_clip(matched, skeleton, times)
        weights = sample_morphs(matched, morph_names, times, rest) if morph_names else np.zeros((len(times), 0))
        pose = pose.broadcast()
        rotations, translations, scales, weights = (
            np.array(a, np.float64) for a in (pose.rotations, pose.translations, pose.scales, weights)
        )
        for what, values in (("rotation", rotations), ("translation", translations), ("scale", scales)):
            bad = np.argwhere(~np.isfinite(values))
            if len(bad):
                frame, joint = bad[0][:2].tolist()
                raise ShapeError(
                    f"clip '{animation.name}': the {what} of '{skeleton.names[joint]}' is not finite at {times[frame]:.6g} s"
                )
        bad = np.argwhere(~np.isfinite(weights))
        if len(bad):
            raise ShapeError(
                f"clip '{animation.name}': the weight of '{morph_names[int(bad[0][1])]}' is not finite at "
                f"{times[int(bad[0][0])]:.6g} s"
            )
        length = np.linalg.norm(rotations, axis=-1, keepdims=True)
        bad = np.argwhere(length[..., 0] < 1e-9)
        if len(bad):
            frame, joint = bad[0].tolist()
            raise ShapeError(
                f"clip '{animation.name}': the rotation of '{skeleton.names[joint]}' is zero at {times[frame]:.6g} s"
            )
        return Frames(rotations / length, translations, scales, weights)

    return at


def _range(animation: Clip | Motion, rate_hz: float | None) -> tuple[float, float, float]:
    """First and last time, and the rate to sample at."""
    if isinstance(animation, Motion):
        if animation.frame_count == 0:
            raise ShapeError(f"motion '{animation.name}' has no frames")
        start, end, own = float(animation.start_s), float(animation.start_s) + animation.duration_s, animation.rate_hz
    else:
        start, end, own = animation.start_s, animation.end_s, key_rate(animation)
    rate = rate_hz if rate_hz is not None else own or _USUAL_HZ
    if not (math.isfinite(rate) and rate > 0):
        raise ShapeError(f"rate_hz: expected a positive number, got {rate}")
    if not (math.isfinite(start) and math.isfinite(end)):
        raise ShapeError(f"clip '{animation.name}': expected finite times, got {start} to {end} s")
    if (end - start) * rate > _MOST_FRAMES:
        raise ShapeError(
            f"rate_hz: {(end - start) * rate:.3g} frames of clip '{animation.name}' are more than {_MOST_FRAMES}"
        )
    return start, end, float(rate)


def _frame_times(start: float, end: float, rate_hz: float) -> Array:
    """Frames at about the rate, the last one exactly at the end."""
    count = math.ceil((end - start) * rate_hz - 0.01)
    if count < 1:
        return np.array([start])
    times = start + np.arange(count + 1) * ((end - start) / count)
    times[-1] = end
    return times
