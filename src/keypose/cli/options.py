"""Options of readers and writers on the command line: ``--option NAME=VALUE``, checked against what the formats take."""

from __future__ import annotations

import inspect
import types
import typing
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from keypose.errors import FormatError, ShapeError, UnknownName

_TRUE, _FALSE = ("true", "yes", "on", "1"), ("false", "no", "off", "0")


@dataclass(frozen=True, slots=True)
class Chosen:
    """Options by input, in their order, and of the output."""

    reading: tuple[dict[str, Any], ...]
    writing: dict[str, Any] = field(default_factory=dict[str, Any])


def choose(texts: Sequence[str], inputs: Sequence[str], output: Path | None = None) -> Chosen:
    """Sort ``NAME=VALUE`` texts to the readers of the inputs and the writer of the output, with values of the right type.

    ``in.NAME`` and ``out.NAME`` say which is meant where both have an option of that name.

    Raises:
        ShapeError: for a text without ``=``, a value of the wrong type, or a name that both sides have.
        UnknownName: for a name that neither side has.
    """
    readers = [parameters(reader_of(reference)) for reference in inputs]
    writer = parameters(writer_of(output))
    reading: tuple[dict[str, Any], ...] = tuple({} for _ in inputs)
    writing: dict[str, Any] = {}
    for text in texts:
        name, sign, value = text.partition("=")
        if not sign or not name:
            raise ShapeError(f"--option {text}: expected NAME=VALUE")
        side, _, rest = name.partition(".")
        side, name = (side, rest) if side in ("in", "out") and rest else ("", name)
        name = name.replace("-", "_")
        taking = [k for k, known in enumerate(readers) if name in known and side != "out"]
        writes = name in writer and side != "in"
        if taking and writes:
            raise ShapeError(f"--option {text}: both reading and writing have it; say in.{name} or out.{name}")
        if not taking and not writes:
            known = [n for names in readers for n in names] if side != "out" else []
            known += list(writer) if side != "in" else []
            raise UnknownName("option", name, dict.fromkeys(known))
        for k in taking:
            reading[k][name] = parsed(name, value, readers[k][name].annotation)
        if writes:
            writing[name] = parsed(name, value, writer[name].annotation)
    return Chosen(reading, writing)


def with_option(chosen: Chosen, inputs: Sequence[str], name: str, value: Any) -> Chosen:
    """The options with one more for every input whose reader takes it.

    Raises:
        ShapeError: where none does.
    """
    takes = [name in parameters(reader_of(reference)) for reference in inputs]
    if not any(takes):
        raise ShapeError(f"--{name}: no reader of these files takes it")
    reading = tuple({**own, name: value} if taking else own for own, taking in zip(chosen.reading, takes, strict=True))
    return Chosen(reading, chosen.writing)


def parameters(function: Callable[..., Any] | None) -> dict[str, inspect.Parameter]:
    """The keyword options of a reader or writer, with types for annotations where these can be found."""
    if function is None:
        return {}
    try:
        hints = typing.get_type_hints(function)
    except NameError:  # of what is imported for type checkers only
        hints = {}
    found = inspect.signature(function).parameters.values()
    return {
        p.name: p.replace(annotation=hints.get(p.name, str)) for p in found if p.kind is inspect.Parameter.KEYWORD_ONLY
    }


def parsed(name: str, text: str, annotation: Any) -> Any:
    """A value of the type that an option has.

    Raises:
        ShapeError, UnknownName: where the text is no such value.
    """
    kinds = _members(annotation)
    choices = [str(c) for kind in kinds if typing.get_origin(kind) is Literal for c in typing.get_args(kind)]
    folded = text.strip().lower()
    if type(None) in kinds and folded == "none":
        return None
    if choices:
        if folded not in choices:
            raise UnknownName(f"value of {name}", text, choices)
        return folded
    if bool in kinds:
        if folded not in (*_TRUE, *_FALSE):
            raise ShapeError(f"{name}: expected true or false, got '{text}'")
        return folded in _TRUE
    for kind in (int, float):
        if kind in kinds:
            try:
                return kind(text)
            except ValueError:
                if str not in kinds:
                    what = "a whole number" if kind is int else "a number"
                    raise ShapeError(f"{name}: expected {what}, got '{text}'") from None
    several = any(typing.get_origin(kind) in (list, tuple, Sequence) for kind in kinds)
    if several and ("," in text or str not in kinds):
        return [word.strip() for word in text.split(",") if word.strip()]
    return text


def format_lines() -> list[tuple[str, str, str, str]]:
    """Of every format: name, suffixes, options of its reader and of its writer, each with its default."""
    from keypose.io import formats

    lines: list[tuple[str, str, str, str]] = []
    for entry in formats():
        writing = _shown(parameters(entry.writer()).values()) if entry.write else "(read only)"
        lines.append((entry.name, " ".join(entry.suffixes), _shown(parameters(entry.reader()).values()), writing))
    return lines


def print_formats() -> None:
    """All formats and their options, for people."""
    from rich.markup import escape
    from rich.table import Table

    from keypose.cli.console import console

    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="bold")
    for title in ("format", "suffixes", "options of reading", "options of writing"):
        table.add_column(title, overflow="fold")
    for line in format_lines():
        table.add_row(*(escape(cell) for cell in line))
    out = console()
    out.print(table)
    out.print("[dim]--option NAME=VALUE; in.NAME and out.NAME where both sides have it; lists with commas[/dim]")


def _shown(options: Iterable[inspect.Parameter]) -> str:
    texts: list[str] = []
    for option in options:
        choices = [
            str(c) for k in _members(option.annotation) if typing.get_origin(k) is Literal for c in typing.get_args(k)
        ]
        default = option.default
        if isinstance(default, tuple):
            default = ",".join(map(str, typing.cast("tuple[Any, ...]", default)))
        elif default is None or isinstance(default, bool):
            default = str(default).lower()
        texts.append(
            f"{option.name}={default}" + (f" ({'|'.join(c for c in choices if c != default)})" if choices else "")
        )
    return ", ".join(texts)


def _members(annotation: Any) -> list[Any]:
    """The types of a union, those of its members too."""
    if typing.get_origin(annotation) in (typing.Union, types.UnionType):
        return [kind for member in typing.get_args(annotation) for kind in _members(member)]
    return [annotation]


def reader_of(reference: str) -> Callable[..., Any] | None:
    """The function that will read an input; none of samples and of what no format knows."""
    if reference.startswith("sample:"):
        return None
    from keypose.io.registry import HEAD_BYTES, format_of_content, format_of_suffix

    path = Path(reference)
    try:
        with path.open("rb") as file:
            found = format_of_content(file.read(HEAD_BYTES))
    except (OSError, ValueError):  # told when it is read
        found = None
    found = found or format_of_suffix(path)
    return None if found is None else found.reader()


def writer_of(output: Path | None) -> Callable[..., Any] | None:
    """The function that will write an output; none where no format has its suffix or can be written."""
    if output is None:
        return None
    from keypose.io.registry import format_of_suffix

    found = format_of_suffix(output)
    try:
        return None if found is None else found.writer()
    except FormatError:
        return None
