# pyright: basic
"""Euler angles in degrees to unit quaternions and back, for whole clips with an order of its own per joint.

Sines, cosines and arc tangents are Taylor polynomials in vectors of float64, good to about one unit in the last place;
what differs from joint to joint (the order) and from frame to frame (signs, whole turns) is done joint by joint.
Equal to `keypose.math.euler` but for rounding.

Source: the products of `keypose.math.euler`; Bernardes and Viollet, Quaternion to Euler angles conversion (PLoS ONE 2022).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from math import factorial, pi, tan
from typing import Any

import numpy as np
from numba.extending import intrinsic

from keypose.errors import ShapeError, UnknownName
from keypose.kernels.runtime import inlined, kernel
from keypose.kernels.vectors import (
    FLAGS,
    absolute,
    constant,
    fill,
    flip_sign,
    lanes,
    load,
    sqrt,
    store,
)

_ORDERS = ("XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYX")
_LANES_OF_ANY_WIDTH = 8

# Adding and subtracting this rounds a float64 below 2^51 to a whole number.
_ROUND = 6755399441055744.0
_HALF_TURNS_TO_QUARTERS = pi / 720  # degrees of an angle to radians of a quarter of it
_DEGREES = 180 / pi
_TAN_EIGHTH = tan(pi / 8)
_HALF_PI, _QUARTER_PI = pi / 2, pi / 4
_LOCK_NOISE = (32 * np.finfo(np.float64).eps) ** 2  # as in math.euler


def quaternions_from_degrees(
    values: Any, columns: Any, orders: Sequence[str], out: np.ndarray | None = None, first: int = 0
) -> np.ndarray:
    """Rotations of J joints whose angles stand in the columns of a table, sign-aligned along time.

    Shapes and units:
        values: (T, C) float64, degrees.
        columns: (J, 3), the columns of the three angles of each joint, in its order; C stands for an angle of 0.
        orders: J intrinsic orders of three different axes, "ZYX".
        out: (N, J, 4) float64, C-contiguous; rows ``first`` to ``first + T`` are written, their signs aligned with the
            row before. Without it a new array is made.
        Returns (T, J, 4) wxyz, a part of ``out`` where that is given.
    """
    table = np.ascontiguousarray(values, np.float64)
    places = np.ascontiguousarray(columns, np.int64)
    if table.ndim != 2 or places.shape != (len(orders), 3):
        raise ShapeError(
            f"values, columns: expected (T, C) and ({len(orders)}, 3), got {table.shape} and {places.shape}"
        )
    frames, count = table.shape
    if places.size and (places.min() < 0 or places.max() > count):
        raise ShapeError(f"columns: expected 0 to {count}, got {int(places.min())} to {int(places.max())}")
    axes, parities = _axes(tuple(orders))
    if out is None:
        out, first = np.empty((frames, len(orders), 4)), 0
    if out.dtype != np.float64 or not out.flags.c_contiguous or not out.flags.writeable:
        raise ShapeError("out: expected a writable, C-contiguous float64 array")
    if out.ndim != 3 or out.shape[1:] != (len(orders), 4) or not 0 <= first <= len(out) - frames:
        raise ShapeError(
            f"out: expected room for rows {first} to {first + frames} of ({len(orders)}, 4), got {out.shape}"
        )
    if count == 0:
        out[first : first + frames] = (1.0, 0.0, 0.0, 0.0)
    else:
        _to_quaternions(
            _frozen(table), _frozen(places), _frozen(axes), _frozen(parities), out.reshape(-1), count, first
        )
    return out[first : first + frames]


def degrees_from_quaternions(rotations: Any, orders: Sequence[str], columns: Any, values: np.ndarray) -> np.ndarray:
    """Write the angles of J joints, each in its own order and smooth along time, into the columns of a table.

    Shapes and units:
        rotations: (T, J, 4) wxyz, unit.
        orders: J intrinsic orders of three different axes, "ZYX".
        columns: (J, 3), where the three angles of each joint go, in its order; C for nowhere.
        values: (T, C) float64, C-contiguous; the angles are written here, in degrees.
        Returns (J, 3), the largest size of the angles that went nowhere; 0 for the others.
    """
    quaternions = np.ascontiguousarray(rotations, np.float64)
    places = np.ascontiguousarray(columns, np.int64)
    frames, count = values.shape
    if quaternions.shape != (frames, len(orders), 4) or places.shape != (len(orders), 3):
        raise ShapeError(
            f"rotations, columns: expected ({frames}, {len(orders)}, 4) and ({len(orders)}, 3), "
            f"got {quaternions.shape} and {places.shape}"
        )
    if values.dtype != np.float64 or not values.flags.c_contiguous or not values.flags.writeable:
        raise ShapeError("values: expected a writable, C-contiguous float64 array")
    if places.size and (places.min() < 0 or places.max() > count):
        raise ShapeError(f"columns: expected 0 to {count}, got {int(places.min())} to {int(places.max())}")
    axes, parities = _axes(tuple(orders))
    lost = np.zeros((len(orders), 3))
    _to_degrees(
        _frozen(quaternions),
        _frozen(axes),
        _frozen(parities),
        _frozen(places),
        values.reshape(-1),
        lost.reshape(-1),
        count,
    )
    return lost


@lru_cache(maxsize=64)
def _axes(orders: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Quaternion components (1 to 3) of the three axes, (J, 3), and the parity of each order, (J,)."""
    for order in orders:
        if order not in _ORDERS:
            raise UnknownName("Euler order", str(order), _ORDERS)
    axes = np.array([["XYZ".index(axis) + 1 for axis in order] for order in orders], np.int64).reshape(-1, 3)
    return axes, np.where((axes[:, 1] - axes[:, 0]) % 3 == 1, 1.0, -1.0)


def _frozen(array: np.ndarray) -> np.ndarray:
    """A flat read-only view, so that frozen and writable arrays meet the same compiled kernel."""
    view = array.reshape(-1).view()
    view.flags.writeable = False
    return view


def _polynomial(coefficients: Sequence[float]) -> Any:
    """A function of a vector: the polynomial with these coefficients, lowest first, by Horner's rule."""

    @intrinsic
    def evaluate(typing, x):
        def generate(context, builder, sig, args):
            total = constant(x, coefficients[-1])
            for coefficient in coefficients[-2::-1]:
                total = builder.fadd(builder.fmul(total, args[0], flags=FLAGS), constant(x, coefficient), flags=FLAGS)
            return total

        return x(x), generate

    return evaluate


# Up to pi/2 the first term left out of sine and cosine is below 1e-17; of arctan up to tan(pi/8) it is below 1e-18.
_sine_by_x = _polynomial([(-1) ** n / factorial(2 * n + 1) for n in range(12)])
_arctan_by_x = _polynomial([(-1) ** n / (2 * n + 1) for n in range(23)])


@intrinsic
def _less_lanes(typing, a, b, x, y):
    """Lanes of x where a < b, of y elsewhere."""

    def generate(context, builder, sig, args):
        a, b, x, y = args
        return builder.select(builder.fcmp_ordered("<", a, b), x, y)

    return x(a, b, x, y), generate


_where_less: Any = _less_lanes  # the type checker does not know that an intrinsic's first argument is Numba's


# cosine = 1 - 2 sin^2 needs the sine of half the angle only, and sine = 2 sin cos its cosine: both come from one more
# polynomial on a quarter of the rotation's angle.
_cosine = _polynomial([(-1) ** n / factorial(2 * n) for n in range(13)])


@inlined
def _half_sine_cosine(degrees):
    """Sine and cosine of half an angle in degrees, any number of turns."""
    turns = (degrees * (1.0 / 720.0) + _ROUND) - _ROUND
    quarter = (degrees - turns * 720.0) * _HALF_TURNS_TO_QUARTERS  # in [-pi/2, pi/2]
    squared = quarter * quarter
    sine = quarter * _sine_by_x(squared)
    cosine = _cosine(squared)
    return 2.0 * (sine * cosine), 1.0 - 2.0 * (sine * sine)


@inlined
def _arctan2(y, x, zero):
    """atan2 in radians; 0 for two zeros."""
    a, b = absolute(x), absolute(y)
    low, high = _where_less(b, a, b, a), _where_less(b, a, a, b)
    # of low / high in [0, 1] above tan(pi/8) the angle beyond pi/4 is taken: one division serves both cases
    near = high * _TAN_EIGHTH
    tangent = _where_less(near, low, low - high, low) / _where_less(near, low, low + high, high)
    tangent = _where_less(zero, high, tangent, zero)
    angle = tangent * _arctan_by_x(tangent * tangent)
    angle = _where_less(near, low, angle + _QUARTER_PI, angle)
    angle = _where_less(a, b, _HALF_PI - angle, angle)
    angle = _where_less(x, zero, pi - angle, angle)
    return flip_sign(angle, y)


@kernel
def _to_quaternions(values, columns, axes, parities, rotations, count, first):
    joints = parities.shape[0]
    step = lanes(values)
    padded = (count // step + 1) * step
    row, sines, cosines = np.zeros(padded), np.zeros(padded), np.zeros(padded)
    frames = values.shape[0] // count
    for t in range(frames):
        start = t * count
        whole = count // step * step
        for k in range(0, whole, step):
            sine, cosine = _half_sine_cosine(load(values, start + k))
            store(sines, k, sine)
            store(cosines, k, cosine)
        # the last columns, and behind them the angle 0 that stands for a missing channel
        for k in range(whole, count):
            row[k - whole] = values[start + k]
        row[count - whole] = 0.0
        sine, cosine = _half_sine_cosine(load(row, 0))
        store(sines, whole, sine)
        store(cosines, whole, cosine)
        for j in range(joints):
            a, b, c = columns[3 * j], columns[3 * j + 1], columns[3 * j + 2]
            s1, s2, s3, c1, c2, c3 = sines[a], sines[b], sines[c], cosines[a], cosines[b], cosines[c]
            parity = parities[j]
            cc, ss, sc, cs = c1 * c3, s1 * s3, s1 * c3, c1 * s3
            w = c2 * cc - parity * s2 * ss
            qi = c2 * sc + parity * s2 * cs
            qj = s2 * cc - parity * c2 * ss
            qk = c2 * cs + parity * s2 * sc
            at = 4 * ((first + t) * joints + j)
            i1, i2, i3 = at + axes[3 * j], at + axes[3 * j + 1], at + axes[3 * j + 2]
            if first + t > 0:
                before = 4 * joints
                dot = w * rotations[at - before]
                dot += qi * rotations[i1 - before] + qj * rotations[i2 - before] + qk * rotations[i3 - before]
                if dot < 0:  # q and -q are one rotation; stay on the side of the frame before
                    w, qi, qj, qk = -w, -qi, -qj, -qk
            rotations[at], rotations[i1], rotations[i2], rotations[i3] = w, qi, qj, qk


@kernel
def _to_degrees(rotations, axes, parities, columns, values, lost, count):
    joints = parities.shape[0]
    frames = 0 if joints == 0 else rotations.shape[0] // (4 * joints)
    padded = joints + _LANES_OF_ANY_WIDTH
    # one frame, component by component in each joint's own axes; the padding is the identity
    w, qi, qj, qk, parity = np.ones(padded), np.zeros(padded), np.zeros(padded), np.zeros(padded), np.ones(padded)
    first, middle, third = np.zeros(padded), np.zeros(padded), np.zeros(padded)
    before = np.zeros(3 * joints)
    parity[:joints] = parities
    for t in range(frames):
        for j in range(joints):
            at = 4 * (t * joints + j)
            w[j], qi[j], qj[j] = rotations[at], rotations[at + axes[3 * j]], rotations[at + axes[3 * j + 1]]
            qk[j] = rotations[at + axes[3 * j + 2]] * parity[j]
        for j in range(0, joints, lanes(w)):
            a, b, c = _angles(load(w, j), load(qi, j), load(qj, j), load(qk, j), load(parity, j), fill(w, 0.0))
            store(first, j, a)
            store(middle, j, b)
            store(third, j, c)
        for j in range(joints):
            a, b, c = first[j], middle[j], third[j]
            if t > 0:
                a, b, c = _nearest(a, b, c, before[3 * j], before[3 * j + 1], before[3 * j + 2])
            before[3 * j], before[3 * j + 1], before[3 * j + 2] = a, b, c
            for k in range(3):
                column = columns[3 * j + k]
                if column < count:
                    values[t * count + column] = before[3 * j + k]
                else:
                    lost[3 * j + k] = max(lost[3 * j + k], abs(before[3 * j + k]))


@inlined
def _angles(w, qi, qj, qk, parity, zero):
    """The three angles in degrees, the outer ones in (-180, 180], the middle one in [-90, 90]."""
    px, py, mx, my = w + qj, qi + qk, w - qj, qi - qk
    p_squared, m_squared = px * px + py * py, mx * mx + my * my
    noise = (p_squared + m_squared) * _LOCK_NOISE
    one = zero + 1.0
    half_sum = _arctan2(_where_less(noise, p_squared, py, zero), _where_less(noise, p_squared, px, one), zero)
    half_difference = _arctan2(_where_less(noise, m_squared, my, zero), _where_less(noise, m_squared, mx, one), zero)
    # at gimbal lock only one of the two is determined; the third angle is then 0
    known_sum = half_sum
    half_sum = _where_less(noise, p_squared, half_sum, half_difference)
    half_difference = _where_less(
        noise, m_squared, half_difference, _where_less(noise, p_squared, known_sum, half_difference)
    )
    middle = _arctan2(2.0 * (w * qj + qi * qk), sqrt(p_squared) * sqrt(m_squared), zero)
    first = (half_sum + half_difference) * _DEGREES
    third = (half_sum - half_difference) * parity * _DEGREES
    return _within_half_turn(first, zero), middle * _DEGREES, _within_half_turn(third, zero)


@inlined
def _within_half_turn(degrees, zero):
    degrees = _where_less(zero + 180.0, degrees, degrees - 360.0, degrees)
    return _where_less(zero - 180.0, degrees, degrees, degrees + 360.0)


@inlined
def _nearest(a, b, c, a0, b0, c0):
    """Of the two triples that mean the same rotation, and of all whole turns, what is nearest to the frame before."""
    if abs(a - a0) <= 60.0 and abs(b - b0) <= 60.0 and abs(c - c0) <= 60.0:
        return a, b, c  # the other triple is at least 120 degrees off in two angles
    stay_a, stay_b, stay_c = _turned(a, a0), _turned(b, b0), _turned(c, c0)
    swap_a, swap_b, swap_c = _turned(a + 180.0, a0), _turned(180.0 - b, b0), _turned(c + 180.0, c0)
    stay = (stay_a - a0) ** 2 + (stay_b - b0) ** 2 + (stay_c - c0) ** 2
    swap = (swap_a - a0) ** 2 + (swap_b - b0) ** 2 + (swap_c - c0) ** 2
    if swap < stay:
        return swap_a, swap_b, swap_c
    return stay_a, stay_b, stay_c


@inlined
def _turned(angle, before):
    return angle - 360.0 * np.rint((angle - before) / 360.0)
