"""The doctor: what was understood of a file, what was guessed, and what is wrong with it, with a cure where there is one."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from keypose.analysis.anatomy import Body, facing, find_body, rest_kind
from keypose.arrays import Floats
from keypose.evaluate import bake, key_rate, world_rotations_positions
from keypose.model import Character, Clip, Markers, Motion, Part, Pose, Scene, Skeleton

Level = Literal["fact", "guess", "warning"]

_RATES_HZ = (
    12,
    15,
    23.976,
    24,
    25,
    29.97,
    30,
    48,
    50,
    59.94,
    60,
    72,
    75,
    90,
    100,
    119.88,
    120,
    125,
    144,
    150,
    180,
    200,
    240,
)
_MORE_RATES_HZ = (250, 300, 360, 400, 480, 500, 600, 1000, 2000)
_MOST_FRAMES = 20_000  # of a motion that is looked at; longer ones are looked at in even steps


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that was found; ``fix`` is what to do, often a command with FILE and OUT in it."""

    level: Level
    topic: str
    text: str
    fix: str = ""


@dataclass(frozen=True, slots=True)
class Examination:
    """What is known of a scene (``facts``, plain values by name) and what was found."""

    facts: Mapping[str, Any]
    findings: tuple[Finding, ...]

    @property
    def warnings(self) -> tuple[Finding, ...]:
        """Findings that say that something is wrong."""
        return tuple(f for f in self.findings if f.level == "warning")


def examine(scene: Scene) -> Examination:
    """Look a scene over: units, axes, facing, sides, rest pose, size, ground, rates, gaps, weights.

    Everything is judged in keypose's space (metres, Y up), as the file was understood.
    """
    findings = [_note(text, scene) for text in scene.notes]
    facts: dict[str, Any] = {"format": scene.format, "unit_m": scene.unit_m, "up": scene.up}
    figures = [c for c in scene.characters if c.skeleton.joint_count > 1]
    for number, character in enumerate(scene.characters):
        own = character if len(scene.characters) > 1 else None
        motions = list(scene.animations) if number == 0 else []
        _character(character, motions, facts if number == 0 else {}, findings, own)
    if not figures:
        facts |= {"forward": None, "handedness": None, "rest_pose": None, "stature_m": None, "ground_m": None}
    _animations(scene, facts, findings)
    for markers in scene.markers:
        _markers(markers, facts, findings)
    for signals in scene.signals:
        facts.setdefault("signals", []).append(
            {"kind": signals.kind, "channels": len(signals.names), "rate_hz": signals.rate_hz}
        )
    if scene.plates:
        facts["force_plates"] = len(scene.plates)
    return Examination(facts, tuple(findings))


def _note(text: str, scene: Scene) -> Finding:
    """A note of the reader: a guess where it says so, with the option that settles it."""
    if text.startswith("unit:"):
        return Finding(
            "guess", "unit", text.removeprefix("unit:").strip(), f"keypose convert FILE OUT --unit {scene.unit_m:.6g}"
        )
    if text.startswith("up axis:"):
        return Finding(
            "guess", "up", text.removeprefix("up axis:").strip(), f"keypose convert FILE OUT --up {scene.up}"
        )
    return Finding("guess", "reading", text)


# --- characters -------------------------------------------------------------------------------------------------------------


def _character(
    character: Character,
    motions: list[Clip | Motion],
    facts: dict[str, Any],
    findings: list[Finding],
    own: Character | None,
) -> None:
    prefix = f"{own.name or 'character'}: " if own is not None else ""
    skeleton = character.skeleton
    _orders(character, facts)
    if skeleton.joint_count > 1:
        body = find_body(skeleton.names)
        rest = np.asarray(world_rotations_positions(skeleton, skeleton.rest)[1], np.float64)
        posed = _frames(skeleton, motions)
        _figure(body, skeleton, rest, posed, facts, findings, prefix)
        if posed is not None:
            _jumps(skeleton, posed, findings, prefix)
        _bones(skeleton, motions, findings, prefix)
    for part in character.parts:
        _part(part, findings, prefix)
    if np.any(np.asarray(skeleton.rest.scales) < 0):
        findings.append(Finding("warning", "scale", f"{prefix}joints with negative scale are mirrored"))


def _orders(character: Character, facts: dict[str, Any]) -> None:
    """Euler orders by joint, where the file has any."""
    channels: Mapping[str, Any] = (character.extras.get("bvh") or {}).get("channels") or {}
    orders: dict[str, str] = {}
    for name, text in channels.items():
        order = "".join(word[0] for word in str(text or "").split() if word.endswith("rotation"))
        if order:
            orders[name] = order
    given: Mapping[str, str] = character.extras.get("euler_orders") or {}
    orders |= {str(name): str(order) for name, order in given.items()}
    if orders:
        facts["euler_orders"] = dict(Counter(orders.values()))
        usual = Counter(orders.values()).most_common(1)[0][0]
        facts["euler_exceptions"] = {name: order for name, order in orders.items() if order != usual}


def _frames(skeleton: Skeleton, motions: list[Clip | Motion]) -> Floats | None:
    """Places (F, J, 3) of the joints along the first animation, in even steps where it is long."""
    for animation in motions:
        motion = animation
        if isinstance(motion, Clip):
            rate = key_rate(motion) or 30.0
            if motion.duration_s * rate > _MOST_FRAMES or not motion.curves:
                continue
            motion = bake(motion, skeleton, rate)
        if motion.joint_names != skeleton.names or motion.frame_count == 0:
            continue
        every = -(-motion.frame_count // _MOST_FRAMES)
        pose = motion.pose.broadcast()
        part = Pose(pose.translations[::every], pose.rotations[::every], pose.scales[::every])
        return np.asarray(world_rotations_positions(skeleton, part)[1], np.float64)
    return None


def _figure(
    body: Body,
    skeleton: Skeleton,
    rest: Floats,
    posed: Floats | None,
    facts: dict[str, Any],
    findings: list[Finding],
    prefix: str,
) -> None:
    head = body.parts.get(("head", ""))
    feet = [joint for (part, side), joint in body.parts.items() if part in ("foot", "toe") and side]
    height = float(np.ptp(rest[:, 1]))
    spread = float(np.max(np.ptp(rest, axis=0)))
    upright = head is not None and bool(feet) and bool(rest[head, 1] - rest[feet, 1].mean() > 0.6 * spread)
    kind = rest_kind(body, rest)
    if spread < 1e-6:
        kind = "collapsed"
    elif head is not None and feet and not upright:
        kind = "collapsed" if height < 0.3 * _reach(skeleton) else "lying"
    facts["rest_pose"] = kind
    facts["sides"] = {"pairs": len(body.pairs)}
    at = rest if upright or posed is None else posed[len(posed) // 2]
    stands = upright or (
        head is not None and bool(feet) and bool(at[head, 1] - at[feet, 1].mean() > 0.5 * np.ptp(at, axis=0).max())
    )
    if kind in ("collapsed", "lying"):
        where = "all joints lie in a heap" if kind == "collapsed" else "it lies down"
        findings.append(
            Finding(
                "warning",
                "rest pose",
                f"{prefix}the rest pose does not stand ({where}); only the motion does",
                "retarget by poses, not by the rest pose",
            )
        )
    facts["stature_m"] = None
    if stands and head is not None:
        # From the sole to the head's joint is about 0.87 of the stature.
        stature = float(at[head, 1] - at[:, 1].min()) / 0.87
        facts["stature_m"] = round(stature, 3)
        if not 0.4 < stature < 3.0:
            findings.append(
                Finding(
                    "warning",
                    "scale",
                    f"{prefix}the figure is {stature:.3g} m tall",
                    "read it in another unit: keypose convert FILE OUT --unit cm",
                )
            )
    ground = float(np.quantile(posed[:, :, 1].min(axis=1), 0.05)) if posed is not None else float(rest[:, 1].min())
    facts["ground_m"] = round(ground, 4)
    size = max(facts.get("stature_m") or height, 1e-6)
    if abs(ground) > 0.15 * size:
        findings.append(Finding("warning", "ground", f"{prefix}the lowest joints are {ground:+.3g} m from the ground"))
    by_sides, by_feet = facing(body, at)
    found = by_feet if by_feet is not None else by_sides
    # Somebody in motion may be turned anywhere; a rest pose says which way the character was built.
    facts["forward"] = None if found is None or not upright else _axis(found)
    facts["handedness"] = "right"
    if by_sides is not None and by_feet is not None and float(by_sides @ by_feet) < -0.5:
        facts["handedness"] = "mirrored"
        findings.append(
            Finding(
                "warning",
                "sides",
                f"{prefix}left and right are swapped: the feet point against what the sides say (a mirrored axis, or swapped names)",
            )
        )
    if upright and facts["forward"] not in (None, "+Z"):
        findings.append(
            Finding("warning", "forward", f"{prefix}at rest it faces {facts['forward']}; keypose's characters face +Z")
        )


def _reach(skeleton: Skeleton) -> float:
    return float(np.linalg.norm(np.asarray(skeleton.rest.translations), axis=-1)[1:].sum()) / 4


def _axis(direction: Floats) -> str:
    """The axis that a horizontal direction is nearest to, or its heading in degrees from +Z."""
    heading = float(np.degrees(np.arctan2(direction[0], direction[2])))
    for name, angle in (("+Z", 0.0), ("+X", 90.0), ("-X", -90.0), ("-Z", 180.0), ("-Z", -180.0)):
        if abs(heading - angle) < 20:
            return name
    return f"{heading:+.0f} degrees from +Z"


def _jumps(skeleton: Skeleton, posed: Floats, findings: list[Finding], prefix: str) -> None:
    if len(posed) < 4:
        return
    if not np.all(np.isfinite(posed)):
        bad = int(np.argwhere(~np.isfinite(posed).all(axis=(1, 2)))[0][0])
        findings.append(Finding("warning", "numbers", f"{prefix}frame {bad} holds numbers that are not finite"))
        return
    steps = np.linalg.norm(np.diff(posed, axis=0), axis=-1).max(axis=1)
    # A jump is far above what happens around it, the step back beside it left out.
    padded = np.pad(steps, 6, mode="constant")
    around = np.max([np.roll(padded, shift)[6:-6] for shift in (*range(-6, -1), *range(2, 7))], axis=0)
    wild = np.flatnonzero((steps > 4 * around) & (steps > 0.15))
    if len(wild) and int(wild[0]) == 0:
        findings.append(
            Finding(
                "warning",
                "frames",
                f"{prefix}frame 0 is {steps[0]:.2g} m from frame 1: a calibration pose before the motion?",
            )
        )
        wild = wild[1:]
    if len(wild):
        joint = skeleton.names[int(np.linalg.norm(posed[wild[0] + 1] - posed[wild[0]], axis=-1).argmax())]
        more = f", {len(wild) - 1} more like it" if len(wild) > 1 else ""
        findings.append(
            Finding(
                "warning",
                "frames",
                f"{prefix}'{joint}' jumps {steps[wild[0]]:.2g} m between frames {wild[0]} and {wild[0] + 1}{more}",
            )
        )


def _bones(skeleton: Skeleton, motions: list[Clip | Motion], findings: list[Finding], prefix: str) -> None:
    for motion in motions[:1]:
        if not isinstance(motion, Motion) or motion.joint_names != skeleton.names or motion.frame_count < 2:
            continue
        lengths = np.linalg.norm(np.asarray(motion.pose.broadcast().translations, np.float64), axis=-1)
        change = np.ptp(lengths, axis=0)
        change[np.asarray(skeleton.parents) < 0] = 0.0
        # Below a root that only carries the place, the first body joint travels too.
        tops = [j for j, p in enumerate(skeleton.parents) if p >= 0 and skeleton.parents[p] < 0]
        change[tops] = 0.0
        if change.max() > 0.005:
            joint = int(change.argmax())
            findings.append(
                Finding(
                    "warning",
                    "bones",
                    f"{prefix}bones change their length, '{skeleton.names[joint]}' most, by {1000 * change[joint]:.3g} mm",
                )
            )


def _part(part: Part, findings: list[Finding], prefix: str) -> None:
    where = f"{prefix}part '{part.name}'"
    points = np.asarray(part.mesh.positions, np.float64)
    triangles = np.asarray(part.mesh.triangles)
    if not np.all(np.isfinite(points)):
        findings.append(Finding("warning", "mesh", f"{where}: vertices that are not finite"))
        return
    if len(triangles):
        a, b, c = (points[triangles[:, k]] for k in range(3))
        area = np.linalg.norm(np.cross(b - a, c - a), axis=-1)
        flat = int(np.sum(area <= 1e-14 * max(float(np.ptp(points, axis=0).max()) ** 2, 1e-30)))
        if flat:
            findings.append(
                Finding("warning", "mesh", f"{where}: {flat:,} of {len(triangles):,} triangles have no area")
            )
    if part.skin is not None:
        weights = np.asarray(part.skin.weights, np.float64)
        sums = weights.sum(axis=1)
        if len(sums) and float(np.abs(sums - 1).max()) > 1e-3:
            bare = int(np.sum(sums == 0))
            text = (
                f"{bare:,} vertices hang on no joint"
                if bare
                else f"weights sum to {sums.min():.3g} to {sums.max():.3g}, not 1"
            )
            findings.append(Finding("warning", "weights", f"{where}: {text}"))
        most = int((weights > 0).sum(axis=1).max()) if weights.size else 0
        if most > 4:
            findings.append(
                Finding(
                    "fact",
                    "weights",
                    f"{where}: up to {most} joints move a vertex; many engines keep 4",
                    "deform.pack states the error",
                )
            )


# --- time -------------------------------------------------------------------------------------------------------------------


def _animations(scene: Scene, facts: dict[str, Any], findings: list[Finding]) -> None:
    rates: list[float | None] = []
    for animation in scene.animations:
        rate = animation.rate_hz if isinstance(animation, Motion) else key_rate(animation)
        rates.append(rate)
        name = f"clip '{animation.name}'" if animation.name else "the clip"
        if rate is None and isinstance(animation, Clip) and animation.curves:
            findings.append(
                Finding("fact", "rate", f"{name} has keys at uneven times", "keypose convert FILE OUT.bvh --rate 60")
            )
        elif rate is not None and not any(abs(rate / r - 1) < 2e-4 for r in (*_RATES_HZ, *_MORE_RATES_HZ)):
            findings.append(
                Finding(
                    "warning",
                    "rate",
                    f"{name} runs at an unusual {rate:.6g} Hz",
                    f"keypose convert FILE OUT --rate {max(round(rate), 1)}",
                )
            )
        if isinstance(animation, Motion) and animation.frame_count == 1:
            findings.append(Finding("warning", "frames", f"{name} has one frame: a pose, not a motion"))
        if animation.duration_s > 0 and isinstance(animation, Motion):
            pose = animation.pose.broadcast()
            if (
                animation.frame_count > 2
                and not np.any(np.ptp(np.asarray(pose.rotations), axis=0))
                and not np.any(np.ptp(np.asarray(pose.translations), axis=0))
                and animation.morph_weights is None
            ):
                findings.append(Finding("warning", "frames", f"{name} does not move"))
    facts["clips"] = len(rates)
    facts["rate_hz"] = rates[0] if rates else None


def _markers(markers: Markers, facts: dict[str, Any], findings: list[Finding]) -> None:
    visible: Any = np.asarray(markers.visible)
    missing = 1.0 - float(visible.mean()) if visible.size else 0.0
    facts |= {"markers": len(markers.names), "missing_share": round(missing, 5)}
    facts.setdefault("rate_hz", markers.rate_hz)
    facts["rate_hz"] = facts["rate_hz"] or markers.rate_hz
    never = [n for n, seen in zip(markers.names, visible.any(axis=0), strict=True) if not seen] if visible.size else []
    if never:
        shown = ", ".join(never[:5]) + (" ..." if len(never) > 5 else "")
        findings.append(
            Finding("warning", "markers", f"{len(never)} of {len(markers.names)} markers are never seen: {shown}")
        )
    if missing > 0.001:
        gaps = [_longest_gap(visible[:, n]) for n in range(visible.shape[1])]
        worst = int(np.argmax(gaps))
        findings.append(
            Finding(
                "fact" if missing < 0.1 else "warning",
                "markers",
                f"{100 * missing:.2g}% of the marker data is missing; the longest gap between two sightings is {gaps[worst]} frames "
                f"('{markers.names[worst]}')",
            )
        )
    double = [n for n, count in Counter(markers.names).items() if count > 1]
    if double:
        findings.append(Finding("warning", "markers", f"marker names occur more than once: {', '.join(double[:5])}"))
    unnamed = sum(1 for n in markers.names if not n or n.startswith("*") or n.lower().startswith(("unlabel", "u_")))
    if unnamed:
        findings.append(Finding("warning", "markers", f"{unnamed} trajectories have no name"))
    if markers.visible is not None and visible.any():
        heights = np.asarray(markers.positions)[..., 1][visible]
        facts["marker_height_m"] = [round(float(np.quantile(heights, q)), 3) for q in (0.0, 1.0)]
        if float(np.quantile(heights, 0.99)) - float(np.quantile(heights, 0.01)) > 20:
            findings.append(
                Finding("warning", "scale", "the markers spread over more than 20 m in height: a wrong unit?")
            )


def _longest_gap(seen: Any) -> int:
    """Frames of the longest gap between two sightings."""
    at = np.flatnonzero(seen)
    return int(np.diff(at).max()) - 1 if len(at) > 1 else 0
