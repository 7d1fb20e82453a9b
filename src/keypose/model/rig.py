"""Rig: the controls that an animator moves in place of joints, and how joints follow them.

Controls are a `Skeleton` of their own, so that poses, clips, layers and curves know them without knowing rigs; their names
are never those of joints. Numbers beside them (FK or IK, a foot's roll, the space of a hand) are `Attribute`s, keyed as
`Property.VALUE` channels. A module moves some joints by some controls; what no module moves stays as the timeline's own
joint channels put it. Everything names controls and joints, so that a rig can be stored, and a person can write one.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum
from typing import TypeAlias

from keypose.errors import ShapeError, UnknownName
from keypose.model.curve import Channel, Curve, CurveKind, Property
from keypose.model.skeleton import Skeleton

Vector: TypeAlias = tuple[float, float, float]


class ControlShape(Enum):
    """How a control is drawn; flat shapes lie across the control's Y axis."""

    CIRCLE = "circle"
    SQUARE = "square"
    BOX = "box"
    BALL = "ball"
    DIAMOND = "diamond"
    ARROWS = "arrows"  # four ways over the ground
    PIN = "pin"  # a line along Y with a ball at its end
    FOOT = "foot"  # the outline of a sole


class ControlSide(Enum):
    """The side of the body, which gives a control its colour."""

    MIDDLE = "middle"
    LEFT = "left"
    RIGHT = "right"


@dataclass(frozen=True, slots=True)
class Space:
    """What carries a control: another control or a joint, named by ``target``, or the world where that is empty."""

    name: str
    target: str = ""


@dataclass(frozen=True, slots=True)
class Control:
    """How one control looks and what it may do.

    Units:
        size_m: half the width of its shape; offset_m: the shape's centre in the control's own axes.
        spaces: what may carry it, the first by default; none for its parent in the hierarchy of controls. Of several, the
            attribute ``NAME.space`` gives the number. Where a rig has attributes ``NAME.space.LABEL``, they are weights (0..1)
            with which several carry it at once; the space of that number takes what they leave of 1.
        moves: what a person sets; the rest stays at rest.
    """

    name: str
    shape: ControlShape = ControlShape.CIRCLE
    size_m: float = 0.1
    offset_m: Vector = (0.0, 0.0, 0.0)
    side: ControlSide = ControlSide.MIDDLE
    spaces: tuple[Space, ...] = ()
    moves: tuple[Property, ...] = (Property.TRANSLATION, Property.ROTATION)

    def __post_init__(self) -> None:
        object.__setattr__(self, "spaces", tuple(self.spaces))
        object.__setattr__(self, "moves", tuple(self.moves))
        object.__setattr__(self, "offset_m", _vector(self.offset_m, f"offset_m of control '{self.name}'"))
        if not (math.isfinite(self.size_m) and self.size_m > 0):
            raise ShapeError(f"control '{self.name}': expected a size above 0 m, got {self.size_m}")
        _unique((s.name for s in self.spaces), f"control '{self.name}': space")

    @property
    def space_attribute(self) -> str:
        """The name of the attribute that says which space carries it."""
        return f"{self.name}.space"

    def weight_attribute(self, space: str) -> str:
        """The name of the attribute that says how much one of its spaces carries it, if the rig has it."""
        return f"{self.space_attribute}.{space}"


@dataclass(frozen=True, slots=True)
class Attribute:
    """A named number of a rig, shown beside a control.

    ``choices`` names the values 0, 1, 2 ... where only those make sense. Angles are in radians (``angle``).
    """

    name: str
    control: str
    default: float = 0.0
    minimum: float = 0.0
    maximum: float = 1.0
    choices: tuple[str, ...] = ()
    angle: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "choices", tuple(self.choices))
        for name in ("default", "minimum", "maximum"):
            if not math.isfinite(getattr(self, name)):
                raise ShapeError(f"attribute '{self.name}': expected a finite {name}, got {getattr(self, name)}")
        if not self.minimum <= self.default <= self.maximum:
            raise ShapeError(
                f"attribute '{self.name}': expected a default of {self.minimum}..{self.maximum}, got {self.default}"
            )


# ---- modules -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class FollowModule:
    """Each joint goes where its control goes: the pelvis, shoulders, a jaw, tails.

    ``carrier`` is a control above the first one that takes the motion when a rig is fitted to it, where that is wanted: the
    pelvis that carries the whole body, above the swing of the hips alone.
    """

    name: str
    joints: tuple[str, ...]
    controls: tuple[str, ...]
    carrier: str = ""

    def __post_init__(self) -> None:
        _pairs(self)


@dataclass(frozen=True, slots=True)
class FootPivots:
    """What a foot turns about when it stands, in the rest pose's model space, metres.

    The toes' control moves the toes' joint with FK and IK alike; both are empty where the foot has no toes. Attributes, under
    ``name``: ``roll`` (below 0 about the heel, above about the ball, beyond ``roll_break`` about the tip), ``bank``,
    ``heel``, ``ball``, ``tip``, ``swivel``, all radians.
    """

    name: str
    heel: Vector
    ball: Vector
    tip: Vector
    left: Vector
    right: Vector
    toes_joint: str = ""
    toes_control: str = ""

    def __post_init__(self) -> None:
        for name in ("heel", "ball", "tip", "left", "right"):
            object.__setattr__(self, name, _vector(getattr(self, name), f"{name} of foot '{self.name}'"))
        if bool(self.toes_joint) != bool(self.toes_control):
            raise ShapeError(f"foot '{self.name}': toes_joint and toes_control belong together")

    def attribute(self, what: str) -> str:
        """The name of one of its attributes."""
        return f"{self.name}.{what}"


@dataclass(frozen=True, slots=True)
class LimbModule:
    """An arm or a leg: three joints that follow three FK controls, or reach for a goal and bend towards a pole.

    Attributes, under ``name``: ``ik`` (0 FK to 1 IK), ``stretch`` (0..1, longer bones where the goal is out of reach), ``soft``
    (share of the length over which it slows down before it is straight), ``twist`` and ``lower_twist`` (radians that the two
    bones turn about themselves), and ``rest_bend`` (0..1), if there is one: a limb whose middle joint lies at rest where the pole
    would not have it, such as a knee bent backwards a little, keeps that near its rest reach.
    """

    name: str
    joints: tuple[str, str, str]
    controls: tuple[str, str, str]
    goal: str
    pole: str
    foot: FootPivots | None = None

    def __post_init__(self) -> None:
        _pairs(self, 3)

    def attribute(self, what: str) -> str:
        """The name of one of its attributes."""
        return f"{self.name}.{what}"


@dataclass(frozen=True, slots=True)
class SpineModule:
    """A chain from above the pelvis to the chest: FK controls, and one goal that bends and turns what they give.

    Attributes, under ``name``: ``ik`` (0..1), ``stretch`` (0..1: how far it grows or shrinks to meet the goal's place).
    """

    name: str
    joints: tuple[str, ...]
    controls: tuple[str, ...]
    goal: str

    def __post_init__(self) -> None:
        _pairs(self)

    def attribute(self, what: str) -> str:
        """The name of one of its attributes."""
        return f"{self.name}.{what}"


@dataclass(frozen=True, slots=True)
class HeadModule:
    """Neck and head: FK controls, turned towards a target by the attribute ``NAME.look`` (0..1).

    ``shares`` says how much of the turn that is left each joint takes; the last takes all of it.
    """

    name: str
    joints: tuple[str, ...]
    controls: tuple[str, ...]
    target: str
    shares: tuple[float, ...]

    def __post_init__(self) -> None:
        _pairs(self)
        object.__setattr__(self, "shares", tuple(float(s) for s in self.shares))
        if len(self.shares) != len(self.joints) or not all(0 <= s <= 1 for s in self.shares):
            raise ShapeError(f"module '{self.name}': expected a share of 0..1 for each of {len(self.joints)} joints")

    def attribute(self, what: str) -> str:
        """The name of one of its attributes."""
        return f"{self.name}.{what}"


@dataclass(frozen=True, slots=True)
class EyesModule:
    """Eyes that look at targets by the attribute ``NAME.look`` (0..1); at 0 they stay as joint channels put them."""

    name: str
    joints: tuple[str, ...]
    controls: tuple[str, ...]

    def __post_init__(self) -> None:
        _pairs(self)

    def attribute(self, what: str) -> str:
        """The name of one of its attributes."""
        return f"{self.name}.{what}"


@dataclass(frozen=True, slots=True)
class Finger:
    """A finger: bones from the hand outwards. Its controls bend about +X; ``spread`` is its part of the hand's fan.

    Its attribute ``NAME.curl`` is 0 straight as at rest, 1 closed; ``bends`` are the radians of each bone at 1.
    """

    name: str
    joints: tuple[str, ...]
    controls: tuple[str, ...]
    bends: tuple[float, ...]
    spread: float = 0.0

    def __post_init__(self) -> None:
        _pairs(self)
        object.__setattr__(self, "bends", tuple(float(b) for b in self.bends))
        if len(self.bends) != len(self.joints):
            raise ShapeError(f"finger '{self.name}': expected {len(self.joints)} bends, got {len(self.bends)}")


@dataclass(frozen=True, slots=True)
class FingersModule:
    """The fingers of a hand. Attributes under ``name``: ``curl`` of all and ``spread`` (radians), and each finger's curl."""

    name: str
    hand: str
    fingers: tuple[Finger, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "fingers", tuple(self.fingers))

    @property
    def joints(self) -> tuple[str, ...]:
        """All joints, finger by finger."""
        return tuple(joint for finger in self.fingers for joint in finger.joints)

    @property
    def controls(self) -> tuple[str, ...]:
        """All controls, finger by finger."""
        return tuple(control for finger in self.fingers for control in finger.controls)

    def attribute(self, what: str) -> str:
        """The name of one of its attributes."""
        return f"{self.name}.{what}"


@dataclass(frozen=True, slots=True)
class Twist:
    """A joint that takes a share (0..1) of the roll along a bone.

    The roll is that of ``end`` beyond the bone (a hand on its forearm), or, where ``end`` is empty, of the bone in its own socket.
    """

    joint: str
    bone: str
    end: str = ""
    share: float = 0.5
    axis: Vector = (0.0, 1.0, 0.0)
    """Along the bone, in its joint's own axes."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "axis", _vector(self.axis, f"axis of twist '{self.joint}'"))
        if not any(self.axis) or not 0 <= self.share <= 1:
            raise ShapeError(f"twist '{self.joint}': expected an axis with a direction and a share of 0..1")


@dataclass(frozen=True, slots=True)
class TwistModule:
    """Joints of twist, which follow by the attribute ``NAME.follow`` (0..1); at 0 they stay as joint channels put them."""

    name: str
    twists: tuple[Twist, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "twists", tuple(self.twists))

    @property
    def joints(self) -> tuple[str, ...]:
        """The joints that it turns."""
        return tuple(twist.joint for twist in self.twists)

    @property
    def controls(self) -> tuple[str, ...]:
        """It has none."""
        return ()

    def attribute(self, what: str) -> str:
        """The name of one of its attributes."""
        return f"{self.name}.{what}"


Module: TypeAlias = FollowModule | LimbModule | SpineModule | HeadModule | EyesModule | FingersModule | TwistModule


# ---- constraints and drivers -------------------------------------------------------------------------------------------


class ConstraintKind(Enum):
    """What a constraint does to its owner, in model space."""

    COPY_POSITION = "copy_position"
    COPY_ROTATION = "copy_rotation"
    COPY_SCALE = "copy_scale"
    LIMIT_POSITION = "limit_position"  # metres in model space
    LIMIT_ROTATION = "limit_rotation"  # XYZ angles of the local rotation, out of rest
    LIMIT_SCALE = "limit_scale"  # of the local scale
    AIM = "aim"
    PARENT = "parent"


_LIMITS = (ConstraintKind.LIMIT_POSITION, ConstraintKind.LIMIT_ROTATION, ConstraintKind.LIMIT_SCALE)


@dataclass(frozen=True, slots=True)
class Constraint:
    """A control or joint held by others.

    Units:
        owner: the control or joint that is moved; on a joint, what hangs on it follows.
        targets: names of controls or joints; shares: their part each, equal where empty. Limits have none.
        weight: 0..1, times the value of ``weight_attribute`` where that is named.
        keep_offset: whether the owner keeps its place to the targets at rest.
        axes: which of x, y, z are copied or limited.
        low, high: of limits, metres, radians or factors.
        aim_axis, up_axis: of AIM, in the owner's own axes; it turns the short way where ``up_axis`` is None, else that
            axis turns towards ``up`` (model space).
    """

    name: str
    kind: ConstraintKind
    owner: str
    targets: tuple[str, ...] = ()
    shares: tuple[float, ...] = ()
    weight: float = 1.0
    weight_attribute: str = ""
    keep_offset: bool = True
    axes: tuple[bool, bool, bool] = (True, True, True)
    low: Vector = (-math.inf, -math.inf, -math.inf)
    high: Vector = (math.inf, math.inf, math.inf)
    aim_axis: Vector = (0.0, 1.0, 0.0)
    up_axis: Vector | None = None
    up: Vector = (0.0, 1.0, 0.0)

    def __post_init__(self) -> None:
        for name in ("targets", "shares", "axes", "low", "high"):
            object.__setattr__(self, name, tuple(getattr(self, name)))
        what = f"constraint '{self.name}'"
        if self.kind in _LIMITS:
            if self.targets:
                raise ShapeError(f"{what}: a limit has no targets")
            if (
                len(self.low) != 3
                or len(self.high) != 3
                or not all(a <= b for a, b in zip(self.low, self.high, strict=True))
            ):
                raise ShapeError(f"{what}: expected three numbers each, low at most high")
        elif not self.targets:
            raise ShapeError(f"{what}: expected at least one target")
        if self.shares and (len(self.shares) != len(self.targets) or min(self.shares) < 0 or sum(self.shares) <= 0):
            raise ShapeError(f"{what}: expected a share of 0 or more for each of {len(self.targets)} targets")
        if not 0 <= self.weight <= 1:
            raise ShapeError(f"{what}: expected a weight of 0..1, got {self.weight}")
        if len(self.axes) != 3:
            raise ShapeError(f"{what}: expected three axes, got {len(self.axes)}")
        for name in ("aim_axis", "up_axis", "up"):
            if getattr(self, name) is not None:
                axis = _vector(getattr(self, name), f"{name} of {what}")
                object.__setattr__(self, name, axis)
                if not any(axis):
                    raise ShapeError(f"{what}: {name} has no direction")


@dataclass(frozen=True, slots=True, eq=False)
class Driver:
    """A channel whose value is computed from others.

    ``expression`` is arithmetic over attributes (``foot.L.roll``), controls (``hand_ik.L.translation.y``) and joints
    (``{LeftHand}.twist.x``); a name that is no plain word stands in braces. With a ``curve`` (scalar), the expression is what the
    curve is looked up at: driven keys.

    A VALUE or WEIGHT is replaced by the result; a component of a TRANSLATION or EULER (about that axis) is added to what the
    control or joint does otherwise. What reads joints is computed last and may drive joints and morphs only.
    """

    channel: Channel
    expression: str
    curve: Curve | None = None

    def __post_init__(self) -> None:
        needs = self.channel.property in (Property.TRANSLATION, Property.EULER)
        if needs != (self.channel.component is not None) or self.channel.property in (
            Property.ROTATION,
            Property.SCALE,
        ):
            raise ShapeError(
                f"driver of {self.channel}: expected a value, a morph's weight, or one component of a translation or of angles"
            )
        if self.curve is not None and self.curve.kind is not CurveKind.SCALAR:
            raise ShapeError(f"driver of {self.channel}: expected a SCALAR curve, got {self.curve.kind.name}")


# ---- the rig -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class Rig:
    """The controls of a character.

    Shapes and units:
        controls: N controls with their rest transforms in model space (metres), parents before children.
        looks: a `Control` for each of them, in the same order.
        character: name of the character in a document that it moves.

    Raises:
        ShapeError: where names repeat or lengths disagree.
        UnknownName: where something names a control or attribute that is not there.
    """

    name: str
    character: str
    controls: Skeleton
    looks: tuple[Control, ...]
    attributes: tuple[Attribute, ...] = ()
    modules: tuple[Module, ...] = ()
    constraints: tuple[Constraint, ...] = ()
    drivers: tuple[Driver, ...] = ()

    def __post_init__(self) -> None:
        for name in ("looks", "attributes", "modules", "constraints", "drivers"):
            object.__setattr__(self, name, tuple(getattr(self, name)))
        if tuple(c.name for c in self.looks) != self.controls.names:
            raise ShapeError(f"rig '{self.name}': expected the look of each control, in order")
        _unique((a.name for a in self.attributes), f"rig '{self.name}': attribute")
        _unique((m.name for m in self.modules), f"rig '{self.name}': module")
        _unique((c.name for c in self.constraints), f"rig '{self.name}': constraint")
        _unique((str(d.channel) for d in self.drivers), f"rig '{self.name}': driver of")
        _unique((j for m in self.modules for j in module_joints(m)), f"rig '{self.name}': modules move joint")
        values = {a.name for a in self.attributes}
        for attribute in self.attributes:
            self.controls.index(attribute.control)
        for control in self.looks:
            if len(control.spaces) > 1 and control.space_attribute not in values:
                raise UnknownName("attribute", control.space_attribute, values)
        for module in self.modules:
            self.controls.indices(module_controls(module))
        for constraint in self.constraints:
            if constraint.weight_attribute and constraint.weight_attribute not in values:
                raise UnknownName("attribute", constraint.weight_attribute, values)

    def control(self, name: str) -> Control:
        """The look of a control; raises `UnknownName` with the nearest."""
        return self.looks[self.controls.index(name)]

    def attribute(self, name: str) -> Attribute:
        """One attribute; raises `UnknownName` with the nearest."""
        for attribute in self.attributes:
            if attribute.name == name:
                return attribute
        raise UnknownName("attribute", name, [a.name for a in self.attributes])

    def module(self, name: str) -> Module:
        """One module; raises `UnknownName` with the nearest."""
        for module in self.modules:
            if module.name == name:
                return module
        raise UnknownName("module", name, [m.name for m in self.modules])

    @property
    def joints(self) -> tuple[str, ...]:
        """The joints that modules move."""
        return tuple(j for m in self.modules for j in module_joints(m))


def module_joints(module: Module) -> tuple[str, ...]:
    """The joints that a module moves."""
    toes = module.foot.toes_joint if isinstance(module, LimbModule) and module.foot is not None else ""
    return (*module.joints, toes) if toes else tuple(module.joints)


def module_controls(module: Module) -> tuple[str, ...]:
    """The controls that a module reads."""
    more: tuple[str, ...] = ()
    if isinstance(module, FollowModule):
        more = (module.carrier,) if module.carrier else ()
    elif isinstance(module, LimbModule):
        toes = module.foot.toes_control if module.foot is not None else ""
        more = (module.goal, module.pole, toes) if toes else (module.goal, module.pole)
    elif isinstance(module, SpineModule):
        more = (module.goal,)
    elif isinstance(module, HeadModule):
        more = (module.target,)
    return (*module.controls, *more)


def _vector(value: Iterable[float], name: str) -> Vector:
    numbers = tuple(float(v) for v in value)
    if len(numbers) != 3 or not all(math.isfinite(n) for n in numbers):
        raise ShapeError(f"{name}: expected three finite numbers, got {numbers}")
    return numbers


def _unique(names: Iterable[str], what: str) -> None:
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise ShapeError(f"{what} '{name}' is there twice")
        seen.add(name)


def _pairs(item: FollowModule | LimbModule | SpineModule | HeadModule | EyesModule | Finger, count: int = 0) -> None:
    for name in ("joints", "controls"):
        object.__setattr__(item, name, tuple(getattr(item, name)))
    joints, controls = len(item.joints), len(item.controls)
    if joints != controls or joints == 0 or (count and joints != count):
        expected = str(count) if count else "as many"
        raise ShapeError(f"'{item.name}': expected {expected} joints and controls, got {joints} and {controls}")
