"""Arcs: living things move along curves, so the path between poses is rounded while the poses stay."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from keypose.arrays import Array
from keypose.editing.selection import EVERYTHING, Selection, chosen_channels, chosen_spans, with_curves
from keypose.editing.spans import hermite_spans, rates
from keypose.errors import ShapeError, UnknownName
from keypose.evaluate import sample_clip, world_rotations_positions
from keypose.model import Channel, Clip, Curve, CurveKind, Interpolation, Property, Skeleton

ROTATION_CURVES = {
    "squad": Interpolation.SQUAD,
    "spherical bezier": Interpolation.SPHERICAL_BEZIER,
    "log cubic": Interpolation.LOG_CUBIC,
}


def arcs(
    clip: Clip,
    skeleton: Skeleton,
    selection: Selection = EVERYTHING,
    amount: float = 1.0,
    bow: float = 0.0,
    rotations: str = "squad",
    whole_chain: bool = True,
) -> Clip:
    """The clip with smooth paths through the same keys: of the chosen joints and, with ``whole_chain``, of all above them.

    Positions get, by ``amount`` of 0..1, the tangents of a smooth curve in the place of those they have (Catmull-Rom over
    the key times); at the first and the last key they stay. ``bow`` lifts a move between two keys off its straight line, by
    this share of its length, upwards. Rotations get one of the smooth rotation curves where ``amount`` is above 0. Keys stay,
    bit for bit, and so do steps and holds.

    Raises: UnknownName for a rotation curve that does not exist; ShapeError where ``amount`` is not in 0..1.
    """
    if not 0 <= amount <= 1:
        raise ShapeError(f"amount: expected 0..1, got {amount}")
    if rotations not in ROTATION_CURVES:
        raise UnknownName("rotation curve", rotations, ROTATION_CURVES)
    chosen = set(chosen_channels(clip, selection))
    if whole_chain:
        above = _with_ancestors(skeleton, {c.target for c in chosen})
        chosen |= {c for c in clip.curves if c.target in above}
    made: dict[Channel, Curve] = {}
    for channel in chosen:
        curve = clip.curves[channel]
        spans = [int(k) for k in chosen_spans(channel, curve, selection) if curve.modes[k] != Interpolation.STEP]
        if channel.property is Property.ROTATION and amount > 0:
            modes = np.array(curve.modes)
            modes[spans] = ROTATION_CURVES[rotations]
            made[channel] = replace(curve, modes=modes)
        elif channel.property in (Property.TRANSLATION, Property.EULER):
            up = bow if channel.property is Property.TRANSLATION and curve.kind is CurveKind.VECTOR else 0.0
            made[channel] = _smooth(curve, spans, amount, up)
    return with_curves(clip, made)


def path_corners(clip: Clip, skeleton: Skeleton, joint: str, times_s: Sequence[float] | Array) -> Array:
    """Angles in radians (T,) by which the path of a joint in the model's space turns at times (T,): 0 where it is smooth.

    Where the joint stands still just before or after the time there is no path, and the angle is 0.
    Raises: UnknownName for a joint that does not exist.
    """
    j, h = skeleton.index(joint), 1e-4
    at = np.asarray(times_s, np.float64)[:, None] + h * np.array([-2.0, -1.0, 0.0, 1.0, 2.0])
    _, positions = world_rotations_positions(skeleton, sample_clip(clip, skeleton, at))
    p = positions[..., j, :].astype(np.float64)
    # One-sided differences of second order, so that a curved path is no corner.
    before, after = 3 * p[:, 2] - 4 * p[:, 1] + p[:, 0], -3 * p[:, 2] + 4 * p[:, 3] - p[:, 4]
    sizes = np.linalg.norm(before, axis=-1), np.linalg.norm(after, axis=-1)
    moving = (sizes[0] > 1e-3 * 2 * h) & (sizes[1] > 1e-3 * 2 * h)
    angle = 2 * np.arctan2(
        np.linalg.norm(before * sizes[1][:, None] - after * sizes[0][:, None], axis=-1),
        np.linalg.norm(before * sizes[1][:, None] + after * sizes[0][:, None], axis=-1),
    )
    return np.where(moving, angle, 0.0)


def _smooth(curve: Curve, spans: list[int], amount: float, bow: float) -> Curve:
    """Spans with tangents nearer to those of a smooth curve through the keys."""
    values, times = np.asarray(curve.values, np.float64), curve.times_s
    leaving, coming = rates(curve)
    count = curve.key_count
    if count < 2:
        return curve
    chords = np.diff(values, axis=0) / np.diff(times)[:, None]
    smooth = np.concatenate([chords[:1], chords])
    if count > 2:
        share = (np.diff(times)[1:] / (times[2:] - times[:-2]))[:, None]
        smooth[1:-1] = share * chords[:-1] + (1 - share) * chords[1:]
    held = np.all(chords == 0, axis=-1)
    for k in range(1, count - 1):
        if held[k - 1] or held[k]:
            smooth[k] = 0.0  # what holds must not drift
    smooth[0], smooth[-1] = leaving[0], coming[-1]
    leaving = leaving + amount * (smooth - leaving)
    coming = coming + amount * (smooth - coming)
    chosen = np.array([k for k in spans if not held[k]], np.intp)
    if bow and values.shape[1] == 3 and len(chosen):
        # A parabola over the chord: its height is a quarter of the change of slope over the span.
        lift = amount * 4.0 * bow * np.linalg.norm(chords, axis=-1)
        leaving[chosen, 1] += lift[chosen]
        coming[chosen + 1, 1] -= lift[chosen]
    return hermite_spans(curve, chosen, leaving, coming)


def _with_ancestors(skeleton: Skeleton, names: set[str]) -> set[str]:
    found: set[str] = set()
    for name in names & set(skeleton.names):
        joint = skeleton.index(name)
        while joint >= 0:
            found.add(skeleton.names[joint])
            joint = int(skeleton.parents[joint])
    return found
