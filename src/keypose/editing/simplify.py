"""Fewer keys, to a tolerance that is measured in metres on the body."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from keypose.arrays import Array
from keypose.errors import ShapeError
from keypose.evaluate import key_rate, match, sample_clip, sample_morphs, sample_motion, world
from keypose.math import quat
from keypose.model import Channel, Character, Clip, Curve, CurveKind, Interpolation, Motion, Property, Skeleton

_FIRST_SHARE = 0.15  # of the tolerance that a joint may take at first
_SOFTENED, _MOST_ROUNDS = 10, 80
_NEAR_FRAMES = 9  # an error is put right by the keys around it
_LONGEST = 120  # frames between two keys
_STILL = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class SimplifyResult:
    """A clip with fewer keys.

    ``error_m`` is the largest distance, at any frame, of any point of the body from where the animation puts it;
    ``morph_error`` likewise of a weight. ``holds`` says whether both are within what was asked. Keys are counted in all channels
    that move; of others one is kept, on both sides of the comparison.
    """

    clip: Clip
    error_m: float
    keys_before: int
    keys_after: int
    holds: bool
    morph_error: float = 0.0


def simplify(
    animation: Clip | Motion,
    body: Skeleton | Character,
    tolerance_m: float = 1e-3,
    *,
    morph_tolerance: float = 1e-3,
    shell_m: float = 0.03,
    rate_hz: float | None = None,
) -> SimplifyResult:
    """An animation with as few Hermite keys as keep every point of the body within a tolerance at every frame.

    The points are those ``shell_m`` off each joint along its axes; of a `Character` with skins also all their vertices, which
    are measured at the end (and the tolerance of the joints is lowered until they hold). ``rate_hz`` is that of the frames (the
    motion's own, the rate of the clip's keys, else 60). Keys lie on frames; rotations become quaternions. Each curve gets the
    keys of least cost, a key against the weighted squares of what is missed; joints are fitted from the root outwards, each in
    the frame that its simplified parent left, so that turns do not add up; then weights rise where points stray and fall
    elsewhere until every frame is within the tolerance.

    Raises: ShapeError where a tolerance or the rate is not positive, or the animation is empty.
    Source: optimal knots by shortest paths (Bellman 1961; here with cubics of least squares); error on the body as in N. Frechette,
    "Animation Compression Library" (2017).
    """
    for name, value in (("tolerance_m", tolerance_m), ("morph_tolerance", morph_tolerance), ("shell_m", shell_m)):
        if not (np.isfinite(value) and value > 0):
            raise ShapeError(f"{name}: expected a positive number, got {value}")
    skeleton = body.skeleton if isinstance(body, Character) else body
    frames = _Frames.of(animation, skeleton, rate_hz)
    if frames.count == 0:
        raise ShapeError(f"animation '{animation.name}': it has no frames")
    limit = tolerance_m
    result = _Simplifier(frames, skeleton, limit, shell_m).run()
    error, holds = result.error, result.error <= tolerance_m
    if isinstance(body, Character) and any(part.skin is not None for part in body.parts):
        for _ in range(4):
            skinned = _skin_error(body, frames, result)
            if skinned <= tolerance_m:
                break
            limit *= 0.95 * tolerance_m / skinned
            result = _Simplifier(frames, skeleton, limit, shell_m).run()
        error = max(result.error, _skin_error(body, frames, result))
        holds = error <= tolerance_m
    curves = result.curves
    morph_error = 0.0
    for m, name in enumerate(frames.morph_names):
        curve, off = _weights(frames, m, morph_tolerance)
        curves[Channel(name, Property.WEIGHT)] = curve
        morph_error = max(morph_error, off)
    before = _key_count(animation, frames, curves)
    clip = Clip(_others(animation) | curves, animation.name, frames.rate_hz)
    after = sum(c.key_count for c in curves.values())
    return SimplifyResult(clip, error, before, after, holds and morph_error <= morph_tolerance, morph_error)


# --- the animation as frames ------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class _Frames:
    """What the animation does at every frame, float64; and which channels it has at all."""

    times: Array
    rate_hz: float
    translations: Array
    rotations: Array
    scales: Array
    morph_names: tuple[str, ...]
    weights: Array
    channels: frozenset[tuple[str, Property]] | None

    @property
    def count(self) -> int:
        return len(self.times)

    @classmethod
    def of(cls, animation: Clip | Motion, skeleton: Skeleton, rate_hz: float | None) -> _Frames:
        matched = match(animation, skeleton)
        if isinstance(matched, Motion):
            rate = matched.rate_hz if rate_hz is None else float(rate_hz)
            names, channels = matched.morph_names, None
        else:
            rate = (key_rate(matched) or 60.0) if rate_hz is None else float(rate_hz)
            names = tuple(dict.fromkeys(c.target for c in matched.curves if c.property is Property.WEIGHT))
            turned = {Property.EULER: Property.ROTATION}
            channels = frozenset((c.target, turned.get(c.property, c.property)) for c in matched.curves)
        if not (np.isfinite(rate) and rate > 0):
            raise ShapeError(f"rate_hz: expected more than 0, got {rate}")
        count = int(np.floor(matched.duration_s * rate + 1e-3)) + 1
        if isinstance(matched, Motion) and (matched.frame_count == 0 or rate == matched.rate_hz):
            count = matched.frame_count
        times = matched.start_s + np.arange(count) / rate
        if count == 0:
            times = np.zeros(0)
            empty = np.zeros((0, skeleton.joint_count, 3))
            return cls(
                times, rate, empty, np.zeros((0, skeleton.joint_count, 4)), empty, names, np.zeros((0, 0)), channels
            )
        if isinstance(matched, Motion):
            pose = sample_motion(matched, times).broadcast()
        else:
            pose = sample_clip(matched, skeleton, times).broadcast()
        weights = np.asarray(sample_morphs(matched, names, times), np.float64) if names else np.zeros((count, 0))
        rotations = quat.align_signs(np.array(pose.rotations, np.float64), axis=0)
        translations, scales = np.array(pose.translations, np.float64), np.array(pose.scales, np.float64)
        return cls(times, rate, translations, rotations, scales, names, weights, channels)


def _others(animation: Clip | Motion) -> dict[Channel, Curve]:
    """Named values stay as they are."""
    if isinstance(animation, Motion):
        return {}
    return {c: v for c, v in animation.curves.items() if c.property is Property.VALUE}


def _key_count(animation: Clip | Motion, frames: _Frames, curves: dict[Channel, Curve]) -> int:
    """Keys before: of a clip its own, of a motion one per frame; one where nothing moves."""
    if isinstance(animation, Motion):
        return sum(frames.count if c.key_count > 1 else 1 for c in curves.values())
    moving = {c for c, v in curves.items() if v.key_count > 1}
    total = sum(1 for v in curves.values() if v.key_count == 1)
    turned = {Property.EULER: Property.ROTATION}
    for channel, curve in animation.curves.items():
        if Channel(channel.target, turned.get(channel.property, channel.property)) in moving:
            total += curve.key_count
    return total


# --- fitting ----------------------------------------------------------------------------------------------------------


@dataclass(slots=True)
class _Fit:
    curves: dict[Channel, Curve]
    rotations: Array
    translations: Array
    scales: Array
    error: float


class _Simplifier:
    """One clip while its keys are chosen."""

    def __init__(self, frames: _Frames, skeleton: Skeleton, tolerance_m: float, shell_m: float) -> None:
        self.frames, self.skeleton, self.tolerance, self.shell = frames, skeleton, tolerance_m, shell_m
        count, joints = frames.count, skeleton.joint_count
        self.parents = np.asarray(skeleton.parents, np.int64)
        self.below = np.zeros((joints, joints), bool)  # joint, and what hangs on it
        for joint in range(joints):
            at = joint
            while at >= 0:
                self.below[at, joint] = True
                at = int(self.parents[at])
        # How far a turn moves what hangs directly on the joint; the turns of joints further down are put right there.
        self.lever = np.full(joints, shell_m)
        size = np.ones(joints)
        for joint in range(joints):
            parent = int(self.parents[joint])
            size[joint] = float(np.max(np.abs(frames.scales[:, joint]))) * (size[parent] if parent >= 0 else 1.0)
            if parent >= 0:
                bone = float(np.max(np.linalg.norm(frames.translations[:, joint], axis=-1))) * size[parent]
                self.lever[parent] = max(self.lever[parent], bone)
        self.size = size
        self.uniform = bool(np.all(np.abs(frames.scales - 1) < _STILL))
        start = 1 / (_FIRST_SHARE * tolerance_m) ** 2
        self.weights = {
            "rotations": np.repeat((2 * self.lever[:, None]) ** 2 * start, count, axis=1),
            "translations": np.full((joints, count), start),
            "scales": np.repeat(self.lever[:, None] ** 2 * start, count, axis=1),
        }
        own = (("rotations", frames.rotations), ("translations", frames.translations), ("scales", frames.scales))
        self.moving = {name: np.any(np.ptp(a, axis=0) > _STILL, axis=-1) for name, a in own}
        self.truth = _matrices(self.parents, frames.rotations, frames.translations, frames.scales)
        self.world = np.empty_like(frames.rotations)
        for joint in range(joints):
            up = int(self.parents[joint])
            mine = frames.rotations[:, joint]
            self.world[:, joint] = mine if up < 0 else quat.multiply(self.world[:, up], mine)

    def run(self) -> _Fit:
        best: _Fit | None = None
        goal = 0.95 * self.tolerance
        for number in range(_MOST_ROUNDS):
            fit = self._fitted()
            errors = self._errors(fit)
            worst = errors.max(axis=1)
            fit.error = float(np.max(worst))
            settled = number >= _SOFTENED
            if fit.error <= self.tolerance and (settled or self.frames.count < 3 or not self._anything_moves()):
                return fit
            if best is None or fit.error < best.error:
                best = fit
            self._weigh(errors, worst, goal, settled)
        if best is None:
            raise ShapeError("animation: nothing to simplify")
        return best

    def _anything_moves(self) -> bool:
        return any(bool(np.any(m)) for m in self.moving.values())

    def _weigh(self, errors: Array, worst: Array, goal: float, settled: bool) -> None:
        """Weights rise where points that hang on a joint stray, and fall at first where there is room."""
        for joint in range(len(self.parents)):
            own = _around(errors[:, self.below[joint]].max(axis=1), _NEAR_FRAMES)
            factor = _factor(own, goal, self.tolerance, settled)
            self.weights["rotations"][joint] *= factor
            self.weights["scales"][joint] *= factor
            if self.moving["translations"][joint]:
                self.weights["translations"][joint] *= _factor(
                    _around(worst, _NEAR_FRAMES), goal, self.tolerance, settled
                )

    def _fitted(self) -> _Fit:
        frames = self.frames
        fit = _Fit({}, frames.rotations.copy(), frames.translations.copy(), frames.scales.copy(), np.inf)
        turned = np.empty_like(self.world)
        for joint, name in enumerate(self.skeleton.names):
            up = int(self.parents[joint])
            self._channel(fit, "translations", Property.TRANSLATION, joint, name, frames.translations[:, joint])
            wanted = frames.rotations[:, joint]
            if up >= 0 and self.uniform:
                # In the frame that the simplified parent left: turns of parents are put right, not handed on.
                wanted = quat.align_signs(quat.multiply(quat.conjugate(turned[:, up]), self.world[:, joint]), axis=0)
            self._channel(fit, "rotations", Property.ROTATION, joint, name, wanted)
            mine = fit.rotations[:, joint]
            turned[:, joint] = mine if up < 0 else quat.multiply(turned[:, up], mine)
            self._channel(fit, "scales", Property.SCALE, joint, name, frames.scales[:, joint])
        return fit

    def _channel(self, fit: _Fit, field: str, property: Property, joint: int, name: str, values: Array) -> None:
        channel = Channel(name, property)
        if self.frames.channels is not None and (name, property) not in self.frames.channels:
            return
        rotation = property is Property.ROTATION
        kind = CurveKind.ROTATION if rotation else CurveKind.VECTOR
        if not self.moving[field][joint]:
            first = self.frames.times[:1]
            still = getattr(self.frames, field)[:1, joint]
            fit.curves[channel] = Curve(first, still, Interpolation.STEP, kind=kind)
            return
        curve, fitted = _hermite(self.frames, np.ascontiguousarray(values), self.weights[field][joint], kind)
        fit.curves[channel] = curve
        getattr(fit, field)[:, joint] = fitted

    def _errors(self, fit: _Fit) -> Array:
        """Distances (T, J) of the points around each joint from their places."""
        from keypose.kernels.encode import shell_errors

        found = _matrices(self.parents, fit.rotations, fit.translations, fit.scales)
        out = np.empty(found.shape[:2])
        shell_errors(found, self.truth, self.shell, out)
        return out


def _factor(error: Array, goal: float, tolerance: float, settled: bool) -> Array:
    if settled:
        return np.where(error > 0.99 * tolerance, np.clip(error / (0.93 * tolerance), 1.0, 2.0) ** 2, 1.0)
    return np.clip(error / goal, 0.7, 1.6) ** 1.5


def _around(values: Array, frames: int) -> Array:
    """The largest of neighbouring frames."""
    half = frames // 2
    padded = np.pad(values, half, mode="edge")
    return np.max(np.lib.stride_tricks.sliding_window_view(padded, frames), axis=-1)


def _matrices(parents: Array, rotations: Array, translations: Array, scales: Array) -> Array:
    from keypose.kernels.encode import model_matrices

    out = np.empty((*rotations.shape[:2], 12))
    arrays = [np.ascontiguousarray(a, np.float64) for a in (rotations, translations, scales)]
    model_matrices(parents, *arrays, np.empty(rotations.shape), out)
    return out


def _hermite(frames: _Frames, values: Array, weights: Array, kind: CurveKind) -> tuple[Curve, Array]:
    """The curve of least cost through values (T, C) at all frames, and what it gives there."""
    from keypose.kernels.curves import choose_keys, fit_spans

    count, width = values.shape
    falling = np.empty(count, np.int64)
    found = int(choose_keys(values, np.ascontiguousarray(weights), _LONGEST, falling))
    keys = np.ascontiguousarray(falling[:found][::-1])
    tangents, fitted = np.empty((found - 1, 2, width)), np.empty_like(values)
    fit_spans(values, np.ascontiguousarray(weights), keys, kind is CurveKind.ROTATION, tangents, fitted)
    tangents *= frames.rate_hz
    out = np.concatenate([tangents[:, 0], np.zeros((1, width))])
    back = np.concatenate([np.zeros((1, width)), tangents[:, 1]])
    return Curve(frames.times[keys], values[keys], Interpolation.HERMITE, back, out, kind), fitted


def _weights(frames: _Frames, m: int, tolerance: float) -> tuple[Curve, float]:
    """One morph's weight."""
    values = np.ascontiguousarray(frames.weights[:, m : m + 1])
    if float(np.ptp(values)) <= _STILL:
        return Curve(frames.times[:1], values[:1], Interpolation.STEP, kind=CurveKind.SCALAR), 0.0
    weights = np.full(frames.count, 1 / (0.5 * tolerance) ** 2)
    curve, error = None, np.inf
    for number in range(_MOST_ROUNDS):
        curve, fitted = _hermite(frames, values, weights, CurveKind.SCALAR)
        off = np.abs(fitted - values)[:, 0]
        error = float(np.max(off))
        if error <= tolerance and number > 0:
            break
        weights = weights * _factor(_around(off, _NEAR_FRAMES), 0.95 * tolerance, tolerance, number > 0)
    if curve is None:
        raise ShapeError("animation: no morph weights to simplify")
    return curve, error


def _skin_error(character: Character, frames: _Frames, fit: _Fit) -> float:
    """The largest distance of any vertex, at every frame."""
    from keypose.deform import deform_part
    from keypose.model import Pose

    worst = 0.0
    rest = character.rest_morph_weights
    step = max(1, 2_000_000 // max(character.vertex_count, 1))
    for start in range(0, frames.count, step):
        rows = slice(start, start + step)
        pair: list[Any] = []
        for t, r, s in (
            (frames.translations, frames.rotations, frames.scales),
            (fit.translations, fit.rotations, fit.scales),
        ):
            pair.append(world(character.skeleton, Pose(t[rows], r[rows], s[rows])))
        for part in character.parts:
            if part.skin is not None:
                a, b = (np.asarray(deform_part(character, part, model, rest), np.float64) for model in pair)
                worst = max(worst, float(np.sqrt(np.max(np.sum((a - b) ** 2, axis=-1)))))
    return worst
