"""Materials, textures and images.

Source: glTF 2.0 Specification, sections 3.8 (images, textures) and 3.9 (materials).
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import PurePosixPath
from typing import Any

from keypose.errors import FormatError
from keypose.io.gltf.accessors import Arrays
from keypose.io.gltf.container import Container, decode_data_uri, is_data_uri, read_beside
from keypose.io.gltf.items import Document, ImageItem
from keypose.io.json_values import Json
from keypose.io.notes import Notes
from keypose.model import Image, Material

LARGEST_IMAGE = 256 << 20
MAGIC = ((b"\x89PNG\r\n\x1a\n", "image/png"), (b"\xff\xd8\xff", "image/jpeg"), (b"\xabKTX 20", "image/ktx2"))


class Materials:
    """The materials of a document, each built once.

    What keypose has no field for stays in ``Material.extras`` under its glTF name, as it was in the file, except that
    a texture's ``index`` becomes ``image`` (an `Image`) and ``sampler`` (its settings).
    """

    def __init__(self, document: Document, arrays: Arrays, container: Container, notes: Notes) -> None:
        self._document, self._arrays, self._container, self._notes = document, arrays, container, notes
        self._built: dict[int | None, Material] = {}
        self._images: dict[int, Image] = {}

    def material(self, index: int | None) -> Material:
        """One material; the format's own default for None."""
        if index not in self._built:
            self._built[index] = (
                Material(base_color=(1.0, 1.0, 1.0, 1.0), metallic=1.0, roughness=1.0)
                if index is None
                else self._build(self._document.materials[index])
            )
        return self._built[index]

    def _build(self, item: Json) -> Material:
        pbr = item.get("pbrMetallicRoughness") or Json({}, f"{item.where}.pbrMetallicRoughness")
        color = pbr.numbers("baseColorFactor", 4) or (1.0, 1.0, 1.0, 1.0)
        emissive = item.numbers("emissiveFactor", 3) or (0.0, 0.0, 0.0)
        texture = pbr.get("baseColorTexture")
        extensions = item.get("extensions")
        alpha_mode = item.text("alphaMode", "OPAQUE")
        if alpha_mode not in ("OPAQUE", "MASK", "BLEND"):
            self._notes.add(f"{item.where}: alpha mode '{alpha_mode[:40]}' is unknown and was taken as OPAQUE")
            alpha_mode = "OPAQUE"
        typed = ("name", "pbrMetallicRoughness", "emissiveFactor", "alphaMode", "alphaCutoff", "doubleSided", "extras")
        extras: dict[str, Any] = {**item.extras()}
        beyond = {k: self._resolved(item.need(k)) for k in item.object() if k not in typed}
        beyond_pbr = {
            k: self._resolved(pbr.need(k))
            for k in pbr.object()
            if k not in ("baseColorFactor", "metallicFactor", "roughnessFactor", "baseColorTexture")
        }
        image = None
        if texture is not None:
            resolved = self._resolved(texture)
            image = resolved.pop("image", None)
            if resolved:
                beyond_pbr["baseColorTexture"] = resolved
        if beyond_pbr:
            beyond["pbrMetallicRoughness"] = beyond_pbr
        if beyond:
            extras["gltf"] = beyond
        return Material(
            name=item.text("name", ""),
            base_color=(color[0], color[1], color[2], color[3]),
            metallic=pbr.number("metallicFactor", 1.0),
            roughness=pbr.number("roughnessFactor", 1.0),
            emissive=(emissive[0], emissive[1], emissive[2]),
            base_color_image=image,
            alpha_mode=alpha_mode,
            alpha_cutoff=item.number("alphaCutoff", 0.5),
            double_sided=item.flag("doubleSided"),
            unlit=extensions is not None and "KHR_materials_unlit" in extensions.object(),
            extras=extras,
        )

    def _resolved(self, item: Json) -> Any:
        """A JSON value whose texture references (objects under a name ending in "Texture") hold their image."""
        value = item.object() if item.where.endswith("Texture") else item.value
        if isinstance(value, list):
            return [self._resolved(Json(v, f"{item.where}[{i}]")) for i, v in enumerate(value)]
        if not isinstance(value, dict):
            return value
        members = {k: self._resolved(item.need(k)) for k in item.object() if k != "extras"}
        if "extras" in value:
            members["extras"] = value["extras"]
        if item.where.endswith("Texture"):
            index = item.need("index").as_integer(0, len(self._document.textures), "texture")
            texture = self._document.textures[index]
            del members["index"]
            if texture.image is not None:
                members["image"] = self.image(texture.image)
            if texture.sampler:
                members["sampler"] = dict(texture.sampler)
        return members

    def image(self, index: int) -> Image:
        """One image with its bytes, or only its name where its file is missing."""
        if index not in self._images:
            self._images[index] = self._load(self._document.images[index])
        return self._images[index]

    def _load(self, item: ImageItem) -> Image:
        if item.view is not None:
            data = bytes(self._arrays.view(item.view))
            self._arrays.take(len(data), item.where)
            return Image(item.name, _mime_type(data, item.mime_type), data)
        if item.uri is None:
            raise FormatError("an image needs a URI or a buffer view", where=item.where)
        if is_data_uri(item.uri):
            kind, data = decode_data_uri(item.uri, item.where)
            return Image(item.name, _mime_type(data, item.mime_type or kind), data)
        name = item.name or PurePosixPath(item.uri).name
        mime_type = _mime_type(b"", item.mime_type, item.uri)
        try:
            found = read_beside(self._container.folder, item.uri, LARGEST_IMAGE, item.where)
        except FormatError as error:
            self._notes.add(f"{item.where}: {error.what}")
            found = None
        else:
            if found is None:
                self._notes.add(f"{item.where}: the picture '{item.uri[:80]}' is missing")
        if found is None:
            return Image(name, mime_type, None)
        self._arrays.take(len(found), item.where)
        return Image(name, _mime_type(found, mime_type), found)


def _mime_type(data: bytes, given: str, uri: str = "") -> str:
    for magic, kind in MAGIC:
        if data.startswith(magic):
            return kind
    if data[:4] == b"RIFF" and data[8:12] == b"WEBP":
        return "image/webp"
    if given:
        return given
    return "image/jpeg" if uri.lower().endswith((".jpg", ".jpeg")) else "image/png"


def unlit_extension(material: Material) -> Mapping[str, Any]:
    """The extensions of a material to write: those it came with, and unlit."""
    kept = material.extras.get("gltf")
    extensions = dict(kept.get("extensions", {})) if isinstance(kept, dict) else {}
    if material.unlit:
        extensions.setdefault("KHR_materials_unlit", {})
    else:
        extensions.pop("KHR_materials_unlit", None)
    return extensions
