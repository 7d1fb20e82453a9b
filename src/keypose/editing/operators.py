"""The table of operators: what the studio offers and the command line runs, each with its parameters and their defaults."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from keypose.editing import arcs as _arcs
from keypose.editing import ease as _ease
from keypose.editing import euler as _euler
from keypose.editing import follow as _follow
from keypose.editing import moves as _moves
from keypose.editing import squash as _squash
from keypose.editing import stopmotion as _stopmotion
from keypose.editing import timing as _timing
from keypose.editing.selection import EVERYTHING, Selection, chosen_channels, with_curves
from keypose.errors import ShapeError, UnknownName
from keypose.math import ease, euler
from keypose.model import Channel, Clip, Curve, CurveKind, Property, Skeleton

ParameterType = Literal["number", "integer", "boolean", "choice", "joint", "text"]
Needs = Literal["keys", "spans", "joints", "channels", "time"]


@dataclass(frozen=True, slots=True)
class Parameter:
    """One setting of an operator.

    ``choices`` are the values of a ``choice``; ``minimum`` and ``maximum`` bound a ``number`` or an ``integer``; a ``joint`` is
    the name of one, empty for the operator's own choice. ``unit`` is for people: ``s``, ``frames``, ``Hz``, ``degrees``, ``m``.
    """

    name: str
    type: ParameterType
    default: float | int | bool | str
    description: str
    label: str = ""
    minimum: float | None = None
    maximum: float | None = None
    unit: str = ""
    choices: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Operated:
    """What an operator made of a clip, and what it has to say of it (empty where that is nothing)."""

    clip: Clip
    report: str = ""


Run = Callable[[Clip, Skeleton, Selection, Mapping[str, Any]], Operated]


@dataclass(frozen=True, slots=True)
class Operator:
    """An operation on the selection of a clip.

    ``needs`` is what a person selects for it: ``keys``, ``spans`` (two keys or the ones after single keys), ``joints``,
    ``channels``, or nothing but a ``time`` range.
    """

    name: str
    label: str
    description: str
    parameters: tuple[Parameter, ...]
    needs: Needs
    run: Run


def run_operator(
    name: str,
    clip: Clip,
    skeleton: Skeleton,
    selection: Selection = EVERYTHING,
    parameters: Mapping[str, Any] | None = None,
) -> Operated:
    """The clip after an operator, by its name, with parameters; those that are not given have their defaults.

    Raises: UnknownName for an operator, a parameter or a choice that does not exist; ShapeError for a value that is none or out of
    its range.
    """
    if name not in OPERATORS:
        raise UnknownName("operator", name, OPERATORS)
    operator = OPERATORS[name]
    return operator.run(clip, skeleton, selection, checked_parameters(operator, parameters or {}))


def checked_parameters(operator: Operator, given: Mapping[str, Any]) -> dict[str, Any]:
    """All parameters of an operator: those given, checked, and the defaults of the rest; raises as `run_operator` does."""
    known = {p.name: p for p in operator.parameters}
    for name in given:
        if name not in known:
            raise UnknownName(f"parameter of {operator.name}", name, known)
    return {name: _checked(operator, p, given[name]) if name in given else p.default for name, p in known.items()}


def _checked(operator: Operator, parameter: Parameter, value: Any) -> Any:
    label = f"{operator.name}: {parameter.name}"
    if parameter.type == "boolean":
        if not isinstance(value, bool):
            raise ShapeError(f"{label}: expected true or false, got {value!r}")
        return value
    if parameter.type in ("number", "integer"):
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
            raise ShapeError(f"{label}: expected a number, got {value!r}")
        if parameter.type == "integer" and value != round(value):
            raise ShapeError(f"{label}: expected a whole number, got {value!r}")
        low, high = parameter.minimum, parameter.maximum
        if (low is not None and value < low) or (high is not None and value > high):
            between = f"{'any' if low is None else f'{low:g}'} to {'any' if high is None else f'{high:g}'}"
            raise ShapeError(f"{label}: expected {between}, got {value:g}")
        return int(value) if parameter.type == "integer" else float(value)
    if not isinstance(value, str):
        raise ShapeError(f"{label}: expected text, got {value!r}")
    if parameter.type == "choice" and value not in parameter.choices:
        raise UnknownName(label, value, parameter.choices)
    return value


# --- the operators -----------------------------------------------------------------------------------------------------------


def _number(
    name: str, default: float, low: float | None, high: float | None, description: str, unit: str = ""
) -> Parameter:
    return Parameter(name, "number", default, description, name_label(name), low, high, unit)


def name_label(name: str) -> str:
    """A parameter's name for people: without the unit at its end."""
    stem, _, end = name.rpartition("_")
    return (stem if stem and end in ("s", "m", "hz", "deg") else name).replace("_", " ").capitalize()


def _run_ease(clip: Clip, skeleton: Skeleton, selection: Selection, p: Mapping[str, Any]) -> Operated:
    del skeleton
    made, error = _ease.ease_clip(clip, selection, p["easing"], p["tolerance"])
    return Operated(made, f"{_keys(clip, made)}; {_error(error)}")


def _run_slow(clip: Clip, skeleton: Skeleton, selection: Selection, p: Mapping[str, Any]) -> Operated:
    del skeleton
    return Operated(_ease.slow_clip(clip, selection, p["slow_in"], p["slow_out"]))


def _run_anticipate(clip: Clip, skeleton: Skeleton, selection: Selection, p: Mapping[str, Any]) -> Operated:
    del skeleton
    made = _moves.on_moves(clip, selection, lambda c, spans: _moves.anticipate(c, spans, p["amount"], p["lead_s"]))
    return Operated(made, _keys(clip, made))


def _run_overshoot(clip: Clip, skeleton: Skeleton, selection: Selection, p: Mapping[str, Any]) -> Operated:
    del skeleton
    made = _moves.overshoot_clip(clip, selection, p["amount"], p["frequency_hz"], p["damping"])
    return Operated(made, _keys(clip, made))


def _run_moving_hold(clip: Clip, skeleton: Skeleton, selection: Selection, p: Mapping[str, Any]) -> Operated:
    del skeleton
    return Operated(_moves.on_moves(clip, selection, lambda c, spans: _moves.moving_hold(c, spans, p["amount"])))


def _run_tween(clip: Clip, skeleton: Skeleton, selection: Selection, p: Mapping[str, Any]) -> Operated:
    del skeleton
    return Operated(_moves.tween_keys(clip, selection, p["favour"]))


def _run_breakdown(clip: Clip, skeleton: Skeleton, selection: Selection, p: Mapping[str, Any]) -> Operated:
    del skeleton
    made = _moves.breakdown_clip(clip, selection, p["time_s"], p["favour"])
    return Operated(made, _keys(clip, made))


def _run_squash(clip: Clip, skeleton: Skeleton, selection: Selection, p: Mapping[str, Any]) -> Operated:
    made = _squash.squash_and_stretch(clip, skeleton, selection, **p)
    changed = [
        c for c, curve in made.curves.items() if c.property is Property.SCALE and curve is not clip.curves.get(c)
    ]
    errors = [_squash.volume_error(made.curves[c], skeleton.rest.scales[skeleton.index(c.target)]) for c in changed]
    worst = max(errors, default=0.0)
    return Operated(made, f"{_keys(clip, made)}; the volume is kept to {worst:.1e}")


def _run_follow(clip: Clip, skeleton: Skeleton, selection: Selection, p: Mapping[str, Any]) -> Operated:
    made = _follow.follow_through(clip, skeleton, selection, **p)
    return Operated(made, _keys(clip, made))


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
    return Operated(made, _keys(clip, made))


def _run_constant_speed(clip: Clip, skeleton: Skeleton, selection: Selection, p: Mapping[str, Any]) -> Operated:
    del skeleton
    made: dict[Channel, Curve] = {}
    worst = 0.0
    for channel in chosen_channels(clip, selection):
        curve = clip.curves[channel]
        if curve.key_count < 2 or curve.kind is CurveKind.BOOLEAN:
            continue
        speed = _timing.constant_speed(curve, p["tolerance"])
        if speed.length > 0:
            made[channel], error = _timing.retimed(curve, speed.warp, max(p["tolerance"] * speed.length, 1e-6))
            worst = max(worst, error)
    result = with_curves(clip, made)
    return Operated(result, f"{_keys(clip, result)}; {_error(worst)}")


def _run_filter_euler(clip: Clip, skeleton: Skeleton, selection: Selection, p: Mapping[str, Any]) -> Operated:
    del skeleton, p
    return Operated(_euler.filter_euler(clip, selection))


def _run_reorder(clip: Clip, skeleton: Skeleton, selection: Selection, p: Mapping[str, Any]) -> Operated:
    del skeleton
    order: str = p["order"]
    orders = {c.target: order for c in chosen_channels(clip, selection) if c.property is Property.EULER}
    made, error = _euler.reorder_euler(clip, orders, every_frame=p["every_frame"])
    return Operated(made, f"{_keys(clip, made)}; largest error between keys {math.degrees(error):.3f} degrees")


def _keys(before: Clip, after: Clip) -> str:
    counts = [sum(curve.key_count for curve in clip.curves.values()) for clip in (before, after)]
    return f"{counts[0]} keys before, {counts[1]} after"


def _error(error: float) -> str:
    return "exact" if error == 0 else f"largest error {error:.2g}"


_TOLERANCE = _number("tolerance", 1e-3, 1e-6, 0.1, "Largest error, as a share of the change, where it cannot be exact.")
_AMOUNT_OF_MOVE = "As a share of the move."

_ALL = (
    Operator(
        "ease",
        "Ease",
        "Lets each span go by an easing of the catalogue.",
        (
            Parameter("easing", "choice", "sine_in_out", "How it starts and stops.", "Easing", choices=ease.names()),
            _TOLERANCE,
        ),
        "spans",
        _run_ease,
    ),
    Operator(
        "slow_in_out",
        "Slow in, slow out",
        "Slows down into the selected keys and starts slowly from them.",
        (
            _number("slow_in", 1.0, 0.0, 1.0, "1 comes to a stop at the key, 0 leaves the arrival as it is."),
            _number("slow_out", 1.0, 0.0, 1.0, "1 starts from rest at the key, 0 leaves the start as it is."),
        ),
        "keys",
        _run_slow,
    ),
    Operator(
        "anticipation",
        "Anticipation",
        "Moves the other way first, before each selected move.",
        (
            _number("amount", 0.15, 0.0, 1.0, "How far back. " + _AMOUNT_OF_MOVE),
            _number("lead_s", 0.2, 0.02, 2.0, "How long it takes, out of the time of the move.", "s"),
        ),
        "spans",
        _run_anticipate,
    ),
    Operator(
        "overshoot",
        "Overshoot and settle",
        "Goes past the end of each selected move and swings until it rests, where a hold follows.",
        (
            _number("amount", 0.12, 0.0, 1.0, "How far beyond. " + _AMOUNT_OF_MOVE),
            _number("frequency_hz", 2.5, 0.2, 20.0, "How fast it swings.", "Hz"),
            _number("damping", 0.35, 0.05, 0.95, "How soon it rests: 0.05 swings for long, 0.95 hardly swings."),
        ),
        "spans",
        _run_overshoot,
    ),
    Operator(
        "moving_hold",
        "Moving hold",
        "Lets held poses drift on a little, so that they stay alive.",
        (_number("amount", 0.04, 0.0, 0.5, "How far. " + _AMOUNT_OF_MOVE),),
        "spans",
        _run_moving_hold,
    ),
    Operator(
        "tween",
        "Tween selected keys",
        "Moves the selected keys between the keys before and after them.",
        (_number("favour", 0.5, -0.5, 1.5, "0 is the pose before, 1 the pose after; beyond, it exaggerates."),),
        "keys",
        _run_tween,
    ),
    Operator(
        "breakdown",
        "Breakdown",
        "Adds a key between two others, nearer to the one or the other.",
        (
            _number("time_s", 0.0, None, None, "When.", "s"),
            _number("favour", 0.5, -0.5, 1.5, "0 is the pose before, 1 the pose after; beyond, it exaggerates."),
        ),
        "channels",
        _run_breakdown,
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
            _number("stretch", 0.25, 0.0, 1.0, "Logarithm of the length at the highest speed."),
            _number("squash", 0.4, 0.0, 1.5, "Logarithm of the flatness at the hardest contact."),
            _number("contact_s", 0.06, 0.0, 0.5, "How long it is flat before and after a touch.", "s"),
        ),
        "joints",
        _run_squash,
    ),
    Operator(
        "follow_through",
        "Follow through",
        "Lets the selected joints drag behind the body and swing, as on springs.",
        (
            _number("drag", 0.7, 0.0, 1.0, "How much of it is seen."),
            _number("frequency_hz", 2.0, 0.2, 20.0, "How stiff: the swings in a second.", "Hz"),
            _number("damping", 0.3, 0.02, 2.0, "How soon it rests; 1 does not swing."),
            _number("loosen", 0.85, 0.1, 1.0, "How much looser each joint is than the one above."),
            _number("settle_s", 1.0, 0.0, 10.0, "How long it may go on after the end.", "s"),
        ),
        "joints",
        _run_follow,
    ),
    Operator(
        "overlap",
        "Overlap",
        "Delays each selected joint after the selected joint above it.",
        (_number("delay_s", 0.08, -2.0, 2.0, "How much later each joint is.", "s"),),
        "joints",
        _run_overlap,
    ),
    Operator(
        "arcs",
        "Arcs",
        "Rounds the paths of the selected joints; keys stay.",
        (
            _number("amount", 1.0, 0.0, 1.0, "0 leaves positions as they are, 1 is round."),
            _number("bow", 0.0, -1.0, 1.0, "Lifts each move off its straight line, as a share of its length."),
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
            _number("rate_hz", 0.0, 0.0, 240.0, "Frames in a second; 0 for the clip's own.", "Hz"),
            _number("jitter_deg", 0.4, 0.0, 30.0, "How much each joint is off in a pose.", "degrees"),
            _number("jitter_m", 0.0, 0.0, 0.2, "How much positions are off.", "m"),
            Parameter("seed", "integer", 1, "Another number, another film.", "Seed", 0, 1_000_000),
        ),
        "channels",
        _run_stop_motion,
    ),
    Operator(
        "constant_speed",
        "Constant speed",
        "Goes through the same values at one speed from the first key to the last.",
        (_TOLERANCE,),
        "channels",
        _run_constant_speed,
    ),
    Operator(
        "filter_euler",
        "Euler filter",
        "Takes whole turns and flips out of Euler angles; rotations at keys stay.",
        (),
        "channels",
        _run_filter_euler,
    ),
    Operator(
        "reorder_euler",
        "Euler order",
        "Gives the selected joints another order of Euler angles and the same motion.",
        (
            Parameter("order", "choice", "XYZ", "The new order.", "Order", choices=euler.CONVENTIONS[:6]),
            Parameter("every_frame", "boolean", True, "A key on every frame: exact there.", "Every frame"),
        ),
        "joints",
        _run_reorder,
    ),
)

OPERATORS: Mapping[str, Operator] = {operator.name: operator for operator in _ALL}
"""All operators by name, in the order in which they are offered."""
