"""Arms and legs of an automatic rig: FK and IK controls, poles, feet and hands."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from keypose.arrays import Floats
from keypose.model import Control, ControlShape, ControlSide, FollowModule, LimbModule, Module, Property, Space
from keypose.rig.body import Body, Sheet, bone_axes, bone_of
from keypose.rig.feet import foot_pivots
from keypose.rig.fingers import finger_module

_TURN = (Property.ROTATION,)
_PLACE = (Property.TRANSLATION,)

SIDE_LABELS = {"left": ("L", ControlSide.LEFT), "right": ("R", ControlSide.RIGHT)}


def spaces_of(*named: tuple[str, str]) -> tuple[Space, ...]:
    """Spaces by label and target, each target once."""
    found: dict[str, Space] = {}
    for label, target in named:
        found.setdefault(target, Space(label, target))
    return tuple(found.values())


def rig_arm(sheet: Sheet, body: Body, side: str, modules: list[Module]) -> None:
    """Controls and modules of a shoulder, an arm and its hand."""
    letter, colour = SIDE_LABELS[side]
    names, size, places = body.skeleton.names, body.size_m, body.places
    upper, lower, hand = (body.roles[f"{side}_{part}"] for part in ("upper_arm", "lower_arm", "hand"))
    above = rig_shoulder(sheet, body, side, modules)
    pole = _bend(places[upper], places[lower], places[hand], -body.forward)
    palm = body.palm(side)
    axes = [
        bone_axes(places[lower] - places[upper], -pole, body.up),
        bone_axes(places[hand] - places[lower], -pole, body.up),
        bone_axes(body.hand_direction(side), palm, body.up),
    ]
    spaces = [("root", sheet.named("root")), ("world", ""), ("pelvis", sheet.named("pelvis"))]
    if body.spine:
        spaces.append(("chest", names[body.spine[-1]]))
    spaces.append(("head", names[body.neck[-1]]))
    goal_look = Control("", ControlShape.BOX, 0.045 * size, side=colour, spaces=spaces_of(*spaces))
    limb = _limb(
        sheet, body, f"arm.{letter}", colour, (upper, lower, hand),
        (f"upper_arm.{letter}", f"lower_arm.{letter}", f"hand.{letter}"), axes, above,
        (f"hand_ik.{letter}", places[hand], axes[2], goal_look), (f"elbow.{letter}", pole), modules, ik=0.0,
    )  # fmt: skip
    if limb is not None:
        modules.append(limb)
    fingers = finger_module(sheet, body, side, letter, colour)
    if fingers is not None:
        modules.append(fingers)


@dataclass(frozen=True, slots=True)
class Leg:
    """What plays a leg, and what its controls are called.

    ``parts``: roles of its three joints and, where there may be any, of the toes; ``controls`` of the three; ``forward`` whether
    it bends forward, as knees do.
    """

    parts: tuple[str, str, str]
    toes: str
    module: str
    controls: tuple[str, str, str]
    pole: str
    forward: bool

    @property
    def foot(self) -> str:
        """The foot's control with FK, and its attributes."""
        return self.controls[2]


LEG = Leg(("upper_leg", "lower_leg", "foot"), "toes", "leg", ("upper_leg", "lower_leg", "foot"), "knee", True)
FORELEG = Leg(
    ("upper_arm", "lower_arm", "hand"), "", "foreleg", ("upper_foreleg", "lower_foreleg", "forefoot"), "elbow", False
)


def rig_shoulder(sheet: Sheet, body: Body, side: str, modules: list[Module]) -> str:
    """The control and module of a shoulder; returns the control that the limb hangs on, the root's where there is none."""
    letter, colour = SIDE_LABELS[side]
    names, places = body.skeleton.names, body.places
    shoulder = body.roles.get(f"{side}_shoulder")
    if shoulder is None:
        return sheet.named("root")
    bone = places[body.roles[f"{side}_upper_arm"]] - places[shoulder]
    carrier = body.parents[shoulder]
    look = Control(
        "", ControlShape.CIRCLE, 0.05 * body.size_m, (0.0, float(np.linalg.norm(bone)), 0.0), colour,
        spaces_of(("chest", names[carrier])) if carrier >= 0 else (),
    )  # fmt: skip
    made = sheet.add(
        f"shoulder.{letter}", sheet.named("root"), places[shoulder], bone_axes(bone, body.forward, body.up), look
    )
    modules.append(FollowModule(f"shoulder.{letter}", (names[shoulder],), (made,)))
    return made


def rig_leg(
    sheet: Sheet, body: Body, side: str, modules: list[Module], leg: Leg = LEG, above: str = "", carrier: str = ""
) -> None:
    """Controls and modules of a leg and its foot, under a control (the root) and carried by a joint, where that is named, too."""
    letter, colour = SIDE_LABELS[side]
    size, places = body.size_m, body.places
    upper, lower, foot = (body.roles[f"{side}_{part}"] for part in leg.parts)
    pole = _bend(places[upper], places[lower], places[foot], body.forward if leg.forward else -body.forward)
    heading = body.heading(side, leg.parts[2], leg.toes)
    flat = np.stack([np.cross(body.up, heading), body.up, heading], axis=1)
    axes = [
        bone_axes(places[lower] - places[upper], -pole, body.up),
        bone_axes(places[foot] - places[lower], -pole, body.up),
        flat,
    ]
    root = sheet.named("root")
    sole = 0.5 * body.foot_m
    drop = float((places[foot] @ body.up) - body.ground_m)
    spaces = [("root", root), ("world", ""), ("pelvis", sheet.named("pelvis"))]
    goal_look = Control(
        "", ControlShape.FOOT, sole, (0.0, -drop, 0.6 * sole), colour,
        spaces_of(*spaces, *((("chest", carrier),) if carrier else ())),
    )  # fmt: skip
    a, b, c = (f"{name}.{letter}" for name in leg.controls)
    limb = _limb(
        sheet, body, f"{leg.module}.{letter}", colour, (upper, lower, foot), (a, b, c), axes, above or root,
        (f"{leg.foot}_ik.{letter}", places[foot], flat, goal_look), (f"{leg.pole}.{letter}", pole), modules, ik=1.0,
    )  # fmt: skip
    toes = ""
    joint = body.roles.get(f"{side}_{leg.toes}", -1)
    if limb is None or (joint >= 0 and not body.hangs(joint, foot)):
        return
    if joint >= 0:
        look = Control("", ControlShape.CIRCLE, 0.035 * size, side=colour, moves=_TURN)
        toes = sheet.add(f"toes.{letter}", limb.goal, places[joint], flat, look)
    pivots = foot_pivots(body, side, f"{leg.foot}.{letter}", toes, leg.parts[2], leg.toes)
    modules.append(replace(limb, foot=pivots))
    for pivot, reach in (("roll", 2.0), ("bank", 1.2), ("heel", 1.5), ("ball", 1.5), ("tip", 1.5), ("swivel", 1.5)):
        sheet.attribute(pivots.attribute(pivot), limb.goal, low=-reach, high=reach, angle=True)
    sheet.attribute(pivots.attribute("roll_break"), limb.goal, default=float(np.radians(40.0)), high=1.5, angle=True)


def _limb(
    sheet: Sheet,
    body: Body,
    name: str,
    side: ControlSide,
    joints: tuple[int, int, int],
    controls: tuple[str, str, str],
    axes: Sequence[Floats],
    above: str,
    goal: tuple[str, Floats, Floats, Control],
    pole: tuple[str, Floats],
    modules: list[Module],
    *,
    ik: float,
) -> LimbModule | None:
    """The controls of a limb; where its joints do not hang on each other, FK alone, and no module is returned."""
    names, size, places = body.skeleton.names, body.size_m, body.places
    root = sheet.named("root")
    made: list[str] = []
    carrier = body.parents[joints[0]]
    for n, (control, joint) in enumerate(zip(controls, joints, strict=True)):
        bone = float(np.linalg.norm(places[joints[n + 1]] - places[joint])) if n < 2 else 0.0
        look = Control(
            "", ControlShape.CIRCLE, (0.06, 0.05, 0.045)[n] * size, (0.0, 0.5 * bone, 0.0), side,
            spaces_of(("body", names[carrier])) if n == 0 and carrier >= 0 else (), moves=_TURN,
        )  # fmt: skip
        above = sheet.add(control, above, places[joint], axes[n], look)
        made.append(above)
    if not (body.hangs(joints[1], joints[0]) and body.hangs(joints[2], joints[1])):
        modules.append(FollowModule(name, tuple(names[j] for j in joints), tuple(made)))
        return None
    goal_name = sheet.add(goal[0], root, goal[1], goal[2], goal[3])
    far = 0.6 * float(np.linalg.norm(places[joints[1]] - places[joints[0]]) + 0.2 * size)
    spaces = [("root", root), ("world", ""), ("goal", goal_name), ("body", names[max(carrier, 0)])]
    pole_name = sheet.add(
        pole[0], root, places[joints[1]] + far * pole[1], body.axes,
        Control("", ControlShape.DIAMOND, 0.025 * size, side=side, spaces=spaces_of(*spaces), moves=_PLACE),
    )  # fmt: skip
    sheet.attribute(f"{name}.ik", goal_name, default=ik)
    sheet.attribute(f"{name}.stretch", goal_name)
    sheet.attribute(f"{name}.soft", goal_name, high=0.5)
    for twist in ("twist", "lower_twist"):
        sheet.attribute(f"{name}.{twist}", goal_name, low=-2 * np.pi, high=2 * np.pi, angle=True)
    ends = names[joints[0]], names[joints[1]], names[joints[2]]
    return LimbModule(name, ends, (made[0], made[1], made[2]), goal_name, pole_name)


def _bend(start: Floats, middle: Floats, end: Floats, usual: Floats) -> Floats:
    """The direction towards which a limb bends: where it does at rest, if that is anything like the usual, else the usual."""
    line = end - start
    reach = float(np.linalg.norm(line))
    along = line / max(reach, 1e-12)
    beside = middle - start - along * float((middle - start) @ along)
    size = float(np.linalg.norm(beside))
    if size > 1e-5 * reach and float(beside @ usual) > 0.2 * size:
        return beside / size
    return bone_of(usual - along * float(usual @ along))
