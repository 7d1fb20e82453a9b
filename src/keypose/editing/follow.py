"""Follow-through and overlap: what hangs on a body arrives later than what carries it, and swings."""

from __future__ import annotations

from dataclasses import replace
from math import ceil, pi, sqrt

import numpy as np

from keypose.arrays import Array
from keypose.editing.selection import (
    EVERYTHING,
    Selection,
    chosen_channels,
    chosen_joints,
    with_curves,
)
from keypose.errors import ShapeError, UnknownName
from keypose.evaluate import sample_clip
from keypose.math import quat
from keypose.model import Channel, Clip, Curve, CurveKind, Interpolation, Pose, Property, Skeleton


def overlap(clip: Clip, skeleton: Skeleton, selection: Selection = EVERYTHING, delay_s: float = 0.08) -> Clip:
    """The clip with each chosen joint ``delay_s`` seconds later than the chosen joint above it.

    Keys move in time and keep everything else, so that a curve is exactly the old one, later; before its first key it goes
    on as it extrapolates. The uppermost joints of the selection stay as they are.

    Raises: ShapeError where ``delay_s`` is not finite.
    """
    if not np.isfinite(delay_s):
        raise ShapeError(f"delay_s: expected a number of seconds, got {delay_s}")
    steps = _steps_down(skeleton, chosen_joints(clip, selection, skeleton.names))
    made: dict[Channel, Curve] = {}
    for channel in chosen_channels(clip, selection):
        late = steps.get(channel.target, 0)
        if late:
            curve = clip.curves[channel]
            made[channel] = replace(curve, times_s=curve.times_s + late * delay_s)
    return with_curves(clip, made)


def follow_through(
    clip: Clip,
    skeleton: Skeleton,
    selection: Selection = EVERYTHING,
    joints: tuple[str, ...] = (),
    drag: float = 0.7,
    frequency_hz: float = 2.0,
    damping: float = 0.3,
    loosen: float = 0.85,
    settle_s: float = 1.0,
    rate_hz: float | None = None,
) -> Clip:
    """The clip with joints (those given, else those chosen) dragging behind the body as damped springs in the model's space.

    Each joint wants the orientation in the model that the clip gives it, and is pulled there by a spring of ``frequency_hz``
    and ``damping`` (1 does not swing); every joint further down is looser, by ``loosen`` to the power of its place. ``drag`` says how much of it is seen: 0 nothing, 1 all. Rotations of these joints get a key for every frame, at twice
    the rate of the clip, and ``settle_s`` seconds more after its end; the body holds there as its curves extrapolate.

    Raises: UnknownName for joints that do not exist; ShapeError where a number is out of its range.
    Source: the exact solution of the damped harmonic oscillator for each step, on the rotation vector of what is missing.
    """
    for label, number, low, high in (("drag", drag, 0, 1), ("damping", damping, 0.02, 2), ("loosen", loosen, 0.1, 1)):
        if not low <= number <= high:
            raise ShapeError(f"{label}: expected {low} to {high}, got {number}")
    if frequency_hz <= 0 or settle_s < 0:
        raise ShapeError(f"frequency_hz, settle_s: expected more than 0, and 0 or more, got {frequency_hz}, {settle_s}")
    chosen = joints or chosen_joints(clip, selection, skeleton.names)
    if not chosen:
        raise UnknownName("joint with keys", "", skeleton.names)
    order = sorted(skeleton.indices(chosen))
    places = _steps_down(skeleton, tuple(skeleton.names[j] for j in order))
    rate = rate_hz or 2.0 * (clip.rate_hz or 25.0)
    start = clip.start_s if selection.start_s is None else selection.start_s
    end = (clip.end_s if selection.end_s is None else selection.end_s) + settle_s
    times = start + np.arange(max(ceil((end - start) * rate), 1) + 1) / rate
    pose = sample_clip(clip, skeleton, times)
    local = np.array(pose.rotations, np.float64)
    local = np.array(np.broadcast_to(local, (len(times), skeleton.joint_count, 4)))
    parents = [int(p) for p in skeleton.parents]
    # Springs that pull towards the lagging parent, in a row, would shake each other up; the clip's own pose does not.
    wanted, model = np.empty_like(local), np.empty_like(local)
    for j in range(skeleton.joint_count):
        above = parents[j]
        wanted[:, j] = local[:, j] if above < 0 else quat.multiply(wanted[:, above], local[:, j])
    looser = np.array([loosen ** places[skeleton.names[j]] for j in order])
    swung = _sprung(wanted[:, order], 1.0 / rate, frequency_hz * looser, damping)
    seen = dict(zip(order, np.moveaxis(quat.slerp(wanted[:, order], swung, drag), 1, 0), strict=True))
    for j in range(skeleton.joint_count):
        above = parents[j]
        if j in seen:
            model[:, j] = seen[j]
            local[:, j] = seen[j] if above < 0 else quat.multiply(quat.conjugate(model[:, above]), seen[j])
        else:
            model[:, j] = local[:, j] if above < 0 else quat.multiply(model[:, above], local[:, j])
    made = {
        Channel(skeleton.names[j], Property.ROTATION): Curve(
            times, quat.align_signs(quat.normalize(local[:, j])), Interpolation.LINEAR, kind=CurveKind.ROTATION
        )
        for j in order
    }
    return with_curves(clip, made)


def lag(clip: Clip, skeleton: Skeleton, joint: str, times_s: Array, other: Clip) -> Array:
    """Angles in radians (T,) between a joint's orientations in the model under two clips: how much one drags behind the other."""
    from keypose.evaluate import world_rotations_positions

    j = skeleton.index(joint)

    def orientation(animation: Clip) -> Array:
        pose: Pose = sample_clip(animation, skeleton, times_s)
        return world_rotations_positions(skeleton, pose)[0][..., j, :]

    return quat.angle_between(orientation(clip), orientation(other))


def _steps_down(skeleton: Skeleton, joints: tuple[str, ...]) -> dict[str, int]:
    """How many of the joints lie above each of them."""
    chosen = set(skeleton.indices(joints))
    found: dict[str, int] = {}
    for j in sorted(chosen):
        above, steps = int(skeleton.parents[j]), 0
        while above >= 0:
            steps += above in chosen
            above = int(skeleton.parents[above])
        found[skeleton.names[j]] = steps
    return found


def _sprung(wanted: Array, dt_s: float, frequency_hz: Array, damping: float) -> Array:
    """Orientations (T, J, 4) that damped springs of J frequencies pull towards wanted ones, from rest at the first."""
    here, velocity = wanted[0], np.zeros((*wanted.shape[1:-1], 3))
    found = np.empty_like(wanted)
    found[0] = here
    natural = 2 * pi * np.asarray(frequency_hz)[:, None]
    # x'' + 2 d w x' + w² x = 0 over one step, as a matrix on (x, x').
    decay = np.exp(-damping * natural * dt_s)
    if damping < 1 - 1e-6:
        swing = natural * sqrt(1 - damping * damping)
        c, s = np.cos(swing * dt_s), np.sin(swing * dt_s) / swing
    elif damping > 1 + 1e-6:
        swing = natural * sqrt(damping * damping - 1)
        c, s = np.cosh(swing * dt_s), np.sinh(swing * dt_s) / swing
    else:
        c, s = 1.0, dt_s
    stay = decay * (c + damping * natural * s), decay * s
    go = -decay * natural * natural * s, decay * (c - damping * natural * s)
    for n in range(1, len(wanted)):
        away = quat.to_rotation_vector(quat.difference(wanted[n], here))
        away, velocity = stay[0] * away + stay[1] * velocity, go[0] * away + go[1] * velocity
        here = quat.normalize(quat.multiply(quat.from_rotation_vector(away), wanted[n]))
        found[n] = here
    return found
