# pyright: basic
"""Reading and writing capture files, against libraries from PyPI that do the same on the same files."""

from __future__ import annotations

import atexit
import importlib.util
import shutil
import tempfile
import warnings
from pathlib import Path

import numpy as np

from keypose.bench.suite import Suite
from keypose.model import Markers, Scene, Signals

_FRAMES, _MARKERS, _CHANNELS, _SAMPLES, _RATE_HZ = 2751, 42, 16, 10, 120.0
_TAKE = f"C3D load, {_MARKERS} markers x {_FRAMES} frames"
_ANALOG = f"C3D load, {_MARKERS} markers and {_CHANNELS} channels x {_FRAMES} frames"
_WRITE = f"C3D write, {_MARKERS} markers x {_FRAMES} frames"


def add(suite: Suite) -> None:
    """All cases of the suite."""
    add_c3d(suite)


def add_c3d(suite: Suite) -> None:
    """A take of 23 seconds, as large as the first of the CMU database, with and without analog channels."""
    import keypose.io

    folder = Path(tempfile.mkdtemp(prefix="keypose-bench-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    plain, whole, target = folder / "take.c3d", folder / "analog.c3d", folder / "out.c3d"
    take = _take()
    keypose.io.save(Scene(markers=take.markers), plain)
    keypose.io.save(take, whole)
    scene = keypose.io.load(plain)
    _check(suite, "C3D round trip: mm", take.markers[0].positions, scene.markers[0].positions)

    def load() -> None:
        keypose.io.load(plain)

    def load_all() -> None:
        keypose.io.load(whole)

    def save() -> None:
        keypose.io.save(scene, target)

    if importlib.util.find_spec("ezc3d") is None:
        for name in (_TAKE, _ANALOG, _WRITE):
            suite.absent(name, "ms", "ezc3d")
    else:
        import ezc3d

        theirs = ezc3d.c3d(str(plain))
        own = keypose.io.load(plain, unit="m", up="Y").markers[0].positions  # the file's own numbers
        _check(suite, "ezc3d reads the same", theirs["data"]["points"][:3].transpose(2, 1, 0) / 1000, own / 1000)
        suite.case(_TAKE, "ms", 1, load, lambda: ezc3d.c3d(str(plain)), against="ezc3d")
        suite.case(_ANALOG, "ms", 1, load_all, lambda: ezc3d.c3d(str(whole)), against="ezc3d")
        suite.case(_WRITE, "ms", 1, save, lambda: theirs.write(str(folder / "theirs.c3d")), against="ezc3d")
    if importlib.util.find_spec("c3d") is None:
        suite.absent(_TAKE, "ms", "c3d")
        return
    import c3d

    def frames() -> None:
        with plain.open("rb") as file, warnings.catch_warnings():
            warnings.simplefilter("ignore")
            for _ in c3d.Reader(file).read_frames():
                pass

    suite.case(_TAKE, "ms", 1, load, frames, against="c3d")


def _take() -> Scene:
    """Markers that wander and are lost now and then, with residuals and cameras; noise on the channels."""
    rng = np.random.default_rng(6)
    positions = np.cumsum(rng.normal(0, 0.004, (_FRAMES, _MARKERS, 3)), axis=0) + rng.uniform(0, 2, (_MARKERS, 3))
    positions[rng.random((_FRAMES, _MARKERS)) < 0.025] = np.nan
    seen = np.isfinite(positions).all(axis=-1)
    residuals = np.where(seen, rng.integers(0, 255, seen.shape) * 1e-5, np.nan)
    cameras = np.where(seen, rng.integers(0, 128, seen.shape), 0)
    names = tuple(f"M{i:02d}" for i in range(_MARKERS))
    markers = Markers(names, positions, _RATE_HZ, residuals=residuals, cameras=cameras)
    channels = tuple(f"EMG{i:02d}" for i in range(_CHANNELS))
    values = rng.normal(0, 1e-3, (_FRAMES * _SAMPLES, _CHANNELS))
    analog = Signals(channels, values, _RATE_HZ * _SAMPLES, ("V",) * _CHANNELS)
    return Scene(markers=(markers,), signals=(analog,))


def _check(suite: Suite, name: str, reference: np.ndarray, ours: np.ndarray) -> None:
    gaps = np.isnan(reference) != np.isnan(ours)
    apart = np.abs(np.where(np.isnan(reference), 0.0, reference) - np.where(np.isnan(ours), 0.0, ours))
    suite.check(name, 1e3 * float(apart.max()) + 1e9 * int(gaps.any()), 1e-3)
