"""What a browser sent, checked against the message dataclasses: nothing else gets past this."""

from __future__ import annotations

import json
import math
import typing
from functools import cache
from typing import Any, Literal, get_args, get_origin

from keypose.studio.messages import ClientMessage, CrowdRequest
from keypose.studio.retarget_messages import RetargetAsked
from keypose.studio.rig_messages import RigAsked


def parse_request(text: str) -> ClientMessage | None:
    """The message of a text; None where it is no JSON, no known message, or has other fields or types than that."""
    return _parsed(text, ClientMessage)


def parse_crowd_request(text: str) -> CrowdRequest | None:
    """The same for the crowd's socket."""
    return _parsed(text, CrowdRequest)


def parse_retarget_request(text: str) -> RetargetAsked | None:
    """The same for what the retarget page asks."""
    return _parsed(text, RetargetAsked)


def parse_rig_request(text: str) -> RigAsked | None:
    """The same for what the edit page asks to change of rigs."""
    return _parsed(text, RigAsked)


def _parsed(text: str, kinds: Any) -> Any:
    try:
        data = json.loads(text)
    except (ValueError, RecursionError):
        return None
    if not isinstance(data, dict) or not isinstance(data.get("type"), str):
        return None
    known = _known(kinds)
    if data["type"] not in known:
        return None
    kind, hints = known[data["type"]]
    if data.keys() != hints.keys() or not all(_fits(data[name], hint) for name, hint in hints.items()):
        return None
    return kind(**data)


@cache
def _known(kinds: Any) -> dict[str, tuple[type[Any], dict[str, Any]]]:
    """``type`` of the message -> its dataclass, and the types of its fields."""
    found: dict[str, tuple[type[Any], dict[str, Any]]] = {}
    for kind in get_args(kinds):
        hints = typing.get_type_hints(kind)
        found |= dict.fromkeys(get_args(hints["type"]), (kind, hints))
    return found


def _fits(value: Any, hint: Any) -> bool:
    origin, arguments = get_origin(hint), get_args(hint)
    if origin is Literal:
        return isinstance(value, str) and value in arguments
    if origin is list:
        return isinstance(value, list) and all(_fits(item, arguments[0]) for item in value)
    if origin is dict:
        return isinstance(value, dict) and all(_fits(item, arguments[1]) for item in value.values())
    if origin is not None:
        return any(_fits(value, argument) for argument in arguments)
    if hint is bool or isinstance(value, bool):
        return hint is bool and isinstance(value, bool)
    if hint is float:
        return isinstance(value, (int, float)) and abs(value) < 1e300 and math.isfinite(value)
    if hint is int:
        return isinstance(value, int) and abs(value) < 1 << 53
    return isinstance(value, hint)
