"""usd-core, imported when something is written."""

from __future__ import annotations

import importlib
import re
from types import SimpleNamespace
from typing import Any

import numpy as np

from keypose.arrays import Array, Floats
from keypose.io.notes import UniqueNames
from keypose.io.usd.process import need_usd

_MODULES = ("Gf", "Sdf", "Usd", "UsdGeom", "UsdShade", "UsdSkel", "Vt")


def library() -> Any:
    """The modules of usd-core by their names; raises `MissingExtra` where it is not installed."""
    need_usd("writing USD")
    return SimpleNamespace(**{name: importlib.import_module(f"pxr.{name}") for name in _MODULES})


class Names:
    """Names of the prims below one prim: what USD allows, each once."""

    def __init__(self) -> None:
        self._unique = UniqueNames()

    def add(self, name: str, default: str) -> str:
        """A name for a prim."""
        return self._unique.add(identifier(name, default))


def identifier(name: str, default: str) -> str:
    """A name with letters, digits and underscores alone."""
    made = re.sub(r"[^A-Za-z0-9_]", "_", name)[:200] or default
    return f"_{made}" if made[0].isdigit() else made


def entitle(prim: Any, name: str) -> None:
    """Keep a name that the prim itself cannot have."""
    if name and prim.GetName() != name:
        prim.SetDisplayName(name)


def keep(prim: Any, **values: Any) -> None:
    """What only keypose reads."""
    for name, value in values.items():
        prim.SetCustomDataByKey(f"keypose:{name}", value)


def vectors(usd: Any, rows: Array) -> Any:
    """Rows (N, 3) as single precision."""
    return usd.Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(rows, np.float32).reshape(-1, 3))


def matrix(usd: Any, columns: Floats, scale: float) -> Any:
    """A matrix that multiplies columns, its translation in file units."""
    scaled = np.array(columns, np.float64)
    scaled[:3, 3] *= scale
    return usd.Gf.Matrix4d(*scaled.T.reshape(-1).tolist())
