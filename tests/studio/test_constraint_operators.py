"""The operators with constraints as the page knows them, and run on a clip of a project as it asks for them."""

from __future__ import annotations

import numpy as np

from keypose import samples
from keypose.editing.reach import found_roles
from keypose.evaluate import sample_clip, to_clip, world
from keypose.model import Channel, Document, Property
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
    clip = to_clip(scene.animations[0])
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
