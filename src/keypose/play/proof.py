"""What a compiled clip may be off by, and measuring by how much it is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from keypose.arrays import Array
from keypose.model import Skeleton
from keypose.play.store import Decoder, Packed

CHECKS_PER_FRAME = 4


class Frames(NamedTuple):
    """Local transforms (F, J, ...) and morph weights (F, M), float64."""

    rotations: Array
    translations: Array
    scales: Array
    weights: Array


@dataclass(frozen=True, slots=True)
class Budget:
    """What the compiled clip may be off by."""

    tolerances_m: Array  # (J,)
    shell_m: float
    weight_tolerance: float


class Measured(NamedTuple):
    """The largest error of all times that were looked at, relative to what is allowed."""

    ratio: float
    error_m: float
    joint: int  # -1 where a morph weight is worst
    time_s: float


def measure(skeleton: Skeleton, decoded: Frames, true: Frames, budget: Budget) -> tuple[Array, Array, Array]:
    """Per pose the error relative to the budget, in metres, and the joint where it is (-1: a morph weight)."""
    off_m, off_weights = errors(skeleton, decoded, true, budget)
    relative = off_m / budget.tolerances_m
    rows = np.arange(len(off_m))
    joint = np.argmax(relative, axis=1)
    ratio, error = relative[rows, joint], off_m[rows, joint]
    if off_weights.shape[1]:
        worst = np.max(off_weights, axis=1) / budget.weight_tolerance
        joint = np.where(worst > ratio, -1, joint)
        ratio = np.maximum(ratio, worst)
    return ratio, error, joint


def check_times(times_s: Array) -> Array:
    """All frames and three times between each two."""
    inner = (times_s[:-1, None] + np.diff(times_s)[:, None] * np.arange(CHECKS_PER_FRAME) / CHECKS_PER_FRAME).ravel()
    return np.append(inner, times_s[-1])


def errors(skeleton: Skeleton, decoded: Frames, true: Frames, budget: Budget) -> tuple[Array, Array]:
    """Errors on the body (F, J) in metres and of morph weights (F, M)."""
    from keypose.kernels.encode import model_matrices, shell_errors

    parents = np.asarray(skeleton.parents, np.int64)
    count, joints = true.rotations.shape[:2]
    both: list[Array] = []
    for frames in (decoded, true):
        out = np.empty((count, joints, 12))
        model_matrices(
            parents, *(np.ascontiguousarray(a, np.float64) for a in frames[:3]), np.empty((count, joints, 4)), out
        )
        both.append(out)
    distances = np.empty((count, joints))
    shell_errors(*both, budget.shell_m, distances)
    return distances, np.abs(decoded.weights - true.weights)


def decode_frames(packed: Packed, decoder: Decoder, times_s: Array, loop: bool) -> Frames:
    """Poses at times, float32, by the kernel."""
    from keypose.kernels.decode import decode_to
    from keypose.kernels.runtime import aligned

    count, joints, morphs = len(times_s), len(packed.kinds), len(packed.morphs)
    out = Frames(
        np.empty((count, joints, 4), np.float32), np.empty((count, joints, 3), np.float32),
        np.empty((count, joints, 3), np.float32), np.empty((count, morphs), np.float32),
    )  # fmt: skip
    decode_to(
        decoder.layout, decoder.tables, decoder.book, decoder.codes, float(packed.info["start_s"]),
        float(packed.info["rate_hz"]), loop, np.ascontiguousarray(times_s, np.float64), aligned(decoder.room), aligned(decoder.stride), *out,
    )  # fmt: skip
    return out
