"""What all rotation code needs: input checks, dot, cross, norm, and series that stay smooth at zero.

Everything here is array-API generic and differentiable: where a formula divides by something that may vanish, the
division is done on a replaced, harmless value and the designed value is selected afterwards, so that neither the
value nor its gradient becomes NaN.
"""

from __future__ import annotations

from functools import cache
from math import factorial
from types import ModuleType
from typing import Any

import array_api_compat
import numpy as np

from keypose.arrays import Array, checked, namespace
from keypose.errors import ShapeError

# Below this x² the power series are exact to float64, and above it the direct forms still have accurate gradients.
_SERIES_BELOW = 1e-3
# sin(x)/x, cos(x), (cos(x) - sin(x)/x) / x², atan(x)/x and (1 - atan(x)/x) / x² as power series of x².
_SINC = [(-1) ** k / factorial(2 * k + 1) for k in range(5)]
_COS = [(-1) ** k / factorial(2 * k) for k in range(6)]
_SINC_SLOPE = [(-1) ** k * 2 * k / factorial(2 * k + 1) for k in range(1, 8)]
_ATAN = [(-1) ** k / (2 * k + 1) for k in range(7)]
_ATAN_GAP = [(-1) ** k / (2 * k + 3) for k in range(7)]


def take(**named: tuple[Any, tuple[int, ...]]) -> tuple[Any, ...]:
    """The namespace and the named inputs as floating-point arrays, checked to end in the given axes.

    Raises:
        ShapeError: where an input has the wrong trailing axes, the batch shapes do not broadcast or the arrays belong
            to different libraries.
    """
    xp, *arrays = convert(**{name: value for name, (value, _) in named.items()})
    batches: dict[str, tuple[int, ...]] = {}
    for array, (name, (_, tail)) in zip(arrays, named.items(), strict=True):
        kept = array.ndim - len(tail)
        if kept < 0 or tuple(array.shape[kept:]) != tail:
            checked(array, (..., *tail), name)
        batches[name] = tuple(array.shape[:kept])
    check_broadcast(batches)
    return (xp, *arrays)


def convert(**named: Any) -> tuple[Any, ...]:
    """The namespace and the named inputs as floating-point arrays of one library.

    Lists, numbers, NumPy scalars and integer arrays take the precision (and the device) of the floating-point arrays
    beside them, else float64.

    Raises:
        ShapeError: where the arrays belong to different libraries.
    """
    values = list(named.values())
    # NumPy's scalars count as plain numbers beside arrays: a u from np.linspace goes with tensors, too.
    given = [v for v in values if hasattr(v, "shape") and not isinstance(v, np.generic)]
    if given:
        values = [v.item() if isinstance(v, np.generic) else v for v in values]
    else:
        values = [np.asarray(v) if isinstance(v, np.generic) else v for v in values]
        given = [v for v in values if isinstance(v, np.ndarray)] or [np.asarray(0.0)]
    try:
        xp = namespace(*given)
    except TypeError:
        libraries = sorted({type(v).__module__.partition(".")[0] for v in given})
        raise ShapeError(f"{', '.join(named)}: expected arrays of one library, got {' and '.join(libraries)}") from None
    if any(not _is_float(xp, v) for v in values):
        floats = [v for v in given if _is_float(xp, v)]
        dtype = xp.result_type(*floats) if floats else xp.float64
        device = array_api_compat.device(given[0])
        values = [v if _is_float(xp, v) else xp.asarray(v, dtype=dtype, device=device) for v in values]
    return (xp, *values)


def check_broadcast(batches: dict[str, tuple[int, ...]]) -> None:
    """Raises ShapeError, naming the inputs, where their batch shapes do not broadcast."""
    try:
        np.broadcast_shapes(*batches.values())
    except ValueError:
        shown = ", ".join(f"{name} {batch}" for name, batch in batches.items())
        raise ShapeError(f"batch shapes do not broadcast: {shown}") from None


def _is_float(xp: ModuleType, value: Any) -> bool:
    if isinstance(value, (np.ndarray, np.generic)):
        return value.dtype == np.float32 or value.dtype == np.float64
    return hasattr(value, "dtype") and xp.isdtype(value.dtype, "real floating")


def matched(xp: ModuleType, value: Array, reference: Array) -> Array:
    """A parameter (u, a weight, a time) in the precision of the values it acts on."""
    return value if value.dtype == reference.dtype else xp.astype(value, reference.dtype)


def beside(xp: ModuleType, values: Any, reference: Array) -> Array:
    """Numbers as an array of the reference's library, precision and device."""
    return xp.asarray(values, dtype=reference.dtype, device=array_api_compat.device(reference))


def parts(array: Array) -> tuple[Array, ...]:
    """The components along the last axis."""
    return tuple(array[..., i] for i in range(array.shape[-1]))


def join(xp: ModuleType, *components: Array) -> Array:
    """Components, of broadcastable shapes, stacked along a new last axis."""
    if all(isinstance(c, (np.ndarray, np.generic)) for c in components):
        shape = np.broadcast_shapes(*(c.shape for c in components))
        out = np.empty((*shape, len(components)), components[0].dtype)
        for i, component in enumerate(components):
            out[..., i] = component
        return out
    if len({tuple(c.shape) for c in components}) > 1:
        components = tuple(xp.broadcast_arrays(*components))
    return xp.stack(components, axis=-1)


def sign(xp: ModuleType, x: Array) -> Array:
    """-1 where x is negative, else 1 (also for zeros of both signs)."""
    one = xp.ones_like(x)
    return xp.where(x < 0, -one, one)


def scaled(xp: ModuleType, factor: Array, v: Array) -> Array:
    """Vectors (*B, N) times numbers (*B); component by component, which NumPy does several times faster."""
    return join(xp, *(factor * c for c in parts(v)))


def dot(xp: ModuleType, a: Array, b: Array) -> Array:
    """Dot product along the last axis."""
    return xp.vecdot(a, b)


def cross(xp: ModuleType, a: Array, b: Array) -> Array:
    """Cross product of vectors (*B, 3)."""
    ax, ay, az = parts(a)
    bx, by, bz = parts(b)
    return join(xp, ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx)


def eps(xp: ModuleType, array: Array) -> float:
    """The distance from 1 to the next number of this precision."""
    return _limits(xp, array.dtype)[0]


def vanishes(xp: ModuleType, squared: Array) -> Array:
    """Where a squared norm is zero or too small to be divided by."""
    return squared < _limits(xp, squared.dtype)[1]


@cache
def _limits(xp: ModuleType, dtype: Any) -> tuple[float, float]:
    info = xp.finfo(dtype)
    return float(info.eps), float(info.smallest_normal)


def root(xp: ModuleType, squared: Array) -> Array:
    """Square root whose gradient at 0 is 0 (not infinite)."""
    zero = vanishes(xp, squared)
    return xp.where(zero, 0.0 * squared, xp.sqrt(xp.where(zero, 1.0, squared)))


def norm(xp: ModuleType, v: Array) -> Array:
    """Length along the last axis; its gradient at the zero vector is 0."""
    return root(xp, dot(xp, v, v))


def unit(xp: ModuleType, v: Array) -> Array:
    """The direction of a vector; the zero vector stays zero."""
    squared = dot(xp, v, v)
    zero = vanishes(xp, squared)
    return scaled(xp, xp.where(zero, 0.0, 1.0 / xp.sqrt(xp.where(zero, 1.0, squared))), v)


def perpendiculars(xp: ModuleType, v: Array) -> tuple[Array, Array]:
    """Two unit vectors b1, b2 that make (b1, b2, v) a right-handed frame, for unit v (*B, 3).

    For v = Z they are X and Y. Source: Duff et al., Building an Orthonormal Basis, Revisited (JCGT 2017).
    """
    x, y, z = parts(v)
    s = sign(xp, z)
    a = -1.0 / (s + z)
    b = x * y * a
    return join(xp, 1.0 + s * x * x * a, s * b, -s * x), join(xp, b, s + y * y * a, -y)


def _series(coefficients: list[float], t: Array) -> Array:
    total = coefficients[-2] + coefficients[-1] * t
    for c in reversed(coefficients[:-2]):
        total = c + t * total
    return total


def cos_sinc(xp: ModuleType, squared: Array) -> tuple[Array, Array]:
    """cos(x) and sin(x)/x of x = sqrt(squared), smooth at 0."""
    small = squared < _SERIES_BELOW
    x = xp.sqrt(xp.where(small, 1.0, squared))
    t = xp.where(small, squared, 0.0)
    return xp.where(small, _series(_COS, t), xp.cos(x)), xp.where(small, _series(_SINC, t), xp.sin(x) / x)


def slerp_weights(xp: ModuleType, arc_squared: Array, u: Array) -> tuple[Array, Array]:
    """sin((1 - u) x) / sin(x) and sin(u x) / sin(x) of an arc x = sqrt(arc_squared), smooth at x = 0."""
    v = 1.0 - u
    u_squared, v_squared = u * u, v * v
    small = arc_squared * (1.0 + u_squared + v_squared) < _SERIES_BELOW
    arc = xp.sqrt(xp.where(small, 1.0, arc_squared))
    t = xp.where(small, arc_squared, 0.0)
    whole_series, whole = _series(_SINC, t), xp.sin(arc)
    return (
        xp.where(small, v * _series(_SINC, v_squared * t) / whole_series, xp.sin(v * arc) / whole),
        xp.where(small, u * _series(_SINC, u_squared * t) / whole_series, xp.sin(u * arc) / whole),
    )


def sinc_slope(xp: ModuleType, squared: Array) -> Array:
    """(cos(x) - sin(x)/x) / x² of x = sqrt(squared), which is the slope of sin(x)/x divided by x; -1/3 at 0."""
    small = squared < 16 * _SERIES_BELOW
    safe = xp.where(small, 1.0, squared)
    x = xp.sqrt(safe)
    return xp.where(small, _series(_SINC_SLOPE, xp.where(small, squared, 0.0)), (xp.cos(x) - xp.sin(x) / x) / safe)


def angle_ratio(xp: ModuleType, squared: Array, w: Array) -> Array:
    """atan2(n, w) / n of n = sqrt(squared) >= 0, smooth at n = 0 for w > 0; where n = 0 and w <= 0 it is finite."""
    small = (w > 0) & (squared < _SERIES_BELOW * w * w)
    w_safe = xp.where(small, w, 1.0)
    t = xp.where(small, squared, 0.0) / (w_safe * w_safe)
    n = xp.sqrt(xp.where(small | vanishes(xp, squared), 1.0, squared))
    return xp.where(small, _series(_ATAN, t) / w_safe, xp.atan2(n, w) / n)


def angle_ratio_gap(xp: ModuleType, squared: Array, w: Array) -> Array:
    """(1 - w atan2(n, w) / n) / n² of n = sqrt(squared), for w > 0 or n > 0; 1 / (3 w²) at n = 0."""
    small = (w > 0) & (squared < _SERIES_BELOW * w * w)
    w_safe = xp.where(small, w, 1.0)
    t = xp.where(small, squared, 0.0) / (w_safe * w_safe)
    safe = xp.where(small | vanishes(xp, squared), 1.0, squared)
    n = xp.sqrt(safe)
    return xp.where(small, _series(_ATAN_GAP, t) / (w_safe * w_safe), (1.0 - w * xp.atan2(n, w) / n) / safe)


def constant(array: Array) -> Array:
    """The same values, with no gradient flowing through them."""
    if hasattr(array, "detach"):
        return array.detach()
    if array_api_compat.is_jax_array(array):
        import jax  # pyright: ignore[reportMissingImports]

        return jax.lax.stop_gradient(array)
    return array
