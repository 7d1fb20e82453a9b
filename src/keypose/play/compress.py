"""The encoder of compiled clips: which numbers move, how finely each is stored, and proof that the body stays in place."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from keypose.arrays import Array
from keypose.math import quat
from keypose.model import Skeleton
from keypose.play import store
from keypose.play.store import CONSTANT, EXACT, FOUR, FRAMES, IDENTITY, THREE, Packed, cosines

# Shares of the tolerance: what a number may move and still count as constant, and what frames aim at.
_STILL = 0.02
_GOAL = 0.97
_STRAIGHT = 0.8
# A rotation is stored as x, y, z / (1 + w) around its mean where w never gets smaller than this,
_LEAST_W = 0.1
# and where its straight way between frames bends by less than this share of the tolerance.
_BEND = 0.3
_BENT_SHARES = (0.99, 1.0)  # of all frames, that are looked at for it
_LOWEST_SCALE, _LUCKY = -100, 4
_PROFILES = 255
_TUNED_SEGMENTS, _TUNING = 10, (1.0, 0.5, 0.5)
_CODED_SHARE = 0.85  # of the coefficients take bits; what a finer step costs
_CHECKS_PER_FRAME = 4
_REPAIRS = 10
_CHUNK = 2048  # poses compared at a time


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


def encode(
    skeleton: Skeleton, truth: Callable[[Array], Frames], times_s: Array, info: dict[str, Any], budget: Budget
) -> tuple[Packed, Measured]:
    """The frames at ``times_s`` (F,) as a packed clip, and its error against ``truth`` between them too.

    Source: N. Frechette, "Animation Compression Library" (2017), for object-space error at virtual vertices; the cosine
    transform is Ahmed, Natarajan & Rao 1974.
    """
    frames = truth(times_s)
    closed = bool(np.all(np.abs(frames.scales - 1) < 1e-9))
    parents = np.asarray(skeleton.parents, np.int64)
    # A jump between two frames wants either finer slots or more joints with four numbers: take what codes fewer tracks.
    plans = [_plan(parents, frames, closed, budget, share) for share in _BENT_SHARES]
    refined = [_slots(skeleton, rig, truth, times_s, budget) for rig, _ in plans]
    sizes = [sum(map(len, slots)) * len(steps) for slots, (_, steps) in zip(refined, plans, strict=True)]
    best = int(np.argmin(sizes))
    (rig, steps), slots = plans[best], refined[best]
    info["refined"] = [[s, levels] for s, levels in enumerate(slots) if len(levels) > 1]
    fine = _fine_times(times_s, slots)
    coder = _Coder(skeleton, rig, steps, truth(fine), closed, info, budget)
    coder.compress()
    real = fine[: int(np.argmax(fine >= times_s[-1])) + 1]
    times = check_times(real)
    sample_of = np.minimum(np.arange(len(times)) // _CHECKS_PER_FRAME, len(real) - 1)
    segment_of, following = sample_of // FRAMES, np.minimum(sample_of + 1, len(real) - 1) // FRAMES
    ratio, error, joint = np.zeros(len(times)), np.zeros(len(times)), np.zeros(len(times), np.int64)
    pending = np.arange(len(times))
    packed = coder.packed()
    for attempt in range(_REPAIRS + 1):
        decoder = store.decoder(packed)
        for start in range(0, len(pending), _CHUNK):
            some = pending[start : start + _CHUNK]
            ratio[some], error[some], joint[some] = _measure(
                skeleton, decode_frames(packed, decoder, times[some], False), truth(times[some]), budget
            )
        bad = ratio > 1.0
        segments = np.unique(np.concatenate([segment_of[bad], following[bad]]))
        if attempt == _REPAIRS or not len(segments) or not coder.repair(segments):
            break
        packed = coder.packed()
        pending = np.nonzero(np.isin(segment_of, segments) | np.isin(following, segments))[0]
    worst = int(np.argmax(ratio))
    return packed, Measured(float(ratio[worst]), float(np.max(error)), int(joint[worst]), float(times[worst]))


def _measure(skeleton: Skeleton, decoded: Frames, true: Frames, budget: Budget) -> tuple[Array, Array, Array]:
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


def _fine_times(times_s: Array, slots: list[list[int]]) -> Array:
    """Times of all samples of all segments, (16 each); after the end the last one again."""
    starts, levels = store.segment_starts(slots)
    positions = starts[:, None] + np.arange(FRAMES) / (1 << levels)[:, None]
    return np.interp(positions.ravel(), np.arange(len(times_s)), times_s)


def _mixed_rotations(rig: Rig, a: Array, b: Array, share: float) -> Array:
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


def _slots(
    skeleton: Skeleton, rig: Rig, truth: Callable[[Array], Frames], times_s: Array, budget: Budget
) -> list[list[int]]:
    """How each slot of 16 frames has to be halved for straight ways to stay near the source: the levels of its parts."""
    count = -(-len(times_s) // FRAMES)
    found: list[tuple[float, int]] = []
    pending = np.arange(count) * float(FRAMES)
    for level in range(store.FINEST + 1):
        if level == store.FINEST:
            found += [(start, level) for start in pending.tolist()]
            break
        bent: list[float] = []
        for first in range(0, len(pending), _CHUNK // FRAMES):
            some = pending[first : first + _CHUNK // FRAMES]
            positions = some[:, None] + np.arange(FRAMES + 1) / (1 << level)
            missed = _missed(skeleton, rig, truth, np.interp(positions, np.arange(len(times_s)), times_s), budget)
            found += [(start, level) for start in some[missed <= _STRAIGHT].tolist()]
            bent += some[missed > _STRAIGHT].tolist()
        half = FRAMES / (2 << level)
        pending = np.array([start + k for start in bent for k in (0.0, half)])
        if not bent:
            break
    slots: list[list[int]] = [[] for _ in range(count)]
    for start, level in sorted(found):
        slots[int(start) // FRAMES].append(level)
    return slots


def _missed(skeleton: Skeleton, rig: Rig, truth: Callable[[Array], Frames], times: Array, budget: Budget) -> Array:
    """How far, in budgets, the straight ways between samples at times (S, N) miss the source, (S,)."""
    exact = truth(times.ravel())
    worst = np.zeros(len(times))
    for share in (0.25, 0.5, 0.75):
        middle = times[:, :-1] + share * np.diff(times, axis=1)
        split = [f.reshape(*times.shape, *f.shape[1:]) for f in exact]
        a = [f[:, :-1].reshape(middle.size, *f.shape[2:]) for f in split]
        b = [f[:, 1:].reshape(middle.size, *f.shape[2:]) for f in split]
        mixed = Frames(
            _mixed_rotations(rig, a[0], b[0], share), *(x + share * (y - x) for x, y in zip(a[1:], b[1:], strict=True))
        )
        ratio, _, _ = _measure(skeleton, mixed, truth(middle.ravel()), budget)
        worst = np.maximum(worst, ratio.reshape(len(times), -1).max(axis=1))
    return worst


class _Coder:
    """One clip while it is being encoded."""

    def __init__(
        self,
        skeleton: Skeleton,
        rig: Rig,
        steps: Array,
        frames: Frames,
        closed: bool,
        info: dict[str, Any],
        budget: Budget,
    ) -> None:
        from keypose.kernels.encode import model_matrices

        self.info, self.budget, self.closed = info, budget, closed
        count, joints = frames.rotations.shape[:2]
        self.segments = count // FRAMES
        parents = rig.parents
        self.frames, self.rig, self.steps = frames._replace(rotations=_on_one_side(rig, frames.rotations)), rig, steps
        self.constants = _exactness(self.rig, self.frames, parents, budget)
        world = np.empty_like(self.frames.rotations)
        matrices = np.empty((self.segments * FRAMES, joints, 12))
        model_matrices(parents, *self.frames[:3], world, matrices)
        self.world, self.matrices = world, matrices
        tracks = len(self.steps)
        self.limits = (budget.tolerances_m, budget.weight_tolerance, budget.shell_m)
        self.basis = np.ascontiguousarray(cosines())
        self.codes = np.zeros((self.segments, tracks, FRAMES), np.int64)
        self.needed = np.zeros((self.segments, tracks, FRAMES), np.int64)
        self.chosen = np.zeros((self.segments, tracks), np.int64)
        self.scales = np.zeros(self.segments, np.int64)
        self.joint_ratio = np.zeros(joints)
        self.book = np.zeros((0, FRAMES), np.int64)

    def compress(self) -> None:
        if not len(self.steps):
            self.segments = 0
            return
        self._tune()
        self._search_all()
        for _ in range(2):
            self.book = _book(self.needed.reshape(-1, FRAMES))
            self._search_all()

    def packed(self) -> Packed:
        """What is stored, as of now."""
        rig, joints, tracks = self.rig, len(self.rig.kinds), len(self.steps)
        moving = np.zeros(joints, np.uint16)
        for row, column in ((0, rig.rotation_tracks), (4, rig.other_tracks)):
            for k in range(column.shape[1]):
                moving |= np.where(column[:, k] >= 0, 1 << (row + k), 0).astype(np.uint16)
        book = self.book.astype(np.uint8)
        codes = b"".join(
            store.pack_codes(self.chosen[s], self.codes[s], book) for s in range(self.segments if tracks else 0)
        )
        return Packed(
            self.info, self.constants, moving, rig.before, rig.after,
            rig.base[:, :3].astype(np.float32), rig.base[:, 3:].astype(np.float32),
            np.where(rig.weight_tracks >= 0, 0.0, self.frames.weights[0]).astype(np.float32), rig.weight_tracks >= 0,
            np.rint(np.log2(self.steps) * 4).astype(np.int16), book,
            self.scales[: self.segments].astype(np.int8) if tracks else np.zeros(0, np.int8), codes,
        )  # fmt: skip

    def repair(self, segments: Array) -> bool:
        """Encode some segments more finely; False where none can be."""
        from keypose.kernels.encode import SCALE_STEPS, encode_segment

        better = False
        if not len(self.steps):
            return False
        for s in segments.tolist():
            n = int(self.scales[s]) - 2
            while n >= _LOWEST_SCALE:
                ratio, _ = encode_segment(
                    self.rig, self._truth(s), self.steps, 2.0 ** (n / SCALE_STEPS), self._coding(), self.limits, self.closed,
                    self._out(s),
                )  # fmt: skip
                if np.isfinite(ratio):
                    self.scales[s], better = n, True
                    break
                # no profile is wide enough: add one that is
                if not self._widen():
                    self._again(s)
                    break
            else:
                self._again(s)
        return better

    def _again(self, s: int) -> None:
        """Put back the codes of the segment as they were before an attempt that failed."""
        from keypose.kernels.encode import SCALE_STEPS, encode_segment

        encode_segment(
            self.rig, self._truth(s), self.steps, 2.0 ** (self.scales[s] / SCALE_STEPS), self._coding(), self.limits,
            self.closed, self._out(s),
        )  # fmt: skip

    def _widen(self) -> bool:
        """Add a profile two bits wider than the widest; codes stay valid because it comes last."""
        widest = self.book[-1]
        if len(self.book) >= _PROFILES or np.all(widest >= store.MAX_BITS):
            return False
        self.book = np.vstack([self.book, np.minimum(widest + 2, store.MAX_BITS)])
        return True

    def _truth(self, s: int) -> tuple[Array, ...]:
        at = slice(s * FRAMES, (s + 1) * FRAMES)
        f = self.frames
        return (f.rotations[at], f.translations[at], f.scales[at], self.world[at], self.matrices[at], f.weights[at])

    def _coding(self) -> tuple[Array, Array, Array]:
        return self.basis, self.book, store.profile_bytes(self.book) * 8

    def _out(self, s: int) -> tuple[Array, ...]:
        return self.codes[s], self.needed[s], self.chosen[s], self.joint_ratio

    def _search_all(self) -> None:
        from keypose.kernels.encode import search_scale

        coding = self._coding()
        hint = int(self.scales[0])
        for s in range(self.segments):
            hint, _, _ = search_scale(
                self.rig, self._truth(s), self.steps, hint, _LOWEST_SCALE, coding, self.limits, self.closed, _GOAL, _LUCKY,
                self._out(s),
            )  # fmt: skip
            self.scales[s] = hint

    def _tune(self) -> None:
        """Find how fine each joint's steps should be, on some segments, by trying one joint after the other."""
        from keypose.kernels.encode import encode_segment

        rig, coding = self.rig, self._coding()
        groups = [
            [t for t in row if t >= 0] for table in (rig.rotation_tracks, rig.other_tracks) for row in table.tolist()
        ]
        groups = [g for g in [*groups, *([t] for t in rig.weight_tracks.tolist() if t >= 0)] if g]
        chosen = np.unique(np.linspace(0, self.segments - 1, _TUNED_SEGMENTS).astype(int)).tolist()
        out = (self.codes[0].copy(), self.needed[0].copy(), self.chosen[0].copy(), self.joint_ratio)
        truths = [self._truth(s) for s in chosen]
        price = len(self.steps) * FRAMES * _CODED_SHARE

        def cost(steps: Array) -> float:
            """Bits, were all steps made finer by as much as the error is too great."""
            total = 0.0
            for truth in truths:
                ratio, bits = encode_segment(rig, truth, steps, 1.0, coding, self.limits, self.closed, out)
                total += bits + price * np.log2(max(ratio, 1e-3) / _GOAL)
            return total

        best = cost(self.steps)
        for octaves in _TUNING:
            for group in groups:
                for direction in (octaves, -octaves):
                    improved = False
                    while True:
                        steps = self.steps.copy()
                        steps[group] *= 2.0**direction
                        now = cost(steps)
                        if not now < best:
                            break
                        self.steps, best, improved = steps, now, True
                    if improved:
                        break


def _plan(parents: Array, frames: Frames, closed: bool, budget: Budget, share: float) -> tuple[Rig, Array]:
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


def _on_one_side(rig: Rig, rotations: Array) -> Array:
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


def _exactness(rig: Rig, frames: Frames, parents: Array, budget: Budget) -> Array:
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


def _book(needed: Array) -> Array:
    """Bit profiles (P, 16), sorted by size, that hold all of ``needed`` (N, 16) with few bits."""
    from keypose.kernels.encode import cheapest_profiles, merge_profiles

    unique, counts = np.unique(needed, axis=0, return_counts=True)
    most_considered = 1200
    order = np.argsort(-counts, kind="stable")
    if len(unique) > most_considered:  # all the frequent ones, and every so many of the others
        half = most_considered // 2
        order = np.concatenate([order[:half], order[half :: -(-(len(order) - half) // half)]])
    widest = np.minimum(np.max(unique, axis=0) + 2, store.MAX_BITS)[None]
    considered = np.concatenate([unique[order], widest])
    weights = np.append(counts[order] * (len(needed) / counts[order].sum()), 1e-3)
    considered = np.ascontiguousarray(considered, np.int64)
    profiles = considered[merge_profiles(considered, weights, _PROFILES - 2, 90.0)]
    choice = np.empty(len(needed), np.int64)
    for last in (False, False, False, False, True):
        profiles = np.unique(np.concatenate([profiles, widest]), axis=0)
        sizes = store.profile_bytes(profiles)
        profiles = profiles[np.lexsort((profiles.sum(axis=1), sizes))]
        if last:
            break
        cheapest_profiles(needed, profiles, store.profile_bytes(profiles), choice)
        profiles = np.stack([needed[choice == p].max(axis=0) for p in np.unique(choice).tolist()])
    return profiles


# --- proof -----------------------------------------------------------------------------------------------------------------


def check_times(times_s: Array) -> Array:
    """All frames and three times between each two."""
    inner = (times_s[:-1, None] + np.diff(times_s)[:, None] * np.arange(_CHECKS_PER_FRAME) / _CHECKS_PER_FRAME).ravel()
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


def decode_frames(packed: Packed, decoder: store.Decoder, times_s: Array, loop: bool) -> Frames:
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
