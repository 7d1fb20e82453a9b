"""Skinning, automatic weights, morph targets, fewer influences, joints and triangles, and whole characters."""

from keypose.deform.morphing import morph, morph_absolute, morphs_from_shapes
from keypose.deform.packing import PackReport, pack
from keypose.deform.parts import deform_character, deform_part
from keypose.deform.rebinding import nearest_kept, rebind
from keypose.deform.simplify import SurfaceError, simplify, surface_error
from keypose.deform.skinning import skin, skin_matrices, skin_points, transform_normals
from keypose.deform.weights import AutomaticWeights, WeightsReport, automatic_weights, skin_character
from keypose.deform.weights_edit import limit_influences, mirror_weights, smooth_weights, transfer_weights

__all__ = [
    "AutomaticWeights",
    "PackReport",
    "SurfaceError",
    "WeightsReport",
    "automatic_weights",
    "deform_character",
    "deform_part",
    "limit_influences",
    "mirror_weights",
    "morph",
    "morph_absolute",
    "morphs_from_shapes",
    "nearest_kept",
    "pack",
    "rebind",
    "simplify",
    "skin",
    "skin_character",
    "skin_matrices",
    "skin_points",
    "smooth_weights",
    "surface_error",
    "transfer_weights",
    "transform_normals",
]
