"""Acclaim files: a skeleton (ASF) and its motion (AMC), read and written.

A bone of an ASF file turns about its start, which is the end of its parent: it becomes a joint there, and the bone's
vector the offset of its children. Joints' axes are those of the world at rest (``axes="world"``: all rest rotations are
the identity, as BVH has it) or the bones' own (``axes="bone"``). What the file says beyond that, limits and the order of the
degrees of freedom, is kept with the character (``extras["acclaim"]``), so that writing it again gives the same bones.
"""

from __future__ import annotations

import contextlib
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np

from keypose.arrays import Floats
from keypose.errors import FormatError, ShapeError, UnknownName
from keypose.io.acclaim_writer import write as write
from keypose.io.amc import AmcStart, AmcText, parse_frames, parse_start
from keypose.io.asf import LARGEST, MOST_BYTES, REMARK, AsfText, Vector, is_amc, is_asf, parse_asf
from keypose.io.axes import UNITS_M, guess_unit, unit_in_metres
from keypose.io.bvh_channels import Layout, read_frames
from keypose.io.text import shown
from keypose.math import euler, quat
from keypose.model import Character, Motion, Pose, Scene, Skeleton

__all__ = ["read", "write"]

_DEFAULT_RATE_HZ = 120.0
_MOST_CANDIDATES = 64
_MOST_FRAME_BYTES, _BYTES_PER_BYTE = 1 << 26, 64


def read(
    path: Path,
    *,
    skeleton: str | Path | None = None,
    unit: str | float | None = None,
    rate_hz: float | None = None,
    axes: Literal["auto", "world", "bone"] = "auto",
    truncated: Literal["refuse", "keep"] = "refuse",
) -> Scene:
    """Read an ASF file as a character at rest, or an AMC file with its ASF as a character and one `Motion`.

    ``skeleton`` names the ASF of an AMC; without it the folder is searched (``03_01.amc`` -> ``03_01.asf``, ``03.asf``,
    the name in the file's first line, or the only one with the same bones). Shapes and units: ``unit`` is a name ("cm")
    or metres per file unit; ``rate_hz`` is 120, which is what nearly all such files were captured at, unless the file
    says it. ``axes="bone"`` gives joints the axes of their bones; "auto" does so for files that keypose wrote from a rig
    with axes of its own. ``truncated="keep"`` leaves a cut last frame out.

    Raises:
        FormatError: at the first thing that does not follow the format, with its line; where no skeleton is found.
        UnknownName: for an option's value that does not exist.

    Source: M. Schafer, "ASF Skeleton File and AMC Motion Capture Data" (Acclaim Advanced Technologies Group, 1994).
    """
    for value, known in ((axes, ("auto", "world", "bone")), (truncated, ("refuse", "keep"))):
        if value not in known:
            raise UnknownName("choice", str(value), known)
    if rate_hz is not None and not (np.isfinite(rate_hz) and rate_hz > 0):
        raise ShapeError(f"rate_hz: expected a positive number, got {rate_hz}")
    given_unit = None if unit is None else unit_in_metres(unit)
    data = path.read_bytes()
    if is_asf(data[:4096]) or (not is_amc(data[:4096]) and path.suffix.lower() == ".asf"):
        asf = parse_asf(data)
        reader = _Reader(asf, path.stem, given_unit, _said(data, axes))
        return Scene((reader.character,), (), "asf", reader.unit_m, "Y", tuple(reader.notes))
    start = parse_start(data)
    asf_path, asf, said = _skeleton(path, start, skeleton, axes)
    reader = _Reader(asf, asf_path.stem, given_unit, said)
    text = parse_frames(data, start, _expected(asf), keep_whole_frames=truncated == "keep")
    notes = [f"skeleton: {asf_path.name}", *reader.notes, *text.notes]
    motions = (reader.motion(text, text.name or path.stem, rate_hz, len(data), notes),) if len(text.table) else ()
    return Scene((reader.character,), motions, "amc", reader.unit_m, "Y", tuple(notes))


def _expected(asf: AsfText) -> dict[str, int]:
    return {"root": len(asf.order), **{bone.name: len(bone.dof) for bone in asf.bones}}


# --- finding the skeleton ---------------------------------------------------------------------------------------------------


def _skeleton(path: Path, start: AmcStart, named: str | Path | None, axes: str) -> tuple[Path, AsfText, _Said]:
    """The ASF file of an AMC, parsed: the one that is named, else one of the folder that has the same bones."""
    if named is not None:
        found, data, asf = _open(Path(named))
        return found, asf, _said(data, axes)
    tried: list[str] = []
    for candidate in _candidates(path, start.text.source):
        try:
            found, data, asf = _open(candidate)
        except FormatError as error:
            tried.append(str(error))
            continue
        expected = _expected(asf)
        odd = [name for name, count in start.counts.items() if expected.get(name) != count]
        if not odd:
            return found, asf, _said(data, axes)
        tried.append(f"{candidate.name} has no bone {shown(odd[0])} with {start.counts[odd[0]]} dof")
    found = f" ({'; '.join(tried[:3])[:300]})" if tried else ""
    raise FormatError(
        f"an AMC file holds no skeleton, and none that fits is beside it{found}; put its ASF file there, or name it: "
        f"--skeleton {path.stem.split('_')[0][:40]}.asf, in Python load(path, skeleton='…')",
        path=path,
    )


def _candidates(path: Path, source: str) -> list[Path]:
    """ASF files of the folder, the likeliest first: same name, name before the underscore, the name in the file."""
    try:
        files = sorted(p for p in path.parent.iterdir() if p.suffix.lower() == ".asf")
    except OSError:
        files = []
    stem = path.stem.casefold()
    prefixes = [stem[: m.start()] for m in re.finditer("[_.-]", stem)][::-1]
    wanted = [stem, *prefixes, Path(source).stem.casefold()]
    ranked = sorted(
        files, key=lambda p: wanted.index(p.stem.casefold()) if p.stem.casefold() in wanted else len(wanted)
    )
    return ranked[:_MOST_CANDIDATES]


def _open(path: Path) -> tuple[Path, bytes, AsfText]:
    try:
        with path.open("rb") as file:
            data = file.read(MOST_BYTES + 1)
        return path, data, parse_asf(data)
    except OSError as error:
        raise FormatError(f"the skeleton cannot be read: {error.strerror or error}", path=path) from None
    except FormatError as error:
        raise (error if error.path else error.at(path)) from None


@dataclass(frozen=True, slots=True)
class _Said:
    """What keypose says in the first line of an ASF file that it wrote, so that reading gives the same rig again."""

    own_axes: bool = False
    unit_m: float | None = None
    root_name: str = "root"
    root_axes: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0)
    root_position: tuple[float, ...] | None = None
    added: frozenset[str] = frozenset()


def _said(data: bytes, axes: str) -> _Said:
    """The remark in the first line, as far as it makes sense; it is a comment and may be anything."""
    values: dict[str, Any] = {}
    if data.startswith(REMARK):
        with contextlib.suppress(ValueError, RecursionError):
            read = json.loads(data[len(REMARK) :].split(b"\n", 1)[0])
            values = cast("dict[str, Any]", read) if isinstance(read, dict) else {}
    unit_m, name, added = values.get("unit_m"), values.get("root"), values.get("added")
    root_axes, position = _numbers(values.get("root_axes"), 4), _numbers(values.get("root_position"), 3)
    if root_axes:
        size = float(np.linalg.norm(root_axes))
        root_axes = tuple(v / size for v in root_axes) if 0.5 < size < 2 else None
    names = [n for n in cast("list[Any]", added) if isinstance(n, str)] if isinstance(added, list) else []
    return _Said(
        axes == "bone" or (axes == "auto" and values.get("axes") == "bone"),
        float(unit_m) if isinstance(unit_m, (int, float)) and 1e-6 <= unit_m <= 1e6 else None,
        name if isinstance(name, str) and 0 < len(name) < 256 else "root",
        root_axes or (1.0, 0.0, 0.0, 0.0),
        position,
        frozenset(names),
    )


def _numbers(values: Any, count: int) -> tuple[float, ...] | None:
    if not isinstance(values, list) or len(cast("list[Any]", values)) != count:
        return None
    numbers = cast("list[Any]", values)
    if not all(isinstance(v, (int, float)) and abs(v) < LARGEST for v in numbers):
        return None
    return tuple(float(v) for v in numbers)


# --- meaning ----------------------------------------------------------------------------------------------------------------


class _Reader:
    """Gives the text its meaning; collects notes on the way."""

    def __init__(self, asf: AsfText, name: str, unit_m: float | None, said: _Said) -> None:
        self.asf, self.notes, self.own = asf, list(asf.notes), said.own_axes
        self.names = ("root", *(bone.name for bone in asf.bones))
        self.parents = np.array([-1, *(parent + 1 for parent in asf.parents)], np.int32)
        self.to_degrees = to_degrees = 1.0 if asf.degrees else 180.0 / np.pi
        # ends of the bones from their starts, in file units, in the axes of the world at rest
        self.vectors = self.bone_vectors()
        offsets = np.zeros((len(self.names), 3))
        offsets[0] = asf.position
        offsets[1:] = self.vectors[self.parents[1:]]
        self.unit_m = unit_m or said.unit_m or self.metres(offsets)
        axes = [asf.orientation, *(bone.axis for bone in asf.bones)]
        orders = [asf.axis_order, *(bone.axis_order for bone in asf.bones)]
        self.axes = np.stack([_axis_rotation(a, order, to_degrees) for a, order in zip(axes, orders, strict=True)])
        self.fold(said.added, offsets)
        self.base = offsets * self.unit_m
        # world from joint and from its parent, at rest
        self.frames = np.tile((1.0, 0.0, 0.0, 0.0), (len(self.names), 1))
        if self.own:
            self.frames = self.axes.copy()
            self.frames[0] = quat.multiply(self.axes[0], np.array(said.root_axes))
        self.above = np.where(self.parents[:, None] >= 0, self.frames[self.parents], (1.0, 0.0, 0.0, 0.0))
        self.base = np.asarray(quat.rotate(quat.conjugate(self.above), self.base))
        self.skeleton = self.rest(said)
        extras = {"acclaim": self.extras(), "euler_orders": self.euler_orders()}
        self.character = Character(self.skeleton, name=name, extras=extras)

    def fold(self, added: frozenset[str], offsets: Floats) -> None:
        """Take out the bones that only lead from one joint's end to another's start, which keypose added in writing."""
        dofs = {bone.name: bone.dof for bone in self.asf.bones}
        gone = np.array([name in added and not dofs.get(name, ("x",)) for name in self.names])
        gone &= np.isin(np.arange(len(self.names)), self.parents)
        if not gone.any():
            return
        for joint in range(1, len(self.names)):
            while gone[self.parents[joint]]:
                offsets[joint] += offsets[self.parents[joint]]
                self.parents[joint] = self.parents[self.parents[joint]]
        place = np.cumsum(~gone) - 1
        self.names = tuple(name for name, out in zip(self.names, gone, strict=True) if not out)
        kept = self.parents[~gone]
        self.parents = np.where(kept >= 0, place[kept], -1).astype(np.int32)
        self.vectors, self.axes = self.vectors[~gone], self.axes[~gone]
        offsets[: len(kept)] = offsets[~gone]
        offsets.resize((len(kept), 3), refcheck=False)

    def rest(self, said: _Said) -> Skeleton:
        translations = self.base.copy()
        if said.root_position is not None:
            translations[0] = said.root_position
        rotations = quat.normalize(quat.multiply(quat.conjugate(self.above), self.frames))
        leaves = sorted(set(range(1, len(self.names))) - set(self.parents.tolist()))
        tips = np.asarray(quat.rotate(quat.conjugate(self.frames), self.vectors)) * self.unit_m
        ends = tuple((leaf, _vector(tips[leaf])) for leaf in leaves if np.any(tips[leaf]))
        self.file_names = self.names
        if said.root_name not in self.names:
            self.names = (said.root_name, *self.names[1:])
        return Skeleton(self.names, self.parents, Pose(translations, rotations, np.ones_like(translations)), ends)

    def bone_vectors(self) -> Floats:
        vectors = np.zeros((len(self.names), 3))
        bent: list[str] = []
        for index, bone in enumerate(self.asf.bones, 1):
            direction = np.array(bone.direction)
            size = float(np.linalg.norm(direction))
            if size:
                vectors[index] = direction / size * bone.length
            if bone.length and abs(size - 1) > 1e-3:
                bent.append(bone.name)
        if bent:
            self.notes.append(
                f"directions of {len(bent)} bones are not of length 1; their 'length' was taken: {bent[0]}"
            )
        return vectors

    def metres(self, offsets: Floats) -> float:
        """Metres per unit: ``length`` is the file's scale of an inch; 1 or nothing says nothing."""
        length = self.asf.length
        if length is not None and length != 1.0:
            unit_m = UNITS_M["inch"] / length
            if 1e-6 <= unit_m <= 1e6:
                return unit_m
        leaves = sorted(set(range(1, len(self.names))) - set(self.parents.tolist()))
        unit_m, note = guess_unit(self.parents.tolist(), offsets, [(leaf, self.vectors[leaf]) for leaf in leaves])
        said = "the file names none" if length is None else "'length 1' names none"
        self.notes.append(note.replace("the file names none", said))
        return unit_m

    def extras(self) -> dict[str, Any]:
        """What the writer needs to write the same file again; plain JSON, so that other formats can carry it."""
        asf = self.asf
        bones: dict[str, Any] = {}
        for bone in asf.bones:
            axis = [angle * self.to_degrees for angle in bone.axis]
            bones[bone.name] = {"axis_deg": axis, "axis_order": bone.axis_order, "dof": " ".join(bone.dof), **bone.mass}
            if bone.limits:
                bones[bone.name]["limits"] = [
                    [None if np.isinf(v) else self.limit(v, dof) for v in pair]
                    for dof, pair in zip(bone.dof, bone.limits, strict=True)
                ]
        return {
            "name": asf.name,
            "version": asf.version,
            "unit_m": self.unit_m,
            "length": asf.length,
            "mass": asf.mass,
            "root": {"order": " ".join(asf.order), "axis_order": asf.axis_order},
            "bones": bones,
            "axes": "bone" if self.own else "world",
        }

    def euler_orders(self) -> dict[str, str]:
        """The axes about which each joint turns, in the order in which they turn with it: the file's, reversed."""
        dofs: dict[str, Sequence[str]] = {"root": self.asf.order, **{b.name: b.dof for b in self.asf.bones}}
        turns = {
            joint: "".join(d[1].upper() for d in reversed(dofs.get(name, ())) if d.startswith("r"))
            for name, joint in zip(self.file_names, self.names, strict=True)
        }
        return {joint: order for joint, order in turns.items() if order}

    def limit(self, value: float, dof: str) -> float:
        """Degrees, or metres for what slides."""
        return value * (self.to_degrees if dof.startswith("r") else self.unit_m)

    def motion(self, text: AmcText, name: str, rate_hz: float | None, size: int, notes: list[str]) -> Motion:
        frames, joints = len(text.table), len(self.names)
        if frames * joints * 7 * 8 > max(_MOST_FRAME_BYTES, _BYTES_PER_BYTE * size):
            raise FormatError(
                f"{frames} frames of {joints} joints, nearly all without values, would take {frames * joints * 56 >> 20} MiB"
            )
        if rate_hz is None and text.rate_hz is None:
            notes.append("frame rate: the file names none; taken as 120 Hz, at which most such files were captured")
        rate = rate_hz or text.rate_hz or _DEFAULT_RATE_HZ
        unnamed = set(self.file_names) - set(text.bones) - {bone.name for bone in self.asf.bones if not bone.dof}
        if unnamed:
            notes.append(f"{len(unnamed)} bones have no values in the motion and stay at rest: {min(unnamed)}")
        degrees = text.degrees if text.degrees is not None else self.asf.degrees
        if text.degrees is None:
            notes.append(
                f"the motion does not say its angles' unit; taken as {'degrees' if degrees else 'radians'}, as the skeleton's"
            )
        where, lengths = self.layout(text)
        if lengths:
            notes.append(f"{len(lengths)} bones change their length; the values are taken as changes of it")
        table = text.table
        if not degrees:
            turning = np.unique(where.rotation_columns[where.rotation_columns < where.column_count])
            table = table.copy()
            table[:, turning] *= 180.0 / np.pi
        rotations, slides = read_frames([table], frames, where)
        self.turn(rotations)
        translations = self.translations(frames, slides, where, lengths, table)
        rotations.setflags(write=False)
        translations.setflags(write=False)
        start_s = 0.0
        if text.first_frame > 1:
            start_s = (text.first_frame - 1) / rate
            notes.append(f"the first frame is {text.first_frame}: the motion starts at {start_s:g} s")
        pose = Pose(translations, rotations, self.skeleton.rest.scales)
        return Motion(self.names, pose, rate, name, start_s)

    def layout(self, text: AmcText) -> tuple[Layout, dict[int, int]]:
        """Where the values of each joint are, and the columns of the lengths that change."""
        count = text.table.shape[1]
        dofs: dict[str, Sequence[str]] = {"root": self.asf.order, **{b.name: b.dof for b in self.asf.bones}}
        columns: dict[str, int] = {}
        at = 0
        for bone, width in zip(text.bones, text.counts, strict=True):
            columns[bone] = at
            at += width
        rotations = np.full((len(self.names), 3), count, np.intp)
        positions = np.full((len(self.names), 3), count, np.intp)
        lengths: dict[int, int] = {}
        orders: list[str] = []
        for joint, name in enumerate(self.file_names):
            turns: list[tuple[str, int]] = []
            for index, dof in enumerate(dofs[name] if name in columns else ()):
                column = columns[name] + index
                if dof.startswith("r"):
                    turns.append((dof[1].upper(), column))
                elif dof.startswith("t"):
                    positions[joint, "xyz".index(dof[1])] = column
                else:
                    lengths[joint] = column
            # the first angle is applied first: it is the last factor of the product
            turns.reverse()
            order = "".join(axis for axis, _ in turns)
            for index, (_, column) in enumerate(turns):
                rotations[joint, index] = column
            orders.append(order + "".join(axis for axis in "ZYX" if axis not in order))
        return Layout(tuple(orders), rotations, positions, count), lengths

    def turn(self, rotations: Floats) -> None:
        """From each bone's axes to the joint's: ``C M C^-1`` turns only the vector half of the quaternion."""
        if self.own:
            # rest times motion; the root may have been given axes of its own, which its bone's do not know
            rest = np.asarray(self.skeleton.rest.rotations)
            inner = quat.multiply(quat.conjugate(self.axes), self.frames)
            rotations[:] = quat.multiply(quat.multiply(rest, quat.multiply(quat.conjugate(inner), rotations)), inner)
            rotations[:] = quat.align_signs(quat.normalize(rotations), axis=0)
            return
        turned = np.abs(self.axes[:, 0]) < 1 - 1e-15
        joints = np.nonzero(turned)[0]
        if len(joints):
            matrices = np.asarray(quat.to_matrix(self.axes))
            for joint in joints:
                rotations[:, joint, 1:] = rotations[:, joint, 1:] @ matrices[joint].T

    def translations(
        self, frames: int, slides: Floats, where: Layout, lengths: Mapping[int, int], table: Floats
    ) -> Floats:
        translations = np.empty((frames, *self.base.shape))
        translations[:] = self.base
        for index, joint in enumerate(where.moving):
            slide = slides[:, index] * self.unit_m
            if joint:  # a bone slides along its own axes, the root along the world's
                slide = quat.rotate(quat.multiply(quat.conjugate(self.above[joint]), self.axes[joint]), slide)
            translations[:, joint] += slide
        for joint, column in lengths.items():
            size = float(np.linalg.norm(self.vectors[joint]))
            if not size:
                continue
            direction = self.vectors[joint] / size
            for child in np.nonzero(self.parents == joint)[0]:
                inward = quat.rotate(quat.conjugate(self.above[child]), direction)
                translations[:, child] += table[:, column, None] * self.unit_m * inward
        return translations


def _axis_rotation(angles: Sequence[float], order: str, to_degrees: float) -> Floats:
    """Angles that are applied in the written order, about fixed axes: (4,)."""
    return np.asarray(euler.to_quat(np.radians(np.array(angles) * to_degrees), order.lower()))


def _vector(values: Floats) -> Vector:
    return float(values[0]), float(values[1]), float(values[2])
