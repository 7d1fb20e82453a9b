"""Poses of controls mirrored: left and right change sides, what is in the middle turns over."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from keypose.arrays import Array, Floats, as_float, checked
from keypose.errors import UnknownName
from keypose.evaluate import world_rotations_positions
from keypose.math import quat
from keypose.model import LimbModule, Pose, Rig

_SIDES = {".L": ".R", ".R": ".L"}


def mirror_controls(
    rig: Rig, control_pose: Pose, values: Mapping[str, Any] | None = None
) -> tuple[Pose, dict[str, Array]]:
    """Controls and attributes of the pose that a mirror shows, across the plane between left and right of the first control.

    Shapes: ``control_pose`` (*B, N), ``values`` (*B,) by attribute; returns the controls and all values. Names that end in
    ``.L`` and ``.R`` are a pair; any other control is its own counterpart. Exact where both sides of the rig are mirror images
    at rest; spaces change sides too.

    Raises:
        ShapeError: where shapes do not fit.
        UnknownName: where a value is no attribute.
    """
    names, rest = rig.controls.names, rig.controls.rest
    checked(control_pose.rotations, (..., len(names), 4), "control_pose", f"the controls of rig '{rig.name}'")
    other = np.array([names.index(_other(name, names)) for name in names], np.intp)
    axes = quat.to_matrix(np.asarray(world_rotations_positions(rig.controls, rest)[0], np.float64))
    left = axes[0][:, 0]
    mirror = np.eye(3) - 2.0 * np.outer(left, left)
    # each control's own axes -> those of its counterpart, as a mirror shows them
    across = np.swapaxes(axes[other], -1, -2) @ mirror @ axes
    parents = rig.controls.parents
    above = np.where((parents < 0)[:, None, None], mirror, across[np.maximum(parents, 0)])
    steps = np.asarray(control_pose.translations, np.float64) - rest.translations
    turns = quat.multiply(quat.conjugate(rest.rotations), np.asarray(control_pose.rotations, np.float64))
    places = rest.translations[other] + np.matmul(above, steps[..., None])[..., 0]
    turned = quat.multiply(rest.rotations[other], _mirrored(turns, across))
    scales = np.abs(across) @ np.asarray(control_pose.scales, np.float64)[..., None]
    pose = Pose(places[..., other, :], turned[..., other, :], scales[..., 0][..., other, :])
    return pose, _values(rig, values or {})


def _mirrored(turns: Floats, across: Floats) -> Floats:
    """Rotations seen in mirrored axes: the axis is mirrored, and with it the sense."""
    vector = -np.matmul(across, turns[..., 1:, None])[..., 0]
    return np.concatenate([turns[..., :1], vector], axis=-1)


def _values(rig: Rig, values: Mapping[str, Any]) -> dict[str, Array]:
    known = {a.name: np.asarray(a.default) for a in rig.attributes}
    for name, value in values.items():
        if name not in known:
            raise UnknownName("attribute", name, known)
        known[name] = np.asarray(as_float(value), np.float64)
    turning = {
        name
        for module in rig.modules
        if isinstance(module, LimbModule)
        for name in (
            module.attribute("twist"),
            module.attribute("lower_twist"),
            *(() if module.foot is None else (module.foot.attribute("bank"), module.foot.attribute("swivel"))),
        )
    }
    found: dict[str, Array] = {}
    for name in known:
        value = known[_other_attribute(name, known)]
        found[name] = -value if name in turning else value
    return found


def _other(name: str, names: tuple[str, ...]) -> str:
    for side, to in _SIDES.items():
        if name.endswith(side) and name[: -len(side)] + to in names:
            return name[: -len(side)] + to
    return name


def _other_attribute(name: str, known: Mapping[str, Any]) -> str:
    """``arm.L.ik`` -> ``arm.R.ik``, where there is one."""
    for side, to in _SIDES.items():
        stem, found, rest = name.partition(f"{side}.")
        if found and f"{stem}{to}.{rest}" in known:
            return f"{stem}{to}.{rest}"
    return name
