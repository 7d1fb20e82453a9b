"""The studio's routes.

========  =============================  ====================================================
GET       ``/?token=…``                  the page
GET       ``/assets/…``                  its scripts and styles (the same for everyone; no token)
WS        ``/api/events?token=…``        messages, see `keypose.studio.messages`
WS        ``/api/crowd?token=…``         a crowd, see `keypose.studio.crowd`
GET       ``/api/scenes/{id}``           one scene as a binary container
POST      ``/api/scenes``                dropped files as a binary container
GET       ``/api/takes/{id}/{kind}``     a recording of the play page as a file: glb or bvh
POST      ``/api/project/edit``          a change of the project, see `keypose.studio.edit_messages`
POST      ``/api/project/operate``       an operator run on it
GET       ``/api/project/operators``     what operators there are
GET       ``/api/project/export/{kind}`` the project as a file; ``character`` and ``timeline`` name what of it
POST      ``/api/project/rig``           a rig added, fitted, baked or removed, see `keypose.studio.rig_messages`
POST      ``/api/project/rig/pose``      what poses of controls make of joints
GET       ``/api/project/rig/track``     what a ``timeline`` makes of a ``rig``, frame by frame
POST      ``/api/retarget``              what the retarget page asks, see `keypose.studio.retarget_messages`
GET       ``/api/retarget/{id}/{kind}``  a retargeted motion with its character as a file
POST      ``/api/retarget/{id}/edit``    the same into the project
========  =============================  ====================================================

Only these exist. Static files are read into memory at start and looked up by their exact path, so there is no path to
climb out of.
"""

from __future__ import annotations

import asyncio
import dataclasses
import tempfile
from collections.abc import Awaitable, Callable, Coroutine, Mapping
from contextlib import suppress
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

from keypose.errors import KeyposeError
from keypose.model import Scene
from keypose.studio import messages
from keypose.studio import retarget_messages as retargets
from keypose.studio.crowd import crowd_events
from keypose.studio.edit_messages import EditResult, ProjectRequest
from keypose.studio.edit_operators import operator_specs
from keypose.studio.edit_wire import EDIT_LIMIT_BYTES
from keypose.studio.requests import parse_request, parse_retarget_request, parse_rig_request
from keypose.studio.rigging import POSE_LIMIT_BYTES
from keypose.studio.session import Session

if TYPE_CHECKING:
    from starlette.applications import Starlette
    from starlette.requests import Request
    from starlette.responses import Response
    from starlette.websockets import WebSocket

TAKE_KINDS = ("glb", "bvh")

RETARGET_LIMIT_BYTES = 1024 * 1024

_TYPES = {
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".svg": "image/svg+xml",
    ".json": "application/json",
    ".woff2": "font/woff2",
    ".png": "image/png",
}


def read_static() -> dict[str, bytes]:
    """The built client: URL path -> bytes.

    Raises:
        KeyposeError: where the client was not built.
    """
    root = resources.files("keypose.studio") / "static"
    files: dict[str, bytes] = {}

    def walk(folder: Any, prefix: str) -> None:
        for entry in folder.iterdir():
            if entry.is_dir():
                walk(entry, f"{prefix}{entry.name}/")
            elif any(entry.name.endswith(suffix) for suffix in _TYPES):
                files[f"{prefix}{entry.name}"] = entry.read_bytes()

    if root.is_dir():
        walk(root, "/")
    if "/index.html" not in files:
        raise KeyposeError("the studio's client is not built; run: python hatch_build.py (in a checkout)")
    return files


def build_app(session: Session, static: Mapping[str, bytes]) -> Starlette:
    """The application, without its guard."""
    from starlette.applications import Starlette
    from starlette.responses import JSONResponse, PlainTextResponse, Response
    from starlette.routing import Route, WebSocketRoute

    def file_response(path: str) -> Response:
        return Response(static[path], media_type=_TYPES[path[path.rindex(".") :]])

    async def page(request: Request) -> Response:
        return file_response("/index.html")

    async def asset(request: Request) -> Response:
        path = request.url.path
        if path not in static or path == "/index.html":
            return PlainTextResponse("404: not here\n", 404)
        return file_response(path)

    async def scene(request: Request) -> Response:
        data = session.payload(request.path_params["id"])
        if data is None:
            return PlainTextResponse("404: no such scene\n", 404)
        return Response(data, media_type="application/octet-stream")

    async def upload(request: Request) -> Response:
        limit = session.upload_limit_bytes
        data = await _received(request, limit)
        if data is None:
            return JSONResponse({"opened": [], "errors": [f"more than {limit / 2**20:.0f} MiB cannot be dropped"]}, 413)
        try:
            result = await session.open_upload(data)
        except KeyposeError as error:
            return JSONResponse({"opened": [], "errors": [str(error)]}, 400)
        return JSONResponse(dataclasses.asdict(result))

    async def take(request: Request) -> Response:
        recorded, kind = session.takes.get(request.path_params["id"]), request.path_params["kind"]
        if recorded is None or kind not in TAKE_KINDS:
            return PlainTextResponse("404: no such recording\n", 404)
        try:
            data = await asyncio.to_thread(written, recorded, kind)
        except KeyposeError as error:
            return PlainTextResponse(f"{error}\n", 422)
        return Response(data, media_type="application/octet-stream")

    async def edit(request: Request) -> Response:
        return await posted(request, session.editing.edit)

    async def operate(request: Request) -> Response:
        return await posted(request, session.editing.operate)

    async def posted(request: Request, act: Callable[[bytes], Awaitable[EditResult]]) -> Response:
        data = await _received(request, EDIT_LIMIT_BYTES)
        if data is None:
            error = f"more than {EDIT_LIMIT_BYTES / 2**20:.0f} MiB cannot be edited at once"
            return JSONResponse(dataclasses.asdict(EditResult("", 0, error, "")), 413)
        result = await act(data)
        return JSONResponse(dataclasses.asdict(result), 400 if result.error else 200)

    async def operators(request: Request) -> Response:
        return JSONResponse([dataclasses.asdict(spec) for spec in await asyncio.to_thread(operator_specs)])

    async def export(request: Request) -> Response:
        asked = request.query_params
        try:
            data = await session.editing.export(
                request.path_params["kind"], asked.get("character") or None, asked.get("timeline") or None
            )
        except KeyposeError as error:
            return PlainTextResponse(f"{error}\n", 422)
        return Response(data, media_type="application/octet-stream")

    async def retarget(request: Request) -> Response:
        data = await _received(request, RETARGET_LIMIT_BYTES)
        asked = None if data is None else parse_retarget_request(data.decode("utf-8", "replace"))
        match asked:
            case retargets.RetargetSubjectRequest():
                return JSONResponse(dataclasses.asdict(await session.retargeting.subject(asked)))
            case retargets.RetargetRolesRequest():
                try:
                    return JSONResponse(dataclasses.asdict(await session.retargeting.roles(asked)))
                except KeyposeError as error:
                    return PlainTextResponse(f"{error}\n", 422)
            case retargets.RetargetRequest():
                return JSONResponse(dataclasses.asdict(await session.retargeting.retarget(asked)))
            case None:
                return PlainTextResponse("400: this is nothing that the retarget page asks\n", 400)

    async def retargeted(request: Request) -> Response:
        try:
            data = await session.retargeting.export(request.path_params["id"], request.path_params["kind"])
        except KeyposeError as error:
            return PlainTextResponse(f"{error}\n", 422)
        return Response(data, media_type="application/octet-stream")

    async def rig(request: Request) -> Response:
        data = await _received(request, RETARGET_LIMIT_BYTES)
        asked = None if data is None else parse_rig_request(data.decode("utf-8", "replace"))
        if asked is None:
            return PlainTextResponse("400: this is nothing that can be asked of rigs\n", 400)
        result = await session.rigging.change(asked)
        return JSONResponse(dataclasses.asdict(result), 400 if result.error else 200)

    async def rig_pose(request: Request) -> Response:
        data = await _received(request, POSE_LIMIT_BYTES)
        if data is None:
            return PlainTextResponse("413: too many poses at once\n", 413)
        try:
            found = await session.rigging.pose(data)
        except KeyposeError as error:
            return PlainTextResponse(f"{error}\n", 422)
        return Response(found, media_type="application/octet-stream")

    async def rig_track(request: Request) -> Response:
        query = request.query_params
        try:
            found = await session.rigging.track(query.get("rig", ""), query.get("timeline", ""))
        except KeyposeError as error:
            return PlainTextResponse(f"{error}\n", 422)
        return Response(found, media_type="application/octet-stream")

    async def send_to_edit(request: Request) -> Response:
        result = await session.retargeting.send_to_edit(request.path_params["id"])
        return JSONResponse(dataclasses.asdict(result), 400 if result.error else 200)

    return Starlette(
        routes=[
            Route("/", page),
            WebSocketRoute("/api/events", lambda socket: _events(session, socket)),
            WebSocketRoute("/api/crowd", lambda socket: crowd_events(session, socket)),
            Route("/api/scenes/{id}", scene),
            Route("/api/scenes", upload, methods=["POST"]),
            Route("/api/takes/{id}/{kind}", take),
            Route("/api/project/edit", edit, methods=["POST"]),
            Route("/api/project/operate", operate, methods=["POST"]),
            Route("/api/project/operators", operators),
            Route("/api/project/export/{kind}", export),
            Route("/api/project/rig", rig, methods=["POST"]),
            Route("/api/project/rig/pose", rig_pose, methods=["POST"]),
            Route("/api/project/rig/track", rig_track),
            Route("/api/retarget", retarget, methods=["POST"]),
            Route("/api/retarget/{id}/edit", send_to_edit, methods=["POST"]),
            Route("/api/retarget/{id}/{kind}", retargeted),
            Route("/{path:path}", asset),
        ]
    )


async def _received(request: Request, limit: int) -> bytes | None:
    """The body of a request; None where it is larger than the limit, announced or not."""
    announced = request.headers.get("content-length", "0")
    if not announced.isdigit() or int(announced) > limit:
        return None
    data = bytearray()
    async for chunk in request.stream():
        data += chunk
        if len(data) > limit:
            return None
    return bytes(data)


def written(scene: Scene, kind: str) -> bytes:
    """A scene as the bytes of a file; raises `KeyposeError` where the format cannot hold it."""
    from keypose import io

    with tempfile.TemporaryDirectory(prefix="keypose-") as folder:
        path = Path(folder, f"take.{kind}")
        io.save(scene, path)
        return path.read_bytes()


async def _events(session: Session, socket: WebSocket) -> None:
    """Send what the session says to one browser; take its acknowledgements and requests."""
    from starlette.websockets import WebSocketDisconnect

    from keypose.studio.desk import PlayDesk

    await socket.accept()
    outbox = session.join()
    desk = PlayDesk(session, outbox)

    async def send() -> None:
        while True:
            await socket.send_bytes(await outbox.next())

    sender = asyncio.create_task(send())
    tasks: set[asyncio.Task[None]] = set()  # the event loop itself keeps only weak references

    def begin(work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.create_task(work)
        tasks.add(task)
        task.add_done_callback(tasks.discard)

    try:
        async for text in socket.iter_text():
            request = parse_request(text)
            if isinstance(request, ProjectRequest):
                begin(session.editing.handle(outbox, request))
                continue
            match request:
                case messages.Acknowledge(sequence=sequence):
                    outbox.acknowledge(sequence)
                case messages.CloseScene(id=id):
                    session.close(id)
                case messages.OpenSample(name=name):
                    begin(session.open_sample(name))
                case None:
                    await socket.close(1003, "unknown message")
                    break
                case _:
                    desk.handle(request)
    finally:
        desk.close()
        session.leave(outbox)
        sender.cancel()
        # a step that was on its way when the page went finds nobody
        with suppress(asyncio.CancelledError, RuntimeError, OSError, WebSocketDisconnect):
            await sender
