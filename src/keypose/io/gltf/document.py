"""The JSON of a glTF 2.0 file as typed items; every wrong field is refused by its name.

Source: Khronos Group, glTF 2.0 Specification, sections 3 and 5.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, TypeVar, cast

from keypose.errors import FormatError
from keypose.io.gltf.items import (
    COMPONENTS,
    INTERPOLATIONS,
    PATHS,
    WIDTHS,
    Accessor,
    Animation,
    Buffer,
    BufferView,
    Compressed,
    Document,
    Draco,
    ImageItem,
    MeshItem,
    Node,
    Primitive,
    Sampler,
    SceneItem,
    SkinItem,
    Sparse,
    Target,
    Texture,
)
from keypose.io.json_values import LARGEST, Json

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
    used = root.texts("extensionsUsed")
    required = root.texts("extensionsRequired")
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
        views=_quickly(root, "bufferViews", sizes, _plain_view, _view),
        accessors=_quickly(root, "accessors", sizes, _plain_accessor, _accessor),
        images=each("images", _image),
        textures=tuple(_texture(item, sizes, samplers) for item in root.items("textures")),
        materials=tuple(root.items("materials")),
        meshes=each("meshes", _mesh),
        skins=each("skins", _skin),
        nodes=_quickly(root, "nodes", sizes, _plain_node, _node),
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


def _quickly(
    root: Json,
    key: str,
    sizes: Mapping[str, int],
    plain: Callable[[dict[str, Any], str, Mapping[str, int]], _T | None],
    careful: Callable[[Json, Mapping[str, int]], _T],
) -> tuple[_T, ...]:
    """A long list: items as nearly all are take a short way; what that does not know is judged by the careful one."""
    member = root.get(key)
    if member is None or not isinstance(member.value, list):
        return tuple(careful(item, sizes) for item in root.items(key))
    values = cast("list[Any]", member.value)
    prefix = f"{member.where}["
    made: list[_T] = []
    for index, value in enumerate(values):
        where = f"{prefix}{index}]"
        try:
            item = plain(value, where, sizes)
        except (AttributeError, TypeError, KeyError):  # no object, or a list for a name
            item = None
        made.append(careful(Json(value, where), sizes) if item is None else item)
    return tuple(made)


def _plain_view(value: dict[str, Any], where: str, sizes: Mapping[str, int]) -> BufferView | None:
    get = value.get
    buffer, offset, length, stride = get("buffer"), get("byteOffset", 0), get("byteLength"), get("byteStride")
    if type(buffer) is int and type(offset) is int and type(length) is int and "extensions" not in value:
        sound = 0 <= buffer < sizes["buffers"] and 0 <= offset < LARGEST and 0 <= length < LARGEST
        if sound and ((stride is None and "byteStride" not in value) or (type(stride) is int and 0 < stride < 256)):
            return BufferView(buffer, offset, length, stride, None, where)
    return None


def _plain_accessor(value: dict[str, Any], where: str, sizes: Mapping[str, int]) -> Accessor | None:
    get = value.get
    view, offset, count, kind = get("bufferView"), get("byteOffset", 0), get("count"), value["type"]
    if type(offset) is not int or type(count) is not int or kind not in WIDTHS or "normalized" in value:
        return None
    sparse = None
    if "sparse" in value:
        sparse = _plain_sparse(value["sparse"], where, sizes["bufferViews"])
        if sparse is None:
            return None
    if type(view) is int:
        if not 0 <= view < sizes["bufferViews"]:
            return None
    elif "bufferView" in value:
        return None
    if 0 <= offset < LARGEST and 0 < count < LARGEST:
        return Accessor(view, offset, count, COMPONENTS[value["componentType"]], kind, False, sparse, where)
    return None


def _plain_sparse(value: dict[str, Any], where: str, views: int) -> Sparse | None:
    indices, values, count = value["indices"], value["values"], value["count"]
    component = COMPONENTS[indices["componentType"]]
    places = (indices["bufferView"], indices.get("byteOffset", 0), values["bufferView"], values.get("byteOffset", 0))
    if "u" not in component or not all(type(number) is int and 0 <= number < LARGEST for number in (count, *places)):
        return None
    if places[0] >= views or places[2] >= views:
        return None
    return Sparse(count, places[0], places[1], component, places[2], places[3], f"{where}.sparse")


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


def _plain_node(value: dict[str, Any], where: str, sizes: Mapping[str, int]) -> Node | None:
    """A joint: a name, children, translation, rotation and scale."""
    if not value.keys() <= _JOINT_KEYS:
        return None
    get = value.get
    name, children, extras, count = get("name", ""), get("children", []), get("extras", {}), sizes["nodes"]
    if (
        type(name) is not str
        or type(children) is not list
        or type(extras) is not dict
        or not all(type(c) is int and 0 <= c < count for c in children)
    ):
        return None
    parts = [get(key) for key in ("translation", "rotation", "scale")]
    for key, part, width in zip(("translation", "rotation", "scale"), parts, (3, 4, 3), strict=True):
        if part is None:
            if key in value:
                return None
        elif (
            type(part) is not list
            or len(part) != width
            or not all(type(v) in (int, float) and -1e30 < v < 1e30 for v in part)
        ):
            return None
    t, r, s = (None if part is None else tuple(map(float, part)) for part in parts)
    return Node(name, tuple(children), None, None, t, r, s, None, None, extras, (), where)


_JOINT_KEYS = {"name", "children", "translation", "rotation", "scale", "extras"}


def _scene(item: Json, sizes: Mapping[str, int]) -> SceneItem:
    return SceneItem(item.text("name", ""), item.indices("nodes", sizes["nodes"], "node"), item.extras())


def _animation(item: Json, sizes: Mapping[str, int]) -> Animation:
    samplers = _quickly(item, "samplers", sizes, _plain_sampler, _sampler)
    counts = {**sizes, "own": len(samplers)}
    targets = _quickly(item, "channels", counts, _plain_target, _target)
    return Animation(item.text("name", ""), samplers, targets, item.extras(), item.where)


def _plain_target(value: dict[str, Any], where: str, counts: Mapping[str, int]) -> Target | None:
    target = value["target"]
    sampler, path, node = value["sampler"], target["path"], target["node"]
    if type(sampler) is int and 0 <= sampler < counts["own"] and type(node) is int and 0 <= node < counts["nodes"]:
        return Target(sampler, node, path, where) if path in PATHS else None
    return None


def _target(channel: Json, counts: Mapping[str, int]) -> Target:
    target = channel.need("target")
    path = target.text("path")
    node = target.index("node", counts["nodes"], "node")
    if path not in PATHS and node is not None:
        target.fail(f"expected a path of {', '.join(PATHS)}, got '{path[:40]}'")
    sampler = channel.need("sampler").as_integer(0, counts["own"], "sampler")
    return Target(sampler, node, path, channel.where)


def _plain_sampler(value: dict[str, Any], where: str, sizes: Mapping[str, int]) -> Sampler | None:
    times, values, mode = value["input"], value["output"], value.get("interpolation", "LINEAR")
    count = sizes["accessors"]
    if (
        type(times) is int
        and type(values) is int
        and 0 <= times < count
        and 0 <= values < count
        and mode in INTERPOLATIONS
    ):
        return Sampler(times, values, mode, where)
    return None


def _sampler(item: Json, sizes: Mapping[str, int]) -> Sampler:
    interpolation = item.text("interpolation", "LINEAR")
    if interpolation not in INTERPOLATIONS:
        item.fail(f"expected an interpolation of STEP, LINEAR or CUBICSPLINE, got '{interpolation[:40]}'")
    return Sampler(
        input=item.to("input", sizes["accessors"], "accessor"),
        output=item.to("output", sizes["accessors"], "accessor"),
        interpolation=interpolation,
        where=item.where,
    )
