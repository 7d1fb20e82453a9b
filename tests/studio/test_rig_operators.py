"""Operators that work on joints, run on a character whose controls are keyed: its joints do what they would without a rig."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from keypose import samples
from keypose.evaluate import sample_clip, to_clip, world
from keypose.model import Clip, Document, Motion
from keypose.rig import auto_rig, bake_rig, fit_controls
from keypose.studio.edit_operators import operated
from keypose.studio.edit_wire import Operation


@cache
def documents() -> tuple[Document, Document, Motion]:
    """The built-in walk on joints, and on controls with the left arm and the legs by IK."""
    scene = samples.load("walk")
    who, take = scene.character, scene.animations[0]
    assert isinstance(take, Motion)
    rig = replace(auto_rig(who.skeleton, who.roles or None, character=who), name=who.name, character=who.name)
    fit = fit_controls(rig, who.skeleton, take, {"arm.L.ik": 1.0})
    cast = {who.name: who}
    plain = Document(characters=cast, clips={"walk": replace(to_clip(take), name="walk")})
    rigged = Document(characters=cast, clips={"walk": replace(fit.clip, name="walk")}, rigs={who.name: rig})
    return plain, rigged, take


def run(document: Document, name: str, parameters: dict[str, Any], span: tuple[float, float] | None, *targets: str):
    """The clip after an operator, and what it says."""
    (who,) = document.characters
    clip = document.clips["walk"]
    channels = {c: None for c in clip.curves if not targets or c.target in targets}
    start_s, end_s = span or (None, None)
    after, _, report = operated(Operation("1", name, "walk", who, channels, start_s, end_s, parameters), document)
    return after.clips["walk"], report


def places(document: Document, clip: Clip, take: Motion) -> np.ndarray:
    (who,) = document.characters.values()
    rig = document.rig_of(who.name)
    times = take.start_s + np.arange(take.frame_count) / take.rate_hz
    pose = sample_clip(clip, who.skeleton, times) if rig is None else bake_rig(rig, who.skeleton, clip, 60.0).pose
    return np.asarray(world(who.skeleton, pose), np.float64)[..., :3, 3]


@pytest.mark.parametrize(
    ("name", "parameters", "joint", "control"),
    [
        ("reach", {"y_m": 0.15, "ease_s": 0.2}, "LeftHand", "hand_ik.L"),
        ("plant_feet", {"speed_m_s": 0.4}, "", ""),
        ("pose_fall_off", {"x_deg": 25.0}, "Head", "head_control"),
        ("reach", {"y_m": 0.1, "z_m": 0.1}, "RightFoot", "foot_ik.R"),
    ],
)
def test_joints_do_what_they_would_without_a_rig(
    name: str, parameters: dict[str, Any], joint: str, control: str
) -> None:
    plain, rigged, take = documents()
    span = (0.6, 1.0)
    expected, said = run(plain, name, parameters, span, *([joint] if joint else []))
    found, told = run(rigged, name, parameters, span, *([control] if control else []))
    assert told == said
    wanted, now, before = (
        places(d, c, take) for d, c in ((plain, expected), (rigged, found), (rigged, rigged.clips["walk"]))
    )
    assert np.abs(wanted - before).max() > 0.004  # it does something
    np.testing.assert_allclose(now, wanted, atol=2e-3)
    # keys before and after stay, and what is not concerned keeps its curve
    old = rigged.clips["walk"]
    for channel, curve in found.curves.items():
        known = old.curves.get(channel)
        if known is None or known is curve:
            continue
        assert np.isin(known.times_s[known.times_s < 0.3], curve.times_s).all()
    if joint == "LeftHand":
        changed = {c.target for c, curve in found.curves.items() if old.curves.get(c) is not curve}
        assert changed and not any(t.endswith(".R") or t.startswith(("leg", "foot")) for t in changed)


def test_curves_of_controls_are_changed_as_they_are() -> None:
    _, rigged, _ = documents()
    old = rigged.clips["walk"]
    found, _ = run(rigged, "smooth", {}, None, "hand_ik.L")
    assert {c.target for c, curve in found.curves.items() if old.curves[c] is not curve} == {"hand_ik.L"}
