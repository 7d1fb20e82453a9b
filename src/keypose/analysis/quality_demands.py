"""Demands on the quality of a motion, for checks that run by themselves: ``skate>2,sink>1`` fails what slides or sinks more."""

from __future__ import annotations

import json
import math
import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from keypose.errors import FormatError, ShapeError, UnknownName

FIGURES: Mapping[str, tuple[str, str]] = {
    "skate": ("skate_cm_s", "cm/s"),
    "worst_skate": ("worst_skate_cm_s", "cm/s"),
    "contact": ("contact_share", ""),
    "sink": ("sink_cm", "cm"),
    "sink_share": ("sink_share", ""),
    "float": ("float_share", ""),
    "jerk": ("jerk_m_s3", "m/s3"),
    "pops": ("pops", ""),
    "limit": ("limit_deg", "degrees"),
    "overlap": ("overlap_cm", "cm"),
    "loop": ("loop_cm", "cm"),
    "loop_turn": ("loop_deg", "degrees"),
    "difference": ("difference.mean_cm", "cm"),
    "worst_difference": ("difference.worst_cm", "cm"),
    "difference_turn": ("difference.mean_deg", "degrees"),
    "direction": ("direction.mean_direction_deg", "degrees"),
}
"""The figures that can be demanded: a short name -> where it is in the JSON of `keypose check --quality`, and its unit."""

_DEMAND = re.compile(r"^\s*([a-z_]+)\s*([<>])\s*([-+0-9.eE]+)\s*$")


@dataclass(frozen=True, slots=True)
class Demand:
    """What fails: a figure that is more (``>``) or less (``<``) than a bound."""

    name: str
    sign: str
    bound: float

    def __post_init__(self) -> None:
        if self.name not in FIGURES:
            raise UnknownName("figure", self.name, FIGURES)
        if self.sign not in ("<", ">") or not math.isfinite(self.bound):
            raise ShapeError(f"{self.name}: expected > or < and a number, got {self.sign!r} and {self.bound}")


def read_demands(text: str) -> tuple[Demand, ...]:
    """Demands from text such as ``skate>2,sink>1,contact<0.2``, or from the .toml or .json file that it names.

    A file holds a table of names: ``skate = 2.0`` is the most that is allowed, ``contact = {least = 0.2}`` the least; they may lie
    in a table ``quality``.

    Raises:
        FormatError: for a file that cannot be read. UnknownName, ShapeError: for what is no demand.
    """
    path = Path(text)
    if path.suffix.lower() in (".toml", ".json"):
        try:
            read = path.read_text(encoding="utf-8")
            table: Any = tomllib.loads(read) if path.suffix.lower() == ".toml" else json.loads(read)
        except OSError as error:
            raise FormatError(error.strerror or str(error), path=path) from None
        except ValueError as error:
            raise FormatError(str(error), path=path) from None
        if isinstance(table, dict) and isinstance(table.get("quality"), dict):  # pyright: ignore[reportUnknownMemberType]
            table = table["quality"]
        if not isinstance(table, dict):
            raise FormatError("expected a table of figures", path=path)
        return tuple(d for name, value in table.items() for d in _from_table(str(name), value))  # pyright: ignore[reportUnknownVariableType, reportUnknownArgumentType]
    found: list[Demand] = []
    for part in text.split(","):
        match = _DEMAND.match(part)
        try:
            if match is None:
                raise ValueError
            found.append(Demand(match[1], match[2], float(match[3])))
        except ValueError as error:
            if isinstance(error, (UnknownName, ShapeError)):
                raise
            raise ShapeError(f"demand '{part.strip()}': expected NAME>NUMBER or NAME<NUMBER, such as skate>2") from None
    return tuple(found)


def _from_table(name: str, value: Any) -> list[Demand]:
    bounds: dict[str, Any] = value if isinstance(value, dict) else {"most": value}
    found: list[Demand] = []
    for word, bound in bounds.items():
        if word not in ("most", "least"):
            raise UnknownName(f"bound of {name}", word, ("most", "least"))
        if isinstance(bound, bool) or not isinstance(bound, (int, float)):
            raise ShapeError(f"{name}: expected a number, got {bound!r}")
        found.append(Demand(name, ">" if word == "most" else "<", float(bound)))
    return found


def unmet(figures: Mapping[str, Any], demands: Sequence[Demand]) -> tuple[str, ...]:
    """The demands that figures (a motion's JSON) do not meet, in words; a figure that could not be measured meets none."""
    found: list[str] = []
    for demand in demands:
        field, unit = FIGURES[demand.name]
        value: Any = figures
        for key in field.split("."):
            value = value.get(key) if isinstance(value, Mapping) else None  # pyright: ignore[reportUnknownMemberType, reportUnknownVariableType]
        number = float(len(value)) if isinstance(value, (list, tuple)) else value  # pyright: ignore[reportUnknownArgumentType, reportUnknownVariableType]
        unit = f" {unit}" if unit else ""
        if not isinstance(number, (int, float)):
            found.append(f"{demand.name} is not measured here, {demand.bound:g}{unit} was the bound")
        elif number > demand.bound if demand.sign == ">" else number < demand.bound:
            what = "more" if demand.sign == ">" else "less"
            found.append(f"{demand.name} is {number:.3g}{unit}, {what} than {demand.bound:g}")
    return tuple(found)
