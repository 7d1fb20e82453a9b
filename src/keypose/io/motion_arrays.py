"""Motions as named arrays, the layout that our .npz and .safetensors files share.

Everything that a learning program needs is inside: names, parents, rest pose, rates. Arrays keep their precision.

| array | shape | |
|---|---|---|
| rotations | (T, J, 4) | unit quaternions, wxyz |
| translations, scales | (T, J, 3) or (J, 3) | metres; one row where nothing moves |
| parents | (J,) | -1 for roots |
| rest_translations, rest_rotations, rest_scales | (J, 3), (J, 4), (J, 3) | |
| end_joints, end_offsets | (E,), (E, 3) | tips of leaf joints |
| morph_weights | (T, M) | |
| event_times_s | (N,) | |
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NoReturn

import numpy as np

from keypose.arrays import Floats
from keypose.errors import FormatError, ShapeError
from keypose.model import Character, Clip, Event, Motion, Pose, Scene, Skeleton

FORMAT, VERSION = "keypose.motion", 1
_MOST_JOINTS = 100_000


@dataclass(frozen=True, slots=True)
class Record:
    """What a file holds: arrays, and texts and numbers as JSON values."""

    arrays: Mapping[str, Any]
    facts: Mapping[str, Any]


def to_record(scene: Scene) -> tuple[Record, tuple[str, ...]]:
    """The first animation of a scene with the first character's skeleton, and notes of what is left out.

    A clip is baked at its rate, or at 30 Hz.

    Raises:
        FormatError: where the scene has no animation.
    """
    notes: list[str] = []
    if not scene.animations:
        raise FormatError("the scene has no animation, and this format holds nothing else")
    animation = scene.animations[0]
    if len(scene.animations) > 1:
        notes.append(f"one animation fits into the file: '{animation.name}' of {len(scene.animations)}")
    skeleton = scene.characters[0].skeleton if scene.characters else None
    if scene.characters and scene.characters[0].parts:
        notes.append("meshes were not written")
    motion = animation
    if isinstance(motion, Clip):
        motion = _baked(motion, scene, notes)
    arrays: dict[str, Any] = {
        "rotations": motion.pose.rotations,
        "translations": motion.pose.translations,
        "scales": motion.pose.scales,
    }
    facts: dict[str, Any] = {
        "format": FORMAT, "version": VERSION, "name": motion.name, "rate_hz": motion.rate_hz, "start_s": motion.start_s,
        "joint_names": list(motion.joint_names),
    }  # fmt: skip
    if skeleton is not None and skeleton.names != motion.joint_names:
        notes.append("the character's skeleton has other joints than the motion and was not written")
        skeleton = None
    if skeleton is not None:
        rest = skeleton.rest
        arrays |= {
            "parents": skeleton.parents,
            "rest_translations": rest.translations,
            "rest_rotations": rest.rotations,
            "rest_scales": rest.scales,
        }
        if skeleton.end_offsets:
            arrays["end_joints"] = np.array([joint for joint, _ in skeleton.end_offsets], np.int32)
            arrays["end_offsets"] = np.array([end for _, end in skeleton.end_offsets], np.float64)
        if scene.characters[0].roles:
            facts["roles"] = dict(scene.characters[0].roles)
        facts["character"] = scene.characters[0].name
    if motion.morph_names:
        arrays["morph_weights"] = motion.morph_weights
        facts["morph_names"] = list(motion.morph_names)
    if motion.events:
        arrays["event_times_s"] = np.array([event.time_s for event in motion.events], np.float64)
        facts["events"] = [[event.name, event.data] for event in motion.events]
    return Record({name: np.ascontiguousarray(array) for name, array in arrays.items()}, facts), tuple(notes)


def _baked(clip: Clip, scene: Scene, notes: list[str]) -> Motion:
    from keypose.evaluate import bake, key_rate

    if not scene.characters:
        raise FormatError("a clip needs its character, whose rest pose its joints have where no curve moves them")
    rate_hz = clip.rate_hz or key_rate(clip) or 30.0
    notes.append(f"clip '{clip.name}' was sampled at {rate_hz:g} Hz")
    character = scene.character
    return bake(
        clip,
        character.skeleton,
        rate_hz,
        morph_names=character.morph_names,
        rest_morph_weights=character.rest_morph_weights,
    )


def to_scene(record: Record, name: str, format: str) -> Scene:
    """The scene of a record.

    Raises:
        FormatError: where something is missing or does not fit, with the name of the array or text.
    """
    reader = _Reader(record)
    if record.facts.get("format") != FORMAT:
        reader.fail("format", f"expected '{FORMAT}'")
    if record.facts.get("version") != VERSION:
        reader.fail("version", f"expected {VERSION}; written by another keypose")
    try:
        return reader.scene(name, format)
    except ShapeError as error:
        raise FormatError(str(error)) from None


class _Reader:
    def __init__(self, record: Record) -> None:
        self.arrays, self.facts = record.arrays, record.facts

    def fail(self, where: str, what: str) -> NoReturn:
        raise FormatError(what, where=where)

    def scene(self, name: str, format: str) -> Scene:
        names = self.names("joint_names")
        if len(names) > _MOST_JOINTS:
            self.fail("joint_names", f"{len(names)} joints; at most {_MOST_JOINTS} are read")
        joints = len(names)
        rotations = self.numbers("rotations", (None, joints, 4))
        frames = len(rotations)
        pose = Pose(
            self.numbers("translations", (frames, joints, 3), (joints, 3)),
            self.units("rotations", rotations),
            self.numbers("scales", (frames, joints, 3), (joints, 3)),
        )
        morphs = self.names("morph_names") if "morph_names" in self.facts else ()
        motion = Motion(
            names,
            pose,
            self.number("rate_hz"),
            self.text("name"),
            self.number("start_s"),
            morphs,
            self.numbers("morph_weights", (frames, len(morphs))) if morphs else None,
            self.events(),
        )
        characters = (self.character(names, name),) if "parents" in self.arrays else ()
        return Scene(characters, (motion,), format)

    def character(self, names: tuple[str, ...], name: str) -> Character:
        joints = len(names)
        parents = self.integers("parents", (joints,))
        rest = Pose(
            self.numbers("rest_translations", (joints, 3)),
            self.units("rest_rotations", self.numbers("rest_rotations", (joints, 4))),
            self.numbers("rest_scales", (joints, 3)),
        )
        ends: tuple[Any, ...] = ()
        if "end_joints" in self.arrays:
            at = self.integers("end_joints", (None,))
            if np.any((at < 0) | (at >= joints)):
                self.fail("end_joints", f"a joint that does not exist; there are {joints}")
            offsets = self.numbers("end_offsets", (len(at), 3))
            ends = tuple((int(j), (float(x), float(y), float(z))) for j, (x, y, z) in zip(at, offsets, strict=True))
        roles = self.facts.get("roles", {})
        if not isinstance(roles, dict) or any(type(j) is not int or not 0 <= j < joints for j in roles.values()):
            self.fail("roles", "expected names of roles with the numbers of joints")
        skeleton = Skeleton(names, parents, rest, ends)
        return Character(skeleton, name=self.text("character") or name, roles=roles)

    def events(self) -> tuple[Event, ...]:
        listed = self.facts.get("events", [])
        if not listed:
            return ()
        wrong = not isinstance(listed, list) or any(
            not isinstance(e, list) or len(e) != 2 or not all(isinstance(t, str) for t in e) for e in listed
        )
        if wrong:
            self.fail("events", "expected pairs of a name and data")
        times = self.numbers("event_times_s", (len(listed),))
        return tuple(Event(float(t), e[0], e[1]) for t, e in zip(times, listed, strict=True))

    def names(self, key: str) -> tuple[str, ...]:
        value = self.facts.get(key)
        if not isinstance(value, list) or not all(isinstance(n, str) for n in value):
            self.fail(key, "expected a list of names")
        if len(set(value)) != len(value):
            self.fail(key, "a name appears more than once")
        return tuple(value)

    def text(self, key: str) -> str:
        value = self.facts.get(key, "")
        if not isinstance(value, str):
            self.fail(key, "expected a text")
        return value

    def number(self, key: str) -> float:
        value = self.facts.get(key)
        if type(value) not in (int, float) or not abs(value) < 1e12:  # pyright: ignore[reportArgumentType]
            self.fail(key, "expected a number")
        return float(value)  # pyright: ignore[reportArgumentType]

    def array(self, key: str, shapes: tuple[tuple[int | None, ...], ...]) -> Any:
        if key not in self.arrays:
            self.fail(key, "the array is missing")
        array = self.arrays[key]
        fits = (
            len(s) == array.ndim and all(w in (None, n) for w, n in zip(s, array.shape, strict=True)) for s in shapes
        )
        if not any(fits):
            wanted = " or ".join(str(tuple("T" if w is None else w for w in s)).replace("'", "") for s in shapes)
            self.fail(key, f"expected shape {wanted}, got {array.shape}")
        return array

    def numbers(self, key: str, *shapes: tuple[int | None, ...]) -> Floats:
        array = self.array(key, shapes)
        if array.dtype.kind not in "fiu" or array.dtype.itemsize > 8:
            self.fail(key, f"expected numbers, got {array.dtype}")
        floats = array.astype(np.float32 if array.dtype in (np.float16, np.float32) else np.float64, copy=False)
        if not np.all(np.isfinite(floats)) or np.any(np.abs(floats) > 1e12):
            self.fail(key, "expected finite numbers")
        return floats

    def integers(self, key: str, shape: tuple[int | None, ...]) -> Any:
        array = self.array(key, (shape,))
        if array.dtype.kind not in "iu":
            self.fail(key, f"expected integers, got {array.dtype}")
        if array.size and (array.min() < -1 or array.max() > _MOST_JOINTS):
            self.fail(key, "a number is out of range")
        return array.astype(np.int32)

    def units(self, key: str, rotations: Floats) -> Floats:
        length = np.linalg.norm(rotations.astype(np.float64), axis=-1, keepdims=True)
        if np.any(np.abs(length - 1) > 1e-2):
            self.fail(key, "expected unit quaternions")
        # those that are of unit length to their precision stay as they are, bit for bit
        return np.where(np.abs(length - 1) > 1e-6, rotations / length, rotations).astype(rotations.dtype)


def facts_text(facts: Mapping[str, Any]) -> str:
    """The facts as JSON; floats keep all their digits."""
    return json.dumps(facts, ensure_ascii=False, separators=(",", ":"), allow_nan=False)
