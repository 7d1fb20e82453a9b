"""What joint names and places say about a body: sides, ends, which way it faces, how it stands at rest."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from keypose.arrays import Floats

Side = Literal["left", "right", ""]

# Names of one word that begin with a side: CMU's lfemur, rhumerus.
_PARTS = (
    "hipjoint|hip|femur|thigh|upleg|knee|tibia|shin|leg|ankle|foot|toes?|clavicle|collar|shoulder|shldr|humerus|arm|elbow|"
    "radius|forearm|wrist|hand|fingers?|thumb|index|eye|heel|buttock"
)
_PREFIXED = re.compile(rf"^(l|r)(?:{_PARTS})\d*$")
_WORDS = re.compile(r"[A-Z]+(?![a-z])|[A-Z][a-z]+|[a-z]+|\d+")
_ENDS = {
    "head": ("head",),
    "hand": ("hand", "wrist"),
    "toe": ("toe", "toes", "toebase", "ball"),
    "foot": ("foot", "ankle"),
    "upper_arm": ("upperarm", "humerus", "shldr", "arm", "shoulder"),
}


def words_of(name: str) -> list[str]:
    """A joint's name as lower-case words, without a name space: ``mixamorig:LeftArm`` is left, arm."""
    return [word.lower() for word in _WORDS.findall(name.rpartition(":")[2])]


def side_of(name: str) -> Side:
    """The side that a joint's name says."""
    words = words_of(name)
    for side in ("left", "right"):
        if side in words or side[0] in words:
            return side
    joined = "".join(words)
    if joined.startswith("left"):
        return "left"
    if joined.startswith("right"):
        return "right"
    found = _PREFIXED.match(joined)
    return "" if found is None else "left" if found[1] == "l" else "right"


def is_end(name: str, end: str) -> bool:
    """Whether a name means that part: ``head``, ``hand``, ``toe``, ``foot`` or ``upper_arm``."""
    words = words_of(name)
    text = "".join(words)
    if end == "upper_arm" and ("fore" in text or "lower" in text or "twist" in text or "hand" in text):
        return False
    if end in ("hand", "head") and any(
        w in text for w in ("thumb", "index", "middle", "ring", "pinky", "finger", "headtop")
    ):
        return False
    stripped = text[1:] if _PREFIXED.match(text) else text
    return any(word in words or stripped == word or stripped.endswith(word) for word in _ENDS[end])


@dataclass(frozen=True, slots=True)
class Body:
    """Where the parts of a body are: joint indices by part and side, and pairs of joints that mirror each other."""

    parts: dict[tuple[str, Side], int]
    pairs: tuple[tuple[int, int], ...]  # left, right

    def __bool__(self) -> bool:
        return len(self.pairs) > 0


def find_body(names: Sequence[str]) -> Body:
    """The parts that joint names tell of; the first joint in the hierarchy wins."""
    parts: dict[tuple[str, Side], int] = {}
    mirrored: dict[str, int] = {}
    pairs: list[tuple[int, int]] = []
    for joint, name in enumerate(names):
        side = side_of(name)
        for end in _ENDS:
            if is_end(name, end):
                parts.setdefault((end, side), joint)
        if side:
            mirrored[name] = joint
    for name, joint in mirrored.items():
        if side_of(name) == "left":
            other = next((mirrored[m] for m in _mirrored(name) if m in mirrored), None)
            if other is not None:
                pairs.append((joint, other))
    return Body(parts, tuple(pairs))


def _mirrored(name: str) -> list[str]:
    """Names that the mirror image of a left joint may have."""
    swaps = (("Left", "Right"), ("left", "right"), ("LEFT", "RIGHT"))
    found = [name.replace(a, b) for a, b in swaps if a in name]
    for match in re.finditer(
        r"(?<![A-Za-z])[Ll](?![a-z])|(?<![A-Za-z])l(?=[A-Z])|^l|(?<![A-Za-z])L(?=[A-Z][a-z])", name
    ):
        letter = "R" if match[0] == "L" else "r"
        found.append(name[: match.start()] + letter + name[match.end() :])
    return found


def facing(body: Body, places: Floats) -> tuple[Floats | None, Floats | None]:
    """The horizontal direction a body faces by its sides and by its feet, unit vectors (3,) or none.

    Shapes and units: ``places`` (J, 3) metres, Y up.
    """
    up = np.array([0.0, 1.0, 0.0])
    by_sides = by_feet = None
    if body.pairs:
        left = np.mean([places[a] - places[b] for a, b in body.pairs], axis=0)
        by_sides = _unit(np.cross(left, up))
    steps: list[Floats] = []
    for side in ("left", "right"):
        toe, foot = body.parts.get(("toe", side)), body.parts.get(("foot", side))
        if toe is not None and foot is not None and toe != foot:
            steps.append(places[toe] - places[foot])
    if steps:
        forward = np.sum(steps, axis=0)
        by_feet = _unit(np.array([forward[0], 0.0, forward[2]]))
    return by_sides, by_feet


def rest_kind(body: Body, places: Floats) -> str:
    """How the arms are held: ``T``, ``A``, ``arms down``, ``other``, or ``unknown`` where no arms are named.

    Shapes and units: ``places`` (J, 3) metres, Y up.
    """
    angles: list[float] = []
    for side in ("left", "right"):
        arm, hand = body.parts.get(("upper_arm", side)), body.parts.get(("hand", side))
        if arm is None or hand is None or arm == hand:
            continue
        way = places[hand] - places[arm]
        length = float(np.linalg.norm(way))
        if length > 0:
            aside = float(np.hypot(way[0], way[2]))
            angles.append(float(np.degrees(np.arctan2(-way[1], aside))))
    if not angles:
        return "unknown"
    low, high = min(angles), max(angles)
    if high - low > 30:
        return "other"
    if low >= -20 and high <= 20:
        return "T"
    if low > 20 and high <= 65:
        return "A"
    return "arms down" if low > 65 else "other"


def _unit(vector: Floats) -> Floats | None:
    length = float(np.linalg.norm(vector))
    return vector / length if length > 1e-6 else None
