"""Rigs for the editor's page: what it asks becomes commands of the project, and poses of controls become poses of joints.

The rig is evaluated here alone; the page samples curves itself and asks for what controls make of joints.
"""

from __future__ import annotations

import asyncio
import itertools
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from keypose.arrays import Array, Floats
from keypose.errors import KeyposeError, UnknownName
from keypose.evaluate import bake_timeline
from keypose.evaluate.performing import BASE_LAYER
from keypose.io.json_values import Json
from keypose.io.native_rigs import MODULES
from keypose.model import (
    Character,
    Clip,
    Document,
    Layer,
    LimbModule,
    Module,
    Motion,
    Placement,
    Pose,
    Rig,
    SpineModule,
    Timeline,
    module_controls,
    module_joints,
)
from keypose.project.commands import Command, RemoveRig, SetClip, SetRig, SetTimeline, import_clip
from keypose.project.document import foreign_joints
from keypose.rig import (
    RigFit,
    auto_rig,
    bake_rig_timeline,
    fit_controls,
    is_keyed,
    match_fk_to_ik,
    match_ik_to_fk,
    mirror_controls,
    sample_rig,
    solve_rig,
    switch_space,
)
from keypose.studio import messages
from keypose.studio import rig_messages as r
from keypose.studio.container import Body, pack
from keypose.studio.edit_messages import EditResult
from keypose.studio.edit_wire import opened

if TYPE_CHECKING:
    from keypose.studio.session import Session

POSE_LIMIT_BYTES = 64 * 1024 * 1024
MOST_TRACK_FRAMES = 20_000

_KINDS = {module: kind for kind, module in MODULES.items()}


def rig_data(rig: Rig, revision: int) -> r.RigData:
    """A rig as the page knows it."""
    rest = rig.controls.rest
    controls = [
        r.RigControl(
            name=look.name,
            parent=int(parent),
            translation=rest.translations[n].tolist(),
            rotation=rest.rotations[n].tolist(),
            scale=rest.scales[n].tolist(),
            shape=look.shape.value,
            size_m=look.size_m,
            offset_m=list(look.offset_m),
            side=look.side.value,
            spaces=[s.name for s in look.spaces],
            space_attribute=look.space_attribute if len(look.spaces) > 1 else "",
            moves=[p.value for p in look.moves],  # type: ignore[misc]
        )
        for n, (look, parent) in enumerate(zip(rig.looks, rig.controls.parents, strict=True))
    ]
    attributes = [
        r.RigAttribute(a.name, a.control, a.default, a.minimum, a.maximum, list(a.choices), a.angle)
        for a in rig.attributes
    ]
    known = {a.name for a in rig.attributes}
    return r.RigData(
        rig.name, rig.character, revision, controls, attributes, [_module(module, known) for module in rig.modules]
    )


def _module(module: Module, known: set[str]) -> r.RigModule:
    switch = f"{module.name}.ik"
    fk = list(module.controls)
    has_switch = isinstance(module, LimbModule | SpineModule) and switch in known
    ik = [c for c in module_controls(module) if c not in fk] if has_switch else []
    return r.RigModule(
        module.name,
        _KINDS[type(module)],
        list(module_joints(module)),
        fk,
        ik,
        switch if has_switch else "",
    )


class Rigging:
    """What the edit pages of one studio ask of rigs."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._jobs = itertools.count(1)
        self._numbers = itertools.count(1)
        self._revisions: dict[int, tuple[Rig, int]] = {}  # a rig is kept with its number, so that its id stays its own

    def data(self, document: Document) -> list[r.RigData]:
        """All rigs of a document."""
        return [rig_data(rig, self._revision(rig)) for rig in document.rigs.values()]

    def _revision(self, rig: Rig) -> int:
        if id(rig) not in self._revisions:
            while len(self._revisions) >= 256:
                del self._revisions[next(iter(self._revisions))]
            self._revisions[id(rig)] = rig, next(self._numbers)
        return self._revisions[id(rig)][1]

    async def change(self, asked: r.RigAsked) -> EditResult:
        """Change the project as a page asks; one step of undo."""
        label, work = {
            r.RigAdd: ("Add rig", "Making controls"),
            r.RigFit: ("Fit rig to motion", "Fitting the controls"),
            r.RigBake: ("Bake rig to joints", "Baking the rig"),
            r.RigRemove: ("Remove rig", "Removing the rig"),
        }[type(asked)]
        job = f"rig {next(self._jobs)}"
        self._session.broadcast(messages.Progress("progress", job, work, None, done=False), job)
        said: list[str] = []
        try:
            done = await self._session.editing.change(lambda document: _commands(document, asked, said), label)
        finally:
            self._session.broadcast(messages.Progress("progress", job, "", 1.0, done=True), job)
        return replace(done, report="; ".join(said)) if not done.error else done

    async def pose(self, data: bytes) -> bytes:
        """What controls make of joints.

        Raises:
            KeyposeError: where the request is damaged or does not fit the rig.
        """
        document = self._session.editing.workspace.document
        return await asyncio.to_thread(self._posed, data, document)

    async def track(self, name: str, timeline: str) -> bytes:
        """What a timeline makes of a rig, frame by frame.

        Raises:
            KeyposeError: where there is no such rig or timeline, or it is too long.
        """
        document = self._session.editing.workspace.document
        return await asyncio.to_thread(self._tracked, document, name, timeline)

    def _posed(self, data: bytes, document: Document) -> bytes:
        header, fetch = opened(data, "rig_pose")
        rig = document.rig(header.text("rig"))
        skeleton = document.character(rig.character).skeleton
        controls = _transforms(fetch(header.need("controls")), rig.controls.joint_count, header.need("controls"))
        base = _transforms(fetch(header.need("joints")), skeleton.joint_count, header.need("joints"))
        given = fetch(header.need("values"))
        if given.shape != (*controls.batch_shape, len(rig.attributes)) or base.batch_shape != controls.batch_shape:
            header.fail(f"expected (B, {len(rig.attributes)}) values and as many poses of controls and joints")
        values: dict[str, Array] = {a.name: given[..., n] for n, a in enumerate(rig.attributes)}
        wish = header.text("wish")
        match wish:
            case "none":
                pass
            case "match_ik_to_fk" | "match_fk_to_ik":
                function = match_ik_to_fk if wish == "match_ik_to_fk" else match_fk_to_ik
                modules = [str(each.value) for each in header.items("modules")]
                controls, values = function(rig, skeleton, controls, values, base, modules or None)
            case "switch_space":
                look = rig.control(header.text("control"))
                number = header.integer("space")
                if not 0 <= number < len(look.spaces):
                    raise UnknownName(f"space of '{look.name}'", str(number), [s.name for s in look.spaces])
                controls, values = switch_space(
                    rig, skeleton, look.name, look.spaces[number].name, controls, values, base
                )
            case "mirror":
                controls, values = mirror_controls(rig, controls, values)
            case _:
                header.fail(f"no wish '{wish[:40]}'")
        solved = solve_rig(rig, skeleton, controls, values, base)
        body = Body()
        batch = controls.batch_shape
        after = np.stack([np.broadcast_to(values[a.name], batch) for a in rig.attributes], axis=-1) if values else given
        return pack(
            r.RigPosed(
                "rig_posed",
                rig.name,
                self._revision(rig),
                keyed=True,
                start_s=0.0,
                rate_hz=0.0,
                joints=body.add(_numbers(solved.pose), "float64"),
                model_from_control=body.add(solved.model_from_control, "float64"),
                model_from_frame=body.add(solved.model_from_frame, "float64"),
                controls=body.add(_numbers(controls), "float64"),
                values=body.add(after, "float64"),
            ),
            body,
        )

    def _tracked(self, document: Document, name: str, timeline: str) -> bytes:
        rig = document.rig(name)
        skeleton = document.character(rig.character).skeleton
        line = document.timeline(timeline)
        count = int(np.floor((line.end_s - line.start_s) * line.rate_hz + 1e-6)) + 1
        if count > MOST_TRACK_FRAMES:
            raise KeyposeError(f"timeline '{timeline}': {count} frames; at most {MOST_TRACK_FRAMES} are played")
        times = line.start_s + np.arange(max(count, 1)) / line.rate_hz
        solved = sample_rig(rig, skeleton, line, document.clips, times)
        body = Body()
        return pack(
            r.RigPosed(
                "rig_posed",
                rig.name,
                self._revision(rig),
                keyed=is_keyed(rig, line, document.clips),
                start_s=line.start_s,
                rate_hz=line.rate_hz,
                joints=body.add(_numbers(solved.pose), "float32"),
                model_from_control=body.add(solved.model_from_control, "float32"),
                model_from_frame=body.add(solved.model_from_frame, "float32"),
                controls=None,
                values=None,
            ),
            body,
        )


def _transforms(numbers: Array, count: int, where: Json) -> Pose:
    if numbers.dtype != np.float64 or numbers.ndim != 3 or numbers.shape[1:] != (count, 10):
        where.fail(f"expected (B, {count}, 10) float64, got {numbers.shape} {numbers.dtype}")
    lengths = np.linalg.norm(numbers[..., 3:7], axis=-1, keepdims=True)
    if not np.all(lengths > 1e-6):
        where.fail("expected rotations, got quaternions of no length")
    return Pose(numbers[..., :3], numbers[..., 3:7] / lengths, numbers[..., 7:])


def _numbers(pose: Pose) -> Floats:
    pose = pose.broadcast()
    return np.concatenate([pose.translations, pose.rotations, pose.scales], axis=-1)


# ---- commands ----------------------------------------------------------------------------------------------------------


def _commands(document: Document, asked: r.RigAsked, said: list[str]) -> list[Command]:
    match asked:
        case r.RigAdd(character=name, fit=fit):
            who = document.character(name)
            if document.rig_of(name) is not None:
                raise KeyposeError(f"'{name}' has a rig already")
            rig = replace(_automatic(document, who), name=name, character=name)
            said.append(f"{rig.controls.joint_count} controls")
            wanted: list[Command] = [SetRig(rig)]
            line = _timeline(document, name)
            if fit and line is not None and _moves(document, line):
                wanted += _fitted(document, rig, who, line, said)
            return wanted
        case r.RigFit(rig=name):
            rig = document.rig(name)
            line = _timeline(document, rig.character)
            if line is None:
                raise KeyposeError(f"no timeline moves '{rig.character}'")
            return _fitted(document, rig, document.character(rig.character), line, said)
        case r.RigBake(rig=name):
            return _baked(document, document.rig(name), said)
        case r.RigRemove(rig=name, bake=bake):
            rig = document.rig(name)
            line = _timeline(document, rig.character)
            keyed = line is not None and is_keyed(rig, line, document.clips)
            return [*(_baked(document, rig, said) if bake and keyed else ()), RemoveRig(name)]


def _automatic(document: Document, who: Character) -> Rig:
    """An automatic rig whose controls are not called like joints of other bodies here, whose clips would move them."""
    others = {name for one in document.characters.values() for name in one.skeleton.names}
    rig = auto_rig(who.skeleton, who.roles or None, character=who, taken=others)
    strange = {n for clip in document.clips.values() for n in foreign_joints(document, clip, rig.controls.names)}
    if strange.isdisjoint(rig.controls.names):
        return rig
    return auto_rig(who.skeleton, who.roles or None, character=who, taken=others | strange)


def _timeline(document: Document, character: str) -> Timeline | None:
    name = document.performs.get(character)
    return None if name is None else document.timeline(name)


def _moves(document: Document, line: Timeline) -> bool:
    """Whether a timeline moves anything."""
    placed = {p.animation for layer in line.layers for p in layer.placements}
    return any(document.clips[name].curves for name in placed if name in document.clips)


def _joints(document: Document, rig: Rig, who: Character, line: Timeline) -> Motion:
    """What a timeline makes of the joints, by its controls where it has keys on them."""
    arguments = line, document.clips, line.rate_hz, who.morph_names, who.rest_morph_weights
    if is_keyed(rig, line, document.clips):
        return bake_rig_timeline(rig, who.skeleton, *arguments)
    return bake_timeline(line, document.clips, who.skeleton, *arguments[2:])


def _fitted(document: Document, rig: Rig, who: Character, line: Timeline, said: list[str]) -> list[Command]:
    motion = _joints(document, rig, who, line)
    fit = fit_controls(rig, who.skeleton, motion)
    said.append(_closeness(fit))
    return _performing(document, fit.clip, line, f"{who.name} controls")


def _closeness(fit: RigFit) -> str:
    """How near joints are to what they were, for people; nobody sees less than a hundredth of a millimetre."""
    if max(fit.error_m, fit.ik_error_m) < 1e-5 and fit.error_deg < 1e-3:
        return "the motion stays as it was, by FK and by IK"
    by_ik = "" if fit.ik_error_m < 1e-5 else f"; by IK within {1000 * fit.ik_error_m:.2f} mm"
    if fit.error_m < 1e-5 and fit.error_deg < 1e-3:
        return f"the motion stays as it was by FK{by_ik}"
    return f"joints stay within {1000 * fit.error_m:.2f} mm and {fit.error_deg:.2f}°{by_ik}"


def _baked(document: Document, rig: Rig, said: list[str]) -> list[Command]:
    who = document.character(rig.character)
    line = _timeline(document, rig.character)
    if line is None or not is_keyed(rig, line, document.clips):
        raise KeyposeError(f"'{rig.character}' has no keys on controls to bake")
    motion = _joints(document, rig, who, line)
    said.append(f"{motion.frame_count} frames")
    clip = import_clip(document, replace(motion, name=f"{who.name} baked")).clip
    return _performing(document, clip, line, clip.name)


def _performing(document: Document, clip: Clip, line: Timeline, wanted: str) -> list[Command]:
    """A new clip that takes the place of all that a timeline played; the clips that it played stay in the project."""
    name = wanted
    for n in itertools.count(2):
        if name not in document.clips:
            break
        name = f"{wanted} {n}"
    layer = Layer(BASE_LAYER, (Placement(name, in_s=0.0),))
    return [SetClip(replace(clip, name=name, rate_hz=line.rate_hz)), SetTimeline(replace(line, layers=(layer,)))]
