"""What a rig needs to know of a body: where is up and forward, how large it is, which joints make its spine and neck."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from keypose.analysis.roles import SIDES, stands_on_all_fours
from keypose.arrays import Floats
from keypose.errors import KeyposeError
from keypose.math import quat
from keypose.model import Attribute, Character, Control, Pose, Skeleton
from keypose.rig.plan import rest_frames

_NEEDED = tuple(f"{s}_{p}" for s in SIDES for p in ("upper_leg", "lower_leg", "foot", "upper_arm", "lower_arm", "hand"))


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """A humanoid, or an animal on all fours, at rest.

    Shapes and units: ``places`` (J, 3) metres; ``axes`` (3, 3) columns to its left, up and forward; ``size_m`` from the soles to
    the head's joint, or to an animal's hips where those are higher; ``ground_m`` along up; ``spine`` from above the hips to the
    chest, ``neck`` from above that to the head.
    """

    skeleton: Skeleton
    roles: Mapping[str, int]
    parents: tuple[int, ...]
    places: Floats
    axes: Floats
    size_m: float
    ground_m: float
    foot_m: float
    spine: tuple[int, ...]
    neck: tuple[int, ...]
    surface: Character | None = None
    on_all_fours: bool = False

    @property
    def along(self) -> Floats:
        """Columns (3, 3) of what lies along the trunk: to the left, from the hips to the chest, and across both."""
        return np.stack([self.left, self.forward, -self.up], axis=1) if self.on_all_fours else self.axes

    @property
    def up(self) -> Floats:
        """Up, (3,)."""
        return self.axes[:, 1]

    @property
    def forward(self) -> Floats:
        """Forward, (3,)."""
        return self.axes[:, 2]

    @property
    def left(self) -> Floats:
        """To the body's left, (3,)."""
        return self.axes[:, 0]

    def hangs(self, joint: int, above: int) -> bool:
        """Whether one joint is below another."""
        while joint >= 0 and joint != above:
            joint = self.parents[joint]
        return joint == above

    def tip(self, joint: int) -> Floats | None:
        """The end of a joint's bone: its only child, the mean of several, or a tip that the file names."""
        children = self.skeleton.children(joint)
        if children:
            return np.mean([self.places[c] for c in children], axis=0)
        for index, offset in self.skeleton.end_offsets:
            if index == joint:
                return (rest_frames(self.skeleton)[joint] @ np.array([*offset, 1.0]))[:3]
        return None

    def heading(self, side: str, end_role: str = "foot", toes_role: str = "toes") -> Floats:
        """Where a foot points, level."""
        foot = self.roles[f"{side}_{end_role}"]
        toes = self.roles.get(f"{side}_{toes_role}")
        end = self.places[toes] if toes is not None else self.tip(foot)
        if end is None:
            return self.forward
        step = end - self.places[foot]
        step = step - self.up * float(step @ self.up)
        return bone_of(step) if float(step @ self.forward) > 0.2 * float(np.linalg.norm(step)) > 1e-4 else self.forward

    def hand_direction(self, side: str) -> Floats:
        """Where a hand points: to its fingers, else on from the forearm."""
        hand, lower = self.roles[f"{side}_hand"], self.roles[f"{side}_lower_arm"]
        for finger in ("middle", "index", "ring"):
            joint = self.roles.get(f"{side}_{finger}_proximal")
            if joint is not None and np.linalg.norm(self.places[joint] - self.places[hand]) > 1e-4 * self.size_m:
                return bone_of(self.places[joint] - self.places[hand])
        return bone_of(self.places[hand] - self.places[lower])

    def palm(self, side: str) -> Floats:
        """Where a palm faces."""
        first, last = (self.roles.get(f"{side}_{finger}_proximal") for finger in ("index", "little"))
        along = self.hand_direction(side)
        if first is not None and last is not None:
            facing = np.cross(along, self.places[first] - self.places[last])
            if np.linalg.norm(facing) > 1e-6 * self.size_m:
                return bone_of(facing if side == "left" else -facing)
        # arms beside the body have palms towards it, stretched ones downwards
        out = self.left if side == "left" else -self.left
        level = float(along @ out)
        return bone_of(-self.up * max(level, 0.0) - out * (1.0 - max(level, 0.0)))


def read_body(skeleton: Skeleton, roles: Mapping[str, int], character: Character | None = None) -> Body:
    """A humanoid, or an animal on all fours, at rest.

    Raises:
        KeyposeError: where hips, head or a limb's joints have no role, or the joints lie in one place.
    """
    missing = [role for role in ("hips", "head", *_NEEDED) if role not in roles]
    if missing:
        raise KeyposeError(f"no humanoid: nothing plays {', '.join(missing)}; name the joints in a map of roles")
    places = rest_frames(skeleton)[:, :3, 3]
    parents = tuple(int(p) for p in skeleton.parents)
    four = stands_on_all_fours(places, roles)
    axes = _axes(places, roles, four)
    up = axes[:, 1]
    parts = ("foot", "toes", "hand") if four else ("foot", "toes")
    ends = [roles[f"{s}_{p}"] for s in SIDES for p in parts if f"{s}_{p}" in roles]
    ground = min(float(places[j] @ up) for j in ends)
    size = max(float(places[roles[role]] @ up) for role in (("head", "hips") if four else ("head",))) - ground
    # ankles and toes lie a little above the soles: who stands on the origin's plane stands on the ground there
    if 0.0 < ground < 0.08 * size:
        size, ground = size + ground, 0.0
    if size <= 1e-6:
        raise KeyposeError("the rest pose is no stand: the head is not above the feet")
    top = next((roles[r] for r in ("upper_chest", "chest", "spine") if r in roles), roles["hips"])
    spine = _between(skeleton, parents, roles["hips"], top)
    neck = _between(skeleton, parents, spine[-1] if spine else roles["hips"], roles["head"])
    body = Body(skeleton, dict(roles), parents, places, axes, size, ground, 0.16 * size, spine, neck, character, four)
    lengths: list[float] = []
    for side in SIDES:
        toes = roles.get(f"{side}_toes")
        if toes is not None:
            step = places[toes] - places[roles[f"{side}_foot"]]
            lengths.append(1.7 * float(np.linalg.norm(step - up * float(step @ up))))
    return replace(body, foot_m=max(0.08 * size, float(np.mean(lengths)))) if lengths else body


def _axes(places: Floats, roles: Mapping[str, int], four: bool) -> Floats:
    """Left, up and forward, along the file's axes where they are near."""
    feet = np.mean([places[roles[f"{s}_foot"]] for s in SIDES], axis=0)
    up = bone_of(places[roles["head"]] - feet)
    if four:
        ways = (("upper_leg", "foot"), ("upper_arm", "hand"))
        up = bone_of(
            np.sum([places[roles[f"{s}_{a}"]] - places[roles[f"{s}_{b}"]] for s in SIDES for a, b in ways], axis=0)
        )
    across = places[roles["left_upper_leg"]] - places[roles["right_upper_leg"]]
    if float(np.linalg.norm(across)) < 1e-6:
        across = places[roles["left_upper_arm"]] - places[roles["right_upper_arm"]]
    left = bone_of(across - up * float(across @ up))
    axes = np.stack([left, up, np.cross(left, up)], axis=1)
    whole = np.rint(axes)
    if np.abs(axes - whole).max() < 0.35 and abs(float(np.linalg.det(whole)) - 1.0) < 1e-9:
        return whole
    return axes


def _between(skeleton: Skeleton, parents: tuple[int, ...], above: int, below: int) -> tuple[int, ...]:
    """The joints under ``above`` down to ``below``; none where they are one."""
    path: list[int] = []
    joint = below
    while joint != above:
        path.append(joint)
        joint = parents[joint]
        if joint < 0:
            names = skeleton.names
            raise KeyposeError(f"joint '{names[below]}' does not hang on '{names[above]}'; correct the roles")
    return tuple(reversed(path))


def bone_of(v: Floats) -> Floats:
    """A unit vector (3,); up for none."""
    size = float(np.linalg.norm(v))
    return v / size if size > 1e-12 else np.array([0.0, 1.0, 0.0])


def bone_axes(bone: Floats, towards: Floats, instead: Floats) -> Floats:
    """Columns (3, 3): Y along a bone, X the axis about which it bends ``towards`` a direction."""
    y = bone_of(bone)
    x = np.cross(y, towards)
    if np.linalg.norm(x) < 1e-6:
        x = np.cross(y, instead)
    if np.linalg.norm(x) < 1e-6:
        x = np.eye(3)[int(np.argmin(np.abs(y)))]
        x = x - y * float(x @ y)
    x = bone_of(x)
    return np.stack([x, y, np.cross(x, y)], axis=1)


@dataclass(slots=True)
class Sheet:
    """Controls while they are collected: names that no joint has and that are not ``taken``, places in model space."""

    skeleton: Skeleton
    taken: Collection[str] = ()
    looks: list[Control] = field(default_factory=list[Control])
    attributes: list[Attribute] = field(default_factory=list[Attribute])
    _parents: list[int] = field(default_factory=list[int])
    _places: list[Floats] = field(default_factory=list[Floats])
    _axes: list[Floats] = field(default_factory=list[Floats])
    _names: dict[str, str] = field(default_factory=dict[str, str])

    def add(self, name: str, parent: str, place: Floats, axes: Floats, look: Control) -> str:
        """A control under a parent (of the name that `add` gave it); returns its own name, which is free."""
        # animations are matched by name without regard to case and name space; controls must not be taken for joints
        joints = {n.replace("|", ":").rsplit(":", 1)[-1].casefold() for n in self.skeleton.names}
        free = name
        while free.casefold() in joints or free in self.taken:
            stem, dot, end = free.partition(".")
            free = f"{stem}_control{dot}{end}"
        self._names[name] = free
        self._parents.append(-1 if not parent else [c.name for c in self.looks].index(parent))
        self._places.append(np.asarray(place, np.float64))
        self._axes.append(np.asarray(axes, np.float64))
        self.looks.append(replace(look, name=free))
        if len(look.spaces) > 1:
            labels = tuple(space.name for space in look.spaces)
            look = self.looks[-1]
            self.attributes.append(Attribute(look.space_attribute, free, 0.0, 0.0, len(labels) - 1.0, labels))
            self.attributes.extend(Attribute(look.weight_attribute(label), free) for label in labels)
        return free

    def named(self, name: str) -> str:
        """The name that a control really has."""
        return self._names[name]

    def attribute(
        self, name: str, control: str, *, default: float = 0.0, low: float = 0.0, high: float = 1.0, angle: bool = False
    ) -> None:
        """A number beside a control."""
        self.attributes.append(Attribute(name, control, default, low, high, angle=angle))

    def controls(self) -> Skeleton:
        """The hierarchy of the controls with local rest transforms."""
        turns = quat.from_matrix(np.stack(self._axes))
        places = np.stack(self._places)
        local_turns, local_places = turns.copy(), places.copy()
        for n, parent in enumerate(self._parents):
            if parent >= 0:
                back = quat.conjugate(turns[parent])
                local_turns[n] = quat.multiply(back, turns[n])
                local_places[n] = quat.rotate(back, places[n] - places[parent])
        rest = Pose(local_places, local_turns, np.ones_like(places))
        return Skeleton(tuple(c.name for c in self.looks), np.asarray(self._parents, np.int32), rest)
