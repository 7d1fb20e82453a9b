"""A rig for any humanoid: controls placed and turned by where its joints are, whatever the joints' own axes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from keypose.analysis import RoleMap, find_roles
from keypose.analysis.roles import SIDES
from keypose.arrays import Floats
from keypose.errors import KeyposeError
from keypose.model import (
    Character,
    Control,
    ControlShape,
    ControlSide,
    EyesModule,
    FollowModule,
    HeadModule,
    LimbModule,
    Module,
    Property,
    Rig,
    Skeleton,
    Space,
    SpineModule,
)
from keypose.rig.body import Body, Sheet, bone_axes, bone_of, read_body
from keypose.rig.feet import foot_pivots
from keypose.rig.fingers import finger_module
from keypose.rig.plan import check_rig

_TURN = (Property.ROTATION,)
_PLACE = (Property.TRANSLATION,)
_SIDES = {"left": ("L", ControlSide.LEFT), "right": ("R", ControlSide.RIGHT)}


def auto_rig(
    skeleton: Skeleton,
    roles: RoleMap | Mapping[str, int] | None = None,
    *,
    name: str = "",
    character: Character | None = None,
) -> Rig:
    """The rig of a humanoid: root, pelvis, spine, head, eyes, jaw, shoulders, arms, hands, fingers, legs and feet.

    What a skeleton does not have gets no controls. ``roles`` are found where none are given (`analysis.find_roles`); the
    surface of ``character`` tells where soles end, and its name is that of the rig's character. Controls at rest give the rest pose.

    Raises:
        KeyposeError: where hips, spine, head, or a limb's joints cannot be told.
    """
    known = dict(_roles(skeleton, roles, character))
    body = read_body(skeleton, known, character)
    sheet = Sheet(skeleton)
    modules: list[Module] = []
    _trunk(sheet, body, modules)
    _head(sheet, body, modules)
    for side in SIDES:
        _arm(sheet, body, side, modules)
        _leg(sheet, body, side, modules)
    called = "" if character is None else character.name
    rig = Rig(
        name or called or "rig",
        called,
        sheet.controls(),
        tuple(sheet.looks),
        tuple(sheet.attributes),
        tuple(modules),
    )
    check_rig(rig, skeleton)
    return rig


def _roles(
    skeleton: Skeleton, roles: RoleMap | Mapping[str, int] | None, character: Character | None
) -> Mapping[str, int]:
    if roles is None:
        own = None if character is None else character.roles
        found = find_roles(skeleton, known=own or None)
        if not found.is_humanoid:
            missing = ", ".join(found.missing) or "arms: it stands on all fours"
            raise KeyposeError(f"no humanoid: nothing plays {missing}; name the joints in a map of roles")
        return found.roles
    return roles.roles if isinstance(roles, RoleMap) else roles


def _spaces(*named: tuple[str, str]) -> tuple[Space, ...]:
    """Spaces by label and target, each target once."""
    found: dict[str, Space] = {}
    for label, target in named:
        found.setdefault(target, Space(label, target))
    return tuple(found.values())


# ---- trunk -------------------------------------------------------------------------------------------------------------


def _trunk(sheet: Sheet, body: Body, modules: list[Module]) -> None:
    names, axes, size = body.skeleton.names, body.axes, body.size_m
    hips = body.roles["hips"]
    ground = body.places[hips] + body.up * (body.ground_m - body.places[hips] @ body.up)
    moves = (Property.TRANSLATION, Property.ROTATION, Property.SCALE)
    root = sheet.add("root", "", ground, axes, Control("", ControlShape.ARROWS, 0.3 * size, moves=moves))
    pelvis = sheet.add(
        "pelvis", root, body.places[hips], axes,
        Control("", ControlShape.SQUARE, 0.16 * size, spaces=_spaces(("root", root), ("world", ""))),
    )  # fmt: skip
    swing = sheet.add("hip_swing", pelvis, body.places[hips], axes, Control("", ControlShape.CIRCLE, 0.12 * size))
    modules.append(FollowModule("body", (names[hips],), (swing,), pelvis))
    spine = body.spine
    if not spine:
        return
    controls: list[str] = []
    above = pelvis
    for n, joint in enumerate(spine):
        above = sheet.add(
            f"spine.{n + 1}", above, body.places[joint], axes, Control("", ControlShape.CIRCLE, 0.11 * size)
        )
        controls.append(above)
    top = spine[-1]
    goal = sheet.add(
        "chest_ik", pelvis, body.places[top], axes,
        Control("", ControlShape.BOX, 0.1 * size, spaces=_spaces(("pelvis", pelvis), ("root", root), ("world", ""))),
    )  # fmt: skip
    modules.append(SpineModule("spine", tuple(names[j] for j in spine), tuple(controls), goal))
    sheet.attribute("spine.ik", goal)
    sheet.attribute("spine.stretch", goal, default=1.0)


def _head(sheet: Sheet, body: Body, modules: list[Module]) -> None:
    names, axes, size = body.skeleton.names, body.axes, body.size_m
    neck = body.neck
    head = neck[-1]
    above = sheet.named("root")
    carrier = body.parents[neck[0]]
    controls: list[str] = []
    for n, joint in enumerate(neck):
        name = "head" if joint == head else "neck" if len(neck) == 2 else f"neck.{n + 1}"
        look = Control(
            "", ControlShape.CIRCLE, (0.1 if joint == head else 0.06) * size,
            tuple(0.06 * size * body.up @ axes) if joint == head else (0.0, 0.0, 0.0),
            spaces=_spaces(("chest", names[carrier])) if n == 0 and carrier >= 0 else (),
        )  # fmt: skip
        above = sheet.add(name, above, body.places[joint], axes, look)
        controls.append(above)
    root, pelvis = sheet.named("root"), sheet.named("pelvis")
    spaces = [("root", root), ("world", ""), ("pelvis", pelvis)]
    if body.spine:
        spaces.append(("chest", names[body.spine[-1]]))
    eyes = [body.roles[f"{side}_eye"] for side in SIDES if f"{side}_eye" in body.roles]
    level = np.mean([body.places[j] for j in eyes], axis=0) if eyes else body.places[head] + 0.04 * size * body.up
    target = sheet.add(
        "look", root, level + 0.6 * size * body.forward, axes,
        Control("", ControlShape.DIAMOND, 0.04 * size, spaces=_spaces(*spaces), moves=_PLACE),
    )  # fmt: skip
    shares = [0.4 / (len(neck) - 1)] * (len(neck) - 1) + [1.0]
    modules.append(HeadModule("head", tuple(names[j] for j in neck), tuple(controls), target, tuple(shares)))
    sheet.attribute("head.look", target)
    if "jaw" in body.roles:
        jaw = body.roles["jaw"]
        look = Control(
            "", ControlShape.CIRCLE, 0.03 * size, tuple(0.05 * size * body.forward @ axes),
            spaces=_spaces(("head", names[body.parents[jaw]])),
        )  # fmt: skip
        control = sheet.add("jaw", above, body.places[jaw], axes, look)
        modules.append(FollowModule("jaw", (names[jaw],), (control,)))
    if eyes:
        _eyes(sheet, body, above, eyes, level, modules)


def _eyes(sheet: Sheet, body: Body, head: str, eyes: Sequence[int], level: Floats, modules: list[Module]) -> None:
    names, axes, size = body.skeleton.names, body.axes, body.size_m
    carrier = names[body.parents[eyes[0]]]
    root = sheet.named("root")
    far = 0.3 * size * body.forward
    both = sheet.add(
        "eyes", head, level + far, axes,
        Control("", ControlShape.SQUARE, 0.035 * size, spaces=_spaces(("head", carrier), ("root", root), ("world", ""))),
    )  # fmt: skip
    controls: list[str] = []
    for side in SIDES:
        if f"{side}_eye" not in body.roles:
            continue
        letter, colour = _SIDES[side]
        place = body.places[body.roles[f"{side}_eye"]] + far
        look = Control("", ControlShape.CIRCLE, 0.012 * size, side=colour, moves=_PLACE)
        controls.append(sheet.add(f"eye.{letter}", both, place, axes, look))
    modules.append(EyesModule("eyes", tuple(names[j] for j in eyes), tuple(controls)))
    sheet.attribute("eyes.look", both, default=1.0)


# ---- arms and legs -----------------------------------------------------------------------------------------------------


def _arm(sheet: Sheet, body: Body, side: str, modules: list[Module]) -> None:
    letter, colour = _SIDES[side]
    names, size, places = body.skeleton.names, body.size_m, body.places
    upper, lower, hand = (body.roles[f"{side}_{part}"] for part in ("upper_arm", "lower_arm", "hand"))
    above = sheet.named("root")
    shoulder = body.roles.get(f"{side}_shoulder")
    if shoulder is not None:
        bone = places[upper] - places[shoulder]
        carrier = body.parents[shoulder]
        look = Control(
            "", ControlShape.CIRCLE, 0.05 * size, (0.0, float(np.linalg.norm(bone)), 0.0), colour,
            _spaces(("chest", names[carrier])) if carrier >= 0 else (),
        )  # fmt: skip
        above = sheet.add(f"shoulder.{letter}", above, places[shoulder], bone_axes(bone, body.forward, body.up), look)
        modules.append(FollowModule(f"shoulder.{letter}", (names[shoulder],), (above,)))
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
    goal_look = Control("", ControlShape.BOX, 0.045 * size, side=colour, spaces=_spaces(*spaces))
    _limb(
        sheet, body, f"arm.{letter}", colour, (upper, lower, hand),
        (f"upper_arm.{letter}", f"lower_arm.{letter}", f"hand.{letter}"), axes, above,
        (f"hand_ik.{letter}", places[hand], axes[2], goal_look), (f"elbow.{letter}", pole), modules, ik=0.0,
    )  # fmt: skip
    fingers = finger_module(sheet, body, side, letter, colour)
    if fingers is not None:
        modules.append(fingers)


def _leg(sheet: Sheet, body: Body, side: str, modules: list[Module]) -> None:
    letter, colour = _SIDES[side]
    size, places = body.size_m, body.places
    upper, lower, foot = (body.roles[f"{side}_{part}"] for part in ("upper_leg", "lower_leg", "foot"))
    pole = _bend(places[upper], places[lower], places[foot], body.forward)
    heading = body.heading(side)
    flat = np.stack([np.cross(body.up, heading), body.up, heading], axis=1)
    axes = [
        bone_axes(places[lower] - places[upper], -pole, body.up),
        bone_axes(places[foot] - places[lower], -pole, body.up),
        flat,
    ]
    root = sheet.named("root")
    sole = 0.5 * body.foot_m
    drop = float((places[foot] @ body.up) - body.ground_m)
    goal_look = Control(
        "", ControlShape.FOOT, sole, (0.0, -drop, 0.6 * sole), colour,
        _spaces(("root", root), ("world", ""), ("pelvis", sheet.named("pelvis"))),
    )  # fmt: skip
    _limb(
        sheet, body, f"leg.{letter}", colour, (upper, lower, foot),
        (f"upper_leg.{letter}", f"lower_leg.{letter}", f"foot.{letter}"), axes, root,
        (f"foot_ik.{letter}", places[foot], flat, goal_look), (f"knee.{letter}", pole), modules, ik=1.0,
    )  # fmt: skip
    limb = modules.pop()
    if not isinstance(limb, LimbModule):
        return
    toes = ""
    if f"{side}_toes" in body.roles:
        joint = body.roles[f"{side}_toes"]
        look = Control("", ControlShape.CIRCLE, 0.035 * size, side=colour, moves=_TURN)
        toes = sheet.add(f"toes.{letter}", limb.goal, places[joint], flat, look)
    pivots = foot_pivots(body, side, f"foot.{letter}", toes)
    modules.append(LimbModule(limb.name, limb.joints, limb.controls, limb.goal, limb.pole, pivots))
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
) -> None:
    names, size, places = body.skeleton.names, body.size_m, body.places
    root = sheet.named("root")
    made: list[str] = []
    carrier = body.parents[joints[0]]
    for n, (control, joint) in enumerate(zip(controls, joints, strict=True)):
        bone = float(np.linalg.norm(places[joints[n + 1]] - places[joint])) if n < 2 else 0.0
        look = Control(
            "", ControlShape.CIRCLE, (0.06, 0.05, 0.045)[n] * size, (0.0, 0.5 * bone, 0.0), side,
            _spaces(("body", names[carrier])) if n == 0 and carrier >= 0 else (), moves=_TURN,
        )  # fmt: skip
        above = sheet.add(control, above, places[joint], axes[n], look)
        made.append(above)
    goal_name = sheet.add(goal[0], root, goal[1], goal[2], goal[3])
    far = 0.6 * float(np.linalg.norm(places[joints[1]] - places[joints[0]]) + 0.2 * size)
    spaces = [("root", root), ("world", ""), ("goal", goal_name), ("body", names[max(carrier, 0)])]
    pole_name = sheet.add(
        pole[0], root, places[joints[1]] + far * pole[1], body.axes,
        Control("", ControlShape.DIAMOND, 0.025 * size, side=side, spaces=_spaces(*spaces), moves=_PLACE),
    )  # fmt: skip
    modules.append(
        LimbModule(
            name,
            (names[joints[0]], names[joints[1]], names[joints[2]]),
            (made[0], made[1], made[2]),
            goal_name,
            pole_name,
        )
    )
    sheet.attribute(f"{name}.ik", goal_name, default=ik)
    sheet.attribute(f"{name}.stretch", goal_name)
    sheet.attribute(f"{name}.soft", goal_name, high=0.5)
    for twist in ("twist", "lower_twist"):
        sheet.attribute(f"{name}.{twist}", goal_name, low=-2 * np.pi, high=2 * np.pi, angle=True)


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
