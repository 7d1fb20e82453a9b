"""Skeleton: the joint hierarchy and its rest pose."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from keypose.arrays import Array, Ints, frozen
from keypose.errors import ShapeError, UnknownName
from keypose.model.pose import Pose


@dataclass(frozen=True, slots=True, eq=False)
class Skeleton:
    """J named joints in an order where every parent comes before its children.

    Shapes and units:
        names: J unique names.
        parents: (J,) int32; -1 marks a root; several roots are allowed.
        rest: local rest pose, batch shape ().
        end_offsets: joint index -> (3,) metres, the tip of a leaf joint (a BVH end site); it is no joint.

    Raises:
        ShapeError: where names repeat, lengths disagree or a parent does not come before its child.
    """

    names: tuple[str, ...]
    parents: Ints
    rest: Pose
    end_offsets: tuple[tuple[int, tuple[float, float, float]], ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "names", tuple(self.names))
        parents = frozen(self.parents, np.int32)
        object.__setattr__(self, "parents", parents)
        count = len(self.names)
        if parents.shape != (count,):
            raise ShapeError(f"parents: expected ({count},) to match the names, got {parents.shape}")
        if self.rest.batch_shape != () or self.rest.joint_count != count:
            raise ShapeError(
                f"rest: expected one pose of {count} joints, got batch {self.rest.batch_shape} of {self.rest.joint_count}"
            )
        if len(set(self.names)) != count:
            seen: set[str] = set()
            twice = next(n for n in self.names if n in seen or seen.add(n))
            raise ShapeError(f"names: joint '{twice}' appears more than once")
        wrong = np.nonzero((parents >= np.arange(count)) | (parents < -1))[0]
        if len(wrong):
            j = int(wrong[0])
            raise ShapeError(
                f"parents: joint {j} '{self.names[j]}' has parent {int(parents[j])}; a parent must come before its child"
            )

    @property
    def joint_count(self) -> int:
        """J."""
        return len(self.names)

    def index(self, joint: str | int) -> int:
        """The index of a joint by its name; a number is only checked.

        Raises:
            UnknownName: for a name that does not exist, with the nearest.
            ShapeError: for a number that is no joint.
        """
        if not isinstance(joint, str):
            if not 0 <= joint < self.joint_count:
                raise ShapeError(f"joint: expected 0 to {self.joint_count - 1}, got {joint}")
            return int(joint)
        try:
            return self.names.index(joint)
        except ValueError:
            raise UnknownName("joint", joint, self.names) from None

    def indices(self, names: Iterable[str]) -> list[int]:
        """The indices of several joints; raises `UnknownName`."""
        known = {n: i for i, n in enumerate(self.names)}
        found = list(names)
        for name in found:
            if name not in known:
                raise UnknownName("joint", name, self.names)
        return [known[n] for n in found]

    def children(self, joint: int) -> list[int]:
        """Indices of the direct children of a joint."""
        return [int(c) for c in np.nonzero(self.parents == joint)[0]]

    def depths(self) -> Array:
        """(J,) number of joints above each joint."""
        depths = np.zeros(self.joint_count, np.int32)
        for joint, parent in enumerate(self.parents):
            if parent >= 0:
                depths[joint] = depths[parent] + 1
        return depths
