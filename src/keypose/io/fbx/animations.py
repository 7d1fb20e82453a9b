"""Animation stacks, evaluated by ufbx with all their layers at the frames of the file, as clips."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from keypose.arrays import Array, Floats
from keypose.errors import FormatError
from keypose.io.fbx.hierarchy import Hierarchy, wxyz
from keypose.io.fbx.morphs import Morphs
from keypose.io.guarded import Record, sane
from keypose.io.notes import Notes
from keypose.math import quat
from keypose.model import Channel, Clip, Curve, CurveKind, Interpolation, Property

# What changes by less than this is taken for rounding: metres, quaternion components, ratios and weights.
STILL = 1e-9


def clips(record: Record, tree: Hierarchy, morphs: Morphs, unit_m: float, notes: Notes) -> list[Clip]:
    """One clip for each stack that moves something."""
    rate = float(record.facts["rate_hz"])
    found = list[Clip]()
    for number, stack in enumerate(record.facts["stacks"]):
        where = f"animation stack '{stack['name']}'"
        if not stack["curves"]:
            notes.add(f"{where}: it holds no keys and was left out")
            continue
        clip = _Clip(record, stack, tree, unit_m, where)
        for track in stack["tracks"]:
            clip.add_joint(track)
        for name, rest, track in zip(morphs.names, morphs.rest_weights, morphs.tracks[number], strict=True):
            clip.add(name, Property.WEIGHT, CurveKind.SCALAR, track[:, None], np.array([rest]))
        if not clip.curves and not clip.hold(0):
            notes.add(f"{where}: its keys move nothing and it was left out")
            continue
        _note_keys_outside(stack, rate, where, notes)
        if stack["layers"] > 1:
            notes.add(f"{where}: its {stack['layers']} layers were baked into one")
        found.append(Clip(clip.finish(), str(stack["name"]), rate))
    return found


def _note_keys_outside(stack: Mapping[str, Any], rate: float, where: str, notes: Notes) -> None:
    begin, end = float(stack["begin"]), float(stack["end"])
    first, last = (float(t) for t in stack["keys"])
    if first < begin - 0.5 / rate or last > end + 0.5 / rate:
        notes.add(
            f"{where}: its keys go from {first:g} to {last:g} s, its take from {begin:g} to {end:g} s, which was read"
        )


class _Clip:
    """A clip under way: what rests is left out, what is constant has one key."""

    def __init__(self, record: Record, stack: Mapping[str, Any], tree: Hierarchy, unit_m: float, where: str) -> None:
        self._record, self._tree, self._unit_m, self._where = record, tree, unit_m, where
        self.times: Floats = record.array(stack["times"]).copy()
        if not len(self.times) or not sane(self.times) or np.any(np.diff(self.times) <= 0):
            raise FormatError("its times do not rise", where=where)
        self.times.setflags(write=False)
        self.curves: dict[Channel, Curve] = {}
        self._moving = False

    def add_joint(self, track: Mapping[str, Any]) -> None:
        """The three curves of one node."""
        joint = self._tree.joint_of_node.get(int(track["node"]))
        if joint is None:
            return
        name, rest = self._tree.skeleton.names[joint], self._tree.skeleton.rest
        array = self._record.array
        translations = array(track["translation"], 3)
        if not (sane(translations) and sane(array(track["scale"], 3))):
            raise FormatError(f"the transform of '{name}' holds impossible numbers", where=self._where)
        translations = translations * self._unit_m
        rotations = wxyz(array(track["rotation"], 4))
        self.add(name, Property.TRANSLATION, CurveKind.VECTOR, translations, rest.translations[joint])
        self.add(name, Property.ROTATION, CurveKind.ROTATION, rotations, rest.rotations[joint])
        self.add(name, Property.SCALE, CurveKind.VECTOR, array(track["scale"], 3), rest.scales[joint])

    def add(self, target: str, property: Property, kind: CurveKind, values: Array, rest: Array) -> None:
        """One curve, with a key at every frame if it moves."""
        if not sane(values):
            raise FormatError(f"the {property.value} of '{target}' is impossible", where=self._where)
        if len(values) not in (1, len(self.times)):
            raise FormatError(f"'{target}' has {len(values)} of {len(self.times)} frames", where=self._where)
        if kind is CurveKind.ROTATION:
            values = quat.align_signs(np.concatenate([rest[None], values]), axis=0)[1:]
        if float(np.ptp(values, axis=0).max()) > STILL:
            self.curves[Channel(target, property)] = Curve(self.times, values, Interpolation.LINEAR, kind=kind)
            self._moving = True
        elif float(np.abs(values[0] - rest).max()) > STILL:
            self.curves[Channel(target, property)] = Curve(self.times[:1], values[:1], Interpolation.LINEAR, kind=kind)

    def hold(self, joint: int) -> bool:
        """Keep a clip in which everything rests by a curve that keeps a joint where it is; whether there is one."""
        if joint >= self._tree.skeleton.joint_count:
            return False
        values = np.asarray(self._tree.skeleton.rest.rotations[joint])[None]
        channel = Channel(self._tree.skeleton.names[joint], Property.ROTATION)
        self.curves[channel] = Curve(self.times[:1], values, Interpolation.LINEAR, kind=CurveKind.ROTATION)
        return True

    def finish(self) -> Mapping[Channel, Curve]:
        """The curves; a clip in which nothing moves keeps its length by one curve with a key at its end."""
        if not self._moving and len(self.times) > 1:
            channel, curve = next(iter(self.curves.items()))
            ends = self.times[[0, -1]]
            self.curves[channel] = Curve(
                ends, np.repeat(curve.values, 2, axis=0), Interpolation.LINEAR, kind=curve.kind
            )
        return self.curves
