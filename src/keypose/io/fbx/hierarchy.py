"""FBX nodes as a skeleton: every node is a joint, helpers and mesh nodes too."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from keypose.arrays import Floats
from keypose.errors import FormatError
from keypose.io.guarded import Record, sane
from keypose.io.notes import Notes, UniqueNames
from keypose.model import Pose, Skeleton

BONE = 5  # ufbx's number for the attribute of a LimbNode
# FBX names the axis first that is turned about first; as axes that turn with the joint they come in reverse.
_ORDERS = ("ZYX", "YZX", "XZY", "ZXY", "YXZ", "XYZ")
STAGE = frozenset({3, 4, 13, 14})  # of lights, cameras and what switches between cameras
NEUTRAL = np.array([0, 0, 0, 0, 0, 0, 1, 1, 1, 1], np.float64)  # translation, rotation as xyzw, scale


@dataclass(frozen=True, slots=True)
class Hierarchy:
    """The skeleton, and which joint each node of the file is (carriers of skinned meshes are none)."""

    skeleton: Skeleton
    joint_of_node: Mapping[int, int]
    joint_above: Mapping[int, int]  # of carriers, if there is one
    nodes: tuple[int, ...]  # in the order of the joints, then the carriers
    roles: Mapping[str, int]
    bones: tuple[str, ...]
    euler_orders: Mapping[str, str]


def build(record: Record, unit_m: float, notes: Notes) -> Hierarchy:
    """All nodes of the file, parents before their children, in the order of a walk down every branch."""
    facts: Sequence[Mapping[str, Any]] = record.facts["nodes"]
    rest = record.array(record.facts["rest"], 10)
    if len(rest) != len(facts) or not sane(rest):
        bad = next((n for n, row in enumerate(rest) if not sane(row)), 0)
        raise FormatError("its transform holds impossible numbers", where=f"node '{_name(facts, bad)}'")
    order = _order(facts)
    stage = _stage(facts, order)
    if stage:
        notes.add(
            f"{len(stage)} nodes of cameras and lights were left out: {_shown([_name(facts, n) for n in sorted(stage)])}"
        )
    order = [n for n in order if n not in stage]
    carriers = {n for n in order if _is_carrier(record, facts, n, rest)}
    kept = [n for n in order if n not in carriers]
    joint_of_node = {node: joint for joint, node in enumerate(kept)}
    given = {n: _given_name(facts, n) for n in kept}
    unique, names = UniqueNames(given.values()), list[str]()
    for node, name in given.items():
        names.append(unique.add(name or f"node_{node}"))
        if names[-1] != name:
            what = f"node name '{name}' appears more than once; one became" if name else "a node has no name; it became"
            notes.add(f"{what} '{names[-1]}'")
    rows = rest[kept]
    pose = Pose(rows[:, :3] * unit_m, wxyz(rows[:, 3:7]), rows[:, 7:])
    parents = [joint_of_node.get(int(facts[n]["parent"]), -1) for n in kept]
    roles, ends = dict[str, int](), list[tuple[int, tuple[float, float, float]]]()
    for joint, node in enumerate(kept):
        role, end = facts[node]["role"], facts[node]["end_site"]
        if isinstance(role, str) and role:
            roles.setdefault(role, joint)
        if end is not None and sane(end):
            x, y, z = (float(v) * unit_m for v in end)
            ends.append((joint, (x, y, z)))
    bones = tuple(names[joint] for joint, node in enumerate(kept) if facts[node]["kind"] == BONE)
    turned = {names[joint]: int(facts[node]["order"]) for joint, node in enumerate(kept)}
    orders = {name: _ORDERS[order] for name, order in turned.items() if 0 <= order < len(_ORDERS)}
    skeleton = Skeleton(tuple(names), np.array(parents, np.int32), pose, tuple(ends))
    above = {n: joint_of_node[int(facts[n]["parent"])] for n in carriers if int(facts[n]["parent"]) in joint_of_node}
    return Hierarchy(skeleton, joint_of_node, above, (*kept, *sorted(carriers)), roles, bones, orders)


def wxyz(xyzw: Floats) -> Floats:
    """Unit quaternions from rows that begin with x."""
    turned = np.ascontiguousarray(xyzw[..., [3, 0, 1, 2]])
    length = np.linalg.norm(turned, axis=-1, keepdims=True)
    return np.where(length > 0, turned / np.where(length > 0, length, 1.0), [1.0, 0.0, 0.0, 0.0])


def affine(columns: Sequence[float], unit_m: float, where: str) -> Floats:
    """A matrix (4, 4) from four columns of three, its translation in metres."""
    if not sane(columns):
        raise FormatError("a matrix holds impossible numbers", where=where)
    matrix = np.eye(4)
    matrix[:3] = np.asarray(columns, np.float64).reshape(4, 3).T
    matrix[:3, 3] *= unit_m
    return matrix


def _given_name(facts: Sequence[Mapping[str, Any]], node: int) -> str:
    """The node's name; a helper, which ufbx makes where scale is not passed on to children, is called after its node."""
    item = facts[node]
    above = int(item["parent"])
    if item["helper"] and above >= 0:
        return f"{_name(facts, above)}_scale"
    return str(item["name"])


def _name(facts: Sequence[Mapping[str, Any]], node: int) -> str:
    return str(facts[node].get("name", ""))


def _order(facts: Sequence[Mapping[str, Any]]) -> list[int]:
    children: dict[int, list[int]] = {}
    top = -1
    for node, item in enumerate(facts):
        if item.get("root"):
            top = node
        else:
            children.setdefault(int(item["parent"]), []).append(node)
    waiting = [*reversed(children.get(-1, [])), *reversed(children.get(top, []) if top >= 0 else [])]
    order: list[int] = []
    while waiting:
        node = waiting.pop()
        order.append(node)
        waiting += reversed(children.get(node, []))
    if len(order) != sum(not item.get("root") for item in facts):
        missing = next(n for n, item in enumerate(facts) if not item.get("root") and n not in set(order))
        raise FormatError("the node is its own ancestor", where=f"node '{_name(facts, missing)}'")
    return order


def _stage(facts: Sequence[Mapping[str, Any]], order: Sequence[int]) -> frozenset[int]:
    """Cameras and lights that stand for themselves, with the targets that they look at: no part of a character."""
    tops = {n for n, item in enumerate(facts) if item.get("root")} | {-1}
    parents = {int(facts[n]["parent"]) for n in order}
    alone = [n for n in order if int(facts[n]["parent"]) in tops and n not in parents and int(facts[n]["mesh"]) < 0]
    stage = {n for n in alone if int(facts[n]["kind"]) in STAGE}
    targets = {f"{_name(facts, n)}.Target" for n in stage}
    return frozenset(stage | {n for n in alone if _name(facts, n) in targets})


def _shown(names: Sequence[str], most: int = 6) -> str:
    return ", ".join(names[:most]) + (", …" if len(names) > most else "")


def _is_carrier(record: Record, facts: Sequence[Mapping[str, Any]], node: int, rest: Floats) -> bool:
    """Whether keypose made the node only to carry a mesh."""
    item = facts[node]
    if not item["carrier"] or int(item["mesh"]) < 0 or not np.allclose(rest[node], NEUTRAL):
        return False
    skinned = bool(record.facts["meshes"][int(item["mesh"])]["skins"])
    above = int(item["parent"])
    return skinned or (above >= 0 and not facts[above].get("root"))
