# pyright: basic
"""Reading and writing capture files, against libraries from PyPI that do the same on the same files."""

from __future__ import annotations

import atexit
import importlib.util
import shutil
import tempfile
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from keypose.bench import glb
from keypose.bench.suite import Suite
from keypose.model import Markers, Scene, Signals

_FRAMES, _MARKERS, _CHANNELS, _SAMPLES, _RATE_HZ = 2751, 42, 16, 10, 120.0
_TAKE = f"C3D load, {_MARKERS} markers x {_FRAMES} frames"
_ANALOG = f"C3D load, {_MARKERS} markers and {_CHANNELS} channels x {_FRAMES} frames"
_AMC = "AMC load with its ASF, 30 bones x 2,751 frames"
_WRITE = f"C3D write, {_MARKERS} markers x {_FRAMES} frames"


def add(suite: Suite) -> None:
    """All cases of the suite."""
    add_c3d(suite)
    add_amc(suite)
    glb.add(suite)


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


def add_amc(suite: Suite) -> None:
    """A text as those of the CMU database: 62 numbers of six digits in each frame."""
    import keypose.io

    folder = Path(tempfile.mkdtemp(prefix="keypose-bench-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    path, counts = folder / "take.amc", [6, *([3, 1, 2, 3, 1, 2] * 5)[:29]]
    (folder / "take.asf").write_text(_skeleton(counts[1:]))
    rng = np.random.default_rng(6)
    values = np.cumsum(rng.normal(0, 0.4, (_FRAMES, sum(counts))), axis=0)
    names = ["root", *(f"bone{i:02d}" for i in range(len(counts) - 1))]
    starts = np.concatenate([[0], np.cumsum(counts)])
    lines = [":FULLY-SPECIFIED", ":DEGREES"]
    for frame, row in enumerate(values.tolist(), 1):
        lines.append(str(frame))
        for name, a, b in zip(names, starts, starts[1:], strict=False):
            lines.append(" ".join([name, *(f"{v:.6g}" for v in row[a:b])]))
    path.write_text("\n".join(lines) + "\n")

    def plain() -> np.ndarray:
        """What everybody writes: split and float, without a skeleton, rotations or any check."""
        rows: list[float] = []
        with path.open() as file:
            for line in file:
                rows.extend(float(word) for word in line.split()[1:])
        return np.array(rows[: _FRAMES * sum(counts)]).reshape(_FRAMES, -1)

    motion: Any = keypose.io.load(path).animation()
    suite.check(
        "AMC: root", float(np.abs(motion.pose.translations[:, 0] / (0.0254 / 0.45) - plain()[:, :3]).max()), 1e-9
    )
    size = path.stat().st_size
    suite.case(_AMC, "MB/s", size, lambda: keypose.io.load(path), plain, against="split and float", note="aim: 100")


def _skeleton(counts: list[int]) -> str:
    dofs = {1: "rx", 2: "rx rz", 3: "rx ry rz"}
    bones = "".join(
        f"  begin\n id {i + 1}\n name bone{i:02d}\n direction 0 1 0\n length 2\n axis 0 0 {i} XYZ\n dof {dofs[n]}\n  end\n"
        for i, n in enumerate(counts)
    )
    tree = "".join(f"    {'root' if i % 6 == 0 else f'bone{i - 1:02d}'} bone{i:02d}\n" for i in range(len(counts)))
    return (
        ":version 1.10\n:units\n length 0.45\n angle deg\n:root\n order TX TY TZ RX RY RZ\n axis XYZ\n"
        f" position 0 0 0\n orientation 0 0 0\n:bonedata\n{bones}:hierarchy\n  begin\n{tree}  end\n"
    )


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
