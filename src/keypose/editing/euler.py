"""Euler angles of clips: how near gimbal lock they come, the order that keeps away from it, other orders, smooth angles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from keypose.arrays import Array
from keypose.editing.selection import EVERYTHING, Selection, chosen_channels, with_curves
from keypose.errors import ShapeError, UnknownName
from keypose.evaluate import sample_curve
from keypose.math import euler, quat
from keypose.model import EULER_ORDER, Channel, Clip, Curve, CurveKind, Interpolation, Property

TAIT_BRYAN = ("XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYX")
"""The orders of three different axes, which editors offer."""


@dataclass(frozen=True, slots=True)
class GimbalReport:
    """How near one joint's Euler angles come to gimbal lock.

    ``nearest_deg`` is the smallest distance of the middle angle from the lock, at ``nearest_s`` (frame ``nearest_frame``);
    ``frames`` are the frames where it is below the threshold. ``best_order`` keeps furthest away, by ``best_deg``.
    """

    joint: str
    order: str
    nearest_deg: float
    nearest_s: float
    nearest_frame: int
    frames: tuple[int, ...]
    best_order: str
    best_deg: float

    def __str__(self) -> str:
        text = f"{self.joint} ({self.order}): {self.nearest_deg:.1f} degrees from gimbal lock at frame {self.nearest_frame}"
        if self.best_order != self.order and self.best_deg > self.nearest_deg + 1:
            text += f"; {self.best_order} keeps {self.best_deg:.1f} degrees away"
        return text


def gimbal_report(
    clip: Clip,
    order: str = EULER_ORDER,
    threshold_deg: float = 10.0,
    rate_hz: float | None = None,
    joints: Sequence[str] | None = None,
) -> tuple[GimbalReport, ...]:
    """Reports on the rotated joints of a clip, those nearest to gimbal lock first.

    Joints with Euler angles are measured in their own order, joints with quaternions in ``order``, at the frames of
    ``rate_hz`` (the clip's, else 25) and at all keys. Frames count from time 0.

    Raises: UnknownName for an order or a joint that does not exist; ShapeError where a rate is not positive.
    """
    rate = clip.rate_hz or 25.0 if rate_hz is None else rate_hz
    if not rate > 0:
        raise ShapeError(f"rate_hz: expected more than 0, got {rate}")
    rotated = _rotated_joints(clip)
    for name in joints or ():
        if name not in rotated:
            raise UnknownName("rotated joint", name, rotated)
    found: list[GimbalReport] = []
    for joint in joints or rotated:
        own = clip.euler_orders.get(joint, EULER_ORDER) if not _has_quaternions(clip, joint) else order
        times = _times(clip, joint, rate)
        angles = _angles(clip, joint, times, own)
        distance = np.degrees(euler.gimbal_distance(angles, own))
        worst = int(np.argmin(distance))
        best, best_distance = best_order(euler.to_quat(angles, own))
        near = np.unique(np.rint(times[distance < threshold_deg] * rate).astype(int))
        found.append(
            GimbalReport(
                joint,
                own,
                float(distance[worst]),
                float(times[worst]),
                round(float(times[worst]) * rate),
                tuple(int(f) for f in near),
                best,
                float(np.degrees(best_distance)),
            )
        )
    return tuple(sorted(found, key=lambda r: r.nearest_deg))


def best_order(rotations: Array, orders: Sequence[str] = TAIT_BRYAN) -> tuple[str, float]:
    """The order, of those given, whose middle angle keeps furthest from gimbal lock over rotations (T, 4), and that distance.

    The distance is in radians, at most a quarter turn. Raises: UnknownName for an order that does not exist.
    """
    nearest = {o: float(np.min(euler.gimbal_distance(euler.from_quat(rotations, o), o))) for o in orders}
    best = max(nearest, key=lambda o: nearest[o])
    return best, nearest[best]


def filter_euler(clip: Clip, selection: Selection = EVERYTHING) -> Clip:
    """The clip with Euler angles that run on from key to key: whole turns taken out, and flips to the twin triple.

    All rotations at keys stay what they are; tangents and handles go with their angles. Three curves of single angles count as
    one where they share their key times.

    Raises: ShapeError where single angles of a joint are keyed at different times.
    Source: each rotation has two triples of angles in a turn, (a, b, c) and, for three different axes, (a + 180, 180 - b, c + 180).
    """
    made: dict[Channel, Curve] = {}
    for joint in dict.fromkeys(c.target for c in chosen_channels(clip, selection) if c.property is Property.EULER):
        order = clip.euler_orders.get(joint, EULER_ORDER)
        whole = clip.curves.get(Channel(joint, Property.EULER))
        if whole is not None:
            made[Channel(joint, Property.EULER)] = _filtered(whole, order)
            continue
        channels = [Channel(joint, Property.EULER, c) for c in range(3)]
        if not all(c in clip.curves for c in channels):
            continue  # single angles that stand alone cannot flip
        curves = [clip.curves[c] for c in channels]
        if any(not np.array_equal(c.times_s, curves[0].times_s) for c in curves):
            raise ShapeError(f"Euler angles of {joint}: expected all three keyed at the same times; join them first")
        joined = np.concatenate([np.asarray(c.values, np.float64) for c in curves], axis=1)
        angles = euler.unroll(joined, order)
        mirrored = _mirrored(joined, angles)
        for n, (channel, curve) in enumerate(zip(channels, curves, strict=True)):
            sign = np.where(mirrored, -1.0, 1.0)[:, None] if n == 1 else 1.0
            made[channel] = _turned(curve, angles[:, n : n + 1], sign)
    return with_curves(clip, made)


def reorder_euler(
    clip: Clip, orders: Mapping[str, str] | str, rate_hz: float | None = None, every_frame: bool = True
) -> tuple[Clip, float]:
    """The clip with Euler angles in other orders and the same motion, and the largest angle in radians between both.

    ``orders`` is one order for all joints with Euler angles, or orders by joint. The angles of a joint that changes are keyed at
    its keys and, with ``every_frame``, at all frames of ``rate_hz`` (the clip's, else 25): there the rotation is the same to
    rounding. Between them angles of another order go another way; the angle returned says how far at most.

    Raises: UnknownName for an order, or for a joint without Euler angles.
    """
    rate = clip.rate_hz or 25.0 if rate_hz is None else rate_hz
    have = [j for j in _rotated_joints(clip) if not _has_quaternions(clip, j)]
    wanted = dict.fromkeys(have, orders) if isinstance(orders, str) else dict(orders)
    curves, names = dict(clip.curves), dict(clip.euler_orders)
    largest = 0.0
    for joint, order in wanted.items():
        if joint not in have:
            raise UnknownName("joint with Euler angles", joint, have)
        if order not in euler.CONVENTIONS:
            raise UnknownName("Euler order", order, euler.CONVENTIONS)
        old = clip.euler_orders.get(joint, EULER_ORDER)
        if order == old:
            continue
        keys = _key_times(clip, joint)
        times = _times(clip, joint, rate) if every_frame else keys
        angles = euler.unroll(euler.from_quat(euler.to_quat(_angles(clip, joint, times, old), old), order), order)
        first = next(c for c in clip.curves if c.target == joint and c.property is Property.EULER)
        curve = Curve(
            times,
            angles,
            Interpolation.LINEAR,
            kind=CurveKind.EULER,
            before=clip.curves[first].before,
            after=clip.curves[first].after,
        )
        between = (times[:-1, None] + np.diff(times)[:, None] * np.linspace(0, 1, 9)[1:-1]).ravel()
        if len(between):
            found = euler.to_quat(sample_curve(curve, between), order)
            exact = euler.to_quat(_angles(clip, joint, between, old), old)
            largest = max(largest, float(quat.angle_between(found, exact).max()))
        for channel in [c for c in curves if c.target == joint and c.property is Property.EULER]:
            del curves[channel]
        curves[Channel(joint, Property.EULER)] = curve
        names[joint] = order
    return replace(clip, curves=curves, euler_orders=names), largest


# --- parts ----------------------------------------------------------------------------------------------------------------------


def _rotated_joints(clip: Clip) -> list[str]:
    return list(dict.fromkeys(c.target for c in clip.curves if c.property in (Property.ROTATION, Property.EULER)))


def _has_quaternions(clip: Clip, joint: str) -> bool:
    return Channel(joint, Property.ROTATION) in clip.curves


def _key_times(clip: Clip, joint: str) -> Array:
    curves = [
        curve
        for c, curve in clip.curves.items()
        if c.target == joint and c.property in (Property.ROTATION, Property.EULER)
    ]
    return np.unique(np.concatenate([c.times_s for c in curves]))


def _times(clip: Clip, joint: str, rate_hz: float) -> Array:
    """Keys and the frames between them, frames that are keys once."""
    keys = _key_times(clip, joint)
    frames = np.arange(np.ceil(keys[0] * rate_hz - 1e-6), np.floor(keys[-1] * rate_hz + 1e-6) + 1) / rate_hz
    apart = np.abs(frames[:, None] - keys[None]).min(axis=1) > 1e-6
    return np.sort(np.concatenate([keys, frames[apart]]))


def _angles(clip: Clip, joint: str, times: Array, order: str) -> Array:
    """Angles (T, 3) of a joint in an order (its own, where it has Euler angles)."""
    quaternions = clip.curves.get(Channel(joint, Property.ROTATION))
    if quaternions is not None:
        return euler.from_quat(sample_curve(quaternions, times).astype(np.float64), order)
    whole = clip.curves.get(Channel(joint, Property.EULER))
    angles = np.zeros((len(times), 3)) if whole is None else np.array(sample_curve(whole, times), np.float64)
    for c in range(3):
        single = clip.curves.get(Channel(joint, Property.EULER, c))
        if single is not None:
            angles[:, c] = sample_curve(single, times)[:, 0]
    return angles


def _filtered(curve: Curve, order: str) -> Curve:
    values = np.asarray(curve.values, np.float64)
    angles = euler.unroll(values, order)
    mirrored = _mirrored(values, angles)
    sign = np.ones((len(angles), 3))
    sign[mirrored, 1] = -1.0
    return _turned(curve, angles, sign)


def _mirrored(before: Array, after: Array) -> Array:
    """Where the twin triple was taken, whose middle angle goes the other way: the first angle moved by an odd half turn."""
    return np.rint((after[:, 0] - before[:, 0]) / np.pi).astype(int) % 2 == 1


def _turned(curve: Curve, angles: Array, sign: Array | float) -> Curve:
    """The curve with other angles; tangents and handles of mirrored ones point the other way."""
    precision = np.asarray(curve.values).dtype

    def signed(side: Array | None, handles: bool) -> Array | None:
        if side is None:
            return None
        if not handles:
            return side * sign
        found = np.array(side, np.float64)
        found[..., 1] *= sign
        return found

    return replace(
        curve,
        values=angles.astype(precision),
        in_tangents=signed(curve.in_tangents, False),
        out_tangents=signed(curve.out_tangents, False),
        in_handles=signed(curve.in_handles, True),
        out_handles=signed(curve.out_handles, True),
    )
