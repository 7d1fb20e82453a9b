"""Opened animation graphs: where their files are found, and what is made of them once, for all pages that play them."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

from keypose.errors import FormatError, KeyposeError
from keypose.model import Character, Scene
from keypose.play import graph as g
from keypose.studio.messages import GraphEntry, SceneEntry
from keypose.studio.payload import encode

Opener = Callable[[str], Scene]

_stages = itertools.count(1)


@dataclass(frozen=True, slots=True, eq=False)
class Stage:
    """A graph that is ready to be played: the program, the character, and the scene that the browser draws it from."""

    program: g.Program
    character: Character
    scene: SceneEntry
    payload: bytes


class OpenedGraph:
    """A graph that pages can play. What it needs is read and built when `stage` is first called."""

    def __init__(
        self, id: str, name: str, definition: g.Graph, open_scene: Opener, *, path: Path | None = None
    ) -> None:
        self.entry = GraphEntry(id, name)
        self.definition = definition
        self._path, self._seen = path, _stamp(path)
        self._open_scene = open_scene
        self._stage: Stage | None = None
        self._lock = threading.Lock()

    def stage(self) -> Stage:
        """The graph, built; may be called from any thread.

        Raises:
            KeyposeError: where the graph names what is not there or does not fit.
        """
        with self._lock:
            if self._stage is None:
                self._stage = self._build()
            return self._stage

    def current(self) -> OpenedGraph:
        """This graph, or what its file has become since it was read (for graphs that have a file to stay).

        Raises:
            FormatError: where the file is no graph any more.
        """
        if self._path is None or _stamp(self._path) == self._seen:
            return self
        return graph_file(self.entry.id, self._path)

    def _build(self) -> Stage:
        # whoever plays wants to see the character travel, also where a game applies the root itself
        program, character = g.assemble(_travelling(self.definition), open_scene=self._open_scene)
        if character is None:
            raise g.GraphError("", "character", "the graph names none")
        id = f"stage{next(_stages)}"
        payload = encode(Scene((character,), format="keypose-graph"), id=id, name=self.entry.name)
        return Stage(program, character, SceneEntry(id, self.entry.name, len(payload)), payload)


def built_in(name: str) -> OpenedGraph:
    """A graph of `keypose.samples.graphs`; raises `UnknownName`."""
    from keypose.samples import PREFIX, graphs, open_scene

    return OpenedGraph(f"{PREFIX}{name}", name, graphs.load(name), open_scene)


def built_ins() -> list[OpenedGraph]:
    """All graphs of `keypose.samples.graphs`."""
    from keypose.samples import graphs

    return [built_in(name) for name in graphs.names()]


def graph_file(id: str, path: Path, *, only_beside: bool = False) -> OpenedGraph:
    """A graph file; its clips are looked for beside it, then where the program was started.

    ``only_beside``: nothing outside of the file's own folder is opened (for graphs that came through the browser).

    Raises:
        FormatError: where it is no graph; the message names file, node and field.
    """
    finder = scene_finder(path.parent, only_beside=only_beside)
    return OpenedGraph(id, path.name, g.load(path), finder, path=None if only_beside else path)


def open_graph(reference: str, id: str) -> OpenedGraph:
    """The graph that a user named, built, so that whatever is wrong with it is told at once.

    Raises:
        FormatError, UnknownName: where it cannot be played; the message names file, node and field.
    """
    from keypose.samples import PREFIX, graphs

    name = reference.removeprefix(PREFIX)
    if reference.startswith(PREFIX) or name in graphs.names():
        return built_in(name)
    return built(graph_file(id, Path(reference)), Path(reference))


def built(opened: OpenedGraph, path: Path) -> OpenedGraph:
    """The graph of a file, built now; raises `FormatError` naming the file."""
    try:
        opened.stage()
    except KeyposeError as error:
        raise FormatError(str(error), path=path) from None
    return opened


def is_graph_name(reference: str) -> bool:
    """Whether a user means a graph: a .json file, or the name of a built-in graph, with or without ``sample:``."""
    from keypose.samples import PREFIX, graphs

    if reference.removeprefix(PREFIX) in graphs.names():
        return reference.startswith(PREFIX) or not Path(reference).exists()
    return reference.lower().endswith(".json")


def scene_finder(folder: Path, *, only_beside: bool) -> Opener:
    """What opens the files that a graph names; each is read once."""
    from keypose.samples import PREFIX, open_scene

    @cache
    def opened(reference: str) -> Scene:
        if reference.startswith(PREFIX):
            return open_scene(reference)
        beside = folder / reference
        if only_beside:
            if not beside.resolve().is_relative_to(folder.resolve()):
                raise FormatError("is outside of what was dropped; drop it together with the graph", path=reference)
            if not beside.is_file():
                raise FormatError("was not dropped; drop it together with the graph", path=reference)
        return open_scene(str(beside if beside.exists() else reference))

    return opened


def _stamp(path: Path | None) -> tuple[int, int] | None:
    """When a file was changed and how long it is; None where it is not there."""
    try:
        found = None if path is None else path.stat()
    except OSError:
        return None
    return None if found is None else (found.st_mtime_ns, found.st_size)


def _travelling(graph: g.Graph) -> g.Graph:
    return graph if graph.apply_root else replace(graph, apply_root=True)
