"""The opened scenes of one studio and the browsers that look at them.

Everything here runs on the event loop; reading files and building payloads happens in threads.
"""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from keypose import __version__
from keypose.errors import KeyposeError, UnknownName
from keypose.model import Scene
from keypose.studio import messages
from keypose.studio.editing import Editing
from keypose.studio.outbox import Outbox
from keypose.studio.payload import encode
from keypose.studio.retarget import Retargeting
from keypose.studio.rigging import Rigging
from keypose.studio.uploads import open_upload

if TYPE_CHECKING:
    from keypose.project.workspace import Workspace
    from keypose.studio.desk import PlayDesk
    from keypose.studio.graphs import OpenedGraph

UPLOAD_LIMIT_BYTES = 512 * 1024 * 1024


class Session:
    """Scenes by id, kept as ready payloads, and graphs by id.

    ``start``: whether pages begin with looking at scenes, with playing the last of the graphs, or with editing the project.
    """

    def __init__(
        self,
        upload_limit_bytes: int = UPLOAD_LIMIT_BYTES,
        graphs: Sequence[OpenedGraph] = (),
        start: Literal["view", "play", "edit"] = "view",
        workspace: Workspace | None = None,
        confined: Path | None = None,
    ) -> None:
        self.upload_limit_bytes = upload_limit_bytes
        self.graphs = {opened.entry.id: opened for opened in graphs}
        self.desks: set[PlayDesk] = set()
        self.stages: dict[str, bytes] = {}
        self.takes: dict[str, Scene] = {}
        self._start: Literal["view", "play", "edit"] = start
        self._first_graph = graphs[-1].entry.id if graphs else ""
        self._take_numbers = itertools.count(1)
        self.outboxes: set[Outbox] = set()
        self._scenes: dict[str, tuple[messages.SceneEntry, bytes, Scene]] = {}
        self.editing = Editing(self, workspace, confined)
        self.retargeting = Retargeting(self)
        self.rigging = Rigging(self)
        self._expected = 0
        self._ids = itertools.count(1)
        self._jobs = itertools.count(1)
        self._work = asyncio.Semaphore(2)  # more readers at once would only take memory from each other

    # ---- what browsers see -------------------------------------------------------------------------------------------

    def join(self) -> Outbox:
        """A new browser: it is greeted with what is open."""
        outbox = Outbox()
        entries = [entry for entry, _, _ in self._scenes.values()]
        outbox.put(
            messages.Hello(
                type="hello",
                protocol=messages.PROTOCOL,
                version=__version__,
                upload_limit_bytes=self.upload_limit_bytes,
                scenes=entries,
                expected=len(entries) + self._expected,
                graphs=[opened.entry for opened in self.graphs.values()],
                start=self._start,
                graph=self._first_graph,
                recoverable=self.editing.recoverable_count,
            )
        )
        self.outboxes.add(outbox)
        return outbox

    def leave(self, outbox: Outbox) -> None:
        """A browser is gone."""
        self.outboxes.discard(outbox)
        self.editing.leave(outbox)

    def broadcast(self, message: messages.ServerMessage, replaces: str | None = None) -> None:
        """Tell every browser."""
        for outbox in self.outboxes:
            outbox.put(message, replaces)

    def payload(self, id: str) -> bytes | None:
        """The container of a scene, of a character that plays a graph or is edited, or of a retargeted motion; or None."""
        found = self._scenes.get(id)
        if found is not None:
            return found[1]
        return self.stages.get(id) or self.editing.payload(id) or self.retargeting.payload(id)

    def scene(self, id: str) -> Scene | None:
        """An opened scene."""
        found = self._scenes.get(id)
        return None if found is None else found[2]

    def entry(self, id: str) -> messages.SceneEntry | None:
        """How an opened scene is fetched."""
        found = self._scenes.get(id)
        return None if found is None else found[0]

    async def find_scene(self, source: str) -> Scene:
        """An opened scene by its id, or a built-in one by its ``sample:`` name.

        Raises:
            UnknownName: where there is none.
        """
        from keypose import samples

        if source.startswith(samples.PREFIX):
            return await asyncio.to_thread(samples.open_scene, source)
        scene = self.scene(source)
        if scene is None:
            raise UnknownName("scene", source[:60], ())
        return scene

    def next_take(self) -> str:
        """A new id for a recording."""
        return f"take{next(self._take_numbers)}"

    # ---- opening and closing -----------------------------------------------------------------------------------------

    async def add(self, name: str, scene: Scene) -> messages.SceneEntry:
        """Make a scene available."""
        id = f"s{next(self._ids)}"
        async with self._work:
            data = await asyncio.to_thread(encode, scene, id=id, name=name)
        entry = messages.SceneEntry(id, name, len(data))
        self._scenes[id] = (entry, data, scene)
        self.broadcast(messages.SceneReady("scene_ready", entry))
        return entry

    async def add_all(self, scenes: Iterable[tuple[str, Scene]]) -> None:
        """Make scenes available one after the other, in their order."""
        waiting = list(scenes)
        self._expected += len(waiting)
        for name, scene in waiting:
            try:
                await self.add(name, scene)
            except (KeyposeError, ValueError, MemoryError) as error:
                self.broadcast(messages.Failure("failure", f"{name} cannot be shown", str(error) or "too large"))
            finally:
                self._expected -= 1

    async def open_sample(self, name: str) -> None:
        """Open a built-in character; a name that does not exist is told to all."""
        from keypose import samples

        job = f"sample {next(self._jobs)}"
        self.broadcast(messages.Progress("progress", job, f"Making {name[:40]}", None, done=False), job)
        try:
            scene = await asyncio.to_thread(samples.load, name)
            await self.add(f"{samples.PREFIX}{name}", scene)
        except KeyposeError as error:
            self.broadcast(messages.Failure("failure", "This cannot be opened", str(error)))
        finally:
            self.broadcast(messages.Progress("progress", job, "", 1.0, done=True), job)

    def add_graph(self, opened: OpenedGraph) -> None:
        """Make a graph available, in place of one with the same id."""
        self.graphs[opened.entry.id] = opened
        self.broadcast(messages.GraphReady("graph_ready", opened.entry))

    def close(self, id: str) -> None:
        """Forget a scene."""
        if self._scenes.pop(id, None) is not None:
            self.broadcast(messages.SceneClosed("scene_closed", id))

    async def open_upload(self, data: bytes) -> messages.UploadResult:
        """Open dropped files.

        Raises:
            FormatError: where the upload itself is damaged.
        """
        job = f"upload {next(self._jobs)}"
        loop = asyncio.get_running_loop()

        def report(label: str, fraction: float) -> None:
            message = messages.Progress("progress", job, f"Reading {label}", fraction, done=False)
            loop.call_soon_threadsafe(self.broadcast, message, job)

        try:
            async with self._work:
                found = await asyncio.to_thread(open_upload, data, open_path, report)
            opened: list[messages.SceneEntry] = []
            errors = found.errors
            for graph in found.graphs:
                self.add_graph(graph)
            for name, scene in found.scenes:
                try:
                    opened.append(await self.add(name, scene))
                except (KeyposeError, ValueError, MemoryError) as error:
                    errors.append(f"{name}: {str(error) or 'too large'}")
            return messages.UploadResult(opened, errors, [graph.entry for graph in found.graphs])
        finally:
            self.broadcast(messages.Progress("progress", job, "", 1.0, done=True), job)


def open_path(path: Path) -> Scene:
    """The scene of one file on disk (never a sample reference)."""
    from keypose import io

    return io.load(path)


def open_references(references: Iterable[str]) -> list[tuple[str, Scene]]:
    """Name and scene of files and ``sample:`` references.

    Raises:
        FormatError, UnknownName: for the first one that cannot be opened.
    """
    from keypose import samples

    return [(r if r.startswith("sample:") else Path(r).name, samples.open_scene(r)) for r in references]
