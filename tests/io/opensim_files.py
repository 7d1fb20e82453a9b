"""One small OpenSim model as text of version 2 and of version 4, and a table of its coordinates."""

from __future__ import annotations

SPLINE = ((-2.0, -1.2, -0.5, 0.1, 1.5), (-0.42, -0.41, -0.4, -0.395, -0.396))


def _coordinate(name: str, default: float = 0.0) -> str:
    return f"""<Coordinate name="{name}"><default_value>{default}</default_value><range>-2 2</range>
      <locked>false</locked></Coordinate>"""


def _axis(name: str, coordinate: str, axis: str, function: str, old: bool) -> str:
    inner = f"<function>{function}</function>" if old else function
    return f"""<TransformAxis name="{name}"><coordinates>{coordinate}</coordinates><axis>{axis}</axis>{inner}</TransformAxis>"""


def _transform(axes: list[tuple[str, str, str]], old: bool) -> str:
    kinds = ("rotation1", "rotation2", "rotation3", "translation1", "translation2", "translation3")
    rows = [_axis(kind, *axis, old) for kind, axis in zip(kinds, axes, strict=True)]
    return f"<SpatialTransform>{''.join(rows)}</SpatialTransform>"


_SAME = "<LinearFunction><coefficients> 1 0</coefficients></LinearFunction>"
_NONE = "<Constant><value>0</value></Constant>"
_KNEE = f"<SimmSpline><x>{' '.join(map(str, SPLINE[0]))}</x><y>{' '.join(map(str, SPLINE[1]))}</y></SimmSpline>"


def _scaled(function: str, old: bool) -> str:
    inner = f"<function>{function}</function>" if old else function
    return f"<MultiplierFunction>{inner}<scale>1.5</scale></MultiplierFunction>"


def _joints(old: bool) -> list[tuple[str, str, str, str, str, tuple[str, str], tuple[str, str]]]:
    """Kind, name, parent, body, what is inside, and the frames in parent and child: place and orientation."""
    free = _transform(
        [("tilt", "0 0 1", _SAME), ("list", "1 0 0", _SAME), ("turn", "0 1 0", _SAME),
         ("tx", "1 0 0", _SAME), ("ty", "0 1 0", _SAME), ("tz", "0 0 1", _SAME)], old,
    )  # fmt: skip
    knee = _transform(
        [("knee", "0 0 1", _SAME), ("", "0 1 0", _NONE), ("", "1 0 0", _NONE),
         ("", "1 0 0", _NONE), ("knee", "0 1 0", _scaled(_KNEE, old)), ("", "0 0 1", _NONE)], old,
    )  # fmt: skip
    six = "".join(_coordinate(n, 0.9 if n == "ty" else 0.0) for n in ("tilt", "list", "turn", "tx", "ty", "tz"))
    return [
        ("CustomJoint", "root", "ground", "pelvis", six + "|" + free, ("0 0 0", "0 0 0"), ("0 0 0", "0 0 0")),
        ("PinJoint", "ankle", "shin", "foot", _coordinate("ankle", 0.1) + "|", ("0 -0.4 0", "0.2 0.3 -0.1"), ("0.01 0.02 -0.03", "0 0.1 0")),
        ("CustomJoint", "knee", "thigh", "shin", _coordinate("knee", -0.2) + "|" + knee, ("0 0 0", "0 0 0"), ("0 0 0", "0 0 0")),
        ("BallJoint", "hip", "pelvis", "thigh", "".join(map(_coordinate, ("flex", "add", "rot"))) + "|", ("-0.07 -0.06 0.08", "0 0 0"), ("0 0.05 0", "0 0 0.3")),
        ("WeldJoint", "neck", "pelvis", "torso", "|", ("-0.1 0.08 0", "0 0 0"), ("0 0 0", "0 0 0")),
    ]  # fmt: skip


_BODIES = {"foot": 1.2, "torso": 33.0, "pelvis": 11.0, "shin": 3.5, "thigh": 9.0}
_MARKERS = {"Heel": ("foot", "-0.02 0.01 0"), "Top": ("torso", "0.1 0.69 0")}


def osim_2() -> str:
    """Joints inside bodies."""
    joints = {
        body: (kind, name, parent, inside, above, own) for kind, name, parent, body, inside, above, own in _joints(True)
    }
    bodies = ['<Body name="ground"><mass>0</mass><Joint /></Body>']
    for body, mass in _BODIES.items():
        kind, name, parent, inside, above, own = joints[body]
        coordinates, _, transform = inside.partition("|")
        bodies.append(
            f"""<Body name="{body}">
  <mass>{mass}</mass>
  <mass_center>0 -0.1 0</mass_center>
  <Joint><{kind} name="{name}">
    {transform}
    <parent_body>{parent}</parent_body>
    <location_in_parent>{above[0]}</location_in_parent>
    <orientation_in_parent>{above[1]}</orientation_in_parent>
    <location>{own[0]}</location>
    <orientation>{own[1]}</orientation>
    <CoordinateSet><objects>{coordinates}</objects></CoordinateSet>
    <reverse>false</reverse>
  </{kind}></Joint>
</Body>"""
        )
    markers = "".join(
        f'<Marker name="{name}"><body>{body}</body><location>{place}</location></Marker>'
        for name, (body, place) in _MARKERS.items()
    )
    return _document(20302, "".join(bodies), "", markers)


def osim_4() -> str:
    """Bodies, then joints that name frames."""
    bodies = "".join(
        f'<Body name="{body}"><mass>{mass}</mass><mass_center>0 -0.1 0</mass_center></Body>\n'
        for body, mass in _BODIES.items()
    )
    joints = ""
    for kind, name, parent, body, inside, above, own in _joints(False):
        coordinates, _, transform = inside.partition("|")
        frames = "".join(
            f"""<PhysicalOffsetFrame name="{base}_offset">
      <socket_parent>{"/ground" if base == "ground" else "/bodyset/" + base}</socket_parent>
      <translation>{place}</translation><orientation>{turn}</orientation></PhysicalOffsetFrame>"""
            for base, (place, turn) in ((parent, above), (body, own))
        )
        joints += f"""<{kind} name="{name}">
    <socket_parent_frame>{parent}_offset</socket_parent_frame>
    <socket_child_frame>{body}_offset</socket_child_frame>
    <coordinates>{coordinates}</coordinates>
    <frames>{frames}</frames>
    {transform}
  </{kind}>
"""
    markers = "".join(
        f'<Marker name="{name}"><socket_parent_frame>/bodyset/{body}</socket_parent_frame><location>{place}</location></Marker>'
        for name, (body, place) in _MARKERS.items()
    )
    return _document(40000, bodies, f"<JointSet><objects>{joints}</objects></JointSet>", markers)


def _document(version: int, bodies: str, joints: str, markers: str) -> str:
    return f"""<?xml version="1.0" encoding="UTF-8" ?>
<OpenSimDocument Version="{version}">
<Model name="leg">
<length_units>meters</length_units>
<BodySet><objects>
{bodies}
</objects></BodySet>
{joints}
<MarkerSet><objects>{markers}</objects></MarkerSet>
</Model>
</OpenSimDocument>
"""


MOT = """walk
version=1
nRows=4
nColumns=5
inDegrees=yes

endheader
time\ttx\tflex\tknee\tunknown
0.5\t0.1\t10\t-20\t7
0.51\t0.2\t20\t-25\t7
0.52\t0.3\t30\t-30\t7
0.53\t0.4\t40\t-35\t7
"""
