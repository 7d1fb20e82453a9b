"""Clips and motions as animation stacks with keys at every frame."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from keypose.arrays import Array, Floats
from keypose.evaluate import bake, key_rate, resample
from keypose.io.fbx.binary import Long, properties
from keypose.io.fbx.out_nodes import ORDER, Model, Objects, number
from keypose.io.notes import Notes
from keypose.math import euler, quat
from keypose.model import Character, Clip, Motion, Property

TICKS_PER_S = 46_186_158_000
DEFAULT_RATE_HZ = 30.0
# FBX's numbers of frame rates; all others are written as custom ones.
TIME_MODES = {24.0: 11, 25.0: 10, 30.0: 6, 48.0: 5, 50.0: 4, 60.0: 3, 72.0: 16, 96.0: 15, 100.0: 2, 120.0: 1}
CUSTOM_MODE = 14
_LINEAR = 4
_STILL = 1e-9


@dataclass(frozen=True, slots=True)
class Written:
    """A character that is in the file: its models, and the blend channels of each of its morph channels."""

    character: Character
    models: Sequence[Model]
    blend_channels: Sequence[tuple[int, int]]


def ticks(time_s: float) -> int:
    """FBX's time."""
    return round(time_s * TICKS_PER_S)


def common_rate(animations: Sequence[Clip | Motion], notes: Notes) -> float:
    """The frame rate of a file with these animations: the highest of theirs."""
    rates: set[float] = set()
    for animation in animations:
        rate = animation.rate_hz or (key_rate(animation) if isinstance(animation, Clip) else None)
        rates.add(float(rate) if rate else DEFAULT_RATE_HZ)
    if len(rates) > 1:
        notes.add(f"the animations have {len(rates)} frame rates, FBX has one: all were written at {max(rates):g} Hz")
    return max(rates, default=DEFAULT_RATE_HZ)


class AnimationWriter:
    """Writes animations for the characters of a file."""

    def __init__(
        self, objects: Objects, written: Sequence[Written], rate_hz: float, scale: float, notes: Notes
    ) -> None:
        self._objects, self._written, self._rate, self._scale, self._notes = objects, written, rate_hz, scale, notes
        self.takes: list[tuple[str, int, int]] = []

    def add(self, animation: Clip | Motion) -> None:
        """One stack of one layer, for every character that has the animation's joints or morphs."""
        name = animation.name or f"Take {len(self.takes) + 1:03d}"
        if isinstance(animation, Motion):
            if animation.frame_count == 0:
                self._notes.add(f"animation '{name}': it has no frames and was left out")
                return
            begin, end = animation.start_s, animation.start_s + animation.duration_s
            if animation.events:
                self._notes.add(f"animation '{name}': {len(animation.events)} events were dropped")
        else:
            begin, end = animation.start_s, animation.end_s
        self._note_targets(animation, name)
        start, stop = ticks(begin), max(ticks(end), ticks(begin))
        stack, item = self._objects.add("AnimationStack", name, "", "AnimStack")
        item.children.append(
            properties(
                [
                    (key, "KTime", "Time", "", Long(value))
                    for key, value in (
                        ("LocalStart", start),
                        ("LocalStop", stop),
                        ("ReferenceStart", start),
                        ("ReferenceStop", stop),
                    )
                ]
            )
        )
        layer, _ = self._objects.add("AnimationLayer", "BaseLayer", "", "AnimLayer")
        self._objects.connect(layer, stack)
        self.takes.append((name, start, stop))
        before = self._objects.counts.get("AnimationCurve", 0)
        for written in self._written:
            self._for_character(animation, written, layer)
        if self._objects.counts.get("AnimationCurve", 0) == before:
            self._hold(layer, start, stop)

    def _hold(self, layer: int, start: int, stop: int) -> None:
        """Keys that keep a joint where it is, so that an animation in which everything rests is one and has a length."""
        for written in self._written:
            if written.character.skeleton.joint_count:
                times = np.unique(np.array([start, stop], np.int64))
                rest = np.asarray(written.character.skeleton.rest.translations[0], np.float64) * self._scale
                model = written.models[0].identity
                self._curves(
                    layer, model, "Lcl Translation", ("d|X", "d|Y", "d|Z"), times, np.tile(rest, (len(times), 1))
                )
                return

    def _note_targets(self, animation: Clip | Motion, name: str) -> None:
        if isinstance(animation, Motion):
            targets = {*animation.joint_names, *animation.morph_names}
        else:
            targets = {channel.target for channel in animation.curves}
        known = {n for w in self._written for n in (*w.character.skeleton.names, *w.character.morph_names)}
        unknown = sorted(targets - known)
        if unknown:
            shown = ", ".join(unknown[:6]) + (", …" if len(unknown) > 6 else "")
            self._notes.add(f"animation '{name}': {len(unknown)} targets do not exist and were dropped: {shown}")

    def _for_character(self, animation: Clip | Motion, written: Written, layer: int) -> None:
        character = written.character
        skeleton = character.skeleton
        motion, animated = self._frames(animation, character)
        times = np.array([ticks(t) for t in motion.times_s], np.int64)
        pose = motion.pose.broadcast()
        joints = {name: joint for joint, name in enumerate(motion.joint_names)}
        for joint, name in enumerate(skeleton.names):
            row = joints.get(name)
            if row is None:
                continue
            model = written.models[joint]
            rest = skeleton.rest
            for prop, kind, values, still in (
                (Property.TRANSLATION, "Lcl Translation", pose.translations[:, row], rest.translations[joint]),
                (Property.ROTATION, "Lcl Rotation", pose.rotations[:, row], rest.rotations[joint]),
                (Property.SCALE, "Lcl Scaling", pose.scales[:, row], rest.scales[joint]),
            ):
                if animated is not None and (name, prop) not in animated:
                    continue
                values = np.asarray(values, np.float64)
                if _rests(values, np.asarray(still, np.float64), prop):
                    continue
                if prop is Property.TRANSLATION:
                    values = values * self._scale
                elif prop is Property.ROTATION:
                    values = _angles(model.pre_rotation, values)
                self._curves(layer, model.identity, kind, ("d|X", "d|Y", "d|Z"), times, values)
        self._weights(motion, written, times, layer, animated)

    def _weights(
        self,
        motion: Motion,
        written: Written,
        times: Array,
        layer: int,
        animated: set[tuple[str, Property]] | None,
    ) -> None:
        names, rest = written.character.morph_names, np.asarray(written.character.rest_morph_weights, np.float64)
        for morph, channel in written.blend_channels:
            name = names[morph]
            if name not in motion.morph_names or (animated is not None and (name, Property.WEIGHT) not in animated):
                continue
            column = motion.morph_names.index(name)
            values = np.asarray(motion.morph_weights, np.float64)[:, column : column + 1]
            if not np.all(np.abs(values - rest[morph]) <= _STILL):
                self._curves(layer, channel, "DeformPercent", ("d|DeformPercent",), times, values * 100)

    def _frames(
        self, animation: Clip | Motion, character: Character
    ) -> tuple[Motion, set[tuple[str, Property]] | None]:
        """The animation at every frame, the last at or after its end, and what it animates; None for everything."""
        if isinstance(animation, Motion):
            return (animation if animation.rate_hz == self._rate else resample(animation, self._rate)), None
        start = animation.start_s
        frames = math.ceil(animation.duration_s * self._rate - 1e-3)
        motion = bake(
            animation,
            character.skeleton,
            self._rate,
            start,
            start + frames / self._rate,
            character.morph_names,
            character.rest_morph_weights,
        )
        return motion, {(c.target, c.property) for c in animation.curves}

    def _curves(self, layer: int, target: int, kind: str, names: Sequence[str], times: Array, values: Floats) -> None:
        """A curve for each component; one that does not move has a single key."""
        label = {"Lcl Translation": "T", "Lcl Rotation": "R", "Lcl Scaling": "S"}.get(kind, kind)
        curve_node, item = self._objects.add("AnimationCurveNode", label, "", "AnimCurveNode")
        item.children.append(properties([number(n, float(v)) for n, v in zip(names, values[0], strict=True)]))
        self._objects.connect(curve_node, layer)
        self._objects.connect(curve_node, target, kind)
        for component, name in enumerate(names):
            track = values[:, component]
            count = 1 if np.ptp(track) == 0 else len(track)
            curve, item = self._objects.add("AnimationCurve", "", "", "AnimCurve")
            item.add("Default", float(track[0]))
            item.add("KeyVer", 4008)
            item.add("KeyTime", times[:count])
            item.add("KeyValueFloat", track[:count].astype(np.float32))
            item.add("KeyAttrFlags", np.array([_LINEAR], np.int32))
            item.add("KeyAttrDataFloat", np.zeros(4, np.float32))
            item.add("KeyAttrRefCount", np.array([count], np.int32))
            self._objects.connect(curve, curve_node, name)


def _rests(values: Floats, rest: Floats, prop: Property) -> bool:
    if prop is Property.ROTATION:
        return bool(np.all(np.minimum(np.abs(values - rest).max(-1), np.abs(values + rest).max(-1)) <= _STILL))
    return bool(np.all(np.abs(values - rest) <= _STILL))


def _angles(pre_rotation: Floats, rotations: Floats) -> Floats:
    """Degrees (T, 3) after the rotation that comes before them, without jumps."""
    relative = quat.multiply(quat.conjugate(pre_rotation), quat.normalize(rotations))
    return np.degrees(euler.unroll(euler.from_quat(quat.align_signs(relative, axis=0), ORDER), ORDER))
