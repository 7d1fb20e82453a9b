"""The encoder of compiled clips: which numbers move, how finely each is stored, and proof that the body stays in place."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from keypose.arrays import Array
from keypose.model import Skeleton
from keypose.play import store
from keypose.play.plan import Rig, exactness, mixed_rotations, on_one_side, plan
from keypose.play.proof import CHECKS_PER_FRAME, Budget, Frames, Measured, check_times, decode_frames, measure
from keypose.play.store import FRAMES, Packed, cosines

_GOAL = 0.97  # share of the tolerance that frames aim at
_STRAIGHT = 0.8  # and that the straight way between exact frames may take
_BENT_SHARES = (0.99, 1.0)  # of all frames, that are looked at to choose between three and four numbers
_LOWEST_SCALE, _LUCKY = -100, 4
_PROFILES = 255
_TUNED_SEGMENTS, _TUNING = 10, (1.0, 0.5, 0.5)
_CODED_SHARE = 0.85  # of the coefficients take bits; what a finer step costs
_REPAIRS = 10
_CHUNK = 2048  # poses compared at a time


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
    plans = [plan(parents, frames, closed, budget, share) for share in _BENT_SHARES]
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
    sample_of = np.minimum(np.arange(len(times)) // CHECKS_PER_FRAME, len(real) - 1)
    segment_of, following = sample_of // FRAMES, np.minimum(sample_of + 1, len(real) - 1) // FRAMES
    ratio, error, joint = np.zeros(len(times)), np.zeros(len(times)), np.zeros(len(times), np.int64)
    pending = np.arange(len(times))
    packed = coder.packed()
    for attempt in range(_REPAIRS + 1):
        decoder = store.decoder(packed)
        for start in range(0, len(pending), _CHUNK):
            some = pending[start : start + _CHUNK]
            ratio[some], error[some], joint[some] = measure(
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


def _fine_times(times_s: Array, slots: list[list[int]]) -> Array:
    """Times of all samples of all segments, (16 each); after the end the last one again."""
    starts, levels = store.segment_starts(slots)
    positions = starts[:, None] + np.arange(FRAMES) / (1 << levels)[:, None]
    return np.interp(positions.ravel(), np.arange(len(times_s)), times_s)


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
            mixed_rotations(rig, a[0], b[0], share), *(x + share * (y - x) for x, y in zip(a[1:], b[1:], strict=True))
        )
        ratio, _, _ = measure(skeleton, mixed, truth(middle.ravel()), budget)
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
        self.frames, self.rig, self.steps = frames._replace(rotations=on_one_side(rig, frames.rotations)), rig, steps
        self.constants = exactness(self.rig, self.frames, parents, budget)
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
