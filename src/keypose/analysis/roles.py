"""Which joint is which: the roles of a humanoid skeleton under any naming, from hierarchy, places and names together.

Paths from the trunk to the ends (feet, hands, head) are found first; along each path the joints are then given roles so
that names and proportions agree best. Names count where they say something; without any the places alone decide.
Roles are those of VRM in snake case: ``hips``, ``left_upper_arm``, ``right_index_proximal``.
"""

from __future__ import annotations

import itertools
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from keypose.analysis.anatomy import Side, side_of
from keypose.analysis.quadruped import Tree, find_quadruped, find_tail
from keypose.analysis.role_words import FINGER_WORDS, part_of, text_of
from keypose.arrays import Floats, Ints
from keypose.errors import ShapeError, UnknownName
from keypose.evaluate import world_rotations_positions
from keypose.model import Pose, Skeleton

SIDES: tuple[Side, Side] = ("left", "right")
FINGERS = ("thumb", "index", "middle", "ring", "little")
_PHALANGES = {
    finger: ("metacarpal", "proximal", "distal") if finger == "thumb" else ("proximal", "intermediate", "distal")
    for finger in FINGERS
}
ROLES: tuple[str, ...] = (
    "hips", "spine", "chest", "upper_chest", "neck", "head", "jaw", "left_eye", "right_eye",
    *(f"{side}_{part}" for side in SIDES for part in (
        "upper_leg", "lower_leg", "foot", "toes", "shoulder", "upper_arm", "lower_arm", "hand",
    )),
    *(f"{side}_{finger}_{bone}" for side in SIDES for finger in FINGERS for bone in _PHALANGES[finger]),
)  # fmt: skip
"""All roles, trunk first."""

REQUIRED: tuple[str, ...] = (
    "hips", "spine", "head",
    *(f"{side}_{part}" for side in SIDES for part in (
        "upper_leg", "lower_leg", "foot", "upper_arm", "lower_arm", "hand",
    )),
)  # fmt: skip
"""What a humanoid has at least, as in VRM."""

_FACE = re.compile(r"^(?:ear|jaw|chin|eye|brow|nose|snout|muzzle|mouth|lip|tongue|teeth|tooth|horn|antler|mane)")
# Further chains of a map made by hand: 'tail:1', 'left_ear:2'.
_FURTHER = re.compile(r"[a-z][a-z0-9_]*:[0-9]+")


@dataclass(frozen=True, slots=True)
class RoleMap:
    """Joints by role, and how sure that is.

    Shapes and units: ``roles`` role -> joint index; ``confidence`` role -> 0..1: 1 where name and place agree, 0.5 where the
    place alone speaks; ``notes`` what was unclear.
    """

    roles: Mapping[str, int]
    confidence: Mapping[str, float]
    notes: tuple[str, ...] = ()
    on_all_fours: bool = False  # its arms are forelegs

    @property
    def is_humanoid(self) -> bool:
        """Whether everything is there that a humanoid has at least, and it stands on its feet alone."""
        return not self.missing and not self.on_all_fours

    @property
    def missing(self) -> tuple[str, ...]:
        """The required roles that no joint plays."""
        return tuple(role for role in REQUIRED if role not in self.roles)

    def to_json(self, skeleton: Skeleton) -> str:
        """The map by joint names, to be kept beside a skeleton and corrected by hand."""
        return json.dumps({role: skeleton.names[j] for role, j in self.roles.items()}, indent=1)


def roles_from_json(text: str, skeleton: Skeleton) -> RoleMap:
    """A saved map for a skeleton.

    Beside the roles of a humanoid it may name joints of further chains, such as ``tail:1``, ``tail:2``.

    Raises:
        ShapeError: where the text is no object of names.
        UnknownName: for a role or joint that does not exist, with the nearest.
    """
    try:
        saved: Any = json.loads(text)
    except ValueError as error:
        raise ShapeError(f"roles: expected a JSON object of role and joint names: {error}") from None
    if not isinstance(saved, dict):
        raise ShapeError("roles: expected a JSON object of role and joint names")
    named: dict[Any, Any] = saved
    joints = {name: j for j, name in enumerate(skeleton.names)}
    found: dict[str, int] = {}
    for role, name in named.items():
        if role not in ROLES and not _FURTHER.fullmatch(str(role)):
            raise UnknownName("role", str(role), ROLES)
        if not isinstance(name, str) or name not in joints:
            raise UnknownName("joint", str(name), skeleton.names)
        found[role] = joints[name]
    return RoleMap(found, dict.fromkeys(found, 1.0))


def joints_by_role(roles: RoleMap | Mapping[str, int], skeleton: Skeleton) -> dict[str, int]:
    """A map of roles of either kind as plain numbers of a skeleton's joints.

    Raises:
        ShapeError: where a role is played by no joint of the skeleton.
    """
    found = dict(roles.roles if isinstance(roles, RoleMap) else roles)
    for role, joint in found.items():
        if not 0 <= joint < skeleton.joint_count:
            raise ShapeError(f"role '{role}': expected a joint from 0 to {skeleton.joint_count - 1}, got {joint}")
    return found


def find_roles(skeleton: Skeleton, pose: Pose | None = None, known: Mapping[str, int] | None = None) -> RoleMap:
    """The roles of a skeleton's joints; what cannot be found is left out.

    ``pose`` (no batch) is looked at instead of the rest pose, for files whose rest pose is collapsed. ``known`` roles, such
    as a VRM names them, are kept as they are.

    Raises:
        ShapeError: where the pose does not fit the skeleton.

    Source: VRM 1.0 specification, humanoid bones (names of roles and which are required).
    """
    return _Finder(skeleton, pose, dict(known or {})).found()


def stands_on_all_fours(places: Floats, roles: Mapping[str, int]) -> bool:
    """Whether hands stand on the ground like feet, below their shoulders, and the back is level, at joints' places (J, 3)."""
    limbs = [
        (f"{side}_{a}", f"{side}_{b}") for side in SIDES for a, b in (("upper_leg", "foot"), ("upper_arm", "hand"))
    ]
    needed = ["hips", "head", *itertools.chain.from_iterable(limbs)]
    if any(role not in roles for role in needed):
        return False
    ways = [places[roles[top]] - places[roles[end]] for top, end in limbs]
    if any(float(way[1]) < 0.5 * float(np.linalg.norm(way)) for way in ways):
        return False
    height = {role: float(places[roles[role], 1]) for role in needed}
    ground = min(height["left_foot"], height["right_foot"])
    stands = all(height[f"{s}_hand"] - ground < 0.3 * (height["hips"] - ground) for s in SIDES)
    back = places[roles.get("upper_chest", roles.get("chest", roles["head"]))] - places[roles["hips"]]
    return stands and float(np.hypot(back[0], back[2])) > abs(float(back[1]))


class _Finder:
    def __init__(self, skeleton: Skeleton, pose: Pose | None, known: dict[str, int]) -> None:
        self.skeleton, self.known = skeleton, known
        self.names = skeleton.names
        self.parents = [int(p) for p in skeleton.parents]
        places = world_rotations_positions(skeleton, skeleton.rest if pose is None else pose)[1]
        self.places: Floats = np.asarray(places, np.float64)
        self.children: list[list[int]] = [[] for _ in self.names]
        for joint, parent in enumerate(self.parents):
            if parent >= 0:
                self.children[parent].append(joint)
        self.sides: list[Side] = [side_of(name) for name in self.names]
        self.texts = [text_of(name) for name in self.names]
        for joint, name in enumerate(self.names):  # '__UpLeg_L' only leads from the hips to 'UpLeg_L'
            same = [c for c in self.children[joint] if self.texts[c] == self.texts[joint] != ""]
            if name.startswith("__") and any(self.sides[c] == self.sides[joint] for c in same):
                self.texts[joint] = ""
        self.parts = [part_of(text, side) for text, side in zip(self.texts, self.sides, strict=True)]
        self.size = max(float(np.ptp(self.places[:, 1])), 1e-9)
        self.roles: dict[str, int] = {}
        self.sure: dict[str, float] = {}
        self.notes: list[str] = []

    def found(self) -> RoleMap:
        ends = self.ends()
        if ends is not None:
            self.trunk(ends)
            for side in SIDES:
                self.leg(side, ends)
                self.arm(side, ends)
                self.fingers(side)
            self.face()
        for role, joint in self.known.items():
            self.roles[role], self.sure[role] = joint, 1.0
        found = self.ordered()
        four = stands_on_all_fours(self.places, found)
        if not four and not self.known and any(role not in found for role in REQUIRED):
            four = self.animal()
            found = self.ordered()
        if four:
            self.notes.append("the hands stand on the ground and the back is level: a quadruped")
            tail = {} if any(":" in role for role in found) else find_tail(self.tree(), found)
            for role, joint in tail.items():
                found[role], self.sure[role] = joint, 1.0 if "tail" in self.texts[joint] else 0.6
        return RoleMap(found, {r: self.sure[r] for r in found}, tuple(self.notes), four)

    def ordered(self) -> dict[str, int]:
        order = [role for role in ROLES if role in self.roles]
        order += [role for role in self.roles if role not in ROLES]
        return {r: self.settled(self.roles[r]) if r not in self.known else self.roles[r] for r in order}

    def tree(self) -> Tree:
        heads = frozenset(j for j, part in enumerate(self.parts) if part == "head")
        aside = {
            j
            for j, (part, text) in enumerate(zip(self.parts, self.texts, strict=True))
            if part == "helper" or _FACE.search(text)
        }
        return Tree(self.parents, self.children, self.places, self.sides, heads, frozenset(aside))

    def animal(self) -> bool:
        """Roles of an animal on all fours, where the joints stand like one."""
        found = find_quadruped(self.tree())
        if found is None or not stands_on_all_fours(self.places, found):
            return False
        self.roles, self.sure = found, dict.fromkeys(found, 0.6)
        self.notes = ["its roles were found by where joints are"]
        self.face()
        return True

    def put(self, role: str, joint: int, sure: float) -> None:
        if joint not in self.roles.values():
            self.roles[role], self.sure[role] = joint, sure

    def settled(self, joint: int) -> int:
        """Of joints at one place with one name ('__UpLeg_L', 'UpLeg_L'), the lowest: it is the one that is animated."""
        for child in self.children[joint]:
            same = self.texts[child] == self.texts[joint] != "" and self.sides[child] == self.sides[joint]
            carries = self.children[child] or len(self.children[joint]) == 1  # else a mesh of the same name
            if same and carries and self.near(child, joint, 1e-3):
                return self.settled(child)
        return joint

    # ---- ends --------------------------------------------------------------------------------------------------------

    def ends(self) -> dict[str, int] | None:
        """A foot and a hand on each side and a head, by names, else by where the outermost joints are."""
        found: dict[str, int] = {}
        for side in SIDES:
            for end, parts in (("foot", ("foot", "toes")), ("hand", ("hand", "fingers"))):
                named = [j for j in (self.first(part, side) for part in parts) if j is not None]
                # A mesh 'Hand.L' beside the skeleton is no hand while fingers hang in it.
                if named:
                    found[f"{side}_{end}"] = max(named, key=lambda j: (len(self.path(j)) >= 4, -named.index(j)))
        head = self.first("head", "")
        if head is not None:
            found["head"] = head
        if len(found) == 5:
            return found
        by_place = self.ends_by_place()
        if by_place is None:
            return found if len(found) >= 4 and "head" in found else None
        if not found:
            self.notes.append("no joint name says what it is; roles were found by places alone")
        return {**by_place, **found}

    def first(self, part: str, side: Side) -> int | None:
        """The joint of a part nearest to the root; helpers and controls are no parts."""
        here = [j for j, p in enumerate(self.parts) if p == part and self.sides[j] == side]
        # Of several, as controls and meshes have the same names, the one that hangs deepest in the body counts.
        real = [j for j in here if not any(self.parts[a] == "helper" for a in self.path(j)[:-1])] or here
        inside = [j for j in real if len(self.path(j)) >= 4] or real
        top = [j for j in inside if not any(a in inside for a in self.path(j)[:-1])]
        return max(top, key=lambda j: (len(self.below(j)) > 1, len(self.path(j)), -j), default=None)

    def ends_by_place(self) -> dict[str, int] | None:
        leaves = [j for j in range(len(self.names)) if not self.children[j]]
        if len(leaves) < 5:
            return None
        height = self.places[:, 1]
        inner = {j for leaf in leaves if len(self.path(leaf)) > 2 for j in self.path(leaf)}
        if len(inner) < 8:
            return None
        used = np.array(sorted(inner))
        low = float(height[used].min())
        middle = np.median(self.places[used], axis=0)
        feet = [j for j in leaves if height[j] - low < 0.15 * self.size and len(self.path(j)) > 3]
        left = self.left_direction(used, middle, feet)
        aside = (self.places - middle) @ left
        head = max(leaves, key=lambda j: height[j] - abs(aside[j]))
        upper = [j for j in leaves if j != head and height[j] - low > 0.3 * self.size]
        found: dict[str, int] = {"head": head}
        for side, sign in (("left", 1.0), ("right", -1.0)):
            on_side = [j for j in feet if sign * aside[j] > 0.01 * self.size]
            if on_side:
                found[f"{side}_foot"] = self.foot_of(max(on_side, key=lambda j: len(self.path(j))))
            arms = [j for j in upper if sign * aside[j] > 0.1 * self.size]
            if arms:
                found[f"{side}_hand"] = self.hand_of(max(arms, key=self.reach), aside)
        return found if len(found) == 5 else None

    def left_direction(self, used: Ints, middle: Floats, feet: Sequence[int]) -> Floats:
        """To the left of the body: across its plane of symmetry, with the toes in front."""
        scores: list[float] = []
        for axis in (0, 2):
            mirrored = self.places[used].copy()
            mirrored[:, axis] = 2 * middle[axis] - mirrored[:, axis]
            apart = np.linalg.norm(mirrored[:, None] - self.places[used][None], axis=-1).min(axis=1).mean()
            scores.append(float(apart) - 0.05 * float(np.ptp(self.places[used, axis])))
        across = np.eye(3)[0 if scores[0] <= scores[1] else 2]
        forward = np.cross(across, (0.0, 1.0, 0.0))
        steps = sum(
            float((self.places[j] - self.places[self.parents[j]]) @ forward) for j in feet if self.parents[j] >= 0
        )
        return -across if steps < -0.02 * self.size else across

    def reach(self, joint: int) -> float:
        path = self.path(joint)
        return float(np.sum(np.linalg.norm(np.diff(self.places[path], axis=0), axis=1)))

    def foot_of(self, leaf: int) -> int:
        """From the tip of a foot up to the ankle: the highest joint of the path that is still near the ground."""
        near = [j for j in self.path(leaf)[2:] if self.places[j, 1] - self.places[leaf, 1] < 0.11 * self.size]
        return near[0] if near else leaf

    def hand_of(self, leaf: int, aside: Floats) -> int:
        """From a finger tip up to the joint where fingers part, else to the end of the last long bone."""
        path = self.path(leaf)
        for joint in reversed(path[:-1]):
            if len(self.children[joint]) >= 3 and abs(aside[joint]) > 0.15 * self.size:
                return joint
        for n in range(len(path) - 1, 0, -1):
            if np.linalg.norm(self.places[path[n]] - self.places[path[n - 1]]) > 0.09 * self.size:
                return path[n]
        return leaf

    # ---- trunk -------------------------------------------------------------------------------------------------------

    def path(self, joint: int) -> list[int]:
        """From the root to a joint, both included."""
        path = [joint]
        while self.parents[path[-1]] >= 0:
            path.append(self.parents[path[-1]])
        return path[::-1]

    def below(self, joint: int) -> list[int]:
        found = [joint]
        for j in found:
            found.extend(self.children[j])
        return found

    def meet(self, *joints: int) -> int | None:
        """The lowest joint that is above all."""
        shared: int | None = None
        for level in zip(*(self.path(j) for j in joints), strict=False):
            if len(set(level)) > 1:
                break
            shared = level[0]
        return shared

    def trunk(self, ends: Mapping[str, int]) -> None:
        feet = [self.leg_end(side, ends[f"{side}_foot"]) for side in SIDES if f"{side}_foot" in ends]
        hands = [ends[f"{side}_hand"] for side in SIDES if f"{side}_hand" in ends]
        head = ends["head"]
        hips = self.meet(*feet, head, *hands)
        if hips is None:
            return
        if self.parts[hips] == "spine":  # Biped: the thighs hang on the first joint of the spine
            named = [j for j in self.path(hips)[:-1] if self.parts[j] in ("hips", "hip") and self.near(j, hips, 0.15)]
            hips = named[-1] if named else hips
        parent = self.parents[hips]
        while parent >= 0 and self.parts[parent] in ("hips", "hip") and self.near(parent, hips, 0.03):
            hips, parent = parent, self.parents[parent]  # a pelvis under hips: the upper one carries the body
        named_hips = self.parts[hips] in ("hips", "hip") or self.texts[hips] in ("root", "hip")
        self.put("hips", hips, 1.0 if named_hips else 0.7)
        chest = self.meet(*hands, head)
        path = self.path(head)
        if chest is None or chest not in path or hips not in path:
            return
        start, stop = path.index(hips) + 1, path.index(chest)
        between = [j for j in path[start : stop + 1] if self.parts[j] not in ("helper", "hips", "neck")]
        spine = [j for n, j in enumerate(between) if n == 0 or not self.near(j, between[n - 1], 1e-4)]
        if spine:
            spread = {1: ["spine"], 2: ["spine", "chest"]}.get(len(spine), ["spine", "chest", "upper_chest"])
            chosen = spine if len(spine) < 3 else [spine[0], spine[len(spine) // 2], spine[-1]]
            for role, joint in zip(spread, chosen, strict=True):
                self.put(role, joint, 1.0 if self.parts[joint] == "spine" else 0.6)
        above = [j for j in path[start:] if j not in (head, *spine)]
        necks = [j for j in above if "neck" in self.texts[j]]
        necks = necks or [j for j in path[stop + 1 :] if j != head and self.parts[j] != "helper"][:1]
        if necks:
            self.put("neck", necks[0], 1.0 if "neck" in self.texts[necks[0]] else 0.6)
        if self.parts[head] != "head" and not self.children[head] and self.parents[head] not in (chest, *necks[:1]):
            head = self.parents[head]  # the tip of an unnamed skeleton is the crown, not the head
        self.put("head", head, 1.0 if self.parts[head] == "head" else 0.5)

    def leg_end(self, side: Side, foot: int) -> int:
        """The foot, or the lower leg where the foot hangs elsewhere, as in rigs whose feet are goals of IK."""
        legs = ("upper_leg", "lower_leg", "leg", "hip")
        if any(self.parts[j] in legs for j in self.path(foot)):
            return foot
        lower = self.first("lower_leg", side)
        return foot if lower is None or len(self.path(lower)) < 4 else lower

    def near(self, a: int, b: int, share: float) -> bool:
        return float(np.linalg.norm(self.places[a] - self.places[b])) <= share * self.size

    # ---- limbs -------------------------------------------------------------------------------------------------------

    def leg(self, side: Side, ends: Mapping[str, int]) -> None:
        foot = ends.get(f"{side}_foot")
        if foot is None:
            return
        if self.parts[foot] == "toes":
            above = self.parents[foot]
            if above >= 0 and self.parts[above] not in ("hips", "spine") and self.parents[above] >= 0:
                foot = above
        apart = self.leg_end(side, foot)
        chain = self.chain(foot) if apart == foot else [*self.chain(apart), foot]
        uppers, lowers = ("upper_leg", "hip", "leg"), ("lower_leg", "leg")
        upper, lower = self.bones(chain, uppers, lowers)
        if upper is None or lower is None:
            self.notes.append(f"the {side} leg has no knee")
            return
        self.put(f"{side}_upper_leg", upper, self.agreed(upper, side, uppers))
        self.put(f"{side}_lower_leg", lower, self.agreed(lower, side, lowers))
        self.put(f"{side}_foot", foot, self.agreed(foot, side, ("foot",)))
        toes = sorted((j for j in self.below(foot)[1:] if self.parts[j] == "toes"), key=lambda j: len(self.path(j)))
        toes = [j for j in toes if len(self.path(j)) == len(self.path(toes[0]))]
        if not toes:
            toes = [j for j in self.children[foot] if self.parts[j] != "helper"]
        if toes:
            # of several, the great toe, which the field numbers first
            chosen = min(toes, key=lambda j: self.texts[j])
            beyond = [j for j in self.children[chosen] if "toe" in self.texts[j]]
            if "metatarsal" in self.texts[chosen] and beyond:  # a bone of the foot itself
                chosen = beyond[0]
            self.put(f"{side}_toes", chosen, self.agreed(chosen, side, ("toes",)))

    def arm(self, side: Side, ends: Mapping[str, int]) -> None:
        hand = ends.get(f"{side}_hand")
        if hand is None:
            return
        above = self.parents[hand]
        if self.parts[hand] == "fingers":
            if above >= 0 and self.parts[above] in ("hand", ""):
                hand = above
        elif self.parts[hand] == "hand" and above >= 0 and self.parts[above] == "hand":
            hand = above  # wrist, then hand: the wrist is where it turns
        chain = self.chain(hand)
        collared = any(self.parts[j] == "collar" for j in chain)
        # Beside a clavicle, 'shoulder' is the arm.
        uppers = ("upper_arm", "shoulder", "arm") if collared else ("upper_arm", "arm", "shoulder")
        lowers = ("lower_arm", "arm")
        upper, lower = self.bones(chain, uppers, lowers)
        if upper is None or lower is None:
            self.notes.append(f"the {side} arm has no elbow")
            return
        self.put(f"{side}_upper_arm", upper, self.agreed(upper, side, uppers))
        self.put(f"{side}_lower_arm", lower, self.agreed(lower, side, lowers))
        self.put(f"{side}_hand", hand, self.agreed(hand, side, ("hand",)))
        before = [j for j in chain[: chain.index(upper)] if self.parts[j] != "helper"]
        if before:
            named = [j for j in before if self.parts[j] in ("collar", "shoulder")]
            chosen = named[-1] if named else before[0]
            self.put(f"{side}_shoulder", chosen, self.agreed(chosen, side, ("collar", "shoulder")))

    def chain(self, end: int) -> list[int]:
        """From below the trunk to the end of a limb, the end included."""
        taken = {self.roles.get(role) for role in ("hips", "spine", "chest", "upper_chest", "neck", "head")}
        path = self.path(end)
        trunk = [n for n, j in enumerate(path) if j in taken or self.parts[j] in ("spine", "hips")]
        first = max((n for n in trunk if path[n] != end), default=-1) + 1
        return path[first:]

    def bones(
        self, chain: Sequence[int], upper_names: tuple[str, ...], lower_names: tuple[str, ...]
    ) -> tuple[int | None, int | None]:
        """The two joints that begin the long bones of a limb: where names, lengths and evenness agree best."""
        end = chain[-1]
        places = self.places
        total = max(sum(float(np.linalg.norm(places[b] - places[a])) for a, b in itertools.pairwise(chain)), 1e-12)
        best: tuple[float, int | None, int | None] = (-np.inf, None, None)
        for a, b in itertools.combinations(chain[:-1], 2):
            upper = float(np.linalg.norm(places[b] - places[a]))
            lower = float(np.linalg.norm(places[end] - places[b]))
            if min(upper, lower) <= 1e-6 * self.size:
                even = -3.0
            else:
                even = -2.0 * abs(float(np.log(upper / lower))) + 2.0 * (upper + lower) / total
            score = even + self.named(a, upper_names) + self.named(b, lower_names)
            # the same part twice (upperleg01, upperleg02): the bone begins with the first
            score -= sum(0.8 for j in (a, b) if self.repeats(j, chain))
            if score > best[0]:
                best = (score, a, b)
        return best[1], best[2]

    def repeats(self, joint: int, chain: Sequence[int]) -> bool:
        n = chain.index(joint)
        return n > 0 and self.parts[chain[n - 1]] == self.parts[joint] != ""

    def named(self, joint: int, parts: tuple[str, ...]) -> float:
        part = self.parts[joint]
        if part == "helper":
            return -3.0
        return 2.5 - 0.5 * parts.index(part) if part in parts else (-1.0 if part else 0.0)

    def agreed(self, joint: int, side: Side, parts: tuple[str, ...]) -> float:
        return 0.5 + 0.25 * (self.parts[joint] in parts) + 0.25 * (self.sides[joint] == side)

    # ---- fingers and face --------------------------------------------------------------------------------------------

    def fingers(self, side: Side) -> None:
        hand = self.roles.get(f"{side}_hand")
        if hand is None:
            return
        arm = self.roles.get(f"{side}_lower_arm", hand)  # a rig may hang fingers beside the palm
        beside = [j for j in self.below(arm) if j != hand and self.parts[j] == "fingers" and hand not in self.path(j)]
        numbers = {j: self.finger_number(j) for j in (*self.below(hand)[1:], *beside)}
        first = 0 if 0 in numbers.values() else 1
        for n, finger in enumerate(FINGERS):
            pattern = re.compile(FINGER_WORDS[finger])
            joints = [
                j
                for j in numbers
                if (pattern.search(self.texts[j]) or numbers[j] == n + first)
                and not re.search(r"nub|end$|slot|socket|orient|twist|weapon", self.texts[j])
            ]
            chains = [self.finger_chain(j, joints) for j in joints if self.parents[j] not in joints]
            chain = max(chains, key=len, default=[])
            if not chain:
                continue
            # A bone of the palm belongs to the thumb alone.
            inside = re.search(r"inhand|metacarpal|palm", self.texts[chain[0]])
            if finger != "thumb" and inside and len(chain) > 1:
                chain = chain[1:]
            for bone, joint in zip(_PHALANGES[finger], chain, strict=False):
                self.put(f"{side}_{finger}_{bone}", joint, 1.0)

    def finger_number(self, joint: int) -> int | None:
        """The finger that a number names: 'finger2-1.L' and 'Finger21' are the second."""
        found = re.search(r"finger(\d)(?:\D|\d?$)", self.names[joint].lower().replace("_", "-"))
        return None if found is None else int(found[1])

    def finger_chain(self, first: int, allowed: Sequence[int]) -> list[int]:
        chain = [first]
        while True:
            following = [j for j in self.children[chain[-1]] if j in allowed]
            if not following:
                return chain
            if self.near(following[0], chain[-1], 1e-3):
                chain.pop()
            chain.append(following[0])

    def face(self) -> None:
        head = self.roles.get("head")
        if head is None:
            return
        for joint in self.below(head)[1:]:
            if self.parts[joint] == "jaw" and "jaw" not in self.roles:
                self.put("jaw", joint, 1.0)
            if self.parts[joint] == "eye" and self.sides[joint] and f"{self.sides[joint]}_eye" not in self.roles:
                self.put(f"{self.sides[joint]}_eye", joint, 1.0)
