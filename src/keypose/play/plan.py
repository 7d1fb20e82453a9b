"""What of a clip is coded: which numbers move, around which mean and axes, and with which steps to start."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from keypose.arrays import Array
from keypose.math import quat
from keypose.play import store
from keypose.play.proof import Budget, Frames
from keypose.play.store import CONSTANT, EXACT, FOUR, IDENTITY, THREE

# What a number may move, as a share of the tolerance, and still count as constant.
_STILL = 0.02
# A rotation is stored as x, y, z / (1 + w) around its mean where w never gets smaller than this,
_LEAST_W = 0.1
# and where its straight way between frames bends by less than this share of the tolerance.
_BEND = 0.3


class Rig(NamedTuple):
    """What the kernels know of a clip; see `keypose.kernels.encode.encode_segment`."""

    parents: Array
    kinds: Array
    before: Array
    after: Array
    base: Array
    rotation_tracks: Array
    other_tracks: Array
    child_starts: Array
    children: Array
    weight_tracks: Array


def plan(parents: Array, frames: Frames, closed: bool, budget: Budget, share: float) -> tuple[Rig, Array]:
    """Which numbers move, what they move around, and steps to start from (powers of 2 ** (1 / 4))."""
    _, translations, scales, weights = frames
    rotations = quat.align_signs(frames.rotations, axis=0)
    joints = len(parents)
    reach, bone = _reaches(parents, translations, scales, budget.shell_m)
    tolerance = budget.tolerances_m
    strictest = tolerance.copy()  # of a joint and all below it
    for j in range(joints - 1, -1, -1):
        if parents[j] >= 0:
            strictest[parents[j]] = min(strictest[parents[j]], strictest[j])
    kinds = np.zeros(joints, np.int64)
    before, after = np.tile([1.0, 0, 0, 0], (joints, 1)), np.tile([1.0, 0, 0, 0], (joints, 1))
    base = np.concatenate([translations[0], scales[0]], axis=1)
    rotation_tracks, other_tracks = np.full((joints, 4), -1, np.int64), np.full((joints, 6), -1, np.int64)
    steps: list[float] = []

    def track(step: float) -> int:
        steps.append(step)
        return len(steps) - 1

    for j in range(joints):
        for k in range(6):
            values = translations[:, j, k] if k < 3 else scales[:, j, k - 3]
            size = 1.0 if k < 3 else reach[j]
            if np.ptp(values) * size > _STILL * strictest[j]:
                other_tracks[j, k] = track(0.25 * strictest[j] / size)
                base[j, k] = (np.max(values) + np.min(values)) / 2 if k < 3 else base[j, k]
            elif values[0] != 0:
                base[j, k] = (np.max(values) + np.min(values)) / 2
        mean = _mean_rotation(rotations[:, j])
        coded = quat.multiply(quat.conjugate(mean), rotations[:, j])
        if coded[0, 0] < 0:
            rotations[:, j], coded = -rotations[:, j], -coded
        if np.max(np.linalg.norm(coded[:, 1:], axis=1)) * 2 * reach[j] < _STILL * strictest[j]:
            same = np.all(rotations[:, j] == rotations[0, j])
            before[j] = rotations[0, j] if same else mean
            continue
        axes = _main_axes(coded[:, 1:])
        # As the file stores them, so that the encoder sees what the decoder will.
        after[j] = _stored(quat.conjugate(axes))
        before[j] = _stored(quat.multiply(mean, quat.conjugate(after[j])))
        coded = quat.multiply(quat.multiply(quat.conjugate(before[j]), rotations[:, j]), quat.conjugate(after[j]))
        if coded[0, 0] < 0:  # what is stored has lost its sign
            rotations[:, j], coded = -rotations[:, j], -coded
        # An error e in x, y, z turns by 2 e; closed loop, only the next joints feel it.
        step = 0.2 * strictest[j] / (2 * (bone[j] if closed else reach[j]))
        swing = float(np.max(np.linalg.norm(coded[:, 1:], axis=1)))
        if np.min(coded[:, 0]) < _LEAST_W or _bend(coded, share) * 2 * reach[j] > _BEND * strictest[j]:
            kinds[j] = FOUR  # an error of w turns by less, as far as w is near one
            rotation_tracks[j] = [track(step / np.clip(swing, 1 / 16, 1)), *(track(step) for _ in range(3))]
            continue
        kinds[j] = THREE
        for k in range(1, 4):
            if np.max(np.abs(coded[:, k])) * 2 * reach[j] > _STILL * strictest[j]:
                rotation_tracks[j, k] = track(step / 2)
        if np.all(rotation_tracks[j] < 0):
            rotation_tracks[j, 1] = track(step / 2)
    weight_tracks = np.full(weights.shape[1], -1, np.int64)
    for m in range(weights.shape[1]):
        if np.ptp(weights[:, m]) > _STILL * budget.weight_tolerance:
            weight_tracks[m] = track(0.5 * budget.weight_tolerance)
    base = base.astype(np.float32).astype(np.float64)
    starts = np.concatenate([[0], np.cumsum(np.bincount(parents[parents >= 0], minlength=joints))]).astype(np.int64)
    children = np.append(np.argsort(np.where(parents < 0, joints, parents), kind="stable"), 0).astype(np.int64)
    rig = Rig(parents, kinds, before, after, base, rotation_tracks, other_tracks, starts, children, weight_tracks)
    rounded = 2.0 ** (np.rint(np.log2(np.array(steps, np.float64)) * 4) / 4)
    # Tracks are stored by row, then by joint.
    order = np.concatenate([rotation_tracks.T.ravel(), other_tracks.T.ravel(), weight_tracks])
    order = order[order >= 0]
    number = np.full(len(order) + 1, -1, np.int64)
    number[order] = np.arange(len(order))
    for table in (rotation_tracks, other_tracks, weight_tracks):
        table[...] = number[table]
    rounded = rounded[order]
    return rig, rounded


def on_one_side(rig: Rig, rotations: Array) -> Array:
    """The rotations (F, J, 4) with the signs that make what is coded continuous."""
    aligned = quat.align_signs(rotations, axis=0)
    first = quat.multiply(quat.multiply(quat.conjugate(rig.before), aligned[0]), quat.conjugate(rig.after))
    return aligned * np.where(first[:, :1] < 0, -1.0, 1.0)


def _reaches(parents: Array, translations: Array, scales: Array, shell_m: float) -> tuple[Array, Array]:
    """How far from each joint (J,) the body reaches that it turns, and its nearest joints do."""
    size = np.max(np.abs(scales), axis=(0, 2))
    length = np.max(np.linalg.norm(translations, axis=2), axis=0)
    above = np.ones(len(parents))
    for j, p in enumerate(parents.tolist()):
        above[j] = above[p] * size[p] if p >= 0 else 1.0
    reach, bone = shell_m * above * size, shell_m * above * size
    length = length * above
    for j in range(len(parents) - 1, -1, -1):
        p = parents[j]
        if p >= 0:
            reach[p] = max(reach[p], length[j] + reach[j])
            bone[p] = max(bone[p], length[j])
    return np.maximum(reach, 1e-12), np.maximum(bone, 1e-12)


def _mean_rotation(q: Array) -> Array:
    """Source: Markley, Cheng, Crassidis & Oshman 2007, equation 12."""
    values, vectors = np.linalg.eigh(q.T @ q)
    mean = vectors[:, np.argmax(values)]
    return mean if mean @ q[0] >= 0 else -mean


def _bend(coded: Array, share: float) -> float:
    """By how much, as half an angle, the middle of x, y, z / (1 + w) between two rotations (F, 4) is off theirs, in a share
    of all frames.
    """
    short = coded[:, 1:] / (1 + coded[:, :1])
    middle = (short[1:] + short[:-1]) / 2
    square = np.sum(middle**2, axis=1, keepdims=True)
    found = np.concatenate([1 - square, 2 * middle], axis=1) / (1 + square)
    true = coded[1:] + coded[:-1]
    true /= np.linalg.norm(true, axis=1, keepdims=True)
    return float(np.quantile(np.linalg.norm(found - true, axis=1), share))


def _main_axes(vectors: Array) -> Array:
    """A rotation (4,) whose x, y, z axes are the directions in which vectors (F, 3) vary most, second and least."""
    _, axes = np.linalg.eigh(np.cov(vectors.T))
    axes = axes[:, ::-1]
    for k in range(3):  # eigenvectors have no sign; choose one
        axes[:, k] *= 1.0 if axes[np.argmax(np.abs(axes[:, k])), k] > 0 else -1.0
    if np.linalg.det(axes) < 0:
        axes[:, 2] = -axes[:, 2]
    return quat.from_matrix(np.ascontiguousarray(axes))


def _stored(q: Array) -> Array:
    return store.unpack_quaternions(store.pack_quaternions(q[None]))[0]


def exactness(rig: Rig, frames: Frames, parents: Array, budget: Budget) -> Array:
    """The stored kind of each joint's rotation (J,); constant ones are rounded in place to what is stored."""
    kinds = rig.kinds.astype(np.uint8)
    reach, _ = _reaches(parents, frames.translations, frames.scales, budget.shell_m)
    for j in np.nonzero(rig.kinds == 0)[0].tolist():
        q = rig.before[j]
        if np.all(q == [1, 0, 0, 0]):
            kinds[j] = IDENTITY
            continue
        short = _stored(q)
        error = 2 * np.linalg.norm(quat.multiply(quat.conjugate(q), short)[1:]) * reach[j]
        if error < _STILL * np.min(budget.tolerances_m):
            kinds[j], rig.before[j] = CONSTANT, short
        else:
            kinds[j], rig.before[j] = EXACT, q.astype(np.float32)
    return kinds


def mixed_rotations(rig: Rig, a: Array, b: Array, share: float) -> Array:
    """Rotations (F, J, 4) as the decoder mixes exact frames."""
    mixed = quat.nlerp(a, b, np.full(a.shape[:-1], share))
    three = np.nonzero(rig.kinds == THREE)[0]
    before, after = quat.conjugate(rig.before[three]), quat.conjugate(rig.after[three])
    short: list[Array] = []
    for q in (a, b):
        coded = quat.multiply(quat.multiply(before, q[:, three]), after)
        coded = coded * np.where(coded[..., :1] < 0, -1.0, 1.0)
        short.append(coded[..., 1:] / (1 + coded[..., :1]))
    middle = short[0] + share * (short[1] - short[0])
    square = np.sum(middle**2, axis=-1, keepdims=True)
    coded = np.concatenate([1 - square, 2 * middle], axis=-1) / (1 + square)
    mixed[:, three] = quat.multiply(quat.multiply(rig.before[three], coded), rig.after[three])
    return mixed
