"""A scene as the browser gets it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from studio_scenes import arm_motion, arm_scene, arm_skeleton

from keypose.model import Character, Image, Material, Motion, Part, Pose, Scene, SkinningMethod
from keypose.studio.container import array, unpack
from keypose.studio.payload import encode

ELEMENTS = {"float32": "<f4", "float64": "<f8", "uint8": "|u1", "uint16": "<u2", "uint32": "<u4", "int32": "<i4"}


class Decoded:
    """Header and arrays of a payload."""

    def __init__(self, scene: Scene) -> None:
        self.header, self.body = unpack(encode(scene, id="s1", name="arm.glb"))

    def __call__(self, ref: dict[str, Any]) -> np.ndarray:
        return np.frombuffer(array(self.body, ref), ELEMENTS[ref["element"]]).reshape(ref["shape"])


def test_everything_of_a_scene_arrives() -> None:
    scene = arm_scene()
    got = Decoded(scene)
    character, part = scene.character, scene.character.parts[0]
    (sent,) = got.header["characters"]
    tube = sent["parts"][0]
    assert got.header["notes"] == ["made by code"]
    assert sent["skeleton"]["names"] == list(character.skeleton.names)
    assert np.array_equal(got(sent["skeleton"]["parents"]), character.skeleton.parents)
    assert np.array_equal(got(sent["skeleton"]["rotations"]), character.skeleton.rest.rotations)
    assert sent["skeleton"]["end_joints"] == [3]
    assert np.array_equal(got(tube["positions"]), part.mesh.positions)
    assert np.array_equal(got(tube["triangles"]), part.mesh.triangles)
    assert part.skin is not None
    assert part.morphs is not None
    assert got(tube["skin"]["joints"]).shape == (part.mesh.vertex_count, 4)
    assert np.allclose(got(tube["skin"]["weights"])[:, :2], part.skin.weights)
    assert not got(tube["skin"]["weights"])[:, 2:].any()
    assert np.allclose(got(tube["morphs"]["position_deltas"]), part.morphs.position_deltas)
    assert (sent["parts"][1]["joint"], sent["parts"][1]["skin"]) == (3, None)


def test_curves_keep_their_precision_and_kind() -> None:
    scene = arm_scene()
    got = Decoded(scene)
    clip = scene.animations[0]
    curves = {(c["target"], c["property"]): c for c in got.header["animations"][0]["curves"]}
    for channel, curve in clip.curves.items():  # type: ignore[union-attr]
        sent = curves[channel.target, channel.property.value]
        assert np.array_equal(got(sent["times"]), curve.times_s)
        assert np.array_equal(got(sent["values"]), curve.values)
        assert np.array_equal(got(sent["modes"]), curve.modes)


def test_what_does_not_change_over_time_is_sent_once() -> None:
    got = Decoded(arm_scene())
    motion = got.header["animations"][1]
    assert motion["frames"] == 61
    assert motion["translations"]["shape"] == [1, 4, 3]
    assert motion["rotations"]["shape"] == [61, 4, 4]


def test_a_pose_that_only_seems_to_change_is_sent_once_too() -> None:
    skeleton = arm_skeleton()
    motion = arm_motion(skeleton)
    full = motion.pose.broadcast()
    again = motion.with_pose(Pose(np.array(full.translations), full.rotations, full.scales))
    got = Decoded(Scene((Character(skeleton),), (again,)))
    assert got.header["animations"][0]["translations"]["shape"] == [1, 4, 3]


def test_more_than_four_influences_are_packed_and_it_is_said() -> None:
    wide = arm_scene(influences=4)
    assert Decoded(wide).header["notes"] == ["made by code"]
    skeleton = arm_skeleton(6)
    from studio_scenes import arm_mesh

    mesh, skin = arm_mesh(skeleton, 6)
    got = Decoded(Scene((Character(skeleton, (Part("tube", mesh, skin=skin),)),)))
    sent = got.header["characters"][0]["parts"][0]["skin"]
    assert np.allclose(got(sent["weights"]).sum(1), 1, atol=1e-6)
    assert "6 influences per vertex" in got.header["notes"][0]


def test_a_skin_of_dual_quaternions_is_shown_linearly_and_it_is_said() -> None:
    scene = arm_scene(influences=4)
    part = scene.character.parts[0]
    assert part.skin is not None
    dual = replace(part, skin=replace(part.skin, method=SkinningMethod.DUAL_QUATERNION))
    got = Decoded(replace(scene, characters=(replace(scene.character, parts=(dual,)),)))
    assert any("dual quaternions; it is shown linearly" in note for note in got.header["notes"])


def test_a_shared_skin_and_a_shared_picture_are_sent_once() -> None:
    scene = arm_scene()
    image = Image("paint.png", data=b"\x89PNG not really")
    part = replace(scene.character.parts[0], material=Material(base_color_image=image))
    character = Character(scene.character.skeleton, (part, part), morph_names=scene.character.morph_names)
    got = Decoded(Scene((character,)))
    first, second = got.header["characters"][0]["parts"]
    assert first["skin"] == second["skin"]
    assert (first["material"]["image"], second["material"]["image"], len(got.header["images"])) == (0, 0, 1)
    assert bytes(got(got.header["images"][0]["bytes"])) == image.data


def test_a_scene_with_nothing_in_it_is_a_payload_too() -> None:
    got = Decoded(
        Scene(
            animations=(
                Motion(("a",), Pose(np.zeros((3, 1, 3)), np.tile([1.0, 0, 0, 0], (3, 1, 1)), np.ones((3, 1, 3))), 30.0),
            )
        )
    )
    assert got.header["characters"] == []
    assert got.header["animations"][0]["frames"] == 3
