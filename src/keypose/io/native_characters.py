"""Characters as JSON beside arrays: skeleton, parts, skins, morphs, materials and pictures, bit for bit.

Skins and pictures that several parts share are stored once. What a file said beyond our model (``extras``) is kept where it
consists of texts, numbers, truths, bytes, arrays, lists and mappings of texts.
"""

from __future__ import annotations

import base64
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from keypose.io.json_values import Json
from keypose.io.native_values import Fetch, Store, built
from keypose.model import (
    Character,
    Image,
    Material,
    Mesh,
    MorphSet,
    Part,
    Pose,
    Skeleton,
    Skin,
)

_DEEPEST = 24  # of extras; deeper ones are left out
_MARKS = ("$array", "$bytes", "$tuple", "$map")


def character_json(character: Character, store: Store) -> dict[str, Any]:
    """A character with all that hangs on it."""
    shared = _Shared(store)
    parts = [_part_json(part, shared) for part in character.parts]
    return {
        "name": character.name,
        "skeleton": _skeleton_json(character.skeleton, store),
        "parts": parts,
        "skins": shared.skins,
        "images": shared.images,
        "morph_names": list(character.morph_names),
        "rest_morph_weights": store(character.rest_morph_weights),
        "roles": {role: int(joint) for role, joint in character.roles.items()},
        "extras": _kept(character.extras, store),
    }


def read_character(item: Json, fetch: Fetch) -> Character:
    """A character; raises `FormatError` naming the place."""
    skins = [_read_skin(each, fetch) for each in item.items("skins")]
    images = [_read_image(each, fetch) for each in item.items("images")]
    skeleton = _read_skeleton(item.need("skeleton"), fetch)
    parts = [_read_part(each, fetch, skins, images) for each in item.items("parts")]
    roles = {role: joint.as_integer() for role, joint in item.members("roles")}
    return built(
        item,
        lambda: Character(
            skeleton,
            tuple(parts),
            item.text("name"),
            item.texts("morph_names"),
            fetch(item.need("rest_morph_weights")),
            roles,
            _extras(item, fetch),
        ),
    )


class _Shared:
    """Skins and pictures by identity."""

    def __init__(self, store: Store) -> None:
        self.store = store
        self.skins: list[dict[str, Any]] = []
        self.images: list[dict[str, Any]] = []
        self._numbers: dict[int, int] = {}

    def skin(self, skin: Skin | None) -> int | None:
        if skin is None:
            return None
        if id(skin) not in self._numbers:
            self._numbers[id(skin)] = len(self.skins)
            self.skins.append(
                {
                    "palette": self.store(skin.palette),
                    "joint_from_mesh": self.store(skin.joint_from_mesh),
                    "joints": self.store(skin.joints),
                    "weights": self.store(skin.weights),
                    "method": str(skin.method),
                }
            )
        return self._numbers[id(skin)]

    def image(self, image: Image | None) -> int | None:
        if image is None:
            return None
        if id(image) not in self._numbers:
            self._numbers[id(image)] = len(self.images)
            data = None if image.data is None else self.store(np.frombuffer(image.data, np.uint8))
            self.images.append({"name": image.name, "mime_type": image.mime_type, "data": data})
        return self._numbers[id(image)]


# ---- parts -------------------------------------------------------------------------------------------------------------


def _skeleton_json(skeleton: Skeleton, store: Store) -> dict[str, Any]:
    rest = skeleton.rest
    return {
        "names": list(skeleton.names),
        "parents": store(skeleton.parents),
        "translations": store(rest.translations),
        "rotations": store(rest.rotations),
        "scales": store(rest.scales),
        "end_offsets": [[int(joint), [float(x) for x in offset]] for joint, offset in skeleton.end_offsets],
    }


def _read_skeleton(item: Json, fetch: Fetch) -> Skeleton:
    names = item.texts("names")
    ends: list[tuple[int, tuple[float, float, float]]] = []
    for each in item.items("end_offsets"):
        pair = Json({"end": each.value}, each.where).items("end")
        if len(pair) != 2:
            each.fail("expected a joint and an offset")
        offset = Json({"offset": pair[1].value}, pair[1].where).numbers("offset", 3) or (0.0, 0.0, 0.0)
        ends.append((pair[0].as_integer(0, len(names), "joint"), (offset[0], offset[1], offset[2])))
    arrays = {name: fetch(item.need(name)) for name in ("parents", "translations", "rotations", "scales")}
    return built(
        item,
        lambda: Skeleton(
            names,
            arrays["parents"],
            Pose(arrays["translations"], arrays["rotations"], arrays["scales"]),
            tuple(ends),
        ),
    )


def _part_json(part: Part, shared: _Shared) -> dict[str, Any]:
    store, mesh = shared.store, part.mesh
    return {
        "name": part.name,
        "mesh": {
            "positions": store(mesh.positions),
            "triangles": store(mesh.triangles),
            **{name: _optional(getattr(mesh, name), store) for name in ("normals", "uvs", "colors")},
            "attributes": {name: store(array) for name, array in mesh.attributes.items()},
        },
        "material": _material_json(part.material, shared),
        "skin": shared.skin(part.skin),
        "joint": part.joint,
        "morphs": None if part.morphs is None else _morphs_json(part.morphs, store),
        "morph_channels": _optional(part.morph_channels, store),
        "group": part.group,
        "extras": _kept(part.extras, store),
    }


def _read_part(item: Json, fetch: Fetch, skins: Sequence[Skin], images: Sequence[Image]) -> Part:
    mesh = item.need("mesh")
    arrays = {name: _maybe(mesh, name, fetch) for name in ("normals", "uvs", "colors")}
    attributes = {name: fetch(array) for name, array in mesh.members("attributes")}
    positions, triangles = fetch(mesh.need("positions")), fetch(mesh.need("triangles"))
    material = _read_material(item.need("material"), fetch, images)
    skin, joint = _number(item, "skin", len(skins), "skin"), _number(item, "joint")
    morphs = item.get("morphs")
    targets = None if morphs is None or morphs.value is None else _read_morphs(morphs, fetch)
    channels = _maybe(item, "morph_channels", fetch)
    return built(
        item,
        lambda: Part(
            item.text("name"),
            Mesh(positions, triangles, attributes=attributes, **arrays),
            material,
            None if skin is None else skins[skin],
            joint,
            targets,
            channels,
            item.integer("group"),
            _extras(item, fetch),
        ),
    )


def _material_json(material: Material, shared: _Shared) -> dict[str, Any]:
    return {
        "name": material.name,
        "base_color": [float(c) for c in material.base_color],
        "metallic": float(material.metallic),
        "roughness": float(material.roughness),
        "emissive": [float(c) for c in material.emissive],
        "base_color_image": shared.image(material.base_color_image),
        "alpha_mode": material.alpha_mode,
        "alpha_cutoff": float(material.alpha_cutoff),
        "double_sided": bool(material.double_sided),
        "unlit": bool(material.unlit),
        "extras": _kept(material.extras, shared.store),
    }


def _read_material(item: Json, fetch: Fetch, images: Sequence[Image]) -> Material:
    color, emissive = item.numbers("base_color", 4), item.numbers("emissive", 3)
    if color is None or emissive is None:
        item.fail("'base_color' or 'emissive' is missing")
    image = _number(item, "base_color_image", len(images), "picture")
    return Material(
        item.text("name"),
        (color[0], color[1], color[2], color[3]),
        item.need("metallic").as_number(),
        item.need("roughness").as_number(),
        (emissive[0], emissive[1], emissive[2]),
        None if image is None else images[image],
        item.text("alpha_mode"),
        item.need("alpha_cutoff").as_number(),
        item.flag("double_sided"),
        item.flag("unlit"),
        _extras(item, fetch),
    )


def _morphs_json(morphs: MorphSet, store: Store) -> dict[str, Any]:
    return {
        "names": list(morphs.names),
        "starts": store(morphs.starts),
        "vertices": store(morphs.vertices),
        "position_deltas": store(morphs.position_deltas),
        "normal_deltas": _optional(morphs.normal_deltas, store),
    }


def _read_morphs(item: Json, fetch: Fetch) -> MorphSet:
    starts, vertices, deltas = (fetch(item.need(name)) for name in ("starts", "vertices", "position_deltas"))
    normals = _maybe(item, "normal_deltas", fetch)
    return built(item, lambda: MorphSet(item.texts("names"), starts, vertices, deltas, normals))


def _read_skin(item: Json, fetch: Fetch) -> Skin:
    names = ("palette", "joint_from_mesh", "joints", "weights")
    arrays = [fetch(item.need(name)) for name in names]
    return built(item, lambda: Skin(*arrays, method=item.text("method")))  # pyright: ignore[reportArgumentType]


def _read_image(item: Json, fetch: Fetch) -> Image:
    data = _maybe(item, "data", fetch)
    if data is not None and data.dtype != np.uint8:
        item.need("data").fail(f"expected bytes, got {data.dtype}")
    return Image(item.text("name"), item.text("mime_type"), None if data is None else data.tobytes())


# ---- extras ------------------------------------------------------------------------------------------------------------


def _kept(extras: Mapping[str, Any], store: Store) -> dict[str, Any]:
    """What of the extras can be stored; the rest is left out."""
    kept = {name: _plain(value, store, 0) for name, value in extras.items()}
    return {name: value for name, value in kept.items() if value is not _LOST}


_LOST: Any = object()


def _plain(value: Any, store: Store, depth: int) -> Any:
    if value is None or isinstance(value, (bool, str)):
        return value
    if isinstance(value, (int, np.integer)):
        return int(value) if abs(int(value)) < 2**53 else _LOST
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else _LOST
    if isinstance(value, bytes):
        return {"$bytes": base64.b64encode(value).decode()}
    if isinstance(value, np.ndarray) and value.dtype.kind in "fiu" and value.dtype.itemsize <= 8:
        return {"$array": store(value)} if value.dtype != np.uint64 else _LOST
    if depth >= _DEEPEST:
        return _LOST
    if isinstance(value, Mapping) and all(isinstance(name, str) for name in value):
        members = {name: _plain(each, store, depth + 1) for name, each in value.items()}
        members = {name: each for name, each in members.items() if each is not _LOST}
        return {"$map": members} if any(name in _MARKS for name in members) else members
    if type(value) in (list, tuple):
        items = [_plain(each, store, depth + 1) for each in value]
        if any(each is _LOST for each in items):
            return _LOST
        return items if type(value) is list else {"$tuple": items}
    return _LOST


def _extras(item: Json, fetch: Fetch) -> Mapping[str, Any]:
    return {name: _value(each, fetch) for name, each in item.members("extras")}


def _value(item: Json, fetch: Fetch) -> Any:
    value = item.value
    if isinstance(value, list):
        return [_value(each, fetch) for each in Json({"list": value}, item.where).items("list")]
    if not isinstance(value, dict):
        return value
    if len(value) == 1:
        (mark,) = value
        if mark == "$array":
            return fetch(item.need(mark))
        if mark == "$bytes":
            return _decoded(item)
        if mark == "$tuple":
            return tuple(_value(each, fetch) for each in item.items(mark))
        if mark == "$map":
            return {name: _value(each, fetch) for name, each in item.members(mark)}
    return {name: _value(item.need(name), fetch) for name in value}


def _decoded(item: Json) -> bytes:
    try:
        return base64.b64decode(item.text("$bytes"), validate=True)
    except ValueError:
        item.fail("expected bytes in base64")


# ---- what all use ------------------------------------------------------------------------------------------------------


def _optional(array: Any, store: Store) -> Any:
    return None if array is None else store(array)


def _maybe(item: Json, key: str, fetch: Fetch) -> Any:
    member = item.get(key)
    return None if member is None or member.value is None else fetch(member)


def _number(item: Json, key: str, limit: int | None = None, what: str = "") -> int | None:
    member = item.get(key)
    return None if member is None or member.value is None else member.as_integer(0, limit, what)
