"""Clips and motions as animations of a file that is being written.

Source: glTF 2.0 Specification, section 3.11.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from keypose.evaluate import to_clip
from keypose.io.gltf.buffers import Buffers
from keypose.io.gltf.hierarchy import OWN
from keypose.io.gltf.keyframes import Track, join, single_precision, track_of
from keypose.io.notes import Notes
from keypose.model import Channel, Character, Clip, Curve, Extrapolation, Interpolation, Motion, Property

NAMES = {Interpolation.STEP: "STEP", Interpolation.LINEAR: "LINEAR", Interpolation.HERMITE: "CUBICSPLINE"}
WXYZ_TO_XYZW = [1, 2, 3, 0]


@dataclass(frozen=True, slots=True)
class WrittenCharacter:
    """A character whose nodes are in the file."""

    character: Character
    first_node: int
    morph_nodes: Sequence[tuple[int, NDArray[np.int32]]]  # nodes with morph targets, and the channels that drive them


@dataclass(slots=True)
class _Item:
    """An animation under way."""

    channels: list[dict[str, Any]] = field(default_factory=list[dict[str, Any]])
    samplers: list[dict[str, Any]] = field(default_factory=list[dict[str, Any]])
    known: dict[tuple[int, int, str], int] = field(default_factory=dict[tuple[int, int, str], int])
    end_s: float = 0.0


class AnimationWriter:
    """Collects animations for the characters of a file."""

    def __init__(self, buffers: Buffers, characters: Sequence[WrittenCharacter], notes: Notes) -> None:
        self._buffers, self._characters, self._notes = buffers, characters, notes
        self.animations: list[dict[str, Any]] = []

    def add(self, animation: Clip | Motion) -> None:
        """Write one animation for every character that has its joints or morphs."""
        if isinstance(animation, Motion):
            clip, extras = clip_of(animation), {"rate_hz": animation.rate_hz, "frames": animation.frame_count}
            if animation.events:
                self._notes.add(f"animation '{animation.name}': {len(animation.events)} events were dropped")
        else:
            clip, extras = animation, {} if animation.rate_hz is None else {"rate_hz": animation.rate_hz}
        shift = min(clip.start_s, 0.0)
        if shift < 0:
            self._notes.add(f"animation '{clip.name}': it was moved by {-shift:g} s because glTF's time starts at 0")
            extras["start_s"] = shift
            clip = replace(clip, curves={c: replace(v, times_s=v.times_s - shift) for c, v in clip.curves.items()})
        item = _Item()
        for written in self._characters:
            self._for_character(item, written, clip, isinstance(animation, Motion))
        known = {n for w in self._characters for n in (*w.character.skeleton.names, *w.character.morph_names)}
        unknown = sorted({c.target for c in clip.curves} - known)
        if unknown:
            shown = ", ".join(unknown[:6]) + (", …" if len(unknown) > 6 else "")
            self._notes.add(f"animation '{clip.name}': {len(unknown)} targets do not exist and were dropped: {shown}")
        if isinstance(animation, Motion) and self._characters:
            self._for_resting(item, self._characters[0], animation, max(animation.start_s, 0.0))
        if not item.channels:
            self._notes.add(f"animation '{clip.name}' moves nothing in this file and was dropped")
            return
        result: dict[str, Any] = {"name": clip.name} if clip.name else {}
        result |= {"channels": item.channels, "samplers": item.samplers}
        if extras:
            result["extras"] = {OWN: extras}
        self.animations.append(result)

    def _for_character(self, item: _Item, written: WrittenCharacter, clip: Clip, without_rest: bool) -> None:
        character = written.character
        joints = {name: joint for joint, name in enumerate(character.skeleton.names)}
        morphs = {name: morph for morph, name in enumerate(character.morph_names)}
        weights: dict[int, Curve] = {}
        for channel, curve in clip.curves.items():
            if curve.before is not Extrapolation.HOLD or curve.after is not Extrapolation.HOLD:
                self._notes.add(
                    f"animation '{clip.name}': glTF holds the first and last key; other extrapolation was dropped"
                )
            if channel.property is Property.WEIGHT:
                if channel.target in morphs and not (without_rest and _rests(curve, character, channel)):
                    weights[morphs[channel.target]] = curve
            elif channel.target in joints:
                if without_rest and _rests(curve, character, channel):
                    continue
                track = self._track(curve)
                if len(set(curve.modes[:-1].tolist())) > 1:
                    self._notes.add(f"animation '{clip.name}': curves of mixed interpolation got additional keys")
                rotation = channel.property is Property.ROTATION
                node = written.first_node + joints[channel.target]
                self._channel(item, node, channel.property.value, track, rotation)
        if weights:
            self._weights(item, written, weights)

    def _weights(self, item: _Item, written: WrittenCharacter, weights: Mapping[int, Curve]) -> None:
        """All morph channels at the same times, so that those that several nodes share stay equal on all of them."""
        rest = np.asarray(written.character.rest_morph_weights, np.float32)
        nodes = [(node, channels) for node, channels in written.morph_nodes if any(int(c) in weights for c in channels)]
        used = sorted({int(c) for _, channels in nodes for c in channels})
        if not used:
            return
        start = min(float(weights[c].times_s[0]) for c in used if c in weights)
        tracks = [
            self._track(weights[c])
            if c in weights
            else Track(np.array([start]), rest[c].reshape(1, 1), Interpolation.LINEAR)
            for c in used
        ]
        joined = join(tracks)
        for node, channels in nodes:
            self._channel(item, node, "weights", joined.columns([used.index(int(c)) for c in channels]), False)

    def _track(self, curve: Curve) -> Track:
        """A curve with one interpolation, at times that single precision can hold."""
        track, dropped = single_precision(track_of(curve))
        if dropped:
            self._notes.add(f"{dropped} keys were too close in time for single precision and were dropped")
        return track

    def _for_resting(self, item: _Item, written: WrittenCharacter, motion: Motion, start: float) -> None:
        """Keep the length of a motion whose last frames all channels leave out because they rest."""
        end = start + motion.duration_s
        skeleton = written.character.skeleton
        names = [n for n in skeleton.names if n in motion.joint_names]
        if (item.channels and item.end_s >= end - 1e-6 * max(end, 1.0)) or not names:
            return
        node = written.first_node + skeleton.index(names[0])
        taken = {(c["target"]["node"], c["target"]["path"]) for c in item.channels}
        for path in ("rotation", "translation", "scale"):
            if (node, path) not in taken:
                rest = getattr(skeleton.rest, f"{path}s")[skeleton.index(names[0])]
                times = np.array([start, end] if end > start else [end], np.float32).astype(np.float64)
                track = Track(times, np.tile(rest, (len(times), 1)), Interpolation.LINEAR)
                self._channel(item, node, path, track, path == "rotation")
                return

    def _channel(self, item: _Item, node: int, path: str, track: Track, rotation: bool) -> None:
        times = track.times_s.astype(np.float32)
        mode = track.mode
        values = _filed(track.values, rotation)
        if mode is Interpolation.HERMITE and len(times) > 1:
            stacked = np.stack(
                [_filed(t, rotation) for t in (track.in_tangents, track.values, track.out_tangents) if t is not None],
                axis=1,
            )
            values = stacked.reshape(-1, values.shape[1])
        else:
            if rotation:
                values = _unit(values)
            mode = Interpolation.LINEAR if mode is Interpolation.HERMITE else mode
        if path == "weights":
            values = values.reshape(-1, 1)
        input = self._buffers.keyframes(times[:, None], bounds=True)
        output = self._buffers.keyframes(np.ascontiguousarray(values))
        key = (input, output, NAMES[mode])
        if key not in item.known:
            sampler: dict[str, Any] = {"input": input, "output": output}
            if mode is not Interpolation.LINEAR:
                sampler["interpolation"] = NAMES[mode]
            item.known[key] = len(item.samplers)
            item.samplers.append(sampler)
        item.channels.append({"sampler": item.known[key], "target": {"node": node, "path": path}})
        item.end_s = max(item.end_s, float(track.times_s[-1]))


def _rests(curve: Curve, character: Character, channel: Channel) -> bool:
    """Whether a curve only says what the rest pose says already."""
    if channel.property is Property.WEIGHT:
        rest = np.asarray(character.rest_morph_weights)[character.morph_index(channel.target)]
    else:
        joint = character.skeleton.index(channel.target)
        rest = getattr(character.skeleton.rest, f"{channel.property.value}s")[joint]
    return curve.key_count <= 2 and bool(np.all(np.asarray(curve.values, np.float32) == np.asarray(rest, np.float32)))


def _filed(values: NDArray[Any], rotation: bool) -> NDArray[np.float32]:
    filed = np.asarray(values, np.float32)
    return np.ascontiguousarray(filed[:, WXYZ_TO_XYZW] if rotation else filed)


def _unit(rotations: NDArray[np.float32]) -> NDArray[np.float32]:
    lengths = np.linalg.norm(rotations.astype(np.float64), axis=1)
    off = np.abs(lengths - 1) > 1e-5
    return np.where(off[:, None], rotations / np.where(off, lengths, 1.0)[:, None], rotations).astype(np.float32)


def clip_of(motion: Motion) -> Clip:
    """A motion as linear curves with a key on every frame; what stands still gets one at each end."""
    clip = to_clip(motion, reduce_constant=True)
    ends = motion.times_s[[0, -1]] if motion.frame_count > 1 else None
    if ends is None:
        return clip
    curves = {
        channel: Curve(ends, np.repeat(curve.values, 2, axis=0), Interpolation.LINEAR, kind=curve.kind)
        if curve.key_count == 1
        else curve
        for channel, curve in clip.curves.items()
    }
    return Clip(curves, clip.name, clip.rate_hz)
