"""COLLADA as XML: a safe parser, references by id, and sources of numbers and names.

Document types and entities are refused: they are what XML bombs are made of, and COLLADA needs neither. Depth, number of
elements and length of attributes are limited; counts in the file are checked against what is there.

Source: COLLADA 1.4.1 and 1.5.0 specifications (Khronos), chapters 3 and 5.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar
from xml.parsers import expat

import numpy as np

from keypose.arrays import Floats, Ints
from keypose.errors import FormatError
from keypose.io.text import parse_block, shown

MOST_BYTES = 1 << 30
LARGEST = 1e15
_MOST_ELEMENTS = 4_000_000
_DEEPEST = 2000
_LONGEST_ATTRIBUTE = 1 << 16
_PIECE = 1 << 20

T = TypeVar("T")


@dataclass(slots=True, eq=False)
class Element:
    """An XML element: its tag without namespace, attributes, text and children."""

    tag: str
    attributes: dict[str, str]
    line: int
    children: list[Element] = field(default_factory=list["Element"])
    text: str = ""
    parent: Element | None = None

    def all(self, tag: str) -> Iterator[Element]:
        """Children of this tag."""
        return (child for child in self.children if child.tag == tag)

    def first(self, *path: str) -> Element | None:
        """The first descendant along a path of tags."""
        found: Element | None = self
        for tag in path:
            found = next(found.all(tag), None) if found else None
        return found

    def get(self, name: str, default: str = "") -> str:
        """An attribute."""
        return self.attributes.get(name, default)

    def named(self) -> str:
        """The name, else the id, else the sid."""
        return self.get("name").strip() or self.get("id").strip() or self.get("sid").strip()

    def walk(self) -> Iterator[Element]:
        """This element and all below, parents first."""
        stack: list[Element] = [self]
        while stack:
            element = stack.pop()
            yield element
            stack.extend(reversed(element.children))

    def error(self, what: str) -> FormatError:
        """An error at this element's line."""
        label = self.get("id") or self.get("sid")
        return FormatError(f"<{self.tag}{' ' + shown(label) if label else ''}>: {what}", where=f"line {self.line}")

    def number(self, default: float) -> float:
        """The text as one number; the default where it is none."""
        values, wrong = parse_block(self.text.encode(), 0, len(self.text.encode()), compiled=False)
        return float(values[0]) if wrong < 0 and len(values) and abs(values[0]) <= LARGEST else default

    def numbers(self, count: int | None = None) -> Floats:
        """The text as numbers, ``count`` of them if given."""
        data = self.text.encode()
        values, wrong = parse_block(data, 0, len(data))
        if wrong >= 0:
            word = data[wrong : wrong + 64].split(None, 1)[0]
            raise self.error(f"expected a number, found {shown(word)}")
        if values.size and np.abs(values).max() > LARGEST:
            raise self.error(f"a number of size {np.abs(values).max():.3g}; at most {LARGEST:g} is read")
        if count is not None and len(values) != count:
            raise self.error(f"expected {count} numbers, found {len(values)}")
        return values

    def integers(self) -> Ints:
        """The text as whole numbers."""
        values = self.numbers()
        whole = values.astype(np.int64)
        if not np.array_equal(whole, values):
            raise self.error("expected whole numbers")
        return whole


def parse_xml(path: Path) -> Element:
    """The root element of a COLLADA file.

    Raises:
        FormatError: where the file is no well-formed XML, has a document type, or passes a limit; with its line.
    """
    size = path.stat().st_size
    if size > MOST_BYTES:
        raise FormatError(f"{size >> 20} MiB; at most {MOST_BYTES >> 20} MiB are read")
    builder = _Builder()
    with path.open("rb") as file:
        while piece := file.read(_PIECE):
            builder.feed(piece)
    return builder.close()


class _Builder:
    def __init__(self) -> None:
        parser = expat.ParserCreate()
        parser.buffer_text = True
        parser.StartElementHandler = self.start
        parser.EndElementHandler = self.end
        parser.CharacterDataHandler = self.data
        parser.StartDoctypeDeclHandler = self.refuse
        parser.EntityDeclHandler = self.refuse
        parser.UnparsedEntityDeclHandler = self.refuse
        parser.ExternalEntityRefHandler = self.refuse
        self.parser = parser
        self.stack: list[Element] = []
        self.texts: list[list[str]] = []
        self.root: Element | None = None
        self.count = 0

    def feed(self, piece: bytes) -> None:
        try:
            self.parser.Parse(piece, False)
        except expat.ExpatError as error:
            raise self.wrong(error) from None
        except FormatError:
            raise
        except (ValueError, LookupError) as error:  # an encoding that does not exist
            raise FormatError(f"no XML that can be read: {str(error)[:200]}", where="line 1") from None

    def close(self) -> Element:
        try:
            self.parser.Parse(b"", True)
        except expat.ExpatError as error:
            raise self.wrong(error) from None
        if self.root is None:
            raise FormatError("the file holds no element", where="line 1")
        return self.root

    def wrong(self, error: expat.ExpatError) -> FormatError:
        return FormatError(f"no well-formed XML: {expat.ErrorString(error.code)}", where=f"line {error.lineno}")

    def start(self, name: str, attributes: dict[str, str]) -> None:
        line = self.parser.CurrentLineNumber
        self.count += 1
        if self.count > _MOST_ELEMENTS:
            raise FormatError(f"more than {_MOST_ELEMENTS} elements", where=f"line {line}")
        if len(self.stack) >= _DEEPEST:
            raise FormatError(f"elements nested more than {_DEEPEST} deep", where=f"line {line}")
        if any(len(value) > _LONGEST_ATTRIBUTE for value in attributes.values()):
            raise FormatError("an attribute of absurd length", where=f"line {line}")
        element = Element(name.rpartition(":")[2], attributes, line)
        if self.stack:
            element.parent = self.stack[-1]
            self.stack[-1].children.append(element)
        elif self.root is None:
            self.root = element
        self.stack.append(element)
        self.texts.append([])

    def end(self, name: str) -> None:
        self.stack.pop().text = "".join(self.texts.pop())

    def data(self, text: str) -> None:
        if self.texts:
            self.texts[-1].append(text)

    def refuse(self, *_: Any) -> int:
        raise FormatError(
            "a document type or entity declaration; COLLADA has none, and they are refused",
            where=f"line {self.parser.CurrentLineNumber}",
        )


# --- references and sources -------------------------------------------------------------------------------------------------


class Document:
    """A COLLADA file with its elements by id."""

    def __init__(self, root: Element) -> None:
        if root.tag != "COLLADA":
            raise root.error("the root is not <COLLADA>")
        self.root = root
        self.notes: dict[str, None] = {}
        self.by_id: dict[str, Element] = {}
        for element in root.walk():
            name = element.attributes.get("id")
            if name is not None:
                self.by_id.setdefault(name, element)
        self._sources: dict[int, Floats] = {}

    def note(self, text: str) -> None:
        """Keep a note, once; no more of them than a reader can take in."""
        if len(self.notes) < 200:
            self.notes[text] = None

    def library(self, name: str, tag: str) -> list[Element]:
        """All elements of a kind, of every library of that kind."""
        return [item for library in self.root.all(name) for item in library.all(tag)]

    def target(self, element: Element, attribute: str, *tags: str) -> Element:
        """The element that an attribute refers to; `FormatError` where there is none of these kinds."""
        reference = element.get(attribute)
        found = self.find(reference)
        if found is None or (tags and found.tag not in tags):
            what = " or ".join(f"<{tag}>" for tag in tags) or "element"
            raise element.error(f"{attribute}: there is no {what} {shown(reference)}")
        return found

    def find(self, reference: str) -> Element | None:
        """The element with an id that is written as ``#id``; some exporters leave the sign out."""
        _, sign, name = reference.partition("#")
        return self.by_id.get(name if sign else reference)

    def table(self, source: Element, width: int | None = None) -> Floats:
        """A source of numbers as (N, stride); ``width`` is the least stride."""
        stored = self._sources.get(id(source))
        if stored is None:
            stored = self._table(source)
            self._sources[id(source)] = stored
        if width is not None and stored.shape[1] < width:
            raise source.error(f"expected {width} numbers per item, found {stored.shape[1]}")
        return stored

    def _table(self, source: Element) -> Floats:
        array = source.first("float_array") or source.first("int_array")
        if array is None:
            raise source.error("it has no <float_array>")
        values = array.numbers()
        accessor = source.first("technique_common", "accessor")
        stride, offset, count = 1, 0, len(values)
        if accessor is not None:
            stride, offset = _count(accessor, "stride", 1), _count(accessor, "offset", 0)
            count = _count(accessor, "count", len(values) // max(stride, 1))
        if stride < 1 or offset + count * stride > len(values):
            raise source.error(
                f"the accessor wants {count} x {stride} numbers from {offset} on, the array has {len(values)}"
            )
        return values[offset : offset + count * stride].reshape(count, stride)

    def words(self, source: Element) -> list[str]:
        """A source of names or ids."""
        array = source.first("Name_array") or source.first("IDREF_array") or source.first("SIDREF_array")
        if array is None:
            raise source.error("it has no <Name_array> or <IDREF_array>")
        words = array.text.split()
        accessor = source.first("technique_common", "accessor")
        count = _count(accessor, "count", len(words)) if accessor is not None else len(words)
        if count > len(words):
            # names with blanks cannot be told apart; the ids of nodes may help
            rejoined = self._rejoined(words, count)
            if rejoined is None:
                raise source.error(f"expected {count} names, found {len(words)}")
            return rejoined
        if count < len(words):
            rejoined = self._rejoined(words, count)
            return rejoined if rejoined is not None else words[:count]
        return words

    def _rejoined(self, words: list[str], count: int) -> list[str] | None:
        """Names that hold blanks, put together again by the ids that exist; None where that does not give ``count``."""
        result: list[str] = []
        at = 0
        while at < len(words):
            for size in range(min(6, len(words) - at), 0, -1):
                name = " ".join(words[at : at + size])
                if size == 1 or name in self.by_id:
                    result.append(name)
                    at += size
                    break
        return result if len(result) == count else None

    def inputs(self, element: Element) -> dict[str, Element]:
        """The sources of an element's inputs by semantic."""
        return {i.get("semantic"): self.target(i, "source") for i in element.all("input")}


def _count(element: Element, name: str, default: int) -> int:
    word = element.get(name).strip()
    if not word:
        return default
    if not re.fullmatch(r"[0-9]{1,12}", word):
        raise element.error(f"{name}: expected a count, found {shown(word)}")
    return int(word)


def counted(element: Element, name: str, default: int) -> int:
    """An attribute that is a count."""
    return _count(element, name, default)


def attempt(document: Document, what: str, action: Callable[[], T]) -> T | None:
    """What the action gives; where the file is wrong there, a note, so that one odd animation does not cost the rest."""
    try:
        return action()
    except FormatError as error:
        document.note(f"{what} was dropped: {error}")
        return None
