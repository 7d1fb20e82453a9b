"""Writing BVH: any skeleton with a motion or clip.

What another BVH file looked like (channels, unit, up axis, names) is taken over from ``extras["bvh"]`` of the character;
a character of other origin is written in centimetres, Y up, with six channels for roots and three for joints.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, cast

import numpy as np

from keypose.arrays import Floats, Ints
from keypose.errors import FormatError, ShapeError, UnknownName
from keypose.io.atomic import replacing
from keypose.io.axes import checked_up, unit_in_metres, y_up_rotation
from keypose.io.bvh_channels import Flags, child_positions_rule, layout, root_positions_rule, write_degrees
from keypose.io.bvh_hierarchy import BvhJoint, Hierarchy
from keypose.io.bvh_text import compose
from keypose.io.joint_motion import depth_first, motion_to_write
from keypose.math import quat
from keypose.model import Character, Motion, Pose, Scene, Skeleton

_ORDERS = ("XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYX")
_POSITIONS = ("Xposition", "Yposition", "Zposition")
_CHANNELS = frozenset((*_POSITIONS, "Xrotation", "Yrotation", "Zrotation"))
_DEFAULT_RATE_HZ = 30.0
# A position is written to 1e-8 m, an angle to 1e-6 degrees: along a chain of ten joints the errors stay below the
# promised 1e-3 mm. Deeper chains get one digit more.
_RESOLUTION_M = 1e-8
_DEEP_CHAIN = 24
_NO_MOVE_M = 1e-8
_NO_TURN_DEG = 1e-6
_ROWS_AT_ONCE = 64


def write(
    scene: Scene,
    path: Path,
    *,
    unit: str | float | None = None,
    up: str | None = None,
    order: str | None = None,
    rate_hz: float | None = None,
    decimals: int | None = None,
    animation: str | None = None,
) -> tuple[str, ...]:
    """Write the first character of a scene with one of its motions or clips; returns notes of what was left out.

    Shapes and units: ``unit`` is a name ("cm") or metres per file unit; ``up`` is "X", "Y" or "Z"; ``order`` the
    rotation order of all joints ("ZYX" means channels Zrotation Yrotation Xrotation). Without these a character that
    came from BVH is written as it was read, others in cm, Y up, ZYX. ``rate_hz`` resamples; a clip is baked at the
    rate of its keys, else at 30 Hz. ``decimals`` is the number of digits after the point.

    Raises:
        FormatError: where there is no skeleton, or the place cannot be written.
        UnknownName: for a unit, axis, order or animation that does not exist.
    """
    if not scene.characters:
        raise FormatError("there is no character to write: a BVH file needs a skeleton", path=path)
    if order is not None and order not in _ORDERS:
        raise UnknownName("rotation order", order, _ORDERS)
    if decimals is not None and not 0 <= decimals <= 9:
        raise ShapeError(f"decimals: expected 0 to 9, got {decimals}")
    notes: list[str] = []
    character = scene.characters[0]
    notes += [f"character '{other.name}' is not in the file: BVH holds one" for other in scene.characters[1:]]
    if character.parts:
        parts = "1 mesh part is" if len(character.parts) == 1 else f"{len(character.parts)} mesh parts are"
        notes.append(f"{parts} not in the file: BVH holds no meshes")
    remembered = _Remembered.of(character)
    motion = motion_to_write(scene, character, "BVH", _DEFAULT_RATE_HZ, rate_hz, animation, notes)
    unit_m, up = written_as(character, unit=unit, up=up)
    body = _body(character, motion, remembered, up, notes)
    hierarchy, values = _table(body, remembered, order, unit_m, notes)
    same_rate = remembered.frame_time and remembered.rate_hz == motion.rate_hz
    frame_time = remembered.frame_time if same_rate else f"{1 / motion.rate_hz:.12g}"
    if decimals is None:
        digits = int(np.ceil(np.log10(unit_m / _RESOLUTION_M) - 1e-9))
        decimals = min(max(6, digits) + (_depth(body.parents) > _DEEP_CHAIN), 9)
    with replacing(path) as temporary, temporary.open("wb") as file:
        file.writelines(compose(hierarchy, frame_time, values, decimals))
    return tuple(notes)


def written_as(character: Character, *, unit: str | float | None = None, up: str | None = None) -> tuple[float, str]:
    """The unit in metres and the up axis that `write` uses for a character, which no BVH file can say."""
    remembered = _Remembered.of(character)
    return (
        remembered.unit_m if unit is None else unit_in_metres(unit),
        remembered.up if up is None else checked_up(up),
    )


@dataclass(frozen=True, slots=True)
class _Remembered:
    """How the character's BVH file looked, or the defaults; checked, for extras may have gone through other hands."""

    unit_m: float = 0.01
    up: str = "Y"
    rest_turned: bool = True
    channels: Mapping[str, Any] = field(default_factory=dict[str, Any])
    file_names: Mapping[str, Any] = field(default_factory=dict[str, Any])
    child_positions: str = "replace"
    added_roots: Sequence[str] = ()
    frame_time: str = ""
    rate_hz: float = 0.0
    known: bool = False

    @classmethod
    def of(cls, character: Character) -> _Remembered:
        stored = character.extras.get("bvh")
        if not isinstance(stored, Mapping):
            return cls()
        values = cast("Mapping[str, Any]", stored)
        plain = cls(known=True)
        checks = {
            "unit_m": lambda v: isinstance(v, (int, float)) and 1e-9 < v < 1e9,
            "up": lambda v: v in ("X", "Y", "Z"),
            "rest_turned": lambda v: isinstance(v, bool),
            "channels": lambda v: isinstance(v, Mapping),
            "file_names": lambda v: isinstance(v, Mapping),
            "child_positions": lambda v: v in ("replace", "add"),
            "added_roots": lambda v: isinstance(v, (list, tuple)),
            "frame_time": lambda v: isinstance(v, str) and re.fullmatch(r"[0-9.]{1,32}", v) is not None,
            "rate_hz": lambda v: isinstance(v, (int, float)),
        }
        return replace(plain, **{k: values[k] for k, fits in checks.items() if k in values and fits(values[k])})

    def channels_of(self, joint: str) -> tuple[str, ...] | None:
        """The channels that a joint had; None where they are not known."""
        stored = self.channels.get(joint, "")
        names = tuple(stored.split()) if isinstance(stored, str) else ()
        if joint not in self.channels or len(set(names)) != len(names) or not _CHANNELS.issuperset(names):
            return None
        return names

    def has_channels_line(self, joint: str) -> bool:
        """Whether the joint had a CHANNELS line at all."""
        return self.channels.get(joint, "") is not None


@dataclass(slots=True)
class _Body:
    """A skeleton in depth-first order with its motion, in the file's axes, in metres."""

    names: list[str]
    parents: Ints  # (J,)
    offsets: Floats  # (J, 3)
    ends: list[tuple[int, tuple[float, float, float]]]
    translations: Floats  # (T, J, 3)
    rotations: Floats  # (T, J, 4)


def _body(character: Character, motion: Motion, remembered: _Remembered, up: str, notes: list[str]) -> _Body:
    """Everything turned into the file's space, in the order the file has it."""
    skeleton = character.skeleton
    pose, rest = motion.pose, skeleton.rest
    rotations = np.broadcast_to(pose.rotations, (motion.frame_count, *pose.rotations.shape[-2:]))
    translations = np.broadcast_to(pose.translations, (motion.frame_count, *pose.translations.shape[-2:]))
    offsets = np.array(rest.translations, np.float64)
    ends = [(joint, np.array(offset)) for joint, offset in skeleton.end_offsets]
    if np.any(pose.scales != 1) or np.any(rest.scales != 1):
        translations, offsets, ends = _without_scales(skeleton, pose, translations, offsets, ends, notes)
    order = depth_first(skeleton.parents)
    place = np.empty(len(order), np.intp)
    place[order] = np.arange(len(order))
    parents = np.where(skeleton.parents[order] >= 0, place[skeleton.parents[order]], -1)
    sorted_already = bool((order == np.arange(len(order))).all())
    if not sorted_already:
        rotations, translations, offsets = rotations[:, order], translations[:, order], offsets[order]
    if up != "Y":
        to_file = quat.conjugate(y_up_rotation(up))
        roots = parents < 0
        rotations, translations = np.array(rotations), np.array(translations)
        rotations[:, roots] = quat.multiply(to_file, rotations[:, roots])
        translations[:, roots] = quat.rotate(to_file, translations[:, roots])
        if remembered.rest_turned:
            offsets[roots] = quat.rotate(to_file, offsets[roots])
    body = _Body(
        [skeleton.names[j] for j in order],
        parents,
        offsets,
        [(int(place[joint]), cast("Any", tuple(offset.tolist()))) for joint, offset in ends],
        translations,
        rotations,
    )
    if np.count_nonzero(parents < 0) > 1 and not remembered.known:
        body = _joined(body, notes)
    return body


def _table(
    body: _Body, remembered: _Remembered, order: str | None, unit_m: float, notes: list[str]
) -> tuple[Hierarchy, Floats]:
    """The joints with their channels, in the file's unit, and the numbers (T, C) of all frames."""
    count = len(body.names)
    channels = [
        _channels(remembered, name, parent < 0, order) for name, parent in zip(body.names, body.parents, strict=True)
    ]
    moved = _largest_move(body) > _NO_MOVE_M
    gained: list[str] = []
    for joint in range(count):
        if moved[joint] and sum(name in channels[joint] for name in _POSITIONS) < 3:
            channels[joint] = (*_POSITIONS, *(c for c in channels[joint] if c not in _POSITIONS))
            gained.append(body.names[joint])
    where = layout(channels)
    values = np.empty((len(body.rotations), where.column_count))
    lost = write_degrees(values, body.rotations, where)
    turned = np.nonzero((lost > _NO_TURN_DEG).any(axis=1))[0]
    if len(turned):  # joints with less than three rotation channels turn about other axes too
        for joint in turned:
            kept = tuple(c for c in channels[joint] if c in _POSITIONS)
            channels[joint] = (*kept, *(f"{axis}rotation" for axis in where.orders[joint]))
            gained.append(body.names[joint])
        where = layout(channels)
        values = np.empty((len(body.rotations), where.column_count))
        write_degrees(values, body.rotations, where)
    if gained and remembered.known:
        got = "1 joint got" if len(gained) == 1 else f"{len(gained)} joints got"
        notes.append(f"{got} channels that were not there, for movement: {_listed(gained)}")
    adds = _adds(body, where.position_columns < where.column_count, remembered, notes)
    for joint in where.moving:
        for axis in range(3):
            column = where.position_columns[joint, axis]
            if column < where.column_count:
                base = body.offsets[joint, axis] if adds[joint] else 0.0
                values[:, column] = (body.translations[:, joint, axis] - base) / unit_m
    hierarchy = Hierarchy(
        [
            BvhJoint(
                _file_name(name, remembered, notes),
                int(body.parents[j]),
                _in_unit(body.offsets[j], unit_m),
                channels[j] if channels[j] or remembered.has_channels_line(name) else None,
            )
            for j, name in enumerate(body.names)
        ],
        [(joint, _in_unit(np.array(offset), unit_m)) for joint, offset in _ends(body, remembered)],
    )
    return hierarchy, values


def _largest_move(body: _Body) -> Floats:
    """How far each joint's translation gets from its OFFSET along any axis, (J,)."""
    if not len(body.translations):
        return np.zeros(len(body.offsets))
    table = body.translations.reshape(len(body.translations), -1)
    high, low = (_reduced(f, table).reshape(-1, 3) for f in (np.maximum, np.minimum))
    return np.maximum(high - body.offsets, body.offsets - low).max(axis=1)


def _reduced(function: np.ufunc, table: Floats) -> Floats:
    """``function.reduce`` of the rows (T, C): many rows side by side, for NumPy is slow on short ones."""
    rows = len(table) // _ROWS_AT_ONCE * _ROWS_AT_ONCE
    rest = function.reduce(table[rows:], axis=0) if rows < len(table) else table[0]
    if not rows:
        return rest
    wide = function.reduce(table[:rows].reshape(rows // _ROWS_AT_ONCE, -1), axis=0)
    return function(rest, function.reduce(wide.reshape(_ROWS_AT_ONCE, -1), axis=0))


def _channels(remembered: _Remembered, name: str, is_root: bool, order: str | None) -> tuple[str, ...]:
    known = remembered.channels_of(name)
    if known is None:
        rotations = tuple(f"{axis}rotation" for axis in (order or "ZYX"))
        return (*_POSITIONS, *rotations) if is_root else rotations
    if order is None:
        return known
    turned = iter(f"{axis}rotation" for axis in order)
    count = sum(c not in _POSITIONS for c in known)
    if count < 3:  # fewer axes than the order names: put all three behind the positions
        return (*(c for c in known if c in _POSITIONS), *(turned if count else ()))
    return tuple(c if c in _POSITIONS else next(turned) for c in known)


def _adds(body: _Body, has_position: Flags, remembered: _Remembered, notes: list[str]) -> Flags:
    """Which joints' positions are written as changes of OFFSET, (J,): so that the reader's rules understand them.

    A root whose positions the reader would misunderstand loses its OFFSET instead.
    """
    is_root = body.parents < 0
    adds = np.zeros(len(body.parents), bool)
    if not len(body.translations):
        return adds
    moving = np.nonzero(has_position.any(axis=1) & ~is_root)[0]
    if len(moving):
        offsets = np.where(has_position[moving], body.offsets[moving], 0.0)
        means = np.where(has_position[moving], body.translations[:, moving].mean(axis=0), 0.0)
        forms = {"replace": means, "add": means - offsets}
        margins: dict[str, float] = {}
        for form, written in forms.items():
            rule, margin = child_positions_rule(offsets, written)
            margins[form] = margin if rule == form else -1.0
        form = remembered.child_positions
        if margins[form] <= 0 and np.any(offsets):
            form = max(margins, key=lambda key: margins[key])
        adds[moving] = form == "add"
    frames = np.unique(np.linspace(0, len(body.translations) - 1, 9).astype(np.intp))
    for root in np.nonzero(is_root & has_position.any(axis=1))[0]:
        offset = np.where(has_position[root], body.offsets[root], 0.0)
        length = float(np.linalg.norm(offset))
        adds[root] = body.names[root] in remembered.added_roots
        if length == 0:
            continue
        written = body.translations[frames, root] - (offset if adds[root] else 0.0)
        if written.mean(axis=0) @ offset > 0.6 * length**2 and not adds[root]:
            continue  # clearly around OFFSET: no need to look where the ground is
        lowest = (_positions(body, frames, int(root)) @ (offset / length)).min(axis=1)
        lowest = lowest - (length if adds[root] else 0.0)
        if root_positions_rule(offset, written, lowest) != ("add" if adds[root] else "replace"):
            adds[root] = False
            body.offsets[root] = 0.0
            notes.append(
                f"OFFSET of root '{body.names[root]}' is written as 0, for readers might add it to its positions"
            )
    return adds


def _positions(body: _Body, frames: Ints, root: int) -> Floats:
    """Positions (F, N, 3) of the root and everything below it in some frames."""
    from keypose.evaluate import world_rotations_positions

    belongs = np.zeros(len(body.parents), bool)
    for joint, parent in enumerate(body.parents):
        belongs[joint] = joint == root or (parent >= 0 and belongs[parent])
    rest = Pose(body.offsets, np.tile((1.0, 0.0, 0.0, 0.0), (len(belongs), 1)), np.ones((len(belongs), 3)))
    skeleton = Skeleton(tuple(map(str, range(len(belongs)))), body.parents, rest)
    pose = Pose(body.translations[frames], body.rotations[frames], rest.scales)
    return np.asarray(world_rotations_positions(skeleton, pose)[1])[:, belongs]


def _without_scales(
    skeleton: Skeleton,
    pose: Pose,
    translations: Floats,
    offsets: Floats,
    ends: list[tuple[int, Floats]],
    notes: list[str],
) -> tuple[Floats, Floats, list[tuple[int, Floats]]]:
    """Translations, offsets and ends multiplied by the scales above them, so that no joint moves."""
    scales = np.broadcast_to(pose.scales, translations.shape)
    if np.abs(scales - 1).max(initial=0.0) < 1e-5:  # rounding
        return translations, offsets, ends
    if np.ptp(scales, axis=-1).max(initial=0.0) > 1e-6:
        notes.append("joints are scaled differently along their axes: BVH has no scale, their mean was used")
    else:
        notes.append("joints are scaled: BVH has no scale, so the bones below them were lengthened instead")
    factors = np.cbrt(np.abs(scales).prod(axis=-1))
    rest_factors = np.cbrt(np.abs(skeleton.rest.scales).prod(axis=-1))
    translations, offsets, ends = np.array(translations), offsets.copy(), list(ends)
    for joint, parent in enumerate(skeleton.parents):
        if parent >= 0:
            translations[:, joint] *= factors[:, parent, None]
            offsets[joint] *= rest_factors[parent]
            factors[:, joint] *= factors[:, parent]
            rest_factors[joint] *= rest_factors[parent]
    return translations, offsets, [(joint, offset * rest_factors[joint]) for joint, offset in ends]


def _joined(body: _Body, notes: list[str]) -> _Body:
    """The same body with all its roots below a new one: most BVH readers know only one ROOT."""
    name = "Root"
    while name in body.names:
        name += "_"
    notes.append(f"the {int(np.count_nonzero(body.parents < 0))} roots were put below a new one, '{name}'")
    frames = len(body.rotations)
    still = np.broadcast_to(np.array((1.0, 0.0, 0.0, 0.0)), (frames, 1, 4))
    return _Body(
        [name, *body.names],
        np.concatenate([[-1], body.parents + 1]),
        np.concatenate([np.zeros((1, 3)), body.offsets]),
        [(joint + 1, offset) for joint, offset in body.ends],
        np.concatenate([np.zeros((frames, 1, 3)), body.translations], axis=1),
        np.concatenate([still, body.rotations], axis=1),
    )


def _in_unit(vector: Floats, unit_m: float) -> tuple[float, float, float]:
    x, y, z = (vector / unit_m).tolist()
    return x, y, z


def _ends(body: _Body, remembered: _Remembered) -> list[tuple[int, tuple[float, float, float]]]:
    """The end sites; a leaf without one gets one of no length where the file never was a BVH: readers expect it."""
    if remembered.known:
        return body.ends
    ended = {joint for joint, _ in body.ends}
    leaves = sorted(set(range(len(body.names))) - set(body.parents.tolist()) - ended)
    return [*body.ends, *((leaf, (0.0, 0.0, 0.0)) for leaf in leaves)]


def _file_name(name: str, remembered: _Remembered, notes: list[str]) -> str:
    stored = remembered.file_names.get(name, name)
    name = stored if isinstance(stored, str) else name
    clean = re.sub(r"[\x00-\x1f{}\x7f\x85\u2028\u2029]", "_", name).strip()
    if clean != name:
        notes.append(f"joint {name!r} is called '{clean}' in the file: BVH names hold no braces or line ends")
    return clean


def _depth(parents: Ints) -> int:
    depths = [0] * len(parents)
    for joint, parent in enumerate(parents):
        depths[joint] = depths[parent] + 1 if parent >= 0 else 0
    return max(depths, default=0)


def _listed(names: Sequence[str]) -> str:
    return ", ".join(f"'{name}'" for name in names[:5]) + (", …" if len(names) > 5 else "")
