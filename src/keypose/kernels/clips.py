# pyright: basic
"""Clips in the form the sampling kernels read, and where each character is in them.

    rotations     float32 or int16 [frame][4][joint]   wxyz, one row per component, all joints side by side
    translations  float32 [frame][3][joint]            only groups of 16 joints in which a translation moves
    rest          float32 [3][joint]                   the translations that do not

All clips stand one after another. Joints are sorted by depth, so that the joints of one depth are neighbours: a single
character then walks its hierarchy a whole depth at a time (see `waves`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from keypose.errors import ShapeError
from keypose.kernels.runtime import WIDTH, aligned_copy

GROUP = 16  # joints are filled up to a multiple of this, whatever the vector width
INT16_SCALE = 32767.0
# Where `CompiledClips.handles` holds what: sizes, then addresses. Handing a kernel ten arrays takes longer than animating
# one character with it.
JOINTS, PADDED, MOVING, WAVES, FRAMES = range(5)
TRANSLATIONS, REST, MOVING_AT, ORDER, PARENTS, WAVE_TABLE, WAVE_PARENTS, ROTATIONS = range(5, 13)
_STILL = 1e-6  # metres; a translation that moves less stays at its mean


@dataclass(frozen=True, slots=True, eq=False)
class CompiledClips:
    """Clips of one skeleton, ready to be sampled; made by `compile_clips`.

    The arrays belong to the kernels: they are not to be replaced or written. (They are not marked read-only because
    Numba takes longer to accept such arrays.)
    """

    joint_count: int
    padded: int  # joints, filled up to a multiple of GROUP
    moving: int  # joints in `translations`, a multiple of GROUP
    starts: np.ndarray  # (clips + 1,) first frame of each clip, and the number of all frames
    rotations: np.ndarray
    translations: np.ndarray
    rest: np.ndarray
    moving_at: np.ndarray  # (padded / GROUP,) where a group's translations stand in a row, or -1
    order: np.ndarray  # (joints,) which joint of the skeleton stands at each place
    parents: np.ndarray  # (joints,) place of the parent of the joint at each place, or -1
    waves: np.ndarray  # [wave][first place, joints, first place that holds a parent or -1]
    wave_parents: np.ndarray  # int32 [wave][W] parents, counted from that place
    scale: float  # of the rotations' numbers
    handles: np.ndarray  # what the kernels need of all this, sizes and addresses

    @property
    def frame_count(self) -> int:
        """Frames of all clips."""
        return int(self.starts[-1])


@dataclass(frozen=True, slots=True, eq=False)
class Mix:
    """Where n characters are in their C clips.

    Shapes: frames (n, C, 2) int32, the frames before and after; shares (n, C, 2) float32, the fraction of the way
    between them and the weight of the clip. Frames count through all clips. Both may be written between two calls.
    """

    frames: np.ndarray
    shares: np.ndarray
    last: list[Any] = field(default_factory=lambda: [(None, None)], repr=False)  # what `animate_one` ran on last

    def __post_init__(self) -> None:
        frames = np.ascontiguousarray(self.frames, np.int32)
        shares = np.ascontiguousarray(self.shares, np.float32)
        if frames.ndim != 3 or frames.shape[2] != 2 or frames.shape[1] < 1 or frames.shape != shares.shape:
            raise ShapeError(f"mix: expected frames and shares (n, C, 2), got {frames.shape} and {shares.shape}")
        for name, array in (("frames", frames), ("shares", shares)):
            object.__setattr__(self, name, aligned_copy(array, array.dtype).reshape(array.shape))


def compile_clips(parents: Any, clips: Sequence[tuple[Any, Any]], quantized: bool = False) -> CompiledClips:
    """Clips of one skeleton in the kernels' form; ``quantized`` stores rotations as 16-bit integers (error 2e-5).

    Shapes and units: parents (J,), parents before children; each clip is rotations (F, J, 4) and translations
    (F, J, 3) or (J, 3), metres.
    """
    parents = np.asarray(parents, np.int64)
    joints = len(parents)
    if not joints or not clips or np.any(parents >= np.arange(joints)):
        raise ShapeError("clips: expected at least one clip, and joints whose parents come before them")
    turns, moves = zip(*(_checked(r, t, joints) for r, t in clips), strict=True)
    starts = np.cumsum([0, *(len(r) for r in turns)])
    order, above = _by_depth(parents)
    padded = -(-joints // GROUP) * GROUP
    rotations = np.zeros((starts[-1], 4, padded), np.float32)
    rotations[:, 0] = 1.0
    translations = np.zeros((starts[-1], 3, padded), np.float32)
    rotations[:, :, :joints] = np.concatenate([_sign_aligned(r) for r in turns])[:, order].transpose(0, 2, 1)
    translations[:, :, :joints] = np.concatenate(moves)[:, order].transpose(0, 2, 1)
    spread = np.ptp(translations, axis=0).max(axis=0).reshape(-1, GROUP).max(axis=1)
    groups = np.nonzero(spread > _STILL)[0]
    moving_at = np.full(padded // GROUP, -1, np.int64)
    moving_at[groups] = np.arange(len(groups)) * GROUP
    kept = translations.reshape(len(translations), 3, -1, GROUP)[:, :, groups]
    waves, wave_parents = _waves(above)
    if quantized:
        rotations = np.rint(rotations * INT16_SCALE).astype(np.int16)
    parts = {
        "translations": aligned_copy(kept),
        "rest": aligned_copy(translations.mean(axis=0, dtype=np.float64)),
        "moving_at": moving_at,
        "order": order,
        "parents": above,
        "waves": waves.reshape(-1),
        "wave_parents": aligned_copy(wave_parents, np.int32),
    }
    scale = INT16_SCALE if quantized else 1.0
    numbers = (joints, padded, len(groups) * GROUP, len(waves), int(starts[-1]))
    rotations = aligned_copy(rotations, rotations.dtype)
    handles = np.array([*numbers, *(part.ctypes.data for part in (*parts.values(), rotations))], np.int64)
    return CompiledClips(
        joint_count=joints, padded=padded, moving=len(groups) * GROUP, starts=starts, rotations=rotations, scale=scale,
        handles=handles, **parts,
    )  # fmt: skip


def mix(clips: CompiledClips, which: Any, places: Any, weights: Any) -> Mix:
    """The mix of characters that play clips ``which`` at frame ``places``; places beyond the ends stay at the ends.

    Shapes: which, places (in frames of that clip, fractional) and weights, (n, C) each.
    """
    which, places, weights = np.broadcast_arrays(which, np.asarray(places, np.float64), weights)
    if which.ndim != 2 or (which.size and not 0 <= which.min() <= which.max() < len(clips.starts) - 1):
        raise ShapeError(f"which: expected (n, C) numbers of the {len(clips.starts) - 1} clips")
    lengths = np.diff(clips.starts)[which]
    places = np.clip(places, 0, lengths - 1)
    whole = np.clip(np.floor(places).astype(np.int64), 0, np.maximum(lengths - 2, 0))
    after = np.minimum(whole + 1, lengths - 1)
    start = clips.starts[which]
    return Mix(np.stack([start + whole, start + after], axis=-1), np.stack([places - whole, weights], axis=-1))


def _checked(rotations: Any, translations: Any, joints: int) -> tuple[np.ndarray, np.ndarray]:
    rotations, translations = np.asarray(rotations, np.float32), np.asarray(translations, np.float32)
    frames = len(rotations)
    if rotations.shape != (frames, joints, 4) or not frames:
        raise ShapeError(f"rotations: expected (F, {joints}, 4) with at least one frame, got {rotations.shape}")
    if translations.shape not in ((joints, 3), (frames, joints, 3)):
        raise ShapeError(f"translations: expected ({frames}, {joints}, 3) or ({joints}, 3), got {translations.shape}")
    return rotations, np.broadcast_to(translations, (frames, joints, 3))


def _sign_aligned(rotations: np.ndarray) -> np.ndarray:
    """q and -q are one rotation: never more than a quarter turn of quaternion space from the frame before."""
    flips = (rotations[1:] * rotations[:-1]).sum(axis=-1, keepdims=True) < 0
    signs = np.where(np.cumsum(flips, axis=0) % 2, -1, 1).astype(np.float32)
    return np.concatenate([rotations[:1], rotations[1:] * signs])


def _by_depth(parents: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Joints sorted by depth, those of one depth by the place of their parents; and the parents' places."""
    depths = np.zeros(len(parents), np.int64)
    for joint, parent in enumerate(parents):
        depths[joint] = depths[parent] + 1 if parent >= 0 else 0
    place = np.full(len(parents) + 1, -1, np.int64)  # the last entry answers for the roots' parent -1
    order: list[int] = []
    for depth in range(int(depths.max()) + 1):
        level = np.nonzero(depths == depth)[0]
        # Joints with children first among brothers keeps the parents of the next depth close together.
        leaf = ~np.isin(level, parents)
        for joint in level[np.lexsort((level, place[parents[level]], leaf))].tolist():
            place[joint] = len(order)
            order.append(joint)
    ordered = np.array(order, np.int64)
    return ordered, place[parents[ordered]]


def _waves(parents: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Runs of at most W neighbours of one depth whose parents lie within W places of each other."""
    waves: list[list[int]] = []
    lanes: list[np.ndarray] = []
    depths = np.zeros(len(parents), np.int64)
    for place, parent in enumerate(parents):
        depths[place] = depths[parent] + 1 if parent >= 0 else 0
    level_start = np.searchsorted(depths, depths)
    at = 0
    while at < len(parents):
        end = at + 1
        base = int(parents[at])
        if base >= 0:
            level = int(level_start[base])
            # From the start of its depth, if it reaches: reading what was just written as a whole is quicker.
            base = level if base - level < WIDTH else base
        while (
            end < len(parents)
            and end - at < WIDTH
            and depths[end] == depths[at]
            and (base < 0 or base <= parents[end] < base + WIDTH)
        ):
            end += 1
        lane = np.zeros(WIDTH, np.int32)
        lane[: end - at] = parents[at:end] - base if base >= 0 else 0
        waves.append([at, end - at, base])
        lanes.append(lane)
        at = end
    return np.array(waves, np.int64), np.array(lanes, np.int32)
