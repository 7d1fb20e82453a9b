"""BVH files: a skeleton and its motion, read and written.

BVH names no unit and no up axis, does not say whether positions of child joints replace their OFFSET, and gives the
frame time with few digits. The rules by which the reader decides are in ``docs/bvh.md``; each decision can be
overridden by an option and is told in the scene's notes. What the file looked like is kept with the character
(``extras["bvh"]``), so that writing it again gives the same channels, orders, unit, axes and names.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from keypose.arrays import Floats, Ints
from keypose.errors import UnknownName
from keypose.io.axes import checked_up, guess_unit, guess_up, turn_roots, unit_in_metres, y_up_rotation
from keypose.io.bvh_channels import (
    Flags,
    Positions,
    child_positions_rule,
    layout,
    read_frames,
    root_positions_rule,
    translations_of,
)
from keypose.io.bvh_text import BvhText, parse
from keypose.io.bvh_writer import write as write
from keypose.model import Character, Motion, Pose, Scene, Skeleton

__all__ = ["read", "write"]

_SAMPLED_FRAMES = 9  # enough to see how a character stands

_COMMON_RATES_HZ = (24, 25, 30, 48, 50, 60, 72, 90, 96, 100, 120, 144, 150, 180, 200, 240, 250, 300, 500, 1000)
_BROADCAST_RATES_HZ = (
    *(rate * 1000 / 1001 for rate in (24, 30, 48, 60, 120)),
    *(23.976, 29.97, 47.952, 59.94, 119.88),
)


def read(
    path: Path,
    *,
    unit: str | float | None = None,
    up: str = "auto",
    child_positions: Literal["auto", "replace", "add"] = "auto",
    root_positions: Literal["auto", "replace", "add"] = "auto",
    truncated: Literal["refuse", "keep"] = "refuse",
) -> Scene:
    """Read a BVH file as one character and, where there are frames, one `Motion`.

    Shapes and units: ``unit`` is a name ("cm") or metres per file unit, guessed from the skeleton's size if not given;
    ``up`` is "X", "Y", "Z" or "auto". ``child_positions`` and ``root_positions`` say whether position channels replace
    OFFSET or are added to it. ``truncated="keep"`` loads the whole frames of a file that holds more or fewer than it says.

    Raises:
        FormatError: at the first thing that does not follow the format, with its line.
        UnknownName: for an option's value that does not exist.

    Source: M. Meredith and S. Maddock, "Motion Capture File Formats Explained" (University of Sheffield, CS-01-11).
    """
    for value, known in (
        (child_positions, ("auto", "replace", "add")),
        (root_positions, ("auto", "replace", "add")),
        (truncated, ("refuse", "keep")),
    ):
        if value not in known:
            raise UnknownName("choice", str(value), known)
    given_unit = None if unit is None else unit_in_metres(unit)
    given_up = None if up == "auto" else checked_up(up)
    with path.open("rb") as file:
        text = parse(file, keep_whole_frames=truncated == "keep")
        reader = _Reader(text, path.stem)
    return reader.scene(given_unit, given_up, child_positions, root_positions)


class _Reader:
    """Gives the text its meaning; collects notes on the way."""

    def __init__(self, text: BvhText, name: str) -> None:
        self.text, self.name = text, name
        self.notes = text.notes
        joints = text.hierarchy.joints
        self.parents = np.array([joint.parent for joint in joints], np.int32)
        self.offsets = np.array([joint.offset for joint in joints], np.float64)
        self.layout = layout([joint.channels or () for joint in joints])
        self.names = self.unique_names()
        self.rotations, self.positions = read_frames(text.blocks, text.frame_count, self.layout)
        step = np.linspace(0, text.frame_count - 1, min(text.frame_count, _SAMPLED_FRAMES))
        self.sampled = np.unique(step.astype(np.intp))

    def scene(self, unit_m: float | None, up: str | None, child_positions: str, root_positions: str) -> Scene:
        children = self.child_rule(child_positions)
        roots, standing = self.root_rule(root_positions, children)
        adds = np.where(self.parents < 0, np.isin(np.arange(len(self.parents)), roots), children == "add")
        if unit_m is None:
            unit_m = self.guessed_unit(adds)
        rest_up = up or "Y"
        if up is None:
            up, rest_up, note = guess_up(self.names, self.rest_positions(), standing)
            self.notes.append(note)
        else:
            rest_up = guess_up(self.names, self.rest_positions(), standing[:0])[1]
        rest_turned = up != "Y" and rest_up == up
        skeleton = self.skeleton(unit_m, up if rest_turned else "Y")
        rate_hz = self.rate()
        extras = self.extras(unit_m, up, rest_turned, children, roots, rate_hz)
        character = Character(skeleton, name=self.name, extras={"bvh": extras})
        motions = (self.motion(skeleton, unit_m, up, adds, rate_hz),) if self.text.frame_count and rate_hz else ()
        return Scene((character,), motions, "bvh", unit_m, up, tuple(self.notes))

    def unique_names(self) -> list[str]:
        names: list[str] = []
        taken: set[str] = {joint.name for joint in self.text.hierarchy.joints}
        seen: set[str] = set()
        changed: list[str] = []
        counts: dict[str, int] = {}
        for joint in self.text.hierarchy.joints:
            name = joint.name or "joint"
            if name in seen or not joint.name:
                stem, count = name, counts.get(name, 1)
                while name in seen or name in taken:
                    count += 1
                    name = f"{stem}_{count}"
                counts[stem] = count
                changed.append(f"'{joint.name}' -> '{name}'")
            seen.add(name)
            names.append(name)
        if changed:
            shown = ", ".join(changed[:6]) + (", …" if len(changed) > 6 else "")
            self.notes.append(f"joint names that were empty or came twice were changed: {shown}")
        return names

    def child_rule(self, choice: str) -> Positions:
        is_child = self.parents[self.layout.moving] >= 0
        moving = self.layout.moving[is_child]
        if not len(moving) or not self.text.frame_count:
            return "add" if choice == "add" else "replace"
        means = self.positions[:, is_child].mean(axis=0)
        # a component without a channel keeps its OFFSET and says nothing about the rule
        offsets = np.where(self.has_position()[moving], self.offsets[moving], 0.0)
        rule = (
            child_positions_rule(offsets, means)[0] if choice == "auto" else ("add" if choice == "add" else "replace")
        )
        how = "replace their OFFSET" if rule == "replace" else "are added to their OFFSET"
        why = (
            " (child_positions)"
            if choice != "auto"
            else f", for they lie around {'it' if rule == 'replace' else 'zero'}"
        )
        self.notes.append(f"position channels of {len(moving)} child joints {how}{why}")
        return rule

    def root_rule(self, choice: str, children: Positions) -> tuple[list[int], Floats]:
        """The roots whose positions are added to OFFSET, and joint positions (F, J, 3) in the sampled frames."""
        roots = [int(j) for j in self.layout.moving if self.parents[j] < 0]
        is_added = (self.parents >= 0) & (children == "add")
        if choice == "add":
            is_added[roots] = True
        positions = self.sampled_positions(is_added)
        if choice != "auto" or not len(positions):
            return [j for j in roots if is_added[j]], positions
        added: list[int] = []
        tree = _trees(self.parents)
        place = {int(joint): index for index, joint in enumerate(self.layout.moving)}
        for root in roots:
            offset = np.where(self.has_position()[root], self.offsets[root], 0.0)
            length = float(np.linalg.norm(offset))
            if length == 0:
                continue
            body = positions[:, tree == root]
            lowest = (body @ (offset / length)).min(axis=1)
            if root_positions_rule(offset, self.positions[self.sampled, place[root]], lowest) == "add":
                added.append(root)
                positions[:, tree == root] += offset
        if added:
            names = ", ".join(f"'{self.names[j]}'" for j in added[:3])
            self.notes.append(
                f"position channels of root {names} are added to its OFFSET, for they lie around zero and the body would "
                "otherwise be below the ground"
            )
        return added, positions

    def sampled_positions(self, adds: Flags) -> Floats:
        from keypose.evaluate import world

        if not len(self.sampled) or len(self.names) > 4096:
            return np.zeros((0, len(self.names), 3))
        pose = Pose(
            translations_of(self.positions[self.sampled], self.layout, self.offsets, adds),
            self.rotations[self.sampled],
            np.ones((len(self.names), 3)),
        )
        return np.array(world(self.skeleton(1.0, "Y"), pose)[..., :3, 3])

    def has_position(self) -> Flags:
        return self.layout.position_columns < self.layout.column_count

    def rest_positions(self) -> Floats:
        positions = self.offsets.copy()
        for joint, parent in enumerate(self.parents):
            if parent >= 0:
                positions[joint] += positions[parent]
        return positions

    def guessed_unit(self, adds: Flags) -> float:
        first = translations_of(self.positions[:1], self.layout, self.offsets, adds)
        lengths = first[0] if len(first) else self.offsets
        ends = [(joint, np.array(offset)) for joint, offset in self.text.hierarchy.end_sites]
        unit_m, note = guess_unit(self.parents.tolist(), lengths, ends)
        self.notes.append(note)
        return unit_m

    def skeleton(self, unit_m: float, up: str) -> Skeleton:
        count = len(self.names)
        rest = Pose(self.offsets * unit_m, np.tile((1.0, 0.0, 0.0, 0.0), (count, 1)), np.ones((count, 3)))
        if up != "Y":
            rest = turn_roots(rest, self.parents, y_up_rotation(up))
        ends = tuple(
            (joint, (x * unit_m, y * unit_m, z * unit_m)) for joint, (x, y, z) in self.text.hierarchy.end_sites
        )
        return Skeleton(tuple(self.names), self.parents, rest, ends)

    def motion(self, skeleton: Skeleton, unit_m: float, up: str, adds: Flags, rate_hz: float) -> Motion:
        rotations = self.rotations
        translations = translations_of(self.positions, self.layout, self.offsets, adds, unit_m)
        if up != "Y":
            turned = Pose(translations, rotations, skeleton.rest.scales)
            pose = turn_roots(turned, self.parents, y_up_rotation(up))
        else:
            for array in (rotations, translations):
                array.setflags(write=False)  # handed over: the pose then need not copy them
            pose = Pose(translations, rotations, skeleton.rest.scales)
        return Motion(skeleton.names, pose, rate_hz, self.name)

    def rate(self) -> float:
        if self.text.frame_time_s is None:
            return 0.0
        rate_hz = rate_from_frame_time(self.text.frame_time_s, self.text.frame_time_text)
        if abs(rate_hz * self.text.frame_time_s - 1) > 1e-9:
            self.notes.append(f"frame time {self.text.frame_time_text} s is a rounded {rate_hz:.6g} Hz")
        return rate_hz

    def extras(
        self, unit_m: float, up: str, rest_turned: bool, children: Positions, roots: Sequence[int], rate_hz: float
    ) -> dict[str, Any]:
        """What the writer needs to write the same file again; plain JSON, so that other formats can carry it."""
        joints = self.text.hierarchy.joints
        renamed = {new: joint.name for new, joint in zip(self.names, joints, strict=True) if new != joint.name}
        return {
            "unit_m": unit_m,
            "up": up,
            "rest_turned": rest_turned,
            "channels": {
                name: None if joint.channels is None else " ".join(joint.channels)
                for name, joint in zip(self.names, joints, strict=True)
            },
            "file_names": renamed,
            "child_positions": children,
            "added_roots": [self.names[j] for j in roots],
            "frame_time": self.text.frame_time_text,
            "rate_hz": rate_hz,
        }


def rate_from_frame_time(seconds: float, text: str) -> float:
    """The frame rate in Hz that a frame time stands for.

    A frame time is a decimal number, rounded or cut: a usual, whole or broadcast rate that gives these digits is meant;
    without one the number is taken as it is.
    """
    exact = 1.0 / seconds
    whole = round(exact)
    if whole and abs(exact / whole - 1) < 1e-9:
        return float(whole)
    mantissa, _, exponent = text.lower().partition("e")
    digits = len(mantissa.partition(".")[2]) - (int(exponent) if exponent else 0)
    last_digit = 10.0**-digits
    relative = last_digit / seconds
    candidates: list[float] = []
    if relative < 0.07:
        candidates += sorted(_COMMON_RATES_HZ, key=lambda rate: abs(1 / rate - seconds))
    if relative < 0.005:
        candidates += [whole, *_BROADCAST_RATES_HZ]

    def is_meant(rate: float) -> bool:
        beyond = (1 / rate - seconds) / last_digit
        return -0.5 - 1e-6 <= beyond <= 1 + 1e-6  # rounded to that digit, or cut after it

    return float(next((rate for rate in candidates if rate and is_meant(rate)), exact))


def _trees(parents: Ints) -> Ints:
    """The root above every joint, (J,)."""
    roots = np.arange(len(parents))
    for joint, parent in enumerate(parents):
        if parent >= 0:
            roots[joint] = roots[parent]
    return roots
