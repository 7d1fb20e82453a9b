"""Prims and UsdSkel joints as one skeleton.

The joints of a UsdSkel skeleton are joints here. A prim becomes one only where it is needed: it moves, carries a mesh that
no skeleton bends, or stands for a place; the prims above a skeleton that only put it somewhere are worked into its roots.
In a file without UsdSkel joints every Xform is a joint.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from keypose.arrays import Floats
from keypose.errors import FormatError
from keypose.io.axes import UP_AXES, y_up_rotation
from keypose.io.guarded import Record, sane
from keypose.io.notes import Notes, UniqueNames
from keypose.math import quat, rigid
from keypose.model import Pose, Skeleton

_PLACES = ("Xform", "SkelRoot", "")
_SHEAR = 1e-5


@dataclass(frozen=True, slots=True)
class Base:
    """What comes before a joint's own transform: a rotation, a uniform scale and a translation, in the file's unit."""

    rotation: Floats = field(default_factory=lambda: np.array([1.0, 0, 0, 0]))
    scale: float = 1.0
    translation: Floats = field(default_factory=lambda: np.zeros(3))

    def before(self, translations: Floats, rotations: Floats, scales: Floats) -> tuple[Floats, Floats, Floats]:
        """The transforms (*B,) after it."""
        moved = self.scale * quat.rotate(self.rotation, translations) + self.translation
        return moved, quat.multiply(self.rotation, rotations), scales * self.scale

    def after(self, first: Base) -> Base:
        """This one inside another."""
        translation, rotation, _ = first.before(self.translation, self.rotation, np.ones(3))
        return Base(rotation, first.scale * self.scale, translation)


@dataclass(frozen=True, slots=True)
class Hierarchy:
    """The skeleton, and which joint everything of the file is."""

    skeleton: Skeleton
    joint_of_prim: Mapping[int, int]
    joint_above: Mapping[int, int]  # of every prim: its own joint, else the nearest above, -1 for none
    joint_of_token: Mapping[int, Mapping[str, int]]  # skeleton prim -> the path of a joint -> joint
    bind: Mapping[int, Mapping[str, Floats]]  # skeleton prim -> path of a joint -> bind transform (4, 4), file's unit
    bases: Mapping[int, Base]  # joints with something before them
    same: Mapping[int, int]  # skeleton prim -> the first one with the same joints, itself for most
    roles: Mapping[str, int]


@dataclass(frozen=True, slots=True)
class _Node:
    name: str
    parent: int
    base: Base
    local: tuple[Floats, Floats, Floats]
    end: Sequence[float] | None = None


def matrices(record: Record, reference: Any, where: str) -> Floats:
    """Matrices (N, 4, 4) that multiply columns, in the file's unit."""
    rows = record.floats(reference, 16)
    if not sane(rows):
        raise FormatError("a transform holds impossible numbers", where=where)
    return rows.reshape(-1, 4, 4).swapaxes(-1, -2)


def inverted(matrix: Floats) -> Floats | None:
    """The inverse of a matrix, if it has one."""
    try:
        inverse = np.linalg.inv(matrix)
    except np.linalg.LinAlgError:
        return None
    return inverse if sane(inverse) else None


def trs(found: Floats, where: str, notes: Notes) -> tuple[Floats, Floats, Floats]:
    """Translations, rotations and scales of matrices (*B, 4, 4); shear is noted."""
    parts = rigid.to_trs(found)
    again = rigid.from_trs(*parts)
    size = np.maximum(np.abs(found[..., :3, :3]).max(axis=(-1, -2), initial=0.0), 1e-30)
    if np.any(np.abs(again - found)[..., :3, :3].max(axis=(-1, -2), initial=0.0) > _SHEAR * size):
        notes.add(f"{where}: the shear of its transform was dropped")
    return parts


def build(record: Record, notes: Notes, unit_m: float, up: str) -> Hierarchy:
    """The skeleton of a file whose ``up`` axis points up, metres, Y up."""
    return _Builder(record, notes, unit_m, up).build()


class _Builder:
    def __init__(self, record: Record, notes: Notes, unit_m: float, up: str) -> None:
        self._record, self._notes, self._unit_m = record, notes, unit_m
        facts = record.facts
        self._prims: Sequence[Mapping[str, Any]] = facts["prims"]
        self._skeletons: Sequence[Mapping[str, Any]] = facts["skeletons"]
        self._up = Base(rotation=y_up_rotation(up if up in UP_AXES else "Y"))
        self._above = [self._parent(p) for p in range(len(self._prims))]
        self._matrix: dict[int, Floats] = {}
        for number, prim in enumerate(self._prims):
            if prim["transform"] is not None:
                self._matrix[number] = matrices(record, prim["transform"], f"prim '{prim['path']}'")

    def _parent(self, prim: int) -> int:
        """The nearest prim above that has a transform."""
        if self._prims[prim].get("resets"):
            return -1
        above = int(self._prims[prim]["parent"])
        while above >= 0 and self._prims[above]["transform"] is None:
            above = int(self._prims[above]["parent"])
        return above if above < prim else -1

    def build(self) -> Hierarchy:
        needed = self._needed()
        folded = self._folded(needed)
        nodes, joint_of_prim, tokens = list[_Node](), dict[int, int](), dict[int, dict[str, int]]()
        binds: dict[int, dict[str, Floats]] = {}
        roles: dict[str, int] = {}
        nearest: dict[int, int] = {-1: -1}
        skeleton_of = {int(s["prim"]): s for s in self._skeletons}
        known: dict[Any, int] = {}
        same = {int(s["prim"]): int(s["prim"]) for s in self._skeletons}
        for number in range(len(self._prims)):
            above = self._above[number] if number in self._matrix else int(self._prims[number]["parent"])
            nearest[number] = nearest.get(above, -1)
            if number in needed:
                nearest[number] = joint_of_prim[number] = len(nodes)
                parent = nearest.get(self._above[number], -1)
                where = f"prim '{self._prims[number]['path']}'"
                local = trs(self._matrix[number][0], where, self._notes)
                nodes.append(_Node(str(self._prims[number]["name"]), parent, self._root_base(parent), local))
            item = skeleton_of.get(number)
            if item is None or not item["joints"]:
                continue
            parent = nearest[number]
            base = folded[number].after(self._up) if parent < 0 else folded[number]
            placed = (base.rotation.tobytes(), base.scale, base.translation.tobytes())
            key = (parent, tuple(item["joints"]), item["animation"], self._bytes(item["rest"]), placed)
            if key in known:  # a skeleton that only has other bind transforms
                tokens[number], same[number] = tokens[known[key]], known[key]
            else:
                known[key] = number
                tokens[number] = self._joints(item, parent, base, nodes, roles)
            binds[number] = self._bind(item)
        return self._finish(nodes, joint_of_prim, nearest, tokens, binds, roles, same)

    def _bytes(self, reference: Any) -> bytes:
        return b"" if reference is None else self._record.array(reference).tobytes()

    def _root_base(self, parent: int) -> Base:
        return self._up if parent < 0 else Base()

    def _needed(self) -> set[int]:
        """Prims that have to be joints."""
        has_joints = any(s["joints"] for s in self._skeletons)
        parents = {int(p["parent"]) for p in self._prims}
        needed: set[int] = set()
        for mesh in self._record.facts["meshes"]:
            if mesh["skin"] is None:
                prim = int(mesh["prim"])
                carried = self._above[prim] >= 0 and self._is_identity(prim)
                needed.add(self._above[prim] if carried else prim)
        for number in self._matrix:
            prim = self._prims[number]
            place = prim["type"] in _PLACES
            moves = prim["times"] is not None and (place or prim["type"] == "Skeleton")
            stands = place and (not has_joints or (number not in parents and prim["type"] == "Xform"))
            if moves or stands:
                needed.add(number)
        self._close(needed)
        return needed

    def _close(self, needed: set[int]) -> None:
        for number in list(needed):
            above = self._above[number]
            while above >= 0 and above not in needed:
                needed.add(above)
                above = self._above[above]

    def _is_identity(self, prim: int) -> bool:
        return self._prims[prim]["times"] is None and np.allclose(self._matrix[prim][0], np.eye(4), atol=1e-12)

    def _folded(self, needed: set[int]) -> dict[int, Base]:
        """What stands before the roots of each skeleton; prims that cannot be put into one similarity become joints."""
        folded: dict[int, Base] = {}
        for item in self._skeletons:
            number, base = int(item["prim"]), Base()
            while number >= 0 and number not in needed:
                found = _similarity(self._matrix[number][0])
                if found is None:
                    needed.add(int(item["prim"]))
                    self._close(needed)
                    base = Base()
                    break
                base = base.after(found)
                number = self._above[number]
            folded[int(item["prim"])] = base
        # a later skeleton may have made joints of prims that were worked into an earlier one
        for item in self._skeletons:
            number, base = int(item["prim"]), Base()
            while number >= 0 and number not in needed:
                base = base.after(_similarity(self._matrix[number][0]) or Base())
                number = self._above[number]
            folded[int(item["prim"])] = base
        return folded

    def _joints(
        self, item: Mapping[str, Any], parent: int, base: Base, nodes: list[_Node], roles: dict[str, int]
    ) -> dict[str, int]:
        """Add the joints of a skeleton; which is which."""
        where = f"skeleton '{self._prims[int(item['prim'])]['path']}'"
        paths = [str(token).strip("/") for token in item["joints"]]
        if len(set(paths)) != len(paths) or "" in paths:
            raise FormatError("two joints have one path, or one has none", where=where)
        names = item["names"] if len(item["names"]) == len(paths) else [path.rpartition("/")[2] for path in paths]
        row = {path: k for k, path in enumerate(paths)}
        parents = [_joint_above(path, row) for path in paths]
        local = self._rest(item, parents, where)
        own = self._prims[int(item["prim"])]["own"] or {}
        ends = _ends(own, len(paths))
        made: dict[int, int] = {}
        for k in _parents_first(parents):
            above = made[parents[k]] if parents[k] >= 0 else parent
            made[k] = len(nodes)
            first = base if parents[k] < 0 else Base()
            nodes.append(_Node(str(names[k]), above, first, (local[0][k], local[1][k], local[2][k]), ends.get(k)))
        for role, k in zip(_words(own.get("roles")), _integers(own.get("role_joints")), strict=False):
            if k in made:
                roles.setdefault(role, made[k])
        return {str(token): made[k] for k, token in enumerate(item["joints"])}

    def _rest(self, item: Mapping[str, Any], parents: Sequence[int], where: str) -> tuple[Floats, Floats, Floats]:
        rest = None if item["rest"] is None else matrices(self._record, item["rest"], where)
        if rest is None or len(rest) != len(parents):
            bind = None if item["bind"] is None else matrices(self._record, item["bind"], where)
            if bind is None or len(bind) != len(parents):
                self._notes.add(f"{where}: it has no rest transforms; its joints were left at one place")
                rest = np.tile(np.eye(4), (len(parents), 1, 1))
            else:
                self._notes.add(f"{where}: it has no rest transforms; the bind transforms stand in for them")
                above = [np.eye(4) if p < 0 else bind[p] for p in parents]
                rest = np.asarray(rigid.inverse(np.stack(above))) @ bind if len(parents) else bind
        return trs(rest, where, self._notes)

    def _bind(self, item: Mapping[str, Any]) -> dict[str, Floats]:
        where = f"skeleton '{self._prims[int(item['prim'])]['path']}'"
        bind = None if item["bind"] is None else matrices(self._record, item["bind"], where)
        if bind is None or len(bind) != len(item["joints"]):
            if bind is not None or item["joints"]:
                self._notes.add(f"{where}: its bind transforms are missing; the rest transforms stand in for them")
            paths = [str(token).strip("/") for token in item["joints"]]
            parents = [_joint_above(path, {path: k for k, path in enumerate(paths)}) for path in paths]
            local = rigid.from_trs(*self._rest(item, parents, where))
            bind = np.tile(np.eye(4), (len(paths), 1, 1))
            for k in _parents_first(parents):
                bind[k] = local[k] if parents[k] < 0 else bind[parents[k]] @ local[k]
        return {str(token): bind[k] for k, token in enumerate(item["joints"])}

    def _finish(
        self,
        nodes: Sequence[_Node],
        joint_of_prim: Mapping[int, int],
        nearest: Mapping[int, int],
        tokens: Mapping[int, Mapping[str, int]],
        binds: Mapping[int, Mapping[str, Floats]],
        roles: Mapping[str, int],
        same: Mapping[int, int],
    ) -> Hierarchy:
        unique, names = UniqueNames(node.name for node in nodes), list[str]()
        for joint, node in enumerate(nodes):
            names.append(unique.add(node.name or f"joint_{joint}"))
            if names[-1] != node.name:
                self._notes.add(f"the name '{node.name}' appears more than once; one joint became '{names[-1]}'")
        placed = [node.base.before(*node.local) for node in nodes]
        columns = [np.array([p[k] for p in placed], np.float64).reshape(-1, w) for k, w in ((0, 3), (1, 4), (2, 3))]
        pose = Pose(columns[0] * self._unit_m, quat.normalize(columns[1]), columns[2])
        unit = self._unit_m
        ends = tuple(
            (j, (n.end[0] * unit, n.end[1] * unit, n.end[2] * unit)) for j, n in enumerate(nodes) if n.end is not None
        )
        skeleton = Skeleton(tuple(names), np.array([n.parent for n in nodes], np.int32), pose, ends)
        bases = {j: n.base for j, n in enumerate(nodes) if _matters(n.base)}
        above = {prim: joint for prim, joint in nearest.items() if prim >= 0}
        return Hierarchy(skeleton, joint_of_prim, above, tokens, binds, bases, same, roles)


def _matters(base: Base) -> bool:
    return base.scale != 1 or bool(np.any(base.translation)) or not np.array_equal(base.rotation, [1, 0, 0, 0])


def _similarity(matrix: Floats) -> Base | None:
    """A matrix as a rotation, a uniform scale and a translation, if it is one."""
    linear = matrix[:3, :3]
    scale = float(np.cbrt(np.linalg.det(linear)))
    if not scale > 0 or np.abs(linear.T @ linear - scale**2 * np.eye(3)).max() > 1e-6 * scale**2:
        return None
    if np.allclose(matrix, np.eye(4), rtol=0, atol=1e-15):
        return Base()
    return Base(np.asarray(quat.from_matrix(linear / scale)), scale, matrix[:3, 3].copy())


def _joint_above(path: str, row: Mapping[str, int]) -> int:
    while "/" in path:
        path = path.rpartition("/")[0]
        if path in row:
            return row[path]
    return -1


def _parents_first(parents: Sequence[int]) -> list[int]:
    """The order of the file where parents come first in it; a parent's path is shorter than that of its children."""
    order, done = list[int](), set[int]()
    for start in range(len(parents)):
        line = list[int]()
        k = start
        while k >= 0 and k not in done:
            line.append(k)
            k = parents[k]
        for k in reversed(line):
            done.add(k)
            order.append(k)
    return order


def _ends(own: Mapping[str, Any], count: int) -> dict[int, list[float]]:
    joints, offsets = _integers(own.get("end_joints")), own.get("end_offsets")
    if not isinstance(offsets, list) or len(offsets) != 3 * len(joints):
        return {}
    if not all(isinstance(v, (int, float)) and abs(v) < 1e15 for v in offsets):
        return {}
    return {j: [float(v) for v in offsets[3 * n : 3 * n + 3]] for n, j in enumerate(joints) if 0 <= j < count}


def _integers(values: Any) -> list[int]:
    return [v for v in values if isinstance(v, int)] if isinstance(values, list) else []


def _words(values: Any) -> Iterable[str]:
    return [v for v in values if isinstance(v, str)] if isinstance(values, list) else []
