"""Time samples of SkelAnimations and of prims as clips, with the keys that the file has."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from keypose.arrays import Array, Floats
from keypose.errors import FormatError
from keypose.io.guarded import Record, sane
from keypose.io.notes import Notes
from keypose.io.usd import hierarchy
from keypose.io.usd.hierarchy import Base, Hierarchy
from keypose.io.usd.morphs import Channel as Driven
from keypose.io.usd.morphs import Morphs, amounts, with_turning_points
from keypose.math import quat
from keypose.model import Channel, Clip, Curve, CurveKind, Interpolation, Property

# What changes by less than this is taken for rounding: metres, quaternion components, ratios and weights.
STILL = 1e-9
_WIDTHS = {"translations": 3, "rotations": 4, "scales": 3, "weights": 1}


def clips(
    record: Record, tree: Hierarchy, morphs: Morphs, rest_weights: Floats, unit_m: float, stem: str, notes: Notes
) -> list[Clip]:
    """One clip of everything that the file plays, and one for each animation that waits to be bound."""
    return _Reader(record, tree, morphs, rest_weights, unit_m, notes).clips(stem)


class _Reader:
    def __init__(
        self, record: Record, tree: Hierarchy, morphs: Morphs, rest_weights: Floats, unit_m: float, notes: Notes
    ) -> None:
        self._record, self._tree, self._morphs, self._notes = record, tree, morphs, notes
        self._rest_weights, self._unit_m = rest_weights, unit_m
        self._skeletons: Sequence[Mapping[str, Any]] = record.facts["skeletons"]
        self._animations: Sequence[Mapping[str, Any]] = record.facts["animations"]
        rate = float(record.facts["codes_per_s"])
        if not (np.isfinite(rate) and rate > 0):
            notes.add(f"its {rate:g} time codes per second are impossible; taken as 24")
            rate = 24.0
        self._rate = rate

    def clips(self, stem: str) -> list[Clip]:
        """The clips in the order of the file."""
        bound: dict[int, list[int]] = {}
        for skeleton in self._skeletons:
            if skeleton["animation"] >= 0:
                prims = bound.setdefault(int(skeleton["animation"]), [])
                if self._tree.same[int(skeleton["prim"])] not in prims:
                    prims.append(self._tree.same[int(skeleton["prim"])])
        played = _Clip(self._rate)
        for number, prims in bound.items():
            self._add(played, self._animations[number], prims)
        self._add_prims(played)
        names = [str(self._animations[number]["name"]) for number in bound]
        waiting: dict[int, Clip] = {}
        for number, item in enumerate(self._animations):
            if number not in bound:
                clip = _Clip(self._rate)
                self._add(clip, item, self._users(item))
                made = clip.finish(self._tree, str(item["name"]), _own_rate(item))
                if made is None:
                    self._notes.add(f"animation '{item['name']}': it moves nothing in this file and was left out")
                else:
                    waiting[number] = made
        own = self._animations[next(iter(bound))] if len(bound) == 1 else {}
        playing = played.finish(self._tree, names[0] if len(names) == 1 else stem, _own_rate(own))
        if playing is None:
            return list(waiting.values())
        place = min(bound, default=0)
        return [*(c for n, c in waiting.items() if n < place), playing, *(c for n, c in waiting.items() if n > place)]

    def _users(self, item: Mapping[str, Any]) -> list[int]:
        """The skeletons that an animation fits."""
        joints, shapes = set(item["joints"]), set(item["shapes"])
        return [
            int(s["prim"])
            for s in self._skeletons
            if self._tree.same[int(s["prim"])] == int(s["prim"])
            and (
                (joints & set(s["joints"])) or any((int(s["prim"]), shape) in self._morphs.channels for shape in shapes)
            )
        ]

    def _add(self, clip: _Clip, item: Mapping[str, Any], prims: Sequence[int]) -> None:
        """The curves of a SkelAnimation for some skeletons."""
        where = f"animation '{item['name']}'"
        tracks = {name: self._track(item, name, where) for name in _WIDTHS}
        done: set[int] = set()
        for prim in prims:
            tokens = self._tree.joint_of_token.get(prim, {})
            for row, token in enumerate(item["joints"]):
                joint = tokens.get(str(token))
                if joint is not None and joint not in done:
                    done.add(joint)
                    self._add_joint(clip, joint, {n: _row(t, row) for n, t in tracks.items() if n != "weights"})
            for row, shape in enumerate(item["shapes"]):
                for channel in self._morphs.channels.get((prim, str(shape)), ()):
                    self._add_weight(clip, channel, _row(tracks["weights"], row))
        unknown = len(item["joints"]) - len(
            {t for p in prims for t in item["joints"] if t in self._tree.joint_of_token.get(p, {})}
        )
        if unknown and prims:
            self._notes.add(f"{where}: {unknown} of its joints are in no skeleton and were dropped")

    def _track(self, item: Mapping[str, Any], name: str, where: str) -> tuple[Floats, Floats] | None:
        """Times in seconds and values (T, N, width)."""
        found = item[name]
        if found is None:
            return None
        count = len(item["shapes"] if name == "weights" else item["joints"])
        if found.get("wrong"):
            self._notes.add(f"{where}: the samples of its {name} are of different sizes and were dropped")
            return None
        values = self._record.floats(found["values"])
        rows, width = int(found["rows"]), _WIDTHS[name]
        if values.size != rows * count * width:
            each = values.size // max(rows * width, 1)
            self._notes.add(f"{where}: it has {each} {name} for {count} of them; they were dropped")
            return None
        if not sane(values):
            raise FormatError(f"its {name} hold impossible numbers", where=where)
        values = values.reshape(rows, count, width)
        codes = self._record.floats(found["times"])
        times = codes / self._rate
        if not sane(codes) or np.any(np.diff(times) <= 0):
            raise FormatError(f"the times of its {name} do not rise", where=where)
        if name == "rotations":
            values = wxyz(values)
        return times, values

    def _add_joint(self, clip: _Clip, joint: int, tracks: Mapping[str, tuple[Floats, Floats] | None]) -> None:
        rest, name = self._tree.skeleton.rest, self._tree.skeleton.names[joint]
        base = self._tree.bases.get(joint, Base())
        translations, rotations, scales = (tracks[n] for n in ("translations", "rotations", "scales"))
        if translations is not None:
            moved = base.scale * quat.rotate(base.rotation, translations[1]) + base.translation
            clip.add(name, Property.TRANSLATION, translations[0], moved * self._unit_m, rest.translations[joint])
        if rotations is not None:
            turned = quat.multiply(base.rotation, rotations[1])
            clip.add(name, Property.ROTATION, rotations[0], turned, rest.rotations[joint])
        if scales is not None:
            clip.add(name, Property.SCALE, scales[0], scales[1] * base.scale, rest.scales[joint])

    def _add_weight(self, clip: _Clip, channel: Driven, track: tuple[Floats, Floats] | None) -> None:
        if track is None:
            return
        times, weights = with_turning_points(channel.stops, track[0], track[1][:, 0])
        for morph, values in zip(channel.morphs, amounts(channel.stops, weights), strict=True):
            rest = self._rest_weights[morph : morph + 1]
            clip.add(self._morphs.names[morph], Property.WEIGHT, times, values[:, None], rest)

    def _add_prims(self, clip: _Clip) -> None:
        """The curves of prims that move."""
        for prim, joint in self._tree.joint_of_prim.items():
            item = self._record.facts["prims"][prim]
            if item["times"] is None:
                continue
            where = f"prim '{item['path']}'"
            codes = self._record.floats(item["times"])
            local = hierarchy.matrices(self._record, item["transform"], where)
            if len(codes) != len(local) or not sane(codes) or np.any(np.diff(codes) <= 0):
                raise FormatError("the times of its transforms do not rise", where=where)
            times = codes / self._rate
            translations, rotations, scales = hierarchy.trs(local, where, self._notes)
            tracks = {"translations": (times, translations), "rotations": (times, rotations), "scales": (times, scales)}
            self._add_joint(clip, joint, tracks)


class _Clip:
    """A clip under way: what rests is left out, what is constant has one key."""

    def __init__(self, rate: float) -> None:
        self._rate = rate
        self._curves: dict[Channel, Curve] = {}
        self._ends: list[float] = []
        self._constant: dict[Channel, Curve] = {}  # what has a value but no time
        self._moving = False

    def add(self, target: str, prop: Property, times: Floats, values: Array, rest: Array) -> None:
        """One curve, with the keys that the file has if it moves."""
        values = np.asarray(values, np.float64)
        rotation = prop is Property.ROTATION
        kind = CurveKind.ROTATION if rotation else CurveKind.SCALAR if prop is Property.WEIGHT else CurveKind.VECTOR
        self._ends += [float(t) for t in times[:1]] + [float(t) for t in times[-1:]]
        if rotation:
            values = np.asarray(quat.align_signs(np.concatenate([np.asarray(rest)[None], values]), axis=0))[1:]
        if float(np.ptp(values, axis=0).max()) > STILL:
            self._curves[Channel(target, prop)] = Curve(times, values, Interpolation.LINEAR, kind=kind)
            self._moving = True
        elif float(np.abs(values[0] - rest).max()) > STILL:
            curve = Curve(times[:1] if len(times) else [0.0], values[:1], Interpolation.LINEAR, kind=kind)
            (self._curves if len(times) else self._constant)[Channel(target, prop)] = curve

    def finish(self, tree: Hierarchy, name: str, rate: float | None) -> Clip | None:
        """The clip; one in which nothing moves keeps its length. None where the file gave no samples at all."""
        if not self._ends and not self._constant:
            return None
        first, last = min(self._ends, default=0.0), max(self._ends, default=0.0)
        for channel, curve in self._constant.items():
            self._curves[channel] = Curve([first], curve.values, Interpolation.LINEAR, kind=curve.kind)
        if not self._curves and (last <= first or not tree.skeleton.joint_count):
            return None  # the very rest pose, at one moment
        if not self._curves:
            held = np.asarray(tree.skeleton.rest.rotations[0])[None]
            kind = CurveKind.ROTATION
            self._curves[Channel(tree.skeleton.names[0], Property.ROTATION)] = Curve([first], held, kind=kind)
        ends = [t for c in self._curves.values() for t in (float(c.times_s[0]), float(c.times_s[-1]))]
        if last > first and (min(ends) > first or max(ends) < last):
            channel, curve = next(iter(self._curves.items()))
            self._curves[channel] = _lengthened(curve, first, last)
        return Clip(self._curves, name, self._rate if rate is None else rate)


def _lengthened(curve: Curve, first: float, last: float) -> Curve:
    """The curve with a key at both ends, which hold its value there."""
    times, values = list(curve.times_s), list(curve.values)
    if times[0] > first:
        times, values = [first, *times], [values[0], *values]
    if times[-1] < last:
        times, values = [*times, last], [*values, values[-1]]
    return Curve(np.array(times), np.stack(values), Interpolation.LINEAR, kind=curve.kind)


def _row(track: tuple[Floats, Floats] | None, row: int) -> tuple[Floats, Floats] | None:
    return None if track is None or row >= track[1].shape[1] else (track[0], track[1][:, row])


def _own_rate(item: Mapping[str, Any]) -> float | None:
    """The rate that keypose has written beside an animation."""
    rate = (item.get("own") or {}).get("rate_hz")
    return float(rate) if isinstance(rate, (int, float)) and 0 < rate < 1e6 else None


def wxyz(xyzw: Floats) -> Floats:
    """Unit quaternions from rows that begin with x."""
    turned = np.ascontiguousarray(xyzw[..., [3, 0, 1, 2]])
    length = np.linalg.norm(turned, axis=-1, keepdims=True)
    return np.where(length > 0, turned / np.where(length > 0, length, 1.0), [1.0, 0.0, 0.0, 0.0])
