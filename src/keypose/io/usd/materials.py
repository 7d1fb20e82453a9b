"""UsdPreviewSurface materials: colours, and the picture of the base colour.

Source: Pixar, "UsdPreviewSurface Specification", version 2.6.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

from keypose.io.guarded import Record
from keypose.io.notes import Notes
from keypose.io.usd.package import picture
from keypose.model import Image, Material

_TEXTURED = ("normal", "metallic", "roughness", "emissiveColor", "occlusion", "displacement", "specularColor")


@dataclass(frozen=True, slots=True)
class Surface:
    """A material, and the name of the texture coordinates that its picture is put on with."""

    material: Material
    uvs: str


def materials(path: Path, record: Record, notes: Notes) -> list[Surface]:
    """All materials that something is bound to; ``path`` is the file's own."""
    return [_Reader(path, item, notes).surface() for item in record.facts["materials"]]


class _Reader:
    def __init__(self, path: Path, item: Mapping[str, Any], notes: Notes) -> None:
        self._path, self._notes = path, notes
        self._name = str(item["name"])
        self._kind = str(item["kind"])
        self._own: Mapping[str, Any] = item["own"] or {}
        self._inputs: Mapping[str, Any] = item["inputs"]

    def surface(self) -> Surface:
        """The material as it will be shown."""
        if self._kind != "UsdPreviewSurface":
            kind = f"'{self._kind}'" if self._kind else "no surface"
            self._note(f"its shader is {kind}, not UsdPreviewSurface; only its name is kept")
            return Surface(Material(self._name), "")
        textured = [n for n in _TEXTURED if isinstance(self._inputs.get(n), dict)]
        if textured:
            self._note(f"its pictures of {', '.join(textured)} were dropped")
        if self._number("useSpecularWorkflow", 0):
            self._note("its specular workflow was taken as metallic")
        image, uvs, color = self._base()
        opacity, texture = self._number("opacity", 1.0), isinstance(self._inputs.get("opacity"), dict)
        cutoff = self._number("opacityThreshold", 0.0)
        mode = "MASK" if cutoff > 0 else "BLEND" if opacity < 1 or texture else "OPAQUE"
        if self._own.get("alpha_mode") in ("OPAQUE", "MASK", "BLEND"):
            mode = str(self._own["alpha_mode"])
        emissive = self._color("emissiveColor", (0.0, 0.0, 0.0))
        own = self._own.get("base_color")
        if image is not None and isinstance(own, list) and len(own) == 4 and all(isinstance(v, float) for v in own):
            color, opacity = (_unit(own[0]), _unit(own[1]), _unit(own[2])), own[3]
        material = Material(
            name=self._name,
            base_color=(*color, _unit(opacity)),
            metallic=_unit(self._number("metallic", 0.0)),
            roughness=_unit(self._number("roughness", 0.5)),
            emissive=emissive,
            base_color_image=image,
            alpha_mode=mode,
            alpha_cutoff=_unit(cutoff) if cutoff > 0 else 0.5,
            unlit=self._own.get("unlit") is True,
        )
        return Surface(material, uvs)

    def _base(self) -> tuple[Image | None, str, tuple[float, float, float]]:
        found = self._inputs.get("diffuseColor")
        if not isinstance(found, dict):
            return None, "", self._color("diffuseColor", (0.18, 0.18, 0.18))
        scale = found["scale"] or [1.0, 1.0, 1.0, 1.0]
        color = (_unit(scale[0]), _unit(scale[1]), _unit(scale[2])) if len(scale) >= 3 else (1.0, 1.0, 1.0)
        if found["uvs"]["moved"]:
            self._note("its picture is moved over the surface, which was dropped")
        return self._image(found), str(found["uvs"]["name"]), color

    def _image(self, found: Mapping[str, Any]) -> Image:
        asset = str(found["asset"])
        name = PurePosixPath(asset.replace("\\", "/")).name
        data = picture(self._path, str(found["file"]))
        if isinstance(data, str):
            self._note(f"its picture '{asset[:200]}' {data}; only its name is kept")
            mime = "image/jpeg" if name.lower().endswith((".jpg", ".jpeg")) else "image/png"
            return Image(name, mime)
        own = self._own.get("image")
        return Image(own if isinstance(own, str) else name, *data)

    def _number(self, name: str, default: float) -> float:
        value = self._inputs.get(name)
        number = float(value[0]) if isinstance(value, list) and value else default
        return number if abs(number) < 1e6 else default

    def _color(self, name: str, default: tuple[float, float, float]) -> tuple[float, float, float]:
        value = self._inputs.get(name)
        if not isinstance(value, list) or len(value) != 3:
            return default
        return (_unit(value[0]), _unit(value[1]), _unit(value[2]))

    def _note(self, text: str) -> None:
        self._notes.add(f"material '{self._name}': {text}")


def _unit(value: float) -> float:
    return min(max(float(value), 0.0), 1.0) if abs(value) < 1e30 else 0.0
