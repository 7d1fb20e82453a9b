"""The way back: controls that give the joints a pose or motion, FK matched to IK and back, spaces changed without a jump."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Set
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np

from keypose.arrays import Array, Floats, finite
from keypose.errors import ShapeError, UnknownName
from keypose.evaluate import match, world_rotations_positions
from keypose.math import quat
from keypose.model import (
    Channel,
    Clip,
    Control,
    Curve,
    CurveKind,
    EyesModule,
    Interpolation,
    LimbModule,
    Motion,
    Pose,
    Property,
    Rig,
    Skeleton,
    SpineModule,
    TwistModule,
    module_joints,
)
from keypose.rig.frames import inverse, lengths, rotation, to_quat
from keypose.rig.modules import fit_owned, wanted
from keypose.rig.plan import CONTROL
from keypose.rig.solve import begin, run, solve_rig
from keypose.rig.state import State

Progress = Callable[[int, int], None]

# Differences of rounding are no keys.
_NOTHING = 1e-9
# Frames that are compared at once, so that long motions do not fill the memory.
_SPAN = 1024


@dataclass(frozen=True, slots=True, eq=False)
class RigFit:
    """Controls fitted to a motion.

    Shapes and units:
        clip: a key per frame on every control that leaves its rest, on attributes, on joints that the rig does not move, and on morphs.
        control_pose, values: the same as arrays, (T,).
        error_m, error_deg: the greatest difference of any joint's place and rotation to the motion, for the clip as it is.
        fk_error_m, ik_error_m: the same with every limb and the spine switched to FK, and to IK.
        worst: the joint where ``error_m`` is.
    """

    clip: Clip
    control_pose: Pose
    values: Mapping[str, Array]
    error_m: float
    error_deg: float
    fk_error_m: float
    ik_error_m: float
    worst: str


def fit_controls(
    rig: Rig,
    skeleton: Skeleton,
    motion: Motion,
    values: Mapping[str, float] | None = None,
    *,
    progress: Progress | None = None,
) -> RigFit:
    """Keys on controls that reproduce a motion of the joints, on the FK and on the IK side, so that switching does not jump.

    ``values`` sets attributes for the whole of it, such as switches and spaces. FK is exact; IK places the ends and the
    middle of limbs exactly, and turns their bones by the twist attributes; joints between hips and chest may differ with the
    spine's IK. The motion is matched to the skeleton by name.
    ``progress`` is called with (steps done, steps in all).

    Raises:
        ShapeError: where the rig does not fit the skeleton, or the motion has no frames or numbers that are not finite.
        UnknownName: where a value is no attribute.
    """
    if motion.frame_count == 0:
        raise ShapeError("motion: expected at least one frame")
    motion = match(motion, skeleton)
    base = _double(motion.pose.broadcast())
    finite(base.translations, "translations of the motion")
    finite(base.rotations, "rotations of the motion")
    done, steps = 0, 2 + 3 * len(range(0, motion.frame_count, _SPAN))

    def step() -> None:
        nonlocal done
        done += 1
        if progress is not None:
            progress(done, steps)

    state, _ = begin(rig, skeleton, None, values, base)
    _fit(state)
    step()
    controls = _control_pose(state, rig.controls, (motion.frame_count,))
    controls = Pose(controls.translations, quat.align_signs(controls.rotations), controls.scales)
    found = {
        name: np.broadcast_to(value, (motion.frame_count,))
        for name, value in state.values.items()
        if name in {a.name for a in rig.attributes}
    }
    del state  # of a long motion it is large
    passive = _passive(rig, skeleton, base)
    clip = Clip(
        {
            **_pose_curves(controls, rig.controls, motion.times_s),
            **_value_curves(rig, found, motion.times_s),
            **_pose_curves(passive, skeleton, motion.times_s),
            **_morph_curves(motion),
        },
        motion.name,
        motion.rate_hz,
    )
    step()
    want = world_rotations_positions(skeleton, base)
    distance, angle = _difference(rig, skeleton, controls, found, passive, want, step)
    joint = int(np.argmax(distance.max(axis=0))) if distance.size else 0
    sides = [
        float(_difference(rig, skeleton, controls, found | _switched(rig, to), passive, want, step)[0].max(initial=0.0))
        for to in (0.0, 1.0)
    ]
    return RigFit(
        clip,
        controls,
        MappingProxyType(found),
        float(distance.max(initial=0.0)),
        float(np.degrees(angle.max(initial=0.0))),
        sides[0],
        sides[1],
        skeleton.names[joint],
    )


def match_ik_to_fk(
    rig: Rig,
    skeleton: Skeleton,
    control_pose: Pose,
    values: Mapping[str, Any] | None = None,
    base_pose: Pose | None = None,
    modules: Iterable[str] | None = None,
) -> tuple[Pose, dict[str, Array]]:
    """Goals, poles and twists set to where limbs and spine are now, so that they may be switched to IK without a jump.

    Shapes as `evaluate_rig`; ``modules`` names limbs and spines, all where not given. Returns the controls and all values;
    the switches stay as they are.

    Raises:
        UnknownName: for a module that is not there.
        ShapeError: for one that has no IK, or where shapes do not fit.
    """
    return _matched(rig, skeleton, control_pose, values, base_pose, modules, to_ik=True)


def match_fk_to_ik(
    rig: Rig,
    skeleton: Skeleton,
    control_pose: Pose,
    values: Mapping[str, Any] | None = None,
    base_pose: Pose | None = None,
    modules: Iterable[str] | None = None,
) -> tuple[Pose, dict[str, Array]]:
    """FK controls set to where limbs and spine are now; the other direction of `match_ik_to_fk`.

    Raises:
        UnknownName: for a module that is not there.
        ShapeError: for one that has no IK, or where shapes do not fit.
    """
    return _matched(rig, skeleton, control_pose, values, base_pose, modules, to_ik=False)


def switch_space(
    rig: Rig,
    skeleton: Skeleton,
    control: str,
    space: str | Mapping[str, float],
    control_pose: Pose,
    values: Mapping[str, Any] | None = None,
    base_pose: Pose | None = None,
) -> tuple[Pose, dict[str, Array]]:
    """A control carried by another of its spaces, or by several, at the place where it is; returns the controls and all values.

    ``space`` is the label of one, or weights of 0 and more by label, of which the shares count.

    Raises:
        UnknownName: where there is no such control or space, or the rig has no weights for its spaces.
        ShapeError: where shapes do not fit, or no weight is above 0.
    """
    look = rig.control(control)
    labels = [s.name for s in look.spaces]
    shares = _shares(rig, look, {space: 1.0} if isinstance(space, str) else space)
    state, batch = begin(rig, skeleton, control_pose, values, base_pose)
    run(state)
    index = rig.controls.index(control)
    world = state.control(index)
    changed: set[str] = set()
    if len(labels) > 1:
        chosen = max(shares, key=lambda label: shares[label])
        state.values[look.space_attribute] = np.full(1, float(labels.index(chosen)))
        for label in labels:
            name = look.weight_attribute(label)
            if name in state.values:
                state.values[name] = np.full(1, shares.get(label, 0.0) if len(shares) > 1 else 0.0)
        changed = {look.space_attribute, *map(look.weight_attribute, labels)}
    own, _ = begin(rig, skeleton, control_pose, values, base_pose)
    own.local[index] = inverse(state.frame(index)) @ world
    return _control_pose(own, rig.controls, batch), _values(rig, state, batch, given=own, changed=changed)


def _matched(
    rig: Rig,
    skeleton: Skeleton,
    control_pose: Pose,
    values: Mapping[str, Any] | None,
    base_pose: Pose | None,
    modules: Iterable[str] | None,
    *,
    to_ik: bool,
) -> tuple[Pose, dict[str, Array]]:
    chosen = [m for m in rig.modules if isinstance(m, (LimbModule, SpineModule))]
    if modules is not None:
        chosen = [rig.module(name) for name in modules]
    posed, batch = begin(rig, skeleton, control_pose, values, base_pose)
    run(posed)
    own, _ = begin(rig, skeleton, control_pose, values, base_pose)
    own.joints = [posed.joint(j) for j in range(skeleton.joint_count)]
    own.controls = list(posed.controls)
    for module in chosen:
        if not isinstance(module, (LimbModule, SpineModule)):
            raise ShapeError(f"module '{module.name}' has no IK")
        before = dict(own.values)
        found = wanted(own, module)
        forward = {rig.controls.index(c) for c in module.controls}
        if not to_ik:
            own.values = before
        for control, world in found.items():
            if (control in forward) != to_ik:
                own.controls[control] = world
        # frames of the controls that were moved, in order, since one may carry another
        for kind, control in own.plan.order:
            if kind == CONTROL and control in found and (control in forward) != to_ik:
                own.local[control] = inverse(own.frame(control)) @ found[control]
        # a rolled foot carries its toes in another way than the foot of FK
        fit_owned(own, module)
    return _control_pose(own, rig.controls, batch), _values(rig, own, batch)


def _shares(rig: Rig, look: Control, weights: Mapping[str, float]) -> dict[str, float]:
    """Shares above 0, sum 1, of spaces that the control has."""
    labels = [s.name for s in look.spaces]
    known = {a.name for a in rig.attributes}
    for label, weight in weights.items():
        if label not in labels:
            raise UnknownName(f"space of '{look.name}'", label, labels)
        if not (math.isfinite(weight) and weight >= 0):
            raise ShapeError(f"space '{label}' of '{look.name}': expected a weight of 0 or more, got {weight}")
    whole = sum(weights.values())
    if whole <= 0:
        raise ShapeError(f"spaces of '{look.name}': expected a weight above 0")
    shares = {label: weight / whole for label, weight in weights.items() if weight > 0}
    for label in shares if len(shares) > 1 else ():
        if look.weight_attribute(label) not in known:
            raise UnknownName("attribute", look.weight_attribute(label), known)
    return shares


# ---- fitting -----------------------------------------------------------------------------------------------------------


def _fit(state: State) -> None:
    """Set controls and values from the joints, which are where the base pose has them."""
    rig = state.plan.rig
    wishes: dict[int, Floats] = {}
    for module in rig.modules:
        wishes.update(wanted(state, module))
    for kind, index in state.plan.order:
        if kind != CONTROL:
            fit_owned(state, rig.modules[index])
            continue
        frame = state.frame(index)
        wish = wishes.get(index)
        if wish is not None:
            state.local[index] = inverse(frame) @ wish
        state.frames[index], state.controls[index] = frame, frame @ state.local[index]


def _switched(rig: Rig, to: float) -> dict[str, Array]:
    return {m.attribute("ik"): np.array(to) for m in rig.modules if isinstance(m, (LimbModule, SpineModule))}


def _difference(
    rig: Rig,
    skeleton: Skeleton,
    controls: Pose,
    values: Mapping[str, Array],
    base: Pose,
    want: tuple[Array, Array],
    step: Callable[[], None],
) -> tuple[Floats, Floats]:
    """Distances and angles between joints as the rig has them and as they are wanted, (T, J)."""
    distances, angles = list[Floats](), list[Floats]()
    frames = len(base.rotations)
    for first in range(0, frames, _SPAN):
        span = slice(first, min(first + _SPAN, frames))
        own = {name: v[span] if np.ndim(v) else v for name, v in values.items()}
        pose = solve_rig(rig, skeleton, controls[span], own, base[span]).pose
        turned, places = world_rotations_positions(skeleton, pose)
        distances.append(np.sqrt(np.sum((places - want[1][span]) ** 2, axis=-1)))
        angles.append(np.asarray(quat.angle_between(turned, want[0][span])))
        step()
    return np.concatenate(distances), np.concatenate(angles)


def _passive(rig: Rig, skeleton: Skeleton, base: Pose) -> Pose:
    """The base pose of a fitted clip: the motion where no module moves a joint, and the lengths that IK takes from it."""
    moved = {
        skeleton.index(j) for m in rig.modules if not isinstance(m, (EyesModule, TwistModule)) for j in module_joints(m)
    }
    reaching = {skeleton.index(j) for m in rig.modules if isinstance(m, LimbModule) for j in module_joints(m)}
    driven = np.array([j in moved for j in range(skeleton.joint_count)])[:, None]
    fixed = np.array([j in moved and j not in reaching for j in range(skeleton.joint_count)])[:, None]
    rest = skeleton.rest
    return Pose(
        np.where(fixed, rest.translations, base.translations),
        np.where(driven, rest.rotations, base.rotations),
        np.where(driven, rest.scales, base.scales),
    )


def _pose_curves(pose: Pose, skeleton: Skeleton, times: Floats) -> dict[Channel, Curve]:
    """A key per frame where a joint or control leaves its rest; one key where it only stands elsewhere."""
    curves: dict[Channel, Curve] = {}
    rest = skeleton.rest
    parts = (
        (Property.TRANSLATION, CurveKind.VECTOR, pose.translations, rest.translations),
        (Property.ROTATION, CurveKind.ROTATION, pose.rotations, rest.rotations),
        (Property.SCALE, CurveKind.VECTOR, pose.scales, rest.scales),
    )
    for kind, curve_kind, values, at_rest in parts:
        full = np.broadcast_to(values, (len(times), *values.shape[-2:]))
        if curve_kind is CurveKind.ROTATION:
            full = quat.align_signs(np.asarray(full))
            sign = np.where(np.sum(full[:1] * at_rest, axis=-1, keepdims=True) < 0, -1.0, 1.0)
            full = full * sign
        away = np.abs(full - at_rest).max(axis=(0, 2), initial=0.0) > _NOTHING
        still = np.abs(full - full[:1]).max(axis=(0, 2), initial=0.0) <= _NOTHING
        for n in np.nonzero(away)[0]:
            keys = slice(0, 1) if still[n] else slice(None)
            curves[Channel(skeleton.names[n], kind)] = Curve(times[keys], full[keys, n], kind=curve_kind)
    return curves


def _value_curves(rig: Rig, values: Mapping[str, Array], times: Floats) -> dict[Channel, Curve]:
    curves: dict[Channel, Curve] = {}
    # one for each space of each control: they get keys where they say something
    mixing = {look.weight_attribute(space.name) for look in rig.looks for space in look.spaces}
    for name, value in values.items():
        if name in mixing and not np.any(value):
            continue
        moving = np.abs(value - value[:1]).max(initial=0.0) > _NOTHING
        keys = slice(None) if moving else slice(0, 1)
        mode = Interpolation.STEP if name.endswith(".space") else Interpolation.LINEAR
        curves[Channel(name, Property.VALUE)] = Curve(times[keys], value[keys, None], mode, kind=CurveKind.SCALAR)
    return curves


def _morph_curves(motion: Motion) -> dict[Channel, Curve]:
    if motion.morph_weights is None:
        return {}
    weights = {Channel(name, Property.WEIGHT): motion.morph_weights[:, n] for n, name in enumerate(motion.morph_names)}
    return {
        channel: Curve(motion.times_s, weight[:, None], kind=CurveKind.SCALAR) for channel, weight in weights.items()
    }


# ---- shapes ------------------------------------------------------------------------------------------------------------


def _control_pose(state: State, controls: Skeleton, batch: tuple[int, ...]) -> Pose:
    """Local frames of controls as a pose."""
    count = state.count
    frames = np.stack([np.broadcast_to(m, (count, 4, 4)) for m in state.local], axis=1)
    size = lengths(frames[..., :3, :3])
    size = np.where(np.abs(size - controls.rest.scales) < _NOTHING, controls.rest.scales, size)
    turned = to_quat(rotation(frames))
    toward = np.sum(turned * controls.rest.rotations, axis=-1, keepdims=True)
    arrays = (frames[..., :3, 3], np.where(toward < 0, -turned, turned), size)
    return Pose(*(a.reshape(*batch, *a.shape[1:]) for a in arrays))


def _values(
    rig: Rig, state: State, batch: tuple[int, ...], given: State | None = None, changed: Set[str] = frozenset()
) -> dict[str, Array]:
    """Attributes as they were given (drivers run again on them), but for the one that was changed."""
    source = state if given is None else given
    found: dict[str, Array] = {}
    for attribute in rig.attributes:
        value = (state if attribute.name in changed else source).values[attribute.name]
        found[attribute.name] = np.broadcast_to(value, (state.count,)).reshape(batch)
    return found


def _double(pose: Pose) -> Pose:
    turned = quat.normalize(np.asarray(pose.rotations, np.float64))
    return replace(
        pose,
        translations=np.asarray(pose.translations, np.float64),
        rotations=turned,
        scales=np.asarray(pose.scales, np.float64),
    )
