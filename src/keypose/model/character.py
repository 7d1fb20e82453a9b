"""Character: a skeleton with the parts that hang on it; Scene: what a file holds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np

from keypose.arrays import Array, Ints, as_float, checked, frozen
from keypose.errors import ShapeError, UnknownName
from keypose.model.curve import Clip
from keypose.model.labels import Tier
from keypose.model.markers import ForcePlate, Markers, Signals
from keypose.model.mesh import Material, Mesh, MorphSet, Skin
from keypose.model.pose import Motion
from keypose.model.skeleton import Skeleton


def _nothing() -> Mapping[str, Any]:
    return {}


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """One mesh of a character: skinned, or rigidly bound to one joint.

    Exactly one binding holds: ``skin`` (the mesh is in the skin's mesh space), or ``joint`` (the mesh is in that
    joint's space).

    ``morph_channels`` (M,) says which of the character's morph channels drives each target of ``morphs``.
    ``group`` numbers the parts that came from one mesh of several materials; they share their morph weights.
    """

    name: str
    mesh: Mesh
    material: Material = field(default_factory=Material)
    skin: Skin | None = None
    joint: int | None = None
    morphs: MorphSet | None = None
    morph_channels: Ints | None = None
    group: int = 0
    extras: Mapping[str, Any] = field(default_factory=_nothing)

    def __post_init__(self) -> None:
        if (self.skin is None) == (self.joint is None):
            raise ShapeError(f"part '{self.name}': expected either a skin or a joint")
        if self.skin is not None and len(self.skin.joints) != self.mesh.vertex_count:
            raise ShapeError(
                f"part '{self.name}': the skin binds {len(self.skin.joints)} vertices, the mesh has {self.mesh.vertex_count}"
            )
        if self.morphs is not None:
            vertices = self.morphs.vertices
            if len(vertices) and (vertices.min() < 0 or vertices.max() >= self.mesh.vertex_count):
                raise ShapeError(
                    f"part '{self.name}': a morph target moves vertex {int(vertices.max())}, the mesh has {self.mesh.vertex_count}"
                )
            channels = np.arange(len(self.morphs.names)) if self.morph_channels is None else self.morph_channels
            channels = frozen(channels, np.int32)
            checked(channels, (len(self.morphs.names),), "morph_channels", f"the morphs of part '{self.name}'")
            object.__setattr__(self, "morph_channels", channels)


@dataclass(frozen=True, slots=True, eq=False)
class Character:
    """A skeleton, the parts that hang on it, its morph channels and the roles of its joints.

    Shapes and units:
        morph_names: M channel names; ``rest_morph_weights`` (M,), zeros if not given.
        roles: role ("hips", "left_hand") -> joint index.
    """

    skeleton: Skeleton
    parts: tuple[Part, ...] = ()
    name: str = ""
    morph_names: tuple[str, ...] = ()
    rest_morph_weights: Array | None = None
    roles: Mapping[str, int] = field(default_factory=_nothing)
    extras: Mapping[str, Any] = field(default_factory=_nothing)

    def __post_init__(self) -> None:
        object.__setattr__(self, "parts", tuple(self.parts))
        object.__setattr__(self, "morph_names", tuple(self.morph_names))
        object.__setattr__(self, "roles", MappingProxyType(dict(self.roles)))
        weights = (
            np.zeros(len(self.morph_names), np.float32) if self.rest_morph_weights is None else self.rest_morph_weights
        )
        weights = checked(as_float(weights), (len(self.morph_names),), "rest_morph_weights", "morph_names")
        object.__setattr__(self, "rest_morph_weights", frozen(weights))
        joints, morphs = self.skeleton.joint_count, len(self.morph_names)
        for part in self.parts:
            used = [part.joint] if part.skin is None else part.skin.palette.tolist()
            for joint in used:
                if joint is None or not 0 <= joint < joints:
                    raise ShapeError(f"part '{part.name}': joint {joint} does not exist; the skeleton has {joints}")
            channels = part.morph_channels
            if channels is not None and len(channels) and not (channels.min() >= 0 and channels.max() < morphs):
                raise ShapeError(f"part '{part.name}': morph channel {int(channels.max())} of {morphs}")
        for role, joint in self.roles.items():
            if not 0 <= joint < joints:
                raise ShapeError(f"role '{role}': joint {joint} does not exist; the skeleton has {joints}")

    def morph_index(self, name: str) -> int:
        """The channel's index; raises `UnknownName` with the nearest name."""
        if name not in self.morph_names:
            raise UnknownName("morph", name, self.morph_names)
        return self.morph_names.index(name)

    @property
    def vertex_count(self) -> int:
        """Vertices of all parts."""
        return sum(p.mesh.vertex_count for p in self.parts)

    @property
    def triangle_count(self) -> int:
        """Triangles of all parts."""
        return sum(len(p.mesh.triangles) for p in self.parts)


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """What a file holds, in keypose's conventions, with notes of everything that was guessed, repaired or dropped.

    ``unit_m`` (metres per file unit) and ``up`` ("X", "Y" or "Z") describe the file as it was written;
    the data here is in metres with Y up.
    """

    characters: tuple[Character, ...] = ()
    animations: tuple[Clip | Motion, ...] = ()
    format: str = ""
    unit_m: float = 1.0
    up: str = "Y"
    notes: tuple[str, ...] = ()
    extras: Mapping[str, Any] = field(default_factory=_nothing)
    markers: tuple[Markers, ...] = ()
    signals: tuple[Signals, ...] = ()
    plates: tuple[ForcePlate, ...] = ()
    tiers: tuple[Tier, ...] = ()

    def __post_init__(self) -> None:
        for name in ("characters", "animations", "notes", "markers", "signals", "plates", "tiers"):
            object.__setattr__(self, name, tuple(getattr(self, name)))

    @property
    def character(self) -> Character:
        """The first character; raises `UnknownName` where there is none."""
        if not self.characters:
            raise UnknownName("character", "first", ())
        return self.characters[0]

    def animation(self, name: str | None = None) -> Clip | Motion:
        """The animation of that name, or the first; raises `UnknownName`."""
        names = [a.name for a in self.animations]
        if name is None and self.animations:
            return self.animations[0]
        if name not in names:
            raise UnknownName("clip", name or "first", names)
        return self.animations[names.index(name)]
