"""When work is large enough for the compiled kernels.

Loading Numba takes about half a second, so a few frames are done by NumPy; once the kernels are loaded (by the player,
the renderer or a large clip) they pay for small work too. Both paths agree to rounding.
"""

from __future__ import annotations

import importlib
import sys
from types import ModuleType

import numpy as np

from keypose.arrays import Array

_LOADED, _NOT_LOADED = 256, 1_000_000  # joint transforms, or vertices times influences


def kernels_for(module: str, work: int, *arrays: Array) -> ModuleType | None:
    """The module of `keypose.kernels`, or None where NumPy or the arrays' own library should do the work.

    Kernels take NumPy arrays of one precision.
    """
    name = f"keypose.kernels.{module}"
    if work < (_LOADED if name in sys.modules else _NOT_LOADED):
        return None
    if not all(isinstance(a, np.ndarray) for a in arrays) or len({a.dtype for a in arrays}) != 1:
        return None
    return importlib.import_module(name)
