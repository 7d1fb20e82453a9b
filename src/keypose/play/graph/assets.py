"""Clips as the graph plays them: matched to the skeleton, cut, root motion taken out, contacts found, all in float64."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from keypose.analysis.contacts import contact_changes, find_contacts
from keypose.arrays import Floats
from keypose.errors import ShapeError
from keypose.evaluate import bake, key_rate, match, world_rotations_positions
from keypose.math import quat
from keypose.model import Clip, Motion, Pose, Skeleton
from keypose.play.graph.checking import GraphError
from keypose.play.graph.definition import ClipSource, Contact
from keypose.play.graph.rootmotion import Track, compose, extract, repeated


@dataclass(frozen=True, slots=True, eq=False)
class ClipAsset:
    """A clip ready to play.

    Shapes and units: translations (T, J, 3), rotations (T, J, 4), scales (T, J, 3) with the root's travel taken out;
    curves (T, C); effectors (T, E, 3) places of the contacts in the character's space, touching (T, E) 0 or 1;
    events as (time, name, data) in order; markers as (time, name) in order. ``duration_s`` is 0 for a clip of one frame.
    """

    name: str
    rate_hz: float
    duration_s: float
    cyclic: bool
    translations: Floats
    rotations: Floats
    scales: Floats
    curves: Floats
    effectors: Floats
    touching: Floats
    track: Track
    markers: tuple[tuple[float, str], ...]
    events: tuple[tuple[float, str, str], ...]


def make_asset(
    name: str,
    animation: Motion | Clip,
    source: ClipSource,
    skeleton: Skeleton,
    *,
    root: int,
    contacts: Mapping[str, Contact],
    curve_names: Sequence[str],
    rest_curves: Floats,
) -> ClipAsset:
    """A clip of the graph from an animation.

    Raises:
        GraphError: where the animation is empty, cut to nothing or has joints of other skeletons only.
    """
    motion = _motion(name, animation, source, skeleton)
    pose = motion.pose.broadcast()
    translations, scales = (np.array(a, np.float64) for a in (pose.translations, pose.scales))
    rotations = quat.align_signs(quat.normalize(np.array(pose.rotations, np.float64)))
    if not all(np.all(np.isfinite(a)) for a in (translations, rotations, scales)):
        raise GraphError("", f"clips['{name}']", "it holds numbers that are not finite")
    used = skeleton.index(source.root) if source.root else root
    track, rotations, translations = _without_travel(
        name, skeleton, used, motion.rate_hz, source, rotations, translations, scales
    )
    curves = _curves(motion, curve_names, rest_curves)
    if source.close_loop and motion.frame_count > 2:
        rotations, translations, scales, curves = _closed(rotations, translations, scales, curves)
    local = Pose(translations, rotations, scales)
    _, positions = world_rotations_positions(skeleton, local)
    index = [skeleton.index(contact.joint) for contact in contacts.values()]
    effectors = np.asarray(positions)[:, index]
    cyclic = source.cyclic and motion.frame_count > 2
    effectors, touching, found = _contacts(effectors, track, contacts, motion.rate_hz, cyclic)
    duration = motion.duration_s
    for i, marker in enumerate(source.markers):
        if not 0 <= marker.time_s <= duration:
            raise GraphError(
                "", f"clips['{name}'].markers[{i}]", f"{marker.time_s:g} s is outside the clip of {duration:g} s"
            )
    for i, event in enumerate(source.events):
        if not 0 <= event.time_s <= duration:
            raise GraphError(
                "", f"clips['{name}'].events[{i}]", f"{event.time_s:g} s is outside the clip of {duration:g} s"
            )
    markers = sorted([*found, *((m.time_s, m.name) for m in source.markers)])
    own = [(e.time_s - motion.start_s, e.name, e.data) for e in motion.events]
    events = sorted(
        [*(e for e in own if 0 <= e[0] <= duration), *((e.time_s, e.name, e.data) for e in source.events)],
        key=lambda e: e[0],
    )
    arrays = (translations, rotations, scales, curves, effectors, touching)
    for array in arrays:
        array.setflags(write=False)
    return ClipAsset(name, motion.rate_hz, duration, cyclic, *arrays, track, tuple(markers), tuple(events))


def find_cycle(
    motion: Motion, *, shortest_s: float = 0.6, longest_s: float = 2.5, margin_s: float = 0.0
) -> tuple[float, float]:
    """Start and end of the cycle of a motion that repeats best, in seconds from its first frame.

    Of all pairs of frames a fitting time apart, the pair whose poses (all joints but the first) and whose neighbours'
    poses are most alike. ``margin_s`` leaves out the motion's beginning and end.

    Raises:
        ShapeError: where the motion is shorter than the shortest cycle.

    Source: the similarity of frames of Kovar, Gleicher and Pighin, "Motion Graphs" (SIGGRAPH 2002), on rotations.
    """
    rotations = np.asarray(motion.pose.broadcast().rotations, np.float64)[:, 1:]
    count, beside = len(rotations), 2
    first, last = round(margin_s * motion.rate_hz), count - 1 - round(margin_s * motion.rate_hz)
    best: tuple[float, int, int] | None = None
    for lag in range(max(round(shortest_s * motion.rate_hz), 1), round(longest_s * motion.rate_hz) + 1):
        if last - lag < first:
            break
        cosines = np.abs(np.sum(rotations[: count - lag] * rotations[lag:], axis=-1))
        apart = np.mean(1.0 - np.minimum(cosines, 1.0), axis=-1)
        near = [apart[np.clip(np.arange(len(apart)) + k, 0, len(apart) - 1)] for k in (-beside, 0, beside)]
        error = np.sum(near, axis=0)[first : last - lag + 1]
        at = int(np.argmin(error))
        if best is None or error[at] < best[0]:
            best = float(error[at]), first + at, first + at + lag
    if best is None:
        raise ShapeError(f"find_cycle: a motion of {motion.duration_s:g} s holds no cycle of {shortest_s:g} s")
    return best[1] / motion.rate_hz, best[2] / motion.rate_hz


def _motion(name: str, animation: Motion | Clip, source: ClipSource, skeleton: Skeleton) -> Motion:
    if isinstance(animation, Clip):
        morphs = tuple(dict.fromkeys(c.target for c in animation.curves if c.property.value == "weight"))
        animation = bake(animation, skeleton, key_rate(animation) or 60.0, morph_names=morphs)
    if animation.frame_count == 0:
        raise GraphError("", f"clips['{name}']", "the animation has no frames")
    matched = match(animation, skeleton)
    start = 0 if source.start_s is None else round(source.start_s * matched.rate_hz)
    end = matched.frame_count - 1 if source.end_s is None else round(source.end_s * matched.rate_hz)
    if not 0 <= start <= end < matched.frame_count:
        raise GraphError(
            "",
            f"clips['{name}']",
            f"cut from {start / matched.rate_hz:g} s to {end / matched.rate_hz:g} s of an animation of {matched.duration_s:g} s",
        )
    if start == 0 and end == matched.frame_count - 1:
        return matched
    weights = None if matched.morph_weights is None else matched.morph_weights[start : end + 1]
    return replace(
        matched,
        pose=matched.pose[start : end + 1],
        morph_weights=weights,
        start_s=matched.start_s + start / matched.rate_hz,
    )


def _without_travel(
    name: str,
    skeleton: Skeleton,
    root: int,
    rate_hz: float,
    source: ClipSource,
    rotations: Floats,
    translations: Floats,
    scales: Floats,
) -> tuple[Track, Floats, Floats]:
    """Takes the travel of one joint out of the clip; the joints above it are pulled along."""
    world_rotations, world_positions = world_rotations_positions(skeleton, Pose(translations, rotations, scales))
    rest_rotations, _ = world_rotations_positions(skeleton, skeleton.rest)
    at_rest = np.asarray(rest_rotations[root], np.float64)
    track, remaining, moved = extract(
        world_rotations[:, root], world_positions[:, root], rate_hz, source.root_motion, at_rest
    )
    if source.root_motion == "none":
        return track, rotations, translations
    # world = ground * pose: every skeleton root is seen from the ground frame instead of the world.
    into = quat.multiply(remaining, quat.conjugate(world_rotations[:, root]))
    base = world_positions[:, root] - quat.rotate(quat.conjugate(into), moved)
    rotations, translations = rotations.copy(), translations.copy()
    for top in np.flatnonzero(skeleton.parents < 0):
        rotations[:, top] = quat.multiply(into, rotations[:, top])
        translations[:, top] = quat.rotate(into, translations[:, top] - base)
    return track, quat.align_signs(rotations), translations


def _curves(motion: Motion, names: Sequence[str], rest: Floats) -> Floats:
    curves = np.tile(np.asarray(rest, np.float64), (motion.frame_count, 1))
    if motion.morph_weights is not None:
        for column, name in enumerate(names):
            if name in motion.morph_names:
                curves[:, column] = motion.morph_weights[:, motion.morph_names.index(name)]
    return curves


def _closed(
    rotations: Floats, translations: Floats, scales: Floats, curves: Floats
) -> tuple[Floats, Floats, Floats, Floats]:
    """The gap between last and first frame, shared out evenly: half a gap at each end, none in the middle."""
    share = np.linspace(0.5, -0.5, len(rotations))
    gap = quat.shortest(quat.difference(rotations[0], rotations[-1]))
    turned = quat.multiply(quat.power(gap, share[:, None]), rotations)
    moved = [a + share.reshape(-1, *([1] * (a.ndim - 1))) * (a[-1] - a[0]) for a in (translations, scales, curves)]
    return quat.align_signs(turned), moved[0], moved[1], moved[2]


def _contacts(
    effectors: Floats, track: Track, contacts: Mapping[str, Contact], rate_hz: float, cyclic: bool
) -> tuple[Floats, Floats, list[tuple[float, str]]]:
    """Places (T, E, 3) that stand still in the world while they touch, flags (T, E), and moments NAME.down, NAME.up."""
    frames = len(effectors)
    touching = np.zeros((frames, len(contacts)))
    found: list[tuple[float, str]] = []
    if frames < 2:
        return effectors, touching, found
    world = _to_world(effectors, track, range(frames))
    for e, (name, contact) in enumerate(contacts.items()):
        flags = find_contacts(
            world[:, [e]], rate_hz, height_m=contact.height_m, speed_m_s=contact.speed_m_s, cyclic=cyclic
        )[:, 0]
        touching[:, e] = flags
        begins, ends = contact_changes(flags, cyclic)
        found += [(float(f) / rate_hz, f"{name}.down") for f in begins]
        found += [(float(f) / rate_hz, f"{name}.up") for f in ends]
    # Three rounds of a cycle side by side: contacts that go on over the seam are one contact.
    period = frames - 1
    rounds = range(-period, 2 * period + 1) if cyclic else range(frames)
    index = np.array([f % period if cyclic and f != period else f for f in rounds])
    places = _to_world(effectors[index], track, rounds)
    places = places + _still_offsets(places, touching[index] > 0)
    if cyclic:
        places = places[period : 2 * period + 1]
    return _to_world(places, track, range(frames), back=True), touching, found


def _to_world(points: Floats, track: Track, frames: Sequence[int], back: bool = False) -> Floats:
    """Points (F, E, 3) of the character's space at frames (also of earlier and later rounds) in the world, or back."""
    period = len(track.ground) - 1
    ground = np.array(
        [
            compose(repeated(track.ground_at(period), f // period), track.ground_at(f % period))
            if not 0 <= f <= period
            else track.ground_at(f)
            for f in frames
        ]
    )
    yaw = quat.from_axis_angle(np.array([0.0, 1.0, 0.0]), ground[:, 2])[:, None]
    base = np.stack([ground[:, 0], np.zeros(len(ground)), ground[:, 1]], axis=-1)[:, None]
    return quat.rotate(quat.conjugate(yaw), points - base) if back else quat.rotate(yaw, points) + base


def _still_offsets(places: Floats, touching: np.ndarray) -> Floats:
    """What moves each point (F, E, 3) to its mean place during every contact, even in between."""
    offsets = np.zeros_like(places)
    frames = np.arange(len(places))
    for e in range(places.shape[1]):
        edges = np.flatnonzero(np.diff(np.concatenate([[0], touching[:, e].astype(np.int8), [0]])))
        for start, end in zip(edges[::2], edges[1::2], strict=True):
            offsets[start:end, e] = places[start:end, e].mean(axis=0) - places[start:end, e]
        known = touching[:, e]
        if known.any():
            for axis in range(3):
                offsets[:, e, axis] = np.interp(frames, frames[known], offsets[known, e, axis])
    return offsets


def marker_pattern(markers: Sequence[tuple[float, str]], names: Sequence[str]) -> list[tuple[float, str]]:
    """The markers of those names (all if none are given), in order of time; ``*.down`` names all that end so."""

    def wanted(name: str) -> bool:
        return any(name == n or (n.startswith("*") and name.endswith(n[1:])) for n in names)

    return [(time, name) for time, name in markers if wanted(name)]
