"""COLLADA's animations: channels that move single numbers of transforms become curves of joints and morphs.

A node's transforms are put together at the keys of all its channels. Where what lies between two keys is not what
interpolating the joint gives (Bezier, several angles), keys are added between them until it is.

Source: COLLADA 1.4.1 specification, chapter 4 (curve interpolation), chapter 5 (animation, channel, sampler).
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from keypose.arrays import Floats
from keypose.errors import FormatError
from keypose.io.collada_nodes import TRANSFORMS, Node, decomposed, local_matrices
from keypose.io.collada_xml import Document, Element, attempt
from keypose.io.text import shown
from keypose.math import quat
from keypose.model import Channel, Clip, Curve, CurveKind, Interpolation, Property

_TURN_RAD, _MOVE_M, _FACTOR = 2e-5, 1e-5, 1e-5  # what keys are added for
_STILL = 1e-8
_HALVINGS = 10
_MOST_KEYS = 20_000  # of one curve, or four times its own
_MEMBERS = {"X": 0, "Y": 1, "Z": 2, "ANGLE": 3, "U": 0, "V": 1, "R": 0, "G": 1, "B": 2, "A": 3}
_TARGET = re.compile(r"^(.*?)(?:\.([A-Za-z]+)|\((\d{1,6})\)(?:\((\d{1,6})\))?)?$", re.DOTALL)


@dataclass(frozen=True, slots=True)
class Track:
    """The keys of one sampler: ``values`` (K, C); ``modes`` (K,) of words; tangents (K, C, 2) of time and value, or None."""

    times_s: Floats
    values: Floats
    modes: tuple[str, ...]
    ins: Floats | None
    outs: Floats | None

    def at(self, times_s: Floats) -> Floats:
        """The values (N, C) at some times; held before the first key and after the last."""
        own = self.times_s
        k = np.clip(np.searchsorted(own, times_s, side="right") - 1, 0, max(len(own) - 2, 0))
        after = np.minimum(k + 1, len(own) - 1)
        span = np.where(after > k, own[after] - own[k], 1.0)
        u = np.clip((times_s - own[k]) / span, 0.0, 1.0)
        result = self.values[k] + (self.values[after] - self.values[k]) * u[:, None]
        modes = np.array(self.modes)[k]
        step = modes == "STEP"
        result[step] = np.where((u[step] >= 1)[:, None], self.values[after[step]], self.values[k[step]])
        curved = np.isin(modes, ("BEZIER", "HERMITE")) & (u > 0) & (u < 1)
        if self.ins is not None and self.outs is not None and curved.any():
            a, b = k[curved], after[curved]
            start = np.stack(np.broadcast_arrays(own[a][:, None], self.values[a]), axis=-1)
            end = np.stack(np.broadcast_arrays(own[b][:, None], self.values[b]), axis=-1)
            result[curved] = _bezier(times_s[curved], start, self.outs[a], self.ins[b], end)
        return result


def _bezier(times_s: Floats, p0: Floats, c0: Floats, c1: Floats, p1: Floats) -> Floats:
    """Values (N, C) at times (N,) of cubics whose points (N, C, 2) are times and values.

    The parameter of a time is found by Newton's method, kept in a bracket by bisection; times of the inner points are kept
    within the span, so that there is one.
    """
    low_t, high_t = p0[..., 0], p1[..., 0]
    t0, t1 = (np.clip(c[..., 0], low_t, high_t) for c in (c0, c1))
    wanted = np.broadcast_to(times_s[:, None], low_t.shape)
    low, high = np.zeros(low_t.shape), np.ones(low_t.shape)
    span = high_t - low_t
    s = (wanted - low_t) / span  # exact where the inner points stand at thirds, as they often do
    for _ in range(60):
        off = _cubic(s, low_t, t0, t1, high_t) - wanted
        wrong = np.abs(off) > 1e-12 * span
        if not wrong.any():
            break
        low, high = np.where(off < 0, s, low), np.where(off < 0, high, s)
        r = 1 - s
        slope = 3 * (r * r * (t0 - low_t) + 2 * r * s * (t1 - t0) + s * s * (high_t - t1))
        newton = s - np.divide(off, slope, out=np.zeros_like(off), where=slope > 1e-9 * span)
        s = np.where(wrong, np.where((newton > low) & (newton < high), newton, 0.5 * (low + high)), s)
    return _cubic(s, p0[..., 1], c0[..., 1], c1[..., 1], p1[..., 1])


def _cubic(s: Floats, a: Floats, b: Floats, c: Floats, d: Floats) -> Floats:
    r = 1 - s
    return r * r * r * a + 3 * r * r * s * b + 3 * r * s * s * c + s * s * s * d


# --- reading samplers and channels ------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Drive:
    """A channel: ``track`` drives the components ``columns`` of transform ``place`` of a node."""

    node: int
    place: int
    columns: tuple[int, ...]
    track: Track


@dataclass(frozen=True, slots=True)
class MorphDrive:
    """A channel of morph weights, by the source of weights and its index."""

    source: Element
    first: int
    track: Track


class Animations:
    """All channels of a file, by the animation that they are in."""

    def __init__(self, document: Document, nodes: Sequence[Node]) -> None:
        self.document, self.nodes = document, nodes
        self.node_of: dict[int, int] = {}
        for index, node in enumerate(nodes):
            self.node_of.setdefault(id(node.element), index)
        self.lost: dict[str, int] = {}
        self.tracks: dict[int, Track] = {}
        self.found: dict[int, list[Drive | MorphDrive]] = {}

    def weight_marks(self) -> dict[tuple[int, int], frozenset[bytes]]:
        """For each weight, by its source's identity and place, what its animations are: equal for equal ones."""
        marks: dict[tuple[int, int], set[bytes]] = {}
        for animation in self.document.library("library_animations", "animation"):
            for drive in self.channels(animation):
                if not isinstance(drive, MorphDrive):
                    continue
                track = drive.track
                for column in range(track.values.shape[1]):
                    mark = b"|".join((track.times_s.tobytes(), track.values[:, column].tobytes()))
                    marks.setdefault((id(drive.source), drive.first + column), set()).add(mark)
        return {key: frozenset(values) for key, values in marks.items()}

    def channels(self, animation: Element) -> list[Drive | MorphDrive]:
        """The channels of an animation and of those inside it."""
        if id(animation) not in self.found:
            self.found[id(animation)] = self._channels(animation)
        return self.found[id(animation)]

    def _channels(self, animation: Element) -> list[Drive | MorphDrive]:
        found: list[Drive | MorphDrive] = []
        for element in animation.walk():
            if element.tag != "channel":
                continue
            drive = attempt(
                self.document, f"the animation of {shown(element.get('target'))}", lambda e=element: self.channel(e)
            )
            if drive is not None:
                found.append(drive)
        return found

    def channel(self, element: Element) -> Drive | MorphDrive | None:
        target = element.get("target").strip()
        match = _TARGET.match(target)
        path, member, first, second = match.groups() if match else (target, None, None, None)
        head, *sids = path.split("/")
        root = self.document.find(head)
        if root is None:
            self.miss("things that are not in the file")
            return None
        if not sids and root.tag in ("source", "float_array"):
            source = root if root.tag == "source" else root.parent
            if source is None:
                return None
            return MorphDrive(source, int(first or 0), self.track(element))
        found = root
        for sid in sids:
            below = next((e for e in found.walk() if e is not found and e.get("sid") == sid), None)
            if below is None:
                self.miss("things that are not in the file")
                return None
            found = below
        if found.tag == "morph" or root.tag == "controller":
            weights = _morph_weights(self.document, root)
            if weights is not None:
                return MorphDrive(weights, int(first or 0), self.track(element))
        owner = found.parent
        node = self.node_of.get(id(owner)) if owner is not None else None
        if node is None or found.tag not in TRANSFORMS or owner is None:
            self.miss("cameras, lights, materials or what is not shown")
            return None
        place = next(i for i, child in enumerate(c for c in owner.children if c.tag in TRANSFORMS) if child is found)
        width = TRANSFORMS[found.tag]
        if first is not None and second is not None:
            columns: tuple[int, ...] = (4 * int(first) + int(second),)
        elif first is not None:
            columns = (int(first),)
        elif member is not None:
            if member.upper() not in _MEMBERS:
                raise element.error(f"target {shown(target)}: there is no member {shown(member)}")
            columns = (_MEMBERS[member.upper()],)
        else:
            columns = tuple(range(width))
        if max(columns) >= width:
            raise element.error(f"target {shown(target)}: a {found.tag} has {width} numbers")
        track = self.track(element)
        if track.values.shape[1] < len(columns):
            # some exporters animate a rotation as its angle alone without saying so
            if found.tag == "rotate" and track.values.shape[1] == 1:
                columns = (3,)
            else:
                raise element.error(
                    f"target {shown(target)}: {track.values.shape[1]} numbers per key for {len(columns)} of the transform"
                )
        return Drive(node, place, columns, track)

    def miss(self, what: str) -> None:
        self.lost[what] = self.lost.get(what, 0) + 1

    def track(self, channel: Element) -> Track:
        sampler = self.document.target(channel, "source", "sampler")
        stored = self.tracks.get(id(sampler))
        if stored is None:
            stored = self.tracks[id(sampler)] = self._track(sampler)
        return stored

    def _track(self, sampler: Element) -> Track:
        inputs = self.document.inputs(sampler)
        for semantic in ("INPUT", "OUTPUT"):
            if semantic not in inputs:
                raise sampler.error(f"it has no {semantic}")
        times, values = self.document.table(inputs["INPUT"])[:, 0], self.document.table(inputs["OUTPUT"])
        if len(times) != len(values) or not len(times):
            raise sampler.error(f"{len(times)} times for {len(values)} values")
        if np.abs(times).max() > 1e7:
            raise sampler.error(f"a key at {np.abs(times).max():.3g} s")
        words = ["LINEAR"] * len(times)
        if "INTERPOLATION" in inputs:
            words = [word.upper() for word in self.document.words(inputs["INTERPOLATION"])]
            if len(words) != len(times):
                raise sampler.error(f"{len(words)} interpolations for {len(times)} keys")
        unknown = sorted(set(words) - {"LINEAR", "STEP", "BEZIER", "HERMITE"})
        if unknown:
            self.document.note(f"keys of interpolation {', '.join(map(shown, unknown[:3]))} are joined by lines")
            words = ["LINEAR" if word in unknown else word for word in words]
        order = np.argsort(times, kind="stable")
        kept = order[np.concatenate([np.diff(times[order]) > 0, [True]])]  # of keys at one time the last counts
        if len(kept) < len(times) or np.any(order != np.arange(len(order))):
            self.document.note("keys that were not in order of time, or at one time, were put right")
        ins, outs = (self.tangents(inputs.get(name), times, values) for name in ("IN_TANGENT", "OUT_TANGENT"))
        modes = tuple(words[i] for i in kept)
        times, values = times[kept], values[kept]
        if ins is None or outs is None:
            if {"BEZIER", "HERMITE"} & set(modes):
                self.document.note("curves without tangents are joined by lines")
            return Track(times, values, modes, None, None)
        return Track(times, values, modes, *_control_points(times, values, modes, ins[kept], outs[kept]))

    def tangents(self, source: Element | None, times: Floats, values: Floats) -> Floats | None:
        """Tangents (K, C, 2); NaN times where the file has values only."""
        if source is None:
            return None
        table = self.document.table(source)
        count, width = values.shape
        if len(table) * table.shape[1] == count * width * 2 and table.size:
            return table.reshape(count, width, 2)
        if table.shape == values.shape:
            return np.stack([np.full(values.shape, np.nan), table], axis=-1)
        raise source.error(f"{table.shape[0]} x {table.shape[1]} tangents for {count} keys of {width} numbers")


def _control_points(
    times: Floats, values: Floats, modes: Sequence[str], ins: Floats, outs: Floats
) -> tuple[Floats, Floats]:
    """The inner points of the cubics at each key: Bezier as they are, Hermite's vectors made points."""
    gaps = np.diff(times)
    before = np.concatenate([gaps[:1], gaps]) if len(gaps) else np.ones(1)
    behind = np.concatenate([gaps, gaps[-1:]]) if len(gaps) else np.ones(1)
    leaving = np.array([mode == "HERMITE" for mode in modes])
    arriving = np.concatenate([leaving[:1], leaving[:-1]])
    result: list[Floats] = []
    for points, gap, hermite, sign in ((ins, before, arriving, -1.0), (outs, behind, leaving, 1.0)):
        points = np.array(points)
        one = np.isnan(points[..., 0])
        third = np.broadcast_to((times + sign * gap / 3)[:, None], one.shape)
        own = np.broadcast_to(times[:, None], one.shape)
        as_point_t = np.where(one, third, np.where(hermite[:, None], own + sign * points[..., 0] / 3, points[..., 0]))
        as_point_v = np.where(hermite[:, None], values + sign * points[..., 1] / 3, points[..., 1])
        result.append(np.stack([as_point_t, as_point_v], axis=-1))
    return result[0], result[1]


def _morph_weights(document: Document, controller: Element) -> Element | None:
    morph = controller if controller.tag == "morph" else controller.first("morph")
    targets = morph.first("targets") if morph else None
    return document.inputs(targets).get("MORPH_WEIGHT") if targets else None


# --- curves -----------------------------------------------------------------------------------------------------------------


def node_curves(
    document: Document,
    node: Node,
    drives: Sequence[Drive],
    unit_m: float,
    turn: Floats | None,
    span: tuple[float, float] | None,
) -> dict[Property, Curve]:
    """The curves of one node: what its transforms do together; ``turn`` is the rotation of a root to Y up."""

    def at(times: Floats) -> tuple[Floats, Floats, Floats]:
        values: dict[int, Floats] = {}
        for drive in drives:
            numbers = node.transforms[drive.place][2]
            if drive.place not in values:
                values[drive.place] = np.tile(numbers, (len(times), 1))
            values[drive.place][:, drive.columns] = drive.track.at(times)[:, : len(drive.columns)]
        translations, rotations, scales = decomposed(document, node, local_matrices(node, values, len(times)), unit_m)
        if turn is not None:
            translations, rotations = quat.rotate(turn, translations), quat.multiply(turn, rotations)
        return translations, np.asarray(quat.align_signs(rotations, axis=0)), scales

    tracks = [drive.track for drive in drives]
    # a matrix whose numbers run on lines is meant as a moving frame: its keys are what counts
    whole = all(node.transforms[d.place][0] == "matrix" and len(d.columns) == 16 for d in drives)
    times = _key_times(tracks, span, at, exact=whole)
    found = at(times)
    steps = _steps(tracks, times)
    curves: dict[Property, Curve] = {}
    rest = decomposed(document, node, local_matrices(node, {}, 1), unit_m)
    if turn is not None:
        rest = (quat.rotate(turn, rest[0]), quat.multiply(turn, rest[1]), rest[2])
    for kind, values, still in zip((Property.TRANSLATION, Property.ROTATION, Property.SCALE), found, rest, strict=True):
        flat = np.abs(values - values[:1]).max() < _STILL
        at_rest = (
            min(
                np.abs(values[0] - still[0]).max(),
                np.abs(values[0] + still[0]).max() if kind is Property.ROTATION else np.inf,
            )
            < _STILL
        )
        if flat and at_rest and kind is Property.SCALE:
            continue
        keys, shown_values, modes = times, values, steps
        if flat:  # its length still counts
            ends = [0, -1] if len(times) > 1 else [0]
            keys, shown_values, modes = times[ends], values[ends], steps[ends]
        curve_kind = CurveKind.ROTATION if kind is Property.ROTATION else CurveKind.VECTOR
        curves[kind] = Curve(keys, shown_values, modes, kind=curve_kind)
    return curves


def weight_curve(track: Track, column: int, span: tuple[float, float] | None) -> Curve:
    """The curve of one morph weight."""

    def at(times: Floats) -> tuple[Floats, ...]:
        return (track.at(times)[:, column : column + 1],)

    times = _key_times([track], span, at, exact=False)
    return Curve(times, at(times)[0], _steps([track], times), kind=CurveKind.SCALAR)


def _steps(tracks: Sequence[Track], times: Floats) -> Any:
    """The mode of each key: STEP where no channel moves on."""
    moving = np.zeros(len(times), bool)
    for track in tracks:
        k = np.clip(np.searchsorted(track.times_s, times, side="right") - 1, 0, len(track.times_s) - 1)
        inside = (times >= track.times_s[0]) & (times < track.times_s[-1])
        moving |= inside & (np.array(track.modes)[k] != "STEP")
    stepping = any("STEP" in track.modes for track in tracks)
    return np.where(moving | (not stepping), int(Interpolation.LINEAR), int(Interpolation.STEP)).astype(np.uint8)


def _key_times(
    tracks: Sequence[Track],
    span: tuple[float, float] | None,
    at: Callable[[Floats], tuple[Floats, ...]],
    *,
    exact: bool,
) -> Floats:
    """The keys of all tracks, within the span if there is one, and more where lines between them are not enough."""
    times = np.unique(np.concatenate([track.times_s for track in tracks]))
    if len(tracks) > 1 and any("STEP" in track.modes for track in tracks):
        # what steps beside what moves: a key just before the step keeps it one
        jumps = np.unique(np.concatenate([t.times_s[1:] for t in tracks if "STEP" in t.modes] or [np.zeros(0)]))
        times = np.unique(np.concatenate([times, np.nextafter(jumps.astype(np.float32), np.float32(-np.inf))]))
    if span is not None:
        start, end = span
        inside = times[(times > start) & (times < end)]
        times = np.concatenate([[start], inside, [end]]) if end > start else np.array([start])
    if exact or all(set(track.modes) == {"STEP"} for track in tracks):
        return times
    return refined(times, at)


def refined(times: Floats, at: Callable[[Floats], tuple[Floats, ...]]) -> Floats:
    """Times with more between them, until lines (of rotations: arcs) through what is ``at`` them are near enough."""
    most = max(_MOST_KEYS, 4 * len(times))
    for _ in range(_HALVINGS):
        if len(times) < 2 or len(times) > most:
            break
        # three places: a curve may cross its chord in the middle
        ends, gaps = at(times), np.diff(times)
        bad = np.zeros(len(gaps), bool)
        for share in (0.25, 0.5, 0.75):
            for values, between in zip(ends, at(times[:-1] + share * gaps), strict=True):
                bad |= _far(values[:-1], values[1:], between, share)
        bad &= gaps > 1e-5
        if not bad.any():
            break
        times = np.sort(np.concatenate([times, (times[:-1] + 0.5 * gaps)[bad]]))
    return times


def _far(first: Floats, second: Floats, between: Floats, share: float) -> Any:
    """Where a line, at some share of its length, is not at what is really there."""
    if first.shape[1] == 4:
        on_arc = quat.slerp(first, second, np.full(len(first), share))
        return np.asarray(quat.angle_between(on_arc, between)) > _TURN_RAD
    limit = _MOVE_M if first.shape[1] == 3 else _FACTOR
    return np.abs((1 - share) * first + share * second - between).max(axis=1) > limit


def clips(
    document: Document,
    animations: Animations,
    joint_of_node: dict[int, int],
    names: Sequence[str],
    weights: dict[int, list[str]],
    unit_m: float,
    turns: dict[int, Floats],
    name: str,
) -> list[Clip]:
    """The clips of a file: those it names, and one of all animations that are in none of them.

    ``weights`` has the morph channels of each source of weights, by its identity.
    """
    top = document.library("library_animations", "animation")
    groups: list[tuple[str, list[Element], tuple[float, float] | None]] = []
    used: set[int] = set()
    for element in document.library("library_animation_clips", "animation_clip"):
        members = [
            found
            for instance in element.all("instance_animation")
            if (found := document.find(instance.get("url"))) is not None and found.tag == "animation"
        ]
        used |= {id(m) for m in members}
        start = _attribute(element, "start", 0.0)
        end = _attribute(element, "end", np.inf)
        groups.append((element.named(), members, (start, end) if np.isfinite(end) and end >= start else None))
    rest = [animation for animation in top if id(animation) not in used]
    if rest:
        groups.append((name, rest, None))
    result: list[Clip] = []
    taken: set[str] = set()
    for title, members, span in groups:
        drives = [drive for member in members for drive in animations.channels(member)]
        curves = _curves(document, animations.nodes, drives, joint_of_node, names, weights, unit_m, turns, span)
        if curves:
            title = title or f"clip_{len(result) + 1}"
            while title in taken:
                title += "_"
            taken.add(title)
            result.append(Clip(curves, title, _rate([drive.track for drive in drives])))
    for what, count in animations.lost.items():
        document.note(f"{count} animation channels of {what} were dropped")
    return result


def _curves(
    document: Document,
    nodes: Sequence[Node],
    drives: Sequence[Drive | MorphDrive],
    joint_of_node: dict[int, int],
    names: Sequence[str],
    weights: dict[int, list[str]],
    unit_m: float,
    turns: dict[int, Floats],
    span: tuple[float, float] | None,
) -> dict[Channel, Curve]:
    by_node: dict[int, list[Drive]] = {}
    curves: dict[Channel, Curve] = {}
    dropped = 0
    for drive in drives:
        if isinstance(drive, Drive):
            by_node.setdefault(drive.node, []).append(drive)
            continue
        channels = weights.get(id(drive.source), [])
        for column in range(drive.track.values.shape[1]):
            if drive.first + column < len(channels):
                channel = Channel(channels[drive.first + column], Property.WEIGHT)
                curves.setdefault(channel, weight_curve(drive.track, column, span))
    for index, own in by_node.items():
        joint = joint_of_node.get(index)
        if joint is None:
            dropped += len(own)
            continue
        node = nodes[index]
        what = f"the animation of node {shown(node.element.named())}"
        made = attempt(
            document, what, lambda n=node, o=own, i=index: node_curves(document, n, o, unit_m, turns.get(i), span)
        )
        for kind, curve in (made or {}).items():
            curves[Channel(names[joint], kind)] = curve
    if dropped:
        document.note(f"{dropped} animation channels of nodes that hold neither mesh nor joint were dropped")
    return curves


def _attribute(element: Element, name: str, default: float) -> float:
    try:
        value = float(element.get(name) or default)
    except ValueError:
        raise FormatError(f"<{element.tag}>: {name} is no number", where=f"line {element.line}") from None
    return value if abs(value) < 1e7 else default


def _rate(tracks: Sequence[Track]) -> float | None:
    """The rate at which the file's own keys lie, if they do; keys that were added between them do not count."""
    from keypose.evaluate import key_rate

    curves = {
        Channel(str(i), Property.WEIGHT): Curve(t.times_s, np.zeros((len(t.times_s), 1)), kind=CurveKind.SCALAR)
        for i, t in enumerate(tracks[:64])
    }
    return key_rate(Clip(curves))
