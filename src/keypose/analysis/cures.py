"""Cures for what the doctor finds: another size, another heading, feet on the ground, a start without its first frames.

Each takes a scene and gives a new one; the commands that `examine` proposes are these.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from keypose.arrays import Array
from keypose.deform import pack
from keypose.errors import ShapeError
from keypose.evaluate import bake, key_rate, resample
from keypose.math import quat
from keypose.model import (
    Channel,
    Character,
    Clip,
    Curve,
    CurveKind,
    ForcePlate,
    Markers,
    Motion,
    Part,
    Pose,
    Property,
    Scene,
    Signals,
    Skeleton,
)

_NO_SKELETON = Skeleton((), np.zeros(0, np.int32), Pose(np.zeros((0, 3)), np.zeros((0, 4)), np.zeros((0, 3))))
_SIDES = ("in_tangents", "out_tangents")
_HANDLES = ("in_handles", "out_handles")


def scaled(scene: Scene, factor: float) -> Scene:
    """The scene with all lengths multiplied by ``factor``: joints, meshes, morphs, motions, markers, plates.

    Raises:
        ShapeError: where the factor is not above 0.
    """
    if not (np.isfinite(factor) and factor > 0):
        raise ShapeError(f"factor: expected a number above 0, got {factor}")

    def pose(old: Pose) -> Pose:
        return Pose(old.translations * factor, old.rotations, old.scales)

    def clip(old: Clip) -> Clip:
        moving = {c: _linear(curve, factor) for c, curve in old.curves.items() if c.property is Property.TRANSLATION}
        return replace(old, curves={**old.curves, **moving})

    characters = tuple(
        replace(
            c,
            skeleton=replace(
                c.skeleton,
                rest=pose(c.skeleton.rest),
                end_offsets=tuple((j, (x * factor, y * factor, z * factor)) for j, (x, y, z) in c.skeleton.end_offsets),
            ),
            parts=tuple(_scaled_part(part, factor) for part in c.parts),
        )
        for c in scene.characters
    )
    animations = tuple(clip(a) if isinstance(a, Clip) else a.with_pose(pose(a.pose)) for a in scene.animations)
    plates = tuple(replace(plate, origin=plate.origin * factor) for plate in scene.plates)
    return _with_capture(
        replace(scene, characters=characters, animations=animations, plates=plates),
        lambda points: points * factor,
        lambda residuals: residuals * factor,
    )


def turned(scene: Scene, degrees: float) -> Scene:
    """The scene turned about the vertical, counter-clockwise seen from above: 90 brings +Z to +X.

    Raises:
        ShapeError: where the angle is not finite.
    """
    if not np.isfinite(degrees):
        raise ShapeError(f"degrees: expected a finite angle, got {degrees}")
    angle = np.radians(degrees)
    turn = np.array([np.cos(angle / 2), 0.0, np.sin(angle / 2), 0.0])

    def rotations(old: Array) -> Array:
        return np.asarray(quat.multiply(turn, np.asarray(old, np.float64))).astype(old.dtype)

    def points(old: Array) -> Array:
        return np.asarray(quat.rotate(turn, np.asarray(old, np.float64))).astype(old.dtype)

    def curve(channel: Channel, old: Curve) -> Curve:
        if channel.property is Property.ROTATION:
            return _through(old, rotations)
        return _through(old, points) if channel.property is Property.TRANSLATION else old

    return _with_capture(_with_roots(scene, points, rotations, curve), points, None)


def raised(scene: Scene, metres: float) -> Scene:
    """The scene lifted by some metres; force plates stay where they are.

    Raises:
        ShapeError: where the height is not finite.
    """
    if not np.isfinite(metres):
        raise ShapeError(f"metres: expected a finite height, got {metres}")
    up = np.array([0.0, metres, 0.0])

    def points(old: Array) -> Array:
        return old + up.astype(old.dtype)

    def curve(channel: Channel, old: Curve) -> Curve:
        return replace(old, values=points(old.values)) if channel.property is Property.TRANSLATION else old

    lifted = _with_roots(scene, points, lambda rotations: rotations, curve)
    return replace(_with_capture(lifted, points, None), plates=scene.plates)


def without_first(scene: Scene, frames: int) -> Scene:
    """The scene without the first frames of its motions, markers and signals; what is left keeps its times.

    Raises:
        ShapeError: where nothing would be left, or a clip has no rate to count frames by.
    """
    animations = tuple(
        _cut_clip(a, frames) if isinstance(a, Clip) else _cut_motion(a, frames) for a in scene.animations
    )
    seconds = frames / scene.markers[0].rate_hz if scene.markers else 0.0
    return replace(
        scene,
        animations=animations,
        markers=tuple(_cut_markers(m, frames) for m in scene.markers),
        signals=tuple(_cut_signals(s, seconds) for s in scene.signals),
    )


def at_rate(scene: Scene, rate_hz: float) -> Scene:
    """The scene with every motion and clip as frames at one rate.

    Raises:
        ShapeError: where there is nothing that has a rate to change.
    """
    if not scene.animations:
        raise ShapeError(f"rate_hz: there is no animation to sample at {rate_hz:g} Hz")
    done: list[Clip | Motion] = []
    for animation in scene.animations:
        if isinstance(animation, Motion):
            done.append(resample(animation, rate_hz))
            continue
        moved = {c.target for c in animation.curves if c.property is Property.WEIGHT}
        if scene.characters:
            character = scene.characters[0]
            names = tuple(n for n in character.morph_names if n in moved)
            every: Array = character.rest_morph_weights
            rest = np.array([every[character.morph_index(n)] for n in names])
            done.append(bake(animation, character.skeleton, rate_hz, morph_names=names, rest_morph_weights=rest))
        else:
            done.append(bake(animation, _NO_SKELETON, rate_hz, morph_names=tuple(sorted(moved))))
    return replace(scene, animations=tuple(done))


def packed(scene: Scene, influences: int) -> tuple[Scene, list[str]]:
    """The scene with at most so many joints to a vertex, and what that changes."""
    notes: list[str] = []
    characters: list[Character] = []
    for character in scene.characters:
        parts: list[Part] = []
        for part in character.parts:
            if part.skin is not None and part.skin.influence_count > influences:
                skin, report = pack(part.skin, influences)
                notes.append(f"part '{part.name}': {report}")
                part = replace(part, skin=skin)
            parts.append(part)
        characters.append(replace(character, parts=tuple(parts)))
    return replace(scene, characters=tuple(characters)), notes


# --- pieces -----------------------------------------------------------------------------------------------------------------


def _scaled_part(part: Part, factor: float) -> Part:
    mesh = replace(part.mesh, positions=part.mesh.positions * factor)
    morphs, skin = part.morphs, part.skin
    if morphs is not None:
        morphs = replace(morphs, position_deltas=morphs.position_deltas * factor)
    if skin is not None:
        matrices = np.array(skin.joint_from_mesh)
        matrices[:, :3, 3] *= factor
        skin = replace(skin, joint_from_mesh=matrices)
    return replace(part, mesh=mesh, morphs=morphs, skin=skin)


def _linear(curve: Curve, factor: float) -> Curve:
    """The curve with values, tangents and the values of handles multiplied."""
    changed: dict[str, Any] = {"values": curve.values * factor}
    for name in _SIDES:
        if getattr(curve, name) is not None:
            changed[name] = getattr(curve, name) * factor
    for name in _HANDLES:
        if getattr(curve, name) is not None:
            handles = np.array(getattr(curve, name))
            handles[..., 1] *= factor
            changed[name] = handles
    return replace(curve, **changed)


def _through(curve: Curve, change: Callable[[Array], Array]) -> Curve:
    """The curve with a linear change of its values and tangents."""
    sides = {name: change(getattr(curve, name)) for name in _SIDES if getattr(curve, name) is not None}
    return replace(curve, values=change(curve.values), **sides)


def _with_roots(
    scene: Scene,
    points: Callable[[Array], Array],
    rotations: Callable[[Array], Array],
    curve: Callable[[Channel, Curve], Curve],
) -> Scene:
    """The scene with another transform of its roots, at rest and in every animation."""
    characters: list[Character] = []
    roots: set[str] = set()
    for character in scene.characters:
        skeleton = character.skeleton
        at = np.flatnonzero(np.asarray(skeleton.parents) < 0)
        roots.update(skeleton.names[j] for j in at)
        characters.append(
            replace(character, skeleton=replace(skeleton, rest=_moved(skeleton.rest, at, points, rotations)))
        )
    animations: list[Clip | Motion] = []
    for animation in scene.animations:
        if isinstance(animation, Clip):
            animation = _plain(animation, roots, scene.characters[0].skeleton if scene.characters else None)
        if isinstance(animation, Clip):
            own: Mapping[Channel, Curve] = {
                c: curve(c, old) if c.target in roots else old for c, old in animation.curves.items()
            }
            animations.append(replace(animation, curves=own))
        else:
            at = np.array([j for j, name in enumerate(animation.joint_names) if name in roots], np.int64)
            animations.append(animation.with_pose(_moved(animation.pose.broadcast(), at, points, rotations)))
    return replace(scene, characters=tuple(characters), animations=tuple(animations))


def _moved(pose: Pose, at: Any, points: Callable[[Array], Array], rotations: Callable[[Array], Array]) -> Pose:
    t, r = np.array(pose.translations), np.array(pose.rotations)
    t[..., at, :], r[..., at, :] = points(t[..., at, :]), rotations(r[..., at, :])
    return Pose(t, r, pose.scales)


def _plain(clip: Clip, roots: set[str], skeleton: Skeleton | None) -> Clip | Motion:
    """The clip itself, or baked where curves of single components or handles of a root cannot be moved one by one."""
    odd = any(
        c.target in roots
        and (
            c.component is not None
            or c.property is Property.EULER
            or (curve.in_handles is not None and curve.kind is not CurveKind.SCALAR)
        )
        for c, curve in clip.curves.items()
    )
    if not odd or skeleton is None:
        return clip
    morphs = tuple(c.target for c in clip.curves if c.property is Property.WEIGHT)
    return bake(clip, skeleton, key_rate(clip) or 60.0, morph_names=morphs)


def _with_capture(scene: Scene, points: Callable[[Array], Array], residuals: Callable[[Array], Array] | None) -> Scene:
    def markers(old: Markers) -> Markers:
        changed = None if old.residuals is None or residuals is None else residuals(old.residuals)
        return replace(old, positions=points(old.positions), residuals=old.residuals if changed is None else changed)

    def plate(old: ForcePlate) -> ForcePlate:
        return replace(old, corners=points(np.asarray(old.corners)))

    return replace(scene, markers=tuple(map(markers, scene.markers)), plates=tuple(map(plate, scene.plates)))


def _cut_motion(motion: Motion, frames: int) -> Motion:
    if motion.frame_count <= frames:
        raise ShapeError(f"motion '{motion.name}' has {motion.frame_count} frames; {frames} cannot be left out")
    pose = motion.pose.broadcast()
    weights = motion.morph_weights
    start = motion.start_s + frames / motion.rate_hz
    return replace(
        motion,
        pose=Pose(pose.translations[frames:], pose.rotations[frames:], pose.scales[frames:]),
        morph_weights=None if weights is None else weights[frames:],
        start_s=start,
        events=tuple(e for e in motion.events if e.time_s >= start),
    )


def _cut_clip(clip: Clip, frames: int) -> Clip:
    rate = key_rate(clip)
    if rate is None:
        raise ShapeError(
            f"clip '{clip.name}' has keys at uneven times, so it has no frames to leave out; give it a rate"
        )
    start = clip.start_s + (frames - 0.5) / rate
    curves: dict[Channel, Curve] = {}
    for channel, curve in clip.curves.items():
        first = min(int(np.searchsorted(curve.times_s, start)), curve.key_count - 1)
        names = ("times_s", "values", "modes", *_SIDES, *_HANDLES, "tangent_types")
        cut = {name: getattr(curve, name)[first:] for name in names if getattr(curve, name) is not None}
        curves[channel] = replace(curve, **cut)
    return replace(clip, curves=curves)


def _cut_markers(markers: Markers, frames: int) -> Markers:
    if markers.frame_count <= frames:
        raise ShapeError(f"the markers have {markers.frame_count} frames; {frames} cannot be left out")
    arrays = {
        n: getattr(markers, n)[frames:]
        for n in ("positions", "visible", "residuals", "cameras")
        if getattr(markers, n) is not None
    }
    return replace(markers, **arrays, start_frame=markers.start_frame + frames)


def _cut_signals(signals: Signals, seconds: float) -> Signals:
    return replace(signals, values=signals.values[round(seconds * signals.rate_hz) :])
