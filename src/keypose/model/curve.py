"""Curve: keyframes <time, value> of one animated property, and Clip, a set of curves."""

from __future__ import annotations

import weakref
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum, IntEnum
from functools import lru_cache
from types import MappingProxyType
from typing import Any

import numpy as np

from keypose.arrays import Array, as_float, checked, frozen
from keypose.errors import ShapeError, UnknownName


class Interpolation(IntEnum):
    """How a key leads to the next one."""

    STEP = 0
    LINEAR = 1  # of rotations: slerp, the short way
    HERMITE = 2  # glTF's CUBICSPLINE: values and tangents in units per second
    BEZIER = 3  # handles in seconds and value, each component with its own
    SQUAD = 4  # rotations only: Shoemake's quadrangle, inner controls from the neighbouring keys
    SPHERICAL_BEZIER = 5  # rotations only: De Casteljau's construction on the sphere, controls from the neighbours
    LOG_CUBIC = 6  # rotations only: cubic in the logarithm, angular velocity and acceleration continuous


ROTATION_ONLY = (Interpolation.SQUAD, Interpolation.SPHERICAL_BEZIER, Interpolation.LOG_CUBIC)
"""Interpolations that exist on the sphere alone; they need no tangents."""


class Tangent(IntEnum):
    """How one side of a key comes by its tangent or handle; editing keeps it up to date."""

    FREE = 0  # as it was set
    ALIGNED = 1  # as it was set, in one line with the other side
    VECTOR = 2  # towards the neighbouring key
    AUTO = 3  # Catmull-Rom over the key times
    CLAMPED = 4  # as AUTO, but never beyond the neighbours (monotone)
    FLAT = 5  # level: slow in, slow out


class Extrapolation(Enum):
    """What a curve does before its first and after its last key."""

    HOLD = "hold"
    LINEAR = "linear"
    CYCLE = "cycle"
    CYCLE_OFFSET = "cycle_offset"
    PING_PONG = "ping_pong"


class CurveKind(Enum):
    """What the values mean."""

    SCALAR = "scalar"
    VECTOR = "vector"
    ROTATION = "rotation"  # unit quaternions, wxyz
    EULER = "euler"  # three angles in radians; the clip names their order
    COLOR = "color"  # linear RGB or RGBA
    BOOLEAN = "boolean"  # 0 or 1, in steps


class Property(Enum):
    """The animated property of a channel."""

    TRANSLATION = "translation"
    ROTATION = "rotation"
    EULER = "euler"  # a joint's rotation as three angles, in the order that the clip gives the joint
    SCALE = "scale"
    WEIGHT = "weight"  # of a morph target
    VALUE = "value"  # anything else that has a name: a light's colour, whether something is shown


@dataclass(frozen=True, slots=True)
class Channel:
    """What a curve drives, by name: a joint's translation, rotation, Euler angles or scale, a morph's weight, a value.

    ``component`` is None where the curve has all components, else the one that it drives alone (0 to 2).

    Raises:
        ShapeError: where there is no such component; rotations (but not Euler angles) and weights have none.
    """

    target: str
    property: Property
    component: int | None = None

    def __post_init__(self) -> None:
        if self.component is None:
            return
        if self.component not in (0, 1, 2):
            raise ShapeError(f"component: expected 0, 1, 2 or None, got {self.component}")
        if self.property in (Property.ROTATION, Property.WEIGHT):
            raise ShapeError(f"component: a {self.property.value} has no components that curves could drive alone")

    def __str__(self) -> str:
        axis = "" if self.component is None else f".{'xyz'[self.component]}"
        return f"{self.target}.{self.property.value}{axis}"


_COMPONENTS = {
    CurveKind.SCALAR: (1,),
    CurveKind.ROTATION: (4,),
    CurveKind.EULER: (3,),
    CurveKind.COLOR: (3, 4),
    CurveKind.BOOLEAN: (1,),
}


_MODES = frozenset(int(mode) for mode in Interpolation)
_OF_ROTATIONS = frozenset(int(mode) for mode in ROTATION_ONLY)
_NOT_OF_ROTATIONS = frozenset({int(Interpolation.BEZIER)})

# The times that were checked last: curves of one clip mostly share them, and what is read-only stays as it is.
_sound: list[weakref.ref[Any]] = [weakref.ref(np.zeros(0))]


def _is_sound(times: Array) -> bool:
    return times is _sound[0]()


def _check_times(times: Array) -> None:
    if len(times) == 0:
        raise ShapeError("times_s: a curve needs at least one key")
    if not np.isfinite(times).all():
        raise ShapeError("times_s: expected finite numbers")
    rising = times[1:] > times[:-1]
    if not rising.all():
        k = int(np.argmin(rising))
        raise ShapeError(f"times_s: key {k + 1} at {times[k + 1]} s does not come after key {k} at {times[k]} s")
    _sound[0] = weakref.ref(times)


@lru_cache(maxsize=256)
def _same_modes(mode: Interpolation, count: int) -> Array:
    """One mode for all keys, (count,); shared, for it is read-only."""
    return frozen(np.full(count, int(mode), np.uint8))


def _finite(numbers: Array, name: str) -> Array:
    """The same numbers (K, ...); another library's may be traced and have no values yet."""
    if isinstance(numbers, np.ndarray) and not np.isfinite(numbers).all():
        key = int(np.nonzero(~np.isfinite(numbers))[0][0])
        raise ShapeError(f"{name}: expected finite numbers, got {numbers[key].ravel().tolist()} at key {key}")
    return numbers


def _furthest(numbers: Any, sign: int) -> float:
    return float(sign * np.max(sign * numbers))


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """K keyframes of C components.

    Shapes and units:
        times_s: (K,) float64, strictly increasing.
        values: (K, C); rotations are wxyz with C = 4, scalars have C = 1.
        modes: (K,) `Interpolation` of the span that starts at each key (one value is spread over all keys).
        in_tangents, out_tangents: (K, C) in units per second, or None; needed where a mode is HERMITE.
        in_handles, out_handles: (K, C, 2) seconds and value from the key to its handle, or None; needed where a mode is
            BEZIER. Seconds are <= 0 before and >= 0 after the key; a handle longer than its span counts as far as the span.
        tangent_types: (K, 2) `Tangent` of the side before and after each key, or None where all are FREE.

    Raises:
        ShapeError: where shapes disagree, times do not increase, a number is not finite or a needed tangent is missing.
    """

    times_s: Array
    values: Array
    modes: Any = Interpolation.LINEAR
    in_tangents: Array | None = None
    out_tangents: Array | None = None
    kind: CurveKind = CurveKind.VECTOR
    before: Extrapolation = Extrapolation.HOLD
    after: Extrapolation = Extrapolation.HOLD
    in_handles: Array | None = None
    out_handles: Array | None = None
    tangent_types: Any = None

    def __post_init__(self) -> None:
        times = frozen(self.times_s, np.float64)
        checked(times, ("K",), "times_s")
        count = len(times)
        if not _is_sound(times):
            _check_times(times)
        values = checked(as_float(self.values), (count, "C"), "values", f"{count} key times")
        widths = _COMPONENTS.get(self.kind)
        if widths is not None and values.shape[1] not in widths:
            asked = " or ".join(str(w) for w in widths)
            raise ShapeError(f"values: expected ({count}, {asked}) for a {self.kind.value} curve, got {values.shape}")
        object.__setattr__(self, "times_s", times)
        object.__setattr__(self, "values", frozen(_finite(values, "values")))
        if type(self.modes) is Interpolation:
            modes, used = _same_modes(self.modes, count), {int(self.modes)}
        else:
            modes = frozen(np.broadcast_to(np.asarray(self.modes, np.uint8), (count,)))
            # The last key starts no span; its mode matters to a curve of one key only when a key is added.
            used = set(np.unique(modes[: max(count - 1, 1)]).tolist())
        object.__setattr__(self, "modes", modes)
        self._check_modes(used)
        self._keep_sides(("in_tangents", "out_tangents"), Interpolation.HERMITE, tuple(values.shape), used)
        self._keep_sides(("in_handles", "out_handles"), Interpolation.BEZIER, (*values.shape, 2), used)
        for name, sign in (("in_handles", -1), ("out_handles", 1)):
            handles = getattr(self, name)
            if isinstance(handles, np.ndarray) and np.any(sign * handles[..., 0] < 0):
                side = "at or before" if sign < 0 else "at or after"
                raise ShapeError(f"{name}: expected seconds {side} the key, got {_furthest(handles[..., 0], -sign)} s")
        if self.tangent_types is not None:
            types = np.asarray(self.tangent_types, np.uint8)
            if types.size and types.max() > max(Tangent):
                raise ShapeError(f"tangent_types: expected Tangent (0 to {int(max(Tangent))}), got {int(types.max())}")
            object.__setattr__(
                self, "tangent_types", frozen(checked(types, (count, 2), "tangent_types", f"{count} keys"))
            )

    def _check_modes(self, used: set[int]) -> None:
        if not used <= _MODES:
            raise ShapeError(f"modes: expected Interpolation (0 to {max(_MODES)}), got {max(used)}")
        wrong = used & (_NOT_OF_ROTATIONS if self.kind is CurveKind.ROTATION else _OF_ROTATIONS)
        if wrong:
            raise ShapeError(f"modes: a {self.kind.value} curve cannot have {Interpolation(min(wrong)).name}")
        if self.kind is CurveKind.BOOLEAN:
            if used != {Interpolation.STEP}:
                raise ShapeError("modes: a boolean curve goes in steps (STEP)")
            if isinstance(self.values, np.ndarray) and not np.all((self.values == 0) | (self.values == 1)):
                raise ShapeError("values: a boolean curve is 0 or 1 at its keys")

    def _keep_sides(self, names: tuple[str, str], mode: Interpolation, shape: tuple[int, ...], used: set[int]) -> None:
        for name in names:
            sides = getattr(self, name)
            if sides is not None:
                object.__setattr__(self, name, frozen(_finite(checked(as_float(sides), shape, name, "values"), name)))
            elif mode in used:
                raise ShapeError(f"{name}: a {mode.name} curve needs {name} of shape {shape}")

    @property
    def key_count(self) -> int:
        """K."""
        return len(self.times_s)


EULER_ORDER = "XYZ"
"""The order of a joint's Euler angles where a clip names none."""


def _no_orders() -> Mapping[str, str]:
    return {}


def _no_curves() -> Mapping[Channel, Curve]:
    return {}


@dataclass(frozen=True, slots=True, eq=False)
class Clip:
    """Sparse, editable animation: curves by channel.

    Joints and morphs are named, so that one clip can drive every skeleton that has those names; what a clip does not
    animate stays at rest.

    Raises:
        ShapeError: where a joint has both a rotation curve and Euler curves.
    """

    curves: Mapping[Channel, Curve] = field(default_factory=_no_curves)
    name: str = ""
    rate_hz: float | None = None  # the rate it was authored at, if known
    euler_orders: Mapping[str, str] = field(default_factory=_no_orders)
    """Order of a joint's Euler angles as `keypose.math.euler` names it; `EULER_ORDER` where a joint is not named."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "curves", MappingProxyType(dict(self.curves)))
        turned = {c.target for c in self.curves if c.property is Property.EULER}
        both = next((c.target for c in self.curves if c.property is Property.ROTATION and c.target in turned), None)
        if both is not None:
            raise ShapeError(f"joint '{both}': it has a rotation curve and Euler curves; only one can drive it")
        object.__setattr__(self, "euler_orders", MappingProxyType(dict(self.euler_orders)))

    @property
    def start_s(self) -> float:
        """Time of the first key of all."""
        return min((float(c.times_s[0]) for c in self.curves.values()), default=0.0)

    @property
    def end_s(self) -> float:
        """Time of the last key of all."""
        return max((float(c.times_s[-1]) for c in self.curves.values()), default=0.0)

    @property
    def duration_s(self) -> float:
        """From the first key to the last."""
        return self.end_s - self.start_s

    def curve(self, target: str, property: Property, component: int | None = None) -> Curve:
        """One curve; raises `UnknownName` with the nearest channel."""
        channel = Channel(target, property, component)
        if channel not in self.curves:
            raise UnknownName("channel", str(channel), [str(c) for c in self.curves])
        return self.curves[channel]
