"""FBX materials: names, base colours and the picture of the base colour."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from keypose.io.guarded import Record
from keypose.io.notes import Notes
from keypose.model import Image, Material

_SIGNATURES = {b"\x89PNG\r\n\x1a\n": "image/png", b"\xff\xd8\xff": "image/jpeg"}


def materials(record: Record, notes: Notes) -> list[Material]:
    """All materials of the file; colours are taken for linear, as FBX does not say."""
    return [_material(record, item, notes) for item in record.facts["materials"]]


def _material(record: Record, item: Mapping[str, Any], notes: Notes) -> Material:
    name = str(item["name"])
    red, green, blue = 0.8, 0.8, 0.8
    if item["base_color"] is not None:
        factor = _number(item["base_factor"], 1.0)
        red, green, blue = (_unit(float(c) * factor) for c in item["base_color"][:3])
    veil = _number(item["transparency_factor"], 1.0) * float(np.mean(item["transparency"][:3]))
    opacity = _unit(_number(item["opacity"], 1 - veil))
    if opacity == 0:
        notes.add(f"material '{name}': it is wholly transparent, which is hardly meant; it was taken as opaque")
        opacity = 1.0
    glow = _number(item["emission_factor"], 1.0)
    emissive = tuple(_unit(float(c) * glow) for c in item["emission"][:3])
    image = _image(record, item, name, notes)
    if item["textures"] > (image is not None):
        notes.add(f"material '{name}': of its {item['textures']} textures only the base colour's is kept")
    if image is not None:
        red, green, blue = 1.0, 1.0, 1.0  # FBX replaces the colour by the texture; glTF multiplies them
    return Material(
        name=name,
        base_color=(red, green, blue, opacity),
        metallic=_unit(_number(item["metalness"], 0.0)),
        roughness=_unit(_number(item["roughness"], 0.8)),
        emissive=(emissive[0], emissive[1], emissive[2]),
        base_color_image=image,
        alpha_mode="OPAQUE" if opacity == 1 else "BLEND",
    )


def _image(record: Record, item: Mapping[str, Any], material: str, notes: Notes) -> Image | None:
    picture = item["picture"]
    if picture is None:
        return None
    name = str(picture["name"]).replace("\\", "/").rsplit("/", 1)[-1]
    if picture["data"] is None:
        notes.add(f"material '{material}': its picture '{name}' is another file; only its name is kept")
        return Image(name, _mime_of_name(name))
    data = record.array(picture["data"]).tobytes()
    mime = next((m for mark, m in _SIGNATURES.items() if data.startswith(mark)), None)
    if mime is None:
        notes.add(f"material '{material}': its picture '{name}' is neither PNG nor JPEG; only its name is kept")
        return Image(name, _mime_of_name(name))
    return Image(name, mime, data)


def _mime_of_name(name: str) -> str:
    return "image/jpeg" if name.lower().endswith((".jpg", ".jpeg")) else "image/png"


def _number(value: Any, default: float) -> float:
    number = default if value is None else float(value)
    return number if np.isfinite(number) else default


def _unit(value: float) -> float:
    return min(max(value, 0.0), 1.0) if np.isfinite(value) else 0.0
