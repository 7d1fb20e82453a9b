"""`keypose edit`: a motion changed by constraints (places to reach, another path, another speed), with the figures."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from keypose.cli.console import Progress, progress_bar
from keypose.cli.inputs import AS_THEY_SAY, Reading, motion_of, open_input
from keypose.cli.output import check_output, motion_facts, motion_words, print_json, print_written, write_scene
from keypose.errors import FormatError, ShapeError
from keypose.model import Motion, Scene, Skeleton

if TYPE_CHECKING:
    from keypose.editing.paths import PathResult
    from keypose.editing.reach import Reach

SCHEMA = "keypose.edit/1"
_KNEES = 1.5  # times as much as before is more than planting allows knees where legs are long enough
_REACH = re.compile(r"^(?P<joint>.+)@(?P<first>\d+)(?:-(?P<last>\d+))?=(?P<sign>\+?)(?P<place>[^+].*)$")
_TURN = re.compile(r"^(?P<joint>.+)@(?P<first>\d+)=(?P<place>.+)$")
_MOVE = re.compile(r"^(?P<frame>\d+)=(?P<place>.+)$")
_SPEED = re.compile(r"^(?P<number>[0-9.eE+-]+)(?P<unit>|x|m/s)$")


@dataclass(frozen=True, slots=True)
class Edits:
    """What is asked for, as the command line says it."""

    reaches: Sequence[str] = ()
    turns: Sequence[str] = ()
    keep: Sequence[str] = ()
    ease_s: float = 0.4
    whole_body: bool = False
    spacetime: bool = False
    bend_deg: float | None = None
    loop: bool = False
    follow: str | None = None
    stride: float | None = None
    speed: str | None = None
    moves: Sequence[str] = ()
    turn_deg: float | None = None
    path_ease_s: float = 1.0

    @property
    def on_path(self) -> bool:
        """Whether the way or the speed on it changes."""
        return self.speed is not None or self.new_path

    @property
    def new_path(self) -> bool:
        """Whether the way changes."""
        given = (self.bend_deg, self.follow, self.stride, self.turn_deg)
        return self.loop or bool(self.moves) or any(value is not None for value in given)


@dataclass(slots=True)
class _Figures:
    """What came of the edits, collected as they are done; ``reached`` how far joints stay from their places in metres."""

    duration_s: float | None = None
    path: PathResult | None = None
    reached: list[tuple[str, float]] = field(default_factory=list[tuple[str, float]])
    converged: bool = True
    frames_changed: int | None = None
    skate_cm_s: tuple[float | None, float | None] = (None, None)

    def lines(self, frame_count: int) -> list[str]:
        """For people."""
        lines: list[str] = []
        if self.duration_s is not None:
            lines.append(f"{self.duration_s:.2f} s long")
        if self.path is not None:
            turned = np.degrees(self.path.path.turning_rad)
            lines.append(f"a way of {self.path.path.lengths_m[-1]:.2f} m that turns by {turned:.0f} degrees")
            if self.path.short_m > 0.001:
                short = f"{100 * self.path.short_m:.1f} cm"
                lines.append(f"a planted foot stays up to {short} from its place: the leg is too short")
            if self.path.knee_ratio > _KNEES:
                lines.append(f"knees accelerate up to {self.path.knee_ratio:.1f} times as before: the way is too tight")
        lines += [_missed(joint, error_m) for joint, error_m in self.reached]
        if not self.converged:
            lines.append("the solver had not come to rest")
        if self.frames_changed is not None:
            lines.append(f"{self.frames_changed:,} of {frame_count:,} frames changed")
        before, after = self.skate_cm_s
        if before is not None and after is not None:
            lines.append(f"feet in contact slide {after:.1f} cm/s (before: {before:.1f})")
        return lines

    def facts(self) -> dict[str, Any]:
        """For programs."""
        path = None
        if self.path is not None:
            length, turned = float(self.path.path.lengths_m[-1]), float(np.degrees(self.path.path.turning_rad))
            path = {"length_m": length, "turning_deg": turned, "short_cm": 100 * self.path.short_m}
            path["knee_ratio"] = self.path.knee_ratio
        before, after = self.skate_cm_s
        return {
            "path": path,
            "reached": [{"joint": joint, "error_mm": 1000 * error_m} for joint, error_m in self.reached],
            "converged": self.converged,
            "frames_changed": self.frames_changed,
            "before": {"skate_cm_s": before},
            "after": {"skate_cm_s": after},
        }


def edit_file(
    source: str,
    output: Path,
    edits: Edits,
    *,
    clip: str | None = None,
    rate_hz: float | None = None,
    reading: Reading = AS_THEY_SAY,
    as_json: bool = False,
    quiet: bool = False,
) -> None:
    """Edit a motion and write it with its character: first its speed, then its path, then poses, then places to reach.

    Raises:
        FormatError: where the output's format cannot be written, or the input has no motion.
        ShapeError, UnknownName: where an edit cannot be read or done.
    """
    check_output(output, [source])
    _check_asked(edits)
    reaches = [_reach(text) for text in edits.reaches]
    scene = open_input(source, reading)
    motion = motion_of(scene, source, clip, rate_hz)
    if motion.frame_count < 2 and (edits.on_path or edits.spacetime):
        raise FormatError("it has one frame only; a path, a speed and --spacetime need a motion", path=source)
    with progress_bar("editing", quiet=quiet or as_json) as progress:
        edited, figures = _edited(motion, scene.character.skeleton, edits, reaches, progress)
    edited = replace(edited, name=motion.name or Path(source).stem)
    made = Scene((scene.character,), (edited,), unit_m=scene.unit_m)
    notes = write_scene(made, output, quiet=quiet or as_json)
    if as_json:
        print_json({"schema": SCHEMA, **motion_facts(output, edited), **figures.facts(), "notes": notes})
    elif not quiet:
        print_written(output, motion_words(edited), notes, figures.lines(motion.frame_count))


def _check_asked(edits: Edits) -> None:
    """Refuse, before anything is read, what asks for nothing or for what cannot be."""
    if not (edits.reaches or edits.turns or edits.on_path):
        raise ShapeError(
            "no edit: expected --reach, --turn, --bend, --loop, --follow, --stride, --move-path, --turn-path or --speed"
        )
    if (edits.spacetime or edits.whole_body) and not edits.reaches:
        raise ShapeError("--whole-body, --spacetime: expected a --reach to go with them")
    if edits.keep and not (edits.turns or edits.spacetime or edits.whole_body):
        raise ShapeError("--keep: expected --turn, --whole-body or --spacetime to go with it")
    for option, degrees in (("--bend", edits.bend_deg), ("--turn-path", edits.turn_deg)):
        if degrees is not None and not np.isfinite(degrees):
            raise ShapeError(f"{option}: expected degrees, got {degrees}")


def _edited(
    motion: Motion, skeleton: Skeleton, edits: Edits, reaches: Sequence[Reach], progress: Progress
) -> tuple[Motion, _Figures]:
    """The motion after all edits, and what came of them."""
    from keypose.analysis.quality import measure_quality
    from keypose.editing.reach import changed_frames, found_roles

    roles = found_roles(skeleton)
    figures = _Figures()
    result = _on_path(motion, skeleton, roles, edits, figures)
    for text in edits.turns:
        result = _turned(result, skeleton, roles, text, edits)
    if reaches and edits.spacetime:
        result = _spacetime(result, skeleton, roles, reaches, edits, figures, progress)
    elif reaches:
        from keypose.editing.reach import KEPT, reach

        done = reach(
            result,
            skeleton,
            reaches,
            roles=roles,
            ease_s=edits.ease_s,
            whole_body=edits.whole_body,
            keep=edits.keep or KEPT,
            progress=progress,
        )
        result = done.motion
        figures.reached = [(r.joint, float(e.max())) for r, e in zip(reaches, done.error_m, strict=True)]
    if result.frame_count == motion.frame_count:
        figures.frames_changed = int(changed_frames(motion, result).sum())
    before, after = (
        measure_quality(m, skeleton, roles or None).skate_cm_s if m.frame_count > 1 else None for m in (motion, result)
    )
    figures.skate_cm_s = before, after
    return result, figures


def _on_path(motion: Motion, skeleton: Skeleton, roles: Mapping[str, int], edits: Edits, figures: _Figures) -> Motion:
    """The motion at its new speed, on its new path."""
    from keypose.editing import paths

    if edits.speed is not None:
        found = _SPEED.match(edits.speed.replace(" ", ""))
        if found is None:
            raise ShapeError(f"--speed: expected a factor such as 1.5, or a speed such as 1.2m/s, got '{edits.speed}'")
        value = _numbers(found["number"], 1, "--speed")[0]
        if value <= 0:
            raise ShapeError(f"--speed: expected a positive factor or speed, got '{edits.speed}'")
        own = paths.extract_path(motion, skeleton, roles=roles)
        factors = paths.speeds_for(own, value) if found["unit"] == "m/s" else value
        motion = paths.retime(motion, skeleton, factors, roles=roles)
        figures.duration_s = motion.duration_s
    if not edits.new_path:
        return motion
    old = paths.extract_path(motion, skeleton, roles=roles)
    path = old if edits.stride is None else paths.scale_path(old, edits.stride)
    if edits.follow is not None:
        drawn = [_numbers(p, 2, "--follow") for p in edits.follow.replace(";", " ").split()]
        if len(drawn) < 2:
            raise ShapeError(f"--follow: expected two places or more such as '0,0 0,1 1,2', got '{edits.follow}'")
        path = paths.follow_points(path, np.array(drawn))
    if edits.moves:
        path = paths.move_path(path, _handles(edits.moves, motion.frame_count), edits.path_ease_s)
    if edits.bend_deg is not None:
        path = paths.bend_path(path, float(np.radians(edits.bend_deg)))
    if edits.loop:
        path = paths.close_path(path)
    if edits.turn_deg is not None:
        path = paths.turn_path(path, float(np.radians(edits.turn_deg)))
    done = paths.put_on_path(motion, skeleton, path, old=old, roles=roles)
    figures.path = done
    return done.motion


def _turned(motion: Motion, skeleton: Skeleton, roles: Mapping[str, int], text: str, edits: Edits) -> Motion:
    """The motion with a joint turned in one frame, and around it less and less."""
    from keypose.editing.falloff import edit_pose, with_joints
    from keypose.editing.reach import joint_of
    from keypose.math import quat

    found = _TURN.match(text)
    if found is None:
        raise ShapeError(f"--turn: expected JOINT@FRAME=X,Y,Z in degrees, got '{text}'")
    joint = joint_of(skeleton, found["joint"], roles)
    frame = int(found["first"])
    if frame >= motion.frame_count:
        raise ShapeError(f"--turn: expected a frame up to {motion.frame_count - 1}, got {frame}")
    vector = np.radians(_numbers(found["place"], 3, "--turn"))
    pose = motion.pose[frame]
    own = quat.multiply(np.asarray(pose.rotations[joint], np.float64), quat.from_rotation_vector(vector))
    turned = with_joints(pose, skeleton, {skeleton.names[joint]: own})
    return edit_pose(
        motion,
        skeleton,
        frame,
        turned,
        before_s=edits.ease_s,
        after_s=edits.ease_s,
        keep=edits.keep,
        roles=roles,
    ).motion


def _spacetime(
    motion: Motion,
    skeleton: Skeleton,
    roles: Mapping[str, int],
    reaches: Sequence[Reach],
    edits: Edits,
    figures: _Figures,
    progress: Progress,
) -> Motion:
    """All reaches at once, by the whole body, with what is to be kept where it is."""
    from keypose.editing.constraints import Constraint, Place, Turn, kept_in_place
    from keypose.editing.reach import KEPT, joint_of
    from keypose.editing.spacetime import solve_spacetime
    from keypose.evaluate import world_rotations_positions

    ease = max(4, round(edits.ease_s * motion.rate_hz))
    last = motion.frame_count - 1
    late = next((r for r in reaches if r.last > last), None)
    if late is not None:
        raise ShapeError(f"--reach: expected frames up to {last}, got {late.last}")
    window = (max(min(r.first for r in reaches) - ease, 0), min(max(r.last for r in reaches) + ease, last))
    places = np.asarray(world_rotations_positions(skeleton, motion.pose.broadcast())[1], np.float64)
    wanted: list[Constraint] = []
    for r in reaches:
        joint = joint_of(skeleton, r.joint, roles)
        wanted.append(Place(r.joint, r.frames, r.target if r.offset is None else places[r.frames, joint] + r.offset))
        if r.rotation is not None:
            wanted.append(Turn(r.joint, r.frames, r.rotation))
    span = np.arange(window[0], window[1] + 1)
    moved = {joint_of(skeleton, r.joint, roles) for r in reaches}
    keep = [joint_of(skeleton, k, roles) for k in edits.keep or [f for f in KEPT if f in roles]]
    wanted += kept_in_place(motion, skeleton, [skeleton.names[j] for j in keep if j not in moved], span)
    done = solve_spacetime(motion, skeleton, window, wanted, roles=roles, progress=progress)
    misses = zip(wanted, done.error, strict=True)
    figures.reached = [(c.joint, float(e.max())) for c, e in misses if isinstance(c, Place)]
    figures.converged = done.converged
    return done.motion


def _missed(joint: str, error_m: float) -> str:
    from keypose.editing.reach import REACHED_M

    said = "is where it should be" if error_m <= REACHED_M else "stays short of its place"
    return f"{joint} {said}: {1000 * error_m:.3g} mm at most"


def _reach(text: str) -> Reach:
    """``left_hand@40-60=0.3,1.4,0.2``: a place; with ``=+``: so far from where it is."""
    from keypose.editing.reach import Reach

    found = _REACH.match(text)
    if found is None:
        raise ShapeError(f"--reach: expected JOINT@FRAME=X,Y,Z or JOINT@FIRST-LAST=+X,Y,Z, got '{text}'")
    place = _numbers(found["place"], 3, "--reach")
    first = int(found["first"])
    last = int(found["last"] or first)
    if found["sign"]:
        return Reach(found["joint"], first, last, offset=place)
    return Reach(found["joint"], first, last, target=place)


def _handles(moves: Sequence[str], frame_count: int) -> dict[int, tuple[float, ...]]:
    """``60=0.3,0``: how far the way goes to the left and forwards in a frame."""
    handles: dict[int, tuple[float, ...]] = {}
    for text in moves:
        found = _MOVE.match(text)
        if found is None:
            raise ShapeError(f"--move-path: expected FRAME=X,Z, got '{text}'")
        frame = int(found["frame"])
        if frame >= frame_count:
            raise ShapeError(f"--move-path: expected a frame up to {frame_count - 1}, got {frame}")
        handles[frame] = _numbers(found["place"], 2, "--move-path")
    return handles


def _numbers(text: str, count: int, option: str) -> tuple[float, ...]:
    parts = text.split(",")
    try:
        values = tuple(float(p) for p in parts)
    except ValueError:
        values = ()
    if len(values) != count or not np.all(np.isfinite(values)):
        raise ShapeError(f"{option}: expected {count} numbers, got '{text}'")
    return values
