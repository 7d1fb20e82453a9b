"""Skinning, morph targets, fewer influences, joints and triangles, and whole characters."""

from keypose.deform.morphing import morph, morph_absolute, morphs_from_shapes
from keypose.deform.packing import PackReport, pack
from keypose.deform.parts import deform_character, deform_part
from keypose.deform.rebinding import nearest_kept, rebind
from keypose.deform.simplify import SurfaceError, simplify, surface_error
from keypose.deform.skinning import skin, skin_matrices, skin_points, transform_normals

__all__ = [
    "PackReport",
    "SurfaceError",
    "deform_character",
    "deform_part",
    "morph",
    "morph_absolute",
    "morphs_from_shapes",
    "nearest_kept",
    "pack",
    "rebind",
    "simplify",
    "skin",
    "skin_matrices",
    "skin_points",
    "surface_error",
    "transform_normals",
]
