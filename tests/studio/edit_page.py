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
from keypose.model import Channel, Clip, Curve, Document
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
        self.hello: dict[str, Any] = {}

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

    def matches(self, document: Document) -> bool:
        """Whether what the page was told amounts to this document, bit for bit; says where it does not."""
        assert self.status["name"] == document.name
        assert self.clips.keys() == document.clips.keys()
        for name, clip in document.clips.items():
            mine = self.clips[name]
            assert (mine.rate_hz, dict(mine.euler_orders)) == (clip.rate_hz, dict(clip.euler_orders)), name
            assert mine.curves.keys() == clip.curves.keys(), name
            for channel, curve in clip.curves.items():
                assert plain(channel, mine.curves[channel]) == plain(channel, curve), (name, channel)
        assert self.poses == {name: values.pose_json(pose) for name, pose in document.poses.items()}
        assert self.settings == dict(document.settings)
        assert {who["name"]: who["timeline"] for who in self.characters} == {
            name: document.performs.get(name, "") for name in document.characters
        }
        assert self.timelines.keys() == document.timelines.keys()
        for name, track in document.timelines.items():
            mine = values.read_timeline(Json(self.timelines[name], name), lambda item: item.value)
            assert values.timeline_json(mine, numbers) == values.timeline_json(track, numbers), name
        return True

    def _state(self, message: dict[str, Any], fetch: values.Fetch) -> None:
        self.state, self.status = message, message["status"]
        self.clips = {c["name"]: values.read_clip(Json(c, "clip"), fetch) for c in message["clips"]}
        self.timelines = {t["name"]: arrays_in(t, fetch) for t in message["timelines"]}
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
        self.timelines |= {t["name"]: arrays_in(t, fetch) for t in message["timelines"]}
        for name in message["removed_timelines"]:
            del self.timelines[name]
        self.poses |= {p["name"]: p for p in message["poses"]}
        for name in message["removed_poses"]:
            del self.poses[name]
        if message["characters"] is not None:
            self.characters = message["characters"]
        if message["settings"] is not None:
            self.settings = message["settings"]


def arrays_in(value: Any, fetch: values.Fetch) -> Any:
    """JSON with the arrays that it refers to."""
    if isinstance(value, dict):
        if value.keys() == {"offset", "bytes", "element", "shape"}:
            return fetch(Json(value, ""))
        return {name: arrays_in(each, fetch) for name, each in value.items()}
    return [arrays_in(each, fetch) for each in value] if isinstance(value, list) else value


def numbers(array: Any) -> Any:
    """An array as plain numbers; those of a project come in double precision."""
    numbers = np.asarray(array, np.uint8 if array.dtype == np.uint8 else np.float64)
    return numbers.shape, numbers.tobytes()


def plain(channel: Channel, curve: Curve) -> dict[str, Any]:
    """All that a curve holds, to be compared."""
    return values.curve_json(channel, curve, numbers)


def storing(body: Body) -> values.Store:
    """Arrays as an edit holds them."""
    return lambda a: body.add(a, "uint8" if a.dtype == np.uint8 else "float64")


def fetching(body: memoryview) -> values.Fetch:
    """Arrays out of a message."""

    def fetch(ref: Json) -> Any:
        found = ref.value
        return np.frombuffer(array(body, found), TYPES[found["element"]]).reshape(found["shape"])

    return fetch
