"""What the doctor sees in a character: how it stands, faces and moves, its size, its bones, its meshes."""

from __future__ import annotations

from typing import Any

import numpy as np

from keypose.analysis.anatomy import (
    Body,
    facing,
    figure_joints,
    find_body,
    on_all_fours,
    rest_kind,
    upright,
    with_roles,
)
from keypose.analysis.findings import Finding, listed
from keypose.arrays import Floats, Ints
from keypose.evaluate import bake, frame_rate, world_rotations_positions
from keypose.model import Character, Clip, Motion, Part, Pose, Skeleton

_MOST_FRAMES = 20_000  # of a motion that is looked at; longer ones are looked at in even steps
_STATURES_M = (0.4, 2.6)  # from a small child to more than any human
_USUAL_M = 1.7
_LONGEST_M = 50.0  # of any creature
_SLOWEST_HZ = 10.0  # keys further apart are no frames of a recording
_TRAVELLING = 0.15  # of the stature: how far the feet may be from the ground


def examine_character(
    character: Character, motions: list[Clip | Motion], facts: dict[str, Any], findings: list[Finding], own: str
) -> None:
    """Add facts and findings of one character; ``own`` is its name where there are several."""
    prefix = f"{own}: " if own else ""
    skeleton = character.skeleton
    if skeleton.joint_count > 1:
        joints = figure_joints(character)
        body = with_roles(find_body(skeleton.names, joints), character.roles)
        rest = np.asarray(world_rotations_positions(skeleton, skeleton.rest)[1], np.float64)
        posed, rate_hz = _frames(skeleton, motions)
        _Figure(body, skeleton, joints, rest, posed, bool(motions), facts, findings, prefix).examine()
        if posed is not None and rate_hz >= _SLOWEST_HZ and body:
            _jumps(skeleton, posed[:, joints], joints, findings, prefix)
        _bones(skeleton, motions, findings, prefix)
        if not facts.get("stature_m"):
            _mesh_size(character, findings, prefix)
    for part in character.parts:
        _part(part, findings, prefix)
    _influences(character.parts, findings, prefix)
    negative = np.flatnonzero((np.asarray(skeleton.rest.scales) < 0).any(axis=1))
    if len(negative):
        # On the very tips, which move nothing, it does no harm.
        tips = not np.isin(negative, np.asarray(skeleton.parents)).any() and not _held(character, negative)
        names = listed([skeleton.names[j] for j in negative])
        text = f"{prefix}{len(negative)} joints have negative scale, which mirrors what hangs on them: {names}"
        findings.append(Finding("fact" if tips else "warning", "scale", text))


def _held(character: Character, joints: Ints) -> bool:
    """Whether any part hangs on one of the joints."""
    hung = [part.joint for part in character.parts if part.joint is not None]
    held = [np.asarray(part.skin.palette) for part in character.parts if part.skin is not None]
    return any(np.isin(joints, palette).any() for palette in (np.array(hung), *held))


def _mesh_size(character: Character, findings: list[Finding], prefix: str) -> None:
    """What is skinned and no human: an animal or a creature, which has a size of its own, within reason."""
    points = [np.asarray(p.mesh.positions) for p in character.parts if p.skin is not None and p.mesh.vertex_count]
    if not points:
        return
    longest = float(np.ptp(np.concatenate(points), axis=0).max())
    if longest > _LONGEST_M:
        factor = next((f for f in (0.1, 0.01, 0.001) if longest * f < 5), 0.001)
        text = f"{prefix}what is skinned is {longest:.3g} m long: a wrong unit?"
        findings.append(Finding("warning", "scale", text, f"keypose convert FILE OUT --scale {factor:g}"))


def _frames(skeleton: Skeleton, motions: list[Clip | Motion]) -> tuple[Floats | None, float]:
    """Places (F, J, 3) of the joints along the first animation, in even steps where it is long, and its rate in Hz."""
    for motion in motions:
        if isinstance(motion, Clip):
            rate = frame_rate(motion)
            if motion.duration_s * rate > _MOST_FRAMES or not motion.curves:
                continue
            motion = bake(motion, skeleton, rate)
        if motion.joint_names != skeleton.names or motion.frame_count == 0:
            continue
        every = -(-motion.frame_count // _MOST_FRAMES)
        pose = motion.pose.broadcast()
        part = Pose(pose.translations[::every], pose.rotations[::every], pose.scales[::every])
        return np.asarray(world_rotations_positions(skeleton, part)[1], np.float64), motion.rate_hz
    return None, 0.0


class _Figure:
    """One body, at rest and along its first motion."""

    def __init__(
        self,
        body: Body,
        skeleton: Skeleton,
        joints: Ints,
        rest: Floats,
        posed: Floats | None,
        moving: bool,
        facts: dict[str, Any],
        findings: list[Finding],
        prefix: str,
    ) -> None:
        self.body, self.skeleton, self.joints, self.rest, self.posed = body, skeleton, joints, rest, posed
        self.moving, self.facts, self.findings, self.prefix = moving, facts, findings, prefix

    def warn(self, topic: str, text: str, fix: str = "", *, fact: bool = False) -> None:
        self.findings.append(Finding("fact" if fact else "warning", topic, self.prefix + text, fix))

    def examine(self) -> None:
        """All that can be said of the body."""
        body, rest = self.body, self.rest
        how = upright(body, rest)
        kind = rest_kind(body, rest)
        fours = on_all_fours(body, rest)
        if how is not None:
            if self.heap():
                kind = "collapsed"
            elif fours:
                kind = "on all fours"
            elif how < 0.7:
                kind = "lying"
        self.facts["rest_pose"] = kind
        self.facts["sides"] = {"pairs": len(body.pairs)}
        if kind in ("collapsed", "lying"):
            where = "all joints lie in a heap" if kind == "collapsed" else "it lies down"
            self.warn("rest pose", f"the rest pose does not stand ({where}); what is retargeted by it goes wrong")
        stands = how is not None and kind not in ("collapsed", "lying")
        at, frame = (rest, None) if stands or self.posed is None else self.standing_frame(self.posed)
        standing = at is not None and (upright(body, at) or 0.0) > 0.7
        if standing and at is not None:
            self.size(at, fours)
        self.ground(standing)
        self.heading(at if standing else None, frame)

    def heap(self) -> bool:
        """Whether head and feet are much nearer to each other than the bones between them are long."""
        head, feet = self.body.head, self.body.feet
        if head is None or not feet:
            return False
        parents = self.skeleton.parents
        lengths = np.linalg.norm(self.rest - self.rest[np.maximum(parents, 0)], axis=-1)

        def above(joint: int) -> list[int]:
            path = [joint]
            while parents[path[-1]] >= 0:
                path.append(int(parents[path[-1]]))
            return path

        up, down = above(head), above(feet[0])
        between = [j for j in up if j not in down] + [j for j in down if j not in up]
        length = float(sum(lengths[j] for j in between))
        return float(np.linalg.norm(self.rest[head] - self.rest[feet].mean(axis=0))) <= 0.3 * length

    def standing_frame(self, posed: Floats) -> tuple[Floats | None, int | None]:
        """The frame in which the body is most upright."""
        some = np.unique(np.linspace(0, len(posed) - 1, 64).astype(int))
        best = max(some.tolist(), key=lambda f: upright(self.body, posed[f]) or 0.0)
        return posed[best], int(best)

    def size(self, at: Floats, fours: bool) -> None:
        """How tall the figure is."""
        head, feet = self.body.head, self.body.feet
        if head is None or not feet or fours:
            return
        # From the sole to the head's joint is about 0.87 of the stature.
        stature = float(at[head, 1] - at[feet, 1].min()) / 0.87
        self.facts["stature_m"] = round(stature, 3)
        if not _STATURES_M[0] < stature < _STATURES_M[1]:
            tens = [f for f in (0.001, 0.01, 0.1, 10.0, 100.0, 1000.0) if 1.2 < stature * f < 2.1]
            factor = tens[0] if tens else float(f"{_USUAL_M / stature:.2g}")
            self.warn(
                "scale",
                f"the figure is {stature:.3g} m tall: a wrong unit?",
                f"keypose convert FILE OUT --scale {factor:g}",
            )

    def ground(self, standing: bool) -> None:
        """How far the lowest joints are from the ground."""
        low = self.body.feet or self.joints
        if self.posed is not None:
            ground = float(np.quantile(self.posed[:, low, 1].min(axis=1), 0.05))
        else:
            ground = float(self.rest[low, 1].min())
        self.facts["ground_m"] = round(ground, 4)
        stature = self.facts.get("stature_m")
        if not standing or not stature or abs(ground) <= _TRAVELLING * stature:
            return
        tops = [j for j in self.joints.tolist() if self.skeleton.parents[j] < 0]
        origin = not self.moving and bool(tops) and bool(np.abs(self.rest[tops]).max() < 1e-3 * stature)
        text = "the hips lie in the origin, and the feet" if origin else "the feet"
        self.warn(
            "ground",
            f"{text} are {abs(ground):.3g} m {'below' if ground < 0 else 'above'} the ground",
            f"keypose convert FILE OUT --raise {-ground:.4g}",
            fact=origin,
        )

    def heading(self, at: Floats | None, frame: int | None) -> None:
        """Which way the body faces, and whether left and right are where their names say."""
        if at is None:
            return
        by_sides, by_feet = facing(self.body, at)
        found = by_feet if by_feet is not None else by_sides
        self.facts["handedness"] = "right"
        if found is not None:
            self.facts["forward" if frame is None else "forward_moving"] = _axis(found)
        if by_sides is not None and by_feet is not None and float(by_sides @ by_feet) < -0.5:
            self.facts["handedness"] = "mirrored"
            self.warn(
                "sides",
                "left and right are swapped: the feet point against what the sides say (a mirrored axis, or swapped names)",
            )
        # Somebody in motion may be turned anywhere; a rest pose says which way the character was built.
        elif frame is None and found is not None and _axis(found) != "+Z":
            degrees = float(np.degrees(np.arctan2(found[0], found[2])))
            nearest = 90 * round(degrees / 90)
            turn = -nearest if abs(degrees - nearest) < 20 and nearest else -degrees
            self.warn(
                "forward",
                f"at rest it faces {_axis(found)}; keypose's characters face +Z",
                f"keypose convert FILE OUT --turn {turn:.4g}",
            )


def _axis(direction: Floats) -> str:
    """The axis that a horizontal direction is nearest to, or its heading in degrees from +Z."""
    heading = float(np.degrees(np.arctan2(direction[0], direction[2])))
    for name, angle in (("+Z", 0.0), ("+X", 90.0), ("-X", -90.0), ("-Z", 180.0), ("-Z", -180.0)):
        if abs(heading - angle) < 20:
            return name
    return f"{heading:+.0f} degrees from +Z"


def _jumps(skeleton: Skeleton, posed: Floats, joints: Ints, findings: list[Finding], prefix: str) -> None:
    if len(posed) < 4:
        return
    if not np.all(np.isfinite(posed)):
        bad = int(np.argwhere(~np.isfinite(posed).all(axis=(1, 2)))[0][0])
        findings.append(Finding("warning", "frames", f"{prefix}frame {bad} holds numbers that are not finite"))
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
                "keypose convert FILE OUT --skip 1",
            )
        )
        wild = wild[1:]
    if len(wild):
        worst = np.linalg.norm(posed[wild[0] + 1] - posed[wild[0]], axis=-1).argmax()
        joint = skeleton.names[int(joints[worst])]
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
            # A few do no harm; they come from poles of spheres and closed edges.
            level = "warning" if flat > 0.01 * len(triangles) else "fact"
            findings.append(Finding(level, "mesh", f"{where}: {flat:,} of {len(triangles):,} triangles have no area"))
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


def _influences(parts: tuple[Part, ...], findings: list[Finding], prefix: str) -> None:
    """How many joints move a vertex where it is more than engines have."""
    counts = {
        p.name: int((np.asarray(p.skin.weights) > 0).sum(axis=1).max(initial=0)) for p in parts if p.skin is not None
    }
    many = {name: count for name, count in counts.items() if count > 4}
    if many:
        name, most = max(many.items(), key=lambda item: item[1])
        text = f"{prefix}part '{name}': up to {most} joints move a vertex; many engines keep 4"
        text += f"; over 4 in {len(many)} parts" if len(many) > 1 else ""
        findings.append(Finding("fact", "weights", text, "keypose convert FILE OUT --influences 4"))
