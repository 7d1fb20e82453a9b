"""Document: all that a project holds; what its file stores and what editing changes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np

from keypose.arrays import checked, frozen
from keypose.errors import ShapeError, UnknownName
from keypose.model.character import Character
from keypose.model.curve import Clip
from keypose.model.pose import Pose
from keypose.model.rig import Rig
from keypose.model.timeline import Timeline


def _nothing() -> Mapping[str, Any]:
    return {}


def _no_pose() -> Pose:
    return Pose(np.zeros((0, 3)), np.zeros((0, 4)), np.ones((0, 3)))


@dataclass(frozen=True, slots=True, eq=False)
class StoredPose:
    """A pose of the library: local transforms of some joints and weights of some morphs, by name.

    Shapes and units: ``pose`` of batch shape () with a joint for each of ``joint_names``, kept in float64.
    """

    name: str
    joint_names: tuple[str, ...] = ()
    pose: Pose = field(default_factory=_no_pose)
    morphs: Mapping[str, float] = field(default_factory=_nothing)

    def __post_init__(self) -> None:
        object.__setattr__(self, "joint_names", tuple(self.joint_names))
        if len(set(self.joint_names)) != len(self.joint_names):
            twice = next(n for n in self.joint_names if self.joint_names.count(n) > 1)
            raise ShapeError(f"pose '{self.name}': joint '{twice}' appears more than once")
        pose = self.pose
        checked(pose.rotations, (len(self.joint_names), 4), "pose", f"the joint names of pose '{self.name}'")
        checked(pose.translations, (len(self.joint_names), 3), "pose", f"the joint names of pose '{self.name}'")
        checked(pose.scales, (len(self.joint_names), 3), "pose", f"the joint names of pose '{self.name}'")
        parts = (frozen(a, np.float64) for a in (pose.translations, pose.rotations, pose.scales))
        object.__setattr__(self, "pose", Pose(*parts))
        object.__setattr__(self, "morphs", MappingProxyType({n: float(w) for n, w in self.morphs.items()}))


_NAMED = ("characters", "clips", "timelines", "poses", "rigs")


@dataclass(frozen=True, slots=True, eq=False)
class Document:
    """Characters, clips, timelines, poses and rigs by name, and which timeline moves which character.

    The placements of timelines name clips; ``performs`` is character -> timeline; a rig names the character that it moves, and a
    character has one rig at most. ``settings`` are texts, numbers and
    truths that an editor keeps with the project. Nothing is ever changed in place, so two documents share what they have
    in common, and keeping many costs little.

    Raises:
        ShapeError: where something is kept under another name than its own.
    """

    name: str = ""
    characters: Mapping[str, Character] = field(default_factory=_nothing)
    clips: Mapping[str, Clip] = field(default_factory=_nothing)
    timelines: Mapping[str, Timeline] = field(default_factory=_nothing)
    poses: Mapping[str, StoredPose] = field(default_factory=_nothing)
    performs: Mapping[str, str] = field(default_factory=_nothing)
    settings: Mapping[str, str | float | bool] = field(default_factory=_nothing)
    rigs: Mapping[str, Rig] = field(default_factory=_nothing)

    def __post_init__(self) -> None:
        for kind in _NAMED:
            kept: Mapping[str, Any] = MappingProxyType(dict(getattr(self, kind)))
            for name, value in kept.items():
                if value.name != name:
                    raise ShapeError(f"{kind}: '{value.name}' is kept under the name '{name}'")
            object.__setattr__(self, kind, kept)
        for kind in ("performs", "settings"):
            object.__setattr__(self, kind, MappingProxyType(dict(getattr(self, kind))))

    def character(self, name: str) -> Character:
        """One character; raises `UnknownName` with the nearest."""
        return _found("character", name, self.characters)

    def clip(self, name: str) -> Clip:
        """One clip; raises `UnknownName` with the nearest."""
        return _found("clip", name, self.clips)

    def timeline(self, name: str) -> Timeline:
        """One timeline; raises `UnknownName` with the nearest."""
        return _found("timeline", name, self.timelines)

    def pose(self, name: str) -> StoredPose:
        """One pose of the library; raises `UnknownName` with the nearest."""
        return _found("pose", name, self.poses)

    def rig(self, name: str) -> Rig:
        """One rig; raises `UnknownName` with the nearest."""
        return _found("rig", name, self.rigs)

    def rig_of(self, character: str) -> Rig | None:
        """The rig that moves a character, or None where it has none."""
        return next((rig for rig in self.rigs.values() if rig.character == character), None)


def _found(kind: str, name: str, known: Mapping[str, Any]) -> Any:
    if name not in known:
        raise UnknownName(kind, name, known)
    return known[name]
