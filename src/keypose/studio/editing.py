"""The project that a studio edits, and the pages that watch it. Everything here runs on the event loop.

The server's document is the one that counts. Pages send what they want changed; every watching page is told the difference
of the two documents, in order, whether it came of an edit, of undo or of an operator.
"""

from __future__ import annotations

import asyncio
import importlib.util
import itertools
import os
from collections.abc import Awaitable, Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from keypose.errors import FormatError, KeyposeError, UnknownName
from keypose.io.native import document_bytes
from keypose.model import Character, Clip, Document, Motion, Rig, Scene
from keypose.project.commands import AddCharacter, Command, RemoveCharacter, SetCurves, import_clip
from keypose.project.document import Difference, check_name, difference
from keypose.project.workspace import UNTITLED, NotSaved, Workspace
from keypose.rig import perform, rigged_skeleton
from keypose.studio import edit_messages as edits
from keypose.studio import messages
from keypose.studio.container import Body
from keypose.studio.edit_operators import operated, operator_specs
from keypose.studio.edit_wire import (
    Edit,
    Operation,
    complaint,
    difference_fields,
    document_fields,
    read_edit,
    read_operation,
    storing,
)
from keypose.studio.folders import listing
from keypose.studio.outbox import Outbox
from keypose.studio.payload import encode

if TYPE_CHECKING:
    from keypose.studio.session import Session


def exports() -> list[str]:
    """Formats that a project can be written as here, by suffix."""
    usd = ["usdz"] if importlib.util.find_spec("pxr") else []
    return ["keypose", "glb", "fbx", "bvh", "dae", *usd]


class Editing:
    """One open project for all pages of a studio.

    ``confined``: the only folder that projects are listed, opened and saved in, for studios that other machines reach.
    """

    def __init__(self, session: Session, workspace: Workspace | None = None, confined: Path | None = None) -> None:
        self._session, self._confined = session, confined
        self.workspace = Workspace() if workspace is None else workspace
        self.recoverable_count = 0
        self._watchers: set[Outbox] = set()
        self._turn = asyncio.Lock()  # one change after the other
        self._numbers = itertools.count(1)
        self._jobs = itertools.count(1)
        # (skeleton, parts, controls) -> entry; the things themselves are kept, so that their ids stay their own
        self._shown: dict[tuple[int, int, int], tuple[Any, messages.SceneEntry, bytes]] = {}

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
            except _REFUSALS as error:
                outbox.put(
                    messages.Failure("failure", _TITLES.get(type(request), "This cannot be done"), complaint(error))
                )

    async def look(self) -> None:
        """See what could be recovered, before the first page asks."""
        await self.recoverable()

    async def _handle(self, outbox: Outbox, request: edits.ProjectRequest) -> None:
        workspace = self.workspace
        match request:
            case edits.ProjectWatch():
                self._watchers.add(outbox)
                await self._send_state([outbox])
            case edits.ProjectNew(name=name, character=character, discard=discard):
                document = Document(name.strip() or UNTITLED)
                check_name(document.name, "project")
                if character:
                    for one in (await self._session.find_scene(character)).characters:
                        await self._entry(one)  # what cannot be shown is not added
                        document = AddCharacter(one).apply(document)
                await asyncio.to_thread(workspace.begin, document, discard=discard)
                await self._enter()
            case edits.ProjectOpen(path=path, discard=discard):
                self._allow(path)
                await asyncio.to_thread(workspace.open, path, discard=discard)
                await self._enter()
            case edits.ProjectSave(path=path, force=force):
                if path is not None:
                    self._allow(path)
                await self._save(outbox, path, force=force)
            case edits.ProjectUndo():
                await self._move("undo", workspace.undo)
            case edits.ProjectRedo():
                await self._move("redo", workspace.redo)
            case edits.ProjectRecover(id=id):
                await asyncio.to_thread(workspace.recover, id)
                await self._enter()
            case edits.ProjectDiscard(id=id):
                await asyncio.to_thread(workspace.discard, id)
                await self._send_state([outbox])
            case edits.ProjectBrowse(folder=folder):
                self._allow(folder or ".")
                outbox.put(await asyncio.to_thread(listing, folder))
            case edits.ProjectAddCharacter(source=source):
                scene = await self._session.find_scene(source)
                if not scene.characters:
                    raise UnknownName("character", source, ())
                for one in scene.characters:  # what cannot be shown is not added
                    await self._entry(one)
                await self._do([AddCharacter(one) for one in scene.characters], "Add character")
            case edits.ProjectRemoveCharacter(name=name):
                await self._do([RemoveCharacter(name)], f"Remove {name}")
            case edits.ProjectImportClip(source=source, animation=number):
                await self._import(await self._session.find_scene(source), number)

    async def edit(self, data: bytes) -> edits.EditResult:
        """A page's edit; answers once it cannot be lost any more."""
        id = ""
        try:
            asked: Edit = await asyncio.to_thread(read_edit, data)
            id = asked.id
            async with self._turn:
                await self._do(asked.commands, asked.label, merge=asked.merge, id=id)
                revision = self.workspace.history.revision
            # outside of the turn, so that edits that follow each other quickly wait for the disk together
            await asyncio.to_thread(self.workspace.sync)
        except _REFUSALS as error:
            return self._refused(id, error)
        return edits.EditResult(id, revision, "", "")

    async def operate(self, data: bytes) -> edits.EditResult:
        """Run an operator for a page, one step of undo; answers once its result cannot be lost any more."""
        id = ""
        try:
            asked: Operation = await asyncio.to_thread(read_operation, data)
            id = asked.id
            async with self._turn:
                done = await self._operate(asked)
                revision = self.workspace.history.revision
            await asyncio.to_thread(self.workspace.sync)
        except _REFUSALS as error:
            return self._refused(id, error)
        return edits.EditResult(id, revision, "", done)

    async def change(self, commands: Callable[[Document], list[Command]], label: str) -> edits.EditResult:
        """Do what another page makes of the document, one step of undo; answers once it cannot be lost any more."""
        try:
            async with self._turn:
                wanted = await asyncio.to_thread(commands, self.workspace.document)
                for command in wanted:
                    if isinstance(command, AddCharacter):
                        await self._entry(command.character)  # what cannot be shown is not added
                await self._do(wanted, label)
                revision = self.workspace.history.revision
            await asyncio.to_thread(self.workspace.sync)
        except _REFUSALS as error:
            return self._refused("", error)
        return edits.EditResult("", revision, "", "")

    async def export(self, kind: str, character: str | None, timeline: str | None) -> bytes:
        """The project, or a character with its timeline, as a file.

        Raises:
            KeyposeError: where the format cannot hold it, or it names what is not there.
        """
        if kind not in exports():
            raise UnknownName("export", kind[:20], exports())
        document = self.workspace.document
        if kind == "keypose":
            return await asyncio.to_thread(document_bytes, document)
        return await asyncio.to_thread(_exported, document, kind, character, timeline)

    def _refused(self, id: str, error: Exception) -> edits.EditResult:
        return edits.EditResult(id, self.workspace.history.revision, complaint(error), "")

    # ---- doing -------------------------------------------------------------------------------------------------------

    async def _do(self, commands: Any, label: str, *, merge: str = "", id: str = "") -> None:
        wanted: list[Command] = list(commands)
        name = label or "Edit"  # an empty one would say that there is nothing to undo

        async def act() -> str:
            await asyncio.to_thread(self.workspace.edit, wanted, name, merge=merge)
            return name

        await self._change("edit", id, act)

    async def _change(
        self, cause: Literal["edit", "undo", "redo", "save"], id: str, act: Callable[[], Awaitable[str]]
    ) -> None:
        """Do something to the document and tell every page the difference."""
        before = self.workspace.document
        label = await act()
        after = self.workspace.document
        body = Body()

        def compare() -> tuple[Difference, dict[str, Any]]:
            found = difference(before, after)
            return found, difference_fields(found, storing(body))

        found, fields = await asyncio.to_thread(compare)
        changed = edits.ProjectChanged(
            type="project_changed",
            status=self._status(),
            edit=id,
            label=label,
            cause=cause,
            rigs=self._session.rigging.data(after) if found.rigs or found.removed_rigs else None,
            characters=await self._characters() if found.characters or found.rigs or found.removed_rigs else None,
            settings=dict(after.settings) if found.settings else None,
            **fields,
        )
        for outbox in self._watchers:
            outbox.put(changed, None, body)

    async def _move(self, cause: Literal["undo", "redo"], act: Callable[[], str]) -> None:
        def move() -> str:
            label = act()
            self.workspace.sync()  # pages hear of it when it cannot be lost any more
            return label

        history = self.workspace.history
        if history.undo_label or history.steps if cause == "undo" else history.redo_steps:
            await self._change(cause, "", lambda: asyncio.to_thread(move))

    async def _operate(self, asked: Operation) -> str:
        """Change a clip by an operator; returns its report."""
        document = self.workspace.document
        job = f"operate {next(self._jobs)}"
        label = asked.operator.replace("_", " ").capitalize()[:60]
        self._session.broadcast(messages.Progress("progress", job, label, None, done=False), job)
        try:
            after, label, report = await asyncio.to_thread(operated, asked, document)
            # only what the operator changed goes to the journal
            commands: list[Command] = [
                SetCurves(change.clip.name, change.curves, change.removed, change.clip.euler_orders)
                for change in difference(document, after).clips
            ]
            if commands:
                await self._do(commands, label, id=asked.id)
        finally:
            self._session.broadcast(messages.Progress("progress", job, "", 1.0, done=True), job)
        return report

    async def _save(self, outbox: Outbox, path: str | None, *, force: bool) -> None:
        async def act() -> str:
            await asyncio.to_thread(self.workspace.save, path, force=force)
            return "Save"

        try:
            await self._change("save", "", act)
        except NotSaved as error:
            refused = edits.ProjectNotSaved("project_not_saved", error.path, error.reason, str(error))
            outbox.put(refused)

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
            unsafe=workspace.unsafe,
        )

    async def _enter(self) -> None:
        """Another project is open: every page gets all of it."""
        used = {(id(who.skeleton), id(who.parts)) for who in self.workspace.document.characters.values()}
        self._shown = {key: shown for key, shown in self._shown.items() if key[:2] in used}
        await self._send_state(self._watchers)

    def _allow(self, path: str) -> None:
        """Raises where the studio is confined to a folder, and this is outside of it."""
        if self._confined is not None:
            meant = Path(os.path.realpath(os.path.expanduser(path)))
            if not meant.is_relative_to(os.path.realpath(self._confined)):
                raise FormatError(f"other machines reach this studio, so it stays in {self._confined}", path=path)

    async def _send_state(self, outboxes: Any) -> None:
        body = Body()
        recoverable = await self.recoverable()
        state = edits.ProjectState(
            type="project_state",
            status=self._status(),
            characters=await self._characters(),
            rigs=self._session.rigging.data(self.workspace.document),
            recoverable=recoverable,
            operators=[spec.name for spec in await asyncio.to_thread(operator_specs)],
            exports=exports(),
            folder=str(Path.cwd()),
            **await asyncio.to_thread(document_fields, self.workspace.document, storing(body)),
        )
        for outbox in outboxes:
            outbox.put(state, None, body)
            for found in recoverable:
                if found.path and found.path == self.workspace.path:
                    text = f"{found.edits} changes of this project were not saved when its studio ended; they can be recovered"
                    outbox.put(messages.Notice("notice", "Unsaved work was found", text))

    async def recoverable(self) -> list[edits.Recoverable]:
        """Projects that were not saved before their studios ended."""
        found = await asyncio.to_thread(self.workspace.recoverable)
        self.recoverable_count = len(found)
        return [edits.Recoverable(u.id, u.name, u.path, u.edits, u.changed_s) for u in found]

    async def _characters(self) -> list[edits.ProjectCharacter]:
        document = self.workspace.document
        return [
            edits.ProjectCharacter(
                name, await self._entry(character, document.rig_of(name)), document.performs.get(name, "")
            )
            for name, character in document.characters.items()
        ]

    async def _entry(self, character: Character, rig: Rig | None = None) -> messages.SceneEntry:
        """The scene that shows a character; made once for its mesh and controls, whatever it is called.

        A rig's controls follow the joints in its skeleton: to a page they are joints that have a shape of their own.
        """
        controls = None if rig is None else rig.controls
        key = id(character.skeleton), id(character.parts), id(controls)
        if key not in self._shown:
            number = f"c{next(self._numbers)}"
            shown = character if rig is None else replace(character, skeleton=rigged_skeleton(rig, character.skeleton))
            data = await asyncio.to_thread(
                encode,
                Scene((shown,), format="keypose"),
                id=number,
                name=character.name,
                rig=rig,
            )
            self._shown[key] = (character, controls), messages.SceneEntry(number, character.name, len(data)), data
        return self._shown[key][1]


_REFUSALS = (KeyposeError, OSError, MemoryError, ValueError)
"""What is told to a page; a ValueError is, for example, a path that the system cannot spell."""


def _exported(document: Document, kind: str, character: str | None, timeline: str | None) -> bytes:
    """A character with its timeline, or the other way round; all of the project where neither is named."""
    from keypose.studio.app import written

    if character is None and timeline is not None:
        document.timeline(timeline)
        character = next((who for who, name in document.performs.items() if name == timeline), None)
        character = next(iter(document.characters), None) if character is None else character
    return written(perform(document, character, timeline), kind)


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
