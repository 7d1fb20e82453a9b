"""Materials, textures and images for a file that is being written."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any, cast

from keypose.io.gltf.buffers import Buffers
from keypose.io.gltf.materials import unlit_extension
from keypose.io.notes import Notes
from keypose.model import Image, Material

TEXTURE_EXTENSIONS = {"image/webp": "EXT_texture_webp", "image/ktx2": "KHR_texture_basisu"}


def plain_json(value: Any, notes: Notes, what: str) -> Any:
    """``value`` as far as JSON can hold it; the rest is dropped with a note."""
    if value is None or isinstance(value, (str, bool, int)):
        return value
    if isinstance(value, float):
        return value if value - value == 0 else None  # no infinity and no NaN in JSON
    if isinstance(value, Mapping):
        return {str(k): plain_json(v, notes, what) for k, v in cast("Mapping[Any, Any]", value).items()}
    if hasattr(value, "tolist"):
        return plain_json(value.tolist(), notes, what)
    if isinstance(value, Sequence) and not isinstance(value, (bytes, bytearray)):
        return [plain_json(v, notes, what) for v in cast("Sequence[Any]", value)]
    notes.add(f"extras of {what}: a {type(value).__name__} cannot be written and was dropped")
    return None


class MaterialWriter:
    """Collects materials; equal ones are written once."""

    def __init__(self, buffers: Buffers, notes: Notes) -> None:
        self._buffers, self._notes = buffers, notes
        self.materials: list[dict[str, Any]] = []
        self.textures: list[dict[str, Any]] = []
        self.samplers: list[dict[str, Any]] = []
        self.images: list[dict[str, Any]] = []
        self.extensions: set[str] = set()
        self._known: dict[str, int] = {}

    def index(self, material: Material) -> int | None:
        """The number of a material in the file; None for the format's own default."""
        item = self._item(material)
        if not item:
            return None
        return self._once("material", self.materials, item)

    def _once(self, kind: str, items: list[dict[str, Any]], item: dict[str, Any]) -> int:
        key = f"{kind} {json.dumps(item, sort_keys=True)}"
        if key not in self._known:
            self._known[key] = len(items)
            items.append(item)
        return self._known[key]

    def _item(self, material: Material) -> dict[str, Any]:
        what = f"material '{material.name}'"
        kept = cast("Mapping[str, Any]", material.extras.get("gltf", {}))
        beyond = self._written(kept, what)
        pbr = dict(beyond.pop("pbrMetallicRoughness", {}))
        if tuple(material.base_color) != (1.0, 1.0, 1.0, 1.0):
            pbr["baseColorFactor"] = [float(v) for v in material.base_color]
        if material.metallic != 1:
            pbr["metallicFactor"] = float(material.metallic)
        if material.roughness != 1:
            pbr["roughnessFactor"] = float(material.roughness)
        settings = cast("Mapping[str, Any]", kept.get("pbrMetallicRoughness", {})).get("baseColorTexture", {})
        pbr.pop("baseColorTexture", None)
        if material.base_color_image is not None:
            texture = self._written({**settings, "image": material.base_color_image}, f"{what} baseColorTexture")
            if texture:
                pbr["baseColorTexture"] = texture
        item: dict[str, Any] = {"name": material.name} if material.name else {}
        item |= beyond
        if pbr:
            item["pbrMetallicRoughness"] = pbr
        if any(material.emissive):
            item["emissiveFactor"] = [min(max(float(v), 0.0), 1.0) for v in material.emissive]
        if material.alpha_mode != "OPAQUE":
            item["alphaMode"] = material.alpha_mode
        item.pop("alphaCutoff", None)
        if material.alpha_mode == "MASK":
            item["alphaCutoff"] = float(material.alpha_cutoff)
        if material.double_sided:
            item["doubleSided"] = True
        item.pop("extensions", None)
        extensions = self._written(unlit_extension(material), what)
        if extensions:
            item["extensions"] = extensions
            self.extensions.update(extensions)
        extras = {k: v for k, v in material.extras.items() if k != "gltf"}
        if extras:
            item["extras"] = plain_json(extras, self._notes, what)
        return item

    def _written(self, value: Any, what: str) -> Any:
        """JSON with images turned into texture references; a reference to a picture that is not there is dropped."""
        if isinstance(value, Mapping):
            members = dict(cast("Mapping[str, Any]", value))
            if isinstance(members.get("image"), Image):
                texture = self._texture(members.pop("image"), members.pop("sampler", None))
                if texture is None:
                    return None
                self.extensions.update(members.get("extensions", {}))
                return {"index": texture, **{k: self._written(v, what) for k, v in members.items()}}
            written = {k: self._written(v, what) for k, v in members.items() if k != "extras"}
            lost = {
                k for k, v in written.items() if k.endswith("Texture") and not (isinstance(v, dict) and "index" in v)
            }
            written = {k: v for k, v in written.items() if v is not None and k not in lost}
            if "extras" in members:
                written["extras"] = plain_json(members["extras"], self._notes, what)
            return written
        if isinstance(value, list):
            return [self._written(v, what) for v in cast("list[Any]", value)]
        return plain_json(value, self._notes, what)

    def _texture(self, image: Image, sampler: Mapping[str, Any] | None) -> int | None:
        if image.data is None:
            self._notes.add(f"the picture '{image.name}' is missing and was left out")
            return None
        item: dict[str, Any] = {"bufferView": self._buffers.view(image.data), "mimeType": image.mime_type}
        if image.name:
            item["name"] = image.name
        source = self._once("image", self.images, item)
        extension = TEXTURE_EXTENSIONS.get(image.mime_type)
        texture: dict[str, Any] = {"source": source}
        if extension is not None:
            texture = {"extensions": {extension: {"source": source}}}
            self.extensions.add(extension)
        if sampler:
            settings = plain_json(sampler, self._notes, f"the sampler of '{image.name}'")
            texture["sampler"] = self._once("sampler", self.samplers, settings)
        return self._once("texture", self.textures, texture)
