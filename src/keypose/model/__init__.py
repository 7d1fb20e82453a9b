"""Frozen data types: skeletons, poses, motions, curves, clips, meshes, skins, characters, markers, labels, scenes."""

import copyreg
from types import MappingProxyType
from typing import Any

from keypose.model.character import Character, Part, Scene
from keypose.model.curve import (
    EULER_ORDER,
    ROTATION_ONLY,
    Channel,
    Clip,
    Curve,
    CurveKind,
    Extrapolation,
    Interpolation,
    Property,
    Tangent,
)
from keypose.model.document import Document, StoredPose
from keypose.model.labels import Tier
from keypose.model.markers import ForcePlate, Markers, Signals
from keypose.model.mesh import Image, Material, Mesh, MorphSet, Skin, SkinningMethod
from keypose.model.pose import Event, Motion, Pose
from keypose.model.skeleton import Skeleton
from keypose.model.timeline import Layer, LayerMode, Marker, Placement, Timeline

__all__ = [
    "EULER_ORDER",
    "ROTATION_ONLY",
    "Channel",
    "Character",
    "Clip",
    "Curve",
    "CurveKind",
    "Document",
    "Event",
    "Extrapolation",
    "ForcePlate",
    "Image",
    "Interpolation",
    "Layer",
    "LayerMode",
    "Marker",
    "Markers",
    "Material",
    "Mesh",
    "MorphSet",
    "Motion",
    "Part",
    "Placement",
    "Pose",
    "Property",
    "Scene",
    "Signals",
    "Skeleton",
    "Skin",
    "SkinningMethod",
    "StoredPose",
    "Tangent",
    "Tier",
    "Timeline",
]


def _read_only(items: dict[Any, Any]) -> MappingProxyType[Any, Any]:
    return MappingProxyType(items)


# Read-only mappings travel to process pools, as the arrays beside them do.
copyreg.pickle(MappingProxyType, lambda mapping: (_read_only, (dict(mapping),)))  # pyright: ignore[reportArgumentType]
