"""OpenSim as an independent judge: its walking model, its markers, and the coordinates that its own solver found for them.

Degrees of freedom are made equal: hips, back and pelvis turn freely, ankles are hinges about the model's slanted axes, and a
knee, which slides as it bends, turns about the axis about which it does so at that moment, until that axis stays where it is.
What is left of the difference is what OpenSim prints (angles to 1e-8 degrees, markers to five digits) and where it stops
(``accuracy`` 1e-5): its coordinates are not quite the best ones for the markers, ours are.
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import least_squares

from keypose import evaluate, io
from keypose.arrays import Floats
from keypose.ik import Hinge, IkResult, PositionTask, Smoothness, SolveOptions, solve_pose, solve_window
from keypose.io.collada_xml import parse_xml
from keypose.io.opensim_model import Model, parse_model
from keypose.math import euler, quat
from keypose.model import Pose, Skeleton

pytestmark = pytest.mark.data

FOLDER = "ik_reference/opensim_gait2354"
KNEES = {"tibia_r": "knee_angle_r", "tibia_l": "knee_angle_l"}
HINGES = {
    "talus_r": "ankle_angle_r", "calcn_r": "subtalar_angle_r", "talus_l": "ankle_angle_l", "calcn_l": "subtalar_angle_l",
}  # fmt: skip
# Flexion about z, then x, then y of the joint; the left leg's other two angles count the other way.
BALLS = {
    "pelvis": ("pelvis_tilt", "pelvis_list", "pelvis_rotation"),
    "femur_r": ("hip_flexion_r", "hip_adduction_r", "hip_rotation_r"),
    "femur_l": ("hip_flexion_l", "hip_adduction_l", "hip_rotation_l"),
    "torso": ("lumbar_extension", "lumbar_bending", "lumbar_rotation"),
}
SIGNS = {"femur_l": (1.0, -1.0, -1.0)}
TRAVELS = ("pelvis_tx", "pelvis_ty", "pelvis_tz")


@dataclass(frozen=True)
class Solved:
    """Coordinates by name (T,), and how far markers are from theirs (T, N) metres."""

    coordinates: Mapping[str, Floats]
    distances: Floats


@pytest.fixture(scope="module")
def model(data_dir: Path) -> Model:
    return parse_model(parse_xml(data_dir / FOLDER / "subject01_simbody.osim"))


def marker_distances(model: Model, values: Mapping[str, Floats], names: tuple[str, ...], places: Floats) -> Floats:
    pose = model.pose(values, len(places))
    turned, at = (np.asarray(a) for a in evaluate.world_rotations_positions(model.skeleton(), pose))
    found = np.empty(places.shape)
    for n, name in enumerate(names):
        joint, offset = model.markers[name]
        found[:, n] = at[:, joint] + quat.rotate(turned[:, joint], offset)
    return np.linalg.norm(found - places, axis=-1)


def slides(model: Model, knee: str, angle: Floats) -> Floats:
    """Where a tibia is in its femur (T, 3), by the model's own functions."""
    joint = next(j for j in model.joints if j.body == knee)
    return sum((axis.function(angle)[:, None] * axis.axis for axis in joint.slides), np.zeros((len(angle), 3)))


def solve(model: Model, names: tuple[str, ...], places: Floats, weights: Floats) -> Solved:
    """The whole model by `solve_pose`: every knee with a joint at its momentary axis and the tibia fixed to that."""
    plain = model.skeleton()
    frames = len(places)
    joints = list(plain.names)
    parents = [int(p) for p in plain.parents]
    for knee in KNEES:  # the joint stays where the tibia was in the list; the tibia itself comes right behind it
        at = joints.index(knee)
        joints.insert(at, f"{knee} axis")
        parents = [p + (p >= at) for p in parents]
        parents.insert(at + 1, at)
    rest = Pose(np.zeros((len(joints), 3)), np.tile([1.0, 0.0, 0.0, 0.0], (len(joints), 1)), np.ones((len(joints), 3)))
    skeleton = Skeleton(tuple(joints), np.array(parents, np.int32), rest)
    still = np.array([joints.index(name) for name in plain.names])
    axes = {j.body: j.turns[0].axis for j in model.joints if j.body in HINGES or j.body in KNEES}
    limits = {
        (f"{body} axis" if body in KNEES else body): Hinge(tuple(axis.tolist()), -np.pi, np.pi)
        for body, axis in axes.items()
    }
    tasks = [
        PositionTask(plain.names[joint], places[:, n], weights[n], tuple(offset.tolist()))
        for n, name in enumerate(names)
        for joint, offset in [model.markers[name]]
    ]
    begun = model.pose({}, frames)
    translations = np.zeros((frames, len(joints), 3))
    translations[:, still] = begun.translations
    rotations = np.tile([1.0, 0.0, 0.0, 0.0], (frames, len(joints), 1))
    knees = {knee: np.full(frames, -0.3) for knee in KNEES}
    for _ in range(60):
        for knee, angle in knees.items():
            at, small = joints.index(f"{knee} axis"), 1e-6
            rate = (slides(model, knee, angle + small) - slides(model, knee, angle - small)) / (2.0 * small)
            place = slides(model, knee, angle)
            axis = np.broadcast_to(axes[knee], place.shape)
            centre = place + np.cross(axis, rate)
            turn = quat.from_axis_angle(axis, angle)
            translations[:, at], rotations[:, at] = centre, turn
            translations[:, at + 1] = quat.rotate(quat.conjugate(turn), place - centre)
        pose = Pose(translations, rotations, np.ones_like(translations))
        found = solve_pose(
            skeleton, pose, tasks, limits=limits, fixed=[*KNEES, "toes_r", "toes_l"],
            options=SolveOptions(tolerance_m=1e-12, settled_rad=1e-12, still_m=1e-14),
        )  # fmt: skip
        translations, rotations = np.array(found.pose.translations), np.array(found.pose.rotations)
        before = knees
        knees = {knee: _angle(rotations[:, joints.index(f"{knee} axis")], axes[knee]) for knee in KNEES}
        if max(float(np.abs(knees[k] - before[k]).max()) for k in KNEES) < 1e-9:
            break
    values = {KNEES[knee]: angle for knee, angle in knees.items()}
    values |= {HINGES[body]: _angle(rotations[:, joints.index(body)], axes[body]) for body in HINGES}
    for body, coordinates in BALLS.items():
        angles = np.asarray(euler.from_quat(rotations[:, joints.index(body)], "ZXY")) * SIGNS.get(body, (1.0, 1.0, 1.0))
        values |= dict(zip(coordinates, angles.T, strict=True))
    values |= dict(zip(TRAVELS, translations[:, 0].T, strict=True))
    return Solved(values, marker_distances(model, values, names, places))


def _angle(turn: Floats, axis: Floats) -> Floats:
    angle = 2.0 * np.arctan2(turn[:, 1:] @ axis, turn[:, 0])
    return (angle + np.pi) % (2.0 * np.pi) - np.pi


def rms(distances: Floats) -> Floats:
    return np.sqrt(np.mean(distances**2, axis=1))


def test_every_frame_fits_the_markers_at_least_as_well_as_opensim(data_dir: Path, model: Model) -> None:
    """All markers count alike, as the tool's own settings have it."""
    markers = io.load(data_dir / FOLDER / "subject01_synthetic_marker_data.trc").markers[0]
    table = io.load(data_dir / FOLDER / "std_subject01_walk1_ik.mot").signals[0]
    theirs = {
        name: np.asarray(column) * (np.pi / 180.0 if unit == "deg" else 1.0)
        for name, column, unit in zip(table.names, np.asarray(table.values).T, table.units, strict=True)
    }
    places = np.asarray(markers.positions, np.float64)
    ours = solve(model, markers.names, places, np.ones(len(markers.names)))
    opensim = rms(marker_distances(model, theirs, markers.names, places))
    print(f"markers RMS: OpenSim {opensim.mean() * 1e6:.1f} um, ours {rms(ours.distances).mean() * 1e6:.1f} um")
    assert (rms(ours.distances) <= opensim).all()
    assert opensim.max() < 1e-4  # the model is put together as OpenSim does it, or its own solution would not fit
    off = {name: np.abs(values - theirs[name]).max() for name, values in ours.coordinates.items()}
    angles = {name: float(np.rad2deg(value)) for name, value in off.items() if name not in TRAVELS}
    worst = max(angles, key=lambda name: angles[name])
    print(
        f"coordinates: at most {angles[worst]:.4f} degrees off ({worst}), {max(off[t] for t in TRAVELS) * 1e6:.0f} um"
    )
    assert angles[worst] < 0.02
    assert max(off[name] for name in TRAVELS) < 1e-4


def test_measured_markers_are_fitted_as_well_as_a_general_solver_does_it(data_dir: Path, model: Model) -> None:
    """The walk as it was captured: 2 cm of every marker cannot be fitted; SciPy solves for the model's own coordinates."""
    markers = io.load(data_dir / "trc/opensim/subject01_walk1.trc").markers[0]
    names = tuple(name for name in markers.names if name in model.markers)
    assert len(names) > 25
    places = np.asarray(markers.positions, np.float64)[:, [markers.index(name) for name in names]]
    weights = np.where([name in ("V.Sacral", "R.Toe.Tip", "L.Toe.Tip") for name in names], 2.0, 1.0)
    frames = np.arange(0, len(places), 30)
    ours = solve(model, names, places[frames], weights)
    known, skeleton = list(ours.coordinates), model.skeleton()

    def missed(at: Floats, frame: int) -> Floats:
        """Of coordinates (*B, C) what every marker is off by, weighted (*B, 3N)."""
        rows = np.atleast_2d(at)
        pose = model.pose(dict(zip(known, rows.T, strict=True)), len(rows))
        turned, where = (np.asarray(a) for a in evaluate.world_rotations_positions(skeleton, pose))
        attached = [model.markers[name] for name in names]
        found = np.stack([where[:, j] + quat.rotate(turned[:, j], offset) for j, offset in attached], axis=1)
        return ((found - places[frame]) * weights[:, None]).reshape(*np.shape(at)[:-1], -1)

    def slope(at: Floats, frame: int) -> Floats:
        small = 1e-6 * np.eye(len(at))
        return (missed(at + small, frame) - missed(at - small, frame)).T / 2e-6

    jacobian: Any = slope
    for n, frame in enumerate(frames):
        begin = np.array([values[n] for values in ours.coordinates.values()])
        reference = least_squares(
            missed, begin + 0.02, jacobian, args=(int(frame),), xtol=1e-12, ftol=1e-14, gtol=1e-12
        )
        cost = float(np.sum((weights * ours.distances[n]) ** 2))
        assert cost <= 2.0 * reference.cost * (1.0 + 1e-6)
        np.testing.assert_allclose(begin, reference.x, atol=1e-4)


def test_a_captured_walk_is_smoothed_without_being_late(data_dir: Path) -> None:
    """Solved together, markers are as near as before and joints jerk a third as much; nearness to the frame before is late."""
    importlib.import_module("keypose.kernels.fullbody")  # frames alone then take the compiled path
    scene = io.load(data_dir / FOLDER / "subject01_simbody.osim")
    body, told = scene.character.skeleton, scene.character.extras["opensim"]
    markers = io.load(data_dir / "trc/opensim/subject01_walk1.trc").markers[0]
    places, attached = np.asarray(markers.positions, np.float64), told["markers"]
    points = [
        PositionTask(attached[name]["joint"], places[:, n], offset=attached[name]["offset"])
        for n, name in enumerate(markers.names)
        if name in attached
    ]
    axes: dict[str, list[list[float]]] = told["axes"]
    limits = {joint: Hinge((x, y, z), -np.pi, np.pi) for joint, ((x, y, z), *more) in _turning(axes) if not more}
    arrays = (np.asarray(a, np.float64) for a in (body.rest.translations, body.rest.rotations, body.rest.scales))
    pose = Pose(*(np.broadcast_to(a, (len(places), *a.shape)) for a in arrays))
    smooth = Smoothness(0.3, root_weight=0.3)
    alone = solve_pose(body, pose, points, limits=limits)
    before = solve_pose(body, pose, [*points, smooth], limits=limits)
    together = solve_window(body, pose, [*points, smooth], limits=limits)
    assert together.converged.all()

    def figures(found: IkResult) -> tuple[float, float, Floats]:
        """RMS metres of markers, RMS jerk in radians per frame cubed, the angle of a knee."""
        missed = np.stack(
            [left.distance_m for left in found.residuals if left.angle_rad is None and left.distance_m is not None]
        )
        turned = np.asarray(found.pose.rotations)
        steps = quat.to_rotation_vector(quat.multiply(turned[1:], quat.conjugate(turned[:-1])))
        jerk = np.linalg.norm(np.diff(steps, 2, axis=0), axis=-1)
        knee = turned[:, body.index("tibia_r")]
        return (
            float(np.sqrt(np.mean(missed**2))),
            float(np.sqrt(np.mean(jerk**2))),
            2.0 * np.arctan2(knee[:, 3], knee[:, 0]),
        )

    rms_alone, jerk_alone, knee = figures(alone)
    rms_together, jerk_together, knee_together = figures(together)
    speed = np.gradient(knee)
    late = [-float(np.sum((angle - knee) * speed) / np.sum(speed**2)) for angle in (knee_together, figures(before)[2])]
    assert rms_together < 1.001 * rms_alone < figures(before)[0]
    assert jerk_together < jerk_alone / 3.0
    assert abs(late[0]) < 0.02 < 0.5 < late[1]


def _turning(axes: Mapping[str, list[list[float]]]) -> list[tuple[str, list[list[float]]]]:
    return [(joint, own) for joint, own in axes.items() if own]
