"""The operators with constraints as the page knows them, and run on a clip of a project as it asks for them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from keypose import samples
from keypose.editing.reach import found_roles
from keypose.evaluate import sample_clip, to_clip, world
from keypose.model import Channel, Document, Motion, Property
from keypose.studio.edit_operators import operated, operator_specs
from keypose.studio.edit_wire import Operation


def test_the_page_offers_them_with_fields_that_fit():
    specs = {spec.name: spec for spec in operator_specs()}
    assert [specs[n].label for n in ("reach", "bend_path", "pose_fall_off", "spacetime")] == [
        "Reach", "Bend path", "Pose with fall-off", "Space-time",
    ]  # fmt: skip
    kinds = {p.name: p.kind for p in specs["reach"].parameters}
    assert kinds["joint"] == "joint" and kinds["first_frame"] == "integer" and kinds["keep_rotation"] == "boolean"
    assert specs["pose_fall_off"].group == "joints" and specs["bend_path"].group == "time"


def test_selected_keys_of_a_take_say_when_a_hand_is_elsewhere():
    scene = samples.load("walk")
    body = scene.character.skeleton
    take = scene.animations[0]
    assert isinstance(take, Motion)
    clip = to_clip(take)
    document = Document(characters={scene.character.name: scene.character}, clips={clip.name: clip})
    key = Channel("LeftHand", Property.ROTATION)
    asked = Operation(
        "1", "reach", clip.name, scene.character.name, {key: np.array([60, 62])}, None, None, {"y_m": 0.2, "z_m": 0.1}
    )
    after, label, report = operated(asked, document)
    assert label == "Reach" and "LeftHand is there" in report
    at = np.array([10, 60, 61, 62, 110]) / 60.0
    hand = found_roles(body)["left_hand"]
    before, now = (
        np.asarray(world(body, sample_clip(d.clips[clip.name], body, at)), np.float64)[:, hand, :3, 3]
        for d in (document, after)
    )
    np.testing.assert_allclose(now - before, [[0, 0, 0], *[[0, 0.2, 0.1]] * 3, [0, 0, 0]], atol=1e-4)
    kept = [c for c, curve in clip.curves.items() if after.clips[clip.name].curves[c] is curve]
    assert len(kept) == len(clip.curves) - 3


def _walked(name: str, start_s: float | None, end_s: float | None, parameters: dict[str, Any], noise_m: float = 0.0):
    """The built-in walk before and after an operator within a time: places of all joints in every frame."""
    scene = samples.load("walk")
    body, take = scene.character.skeleton, scene.animations[0]
    assert isinstance(take, Motion)
    if noise_m:
        sway = noise_m * np.sin(np.arange(take.frame_count) / 7.0)
        moved = np.array(take.pose.broadcast().translations)
        moved[:, 0, 0] += sway
        take = replace(take, pose=replace(take.pose.broadcast(), translations=moved))
    clip = to_clip(take)
    document = Document(characters={scene.character.name: scene.character}, clips={clip.name: clip})
    channels = dict.fromkeys(clip.curves)
    asked = Operation("1", name, clip.name, scene.character.name, channels, start_s, end_s, parameters)
    after, _, _ = operated(asked, document)
    times = take.start_s + np.arange(take.frame_count) / take.rate_hz
    before, now = (
        np.asarray(world(body, sample_clip(d.clips[clip.name], body, times)), np.float64)[..., :3, 3]
        for d in (document, after)
    )
    return before, now, take.rate_hz, found_roles(body)


def test_selected_time_says_when_a_hand_is_elsewhere():
    before, now, rate, roles = _walked("reach", 1.0, 1.2, {"joint": "LeftHand", "y_m": 0.2, "ease_s": 0.3})
    moved = np.linalg.norm(now - before, axis=-1)[:, roles["left_hand"]]
    frames = np.arange(len(moved))
    np.testing.assert_allclose(moved[(frames >= rate) & (frames <= 1.2 * rate)], 0.2, atol=1e-4)
    assert moved[(frames < 0.7 * rate - 1) | (frames > 1.5 * rate + 1)].max() < 1e-6


def test_a_path_bends_within_the_selected_time_and_goes_straight_on():
    before, now, rate, roles = _walked("bend_path", 0.5, 1.5, {"angle_deg": 60.0, "plant": False})
    # bodies begin to turn a little before the way does, and end a little after it
    first, last = round(0.2 * rate), round(1.8 * rate)
    np.testing.assert_allclose(now[:first], before[:first], atol=1e-5)
    # what follows is the same walk, turned as one by the whole angle
    hips = roles["hips"]
    old, new = (p[last:, :, [2, 0]] - p[last, hips, [2, 0]] for p in (before, now))
    turned = np.exp(1j * np.radians(60.0)) * (old[..., 0] + 1j * old[..., 1])
    np.testing.assert_allclose(new[..., 0] + 1j * new[..., 1], turned, atol=1e-3)
    np.testing.assert_allclose(now[..., 1], before[..., 1], atol=1e-5)


def test_feet_are_planted_within_the_selected_time_alone():
    whole = _walked("plant_feet", None, None, {}, noise_m=0.03)[1]
    before, now, rate, _ = _walked("plant_feet", 0.6, 1.2, {}, noise_m=0.03)
    frames = np.arange(len(now))
    inside = (frames >= 0.6 * rate) & (frames <= 1.2 * rate)
    outside = (frames < 0.4 * rate - 1) | (frames > 1.4 * rate + 1)  # it goes over within 0.2 s
    assert np.abs(whole - before)[inside].max() > 0.01 < np.abs(whole - before)[outside].max()
    np.testing.assert_allclose(now[inside], whole[inside], atol=1e-5)
    np.testing.assert_allclose(now[outside], before[outside], atol=1e-6)
    # and nowhere does a joint jump: a frame's step is that of one motion or the other, and a little of the way over
    step = np.linalg.norm(np.diff(now, axis=0), axis=-1).max()
    assert step < 1.2 * max(np.linalg.norm(np.diff(p, axis=0), axis=-1).max() for p in (before, whole))
