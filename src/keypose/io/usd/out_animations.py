"""Clips and motions as SkelAnimations, with samples where they have keys."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from keypose.arrays import Array, Floats
from keypose.evaluate import key_rate, sample_curve
from keypose.io.notes import Notes
from keypose.io.usd.library import Names, entitle, keep, vectors
from keypose.math import quat
from keypose.model import Channel, Character, Clip, Curve, Extrapolation, Interpolation, Motion, Property

DEFAULT_RATE_HZ = 24.0
_SLOWEST_HZ = 24.0
_FINE_HZ = 60.0  # at which curves are sampled that USD does not have
_JUMP = 1e-4  # frames before a key at which a step still has its old value
_INTEGER = 1e-6  # frames by which a time code may miss a whole number and still be one


@dataclass(frozen=True, slots=True)
class Written:
    """A character that is in the file."""

    character: Character
    tokens: Sequence[str]
    skeletons: Sequence[Any]
    root: str


def common_rate(animations: Sequence[Clip | Motion]) -> float:
    """Time codes per second of a file with these animations: the highest of their rates."""
    rates = [
        animation.rate_hz or (key_rate(animation) if isinstance(animation, Clip) else None) for animation in animations
    ]
    rate = max((float(rate) for rate in rates if rate), default=DEFAULT_RATE_HZ)
    return rate * math.ceil(_SLOWEST_HZ / rate)  # few keys are no slow film


class AnimationWriter:
    """Writes animations for the characters of a file; the first one is bound."""

    def __init__(
        self, usd: Any, stage: Any, written: Sequence[Written], rate_hz: float, scale: float, notes: Notes
    ) -> None:
        self._usd, self._stage, self._written = usd, stage, written
        self._rate, self._scale, self._notes = rate_hz, scale, notes
        self._names = {w.root: Names() for w in written}
        self._bound: set[str] = set()
        self.span: tuple[float, float] | None = None  # time codes of what is bound
        self._worst = 0.0  # error of scales in half precision

    def add(self, animation: Clip | Motion) -> None:
        """One animation, for every character that has its joints or morphs."""
        name = animation.name or "Animation"
        if isinstance(animation, Motion) and animation.events:
            self._notes.add(f"animation '{name}': {len(animation.events)} events were dropped")
        if isinstance(animation, Motion) and not animation.frame_count:
            self._notes.add(f"animation '{name}': it has no frames and was left out")
            return
        self._note_targets(animation, name)
        for written in self._written:
            if isinstance(animation, Motion):
                tracks: _Tracks = _MotionTracks(animation, written.character)
            else:
                tracks = _ClipTracks(animation, written.character, self._rate, self._notes)
            if tracks.fits:
                self._write(written, animation, name, tracks)

    def finish(self) -> None:
        """Say what all animations have in common."""
        if self._worst:
            self._notes.add(
                f"UsdSkel holds scales in half precision, off by up to {self._worst:.2g}; "
                "keypose reads an exact copy that is beside them"
            )

    def _note_targets(self, animation: Clip | Motion, name: str) -> None:
        targets = (
            {*animation.joint_names, *animation.morph_names}
            if isinstance(animation, Motion)
            else {channel.target for channel in animation.curves}
        )
        known = {n for w in self._written for n in (*w.character.skeleton.names, *w.character.morph_names)}
        unknown = sorted(targets - known)
        if unknown:
            shown = ", ".join(unknown[:6]) + (", …" if len(unknown) > 6 else "")
            self._notes.add(f"animation '{name}': {len(unknown)} targets do not exist and were dropped: {shown}")

    def _write(self, written: Written, animation: Clip | Motion, name: str, tracks: _Tracks) -> None:
        usd, scope = self._usd, f"{written.root}/Animations"
        if not self._stage.GetPrimAtPath(scope):
            usd.UsdGeom.Scope.Define(self._stage, scope)
        path = f"{scope}/{self._names[written.root].add(name, 'Animation')}"
        schema = usd.UsdSkel.Animation.Define(self._stage, path)
        prim = schema.GetPrim()
        entitle(prim, animation.name)
        if animation.rate_hz:
            keep(prim, rate_hz=float(animation.rate_hz))
        schema.CreateJointsAttr(usd.Vt.TokenArray(list(written.tokens)))
        times, values = tracks.joints(Property.TRANSLATION)
        self._sample(schema.CreateTranslationsAttr(), times, [vectors(usd, rows * self._scale) for rows in values])
        times, values = tracks.joints(Property.ROTATION)
        aligned = np.asarray(quat.align_signs(_unit(values), axis=0))
        xyzw = np.ascontiguousarray(aligned[..., [1, 2, 3, 0]], np.float32)
        self._sample(schema.CreateRotationsAttr(), times, [usd.Vt.QuatfArray.FromNumpy(rows) for rows in xyzw])
        self._scales(schema, tracks)
        if tracks.morphs:
            schema.CreateBlendShapesAttr(usd.Vt.TokenArray([written.character.morph_names[m] for m in tracks.morphs]))
            times, values = tracks.weights()
            rows = np.ascontiguousarray(values, np.float32)
            self._sample(schema.CreateBlendShapeWeightsAttr(), times, [usd.Vt.FloatArray.FromNumpy(r) for r in rows])
        if written.root not in self._bound:
            self._bound.add(written.root)
            for skeleton in written.skeletons:
                usd.UsdSkel.BindingAPI(skeleton).CreateAnimationSourceRel().SetTargets([path])
            first, last = (float(self._code(t)) for t in (animation.start_s, animation.start_s + animation.duration_s))
            before = self.span or (first, last)
            self.span = min(first, before[0]), max(last, before[1])

    def _scales(self, schema: Any, tracks: _Tracks) -> None:
        """UsdSkel has scales in half precision; where that is not enough keypose's own copy is beside them."""
        usd = self._usd
        times, values = tracks.joints(Property.SCALE)
        exact = np.asarray(values, np.float32)
        with np.errstate(over="ignore"):
            half = exact.astype(np.float16)
        self._sample(schema.CreateScalesAttr(), times, [usd.Vt.Vec3hArray.FromNumpy(rows) for rows in half])
        off = np.abs(half.astype(np.float64) - exact)
        if np.any(off > 0):
            types = usd.Sdf.ValueTypeNames
            attribute = schema.GetPrim().CreateAttribute("keypose:scales", types.Float3Array, True)
            self._sample(attribute, times, [vectors(usd, rows) for rows in exact])
            self._worst = max(self._worst, float(off.max()))

    def _sample(self, attribute: Any, times: Floats, values: Sequence[Any]) -> None:
        """Samples, or one value without a time where nothing moves."""
        if not len(times):
            attribute.Set(values[0])
            return
        for time, value in zip(times, values, strict=True):
            attribute.Set(value, self._usd.Usd.TimeCode(self._code(float(time))))

    def _code(self, time_s: float) -> float:
        code = time_s * self._rate
        return float(round(code)) if abs(code - round(code)) < _INTEGER else code


class _Tracks:
    """What an animation does to a character, as tables of values at times."""

    fits: bool
    morphs: list[int]  # channels that are driven

    def joints(self, prop: Property) -> tuple[Floats, Floats]:
        """Times (T,) and values (T, J, C); one row and no times where nothing moves."""
        raise NotImplementedError

    def weights(self) -> tuple[Floats, Floats]:
        """Times (T,) and values (T, morphs)."""
        raise NotImplementedError


class _MotionTracks(_Tracks):
    def __init__(self, motion: Motion, character: Character) -> None:
        self._motion, self._character = motion, character
        self._joints = {n: j for j, n in enumerate(motion.joint_names)}
        driven = {n for n in motion.morph_names if n in character.morph_names}
        self.morphs = _with_resting(character, driven)
        self.fits = bool(driven) or any(n in self._joints for n in character.skeleton.names)

    def joints(self, prop: Property) -> tuple[Floats, Floats]:
        pose = self._motion.pose.broadcast()
        moving = np.asarray(getattr(pose, f"{prop.value}s"), np.float64)
        rest = np.asarray(getattr(self._character.skeleton.rest, f"{prop.value}s"), np.float64)
        values = np.tile(rest, (len(moving), 1, 1))
        for joint, name in enumerate(self._character.skeleton.names):
            if name in self._joints:
                values[:, joint] = moving[:, self._joints[name]]
        return np.asarray(self._motion.times_s), values

    def weights(self) -> tuple[Floats, Floats]:
        rest = np.asarray(self._character.rest_morph_weights, np.float64)
        values = np.tile(rest[self.morphs], (self._motion.frame_count, 1))
        for column, morph in enumerate(self.morphs):
            name = self._character.morph_names[morph]
            if name in self._motion.morph_names:
                values[:, column] = np.asarray(self._motion.morph_weights)[:, self._motion.morph_names.index(name)]
        return np.asarray(self._motion.times_s), values


class _ClipTracks(_Tracks):
    def __init__(self, clip: Clip, character: Character, rate: float, notes: Notes) -> None:
        self._clip, self._character, self._rate, self._notes = clip, character, rate, notes
        weights = Property.WEIGHT
        known = {*character.skeleton.names}
        driven = {c.target for c in clip.curves if c.property is weights and c.target in character.morph_names}
        self.morphs = _with_resting(character, driven)
        self.fits = bool(driven) or any(c.target in known and c.property is not weights for c in clip.curves)
        for curve in clip.curves.values():
            if curve.before is not Extrapolation.HOLD or curve.after is not Extrapolation.HOLD:
                notes.add(f"animation '{clip.name}': USD holds the first and last key; other extrapolation was dropped")

    def joints(self, prop: Property) -> tuple[Floats, Floats]:
        skeleton = self._character.skeleton
        row = {name: joint for joint, name in enumerate(skeleton.names)}
        curves = {
            row[c.target]: v
            for c, v in self._clip.curves.items()
            if c.property is prop and c.component is None and c.target in row
        }
        return self._table(curves, np.asarray(getattr(skeleton.rest, f"{prop.value}s"), np.float64))

    def weights(self) -> tuple[Floats, Floats]:
        names, rest = self._character.morph_names, np.asarray(self._character.rest_morph_weights, np.float64)
        curves: dict[int, Curve] = {}
        for column, morph in enumerate(self.morphs):
            channel = Channel(names[morph], Property.WEIGHT)
            if channel in self._clip.curves:
                curves[column] = self._clip.curves[channel]
        times, values = self._table(curves, rest[self.morphs][:, None])
        return times, values[..., 0]

    def _table(self, curves: Mapping[int, Curve], rest: Array) -> tuple[Floats, Floats]:
        """All curves at the times of every one of them; between these all are linear."""
        times = self._times(list(curves.values()))
        if not len(times):
            return times, rest[None]
        values = np.tile(rest, (len(times), *([1] * rest.ndim)))
        for row, curve in curves.items():
            values[:, row] = sample_curve(curve, times)
        return times, values

    def _times(self, curves: Sequence[Curve]) -> Floats:
        found = [np.asarray(c.times_s, np.float64) for c in curves]
        for curve in curves:
            modes = np.asarray(curve.modes)[:-1]
            steps = np.nonzero(modes == Interpolation.STEP)[0]
            jumps = np.asarray(curve.times_s)[steps + 1]
            spans = jumps - np.asarray(curve.times_s)[steps]
            found.append(jumps - np.minimum(_JUMP / self._rate, spans / 2))
            if len(steps):
                self._notes.add(
                    f"animation '{self._clip.name}': USD has no steps here; each became two keys close together"
                )
            if np.any(~np.isin(modes, (Interpolation.STEP, Interpolation.LINEAR))):
                first, last = float(curve.times_s[0]), float(curve.times_s[-1])
                rate = self._rate * math.ceil(_FINE_HZ / self._rate)
                frames = np.arange(math.ceil(first * rate), math.floor(last * rate) + 1)
                found.append(np.clip(frames / rate, first, last))
                self._notes.add(f"animation '{self._clip.name}': its smooth curves were sampled at {rate:g} Hz")
        return np.unique(np.concatenate(found)) if found else np.zeros(0)


def _unit(rotations: Floats) -> Floats:
    """Unit quaternions; those that are so in single precision stay as they are, to the last bit."""
    off = np.abs(np.linalg.norm(rotations, axis=-1, keepdims=True) - 1) > 1e-5
    return np.where(off, quat.normalize(rotations), rotations)


def _with_resting(character: Character, driven: set[str]) -> list[int]:
    """Channels that are driven, and those that do not rest at 0, where they would be without a weight."""
    rest = np.asarray(character.rest_morph_weights)
    return [m for m, name in enumerate(character.morph_names) if name in driven or (driven and rest[m] != 0)]
