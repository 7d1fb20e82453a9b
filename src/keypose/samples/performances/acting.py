"""Idle, jump, wave and talk: performances on one spot."""

from __future__ import annotations

import numpy as np

from keypose.arrays import Floats
from keypose.model import Motion
from keypose.samples.performances.body import Arm, Controls, Foot, animate
from keypose.samples.performances.tracks import blinks, bump, eased, rolled_ankle, rounded, smooth_sum
from keypose.samples.skeleton import rest_positions

RATE_HZ = 60.0
GRAVITY = 9.81


def _times(duration_s: float) -> Floats:
    return np.arange(round(duration_s * RATE_HZ) + 1) / RATE_HZ


def _columns(*tracks: Floats | float) -> Floats:
    return np.stack(np.broadcast_arrays(*tracks), axis=-1).astype(np.float64)


def _smile(amount: Floats | float) -> dict[str, Floats | float]:
    return {"mouthSmileLeft": amount, "mouthSmileRight": amount}


def _standing(times: Floats, duration_s: float) -> Controls:
    """Someone alive: breath, a slow shift of weight, a wandering gaze. Loops after ``duration_s``."""
    breaths = max(1, round(duration_s / 3.2))
    breath = np.sin(2 * np.pi * breaths * times / duration_s)
    late = np.sin(2 * np.pi * breaths * times / duration_s - 0.7)
    shift = smooth_sum(times, duration_s, [(1, 1.0, 0.05), (2, 0.25, 0.3)])
    controls = Controls(frames=len(times))
    controls.hips_move = _columns(0.016 * shift, -0.0135 + 0.002 * breath - 0.004 * shift**2, 0.004 * late)
    controls.hips_turn = _columns(0.6, 1.6 * shift, -1.3 * shift)
    controls.spine = _columns(0.4 - 1.5 * breath, -1.2 * shift, 2.0 * shift)
    gaze = smooth_sum(times, duration_s, [(1, 4.0, 0.6), (2, 2.0, 0.1), (3, 1.2, 0.8)])
    controls.neck = _columns(0.6 + 0.4 * late, 0.4 * gaze, -0.4 * shift)
    controls.head = _columns(-0.6 + 0.7 * late, 0.7 * gaze, -0.5 * shift)
    for side, sign in (("Left", 1.0), ("Right", -1.0)):
        sway = sign * shift
        controls.arms[side] = Arm(
            lift=8.5 + 0.9 * breath - 0.8 * sway,
            swing=1.0 + 1.4 * late,
            twist=9.0,
            bend=17.0 + 1.6 * late,
            roll=16.0,
            hand=4.0 + 1.2 * late,
            curl=0.27 + 0.015 * late,
            shrug=1.0 + 1.5 * breath,
        )
        controls.feet[side] = Foot(yaw=9.0, knee=8.0)
    return controls


def idle() -> Motion:
    """Standing at ease; loops after 6.4 s."""
    duration = 6.4
    times = _times(duration)
    controls = _standing(times, duration)
    controls.morphs = {**_smile(0.2), **blinks(times, [0.9, 3.1, 3.42, 5.5])}
    return animate(controls, name="idle", rate_hz=RATE_HZ)


def wave() -> Motion:
    """A friendly wave of the right hand, with a smile; begins and ends at ease."""
    duration = 3.6
    times = _times(duration)
    controls = _standing(times, duration)
    up = eased(times, [(0.25, 0), (0.85, 1), (2.7, 1), (3.4, 0)])
    anticipation = bump(times, 0.3, 0.25)
    swing = np.sin(2 * np.pi * 1.9 * (times - 0.85)) * eased(times, [(0.7, 0), (1.0, 1), (2.45, 1), (2.8, 0)])
    drag = np.sin(2 * np.pi * 1.9 * (times - 0.93)) * eased(times, [(0.75, 0), (1.1, 1), (2.5, 1), (2.85, 0)])
    rest = controls.arms["Right"]
    controls.arms["Right"] = Arm(
        lift=_mix(rest.lift, 66.0, up) - 3 * anticipation + 3 * swing,
        swing=_mix(rest.swing, 14.0, up),
        twist=_mix(rest.twist, 74.0, up),
        bend=_mix(rest.bend, 92.0, up) + 21 * swing,
        roll=_mix(rest.roll, 20.0, up),
        hand=_mix(rest.hand, -6.0, up),
        tilt=13 * drag,
        curl=_mix(rest.curl, 0.05, up),
        spread=0.9 * up,
        shrug=_mix(rest.shrug, 9.0, up),
    )
    lean = eased(times, [(0.2, 0), (0.9, 1), (2.6, 1), (3.4, 0)])
    controls.hips_move = controls.hips_move + _columns(0.012 * lean, 0.0, 0.0)
    controls.spine = controls.spine + _columns(-1.5 * lean, -3.0 * lean, -3.5 * lean + 0.7 * swing)
    controls.head = controls.head + _columns(-2.0 * lean, 2.0 * lean, 6.0 * lean + 0.8 * drag)
    joy = eased(times, [(0.2, 0.2), (0.8, 0.85), (2.7, 0.8), (3.5, 0.2)])
    brows = eased(times, [(0.2, 0), (0.6, 0.65), (1.3, 0.3), (2.6, 0.25), (3.3, 0)])
    controls.morphs = {
        **_smile(joy),
        "cheekSquintLeft": 0.5 * joy,
        "cheekSquintRight": 0.5 * joy,
        "browInnerUp": brows,
        "browOuterUpLeft": brows,
        "browOuterUpRight": brows,
        "jawOpen": 0.16 * eased(times, [(0.4, 0), (0.9, 1), (2.3, 0.7), (3.0, 0)]),
        **blinks(times, [0.35, 2.15, 3.2]),
    }
    return animate(controls, name="wave", rate_hz=RATE_HZ)


def _mix(from_value: Floats | float, to_value: float, share: Floats) -> Floats:
    return np.asarray(from_value) * (1 - share) + to_value * share


def jump() -> Motion:
    """A jump on the spot: anticipation, take-off, a ballistic flight, and a soft landing."""
    from scipy.interpolate import CubicHermiteSpline

    leave_s, rise_m, off_m = 0.56, 0.36, 0.052
    speed = np.sqrt(2 * GRAVITY * rise_m)
    land_s = leave_s + 2 * speed / GRAVITY
    times = _times(2.2)
    rest_y = -0.0135
    before = CubicHermiteSpline([0, 0.36, leave_s], [rest_y, -0.27, off_m], [0, 0, speed])
    after = CubicHermiteSpline([land_s, land_s + 0.2, 2.0, 2.3], [off_m, -0.235, rest_y, rest_y], [-speed, 0, 0, 0])
    flight = off_m + speed * (times - leave_s) - GRAVITY / 2 * (times - leave_s) ** 2
    height = np.where(times < leave_s, before(times), np.where(times > land_s, after(times), flight))
    air = np.clip((times - leave_s) / (land_s - leave_s), 0, 1)
    flying = (times > leave_s) & (times < land_s)

    crouch = eased(times, [(0.07, 0), (0.36, 1), (leave_s, 0), (land_s, 0.05), (land_s + 0.2, 0.85), (1.95, 0)])
    controls = _standing(times, times[-1])
    controls.hips_move = _columns(0.0, height, -0.075 * crouch)
    controls.hips_turn = _columns(34 * crouch - 5 * np.sin(np.pi * air) ** 2, 0.0, 0.0)
    controls.spine = _columns(20 * crouch - 7 * np.sin(np.pi * air) ** 2, 0.0, 0.0)
    controls.neck = _columns(-16 * crouch, 0.0, 0.0)
    controls.head = _columns(-18 * crouch - 5 * np.sin(np.pi * air) ** 2, 0.0, 0.0)

    pitch = eased(
        times,
        [
            (0, 0),
            (0.43, 0),
            (leave_s, -60),
            (leave_s + 0.2, -40),
            (land_s - 0.12, -28),
            (land_s, -36),
            (land_s + 0.11, 0),
            (2.2, 0),
        ],
    )
    # In the air the feet follow the hips, drawn up a little; they leave and meet the ground within a few frames, not within one.
    tuck = 0.115 * np.sin(np.pi * air) ** 1.5
    drawn = np.where(flying[:, None], _columns(0.0, flight - off_m + tuck, -0.35 * tuck), 0.0)
    near = np.maximum(bump(times, leave_s, 0.25), bump(times, land_s, 0.25))[:, None]
    drawn = drawn + near * (rounded(drawn, 10) - drawn)
    for side in ("Left", "Right"):
        flat = np.tile(rest_positions()[f"{side}Foot"], (len(times), 1))
        place, toe = rolled_ankle(side, flat, pitch, 9.0)
        place = place + drawn
        controls.feet[side] = Foot(
            place=place,
            pitch=pitch,
            yaw=9.0,
            toe=np.where(flying, toe * (1 - np.sin(np.pi * air)), toe),
            knee=10 + 10 * crouch,
        )
        swing = eased(
            times,
            [
                (0.07, 1),
                (0.28, -40),
                (leave_s + 0.08, 92),
                (leave_s + 0.26, 132),
                (land_s, 66),
                (land_s + 0.3, -10),
                (1.75, 8),
                (2.05, 1),
                (2.2, 1),
            ],
        )
        controls.arms[side] = Arm(
            lift=eased(
                times, [(0.07, 8.5), (0.36, 14), (leave_s, 14), (leave_s + 0.2, 17), (land_s + 0.1, 34), (1.9, 8.5)]
            ),
            swing=swing,
            twist=9.0,
            bend=eased(
                times, [(0.07, 17), (0.3, 26), (leave_s, 36), (leave_s + 0.24, 22), (land_s + 0.25, 48), (1.95, 17)]
            ),
            roll=16.0,
            hand=eased(times, [(0.07, 4), (0.3, 12), (leave_s + 0.1, -12), (land_s, 10), (1.95, 4)]),
            curl=eased(times, [(0.07, 0.27), (0.3, 0.5), (leave_s + 0.16, 0.08), (land_s, 0.15), (1.9, 0.27)]),
            spread=0.6 * np.sin(np.pi * air),
            shrug=1.0 + 12 * np.sin(np.pi * np.clip(air * 1.2, 0, 1)),
        )
    effort = eased(times, [(0, 0), (0.36, 0.7), (leave_s, 0.2), (land_s, 0.1), (land_s + 0.15, 0.6), (1.9, 0)])
    joy = np.sin(np.pi * air)
    controls.morphs = {
        **_smile(np.maximum(0.2, 0.9 * joy)),
        "browDownLeft": effort,
        "browDownRight": effort,
        "browInnerUp": 0.6 * joy,
        "eyeWideLeft": 0.5 * joy,
        "eyeWideRight": 0.5 * joy,
        "jawOpen": 0.32 * joy,
        "mouthPucker": 0.25 * effort,
        **blinks(times, [0.3, land_s + 0.14]),
    }
    return animate(controls, name="jump", rate_hz=RATE_HZ)


# What is said, as (start in seconds, viseme): "Hello! I was made in Python. Now, what shall we do?"
_SPEECH = (
    (0.40, "E"), (0.50, "nn"), (0.58, "O"), (0.72, "U"), (0.86, "sil"),
    (1.10, "aa"), (1.22, "I"), (1.32, "U"), (1.40, "O"), (1.48, "SS"), (1.58, "PP"), (1.66, "E"), (1.76, "I"), (1.85, "DD"),
    (1.93, "I"), (2.00, "nn"), (2.08, "PP"), (2.15, "aa"), (2.26, "TH"), (2.36, "O"), (2.48, "nn"), (2.60, "sil"),
    (2.95, "nn"), (3.03, "aa"), (3.16, "U"), (3.28, "sil"), (3.45, "U"), (3.52, "O"), (3.63, "DD"), (3.71, "CH"),
    (3.80, "aa"), (3.89, "nn"), (3.97, "U"), (4.03, "I"), (4.16, "DD"), (4.23, "CH"), (4.32, "U"), (4.58, "sil"),
)  # fmt: skip


def _visemes(times: Floats) -> dict[str, Floats]:
    """Overlapping bumps, each as wide as its neighbours are near, that never add up to more than 1."""
    weights: dict[str, Floats] = {}
    for i, (start, name) in enumerate(_SPEECH[:-1]):
        if name == "sil":
            continue
        end = _SPEECH[i + 1][0]
        centre = (start + end) / 2
        rise, fall = min(0.13, centre - start + 0.06), min(0.15, end - centre + 0.07)
        key = f"viseme_{name}"
        weights[key] = np.maximum(weights.get(key, np.zeros_like(times)), bump(times, centre, rise, fall))
    total = np.maximum(sum(weights.values(), np.zeros_like(times)), 1.0)
    return {name: 0.88 * track / total for name, track in weights.items()}


def talk() -> Motion:
    """A short speech with open hands: visemes, brows, blinks and nods that fall on the stressed words."""
    duration = 5.4
    times = _times(duration)
    controls = _standing(times, duration)
    hello, python, question = bump(times, 0.6, 0.35), bump(times, 2.2, 0.5), bump(times, 4.0, 0.7, 0.8)
    nods = 4.5 * hello + 3.5 * bump(times, 1.62, 0.2) + 4.5 * bump(times, 2.16, 0.22) + 3.0 * bump(times, 3.05, 0.22)
    open_hands = eased(
        times, [(0.2, 0), (0.75, 0.7), (1.3, 0.75), (2.1, 1), (2.8, 0.8), (3.5, 0.85), (4.1, 1), (4.7, 0.85), (5.3, 0)]
    )
    beat = (
        6 * bump(times, 0.62, 0.2)
        + 5 * bump(times, 1.6, 0.2)
        + 9 * bump(times, 2.18, 0.22)
        + 5 * bump(times, 3.05, 0.2)
    )
    for side, sign in (("Left", 1.0), ("Right", -1.0)):
        rest = controls.arms[side]
        share = np.clip(open_hands * (1.0 if side == "Right" else 0.88), 0, 1)
        controls.arms[side] = Arm(
            lift=_mix(rest.lift, 19.0, share) + 7 * question,
            swing=_mix(rest.swing, 17.0, share) + 0.8 * beat,
            twist=_mix(rest.twist, -10.0, share) - 9 * question,
            bend=_mix(rest.bend, 80.0, share) - 1.2 * beat - 3 * sign * python,
            roll=_mix(rest.roll, -48.0, share) - 16 * question,
            hand=_mix(rest.hand, -10.0, share) + 0.9 * beat,
            tilt=2 * sign * python,
            curl=_mix(rest.curl, 0.2, share) - 0.1 * question,
            spread=0.35 * share + 0.4 * question,
            shrug=_mix(rest.shrug, 2.0, share) + 8 * question,
        )
    controls.spine = controls.spine + _columns(
        2.0 * hello - 1.5 * question, 3.0 * python - 2.5 * question, 1.5 * python
    )
    controls.neck = controls.neck + _columns(0.4 * nods, 2.0 * python, 0.0)
    controls.head = controls.head + _columns(
        0.6 * nods - 3 * question, 3.0 * python - 2.0 * question, 4.0 * python - 6.5 * question
    )
    brows = np.clip(0.75 * hello + 0.5 * python + 0.9 * question, 0, 1)
    controls.morphs = {
        **_smile(0.22 + 0.35 * hello + 0.3 * bump(times, 5.0, 0.5)),
        "browInnerUp": brows,
        "browOuterUpLeft": brows,
        "browOuterUpRight": 0.8 * brows,
        **_visemes(times),
        **blinks(times, [0.28, 1.42, 2.78, 3.42, 4.85]),
    }
    return animate(controls, name="talk", rate_hz=RATE_HZ)
