"""Selection: which channels, keys and times of a clip an operation works on."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from keypose.errors import ShapeError, UnknownName
from keypose.model import Channel, Clip, Curve, Property

# Times that differ by less are one: a thousandth of a frame at 25 per second.
SAME_TIME_S = 4e-5


@dataclass(frozen=True, slots=True)
class Selection:
    """What of a clip is worked on; everything where nothing is said.

    Units:
        channels: those worked on, or None for all of the clip.
        keys: indices of selected keys by channel, rising; a channel that is not named has all. None for all keys of all.
        start_s, end_s: bounds in the clip's time, both counted in; None for its ends.
    """

    channels: tuple[Channel, ...] | None = None
    keys: Mapping[Channel, Sequence[int]] | None = None
    start_s: float | None = None
    end_s: float | None = None

    def __post_init__(self) -> None:
        if self.start_s is not None and self.end_s is not None and self.end_s < self.start_s:
            raise ShapeError(f"end_s: expected {self.start_s} s or later, got {self.end_s} s")


EVERYTHING = Selection()


def chosen_channels(clip: Clip, selection: Selection) -> tuple[Channel, ...]:
    """The channels of a clip that a selection names; raises UnknownName where the clip lacks one."""
    if selection.channels is None:
        return tuple(clip.curves)
    for channel in selection.channels:
        if channel not in clip.curves:
            raise UnknownName("channel", str(channel), [str(c) for c in clip.curves])
    return selection.channels


def chosen_joints(clip: Clip, selection: Selection, names: Sequence[str]) -> tuple[str, ...]:
    """The joints, of those that have a name here, which the chosen channels drive, in the order of the skeleton."""
    targets = {c.target for c in chosen_channels(clip, selection)}
    return tuple(name for name in names if name in targets)


def chosen_keys(channel: Channel, curve: Curve, selection: Selection) -> np.ndarray[Any, np.dtype[np.intp]]:
    """Indices of the keys of one channel that are selected and lie between the bounds, rising.

    Raises: ShapeError where an index is none of the curve's.
    """
    indices = np.arange(curve.key_count)
    if selection.keys is not None and channel in selection.keys:
        indices = np.unique(np.asarray(selection.keys[channel], np.intp))
        if len(indices) and (indices[0] < 0 or indices[-1] >= curve.key_count):
            raise ShapeError(f"keys of {channel}: expected indices below {curve.key_count}, got {int(indices[-1])}")
    low, high = bounds(selection)
    times = curve.times_s[indices]
    return indices[(times >= low) & (times <= high)]


def chosen_spans(channel: Channel, curve: Curve, selection: Selection) -> np.ndarray[Any, np.dtype[np.intp]]:
    """Indices of the keys that start the selected spans: both ends are selected, or, of single keys, the span that follows."""
    keys = chosen_keys(channel, curve, selection)
    spans = keys[np.isin(keys + 1, keys)]
    if len(spans) == 0 and selection.keys is not None and channel in selection.keys:
        spans = keys
    return spans[spans < curve.key_count - 1]


def bounds(selection: Selection) -> tuple[float, float]:
    """Start and end in seconds, widened by less than a frame's thousandth; infinite where there is none."""
    low = -np.inf if selection.start_s is None else selection.start_s - SAME_TIME_S
    high = np.inf if selection.end_s is None else selection.end_s + SAME_TIME_S
    return low, high


def with_curves(clip: Clip, curves: Mapping[Channel, Curve]) -> Clip:
    """The clip with some curves replaced or added; a joint that gets a rotation curve loses its Euler angles."""
    turned = {c.target for c in curves if c.property is Property.ROTATION}
    kept = {c: v for c, v in clip.curves.items() if not (c.property is Property.EULER and c.target in turned)}
    return replace(clip, curves={**kept, **curves})


def edited(clip: Clip, selection: Selection, change: Callable[[Channel, Curve], Curve]) -> Clip:
    """The clip with ``change`` done to each chosen channel."""
    return with_curves(clip, {c: change(c, clip.curves[c]) for c in chosen_channels(clip, selection)})
