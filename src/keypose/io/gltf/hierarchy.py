"""The node tree as a skeleton: every node of the scene is a joint.

Source: glTF 2.0 Specification, section 3.5 (scenes, nodes, transformations).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from keypose.errors import FormatError
from keypose.io.gltf.items import Document, Node
from keypose.io.notes import Notes, UniqueNames
from keypose.model import Pose, Skeleton

# A mark in a node's extras: the writer made the node only to carry a skinned mesh, or to give several roots a common
# one; it is no joint.
CARRIER = "carrier"
END_SITE = "end_site"
OWN = "keypose"


@dataclass(frozen=True, slots=True)
class Hierarchy:
    """The skeleton, and the joint of each node (carriers have none)."""

    skeleton: Skeleton
    joint_of_node: Mapping[int, int]
    joint_above: Mapping[int, int]  # of carriers, if there is one
    nodes: tuple[int, ...]  # of the scene, carriers too
    node_extras: Mapping[str, Mapping[str, Any]]


def own_extras(node_extras: Mapping[str, Any]) -> Mapping[str, Any]:
    """What keypose itself has written into a node's extras."""
    own = node_extras.get(OWN)
    return own if isinstance(own, dict) else {}


def check_tree(document: Document) -> list[int]:
    """The parent of each node, -1 for roots; raises `FormatError` at a second parent or a cycle."""
    parents = [-1] * len(document.nodes)
    for index, node in enumerate(document.nodes):
        for child in node.children:
            if child == index:
                raise FormatError("a node is its own child", where=node.where)
            if parents[child] >= 0:
                raise FormatError(
                    f"nodes[{child}] has two parents, nodes[{parents[child]}] and nodes[{index}]", where=node.where
                )
            parents[child] = index
    state = [0] * len(parents)  # 1: on the way up from here, 2: known to reach a root
    for start in range(len(parents)):
        path: list[int] = []
        node = start
        while node >= 0 and state[node] == 0:
            state[node] = 1
            path.append(node)
            node = parents[node]
        if node >= 0 and state[node] == 1:
            raise FormatError("the node is its own ancestor", where=document.nodes[node].where)
        for passed in path:
            state[passed] = 2
    return parents


def build(document: Document, notes: Notes) -> tuple[Hierarchy, str]:
    """The skeleton of the default scene, and the scene's name."""
    parents = check_tree(document)
    roots, name = _roots(document, parents, notes)
    order = _order(document, parents, roots)
    carriers = {n for n in order if own_extras(document.nodes[n].extras).get(CARRIER) is True}
    kept = [n for n in order if n not in carriers]
    joint_of_node = {node: joint for joint, node in enumerate(kept)}
    names = _unique([_node_name(document, n) for n in kept], [bool(document.nodes[n].name) for n in kept], notes)
    translations = np.zeros((len(kept), 3))
    rotations = np.tile([1.0, 0.0, 0.0, 0.0], (len(kept), 1))
    scales = np.ones((len(kept), 3))
    joint_parents = np.full(len(kept), -1, np.int32)
    ends: list[tuple[int, tuple[float, float, float]]] = []
    extras: dict[str, Mapping[str, Any]] = {}

    def joint_above(node: int) -> int:
        parent = parents[node]
        while parent in carriers:
            parent = parents[parent]
        return joint_of_node.get(parent, -1)

    for joint, index in enumerate(kept):
        node = document.nodes[index]
        translations[joint], rotations[joint], scales[joint] = _transform(node, notes)
        joint_parents[joint] = joint_above(index)
        own = own_extras(node.extras)
        end = own.get(END_SITE)
        if isinstance(end, list) and len(end) == 3 and all(_finite(e) for e in end):
            ends.append((joint, (float(end[0]), float(end[1]), float(end[2]))))
        rest = {k: v for k, v in node.extras.items() if k != OWN}
        if rest:
            extras[names[joint]] = rest
    pose = Pose(translations.astype(np.float32), rotations.astype(np.float32), scales.astype(np.float32))
    skeleton = Skeleton(tuple(names), joint_parents, pose, tuple(ends))
    above = {carrier: joint_above(carrier) for carrier in sorted(carriers)}
    above = {carrier: joint for carrier, joint in above.items() if joint >= 0}
    return Hierarchy(skeleton, joint_of_node, above, tuple(order), extras), name


def _finite(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) < 1e30


def _roots(document: Document, parents: Sequence[int], notes: Notes) -> tuple[list[int], str]:
    every = [n for n, parent in enumerate(parents) if parent < 0]
    name = ""
    if document.scenes:
        scene = document.scenes[document.scene or 0]
        name = scene.name
        if len(document.scenes) > 1:
            notes.add(f"the file has {len(document.scenes)} scenes; scene {document.scene or 0} was read")
        roots = list(dict.fromkeys(scene.nodes))
        for root in roots:
            if parents[root] >= 0:
                raise FormatError(
                    f"nodes[{root}] is no root: nodes[{parents[root]}] is its parent",
                    where=f"scenes[{document.scene or 0}].nodes",
                )
    else:
        roots = every
    # Joints may lie outside the scene by mistake; without them the skin could not be shown.
    reached = set(_descend(document, roots))
    used = {document.nodes[n].skin for n in reached} - {None}
    for skin in sorted(s for s in used if s is not None):
        for joint in document.skins[skin].joints:
            if joint not in reached:
                root = joint
                while parents[root] >= 0:
                    root = parents[root]
                notes.add(f"nodes[{root}] was added to the scene because skins[{skin}] needs it")
                roots.append(root)
                reached.update(_descend(document, [root]))
    left = [n for n in every if n not in reached]
    if left:
        notes.add(f"{len(left)} root nodes outside the scene were dropped")
    return roots, name


def _descend(document: Document, roots: Iterable[int]) -> list[int]:
    order: list[int] = []
    stack = list(roots)[::-1]
    while stack:
        node = stack.pop()
        order.append(node)
        stack.extend(document.nodes[node].children[::-1])
    return order


def _order(document: Document, parents: Sequence[int], roots: Sequence[int]) -> list[int]:
    depth_first = _descend(document, roots)
    # The file's own order is kept where parents come first in it, so that what was written is read back in its order.
    if all(parents[n] < n for n in depth_first) and list(roots) == sorted(roots):
        return sorted(depth_first)
    return depth_first


def _node_name(document: Document, index: int) -> str:
    node = document.nodes[index]
    if node.name:
        return node.name
    if node.mesh is not None and document.meshes[node.mesh].name:
        return document.meshes[node.mesh].name
    return f"node_{index}"


def _unique(names: Sequence[str], given: Sequence[bool], notes: Notes) -> list[str]:
    unique = UniqueNames(reserved=names)
    result = [unique.add(name) for name in names]
    renamed = [new for name, new in zip(names, result, strict=True) if new != name]
    if renamed:
        shown = ", ".join(renamed[:6]) + (", …" if len(renamed) > 6 else "")
        notes.add(f"{len(renamed)} nodes had the name of another and were numbered: {shown}")
    nameless = len(given) - sum(given)
    if nameless:
        notes.add(f"{nameless} nodes have no name and were numbered")
    return result


def _transform(node: Node, notes: Notes) -> tuple[Any, Any, Any]:
    if node.matrix is not None:
        return decompose(np.asarray(node.matrix).reshape(4, 4).T, node.where, notes)
    x, y, z, w = node.rotation or (0.0, 0.0, 0.0, 1.0)
    rotation = np.array([w, x, y, z])
    length = math.hypot(x, y, z, w)
    if not 1e-30 < length < 1e30:
        notes.add(f"{node.where}: a rotation of length {length:.3g} was replaced by none")
        rotation = np.array([1.0, 0.0, 0.0, 0.0])
    elif abs(length - 1) > 1e-5:
        rotation = rotation / length
        if abs(length - 1) > 1e-3:
            notes.add(f"{node.where}: a rotation of length {length:.4g} was normalised")
    values = (node.translation or (0.0, 0.0, 0.0), rotation, node.scale or (1.0, 1.0, 1.0))
    for part in (values[0], values[2]):
        if max(abs(v) for v in part) > 1e30:
            raise FormatError("the transform is too large", where=node.where)
    return values


def decompose(matrix: NDArray[np.float64], where: str, notes: Notes) -> tuple[Any, Any, Any]:
    """Translation, rotation (wxyz) and scale of a matrix; shear, which they cannot hold, is noted."""
    if np.any(np.abs(matrix) > 1e30):
        raise FormatError("the transform is too large", where=where)
    if np.any(np.abs(matrix[3] - (0, 0, 0, 1)) > 1e-6):
        notes.add(f"{where}: the last row of the matrix is not 0 0 0 1; it was dropped")
    linear = matrix[:3, :3]
    scale = np.linalg.norm(linear, axis=0)
    if np.linalg.det(linear) < 0:
        scale[0] = -scale[0]  # a mirror: the sign may go on any axis
    if np.any(scale == 0):
        notes.add(f"{where}: the matrix has no volume; the axes without length were replaced")
    axes = _orthonormal(linear, scale)
    if np.max(np.abs(axes * scale - linear)) > 1e-5 * max(float(np.max(np.abs(linear))), 1e-30):
        notes.add(f"{where}: the shear of the matrix was dropped")
    return matrix[:3, 3], _quaternion(axes), scale


def _orthonormal(linear: NDArray[np.float64], scale: NDArray[np.float64]) -> NDArray[np.float64]:
    axes = np.divide(linear, scale, out=np.zeros((3, 3)), where=scale != 0)
    u, _, vt = np.linalg.svd(axes)  # the nearest rotation; axes without length are filled in
    if np.linalg.det(u @ vt) < 0:
        u[:, 2] = -u[:, 2]
    return u @ vt


def _quaternion(axes: NDArray[np.float64]) -> NDArray[np.float64]:
    from keypose.math import quat

    return np.asarray(quat.from_matrix(axes))
