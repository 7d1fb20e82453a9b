"""OpenSim models (.osim) as text: bodies, joints, coordinates and markers, of versions 2 to 4.

A body hangs on another by a joint: a fixed frame of the parent, turns about three axes and slides along three that follow
coordinates by functions, and a fixed frame of the child. It becomes a joint of a skeleton where the child's frame is, so
that it turns about itself.

Source: OpenSim documentation, "Joint", "CustomJoint", "SpatialTransform", "PhysicalOffsetFrame".
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from keypose.arrays import Floats
from keypose.errors import FormatError
from keypose.io.collada_xml import Element
from keypose.io.opensim_functions import Function, function_of
from keypose.io.text import shown
from keypose.math import euler, quat
from keypose.model import Pose, Skeleton

_MOST_BODIES = 10_000
_GROUND = "ground"
_X, _Y, _Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
# What other joints turn about and slide along, coordinate after coordinate.
_KINDS: dict[str, tuple[tuple[tuple[float, float, float], ...], tuple[tuple[float, float, float], ...]]] = {
    "WeldJoint": ((), ()),
    "PinJoint": ((_Z,), ()),
    "SliderJoint": ((), (_X,)),
    "UniversalJoint": ((_X, _Y), ()),
    "BallJoint": ((_X, _Y, _Z), ()),
    "GimbalJoint": ((_X, _Y, _Z), ()),
    "PlanarJoint": ((_Z,), (_X, _Y)),
    "FreeJoint": ((_X, _Y, _Z), (_X, _Y, _Z)),
}


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """A fixed frame in a body: place (3,) metres and rotation (4,)."""

    place: Floats
    rotation: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Axis:
    """A turn about, or slide along, a unit axis (3,), by a function of a coordinate (empty: a constant)."""

    coordinate: str
    axis: Floats
    function: Function


@dataclass(frozen=True, slots=True, eq=False)
class Coordinate:
    """A coordinate: what it starts at, its range, and whether its values are angles."""

    default: float
    low: float
    high: float
    is_angle: bool
    locked: bool


@dataclass(frozen=True, slots=True, eq=False)
class Joint:
    """A body and what it hangs on; ``parent`` an index or -1; frames in the parent's body and in its own."""

    body: str
    parent: int
    in_parent: Frame
    in_child: Frame
    turns: tuple[Axis, ...]
    slides: tuple[Axis, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """A model: joints with parents first, coordinates and markers (joint, place (3,) in the joint's axes) by name."""

    name: str
    joints: tuple[Joint, ...]
    coordinates: Mapping[str, Coordinate]
    markers: Mapping[str, tuple[int, Floats]]
    masses: Floats
    centers: Floats
    notes: tuple[str, ...]

    def skeleton(self) -> Skeleton:
        """One joint for each body, at rest where all coordinates start; the last ones end twice as far as their masses' centres."""
        parents = np.array([joint.parent for joint in self.joints], np.int32)
        leaves = sorted(set(range(len(parents))) - set(parents.tolist()))
        ends = tuple((leaf, _three(2.0 * self.centers[leaf])) for leaf in leaves if self.centers[leaf].any())
        return Skeleton(tuple(joint.body for joint in self.joints), parents, self.pose({}, 1)[0], ends)

    def pose(self, values: Mapping[str, Floats], frames: int) -> Pose:
        """The pose (T,) where coordinates have values (T,), radians and metres; what is not given stays as it starts."""
        count = len(self.joints)
        translations, rotations = np.empty((frames, count, 3)), np.empty((frames, count, 4))

        def follow(axis: Axis) -> Floats:
            default = self.coordinates[axis.coordinate].default if axis.coordinate else 0.0
            return axis.function(values.get(axis.coordinate, np.full(frames, default)))

        for n, joint in enumerate(self.joints):
            turned = np.broadcast_to([1.0, 0.0, 0.0, 0.0], (frames, 4))
            for axis in joint.turns:
                around = np.broadcast_to(axis.axis, (frames, 3))
                turned = quat.multiply(turned, quat.from_axis_angle(around, follow(axis)))
            slid = np.zeros((frames, 3))
            for axis in joint.slides:
                slid += follow(axis)[:, None] * axis.axis
            base = joint.in_parent
            place = base.place + quat.rotate(np.broadcast_to(base.rotation, (frames, 4)), slid)
            turned = quat.multiply(base.rotation, turned)
            if joint.parent >= 0:
                above = self.joints[joint.parent].in_child
                back = quat.conjugate(above.rotation)
                place = quat.rotate(np.broadcast_to(back, (frames, 4)), place - above.place)
                turned = quat.multiply(back, turned)
            translations[:, n], rotations[:, n] = place, quat.normalize(turned)
        return Pose(translations, quat.align_signs(rotations, axis=0), np.ones_like(translations))

    def extras(self) -> dict[str, Any]:
        """Coordinates, markers and masses as plain values, so that other formats can carry them."""
        names = [joint.body for joint in self.joints]
        joint_of: dict[str, str] = {}
        for joint in self.joints:
            joint_of |= {axis.coordinate: joint.body for axis in (*joint.turns, *joint.slides) if axis.coordinate}
        return {
            "coordinates": {
                name: {
                    "joint": joint_of.get(name, ""),
                    "kind": "angle" if one.is_angle else "length",
                    "default": one.default,
                    "range": [one.low, one.high],
                    "locked": one.locked,
                }
                for name, one in self.coordinates.items()
            },
            "axes": {
                joint.body: [axis.axis.tolist() for axis in joint.turns if axis.coordinate] for joint in self.joints
            },
            "markers": {
                name: {"joint": names[joint], "offset": place.tolist()} for name, (joint, place) in self.markers.items()
            },
            "masses": dict(zip(names, self.masses.tolist(), strict=True)),
            "centers": dict(zip(names, self.centers.tolist(), strict=True)),
        }


def parse_model(root: Element) -> Model:
    """The model of a file; raises `FormatError` where it does not follow the format, with the line."""
    model = root.first("Model")
    if root.tag != "OpenSimDocument" or model is None:
        inside = root.children[0].tag if root.children else "nothing"
        raise root.error(f"expected <OpenSimDocument> with a <Model>, found <{root.tag}> with <{inside}>")
    return _Parser(model).model()


class _Parser:
    def __init__(self, model: Element) -> None:
        self.root = model
        self.notes: list[str] = []
        self.coordinates: dict[str, Coordinate] = {}
        self.bodies: dict[str, Element] = {}
        for body in _objects(model, "BodySet"):
            name = body.get("name").strip()
            if body.tag != "Body" or name == _GROUND:
                continue
            if not name or name in self.bodies:
                raise body.error(f"expected bodies with names of their own, found {shown(name)}")
            self.bodies[name] = body
        if len(self.bodies) > _MOST_BODIES:
            raise model.error(f"more than {_MOST_BODIES} bodies")
        units = (model.first("length_units") or model).text.strip().lower()
        if units not in ("", "m", "meters", "metres", "meter", "metre"):
            raise model.error(f"lengths are in {shown(units)}; expected meters")

    def model(self) -> Model:
        found = self.joints()
        hung: dict[str, str] = {}
        for body, (parent, element, *_) in found.items():
            if parent != _GROUND and parent not in self.bodies:
                raise element.error(f"there is no body {shown(parent)}")
            hung[body] = parent
        order = self.in_order(hung)
        at = {body: n for n, body in enumerate(order)}
        joints: list[Joint] = []
        for body in order:
            parent, element, in_parent, in_child = found[body]
            turns, slides = self.axes(element)
            joints.append(Joint(body, at.get(parent, -1), in_parent, in_child, turns, slides))
        masses, centers = np.zeros(len(order)), np.zeros((len(order), 3))
        for n, body in enumerate(order):
            masses[n] = max(_number(self.bodies[body], "mass", 0.0), 0.0)
            centers[n] = _inside(joints[n].in_child, _vector(self.bodies[body], "mass_center"))
        constraints = len(_objects(self.root, "ConstraintSet"))
        if constraints:
            self.notes.append(f"{constraints} constraints between coordinates or bodies are not applied")
        name = self.root.get("name").strip()
        markers = self.markers(at, joints)
        return Model(name, tuple(joints), self.coordinates, markers, masses, centers, tuple(self.notes))

    def in_order(self, hung: Mapping[str, str]) -> list[str]:
        """Bodies, parents first."""
        order: list[str] = []
        done = {_GROUND}
        for body in self.bodies:
            if body not in hung:
                raise self.bodies[body].error("no joint hangs it on anything")
            chain: list[str] = []
            while body not in done:
                if body in chain:
                    raise self.bodies[body].error("it hangs on itself")
                chain.append(body)
                body = hung[body]
            order += reversed(chain)
            done.update(chain)
        return order

    def joints(self) -> dict[str, tuple[str, Element, Frame, Frame]]:
        """Of each body its parent's name, its joint, and both frames."""
        found: dict[str, tuple[str, Element, Frame, Frame]] = {}
        for body, element in self.bodies.items():  # up to version 3 a body holds its joint
            held = element.first("Joint")
            if held is not None and held.children:
                joint = held.children[0]
                parent = _text(joint, "parent_body")
                own = "location_in_child" if joint.first("location_in_child") else "location"
                frames = (
                    _frame(joint, "location_in_parent", "orientation_in_parent"),
                    _frame(joint, own, own.replace("location", "orientation")),
                )
                self.add(found, body, parent, joint, *frames)
        for joint in _objects(self.root, "JointSet"):
            parent, in_parent = self.socket(joint, "socket_parent_frame")
            body, in_child = self.socket(joint, "socket_child_frame")
            if body not in self.bodies:
                raise joint.error(f"there is no body {shown(body)}")
            self.add(found, body, parent, joint, in_parent, in_child)
        return found

    def add(
        self, found: dict[str, tuple[str, Element, Frame, Frame]], body: str, parent: str, joint: Element,
        in_parent: Frame, in_child: Frame,
    ) -> None:  # fmt: skip
        if body in found:
            raise joint.error(f"a second joint of the body {shown(body)}; loops are not read")
        reverse = joint.first("reverse")
        if reverse is not None and reverse.text.strip().lower() == "true":
            raise joint.error("a joint that is reversed is not read")
        found[body] = parent, joint, in_parent, in_child

    def socket(self, joint: Element, tag: str) -> tuple[str, Frame]:
        """The body that a joint's frame is fixed to, and where."""
        frames: dict[str, Element] = {}
        for frame in (joint.first("frames") or joint).all("PhysicalOffsetFrame"):
            frames[frame.get("name").strip()] = frame
        name = _last(_text(joint, tag))
        place, rotation = np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])
        for _ in range(len(frames) + 1):
            frame = frames.get(name)
            if frame is None:
                return name, Frame(place, rotation)
            base = _frame(frame, "translation", "orientation")
            place = base.place + quat.rotate(base.rotation, place)
            rotation = quat.multiply(base.rotation, rotation)
            name = _last(_text(frame, "socket_parent"))
        raise joint.error(f"its frames hang on each other: {shown(name)}")

    def axes(self, joint: Element) -> tuple[tuple[Axis, ...], tuple[Axis, ...]]:
        """What a joint turns about, then slides along; its coordinates are kept."""
        holder = joint.first("coordinates") or joint.first("CoordinateSet", "objects")
        own = list(holder.all("Coordinate")) if holder is not None else []
        names = [element.get("name").strip() for element in own]
        angles: set[str] = set()
        if joint.tag == "CustomJoint":
            turns, slides = self.transform(joint, names, angles)
        elif joint.tag in _KINDS:
            turning, sliding = _KINDS[joint.tag]
            wanted = len(turning) + len(sliding)
            if len(names) > wanted:
                raise joint.error(f"expected {wanted} coordinates, found {len(names)}")
            base = joint.get("name").strip()
            names += [f"{base}_coord_{n}" for n in range(len(names), wanted)]
            axes = [Axis(name, np.array(axis), _same) for name, axis in zip(names, turning + sliding, strict=True)]
            turns, slides = tuple(axes[: len(turning)]), tuple(axes[len(turning) :])
            angles.update(names[: len(turning)])
        else:
            raise joint.error("a kind of joint that is not read")
        for n, name in enumerate(names):
            if not name or name in self.coordinates:
                raise joint.error(f"expected coordinates with names of their own, found {shown(name)}")
            self.coordinates[name] = _coordinate(own[n] if n < len(own) else joint, name in angles)
        return turns, slides

    def transform(
        self, joint: Element, names: list[str], angles: set[str]
    ) -> tuple[tuple[Axis, ...], tuple[Axis, ...]]:
        """The axes of a custom joint; ``angles`` gets the coordinates that are angles themselves."""
        axes = list((joint.first("SpatialTransform") or joint).all("TransformAxis"))
        if len(axes) != 6:
            raise joint.error(f"expected a <SpatialTransform> of 6 axes, found {len(axes)}")
        found: list[Axis] = []
        for n, element in enumerate(axes):
            words = (element.first("coordinates") or element.first("coordinate") or joint).text.split()
            if len(words) > 1:
                raise element.error("a function of several coordinates is not read")
            if words and words[0] not in names:
                raise element.error(f"there is no coordinate {shown(words[0])} in this joint")
            direction = _vector(element, "axis")
            length = float(np.linalg.norm(direction))
            if length < 1e-9:
                raise element.error("its axis has no length")
            function, plain = function_of(element)
            if words and plain and n < 3:
                angles.add(words[0])
            found.append(Axis(words[0] if words else "", direction / length, function))
        return tuple(found[:3]), tuple(found[3:])

    def markers(self, at: Mapping[str, int], joints: list[Joint]) -> dict[str, tuple[int, Floats]]:
        found: dict[str, tuple[int, Floats]] = {}
        elsewhere = 0
        for marker in _objects(self.root, "MarkerSet"):
            name = marker.get("name").strip()
            holder = marker.first("socket_parent_frame") or marker.first("body")
            body = _last(holder.text) if holder is not None else ""
            if marker.tag != "Marker" or not name or name in found or body not in at:
                elsewhere += 1
                continue
            joint = at[body]
            found[name] = joint, _inside(joints[joint].in_child, _vector(marker, "location"))
        if elsewhere:
            self.notes.append(f"{elsewhere} markers without a name of their own or on no body were dropped")
        return found


def _three(values: Floats) -> tuple[float, float, float]:
    return float(values[0]), float(values[1]), float(values[2])


def _same(values: Floats) -> Floats:
    return values


def _inside(frame: Frame, place: Floats) -> Floats:
    """A place in a body, in the axes of a frame of it."""
    return np.asarray(quat.rotate(quat.conjugate(frame.rotation), place - frame.place))


def _coordinate(element: Element, is_angle: bool) -> Coordinate:
    held = element.first("range")
    low, high = held.numbers(2).tolist() if held is not None else (-np.pi, np.pi)
    locked = element.first("locked")
    return Coordinate(
        _number(element, "default_value", 0.0), min(low, high), max(low, high), is_angle,
        locked is not None and locked.text.strip().lower() == "true",
    )  # fmt: skip


def _objects(model: Element, name: str) -> list[Element]:
    held = model.first(name, "objects")
    return held.children if held is not None else []


def _last(path: str) -> str:
    return path.strip().rpartition("/")[2]


def _text(element: Element, tag: str) -> str:
    found = element.first(tag)
    if found is None or not found.text.strip():
        raise element.error(f"it has no <{tag}>")
    return found.text.strip()


def _number(element: Element, tag: str, default: float) -> float:
    found = element.first(tag)
    if found is None or not found.text.strip():
        return default
    return float(found.numbers(1)[0])


def _vector(element: Element, tag: str) -> Floats:
    found = element.first(tag)
    return np.zeros(3) if found is None else found.numbers(3)


def _frame(element: Element, place: str, orientation: str) -> Frame:
    return Frame(_vector(element, place), np.asarray(euler.to_quat(_vector(element, orientation), "XYZ")))


def check_size(frames: int, joints: int, size: int) -> None:
    """Raises `FormatError` where a motion would be far larger than its file."""
    if frames * joints * 80 > max(1 << 26, 256 * size):
        raise FormatError(f"{frames} frames of {joints} bodies, in a file of {size} bytes, would take too much memory")
