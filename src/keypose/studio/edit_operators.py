"""The operators of `keypose.editing` as pages know them, and running one on a clip of the project."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from keypose.errors import UnknownName
from keypose.model import Character, Clip
from keypose.studio.edit_messages import OperatorSpec
from keypose.studio.edit_wire import Operation


@dataclass(frozen=True, slots=True, eq=False)
class Operated:
    """What an operator made: the clip, what the step is called, and what it says of its work."""

    clip: Clip
    label: str
    report: str


def operator_specs() -> list[OperatorSpec]:
    """All operators, as their forms are drawn from."""
    if importlib.util.find_spec("keypose.editing.operators") is None:
        return []
    operators: Any = importlib.import_module("keypose.editing.operators")
    return [OperatorSpec(**spec) for spec in operators.describe()]


def operated(asked: Operation, clip: Clip, character: Character | None, report: Callable[[float], None]) -> Operated:
    """A clip changed by an operator.

    Raises:
        KeyposeError: where there is no such operator, or it cannot be done.
    """
    raise UnknownName("operator", asked.operator, [spec.name for spec in operator_specs()])
