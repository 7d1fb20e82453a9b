"""The project that a studio edits, and the pages that watch it. Everything here runs on the event loop.

The server's document is the one that counts. Pages send what they want changed; every watching page is told the difference
of the two documents, in order, whether it came of an edit, of undo or of an operator.
"""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from keypose.errors import KeyposeError, UnknownName
from keypose.model import Character, Clip, Document, Motion, Scene
from keypose.project.commands import AddCharacter, Command, RemoveCharacter, import_clip
from keypose.project.document import difference
from keypose.project.workspace import Workspace
from keypose.studio import edit_messages as edits
from keypose.studio import messages
from keypose.studio.container import Body
from keypose.studio.edit_wire import Edit, complaint, difference_fields, document_fields, read_edit, storing
from keypose.studio.outbox import Outbox
from keypose.studio.payload import encode

if TYPE_CHECKING:
    from keypose.studio.session import Session

EXPORTS = ("keypose", "glb", "fbx", "bvh", "dae")


class Editing:
    """One open project for all pages of a studio."""

    def __init__(self, session: Session, workspace: Workspace | None = None) -> None:
        self._session = session
        self.workspace = Workspace() if workspace is None else workspace
        self._watchers: set[Outbox] = set()
        self._turn = asyncio.Lock()  # one change after the other
        self._numbers = itertools.count(1)
        self._jobs = itertools.count(1)
        # (skeleton, parts) -> entry; the character itself is kept, so that its ids stay its own
        self._shown: dict[tuple[int, int], tuple[Character, messages.SceneEntry, bytes]] = {}

    # ---- what pages see ----------------------------------------------------------------------------------------------

    def payload(self, id: str) -> bytes | None:
        """The scene of one of the project's characters; None where there is none of that id."""
        return next((data for _, entry, data in self._shown.values() if entry.id == id), None)

    def leave(self, outbox: Outbox) -> None:
        """A page is gone."""
        self._watchers.discard(outbox)

    async def handle(self, outbox: Outbox, request: edits.ProjectRequest) -> None:
        """Do what a page asks; what cannot be done is said to that page."""
        async with self._turn:
            try:
                await self._handle(outbox, request)
            except (KeyposeError, OSError, MemoryError) as error:
                outbox.put(
                    messages.Failure("failure", _TITLES.get(type(request), "This cannot be done"), complaint(error))
                )

    async def _handle(self, outbox: Outbox, request: edits.ProjectRequest) -> None:
        workspace = self.workspace
        match request:
            case edits.ProjectWatch():
                self._watchers.add(outbox)
                await self._send_state([outbox])
            case edits.ProjectNew(name=name, character=character):
                document = Document(name.strip() or "Untitled")
                if character:
                    for one in (await self._scene(character)).characters:
                        document = AddCharacter(one).apply(document)
                await asyncio.to_thread(workspace.begin, document)
                await self._send_state(self._watchers)
            case edits.ProjectUndo():
                await self._change("undo", "", lambda: asyncio.to_thread(workspace.undo))
            case edits.ProjectRedo():
                await self._change("redo", "", lambda: asyncio.to_thread(workspace.redo))
            case edits.ProjectAddCharacter(source=source):
                scene = await self._scene(source)
                if not scene.characters:
                    raise UnknownName("character", source, ())
                await self._do([AddCharacter(one) for one in scene.characters], "Add character")
            case edits.ProjectRemoveCharacter(name=name):
                await self._do([RemoveCharacter(name)], f"Remove {name}")
            case edits.ProjectImportClip(source=source, animation=number):
                await self._import(await self._scene(source), number)
            case _:
                raise KeyposeError("this is not possible yet")

    async def edit(self, data: bytes) -> edits.EditResult:
        """A page's edit; answers once it cannot be lost any more."""
        id = ""
        try:
            asked: Edit = await asyncio.to_thread(read_edit, data)
            id = asked.id
            async with self._turn:
                await self._do(asked.commands, asked.label, merge=asked.merge, id=id)
        except (KeyposeError, OSError, MemoryError) as error:
            return edits.EditResult(id, self.workspace.history.revision, complaint(error), "")
        return edits.EditResult(id, self.workspace.history.revision, "", "")

    # ---- doing -------------------------------------------------------------------------------------------------------

    async def _do(self, commands: Any, label: str, *, merge: str = "", id: str = "") -> None:
        wanted: list[Command] = list(commands)

        async def act() -> str:
            await asyncio.to_thread(self.workspace.edit, wanted, label, merge=merge)
            return label

        await self._change("edit", id, act)

    async def _change(
        self, cause: Literal["edit", "undo", "redo", "save"], id: str, act: Callable[[], Awaitable[str]]
    ) -> None:
        """Do something to the document and tell every page the difference."""
        before = self.workspace.document
        label = await act()
        after = self.workspace.document
        found = await asyncio.to_thread(difference, before, after)
        body = Body()
        changed = edits.ProjectChanged(
            type="project_changed",
            status=self._status(),
            edit=id,
            label=label,
            cause=cause,
            characters=await self._characters() if found.characters else None,
            settings=dict(after.settings) if found.settings else None,
            **difference_fields(found, storing(body)),
        )
        for outbox in self._watchers:
            outbox.put(changed, None, body)

    async def _import(self, scene: Scene, number: int) -> None:
        found: list[Clip | Motion] = list(scene.animations)
        if number >= 0:
            if number >= len(found):
                raise UnknownName("animation", str(number), [a.name for a in found])
            found = [found[number]]
        document, commands = self.workspace.document, list[Command]()
        for animation in found:
            command = await asyncio.to_thread(import_clip, document, animation)
            document = command.apply(document)
            commands.append(command)
        if commands:
            await self._do(commands, "Import clip" if len(commands) == 1 else f"Import {len(commands)} clips")

    async def _scene(self, source: str) -> Scene:
        """An opened scene by its id, or a built-in one."""
        from keypose import samples

        if source.startswith(samples.PREFIX):
            return await asyncio.to_thread(samples.open_scene, source)
        scene = self._session.scene(source)
        if scene is None:
            raise UnknownName("scene", source[:60], ())
        return scene

    # ---- saying ------------------------------------------------------------------------------------------------------

    def _status(self) -> edits.ProjectStatus:
        workspace = self.workspace
        history = workspace.history
        return edits.ProjectStatus(
            name=workspace.document.name,
            path=workspace.path,
            revision=history.revision,
            saved_revision=workspace.saved_revision,
            undo=history.undo_label,
            redo=history.redo_label,
        )

    async def _send_state(self, outboxes: Any) -> None:
        body = Body()
        state = edits.ProjectState(
            type="project_state",
            status=self._status(),
            characters=await self._characters(),
            recoverable=[],
            operators=[],
            exports=list(EXPORTS),
            folder=str(Path.cwd()),
            **document_fields(self.workspace.document, storing(body)),
        )
        for outbox in outboxes:
            outbox.put(state, None, body)

    async def _characters(self) -> list[edits.ProjectCharacter]:
        document = self.workspace.document
        return [
            edits.ProjectCharacter(name, await self._entry(character), document.performs.get(name, ""))
            for name, character in document.characters.items()
        ]

    async def _entry(self, character: Character) -> messages.SceneEntry:
        """The scene that shows a character; made once for its mesh, whatever it is called."""
        key = id(character.skeleton), id(character.parts)
        if key not in self._shown:
            number = f"c{next(self._numbers)}"
            data = await asyncio.to_thread(
                encode, Scene((character,), format="keypose"), id=number, name=character.name
            )
            self._shown[key] = character, messages.SceneEntry(number, character.name, len(data)), data
        return self._shown[key][1]


_TITLES: dict[type, str] = {
    edits.ProjectNew: "No project was begun",
    edits.ProjectOpen: "This project cannot be opened",
    edits.ProjectSave: "The project was not saved",
    edits.ProjectRecover: "This project cannot be recovered",
    edits.ProjectAddCharacter: "No character was added",
    edits.ProjectRemoveCharacter: "The character was not removed",
    edits.ProjectImportClip: "Nothing was imported",
    edits.ProjectBrowse: "This folder cannot be shown",
}
