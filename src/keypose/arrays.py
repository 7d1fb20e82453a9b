"""What every layer needs of arrays: the array namespace, frozen copies, shape checks.

``Array`` stands for any array of the array-API standard (NumPy, PyTorch, JAX, CuPy). It is ``Any``
for the type checker because the standard has no common static type yet.
"""

from __future__ import annotations

from types import ModuleType
from typing import Any, TypeAlias

import array_api_compat
import numpy as np
from numpy.typing import NDArray

from keypose.errors import ShapeError

Array: TypeAlias = Any
Floats: TypeAlias = NDArray[np.floating[Any]]
Ints: TypeAlias = NDArray[np.integer[Any]]


def namespace(*arrays: Array) -> ModuleType:
    """The array-API namespace that all the given arrays share (plain numbers are passed over)."""
    return array_api_compat.array_namespace(*(a for a in arrays if hasattr(a, "shape")))


def as_float(array: Any) -> Array:
    """A floating-point array: float32 and float64 as they are, lists and integers as float64."""
    if not hasattr(array, "shape"):
        array = np.asarray(array)
    if isinstance(array, np.ndarray):
        return array if array.dtype in (np.float32, np.float64) else array.astype(np.float64)
    xp = namespace(array)
    return array if xp.isdtype(array.dtype, "real floating") else xp.astype(array, xp.float64)


def unified(*arrays: Any) -> tuple[Array, ...]:
    """The arrays in one library: NumPy constants follow the PyTorch or JAX arrays that they meet.

    NumPy arrays alone are returned as they are. Beside an array of another library all become floating-point arrays of
    that library, of one precision (the widest) and on its device, because not every library promotes by itself.
    """
    arrays = tuple(a if hasattr(a, "shape") and not isinstance(a, np.generic) else np.asarray(a) for a in arrays)
    foreign = [a for a in arrays if not isinstance(a, np.ndarray)]
    if not foreign:
        return tuple(as_float(a) for a in arrays)
    xp, device = namespace(*foreign), array_api_compat.device(foreign[0])
    # Frozen arrays are copied: PyTorch shares memory and cannot share what is read-only.
    moved = [as_float(xp.asarray(a.copy(), device=device) if isinstance(a, np.ndarray) else a) for a in arrays]
    dtype = xp.result_type(*(a.dtype for a in moved))
    return tuple(a if a.dtype == dtype else xp.astype(a, dtype) for a in moved)


def gather(array: Array, index: Ints, axis: int) -> Array:
    """Entries of an array of any library along one axis, at a NumPy index (N,)."""
    if isinstance(array, np.ndarray):
        return np.take(array, index, axis=axis)
    xp = namespace(array)
    return xp.take(array, xp.asarray(np.array(index, np.int64), device=array_api_compat.device(array)), axis=axis)


def frozen(array: Any, dtype: Any = None) -> Array:
    """A read-only, contiguous copy of a NumPy array (or list); other libraries' arrays are returned as they are.

    An array that already owns read-only memory is returned itself, so that rebuilding a frozen type is cheap.
    """
    if hasattr(array, "shape") and not isinstance(array, (np.ndarray, np.generic)):
        return array
    if (
        isinstance(array, np.ndarray)
        and array.flags.owndata
        and array.flags.c_contiguous
        and not array.flags.writeable
        and (dtype is None or array.dtype == dtype)
    ):
        return array
    copy = np.array(array, dtype=dtype, order="C")
    copy.setflags(write=False)
    return copy


def checked(array: Any, shape: tuple[int | str | Any, ...], name: str, context: str = "") -> Array:
    """``array`` itself if its shape fits, else a `ShapeError` that says what was expected.

    ``shape`` may start with ``...`` (any batch) and hold numbers (exact) or letters (any size; the same letter
    twice must be the same size): ``checked(rotations, (..., joint_count, 4), "rotations", "skeleton 'anna'")``.
    """
    actual = tuple(int(n) for n in array.shape) if hasattr(array, "shape") else np.shape(array)
    batched = bool(shape) and shape[0] is Ellipsis
    wanted = shape[1:] if batched else shape
    tail = actual[len(actual) - len(wanted) :] if batched else actual
    sizes: dict[str, int] = {}
    fits = len(tail) == len(wanted) and len(actual) >= len(wanted)
    for want, have in zip(wanted, tail, strict=False):
        fits = fits and (sizes.setdefault(want, have) == have if isinstance(want, str) else want == have)
    if not fits:
        expected = ", ".join((["*B"] if batched else []) + [str(w) for w in wanted])
        comma = "," if len(wanted) + batched == 1 and not batched else ""
        suffix = f" to match {context}" if context else ""
        raise ShapeError(f"{name}: expected ({expected}{comma}){suffix}, got {actual}")
    return array


def finite(array: Floats, name: str) -> Floats:
    """``array`` itself if all its numbers are finite, else a `ShapeError` that says which is not."""
    good = np.isfinite(array)
    if not good.all():
        at = tuple(int(n) for n in np.unravel_index(int(np.argmin(good)), good.shape))
        raise ShapeError(f"{name}: expected finite numbers, got {array[at]} at {list(at)}")
    return array
