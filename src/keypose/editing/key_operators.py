"""The operators of the table that work on keys, curves and channels."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from keypose.editing import channels as _channels
from keypose.editing import ease as _ease
from keypose.editing import euler as _euler
from keypose.editing import filters as _filters
from keypose.editing import keys as _keys
from keypose.editing import modes as _modes
from keypose.editing import moves as _moves
from keypose.editing import simplify as _simplify
from keypose.editing import timing as _timing
from keypose.editing.operator_types import Operated, Operator, Parameter, count_keys, number, state_error
from keypose.editing.selection import Selection, chosen_channels, chosen_keys, edited, with_curves
from keypose.math import ease, euler
from keypose.model import Channel, Clip, Curve, CurveKind, Property, Skeleton


def _run_ease(clip: Clip, skeleton: Skeleton, selection: Selection, p: Mapping[str, Any]) -> Operated:
    del skeleton
    made, error = _ease.ease_clip(clip, selection, p["easing"], p["tolerance"])
    return Operated(made, f"{count_keys(clip, made)}; {state_error(error)}")


def _run_slow(clip: Clip, skeleton: Skeleton, selection: Selection, p: Mapping[str, Any]) -> Operated:
    del skeleton
    return Operated(_ease.slow_clip(clip, selection, p["slow_in"], p["slow_out"]))


def _run_tween(clip: Clip, skeleton: Skeleton, selection: Selection, p: Mapping[str, Any]) -> Operated:
    del skeleton
    return Operated(_moves.tween_keys(clip, selection, p["favour"]))


def _run_breakdown(clip: Clip, skeleton: Skeleton, selection: Selection, p: Mapping[str, Any]) -> Operated:
    del skeleton
    made = _moves.breakdown_clip(clip, selection, p["time_s"], p["favour"])
    return Operated(made, count_keys(clip, made))


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
    return Operated(result, f"{count_keys(clip, result)}; {state_error(worst)}")


def _run_smooth(clip: Clip, skeleton: Skeleton, selection: Selection, p: Mapping[str, Any]) -> Operated:
    del skeleton
    method: Any = p["method"]

    def change(channel: Channel, curve: Curve) -> Curve:
        keys = chosen_keys(channel, curve, selection)
        return (
            _filters.smooth_keys(curve, p["width_s"], keys, method=method, amount=p["amount"]) if len(keys) else curve
        )

    return Operated(edited(clip, selection, change))


def _run_simplify(clip: Clip, skeleton: Skeleton, selection: Selection, p: Mapping[str, Any]) -> Operated:
    chosen = chosen_channels(clip, selection)
    if not chosen:
        return Operated(clip)
    part = replace(clip, curves={c: clip.curves[c] for c in chosen})
    found = _simplify.simplify(part, skeleton, p["tolerance_mm"] / 1000.0, rate_hz=p["rate_hz"] or None)
    kept = {c: curve for c, curve in clip.curves.items() if c not in part.curves}
    made = with_curves(replace(clip, curves=kept), found.clip.curves)
    kept_to = "" if found.holds else ", more than was asked"
    return Operated(made, f"{count_keys(clip, made)}; the body within {1000 * found.error_m:.2f} mm{kept_to}")


def _run_resample(clip: Clip, skeleton: Skeleton, selection: Selection, p: Mapping[str, Any]) -> Operated:
    del skeleton
    rate = p["rate_hz"] or clip.rate_hz or 25.0
    made: dict[Channel, Curve] = {}
    worst = 0.0
    for channel in chosen_channels(clip, selection):
        curve = clip.curves[channel]
        low, high = float(curve.times_s[0]), float(curve.times_s[-1])
        low = low if selection.start_s is None else max(low, selection.start_s)
        high = high if selection.end_s is None else min(high, selection.end_s)
        if high > low:
            keyed = _modes.resample_keys(curve, rate, low, high)
            made[channel], worst = keyed.curve, max(worst, keyed.error)
    result = with_curves(clip, made)
    return Operated(result, f"{count_keys(clip, result)}; {state_error(worst)}")


def _run_reverse(clip: Clip, skeleton: Skeleton, selection: Selection, p: Mapping[str, Any]) -> Operated:
    del skeleton, p
    worst = 0.0

    def change(channel: Channel, curve: Curve) -> Curve:
        nonlocal worst
        keys = chosen_keys(channel, curve, selection)
        if len(keys) < 2:
            return curve
        keyed = _keys.reverse_keys(curve, keys)
        worst = max(worst, keyed.error)
        return keyed.curve

    result = edited(clip, selection, change)
    return Operated(result, f"{state_error(worst)}")


def _run_separate(clip: Clip, skeleton: Skeleton, selection: Selection, p: Mapping[str, Any]) -> Operated:
    del skeleton, p
    for channel in chosen_channels(clip, selection):
        if channel.component is None and channel.property in _APART:
            clip = _channels.separate_components(clip, channel.target, channel.property)
    return Operated(clip)


def _run_join(clip: Clip, skeleton: Skeleton, selection: Selection, p: Mapping[str, Any]) -> Operated:
    del p
    worst = 0.0
    apart = [c for c in chosen_channels(clip, selection) if c.component is not None]
    for target, property in dict.fromkeys((c.target, c.property) for c in apart):
        clip, error = _channels.join_components(clip, skeleton, target, property)
        worst = max(worst, error)
    return Operated(clip, state_error(worst) if apart else "")


def _run_to_euler(clip: Clip, skeleton: Skeleton, selection: Selection, p: Mapping[str, Any]) -> Operated:
    worst = 0.0
    made = clip
    for channel in chosen_channels(clip, selection):
        if channel.property is Property.ROTATION:
            made, error = _channels.to_euler(
                made, skeleton, channel.target, p["order"], None if p["every_frame"] else 0.0
            )
            worst = max(worst, error)
    return Operated(made, f"{count_keys(clip, made)}; largest error {math.degrees(worst):.3f} degrees")


def _run_to_rotations(clip: Clip, skeleton: Skeleton, selection: Selection, p: Mapping[str, Any]) -> Operated:
    worst = 0.0
    made = clip
    joints = dict.fromkeys(c.target for c in chosen_channels(clip, selection) if c.property is Property.EULER)
    for joint in joints:
        made, error = _channels.to_rotations(made, skeleton, joint, math.radians(p["tolerance_deg"]))
        worst = max(worst, error)
    return Operated(made, f"{count_keys(clip, made)}; largest error {math.degrees(worst):.3f} degrees")


def _run_filter_euler(clip: Clip, skeleton: Skeleton, selection: Selection, p: Mapping[str, Any]) -> Operated:
    del skeleton, p
    return Operated(_euler.filter_euler(clip, selection))


def _run_reorder(clip: Clip, skeleton: Skeleton, selection: Selection, p: Mapping[str, Any]) -> Operated:
    del skeleton
    order: str = p["order"]
    orders = {c.target: order for c in chosen_channels(clip, selection) if c.property is Property.EULER}
    made, error = _euler.reorder_euler(clip, orders, every_frame=p["every_frame"])
    return Operated(made, f"{count_keys(clip, made)}; largest error between keys {math.degrees(error):.3f} degrees")


_APART = (Property.TRANSLATION, Property.SCALE, Property.EULER)
_TOLERANCE = number("tolerance", 1e-3, 1e-6, 0.1, "Largest error, as a share of the change, where it cannot be exact.")

KEY_OPERATORS: tuple[Operator, ...] = (
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
            number("slow_in", 1.0, 0.0, 1.0, "1 comes to a stop at the key, 0 leaves the arrival as it is."),
            number("slow_out", 1.0, 0.0, 1.0, "1 starts from rest at the key, 0 leaves the start as it is."),
        ),
        "keys",
        _run_slow,
    ),
    Operator(
        "tween",
        "Tween selected keys",
        "Moves the selected keys between the keys before and after them.",
        (number("favour", 0.5, -0.5, 1.5, "0 is the pose before, 1 the pose after; beyond, it exaggerates."),),
        "keys",
        _run_tween,
    ),
    Operator(
        "breakdown",
        "Breakdown",
        "Adds a key between two others, nearer to the one or the other.",
        (
            number("time_s", 0.0, None, None, "When.", "s"),
            number("favour", 0.5, -0.5, 1.5, "0 is the pose before, 1 the pose after; beyond, it exaggerates."),
        ),
        "channels",
        _run_breakdown,
    ),
    Operator(
        "smooth",
        "Smooth keys",
        "Takes trembling out of the selected keys; their times stay, and so do the first and the last.",
        (
            number("width_s", 0.08, 0.005, 2.0, "How long a tremble it takes out.", "s"),
            Parameter(
                "method",
                "choice",
                "gaussian",
                "Gaussian is the gentler; Butterworth keeps slow movement better.",
                "Method",
                choices=("gaussian", "butterworth"),
            ),
            number("amount", 1.0, 0.0, 1.0, "0 leaves the keys, 1 puts them on the smooth curve."),
        ),
        "keys",
        _run_smooth,
    ),
    Operator(
        "simplify",
        "Simplify",
        "Leaves as few keys as keep the body where it is.",
        (
            number(
                "tolerance_mm", 1.0, 0.001, 1000.0, "How far any point of the body may be moved, at any frame.", "mm"
            ),
            number("rate_hz", 0.0, 0.0, 1000.0, "Frames in a second; 0 for the clip's own.", "Hz"),
        ),
        "channels",
        _run_simplify,
    ),
    Operator(
        "resample",
        "Key every frame",
        "Puts a key on every frame of a rate.",
        (number("rate_hz", 0.0, 0.0, 1000.0, "Frames in a second; 0 for the clip's own.", "Hz"),),
        "channels",
        _run_resample,
    ),
    Operator("reverse", "Reverse", "Turns the selected keys round in time.", (), "keys", _run_reverse),
    Operator(
        "constant_speed",
        "Constant speed",
        "Goes through the same values at one speed from the first key to the last.",
        (_TOLERANCE,),
        "channels",
        _run_constant_speed,
    ),
    Operator(
        "separate",
        "Separate components",
        "Gives X, Y and Z curves of their own.",
        (),
        "channels",
        _run_separate,
    ),
    Operator(
        "join",
        "Join components",
        "Makes one curve of the curves of X, Y and Z.",
        (),
        "channels",
        _run_join,
    ),
    Operator(
        "to_euler",
        "Quaternions to Euler angles",
        "Gives the selected joints Euler angles in place of quaternions.",
        (
            Parameter("order", "choice", "XYZ", "The order of the angles.", "Order", choices=euler.CONVENTIONS[:6]),
            Parameter("every_frame", "boolean", True, "A key on every frame: exact there.", "Every frame"),
        ),
        "joints",
        _run_to_euler,
    ),
    Operator(
        "to_rotations",
        "Euler angles to quaternions",
        "Gives the selected joints quaternions in place of Euler angles.",
        (number("tolerance_deg", 0.01, 1e-4, 5.0, "Largest error, where it cannot be exact.", "degrees"),),
        "joints",
        _run_to_rotations,
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
