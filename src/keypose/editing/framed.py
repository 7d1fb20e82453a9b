"""Edits of whole frames on a clip: baked, changed, and only the frames and channels that changed put back as keys."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from keypose.arrays import Array, Floats
from keypose.editing.keys import delete_keys, insert_keys, merge_keys
from keypose.editing.modes import set_interpolation
from keypose.editing.selection import SAME_TIME_S, Selection, bounds, chosen_keys
from keypose.evaluate import bake
from keypose.math import quat
from keypose.model import (
    ROTATION_ONLY,
    Channel,
    Clip,
    Curve,
    CurveKind,
    Interpolation,
    Motion,
    Pose,
    Property,
    Skeleton,
)

FALLBACK_RATE_HZ = 30.0
"""Frames a second of a clip that does not say its own."""


def clip_rate(clip: Clip) -> float:
    """The frames a second at which a clip's frames are counted."""
    return clip.rate_hz or FALLBACK_RATE_HZ


def selected_frames(clip: Clip, selection: Selection) -> tuple[int, int] | None:
    """First and last frame, counted from the clip's first key, of the selected keys or time; None where neither is selected."""
    low, high = bounds(selection)
    picked = [clip.curves[c].times_s[chosen_keys(c, clip.curves[c], selection)] for c in selection.keys or ()]
    times = np.concatenate(picked) if picked else np.zeros(0)
    if len(times):
        return nearest_frame(clip, float(times.min())), nearest_frame(clip, float(times.max()))
    if np.isfinite(low) or np.isfinite(high):
        return nearest_frame(clip, max(low, clip.start_s)), nearest_frame(clip, min(high, clip.end_s))
    return None


def nearest_frame(clip: Clip, time_s: float) -> int:
    """The frame of a clip, counted from its first key, that is nearest to a time."""
    rate, start = clip_rate(clip), clip.start_s
    last_frame = max(int(np.floor((clip.end_s - start) * rate + 0.01)), 0)
    return int(np.clip(round((time_s - start) * rate), 0, last_frame))


def only_between(before: Motion, after: Motion, first: int, last: int, ease_s: float) -> Motion:
    """A changed motion from one frame to another, and what it was elsewhere; between them it goes over smoothly within ``ease_s``."""
    frames = np.arange(before.frame_count)
    away = np.maximum(np.maximum(first - frames, frames - last), 0) / max(ease_s * before.rate_hz, 1.0)
    share = 1.0 - np.clip(away, 0.0, 1.0)
    share = share * share * (3.0 - 2.0 * share)
    old, new = before.pose.broadcast(), after.pose.broadcast()
    weight = share[:, None, None].astype(np.asarray(old.rotations).dtype)

    def mixed(a: Array, b: Array, between: Array) -> Array:
        return np.where(weight == 0.0, a, np.where(weight == 1.0, b, between))

    pose = Pose(
        mixed(old.translations, new.translations, old.translations + weight * (new.translations - old.translations)),
        mixed(old.rotations, new.rotations, quat.slerp(old.rotations, new.rotations, weight[..., 0])),
        mixed(old.scales, new.scales, old.scales + weight * (new.scales - old.scales)),
    )
    return replace(after, pose=pose)


def edit_frames(clip: Clip, skeleton: Skeleton, change: Callable[[Motion], Motion]) -> Clip:
    """A clip after a change of its frames, at its own rate.

    A joint whose rotation, translation or scale changes gets a key in every frame that changed, in straight spans; its keys
    before and after stay, and its curve there with them. Euler angles, single components and splines on the sphere of such a
    joint become one curve with a key for every frame. Channels that do not change are those of the clip.
    """
    before = bake(clip, skeleton, clip_rate(clip))
    after = change(before)
    old, new = before.pose.broadcast(), after.pose.broadcast()
    curves = dict(clip.curves)
    for property, kind, a, b in (
        (Property.TRANSLATION, CurveKind.VECTOR, old.translations, new.translations),
        (Property.ROTATION, CurveKind.ROTATION, old.rotations, new.rotations),
        (Property.SCALE, CurveKind.VECTOR, old.scales, new.scales),
    ):
        for joint in np.flatnonzero(np.any(a != b, axis=(0, 2))):
            channel = Channel(skeleton.names[joint], property)
            changed = np.any(a[:, joint] != b[:, joint], axis=-1)
            parts = [c for c in curves if c.target == channel.target and _is_part(c, property)]
            for part in parts:
                del curves[part]
            values = np.asarray(b[:, joint], np.float64)
            if kind is CurveKind.ROTATION:
                values = quat.align_signs(values, axis=0)
            curve = curves.get(channel)
            # A spline on the sphere is shaped by its neighbours; cut anywhere, it would change elsewhere too.
            if parts or (curve is not None and np.isin(curve.modes, ROTATION_ONLY).any()):
                changed = np.ones(len(changed), bool)
            curves[channel] = put_frames(curve, before.times_s, values, changed, np.asarray(a[:, joint]), kind)
    return replace(clip, curves=curves)


def _is_part(channel: Channel, property: Property) -> bool:
    """Whether a channel drives part of what a whole one is to drive."""
    if property is Property.ROTATION:
        return channel.property is Property.EULER
    return channel.property is property and channel.component is not None


def put_frames(
    curve: Curve | None, times: Floats, values: Array, changed: np.ndarray, old: Array, kind: CurveKind
) -> Curve:
    """A curve with the frames (T) that ``changed`` as keys of their ``values``; ``old`` is what it gave there before."""
    rows = np.flatnonzero(changed)
    first, last = int(rows[0]), int(rows[-1])
    # The frames beside the changed ones say where the old curve ends and begins again.
    low, high = max(first - 1, 0), min(last + 1, len(times) - 1)
    if curve is None:
        span = slice(low, high + 1)
        return Curve(times[span], values[span], Interpolation.LINEAR, kind=kind)
    ends = [times[f] for f in (low, high) if not changed[f]]
    held = insert_keys(curve, ends).curve if ends else curve
    inside = np.flatnonzero((held.times_s > times[first] - SAME_TIME_S) & (held.times_s < times[last] + SAME_TIME_S))
    left = delete_keys(held, inside) if len(inside) else held
    frames = np.arange(first, last + 1)
    own = values[frames]
    if kind is CurveKind.ROTATION and left is not None and len(ends):
        # On the side of the sphere on which the old curve is.
        beside = old[low] if not changed[low] else old[high]
        reference = values[low] if not changed[low] else values[high]
        if float(np.sum(beside * reference)) < 0:
            own = -own
    added = Curve(times[frames], own, Interpolation.LINEAR, kind=kind, before=curve.before, after=curve.after)
    if left is None:
        return added
    merged, at = merge_keys(left, added)
    spans = np.arange(max(int(at[0]) - 1, 0), int(at[-1]) + 1)
    return set_interpolation(merged, spans, Interpolation.LINEAR).curve
