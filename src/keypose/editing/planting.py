"""Feet that stand still where they touch the ground: contacts, anchors, and legs that reach them.

A foot in contact is moved so that the point that carries it (the ball, or the heel before the ball lands) does not move; while
both are down it does not turn either. Between two contacts the correction goes over smoothly, with the speed it has at both
ends. Hips come along where a knee would have to jump.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from keypose.analysis.contacts import LEG_M, Footing, find_footing
from keypose.analysis.ground import GROUND_KINDS, Ground, GroundKind
from keypose.analysis.roles import SIDES
from keypose.arrays import Floats, finite
from keypose.editing.planting_cycles import Cycle, cut, find_cycle, unroll
from keypose.editing.planting_hips import hips_path
from keypose.editing.planting_legs import bend_leg, find_leg, knee_angles
from keypose.editing.planting_parts import legs_only
from keypose.editing.planting_paths import FootPath, foot_path
from keypose.errors import KeyposeError, ShapeError
from keypose.evaluate import world_rotations_positions
from keypose.math import quat
from keypose.model import Motion, Pose, Skeleton

Touching = Mapping[str, np.ndarray]
Progress = Callable[[int, int], None]
HipsMode = Literal["free", "upright", "still"]

_ROUNDS = 24  # of planting and looking again; almost always two or three are enough
_SINK_M, _SINK_KNOWN_M = 0.01, 0.0005  # how far feet in the air may go under a ground that is guessed, or known
_STILL_M = 1e-7  # hips that move no more are still, for a leg of LEG_M
_KNEE_LIMIT = 1.4  # times the largest angular acceleration of a knee that there was
_LEAST_KNEE_LIMIT = 14.0  # radians a second squared; what is less nobody sees


@dataclass(frozen=True, slots=True)
class PlantOptions:
    """What counts as a contact, and how feet are held.

    Units:
        height_m, speed_m_s: limits of a contact for a leg of 0.85 m; they grow with the leg.
        ground: ``auto``, ``flat``, ``slope``, ``steps``, or a known `Ground`.
        blend_s: how long the speed of a correction takes to fade beside a contact.
        loop: the motion's last frame is its first, a round on over the ground, and stays so.
        level_feet: whether a foot that is flat is laid on the ground; it is kept from turning anyway.
        hips: ``free`` (they may come along with the feet), ``upright`` (up and down only) or ``still``.
        knee_rad_s2: the largest angular acceleration that a knee may get, radians a second squared, if hips can help it; that of
            `knee_limit` if not given.
    """

    height_m: float = 0.03
    speed_m_s: float = 0.25
    ground: Ground | GroundKind = "auto"
    blend_s: float = 0.2
    level_feet: bool = True
    hips: HipsMode = "free"
    loop: bool = False
    knee_rad_s2: float | None = None

    def __post_init__(self) -> None:
        knees = 1.0 if self.knee_rad_s2 is None else self.knee_rad_s2
        if not (self.height_m > 0 and self.speed_m_s > 0 and self.blend_s > 0 and knees > 0):
            raise ShapeError("options: expected positive limits and a positive blend_s")
        if self.hips not in ("free", "upright", "still"):
            raise ShapeError(f"options: expected hips that are free, upright or still, got {self.hips!r}")
        if isinstance(self.ground, str) and self.ground not in GROUND_KINDS:
            raise ShapeError(f"options: expected a ground of {', '.join(GROUND_KINDS)}, got {self.ground!r}")


@dataclass(frozen=True, slots=True, eq=False)
class PlantResult:
    """The motion with planted feet.

    Shapes and units: ``touching`` point -> (T,) bool for ``left_heel``, ``left_ball`` ...; ``footing`` with the places of these
    points afterwards; ``moved_m`` (T,) how far feet were moved at most, ``hips_m`` (T,) how far the hips; ``short_m`` how far a
    planted foot stays from its anchor at most; ``knee_ratio`` the largest angular acceleration of a knee by that of before;
    ``settled``: planting again would change nothing.
    """

    motion: Motion
    touching: Touching
    footing: Footing
    moved_m: Floats
    hips_m: Floats
    short_m: float
    knee_ratio: float
    settled: bool


def plant_feet(
    motion: Motion,
    skeleton: Skeleton,
    roles: Mapping[str, int],
    *,
    touching: Touching | None = None,
    heights: Floats | None = None,
    options: PlantOptions = PlantOptions(),
    progress: Progress | None = None,
) -> PlantResult:
    """A motion whose feet do not slide while they touch the ground; planted once, it is left as it is.

    Shapes and units: ``touching`` as `foot_contacts` gives it (found in this motion, if not given); ``heights`` (J,) metres,
    the height of every joint where it stands on the ground (if not given, where feet stand in this motion).

    Contacts that were not given are looked for again in the planted motion, and what is new is planted too, until nothing is.
    ``progress`` is called with (steps done, steps in all); steps are added where that takes more rounds than usual.

    Raises:
        KeyposeError: where a leg has no hip, knee or foot.
        ShapeError: where flags have other lengths than the motion, what is to be a loop is none, or a joint is at no place.

    Source: L. Kovar, J. Schreiner and M. Gleicher, "Footskate cleanup for motion capture editing" (SCA 2002).
    """
    for side in SIDES:
        for part in ("upper_leg", "lower_leg", "foot"):
            if f"{side}_{part}" not in roles:
                raise KeyposeError(f"feet cannot be planted: nothing plays {side}_{part}")
    if touching is not None:
        for point, flags in touching.items():
            if np.shape(flags) != (motion.frame_count,):
                raise ShapeError(f"touching['{point}']: expected {motion.frame_count} flags, got {np.shape(flags)}")
    # contacts that are given are planted once, others twice and looked at a third time, as a rule
    steps = _Steps(progress, 5 if touching is not None else 14)
    cycle = _cycle(motion, skeleton, roles, touching) if options.loop else None
    part = legs_only(motion, skeleton, roles, () if cycle is None else (cycle.joint,))
    if heights is not None:
        heights = np.asarray(heights)[part.joints]
    before = _Body(part.motion, part.skeleton, part.roles, steps)
    if options.knee_rad_s2 is None:
        # that of this motion, in all rounds
        options = replace(options, knee_rad_s2=_limit(before.knee_peak))
    if cycle is None:
        result = _planted_once(before, touching, heights, options)
    else:
        joint = int(np.searchsorted(part.joints, cycle.joint))
        result = _planted_round(before, replace(cycle, joint=joint), heights, options)
    peak = _Body(result.motion, part.skeleton, part.roles, steps).knee_peak
    steps.end()
    return replace(
        result,
        motion=part.put_back(result.motion, closes=cycle is not None),
        knee_ratio=peak / before.knee_peak if before.knee_peak > 1e-9 else 1.0,
    )


def knee_limit(motion: Motion, skeleton: Skeleton, roles: Mapping[str, int]) -> float:
    """The largest angular acceleration that knees of a motion get when its feet are planted, radians a second squared: 1.4 times
    what they have, or little enough that nobody sees it.
    """
    part = legs_only(motion, skeleton, roles)
    return _limit(_Body(part.motion, part.skeleton, part.roles, _Steps(None, 1)).knee_peak)


def _cycle(motion: Motion, skeleton: Skeleton, roles: Mapping[str, int], touching: Touching | None) -> Cycle:
    """How a motion that is to be planted as a loop goes round."""
    if touching is not None:
        raise ShapeError(f"motion '{motion.name}' cannot be planted as a loop: contacts of loops cannot be given")
    turned, places = (np.asarray(a, np.float64) for a in world_rotations_positions(skeleton, motion.pose.broadcast()))
    size = float(find_leg(SIDES[0], roles, skeleton, turned[:1], places[:1]).length[0]) / LEG_M
    cycle = find_cycle(motion, skeleton, turned, places, size)
    if cycle is None:
        raise ShapeError(f"motion '{motion.name}' cannot be planted as a loop: its last frame is not its first")
    return cycle


def _planted_once(
    before: _Body, touching: Touching | None, heights: Floats | None, options: PlantOptions
) -> PlantResult:
    """A motion planted, and what that shows as new contacts planted too, until nothing is new."""
    footing = before.look(options, heights)
    if touching is not None:
        none = np.zeros(before.motion.frame_count, bool)
        flags = {point: np.asarray(touching.get(point, none), bool) for point in footing.points}
        return before.planted(replace(footing, touching=flags), options, heights)
    result = before.planted(footing, options, heights)
    for _ in range(_ROUNDS):
        after = _Body(result.motion, before.skeleton, before.roles, before.steps)
        again = after.look(options, heights)
        if not any(path.moves for path in after.paths(again, options, heights)):
            return replace(result, footing=again, settled=True)
        more = {p: footing.touching[p] | f for p, f in again.touching.items()}
        if all(np.array_equal(more[p], footing.touching[p]) for p in more):
            # nothing new touches the ground, but what was found of it changed: from here on one after the other
            planted = after.planted(again, options, heights)
            result = replace(planted, touching=more, moved_m=np.maximum(result.moved_m, planted.moved_m))
            continue
        footing = replace(footing, touching=more)
        result = before.planted(footing, options, heights)
    return result


def _planted_round(body: _Body, cycle: Cycle, heights: Floats | None, options: PlantOptions) -> PlantResult:
    """A motion that goes round, planted in the middle of three rounds: it goes round still."""
    motion, skeleton, roles = body.motion, body.skeleton, body.roles
    middle = slice(motion.frame_count - 1, 2 * motion.frame_count - 1)
    moved, away, short, made = np.zeros(motion.frame_count), np.zeros(motion.frame_count), 0.0, motion
    rounds = _ROUNDS
    while True:
        rounds_of_it = _Body(unroll(made, skeleton, cycle), skeleton, roles, body.steps)
        long = _planted_once(rounds_of_it, None, heights, options)
        footing = replace(
            long.footing,
            points={p: track[middle] for p, track in long.footing.points.items()},
            touching={p: flags[middle] for p, flags in long.footing.touching.items()},
        )
        touching = {p: flags[middle] for p, flags in long.touching.items()}
        # the first and the last round have open ends, and only they may be moved still
        settled = not long.moved_m[middle].any() and float(long.hips_m[middle].max()) < _STILL_M * body.size
        if settled or (rounds := rounds - 1) < 0:
            return PlantResult(made, touching, footing, moved, away, short, 1.0, settled)
        moved, away = np.maximum(moved, long.moved_m[middle]), np.maximum(away, long.hips_m[middle])
        short = max(short, long.short_m)
        made = cut(long.motion, motion, skeleton, cycle)


def put_on_floor(motion: Motion, skeleton: Skeleton, footing: Footing, height_m: float = 0.0) -> Motion:
    """A motion lifted or lowered as a whole, so that what feet stand on is at a height.

    Units: ``height_m`` of the balls of the feet where they stand (of ankles, if there are no toes). Ground that is not level has
    that height under the first contact.
    """
    first = [(int(np.argmax(flags)), point) for point, flags in footing.touching.items() if flags.any()]
    if not first:
        return motion
    frame, point = min(first)
    place = footing.points[point][frame]
    up = height_m - float(footing.ground.heights(place)) - float(np.mean(list(footing.stand_m.values())))
    pose = motion.pose.broadcast()
    translations = np.array(pose.translations)
    translations[:, np.asarray(skeleton.parents) < 0, 1] += up
    return replace(motion, pose=Pose(translations, pose.rotations, pose.scales))


@dataclass(slots=True)
class _Steps:
    """What is done and what is expected to be, told to who wants to know."""

    show: Progress | None
    total: int
    done: int = 0

    def take(self) -> None:
        self.done += 1
        self.total = max(self.total, self.done + 1)
        if self.show is not None:
            self.show(self.done, self.total)

    def end(self) -> None:
        if self.show is not None:
            self.show(self.total, self.total)


class _Body:
    """A motion's legs in the model's space."""

    def __init__(self, motion: Motion, skeleton: Skeleton, roles: Mapping[str, int], steps: _Steps) -> None:
        self.motion, self.skeleton, self.roles, self.steps = motion, skeleton, roles, steps
        pose = motion.pose.broadcast()
        exact = Pose(*(np.asarray(a, np.float64) for a in (pose.translations, pose.rotations, pose.scales)))
        self.pose = exact
        self.turned, self.places = (np.asarray(a) for a in world_rotations_positions(skeleton, exact))
        finite(self.places, "places of the motion's joints")
        self.legs = [find_leg(side, roles, skeleton, self.turned, self.places) for side in SIDES]
        self.leg_m = float(self.legs[0].length[0])
        self.size = self.leg_m / LEG_M
        angles = [knee_angles(leg) for leg in self.legs]
        self.knee_peak = max(float(np.abs(np.diff(a, 2)).max(initial=0.0)) for a in angles) * motion.rate_hz**2

    def look(self, options: PlantOptions, heights: Floats | None) -> Footing:
        """Where feet stand."""
        footing = find_footing(
            self.roles,
            self.places,
            self.motion.rate_hz,
            self.leg_m,
            height_m=options.height_m,
            speed_m_s=options.speed_m_s,
            ground=options.ground,
        )
        self.steps.take()
        return footing if heights is None else self._stood(footing, heights)

    def _stood(self, footing: Footing, heights: Floats) -> Footing:
        """The footing with heights at which joints are known to stand over a level ground at 0."""
        toes = {side: f"{side}_toes" for side in SIDES}
        stand: dict[str, float] = {}
        soles = dict(footing.soles)
        for side in SIDES:
            ankle = float(heights[self.roles[f"{side}_foot"]])
            stand[side] = ankle
            if toes[side] in self.roles:
                ball = float(heights[self.roles[toes[side]]])
                stand[side] = ball
                foot, toe = self.roles[f"{side}_foot"], self.roles[toes[side]]
                length = float(np.linalg.norm(self.places[0, toe] - self.places[0, foot]))
                soles[side] = replace(soles[side], flat=float(np.arcsin(np.clip((ball - ankle) / length, -1.0, 1.0))))
        return replace(footing, ground=Ground(), stand_m=stand, soles=soles)

    def paths(self, footing: Footing, options: PlantOptions, heights: Floats | None) -> list[FootPath]:
        """What is to be added to both feet."""
        found: list[FootPath] = []
        for side, leg in zip(SIDES, self.legs, strict=True):
            toes = self.roles.get(f"{side}_toes")
            ball = None if toes is None else self.places[:, toes]
            turned = self.turned[:, leg.foot]
            sink = (_SINK_M if heights is None else _SINK_KNOWN_M) * self.size
            found.append(
                foot_path(side, footing, leg.ankle, turned, ball, self.size, options.blend_s, options.level_feet, sink)
            )
        self.steps.take()
        return found

    def planted(self, footing: Footing, options: PlantOptions, heights: Floats | None) -> PlantResult:
        """The motion with these contacts held."""
        paths = self.paths(footing, options, heights)
        frames = self.motion.frame_count
        if not any(path.moves for path in paths):
            none = np.zeros(frames)
            return PlantResult(self.motion, footing.touching, footing, none, none, 0.0, 1.0, True)
        hips = np.zeros((frames, 3))
        joint = self._carrier()
        if options.hips != "still" and joint >= 0:
            limit = _limit(self.knee_peak) if options.knee_rad_s2 is None else options.knee_rad_s2
            hips = hips_path(self.legs, paths, self.motion.rate_hz, options.hips == "upright", limit)
        self.steps.take()
        rotations = np.array(self.pose.rotations)
        short = 0.0
        for leg, path in zip(self.legs, paths, strict=True):
            if path.moves or np.any(hips):
                hangs = leg.upper in self._above(leg.foot)
                missed = bend_leg(leg, self.skeleton, self.turned, hips, path, rotations, hangs)
                short = max(short, float(missed[path.held].max(initial=0.0)))
            self.steps.take()
        translations = np.array(self.pose.translations)
        if joint >= 0:
            translations[:, joint] += self._under(int(self.skeleton.parents[joint]), hips)
        for leg, path in zip(self.legs, paths, strict=True):
            if leg.upper not in self._above(leg.foot):
                # a foot that does not hang on the leg, as some rigs have it, goes itself
                own = path.shift - (hips if joint in self._above(leg.foot) else 0.0)
                translations[:, leg.foot] += self._under(int(self.skeleton.parents[leg.foot]), own)
        given = self.motion.pose
        made = Pose(
            translations.astype(np.result_type(given.translations)),
            quat.align_signs(rotations, axis=0).astype(np.result_type(given.rotations)),
            self.motion.pose.broadcast().scales,
        )
        result = replace(self.motion, pose=made)
        moved = np.max([np.linalg.norm(path.shift, axis=-1) for path in paths], axis=0)
        away = np.linalg.norm(hips, axis=-1)
        return PlantResult(result, footing.touching, footing, moved, away, short, 1.0, False)

    def _carrier(self) -> int:
        """The joint that moves both legs: the hips, or what is above both; -1 where there is none."""
        above = [self._above(leg.upper) for leg in self.legs]
        shared = [joint for joint in above[0] if joint in above[1]]
        hips = self.roles.get("hips", -1)
        return hips if hips in shared else shared[0] if shared else -1

    def _above(self, joint: int) -> list[int]:
        """What a joint hangs on, nearest first."""
        line = list[int]()
        while (joint := int(self.skeleton.parents[joint])) >= 0:
            line.append(joint)
        return line

    def _under(self, parent: int, moved: Floats) -> Floats:
        """A way in the model's space (T, 3) in the axes of a joint."""
        if parent < 0:
            return moved
        local = quat.rotate(quat.conjugate(self.turned[:, parent]), moved)
        while parent >= 0:
            local = local / self.pose.scales[:, parent]
            parent = int(self.skeleton.parents[parent])
        return local


def _limit(knee_peak: float) -> float:
    return max(_KNEE_LIMIT * knee_peak, _LEAST_KNEE_LIMIT)
