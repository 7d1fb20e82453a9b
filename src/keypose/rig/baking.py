"""Rigs along time: clips and timelines that hold keys on controls become motions of the joints."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from keypose.arrays import Array
from keypose.errors import ShapeError
from keypose.evaluate import bake_timeline, match, performing, sample_timeline, sample_timeline_values
from keypose.model import (
    Character,
    Clip,
    Document,
    Layer,
    Motion,
    Placement,
    Pose,
    Property,
    Rig,
    Scene,
    Skeleton,
    Timeline,
)
from keypose.rig.solve import RigResult, solve_rig

_SLACK = 1e-6
_FILM_HZ = performing.FILM_HZ


@lru_cache(maxsize=16)
def rigged_skeleton(rig: Rig, skeleton: Skeleton) -> Skeleton:
    """Joints and controls as one skeleton, joints first: what clips with keys on both are sampled for.

    Raises:
        ShapeError: where a control is called like a joint.
    """
    controls = rig.controls
    parents = np.where(controls.parents < 0, -1, controls.parents + skeleton.joint_count)
    rests = skeleton.rest, controls.rest
    names = ("translations", "rotations", "scales")
    rest = Pose(*(np.concatenate([np.asarray(getattr(r, n), np.float64) for r in rests]) for n in names))
    return Skeleton((*skeleton.names, *controls.names), np.concatenate([skeleton.parents, parents]), rest)


def is_keyed(rig: Rig, timeline: Timeline, animations: Mapping[str, Clip | Motion]) -> bool:
    """Whether a timeline holds a key on a control or attribute; until it does, a rig leaves its character's joints alone."""
    controls, values = set(rig.controls.names), {a.name for a in rig.attributes}
    for layer in timeline.layers:
        for placement in layer.placements:
            clip = animations.get(placement.animation)
            if isinstance(clip, Clip) and any(
                c.target in (values if c.property is Property.VALUE else controls) for c in clip.curves
            ):
                return True
    return False


def sample_rig(
    rig: Rig, skeleton: Skeleton, timeline: Timeline, animations: Mapping[str, Clip | Motion], times_s: Any
) -> RigResult:
    """What a rig makes of a timeline's keys at times of any shape: its joints, and where its controls are.

    Shapes and units: ``times_s`` (*B,) seconds of the timeline. Keys on joints that no module moves, and below IK, count as the
    base pose.

    Raises:
        ShapeError: where a time is not finite, or the rig does not fit the skeleton.
        UnknownName: where a placement names no animation.
    """
    used = {p.animation for layer in timeline.layers for p in layer.placements}
    own = {name: bound(animations[name], rig, skeleton) for name in used if name in animations}
    whole = sample_timeline(timeline, own, rigged_skeleton(rig, skeleton), times_s)
    count = skeleton.joint_count
    parts = [(a[..., :count, :], a[..., count:, :]) for a in (whole.translations, whole.rotations, whole.scales)]
    base, controls = Pose(*(p[0] for p in parts)), Pose(*(p[1] for p in parts))
    names = [a.name for a in rig.attributes]
    defaults = np.array([a.default for a in rig.attributes])
    sampled = sample_timeline_values(timeline, animations, names, times_s, defaults)
    values = {name: sampled[..., n] for n, name in enumerate(names)}
    return solve_rig(rig, skeleton, controls, values, base)


@lru_cache(maxsize=16)
def bound(animation: Clip | Motion, rig: Rig, skeleton: Skeleton) -> Clip | Motion:
    """An animation by the names of a skeleton's joints and of a rig's controls.

    Joints go by similar names as in `evaluate.match`. Controls go by their own names alone, and by channels of clips alone: a
    motion, or a file's ``mixamorig:Head``, says nothing of a control ``head``.
    """
    if isinstance(animation, Motion):
        return match(animation, skeleton)
    controls, joints = set(rig.controls.names), set(skeleton.names)
    moving = {c.target for c in animation.curves if c.property not in (Property.WEIGHT, Property.VALUE)}
    if moving <= controls | joints:
        return animation
    own = {c: v for c, v in animation.curves.items() if c.target in controls}
    others = match(replace(animation, curves={c: v for c, v in animation.curves.items() if c not in own}), skeleton)
    orders = {name: order for name, order in animation.euler_orders.items() if name in controls}
    return replace(others, curves={**others.curves, **own}, euler_orders={**others.euler_orders, **orders})


def bake_rig_timeline(
    rig: Rig,
    skeleton: Skeleton,
    timeline: Timeline,
    animations: Mapping[str, Clip | Motion],
    rate_hz: float | None = None,
    morph_names: Sequence[str] = (),
    rest_morph_weights: Array | None = None,
) -> Motion:
    """A timeline with keys on controls as a motion of the joints, from its start to its end, at its rate or ``rate_hz``.

    Raises:
        ShapeError: where the rate is not positive.
        UnknownName: where a placement names no animation.
    """
    below = bake_timeline(timeline, animations, skeleton, rate_hz, morph_names, rest_morph_weights)
    solved = sample_rig(rig, skeleton, timeline, animations, below.times_s)
    weights = below.morph_weights
    driven = [(m, solved.values[name]) for m, name in enumerate(below.morph_names) if name in _driven_morphs(rig)]
    if driven and weights is not None:
        weights = np.array(weights)
        for column, weight in driven:
            weights[:, column] = weight
    return replace(below, pose=solved.pose, morph_weights=weights)


def bake_rig(
    rig: Rig,
    skeleton: Skeleton,
    clip: Clip,
    rate_hz: float | None = None,
    start_s: float | None = None,
    end_s: float | None = None,
) -> Motion:
    """A clip with keys on controls as a motion of the joints, from its first key to its last, at its own or film's rate.

    Raises:
        ShapeError: where the rate is not positive or the end comes before the start.
    """
    rate = clip.rate_hz or _FILM_HZ if rate_hz is None else float(rate_hz)
    start = clip.start_s if start_s is None else float(start_s)
    end = clip.end_s if end_s is None else float(end_s)
    if not (math.isfinite(rate) and rate > 0):
        raise ShapeError(f"rate_hz: expected more than 0, got {rate}")
    if end < start:
        raise ShapeError(f"end_s: expected a time at or after {start} s, got {end} s")
    timeline = alone(clip)
    times = start + np.arange(math.floor((end - start) * rate + _SLACK) + 1) / rate
    solved = sample_rig(rig, skeleton, timeline, {clip.name: clip}, times)
    return Motion(skeleton.names, solved.pose, rate, name=clip.name, start_s=start)


def alone(clip: Clip) -> Timeline:
    """A timeline that plays one clip in the clip's own time."""
    return Timeline((Layer(performing.BASE_LAYER, (Placement(clip.name, in_s=0.0),)),), clip.name, start_s=0.0)


def perform(
    document: Document, character: str | None = None, timeline: str | None = None, rate_hz: float | None = None
) -> Scene:
    """The characters of a document and what their timelines make of them, controls of rigs baked to joints.

    As `evaluate.performing.perform`, for documents with rigs.

    Raises:
        UnknownName: for a character, timeline or clip that is not there.
        ShapeError: where the rate is not positive.
    """
    return performing.perform(document, character, timeline, rate_hz, _rigged)


def _rigged(document: Document, timeline: Timeline, character: Character, rate_hz: float | None) -> Motion | None:
    rig = document.rig_of(character.name)
    if rig is None or not is_keyed(rig, timeline, document.clips):
        return None
    return bake_rig_timeline(
        rig,
        character.skeleton,
        timeline,
        document.clips,
        rate_hz,
        character.morph_names,
        character.rest_morph_weights,
    )


def _driven_morphs(rig: Rig) -> set[str]:
    return {d.channel.target for d in rig.drivers if d.channel.property is Property.WEIGHT}
