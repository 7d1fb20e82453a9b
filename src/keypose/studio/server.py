"""Run the studio: one local server, one URL with a token, until Ctrl-C."""

from __future__ import annotations

import asyncio
import os
import secrets
import socket
import sys
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from keypose.errors import KeyposeError, ShapeError
from keypose.model import Scene
from keypose.studio.guard import Guard, bracketed, is_loopback
from keypose.studio.session import UPLOAD_LIMIT_BYTES, Session, open_references

if TYPE_CHECKING:
    import uvicorn

    from keypose.studio.graphs import OpenedGraph

LOOPBACK = "127.0.0.1"


def serve(
    references: Sequence[str],
    host: str = LOOPBACK,
    port: int = 0,
    open_browser: bool = True,
    ready: Callable[[str], None] | None = None,
    *,
    allow_remote: bool = False,
) -> None:
    """Open files in the studio and serve it until Ctrl-C.

    ``references`` are paths or ``sample:`` names of scenes and animation graphs, and at most one project; where there is a
    project, the page begins with editing it, else where there is a graph, with playing it. ``port`` 0 takes a free one. As soon as the server listens, ``ready`` is called with the URL; without
    ``ready`` one line with the URL is printed.

    Raises:
        FormatError, UnknownName: where a file cannot be opened (before anything is served).
        Locked: where the project is open in another studio.
        ShapeError: where ``host`` can be reached from other machines and ``allow_remote`` is not set.
        KeyposeError: where the address cannot be used, or the client was not built.
    """
    if not is_loopback(host) and not allow_remote:
        raise ShapeError(
            f"host: '{host}' can be reached from other machines, and whoever has the URL sees what is open and edits the project; "
            "say that you want this with --allow-remote"
        )
    from keypose.studio.graphs import is_graph_name, open_graph

    projects = [r for r in references if r.lower().endswith(".keypose")]
    if len(projects) > 1:
        raise ShapeError(f"{projects[1]}: only one project can be open; {projects[0]} is it")
    named = [r for r in references if is_graph_name(r)]
    graphs = [open_graph(reference, f"file:{n}") for n, reference in enumerate(named)]
    scenes = open_references(r for r in references if r not in named and r not in projects)
    StudioServer(
        scenes,
        host,
        port,
        graphs=graphs,
        project=projects[0] if projects else None,
        open_browser=open_browser,
        ready=ready,
    ).run()


class StudioServer:
    """A studio that `run` serves and `stop` (from any thread) ends.

    The built-in graphs can always be played; where others are given, the page begins with the last of those, and where a
    ``project`` is given, with editing that. ``state``: the folder where unsaved work is kept, the user's own if not given.

    Raises:
        FormatError: where the project cannot be opened.
        Locked: where another studio has it open.
        KeyposeError: where the address cannot be used, or the client was not built.
    """

    def __init__(
        self,
        scenes: Sequence[tuple[str, Scene]] = (),
        host: str = LOOPBACK,
        port: int = 0,
        *,
        graphs: Sequence[OpenedGraph] = (),
        project: str | None = None,
        state: Path | None = None,
        open_browser: bool = False,
        ready: Callable[[str], None] | None = None,
        upload_limit_bytes: int | None = None,
    ) -> None:
        from keypose.project.workspace import Workspace
        from keypose.studio.app import read_static

        self.token = secrets.token_urlsafe(24)
        self._scenes, self._graphs = tuple(scenes), tuple(graphs)
        self._static = read_static()
        self._open_browser = open_browser
        self._ready = ready or _print_url
        self._upload_limit_bytes = upload_limit_bytes
        self._server: uvicorn.Server | None = None
        self._workspace, self._edits = Workspace(state), project is not None
        if project is not None:
            self._workspace.open(project)
        try:
            self._socket = _bind(host, port)
        except KeyposeError:
            self._workspace.close()
            raise
        self.host, self.port = host, int(self._socket.getsockname()[1])
        shown = LOOPBACK if host in ("0.0.0.0", "") else "::1" if host == "::" else host
        self.url = f"http://{bracketed(shown)}:{self.port}/?token={self.token}"
        if not is_loopback(host):
            print(
                f"warning: {host} can be reached from other machines; whoever has the URL can see what is open and edit the project",
                file=sys.stderr,
            )

    def run(self) -> None:
        """Serve until Ctrl-C or `stop`."""
        try:
            asyncio.run(self._serve())
        except KeyboardInterrupt:
            pass  # uvicorn has already shut down; it raises the interrupt again for those who want to know
        finally:
            self._workspace.close()
            self._socket.close()

    def stop(self) -> None:
        """End `run`; may be called from another thread."""
        if self._server is not None:
            self._server.should_exit = True

    async def _serve(self) -> None:
        import uvicorn

        from keypose.studio.app import build_app
        from keypose.studio.graphs import built_ins

        session = Session(
            UPLOAD_LIMIT_BYTES if self._upload_limit_bytes is None else self._upload_limit_bytes,
            graphs=[*built_ins(), *self._graphs],
            start="edit" if self._edits else "play" if self._graphs else "view",
            workspace=self._workspace,
            confined=None if is_loopback(self.host) else Path.cwd(),
        )
        await session.editing.look()
        app = Guard(build_app(session, self._static), token=self.token, host=self.host, port=self.port)
        config = uvicorn.Config(
            app,
            log_level="error",
            access_log=False,
            lifespan="off",
            ws="websockets-sansio",
            ws_per_message_deflate=False,
            ws_max_size=64 * 1024,
            server_header=False,
            timeout_graceful_shutdown=1,
        )
        self._server = uvicorn.Server(config)
        serving = asyncio.create_task(self._server.serve(sockets=[self._socket]))
        preparing = asyncio.create_task(session.add_all(self._scenes))
        self._scenes = ()
        while not self._server.started and not serving.done():
            await asyncio.sleep(0.005)
        if self._server.started:
            self._ready(self.url)
            if self._open_browser:
                _show(self.url)
        await serving
        preparing.cancel()


def _bind(host: str, port: int) -> socket.socket:
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        listener = socket.socket(family, kind, protocol)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(address)
    except (OSError, OverflowError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise KeyposeError(f"cannot listen on {host}, port {port}: {reason}") from None
    return listener


def _print_url(url: str) -> None:
    print(f"keypose studio: {url}", flush=True)


def _show(url: str) -> None:
    """Open the URL in the user's browser, where there is a desktop to open it on."""
    if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        return  # webbrowser would start a text browser inside the terminal
    import webbrowser

    threading.Thread(target=webbrowser.open, args=(url,), daemon=True).start()
