"""What joint names say about roles, under any convention: the words for parts of the body."""

from __future__ import annotations

import re

from keypose.analysis.anatomy import Side, side_of, words_of

# What a joint's text (letters only, no side, no name space) says it is; the first that fits wins.
PARTS = (
    ("helper", r"twist|share|nub|end$|helper|ctrl|control|pole|target|slot|socket|footsteps|camera|roll|dummy|null|orient|ik$|attach|prop|effector"),
    ("toes", r"toe|ball|metatarsal"),
    ("fingers", r"thumb|index|middle|mid\d|ring|pinky|pinkie|little|finger|metacarpal|palm"),
    ("foot", r"foot|ankle|heel"),
    ("hand", r"hand|wrist"),
    ("lower_leg", r"lowerleg|loleg|calf|shin|tibia|knee|crus"),
    ("upper_leg", r"upleg|upperleg|thigh|femur"),
    ("leg", r"leg"),
    ("lower_arm", r"lowerarm|loarm|forearm|radius|ulna|elbow"),
    ("upper_arm", r"uparm|upperarm|humerus|bicep|shldr"),
    ("collar", r"clavicle|collar|scapula"),
    ("shoulder", r"shoulder"),
    ("arm", r"arm"),
    ("jaw", r"jaw|chin"),
    ("eye", r"^eye(?!brow|lid|lash)|eyeball|eye$"),
    ("head", r"head|skull"),
    ("neck", r"neck"),
    ("hips", r"hips|pelvis|cog"),
    ("", r"hipjoint"),  # of CMU's skeletons: beside the hips, above the thigh
    ("hip", r"hip"),
    ("spine", r"spine|back|chest|thorax|torso|abdomen|waist|ribcage|body"),
)  # fmt: skip
_PATTERNS = tuple((part, re.compile(pattern)) for part, pattern in PARTS)
_PREFIX = re.compile(
    r"^(?:mixamorig\d*|ccbase|rlbone|bip\d*|biped\d*|valve|def|org|mch|jbip|bone|b|jnt|joint)(?=[a-z])"
)
FINGER_WORDS = {
    "thumb": r"thumb", "index": r"index|fore(?!arm)", "middle": r"middle|mid",
    "ring": r"ring(?!pinky)", "little": r"pinky|pinkie|little|small",
}  # fmt: skip


def text_of(name: str) -> str:
    """A joint's name as letters and digits without name space, known prefixes and its side."""
    words = words_of(name.replace("|", ":"))
    text = "".join(w for w in words if w not in ("left", "right", "l", "r"))
    for _ in range(2):
        text = _PREFIX.sub("", text)
    if text.startswith(("left", "right")):
        text = text.removeprefix("left").removeprefix("right")
    elif side_of(name) and text[:1] in "lr" and "".join(words) == text:
        text = text[1:]
    return text


def part_of(text: str, side: Side) -> str:
    """The part of the body that a joint's text names (`PARTS`); empty where it says nothing."""
    for part, pattern in _PATTERNS:
        if pattern.search(text):
            if part == "eye" and not side:
                return ""
            if part == "hip" and not side:
                return "hips"
            return part
    return ""
