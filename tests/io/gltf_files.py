"""glTF files made by hand for the tests: nothing here knows keypose's own writer."""

from __future__ import annotations

import base64
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np

COMPONENT = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
KIND = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}


class GltfFile:
    """A document under construction: ``json`` is free to be changed, arrays are appended to one buffer."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.json: dict[str, Any] = {
            "asset": {"version": "2.0"},
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": [{"name": "root"}],
            "accessors": [],
            "bufferViews": [],
            "buffers": [{"byteLength": 0}],
        }

    def view(self, data: bytes, **more: Any) -> int:
        """A buffer view of these bytes."""
        self.data += bytes(-len(self.data) % 4)
        self.json["bufferViews"].append({"buffer": 0, "byteOffset": len(self.data), "byteLength": len(data), **more})
        self.data += data
        return len(self.json["bufferViews"]) - 1

    def accessor(self, array: Any, **more: Any) -> int:
        """An accessor of a (count, width) array in its own type."""
        array = np.ascontiguousarray(array)
        array = array.reshape(len(array), -1)
        item = {
            "bufferView": self.view(array.tobytes()),
            "componentType": COMPONENT[array.dtype.str[1:]],
            "count": len(array),
            "type": KIND[array.shape[1]],
        }
        self.json["accessors"].append({**item, **more})
        return len(self.json["accessors"]) - 1

    def floats(self, values: Any, **more: Any) -> int:
        """An accessor of float32."""
        return self.accessor(np.asarray(values, np.float32), **more)

    def animate(
        self, path: str, times: Any, values: Any, interpolation: str = "LINEAR", node: int = 0
    ) -> dict[str, Any]:
        """One animation with one channel."""
        flat = np.asarray(values, np.float32)
        if path == "weights":
            flat = flat.reshape(-1, 1)
        animation = {
            "samplers": [{"input": self.floats(times), "output": self.floats(flat), "interpolation": interpolation}],
            "channels": [{"sampler": 0, "target": {"node": node, "path": path}}],
        }
        self.json.setdefault("animations", []).append(animation)
        return animation

    def triangle(self, **attributes: int) -> dict[str, Any]:
        """A mesh of one triangle on node 0, with more attributes; returns its primitive."""
        positions = self.floats([[0, 0, 0], [1, 0, 0], [0, 1, 0]])
        normals = self.floats([[0, 0, 1]] * 3)
        primitive: dict[str, Any] = {"attributes": {"POSITION": positions, "NORMAL": normals, **attributes}}
        self.json["meshes"] = [{"primitives": [primitive]}]
        self.json["nodes"][0]["mesh"] = 0
        return primitive

    def glb(self) -> bytes:
        """The whole as GLB."""
        data = bytes(self.data) + bytes(-len(self.data) % 4)
        self.json["buffers"][0]["byteLength"] = len(self.data)
        document = dict(self.json)
        if not data:
            document = {k: v for k, v in document.items() if k not in ("buffers", "bufferViews", "accessors")}
        return glb_of(json.dumps(document).encode(), data)

    def gltf(self) -> bytes:
        """The whole as text with embedded data."""
        document = {**self.json, "buffers": [dict(b) for b in self.json["buffers"]]}
        uri = "data:application/octet-stream;base64," + base64.b64encode(self.data).decode()
        document["buffers"][0] |= {"byteLength": len(self.data), "uri": uri}
        return json.dumps(document).encode()

    def save(self, folder: Path, name: str = "file.glb") -> Path:
        """Write the file into a folder."""
        path = folder / name
        path.write_bytes(self.glb() if path.suffix != ".gltf" else self.gltf())
        return path


def glb_of(text: bytes, data: bytes = b"") -> bytes:
    """A GLB of a JSON text and binary data."""
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
    if data:
        chunks += struct.pack("<II", len(data), 0x004E4942) + data
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def split(data: bytes) -> tuple[dict[str, Any], bytes]:
    """JSON and binary chunk of a .glb or .gltf."""
    if data[:4] != b"glTF":
        return json.loads(data), b""
    length = struct.unpack_from("<I", data, 12)[0]
    return json.loads(data[20 : 20 + length]), data[20 + length + 8 :]
