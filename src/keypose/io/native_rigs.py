"""Rigs as JSON: one schema for project files, journals and the studio, as `native_values` is for clips.

Numbers stand in the JSON itself, which keeps every bit of a float64; a limit that is none is null. Only the curves of drivers
are arrays.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from keypose.io.json_values import Json
from keypose.io.native_values import (
    Fetch,
    Store,
    built,
    channel_json,
    choice,
    curve_json,
    read_channel,
    read_curve,
)
from keypose.model import (
    Attribute,
    Channel,
    Constraint,
    ConstraintKind,
    Control,
    ControlShape,
    ControlSide,
    Driver,
    EyesModule,
    Finger,
    FingersModule,
    FollowModule,
    FootPivots,
    HeadModule,
    LimbModule,
    Module,
    Pose,
    Property,
    Rig,
    Skeleton,
    Space,
    SpineModule,
    Twist,
    TwistModule,
)

MODULES: Mapping[str, type[Any]] = {
    "follow": FollowModule,
    "limb": LimbModule,
    "spine": SpineModule,
    "head": HeadModule,
    "eyes": EyesModule,
    "fingers": FingersModule,
    "twist": TwistModule,
}
_KINDS = {module: kind for kind, module in MODULES.items()}

PIVOTS = ("heel", "ball", "tip", "left", "right")


# ---- to JSON -----------------------------------------------------------------------------------------------------------


def rig_json(rig: Rig, store: Store) -> dict[str, Any]:
    """A whole rig."""
    rest = rig.controls.rest
    return {
        "name": rig.name,
        "character": rig.character,
        "controls": [
            {
                "name": look.name,
                "parent": int(parent),
                "translation": rest.translations[n].tolist(),
                "rotation": rest.rotations[n].tolist(),
                "scale": rest.scales[n].tolist(),
                "shape": look.shape.value,
                "size_m": look.size_m,
                "offset_m": list(look.offset_m),
                "side": look.side.value,
                "spaces": [{"name": s.name, "target": s.target} for s in look.spaces],
                "moves": [p.value for p in look.moves],
            }
            for n, (look, parent) in enumerate(zip(rig.looks, rig.controls.parents, strict=True))
        ],
        "attributes": [
            {
                "name": a.name,
                "control": a.control,
                "default": float(a.default),
                "minimum": float(a.minimum),
                "maximum": float(a.maximum),
                "choices": list(a.choices),
                "angle": a.angle,
            }
            for a in rig.attributes
        ],
        "modules": [_module_json(module) for module in rig.modules],
        "constraints": [_constraint_json(constraint) for constraint in rig.constraints],
        "drivers": [_driver_json(driver, store) for driver in rig.drivers],
    }


def _module_json(module: Module) -> dict[str, Any]:
    fields: dict[str, Any] = {"kind": _KINDS[type(module)], "name": module.name}
    if isinstance(module, FingersModule):
        return fields | {"hand": module.hand, "fingers": [_finger_json(finger) for finger in module.fingers]}
    if isinstance(module, TwistModule):
        return fields | {"twists": [_twist_json(twist) for twist in module.twists]}
    fields |= {"joints": list(module.joints), "controls": list(module.controls)}
    if isinstance(module, FollowModule):
        return fields | {"carrier": module.carrier}
    if isinstance(module, LimbModule):
        foot = None if module.foot is None else _foot_json(module.foot)
        return fields | {"goal": module.goal, "pole": module.pole, "foot": foot}
    if isinstance(module, SpineModule):
        return fields | {"goal": module.goal}
    if isinstance(module, HeadModule):
        return fields | {"target": module.target, "shares": list(module.shares)}
    return fields


def _finger_json(finger: Finger) -> dict[str, Any]:
    return {
        "name": finger.name,
        "joints": list(finger.joints),
        "controls": list(finger.controls),
        "bends": list(finger.bends),
        "spread": float(finger.spread),
    }


def _twist_json(twist: Twist) -> dict[str, Any]:
    share = float(twist.share)
    return {"joint": twist.joint, "bone": twist.bone, "end": twist.end, "share": share, "axis": list(twist.axis)}


def _foot_json(foot: FootPivots) -> dict[str, Any]:
    pivots = {name: list(getattr(foot, name)) for name in PIVOTS}
    return {"name": foot.name, **pivots, "toes_joint": foot.toes_joint, "toes_control": foot.toes_control}


def _constraint_json(constraint: Constraint) -> dict[str, Any]:
    return {
        "name": constraint.name,
        "kind": constraint.kind.value,
        "owner": constraint.owner,
        "targets": list(constraint.targets),
        "shares": [float(s) for s in constraint.shares],
        "weight": float(constraint.weight),
        "weight_attribute": constraint.weight_attribute,
        "keep_offset": constraint.keep_offset,
        "axes": list(constraint.axes),
        "low": [float(v) if math.isfinite(v) else None for v in constraint.low],
        "high": [float(v) if math.isfinite(v) else None for v in constraint.high],
        "aim_axis": list(constraint.aim_axis),
        "up_axis": None if constraint.up_axis is None else list(constraint.up_axis),
        "up": list(constraint.up),
    }


def _driver_json(driver: Driver, store: Store) -> dict[str, Any]:
    curve = driver.curve
    return {
        **channel_json(driver.channel),
        "expression": driver.expression,
        "curve": None if curve is None else curve_json(Channel("", Property.VALUE), curve, store),
    }


# ---- from JSON ---------------------------------------------------------------------------------------------------------


def read_rig(item: Json, fetch: Fetch) -> Rig:
    """A rig; raises `FormatError` naming the place."""
    controls = item.items("controls")
    looks = tuple(_read_control(each) for each in controls)
    parents = np.array([each.need("parent").as_integer(-1, max(len(controls), 1)) for each in controls], np.int32)
    rows = {
        name: np.array([_numbers(each, name, width) for each in controls], np.float64).reshape(-1, width)
        for name, width in (("translation", 3), ("rotation", 4), ("scale", 3))
    }
    attributes = tuple(_read_attribute(each) for each in item.items("attributes"))
    modules = tuple(_read_module(each) for each in item.items("modules"))
    constraints = tuple(_read_constraint(each) for each in item.items("constraints"))
    drivers = tuple(_read_driver(each, fetch) for each in item.items("drivers"))

    def make() -> Rig:
        rest = Pose(rows["translation"], rows["rotation"], rows["scale"])
        skeleton = Skeleton(tuple(look.name for look in looks), parents, rest)
        return Rig(
            item.text("name"), item.text("character"), skeleton, looks, attributes, modules, constraints, drivers
        )

    return built(item, make)


def _read_control(item: Json) -> Control:
    spaces = tuple(Space(each.text("name"), each.text("target")) for each in item.items("spaces"))
    moves = tuple(_property(each) for each in item.items("moves"))
    return built(
        item,
        lambda: Control(
            item.text("name"),
            choice(item, "shape", ControlShape),
            item.need("size_m").as_number(),
            _vector(item, "offset_m"),
            choice(item, "side", ControlSide),
            spaces,
            moves,
        ),
    )


def _read_attribute(item: Json) -> Attribute:
    return built(
        item,
        lambda: Attribute(
            item.text("name"),
            item.text("control"),
            item.need("default").as_number(),
            item.need("minimum").as_number(),
            item.need("maximum").as_number(),
            item.texts("choices"),
            item.flag("angle"),
        ),
    )


def _read_module(item: Json) -> Module:
    kind = item.text("kind")
    if kind not in _READERS:
        item.need("kind").fail(f"no module '{kind[:40]}'; known: {', '.join(_READERS)}")
    return built(item, lambda: _READERS[kind](item))


_READERS: Mapping[str, Callable[[Json], Module]] = {
    "follow": lambda i: FollowModule(i.text("name"), i.texts("joints"), i.texts("controls"), i.text("carrier")),
    "limb": lambda i: LimbModule(
        i.text("name"), _three(i, "joints"), _three(i, "controls"), i.text("goal"), i.text("pole"), _read_foot(i)
    ),
    "spine": lambda i: SpineModule(i.text("name"), i.texts("joints"), i.texts("controls"), i.text("goal")),
    "head": lambda i: HeadModule(
        i.text("name"), i.texts("joints"), i.texts("controls"), i.text("target"), i.numbers("shares", None) or ()
    ),
    "eyes": lambda i: EyesModule(i.text("name"), i.texts("joints"), i.texts("controls")),
    "fingers": lambda i: FingersModule(
        i.text("name"), i.text("hand"), tuple(_read_finger(each) for each in i.items("fingers"))
    ),
    "twist": lambda i: TwistModule(i.text("name"), tuple(_read_twist(each) for each in i.items("twists"))),
}


def _read_finger(item: Json) -> Finger:
    return built(
        item,
        lambda: Finger(
            item.text("name"),
            item.texts("joints"),
            item.texts("controls"),
            item.numbers("bends", None) or (),
            item.need("spread").as_number(),
        ),
    )


def _read_twist(item: Json) -> Twist:
    return built(
        item,
        lambda: Twist(
            item.text("joint"),
            item.text("bone"),
            item.text("end"),
            item.need("share").as_number(),
            _vector(item, "axis"),
        ),
    )


def _read_foot(item: Json) -> FootPivots | None:
    foot = item.need("foot")
    if foot.value is None:
        return None
    pivots = {name: _vector(foot, name) for name in PIVOTS}
    return FootPivots(
        foot.text("name"), **pivots, toes_joint=foot.text("toes_joint"), toes_control=foot.text("toes_control")
    )


def _read_constraint(item: Json) -> Constraint:
    axes = item.items("axes")
    for axis in axes:
        if not isinstance(axis.value, bool):
            axis.fail("expected true or false")
    up_axis = item.get("up_axis")
    return built(
        item,
        lambda: Constraint(
            item.text("name"),
            choice(item, "kind", ConstraintKind),
            item.text("owner"),
            item.texts("targets"),
            item.numbers("shares", None) or (),
            item.need("weight").as_number(),
            item.text("weight_attribute"),
            item.flag("keep_offset"),
            tuple(axis.value for axis in axes),  # type: ignore[arg-type]
            _limits(item, "low", -math.inf),
            _limits(item, "high", math.inf),
            _vector(item, "aim_axis"),
            None if up_axis is None or up_axis.value is None else _vector(item, "up_axis"),
            _vector(item, "up"),
        ),
    )


def _read_driver(item: Json, fetch: Fetch) -> Driver:
    channel, curve = read_channel(item), item.get("curve")
    given = None if curve is None or curve.value is None else read_curve(curve, fetch)[1]
    return built(item, lambda: Driver(channel, item.text("expression"), given))


# ---- what all use ------------------------------------------------------------------------------------------------------


def _numbers(item: Json, key: str, count: int) -> tuple[float, ...]:
    found = item.numbers(key, count)
    if found is None:
        item.fail(f"'{key}' is missing")
    return found


def _vector(item: Json, key: str) -> tuple[float, float, float]:
    x, y, z = _numbers(item, key, 3)
    return x, y, z


def _limits(item: Json, key: str, none: float) -> tuple[float, float, float]:
    found = [none if each.value is None else each.as_number() for each in item.items(key)]
    if len(found) != 3:
        item.need(key).fail(f"expected 3 numbers, got {len(found)}")
    return found[0], found[1], found[2]


def _three(item: Json, key: str) -> tuple[str, str, str]:
    texts = item.texts(key)
    if len(texts) != 3:
        item.need(key).fail(f"expected 3 names, got {len(texts)}")
    return texts[0], texts[1], texts[2]


def _property(item: Json) -> Property:
    known = {p.value: p for p in Property}
    if not isinstance(item.value, str) or item.value not in known:
        item.fail(f"expected one of {', '.join(known)}, got {str(item.value)[:40]!r}")
    return known[item.value]
