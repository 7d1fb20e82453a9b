"""The doctor: what was understood of a file, what was guessed, and what is wrong with it, with a cure where there is one."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Any

import numpy as np

from keypose.analysis.doctor_figures import examine_character
from keypose.analysis.doctor_takes import examine_animations, examine_markers
from keypose.analysis.findings import Examination, Finding, note_level
from keypose.model import Character, Scene

__all__ = ["Examination", "Finding", "examine"]

# Formats whose rotations are angles in an order that each joint has; what came from another file has none.
_ANGLES = {"bvh", "asf", "amc", "fbx", "collada"}
_UNITS = {0.001: "mm", 0.01: "cm", 0.1: "dm", 1.0: "m", 0.0254: "inch", 0.3048: "foot"}
_FACTS = (
    "unit_m",
    "up",
    "forward",
    "handedness",
    "euler_orders",
    "euler_exceptions",
    "rest_pose",
    "sides",
    "stature_m",
    "ground_m",
    "clips",
    "rate_hz",
    "markers",
    "missing_share",
)


def examine(scene: Scene) -> Examination:
    """Look a scene over: units, axes, facing, sides, rest pose, size, ground, rates, gaps, weights.

    Everything is judged in keypose's space (metres, Y up), as the file was understood. Facts that do not apply are None.
    """
    findings = [_note(text, scene) for text in scene.notes]
    facts: dict[str, Any] = {"format": scene.format, **dict.fromkeys(_FACTS), "unit_m": scene.unit_m, "up": scene.up}
    for number, character in enumerate(scene.characters):
        own = character.name or "character" if len(scene.characters) > 1 else ""
        motions = list(scene.animations) if number == 0 else []
        examine_character(character, motions, facts if number == 0 else {}, findings, own)
        if number == 0 and scene.format in _ANGLES:
            _orders(character, facts)
    _meshes(scene, facts)
    examine_animations(scene, facts, findings)
    for number, markers in enumerate(scene.markers, 1):
        own = f"{markers.name or f'set {number}'}: " if len(scene.markers) > 1 else ""
        examine_markers(markers, facts, findings, own)
    for signals in scene.signals:
        facts.setdefault("signals", []).append(
            {"kind": signals.kind, "channels": len(signals.names), "rate_hz": signals.rate_hz}
        )
    if scene.plates:
        facts["force_plates"] = len(scene.plates)
    for tier in scene.tiers:
        facts.setdefault("tiers", []).append(
            {"name": tier.name, "labels": len(tier.labels), "start_s": tier.start_s, "end_s": tier.end_s}
        )
    return Examination(facts, tuple(findings))


def _note(text: str, scene: Scene) -> Finding:
    """A note of the reader: where it guessed the unit or the axes, with the command that settles both."""
    topic, _, said = text.partition(":")
    if topic in ("unit", "up axis"):
        return Finding("guess", "up" if topic == "up axis" else topic, said.strip(), _settled(scene))
    if topic == "frame rate" and scene.animations:
        rate = getattr(scene.animations[0], "rate_hz", None)
        return Finding("guess", "rate", said.strip(), f"keypose convert FILE OUT.glb --option in.rate_hz={rate:g}")
    return Finding(note_level(text), "reading", text)


def _settled(scene: Scene) -> str:
    """The command that writes what was guessed into a file that says it."""
    name = next((name for size, name in _UNITS.items() if abs(scene.unit_m / size - 1) < 1e-6), f"{scene.unit_m:.6g}")
    options = [f"--unit {name}"] if any(n.startswith("unit:") for n in scene.notes) else []
    options += [f"--up {scene.up}"] if any(n.startswith("up axis:") for n in scene.notes) else []
    return f"keypose convert FILE OUT{'.c3d' if scene.markers else '.glb'} {' '.join(options)}"


def _orders(character: Character, facts: dict[str, Any]) -> None:
    """Euler orders by joint as rotations that follow each other in the joint's own axes, where the file has any."""
    channels: Mapping[str, Any] = (character.extras.get("bvh") or {}).get("channels") or {}
    orders: dict[str, str] = {}
    for name, text in channels.items():
        order = "".join(word[0] for word in str(text or "").split() if word.endswith("rotation"))
        if order:
            orders[name] = order
    given: Mapping[str, str] = character.extras.get("euler_orders") or {}
    orders |= {str(name): str(order) for name, order in given.items()}
    if orders:
        counted = Counter(orders.values())
        facts["euler_orders"] = dict(counted)
        usual = counted.most_common(1)[0][0]
        facts["euler_exceptions"] = {name: order for name, order in orders.items() if order != usual}


def _meshes(scene: Scene, facts: dict[str, Any]) -> None:
    """How many vertices there are, and how large the meshes are as they were modelled."""
    parts = [part for character in scene.characters for part in character.parts if part.mesh.vertex_count]
    if parts:
        low = np.min([np.asarray(p.mesh.positions).min(axis=0) for p in parts], axis=0)
        high = np.max([np.asarray(p.mesh.positions).max(axis=0) for p in parts], axis=0)
        facts["meshes"] = {
            "parts": len(parts),
            "vertices": sum(p.mesh.vertex_count for p in parts),
            "size_m": [round(float(v), 4) for v in high - low],
        }
