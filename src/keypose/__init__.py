"""keypose: character animation as one Python library, one command line and one browser studio."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

# Sub-packages and the few everyday functions are loaded on first use: importing keypose does no work.
_PACKAGES = (
    "analysis", "arrays", "bench", "cli", "deform", "editing", "errors", "evaluate", "ik", "io", "kernels",
    "math", "model", "play", "project", "render", "retarget", "rig", "samples", "studio",
)  # fmt: skip
_FUNCTIONS = {"load": "keypose.io", "save": "keypose.io"}

__all__ = ["__version__", "load", "save", *_PACKAGES]  # pyright: ignore[reportUnsupportedDunderAll]

if TYPE_CHECKING:
    from keypose.io import load as load
    from keypose.io import save as save


def __getattr__(name: str) -> Any:
    if name in _PACKAGES:
        return importlib.import_module(f"keypose.{name}")
    if name in _FUNCTIONS:
        return getattr(importlib.import_module(_FUNCTIONS[name]), name)
    raise AttributeError(f"module 'keypose' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted([*globals(), *_PACKAGES, *_FUNCTIONS])
