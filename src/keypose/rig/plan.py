"""The order in which a rig is evaluated on a skeleton, and all that does not change from pose to pose.

Controls wait for what carries them, modules for their controls and for the joint that their joints hang on. A circle has no
such order and is refused by name.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TypeVar

import numpy as np

from keypose.arrays import Floats
from keypose.errors import KeyposeError, ShapeError, UnknownName
from keypose.model import (
    Constraint,
    Control,
    Driver,
    EyesModule,
    FingersModule,
    LimbModule,
    Module,
    Property,
    Rig,
    Skeleton,
    TwistModule,
    module_controls,
    module_joints,
)
from keypose.rig.expressions import Expression, parse_expression
from keypose.rig.frames import frames_of, inverse

T = TypeVar("T", bound=Hashable)

CONTROL, MODULE = "control", "module"

AXES = "xyz"
_PARTS = ("translation", "rotation", "twist", "scale")


@dataclass(frozen=True, slots=True, eq=False)
class Carrier:
    """What carries a control: a control, a joint or (both None) the world; ``offset`` (4, 4) leads to the frame's rest."""

    control: int | None
    joint: int | None
    offset: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """A component of a control or joint, as expressions read and drivers move it."""

    control: int | None
    joint: int | None
    kind: str
    axis: int


@dataclass(frozen=True, slots=True, eq=False)
class Driven:
    """A driver ready to run: its expression and where its result goes (a component, or a value by name)."""

    driver: Driver
    expression: Expression
    part: Part | None


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """A rig on a skeleton.

    Shapes: ``rest`` (J, 4, 4) and ``control_rest`` (N, 4, 4): model-from at rest, with their inverses; ``parent_rest`` (N, 4, 4)
    of what controls hang on in the hierarchy, ``local_rest`` (N, 4, 4) of the controls in that. ``space_weights`` names the
    attribute of each space of each control, empty where there is none.
    """

    rig: Rig
    skeleton: Skeleton
    parents: tuple[int, ...]
    rest: Floats
    rest_inverse: Floats
    control_rest: Floats
    control_rest_inverse: Floats
    parent_rest: Floats
    local_rest: Floats
    carriers: tuple[tuple[Carrier, ...], ...]
    space_weights: tuple[tuple[str, ...], ...]
    order: tuple[tuple[str, int], ...]
    owned: frozenset[int]
    moved: tuple[int, ...]
    control_constraints: Mapping[int, tuple[Constraint, ...]]
    joint_constraints: Mapping[int, tuple[Constraint, ...]]
    joint_order: tuple[int, ...]
    drivers: tuple[Driven, ...]
    late_drivers: tuple[Driven, ...]
    parts: Mapping[str, Part]

    def control(self, name: str) -> int:
        """The index of a control."""
        return self.rig.controls.index(name)

    def joint(self, name: str) -> int:
        """The index of a joint."""
        return self.skeleton.index(name)

    def offset(self, control: int, joint: int) -> Floats:
        """(4, 4): the joint's rest in the control's rest frame."""
        return self.control_rest_inverse[control] @ self.rest[joint]


def check_rig(rig: Rig, skeleton: Skeleton) -> None:
    """Whether a rig fits a skeleton.

    Raises:
        UnknownName: where it names a joint, control or channel that is not there; names the nearest.
        ShapeError: where a control is called like a joint, an expression is none, or things wait for each other in a circle.
    """
    plan_of(rig, skeleton)


@lru_cache(maxsize=16)
def plan_of(rig: Rig, skeleton: Skeleton) -> Plan:
    """The plan of a rig on a skeleton; made once for both."""
    with np.errstate(over="ignore", invalid="ignore"):  # numbers of damaged files
        return _Planner(rig, skeleton).plan()


def rest_frames(skeleton: Skeleton) -> Floats:
    """Model-from-joint of the rest pose, (J, 4, 4) float64."""
    local = frames_of(skeleton.rest, 1)[:, 0]
    model = np.empty_like(local)
    for joint, parent in enumerate(skeleton.parents):
        model[joint] = local[joint] if parent < 0 else model[parent] @ local[joint]
    return model


def owned_controls(module: Module) -> tuple[str, ...]:
    """Controls that a module evaluates itself, because they hang on what it makes."""
    if isinstance(module, FingersModule):
        return module.controls
    if isinstance(module, LimbModule) and module.foot is not None and module.foot.toes_control:
        return (module.foot.toes_control,)
    return ()


def hanging_joints(module: Module) -> tuple[str, ...]:
    """Joints whose place depends on what they hang on, not on controls alone."""
    if isinstance(module, LimbModule):
        return module.joints[:1]
    return module.joints if isinstance(module, (EyesModule, TwistModule)) else ()


class _Planner:
    def __init__(self, rig: Rig, skeleton: Skeleton) -> None:
        self.rig, self.skeleton = rig, skeleton
        self.joints = {name: j for j, name in enumerate(skeleton.names)}
        self.controls = {name: c for c, name in enumerate(rig.controls.names)}
        self.values = {a.name for a in rig.attributes}
        both = next((name for name in self.controls if name in self.joints), None)
        if both is not None:
            raise ShapeError(f"rig '{rig.name}': control '{both}' has the name of a joint")
        self.parents = tuple(int(p) for p in skeleton.parents)
        self.rest = rest_frames(skeleton)
        self.control_rest = rest_frames(rig.controls)
        self.owner = {self.controls[c]: m for m, module in enumerate(rig.modules) for c in owned_controls(module)}
        self.mover = {self.joint(j): m for m, module in enumerate(rig.modules) for j in module_joints(module)}

    def plan(self) -> Plan:
        rest_inverse, control_inverse = inverse(self.rest), inverse(self.control_rest)
        parents = self.rig.controls.parents
        eye = np.eye(4)
        parent_rest = np.stack([eye if p < 0 else self.control_rest[p] for p in parents] or [eye])[: len(parents)]
        carriers: list[tuple[Carrier, ...]] = []
        for c, look in enumerate(self.rig.looks):
            found: list[Carrier] = []
            for space in look.spaces:
                if not space.target:
                    found.append(Carrier(None, None, parent_rest[c]))
                elif space.target in self.controls:
                    target = self.controls[space.target]
                    found.append(Carrier(target, None, control_inverse[target] @ parent_rest[c]))
                else:
                    joint = self.joint(space.target, "control or joint", (*self.controls, *self.joints))
                    found.append(Carrier(None, joint, rest_inverse[joint] @ parent_rest[c]))
            if not look.spaces:
                found.append(Carrier(int(parents[c]) if parents[c] >= 0 else None, None, eye))
            carriers.append(tuple(found))
        on_controls: dict[int, list[Constraint]] = {}
        on_joints: dict[int, list[Constraint]] = {}
        for constraint in self.rig.constraints:
            for target in constraint.targets:
                self.place(target)
            control, joint = self.place(constraint.owner)
            if control is not None:
                on_controls.setdefault(control, []).append(constraint)
            elif joint is not None:
                on_joints.setdefault(joint, []).append(constraint)
        order = self.order(carriers, on_controls)
        drivers, late, parts = self.drivers()
        return Plan(
            self.rig,
            self.skeleton,
            self.parents,
            self.rest,
            rest_inverse,
            self.control_rest,
            control_inverse,
            parent_rest,
            frames_of(self.rig.controls.rest, 1)[:, 0],
            tuple(carriers),
            tuple(self.space_weights(look) for look in self.rig.looks),
            order,
            frozenset(self.owner),
            tuple(sorted(self.mover)),
            {c: tuple(held) for c, held in on_controls.items()},
            {j: tuple(held) for j, held in on_joints.items()},
            self.joint_order(on_joints),
            drivers,
            late,
            parts,
        )

    # ---- names

    def space_weights(self, look: Control) -> tuple[str, ...]:
        """The attribute of each space's weight; an empty name where the rig has none."""
        names = (look.weight_attribute(space.name) for space in look.spaces)
        return tuple(name if name in self.values else "" for name in names)

    def joint(self, name: str, kind: str = "joint", known: Iterable[str] | None = None) -> int:
        if name not in self.joints:
            raise UnknownName(kind, name, self.joints if known is None else known)
        return self.joints[name]

    def place(self, name: str) -> tuple[int | None, int | None]:
        """The index of a control or of a joint."""
        if name in self.controls:
            return self.controls[name], None
        return None, self.joint(name, "control or joint", (*self.controls, *self.joints))

    # ---- order

    def mover_of(self, joint: int) -> int | None:
        """The module on which a joint's place depends: its own or that of the nearest joint above it."""
        while joint >= 0:
            if joint in self.mover:
                return self.mover[joint]
            joint = self.parents[joint]
        return None

    def node(self, control: int | None, joint: int | None) -> tuple[str, int] | None:
        if control is not None:
            return (MODULE, self.owner[control]) if control in self.owner else (CONTROL, control)
        module = None if joint is None else self.mover_of(joint)
        return None if module is None else (MODULE, module)

    def order(
        self, carriers: Sequence[Sequence[Carrier]], held: Mapping[int, Sequence[Constraint]]
    ) -> tuple[tuple[str, int], ...]:
        waits: dict[tuple[str, int], list[tuple[str, int]]] = {}

        def wait(node: tuple[str, int], control: int | None, joint: int | None) -> None:
            other = self.node(control, joint)
            if other is not None and (other != node or control is None):
                waits.setdefault(node, []).append(other)

        for c in range(len(self.controls)):
            node = (MODULE, self.owner[c]) if c in self.owner else (CONTROL, c)
            waits.setdefault(node, [])
            for constraint in held.get(c, ()):
                for target in constraint.targets:
                    wait(node, *self.place(target))
            if c not in self.owner:
                for carrier in carriers[c]:
                    wait(node, carrier.control, carrier.joint)
        for m, module in enumerate(self.rig.modules):
            node = (MODULE, m)
            waits.setdefault(node, [])
            for name in module_controls(module):
                wait(node, self.controls[name], None)
            for name in hanging_joints(module):
                above = self.parents[self.joint(name)]
                while above >= 0 and above not in self.mover:
                    above = self.parents[above]
                if above >= 0 and self.mover[above] != m:
                    wait(node, None, above)
            if isinstance(module, FingersModule):
                wait(node, None, self.joint(module.hand))
            if isinstance(module, TwistModule):
                for name in (n for twist in module.twists for n in (twist.bone, twist.end) if n):
                    wait(node, None, self.joint(name))
        return tuple(_sorted(waits, self.called, f"rig '{self.rig.name}'"))

    def called(self, node: tuple[str, int]) -> str:
        kind, index = node
        return (
            f"control '{self.rig.looks[index].name}'" if kind == CONTROL else f"module '{self.rig.modules[index].name}'"
        )

    def joint_order(self, held: Mapping[int, Sequence[Constraint]]) -> tuple[int, ...]:
        """Joints in an order where parents and what constraints aim at come first."""
        waits: dict[int, list[int]] = {j: [p] if p >= 0 else [] for j, p in enumerate(self.parents)}
        for joint, constraints in held.items():
            for target in (t for c in constraints for t in c.targets):
                other = self.place(target)[1]
                if other is not None:
                    waits[joint].append(other)
        return tuple(
            _sorted(waits, lambda j: f"joint '{self.skeleton.names[j]}'", f"rig '{self.rig.name}': constraints")
        )

    # ---- drivers

    def drivers(self) -> tuple[tuple[Driven, ...], tuple[Driven, ...], dict[str, Part]]:
        parts: dict[str, Part] = {}
        results: dict[str, int] = {}
        made: list[Driven] = []
        morphs = {d.channel.target for d in self.rig.drivers if d.channel.property is Property.WEIGHT}
        for n, driver in enumerate(self.rig.drivers):
            expression = _parsed(driver)
            channel = driver.channel
            part = None
            if channel.property in (Property.TRANSLATION, Property.EULER):
                control, joint = self.place(channel.target)
                kind = "translation" if channel.property is Property.TRANSLATION else "rotation"
                part = Part(control, joint, kind, channel.component or 0)
                results[f"{channel.target}.{kind}.{AXES[part.axis]}"] = n
            else:
                if channel.property is Property.VALUE:
                    self.rig.attribute(channel.target)
                results[channel.target] = n
            for name in expression.names:
                if name not in self.values and name not in morphs:
                    parts[name] = self.part(name, driver)
            made.append(Driven(driver, expression, part))
        waits = {n: [results[name] for name in d.expression.names if name in results] for n, d in enumerate(made)}
        order = list(_sorted(waits, lambda n: f"driver of {made[n].driver.channel}", f"rig '{self.rig.name}'"))
        late: set[int] = set()
        for n in order:
            reads_joint = any(name in parts and parts[name].joint is not None for name in made[n].expression.names)
            own = made[n].part
            moves_joint = own is not None and own.joint is not None
            if moves_joint or reads_joint or any(other in late for other in waits[n]):
                late.add(n)
                if made[n].driver.channel.property is Property.VALUE or (own is not None and own.control is not None):
                    raise ShapeError(
                        f"driver of {made[n].driver.channel}: it reads a joint, which is known only when controls and values "
                        "are; it can drive joints and morphs"
                    )
        early = tuple(made[n] for n in order if n not in late)
        return early, tuple(made[n] for n in order if n in late), parts

    def part(self, name: str, driver: Driver) -> Part:
        """A name such as ``hand_ik.L.translation.x``; raises `UnknownName` listing what there is."""
        pieces = name.rsplit(".", 2)
        if len(pieces) == 3 and pieces[1] in _PARTS and pieces[2] in tuple(AXES):
            try:
                control, joint = self.place(pieces[0])
            except UnknownName as error:
                raise UnknownName(f"control or joint (driver of {driver.channel})", pieces[0], error.known) from None
            return Part(control, joint, pieces[1], AXES.index(pieces[2]))
        raise UnknownName(f"attribute (driver of {driver.channel})", name, sorted(self.values))


def _parsed(driver: Driver) -> Expression:
    try:
        return parse_expression(driver.expression)
    except KeyposeError as error:
        raise ShapeError(f"driver of {driver.channel}: {error}") from None


def _sorted(waits: Mapping[T, Sequence[T]], called: Callable[[T], str], where: str) -> list[T]:
    """The keys, each after what it waits for; raises `ShapeError` that spells out a circle."""
    done: dict[T, None] = {}
    open_nodes: dict[T, None] = {}
    for start in waits:
        stack: list[tuple[T, int]] = [(start, 0)]
        while stack:
            node, at = stack.pop()
            if node in done:
                continue
            if at == 0:
                open_nodes[node] = None
            others = waits[node]
            if at == len(others):
                del open_nodes[node]
                done[node] = None
                continue
            stack.append((node, at + 1))
            other = others[at]
            if other in open_nodes:
                path = list(open_nodes)
                circle = [*path[path.index(other) :], other]
                names = " -> ".join(called(n) for n in circle)
                raise ShapeError(f"{where}: these wait for each other in a circle: {names}")
            if other not in done:
                stack.append((other, 0))
    return list(done)
