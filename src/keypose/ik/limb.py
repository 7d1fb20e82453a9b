"""Two-bone limbs (arms and legs) in closed form: where the middle joint goes, and how the bones turn."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from keypose.arrays import Array, as_float, checked, namespace, unified
from keypose.errors import ShapeError
from keypose.evaluate.compiled import kernels_for
from keypose.math import quat

_IN_LINE = 64.0  # units in the last place of a sine: below, three joints lie on one line and show no plane
_LIMB_WORK = 4  # joint transforms that a limb counts as


@dataclass(frozen=True, slots=True, eq=False)
class LimbResult:
    """A solved limb: joint places, the normal of its plane, how much longer it is, how far the end stays from the target.

    Shapes and units:
        middle, end: (*B, 3) metres.
        normal: (*B, 3) unit, ``direction x pole``; defined for straight limbs too.
        error_m: (*B,) distance of the end from the target; 0 where it is in reach.
        stretch: (*B,) factor of both bones' lengths; 1 without ``max_stretch``.
    """

    middle: Array
    end: Array
    normal: Array
    error_m: Array
    stretch: Array


@dataclass(frozen=True, slots=True, eq=False)
class LimbTurns:
    """How the joints of limbs turn, in world axes.

    Shapes and units:
        start: (*B, 4) goes on the left of the start joint's world rotation, and of everything below it.
        middle: (*B, 4) goes on the left of the middle joint's world rotation before that: in all it turns by
            ``start * middle``.
        stretch: (*B,) factor of both bones' lengths.
        error_m: (*B,) how far from the target the end stays with a weight of 1; 0 where it is in reach.
    """

    start: Array
    middle: Array
    stretch: Array
    error_m: Array


def solve_limb(
    start: Array,
    target: Array,
    pole: Array,
    *,
    upper_m: Array,
    lower_m: Array,
    softness_m: Array = 0.0,
    max_stretch: float = 1.0,
) -> LimbResult:
    """Place the middle joint of a limb so that its end reaches the target and it bends towards the pole.

    Shapes and units:
        start, target: (*B, 3) metres; pole: (*B, 3) direction, of any length.
        upper_m, lower_m: lengths of the two bones, numbers or (*B,).
        softness_m: length before full reach over which the limb slows down instead of locking straight, a number or (*B,);
            the end then stays short of targets near or out of reach, without a jump in the middle joint's speed.
        max_stretch: how many times their lengths the bones may have. They lengthen where the limb would stay short of its
            target, with softness as soon as it slows down: the end is on the target and the limb still straightens slowly.
            Near the greatest factor they slow down likewise.

    A target out of reach is approached as far as the bones allow; one on the start joint, or a pole along the limb,
    takes the axis that is least along the limb, so the result is defined and finite everywhere.

    Raises:
        ShapeError: where a shape or a length does not fit.
    Source: law of cosines, with Heron's formula for the sine, which keeps its digits where the limb is straight; soft reach
    after A. Nicol, "Soft IK" (2007).
    """
    start, target, pole = as_float(start), as_float(target), as_float(pole)
    for name, array in (("start", start), ("target", target), ("pole", pole)):
        checked(array, (..., 3), name)
    if not _everywhere(upper_m, lower_m, lambda upper, lower: (upper > 0) & (lower > 0)):
        raise ShapeError(f"upper_m, lower_m: expected positive lengths, got {upper_m} and {lower_m}")
    if not _everywhere(softness_m, upper_m + lower_m, lambda soft, reach: (soft >= 0) & (soft < reach)):
        raise ShapeError(f"softness_m: expected a length from 0 to {upper_m + lower_m}, got {softness_m}")
    _check_stretch(max_stretch)
    xp = namespace(start, target, pole)
    wanted = target - start
    upper, lower, softness = (_column(xp, n, wanted) for n in (upper_m, lower_m, softness_m))
    distance = _length(wanted)
    direction = _direction(xp, wanted, distance, pole)
    shortest, reach = xp.abs(upper - lower), upper + lower
    used, stretch = _reached(xp, distance, shortest, reach, softness, max_stretch)
    # A limb of two equal bones folds onto itself: the start angle is then a right angle towards the pole.
    folded = used == 0
    base = 2 * upper * xp.where(folded, xp.ones_like(used), used)
    cosine = xp.where(folded, xp.zeros_like(used), ((upper - lower) * reach + used * used) / base)
    area = xp.sqrt((used - shortest) * (used + shortest) * (reach - used) * (reach + used))
    sine = xp.where(folded, xp.ones_like(used), area / base)
    side = _perpendicular(pole, direction)
    middle = start + stretch * upper * (cosine * direction + sine * side)
    end = start + stretch * used * direction
    return LimbResult(middle, end, xp.linalg.cross(direction, side), _length(target - end)[..., 0], stretch[..., 0])


def solve_limbs(
    start: Array,
    middle: Array,
    end: Array,
    target: Array,
    pole: Array,
    *,
    weight: Array = 1.0,
    hinge: Array | None = None,
    softness: float = 0.0,
    max_stretch: float = 1.0,
) -> LimbTurns:
    """Turn limbs of any poses, of one character or a crowd, so that their ends reach targets and they bend towards poles.

    Shapes and units:
        start, middle, end, target: (*B, 3) metres, where the joints are and where the end shall be; pole: (*B, 3) direction,
            of any length.
        weight: number or (*B,), 0 for no turn, 1 for the whole.
        hinge: (*B, 3) axis of the middle joint in the same space, of any length, about which a positive angle bends the
            limb. It says to which side a straight limb bends, and takes one that is bent too far back. Without it the limb
            bends the way it bends now, and a straight one towards the pole.
        softness: as ``softness_m`` of `solve_limb`, as a share of the limb's greatest reach.
        max_stretch: as of `solve_limb`.

    The bones are as long as they are. With a hinge the middle joint turns about nothing else, and the hinge comes to stand
    across the pole. A limb with a bone of no length (or along its hinge) does not turn. Large batches of NumPy arrays run in
    `keypose.kernels.limbs`, with the same result to rounding.

    Raises:
        ShapeError: where a shape or a number does not fit.
    Source: law of cosines, and two frames.
    """
    arrays: dict[str, Array] = {"start": start, "middle": middle, "end": end, "target": target, "pole": pole}
    if hinge is not None:
        arrays["hinge"] = hinge
    arrays = dict(zip(arrays, unified(*(as_float(a) for a in arrays.values())), strict=True))
    for name, array in arrays.items():
        checked(array, (..., 3), name)
    if not 0 <= softness < 1:
        raise ShapeError(f"softness: expected a share of the reach, from 0 to 1, got {softness}")
    _check_stretch(max_stretch)
    batch = np.broadcast_shapes(*(tuple(a.shape[:-1]) for a in arrays.values()), np.shape(weight))
    kernels = kernels_for("limbs", _LIMB_WORK * math.prod(batch), *arrays.values())
    if kernels is not None:
        return LimbTurns(*kernels.turns(batch, tuple(arrays.values()), weight, softness, max_stretch))
    return _turns(arrays, weight, softness, max_stretch)


def limb_rotations(
    rest_directions: tuple[Array, Array], rest_normal: Array, start: Array, result: LimbResult
) -> tuple[Array, Array]:
    """World rotations that carry the two rest bones and their plane onto the solved limb.

    Shapes and units:
        rest_directions: upper and lower bone at rest, (3,) each, world axes, of any length.
        rest_normal: (3,) normal of the limb's plane at rest (``direction x pole``).
        start: (*B, 3) metres.
        Returns two unit quaternions (*B, 4).
    """
    upper, lower = result.middle - start, result.end - result.middle
    return (
        rotation_between_frames(rest_directions[0], rest_normal, upper, result.normal),
        rotation_between_frames(rest_directions[1], rest_normal, lower, result.normal),
    )


def rotation_between_frames(from_along: Array, from_normal: Array, to_along: Array, to_normal: Array) -> Array:
    """The rotation that carries one direction exactly onto another and one normal as near as that allows, (*B, 4)."""
    xp = namespace(to_along, to_normal)
    rest, posed = _frame(xp.asarray(from_along, dtype=to_along.dtype), from_normal), _frame(to_along, to_normal)
    return quat.from_matrix(posed @ xp.matrix_transpose(rest))


def _frame(along: Array, normal: Array) -> Array:
    """Orthonormal columns: the bone, the normal made perpendicular to it, and their product."""
    xp = namespace(along)
    along = along / _length(along)
    normal = _perpendicular(xp.asarray(normal, dtype=along.dtype), along)
    along, normal = xp.broadcast_arrays(along, normal)
    return xp.stack([along, normal, xp.linalg.cross(along, normal)], axis=-1)


def _turns(arrays: dict[str, Array], weight: Array, softness: float, max_stretch: float) -> LimbTurns:
    start, middle, end, target, pole = (arrays[name] for name in ("start", "middle", "end", "target", "pole"))
    xp = namespace(start)
    a, b, wanted = middle - start, end - middle, target - start
    noise = _IN_LINE * float(xp.finfo(a.dtype).eps)
    distance = _length(wanted)
    direction = _direction(xp, wanted, distance, pole)
    # The middle joint turns about n: what its bones have along n stays.
    n = _bend_axis(xp, a, b, pole, arrays.get("hinge"), noise)
    along_a, along_b, across = _dot(xp, a, n), _dot(xp, b, n), xp.linalg.cross(n, b)
    a_m, b_m = _length(a - along_a * n), _length(across)
    lost = (a_m <= noise * _length(a)) | (b_m <= noise * _length(b))
    product = xp.where(lost, xp.ones_like(a_m), a_m * b_m)
    aside = along_a + along_b
    shortest, reach = xp.sqrt((a_m - b_m) ** 2 + aside**2), xp.sqrt((a_m + b_m) ** 2 + aside**2)
    used, stretch = _reached(xp, distance, shortest, reach, softness * reach, max_stretch)
    # By how much the cosine of the bend is less than 1 and more than -1.
    less, more = (reach - used) * (reach + used) / (2 * product), (used - shortest) * (used + shortest) / (2 * product)
    cos_want, sin_want = (more - less) / 2, xp.sqrt(less * more)
    cos_now, sin_now = (_dot(xp, a, b) - along_a * along_b) / product, -_dot(xp, a, across) / product
    cosine, sine = cos_want * cos_now + sin_want * sin_now, sin_want * cos_now - cos_want * sin_now
    there = (
        a + along_b * n + cosine * (b - along_b * n) + sine * across
    )  # the end as the bend has it, before the limb turns
    folded = _length(there) <= noise * (a_m + b_m)
    there = xp.where(folded, xp.linalg.cross(n, a), there)
    there = xp.where(lost, direction, there)
    first = rotation_between_frames(there, -n, direction, xp.linalg.cross(direction, _perpendicular(pole, direction)))
    # The half angle from the larger of cosine and sine, which is never small.
    blunt, larger = cosine < 0, 1 + xp.abs(cosine)
    half = xp.where(blunt, xp.where(sine < 0, -larger, larger), sine)
    second = xp.concat([xp.where(blunt, xp.abs(sine), larger), half * n], axis=-1)
    share = xp.where(lost, xp.zeros_like(distance), _column(xp, weight, wanted))
    one = quat.identity(like=first)
    return LimbTurns(
        quat.nlerp(one, first, share[..., 0]),
        quat.nlerp(one, quat.normalize(second), share[..., 0]),
        (1 + share * (stretch - 1))[..., 0],
        xp.abs(distance - stretch * used)[..., 0],
    )


def _bend_axis(xp: Array, a: Array, b: Array, pole: Array, hinge: Array | None, noise: float) -> Array:
    """The unit axis of the bend from bone a to bone b; for a straight limb the one that takes its middle to the pole."""
    if hinge is not None:
        length = _length(hinge)
        none = length == 0
        return xp.where(none, _least_axis(hinge), hinge) / xp.where(none, xp.ones_like(length), length)
    normal = xp.linalg.cross(a, b)
    size, upper = _length(normal), _length(a)
    straight = size <= noise * upper * _length(b)
    upper = xp.where(upper == 0, xp.ones_like(upper), upper)
    fallback = _perpendicular(xp.linalg.cross(*xp.broadcast_arrays(pole, a)), a / upper)
    return xp.where(straight, fallback, normal / xp.where(straight, xp.ones_like(size), size))


def _reached(
    xp: Array, distance: Array, shortest: Array, reach: Array, softness: Array, max_stretch: float
) -> tuple[Array, Array]:
    """How long the limb is between its ends without stretch, and by what it is stretched."""
    used = xp.minimum(xp.maximum(softened(xp, distance, reach, softness), shortest), reach)
    if max_stretch == 1:
        return used, xp.ones_like(used)
    short = (distance > used) & (used > 0)
    ratio = xp.where(short, distance / xp.where(short, used, xp.ones_like(used)), xp.ones_like(used))
    # The factor slows down by the same share of the length, or over all that it has.
    slow = xp.minimum(softness / xp.where(reach == 0, xp.ones_like(reach), reach), xp.full_like(reach, max_stretch - 1))
    return used, xp.clip(softened(xp, ratio, xp.full_like(ratio, max_stretch), slow), 1.0, max_stretch)


def softened(xp: Array, value: Array, limit: Array, softness: Array) -> Array:
    """The value, bent from ``limit - softness`` on so that it nears the limit without end."""
    hard = limit - softness
    over = xp.clip(value - hard, 0.0, None)
    safe = xp.where(softness == 0, xp.ones_like(over), softness + 0 * over)
    return xp.where(softness == 0, value, xp.where(over > 0, hard + safe * (1 - xp.exp(-over / safe)), value))


def _direction(xp: Array, wanted: Array, distance: Array, pole: Array) -> Array:
    """Where the target is; on the start joint the axis that is least along the pole."""
    at_start = distance == 0
    direction = wanted / xp.where(at_start, xp.ones_like(distance), distance)
    return xp.where(at_start, xp.zeros_like(direction) + _least_axis(pole), direction)


def _check_stretch(max_stretch: float) -> None:
    if not 1 <= max_stretch < math.inf:
        raise ShapeError(f"max_stretch: expected a factor of at least 1, got {max_stretch}")


def _everywhere(a: Array, b: Array, law: Callable[[Array, Array], Array]) -> bool:
    """Whether numbers or NumPy arrays obey a law; other libraries' arrays may be traced and have no values yet."""
    known = all(isinstance(n, (int, float, np.ndarray, np.generic)) for n in (a, b))
    return not known or bool(np.all(law(np.asarray(a), np.asarray(b))))


def _column(xp: Array, number: Array, like: Array) -> Array:
    """A number or (*B,) as an array that multiplies vectors (*B, 3)."""
    array = xp.asarray(number, dtype=like.dtype)
    return array[..., None] if array.ndim else array


def _dot(xp: Array, a: Array, b: Array) -> Array:
    return xp.sum(a * b, axis=-1, keepdims=True)


def _perpendicular(vector: Array, direction: Array) -> Array:
    """The unit part of ``vector`` across ``direction``; where there is none, of the axis least along it."""
    xp = namespace(vector, direction)
    across = vector - xp.sum(vector * direction, axis=-1, keepdims=True) * direction
    # Rounding leaves about one unit in the last place of a vector that has no part across.
    lost = _length(across) <= 4 * xp.finfo(direction.dtype).eps * _length(vector)
    other = _least_axis(direction)
    other = other - xp.sum(other * direction, axis=-1, keepdims=True) * direction
    across = xp.where(lost, other, across)
    return across / _length(across)


def _least_axis(vector: Array) -> Array:
    """The unit axis (x, y or z) along which the vector is smallest."""
    xp = namespace(vector)
    return xp.eye(3, dtype=vector.dtype)[xp.argmin(xp.abs(vector), axis=-1)]


def _length(vector: Array) -> Array:
    xp = namespace(vector)
    return xp.sqrt(xp.sum(vector**2, axis=-1, keepdims=True))
