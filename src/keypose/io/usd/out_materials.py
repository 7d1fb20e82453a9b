"""Materials as UsdPreviewSurface, their pictures as files."""

from __future__ import annotations

import re
from pathlib import PurePosixPath
from typing import Any

from keypose.io.notes import Notes, UniqueNames
from keypose.io.usd.library import Names, entitle, keep
from keypose.model import Image, Material

_SUFFIXES = {"image/png": ".png", "image/jpeg": ".jpg"}


class MaterialWriter:
    """Writes the materials below one prim; ``pictures`` are the files that have to be put in place, by their names."""

    def __init__(self, usd: Any, stage: Any, scope: str, pictures: dict[str, bytes], prefix: str, notes: Notes) -> None:
        self._usd, self._stage, self._scope, self._notes = usd, stage, scope, notes
        self._pictures, self._prefix = pictures, prefix
        self._names, self._files = Names(), UniqueNames(pictures)
        self._known: dict[tuple[Any, ...], Any] = {}

    def bind(self, prim: Any, material: Material, has_uvs: bool) -> None:
        """Bind a mesh to a material."""
        image = material.base_color_image if has_uvs else None
        key = (
            material.name,
            material.base_color,
            material.metallic,
            material.roughness,
            material.emissive,
            id(image) if image is not None else 0,
            material.alpha_mode,
            material.alpha_cutoff,
            material.unlit,
        )
        if key not in self._known:
            self._known[key] = self._material(material, image)
        self._usd.UsdShade.MaterialBindingAPI.Apply(prim).Bind(self._known[key])

    def _material(self, material: Material, image: Image | None) -> Any:
        usd, types = self._usd, self._usd.Sdf.ValueTypeNames
        if not self._stage.GetPrimAtPath(self._scope):
            usd.UsdGeom.Scope.Define(self._stage, self._scope)
        path = f"{self._scope}/{self._names.add(material.name, 'Material')}"
        schema = usd.UsdShade.Material.Define(self._stage, path)
        prim = schema.GetPrim()
        entitle(prim, material.name)
        keep(prim, alpha_mode=material.alpha_mode)
        if material.unlit:
            keep(prim, unlit=True)
            self._notes.add(f"material '{material.name}': it takes no light, which UsdPreviewSurface cannot say")
        shader = usd.UsdShade.Shader.Define(self._stage, f"{path}/Surface")
        shader.CreateIdAttr("UsdPreviewSurface")
        red, green, blue, alpha = (float(c) for c in material.base_color)
        color = shader.CreateInput("diffuseColor", types.Color3f)
        opacity = shader.CreateInput("opacity", types.Float)
        texture = None if image is None else self._texture(path, image, material)
        if texture is None:
            color.Set(usd.Gf.Vec3f(red, green, blue))
            opacity.Set(1.0 if material.alpha_mode == "OPAQUE" else alpha)
        else:
            color.ConnectToSource(texture.CreateOutput("rgb", types.Float3))
            if material.alpha_mode == "OPAQUE":
                opacity.Set(1.0)
            else:
                opacity.ConnectToSource(texture.CreateOutput("a", types.Float))
        if texture is not None or (material.alpha_mode == "OPAQUE" and alpha != 1):
            keep(prim, base_color=usd.Vt.DoubleArray([red, green, blue, alpha]))
        if material.alpha_mode == "MASK":
            shader.CreateInput("opacityThreshold", types.Float).Set(float(material.alpha_cutoff))
        shader.CreateInput("metallic", types.Float).Set(float(material.metallic))
        shader.CreateInput("roughness", types.Float).Set(float(material.roughness))
        glow = usd.Gf.Vec3f(*(float(c) for c in material.emissive))
        shader.CreateInput("emissiveColor", types.Color3f).Set(glow)
        schema.CreateSurfaceOutput().ConnectToSource(shader.CreateOutput("surface", types.Token))
        return schema

    def _texture(self, path: str, image: Image, material: Material) -> Any:
        usd, types = self._usd, self._usd.Sdf.ValueTypeNames
        file = self._file(image, material.name)
        if file is None:
            return None
        reader = usd.UsdShade.Shader.Define(self._stage, f"{path}/Coordinates")
        reader.CreateIdAttr("UsdPrimvarReader_float2")
        reader.CreateInput("varname", types.String).Set("st")
        texture = usd.UsdShade.Shader.Define(self._stage, f"{path}/Picture")
        texture.CreateIdAttr("UsdUVTexture")
        texture.CreateInput("file", types.Asset).Set(usd.Sdf.AssetPath(file))
        texture.CreateInput("st", types.Float2).ConnectToSource(reader.CreateOutput("result", types.Float2))
        texture.CreateInput("sourceColorSpace", types.Token).Set("sRGB")
        texture.CreateInput("wrapS", types.Token).Set("repeat")
        texture.CreateInput("wrapT", types.Token).Set("repeat")
        texture.CreateInput("scale", types.Float4).Set(usd.Gf.Vec4f(*(float(c) for c in material.base_color)))
        keep(self._stage.GetPrimAtPath(path), image=image.name)
        return texture

    def _file(self, image: Image, material: str) -> str | None:
        """The name of a picture as the layer has it."""
        suffix = _SUFFIXES.get(image.mime_type)
        if image.data is None:
            name = PurePosixPath(image.name.replace("\\", "/")).name
            self._notes.add(f"material '{material}': its picture '{name}' is missing; only its name was written")
            return f"./{name}" if name else None
        if suffix is None:
            self._notes.add(f"material '{material}': its picture is neither PNG nor JPEG and was not written")
            return None
        for known, data in self._pictures.items():
            if data is image.data:
                return f"./{known}"
        stem = re.sub(r"[^A-Za-z0-9_-]", "_", image.name.removesuffix(suffix))[:100] or "picture"
        name = self._files.add(f"{self._prefix}{stem}") + suffix
        self._pictures[name] = image.data
        return f"./{name}"
