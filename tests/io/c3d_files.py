"""C3D files made here, byte by byte and by keypose, and comparisons of scenes of markers."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

import keypose.io
from keypose.model import ForcePlate, Markers, Scene, Signals


def walk(frames: int = 20, count: int = 5, *, quality: bool = True, start_frame: int = 1, seed: int = 1) -> Markers:
    """Markers that drift, with gaps."""
    dice = np.random.default_rng(seed)
    positions = np.cumsum(dice.normal(0, 0.01, (frames, count, 3)), axis=0) + dice.uniform(-1, 2, (count, 3))
    positions[dice.random((frames, count)) < 0.1] = np.nan
    visible = np.isfinite(positions).all(axis=-1)
    residuals = cameras = None
    if quality:
        residuals = np.where(visible, dice.integers(0, 255, visible.shape) * 1e-5, np.nan).astype(np.float32)
        cameras = np.where(visible, dice.integers(0, 128, visible.shape), 0)
    names = tuple(f"M{i}" for i in range(count))
    return Markers(names, positions, 100.0, None, residuals, cameras, start_frame, "walk")


def lab() -> Scene:
    """Everything that a C3D file holds."""
    dice = np.random.default_rng(2)
    analog = Signals(
        ("Fx", "Fy", "Fz", "Mx", "My", "Mz", "EMG"),
        dice.normal(0, 100, (80, 7)),
        400.0,
        ("N",) * 3 + ("Nm",) * 3 + ("V",),
    )
    angles = Signals(("LKnee", "RKnee"), dice.normal(0, 30, (20, 2, 3)), 100.0, ("deg", "deg"), "angle", "angles")
    powers = Signals(("LPower",), dice.normal(0, 3, (20, 1, 3)), 100.0, ("W",), "power", "powers")
    corners = np.array([(0.6, 0, 0.4), (0, 0, 0.4), (0, 0, 0), (0.6, 0, 0)])
    plate = ForcePlate(corners, np.array((0.01, 0.02, -0.04)), 4, analog.names[:6], np.arange(36.0).reshape(6, 6))
    events = ({"name": "Foot Strike", "time_s": 0.05, "context": "Left", "subject": "anna"},)
    return Scene(markers=(walk(),), signals=(angles, powers, analog), plates=(plate,), extras={"events": events})


def differences(a: Scene, b: Scene) -> list[str]:
    """What two scenes of markers do not have in common, to 1e-6 m (1e-3 mm) and float32's digits."""
    wrong: list[str] = []
    for x, y in zip(a.markers, b.markers, strict=True):
        wrong += [f"{n}" for n in ("names", "rate_hz", "start_frame") if getattr(x, n) != getattr(y, n)]
        for name, limit in (("positions", 1e-6), ("visible", 0), ("residuals", 1e-7), ("cameras", 0)):
            p, q = getattr(x, name), getattr(y, name)
            if (p is None) != (q is None) or (
                p is not None and (p.shape != q.shape or not np.allclose(p, q, rtol=0, atol=limit, equal_nan=True))
            ):
                wrong.append(f"markers.{name}")
    for x, y in zip(a.signals, b.signals, strict=True):
        wrong += [f"{x.name}.{n}" for n in ("names", "rate_hz", "units", "kind") if getattr(x, n) != getattr(y, n)]
        if x.values.shape != y.values.shape or not np.allclose(
            x.values, y.values, rtol=2e-7, atol=1e-6, equal_nan=True
        ):
            wrong.append(f"{x.name}.values")
    for x, y in zip(a.plates, b.plates, strict=True):
        wrong += [f"plate.{n}" for n in ("kind", "channels") if getattr(x, n) != getattr(y, n)]
        wrong += [
            f"plate.{n}" for n in ("corners", "origin") if not np.allclose(getattr(x, n), getattr(y, n), atol=1e-6)
        ]
        if (x.calibration is None) != (y.calibration is None) or (
            x.calibration is not None and not np.allclose(x.calibration, y.calibration)
        ):
            wrong.append("plate.calibration")
    return wrong


def saved(scene: Scene, path: Path, **options: object) -> tuple[Scene, tuple[str, ...]]:
    """The scene written and read again, with the writer's notes."""
    notes = keypose.io.save(scene, path, **options)
    return keypose.io.load(path), notes


def c3d_bytes(
    groups: dict[str, dict[str, tuple[int, tuple[int, ...], bytes]]],
    *,
    points: int,
    frames: tuple[int, int],
    data: bytes,
    scale: float = -1.0,
    analog: int = 0,
    samples: int = 1,
    rate: float = 50.0,
) -> bytes:
    """A C3D file of Intel floats written without keypose: parameters as (type, dimensions, bytes)."""
    section = bytearray(b"\x01\x50\x00\x54")
    for number, (name, parameters) in enumerate(groups.items(), 1):
        section += struct.pack("<bb", len(name), -number) + name.encode() + struct.pack("<hB", 3, 0)
        for own, (kind, dims, raw) in parameters.items():
            body = struct.pack("<bB", kind, len(dims)) + bytes(dims) + raw + b"\0"
            section += struct.pack("<bb", len(own), number) + own.encode() + struct.pack("<H", len(body) + 2) + body
    section += b"\0\0"
    section += b"\0" * (-len(section) % 512)
    section[2] = len(section) // 512
    header = bytearray(512)
    struct.pack_into(
        "<BB5Hf2Hf", header, 0, 2, 0x50, points, analog, *frames, 0, scale, 2 + len(section) // 512, samples, rate
    )
    return bytes(header) + bytes(section) + data
