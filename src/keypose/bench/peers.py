# pyright: basic
"""Against libraries from PyPI that do the same, each comparison in one process on the same data."""

from __future__ import annotations

import atexit
import contextlib
import importlib.util
import io
import shutil
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from keypose.bench import data, plain
from keypose.bench.suite import Suite

_READ, _WRITE, _FK = "BVH load, 5000 frames x 31 joints", "BVH write, 5000 frames x 31 joints", "clip FK, 26 joints"


def add_bvh(suite: Suite) -> None:
    """Reading and writing a BVH file of 5,000 frames and 31 joints."""
    import keypose.io

    folder = Path(tempfile.mkdtemp(prefix="keypose-bench-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    _, numbers, content = data.bvh(np.random.default_rng(4))
    path, ours, theirs = folder / "take.bvh", folder / "ours.bvh", folder / "theirs.bvh"
    path.write_bytes(content)

    scene = keypose.io.load(path)
    keypose.io.save(scene, ours)
    written = np.array(ours.read_bytes().split(b"Frame Time:")[1].split()[1:], np.float64).reshape(numbers.shape)
    turns = (written - numbers)[:, 3:] / 360  # another turn is the same rotation
    suite.check("BVH round trip: degrees", 360 * abs(turns - np.rint(turns)).max(), 2e-5)

    def load() -> None:
        keypose.io.load(path)

    def save() -> None:
        keypose.io.save(scene, ours)

    for package, peer in (("pybvh", _pybvh), ("pymotion", _pymotion)):
        name = {"pybvh": "pybvh", "pymotion": "PyMotion"}[package]
        if not _installed(package):
            suite.absent(_READ, "ms", name)
            suite.absent(_WRITE, "ms", name)
            continue
        read, write = peer(path, theirs)
        suite.case(_READ, "ms", 1, load, read, against=name)
        suite.case(_WRITE, "ms", 1, save, write, against=name)


def add_fk(suite: Suite) -> None:
    """Forward kinematics of 10,240 frames and 26 joints, arrays in and arrays out."""
    from keypose.kernels import fk

    if not _installed("pymotion"):
        suite.absent(_FK, "frames/s", "PyMotion")
        return
    from pymotion.ops import skeleton

    rng = np.random.default_rng(5)
    parents, offsets = data.body(data.BODY_JOINTS)
    frames = 10240
    rotations = data.unit(rng.normal(size=(frames, len(parents), 4))).astype(np.float32)
    roots, offsets = rng.normal(size=(frames, 3)).astype(np.float32), offsets.astype(np.float32)
    their_offsets, their_parents = offsets.copy(), np.maximum(parents, 0)
    their_offsets[0] = 0
    positions = np.asarray(skeleton.fk(rotations, roots, their_offsets, their_parents)[0])
    local = np.broadcast_to(offsets, (frames, *offsets.shape)).copy()
    local[:, 0] = roots
    suite.check(
        "PyMotion computes the same", abs(positions - plain.kinematics(parents, rotations, local)[1]).max(), 1e-4
    )
    mine = fk.matrices(parents, rotations, offsets, roots=roots)
    suite.check("clip FK, matrices", abs(mine[..., :3, 3] - positions).max(), 1e-4)
    suite.case(
        _FK, "frames/s", frames, lambda: fk.matrices(parents, rotations, offsets, roots=roots),
        lambda: skeleton.fk(rotations, roots, their_offsets, their_parents), against="PyMotion", note="to matrices",
    )  # fmt: skip
    suite.case(
        _FK, "frames/s", frames, lambda: fk.rotations_positions(parents, rotations, offsets, roots),
        lambda: skeleton.fk(rotations, roots, their_offsets, their_parents), against="PyMotion",
        note="to quaternions",
    )  # fmt: skip


def _installed(package: str) -> bool:
    return importlib.util.find_spec(package) is not None


def _pybvh(path: Path, target: Path) -> tuple[Callable[[], Any], Callable[[], Any]]:
    import pybvh

    def read() -> Any:
        with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
            warnings.simplefilter("ignore")
            return pybvh.read_bvh_file(path)

    motion = read()
    return read, lambda: pybvh.write_bvh_file(motion, target)


def _pymotion(path: Path, target: Path) -> tuple[Callable[[], Any], Callable[[], Any]]:
    from pymotion.io.bvh import BVH

    def read() -> Any:
        motion = BVH()
        motion.load(str(path))
        return motion

    motion = read()
    return read, lambda: motion.save(str(target))
