"""Materials as FBX Phong materials, with the base colour's picture inside the file."""

from __future__ import annotations

from collections.abc import Sequence

from keypose.io.fbx.binary import properties
from keypose.io.fbx.out_nodes import Objects, number, vector
from keypose.io.notes import Notes
from keypose.model import Image, Material


class MaterialWriter:
    """Writes each material once."""

    def __init__(self, objects: Objects, notes: Notes) -> None:
        self._objects, self._notes = objects, notes
        self._known: dict[int, int] = {}
        self._kept: list[Material] = []  # what is known by identity must live as long as we know it

    def connect(self, materials: Sequence[Material], model: int) -> list[int]:
        """Give a model its materials; returns which of them each part uses."""
        slots: dict[int, int] = {}
        for material in materials:
            if id(material) not in slots:
                slots[id(material)] = len(slots)
                self._objects.connect(self._material(material), model)
        return [slots[id(material)] for material in materials]

    def _material(self, material: Material) -> int:
        if id(material) in self._known:
            return self._known[id(material)]
        red, green, blue, alpha = material.base_color
        identity, item = self._objects.add("Material", material.name or "material", "")
        item.add("Version", 102)
        item.add("ShadingModel", "phong")
        item.add("MultiLayer", 0)
        shine = (10 * (1 - material.roughness)) ** 2
        rows = [
            vector("DiffuseColor", "Color", (red, green, blue)),
            number("DiffuseFactor", 1.0),
            vector("EmissiveColor", "Color", material.emissive),
            number("EmissiveFactor", 1.0),
            number("ShininessExponent", shine),
            number("Shininess", shine),
            number("ReflectionFactor", material.metallic),
            number("SpecularFactor", 0.25),
            vector("SpecularColor", "Color", (1.0, 1.0, 1.0)),
        ]
        if material.alpha_mode == "BLEND":
            rows += [
                vector("TransparentColor", "Color", (1.0, 1.0, 1.0)),
                number("TransparencyFactor", 1 - alpha),
                ("Opacity", "double", "Number", "", float(alpha)),
            ]
        item.children.append(properties(rows))
        if material.base_color_image is not None:
            self._picture(material.base_color_image, identity, material.name)
        self._known[id(material)] = identity
        self._kept.append(material)
        return identity

    def _picture(self, image: Image, material: int, name: str) -> None:
        ending = ".jpg" if image.mime_type == "image/jpeg" else ".png"
        file = image.name or name or "picture"
        file = file if "." in file else file + ending
        texture, item = self._objects.add("Texture", image.name or name, "")
        item.add("Type", "TextureVideoClip")
        item.add("Version", 202)
        item.add("TextureName", f"{image.name or name}\x00\x01Texture")
        item.add("Media", f"{image.name or name}\x00\x01Video")
        item.add("FileName", file)
        item.add("RelativeFilename", file)
        video, clip = self._objects.add("Video", image.name or name, "Clip")
        clip.add("Type", "Clip")
        clip.children.append(properties([("Path", "KString", "XRefUrl", "", file)]))
        clip.add("UseMipMap", 0)
        clip.add("Filename", file)
        clip.add("RelativeFilename", file)
        if image.data is not None:
            clip.add("Content", image.data)
        else:
            self._notes.add(f"material '{name}': its picture '{file}' has no data; only its name was written")
        self._objects.connect(texture, material, "DiffuseColor")
        self._objects.connect(video, texture)
