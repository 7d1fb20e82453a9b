"""Curve: keyframes <time, value> of one animated property, and Clip, a set of curves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum, IntEnum
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


class Property(Enum):
    """The animated property of a channel."""

    TRANSLATION = "translation"
    ROTATION = "rotation"
    SCALE = "scale"
    WEIGHT = "weight"  # of a morph target


@dataclass(frozen=True, slots=True)
class Channel:
    """What a curve drives: a joint's translation, rotation or scale, or a morph's weight, by name."""

    target: str
    property: Property


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """K keyframes of C components.

    Shapes and units:
        times_s: (K,) float64, strictly increasing.
        values: (K, C); rotations are wxyz with C = 4, scalars have C = 1.
        modes: (K,) `Interpolation` of the span that starts at each key (one value is spread over all keys).
        in_tangents, out_tangents: (K, C) in units per second, or None; needed where a mode is HERMITE.

    Raises:
        ShapeError: where shapes disagree, times do not increase or a needed tangent is missing.
    """

    times_s: Array
    values: Array
    modes: Any = Interpolation.LINEAR
    in_tangents: Array | None = None
    out_tangents: Array | None = None
    kind: CurveKind = CurveKind.VECTOR
    before: Extrapolation = Extrapolation.HOLD
    after: Extrapolation = Extrapolation.HOLD

    def __post_init__(self) -> None:
        times = frozen(self.times_s, np.float64)
        checked(times, ("K",), "times_s")
        count = len(times)
        if count == 0:
            raise ShapeError("times_s: a curve needs at least one key")
        if not np.all(np.isfinite(times)):
            raise ShapeError("times_s: expected finite numbers")
        late = np.nonzero(np.diff(times) <= 0)[0]
        if len(late):
            k = int(late[0])
            raise ShapeError(f"times_s: key {k + 1} at {times[k + 1]} s does not come after key {k} at {times[k]} s")
        values = checked(as_float(self.values), (count, "C"), "values", f"{count} key times")
        width = {CurveKind.SCALAR: 1, CurveKind.ROTATION: 4}.get(self.kind)
        if width is not None and values.shape[1] != width:
            raise ShapeError(f"values: expected ({count}, {width}) for a {self.kind.value} curve, got {values.shape}")
        modes = np.broadcast_to(np.asarray(self.modes, np.uint8), (count,))
        object.__setattr__(self, "times_s", times)
        object.__setattr__(self, "values", frozen(values))
        object.__setattr__(self, "modes", frozen(modes))
        for name in ("in_tangents", "out_tangents"):
            tangents = getattr(self, name)
            if tangents is not None:
                tangents = checked(as_float(tangents), tuple(values.shape), name, "values")
                object.__setattr__(self, name, frozen(tangents))
            elif np.any(modes[: max(count - 1, 1)] == Interpolation.HERMITE):
                raise ShapeError(f"{name}: a HERMITE curve needs tangents of shape {tuple(values.shape)}")

    @property
    def key_count(self) -> int:
        """K."""
        return len(self.times_s)


def _no_curves() -> Mapping[Channel, Curve]:
    return {}


@dataclass(frozen=True, slots=True, eq=False)
class Clip:
    """Sparse, editable animation: curves by channel.

    Joints and morphs are named, so that one clip can drive every skeleton that has those names; what a clip does not
    animate stays at rest.
    """

    curves: Mapping[Channel, Curve] = field(default_factory=_no_curves)
    name: str = ""
    rate_hz: float | None = None  # the rate it was authored at, if known

    def __post_init__(self) -> None:
        object.__setattr__(self, "curves", MappingProxyType(dict(self.curves)))

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

    def curve(self, target: str, property: Property) -> Curve:
        """One curve; raises `UnknownName` with the nearest channel."""
        channel = Channel(target, property)
        if channel not in self.curves:
            known = [f"{c.target}.{c.property.value}" for c in self.curves]
            raise UnknownName("channel", f"{target}.{property.value}", known)
        return self.curves[channel]
