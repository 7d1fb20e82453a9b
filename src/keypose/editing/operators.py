"""The table of operators: what the studio offers and the command line runs, each with its parameters and their defaults."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from keypose.editing.constraint_operators import CONSTRAINT_OPERATORS
from keypose.editing.key_operators import KEY_OPERATORS
from keypose.editing.motion_operators import MOTION_OPERATORS
from keypose.editing.operator_types import Operated, Operator, Parameter
from keypose.editing.selection import EVERYTHING, Selection
from keypose.errors import ShapeError, UnknownName
from keypose.model import Clip, Skeleton

__all__ = ["OPERATORS", "Operated", "Operator", "Parameter", "checked_parameters", "run_operator"]

OPERATORS: Mapping[str, Operator] = {
    operator.name: operator for operator in (*KEY_OPERATORS, *MOTION_OPERATORS, *CONSTRAINT_OPERATORS)
}
"""All operators by name, in the order in which they are offered."""


def run_operator(
    name: str,
    clip: Clip,
    skeleton: Skeleton,
    selection: Selection = EVERYTHING,
    parameters: Mapping[str, Any] | None = None,
) -> Operated:
    """The clip after an operator, by its name, with parameters; those that are not given have their defaults.

    Raises: UnknownName for an operator, a parameter or a choice that does not exist; ShapeError for a value that is none or out of
    its range.
    """
    if name not in OPERATORS:
        raise UnknownName("operator", name, OPERATORS)
    operator = OPERATORS[name]
    return operator.run(clip, skeleton, selection, checked_parameters(operator, parameters or {}))


def checked_parameters(operator: Operator, given: Mapping[str, Any]) -> dict[str, Any]:
    """All parameters of an operator: those given, checked, and the defaults of the rest; raises as `run_operator` does."""
    known = {p.name: p for p in operator.parameters}
    for name in given:
        if name not in known:
            raise UnknownName(f"parameter of {operator.name}", name, known)
    return {name: _checked(operator, p, given[name]) if name in given else p.default for name, p in known.items()}


def _checked(operator: Operator, parameter: Parameter, value: Any) -> Any:
    label = f"{operator.name}: {parameter.name}"
    if parameter.type == "boolean":
        if not isinstance(value, bool):
            raise ShapeError(f"{label}: expected true or false, got {value!r}")
        return value
    if parameter.type in ("number", "integer"):
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
            raise ShapeError(f"{label}: expected a number, got {value!r}")
        if parameter.type == "integer" and value != round(value):
            raise ShapeError(f"{label}: expected a whole number, got {value!r}")
        low, high = parameter.minimum, parameter.maximum
        if (low is not None and value < low) or (high is not None and value > high):
            between = f"{'any' if low is None else f'{low:g}'} to {'any' if high is None else f'{high:g}'}"
            raise ShapeError(f"{label}: expected {between}, got {value:g}")
        return int(value) if parameter.type == "integer" else float(value)
    if not isinstance(value, str):
        raise ShapeError(f"{label}: expected text, got {value!r}")
    if parameter.type == "choice" and value not in parameter.choices:
        raise UnknownName(label, value, parameter.choices)
    return value
