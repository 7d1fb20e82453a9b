"""Controls of fingers: bones that bend towards the palm, and how a hand closes and fans."""

from __future__ import annotations

import itertools

import numpy as np

from keypose.analysis.roles import FINGERS
from keypose.model import Control, ControlShape, ControlSide, Finger, FingersModule, Property
from keypose.rig.body import Body, Sheet, bone_axes

_BONES = ("metacarpal", "proximal", "intermediate", "distal")

# A closed fist, bone by bone from the knuckle; the thumb closes less.
_CLOSED = np.radians((80.0, 95.0, 65.0))
_THUMB = np.radians((25.0, 40.0, 60.0))

# A fan about the middle finger.
_FAN = {"thumb": 1.4, "index": 1.0, "middle": 0.0, "ring": -0.8, "little": -1.7}


def finger_module(sheet: Sheet, body: Body, side: str, letter: str, colour: ControlSide) -> FingersModule | None:
    """The fingers of a hand, or None where it has none."""
    hand = body.roles[f"{side}_hand"]
    names, places, palm = body.skeleton.names, body.places, body.palm(side)
    fingers: list[Finger] = []
    for finger in FINGERS:
        joints = [body.roles[r] for bone in _BONES if (r := f"{side}_{finger}_{bone}") in body.roles]
        if (
            not joints
            or any(body.parents[b] != a for a, b in itertools.pairwise(joints))
            or not body.hangs(joints[0], hand)
        ):
            continue
        ends = [places[j] for j in joints[1:]]
        tip = body.tip(joints[-1])
        previous = places[joints[-1]] - (places[joints[-2]] if len(joints) > 1 else places[hand])
        ends.append(tip if tip is not None else places[joints[-1]] + 0.8 * previous)
        towards = palm
        if finger == "thumb":  # across the palm, to the root of the ring finger
            root = body.roles.get(f"{side}_ring_proximal", body.roles.get(f"{side}_middle_proximal"))
            if root is not None:
                towards = places[root] + 0.02 * body.size_m * palm - ends[-1]
        above = sheet.named(f"hand.{letter}")
        controls: list[str] = []
        for n, (joint, end) in enumerate(zip(joints, ends, strict=True)):
            bone = end - places[joint]
            look = Control(
                "", ControlShape.CIRCLE, 0.009 * body.size_m, (0.0, 0.5 * float(np.linalg.norm(bone)), 0.0), colour,
                moves=(Property.ROTATION,),
            )  # fmt: skip
            above = sheet.add(f"{finger}.{n + 1}.{letter}", above, places[joint], bone_axes(bone, towards, palm), look)
            controls.append(above)
        closed = _THUMB if finger == "thumb" else _CLOSED
        bends = (
            tuple(float(b) for b in closed[-len(joints) :]) if len(joints) < 3 else _spread_over(closed, len(joints))
        )
        # the axis of the fan is the controls' Z, which points away from the palm on the left and to it on the right
        fan = _FAN[finger] * (1.0 if side == "left" else -1.0)
        fingers.append(Finger(f"{finger}.{letter}", tuple(names[j] for j in joints), tuple(controls), bends, fan))
    if not fingers:
        return None
    module = FingersModule(f"hand.{letter}", names[hand], tuple(fingers))
    goal = sheet.named(f"hand.{letter}")
    sheet.attribute(module.attribute("curl"), goal, low=-0.3)
    sheet.attribute(module.attribute("spread"), goal, low=-0.3, high=0.5, angle=True)
    for finger in fingers:
        sheet.attribute(f"{finger.name}.curl", goal, low=-1.0)
    return module


def _spread_over(closed: np.ndarray, count: int) -> tuple[float, ...]:
    """Bends of a finger that has as many bones as the table, or more (metacarpals hardly bend)."""
    return (*[float(np.radians(5.0))] * (count - 3), *(float(b) for b in closed))
