"""What the doctor sees in time: rates, frames, keys, and gaps in what cameras saw."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np

from keypose.analysis.findings import Finding, listed
from keypose.evaluate import key_rate
from keypose.model import Clip, Markers, Motion, Scene

# Rates that recorders and screens have.
_RATES_HZ = np.fromstring(
    "12 15 23.976 24 25 29.97 30 48 50 59.94 60 72 75 90 100 119.88 120 125 144 150 180 200 240 250 300 360 400 480 500 600 "
    "1000 2000",
    sep=" ",
)
_USUAL_HZ = (24, 25, 30, 50, 60, 100, 120, 240, 480, 1000)  # of these one is chosen to sample at
_MEANT = 0.05
_CLOCK = 5e-3  # by how much the clocks of recorders differ
_SLOWEST_HZ = 10.0  # keys further apart are no frames
_EDITING_HZ = 30


def examine_animations(scene: Scene, facts: dict[str, Any], findings: list[Finding]) -> None:
    """Rates and frames of motions and clips."""
    rates: list[float] = []
    uneven: list[str] = []
    for animation in scene.animations:
        name = f"clip '{animation.name}'" if animation.name else "the clip"
        rate = animation.rate_hz if isinstance(animation, Motion) else key_rate(animation)
        if isinstance(animation, Clip) and (rate is None or rate < _SLOWEST_HZ):
            if animation.curves and max(c.key_count for c in animation.curves.values()) > 1:
                uneven.append(animation.name or "the clip")
        elif rate is not None:
            rates.append(rate)
            _rate(name, rate, findings)
        if isinstance(animation, Motion):
            _frames(animation, name, findings)
    if uneven:
        one = len(uneven) == 1
        who = f"clip '{uneven[0]}' has" if one else f"{len(uneven)} of {len(scene.animations)} clips have"
        text = f"{who} keys but no frame rate" + ("" if one else f": {listed(uneven)}")
        findings.append(Finding("fact", "rate", text, f"keypose convert FILE OUT --rate {_EDITING_HZ}"))
    facts["clips"] = len(scene.animations)
    facts["rate_hz"] = rates[0] if rates else None


def _rate(name: str, rate: float, findings: list[Finding]) -> None:
    off = rate / float(_RATES_HZ[np.abs(np.log(_RATES_HZ / rate)).argmin()]) - 1
    if abs(off) <= 2e-4:
        return
    if abs(off) <= _CLOCK:
        text = f"{name} runs at {rate:.6g} Hz: a clock that is {100 * abs(off):.2g}% {'fast' if off > 0 else 'slow'}"
        findings.append(Finding("fact", "rate", text))
        return
    # The usual rate that is meant, else the next one up, which loses nothing.
    meant = [r for r in _USUAL_HZ if abs(rate / r - 1) < _MEANT] or [r for r in _USUAL_HZ if r > rate]
    fix = f"keypose convert FILE OUT --rate {meant[0]}" if meant else ""
    findings.append(Finding("warning", "rate", f"{name} runs at an unusual {rate:.6g} Hz", fix))


def _frames(motion: Motion, name: str, findings: list[Finding]) -> None:
    if motion.frame_count == 1:
        findings.append(Finding("fact", "frames", f"{name} has one frame: a pose, not a motion"))
    pose = motion.pose.broadcast()
    still = motion.frame_count > 2 and motion.morph_weights is None and motion.pose.joint_count > 0
    if still and not any(np.any(np.ptp(np.asarray(a), axis=0)) for a in (pose.rotations, pose.translations)):
        findings.append(Finding("warning", "frames", f"{name} does not move"))


def examine_markers(markers: Markers, facts: dict[str, Any], findings: list[Finding], own: str) -> None:
    """Names, gaps and places of markers; ``own`` begins what is said where there are several sets."""
    visible: Any = np.asarray(markers.visible)
    missing = 1.0 - float(visible.mean()) if visible.size else 0.0
    if facts["markers"] is None:  # of several sets the first is the lab's own
        facts |= {"markers": len(markers.names), "missing_share": round(missing, 5)}
        facts["rate_hz"] = facts["rate_hz"] or markers.rate_hz
    nearest = float(_RATES_HZ[np.abs(np.log(_RATES_HZ / markers.rate_hz)).argmin()])
    if abs(markers.rate_hz / nearest - 1) > _CLOCK:
        findings.append(Finding("fact", "rate", f"{own}the markers were seen at an unusual {markers.rate_hz:.6g} Hz"))
    _gaps(markers, visible, missing, own, findings)
    double = [n for n, count in Counter(markers.names).items() if count > 1]
    if double:
        findings.append(Finding("warning", "markers", f"{own}names occur more than once: {listed(double)}"))
    unnamed = [n for n in markers.names if not n or n.startswith("*") or n.lower().startswith(("unlabel", "u_"))]
    if unnamed:
        text = f"{own}{len(unnamed)} {'trajectory has' if len(unnamed) == 1 else 'trajectories have'} no name"
        findings.append(Finding("warning", "markers", text))
    if visible.any():
        heights = np.asarray(markers.positions)[..., 1][visible]
        facts.setdefault("marker_height_m", [round(float(np.quantile(heights, q)), 3) for q in (0.0, 1.0)])
        if float(np.quantile(heights, 0.99)) - float(np.quantile(heights, 0.01)) > 20:
            text = f"{own}the markers spread over more than 20 m in height: a wrong unit?"
            findings.append(Finding("warning", "scale", text, "keypose convert FILE OUT --scale 0.001"))


def _gaps(markers: Markers, visible: Any, missing: float, own: str, findings: list[Finding]) -> None:
    if not visible.size:
        return
    seen = visible.any(axis=0)
    never = [n for n, s in zip(markers.names, seen, strict=True) if not s]
    if never:
        text = f"{own}{len(never)} of {len(markers.names)} markers are never seen: {listed(never)}"
        findings.append(Finding("warning", "markers", text))
    if seen.any():
        lost = 1.0 - float(visible[:, seen].mean())
        gaps = [longest_gap(visible[:, n]) if seen[n] else (0, 0) for n in range(visible.shape[1])]
        worst = int(np.argmax([length for length, _ in gaps]))
        length, start = gaps[worst]
        if length and missing > 0.001:
            of = f"the {int(seen.sum())} others'" if never else "the marker"
            frame = markers.start_frame + start
            findings.append(
                Finding(
                    "warning" if lost >= 0.1 else "fact",
                    "markers",
                    f"{own}{100 * lost:.2g}% of {of} data is missing; the longest gap is {length} "
                    f"frame{'s' * (length != 1)} from frame {frame} ('{markers.names[worst]}')",
                )
            )


def longest_gap(seen: Any) -> tuple[int, int]:
    """Length and first frame of the longest time (T,) in which something is not seen, the ends included."""
    edges = np.flatnonzero(np.diff(np.concatenate([[True], np.asarray(seen, bool), [True]]).astype(np.int8)))
    if not len(edges):
        return 0, 0
    starts, ends = edges[::2], edges[1::2]
    worst = int((ends - starts).argmax())
    return int(ends[worst] - starts[worst]), int(starts[worst])
