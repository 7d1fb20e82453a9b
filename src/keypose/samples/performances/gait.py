"""Walk and run: cycles whose feet do not slide, because the ground decides where they are."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from keypose.arrays import Floats
from keypose.model import Motion
from keypose.samples.performances.body import Arm, Controls, Foot, animate
from keypose.samples.performances.tracks import blinks, cyclic, rolled_ankle
from keypose.samples.skeleton import rest_positions

RATE_HZ = 60.0


@dataclass(frozen=True, slots=True)
class Gait:
    """What makes a cycle: lengths in metres, phases as shares of the cycle, pitches in degrees by phase.

    ``stance`` is the share of the cycle a foot is on the ground; ``ahead_m`` is how far in front of the hips it lands.
    ``lift`` lists (share of the swing, height) of the ankle's detour.
    """

    frames: int
    stride_m: float
    stance: float
    ahead_m: float
    width_m: float
    pitch: tuple[tuple[float, float], ...]
    lift: tuple[tuple[float, float], ...]
    swing_toe: float
    yaw: float


WALK = Gait(
    frames=62,
    stride_m=1.25,
    stance=0.6,
    ahead_m=0.305,
    width_m=0.078,
    pitch=(
        (0.0, 19), (0.05, 9), (0.1, 0), (0.3, 0), (0.4, -8), (0.5, -26), (0.6, -52),
        (0.66, -60), (0.76, -34), (0.86, 2), (0.94, 18),
    ),
    lift=((0.0, 0.0), (0.3, 0.045), (0.62, 0.026), (0.82, 0.013), (1.0, 0.0)),
    swing_toe=12.0,
    yaw=5.0,
)  # fmt: skip

RUN = Gait(
    frames=42,
    stride_m=2.3,
    stance=0.34,
    ahead_m=0.27,
    width_m=0.055,
    pitch=(
        (0.0, 6), (0.05, 0), (0.13, 0), (0.2, -16), (0.27, -42), (0.34, -66),
        (0.5, -92), (0.64, -62), (0.78, -16), (0.9, 8), (0.96, 9),
    ),
    lift=((0.0, 0.0), (0.17, 0.16), (0.45, 0.3), (0.7, 0.2), (0.88, 0.08), (1.0, 0.0)),
    swing_toe=10.0,
    yaw=3.0,
)  # fmt: skip


def walk() -> Motion:
    """Two cycles of a relaxed walk, 1.21 m/s; the loop goes on 2.5 m further forward."""
    phase, times = _phases(WALK, cycles=2)
    wave, turn_wave = np.cos(2 * np.pi * phase), np.sin(2 * np.pi * phase)
    twice = np.cos(4 * np.pi * (phase - 0.03))
    hips = np.stack([0.017 * np.sin(2 * np.pi * (phase - 0.02)), 0 * phase, _travel(WALK, phase) + 0.006 * twice], -1)
    hips_turn = np.stack([1.5 + 0.7 * twice, -6.5 * wave, 3.6 * turn_wave], -1)
    feet = {side: _foot(WALK, side, phase, hips) for side in ("Left", "Right")}
    hips[:, 1] = _hips_height(WALK, phase, hips, feet)
    spine = np.stack([2.2 - 1.2 * twice, 12.0 * wave, -5.0 * turn_wave], -1)
    head = np.stack([-2.2 + 0.9 * np.cos(4 * np.pi * (phase - 0.1)), -3.4 * wave, 0.9 * turn_wave], -1)

    def arm(shift: float) -> Arm:
        swing = np.cos(2 * np.pi * (phase + shift - 0.04))
        late = np.cos(2 * np.pi * (phase + shift - 0.1))
        return Arm(
            lift=10.5 - 1.5 * swing**2,
            swing=2.0 - 25.0 * swing,
            twist=8.0 - 4 * swing,
            bend=23.0 - 13.0 * late,
            roll=14.0 - 6 * late,
            hand=3.0 + 7.0 * np.cos(2 * np.pi * (phase + shift - 0.18)),
            curl=0.3 + 0.05 * late,
            forward=-5.0 * swing,
            shrug=1.0 + 0.8 * twice,
        )

    controls = Controls(
        frames=len(phase),
        hips_move=hips,
        hips_turn=hips_turn,
        spine=spine,
        neck=head * 0.4,
        head=head * 0.6,
        arms={"Left": arm(0.0), "Right": arm(0.5)},
        feet=feet,
        morphs={"mouthSmileLeft": 0.22, "mouthSmileRight": 0.22, **blinks(times, [0.82])},
    )
    return animate(controls, name="walk", rate_hz=RATE_HZ)


def run() -> Motion:
    """Two cycles of a run, 3.3 m/s, with a flight in every step; the loop goes on 4.6 m further forward."""
    phase, times = _phases(RUN, cycles=2)
    wave, turn_wave = np.cos(2 * np.pi * phase), np.sin(2 * np.pi * (phase - 0.02))
    twice = np.cos(4 * np.pi * (phase - 0.17))  # 1 in the middle of each stance
    hips = np.stack([0.009 * turn_wave, -0.052 - 0.034 * twice, _travel(RUN, phase)], -1)
    hips_turn = np.stack([9.0 + 1.5 * twice, -9.0 * wave, 3.0 * turn_wave], -1)
    feet = {side: _foot(RUN, side, phase, hips) for side in ("Left", "Right")}
    spine = np.stack([6.0 + 2.0 * twice, 19.0 * wave, -3.5 * turn_wave], -1)
    head = np.stack([-11.0 - 2.5 * np.cos(4 * np.pi * (phase - 0.22)), -8.0 * wave, 0 * phase], -1)

    def arm(shift: float) -> Arm:
        swing = np.cos(2 * np.pi * (phase + shift - 0.03))
        late = np.cos(2 * np.pi * (phase + shift - 0.08))
        return Arm(
            lift=19.0 + 3.0 * swing,
            swing=-8.0 - 44.0 * swing,
            twist=2.0 - 12 * swing,
            bend=92.0 - 14.0 * late,
            roll=22.0,
            hand=4.0 + 5.0 * late,
            curl=0.62,
            forward=-9.0 * swing,
            shrug=3.0,
        )

    controls = Controls(
        frames=len(phase),
        hips_move=hips,
        hips_turn=hips_turn,
        spine=spine,
        neck=head * 0.45,
        head=head * 0.55,
        arms={"Left": arm(0.0), "Right": arm(0.5)},
        feet=feet,
        morphs={"jawOpen": 0.1 + 0.05 * twice, "browDownLeft": 0.18, "browDownRight": 0.18, **blinks(times, [0.9])},
    )
    return animate(controls, name="run", rate_hz=RATE_HZ)


def _phases(gait: Gait, cycles: int) -> tuple[Floats, Floats]:
    """The left foot's phase, rising through the cycles (last frame = first), and the times in seconds."""
    frames = np.arange(gait.frames * cycles + 1)
    return frames / gait.frames, frames / RATE_HZ


def _travel(gait: Gait, phase: Floats) -> Floats:
    return gait.stride_m * phase


def _foot(gait: Gait, side: str, phase: Floats, hips: Floats) -> Foot:
    """The ankle along the cycle: on the ground by the roll of the foot, in the air by a curve that meets it smoothly."""
    foot_phase = phase if side == "Left" else phase + 0.5
    step, part = np.floor(foot_phase), foot_phase % 1
    behind = 0.0 if side == "Left" else -0.5  # the right foot's steps begin half a cycle earlier

    def pitch(at: Floats) -> Floats:
        return cyclic(at, gait.pitch)

    def on_ground(number: Floats, at: Floats) -> tuple[Floats, Floats]:
        ankle = rest_positions()[f"{side}Foot"].copy()
        ankle = np.tile(ankle, (len(at), 1))
        ankle[:, 0] = np.copysign(gait.width_m, ankle[0, 0])
        ankle[:, 2] += gait.stride_m * (number + behind) + gait.ahead_m
        return rolled_ankle(side, ankle, pitch(at), gait.yaw)

    place, toe = on_ground(step, np.minimum(part, gait.stance))
    air = (part - gait.stance) / (1 - gait.stance)
    flying = _swing(gait, on_ground, step, np.clip(air, 0, 1))
    place = np.where((air > 0)[:, None], flying, place)
    # The toe straightens while the foot is in the air.
    fade = np.clip(air, 0, 1)
    toe = np.where(air > 0, toe * (1 - fade) ** 2 + gait.swing_toe * np.sin(np.pi * fade), toe)
    return Foot(place=place, pitch=pitch(part), yaw=gait.yaw, toe=toe, knee=4.0)


def _swing(
    gait: Gait, on_ground: Callable[[Floats, Floats], tuple[Floats, Floats]], step: Floats, share: Floats
) -> Floats:
    """A quintic from toe-off to heel strike with the ground's velocities and no acceleration at both ends, plus the lift."""
    from scipy.interpolate import PchipInterpolator

    little, span = 1e-3, 1 - gait.stance
    leave, before = on_ground(step, 0 * step + gait.stance)[0], on_ground(step, 0 * step + gait.stance - little)[0]
    land, after = on_ground(step + 1, 0 * step)[0], on_ground(step + 1, 0 * step + little)[0]
    leave_speed, land_speed = (leave - before) / little * span, (land - after) / little * span
    u, v = share[:, None], 1 - share[:, None]
    place = _blend(u) * leave + _blend(v) * land + _speed(u) * leave_speed + _speed(v) * land_speed
    # level at both ends, where the ground's own velocities hold
    shares, heights = np.array([(-1.0, gait.lift[0][1]), *gait.lift, (2.0, gait.lift[-1][1])]).T
    place[:, 1] += PchipInterpolator(shares, heights)(share)
    return place


def _blend(u: Floats) -> Floats:
    """The quintic that is 1 at 0, and nothing else there and at 1."""
    return 1 - u**3 * (10 - 15 * u + 6 * u**2)


def _speed(u: Floats) -> Floats:
    """The quintic with the slope 1 at 0, and nothing else there and at 1."""
    return u - u**3 * (6 - 8 * u + 3 * u**2)


def _hips_height(gait: Gait, phase: Floats, hips: Floats, feet: dict[str, Foot]) -> Floats:
    """The highest smooth bob (two waves a cycle) that lets both legs reach the ground with a soft knee."""
    rest = rest_positions()
    length = 0.99 * sum(
        float(np.linalg.norm(rest[a] - rest[b])) for a, b in (("LeftUpLeg", "LeftLeg"), ("LeftLeg", "LeftFoot"))
    )
    limit = np.full(len(phase), np.inf)
    for side, foot in feet.items():
        if foot.place is None:
            continue
        offset = foot.place - (rest[f"{side}UpLeg"] + hips)
        room = np.sqrt(np.maximum(length**2 - offset[:, 0] ** 2 - offset[:, 2] ** 2, 0))
        on_ground = (phase if side == "Left" else phase + 0.5) % 1 <= gait.stance
        limit = np.where(on_ground, np.minimum(limit, foot.place[:, 1] + room - rest[f"{side}UpLeg"][1]), limit)
    waves = np.stack([0 * phase + 1, np.cos(4 * np.pi * phase), np.sin(4 * np.pi * phase)], -1)
    height = waves @ np.linalg.lstsq(waves, limit, rcond=None)[0]
    return height - np.max(height - limit)
