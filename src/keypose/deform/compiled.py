"""Meshes compiled for the skinning kernels, kept as long as their arrays live.

Compiling a mesh costs as much as skinning it about ten times with NumPy and makes every later time about fifty times
cheaper, so a mesh is compiled when it has been used often enough, however the frames arrive: in one batch or one by one.
"""

from __future__ import annotations

import math
import weakref
from dataclasses import dataclass
from typing import Any

import numpy as np

from keypose.arrays import Array, Floats
from keypose.evaluate.compiled import kernels_for
from keypose.model import Skin

_WORTH_COMPILING = 8  # frames


@dataclass(slots=True)
class _Use:
    frames: int = 0
    compiled: Any = None


_uses: dict[tuple[int, ...], _Use] = {}


def skin_compiled(
    positions: Array,
    normals: Array | None,
    binding: Skin,
    weights: Array,
    matrices: Array,
    normal_matrices: Array | None,
) -> tuple[Floats, Floats | None] | None:
    """Positions and normals by the compiled kernel, or None where it does not apply or does not pay (yet)."""
    arrays = [positions, binding.joints, binding.weights] + ([] if normals is None else [normals])
    # Only what is frozen can be told by its identity; ids are forgotten with their arrays.
    if weights is not binding.weights or not all(isinstance(a, np.ndarray) and not a.flags.writeable for a in arrays):
        return None
    if positions.ndim != 2 or (normals is not None and normals.ndim != 2):
        return None
    key = tuple(map(id, arrays))
    use = _uses.get(key)
    if use is None:
        use = _uses[key] = _Use()
        for array in arrays:
            weakref.finalize(array, _uses.pop, key, None)
    use.frames += math.prod(matrices.shape[:-3])
    if use.frames < _WORTH_COMPILING and use.compiled is None:
        return None
    floats = [positions, weights, matrices] + ([] if normals is None else [normals])
    kernels = kernels_for("skin", use.frames * binding.joints.size, *floats)
    if kernels is None:
        return None
    if use.compiled is None:
        use.compiled = kernels.compile_mesh(binding.joints, weights, positions, normals)
    return kernels.skin(use.compiled, matrices, normal_matrices, with_normals=normals is not None)
