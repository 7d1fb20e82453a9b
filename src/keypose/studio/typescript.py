"""TypeScript types from the message dataclasses.

``python -m keypose.studio.typescript`` rewrites ``client/src/generated/messages.ts``.
"""

from __future__ import annotations

import dataclasses
import types
import typing
from pathlib import Path
from typing import Any

from keypose.studio import edit_messages, messages, retarget_messages, rig_messages, scene_messages

_PLAIN = {str: "string", int: "number", float: "number", bool: "boolean", type(None): "null"}

_UNIONS = (
    "ServerMessage",
    "ClientMessage",
    "CrowdMessage",
    "CrowdRequest",
    "ProjectMessage",
    "ProjectRequest",
    "EditCommand",
    "RetargetAsked",
    "RigAsked",
)


def typescript_type(annotation: Any) -> str:
    """The TypeScript spelling of a Python annotation."""
    if annotation in _PLAIN:
        return _PLAIN[annotation]
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    if origin is typing.Literal:
        return " | ".join(f'"{a}"' for a in arguments)
    if origin in (types.UnionType, typing.Union):
        return " | ".join(typescript_type(a) for a in arguments)
    if origin is list:
        item = typescript_type(arguments[0])
        return f"({item})[]" if " " in item else f"{item}[]"
    if origin is dict:
        return f"Record<string, {typescript_type(arguments[1])}>"
    if dataclasses.is_dataclass(annotation) and isinstance(annotation, type):
        return annotation.__name__
    raise TypeError(f"no TypeScript type for {annotation!r}")


def generate() -> str:
    """The whole of ``messages.ts``."""
    lines = [
        "// Generated from src/keypose/studio/messages.py by `python -m keypose.studio.typescript`. Do not edit.",
        "",
        f"export const PROTOCOL = {messages.PROTOCOL};",
    ]
    modules = scene_messages, rig_messages, edit_messages, messages, retarget_messages
    for name, value in {name: value for module in modules for name, value in vars(module).items()}.items():
        if dataclasses.is_dataclass(value) and isinstance(value, type):
            hints = typing.get_type_hints(value)
            lines += ["", f"/** {(value.__doc__ or '').strip().splitlines()[0]} */", f"export interface {name} {{"]
            lines += [f"  {field}: {typescript_type(hint)};" for field, hint in hints.items()]
            lines += ["}"]
        elif name in _UNIONS:
            lines += ["", f"export type {name} = {typescript_type(value)};"]
    return "\n".join(lines) + "\n"


def target() -> Path:
    """Where the generated file lies in a checkout."""
    return Path(__file__).resolve().parents[3] / "client" / "src" / "generated" / "messages.ts"


if __name__ == "__main__":
    target().parent.mkdir(parents=True, exist_ok=True)
    target().write_text(generate(), encoding="utf-8")
