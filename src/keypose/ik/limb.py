"""Two-bone limbs (arms and legs) in closed form: where the middle joint goes, and how the two bones turn."""

from __future__ import annotations

from dataclasses import dataclass

from keypose.arrays import Array, as_float, checked, namespace
from keypose.errors import ShapeError
from keypose.math import quat


@dataclass(frozen=True, slots=True, eq=False)
class LimbResult:
    """A solved limb: joint places, the normal of its plane, and how far the end stays from the target.

    Shapes and units:
        middle, end: (*B, 3) metres.
        normal: (*B, 3) unit, ``direction x pole``; defined for straight limbs too.
        error_m: (*B,) distance of the end from the target; 0 where it is in reach.
    """

    middle: Array
    end: Array
    normal: Array
    error_m: Array


def solve_limb(
    start: Array, target: Array, pole: Array, *, upper_m: float, lower_m: float, softness_m: float = 0.0
) -> LimbResult:
    """Place the middle joint of a limb so that its end reaches the target and it bends towards the pole.

    Shapes and units:
        start, target: (*B, 3) metres; pole: (*B, 3) direction, of any length.
        upper_m, lower_m: lengths of the two bones.
        softness_m: length before full reach over which the limb slows down instead of locking straight; the end then
            stays short of targets near or out of reach, without a jump in the middle joint's speed.

    A target out of reach is approached as far as the bones allow; one on the start joint, or a pole along the limb,
    takes the axis that is least along the limb, so the result is defined and finite everywhere.

    Raises:
        ShapeError: where a shape or a length does not fit.
    Source: law of cosines; soft reach after A. Nicol, "Soft IK" (2007).
    """
    start, target, pole = as_float(start), as_float(target), as_float(pole)
    for name, array in (("start", start), ("target", target), ("pole", pole)):
        checked(array, (..., 3), name)
    if not (upper_m > 0 and lower_m > 0):
        raise ShapeError(f"upper_m, lower_m: expected positive lengths, got {upper_m} and {lower_m}")
    reach = upper_m + lower_m
    if not 0 <= softness_m < reach:
        raise ShapeError(f"softness_m: expected a length from 0 to {reach}, got {softness_m}")
    xp = namespace(start, target, pole)
    wanted = target - start
    distance = _length(wanted)
    at_start = distance == 0
    direction = wanted / xp.where(at_start, xp.ones_like(distance), distance)
    direction = xp.where(at_start, xp.zeros_like(direction) + _least_axis(pole), direction)
    used = xp.clip(_softened(xp, distance, reach, softness_m), abs(upper_m - lower_m), reach)
    # A limb of two equal bones folds onto itself: the start angle is then a right angle towards the pole.
    safe = xp.where(used == 0, xp.ones_like(used), used)
    cosine = xp.where(used == 0, xp.zeros_like(used), (upper_m**2 + used**2 - lower_m**2) / (2 * upper_m * safe))
    cosine = xp.clip(cosine, -1.0, 1.0)
    sine = xp.sqrt(1 - cosine**2)
    side = _perpendicular(pole, direction)
    middle = start + upper_m * (cosine * direction + sine * side)
    end = start + used * direction
    return LimbResult(middle, end, xp.linalg.cross(direction, side), _length(target - end)[..., 0])


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


def _softened(xp: Array, distance: Array, reach: float, softness: float) -> Array:
    if softness == 0:
        return distance
    hard = reach - softness
    over = xp.clip(distance - hard, 0.0, None)
    return xp.where(distance > hard, hard + softness * (1 - xp.exp(-over / softness)), distance)


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
