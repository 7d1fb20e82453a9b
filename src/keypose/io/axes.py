"""Units and axes: the only place where they change between a file and keypose (metres, Y up).

Formats that say their unit and axes are converted; for those that do not (BVH), both are guessed from the skeleton
and its motion, and every guess comes with a sentence for the scene's notes.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from math import log

import numpy as np

from keypose.arrays import Array, Floats, Ints
from keypose.errors import ShapeError, UnknownName
from keypose.math import quat
from keypose.model import Pose

UNITS_M: dict[str, float] = {
    "m": 1.0,
    "foot": 0.3048,
    "dm": 0.1,
    "cmu": 0.0254 / 0.45,
    "inch": 0.0254,
    "cm": 0.01,
    "mm": 0.001,
}
"""Metres per unit. ``cmu`` is the length unit of the CMU motion capture database, 1/0.45 inch."""

UP_AXES = ("X", "Y", "Z")

# Of a standing human the longest path through the skeleton, hand to opposite toes, is 1.5 times the stature; it does
# not depend on the pose. A skeleton is taken for the stature of 1.6 m in the middle between a child and a tall adult.
_PATH_PER_STATURE = 1.5
_STATURE_M = 1.6
_FEWEST_JOINTS, _FEWEST_TIPS = 10, 4
_MOST_JOINTS = 4096

_SMALLEST_M, _LARGEST_M = 0.02, 5.0  # of a mesh whose file names no unit
_UPRIGHT = 0.8  # cosine between the direction from feet to head and an axis
_HEAD_WORDS = ("head",)
_FOOT_WORDS = ("foot", "toe", "ankle")


def unit_in_metres(unit: str | float) -> float:
    """Metres per unit, from a name of `UNITS_M` or a number.

    Raises:
        UnknownName: for a name that is no unit.
        ShapeError: for a number that is not positive.
    """
    if isinstance(unit, str):
        if unit not in UNITS_M:
            raise UnknownName("unit", unit, UNITS_M)
        return UNITS_M[unit]
    if not (np.isfinite(unit) and unit > 0):
        raise ShapeError(f"unit: expected metres per unit, a positive number, got {unit}")
    return float(unit)


def unit_name(unit_m: float) -> str:
    """The unit's name where it has one, else its size, for notes: ``cm``, ``0.02 m``."""
    return next((name for name, size in UNITS_M.items() if abs(size / unit_m - 1) < 1e-6), f"{unit_m:g} m")


def checked_up(up: str) -> str:
    """``X``, ``Y`` or ``Z``; raises `UnknownName` for anything else."""
    if up.upper() not in UP_AXES:
        raise UnknownName("up axis", up, (*UP_AXES, "auto"))
    return up.upper()


def y_up_rotation(up: str) -> Floats:
    """The rotation (4,) that turns a world whose ``up`` axis points up into a Y-up world.

    A character that faces -Y in a Z-up world, as authoring tools have it, then faces +Z.
    """
    half = np.sqrt(0.5)
    return np.array({"X": (half, 0, 0, half), "Y": (1, 0, 0, 0), "Z": (half, -half, 0, 0)}[up], np.float64)


def turn_roots(pose: Pose, parents: Ints, rotation: Array) -> Pose:
    """The pose with its world turned: only what the roots do changes.

    Shapes and units: a pose of batch shape (*B,), ``rotation`` (4,).
    """
    roots = np.asarray(parents) < 0
    translations, rotations = np.array(pose.translations), np.array(pose.rotations)
    translations[..., roots, :] = quat.rotate(rotation, translations[..., roots, :])
    rotations[..., roots, :] = quat.multiply(rotation, rotations[..., roots, :])
    return replace(pose, translations=translations, rotations=rotations)


def guess_unit(parents: Sequence[int], translations: Floats, ends: Sequence[tuple[int, Floats]]) -> tuple[float, str]:
    """Metres per unit of a skeleton that does not say, and the note that tells of the guess.

    Shapes and units: ``translations`` (J, 3) from parent to joint; ``ends`` the tips, from their joint; file units.
    """
    lengths = np.linalg.norm(translations, axis=-1)
    tips = [(joint, float(np.linalg.norm(offset))) for joint, offset in ends]
    path, tip_count = _longest_path(parents, lengths, tips)
    if len(parents) < _FEWEST_JOINTS or tip_count < _FEWEST_TIPS or path == 0:
        return 0.01, "unit: the file names none and the skeleton is no human's; taken as cm"
    stature = path / _PATH_PER_STATURE
    name = min(UNITS_M, key=lambda unit: abs(log(stature * UNITS_M[unit] / _STATURE_M)))
    unit_m = UNITS_M[name]
    return unit_m, (
        f"unit: the file names none; taken as {name} ({unit_m:.6g} m), which makes the skeleton {stature * unit_m:.2f} m tall"
    )


def guess_mesh_unit(extent: float) -> tuple[float, str]:
    """Metres per unit of a mesh that does not say, and the note that tells of the guess.

    Shapes and units: ``extent`` is the longest side of its box in file units. The first of metre, centimetre and
    millimetre is taken that makes it a thing one can hold, wear or ride on.
    """
    name = next((u for u in ("m", "cm", "mm") if _SMALLEST_M <= extent * UNITS_M[u] <= _LARGEST_M), "m")
    size = f"{extent * UNITS_M[name]:.3g} m"
    return UNITS_M[name], f"unit: the file names none; taken as {name}, which makes the longest side {size}"


def guess_up(names: Sequence[str], rest: Floats, frames: Floats) -> tuple[str, str, str]:
    """The up axis of the world, the up axis of the rest pose, and the note that tells of the guess.

    Shapes and units: ``rest`` (J, 3) and ``frames`` (F, J, 3) are joint positions in the file's space, F may be 0.

    A rest pose and a motion that both stand along Z make a Z-up world. A motion that stands along Z over a rest pose
    along Y does so only if it stands there nearly always and on the ground; otherwise somebody may be lying.
    """
    if len(names) > _MOST_JOINTS:
        return "Y", "Y", "up axis: too many joints to judge; taken as Y"
    rest_standing = _standing(names, rest[None])
    rest_up = next((axis for axis in "YZ" if rest_standing[axis] > 0.5), "Y")
    if not len(frames):
        return rest_up, rest_up, f"up axis: the file names none; taken as {rest_up}, along which the rest pose stands"
    standing = _standing(names, frames)
    along_z = frames[..., 2]
    height = float(np.median(np.ptp(along_z, axis=1)))
    grounded = abs(float(np.median(along_z.min(axis=1)))) < 0.25 * height
    is_z = standing["Z"] > 0.5 and (rest_up == "Z" or (standing["Z"] > 0.8 and grounded))
    if is_z:
        return "Z", rest_up, "up axis: the file names none; taken as Z, along which the character stands in the motion"
    if standing["Y"] <= 0.5:
        return rest_up, rest_up, f"up axis: the file names none; taken as {rest_up}, along which the rest pose stands"
    return "Y", rest_up, "up axis: the file names none; taken as Y, along which the character stands in the motion"


def _standing(names: Sequence[str], positions: Floats) -> dict[str, float]:
    """In which part of the frames (F, J, 3) the character stands upright along Y and along Z."""
    folded = [name.casefold() for name in names]
    heads = [j for j, name in enumerate(folded) if any(word in name for word in _HEAD_WORDS)]
    feet = [j for j, name in enumerate(folded) if any(word in name for word in _FOOT_WORDS)]
    if heads and feet:
        upward = positions[:, heads].mean(axis=1) - positions[:, feet].mean(axis=1)
        length = np.linalg.norm(upward, axis=-1)
        return {axis: float(np.mean(upward[:, i] > _UPRIGHT * length)) for axis, i in (("Y", 1), ("Z", 2))}
    extent = np.ptp(positions, axis=1)
    return {
        "Y": float(np.mean(extent[:, 1] >= extent[:, 2])),
        "Z": float(np.mean(extent[:, 2] > 2 * extent[:, 1])),
    }


def _longest_path(parents: Sequence[int], lengths: Floats, tips: Sequence[tuple[int, float]]) -> tuple[float, int]:
    """Length of the longest path between two tips, without the bones above the first fork, and the number of tips."""
    reach = [0.0] * len(parents)  # from a joint to the farthest tip below it
    is_tip = [True] * len(parents)
    longest = 0.0
    for joint, length in tips:
        longest = max(longest, reach[joint] + length)
        reach[joint] = max(reach[joint], length)
    for joint in range(len(parents) - 1, -1, -1):
        parent = int(parents[joint])
        if parent >= 0:
            is_tip[parent] = False
            length = reach[joint] + float(lengths[joint])
            longest = max(longest, reach[parent] + length)
            reach[parent] = max(reach[parent], length)
    return longest, sum(is_tip)


# --- marker files -----------------------------------------------------------------------------------------------------

_LENGTH_WORDS: tuple[tuple[str, str], ...] = (
    ("mm", "mm"), ("millimeters", "mm"), ("millimetres", "mm"), ("cm", "cm"), ("centimeters", "cm"), ("centimetres", "cm"),
    ("dm", "dm"), ("decimeters", "dm"), ("decimetres", "dm"), ("m", "m"), ("meters", "m"), ("metres", "m"),
    ("in", "inch"), ("inches", "inch"), ("ft", "foot"), ("feet", "foot"), ("foot", "foot"),
)  # fmt: skip
_FEWEST_LETTERS = 3
_SIDE = r"(?:l|r|left|right)?[^a-z]*(?:top|front|back|rear)?[^a-z]*"
_HEAD_MARKER = re.compile(_SIDE + r"(?:head|forehead|fhd|bhd|thd|vertex|c7)")
_FOOT_MARKER = re.compile(_SIDE + r"(?:toe|heel|hee|hel(?!m)|ankle|ank|foot|calc|mt1|mt5)(?![a-z]*chair)")
_SHOULDER_MARKER = re.compile(_SIDE + r"(?:clav|ster|strn|stern|acro|sho|t1(?!\d))")
_PELVIS_MARKER = re.compile(_SIDE + r"(?:asi|psi|sac|pelvis|pelv|hip|waist)")
_LEANING = 0.6  # cosine between an axis and the direction to the head from all other markers

Turn = tuple[tuple[int, int, int], tuple[float, float, float]]
"""Which axes of the file become X, Y, Z of keypose, and their signs."""


def unit_of_word(word: str) -> str | None:
    """The name in `UNITS_M` of a unit as marker files write it, also cut short ("mete"), else None."""
    word = word.strip().strip("\0").casefold()
    for known, unit in _LENGTH_WORDS:
        if word == known or (len(word) >= _FEWEST_LETTERS and known.startswith(word)):
            return unit
    return None


def screen_turn(right: str, up: str) -> Turn:
    """The turn that brings a lab's axes to keypose's: ``right`` ("+X") becomes X, ``up`` ("+Z") becomes Y.

    What points at the viewer of such a screen becomes Z.

    Raises:
        ShapeError: where the two name the same axis.
    """
    x, y = _axis_vector(right), _axis_vector(up)
    z = np.cross(x, y)
    if not z.any():
        raise ShapeError(f"the axes to the right ({right}) and up ({up}) are the same")
    rows = np.array((x, y, z))
    axes = np.abs(rows).argmax(axis=1)
    signs = rows[np.arange(3), axes]
    return (int(axes[0]), int(axes[1]), int(axes[2])), (float(signs[0]), float(signs[1]), float(signs[2]))


def right_of(up: str) -> str:
    """The axis to the right, where only ``up`` is known, so that the turn is that of `y_up_rotation`."""
    return {"X": "-Y", "Y": "+X", "Z": "+X"}[up[-1]]


def turn_in(points: Array, turn: Turn, factor: float) -> Array:
    """Points (..., 3) of a file in keypose's axes, multiplied by ``factor``; a new float64 array."""
    axes, signs = turn
    out = np.empty((*points.shape[:-1], 3), np.float64)
    for axis in range(3):
        with np.errstate(invalid="ignore"):
            np.multiply(points[..., axes[axis]], signs[axis] * factor, out=out[..., axis], dtype=np.float64)
    return out


def turn_out(points: Array, turn: Turn, factor: float) -> Array:
    """Points (..., 3) of keypose in a file's axes, divided by ``factor``; undoes `turn_in`."""
    axes, signs = turn
    out = np.empty(points.shape, np.float64)
    for axis in range(3):
        np.divide(points[..., axis], signs[axis] * factor, out=out[..., axes[axis]], dtype=np.float64)
    return out


def guess_markers_up(names: Sequence[str], frames: Array, plates: Array, default: str) -> tuple[str, str]:
    """The up axis of a marker file that names none, and the note that tells of the guess.

    Shapes and units: ``frames`` (F, N, 3) are positions in the file's space, NaN where not seen; ``plates`` (P, 4, 3) the
    corners of force plates. A floor of force plates decides, then markers of the head above those of the feet,
    shoulders above the pelvis, the head above all others; without them ``default``.
    """
    said = "up axis: the file names none; taken as"
    if len(plates):
        extents = np.ptp(plates, axis=1)
        flat = extents.argmin(axis=1)
        if (flat == flat[0]).all() and (extents.min(axis=1) < 0.1 * extents.max(axis=1)).all():
            return UP_AXES[flat[0]], f"{said} {UP_AXES[flat[0]]}, for the force plates lie across it"
    folded = [name.rsplit(":", 1)[-1].casefold() for name in names]
    heads, feet, shoulders, pelvis = (
        [i for i, name in enumerate(folded) if pattern.match(name)]
        for pattern in (_HEAD_MARKER, _FOOT_MARKER, _SHOULDER_MARKER, _PELVIS_MARKER)
    )
    others = sorted(set(range(len(folded))) - set(heads))
    for above, below, least, what in (
        (heads, feet, _UPRIGHT, "the head is above the feet"),
        (shoulders, pelvis, _UPRIGHT, "the shoulders are above the pelvis"),
        (heads, others, _LEANING, "the head is above the other markers"),
    ):
        if not (above and below and len(frames)):
            continue
        upward = _mean_seen(frames[:, above]) - _mean_seen(frames[:, below])
        upward = upward[np.isfinite(upward).all(axis=-1)]
        length = np.linalg.norm(upward, axis=-1)
        for axis, column in (("Y", 1), ("Z", 2)):
            if len(upward) and float(np.mean(upward[:, column] > least * length)) > 0.5:
                return axis, f"{said} {axis}, along which {what}"
    return default, f"{said} {default}, as such files mostly have it (option up)"


def _mean_seen(points: Array) -> Array:
    """The mean (F, 3) of the points (F, N, 3) that were seen; not a number where none was."""
    is_seen = np.isfinite(points).all(axis=-1, keepdims=True)
    count = is_seen.sum(axis=1)
    total = np.where(is_seen, points, 0.0).sum(axis=1)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _axis_vector(name: str) -> Ints:
    name = name.strip().upper()
    letter = name[-1:]
    if letter not in UP_AXES or name[:-1] not in ("", "+", "-"):
        raise UnknownName("axis", name, [sign + axis for sign in "+-" for axis in UP_AXES])
    return np.eye(3, dtype=np.int64)[UP_AXES.index(letter)] * (-1 if name[:-1] == "-" else 1)
