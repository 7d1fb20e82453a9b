"""Curves, clips, timelines and poses as JSON beside arrays: one schema for project files, journals and the studio.

``Store`` takes an array and returns what stands for it in the JSON; ``Fetch`` is the way back. Names and order of the
fields are those of the schema; `keypose.io.native` says what its versions changed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from enum import Enum
from typing import Any

import numpy as np

from keypose.arrays import Array
from keypose.errors import KeyposeError
from keypose.io.json_values import Json
from keypose.math.euler import CONVENTIONS
from keypose.model import (
    Channel,
    Clip,
    Curve,
    CurveKind,
    Extrapolation,
    Layer,
    LayerMode,
    Marker,
    Placement,
    Pose,
    Property,
    StoredPose,
    Timeline,
)

Store = Callable[[Array], Any]
Fetch = Callable[[Json], Array]

SIDES = ("in_tangents", "out_tangents", "in_handles", "out_handles")


# ---- to JSON -----------------------------------------------------------------------------------------------------------


def channel_json(channel: Channel) -> dict[str, Any]:
    """A channel's three fields."""
    return {"target": channel.target, "property": channel.property.value, "component": channel.component}


def curve_json(channel: Channel, curve: Curve, store: Store) -> dict[str, Any]:
    """A curve and the channel that it drives."""
    return {
        **channel_json(channel),
        "kind": curve.kind.value,
        "times": store(curve.times_s),
        "values": store(curve.values),
        "modes": store(curve.modes),
        **{name: _optional(getattr(curve, name), store) for name in SIDES},
        "types": _optional(curve.tangent_types, store),
        "before": curve.before.value,
        "after": curve.after.value,
    }


def clip_json(clip: Clip, store: Store) -> dict[str, Any]:
    """A clip with all its curves."""
    return {
        "name": clip.name,
        "rate_hz": None if clip.rate_hz is None else float(clip.rate_hz),
        "curves": [curve_json(channel, curve, store) for channel, curve in clip.curves.items()],
        "euler_orders": dict(clip.euler_orders),
    }


def timeline_json(timeline: Timeline, store: Store) -> dict[str, Any]:
    """A timeline with its layers and placements."""
    return {
        "name": timeline.name,
        "layers": [_layer_json(layer, store) for layer in timeline.layers],
        "rate_hz": float(timeline.rate_hz),
        "start_s": float(timeline.start_s),
        "end_s": float(timeline.end_s),
        "hold_frames": int(timeline.hold_frames),
        "markers": [{"time_s": float(m.time_s), "name": m.name} for m in timeline.markers],
    }


def pose_json(pose: StoredPose) -> dict[str, Any]:
    """A pose of the library; its numbers stand in the JSON itself, which keeps every bit of a float64."""
    parts = zip(pose.joint_names, pose.pose.translations, pose.pose.rotations, pose.pose.scales, strict=True)
    return {
        "name": pose.name,
        "joints": {
            name: {"translation": t.tolist(), "rotation": r.tolist(), "scale": s.tolist()} for name, t, r, s in parts
        },
        "morphs": dict(pose.morphs),
    }


def _optional(array: Array | None, store: Store) -> Any:
    return None if array is None else store(array)


def _layer_json(layer: Layer, store: Store) -> dict[str, Any]:
    influence = layer.influence
    # a frozenset has no order of its own; the schema's is the enumeration's
    properties = None if layer.properties is None else [p.value for p in Property if p in layer.properties]
    return {
        "name": layer.name,
        "placements": [_placement_json(placement, store) for placement in layer.placements],
        "mode": layer.mode.value,
        "influence": _plain_curve(influence, store) if isinstance(influence, Curve) else float(influence),
        "joints": {name: float(share) for name, share in layer.joints.items()},
        "properties": properties,
        "muted": layer.muted,
        "solo": layer.solo,
        "locked": layer.locked,
    }


def _placement_json(placement: Placement, store: Store) -> dict[str, Any]:
    return {
        "animation": placement.animation,
        "start_s": float(placement.start_s),
        "in_s": None if placement.in_s is None else float(placement.in_s),
        "out_s": None if placement.out_s is None else float(placement.out_s),
        "speed": float(placement.speed),
        "cycles": float(placement.cycles),
        "fade_in_s": float(placement.fade_in_s),
        "fade_out_s": float(placement.fade_out_s),
        "time_warp": None if placement.time_warp is None else _plain_curve(placement.time_warp, store),
        "weight": None if placement.weight is None else _plain_curve(placement.weight, store),
        "hold": placement.hold,
        "muted": placement.muted,
    }


def _plain_curve(curve: Curve, store: Store) -> dict[str, Any]:
    """A curve that drives no channel."""
    return curve_json(Channel("", Property.VALUE), curve, store)


# ---- from JSON ---------------------------------------------------------------------------------------------------------


def read_channel(item: Json) -> Channel:
    """A channel; raises `FormatError` naming the place."""
    component = item.get("component")
    number = None if component is None or component.value is None else component.as_integer(0, 3)
    return Channel(item.text("target"), choice(item, "property", Property), number)


def read_curve(item: Json, fetch: Fetch) -> tuple[Channel, Curve]:
    """A curve and its channel; raises `FormatError` naming the place, also where the curve itself does not hold."""
    channel = read_channel(item)
    sides = {name: _maybe(item, name, fetch) for name in SIDES}
    values = fetch(item.need("values"))
    try:
        curve = Curve(
            fetch(item.need("times")),
            values,
            _bytes(item, "modes", fetch),
            kind=choice(item, "kind", CurveKind),
            before=choice(item, "before", Extrapolation),
            after=choice(item, "after", Extrapolation),
            tangent_types=_bytes(item, "types", fetch),
            **sides,
        )
    except KeyposeError as error:
        item.fail(f"{channel}: {error}")
    return channel, curve


def read_curves(item: Json, key: str, fetch: Fetch) -> dict[Channel, Curve]:
    """The curves of a list, by channel; a channel that is there twice is refused."""
    curves: dict[Channel, Curve] = {}
    for each in item.items(key):
        channel, curve = read_curve(each, fetch)
        if channel in curves:
            each.fail(f"{channel} has two curves")
        curves[channel] = curve
    return curves


def read_clip(item: Json, fetch: Fetch) -> Clip:
    """A clip; raises `FormatError` naming the place."""
    rate = maybe_number(item, "rate_hz")
    if rate is not None and rate <= 0:
        item.need("rate_hz").fail(f"expected more than 0, got {rate}")
    return Clip(read_curves(item, "curves", fetch), item.text("name"), rate, read_orders(item))


def read_orders(item: Json) -> dict[str, str]:
    """The orders of Euler angles by joint; raises `FormatError` for one that is none."""
    orders = texts(item, "euler_orders")
    for joint, order in orders.items():
        if order not in CONVENTIONS:
            item.need("euler_orders").fail(f"joint '{joint}': expected an order such as XYZ, got {order[:20]!r}")
    return orders


def read_timeline(item: Json, fetch: Fetch) -> Timeline:
    """A timeline; raises `FormatError` naming the place."""
    layers = [_read_layer(layer, fetch) for layer in item.items("layers")]
    markers = [Marker(m.need("time_s").as_number(), m.text("name")) for m in item.items("markers")]
    return built(
        item,
        lambda: Timeline(
            tuple(layers),
            item.text("name"),
            item.need("rate_hz").as_number(),
            item.need("start_s").as_number(),
            item.need("end_s").as_number(),
            item.integer("hold_frames"),
            tuple(markers),
        ),
    )


def read_pose(item: Json) -> StoredPose:
    """A pose of the library; raises `FormatError` naming the place."""
    joints = list(item.members("joints"))
    rows: dict[str, list[tuple[float, ...]]] = {"translation": [], "rotation": [], "scale": []}
    for _, joint in joints:
        for name, width in (("translation", 3), ("rotation", 4), ("scale", 3)):
            rows[name].append(joint.numbers(name, width) or joint.fail(f"'{name}' is missing"))
    shape = (len(joints), -1)
    count = len(joints)
    pose = Pose(
        np.array(rows["translation"], np.float64).reshape(shape if count else (0, 3)),
        np.array(rows["rotation"], np.float64).reshape(shape if count else (0, 4)),
        np.array(rows["scale"], np.float64).reshape(shape if count else (0, 3)),
    )
    morphs = {name: weight.as_number() for name, weight in item.members("morphs")}
    return built(item, lambda: StoredPose(item.text("name"), tuple(name for name, _ in joints), pose, morphs))


def _read_layer(item: Json, fetch: Fetch) -> Layer:
    influence = item.need("influence")
    strength = read_curve(influence, fetch)[1] if isinstance(influence.value, Mapping) else influence.as_number()
    given = item.get("properties")
    properties = None
    if given is not None and given.value is not None:
        properties = frozenset(_member(each, Property) for each in item.items("properties"))
    placements = [_read_placement(each, fetch) for each in item.items("placements")]
    joints = {name: share.as_number() for name, share in item.members("joints")}
    return built(
        item,
        lambda: Layer(
            item.text("name"),
            tuple(placements),
            choice(item, "mode", LayerMode),
            strength,
            joints,
            properties,
            item.flag("muted"),
            item.flag("solo"),
            item.flag("locked"),
        ),
    )


def _read_placement(item: Json, fetch: Fetch) -> Placement:
    curves: dict[str, Curve | None] = {}
    for name in ("time_warp", "weight"):
        given = item.get(name)
        curves[name] = None if given is None or given.value is None else read_curve(given, fetch)[1]
    return built(
        item,
        lambda: Placement(
            item.text("animation"),
            item.need("start_s").as_number(),
            maybe_number(item, "in_s"),
            maybe_number(item, "out_s"),
            item.need("speed").as_number(),
            item.need("cycles").as_number(),
            item.need("fade_in_s").as_number(),
            item.need("fade_out_s").as_number(),
            hold=item.flag("hold"),
            muted=item.flag("muted"),
            **curves,
        ),
    )


# ---- what both use -----------------------------------------------------------------------------------------------------


def built(item: Json, make: Callable[[], Any]) -> Any:
    """What ``make`` builds; what its checks refuse is a `FormatError` at this place."""
    try:
        return make()
    except KeyposeError as error:
        if getattr(error, "where", ""):
            raise
        item.fail(str(error))


def choice(item: Json, key: str, kind: type[Enum]) -> Any:
    """A text member that names a value of an enumeration."""
    return _member(item.need(key), kind)


def maybe_number(item: Json, key: str) -> float | None:
    """A number member, or None where it is null or missing."""
    member = item.get(key)
    return None if member is None or member.value is None else member.as_number()


def texts(item: Json, key: str) -> dict[str, str]:
    """An object member of texts."""
    found: dict[str, str] = {}
    for name, value in item.members(key):
        if not isinstance(value.value, str):
            value.fail("expected a text")
        found[name] = value.value
    return found


def _member(item: Json, kind: type[Enum]) -> Any:
    try:
        return kind(item.value)
    except ValueError:
        known = ", ".join(str(entry.value) for entry in kind)
        item.fail(f"expected one of {known}, got {str(item.value)[:40]!r}")


def _maybe(item: Json, key: str, fetch: Fetch) -> Array | None:
    member = item.get(key)
    return None if member is None or member.value is None else fetch(member)


def _bytes(item: Json, key: str, fetch: Fetch) -> Array | None:
    array = _maybe(item, key, fetch)
    if array is None and key == "modes":
        item.fail("'modes' is missing")
    if array is not None and array.dtype != np.uint8:
        item.need(key).fail(f"expected bytes, got {array.dtype}")
    return array
