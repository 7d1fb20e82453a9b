"""Operators that work on joints, for characters whose controls are keyed: on what the rig makes of them, and back onto controls."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from keypose.arrays import Array, Floats
from keypose.editing.framed import clip_rate, edit_frames, put_frames, selected_frames
from keypose.editing.operator_types import Operated
from keypose.editing.operators import OPERATORS, run_operator
from keypose.editing.selection import Selection
from keypose.evaluate import bake, sample_curve, to_clip
from keypose.model import (
    Channel,
    Clip,
    CurveKind,
    Document,
    LimbModule,
    Motion,
    Pose,
    Property,
    Rig,
    Skeleton,
    module_controls,
    module_joints,
)
from keypose.rig import bake_rig, fit_controls

ON_JOINTS = frozenset({"plant_feet", "reach", "bend_path", "pose_fall_off", "spacetime"})
"""Operators that look at a body and where it is; the others change the curves that they are given."""

_SAME = 1e-6  # of rotations, metres and numbers: what is nearer is what it was


def rig_of_clip(document: Document, character: str, clip: Clip) -> Rig | None:
    """The rig that a character's clip has keys for; None where its joints are keyed."""
    rig = document.rig_of(character)
    if rig is None:
        return None
    known = set(rig.controls.names) | {a.name for a in rig.attributes}
    return rig if any(channel.target in known for channel in clip.curves) else None


def operate_on_rig(
    name: str, clip: Clip, rig: Rig, skeleton: Skeleton, selection: Selection, parameters: Mapping[str, Any]
) -> Operated:
    """A clip of controls after an operator on the joints: keys on controls in the frames that changed, and only there.

    Controls that are selected stand for the joints that they move. Switches and spaces stay as they are where the change begins.

    Raises:
        KeyposeError: as `run_operator` and `fit_controls` do.
    """
    rate = clip_rate(clip)
    before = bake_rig(rig, skeleton, clip, rate)
    span = selected_frames(clip, selection)
    times = None if span is None else before.times_s[list(span)]
    joints = _joints_of(rig, [c.target for c in selection.channels or ()])
    given = dict(parameters)
    if given.get("joint"):
        given["joint"] = (_joints_of(rig, [given["joint"]]) or [given["joint"]])[0]
    elif joints and any(p.name == "joint" for p in OPERATORS[name].parameters):
        given["joint"] = joints[0]
    whole = Selection() if times is None else Selection(start_s=float(times[0]), end_s=float(times[1]))
    own = to_clip(before)
    done = run_operator(name, own, skeleton, whole, given)
    after = bake(done.clip, skeleton, rate)
    frames = _changed(before.pose.broadcast(), after.pose.broadcast())
    if len(frames) == 0:
        return Operated(clip, done.report)
    return Operated(_onto_controls(clip, rig, skeleton, after, int(frames[0]), int(frames[-1])), done.report)


def _joints_of(rig: Rig, names: list[str]) -> list[str]:
    """The joints that controls move, in the order of the controls; the goal of a limb moves its end."""
    found: list[str] = []
    for name in names:
        for module in rig.modules:
            joints = module_joints(module)
            if isinstance(module, LimbModule) and name in (module.goal, module.pole):
                found.append(module.joints[-1])
            elif isinstance(module, LimbModule) and module.foot is not None and name == module.foot.toes_control:
                found.append(module.foot.toes_joint)
            elif name in module.controls and joints:
                found.append(joints[min(module.controls.index(name), len(joints) - 1)])
            elif name in module_controls(module) and joints:
                found.append(joints[-1])
    return list(dict.fromkeys(found))


def _changed(a: Pose, b: Pose) -> np.ndarray:
    away = [np.abs(x - y).max(axis=(1, 2)) for x, y in ((a.translations, b.translations), (a.scales, b.scales))]
    turned = 1.0 - np.abs(np.sum(np.asarray(a.rotations) * b.rotations, axis=-1)).min(axis=1)
    return np.flatnonzero((np.maximum(*away) > _SAME) | (turned > _SAME**2))


def _onto_controls(clip: Clip, rig: Rig, skeleton: Skeleton, after: Motion, first: int, last: int) -> Clip:
    """The clip with keys on controls that make a motion of the joints from one frame to another."""
    frames = np.arange(first, last + 1)
    pose = after.pose.broadcast()
    part = Motion(
        after.joint_names,
        Pose(pose.translations[frames], pose.rotations[frames], pose.scales[frames]),
        after.rate_hz,
        start_s=float(after.times_s[first]),
    )
    old = {a.name: _values(clip, a.name, a.default, after.times_s) for a in rig.attributes}
    kept = {f"{m.name}.ik" for m in rig.modules} | {c.space_attribute for c in rig.looks}
    held = {n: float(v[first]) for n, v in old.items() if n in kept or any(n.startswith(f"{c}.") for c in kept)}
    fit = fit_controls(rig, skeleton, part, held)

    def change(controls: Motion) -> Motion:
        now = controls.pose.broadcast()
        fitted = fit.control_pose.broadcast()
        parts: list[Array] = []
        for a, b, axis in (
            (now.translations, fitted.translations, False),
            (now.rotations, fitted.rotations, True),
            (now.scales, fitted.scales, False),
        ):
            out = np.array(a, np.float64)
            same = np.abs(np.abs(np.sum(out[frames] * b, axis=-1)) - 1.0) < _SAME**2 if axis else None
            near = np.abs(out[frames] - b).max(axis=-1) < _SAME if same is None else same
            out[frames] = np.where(near[..., None], out[frames], b)
            parts.append(out)
        return replace(controls, pose=Pose(*parts))

    changed = edit_frames(clip, rig.controls, change)
    curves = dict(changed.curves)
    for name, value in fit.values.items():
        new = np.array(old[name])
        new[frames] = np.broadcast_to(value, (len(frames),))
        moved = np.abs(new - old[name]) > _SAME
        if name in held or not moved.any():
            continue
        channel = Channel(name, Property.VALUE)
        curves[channel] = put_frames(
            curves.get(channel), after.times_s, new[:, None], moved, old[name][:, None], CurveKind.SCALAR
        )
    return replace(changed, curves=curves)


def _values(clip: Clip, name: str, default: float, times_s: Floats) -> Floats:
    curve = clip.curves.get(Channel(name, Property.VALUE))
    return np.full(len(times_s), default) if curve is None else np.asarray(sample_curve(curve, times_s)).reshape(-1)
