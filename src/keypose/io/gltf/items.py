"""The typed items of a glTF 2.0 document: what the JSON says, checked, with indices still as they are in the file.

Source: Khronos Group, glTF 2.0 Specification, sections 3 and 5.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from keypose.io.json_values import Json

COMPONENTS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
PATHS = ("translation", "rotation", "scale", "weights")
INTERPOLATIONS = ("STEP", "LINEAR", "CUBICSPLINE")


@dataclass(frozen=True, slots=True)
class Compressed:
    """A buffer view packed by meshoptimizer."""

    buffer: int
    offset: int
    length: int
    stride: int
    count: int
    mode: str  # ATTRIBUTES, TRIANGLES, INDICES
    filter: str  # NONE, OCTAHEDRAL, QUATERNION, EXPONENTIAL, COLOR


@dataclass(slots=True)  # thousands are made of these; frozen ones take four times as long
class BufferView:
    """A range of a buffer."""

    buffer: int
    offset: int
    length: int
    stride: int | None
    compressed: Compressed | None
    where: str


@dataclass(frozen=True, slots=True)
class Buffer:
    """Raw bytes: of the GLB file itself, embedded, or beside it."""

    uri: str | None
    length: int
    fallback: bool  # a place-holder for data that is really compressed
    where: str


@dataclass(slots=True)
class Sparse:
    """Elements that replace those of an accessor."""

    count: int
    indices_view: int
    indices_offset: int
    indices_type: str
    values_view: int
    values_offset: int
    where: str


@dataclass(slots=True)  # thousands are made of these; frozen ones take four times as long
class Accessor:
    """Typed elements within a buffer view."""

    view: int | None
    offset: int
    count: int
    component: str  # NumPy type
    kind: str  # SCALAR .. MAT4
    normalized: bool
    sparse: Sparse | None
    where: str


@dataclass(frozen=True, slots=True)
class Node:
    """A node of the hierarchy; ``rotation`` is xyzw as in the file."""

    name: str
    children: tuple[int, ...]
    mesh: int | None
    skin: int | None
    translation: tuple[float, ...] | None
    rotation: tuple[float, ...] | None
    scale: tuple[float, ...] | None
    matrix: tuple[float, ...] | None
    weights: tuple[float, ...] | None
    extras: Mapping[str, Any]
    others: tuple[str, ...]  # camera, light and further extensions it carries
    where: str


@dataclass(frozen=True, slots=True)
class Draco:
    """The compressed form of a primitive."""

    view: int
    attributes: Mapping[str, int]  # unique id of the compressed attribute
    where: str


@dataclass(frozen=True, slots=True)
class Primitive:
    """Triangles of one material."""

    attributes: Mapping[str, int]
    indices: int | None
    material: int | None
    mode: int
    targets: tuple[Mapping[str, int], ...]
    draco: Draco | None
    extras: Mapping[str, Any]
    where: str


@dataclass(frozen=True, slots=True)
class MeshItem:
    """A mesh of one or several primitives that share their morph targets."""

    name: str
    primitives: tuple[Primitive, ...]
    weights: tuple[float, ...] | None
    target_names: tuple[str, ...] | None
    extras: Mapping[str, Any]
    where: str


@dataclass(frozen=True, slots=True)
class SkinItem:
    """The joints of a skin and where their inverse bind matrices lie."""

    name: str
    joints: tuple[int, ...]
    inverse_bind: int | None
    where: str


@dataclass(slots=True)  # thousands are made of these; frozen ones take four times as long
class Sampler:
    """Keyframes."""

    input: int
    output: int
    interpolation: str
    where: str


@dataclass(slots=True)  # thousands are made of these; frozen ones take four times as long
class Target:
    """What a sampler drives; ``node`` is None where an extension says what."""

    sampler: int
    node: int | None
    path: str
    where: str


@dataclass(frozen=True, slots=True)
class Animation:
    """One clip."""

    name: str
    samplers: tuple[Sampler, ...]
    targets: tuple[Target, ...]
    extras: Mapping[str, Any]
    where: str


@dataclass(frozen=True, slots=True)
class ImageItem:
    """A picture by URI or buffer view."""

    name: str
    uri: str | None
    view: int | None
    mime_type: str
    where: str


@dataclass(frozen=True, slots=True)
class Texture:
    """An image with its sampler's settings."""

    image: int | None
    sampler: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class SceneItem:
    """Roots that belong together."""

    name: str
    nodes: tuple[int, ...]
    extras: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Document:
    """All of a file's JSON that keypose understands."""

    asset: Mapping[str, Any]
    used: tuple[str, ...]
    required: tuple[str, ...]
    buffers: tuple[Buffer, ...]
    views: tuple[BufferView, ...]
    accessors: tuple[Accessor, ...]
    images: tuple[ImageItem, ...]
    textures: tuple[Texture, ...]
    materials: tuple[Json, ...]
    meshes: tuple[MeshItem, ...]
    skins: tuple[SkinItem, ...]
    nodes: tuple[Node, ...]
    scenes: tuple[SceneItem, ...]
    scene: int | None
    animations: tuple[Animation, ...]
    extensions: Mapping[str, Any]
    extras: Mapping[str, Any]
    cameras: int
