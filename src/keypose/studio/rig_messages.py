"""A rig as the editor's page knows it, and what the page asks about it.

Rigs are part of `ProjectState` and `ProjectChanged`. What changes the project is a JSON body of ``POST api/project/rig``; poses
are containers, ``POST api/project/rig/pose`` for some and ``GET api/project/rig/track`` for a whole timeline. Transforms are ten
numbers: translation (metres), rotation (wxyz), scale.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from keypose.studio.scene_messages import ArrayRef


@dataclass(frozen=True, slots=True)
class RigControl:
    """A control: its place in the hierarchy (-1 for none above it), rest transform and looks, as `keypose.model.Control`."""

    name: str
    parent: int
    translation: list[float]
    rotation: list[float]
    scale: list[float]
    shape: Literal["circle", "square", "box", "ball", "diamond", "arrows", "pin", "foot"]
    size_m: float
    offset_m: list[float]
    side: Literal["middle", "left", "right"]
    spaces: list[str]
    space_attribute: str
    moves: list[Literal["translation", "rotation", "scale"]]


@dataclass(frozen=True, slots=True)
class RigAttribute:
    """A number of a rig, shown beside a control; keyed as a value channel of its name."""

    name: str
    control: str
    default: float
    minimum: float
    maximum: float
    choices: list[str]
    angle: bool


@dataclass(frozen=True, slots=True)
class RigModule:
    """What moves some joints; ``switch`` is the attribute that goes from FK (0) to IK (1), empty where it has none."""

    name: str
    kind: str
    joints: list[str]
    fk: list[str]
    ik: list[str]
    switch: str


@dataclass(frozen=True, slots=True)
class RigData:
    """A character's rig; ``revision`` is another for every change of it."""

    name: str
    character: str
    revision: int
    controls: list[RigControl]
    attributes: list[RigAttribute]
    modules: list[RigModule]


# ---- changes, JSON -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class RigAdd:
    """Rig a humanoid; where its timeline moves it already, that motion goes to keys on the controls."""

    type: Literal["rig_add"]
    character: str
    fit: bool


@dataclass(frozen=True, slots=True)
class RigFit:
    """Put what a character's timeline makes of its joints on its controls, as a clip of its own in that timeline."""

    type: Literal["rig_fit"]
    rig: str


@dataclass(frozen=True, slots=True)
class RigBake:
    """Put what the controls make of the joints into a clip of joints, which takes their place in the timeline."""

    type: Literal["rig_bake"]
    rig: str


@dataclass(frozen=True, slots=True)
class RigRemove:
    """Take a rig off its character; ``bake`` keeps the motion, as keys on joints."""

    type: Literal["rig_remove"]
    rig: str
    bake: bool


RigAsked = RigAdd | RigFit | RigBake | RigRemove


# ---- poses, containers -------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class RigPoseRequest:
    """Header: what some of a rig's controls and numbers give, (B) poses at once.

    ``controls`` (B, N, 10) and ``joints`` (B, J, 10) are local transforms, ``values`` (B, A) the attributes in the rig's order, all float64.
    ``wish`` changes the controls before: the IK side is put where FK is or the other way round in ``modules`` (all where
    empty), or ``control`` goes to its space number ``space`` and stays where it is, or left and right change places.
    """

    type: Literal["rig_pose"]
    rig: str
    controls: ArrayRef
    joints: ArrayRef
    values: ArrayRef
    wish: Literal["none", "match_ik_to_fk", "match_fk_to_ik", "switch_space", "mirror"]
    modules: list[str]
    control: str
    space: int


@dataclass(frozen=True, slots=True)
class RigPosed:
    """Header of the answer, and of a track.

    ``joints`` (B, J, 10) local; ``controls`` and ``values`` as asked, changed by the wish (null in a track);
    ``model_from_control`` and ``model_from_frame`` (B, N, 4, 4), row by row: where controls are, and what their local transforms
    are relative to; ``keyed``: whether a track's timeline has keys on the rig at all; else the joints are its own.
    """

    type: Literal["rig_posed"]
    rig: str
    revision: int
    keyed: bool
    start_s: float
    rate_hz: float
    joints: ArrayRef
    model_from_control: ArrayRef
    model_from_frame: ArrayRef
    controls: ArrayRef | None
    values: ArrayRef | None
