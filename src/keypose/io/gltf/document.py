"""The typed model of a glTF 2.0 document: what the JSON says, checked, with indices still as they are in the file.

Source: Khronos Group, glTF 2.0 Specification, sections 3 and 5.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

from keypose.errors import FormatError
from keypose.io.json_values import Json

COMPONENTS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
PATHS = ("translation", "rotation", "scale", "weights")

# Extensions that are understood, or that change nothing that keypose reads.
SUPPORTED = {
    "EXT_meshopt_compression",
    "EXT_texture_webp",
    "KHR_animation_pointer",
    "KHR_draco_mesh_compression",
    "KHR_lights_punctual",
    "KHR_mesh_quantization",
    "KHR_meshopt_compression",
    "KHR_texture_basisu",
    "KHR_texture_transform",
    "KHR_xmp_json_ld",
    "VRM",
}
SUPPORTED_PREFIXES = ("KHR_materials_", "VRMC_")

MESHOPT = ("EXT_meshopt_compression", "KHR_meshopt_compression")


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


@dataclass(frozen=True, slots=True)
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


@dataclass(frozen=True, slots=True)
class Sparse:
    """Elements that replace those of an accessor."""

    count: int
    indices_view: int
    indices_offset: int
    indices_type: str
    values_view: int
    values_offset: int
    where: str


@dataclass(frozen=True, slots=True)
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


@dataclass(frozen=True, slots=True)
class Sampler:
    """Keyframes."""

    input: int
    output: int
    interpolation: str
    where: str


@dataclass(frozen=True, slots=True)
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


_T = TypeVar("_T")


def parse(root: Json) -> Document:
    """The document of a glTF file's JSON.

    Raises:
        FormatError: where a field is missing, has the wrong type or points at nothing, or the file needs an
            extension that is not supported.
    """
    asset = root.need("asset")
    version = asset.need("version").value
    if not isinstance(version, str) or version.split(".")[0] != "2":
        raise FormatError(f"expected glTF version 2, got {str(version)[:20]!r}", where="asset.version")
    used = _texts(root, "extensionsUsed")
    required = _texts(root, "extensionsRequired")
    unknown = [n for n in required if n not in SUPPORTED and not n.startswith(SUPPORTED_PREFIXES)]
    if unknown:
        names = ", ".join(unknown)
        raise FormatError(f"the file requires what is not supported: {names}", where="extensionsRequired")

    sizes = {key: len(root.items(key)) for key in _LISTS}

    def each(key: str, build: Callable[[Json, Mapping[str, int]], _T]) -> tuple[_T, ...]:
        return tuple(build(item, sizes) for item in root.items(key))

    samplers = [dict(item.object()) for item in root.items("samplers")]
    extensions = root.get("extensions")
    return Document(
        asset=asset.object(),
        used=used,
        required=required,
        buffers=each("buffers", _buffer),
        views=each("bufferViews", _view),
        accessors=each("accessors", _accessor),
        images=each("images", _image),
        textures=tuple(_texture(item, sizes, samplers) for item in root.items("textures")),
        materials=tuple(root.items("materials")),
        meshes=each("meshes", _mesh),
        skins=each("skins", _skin),
        nodes=each("nodes", _node),
        scenes=each("scenes", _scene),
        scene=root.index("scene", sizes["scenes"], "scene"),
        animations=each("animations", _animation),
        extensions={} if extensions is None else extensions.object(),
        extras=root.extras(),
        cameras=len(root.items("cameras")),
    )


_LISTS = [
    "accessors",
    "animations",
    "buffers",
    "bufferViews",
    "images",
    "materials",
    "meshes",
    "nodes",
    "samplers",
    "scenes",
    "skins",
    "textures",
]


def _texts(item: Json, key: str) -> tuple[str, ...]:
    for element in item.items(key):
        if not isinstance(element.value, str):
            element.fail("expected a text")
    return tuple(element.value for element in item.items(key))


def _extension(item: Json, *names: str) -> Json | None:
    extensions = item.get("extensions")
    if extensions is not None:
        for name in names:
            found = extensions.get(name)
            if found is not None:
                found.object()
                return found
    return None


def _buffer(item: Json, sizes: Mapping[str, int]) -> Buffer:
    uri = item.text("uri") if "uri" in item.object() else None
    packed = _extension(item, *MESHOPT)
    return Buffer(uri, item.integer("byteLength"), packed is not None and packed.flag("fallback"), item.where)


def _view(item: Json, sizes: Mapping[str, int]) -> BufferView:
    packed = _extension(item, *MESHOPT)
    return BufferView(
        buffer=item.to("buffer", sizes["buffers"], "buffer"),
        offset=item.integer("byteOffset", 0),
        length=item.integer("byteLength"),
        stride=item.integer("byteStride", least=1, limit=256) if "byteStride" in item.object() else None,
        compressed=None if packed is None else _compressed(packed, sizes),
        where=item.where,
    )


def _compressed(item: Json, sizes: Mapping[str, int]) -> Compressed:
    mode, filter = item.text("mode"), item.text("filter", "NONE")
    if mode not in ("ATTRIBUTES", "TRIANGLES", "INDICES"):
        item.fail(f"unknown mode '{mode[:40]}'")
    if filter not in ("NONE", "OCTAHEDRAL", "QUATERNION", "EXPONENTIAL", "COLOR"):
        item.fail(f"unknown filter '{filter[:40]}'")
    return Compressed(
        buffer=item.to("buffer", sizes["buffers"], "buffer"),
        offset=item.integer("byteOffset", 0),
        length=item.integer("byteLength"),
        stride=item.integer("byteStride", least=1, limit=257),
        count=item.integer("count"),
        mode=mode,
        filter=filter,
    )


def _component(item: Json) -> str:
    number = item.integer("componentType")
    if number not in COMPONENTS:
        item.need("componentType").fail(f"expected one of {', '.join(map(str, COMPONENTS))}, got {number}")
    return COMPONENTS[number]


def _accessor(item: Json, sizes: Mapping[str, int]) -> Accessor:
    kind = item.text("type")
    if kind not in WIDTHS:
        item.fail(f"expected a type of {', '.join(WIDTHS)}, got '{kind[:40]}'")
    sparse = item.get("sparse")
    return Accessor(
        view=item.index("bufferView", sizes["bufferViews"], "buffer view"),
        offset=item.integer("byteOffset", 0),
        count=item.integer("count", least=1),
        component=_component(item),
        kind=kind,
        normalized=item.flag("normalized"),
        sparse=None if sparse is None else _sparse(sparse, sizes),
        where=item.where,
    )


def _sparse(item: Json, sizes: Mapping[str, int]) -> Sparse:
    indices, values = item.need("indices"), item.need("values")
    component = _component(indices)
    if "u" not in component:
        indices.fail("expected an unsigned component type")
    return Sparse(
        count=item.integer("count"),
        indices_view=indices.to("bufferView", sizes["bufferViews"], "buffer view"),
        indices_offset=indices.integer("byteOffset", 0),
        indices_type=component,
        values_view=values.to("bufferView", sizes["bufferViews"], "buffer view"),
        values_offset=values.integer("byteOffset", 0),
        where=item.where,
    )


def _image(item: Json, sizes: Mapping[str, int]) -> ImageItem:
    uri = item.text("uri") if "uri" in item.object() else None
    view = item.index("bufferView", sizes["bufferViews"], "buffer view")
    return ImageItem(item.text("name", ""), uri, view, item.text("mimeType", ""), item.where)


def _texture(item: Json, sizes: Mapping[str, int], samplers: list[dict[str, Any]]) -> Texture:
    image = item.index("source", sizes["images"], "image")
    other = _extension(item, "EXT_texture_webp", "KHR_texture_basisu")
    if image is None and other is not None:
        image = other.index("source", sizes["images"], "image")
    sampler = item.index("sampler", sizes["samplers"], "sampler")
    return Texture(image, {} if sampler is None else samplers[sampler])


def _attributes(item: Json, sizes: Mapping[str, int]) -> dict[str, int]:
    return {name: value.as_integer(0, sizes["accessors"], "accessor") for name, value in _members(item)}


def _members(item: Json) -> list[tuple[str, Json]]:
    return [(name, item.need(name)) for name in item.object()]


def _primitive(item: Json, sizes: Mapping[str, int]) -> Primitive:
    packed = _extension(item, "KHR_draco_mesh_compression")
    return Primitive(
        attributes=_attributes(item.need("attributes"), sizes),
        indices=item.index("indices", sizes["accessors"], "accessor"),
        material=item.index("material", sizes["materials"], "material"),
        mode=item.integer("mode", 4, limit=7),
        targets=tuple(_attributes(target, sizes) for target in item.items("targets")),
        draco=None if packed is None else _draco(packed, sizes),
        extras=item.extras(),
        where=item.where,
    )


def _draco(item: Json, sizes: Mapping[str, int]) -> Draco:
    return Draco(
        view=item.to("bufferView", sizes["bufferViews"], "buffer view"),
        attributes={name: value.as_integer() for name, value in item.members("attributes")},
        where=item.where,
    )


def _mesh(item: Json, sizes: Mapping[str, int]) -> MeshItem:
    primitives = tuple(_primitive(p, sizes) for p in item.items("primitives"))
    if len({len(p.targets) for p in primitives}) > 1:
        item.fail("its primitives have different numbers of morph targets")
    extras = item.extras()
    names = extras.get("targetNames")
    if not isinstance(names, list) or not all(isinstance(n, str) for n in names):
        names = None
    return MeshItem(
        name=item.text("name", ""),
        primitives=primitives,
        weights=item.numbers("weights", None),
        target_names=None if names is None else tuple(names),
        extras={k: v for k, v in extras.items() if k != "targetNames"},
        where=item.where,
    )


def _skin(item: Json, sizes: Mapping[str, int]) -> SkinItem:
    joints = item.indices("joints", sizes["nodes"], "node")
    if not joints:
        item.fail("a skin needs joints")
    inverse_bind = item.index("inverseBindMatrices", sizes["accessors"], "accessor")
    return SkinItem(item.text("name", ""), joints, inverse_bind, item.where)


def _node(item: Json, sizes: Mapping[str, int]) -> Node:
    extensions = item.get("extensions")
    others = [] if extensions is None else list(extensions.object())
    return Node(
        name=item.text("name", ""),
        children=item.indices("children", sizes["nodes"], "node"),
        mesh=item.index("mesh", sizes["meshes"], "mesh"),
        skin=item.index("skin", sizes["skins"], "skin"),
        translation=item.numbers("translation", 3),
        rotation=item.numbers("rotation", 4),
        scale=item.numbers("scale", 3),
        matrix=item.numbers("matrix", 16),
        weights=item.numbers("weights", None),
        extras=item.extras(),
        others=(*(["camera"] if "camera" in item.object() else []), *others),
        where=item.where,
    )


def _scene(item: Json, sizes: Mapping[str, int]) -> SceneItem:
    return SceneItem(item.text("name", ""), item.indices("nodes", sizes["nodes"], "node"), item.extras())


def _animation(item: Json, sizes: Mapping[str, int]) -> Animation:
    samplers = tuple(_sampler(s, sizes) for s in item.items("samplers"))
    targets: list[Target] = []
    for channel in item.items("channels"):
        target = channel.need("target")
        path = target.text("path")
        node = target.index("node", sizes["nodes"], "node")
        if path not in PATHS and node is not None:
            target.fail(f"expected a path of {', '.join(PATHS)}, got '{path[:40]}'")
        sampler = channel.need("sampler").as_integer(0, len(samplers), "sampler")
        targets.append(Target(sampler, node, path, channel.where))
    return Animation(item.text("name", ""), samplers, tuple(targets), item.extras(), item.where)


def _sampler(item: Json, sizes: Mapping[str, int]) -> Sampler:
    interpolation = item.text("interpolation", "LINEAR")
    if interpolation not in ("STEP", "LINEAR", "CUBICSPLINE"):
        item.fail(f"expected an interpolation of STEP, LINEAR or CUBICSPLINE, got '{interpolation[:40]}'")
    return Sampler(
        input=item.to("input", sizes["accessors"], "accessor"),
        output=item.to("output", sizes["accessors"], "accessor"),
        interpolation=interpolation,
        where=item.where,
    )
