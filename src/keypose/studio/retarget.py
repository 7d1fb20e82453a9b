"""Retargeting for the studio's page: subjects with their roles, motions on other characters, files and edits made of them.

Everything here runs on the event loop; finding roles, retargeting and writing happen in threads.
"""

from __future__ import annotations

import asyncio
import itertools
import json
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import PurePath
from typing import TYPE_CHECKING

from keypose.errors import KeyposeError, UnknownName
from keypose.model import Character, Clip, Motion, Scene
from keypose.project.commands import AddCharacter, Command, RemoveClip, SetTimeline, import_clip
from keypose.studio import messages
from keypose.studio import retarget_messages as r
from keypose.studio.edit_messages import EditResult
from keypose.studio.edit_wire import complaint
from keypose.studio.editing import exports
from keypose.studio.payload import encode
from keypose.studio.retarget_inputs import beside, named_scenes, placed_props, props_of, source_stand, target_stand

if TYPE_CHECKING:
    from keypose.analysis import RoleMap
    from keypose.model import Document
    from keypose.retarget import RetargetResult
    from keypose.studio.session import Session

RESULTS_KEPT = 8
SAMPLES_KEPT = 12

_STANDS_ON = ("hips", "left_upper_leg", "right_upper_leg", "left_foot", "right_foot")
"""Roles without which there is no stand to begin with."""

_REFUSALS = (KeyposeError, ValueError, MemoryError, OSError)


@dataclass(frozen=True, slots=True)
class _Kept:
    """A scene that only this page shows."""

    entry: messages.SceneEntry
    payload: bytes
    scene: Scene


class Retargeting:
    """What the retarget pages of one studio share."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._numbers = itertools.count(1)
        self._jobs = itertools.count(1)
        self._turn = asyncio.Semaphore(1)  # one after the other: each takes a core for itself
        self._samples: dict[str, _Kept] = {}
        self._results: dict[str, _Kept] = {}

    def payload(self, id: str) -> bytes | None:
        """The container of a motion that was retargeted, or of a built-in scene; None where there is none of that id."""
        kept = self._results.get(id) or next((k for k in self._samples.values() if k.entry.id == id), None)
        return None if kept is None else kept.payload

    # ---- asking ------------------------------------------------------------------------------------------------------

    async def subject(self, asked: r.RetargetSubjectRequest) -> r.RetargetSubject:
        """A scene with the roles of its characters."""
        try:
            scene = await self._session.find_scene(asked.scene)
            entry = self._session.entry(asked.scene) or await self._sample(asked.scene, scene)
            found = await asyncio.to_thread(lambda: [_told(who, find_character_roles(who)) for who in scene.characters])
        except _REFUSALS as error:
            return r.RetargetSubject(None, [], complaint(error))
        return r.RetargetSubject(entry, found, "")

    async def roles(self, asked: r.RetargetRolesRequest) -> r.RetargetRoles:
        """The roles of a character where some are known.

        Raises:
            KeyposeError: for a scene, character, role or joint that does not exist.
        """
        scene = await self._session.find_scene(asked.scene)
        character = _character(scene, asked.character)
        known = _map(asked.known, character)
        return await asyncio.to_thread(
            lambda: _told(character, find_character_roles(character, {} if known is None else known.roles))
        )

    async def retarget(self, asked: r.RetargetRequest) -> r.RetargetDone:
        """Put a motion on a character; what cannot be done is in the answer."""
        job = f"retarget {next(self._jobs)}"
        try:
            source = await self._session.find_scene(asked.source)
            target = await self._session.find_scene(asked.target)
            others = {id: await self._session.find_scene(id) for id in named_scenes(asked)}
            async with self._turn:
                label = f"Retargeting {_animation(source, asked.animation).name or 'the motion'}"[:80]
                self._session.broadcast(messages.Progress("progress", job, label, None, done=False), job)
                return await asyncio.to_thread(self._retargeted, asked, source, target, others)
        except _REFUSALS as error:
            return _refused(complaint(error))
        finally:
            self._session.broadcast(messages.Progress("progress", job, "", 1.0, done=True), job)

    async def export(self, id: str, kind: str) -> bytes:
        """A retargeted motion with its character as a file.

        Raises:
            KeyposeError: where the format cannot hold it, or the motion or format is not known.
        """
        from keypose.studio.app import written

        if kind not in _kinds():
            raise UnknownName("export", kind[:20], _kinds())
        return await asyncio.to_thread(written, self._result(id).scene, kind)

    async def send_to_edit(self, id: str) -> EditResult:
        """Add the character and its motion to the project, one step of undo; the report is what it is called there."""
        try:
            scene = self._result(id).scene
        except KeyposeError as error:
            return EditResult("", 0, complaint(error), "")
        motion = scene.animations[0]
        label = f"Retarget {motion.name}"[:120]
        editing = self._session.editing
        result = await editing.change(lambda document: performance_commands(document, scene), label)
        return result if result.error else replace(result, report=list(editing.workspace.document.characters)[-1])

    # ---- doing -------------------------------------------------------------------------------------------------------

    async def _sample(self, name: str, scene: Scene) -> messages.SceneEntry:
        if name not in self._samples:
            id = f"m{next(self._numbers)}"
            data = await asyncio.to_thread(encode, scene, id=id, name=name)
            self._samples[name] = _Kept(messages.SceneEntry(id, name, len(data)), data, scene)
            while len(self._samples) > SAMPLES_KEPT:
                del self._samples[next(iter(self._samples))]
        return self._samples[name].entry

    def _name(self, source: str) -> str:
        entry = self._session.entry(source)
        return source if entry is None else entry.name

    def _result(self, id: str) -> _Kept:
        if id not in self._results:
            raise UnknownName("retargeted motion", id[:20], list(self._results))
        return self._results[id]

    def _retargeted(
        self, asked: r.RetargetRequest, source: Scene, target: Scene, others: Mapping[str, Scene]
    ) -> r.RetargetDone:
        from keypose.editing.planting import PlantOptions
        from keypose.evaluate import to_motion
        from keypose.retarget import HandOptions, ground_under, retarget
        from keypose.retarget.scenes import own_motion
        from keypose.studio.retarget_feet import found_feet

        own, other = _character(source, asked.source_character), _character(target, asked.target_character)
        began = time.perf_counter()
        animation = _animation(source, asked.animation)
        motion = to_motion(animation, own.skeleton, asked.rate_hz)

        roles = _roles(own, asked.source_roles), _roles(other, asked.target_roles)
        source_reference = source_stand(own, animation, asked.source_reference, others)
        target_reference, said = target_stand(other, target.animations, roles[1], asked.target_reference, others)
        props = props_of(asked)

        def run(plant: PlantOptions | None, hands: HandOptions | None) -> RetargetResult:
            return retarget(
                motion,
                own.skeleton,
                other.skeleton,
                source_roles=roles[0],
                target_roles=roles[1],
                source_reference=source_reference,
                target_reference=target_reference,
                target_motion=own_motion(other, target.animations) if target_reference is None else None,
                target_ground_m=ground_under(other, target_reference),
                scale=asked.scale,
                plant=plant,
                hands=hands,
            )

        done = run(
            PlantOptions() if asked.plant else None, HandOptions(props=props) if asked.keep_hands or props else None
        )
        took = time.perf_counter() - began
        loose = run(None, None).report.slide_cm_s if asked.plant else done.report.slide_cm_s
        scale = done.target.leg_m / done.source.leg_m if asked.scale is None else asked.scale
        name = animation.name or PurePath(asked.source.removeprefix("sample:")).stem
        result = replace(done.motion, name=name)
        kept = self._keep(Scene((other,), (result,), format="retarget", unit_m=target.unit_m), name)
        report = done.report
        return r.RetargetDone(
            id=kept.entry.id,
            scene=kept.entry,
            error="",
            name=name,
            frames=result.frame_count,
            rate_hz=float(result.rate_hz),
            took_s=took,
            scale=scale,
            direction_deg={bone: float(angle) for bone, angle in report.direction_deg.items()},
            mean_direction_deg=float(report.mean_direction_deg),
            source_slide_cm_s=float(report.source_slide_cm_s),
            loose_slide_cm_s=float(loose),
            slide_cm_s=float(report.slide_cm_s),
            worst_slide_cm_s=float(report.worst_slide_cm_s),
            sink_cm=float(report.sink_cm),
            contact_frames=int(report.contact_frames),
            hands_off_cm=report.hands_off_cm,
            props=placed_props(props, motion, done, scale),
            beside=beside(done, other, others[asked.against], self._name(asked.against)) if asked.against else None,
            feet=found_feet(done, motion, result),
            exports=_kinds(),
            notes=[*done.notes, *said],
        )

    def _keep(self, scene: Scene, name: str) -> _Kept:
        id = f"r{next(self._numbers)}"
        # the page has the character already: only the motion travels
        data = encode(replace(scene, characters=()), id=id, name=name)
        kept = self._results[id] = _Kept(messages.SceneEntry(id, name, len(data)), data, scene)
        while len(self._results) > RESULTS_KEPT:
            del self._results[next(iter(self._results))]
        return kept


def performance_commands(document: Document, scene: Scene) -> list[Command]:
    """What adds a scene's character to a document with its first animation on the character's own timeline."""
    adding = AddCharacter(scene.character)
    with_character = adding.apply(document)
    name = next(name for name in with_character.characters if name not in document.characters)
    timeline = with_character.timeline(with_character.performs[name])
    layer = timeline.layers[0]
    empty = layer.placements[0]
    adopted = import_clip(with_character, scene.animations[0])
    clip = adopted.clip
    placed = replace(empty, animation=clip.name, in_s=0.0)
    end_s = max(clip.start_s + clip.duration_s, 1.0 / timeline.rate_hz)
    performing = replace(
        timeline,
        layers=(replace(layer, placements=(placed,)), *timeline.layers[1:]),
        rate_hz=clip.rate_hz or timeline.rate_hz,
        start_s=clip.start_s,
        end_s=end_s,
    )
    return [adding, adopted, SetTimeline(performing), RemoveClip(empty.animation)]


def find_character_roles(character: Character, known: Mapping[str, int] | None = None) -> RoleMap:
    """The roles of a character's joints; those of ``known`` and of its file (a VRM names them) are kept."""
    from keypose.analysis import find_roles

    # what a person says counts more than what the file says
    file_says = {role: joint for role, joint in character.roles.items() if joint not in (known or {}).values()}
    return find_roles(character.skeleton, known={**file_says, **(known or {})} or None)


def _kinds() -> list[str]:
    return [kind for kind in exports() if kind != "keypose"]


def _character(scene: Scene, number: int) -> Character:
    if not 0 <= number < len(scene.characters):
        raise UnknownName("character", str(number), [c.name for c in scene.characters])
    return scene.characters[number]


def _animation(scene: Scene, number: int) -> Motion | Clip:
    if not 0 <= number < len(scene.animations):
        raise UnknownName("animation", str(number), [a.name for a in scene.animations])
    return scene.animations[number]


def _map(names: Mapping[str, str] | None, character: Character) -> RoleMap | None:
    from keypose.analysis import roles_from_json

    return None if names is None else roles_from_json(json.dumps(names), character.skeleton)


def _roles(character: Character, names: Mapping[str, str] | None) -> RoleMap | None:
    """A page's map; else what is found, where that is a humanoid (where it is none, retargeting says why)."""
    named = _map(names, character)
    if named is not None:
        missing = [role for role in _STANDS_ON if role not in named.roles]
        if missing:
            raise KeyposeError(f"no humanoid: nothing plays {', '.join(missing)}")
        return named
    found = find_character_roles(character)
    return found if found.is_humanoid else None


def _told(character: Character, found: RoleMap) -> r.RetargetRoles:
    names = character.skeleton.names
    return r.RetargetRoles(
        roles={role: names[joint] for role, joint in found.roles.items()},
        confidence={role: float(sure) for role, sure in found.confidence.items()},
        missing=list(found.missing),
        all_fours=found.on_all_fours,
        notes=list(found.notes),
    )


def _refused(error: str) -> r.RetargetDone:
    return r.RetargetDone(
        id="",
        scene=None,
        error=error,
        name="",
        frames=0,
        rate_hz=0.0,
        took_s=0.0,
        scale=1.0,
        direction_deg={},
        mean_direction_deg=0.0,
        source_slide_cm_s=0.0,
        loose_slide_cm_s=0.0,
        slide_cm_s=0.0,
        worst_slide_cm_s=0.0,
        sink_cm=0.0,
        contact_frames=0,
        hands_off_cm=None,
        props=[],
        beside=None,
        feet=[],
        exports=[],
        notes=[],
    )
