"""The steps of retargeted bodies as the page shows them: prints on the ground, and how feet slide on them."""

from __future__ import annotations

import itertools
from collections.abc import Mapping

import numpy as np

from keypose.analysis.contacts import foot_points
from keypose.analysis.ground import true_runs
from keypose.analysis.roles import SIDES
from keypose.evaluate import world_rotations_positions
from keypose.model import Motion
from keypose.retarget import BodyFrames, RetargetResult
from keypose.studio.retarget_messages import RetargetFoot


def found_feet(done: RetargetResult, source: Motion, target: Motion) -> list[RetargetFoot]:
    """The steps of all feet, and how they slide on both bodies."""
    bodies = ((done.source, source), (done.target, target))
    places = [
        np.asarray(world_rotations_positions(body.skeleton, motion.pose.broadcast())[1], np.float64)
        for body, motion in bodies
    ]
    found: list[RetargetFoot] = []
    for side, limb in itertools.product(SIDES, ("foot", "hand")):
        names = ("heel", "ball") if limb == "foot" else ("hand",)
        flags = {name: done.touching[f"{side}_{name}"] for name in names if f"{side}_{name}" in done.touching}
        if not flags:
            continue
        down = np.logical_or.reduce(list(flags.values()))
        steps = [(first, after - 1) for first, after in true_runs(down)]
        joints: list[list[str]] = []
        slides: list[list[float]] = []
        for (body, motion), at in zip(bodies, places, strict=True):
            own = [f"{side}_{limb}", f"{side}_toes" if limb == "foot" else f"{side}_hand"]
            own = [role for role in own if role in body.roles]
            joints.append([body.skeleton.names[body.roles[role]] for role in (*own, *own[-1:])][:2])
            speeds = _carrying_speeds(body, at, done.touching, side, flags, motion.rate_hz)
            slides.append([_mean(speeds[first:last]) for first, last in steps])
        pairs = [frame for step in steps for frame in step]
        found.append(RetargetFoot(f"{side}_{limb}", joints[0], joints[1], pairs, slides[0], slides[1]))
    return found


def _carrying_speeds(
    body: BodyFrames,
    places: np.ndarray,
    touching: Mapping[str, np.ndarray],
    side: str,
    flags: Mapping[str, np.ndarray],
    rate_hz: float,
) -> np.ndarray:
    """Level speed (T - 1,) in cm/s of the point that carries a foot, the ball before the heel; NaN where none does."""
    points = foot_points(body.roles, places, touching)
    if f"{side}_hand" in body.roles:
        points[f"{side}_hand"] = places[:, body.roles[f"{side}_hand"]]
    speeds = np.full(max(len(places) - 1, 0), np.nan)
    for name in ("hand", "heel", "ball"):
        if name in flags and f"{side}_{name}" in points:
            step = np.diff(points[f"{side}_{name}"], axis=0)
            stays = flags[name][1:] & flags[name][:-1]
            speeds[stays] = 100.0 * rate_hz * np.hypot(step[stays, 0], step[stays, 2])
    return speeds


def _mean(speeds: np.ndarray) -> float:
    known = speeds[np.isfinite(speeds)]
    return float(known.mean()) if len(known) else 0.0
