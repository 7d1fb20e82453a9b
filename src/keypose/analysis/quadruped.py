"""Which joint is which in an animal on all fours: by where joints are and how they hang together, hardly by names.

Roles are a humanoid's, forelegs being arms, with `tail:1`, `tail:2` ... from the root of the tail.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from keypose.arrays import Floats

# A paw is no higher over the ground than this share of the height of the back.
_LOW = 0.3
# A limb's first joint this near the ground (share of its height) is where it stands.
_STANDS = 0.25


@dataclass(frozen=True, slots=True, eq=False)
class Tree:
    """A skeleton's joints.

    Shapes: ``places`` (J, 3); ``sides`` by name ("left", "right" or ""); ``heads`` are called so; ``helpers`` are no bones of
    trunk, limbs or tail.
    """

    parents: Sequence[int]
    children: Sequence[Sequence[int]]
    places: Floats
    sides: Sequence[str]
    heads: frozenset[int]
    helpers: frozenset[int]

    def path(self, joint: int) -> list[int]:
        """From the root to a joint, both included."""
        path = [joint]
        while self.parents[path[-1]] >= 0:
            path.append(self.parents[path[-1]])
        return path[::-1]

    def meet(self, *joints: int) -> int:
        """The lowest joint that is above all, -1 for none."""
        shared = -1
        for level in zip(*(self.path(j) for j in joints), strict=False):
            if len(set(level)) > 1:
                break
            shared = level[0]
        return shared


def find_quadruped(tree: Tree) -> dict[str, int] | None:
    """The roles of an animal that stands on four legs; None for what is none."""
    places = tree.places
    leaves = [j for j, below in enumerate(tree.children) if not _real(tree, below) and j not in tree.helpers]
    leaves = [j for j in leaves if len(tree.path(j)) > 3]
    if len(leaves) < 5:
        return None
    body = np.array(sorted({j for leaf in leaves for j in tree.path(leaf)[1:]}))
    low = float(places[body, 1].min())
    tall = float(places[body, 1].max()) - low
    paws = [j for j in leaves if places[j, 1] - low < 0.5 * _LOW * tall]
    legs = _legs(tree, paws, body)
    if legs is None:
        return None
    (hind, fore), left = legs
    hips, chest = tree.meet(*hind), tree.meet(*fore)
    if hips < 0 or chest < 0:
        return None
    head = _head(tree, chest, leaves, paws)
    if head is None:
        return None
    if chest not in tree.path(head):
        return None
    if hips not in tree.path(chest):  # the hips hang on the back as the chest does
        hips = tree.meet(hips, chest)
    if hips < 0 or hips == chest:
        return None
    found: dict[str, int] = {"hips": hips}
    spine = [j for j in tree.path(chest)[tree.path(hips).index(hips) + 1 :] if j not in tree.helpers]
    chosen = spine if len(spine) < 3 else [spine[0], spine[len(spine) // 2], spine[-1]]
    found |= dict(zip(("spine", "chest", "upper_chest"), chosen, strict=False))
    neck = [j for j in tree.path(head)[tree.path(head).index(chest) + 1 : -1] if j not in tree.helpers]
    if neck:
        found["neck"] = neck[0]
    found["head"] = head
    sides = ("left", "right") if left else ("right", "left")
    for side, paw in zip(sides, hind, strict=True):
        leg = _hind_leg(tree, hips, paw, low)
        if leg is None:
            return None
        found |= {f"{side}_{role}": joint for role, joint in leg.items()}
    for side, paw in zip(sides, fore, strict=True):
        leg = _foreleg(tree, chest, paw, low)
        if leg is None:
            return None
        found |= {f"{side}_{role}": joint for role, joint in leg.items()}
    return found


def find_tail(tree: Tree, roles: Mapping[str, int]) -> dict[str, int]:
    """The joints of a tail by ``tail:1`` ..., from its root: the longest chain behind the hips that plays no role."""
    places, taken = tree.places, set(roles.values())
    hips, head = roles["hips"], roles["head"]
    back = places[hips] - places[head]
    back = back * np.array([1.0, 0.0, 1.0])
    best: list[int] = []
    above = {hips, *(roles[r] for r in ("spine",) if r in roles)}
    for first in (j for a in above for j in tree.children[a]):
        if first in taken or first in tree.helpers:
            continue
        chain = [first]
        while True:
            below = [j for j in _real(tree, tree.children[chain[-1]]) if j not in taken]
            if not below:
                break
            chain.append(max(below, key=lambda j: _depth(tree, j)))
        if any(taken & set(_below(tree, j)) for j in chain):
            continue
        if float((places[chain[-1]] - places[hips]) @ back) > 0 and len(chain) > len(best):
            best = chain
    return {f"tail:{n + 1}": joint for n, joint in enumerate(best)}


def _real(tree: Tree, joints: Sequence[int]) -> list[int]:
    return [j for j in joints if j not in tree.helpers]


def _depth(tree: Tree, joint: int) -> int:
    return 1 + max((_depth(tree, j) for j in tree.children[joint]), default=0)


def _below(tree: Tree, joint: int) -> list[int]:
    found = [joint]
    for j in found:
        found.extend(tree.children[j])
    return found


def _legs(
    tree: Tree, paws: Sequence[int], body: np.ndarray
) -> tuple[tuple[tuple[int, int], tuple[int, int]], bool] | None:
    """The paws (hind, fore), each of one side and of the other, and whether the first side is the left."""
    places = tree.places
    if len(paws) < 4:
        return None
    # a body on four legs is longer than it is wide
    level = places[body][:, [0, 2]]
    spread = level - level.mean(axis=0)
    along = np.linalg.eigh(spread.T @ spread)[1][:, 1]
    ahead = places[:, [0, 2]] @ along
    across = places[:, [0, 2]] @ np.array([along[1], -along[0]])
    centre = float(np.median(across[body]))
    aside = {j: float(across[j]) - centre for j in paws}
    halves = [[j for j in paws if aside[j] * sign > 0] for sign in (1.0, -1.0)]
    if min(len(h) for h in halves) < 2:
        return None
    ends: list[tuple[int, int]] = []
    for half in halves:
        first, last = min(half, key=lambda j: ahead[j]), max(half, key=lambda j: ahead[j])
        # toes of one foot are no two legs
        if tree.meet(first, last) in half or len(set(tree.path(first)) ^ set(tree.path(last))) < 5:
            return None
        ends.append((first, last))
    pairs = [(ends[0][n], ends[1][n]) for n in (0, 1)]
    heads = [tree.meet(*pair) for pair in pairs]
    if min(heads) < 0:
        return None
    # the forelegs hang beyond the hind legs on the way to the head, or, seen from a common root, on the side of it
    front = 1 if _leads(tree, heads[1], heads[0], paws) else 0
    hind, fore = pairs[1 - front], pairs[front]
    sense = np.sign(ahead[fore[0]] - ahead[hind[0]])
    left = np.cross((0.0, 1.0, 0.0), (sense * along[0], 0.0, sense * along[1]))
    named = [tree.sides[j] for j in hind]
    is_left = named == ["left", "right"] if all(named) else float((places[hind[0]] - places[hind[1]]) @ left) > 0
    return (hind, fore), is_left


def _leads(tree: Tree, one: int, other: int, paws: Sequence[int]) -> bool:
    """Whether the head rather hangs on the joint where one pair of legs meets than on the other's."""

    def highest(joint: int, without: int) -> float:
        own = [
            j
            for j in _below(tree, joint)
            if not any(p in _below(tree, j) for p in paws) and without not in tree.path(j)
        ]
        return max((float(tree.places[j, 1]) for j in own), default=-np.inf)

    return highest(one, other if one in tree.path(other) else -1) > highest(
        other, one if other in tree.path(one) else -1
    )


def _head(tree: Tree, chest: int, leaves: Sequence[int], paws: Sequence[int]) -> int | None:
    """Where ears, eyes and jaw part beyond the neck, else the end of it."""
    beyond = [j for j in leaves if chest in tree.path(j) and j not in paws and j != chest]
    if not beyond:
        return None
    top = max(beyond, key=lambda j: float(tree.places[j, 1]))
    way = tree.path(top)
    for joint in way[way.index(chest) + 1 :]:
        if joint in tree.heads or len(_real(tree, tree.children[joint])) > 1:
            return joint
    return top


def _limb(tree: Tree, above: int, paw: int) -> list[int]:
    way = tree.path(paw)
    return [j for j in way[way.index(above) + 1 :] if j not in tree.helpers] if above in way else []


def _standing(tree: Tree, limb: Sequence[int], low: float) -> int:
    """The number of the first joint of a limb that is near the ground."""
    heights = [float(tree.places[j, 1]) - low for j in limb]
    return next((n for n, h in enumerate(heights) if h < _STANDS * heights[0]), len(limb) - 1)


def _hind_leg(tree: Tree, hips: int, paw: int, low: float) -> dict[str, int] | None:
    limb = _limb(tree, hips, paw)
    if len(limb) < 3:
        return None
    stands = _standing(tree, limb, low)
    if stands >= 3:  # on its toes: the heel is in the air
        return dict(zip(("upper_leg", "lower_leg", "foot", "toes"), limb[stands - 3 : stands + 1], strict=True))
    if stands < 2:
        return None
    return dict(zip(("upper_leg", "lower_leg", "foot", "toes"), limb[stands - 2 : stands + 2], strict=False))


def _foreleg(tree: Tree, chest: int, paw: int, low: float) -> dict[str, int] | None:
    limb = _limb(tree, chest, paw)
    stands = _standing(tree, limb, low) if len(limb) >= 3 else 0
    if stands < 2:
        return None
    parts = ("upper_arm", "lower_arm", "hand")
    shoulder = {"shoulder": limb[stands - 3]} if stands >= 3 else {}
    return shoulder | dict(zip(parts, limb[stands - 2 : stands + 1], strict=True))
