"""What is known while a rig is evaluated: values, places of controls, and places of the joints that modules moved."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from keypose.arrays import Floats, Ints
from keypose.model import Attribute
from keypose.rig.frames import EYE, mixed
from keypose.rig.plan import Carrier, Plan


class State:
    """One evaluation of N poses; frames are (N, 4, 4), or (1, 4, 4) where all poses share one."""

    def __init__(
        self, plan: Plan, count: int, local: Iterable[Floats], base: Iterable[Floats], values: Mapping[str, Floats]
    ) -> None:
        self.plan, self.count = plan, count
        self.local: list[Floats] = list(local)  # of controls: frame-from-control
        self.base: list[Floats] = list(base)  # of joints: parent-from-joint of what the rig does not move
        self.values = dict(values)
        self.controls: list[Floats | None] = [None] * len(plan.rig.looks)
        self.frames: list[Floats | None] = [None] * len(plan.rig.looks)
        self.joints: list[Floats | None] = [None] * len(plan.parents)
        self._passive: dict[int, Floats] = {}

    def copy(self) -> State:
        """The same controls and values before any joint is placed."""
        other = State(self.plan, self.count, self.local, self.base, self.values)
        other.controls, other.frames = self.controls, self.frames
        return other

    def control(self, index: int) -> Floats:
        """Model-from-control of a control that has been evaluated."""
        found = self.controls[index]
        return EYE[None] if found is None else found

    def joint(self, index: int) -> Floats:
        """Model-from-joint: as its module moved it, else as the base pose has it on the joint above."""
        found = self.joints[index]
        if found is not None:
            return found
        if index not in self._passive:
            self._passive[index] = self.above(index) @ self.base[index]
        return self._passive[index]

    def above(self, index: int) -> Floats:
        """Model-from-parent of a joint."""
        parent = self.plan.parents[index]
        return EYE[None] if parent < 0 else self.joint(parent)

    def value(self, name: str) -> Floats:
        """A value, (N,) or (1,)."""
        return self.values[name]

    def is_zero(self, *names: str) -> bool:
        """Whether values are 0 in all poses."""
        return not any(np.any(self.values[name]) for name in names)

    def place(self, carrier: Carrier) -> Floats:
        """The frame that a control has on one of its carriers."""
        if carrier.control is not None:
            held = self.control(carrier.control)
        elif carrier.joint is not None:
            held = self.joint(carrier.joint)
        else:
            return carrier.offset[None]
        return held @ carrier.offset

    def frame(self, control: int) -> Floats:
        """Model-from-frame: what a control's own transform is relative to, in the space or the mixture that it has."""
        carriers = self.plan.carriers[control]
        if len(carriers) == 1:
            return self.place(carriers[0])
        chosen = self.value(self.plan.rig.looks[control].space_attribute)
        index = np.clip(np.rint(chosen), 0, len(carriers) - 1).astype(np.intp)
        if not self.is_zero(*(name for name in self.plan.space_weights[control] if name)):
            return self._mixture(control, carriers, index)
        used = np.unique(index) if index.size else np.zeros(1, np.intp)
        frame = self.place(carriers[used[0]])
        for n in used[1:]:
            frame = np.where((index == n)[:, None, None], self.place(carriers[n]), frame)
        return frame

    def _mixture(self, control: int, carriers: tuple[Carrier, ...], chosen: Ints) -> Floats:
        """The frame between several carriers: the control's place at rest goes between where each would carry it, and turns."""
        zero = np.zeros(1)
        given = [self.values[name] if name else zero for name in self.plan.space_weights[control]]
        weights = [np.clip(w, 0.0, 1.0) for w in given]
        left = np.maximum(1.0 - sum(weights, zero), 0.0)
        weights = [w + np.where(chosen == n, left, 0.0) for n, w in enumerate(weights)]
        there = np.eye(4)
        there[:3, 3] = self.plan.local_rest[control][:3, 3]
        frame, carried = EYE[None], zero
        for carrier, weight in zip(carriers, weights, strict=True):
            carried = carried + weight
            if np.any(weight):
                share = weight / np.where(carried == 0, 1.0, carried)
                frame = mixed(frame, self.place(carrier) @ there, share)
        there[:3, 3] *= -1.0
        return frame @ there

    def put(self, control: int, frame: Floats) -> Floats:
        """Place a control in its frame; returns model-from-control."""
        world = frame @ self.local[control]
        held = self.plan.control_constraints.get(control)
        if held:
            from keypose.rig.constraints import constrained

            for constraint in held:
                world = constrained(self, constraint, world, frame, self.plan.rig.controls.rest.rotations[control])
        self.frames[control], self.controls[control] = frame, world
        return world


def blend(state: State, name: str, first: Floats, second: Floats) -> Floats:
    """From one frame to another by a value, exactly either at 0 and 1."""
    return mixed(first, second, np.clip(state.value(name), 0.0, 1.0))


def defaults(attributes: tuple[Attribute, ...]) -> dict[str, Floats]:
    """The default of every attribute, each (1,)."""
    return {a.name: np.array([a.default]) for a in attributes}
