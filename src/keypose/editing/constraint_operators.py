"""Operators of the table that edit with constraints: reach, bend the path, change a pose with fall-off, solve a window."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from keypose.editing.constraints import Constraint, Place, kept_in_place
from keypose.editing.falloff import FALL_OFFS, edit_pose, with_joints
from keypose.editing.framed import clip_rate, edit_frames, nearest_frame, selected_frames
from keypose.editing.operator_types import Operated, Operator, Parameter, number
from keypose.editing.paths import bend_path, close_path, extract_path, put_on_path, stretch_path
from keypose.editing.reach import KEPT, REACHED_M, Reach, found_roles, joint_of, reach
from keypose.editing.selection import Selection, chosen_channels, chosen_joints
from keypose.editing.spacetime import solve_spacetime
from keypose.errors import ShapeError, UnknownName
from keypose.evaluate import world_rotations_positions
from keypose.math import quat
from keypose.model import Clip, Motion, Skeleton


def _frames(clip: Clip, selection: Selection, p: Mapping[str, Any]) -> tuple[int, int]:
    """First and last frame, counted from the clip's first key: of the keys or the time selected, else as the parameters say."""
    found = selected_frames(clip, selection)
    if found is not None:
        return found
    # Frames of the parameters are those of the time line.
    rate, first = clip_rate(clip), p["first_frame"]
    return nearest_frame(clip, first / rate), nearest_frame(clip, max(first, p["last_frame"]) / rate)


def _joint(clip: Clip, skeleton: Skeleton, selection: Selection, name: str) -> str:
    """The joint that is named, else the first that is selected."""
    if name:
        return skeleton.names[joint_of(skeleton, name, found_roles(skeleton))]
    chosen = chosen_joints(clip, selection, skeleton.names)
    if not chosen:
        raise UnknownName("joint with keys", "", skeleton.names)
    return chosen[0]


def _nothing(clip: Clip, selection: Selection) -> bool:
    return not chosen_channels(clip, selection)


def _run_reach(clip: Clip, skeleton: Skeleton, selection: Selection, p: Mapping[str, Any]) -> Operated:
    if _nothing(clip, selection):
        return Operated(clip)
    first, last = _frames(clip, selection, p)
    joint = _joint(clip, skeleton, selection, p["joint"])
    wanted = Reach(joint, first, last, offset=(p["x_m"], p["y_m"], p["z_m"]), keep_rotation=p["keep_rotation"])
    said: list[str] = []

    def change(motion: Motion) -> Motion:
        done = reach(motion, skeleton, [wanted], ease_s=p["ease_s"])
        said.append(f"{joint} {_missed(float(done.error_m[0].max()))}, {int(done.changed.sum())} frames changed")
        return done.motion

    return Operated(edit_frames(clip, skeleton, change), said[0])


def _missed(error: float) -> str:
    return "is there" if error <= REACHED_M else f"stays {1000 * error:.1f} mm away"


def _run_bend_path(clip: Clip, skeleton: Skeleton, selection: Selection, p: Mapping[str, Any]) -> Operated:
    if _nothing(clip, selection):
        return Operated(clip)
    said: list[str] = []
    chosen = None if p["close"] else selected_frames(clip, selection)  # a loop is closed as a whole

    def change(motion: Motion) -> Motion:
        roles = found_roles(skeleton)
        old = extract_path(motion, skeleton, roles=roles)
        first, last = (0, motion.frame_count - 1) if chosen is None else chosen
        way = old.lengths_m
        if way[last] - way[first] < 0.05:
            said.append("it stays where it is: there is no path to bend")
            return motion
        path = stretch_path(old, p["stride"], first, last)
        path = close_path(path) if p["close"] else bend_path(path, np.radians(p["angle_deg"]), first, last)
        done = put_on_path(motion, skeleton, path, old=old, roles=roles, plant=p["plant"])
        said.append(f"{path.lengths_m[-1]:.2f} m, turning by {np.degrees(path.turning_rad):.0f}°")
        return done.motion

    return Operated(edit_frames(clip, skeleton, change), said[0])


def _run_pose(clip: Clip, skeleton: Skeleton, selection: Selection, p: Mapping[str, Any]) -> Operated:
    if _nothing(clip, selection):
        return Operated(clip)
    frame = _frames(clip, selection, {**p, "last_frame": p["first_frame"]})[0]
    joint = _joint(clip, skeleton, selection, p["joint"])
    turn = np.radians([p["x_deg"], p["y_deg"], p["z_deg"]])
    said: list[str] = []

    def change(motion: Motion) -> Motion:
        roles = found_roles(skeleton)
        pose = motion.pose[frame]
        own = np.asarray(pose.rotations[skeleton.index(joint)], np.float64)
        turned = with_joints(pose, skeleton, {joint: quat.multiply(own, quat.from_rotation_vector(turn))})
        keep = [f for f in KEPT if f in roles] if p["keep_feet"] else []
        done = edit_pose(
            motion,
            skeleton,
            frame,
            turned,
            before_s=p["before_s"],
            after_s=p["after_s"],
            shape=p["fall_off"],
            keep=keep,
            roles=roles,
        )
        said.append(f"{int(np.count_nonzero(done.weights))} frames changed")
        return done.motion

    return Operated(edit_frames(clip, skeleton, change), said[0])


def _run_spacetime(clip: Clip, skeleton: Skeleton, selection: Selection, p: Mapping[str, Any]) -> Operated:
    if _nothing(clip, selection):
        return Operated(clip)
    first, last = _frames(clip, selection, p)
    joint = _joint(clip, skeleton, selection, p["joint"])
    said: list[str] = []

    def change(motion: Motion) -> Motion:
        roles = found_roles(skeleton)
        around = max(4, round(p["ease_s"] * motion.rate_hz))
        window = (max(first - around, 0), min(last + around, motion.frame_count - 1))
        if window[1] - window[0] < 4:
            raise ShapeError(f"spacetime: expected a window of 4 frames or more, got {window[1] - window[0]}")
        span = np.arange(window[0], window[1] + 1)
        places = np.asarray(world_rotations_positions(skeleton, motion.pose[window[0] : window[1] + 1])[1], np.float64)
        at = np.arange(first, last + 1)
        number = skeleton.index(joint)
        wanted: list[Constraint] = [Place(joint, at, places[at - window[0], number] + (p["x_m"], p["y_m"], p["z_m"]))]
        if p["keep_feet"]:
            feet = [roles[f] for f in KEPT if f in roles and roles[f] != number]
            wanted += kept_in_place(motion, skeleton, [skeleton.names[f] for f in feet], span)
        done = solve_spacetime(motion, skeleton, window, wanted, roles=roles)
        rest = "" if done.converged else "; not at rest yet"
        said.append(f"{joint} {_missed(float(done.error[0].max()))} after {len(done.costs) - 1} last steps{rest}")
        return done.motion

    return Operated(edit_frames(clip, skeleton, change), said[0])


_FIRST = Parameter(
    "first_frame",
    "integer",
    0,
    "From this frame on; selected keys say it themselves.",
    "First frame",
    0,
    10_000_000,
    "frames",
)
_LAST = Parameter(
    "last_frame",
    "integer",
    0,
    "To this frame; the first one alone where it is before it.",
    "Last frame",
    0,
    10_000_000,
    "frames",
)
_JOINT = Parameter("joint", "joint", "", "What moves; empty for the first selected.", "Joint")


def _offset() -> tuple[Parameter, ...]:
    return tuple(
        number(f"{axis}_m", 0.1 if axis == "y" else 0.0, -100.0, 100.0, f"How far it goes {way}.", "m")
        for axis, way in (("x", "to the left"), ("y", "up"), ("z", "forwards"))
    )


CONSTRAINT_OPERATORS: tuple[Operator, ...] = (
    Operator(
        "reach",
        "Reach",
        "Puts a hand, a foot or any joint somewhere else in some frames; the motion around them gives way smoothly.",
        (
            _JOINT,
            *_offset(),
            _FIRST,
            _LAST,
            number("ease_s", 0.4, 0.0, 60.0, "How long it takes to get there and back.", "s"),
            Parameter("keep_rotation", "boolean", True, "Hands and feet stay turned as they are.", "Keep rotation"),
        ),
        "joints",
        _run_reach,
    ),
    Operator(
        "bend_path",
        "Bend path",
        "Bends the way over the ground; steps go along, and feet that stand do not slide.",
        (
            number(
                "angle_deg", 90.0, -3600.0, 3600.0, "How much more it turns, to the left where positive.", "degrees"
            ),
            number("stride", 1.0, 0.05, 20.0, "How much longer steps are."),
            Parameter("close", "boolean", False, "Ends where it begins, whatever the angle.", "Close to a loop"),
            Parameter("plant", "boolean", True, "Holds feet where they touch the ground.", "Plant feet"),
        ),
        "time",
        _run_bend_path,
    ),
    Operator(
        "pose_fall_off",
        "Pose with fall-off",
        "Turns a joint in one frame, and less and less in the frames around it.",
        (
            _JOINT,
            *(
                number(
                    f"{axis}_deg", 20.0 if axis == "x" else 0.0, -360.0, 360.0, f"Turn about its own {axis}.", "degrees"
                )
                for axis in "xyz"
            ),
            _FIRST,
            number("before_s", 0.5, 0.0, 600.0, "How long before the frame it begins.", "s"),
            number("after_s", 0.5, 0.0, 600.0, "How long after the frame it ends.", "s"),
            Parameter("fall_off", "choice", "smooth", "How it fades.", "Fall-off", choices=FALL_OFFS),
            Parameter("keep_feet", "boolean", False, "Feet stay where they are.", "Keep feet"),
        ),
        "joints",
        _run_pose,
    ),
    Operator(
        "spacetime",
        "Space-time",
        "Moves a joint as Reach does, with the whole body, and changes the motion as little as it can.",
        (
            _JOINT,
            *_offset(),
            _FIRST,
            _LAST,
            number("ease_s", 0.6, 0.1, 60.0, "How long before and after the motion may change.", "s"),
            Parameter("keep_feet", "boolean", True, "Feet stay where they are.", "Keep feet"),
        ),
        "joints",
        _run_spacetime,
    ),
)
