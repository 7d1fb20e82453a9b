# pyright: basic
"""What every kernel shares: the vector width, the compile options, the code cache and aligned memory.

``WIDTH`` is the number of float32 lanes of one vector: 16 where the compiler may use AVX-512, 8 with AVX, 4 elsewhere
(SSE2, NEON, anything LLVM knows). ``KEYPOSE_SIMD_WIDTH`` forces 4, 8 or 16; every width works on every machine.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import pickle
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numba import config as _config
from numba import njit, types
from numba.core import caching
from numba.core.codegen import get_host_cpu_features
from numba.extending import intrinsic as _intrinsic

from keypose.errors import ShapeError

CACHE_LINE = 64

# Functions that write LLVM code; the type checker cannot follow what the decorator makes of them.
intrinsic: Any = _intrinsic
config: Any = _config  # its settings are made while it is imported


def _compiler_features() -> frozenset[str]:
    """The instruction sets that Numba really compiles for: ``{"avx", "fma", ...}``."""
    listed = config.CPU_FEATURES
    if listed is None:  # a named processor ("generic") switches the detection off
        listed = "" if config.CPU_NAME else get_host_cpu_features()
    return frozenset(name[1:] for name in listed.split(",") if name.startswith("+"))


def _choose_width(features: frozenset[str]) -> int:
    forced = os.environ.get("KEYPOSE_SIMD_WIDTH")
    if forced:
        if forced not in ("4", "8", "16"):
            raise ShapeError(f"KEYPOSE_SIMD_WIDTH: expected 4, 8 or 16, got '{forced}'")
        return int(forced)
    return 16 if "avx512f" in features else 8 if "avx" in features else 4


FEATURES = _compiler_features()
WIDTH = _choose_width(FEATURES)


# --- the code cache ---------------------------------------------------------------------------------------------------
# Numba's own cache looks at the file of the cached function only. Kernels are built from helpers in other modules and
# from WIDTH, so a changed helper would silently run old code. Ours lives in a folder named after all of them, in the
# user's cache (site-packages may be read-only), and without touching Numba's global settings.


def _cache_root() -> Path:
    if config.CACHE_DIR:
        return Path(config.CACHE_DIR)
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")


def _source_stamp() -> str:
    digest = hashlib.sha256(f"{WIDTH} {sorted(FEATURES)}".encode())
    for path in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(path.name.encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:20]


STAMP = _source_stamp()


def cache_folder() -> Path | None:
    """The folder of compiled kernels, or None where no folder can be written (each process then compiles afresh)."""
    try:
        return _cache_root() / "keypose" / "kernels" / f"w{WIDTH}-{STAMP}"
    except RuntimeError:  # no home directory
        return None


class _Locator(caching._CacheLocator):
    def __init__(self, function: Callable[..., Any], folder: Path) -> None:
        self._function, self._folder = function, folder

    @classmethod
    def from_function(cls, py_func: Callable[..., Any], py_file: str) -> _Locator | None:
        folder = cache_folder()
        if folder is None:
            return None
        locator = cls(py_func, folder)
        try:
            locator.ensure_cache_path()
        except OSError:
            return None
        return locator

    def get_cache_path(self) -> str:
        return str(self._folder)

    def get_source_stamp(self) -> str:
        return STAMP

    def get_disambiguator(self) -> str:
        return str(self._function.__code__.co_firstlineno)


class _Implementation(caching.CompileResultCacheImpl):
    _locator_classes = [_Locator]  # noqa: RUF012 - Numba's own attribute


class _Cache(caching.FunctionCache):
    """A cache whose faults (a full disk, a truncated file) only cost a new compilation."""

    _impl_class = _Implementation

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        try:
            return super().load_overload(sig, target_context)
        except (OSError, EOFError, pickle.UnpicklingError, AttributeError, ImportError, ValueError, KeyError):
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        try:
            super().save_overload(sig, data)
        except (OSError, EOFError, pickle.PicklingError, pickle.UnpicklingError):
            self.disable()


def _compiled(fastmath: Any, nogil: bool = True) -> Callable[[Callable[..., Any]], Any]:
    def decorate(function: Callable[..., Any]) -> Any:
        dispatcher: Any = njit(error_model="numpy", boundscheck=False, nogil=nogil, fastmath=fastmath)(function)
        with contextlib.suppress(RuntimeError, OSError):  # nowhere to write
            dispatcher._cache = _Cache(function)
        return dispatcher

    return decorate


# Fused multiply-add is welcome everywhere; the other fast-math flags are not, because they make NaN undefined.
kernel = _compiled({"contract", "nsz"})
short_kernel = _compiled({"contract", "nsz"}, nogil=False)  # so short that giving the GIL away would show
exact_kernel = _compiled(False)  # text: the one division must round as IEEE says
inlined = njit(error_model="numpy", boundscheck=False, nogil=True, fastmath={"contract", "nsz"}, inline="always")
exact_inlined = njit(error_model="numpy", boundscheck=False, nogil=True, fastmath=False, inline="always")


_OF_ADDRESS = (types.int64,)


def entry_of(function: Any, given: tuple[types.Type, ...]) -> Callable[..., Any]:
    """The machine code of a kernel for these types, without Numba's look at what it is given: the caller has looked.

    Numba takes longer to find out the types of a few arrays than a short kernel runs.
    """
    if given not in function.overloads:
        function.compile(given)
    return function.overloads[given].entry_point


def entry_of_address(function: Any) -> Callable[[int], Any]:
    """The same of a kernel that takes one address."""
    return entry_of(function, _OF_ADDRESS)


# --- memory: every buffer starts on a cache line, for unaligned vectors straddle two ------------------------------------


def aligned(count: int, dtype: Any = np.float32) -> np.ndarray:
    """A flat array of zeros that starts on a 64-byte boundary."""
    size = count * np.dtype(dtype).itemsize
    raw = np.zeros(size + CACHE_LINE, np.uint8)
    start = -raw.ctypes.data % CACHE_LINE
    return raw[start : start + size].view(dtype)


def aligned_copy(values: Any, dtype: Any = np.float32) -> np.ndarray:
    """A flat aligned copy of an array in C order."""
    values = np.asarray(values)
    out = aligned(values.size, dtype)
    out[:] = values.ravel()
    return out


def flat(values: Any, dtype: np.dtype) -> np.ndarray:
    """The values as a flat, contiguous array of that type; quicker than `readable`, for functions called very often.

    A frozen array meets a kernel of its own, compiled when it first comes.
    """
    if not (
        type(values) is np.ndarray and values.dtype == dtype and values.flags.c_contiguous and values.flags.aligned
    ):
        values = np.require(values, dtype, ["C", "A"])
    return values.reshape(-1)


def readable(values: Any, dtype: Any) -> np.ndarray:
    """The values as a flat, contiguous, read-only array of that type.

    Always read-only, so that frozen and writable arrays meet the same compiled kernel.
    """
    if not (type(values) is np.ndarray and values.dtype == dtype and values.flags.carray):
        values = np.require(values, dtype, ["C", "A"])
    view = values.reshape(-1).view()
    view.flags.writeable = False
    return view


@inlined
def scratch(count):
    """Uninitialised float32 memory for a kernel, 64-byte aligned; each call has its own, so threads do not meet."""
    raw = np.empty(count + 16, np.float32)
    skip = np.intp(-raw.ctypes.data & 63) >> 2
    return raw[skip : skip + count]


@inlined
def scratch_like(array, count):
    """Uninitialised memory of the element type of ``array``, 64-byte aligned."""
    raw = np.empty(count + 16, array.dtype)
    skip = np.intp(-raw.ctypes.data & 63) // raw.itemsize
    return raw[skip : skip + count]
