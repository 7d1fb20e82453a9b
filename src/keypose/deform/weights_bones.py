"""Bones as pieces of straight lines: which joint warms what, tips of leaf joints, twist joints along a bone."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from keypose.arrays import Floats, Ints
from keypose.model import Skeleton

_ALONG = (0.05, 0.95)  # where on a bone a twist joint may lie
_BESIDE = 0.1  # how far beside it, in lengths of the bone
_MOUNT = 0.1  # lengths of the bone before
_REACH = 4.0  # a leaf is at most so many times as long as the bone before it
_SHORT = 0.05  # of the bone before it: too short to say anything
_INSIDE = 0.85  # and ends before the surface
_OTHER_WAY = 0.3  # the cosine down to which a leaf may bend away from the bone before it

Reach = Callable[[Floats, Floats, float], Floats]


@dataclass(frozen=True, slots=True)
class Bones:
    """B pieces of straight lines, each of one joint; a joint may have several, and one may be a point.

    Shapes and units: ``starts`` and ``ends`` (B, 3) metres; ``joints`` (B,).
    """

    starts: Floats
    ends: Floats
    joints: Ints

    @property
    def count(self) -> int:
        """B."""
        return len(self.joints)

    def kept(self, flags: Any) -> Bones:
        """Those that are flagged (B,)."""
        return Bones(self.starts[flags], self.ends[flags], self.joints[flags])

    def nearest(self, points: Floats) -> tuple[Floats, Floats]:
        """The nearest place (N, B, 3) on every bone to points (N, 3), and its distance (N, B)."""
        along = self.ends - self.starts
        squared = np.maximum(np.sum(along * along, axis=1), 1e-30)
        shares = points @ along.T - np.sum(self.starts * along, axis=1)
        shares = np.clip(shares / squared, 0.0, 1.0)
        places = self.starts + shares[..., None] * along
        return places, np.linalg.norm(places - points[:, None], axis=-1)


def bones_of(skeleton: Skeleton, model_from_joint: Floats, joints: Iterable[int], inside: Reach | None = None) -> Bones:
    """The bones of the ``joints`` of a skeleton in a pose ``model_from_joint`` (J, 4, 4).

    A joint reaches to each of its children. A leaf that lies on the way to another child is a twist joint: from there on
    the bone is its own. Other leaves reach to their end site, or on in about the direction of the bone before them, as
    far as ``inside(start, directions (D, 3), longest)`` says that a straight way (D,) stays in the body.
    """
    chosen = set(joints)
    places = model_from_joint[:, :3, 3]
    children: list[list[int]] = [[] for _ in range(skeleton.joint_count)]
    mounts = mounts_of(skeleton, places)
    for joint, parent in enumerate(skeleton.parents.tolist()):
        if parent >= 0 and (joint in chosen or joint not in mounts):
            children[parent].append(joint)
    ways = {joint: _ways(places, children, joint) for joint in range(skeleton.joint_count)}
    twists = {t for own in ways.values() for way in own for t in way[1:-1]}
    offsets = dict(skeleton.end_offsets)
    owner = list(range(skeleton.joint_count))  # what no joint may warm is warmed by the one above
    for joint, parent in enumerate(skeleton.parents.tolist()):
        if joint not in chosen:
            owner[joint] = owner[parent] if parent >= 0 else -1
    found: list[tuple[Floats, Floats, int]] = []
    for joint, own in ways.items():
        for way in own:
            for start, end in itertools.pairwise(way):
                if owner[start] >= 0:
                    found.append((places[start], places[end], owner[start]))
        if joint in chosen and not own and joint not in twists:
            if joint in offsets:
                tip = model_from_joint[joint, :3, :3] @ np.asarray(offsets[joint], np.float64) + places[joint]
            else:
                tip = _leaf_tip(skeleton, model_from_joint, joint, inside)
            found.append((places[joint], tip, joint))
    return Bones(
        np.array([b[0] for b in found], np.float64).reshape(-1, 3),
        np.array([b[1] for b in found], np.float64).reshape(-1, 3),
        np.array([b[2] for b in found], np.int64),
    )


def mounts_of(skeleton: Skeleton, places: Floats) -> set[int]:
    """Leaf joints almost at the place of the joint above, (J, 3) being all places: what is hung on there is no bone."""
    parents = skeleton.parents.tolist()
    found: set[int] = set()
    for joint in set(range(skeleton.joint_count)) - set(parents):
        parent = parents[joint]
        if parent >= 0 and parents[parent] >= 0:
            before = float(np.linalg.norm(places[parent] - places[parents[parent]]))
            if np.linalg.norm(places[joint] - places[parent]) < _MOUNT * before:
                found.add(joint)
    return found


def _ways(places: Floats, children: list[list[int]], joint: int) -> list[list[int]]:
    """From a joint to each child, over the twist joints on the way: lists of joints."""
    leaves = [c for c in children[joint] if not children[c]]
    others = [c for c in children[joint] if children[c]] or leaves
    found: list[list[int]] = []
    taken: set[int] = set()
    for child in others:
        along = places[child] - places[joint]
        squared = float(along @ along)
        row: list[tuple[float, int]] = []
        for leaf in leaves:
            if leaf == child or leaf in taken or squared <= 0 or child in leaves:
                continue
            arm = places[leaf] - places[joint]
            share = float(arm @ along) / squared
            if _ALONG[0] < share < _ALONG[1] and np.linalg.norm(arm - share * along) < _BESIDE * squared**0.5:
                row.append((share, leaf))
        taken.update(leaf for _, leaf in row)
        found.append([joint, *(leaf for _, leaf in sorted(row)), child])
    found += [[joint, leaf] for leaf in leaves if leaf not in taken and leaf not in others]
    return found


def _leaf_tip(skeleton: Skeleton, model_from_joint: Floats, joint: int, inside: Reach | None) -> Floats:
    place = model_from_joint[joint, :3, 3]
    parent = int(skeleton.parents[joint])
    before = place - model_from_joint[parent, :3, 3] if parent >= 0 else np.zeros(3)
    length = float(np.linalg.norm(before))
    if length <= 0:
        return place
    forward = before / length
    if inside is None:
        return place + before * 0.5
    own = model_from_joint[joint, :3, :3] / np.maximum(np.linalg.norm(model_from_joint[joint, :3, :3], axis=0), 1e-30)
    axes = np.concatenate([own.T, -own.T, np.eye(3), -np.eye(3)])
    axes = axes[axes @ forward > _OTHER_WAY]
    directions = np.concatenate([forward[None], axes])
    ways = inside(place, directions, _REACH * length)
    # The way that stays inside longest, those that bend away counting less.
    best = int(np.argmax(ways * (0.5 + 0.5 * (directions @ forward)) * np.where(np.arange(len(ways)) == 0, 1.05, 1.0)))
    if ways[best] < _SHORT * length:  # the joint is not in the body, or at its surface
        return place + before * 0.5
    return place + directions[best] * ways[best] * _INSIDE
