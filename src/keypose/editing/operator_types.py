"""What an operator of the table is: its parameters, what it needs, and what it returns."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from keypose.editing.selection import Selection
from keypose.model import Clip, Skeleton

ParameterType = Literal["number", "integer", "boolean", "choice", "joint", "text"]
Needs = Literal["keys", "spans", "joints", "channels", "time"]


@dataclass(frozen=True, slots=True)
class Parameter:
    """One setting of an operator.

    ``choices`` are the values of a ``choice``; ``minimum`` and ``maximum`` bound a ``number`` or an ``integer``; a ``joint`` is
    the name of one, empty for the operator's own choice. ``unit`` is for people: ``s``, ``frames``, ``Hz``, ``degrees``, ``m``.
    """

    name: str
    type: ParameterType
    default: float | int | bool | str
    description: str
    label: str = ""
    minimum: float | None = None
    maximum: float | None = None
    unit: str = ""
    choices: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Operated:
    """What an operator made of a clip, and what it has to say of it (empty where that is nothing)."""

    clip: Clip
    report: str = ""


Run = Callable[[Clip, Skeleton, Selection, Mapping[str, Any]], Operated]


@dataclass(frozen=True, slots=True)
class Operator:
    """An operation on the selection of a clip.

    ``needs`` is what a person selects for it: ``keys``, ``spans`` (two keys or the ones after single keys), ``joints``,
    ``channels``, or nothing but a ``time`` range.
    """

    name: str
    label: str
    description: str
    parameters: tuple[Parameter, ...]
    needs: Needs
    run: Run


def number(
    name: str, default: float, low: float | None, high: float | None, description: str, unit: str = ""
) -> Parameter:
    """A parameter that is a number between two bounds."""
    return Parameter(name, "number", default, description, name_label(name), low, high, unit)


def name_label(name: str) -> str:
    """A parameter's name for people: without the unit at its end."""
    stem, _, end = name.rpartition("_")
    return (stem if stem and end in ("s", "m", "mm", "hz", "deg") else name).replace("_", " ").capitalize()


def count_keys(before: Clip, after: Clip) -> str:
    """How many keys there were and are."""
    counts = [sum(curve.key_count for curve in clip.curves.values()) for clip in (before, after)]
    return f"{counts[0]} keys before, {counts[1]} after"


def state_error(error: float) -> str:
    """An error in words."""
    return "exact" if error == 0 else f"largest error {error:.2g}"
