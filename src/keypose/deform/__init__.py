"""Skinning, morph targets, packing to a few influences, and whole characters."""

from keypose.deform.morphing import morph, morph_absolute, morphs_from_shapes
from keypose.deform.packing import PackReport, pack
from keypose.deform.parts import deform_character, deform_part
from keypose.deform.skinning import METHODS, Method, skin, skin_matrices, skin_points, transform_normals

__all__ = [
    "METHODS",
    "Method",
    "PackReport",
    "deform_character",
    "deform_part",
    "morph",
    "morph_absolute",
    "morphs_from_shapes",
    "pack",
    "skin",
    "skin_matrices",
    "skin_points",
    "transform_normals",
]
