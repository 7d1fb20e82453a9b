"""What a capture lab records: marker trajectories, analog signals and force plates."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np

from keypose.arrays import Array, as_float, checked, frozen
from keypose.errors import ShapeError, UnknownName


def _nothing() -> Mapping[str, Any]:
    return {}


def _kept(owner: object, name: str, mapping: Mapping[str, Any]) -> None:
    object.__setattr__(owner, name, MappingProxyType(dict(mapping)))


def _rate(rate_hz: float, owner: str) -> None:
    if not (np.isfinite(rate_hz) and rate_hz > 0):
        raise ShapeError(f"{owner}: expected a rate above 0 Hz, got {rate_hz}")


@dataclass(frozen=True, slots=True, eq=False)
class Markers:
    """Trajectories of N markers over T frames; what was not seen is not a number.

    Shapes and units:
        positions: (T, N, 3) metres, NaN where a marker was not seen.
        visible: (T, N), found from the positions if not given.
        residuals: (T, N) metres, how far the cameras' rays miss each other, or none; NaN where not seen, 0 for a point that
            was filled or smoothed.
        cameras: (T, N) bit mask of the cameras that saw a marker, or none.
        start_frame: the number of the first frame in the file.
    """

    names: tuple[str, ...]
    positions: Array
    rate_hz: float
    visible: Array | None = None
    residuals: Array | None = None
    cameras: Array | None = None
    start_frame: int = 1
    name: str = ""
    extras: Mapping[str, Any] = field(default_factory=_nothing)

    def __post_init__(self) -> None:
        object.__setattr__(self, "names", tuple(self.names))
        positions = checked(as_float(self.positions), ("T", len(self.names), 3), "positions", "names")
        _rate(self.rate_hz, "markers")
        shape = tuple(positions.shape[:2])
        visible = np.isfinite(np.asarray(positions)).all(axis=-1) if self.visible is None else self.visible
        object.__setattr__(self, "positions", frozen(positions))
        object.__setattr__(self, "visible", frozen(checked(np.asarray(visible, bool), shape, "visible", "positions")))
        if self.residuals is not None:
            object.__setattr__(
                self, "residuals", frozen(checked(as_float(self.residuals), shape, "residuals", "positions"))
            )
        if self.cameras is not None:
            cameras = checked(np.asarray(self.cameras, np.int32), shape, "cameras", "positions")
            object.__setattr__(self, "cameras", frozen(cameras, np.int32))
        _kept(self, "extras", self.extras)

    @property
    def frame_count(self) -> int:
        """T."""
        return int(self.positions.shape[0])

    @property
    def duration_s(self) -> float:
        """From the first frame to the last."""
        return max(self.frame_count - 1, 0) / self.rate_hz

    def index(self, name: str) -> int:
        """The marker's index; raises `UnknownName` with the nearest name."""
        if name not in self.names:
            raise UnknownName("marker", name, self.names)
        return self.names.index(name)


@dataclass(frozen=True, slots=True, eq=False)
class Signals:
    """C channels of numbers over time: analog channels, or what was computed from markers (angles, moments, powers).

    Shapes and units: values (T, C) or (T, C, 3), in ``units`` (one per channel, as the file names them); ``kind``
    says what they are: "analog", "angle", "force", "moment", "power", "scalar" or another word.
    """

    names: tuple[str, ...]
    values: Array
    rate_hz: float
    units: tuple[str, ...] = ()
    kind: str = "analog"
    name: str = ""
    extras: Mapping[str, Any] = field(default_factory=_nothing)

    def __post_init__(self) -> None:
        object.__setattr__(self, "names", tuple(self.names))
        object.__setattr__(self, "units", tuple(self.units) or ("",) * len(self.names))
        values = as_float(self.values)
        if values.ndim not in (2, 3) or values.shape[1] != len(self.names) or values.shape[2:] not in ((), (3,)):
            raise ShapeError(
                f"values: expected (T, {len(self.names)}) or (T, {len(self.names)}, 3), got {tuple(values.shape)}"
            )
        if len(self.units) != len(self.names):
            raise ShapeError(f"units: expected {len(self.names)}, got {len(self.units)}")
        _rate(self.rate_hz, "signals")
        object.__setattr__(self, "values", frozen(values))
        _kept(self, "extras", self.extras)


@dataclass(frozen=True, slots=True, eq=False)
class ForcePlate:
    """A plate in the floor that measures forces.

    Shapes and units: corners (4, 3) metres in the world; origin (3,) metres, from the plate's own origin to the middle of its surface;
    channels: names of its analog channels in the order of its ``kind`` (the C3D type number); calibration (C, C) or none.
    """

    corners: Array
    origin: Array
    kind: int
    channels: tuple[str, ...] = ()
    calibration: Array | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "corners", frozen(checked(as_float(self.corners), (4, 3), "corners")))
        object.__setattr__(self, "origin", frozen(checked(as_float(self.origin), (3,), "origin")))
        object.__setattr__(self, "channels", tuple(self.channels))
        if self.calibration is not None:
            object.__setattr__(self, "calibration", frozen(as_float(self.calibration)))
