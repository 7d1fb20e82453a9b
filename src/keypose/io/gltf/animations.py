"""Animations as clips, and the morph channels they drive.

Source: glTF 2.0 Specification, section 3.11 (animations) and appendix C (interpolation).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from keypose.errors import FormatError
from keypose.io.gltf.accessors import PER_ITEM, XYZW_TO_WXYZ, Arrays
from keypose.io.gltf.hierarchy import OWN
from keypose.io.gltf.items import Animation, Document, Sampler
from keypose.io.notes import Notes, UniqueNames
from keypose.model import Channel, Clip, Curve, CurveKind, Interpolation, Property

MODES = {"STEP": Interpolation.STEP, "LINEAR": Interpolation.LINEAR, "CUBICSPLINE": Interpolation.HERMITE}
WIDTHS = {"translation": 3, "rotation": 4, "scale": 3}


_FOUR = np.ones(4, np.float32)


@dataclass(frozen=True, slots=True)
class Keys:
    """The keys of one sampler: ``values`` and tangents are (K, C), rotations already wxyz."""

    times_s: NDArray[np.float64]
    values: NDArray[np.float32]
    mode: Interpolation
    in_tangents: NDArray[np.float32] | None = None
    out_tangents: NDArray[np.float32] | None = None

    def column(self, index: int) -> Keys:
        """The keys of one component."""
        cut = slice(index, index + 1)
        return Keys(
            self.times_s,
            self.values[:, cut],
            self.mode,
            None if self.in_tangents is None else self.in_tangents[:, cut],
            None if self.out_tangents is None else self.out_tangents[:, cut],
        )

    def fingerprint(self) -> tuple[Any, ...]:
        """Equal for equal keys."""
        arrays = (self.times_s, self.values, self.in_tangents, self.out_tangents)
        return (self.mode, *(None if a is None else a.tobytes() for a in arrays))

    def only(self, weights: Sequence[float]) -> NDArray[np.bool_]:
        """Which columns never leave a weight, so that they say nothing that the rest does not."""
        still = (self.values == np.array(weights, np.float32)).all(axis=0)
        for tangents in (self.in_tangents, self.out_tangents):
            if tangents is not None:
                still &= ~tangents.any(axis=0)
        return still

    def curve(self, kind: CurveKind) -> Curve:
        """The same as a curve."""
        return Curve(self.times_s, self.values, self.mode, self.in_tangents, self.out_tangents, kind=kind)


@dataclass(frozen=True, slots=True)
class MorphInstance:
    """A node that shows a mesh with morph targets."""

    node: int
    name: str
    targets: tuple[str, ...]
    rest_weights: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class MorphChannels:
    """The channels of a character and, for each node, which of them drive its targets."""

    names: tuple[str, ...]
    rest_weights: NDArray[np.float32]
    of_node: Mapping[int, NDArray[np.int32]]


class Animations:
    """The keyframes of a document's animations."""

    def __init__(self, document: Document, arrays: Arrays, notes: Notes) -> None:
        self._document, self._arrays, self._notes = document, arrays, notes
        self._times: dict[int, tuple[NDArray[np.float64], NDArray[np.intp] | None]] = {}
        self._keys: dict[tuple[int, int, str, int], Keys] = {}
        self.weights: dict[tuple[int, int], Keys] = {}  # by animation and node
        for number, animation in enumerate(document.animations):
            for target in animation.targets:
                node = target.node
                if node is None or target.path != "weights":
                    continue
                mesh = document.nodes[node].mesh
                count = 0
                if mesh is not None and document.meshes[mesh].primitives:
                    count = len(document.meshes[mesh].primitives[0].targets)
                if count == 0:
                    notes.add(f"{target.where}: nodes[{node}] has no morph targets; their animation was dropped")
                elif (number, node) in self.weights:
                    notes.add(f"{target.where}: nodes[{node}].weights is animated twice; the first was kept")
                else:
                    self.weights[number, node] = self.keys(animation.samplers[target.sampler], "weights", count)

    def channels(self, instances: Sequence[MorphInstance], order: Sequence[str] = ()) -> MorphChannels:
        """Morph channels: one for all targets of a name where nothing tells them apart, else one for each node.

        They are in order of appearance, or in ``order`` where that has the same names.
        """
        prints: dict[str, set[tuple[Any, ...]]] = {}
        animations = range(len(self._document.animations))
        for instance in instances:
            self._arrays.take(len(instance.targets) * PER_ITEM, self._document.nodes[instance.node].where)
            seen: list[list[Any]] = [[weight] for weight in instance.rest_weights]
            for keys in (self.weights.get((a, instance.node)) for a in animations):
                still = None if keys is None else keys.only(instance.rest_weights)
                for index, column in enumerate(seen):
                    column.append(
                        None if keys is None or still is None or still[index] else keys.column(index).fingerprint()
                    )
            for target, column in zip(instance.targets, seen, strict=True):
                prints.setdefault(target, set()).add(tuple(column))
        shared = {target for target, seen in prints.items() if len(seen) == 1}
        names: dict[str, int] = {}
        rest: list[float] = []
        of_node: dict[int, NDArray[np.int32]] = {}
        for instance in instances:
            numbers: list[int] = []
            for index, target in enumerate(instance.targets):
                name = target
                if target not in shared:
                    name = f"{instance.name}.{target}"
                    while name in names or name in shared:  # a target may be named like that by itself
                        name += "'"
                if name not in names:
                    names[name] = len(rest)
                    rest.append(instance.rest_weights[index])
                numbers.append(names[name])
            of_node[instance.node] = np.array(numbers, np.int32)
        if len(order) == len(names) and set(order) == set(names):
            moved = np.argsort([names[name] for name in order]).astype(np.int32)  # new place of each channel
            rest = [rest[names[name]] for name in order]
            of_node = {node: moved[channels] for node, channels in of_node.items()}
            names = {name: number for number, name in enumerate(order)}
        told_apart = sorted(set(prints) - shared)
        if told_apart:
            self._notes.add(
                f"morph targets of one name move differently on several nodes and were named after them: "
                f"{', '.join(told_apart[:8])}{', …' if len(told_apart) > 8 else ''}"
            )
        return MorphChannels(tuple(names), np.array(rest, np.float32), of_node)

    def clips(self, joint_names: Sequence[str], joint_of_node: Mapping[int, int], morphs: MorphChannels) -> list[Clip]:
        """One clip for each animation."""
        unique = UniqueNames()
        clips: list[Clip] = []
        for number, animation in enumerate(self._document.animations):
            name = unique.add(animation.name or f"animation_{number}")
            if animation.name and name != animation.name:
                self._notes.add(f"several animations are named '{animation.name}'; one became '{name}'")
            curves = self._curves(number, animation, joint_names, joint_of_node, morphs)
            start = _own_number(animation, "start_s", -1e6, 0)
            if start is not None:  # the writer moved it, because the format has no time before 0
                curves = {c: replace(curve, times_s=curve.times_s + start) for c, curve in curves.items()}
            clips.append(Clip(curves, name, _own_number(animation, "rate_hz", 0, 1e6)))
        return clips

    def _curves(
        self,
        number: int,
        animation: Animation,
        joint_names: Sequence[str],
        joint_of_node: Mapping[int, int],
        morphs: MorphChannels,
    ) -> dict[Channel, Curve]:
        curves: dict[Channel, Curve] = {}
        for target in animation.targets:
            node = target.node
            if node is None:
                self._notes.add(f"{target.where}: a channel that animates no node was dropped")
            elif target.path == "weights":
                keys = self.weights.get((number, node))
                channels = morphs.of_node.get(node)
                if keys is None or channels is None:
                    continue
                self._arrays.take(len(channels) * PER_ITEM, target.where)
                # The format animates all targets of a node at once; those that stay at rest are left out.
                rests = keys.only([float(w) for w in morphs.rest_weights[channels]])
                for index in np.nonzero(~rests)[0].tolist() if not rests.all() else range(len(channels)):
                    key = Channel(morphs.names[channels[index]], Property.WEIGHT)
                    if key not in curves:  # shared channels have equal keys
                        curves[key] = keys.column(index).curve(CurveKind.SCALAR)
            elif node not in joint_of_node:
                self._notes.add(f"{target.where}: nodes[{node}] is not in the scene; its animation was dropped")
            else:
                channel = Channel(joint_names[joint_of_node[node]], Property(target.path))
                if channel in curves:
                    self._notes.add(f"{target.where}: {target.path} is animated twice; the first was kept")
                    continue
                keys = self.keys(animation.samplers[target.sampler], target.path, 1)
                kind = CurveKind.ROTATION if target.path == "rotation" else CurveKind.VECTOR
                curves[channel] = keys.curve(kind)
        return curves

    def keys(self, sampler: Sampler, path: str, targets: int) -> Keys:
        """The checked keys of a sampler for one path; weights have one column for each target."""
        key = (sampler.input, sampler.output, f"{path} {sampler.interpolation}", targets)
        if key not in self._keys:
            self._keys[key] = self._read(sampler, path, targets)
        return self._keys[key]

    def _read(self, sampler: Sampler, path: str, targets: int) -> Keys:
        times, kept = self._key_times(sampler)
        count = len(times) if kept is None else self._document.accessors[sampler.input].count
        where = f"{sampler.where}.output"
        kind = {"rotation": "VEC4", "weights": "SCALAR"}.get(path, "VEC3")
        width = WIDTHS.get(path, targets)
        parts = 3 if sampler.interpolation == "CUBICSPLINE" else 1
        if (
            path == "rotation"
            and kept is None
            and parts == 1
            and self._document.accessors[sampler.output].count == count
        ):
            rotations = self._unit(self._arrays.wxyz(sampler.output, place=where), sampler, where)
            rotations.flags.writeable = False
            return Keys(times, rotations, MODES[sampler.interpolation])
        values = self._arrays.floats(sampler.output, kind, place=where)
        if values.size != count * parts * width:
            raise FormatError(
                f"expected {count * parts * width // values.shape[1]} elements for {count} keys, got {len(values)}",
                where=where,
            )
        if parts == 1 and kept is None and values.shape[1] == width and path != "rotation":
            return Keys(times, values, MODES[sampler.interpolation])
        rows = values.reshape(count, parts, width)
        if kept is not None:
            rows = rows[kept]
        if path == "rotation":
            rows = rows[..., XYZW_TO_WXYZ]
        middle = self._unit(rows[:, parts // 2], sampler, where) if path == "rotation" else rows[:, parts // 2]
        if parts == 1:
            return Keys(times, _own(middle), MODES[sampler.interpolation])
        return Keys(times, _own(middle), Interpolation.HERMITE, _own(rows[:, 0]), _own(rows[:, 2]))

    def _unit(self, rotations: NDArray[np.float32], sampler: Sampler, where: str) -> NDArray[np.float32]:
        squares = (rotations * rotations) @ _FOUR
        if len(squares) and squares.min() > 1 - 1e-5 and squares.max() < 1 + 1e-5:
            return rotations
        self._arrays.check_finite(rotations, sampler.output)
        lengths = np.linalg.norm(rotations.astype(np.float64), axis=1)
        if np.any(lengths > 1e18):
            raise FormatError(f"key {int(np.argmax(lengths))} is no rotation", where=where)
        empty = lengths < 1e-18
        if np.any(empty):
            self._notes.add(f"{where}: {int(empty.sum())} rotations of length 0 were replaced by none")
            rotations = rotations.copy()
            rotations[empty] = (1, 0, 0, 0)
            lengths = np.where(empty, 1.0, lengths)
        off = np.abs(lengths - 1) > 1e-5
        # With tangents the length belongs to the curve: it is normalised after interpolation.
        if np.any(off) and sampler.interpolation != "CUBICSPLINE":
            worst = float(np.max(np.abs(lengths - 1)))
            if worst > 1e-2:
                self._notes.add(f"{where}: {int(off.sum())} rotations had other lengths than 1 and were normalised")
            rotations = np.where(off[:, None], rotations / lengths[:, None], rotations).astype(np.float32)
        return rotations

    def _key_times(self, sampler: Sampler) -> tuple[NDArray[np.float64], NDArray[np.intp] | None]:
        """Increasing times, and which keys are kept (None: all)."""
        index = sampler.input
        if index not in self._times:
            where = f"{sampler.where}.input"
            times = self._arrays.floats(index, "SCALAR", place=where)[:, 0].astype(np.float64)
            self._times[index] = self._repaired(times, where)
        return self._times[index]

    def _repaired(self, times: NDArray[np.float64], where: str) -> tuple[NDArray[np.float64], NDArray[np.intp] | None]:
        steps = np.diff(times)
        if np.any(steps < 0):
            key = int(np.argmax(steps < 0)) + 1
            raise FormatError(
                f"key {key} at {times[key]:g} s is before key {key - 1} at {times[key - 1]:g} s", where=where
            )
        if times[0] < 0:
            self._notes.add(f"{where}: keys before time 0")
        kept = None
        if np.any(steps == 0):
            # Several keys at one time are a jump: its two sides stay, the first a hair earlier.
            first = np.concatenate([[True], steps > 0])
            last = np.concatenate([steps > 0, [True]])
            early = np.nextafter(times.astype(np.float32), np.float32(-np.inf)).astype(np.float64)
            previous = np.concatenate([[-np.inf], times[:-1]])
            keep = last | (first & ~last & (early > previous))
            shifted = np.where(first & ~last, early, times)
            kept = np.nonzero(keep)[0]
            self._notes.add(f"{where}: {int(np.sum(steps == 0))} keys at the time of another were set apart")
            times = shifted[kept]
        times = np.array(times)
        times.setflags(write=False)
        return times, kept


def _own_number(animation: Animation, key: str, above: float, below: float) -> float | None:
    """A number that keypose itself has written into an animation's extras."""
    own = animation.extras.get(OWN)
    value = own.get(key) if isinstance(own, dict) else None
    known = isinstance(value, (int, float)) and not isinstance(value, bool) and above < value < below
    return float(value) if known and value is not None else None


def _own(values: NDArray[np.float32]) -> NDArray[np.float32]:
    owned = np.array(values, np.float32, order="C")
    owned.setflags(write=False)
    return owned
