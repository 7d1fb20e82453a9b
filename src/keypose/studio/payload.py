"""A scene as the one binary container that the browser draws from."""

from __future__ import annotations

from typing import Any

import numpy as np

from keypose.io.native_values import curve_json
from keypose.model import (
    Character,
    Clip,
    Image,
    Material,
    MorphSet,
    Motion,
    Part,
    Rig,
    Scene,
    Skeleton,
    Skin,
    SkinningMethod,
)
from keypose.studio import scene_messages as messages
from keypose.studio.container import Body, pack

INFLUENCES = 4
_ELEMENT_OF = {np.float64: "float64", np.float32: "float32", np.uint8: "uint8"}


def encode(scene: Scene, *, id: str, name: str, rig: Rig | None = None) -> bytes:
    """The container of a scene; arrays go to float32, curve times stay float64.

    ``rig``: whose controls are the last joints of its characters.
    """
    return _Encoder(rig).scene(scene, id, name)


class _Encoder:
    """Adds arrays to one body; pictures and skins that several parts share are sent once."""

    def __init__(self, rig: Rig | None) -> None:
        self.rig = rig
        self.body = Body()
        self.notes: list[str] = []
        self.images: list[messages.PictureData] = []
        self._image_numbers: dict[int, int] = {}
        self._skins: dict[int, messages.SkinData] = {}

    def scene(self, scene: Scene, id: str, name: str) -> bytes:
        self.notes = list(scene.notes)
        header = messages.SceneData(
            type="scene",
            id=id,
            name=name,
            format=scene.format,
            unit_m=float(scene.unit_m),
            up=scene.up,
            notes=self.notes,
            images=self.images,
            characters=[self._character(c) for c in scene.characters],
            animations=[self._clip(a) if isinstance(a, Clip) else self._motion(a) for a in scene.animations],
        )
        return pack(header, self.body)

    def _floats(self, array: Any) -> messages.ArrayRef:
        return self.body.add(array, "float32")

    def _optional(self, array: Any) -> messages.ArrayRef | None:
        return None if array is None else self._floats(array)

    def _skeleton(self, skeleton: Skeleton) -> messages.SkeletonData:
        ends = skeleton.end_offsets
        return messages.SkeletonData(
            names=list(skeleton.names),
            parents=self.body.add(skeleton.parents, "int32"),
            translations=self.body.add(skeleton.rest.translations, "float64"),
            rotations=self.body.add(skeleton.rest.rotations, "float64"),
            scales=self.body.add(skeleton.rest.scales, "float64"),
            end_joints=[int(joint) for joint, _ in ends],
            end_offsets=self._floats(np.array([offset for _, offset in ends]).reshape(-1, 3)),
            controls=0 if self.rig is None else self.rig.controls.joint_count,
        )

    def _character(self, character: Character) -> messages.CharacterData:
        return messages.CharacterData(
            name=character.name,
            skeleton=self._skeleton(character.skeleton),
            parts=[self._part(p) for p in character.parts],
            morph_names=list(character.morph_names),
            rest_morph_weights=self._floats(character.rest_morph_weights),
            attributes={} if self.rig is None else {a.name: float(a.default) for a in self.rig.attributes},
            roles={role: int(joint) for role, joint in character.roles.items()},
        )

    def _part(self, part: Part) -> messages.PartData:
        mesh = part.mesh
        return messages.PartData(
            name=part.name,
            material=self._material(part.material),
            positions=self._floats(mesh.positions),
            triangles=self.body.add(mesh.triangles, "uint32"),
            normals=self._optional(mesh.normals),
            uvs=self._optional(mesh.uvs),
            colors=self._optional(mesh.colors),
            skin=None if part.skin is None else self._skin(part.skin, part.name),
            joint=part.joint,
            morphs=None if part.morphs is None else self._morphs(part.morphs, part.morph_channels),
        )

    def _material(self, material: Material) -> messages.MaterialData:
        return messages.MaterialData(
            name=material.name,
            base_color=[float(c) for c in material.base_color],
            metallic=float(material.metallic),
            roughness=float(material.roughness),
            emissive=[float(c) for c in material.emissive],
            image=self._image(material.base_color_image),
            alpha_mode=material.alpha_mode,
            alpha_cutoff=float(material.alpha_cutoff),
            double_sided=material.double_sided,
            unlit=material.unlit,
        )

    def _image(self, image: Image | None) -> int | None:
        if image is None or image.data is None:
            return None
        if id(image) not in self._image_numbers:
            self._image_numbers[id(image)] = len(self.images)
            self.images.append(messages.PictureData(image.name, image.mime_type, self.body.add_bytes(image.data)))
        return self._image_numbers[id(image)]

    def _skin(self, skin: Skin, part_name: str) -> messages.SkinData:
        if id(skin) not in self._skins:
            packed = self._packed(skin, part_name)
            if skin.method is not SkinningMethod.LINEAR:
                self.notes.append(f"view of '{part_name}': its skin asks for dual quaternions; it is shown linearly")
            self._skins[id(skin)] = messages.SkinData(
                palette=self.body.add(packed.palette, "int32"),
                joint_from_mesh=self._floats(packed.joint_from_mesh),
                joints=self.body.add(packed.joints, "uint16"),
                weights=self._floats(packed.weights),
            )
        return self._skins[id(skin)]

    def _packed(self, skin: Skin, part_name: str) -> Skin:
        count = skin.influence_count
        if count > INFLUENCES:
            from keypose import deform

            packed, report = deform.pack(skin, influences=INFLUENCES)
            self.notes.append(
                f"view of '{part_name}': {count} influences per vertex shown with {INFLUENCES} ({report})"
            )
            return packed
        if count == INFLUENCES:
            return skin
        widen = ((0, 0), (0, INFLUENCES - count))
        return Skin(skin.palette, skin.joint_from_mesh, np.pad(skin.joints, widen), np.pad(skin.weights, widen))

    def _morphs(self, morphs: MorphSet, channels: Any) -> messages.MorphData:
        return messages.MorphData(
            channels=self.body.add(channels, "int32"),
            starts=self.body.add(morphs.starts, "uint32"),
            vertices=self.body.add(morphs.vertices, "uint32"),
            position_deltas=self._floats(morphs.position_deltas),
            normal_deltas=self._optional(morphs.normal_deltas),
        )

    def _clip(self, clip: Clip) -> messages.ClipData:
        def store(array: Any) -> messages.ArrayRef:
            return self.body.add(array, _ELEMENT_OF[array.dtype.type])

        return messages.ClipData(
            kind="clip",
            name=clip.name,
            start_s=clip.start_s,
            duration_s=clip.duration_s,
            rate_hz=clip.rate_hz,
            curves=[messages.CurveData(**curve_json(channel, curve, store)) for channel, curve in clip.curves.items()],
            euler_orders=dict(clip.euler_orders),
        )

    def _motion(self, motion: Motion) -> messages.MotionData:
        pose = motion.pose
        return messages.MotionData(
            kind="motion",
            name=motion.name,
            start_s=float(motion.start_s),
            duration_s=float(motion.duration_s),
            rate_hz=float(motion.rate_hz),
            frames=motion.frame_count,
            joint_names=list(motion.joint_names),
            translations=self._frames(pose.translations),
            rotations=self._frames(pose.rotations),
            scales=self._frames(pose.scales),
            morph_names=list(motion.morph_names),
            morph_weights=self._optional(motion.morph_weights),
        )

    def _frames(self, array: Any) -> messages.ArrayRef:
        """(T, J, C), or (1, J, C) where nothing changes over time."""
        frames = np.asarray(array)
        frames = frames.reshape(-1, *frames.shape[-2:])
        if len(frames) > 1 and (
            frames.strides[0] == 0 or np.array_equal(frames, np.broadcast_to(frames[:1], frames.shape))
        ):
            frames = frames[:1]
        return self._floats(frames)
