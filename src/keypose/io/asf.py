"""ASF: the skeleton half of Acclaim's format as text; bytes to a plain description of the file, and back.

The description keeps the file's own units, axes and orders; `keypose.io.acclaim` gives it its meaning.

Source: M. Schafer, "ASF Skeleton File and AMC Motion Capture Data" (Acclaim Advanced Technologies Group, 1994), with the
variations of the CMU and HDM05 databases.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field

from keypose.errors import FormatError
from keypose.io.text import shown, to_number

LARGEST = 1e9
MOST_BYTES = 64 << 20
REMARK = b"#!keypose "  # what the format cannot say: a comment in the first line of files that keypose writes
DOFS = ("tx", "ty", "tz", "rx", "ry", "rz", "l")

_AXES = ("XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYX")
_SECTIONS = ("version", "name", "units", "documentation", "root", "bonedata", "hierarchy", "skin")
_BONE_WORDS = ("id", "name", "direction", "length", "axis", "dof", "limits", "bodymass", "cofmass", "begin", "end")
_PAIR = re.compile(r"\(\s*([^\s(),]+)[\s,]+([^\s(),]+)\s*\)")

Vector = tuple[float, float, float]
Limit = tuple[float, float]


@dataclass(slots=True)
class AsfBone:
    """One bone: its name, the unit vector to its end, and how it may move.

    ``axis`` are the three angles of its local axes, listed and composed as ``axis_order`` says (the first is applied
    first); ``dof`` names its channels in file order, ``limits`` has a pair for each.
    """

    name: str
    number: str = ""
    direction: Vector = (0.0, 0.0, 0.0)
    length: float = 0.0
    axis: Vector = (0.0, 0.0, 0.0)
    axis_order: str = "XYZ"
    dof: tuple[str, ...] = ()
    limits: list[Limit] = field(default_factory=list[Limit])
    mass: dict[str, float] = field(default_factory=dict[str, float])
    line: int = 0


@dataclass(slots=True)
class AsfText:
    """What an ASF file says. ``bones`` come with parents before children; ``parents`` has -1 for those at the root."""

    name: str = ""
    version: str = ""
    mass: float | None = None
    length: float | None = None
    degrees: bool = True
    order: tuple[str, ...] = ("tx", "ty", "tz", "rx", "ry", "rz")
    axis_order: str = "XYZ"
    position: Vector = (0.0, 0.0, 0.0)
    orientation: Vector = (0.0, 0.0, 0.0)
    bones: list[AsfBone] = field(default_factory=list[AsfBone])
    parents: list[int] = field(default_factory=list[int])
    notes: list[str] = field(default_factory=list[str])


def is_asf(head: bytes) -> bool:
    """Whether the first bytes are those of an ASF file."""
    return _first_keyword(head) in (b"version", b"name", b"units", b"documentation", b"root", b"bonedata")


def is_amc(head: bytes) -> bool:
    """Whether the first bytes are those of an AMC file."""
    return _first_keyword(head) in (b"fully-specified", b"degrees", b"radians", b"samples-per-second")


def _first_keyword(head: bytes) -> bytes:
    for line in head.removeprefix(b"\xef\xbb\xbf").splitlines():
        line = line.strip()
        if line.startswith(b":"):
            return (line[1:].split() or [b""])[0].lower()
        if line and not line.startswith(b"#"):
            return b""
    return b""


def parse_asf(data: bytes) -> AsfText:
    """Read an ASF file.

    Raises:
        FormatError: at the first thing that does not follow the format, with its line.
    """
    if len(data) > MOST_BYTES:
        raise FormatError(f"a skeleton of {len(data) >> 20} MiB; at most {MOST_BYTES >> 20} are read")
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise FormatError("the text is UTF-16; expected UTF-8 or ASCII", where="line 1")
    return _Parser(data).parse()


class _Parser:
    def __init__(self, data: bytes) -> None:
        try:
            text = data.decode("utf-8-sig")
        except UnicodeDecodeError:
            text = data.decode("latin-1")
        self.lines = re.split(r"\r\n|\r|\n", text)
        self.line = 0
        self.result = AsfText()
        self.bone: AsfBone | None = None
        self.place: dict[str, int] = {}
        self.parent_of: dict[str, tuple[str, int]] = {}
        self.seen: set[str] = set()
        self.misplaced: list[str] = []

    def parse(self) -> AsfText:
        section = ""
        for number, line in enumerate(self.lines, 1):
            self.line = number
            words = line.split("#", 1)[0].split() if section != "documentation" else line.split()
            if not words:
                continue
            if words[0].startswith(":") and (section != "documentation" or words[0][1:].lower() in _SECTIONS):
                section = self.section(words)
                continue
            match section:
                case "units":
                    self.unit(words)
                case "root":
                    self.root(words)
                case "bonedata":
                    self.bone_line(words, line)
                case "hierarchy":
                    self.hierarchy(words)
                case "documentation" | "skin" | "name" | "version":
                    pass
                case _:
                    raise self.error(f"expected a section (:version, :units, :root, …), found {shown(words[0])}")
        self.close_bone()
        if "root" not in self.seen:
            raise self.error("the file has no :root")
        self.sort()
        if self.misplaced:
            self.result.notes.append(
                f"words in :bonedata that are not known were passed over: {', '.join(self.misplaced)}"
            )
        return self.result

    def section(self, words: list[str]) -> str:
        self.close_bone()
        name = words[0][1:].lower()
        if name not in _SECTIONS:
            self.result.notes.append(
                f"line {self.line}: the section {shown(words[0])} is not known and was passed over"
            )
            return "skin"
        if name in self.seen and name in ("root", "bonedata", "hierarchy"):
            raise self.error(f"a second :{name}")
        self.seen.add(name)
        if name == "name":
            self.result.name = " ".join(words[1:])
        elif name == "version":
            self.result.version = " ".join(words[1:])
        return name

    def unit(self, words: list[str]) -> None:
        keyword = words[0].lower()
        if keyword == "angle":
            value = (words[1] if len(words) > 1 else "").lower()
            if value[:3] not in ("deg", "rad"):
                raise self.error(f"angle: expected deg or rad, found {shown(value)}")
            self.result.degrees = value.startswith("deg")
        elif keyword in ("mass", "length"):
            value = self.numbers(words, 1, keyword)[0]
            if not 1e-6 <= value <= 1e6:
                raise self.error(f"{keyword}: expected a positive number, found {shown(words[1])}")
            if keyword == "mass":
                self.result.mass = value
            else:
                self.result.length = value
        else:
            self.result.notes.append(f"line {self.line}: the unit {shown(words[0])} is not known and was passed over")

    def root(self, words: list[str]) -> None:
        keyword = words[0].lower()
        if keyword == "order":
            self.result.order = self.dofs(words[1:], "order")
            if "l" in self.result.order:
                raise self.error("order: the root has no length")
        elif keyword == "axis":
            self.result.axis_order = self.axis_order(words[1] if len(words) > 1 else "", "axis of the root")
        elif keyword == "position":
            self.result.position = self.vector(words, "position")
        elif keyword == "orientation":
            self.result.orientation = self.vector(words, "orientation")
        else:
            raise self.error(f":root: expected order, axis, position or orientation, found {shown(words[0])}")

    def bone_line(self, words: list[str], line: str) -> None:
        keyword = words[0].lower()
        if keyword == "begin":
            if self.bone:
                raise self.error(f"begin inside {self.described()}; an 'end' is missing")
            self.bone = AsfBone("", line=self.line)
        elif self.bone is None:
            raise self.error(f"expected begin, found {shown(words[0])}")
        elif keyword == "end":
            if not self.bone.name:
                raise self.error(f"the bone that begins in line {self.bone.line} has no name")
            if self.bone.name in self.place or self.bone.name == "root":
                raise self.error(f"a second bone {shown(self.bone.name)}")
            self.check_limits(self.bone)
            self.place[self.bone.name] = len(self.result.bones)
            self.result.bones.append(self.bone)
            self.bone = None
        elif keyword.startswith("("):
            self.limits(line)
        elif keyword == "limits":
            self.limits(line.strip()[len("limits") :])
        else:
            self.bone_field(self.bone, keyword, words)

    def bone_field(self, bone: AsfBone, keyword: str, words: list[str]) -> None:
        if keyword == "name":
            bone.name = words[1] if len(words) > 1 else ""
        elif keyword == "id":
            bone.number = words[1][:32] if len(words) > 1 else ""
        elif keyword == "direction":
            bone.direction = self.vector(words, f"direction of {self.described()}")
        elif keyword == "length":
            bone.length = self.numbers(words, 1, f"length of {self.described()}")[0]
        elif keyword == "axis":
            bone.axis = self.vector(words, f"axis of {self.described()}")
            bone.axis_order = self.axis_order(words[4] if len(words) > 4 else "", f"axis of {self.described()}")
        elif keyword == "dof":
            bone.dof = self.dofs(words[1:], f"dof of {self.described()}")
        elif keyword in ("bodymass", "cofmass"):
            bone.mass[keyword] = self.numbers(words, 1, f"{keyword} of {self.described()}")[0]
        elif len(self.misplaced) < 5:
            self.misplaced.append(f"{shown(words[0])} (line {self.line})")

    def limits(self, text: str) -> None:
        if self.bone is None:
            raise self.error("limits outside a bone")
        text = text.split("#", 1)[0]
        pairs = _PAIR.findall(text)
        if _PAIR.sub("", text).strip():
            raise self.error(f"limits of {self.described()}: expected pairs as (-10 170), found {shown(text.strip())}")
        for low, high in pairs:
            if len(self.bone.limits) >= len(DOFS):
                raise self.error(f"limits of {self.described()}: more than {len(DOFS)} pairs")
            self.bone.limits.append((self.limit(low), self.limit(high)))

    def limit(self, word: str) -> float:
        if word.lower().strip("+-") in ("inf", "infinity"):
            return float("-inf") if word.startswith("-") else float("inf")
        try:
            return to_number(word, LARGEST)
        except ValueError:
            raise self.error(f"limits of {self.described()}: expected a number or inf, found {shown(word)}") from None

    def check_limits(self, bone: AsfBone) -> None:
        if bone.limits and len(bone.limits) != len(bone.dof):
            self.result.notes.append(
                f"bone '{bone.name}' has {len(bone.dof)} dof and {len(bone.limits)} limits; its limits were dropped"
            )
            bone.limits = []

    def hierarchy(self, words: list[str]) -> None:
        if words[0].lower() in ("begin", "end") and len(words) == 1:
            return
        parent, *children = words
        if parent != "root" and parent not in self.place:
            raise self.error(f"hierarchy: there is no bone {shown(parent)}")
        for child in children:
            if child not in self.place:
                raise self.error(f"hierarchy: there is no bone {shown(child)}")
            if child in self.parent_of:
                raise self.error(
                    f"hierarchy: {shown(child)} is below {shown(self.parent_of[child][0])} already, "
                    f"since line {self.parent_of[child][1]}"
                )
            self.parent_of[child] = (parent, self.line)

    def sort(self) -> None:
        """Bones in depth-first order from the root; a bone that the hierarchy does not reach is a fault."""
        below: dict[str, list[str]] = {}
        for child, (parent, _) in self.parent_of.items():
            below.setdefault(parent, []).append(child)
        order: list[AsfBone] = []
        parents: list[int] = []
        stack = [(name, -1) for name in reversed(below.get("root", []))]
        while stack:
            name, parent = stack.pop()
            order.append(self.result.bones[self.place[name]])
            parents.append(parent)
            stack += [(child, len(order) - 1) for child in reversed(below.get(name, []))]
        if len(order) != len(self.result.bones):
            reached = {bone.name for bone in order}
            lost = next(bone for bone in self.result.bones if bone.name not in reached)
            raise FormatError(
                f"hierarchy: bone {shown(lost.name)} does not hang on the root", where=f"line {lost.line}"
            )
        self.result.bones, self.result.parents = order, parents

    def close_bone(self) -> None:
        if self.bone:
            raise self.error(f"{self.described()} is not closed; an 'end' is missing")

    def described(self) -> str:
        bone = self.bone
        if bone is None:
            return "the root"
        return f"bone {shown(bone.name)}" if bone.name else f"the bone that begins in line {bone.line}"

    def dofs(self, words: list[str], what: str) -> tuple[str, ...]:
        dofs = tuple(word.lower() for word in words)
        for word, dof in zip(words, dofs, strict=True):
            if dof not in DOFS:
                raise self.error(f"{what}: expected some of {' '.join(DOFS)}, found {shown(word)}")
        if len(set(dofs)) != len(dofs):
            raise self.error(f"{what}: {shown(next(d for d in dofs if dofs.count(d) > 1))} comes twice")
        return dofs

    def axis_order(self, word: str, what: str) -> str:
        if word.upper() not in _AXES:
            raise self.error(f"{what}: expected an order of X, Y and Z, found {shown(word)}")
        return word.upper()

    def vector(self, words: list[str], what: str) -> Vector:
        x, y, z = self.numbers(words, 3, what)
        return x, y, z

    def numbers(self, words: list[str], count: int, what: str) -> list[float]:
        values: list[float] = []
        for word in [*words[1 : count + 1], *[""] * count][:count]:
            try:
                values.append(to_number(word, LARGEST))
            except ValueError:
                expected = "a number" if count == 1 else f"{count} numbers"
                raise self.error(f"{what}: expected {expected}, found {shown(word)}") from None
        return values

    def error(self, what: str) -> FormatError:
        return FormatError(what, where=f"line {max(self.line, 1)}")


def compose_asf(asf: AsfText, remark: str = "") -> bytes:
    """The bytes of an ASF file; ``remark`` is a comment for its first line."""
    lines = [REMARK.decode() + remark] if remark else []
    lines += [":version " + (asf.version or "1.10"), ":name " + (asf.name or "keypose"), ":units"]
    if asf.mass is not None:
        lines.append(f"  mass {_number(asf.mass)}")
    if asf.length is not None:
        lines.append(f"  length {_number(asf.length)}")
    lines += [f"  angle {'deg' if asf.degrees else 'rad'}", ":documentation", "   written by keypose", ":root"]
    lines.append(f"   order {' '.join(asf.order).upper()}")
    lines.append(f"   axis {asf.axis_order}")
    lines.append(f"   position {_vector(asf.position)}")
    lines.append(f"   orientation {_vector(asf.orientation)}")
    lines.append(":bonedata")
    for number, bone in enumerate(asf.bones, 1):
        lines += ["  begin", f"     id {bone.number or number}", f"     name {bone.name}"]
        lines.append(f"     direction {_vector(bone.direction)}")
        lines.append(f"     length {_number(bone.length)}")
        lines.append(f"     axis {_vector(bone.axis)}  {bone.axis_order}")
        lines += [f"    {key} {_number(value)}" for key, value in bone.mass.items()]
        if bone.dof:
            lines.append(f"    dof {' '.join(bone.dof)}")
        for index, (low, high) in enumerate(bone.limits):
            lines.append(f"    {'limits' if index == 0 else '      '} ({_number(low)} {_number(high)})")
        lines.append("  end")
    lines += [":hierarchy", "  begin"]
    for parent in range(-1, len(asf.bones)):
        children = [bone.name for bone, above in zip(asf.bones, asf.parents, strict=True) if above == parent]
        if children:
            lines.append(f"    {'root' if parent < 0 else asf.bones[parent].name} {' '.join(children)}")
    return ("\n".join([*lines, "  end"]) + "\n").encode()


def _number(value: float) -> str:
    return f"{value + 0.0:.12g}"


def _vector(values: Vector) -> str:
    return " ".join(_number(value) for value in values)
