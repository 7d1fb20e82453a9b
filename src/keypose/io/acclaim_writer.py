"""Writing Acclaim files: any skeleton as ASF, with a motion or clip as AMC beside it.

A bone starts where its parent ends. Where the children of a joint lie at several places, bones without degrees of freedom
are put between; they, the root's name and axes are told in a comment, so that reading gives the same rig again.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

import numpy as np

from keypose.arrays import Floats
from keypose.errors import FormatError, ShapeError
from keypose.io.amc import compose_amc
from keypose.io.asf import DOFS, AsfBone, AsfText, Vector, compose_asf
from keypose.io.atomic import replacing
from keypose.io.axes import UNITS_M, unit_in_metres
from keypose.io.bvh_channels import Layout, write_degrees
from keypose.io.joint_motion import depth_first, motion_to_write
from keypose.math import euler, quat
from keypose.model import Character, Motion, Pose, Scene, Skeleton

_DEFAULT_RATE_HZ = 120.0
_RESOLUTION_M = 1e-8
_SAME_PLACE_M = 1e-9
_NO_MOVE_M = 1e-8
_NO_TURN_DEG = 1e-6
_ORDERS = ("XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYX")
_ROOT_DOF = ("tx", "ty", "tz", "rx", "ry", "rz")
_BONE_DOF = ("rx", "ry", "rz")


def write(
    scene: Scene,
    path: Path,
    *,
    unit: str | float | None = None,
    rate_hz: float | None = None,
    decimals: int | None = None,
    animation: str | None = None,
) -> tuple[str, ...]:
    """Write the first character as ASF and, where ``path`` ends in .amc, one of its animations as AMC beside it.

    Shapes and units: ``unit`` is a name ("cm") or metres per file unit, CMU's 1/0.45 inch unless the character came from
    another; ``rate_hz`` resamples; a clip is baked at the rate of its keys, else at 120 Hz; ``decimals`` is the number of
    digits after the point of the motion.

    Raises:
        FormatError: where there is no skeleton, or the place cannot be written.
        UnknownName: for a unit or animation that does not exist.
    """
    if not scene.characters:
        raise FormatError("there is no character to write: ASF holds a skeleton", path=path)
    if decimals is not None and not 0 <= decimals <= 12:
        raise ShapeError(f"decimals: expected 0 to 12, got {decimals}")
    character, notes = scene.characters[0], list[str]()
    notes += [f"character '{other.name}' is not in the file: ASF holds one" for other in scene.characters[1:]]
    if character.parts:
        parts = "1 mesh part is" if len(character.parts) == 1 else f"{len(character.parts)} mesh parts are"
        notes.append(f"{parts} not in the file: ASF holds no meshes")
    known = _Known.of(character)
    unit_m = known.unit_m if unit is None else unit_in_metres(unit)
    with_motion = path.suffix.lower() == ".amc"
    motion = (
        motion_to_write(scene, character, "AMC", _DEFAULT_RATE_HZ, rate_hz, animation, notes)
        if with_motion
        else _at_rest(character.skeleton)
    )
    if not with_motion and scene.animations:
        notes.append(
            "animations are not in the file: ASF holds a skeleton; give a name that ends in .amc to write both"
        )
    body = _body(character.skeleton, motion, notes)
    bones = _bones(body, character.skeleton, known, unit_m)
    table, counts = _table(body, bones, known, unit_m, notes)
    length = known.length if known.length and unit is None else UNITS_M["inch"] / unit_m
    asf = AsfText(known.name, known.version, known.mass or 1.0, length, bones=bones.bones, parents=bones.parents)
    remark = json.dumps(_remark(body, bones, unit_m, known), separators=(",", ":"))
    if bones.added:
        notes.append(
            f"{len(bones.added)} bones without degrees of freedom lead to joints that do not start at their parent's end"
        )
    skeleton_path = path.with_suffix(".ASF" if path.suffix == ".AMC" else ".asf") if with_motion else path
    if not with_motion:
        with replacing(path) as temporary:
            temporary.write_bytes(compose_asf(asf, remark))
        return tuple(notes)
    if decimals is None:
        decimals = min(max(6, int(np.ceil(np.log10(unit_m / _RESOLUTION_M) - 1e-9))), 12)
    first = 1 + max(round(motion.start_s * motion.rate_hz), 0)
    if abs((first - 1) / motion.rate_hz - motion.start_s) > 1e-6:
        notes.append(f"the motion starts at {motion.start_s:g} s; in the file it starts at frame {first}")
    with replacing(skeleton_path) as skeleton_file, replacing(path) as motion_file:
        skeleton_file.write_bytes(compose_asf(asf, remark))
        with motion_file.open("wb") as file:
            said: dict[str, Any] = {"rate_hz": motion.rate_hz}
            if motion.name and motion.name != path.stem:
                said["name"] = motion.name
            names = ["root", *bones.file_names]
            file.writelines(compose_amc(names, counts, table, decimals, first, json.dumps(said)))
    notes.append(f"the skeleton is in {skeleton_path.name}")
    return tuple(notes)


# --- what is remembered of the file that a character came from ----------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Known:
    """How the character's ASF file looked, or the defaults; checked, for extras may have gone through other hands."""

    unit_m: float = UNITS_M["cmu"]
    length: float | None = None
    mass: float | None = None
    name: str = ""
    version: str = ""
    own_axes: bool = True
    bones: Mapping[str, Any] = field(default_factory=dict[str, Any])

    @classmethod
    def of(cls, character: Character) -> _Known:
        stored = character.extras.get("acclaim")
        if not isinstance(stored, Mapping):
            return cls(name=_word(character.name))
        values = cast("Mapping[str, Any]", stored)

        def number(key: str) -> float | None:
            value = values.get(key)
            return float(value) if isinstance(value, (int, float)) and 1e-6 <= value <= 1e6 else None

        def text(key: str) -> str:
            value = values.get(key)
            return re.sub(r"[\x00-\x1f#]", "_", value)[:256] if isinstance(value, str) else ""

        bones = values.get("bones")
        return cls(
            number("unit_m") or UNITS_M["cmu"],
            number("length"),
            number("mass"),
            text("name"),
            text("version"),
            values.get("axes") != "world",
            cast("Mapping[str, Any]", bones) if isinstance(bones, Mapping) else {},
        )

    def bone(self, name: str) -> Mapping[str, Any]:
        stored = self.bones.get(name)
        return cast("Mapping[str, Any]", stored) if isinstance(stored, Mapping) else {}

    def dof(self, name: str) -> tuple[str, ...] | None:
        stored = self.bone(name).get("dof")
        words = tuple(stored.split()) if isinstance(stored, str) else None
        if words is None or not set(words) <= set(DOFS) or len(set(words)) != len(words):
            return None
        return tuple(word for word in words if word != "l")  # a changed length becomes a translation of the children

    def axis(self, name: str) -> tuple[Floats, str] | None:
        angles, order = self.bone(name).get("axis_deg"), self.bone(name).get("axis_order")
        if not isinstance(angles, (list, tuple)) or order not in _ORDERS:
            return None
        numbers: list[Any] = list(cast("Any", angles))
        if len(numbers) != 3 or not all(isinstance(v, (int, float)) and abs(v) < 1e6 for v in numbers):
            return None
        return np.array(numbers, np.float64), str(order)

    def limits(self, name: str, dof: tuple[str, ...], unit_m: float) -> list[tuple[float, float]]:
        stored, own = self.bone(name).get("limits"), self.bone(name).get("dof")
        if not isinstance(stored, (list, tuple)) or not isinstance(own, str) or tuple(own.split()) != dof:
            return []
        limits: list[tuple[float, float]] = []
        pairs: list[Any] = list(cast("Any", stored))
        for channel, pair in zip(dof, pairs, strict=False):
            if not isinstance(pair, (list, tuple)) or len(cast("list[Any]", pair)) != 2:
                return []
            low, high = cast("Any", pair)
            scale = 1.0 if channel.startswith("r") else unit_m
            if not all(v is None or isinstance(v, (int, float)) for v in (low, high)):
                return []
            limits.append((-np.inf if low is None else low / scale, np.inf if high is None else high / scale))
        return limits if len(limits) == len(dof) else []


# --- the skeleton and its motion as Acclaim sees them -----------------------------------------------------------------------


@dataclass(slots=True)
class _Body:
    """Joints below one root, without scale. ``frames`` (J, 4) are world from joint at rest, ``offsets`` (J, 3) from parent
    to joint in the world's axes at rest, ``locals`` (T, J, 4) and ``translations`` (T, J, 3) as in a pose; metres."""

    names: list[str]
    parents: list[int]
    rest_rotations: Floats
    rest_translations: Floats
    frames: Floats
    offsets: Floats
    tips: dict[int, Floats]
    locals: Floats
    translations: Floats


@dataclass(slots=True)
class _Bones:
    """The bones of the file in its order; ``joints`` has each one's joint, -1 for those that are only put between."""

    bones: list[AsfBone] = field(default_factory=list[AsfBone])
    parents: list[int] = field(default_factory=list[int])
    joints: list[int] = field(default_factory=list[int])
    axes: list[Any] = field(default_factory=list[Any])  # (4,) each, world from bone at rest
    added: list[str] = field(default_factory=list[str])

    @property
    def file_names(self) -> list[str]:
        return [bone.name for bone in self.bones]


def _at_rest(skeleton: Skeleton, rate_hz: float = _DEFAULT_RATE_HZ) -> Motion:
    rest = skeleton.rest
    return Motion(skeleton.names, Pose(rest.translations[None], rest.rotations[None], rest.scales[None]), rate_hz)


def _body(skeleton: Skeleton, motion: Motion, notes: list[str]) -> _Body:
    rest, pose = skeleton.rest, motion.pose.broadcast()
    parents = [int(p) for p in skeleton.parents]
    names = list(skeleton.names)
    rotations = np.asarray(pose.rotations, np.float64)
    translations = np.asarray(pose.translations, np.float64)
    rest_translations = np.asarray(rest.translations, np.float64)
    rest_rotations = np.asarray(rest.rotations, np.float64)
    tips = {joint: np.array(tip, np.float64) for joint, tip in reversed(skeleton.end_offsets)}
    if any(np.abs(np.asarray(p.scales) - 1).max(initial=0.0) > 1e-5 for p in (pose, rest)):  # more than rounding
        notes.append("joints are scaled: ASF has no scale, so the bones below them were lengthened instead")
        translations, _ = _lengthened(parents, translations, np.asarray(pose.scales, np.float64))
        rest_translations, sizes = _lengthened(parents, rest_translations, np.asarray(rest.scales, np.float64))
        tips = {joint: tip * sizes[joint] for joint, tip in tips.items()}
    roots = [joint for joint, parent in enumerate(parents) if parent < 0]
    if len(roots) != 1:
        notes.append(f"the {len(roots)} roots were put below a new one")
        one = np.array((1.0, 0.0, 0.0, 0.0))
        name = "world"
        while name in names:
            name += "_"
        names = [name, *names]
        parents = [-1, *(parent + 1 for parent in parents)]
        rest_translations = np.concatenate([np.zeros((1, 3)), rest_translations])
        rest_rotations = np.concatenate([one[None], rest_rotations])
        frames = len(rotations)
        translations = np.concatenate([np.zeros((frames, 1, 3)), translations], axis=1)
        rotations = np.concatenate([np.broadcast_to(one, (frames, 1, 4)), rotations], axis=1)
        tips = {joint + 1: tip for joint, tip in tips.items()}
    frames_at_rest: Any = np.empty((len(names), 4))
    offsets: Any = np.array(rest_translations)
    for joint, parent in enumerate(parents):
        if parent < 0:
            frames_at_rest[joint] = rest_rotations[joint]
        else:
            frames_at_rest[joint] = quat.multiply(frames_at_rest[parent], rest_rotations[joint])
            offsets[joint] = quat.rotate(frames_at_rest[parent], offsets[joint])
    frames_at_rest = np.asarray(quat.normalize(frames_at_rest))
    tips = {joint: np.asarray(quat.rotate(frames_at_rest[joint], tip)) for joint, tip in tips.items()}
    return _Body(
        names, parents, rest_rotations, rest_translations, frames_at_rest, offsets, tips, rotations, translations
    )


def _lengthened(parents: list[int], translations: Floats, scales: Floats) -> tuple[Floats, Floats]:
    """Translations multiplied by the mean scales above them, and each joint's own (*B, J)."""
    sizes = np.cbrt(np.abs(scales).prod(axis=-1))
    translations = np.array(translations)
    for joint, parent in enumerate(parents):
        if parent >= 0:
            translations[..., joint, :] *= sizes[..., parent, None]
            sizes[..., joint] *= sizes[..., parent]
    return translations, sizes


def _bones(body: _Body, skeleton: Skeleton, known: _Known, unit_m: float) -> _Bones:
    """Depth-first, children in their old order."""
    children: list[list[int]] = [[] for _ in body.names]
    for joint, parent in enumerate(body.parents):
        if parent >= 0:
            children[parent].append(joint)
    taken = {"root"}
    result = _Bones()
    ends: dict[int, Floats] = {0: np.zeros(3)}
    place = {0: -1}
    for joint in depth_first(body.parents)[1:].tolist():
        parent = body.parents[joint]
        name = _unique(_word(body.names[joint]), taken)
        above = place[parent]
        gap = body.offsets[joint] - ends[parent]
        if np.linalg.norm(gap) > _SAME_PLACE_M:
            above = _add(result, AsfBone(_unique(f"{name}_start", taken)), above, -1, gap, unit_m)
            result.added.append(result.bones[above].name)
        end = _end(joint, children[joint], body)
        bone = AsfBone(name)
        axis = known.axis(body.names[joint])
        if axis is None:
            angles = np.degrees(np.asarray(euler.from_quat(body.frames[joint], "xyz")))
            axis = np.where(np.abs(angles) < 1e-10, 0.0, angles), "XYZ"
        bone.axis, bone.axis_order = _vector(axis[0]), axis[1]
        stored = known.bone(body.names[joint])
        bone.mass = {k: float(stored[k]) for k in ("bodymass", "cofmass") if isinstance(stored.get(k), (int, float))}
        place[joint] = _add(result, bone, above, joint, end, unit_m)
        ends[joint] = end
    return result


def _end(joint: int, children: list[int], body: _Body) -> Floats:
    """Where a bone ends: where most of its children start, else its tip."""
    if not children:
        return body.tips.get(joint, np.zeros(3))
    starts = body.offsets[children]
    near = (
        np.linalg.norm(starts[:, None] - starts[None], axis=-1) <= _SAME_PLACE_M
        if len(children) < 256
        else np.eye(len(children), dtype=bool)
    )
    return starts[int(np.argmax(near.sum(axis=1)))]


def _add(result: _Bones, bone: AsfBone, above: int, joint: int, vector: Floats, unit_m: float) -> int:
    length = float(np.linalg.norm(vector))
    bone.direction = _vector(vector / length) if length else (0.0, 0.0, 1.0)
    bone.length = length / unit_m
    result.bones.append(bone)
    result.parents.append(above)
    result.joints.append(joint)
    angles = np.radians(np.array(bone.axis))
    result.axes.append(np.asarray(euler.to_quat(angles, bone.axis_order.lower())))
    return len(result.bones) - 1


def _table(body: _Body, bones: _Bones, known: _Known, unit_m: float, notes: list[str]) -> tuple[Floats, list[int]]:
    """The numbers (T, C) of all bones in degrees and file units, and how many each has; gives the bones their dof."""
    joints = [0, *bones.joints]
    frames = len(body.locals)
    turns = np.zeros((frames, len(joints), 4))
    turns[..., 0] = 1.0
    slides = np.zeros((frames, len(joints), 3))
    for index, joint in enumerate(joints):
        if joint < 0:
            continue
        axes = bones.axes[index - 1] if index else np.array((1.0, 0.0, 0.0, 0.0))
        inner = quat.multiply(quat.conjugate(body.frames[joint]), axes)
        relative = quat.multiply(quat.conjugate(body.rest_rotations[joint]), body.locals[:, joint])
        turns[:, index] = quat.multiply(quat.multiply(quat.conjugate(inner), relative), inner)
        moved = body.translations[:, joint] - body.rest_translations[joint] * (index > 0)
        if index:
            above = body.frames[body.parents[joint]]
            moved = quat.rotate(quat.multiply(quat.conjugate(axes), above), moved)
        slides[:, index] = moved
    turns = np.ascontiguousarray(quat.normalize(turns))
    sliding = np.abs(slides).max(axis=(0, 2), initial=0.0) > _NO_MOVE_M
    dofs: list[tuple[str, ...]] = [_ROOT_DOF]
    for index, joint in enumerate(bones.joints, 1):
        dof = known.dof(body.names[joint]) if joint >= 0 else ()
        dof = _BONE_DOF if dof is None else dof
        if sliding[index]:
            dof = ("tx", "ty", "tz", *(d for d in dof if d.startswith("r")))
        dofs.append(dof)
    where = _layout(dofs)
    values = np.zeros((frames, where.column_count))
    lost = write_degrees(values, turns, where)
    turned = np.nonzero((lost > _NO_TURN_DEG).any(axis=1))[0]
    if len(turned):  # bones with less than three angles turn about other axes too
        for index in turned:
            dofs[index] = (*(d for d in dofs[index] if d.startswith("t")), *_BONE_DOF)
        where = _layout(dofs)
        values = np.zeros((frames, where.column_count))
        write_degrees(values, turns, where)
    for index in where.moving:
        for axis in range(3):
            column = where.position_columns[index, axis]
            if column < where.column_count:
                values[:, column] = slides[:, index, axis] / unit_m
    gained = [bones.bones[i - 1].name for i, joint in enumerate(joints) if i and sliding[i] and joint >= 0]
    if gained:
        notes.append(f"{len(gained)} bones slide (tx ty tz), which other programs may not know: {gained[0]}")
    changed = 0
    for bone, joint, dof in zip(bones.bones, bones.joints, dofs[1:], strict=True):
        bone.dof = dof
        bone.limits = known.limits(body.names[joint], dof, unit_m) if joint >= 0 else []
        before = known.dof(body.names[joint]) if joint >= 0 else None
        changed += before is not None and before != dof
    if changed:
        notes.append(
            f"{changed} bones got degrees of freedom they did not have, for they move; their limits are left out"
        )
    return values, [len(dof) for dof in dofs]


def _layout(dofs: list[tuple[str, ...]]) -> Layout:
    count = sum(map(len, dofs))
    rotations = np.full((len(dofs), 3), count, np.intp)
    positions = np.full((len(dofs), 3), count, np.intp)
    orders: list[str] = []
    column = 0
    for index, dof in enumerate(dofs):
        turns: list[tuple[str, int]] = []
        for channel in dof:
            if channel.startswith("r"):
                turns.insert(0, (channel[1].upper(), column))  # the first is applied first: the last factor
            else:
                positions[index, "xyz".index(channel[1])] = column
            column += 1
        for k, (_, at) in enumerate(turns):
            rotations[index, k] = at
        order = "".join(axis for axis, _ in turns)
        orders.append(order + "".join(axis for axis in "ZYX" if axis not in order))
    return Layout(tuple(orders), rotations, positions, count)


def _remark(body: _Body, bones: _Bones, unit_m: float, known: _Known) -> dict[str, Any]:
    """What the format cannot say of this rig."""
    remark: dict[str, Any] = {"unit_m": unit_m}
    if body.names[0] != "root":
        remark["root"] = body.names[0]
    plain = np.array((1.0, 0.0, 0.0, 0.0))
    if known.own_axes and np.abs(np.abs(body.frames @ plain) - 1).max() > 1e-12:
        remark["axes"] = "bone"
        remark["root_axes"] = [float(v) for v in body.frames[0]]
    if np.any(body.rest_translations[0]):
        remark["root_position"] = [float(v) for v in body.rest_translations[0]]
    if bones.added:
        remark["added"] = bones.added
    return remark


def _word(name: str) -> str:
    """A name that the format can hold: one word without comment signs, colons or braces."""
    return re.sub(r"[\s#:(){}\x00-\x1f\x7f\x85\u2028\u2029]+", "_", name)[:128] or "joint"


def _unique(name: str, taken: set[str]) -> str:
    if name[0].isdigit():
        name = f"_{name}"
    stem, count = name, 1
    while name in taken:
        count += 1
        name = f"{stem}_{count}"
    taken.add(name)
    return name


def _vector(values: Floats) -> Vector:
    return float(values[0]), float(values[1]), float(values[2])
