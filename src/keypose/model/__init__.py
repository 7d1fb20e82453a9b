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
from keypose.model.rig import (
    Attribute,
    Constraint,
    ConstraintKind,
    Control,
    ControlShape,
    ControlSide,
    Driver,
    EyesModule,
    Finger,
    FingersModule,
    FollowModule,
    FootPivots,
    HeadModule,
    LimbModule,
    Module,
    Rig,
    Space,
    SpineModule,
    Twist,
    TwistModule,
    module_controls,
    module_joints,
)
from keypose.model.skeleton import Skeleton
from keypose.model.timeline import Layer, LayerMode, Marker, Placement, Timeline

__all__ = [
    "EULER_ORDER",
    "ROTATION_ONLY",
    "Attribute",
    "Channel",
    "Character",
    "Clip",
    "Constraint",
    "ConstraintKind",
    "Control",
    "ControlShape",
    "ControlSide",
    "Curve",
    "CurveKind",
    "Document",
    "Driver",
    "Event",
    "Extrapolation",
    "EyesModule",
    "Finger",
    "FingersModule",
    "FollowModule",
    "FootPivots",
    "ForcePlate",
    "HeadModule",
    "Image",
    "Interpolation",
    "Layer",
    "LayerMode",
    "LimbModule",
    "Marker",
    "Markers",
    "Material",
    "Mesh",
    "Module",
    "MorphSet",
    "Motion",
    "Part",
    "Placement",
    "Pose",
    "Property",
    "Rig",
    "Scene",
    "Signals",
    "Skeleton",
    "Skin",
    "SkinningMethod",
    "Space",
    "SpineModule",
    "StoredPose",
    "Tangent",
    "Tier",
    "Timeline",
    "Twist",
    "TwistModule",
    "module_controls",
    "module_joints",
]


def _read_only(items: dict[Any, Any]) -> MappingProxyType[Any, Any]:
    return MappingProxyType(items)


# Read-only mappings travel to process pools, as the arrays beside them do.
copyreg.pickle(MappingProxyType, lambda mapping: (_read_only, (dict(mapping),)))  # pyright: ignore[reportArgumentType]
