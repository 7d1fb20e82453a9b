"""Crowds that play compiled clips: each character mixes a few clips at times of its own, and gets its model matrices."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from types import ModuleType
from typing import Any, cast

import numpy as np

from keypose.arrays import Array
from keypose.errors import ShapeError
from keypose.evaluate import world
from keypose.model import Pose, Skeleton
from keypose.play.clip import CompiledClip, sample, sample_rows

_FRAMES = 16  # samples of a segment
_INT64, _FLOAT64 = np.dtype(np.int64), np.dtype(np.float64)
_GROUP = 16  # joints that move or rest together
_FINEST = 16  # knots of one sample, at most
_STRAIGHT_M = 5e-5  # how far the straight way between two knots may be from the clip itself


@dataclass(slots=True, eq=False)
class _Call:
    """A kernel that takes one address, and what is there. It need not look again at arrays that come again."""

    function: Any
    about: Array  # numbers and addresses, see `kernels.crowd.CALL`
    address: int
    models: Array
    which: Array = field(default_factory=lambda: np.zeros(0))
    times_s: Array = field(default_factory=lambda: np.zeros(0))
    weights: Array = field(default_factory=lambda: np.zeros(0))
    run: Callable[[int], int] = lambda address: 0  # the function without its dispatcher, as soon as it is needed


@dataclass(frozen=True, slots=True, eq=False)
class Crowd:
    """Characters of one skeleton that play compiled clips; made by `prepare`, which is where all its memory comes from.

    A crowd is written by `animate`: two threads must not use one at the same time. Give each its own.
    """

    clips: tuple[CompiledClip, ...]
    skeleton: Skeleton
    count: int
    clips_each: int
    pool_bytes: int
    models: Array = field(repr=False)  # (blocks, J, 12, W) float32
    model: Array = field(repr=False)  # (J, 4, 4) float32, of one character
    handles: Array = field(repr=False)
    parts: dict[str, Array] = field(repr=False)  # what the handles point to
    kernel: ModuleType = field(repr=False)
    all_call: _Call = field(repr=False)
    one_call: _Call = field(repr=False)

    @property
    def decoded_count(self) -> int:
        """How many samples of clips have been decoded since the crowd was prepared."""
        return int(self.handles[self.kernel.DECODED])


def prepare(
    clips: Sequence[CompiledClip],
    skeleton: Skeleton,
    count: int,
    *,
    clips_each: int = 4,
    loop: bool | None = None,
    pool_bytes: int = 8 << 20,
) -> Crowd:
    """A crowd of ``count`` characters that each mix up to ``clips_each`` of these clips.

    Decoded samples are kept in up to ``pool_bytes`` of memory (more where one block of characters needs more), however
    many and long the clips are; where it does not hold what the crowd plays at one time, samples are decoded again and
    again. ``loop`` overrides what the clips themselves say.

    Raises:
        ShapeError: where there are no clips, their joints are not those of the skeleton in the same order, or a number
            is not positive.
    """
    from keypose.kernels import crowd as kernel
    from keypose.kernels.runtime import WIDTH, aligned

    clips = tuple(clips)
    if not clips:
        raise ShapeError("clips: expected at least one compiled clip")
    for name, value in (("count", count), ("clips_each", clips_each), ("pool_bytes", pool_bytes)):
        if value < 1:
            raise ShapeError(f"{name}: expected a positive number, got {value}")
    for clip in clips:
        if clip.joint_names != skeleton.names:
            raise ShapeError(
                f"clip '{clip.name}': expected the {skeleton.joint_count} joints of the skeleton, in its order, got "
                f"{len(clip.joint_names)} that differ"
            )
    joints, padded = skeleton.joint_count, clips[0].decoder.padded
    rest, moved_at, scaled_at = _constants(clips)
    moved, scaled = (int(np.sum(at >= 0)) * _GROUP for at in (moved_at, scaled_at))
    knot_size = 4 * padded + 3 * (moved + scaled)
    table = np.zeros((len(clips), kernel.CLIP), np.int64)
    times: list[Array] = []
    total = 0
    for row, clip in zip(table, clips, strict=True):
        d = clip.decoder
        wraps = clip.loop if loop is None else loop
        fineness = _fineness(clip, skeleton)
        knots = _knot_times(clip, fineness)
        addresses = [a.ctypes.data for a in (d.layout, d.tables, d.book, d.codes)]
        row[:] = (*addresses, total, len(knots), fineness, wraps)
        times.append(knots)
        total += len(knots)
    # One block of characters must find all its knots in the pool at once, or in the slots after it.
    slots, spare = total, 0
    if 4 * knot_size * total > pool_bytes:
        spare = 2 * clips_each * WIDTH
        slots = min(max(pool_bytes // (4 * knot_size) - spare, 2 * clips_each * WIDTH + 1), total)
    room, stride = max(c.decoder.room for c in clips), max(c.decoder.stride for c in clips)
    parts = {
        "clip_table": table.ravel(),
        "timing": np.array([[c.start_s, c.rate_hz] for c in clips], np.float64).ravel(),
        "knot_times": np.concatenate(times),
        "slot_of": np.full(total, -1, np.int64),
        "knot_of": np.full(slots, -1, np.int64),
        "stamps": np.full(slots, -1, np.int64),
        "pool": aligned((slots + spare) * knot_size),
        "moved_at": moved_at,
        "scaled_at": scaled_at,
        "rest": rest,
        "parents": np.array(skeleton.parents, np.int64),
        "places": aligned(2 * clips_each * WIDTH, np.int64),
        "shares": aligned(2 * clips_each * WIDTH),
        "poses": aligned(2 * kernel.ROWS * WIDTH * WIDTH),
        "sums": aligned(2 * room),
        "room": aligned(2 * stride),
        "local": aligned(12 * padded),
        "model": aligned(16 * joints),
    }
    numbers = (joints, padded, len(clips), moved, scaled, knot_size, slots, 0, 0, 0)
    handles = np.array([*numbers, *(part.ctypes.data for part in parts.values()), spare, room, stride], np.int64)
    blocks = -(-count // WIDTH)
    models = aligned(blocks * joints * 12 * WIDTH).reshape(blocks, joints, 12, WIDTH)
    model = parts["model"].reshape(joints, 4, 4)
    used = 4 * knot_size * (slots + spare)
    calls = (_call(kernel.animate, handles, models, count), _call(kernel.animate_one, handles, model, 1))
    return Crowd(clips, skeleton, count, clips_each, used, models, model, handles, parts, kernel, *calls)


def animate(crowd: Crowd, clip_indices: Array, times_s: Array, weights: Array) -> Array:
    """Sample up to ``crowd.clips_each`` clips for each character, blend them, and walk the skeleton.

    Shapes and units: ``clip_indices`` integers, ``times_s`` and ``weights`` (>= 0, of any sum), all (count, K) with
    K <= ``clips_each``, or broadcastable to that. Returns ``crowd.models``, (blocks, J, 12, W) float32: rows of 3x4
    matrices model_from_joint, characters in the lanes, the last character filling up its block; the next call writes
    there again. `model_matrices` makes plain matrices of them. Nothing is allocated where the arrays are int64, float64
    and float64 in C order.

    Blending is that of `keypose.evaluate.blend`: rotations are summed on one side and normalised, the rest is a weighted
    mean; where no weight is above zero the first clip is played. Arrays that are handed in again, with new numbers, need
    no second look at their types.

    Raises:
        ShapeError: where shapes disagree, a clip does not exist, a time is not finite or a weight is not >= 0.
    """
    call = crowd.all_call
    if clip_indices is not call.which or times_s is not call.times_s or weights is not call.weights:
        _aim(crowd, call, 2, clip_indices, times_s, weights)
    wrong = call.run(call.address)
    if wrong:
        _refuse(crowd, call, wrong)
    return call.models


def animate_one(crowd: Crowd, clip_indices: Array, times_s: Array, weights: Array) -> Array:
    """As `animate`, for one character alone and quicker for that: arrays (K,).

    Returns ``crowd.model``, model_from_joint (J, 4, 4) float32; the next call writes there again. Raises as `animate`.
    """
    call = crowd.one_call
    if clip_indices is not call.which or times_s is not call.times_s or weights is not call.weights:
        _aim(crowd, call, 1, clip_indices, times_s, weights)
    wrong = call.run(call.address)
    if wrong:
        _refuse(crowd, call, wrong)
    return call.models


def model_matrices(crowd: Crowd, models: Array) -> Array:
    """What `animate` returned as model_from_joint, (count, J, 4, 4) float32, a copy."""
    return plain_matrices(models, crowd.count)


def plain_matrices(models: Array, count: int) -> Array:
    """Matrices (count, J, 4, 4) float32 of rows with characters in the lanes, (blocks, J, 12, W)."""
    rows = np.moveaxis(models, -1, 1).reshape(-1, models.shape[1], 3, 4)[:count]
    out = np.zeros((count, models.shape[1], 4, 4), np.float32)
    out[:, :, :3] = rows
    out[:, :, 3, 3] = 1.0
    return out


def forget(crowd: Crowd) -> None:
    """Empty the pool of decoded samples, as it was at first."""
    for name in ("slot_of", "knot_of", "stamps"):
        crowd.parts[name].fill(-1)


# --- checks ---------------------------------------------------------------------------------------------------------------


def _call(function: Any, handles: Array, models: Array, characters: int) -> _Call:
    from keypose.kernels.crowd import CALL

    about = np.zeros(CALL, np.int64)
    about[:6] = handles.ctypes.data, 0, 0, 0, models.ctypes.data, characters
    return _Call(function, about, about.ctypes.data, models)


def _fits(array: Any, dtype: Any, axes: int) -> bool:
    return type(array) is np.ndarray and array.dtype is dtype and array.ndim == axes and array.flags.carray


def _aim(crowd: Crowd, call: _Call, axes: int, which: Any, times: Any, weights: Any) -> None:
    """Look at the arrays of a call, and convert what is of another type."""
    from keypose.kernels.runtime import entry_of_address

    count = crowd.count if axes == 2 else 1
    fit = _fits(which, _INT64, axes) and _fits(times, _FLOAT64, axes) and _fits(weights, _FLOAT64, axes)
    if not (fit and which.shape == times.shape == weights.shape):
        which, times, weights = _converted(count, which, times, weights)
    many = which.shape[-1]
    if which.size != count * many or not 1 <= many <= crowd.clips_each:
        rows = f"({count}, K)" if axes == 2 else "(K,)"
        raise ShapeError(
            f"clip_indices, times_s, weights: expected {rows} with K from 1 to {crowd.clips_each}, got {which.shape}"
        )
    crowd.kernel.aim(call.about, which, times, weights)
    call.about[6] = many
    call.which, call.times_s, call.weights = which, times, weights
    call.run = entry_of_address(call.function)


def _converted(count: int, which: Any, times: Any, weights: Any) -> tuple[Array, Array, Array]:
    which = np.asarray(which)
    if which.dtype.kind not in "iu":
        raise ShapeError(f"clip_indices: expected integers, got {which.dtype}")
    try:
        which, times, weights = np.broadcast_arrays(which, np.asarray(times, np.float64), weights)
        shape = (count, which.shape[-1] if which.ndim else 1)
        which, times, weights = (np.broadcast_to(a, shape) for a in (which, times, weights))
    except ValueError as error:
        raise ShapeError(f"clip_indices, times_s, weights: expected ({count}, K): {error}") from None
    return (
        np.require(which, np.int64, ["C", "A", "W"]),
        np.require(times, np.float64, ["C", "A", "W"]),
        np.require(weights, np.float64, ["C", "A", "W"]),
    )


def _refuse(crowd: Crowd, call: _Call, wrong: int) -> None:
    kernel = crowd.kernel
    which, times, weights = (np.atleast_2d(a) for a in (call.which, call.times_s, call.weights))
    if wrong == kernel.BAD_CLIP:
        bad = (which < 0) | (which >= len(crowd.clips))
        name, values, expected = "clip_indices", which, f"0 to {len(crowd.clips) - 1}"
    elif wrong == kernel.BAD_TIME:
        bad, name, values, expected = ~np.isfinite(times), "times_s", times, "finite numbers"
    else:
        bad = ~(np.isfinite(weights) & (weights >= 0))
        name, values, expected = "weights", weights, "finite numbers >= 0"
    character, column = cast("list[int]", np.argwhere(bad)[0].tolist())
    raise ShapeError(f"{name}: expected {expected}, got {values[character, column]} for character {character}")


# --- clips ----------------------------------------------------------------------------------------------------------------


def _constants(clips: tuple[CompiledClip, ...]) -> tuple[Array, Array, Array]:
    """Translations and scales that never move in any clip, (6, padded), and where groups of joints that do are in a knot."""
    from keypose.kernels.crowd import STILL, UNIT
    from keypose.kernels.runtime import aligned_copy

    padded = clips[0].decoder.padded
    first = np.array(sample_rows(clips[0], [clips[0].start_s])[0, 4:])
    moving = np.zeros((6, padded), bool)
    for clip in clips:
        joints = len(clip.joint_names)
        moving[:, :joints] |= (clip.packed.moving[None, :].astype(np.int64) >> np.arange(4, 10)[:, None]) & 1 > 0
        moving |= sample_rows(clip, [clip.start_s])[0, 4:] != first
    places: list[Array] = []
    for rows in (slice(0, 3), slice(3, 6)):
        groups = moving[rows].any(axis=0).reshape(-1, _GROUP).any(axis=1)
        ones = (first[rows] == 1).all(axis=0).reshape(-1, _GROUP).all(axis=1) & (rows.start == 3)
        at = np.where(ones, UNIT, STILL)
        at[groups] = np.arange(int(groups.sum())) * _GROUP
        places.append(at.astype(np.int64))
    return aligned_copy(first), places[0], places[1]


def _knot_times(clip: CompiledClip, fineness: int) -> Array:
    """The place in frames of every knot: of every sample of every segment, and ``fineness`` - 1 between it and the next."""
    from keypose.kernels.decode import CELLS, SLOTS, TRACKS

    layout = clip.decoder.layout
    if layout[TRACKS] == 0:
        return np.zeros(1)
    starts: dict[int, tuple[float, int]] = {}
    for slot in range(-(-clip.frame_count // _FRAMES)):
        entry = int(layout[int(layout[SLOTS]) + slot])
        cells = 1 << (entry & 7)
        for cell in range(cells):
            found = int(layout[int(layout[CELLS]) + (entry >> 3) + cell])
            starts.setdefault(found >> 3, ((slot + cell / cells) * _FRAMES, 1 << (found & 7)))
    steps = np.arange(_FRAMES * fineness) / fineness
    return np.concatenate([starts[s][0] + steps / starts[s][1] for s in range(len(starts))])


def _fineness(clip: CompiledClip, skeleton: Skeleton) -> int:
    """How many knots each sample needs so that the straight way between them is the clip's own, as seen on the body."""
    fineness = 1
    while fineness < _FINEST and _off_m(clip, skeleton, fineness) > _STRAIGHT_M:
        fineness *= 2
    return fineness


def _off_m(clip: CompiledClip, skeleton: Skeleton, fineness: int) -> float:
    """The largest distance of a joint from where it should be half way and a third of the way between two knots."""
    knots = _knot_times(clip, fineness)
    knots = knots[knots <= clip.frame_count - 1]
    if len(knots) < 2:
        return 0.0
    before, after = (sample(clip, clip.start_s + k / clip.rate_hz, loop=False) for k in (knots[:-1], knots[1:]))
    worst = 0.0
    for share in (1 / 3, 1 / 2):
        places = knots[:-1] + share * np.diff(knots)
        true = sample(clip, clip.start_s + places / clip.rate_hz, loop=False)
        turned = (1 - share) * before.rotations + share * after.rotations
        straight = Pose(true.translations, turned / np.linalg.norm(turned, axis=-1, keepdims=True), true.scales)
        off = (world(skeleton, straight) - world(skeleton, true))[..., :3, 3]
        worst = max(worst, float(np.sqrt(np.max(np.sum(off * off, axis=-1)))))
    return worst
