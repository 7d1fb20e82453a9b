"""A rig for any humanoid or animal on all fours: controls placed and turned by where its joints are, whatever the joints' own axes."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from keypose.analysis import RoleMap, find_roles
from keypose.analysis.roles import SIDES, joints_by_role
from keypose.arrays import Floats
from keypose.errors import KeyposeError
from keypose.model import (
    Attribute,
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
    SpineModule,
)
from keypose.rig.auto_limbs import FORELEG, SIDE_LABELS, rig_arm, rig_leg, rig_shoulder, spaces_of
from keypose.rig.body import Body, Sheet, bone_axes, read_body
from keypose.rig.limbs import is_bent_aside
from keypose.rig.plan import plan_of
from keypose.rig.twists import find_twists

_PLACE = (Property.TRANSLATION,)


def auto_rig(
    skeleton: Skeleton,
    roles: RoleMap | Mapping[str, int] | None = None,
    *,
    name: str = "",
    character: Character | None = None,
    taken: Collection[str] = (),
) -> Rig:
    """The rig of a humanoid: root, pelvis, spine, head, eyes, jaw, shoulders, arms, hands, fingers, legs and feet.

    An animal on all fours has forelegs in place of arms. Further chains that ``roles`` name (``tail:1``, ``left_ear:1``) follow
    a control for each joint.

    What a skeleton does not have gets no controls. ``roles`` are found where none are given (`analysis.find_roles`); the
    surface of ``character`` tells where soles end, and its name is that of the rig's character. ``taken`` are names that controls
    leave free, such as joints of clips beside it. Controls at rest give the rest pose.

    Raises:
        KeyposeError: where hips, spine, head, or a limb's joints cannot be told.
    """
    known = dict(_roles(skeleton, roles, character))
    body = read_body(skeleton, known, character)
    sheet = Sheet(skeleton, frozenset(taken))
    modules: list[Module] = []
    _trunk(sheet, body, modules)
    _head(sheet, body, modules)
    for side in SIDES:
        if body.on_all_fours:
            carrier = skeleton.names[body.spine[-1]] if body.spine else ""
            rig_leg(sheet, body, side, modules, FORELEG, rig_shoulder(sheet, body, side, modules), carrier)
        else:
            rig_arm(sheet, body, side, modules)
        rig_leg(sheet, body, side, modules)
    _chains(sheet, body, modules)
    twists = find_twists(body)
    if twists is not None:
        modules.append(twists)
        sheet.attribute(twists.attribute("follow"), sheet.named("root"), default=1.0)
    called = "" if character is None else character.name
    rig = Rig(
        name or called or "rig",
        called,
        sheet.controls(),
        tuple(sheet.looks),
        tuple(sheet.attributes),
        tuple(modules),
    )
    plan = plan_of(rig, skeleton)
    aside = [m for m in rig.modules if isinstance(m, LimbModule) and is_bent_aside(plan, m)]
    more = tuple(Attribute(m.attribute("rest_bend"), m.goal, 1.0) for m in aside)
    return replace(rig, attributes=(*rig.attributes, *more)) if more else rig


def _roles(
    skeleton: Skeleton, roles: RoleMap | Mapping[str, int] | None, character: Character | None
) -> Mapping[str, int]:
    if roles is None:
        own = None if character is None else character.roles
        found = find_roles(skeleton, known=own or None)
        if found.missing:
            missing = ", ".join(found.missing)
            raise KeyposeError(f"no humanoid or animal: nothing plays {missing}; name the joints in a map of roles")
        return found.roles
    return joints_by_role(roles, skeleton)


# ---- trunk -------------------------------------------------------------------------------------------------------------


def _trunk(sheet: Sheet, body: Body, modules: list[Module]) -> None:
    names, axes, size = body.skeleton.names, body.axes, body.size_m
    girth = 2.0 * size if body.on_all_fours else size
    hips = body.roles["hips"]
    ground = body.places[hips] + body.up * (body.ground_m - body.places[hips] @ body.up)
    moves = (Property.TRANSLATION, Property.ROTATION, Property.SCALE)
    root = sheet.add("root", "", ground, axes, Control("", ControlShape.ARROWS, 0.3 * size, moves=moves))
    pelvis = sheet.add(
        "pelvis", root, body.places[hips], axes,
        Control("", ControlShape.SQUARE, 0.16 * girth, spaces=spaces_of(("root", root), ("world", ""))),
    )  # fmt: skip
    swing = sheet.add(
        "hip_swing", pelvis, body.places[hips], body.along, Control("", ControlShape.CIRCLE, 0.12 * girth)
    )
    modules.append(FollowModule("body", (names[hips],), (swing,), pelvis))
    spine = body.spine
    if not spine:
        return
    controls: list[str] = []
    above = pelvis
    for n, joint in enumerate(spine):
        above = sheet.add(
            f"spine.{n + 1}", above, body.places[joint], body.along, Control("", ControlShape.CIRCLE, 0.11 * girth)
        )
        controls.append(above)
    # legs that hang on the spine, as a Biped's, do not sway with the chest's IK
    carrying = {body.parents[body.roles[f"{side}_upper_leg"]] for side in SIDES}
    low = max((n + 1 for n, joint in enumerate(spine) if joint in carrying), default=0)
    if low:
        modules.append(FollowModule("waist", tuple(names[j] for j in spine[:low]), tuple(controls[:low])))
        spine, controls = spine[low:], controls[low:]
    if not spine:
        return
    top = spine[-1]
    goal = sheet.add(
        "chest_ik", pelvis, body.places[top], body.along,
        Control("", ControlShape.BOX, 0.1 * size, spaces=spaces_of(("pelvis", pelvis), ("root", root), ("world", ""))),
    )  # fmt: skip
    modules.append(SpineModule("spine", tuple(names[j] for j in spine), tuple(controls), goal))
    sheet.attribute("spine.ik", goal)
    sheet.attribute("spine.stretch", goal, default=1.0)


def _head(sheet: Sheet, body: Body, modules: list[Module]) -> None:
    names, axes, size = body.skeleton.names, body.axes, body.size_m
    girth = 2.0 * size if body.on_all_fours else size
    neck = body.neck
    head = neck[-1]
    above = sheet.named("root")
    carrier = body.parents[neck[0]]
    controls: list[str] = []
    for n, joint in enumerate(neck):
        name = "head" if joint == head else "neck" if len(neck) == 2 else f"neck.{n + 1}"
        own = axes
        if body.on_all_fours:
            own = (
                body.along
                if joint == head
                else bone_axes(body.places[neck[n + 1]] - body.places[joint], -body.up, body.forward)
            )
        look = Control(
            "", ControlShape.CIRCLE, (0.1 if joint == head else 0.06) * girth,
            (0.0, 0.06 * girth, 0.0) if joint == head else (0.0, 0.0, 0.0),
            spaces=spaces_of(("chest", names[carrier])) if n == 0 and carrier >= 0 else (),
        )  # fmt: skip
        above = sheet.add(name, above, body.places[joint], own, look)
        controls.append(above)
    root, pelvis = sheet.named("root"), sheet.named("pelvis")
    spaces = [("root", root), ("world", ""), ("pelvis", pelvis)]
    if body.spine:
        spaces.append(("chest", names[body.spine[-1]]))
    eyes = [body.roles[f"{side}_eye"] for side in SIDES if f"{side}_eye" in body.roles]
    level = np.mean([body.places[j] for j in eyes], axis=0) if eyes else body.places[head] + 0.04 * size * body.up
    target = sheet.add(
        "look", root, level + 0.6 * size * body.forward, axes,
        Control("", ControlShape.DIAMOND, 0.04 * size, spaces=spaces_of(*spaces), moves=_PLACE),
    )  # fmt: skip
    shares = [0.4 / max(len(neck) - 1, 1)] * (len(neck) - 1) + [1.0]
    modules.append(HeadModule("head", tuple(names[j] for j in neck), tuple(controls), target, tuple(shares)))
    sheet.attribute("head.look", target)
    if "jaw" in body.roles:
        jaw = body.roles["jaw"]
        look = Control(
            "", ControlShape.CIRCLE, 0.03 * size, tuple(0.05 * size * body.forward @ axes),
            spaces=spaces_of(("head", names[body.parents[jaw]])),
        )  # fmt: skip
        control = sheet.add("jaw", above, body.places[jaw], axes, look)
        modules.append(FollowModule("jaw", (names[jaw],), (control,)))
    if eyes:
        _eyes(sheet, body, above, eyes, level, modules)


def _chains(sheet: Sheet, body: Body, modules: list[Module]) -> None:
    """Tails, ears and whatever else is named in chains: a control for each joint."""
    names, size = body.skeleton.names, body.size_m
    chains: dict[str, dict[int, int]] = {}
    for role, joint in body.roles.items():
        stem, colon, number = role.partition(":")
        if colon:
            chains.setdefault(stem, {})[int(number)] = joint
    for stem, numbered in chains.items():
        side = next((s for s in SIDES if stem.startswith(f"{s}_")), "")
        letter, colour = SIDE_LABELS[side] if side else ("", ControlSide.MIDDLE)
        stem, dot = stem.removeprefix(f"{side}_"), f".{letter}" if letter else ""
        joints = [numbered[n] for n in sorted(numbered)]
        above, controls = sheet.named("root"), list[str]()
        for n, joint in enumerate(joints):
            tip = body.places[joints[n + 1]] if n + 1 < len(joints) else body.tip(joint)
            before = body.places[joints[n - 1]] if n else body.places[body.roles["hips"]]
            bone = (body.places[joint] - before) if tip is None else tip - body.places[joint]
            carrier = body.parents[joint]
            hangs = n == 0 or not body.hangs(joint, joints[n - 1])
            look = Control(
                "", ControlShape.CIRCLE, 0.08 * size, side=colour,
                spaces=spaces_of(("body", names[carrier])) if hangs and carrier >= 0 else (),
            )  # fmt: skip
            above = sheet.add(
                f"{stem}.{n + 1}{dot}", above, body.places[joint], bone_axes(bone, body.up, body.forward), look
            )
            controls.append(above)
        modules.append(FollowModule(f"{stem}{dot}", tuple(names[j] for j in joints), tuple(controls)))


def _eyes(sheet: Sheet, body: Body, head: str, eyes: Sequence[int], level: Floats, modules: list[Module]) -> None:
    names, axes, size = body.skeleton.names, body.axes, body.size_m
    carrier = names[body.parents[eyes[0]]]
    root = sheet.named("root")
    far = 0.3 * size * body.forward
    both = sheet.add(
        "eyes", head, level + far, axes,
        Control("", ControlShape.SQUARE, 0.035 * size, spaces=spaces_of(("head", carrier), ("root", root), ("world", ""))),
    )  # fmt: skip
    controls: list[str] = []
    for side in SIDES:
        if f"{side}_eye" not in body.roles:
            continue
        letter, colour = SIDE_LABELS[side]
        place = body.places[body.roles[f"{side}_eye"]] + far
        look = Control("", ControlShape.CIRCLE, 0.012 * size, side=colour, moves=_PLACE)
        controls.append(sheet.add(f"eye.{letter}", both, place, axes, look))
    modules.append(EyesModule("eyes", tuple(names[j] for j in eyes), tuple(controls)))
    sheet.attribute("eyes.look", both, default=1.0)
