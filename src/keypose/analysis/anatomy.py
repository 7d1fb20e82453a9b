"""What joint names and places say about a body: sides, ends, which way it faces, how it stands at rest."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from keypose.arrays import Floats, Ints
from keypose.model import Character, Skin

Side = Literal["left", "right", ""]

# Names of one word that begin with a side: CMU's lfemur, rhumerus.
_PARTS = (
    "hipjoint|hip|femur|thigh|upleg|knee|tibia|shin|leg|ankle|foot|toes?|clavicle|collar|shoulder|shldr|humerus|arm|elbow|"
    "radius|forearm|wrist|hand|fingers?|thumb|index|eye|heel|buttock"
)
_PREFIXED = re.compile(rf"^(l|r)(?:{_PARTS})\d*$")
_TRUNK = re.compile("hip|femur|thigh|upleg|upperleg|clavicle|collar|shoulder|shldr|humerus|upperarm")
_PART_OF_ROLE = {"foot": "foot", "toes": "toe", "hand": "hand", "upper_arm": "upper_arm"}
_FEWEST = 4  # joints that a skinned body has
_WORDS = re.compile(r"[A-Z]+(?![a-z])|[A-Z][a-z]+|[a-z]+|\d+")
_ENDS = {
    "head": ("head",),
    "hand": ("hand", "wrist"),
    "toe": ("toe", "toes", "toebase", "ball"),
    "foot": ("foot", "ankle"),
    "upper_arm": ("upperarm", "humerus", "shldr", "arm", "shoulder"),
}


# Bones along which a limb's roll is shared out: role of the bone, role of its end, whether the bone rolls in its own socket (an
# upper arm, a thigh) or its end rolls beyond it (a hand beyond the forearm).
ROLLING_BONES = (
    ("upper_arm", "lower_arm", True),
    ("lower_arm", "hand", False),
    ("upper_leg", "lower_leg", True),
    ("lower_leg", "foot", False),
)
TWIST_NAME = re.compile(r"twist|roll(?!ing)|ribbon", re.IGNORECASE)
TWIST_ASIDE = 0.15
"""A joint further from its bone than this share of the length does not roll with it."""


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

    trunk: tuple[tuple[int, int], ...] = ()  # those of hips and shoulders

    def __bool__(self) -> bool:
        return len(self.pairs) > 0

    @property
    def head(self) -> int | None:
        """The joint of the head."""
        return self.parts.get(("head", ""))

    @property
    def feet(self) -> list[int]:
        """Ankles and toes."""
        return [joint for (part, side), joint in self.parts.items() if part in ("foot", "toe") and side]


def figure_joints(character: Character) -> Ints:
    """The joints that make the body: those that skins hold, else the tree with the most joints.

    Files hold more than a body: meshes, cameras, handles of a rig, what a character looks at.
    """
    skeleton = character.skeleton
    parents = np.asarray(skeleton.parents)
    held = [np.asarray(part.skin.palette)[_used(part.skin)] for part in character.parts if part.skin is not None]
    if held:
        found = np.unique(np.concatenate(held))
        if len(found) >= _FEWEST:
            return found
    tops = np.arange(len(parents))
    for joint, parent in enumerate(parents):
        if parent >= 0:
            tops[joint] = tops[parent]
    if not len(tops):
        return tops
    return np.flatnonzero(tops == np.bincount(tops).argmax())


def _used(skin: Skin) -> Ints:
    """The places of a palette that any vertex hangs on."""
    weights, joints = np.asarray(skin.weights), np.asarray(skin.joints)
    return np.unique(joints[weights > 0])


def find_body(names: Sequence[str], joints: Iterable[int] | None = None) -> Body:
    """The parts that joint names tell of, among ``joints`` (all if not given); the first joint in the hierarchy wins."""
    parts: dict[tuple[str, Side], int] = {}
    mirrored: dict[str, int] = {}
    pairs: list[tuple[int, int]] = []
    for joint in range(len(names)) if joints is None else map(int, joints):
        name = names[joint]
        side: Side = side_of(name)
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
    trunk = tuple(pair for pair in pairs if _TRUNK.search("".join(words_of(names[pair[0]]))))
    return Body(parts, tuple(pairs), trunk)


def with_roles(body: Body, roles: Mapping[str, int]) -> Body:
    """The body with what a file itself says of its joints (``left_hand``, ``head``), which counts more than names."""
    parts = dict(body.parts)
    pairs, trunk = set(body.pairs), set(body.trunk)
    for role, joint in roles.items():
        if role == "head":
            parts["head", ""] = joint
        side, _, limb = role.partition("_")
        if side in ("left", "right") and limb in _PART_OF_ROLE:
            parts[_PART_OF_ROLE[limb], side] = joint
        if role.startswith("left_") and f"right_{role.removeprefix('left_')}" in roles:
            pair = joint, roles[f"right_{role.removeprefix('left_')}"]
            pairs.add(pair)
            if role.removeprefix("left_") in ("upper_leg", "upper_arm", "shoulder"):
                trunk.add(pair)
    return Body(parts, tuple(sorted(pairs)), tuple(sorted(trunk)))


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
    # Arms may be crossed; hips and shoulders tell the sides.
    pairs = body.trunk or body.pairs
    if pairs:
        left = np.mean([places[a] - places[b] for a, b in pairs], axis=0)
        by_sides = _unit(np.cross(left, up))
    steps: list[Floats] = []
    for side in ("left", "right"):
        toe, foot = body.parts.get(("toe", side)), body.parts.get(("foot", side))
        if toe is not None and foot is not None and toe != foot:
            step = places[toe] - places[foot]
            if abs(step[1]) < np.hypot(step[0], step[2]):  # one that hangs down says nothing
                steps.append(step)
    if steps:
        forward = np.sum(steps, axis=0)
        by_feet = _unit(np.array([forward[0], 0.0, forward[2]]))
    return by_sides, by_feet


def upright(body: Body, places: Floats) -> float | None:
    """How upright a body is: the cosine between feet-to-head and up, None where it has no head or feet.

    Shapes and units: ``places`` (J, 3) metres, Y up.
    """
    head, feet = body.head, body.feet
    if head is None or not feet:
        return None
    way = places[head] - places[feet].mean(axis=0)
    length = float(np.linalg.norm(way))
    return float(way[1]) / length if length > 0 else 0.0


def on_all_fours(body: Body, places: Floats) -> bool:
    """Whether the hands are as near the ground as the feet, and the head is above both."""
    hands = [joint for (part, side), joint in body.parts.items() if part == "hand" and side]
    if body.head is None or not body.feet or len(hands) < 2:
        return False
    low = min(float(places[hands, 1].min()), float(places[body.feet, 1].min()))
    top = float(places[body.head, 1]) - low
    return top > 0 and bool(max(float(places[hands, 1].max()), float(places[body.feet, 1].max())) - low < 0.3 * top)


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
