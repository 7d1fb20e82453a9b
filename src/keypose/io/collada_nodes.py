"""COLLADA's node tree: transforms in any order, and the skeleton that the nodes make.

Source: COLLADA 1.4.1 specification, chapter 5 (node, matrix, translate, rotate, scale, lookat, skew).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from keypose.arrays import Floats
from keypose.io.collada_xml import Document, Element
from keypose.io.text import shown
from keypose.math import rigid

TRANSFORMS = {"matrix": 16, "translate": 3, "rotate": 4, "scale": 3, "lookat": 9, "skew": 7}
_MOST_NODES = 200_000


@dataclass(slots=True, eq=False)
class Node:
    """A node as it stands in the scene. ``transforms`` are (kind, sid, numbers) in file order."""

    element: Element
    parent: int
    transforms: list[tuple[str, str, Floats]] = field(default_factory=list[tuple[str, str, Floats]])

    @property
    def is_joint(self) -> bool:
        return self.element.get("type").upper() == "JOINT"

    @property
    def euler_order(self) -> str:
        """The axes of its rotations in their order where each is about an axis of its own, else nothing."""
        order = ""
        for kind, _, numbers in self.transforms:
            if kind in ("matrix", "lookat", "skew"):
                return ""
            if kind == "rotate":
                along = np.flatnonzero(numbers[:3])
                if len(along) != 1 or numbers[along[0]] <= 0 or "XYZ"[along[0]] in order:
                    return ""  # such as the two of a joint's own orientation and its motion
                order += "XYZ"[along[0]]
        return order


def scene_nodes(document: Document) -> tuple[list[Node], str]:
    """All nodes of the scene that the file shows, parents first, instances of library nodes included; the scene's name."""
    scene = _visual_scene(document)
    if scene is None:
        return [], ""
    nodes: list[Node] = []
    stack: list[tuple[Element, int, tuple[int, ...]]] = [(child, -1, ()) for child in reversed(scene.children)]
    while stack:
        element, parent, inside = stack.pop()
        if element.tag == "instance_node":
            target = document.target(element, "url", "node")
            if id(target) in inside:
                raise element.error(f"the node {shown(element.get('url'))} holds itself")
            stack.append((target, parent, (*inside, id(target))))
            continue
        if element.tag != "node":
            continue
        if len(nodes) >= _MOST_NODES:
            raise element.error(f"more than {_MOST_NODES} nodes")
        nodes.append(Node(element, parent, _transforms(element)))
        here = len(nodes) - 1
        stack.extend((child, here, inside) for child in reversed(element.children))
    return nodes, scene.named()


def _visual_scene(document: Document) -> Element | None:
    scenes = document.library("library_visual_scenes", "visual_scene")
    shown_scene = document.root.first("scene", "instance_visual_scene")
    if shown_scene is not None:
        found = document.find(shown_scene.get("url"))
        if found is not None and found.tag == "visual_scene":
            return found
        if len(scenes) != 1 or shown_scene.get("url") not in ("#", ""):
            document.note(f"the scene {shown(shown_scene.get('url'))} is not in the file; the first was read")
    elif len(scenes) > 1:
        document.note(f"the file shows none of its {len(scenes)} scenes; the first was read")
    return scenes[0] if scenes else None


def _transforms(element: Element) -> list[tuple[str, str, Floats]]:
    return [
        (child.tag, child.get("sid"), child.numbers(TRANSFORMS[child.tag]))
        for child in element.children
        if child.tag in TRANSFORMS
    ]


def matrix_of(kind: str, values: Any) -> Floats:
    """The matrices (*B, 4, 4) of one kind of transform; ``values`` (*B, n) as the file has them, column vectors."""
    values = np.asarray(values, np.float64)
    batch = values.shape[:-1]
    if kind == "matrix":
        return values.reshape(*batch, 4, 4)
    result = np.zeros((*batch, 4, 4))
    result[...] = np.eye(4)
    if kind == "translate":
        result[..., :3, 3] = values
    elif kind == "scale":
        for axis in range(3):
            result[..., axis, axis] = values[..., axis]
    elif kind == "rotate":
        result[..., :3, :3] = _rotation(values[..., :3], np.radians(values[..., 3]))
    elif kind == "lookat":
        result[..., :3, :4] = _look_at(values[..., :3], values[..., 3:6], values[..., 6:9])
    elif kind == "skew":
        # after RenderMan: what lies along the first axis is moved along the second by the tangent of the angle
        first, second = _unit(values[..., 1:4]), _unit(values[..., 4:7])
        across = first - np.sum(first * second, axis=-1, keepdims=True) * second
        result[..., :3, :3] += (
            np.tan(np.radians(values[..., 0]))[..., None, None] * second[..., :, None] * _unit(across)[..., None, :]
        )
    return result


def _rotation(axis: Floats, angle: Floats) -> Floats:
    """Rodrigues' formula, (*B, 3, 3); an axis of no length turns nothing."""
    axis = _unit(axis)
    c, s = np.cos(angle)[..., None, None], np.sin(angle)[..., None, None]
    x, y, z = axis[..., 0], axis[..., 1], axis[..., 2]
    zero = np.zeros_like(x)
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(*axis.shape[:-1], 3, 3)
    turned = c * np.eye(3) + (1 - c) * axis[..., :, None] * axis[..., None, :] + s * cross
    still = (np.sum(axis * axis, axis=-1) == 0)[..., None, None]
    return np.where(still, np.eye(3), turned)


def _look_at(eye: Floats, target: Floats, up: Floats) -> Floats:
    """The node's axes and place (*B, 3, 4): its -Z looks from the eye to the target."""
    z = _unit(eye - target)
    x = _unit(np.cross(up, z))
    lost = np.sum(x * x, axis=-1, keepdims=True) == 0
    z = np.where(np.sum(z * z, axis=-1, keepdims=True) == 0, (0.0, 0.0, 1.0), z)
    other = np.where(np.abs(z[..., :1]) < 0.9, (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
    x = np.where(lost, _unit(np.cross(other, z)), x)
    return np.stack([x, np.cross(z, x), z, eye], axis=-1)


def _unit(vectors: Floats) -> Floats:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0)


def local_matrices(node: Node, values: Mapping[int, Floats], count: int) -> Floats:
    """The node's matrices (N, 4, 4); ``values`` has the animated transforms by place, (N, n) each."""
    result = np.broadcast_to(np.eye(4), (count, 4, 4))
    for place, (kind, _, numbers) in enumerate(node.transforms):
        own = matrix_of(kind, values.get(place, numbers))
        result = result @ own
    return result


def decomposed(document: Document, node: Node, matrices: Floats, unit_m: float) -> tuple[Floats, Floats, Floats]:
    """Translations in metres, rotations and scales of matrices (N, 4, 4); what they cannot hold is told."""
    matrices = np.array(matrices, np.float64)
    if not np.isfinite(matrices).all() or np.abs(matrices).max(initial=0.0) > 1e30:
        raise node.element.error("its transforms are too large")
    bottom = np.abs(matrices[:, 3] - (0, 0, 0, 1)).max(initial=0.0)
    if bottom > 1e-6:
        document.note(f"the last row of a matrix of node {shown(node.element.named())} is not 0 0 0 1 and was dropped")
    matrices[:, 3] = (0, 0, 0, 1)
    translations, rotations, scales = (np.asarray(a) for a in rigid.to_trs(matrices))
    again = np.asarray(rigid.from_trs(translations, rotations, scales))
    size = np.abs(matrices[:, :3, :3]).max(initial=0.0)
    if np.abs(again - matrices)[:, :3, :3].max(initial=0.0) > 1e-4 * max(size, 1e-30):
        document.note(f"the shear of node {shown(node.element.named())} was dropped")
    return translations * unit_m, rotations, scales
