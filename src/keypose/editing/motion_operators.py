"""The classical operators of the table: how a move begins, ends, drags, bends and deforms."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from keypose.analysis.ground import GROUND_KINDS
from keypose.editing import arcs as _arcs
from keypose.editing import follow as _follow
from keypose.editing import moves as _moves
from keypose.editing import planting as _planting
from keypose.editing import squash as _squash
from keypose.editing import stopmotion as _stopmotion
from keypose.editing.framed import edit_frames, only_between, selected_frames
from keypose.editing.operator_types import Operated, Operator, Parameter, count_keys, number
from keypose.editing.reach import found_roles
from keypose.editing.selection import Selection, chosen_channels
from keypose.model import Clip, Motion, Property, Skeleton


def _run_anticipate(clip: Clip, skeleton: Skeleton, selection: Selection, p: Mapping[str, Any]) -> Operated:
    del skeleton
    made = _moves.on_moves(clip, selection, lambda c, spans: _moves.anticipate(c, spans, p["amount"], p["lead_s"]))
    return Operated(made, count_keys(clip, made))


def _run_overshoot(clip: Clip, skeleton: Skeleton, selection: Selection, p: Mapping[str, Any]) -> Operated:
    del skeleton
    made = _moves.overshoot_clip(clip, selection, p["amount"], p["frequency_hz"], p["damping"])
    return Operated(made, count_keys(clip, made))


def _run_moving_hold(clip: Clip, skeleton: Skeleton, selection: Selection, p: Mapping[str, Any]) -> Operated:
    del skeleton
    return Operated(_moves.on_moves(clip, selection, lambda c, spans: _moves.moving_hold(c, spans, p["amount"])))


def _run_squash(clip: Clip, skeleton: Skeleton, selection: Selection, p: Mapping[str, Any]) -> Operated:
    made = _squash.squash_and_stretch(clip, skeleton, selection, **p)
    changed = [
        c for c, curve in made.curves.items() if c.property is Property.SCALE and curve is not clip.curves.get(c)
    ]
    errors = [_squash.volume_error(made.curves[c], skeleton.rest.scales[skeleton.index(c.target)]) for c in changed]
    worst = max(errors, default=0.0)
    return Operated(made, f"{count_keys(clip, made)}; the volume is kept to {worst:.1e}")


def _run_follow(clip: Clip, skeleton: Skeleton, selection: Selection, p: Mapping[str, Any]) -> Operated:
    made = _follow.follow_through(clip, skeleton, selection, **p)
    return Operated(made, count_keys(clip, made))


def _run_overlap(clip: Clip, skeleton: Skeleton, selection: Selection, p: Mapping[str, Any]) -> Operated:
    return Operated(_follow.overlap(clip, skeleton, selection, p["delay_s"]))


def _run_arcs(clip: Clip, skeleton: Skeleton, selection: Selection, p: Mapping[str, Any]) -> Operated:
    return Operated(_arcs.arcs(clip, skeleton, selection, **p))


def _run_stop_motion(clip: Clip, skeleton: Skeleton, selection: Selection, p: Mapping[str, Any]) -> Operated:
    del skeleton
    made = _stopmotion.stop_motion(
        clip,
        selection,
        p["hold_frames"],
        p["rate_hz"] or clip.rate_hz or 25.0,
        p["jitter_deg"],
        p["jitter_m"],
        p["seed"],
    )
    return Operated(made, count_keys(clip, made))


def _run_plant_feet(clip: Clip, skeleton: Skeleton, selection: Selection, p: Mapping[str, Any]) -> Operated:
    if not chosen_channels(clip, selection):
        return Operated(clip)
    roles = found_roles(skeleton)
    if not roles:
        return Operated(clip, "no legs were found: nothing to plant")
    options = _planting.PlantOptions(
        p["height_m"], p["speed_m_s"], p["ground"], level_feet=p["level_feet"], hips=p["hips"], loop=p["loop"]
    )
    said: list[str] = []
    chosen = selected_frames(clip, selection)

    def change(motion: Motion) -> Motion:
        done = _planting.plant_feet(motion, skeleton, roles, options=options)
        share = float(np.mean(np.any(list(done.touching.values()), axis=0)))
        said.append(
            f"a foot stands in {share:.0%} of the frames; feet moved {100 * done.moved_m.max(initial=0.0):.1f} cm at most, "
            f"hips {100 * done.hips_m.max(initial=0.0):.1f} cm; ground: {done.footing.ground.describe()}"
        )
        return done.motion if chosen is None else only_between(motion, done.motion, *chosen, options.blend_s)

    return Operated(edit_frames(clip, skeleton, change), said[0])


_AMOUNT_OF_MOVE = "As a share of the move."

MOTION_OPERATORS: tuple[Operator, ...] = (
    Operator(
        "anticipation",
        "Anticipation",
        "Moves the other way first, before each selected move.",
        (
            number("amount", 0.15, 0.0, 1.0, "How far back. " + _AMOUNT_OF_MOVE),
            number("lead_s", 0.2, 0.02, 2.0, "How long it takes, out of the time of the move.", "s"),
        ),
        "spans",
        _run_anticipate,
    ),
    Operator(
        "overshoot",
        "Overshoot and settle",
        "Goes past the end of each selected move and swings until it rests, where a hold follows.",
        (
            number("amount", 0.12, 0.0, 1.0, "How far beyond. " + _AMOUNT_OF_MOVE),
            number("frequency_hz", 2.5, 0.2, 20.0, "How fast it swings.", "Hz"),
            number("damping", 0.35, 0.05, 0.95, "How soon it rests: 0.05 swings for long, 0.95 hardly swings."),
        ),
        "spans",
        _run_overshoot,
    ),
    Operator(
        "moving_hold",
        "Moving hold",
        "Lets held poses drift on a little, so that they stay alive.",
        (number("amount", 0.04, 0.0, 0.5, "How far. " + _AMOUNT_OF_MOVE),),
        "spans",
        _run_moving_hold,
    ),
    Operator(
        "squash_and_stretch",
        "Squash and stretch",
        "Stretches along the motion where it is fast, squashes where it is turned back; the volume stays.",
        (
            Parameter("joint", "joint", "", "Whose path is looked at; empty for the first selected.", "Moving joint"),
            Parameter(
                "scale_joint", "joint", "", "What is scaled; empty for Squash below it, or itself.", "Scaled joint"
            ),
            Parameter("level_joint", "joint", "", "What turns back; empty for Level below that.", "Levelling joint"),
            number("stretch", 0.25, 0.0, 1.0, "Logarithm of the length at the highest speed."),
            number("squash", 0.4, 0.0, 1.5, "Logarithm of the flatness at the hardest contact."),
            number("contact_s", 0.06, 0.0, 0.5, "How long it is flat before and after a touch.", "s"),
        ),
        "joints",
        _run_squash,
    ),
    Operator(
        "follow_through",
        "Follow through",
        "Lets the selected joints drag behind the body and swing, as on springs.",
        (
            number("drag", 0.7, 0.0, 1.0, "How much of it is seen."),
            number("frequency_hz", 2.0, 0.2, 20.0, "How stiff: the swings in a second.", "Hz"),
            number("damping", 0.3, 0.02, 2.0, "How soon it rests; 1 does not swing."),
            number("loosen", 0.85, 0.1, 1.0, "How much looser each joint is than the one above."),
            number("settle_s", 1.0, 0.0, 10.0, "How long it may go on after the end.", "s"),
        ),
        "joints",
        _run_follow,
    ),
    Operator(
        "overlap",
        "Overlap",
        "Delays each selected joint after the selected joint above it.",
        (number("delay_s", 0.08, -2.0, 2.0, "How much later each joint is.", "s"),),
        "joints",
        _run_overlap,
    ),
    Operator(
        "arcs",
        "Arcs",
        "Rounds the paths of the selected joints; keys stay.",
        (
            number("amount", 1.0, 0.0, 1.0, "0 leaves positions as they are, 1 is round."),
            number("bow", 0.0, -1.0, 1.0, "Lifts each move off its straight line, as a share of its length."),
            Parameter(
                "rotations",
                "choice",
                "squad",
                "The curve that rotations get.",
                "Rotations",
                choices=tuple(_arcs.ROTATION_CURVES),
            ),
            Parameter("whole_chain", "boolean", True, "Also all joints above the selected ones.", "Whole chain"),
        ),
        "joints",
        _run_arcs,
    ),
    Operator(
        "stop_motion",
        "Stop motion",
        "Holds a pose for one, two, three frames, none of them quite exact.",
        (
            Parameter("hold_frames", "integer", 2, "On ones, twos, threes ...", "Hold", 1, 24, "frames"),
            number("rate_hz", 0.0, 0.0, 240.0, "Frames in a second; 0 for the clip's own.", "Hz"),
            number("jitter_deg", 0.4, 0.0, 30.0, "How much each joint is off in a pose.", "degrees"),
            number("jitter_m", 0.0, 0.0, 0.2, "How much positions are off.", "m"),
            Parameter("seed", "integer", 1, "Another number, another film.", "Seed", 0, 1_000_000),
        ),
        "channels",
        _run_stop_motion,
    ),
    Operator(
        "plant_feet",
        "Plant feet",
        "Holds feet still where they touch the ground, without a jump of a knee; a second time it changes nothing.",
        (
            number("height_m", 0.03, 0.001, 0.3, "How low a foot is in contact, for a leg of 0.85 m.", "m"),
            number("speed_m_s", 0.25, 0.01, 3.0, "How slow a foot is in contact, in metres a second."),
            Parameter("ground", "choice", "auto", "What feet stand on.", "Ground", choices=GROUND_KINDS),
            Parameter("level_feet", "boolean", True, "Lays feet flat on the ground.", "Level feet"),
            Parameter(
                "hips",
                "choice",
                "free",
                "Whether hips may come along.",
                "Hips",
                choices=("free", "upright", "still"),
            ),
            Parameter("loop", "boolean", False, "The last frame is the first, and stays so.", "Loop"),
        ),
        "channels",
        _run_plant_feet,
    ),
)
