"""Timeline: layers of placed animations, as an animator stacks them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from types import MappingProxyType

from keypose.errors import ShapeError, UnknownName
from keypose.model.curve import Curve, CurveKind, Property


class LayerMode(Enum):
    """How a layer joins what lies below it."""

    REPLACE = "replace"  # previous towards value: lerp, slerp the short way
    ADD = "add"  # previous * (value relative to rest) ^ influence


@dataclass(frozen=True, slots=True, eq=False)
class Placement:
    """An animation on a layer, by name: where it starts, how fast it goes, how often, and how strongly.

    Units:
        start_s: where it begins on the timeline.
        in_s, out_s: the part of the animation that is used, in its own time; None for its own beginning and end.
        speed: seconds of the animation in a second of the timeline; negative runs it backwards.
        cycles: how often the part is gone through, 1 or more or less.
        fade_in_s, fade_out_s: seconds of the timeline over which its influence grows from 0 and falls to 0 (smoothly).
        time_warp: scalar curve from seconds since ``start_s`` to seconds into the part; takes the place of ``speed`` and
            ``cycles``, and lasts from ``start_s`` to its last key.
        weight: scalar curve of the influence by seconds since ``start_s``, or None for 1.
        hold: whether the last pose stays after its end (and the first before its start), else it has no influence there.
            Where the animation's own end is not cut off (``out_s`` None, one cycle) it goes on as its curves extrapolate.

    Raises:
        ShapeError: where a number is not finite, a duration negative, a speed 0 or a curve not scalar.
    """

    animation: str
    start_s: float = 0.0
    in_s: float | None = None
    out_s: float | None = None
    speed: float = 1.0
    cycles: float = 1.0
    fade_in_s: float = 0.0
    fade_out_s: float = 0.0
    time_warp: Curve | None = None
    weight: Curve | None = None
    hold: bool = True
    muted: bool = False

    def __post_init__(self) -> None:
        for name in ("start_s", "in_s", "out_s", "speed", "cycles", "fade_in_s", "fade_out_s"):
            number = getattr(self, name)
            if number is not None and not math.isfinite(number):
                raise ShapeError(f"{name}: expected a finite number, got {number}")
        for name in ("fade_in_s", "fade_out_s"):
            if getattr(self, name) < 0:
                raise ShapeError(f"{name}: expected 0 or more seconds, got {getattr(self, name)}")
        if self.speed == 0:
            raise ShapeError("speed: expected a number other than 0; a time_warp can stand still")
        if self.cycles <= 0:
            raise ShapeError(f"cycles: expected more than 0, got {self.cycles}")
        if self.in_s is not None and self.out_s is not None and self.out_s < self.in_s:
            raise ShapeError(f"out_s: expected {self.in_s} s or later, got {self.out_s} s")
        for name in ("time_warp", "weight"):
            curve = getattr(self, name)
            if curve is not None and curve.kind is not CurveKind.SCALAR:
                raise ShapeError(f"{name}: expected a SCALAR curve, got {curve.kind.name}")


def _everywhere() -> Mapping[str, float]:
    return {}


@dataclass(frozen=True, slots=True, eq=False)
class Layer:
    """Placements one after another or over each other, joined to the layers below as one.

    Units:
        influence: 0..1, a number or a scalar curve over the timeline's seconds.
        joints: share 0..1 by joint name that the layer may move; empty for all of every joint. Joints that are not named
            are left alone, where any is. Morphs and values are named alike.
        properties: what it may move, or None for everything.

    A layer that is ``solo`` silences all that are not; ``locked`` is for editors and changes nothing here.
    """

    name: str
    placements: tuple[Placement, ...] = ()
    mode: LayerMode = LayerMode.REPLACE
    influence: float | Curve = 1.0
    joints: Mapping[str, float] = field(default_factory=_everywhere)
    properties: frozenset[Property] | None = None
    muted: bool = False
    solo: bool = False
    locked: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "placements", tuple(self.placements))
        object.__setattr__(self, "joints", MappingProxyType(dict(self.joints)))
        if self.properties is not None:
            object.__setattr__(self, "properties", frozenset(self.properties))
        for name, share in self.joints.items():
            if not 0 <= share <= 1:
                raise ShapeError(f"joints: expected a share of 0..1 for '{name}', got {share}")
        if isinstance(self.influence, Curve):
            if self.influence.kind is not CurveKind.SCALAR:
                raise ShapeError(f"influence: expected a SCALAR curve, got {self.influence.kind.name}")
        elif not 0 <= self.influence <= 1:
            raise ShapeError(f"influence: expected 0..1, got {self.influence}")


@dataclass(frozen=True, slots=True)
class Marker:
    """A named moment on the timeline."""

    time_s: float
    name: str


@dataclass(frozen=True, slots=True, eq=False)
class Timeline:
    """Layers, lowest first, between two times.

    Units:
        rate_hz: frames per second of its grid; 25 is film's (lecture notes).
        hold_frames: exposure: every pose is held for so many frames (1 on ones, 2 on twos, 3 on threes), 0 for smooth time.
    """

    layers: tuple[Layer, ...] = ()
    name: str = ""
    rate_hz: float = 25.0
    start_s: float = 0.0
    end_s: float = 4.0
    hold_frames: int = 0
    markers: tuple[Marker, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "layers", tuple(self.layers))
        object.__setattr__(self, "markers", tuple(self.markers))
        if not (math.isfinite(self.rate_hz) and self.rate_hz > 0):
            raise ShapeError(f"rate_hz: expected more than 0, got {self.rate_hz}")
        if not (math.isfinite(self.start_s) and math.isfinite(self.end_s) and self.start_s <= self.end_s):
            raise ShapeError(f"end_s: expected a time at or after {self.start_s} s, got {self.end_s}")
        if self.hold_frames < 0:
            raise ShapeError(f"hold_frames: expected 0 or more, got {self.hold_frames}")
        names = [layer.name for layer in self.layers]
        double = next((n for n in names if names.count(n) > 1), None)
        if double is not None:
            raise ShapeError(f"layers: two are named '{double}'")

    def layer(self, name: str) -> Layer:
        """One layer; raises `UnknownName` with the nearest."""
        for layer in self.layers:
            if layer.name == name:
                return layer
        raise UnknownName("layer", name, [layer.name for layer in self.layers])
