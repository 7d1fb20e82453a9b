"""COLLADA's materials: the common profile's colours.

Source: COLLADA 1.4.1 specification, chapter 8 (profile_COMMON, lambert, phong, blinn, constant).
"""

from __future__ import annotations

import re
from urllib.parse import unquote

import numpy as np

from keypose.io.collada_xml import Document, Element
from keypose.model import Image, Material

_SHADERS = ("phong", "blinn", "lambert", "constant")


class Materials:
    """The materials of a file, each made once."""

    def __init__(self, document: Document) -> None:
        self.document = document
        self.made: dict[int, Material] = {}

    def symbols(self, instance: Element) -> dict[str, Element]:
        """The materials that an instance binds to the symbols of its geometry."""
        common = instance.first("bind_material", "technique_common")
        found: dict[str, Element] = {}
        for item in common.all("instance_material") if common is not None else ():
            target = self.document.find(item.get("target"))
            if target is not None and target.tag == "material":
                found[item.get("symbol")] = target
        return found

    def material(self, element: Element | None, symbol: str) -> Material:
        """The material of a symbol; without a binding the symbol may be its id."""
        if element is None:
            found = self.document.find(symbol) if symbol else None
            element = found if found is not None and found.tag == "material" else None
        if element is None:
            return Material(symbol)
        if id(element) not in self.made:
            self.made[id(element)] = self._material(element)
        return self.made[id(element)]

    def _material(self, element: Element) -> Material:
        name = element.named()
        instance = element.first("instance_effect")
        effect = self.document.find(instance.get("url")) if instance is not None else None
        profile = effect.first("profile_COMMON") if effect is not None and effect.tag == "effect" else None
        technique = profile.first("technique") if profile is not None else None
        shader = next((child for child in technique.children if child.tag in _SHADERS), None) if technique else None
        if profile is None or shader is None:
            self.document.note(f"material '{name[:60]}' has no common profile; it became plain")
            return Material(name)
        kind = "emission" if shader.tag == "constant" else "diffuse"
        color, image = self._color(shader.first(kind), profile)
        emissive, _ = self._color(shader.first("emission"), profile)
        sided = next((e for e in effect.walk() if e.tag == "double_sided"), None) if effect is not None else None
        red, green, blue, _ = color or (0.8, 0.8, 0.8, 1.0)
        glow = emissive or (0.0, 0.0, 0.0, 1.0)
        return Material(
            name,
            (1.0, 1.0, 1.0, 1.0) if image is not None else (red, green, blue, 1.0),
            emissive=(0.0, 0.0, 0.0) if shader.tag == "constant" else (glow[0], glow[1], glow[2]),
            base_color_image=image,
            double_sided=sided is not None and sided.text.strip() in ("1", "true"),
            unlit=shader.tag == "constant",
        )

    def _color(
        self, slot: Element | None, profile: Element
    ) -> tuple[tuple[float, float, float, float] | None, Image | None]:
        if slot is None:
            return None, None
        texture, color = slot.first("texture"), slot.first("color")
        if texture is not None:
            return None, self._image(texture.get("texture"), profile)
        if color is None:
            return None, None
        values = np.clip([*color.numbers()[:4].tolist(), 1.0, 1.0, 1.0, 1.0][:4], 0.0, 1.0).tolist()
        return (values[0], values[1], values[2], values[3]), None

    def _image(self, reference: str, profile: Element) -> Image | None:
        """The picture behind a sampler and its surface, or straight behind the name; only its name is kept."""
        parameters = {item.get("sid"): item for item in profile.all("newparam")}
        name = reference
        for _ in range(3):
            item = parameters.get(name)
            if item is None:
                break
            link = item.first("sampler2D", "source") or item.first("surface", "init_from")
            link = link or item.first("sampler2D", "instance_image")
            if link is None:
                break
            name = link.text.strip() or link.get("url").lstrip("#")
        found = self.document.find(name)
        if found is None or found.tag != "image":
            return None
        file = found.first("init_from")
        place = ""
        if file is not None:
            inner = file.first("ref")
            place = (inner.text if inner is not None else file.text).strip()
        plain = re.split(r"[\\/]", unquote(place))[-1] or found.named()
        if plain:
            self.document.note(f"picture '{plain[:80]}' was not read; materials keep its name")
        mime = "image/jpeg" if plain.lower().endswith((".jpg", ".jpeg")) else "image/png"
        return Image(plain, mime) if plain else None
