"""A page without a browser that edits a project: its document is built from messages alone, as the editor's is."""

from __future__ import annotations

import http.client
import json
from collections.abc import Callable
from dataclasses import asdict
from typing import Any

import numpy as np

from keypose.io import native_values as values
from keypose.io.json_values import Json
from keypose.model import Channel, Clip, Curve
from keypose.studio import StudioServer
from keypose.studio.container import Body, array, pack, unpack

TYPES = {"float64": "<f8", "float32": "<f4", "uint8": "u1", "uint32": "<u4"}


class EditPage:
    """Follows a project over a socket; says what it wants over socket and HTTP."""

    def __init__(self, socket: Any, server: StudioServer) -> None:
        self.socket, self.server = socket, server
        self.status: dict[str, Any] = {}
        self.clips: dict[str, Clip] = {}
        self.timelines: dict[str, Any] = {}
        self.poses: dict[str, Any] = {}
        self.characters: list[dict[str, Any]] = []
        self.settings: dict[str, Any] = {}
        self.state: dict[str, Any] = {}

    def say(self, type: str, **fields: Any) -> None:
        self.socket.send(json.dumps({"type": type, **fields}))

    def hear(self, timeout: float = 30) -> dict[str, Any]:
        """The next message, after it was acknowledged and obeyed."""
        header, body = unpack(self.socket.recv(timeout=timeout))
        self.socket.send(json.dumps({"type": "acknowledge", "sequence": header["sequence"]}))
        message = header["message"]
        fetch = fetching(body)
        if message["type"] == "project_state":
            self._state(message, fetch)
        elif message["type"] == "project_changed":
            self._changed(message, fetch)
        return message

    def until(self, kind: str, wanted: Callable[[dict[str, Any]], bool] = lambda _: True) -> dict[str, Any]:
        while True:
            message = self.hear()
            if message["type"] == kind and wanted(message):
                return message

    def edit(self, *commands: dict[str, Any], body: Body | None = None, **fields: Any) -> dict[str, Any]:
        """The answer to an edit, without waiting for the difference."""
        header = {"type": "edit", "id": "e", "label": "edit", "merge": "", **fields, "commands": list(commands)}
        return self.post("edit", pack(json.loads(json.dumps(header, default=asdict)), body))

    def post(self, what: str, data: bytes) -> dict[str, Any]:
        connection = http.client.HTTPConnection("127.0.0.1", self.server.port, timeout=60)
        connection.request("POST", f"/api/project/{what}", data, {"X-Keypose-Token": self.server.token})
        answer = connection.getresponse()
        result: dict[str, Any] = json.loads(answer.read())
        connection.close()
        assert (answer.status == 200) == (not result["error"])
        return result

    def set_curves(self, clip: str, curves: dict[Channel, Curve], **fields: Any) -> dict[str, Any]:
        body = Body()
        command = {
            "kind": "set_curves",
            "clip": clip,
            "curves": [values.curve_json(channel, curve, storing(body)) for channel, curve in curves.items()],
            "removed": [],
            "euler_orders": {},
        }
        return self.edit(command, body=body, **fields)

    def _state(self, message: dict[str, Any], fetch: values.Fetch) -> None:
        self.state, self.status = message, message["status"]
        self.clips = {c["name"]: values.read_clip(Json(c, "clip"), fetch) for c in message["clips"]}
        self.timelines = {t["name"]: t for t in message["timelines"]}
        self.poses = {p["name"]: p for p in message["poses"]}
        self.characters, self.settings = message["characters"], message["settings"]

    def _changed(self, message: dict[str, Any], fetch: values.Fetch) -> None:
        self.status = message["status"]
        for change in message["clips"]:
            old = self.clips.get(change["name"])
            curves = {} if old is None else dict(old.curves)
            for channel in change["removed"]:
                del curves[values.read_channel(Json(channel, "removed"))]
            curves |= values.read_curves(Json(change, "clip"), "curves", fetch)
            self.clips[change["name"]] = Clip(curves, change["name"], change["rate_hz"], change["euler_orders"])
        for name in message["removed_clips"]:
            del self.clips[name]
        self.timelines |= {t["name"]: t for t in message["timelines"]}
        for name in message["removed_timelines"]:
            del self.timelines[name]
        self.poses |= {p["name"]: p for p in message["poses"]}
        for name in message["removed_poses"]:
            del self.poses[name]
        if message["characters"] is not None:
            self.characters = message["characters"]
        if message["settings"] is not None:
            self.settings = message["settings"]


def storing(body: Body) -> values.Store:
    """Arrays as an edit holds them."""
    return lambda a: body.add(a, "uint8" if a.dtype == np.uint8 else "float64")


def fetching(body: memoryview) -> values.Fetch:
    """Arrays out of a message."""

    def fetch(ref: Json) -> Any:
        found = ref.value
        return np.frombuffer(array(body, found), TYPES[found["element"]]).reshape(found["shape"])

    return fetch
