"""Reach edits: a hand, a foot, any joint is at a place in some frames, and the motion around them gives way smoothly."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from keypose.arrays import Array, Floats, Ints, checked, finite
from keypose.editing.displacement import displace, fit_displacement, rotation_change
from keypose.editing.limb_pose import LimbJoints, bend_direction, bend_limb, keep_ends, limb_above, path_up
from keypose.errors import ShapeError, UnknownName
from keypose.evaluate import world_rotations_positions
from keypose.ik import OrientationTask, PosePrior, PositionTask, SolveOptions, Task, chain_between, solve_pose
from keypose.math import quat
from keypose.model import Motion, Pose, Skeleton

Progress = Callable[[int, int], None]

REACHED_M = 1e-4
"""So near a joint has to be for its constraint to count as met."""


KEPT = ("left_foot", "right_foot")
"""What stays where it is, of the ends of limbs that there are, while the whole body helps."""

_EXACT = SolveOptions(tolerance_m=1e-7)
# What a radian of the whole body counts, in metres, and a metre of the root: so much that hips stay over the feet.
_PRIOR_M, _PRIOR_ROOT = 0.03, 0.3
_BODY_ROUNDS = 4
# The share of a limb's length over which it slows down on its way, where no constraint says where it is.
_SOFT = 0.02
# ... and how far it must be displaced for that.
_SOFT_FROM_M = 0.03


@dataclass(frozen=True, slots=True, eq=False)
class Reach:
    """A joint that is at a place from a first to a last frame.

    Shapes and units:
        joint: a joint's name, or a role such as ``left_hand``.
        first, last: frames, both counted in; ``last`` is ``first`` if not given.
        target: (3,) or (N, 3) metres in the model's space, one for each frame.
        offset: (3,) or (N, 3) metres from where the joint is in the motion, instead of a target.
        rotation: (4,) or (N, 4) of the joint in the model's space. If not given, feet keep theirs and hands turn with the
            arm; ``keep_rotation`` says otherwise.

    Raises:
        ShapeError: where there is not exactly one of target and offset, or a shape or frame does not fit.
    """

    joint: str
    first: int
    last: int = -1
    target: Any = None
    offset: Any = None
    rotation: Any = None
    keep_rotation: bool | None = None

    def __post_init__(self) -> None:
        if self.last == -1:
            object.__setattr__(self, "last", self.first)
        if not 0 <= self.first <= self.last:
            raise ShapeError(f"{self.joint}: expected frames first <= last from 0 on, got {self.first} to {self.last}")
        if (self.target is None) == (self.offset is None):
            raise ShapeError(f"{self.joint}: expected a target or an offset")
        frames = self.last - self.first + 1
        for name, width in (("target", 3), ("offset", 3), ("rotation", 4)):
            given = getattr(self, name)
            if given is None:
                continue
            array = np.asarray(given, np.float64)
            if array.shape not in ((width,), (frames, width)) or not np.all(np.isfinite(array)):
                raise ShapeError(f"{self.joint}: {name}: expected ({width},) or ({frames}, {width}), got {array.shape}")
            object.__setattr__(self, name, np.array(np.broadcast_to(array, (frames, width))))
        if self.rotation is not None:
            object.__setattr__(self, "rotation", quat.normalize(self.rotation))

    @property
    def frames(self) -> Ints:
        """All frames of the constraint."""
        return np.arange(self.first, self.last + 1)


@dataclass(frozen=True, slots=True, eq=False)
class ReachResult:
    """The motion after reach edits.

    Shapes and units: ``error_m`` for each constraint its distance left (N,) metres; ``converged`` whether all are at most
    `REACHED_M`; ``changed`` (T,) the frames that are not as before; ``kept_m`` how far ends of limbs that were to stay are from
    their old places at most.
    """

    motion: Motion
    error_m: tuple[Floats, ...]
    converged: bool
    changed: np.ndarray
    kept_m: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class _Goal:
    """A constraint with its joint found and its places known."""

    reach: Reach
    joint: int
    targets: Floats
    limb: LimbJoints | None
    keep_rotation: bool


@dataclass(slots=True)
class _Changes:
    """Wanted changes at frames, by joint."""

    frames: list[Ints] = field(default_factory=list[Any])
    values: list[Floats] = field(default_factory=list[Any])

    def add(self, frames: Ints, values: Floats) -> None:
        self.frames.append(frames)
        self.values.append(values)

    def fitted(self, frame_count: int, ease: int) -> Floats:
        frames = np.concatenate(self.frames)
        order = np.argsort(frames, kind="stable")
        return fit_displacement(frames[order], np.concatenate(self.values)[order], frame_count, ease).values


def reach(
    motion: Motion,
    skeleton: Skeleton,
    reaches: Sequence[Reach],
    *,
    roles: Mapping[str, int] | None = None,
    ease_s: float = 0.4,
    softness: float = 0.0,
    whole_body: bool = False,
    keep: Sequence[str] = KEPT,
    progress: Progress | None = None,
) -> ReachResult:
    """A motion in which joints are where they should be, with a smooth displacement that begins and ends ``ease_s`` around.

    Hands and feet, and what hangs on them, are reached by their two bones, a root by moving it, everything else by the joints
    above it. Roots are moved first, limbs last, so that a planted foot stays planted. Frames further away are not touched at
    all. A target out of reach is approached as far as the limb goes, and the result says so; with ``whole_body`` trunk and
    root help where a limb is too short, and the ends of limbs in ``keep`` (those that there are) stay where they were.

    Shapes and units: ``roles`` as `keypose.analysis.find_roles` finds them, which is asked if they are not given;
    ``softness`` the share of a limb's length over which it slows down before it is straight (it then stays a little short).

    Raises:
        UnknownName: for a joint that is not there.
        ShapeError: where frames lie outside the motion, two constraints want the same limb in the same frame, or the motion has
            numbers that are not finite.

    Source: J. Lee and S. Y. Shin, "A hierarchical approach to interactive motion editing for human-like figures"
    (SIGGRAPH 1999).
    """
    if not (np.isfinite(ease_s) and ease_s >= 0):
        raise ShapeError(f"ease_s: expected 0 or more seconds, got {ease_s}")
    check_finite(motion)
    ease = max(2, round(ease_s * motion.rate_hz))
    known = _roles(skeleton, roles)
    goals = [_goal(r, motion, skeleton, known) for r in reaches]
    _refuse_conflicts(goals, skeleton)
    result, kept_m = motion, 0.0
    for _ in range(_BODY_ROUNDS if whole_body else 0):
        # Staying near the pose holds the body back a little each time.
        short = [g for g in goals if _is_short(g, result, skeleton)]
        if not short:
            break
        result, kept_m = _with_body(motion, result, skeleton, goals, short, known, ease, keep)
    done = 0
    for stage in _stages(goals, skeleton):
        result = _along_paths([g for g in stage if g.limb is not None], result, skeleton, ease, softness)
        # What softness, rounding and a first pass leave, further ones take.
        for _ in range(3):
            turns: dict[int, _Changes] = {}
            moves: dict[int, _Changes] = {}
            for goal in stage:
                _solve(goal, result, skeleton, softness, turns, moves)
            result = displace(
                result,
                {j: c.fitted(motion.frame_count, ease) for j, c in turns.items()},
                {j: c.fitted(motion.frame_count, ease) for j, c in moves.items()},
            )
            if all(float(_errors(g, result, skeleton).max()) <= 0.01 * REACHED_M for g in stage):
                break
        done += len(stage)
        if progress is not None:
            progress(done, len(goals))
    errors = tuple(_errors(g, result, skeleton) for g in goals)
    reached = all(float(e.max()) <= REACHED_M for e in errors)
    return ReachResult(result, errors, reached, changed_frames(motion, result), kept_m)


def joint_of(skeleton: Skeleton, name: str, roles: Mapping[str, int]) -> int:
    """The joint of a name, else the one that plays a role of that name; raises `UnknownName`."""
    if name in skeleton.names:
        return skeleton.names.index(name)
    if name in roles:
        return roles[name]
    raise UnknownName("joint or role", name, (*skeleton.names, *roles))


def check_finite(motion: Motion) -> None:
    """Refuse a motion with a number that is not finite, by a `ShapeError` that says where; one would spread over all frames."""
    for name in ("translations", "rotations", "scales"):
        finite(getattr(motion.pose, name), f"{name} of the motion")


def changed_frames(before: Motion, after: Motion) -> np.ndarray:
    """The frames (T,) in which two motions of one length differ in any bit of their joints."""
    a, b = before.pose.broadcast(), after.pose.broadcast()
    differs = np.zeros(before.frame_count, bool)
    for one, other in ((a.rotations, b.rotations), (a.translations, b.translations), (a.scales, b.scales)):
        differs |= np.any(one != other, axis=(-1, -2))
    return differs


def found_roles(skeleton: Skeleton) -> Mapping[str, int]:
    """The roles of a skeleton's joints, empty where it is no humanoid."""
    from keypose.analysis import find_roles

    found = find_roles(skeleton)
    return found.roles if found.is_humanoid else {}


def _roles(skeleton: Skeleton, roles: Mapping[str, int] | None) -> Mapping[str, int]:
    return found_roles(skeleton) if roles is None else roles


def _goal(wanted: Reach, motion: Motion, skeleton: Skeleton, roles: Mapping[str, int]) -> _Goal:
    joint = joint_of(skeleton, wanted.joint, roles)
    if wanted.last >= motion.frame_count:
        raise ShapeError(f"{wanted.joint}: expected frames up to {motion.frame_count - 1}, got {wanted.last}")
    checked(motion.pose.rotations, (..., skeleton.joint_count, 4), "rotations", "the skeleton")
    if wanted.target is not None:
        targets = wanted.target
    else:
        targets = _places(motion, skeleton, wanted.frames)[1][:, joint] + wanted.offset
    limb = limb_above(skeleton, joint, roles)
    keep = wanted.keep_rotation
    if keep is None:
        # A foot lies on the ground; what is carried needs a hand that does not turn below it.
        legs = (roles.get("left_foot"), roles.get("right_foot"))
        keep = limb is not None and (limb.end in legs or limb.end != joint)
    return _Goal(wanted, joint, targets, limb, keep)


def _refuse_conflicts(goals: Sequence[_Goal], skeleton: Skeleton) -> None:
    for n, one in enumerate(goals):
        for other in goals[:n]:
            same = one.joint == other.joint or (one.limb is not None and one.limb == other.limb)
            if same and one.reach.first <= other.reach.last and other.reach.first <= one.reach.last:
                raise ShapeError(
                    f"'{skeleton.names[one.joint]}' is wanted twice between frames "
                    f"{max(one.reach.first, other.reach.first)} and {min(one.reach.last, other.reach.last)}"
                )


def _stages(goals: Sequence[_Goal], skeleton: Skeleton) -> list[list[_Goal]]:
    """Goals in the order in which they are met: roots, chains from the trunk outwards, limbs (from the trunk outwards)."""
    depths = skeleton.depths()

    def rank(goal: _Goal) -> tuple[int, int]:
        if goal.limb is not None:
            return 1, int(depths[goal.limb.upper])
        return 0, int(depths[goal.joint])

    stages: dict[tuple[int, int], list[_Goal]] = {}
    for goal in goals:
        stages.setdefault(rank(goal), []).append(goal)
    return [stages[r] for r in sorted(stages)]


def _solve(
    goal: _Goal,
    motion: Motion,
    skeleton: Skeleton,
    softness: float,
    turns: dict[int, _Changes],
    moves: dict[int, _Changes],
) -> None:
    """Add what the joints have to change for a goal in its frames."""
    frames = goal.reach.frames
    pose = motion.pose[goal.reach.first : goal.reach.last + 1]
    local = np.asarray(pose.rotations, np.float64)
    if goal.limb is not None:
        solved = bend_limb(
            skeleton,
            pose,
            goal.limb,
            goal.targets,
            bend=bend_direction(motion, skeleton, goal.limb),
            rotations=goal.reach.rotation,
            carried=goal.joint,
            follow=not goal.keep_rotation,
            softness=softness,
        )
        for n, joint in enumerate((goal.limb.upper, goal.limb.lower, goal.limb.end)):
            turns.setdefault(joint, _Changes()).add(frames, rotation_change(local[:, joint], solved.rotations[:, n]))
        return
    turned, places = _places(motion, skeleton, frames)
    parent = int(skeleton.parents[goal.joint])
    if parent < 0 or int(skeleton.parents[parent]) < 0:
        # A root, or what hangs right on one, moves the root.
        root = goal.joint if parent < 0 else parent
        moves.setdefault(root, _Changes()).add(frames, goal.targets - places[:, goal.joint])
    else:
        chain = _chain(skeleton, goal.joint)[:-1]
        others = [skeleton.names[j] for j in path_up(skeleton, goal.joint) if j not in chain]
        task = PositionTask(skeleton.names[goal.joint], goal.targets)
        after = _solved(skeleton, pose, [task], [goal.joint], fixed=others, root="fixed", options=_EXACT)
        new = np.asarray(after.rotations, np.float64)
        for joint in chain:
            turns.setdefault(joint, _Changes()).add(frames, rotation_change(local[:, joint], new[:, joint]))
        turned = np.asarray(world_rotations_positions(skeleton, after)[0], np.float64)
    if goal.reach.rotation is not None:
        above = (
            goal.reach.rotation if parent < 0 else quat.multiply(quat.conjugate(turned[:, parent]), goal.reach.rotation)
        )
        turns.setdefault(goal.joint, _Changes()).add(frames, rotation_change(local[:, goal.joint], above))


def _along_paths(goals: Sequence[_Goal], motion: Motion, skeleton: Skeleton, ease: int, softness: float) -> Motion:
    """The motion with the ends of limbs on displaced paths, reached frame by frame.

    Angles that are displaced in one frame may bend a middle joint the wrong way in another; a path that is displaced cannot.
    Limbs that it would stretch beyond their length slow down before, less so the nearer a constraint is.
    """
    by_joint: dict[int, list[_Goal]] = {}
    for goal in goals:
        by_joint.setdefault(goal.joint, []).append(goal)
    for joint, own in by_joint.items():
        limb = own[0].limb
        if limb is None:
            continue
        own.sort(key=lambda g: g.reach.first)
        frames = np.concatenate([g.reach.frames for g in own])
        places = np.asarray(world_rotations_positions(skeleton, motion.pose.broadcast())[1], np.float64)[:, joint]
        offsets = np.concatenate([g.targets for g in own]) - places[frames]
        path = fit_displacement(frames, offsets, motion.frame_count, ease).values
        sure = fit_displacement(frames, np.ones((len(frames), 1)), motion.frame_count, ease).values[:, 0]
        rows = np.flatnonzero(np.any(path != 0, axis=-1))
        if not len(rows):
            continue
        full = motion.pose.broadcast()
        # where it is hardly moved it is hardly slowed down, so that a straight limb keeps what the motion gives it
        moved = np.clip(np.linalg.norm(path[rows], axis=-1) / _SOFT_FROM_M, 0.0, 1.0)
        moved *= moved * (3.0 - 2.0 * moved)
        solved = bend_limb(
            skeleton,
            Pose(full.translations[rows], full.rotations[rows], full.scales[rows]),
            limb,
            places[rows] + path[rows],
            bend=bend_direction(motion, skeleton, limb),
            carried=joint,
            follow=not own[0].keep_rotation and joint == limb.end,
            softness=softness + _SOFT * moved * (1.0 - np.clip(sure[rows], 0.0, 1.0)),
        )
        rotations = np.array(full.rotations)
        for n, part in enumerate((limb.upper, limb.lower, limb.end)):
            rotations[rows, part] = solved.rotations[:, n]
        motion = motion.with_pose(Pose(motion.pose.translations, rotations, motion.pose.scales))
    return motion


def _with_body(
    before: Motion,
    motion: Motion,
    skeleton: Skeleton,
    goals: Sequence[_Goal],
    short: Sequence[_Goal],
    roles: Mapping[str, int],
    ease: int,
    keep: Sequence[str],
) -> tuple[Motion, float]:
    """The motion with trunk and root moved where a limb alone would be too short, and how far kept ends moved; limbs are for
    later.

    Only the frames of such constraints count: others leave the trunk alone, and its change must not come and go with them.
    """
    frames = np.unique(np.concatenate([g.reach.frames for g in short]))
    full = motion.pose.broadcast()
    pose = Pose(full.translations[frames], full.rotations[frames], full.scales[frames])
    own = before.pose.broadcast()
    first = Pose(own.translations[frames], own.rotations[frames], own.scales[frames])
    turned, places = (np.asarray(a, np.float64) for a in world_rotations_positions(skeleton, first))
    tasks: list[Task] = [PosePrior(weight=_PRIOR_M, root_weight=_PRIOR_ROOT)]
    name = skeleton.names
    for goal in goals:
        targets, weights = places[:, goal.joint].copy(), np.zeros(len(frames))
        at = np.isin(frames, goal.reach.frames)
        targets[at], weights[at] = goal.targets[frames[at] - goal.reach.first], 1.0
        tasks.append(PositionTask(name[goal.joint], targets, weights))
    moved = {g.limb.end for g in goals if g.limb is not None}
    there = [name for name in keep if name not in KEPT or name in roles]  # not every skeleton has feet
    kept = [j for j in (joint_of(skeleton, name, roles) for name in there) if j not in moved]
    for joint in kept:
        tasks += [PositionTask(name[joint], places[:, joint]), OrientationTask(name[joint], turned[:, joint], 0.1)]
    solved = _solved(skeleton, pose, tasks, [*(g.joint for g in goals), *kept])
    limbs = [limb_above(skeleton, j, roles) for j in (*(g.joint for g in goals), *kept)]
    later = {j for limb in limbs if limb is not None for j in (limb.upper, limb.lower, limb.end)}
    new, old = np.asarray(solved.rotations, np.float64), np.asarray(pose.rotations, np.float64)
    changed = np.flatnonzero(np.any(np.abs(new - old) > 1e-9, axis=(0, 2)))
    turns = {
        int(j): fit_displacement(frames, rotation_change(old[:, j], new[:, j]), motion.frame_count, ease).values
        for j in changed
        if j not in later
    }
    went = np.asarray(solved.translations, np.float64) - np.asarray(pose.translations, np.float64)
    moves = {
        int(j): fit_displacement(frames, went[:, j], motion.frame_count, ease).values
        for j in np.flatnonzero(np.any(np.abs(went) > 1e-9, axis=(0, 2)))
    }
    result = displace(motion, turns, moves)
    rows = np.flatnonzero(changed_frames(before, result))
    return keep_ends(before, result, skeleton, kept, rows, roles)


def _solved(skeleton: Skeleton, pose: Pose, tasks: Sequence[Task], ends: Sequence[int], **how: Any) -> Pose:
    """Poses that do tasks, by the joints above some ends; fingers and faces would only make the problem larger."""
    used = sorted({j for end in ends for j in path_up(skeleton, end)})
    place = {joint: n for n, joint in enumerate(used)}
    full = pose.broadcast()

    def part(whole: Pose) -> Pose:
        return Pose(whole.translations[..., used, :], whole.rotations[..., used, :], whole.scales[..., used, :])

    parents = [place.get(int(skeleton.parents[j]), -1) for j in used]
    small = Skeleton(tuple(skeleton.names[j] for j in used), np.array(parents, np.int32), part(skeleton.rest))
    solved = solve_pose(small, part(full), tasks, **how).pose.broadcast()
    rotations, translations = np.array(full.rotations), np.array(full.translations)
    rotations[..., used, :], translations[..., used, :] = solved.rotations, solved.translations
    return Pose(translations, rotations, full.scales)


def _is_short(goal: _Goal, motion: Motion, skeleton: Skeleton) -> bool:
    """Whether a limb alone does not get there."""
    if goal.limb is None:
        return False
    solved = bend_limb(
        skeleton,
        motion.pose[goal.reach.first : goal.reach.last + 1],
        goal.limb,
        goal.targets,
        bend=bend_direction(motion, skeleton, goal.limb),
        rotations=goal.reach.rotation,
        carried=goal.joint,
        follow=not goal.keep_rotation,
    )
    return float(solved.error_m.max(initial=0.0)) > REACHED_M


def _chain(skeleton: Skeleton, joint: int) -> tuple[int, ...]:
    """The joints from right below the root down to one."""
    top = joint
    while int(skeleton.parents[int(skeleton.parents[top])]) >= 0:
        top = int(skeleton.parents[top])
    return chain_between(skeleton, top, joint)


def _places(motion: Motion, skeleton: Skeleton, frames: Ints) -> tuple[Floats, Floats]:
    turned, places = world_rotations_positions(skeleton, motion.pose[int(frames[0]) : int(frames[-1]) + 1])
    return np.asarray(turned, np.float64), np.asarray(places, np.float64)


def _errors(goal: _Goal, motion: Motion, skeleton: Skeleton) -> Floats:
    places: Array = _places(motion, skeleton, goal.reach.frames)[1]
    return np.linalg.norm(places[:, goal.joint] - goal.targets, axis=-1)
