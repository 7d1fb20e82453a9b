"""MakeHuman's own files: skeleton (.mhskel), weights (.mhw), targets (.target) and names of pose units (.json).

Numbers are in decimetres with Y up, as MakeHuman has them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from keypose.arrays import Floats, Ints
from keypose.errors import FormatError
from keypose.io.json_values import Json, parse_json
from keypose.io.text import line_of, parse_block, shown, to_number

LARGEST_BYTES = 64 << 20
_MOST_BONES = 4096
_LARGEST = 1e6


@dataclass(frozen=True, slots=True)
class Rig:
    """The bones of a skeleton file, parents before children.

    Shapes and units: ``parents`` (B,); ``heads`` and ``tails`` hold for each bone the vertices whose mean is its joint.
    """

    name: str
    names: tuple[str, ...]
    parents: Ints
    heads: tuple[Ints, ...]
    tails: tuple[Ints, ...]
    weights_file: str


def read_json(path: Path) -> Json:
    """The root of a JSON file of bounded size; every error names the file."""
    size = path.stat().st_size
    if size > LARGEST_BYTES:
        raise FormatError(f"{size >> 20} MiB; at most {LARGEST_BYTES >> 20} MiB are read", path=path)
    try:
        root = parse_json(path.read_bytes())
        root.object()
    except FormatError as error:
        raise error.at(path) from None
    return root


def read_rig(path: Path, vertex_count: int) -> Rig:
    """The skeleton of a .mhskel file for a base mesh of ``vertex_count`` vertices.

    Raises:
        FormatError: where something is missing, a vertex does not exist, or a bone is its own ancestor.
    """
    root = read_json(path)
    try:
        return _rig(root, vertex_count)
    except FormatError as error:
        raise error.at(path) from None


def _rig(root: Json, vertex_count: int) -> Rig:
    bones = dict(root.members("bones"))
    if not bones:
        root.fail("no bones")
    if len(bones) > _MOST_BONES:
        root.fail(f"{len(bones)} bones; at most {_MOST_BONES} are read")
    joints = dict(root.members("joints"))
    above: dict[str, str | None] = {}
    for name, bone in bones.items():
        parent = bone.object().get("parent")
        if parent is not None and (not isinstance(parent, str) or parent not in bones):
            bone.fail(f"its parent {shown(str(parent))} is no bone")
        above[name] = parent
    order = _parents_first(bones, above)
    place = {name: index for index, name in enumerate(order)}

    def vertices(bone: Json, end: str) -> Ints:
        joint = bone.text(end)
        if joint not in joints:
            bone.fail(f"its {end} {shown(joint)} is no joint")
        item = joints[joint]
        if not isinstance(item.value, list) or not item.value:
            item.fail("expected a list of vertices")
        found = [Json(v, f"{item.where}[{i}]").as_integer(0, vertex_count, "vertex") for i, v in enumerate(item.value)]
        return np.array(found, np.int64)

    parents = [-1 if above[name] is None else place[str(above[name])] for name in order]
    return Rig(
        root.text("name", ""),
        tuple(order),
        np.array(parents, np.int32),
        tuple(vertices(bones[name], "head") for name in order),
        tuple(vertices(bones[name], "tail") for name in order),
        root.text("weights_file", ""),
    )


def _parents_first(bones: Mapping[str, Json], above: Mapping[str, str | None]) -> list[str]:
    """Depth first, children in the file's order."""
    children: dict[str | None, list[str]] = {}
    for name, parent in above.items():
        children.setdefault(parent, []).append(name)
    order: list[str] = []
    stack = children.get(None, [])[::-1]
    while stack:
        name = stack.pop()
        order.append(name)
        stack.extend(children.get(name, [])[::-1])
    if len(order) < len(above):
        lost = next(name for name in above if name not in set(order))
        bones[lost].fail("the bone is its own ancestor")
    return order


def read_weights(path: Path, bones: tuple[str, ...], vertex_count: int) -> tuple[Ints, Ints, Floats, list[str]]:
    """Bones, vertices and weights of a .mhw file, (N,) each, and the names in it that are no bones.

    Raises:
        FormatError: where a vertex does not exist or a weight is negative or no number.
    """
    root = read_json(path)
    place = {name: index for index, name in enumerate(bones)}
    owners: list[Ints] = []
    vertices: list[Ints] = []
    weights: list[Floats] = []
    strangers: list[str] = []
    try:
        root.need("weights").object()
        for name, item in root.members("weights"):
            table = _pairs(item)
            if name not in place:
                strangers.append(name)
                continue
            vertex = table[:, 0].astype(np.int64)
            wrong = np.nonzero((table[:, 0] != vertex) | (vertex < 0) | (vertex >= vertex_count))[0]
            if len(wrong):
                Json(None, f"{item.where}[{wrong[0]}]").fail(
                    f"vertex {table[wrong[0], 0]:g} does not exist; the mesh has {vertex_count}"
                )
            negative = np.nonzero(table[:, 1] < 0)[0]
            if len(negative):
                Json(None, f"{item.where}[{negative[0]}]").fail(f"weight {table[negative[0], 1]:g} is negative")
            owners.append(np.full(len(table), place[name]))
            vertices.append(vertex)
            weights.append(table[:, 1])
    except FormatError as error:
        raise error.at(path) from None
    if not owners:
        raise FormatError("no weight is of a bone of the skeleton", path=path)
    return np.concatenate(owners), np.concatenate(vertices), np.concatenate(weights), strangers


def _pairs(item: Json) -> Floats:
    rows = item.value
    if not isinstance(rows, list):
        item.fail("expected a list of vertices and weights")
    for index, row in enumerate(rows):
        ok = isinstance(row, list) and len(row) == 2
        if not ok or any(type(v) not in (int, float) or not abs(v) < _LARGEST for v in row):
            Json(row, f"{item.where}[{index}]").fail("expected a vertex and its weight")
    return np.array(rows, np.float64).reshape(-1, 2)


def read_target(path: Path, vertex_count: int) -> tuple[Ints, Floats]:
    """Vertices (N,) and deltas (N, 3) of a .target file; a vertex named twice moves by the sum.

    Raises:
        FormatError: at the first line that is no vertex and its delta.
    """
    size = path.stat().st_size
    if size > LARGEST_BYTES:
        raise FormatError(f"{size >> 20} MiB; at most {LARGEST_BYTES >> 20} MiB are read", path=path)
    data = path.read_bytes()
    at = 0
    while data[at : at + 1] in (b"#", b"\n", b"\r"):  # remarks come first
        end = data.find(b"\n", at)
        at = len(data) if end < 0 else end + 1
    values, wrong = parse_block(data, at, len(data))
    lines = [line for line in data[at:].splitlines() if line.strip()]
    if wrong >= 0 or values.size != 4 * len(lines) or any(len(line.split()) != 4 for line in lines):
        table = _target_lines(data, at, path)
    else:
        table = values.reshape(-1, 4)
    if np.any(np.abs(table) > _LARGEST):
        raise FormatError("a number is too large", path=path)
    vertices = table[:, 0].astype(np.int64)
    bad = np.nonzero((vertices != table[:, 0]) | (vertices < 0) | (vertices >= vertex_count))[0]
    if len(bad):
        raise FormatError(
            f"vertex {table[bad[0], 0]:g} of row {bad[0] + 1} does not exist; the mesh has {vertex_count}", path=path
        )
    unique, inverse = np.unique(vertices, return_inverse=True)
    deltas = np.zeros((len(unique), 3))
    np.add.at(deltas, inverse, table[:, 1:])
    return unique, deltas


def _target_lines(data: bytes, at: int, path: Path) -> Floats:
    rows: list[list[float]] = []
    start = line_of(data, at)
    for number, line in enumerate(data[at:].replace(b"\r\n", b"\n").replace(b"\r", b"\n").split(b"\n")):
        words = line.partition(b"#")[0].split()
        if not words:
            continue
        where = f"line {start + number}"
        if len(words) != 4:
            raise FormatError(f"expected a vertex and three numbers, got {len(words)} words", where=where, path=path)
        try:
            rows.append([to_number(word.decode("latin-1"), _LARGEST) for word in words])
        except ValueError:
            raise FormatError(
                f"expected a vertex and three numbers, got {shown(line.strip())}", where=where, path=path
            ) from None
    return np.array(rows, np.float64).reshape(-1, 4)


def read_pose_names(path: Path) -> tuple[list[str], str]:
    """The names of the frames of a file of pose units, and the animation file it names."""
    root = read_json(path)
    try:
        root.need("framemapping")
        names = [item.value for item in root.items("framemapping")]
        wrong = next((i for i, name in enumerate(names) if not isinstance(name, str)), None)
        if wrong is not None:
            Json(None, f"framemapping[{wrong}]").fail("expected a name")
        return [str(name) for name in names], root.text("animation_file", "")
    except FormatError as error:
        raise error.at(path) from None
