"""Json: a JSON value that knows its place in the file, so that every wrong field is refused by name."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, NoReturn, cast

from keypose.errors import FormatError

LARGEST = 2**53  # of integers that every JSON reader keeps exactly


def parse_json(data: bytes) -> Json:
    """The root of a JSON text; raises `FormatError` naming line and column."""

    def refuse(constant: str) -> NoReturn:
        raise FormatError(f"{constant} is no JSON number", where="JSON")

    try:
        return Json(json.loads(data.decode("utf-8-sig"), parse_constant=refuse), "")
    except FormatError:
        raise
    except UnicodeDecodeError as error:
        raise FormatError("expected UTF-8 text", where=f"JSON byte {error.start}") from None
    except json.JSONDecodeError as error:
        raise FormatError(error.msg, where=f"JSON line {error.lineno} column {error.colno}") from None
    except RecursionError:
        raise FormatError("brackets are nested too deeply", where="JSON") from None
    except ValueError as error:  # a number of thousands of digits
        raise FormatError(str(error), where="JSON") from None


def _kind(value: Any) -> str:
    names = {dict: "an object", list: "an array", str: "a text", bool: "true or false", type(None): "null"}
    return names.get(type(value), "a number")


@dataclass(frozen=True, slots=True)
class Json:
    """One JSON value and its place, such as ``meshes[0].primitives[1]``."""

    value: Any
    where: str

    def fail(self, what: str) -> NoReturn:
        """Refuse the file at this place."""
        raise FormatError(what, where=self.where or "root")

    def _typed(self, kind: type, expected: str) -> Any:
        if not isinstance(self.value, kind):
            self.fail(f"expected {expected}, got {_kind(self.value)}")
        return self.value

    def object(self) -> dict[str, Any]:
        """The value itself, which has to be an object."""
        return cast("dict[str, Any]", self._typed(dict, "an object"))

    def get(self, key: str) -> Json | None:
        """A member, or None where it is missing."""
        members = self.object()
        if key not in members:
            return None
        return Json(members[key], f"{self.where}.{key}" if self.where else key)

    def need(self, key: str) -> Json:
        """A member that has to be there."""
        member = self.get(key)
        if member is None:
            self.fail(f"'{key}' is missing")
        return member

    def items(self, key: str) -> list[Json]:
        """The elements of an array member; empty where it is missing."""
        member = self.get(key)
        if member is None:
            return []
        values = cast("list[Any]", member._typed(list, "an array"))
        return [Json(v, f"{member.where}[{i}]") for i, v in enumerate(values)]

    def members(self, key: str) -> Iterator[tuple[str, Json]]:
        """Names and values of an object member; empty where it is missing."""
        member = self.get(key)
        if member is not None:
            for name in member.object():
                yield name, member.need(name)

    def text(self, key: str, default: str | None = None) -> str:
        """A text member; it has to be there where no default is given."""
        value = self.object().get(key)
        if isinstance(value, str):  # the common case, without building the place of an error
            return value
        if default is not None and key not in self.object():
            return default
        return cast("str", self.need(key)._typed(str, "a text"))

    def texts(self, key: str) -> tuple[str, ...]:
        """An array of texts; empty where it is missing."""
        return tuple(cast("str", each._typed(str, "a text")) for each in self.items(key))

    def flag(self, key: str) -> bool:
        """A true-or-false member, false where it is missing."""
        if key not in self.object():
            return False
        return cast("bool", self.need(key)._typed(bool, "true or false"))

    def as_integer(self, least: int = 0, limit: int | None = None, what: str = "") -> int:
        """This value as an integer in ``least <= value < limit``."""
        value = self.value
        if isinstance(value, float) and value.is_integer() and abs(value) < 2**53:
            value = int(value)  # "3.0" is an integer to JSON
        if not isinstance(value, int) or isinstance(value, bool):
            self.fail(f"expected an integer, got {_kind(value) if not isinstance(value, float) else value}")
        if limit is not None and not least <= value < limit:
            if what:
                self.fail(f"{what} {_short(value)} does not exist; the file has {limit}")
            self.fail(f"expected {least} to {limit - 1}, got {_short(value)}")
        if value < least:
            self.fail(f"expected {least} or more, got {_short(value)}")
        if value >= LARGEST:
            self.fail(f"{_short(value)} is too large")
        return value

    def integer(self, key: str, default: int | None = None, least: int = 0, limit: int | None = None) -> int:
        """An integer member; it has to be there where no default is given."""
        value = self.object().get(key)
        if type(value) is int and least <= value < (LARGEST if limit is None else limit):
            return value  # the common case, without building the place of an error
        if default is not None and key not in self.object():
            return default
        return self.need(key).as_integer(least, limit)

    def index(self, key: str, limit: int, what: str) -> int | None:
        """An index member into the file's list of ``what``; None where it is missing."""
        value = self.object().get(key)
        if type(value) is int and 0 <= value < limit:
            return value
        member = self.get(key)
        return None if member is None else member.as_integer(0, limit, what)

    def to(self, key: str, limit: int, what: str) -> int:
        """An index member that has to be there."""
        index = self.index(key, limit, what)
        if index is None:
            self.fail(f"'{key}' is missing")
        return index

    def as_number(self) -> float:
        """This value as a finite number."""
        value = self.value
        if not isinstance(value, (int, float)) or isinstance(value, bool):
            self.fail(f"expected a number, got {_kind(value)}")
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        if not math.isfinite(number):
            self.fail("the number is too large")
        return number

    def number(self, key: str, default: float) -> float:
        """A number member."""
        member = self.get(key)
        return default if member is None else member.as_number()

    def numbers(self, key: str, count: int | None) -> tuple[float, ...] | None:
        """An array member of ``count`` numbers (any count for None); None where it is missing."""
        if key not in self.object():
            return None
        elements = self.items(key)
        if count is not None and len(elements) != count:
            self.need(key).fail(f"expected {count} numbers, got {len(elements)}")
        return tuple(e.as_number() for e in elements)

    def indices(self, key: str, limit: int, what: str) -> tuple[int, ...]:
        """An array member of indices into the file's list of ``what``."""
        return tuple(e.as_integer(0, limit, what) for e in self.items(key))

    def extras(self) -> Mapping[str, Any]:
        """The ``extras`` member; one that is no object is kept under the key ``value``."""
        extras = self.object().get("extras")
        if extras is None:
            return {}
        return cast("dict[str, Any]", extras) if isinstance(extras, dict) else {"value": extras}


def _short(value: int) -> str:
    if abs(value) >= 10**18:
        return f"a number of {math.floor(abs(value).bit_length() * 0.30103) + 1} digits"
    return str(value)
