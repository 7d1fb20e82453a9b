"""The work of the kernels in plain NumPy, as one would write it without them: what they are checked against and measured by."""

from __future__ import annotations

from typing import Any

import numpy as np

from keypose.bench.data import Floats, Ints, unit
from keypose.math import quat


def blend(clips: list[tuple[Floats, Floats]], places: Floats, weights: Floats) -> tuple[Floats, Floats]:
    """Blended local rotations (n, J, 4) and translations (n, J, 3) at places (n, 3) in frames."""
    turned: Any = 0.0
    moved: Any = 0.0
    for k, (rotations, translations) in enumerate(clips):
        whole = np.minimum(places[:, k].astype(np.intp), len(rotations) - 2)
        t = (places[:, k] - whole)[:, None, None].astype(rotations.dtype)
        weight = weights[:, k, None, None].astype(rotations.dtype)
        q = unit(rotations[whole] + t * (rotations[whole + 1] - rotations[whole]))
        if k:
            q = np.where((q * turned).sum(axis=-1, keepdims=True) < 0, -q, q)
        turned = turned + weight * q
        moved = moved + weight * (translations[whole] + t * (translations[whole + 1] - translations[whole]))
    return unit(turned), moved


def kinematics(parents: Ints, rotations: Floats, translations: Floats) -> tuple[Floats, Floats]:
    """World rotations (n, J, 4) and positions (n, J, 3)."""
    turned, moved = np.array(rotations), np.array(translations)
    for joint, parent in enumerate(parents):
        if parent >= 0:
            aw, av = turned[:, parent, :1], turned[:, parent, 1:]
            bw, bv = rotations[:, joint, :1], rotations[:, joint, 1:]
            turned[:, joint, :1] = aw * bw - (av * bv).sum(axis=1, keepdims=True)
            turned[:, joint, 1:] = aw * bv + bw * av + np.cross(av, bv)
            twice = 2 * np.cross(av, translations[:, joint])
            moved[:, joint] = moved[:, parent] + translations[:, joint] + aw * twice + np.cross(av, twice)
    return turned, moved


def matrices(rotations: Floats, positions: Floats) -> Floats:
    """(*B, 4, 4) of rotations and positions."""
    out = np.zeros((*positions.shape[:-1], 4, 4), positions.dtype)
    out[..., :3, :3], out[..., :3, 3], out[..., 3, 3] = quat.to_matrix(rotations), positions, 1
    return out


def skin(palette: Floats, joints: Ints, weights: Floats, positions: Floats, normals: Floats | None = None) -> Any:
    """Positions, or positions and normals, (*B, V, 3) moved by matrices (*B, P, 4, 4)."""
    blended: Any = 0.0
    for k in range(joints.shape[1]):
        blended = blended + weights[:, k, None, None] * palette[..., joints[:, k], :3, :]
    moved = (blended[..., :3] @ positions[..., None])[..., 0] + blended[..., 3]
    return moved if normals is None else (moved, (blended[..., :3] @ normals[..., None])[..., 0])
