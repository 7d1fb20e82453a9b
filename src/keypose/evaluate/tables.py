"""Many curves, each with its own keys, made ready to be sampled together by a kernel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from keypose.arrays import Array
from keypose.errors import ShapeError
from keypose.evaluate.curves import finite_times, sample_curve
from keypose.model import Curve, CurveKind, Extrapolation, Interpolation

_RULES = list(Extrapolation)


@dataclass(frozen=True, slots=True, eq=False)
class CurveTable:
    """N curves, made by `prepare_curves`; D is the number of all their components.

    ``starts`` (N + 1,): the components of curve n are ``starts[n]`` to ``starts[n + 1]``. Curves that the kernel does not know
    (splines on the sphere, rotations that turn on beyond their keys) are among them and sampled one by one.
    """

    starts: Array
    curves: tuple[Curve, ...]
    others: tuple[int, ...]
    arrays: tuple[Array, ...]  # what the kernel reads: see `keypose.kernels.curves`

    @property
    def component_count(self) -> int:
        """D."""
        return int(self.starts[-1])

    @property
    def byte_count(self) -> int:
        """Bytes of keys, values, tangents and handles."""
        return sum(int(a.nbytes) for a in self.arrays)


def prepare_curves(curves: Sequence[Curve], dtype: Any = None) -> CurveTable:
    """Curves of any kinds, modes and key times, side by side for `sample_curves`.

    ``dtype`` is float32 or float64 for values, tangents and handles; the widest of the curves where it is None.

    Raises:
        ShapeError: where a curve holds another library's arrays, or dtype is neither.
    """
    curves = tuple(curves)
    foreign = next((c for c in curves if not isinstance(c.values, np.ndarray)), None)
    if foreign is not None:
        raise ShapeError(f"curves: expected NumPy arrays, got {type(foreign.values).__name__}")
    precision = np.dtype(dtype) if dtype is not None else np.result_type(np.float32, *(c.values.dtype for c in curves))
    if precision.kind != "f" or precision.itemsize not in (4, 8):
        raise ShapeError(f"dtype: expected float32 or float64, got {precision}")
    known = [n for n, c in enumerate(curves) if _in_kernel(c)]
    widths = np.array([c.values.shape[1] for c in curves], np.int64)
    tracks = np.zeros((len(known), 10), np.int64)
    keys: list[Array] = []
    modes: list[Array] = []
    values: list[Array] = []
    tangents: list[Array] = []
    handles: list[Array] = []
    at_key = at_value = at_tangent = at_handle = 0
    for row, n in enumerate(known):
        curve = curves[n]
        count, width = curve.values.shape
        spans = np.asarray(curve.modes[:-1])
        cubic, weighted = bool(np.any(spans == Interpolation.HERMITE)), bool(np.any(spans == Interpolation.BEZIER))
        kind = 2 if curve.kind is CurveKind.ROTATION else int(cubic or weighted)
        before, after = _RULES.index(curve.before), _RULES.index(curve.after)
        if curve.kind is CurveKind.BOOLEAN:  # what is on or off comes back as it was
            before, after = (2 if r == 3 else r for r in (before, after))
        tracks[row] = (
            at_key, count, at_value, width, at_tangent if cubic else -1, at_handle if weighted else -1, kind, before, after,
            int(curve.modes[0]) if count < 2 or np.all(spans == spans[0]) else -1,
        )  # fmt: skip
        keys.append(curve.times_s)
        modes.append(np.asarray(curve.modes))
        values.append(curve.values.ravel())
        # What arrives at a key and what leaves it stand together.
        if cubic and curve.in_tangents is not None and curve.out_tangents is not None:
            tangents.append(np.stack([curve.in_tangents, curve.out_tangents], axis=1).ravel())
        if weighted and curve.in_handles is not None and curve.out_handles is not None:
            handles.append(np.stack([curve.in_handles, curve.out_handles], axis=1).ravel())
        at_key, at_value = at_key + count, at_value + count * width
        at_tangent += 2 * count * width if cubic else 0
        at_handle += 4 * count * width if weighted else 0

    def joined(parts: list[Array], kind: Any) -> Array:
        return np.ascontiguousarray(np.concatenate(parts), kind) if parts else np.zeros(0, kind)

    arrays = (
        tracks, joined(keys, np.float64), joined(modes, np.uint8), joined(values, precision),
        joined(tangents, precision), joined(handles, precision),
    )  # fmt: skip
    starts = np.concatenate([[0], np.cumsum(widths)]).astype(np.int64)
    return CurveTable(starts, curves, tuple(n for n in range(len(curves)) if n not in set(known)), arrays)


def sample_curves(table: CurveTable, times_s: Any, out: Array | None = None) -> Array:
    """All curves at times of any shape: what `sample_curve` gives for each, side by side.

    Shapes and units: ``times_s`` (*B,) seconds; returns (*B, D) in the precision of the table. The result is a view in which
    the times of one component stand side by side in memory; ``out`` (D, number of times), if given, is that memory, so that a
    caller who asks again and again takes none anew.

    Raises:
        ShapeError: where a time is not finite or ``out`` does not fit.
    """
    from keypose.kernels.curves import sample_tracks

    times = finite_times(times_s)
    flat = times.reshape(-1)
    rising = bool(np.all(flat[1:] >= flat[:-1]))
    order = None if rising else np.argsort(flat, kind="stable")
    asked = np.ascontiguousarray(flat if order is None else flat[order])
    rows = int(table.arrays[0][:, 3].sum())
    given = _checked_out(out, table, len(flat))
    direct = given if order is None and not table.others else None
    found: Array = np.empty((rows, len(flat)), table.arrays[3].dtype) if direct is None else direct
    sample_tracks(asked, *table.arrays, found)
    if order is not None:
        back = np.empty_like(found)
        back[:, order] = found
        found = back
    if table.others:
        found = _with_others(table, flat, found)
    if given is not None and direct is None:
        given[...] = found
        found = given
    return np.moveaxis(found.reshape(table.component_count, *times.shape), 0, -1)


def _checked_out(out: Array | None, table: CurveTable, count: int) -> Array | None:
    if out is None:
        return None
    wanted, precision = (table.component_count, count), table.arrays[3].dtype
    if not isinstance(out, np.ndarray) or out.shape != wanted or out.dtype != precision or not out.flags.c_contiguous:
        raise ShapeError(f"out: expected a contiguous array {wanted} of {precision}, got {getattr(out, 'shape', out)}")
    return out


def _in_kernel(curve: Curve) -> bool:
    if curve.kind is not CurveKind.ROTATION:
        return True
    if np.any(np.asarray(curve.modes[: max(curve.key_count - 1, 1)]) > Interpolation.HERMITE):
        return False
    turning = (Extrapolation.LINEAR, Extrapolation.CYCLE_OFFSET)
    return curve.before not in turning and curve.after not in turning


def _with_others(table: CurveTable, times: Array, out: Array) -> Array:
    whole = np.empty((table.component_count, len(times)), out.dtype)
    own = np.ones(table.component_count, bool)
    for n in table.others:
        rows = slice(int(table.starts[n]), int(table.starts[n + 1]))
        own[rows] = False
        whole[rows] = np.moveaxis(sample_curve(table.curves[n], times), -1, 0)
    whole[own] = out
    return whole
