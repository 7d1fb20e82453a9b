"""What both backends draw: one `Surface` per part, with its picture decoded and its weights made ready."""

from __future__ import annotations

import io
from dataclasses import dataclass

import numpy as np

from keypose.arrays import Floats, Ints
from keypose.model import Character, Image, Material, Part
from keypose.render.settings import Picture
from keypose.render.stage import Drawn, Moment, Stage

_MAX_TEXTURE = 2048  # pixels along one side; larger pictures are reduced
_MAX_PIXELS = 1 << 26  # an encoded picture that claims more is not decoded


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """One part as it is drawn.

    Shapes and units:
        drawn: index into ``stage.drawn`` and into the lists of a `Moment`.
        texture: (H, W, 4) uint8 sRGB, or None.
        palette: (P,) joints of the character.
        joint_from_mesh: (P, 4, 4).
        joints, weights: (V, 4) or (V, 8) influences.
    """

    drawn: int
    cast: Drawn
    character: Character
    part: Part
    texture: Picture | None
    palette: Ints
    joint_from_mesh: Floats
    joints: Ints
    weights: Floats

    @property
    def material(self) -> Material:
        """The part's material."""
        return self.part.material

    @property
    def blended(self) -> bool:
        """Whether what is behind shows through."""
        return self.material.alpha_mode == "BLEND" or self.cast.ghost > 0

    @property
    def casts_shadow(self) -> bool:
        """Ghosts, overlays and glass throw none."""
        return not (self.blended or self.cast.overlay)

    def palette_matrices(self, moment: Moment) -> Floats:
        """World-from-mesh matrices of the part's palette, (P, 4, 4) float32."""
        return moment.matrices[self.drawn][self.palette] @ self.joint_from_mesh

    def mirrored(self, moment: Moment) -> bool:
        """Whether the part is scaled by an odd number of negative factors, which turns its triangles' winding round."""
        matrix = (
            moment.matrices[self.drawn][self.palette[0]] @ self.joint_from_mesh[0] if len(self.palette) else np.eye(4)
        )
        return bool(np.linalg.det(matrix[:3, :3]) < 0)

    def morph_weights(self, moment: Moment) -> Floats:
        """Weights of the part's own targets, (M,)."""
        return moment.morph_weights[self.drawn][self.part.morph_channels]


def surfaces(stage: Stage) -> list[Surface]:
    """Everything that is drawn, in the order of the stage."""
    pictures: dict[int, Picture | None] = {}
    found: list[Surface] = []
    for index, drawn in enumerate(stage.drawn):
        character = stage.character(drawn)
        for part in character.parts:
            if not len(part.mesh.triangles):
                continue
            image = part.material.base_color_image if part.mesh.uvs is not None else None
            if image is not None and id(image) not in pictures:
                pictures[id(image)] = decode_image(image)
            texture = None if image is None else pictures[id(image)]
            found.append(Surface(index, drawn, character, part, texture, *_binding(part)))
    return found


def decode_image(image: Image) -> Picture | None:
    """(H, W, 4) uint8 of an encoded picture; None for one that is missing, damaged or absurdly large."""
    if not image.data:
        return None
    from PIL import Image as Pillow

    try:
        with Pillow.open(io.BytesIO(image.data)) as picture:
            if picture.width * picture.height > _MAX_PIXELS:
                return None
            converted = picture.convert("RGBA")
            if max(converted.size) > _MAX_TEXTURE:
                scale = _MAX_TEXTURE / max(converted.size)
                size = (max(1, round(converted.width * scale)), max(1, round(converted.height * scale)))
                converted = converted.resize(size, Pillow.Resampling.LANCZOS)
            return np.asarray(converted, np.uint8)
    except (OSError, ValueError, SyntaxError, Pillow.DecompressionBombError):
        return None  # Pillow's ways to say that the bytes are no picture


def _binding(part: Part) -> tuple[Ints, Floats, Ints, Floats]:
    """Palette, inverse bind matrices and four or eight influences per vertex (more are left out, smallest first)."""
    count = part.mesh.vertex_count
    if part.skin is None:
        return (
            np.array([part.joint], np.int32),
            np.eye(4, dtype=np.float32)[None],
            np.zeros((count, 4), np.int32),
            np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1)),
        )
    skin = part.skin
    joints, weights = np.asarray(skin.joints), np.asarray(skin.weights, np.float32)
    used = weights.shape[1]
    if used > 4:
        order = np.argsort(-weights, axis=1, kind="stable")
        joints, weights = np.take_along_axis(joints, order, 1), np.take_along_axis(weights, order, 1)
        used = 4 if not np.any(weights[:, 4:]) else 8
        kept = weights[:, :used]
        totals, whole = kept.sum(axis=1, keepdims=True), weights.sum(axis=1, keepdims=True)
        weights = kept * (whole / np.where(totals > 0, totals, 1))
        joints = joints[:, :used]
    width = 4 if used <= 4 else 8
    missing = width - weights.shape[1]
    return (
        np.asarray(skin.palette, np.int32),
        np.asarray(skin.joint_from_mesh, np.float32),
        np.pad(joints, ((0, 0), (0, missing))).astype(np.int32),
        np.pad(weights, ((0, 0), (0, missing))).astype(np.float32),
    )
