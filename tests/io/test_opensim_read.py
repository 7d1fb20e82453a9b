"""OpenSim models and tables: both ways of writing a model, every joint beside SciPy, splines, rates, gaps, what is refused."""

from __future__ import annotations

import doctest
import re
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import keypose.io
from keypose import evaluate
from keypose.errors import FormatError
from keypose.io.opensim_functions import spline_through
from keypose.model import Motion, Scene
from tests.conftest import ROOT
from tests.io.damage import load_damaged
from tests.io.opensim_files import MOT, SPLINE, osim_2, osim_4


def load(tmp_path: Path, text: str, name: str = "leg.osim") -> Scene:
    path = tmp_path / name
    path.write_text(text)
    return keypose.io.load(path)


def motion_of(scene: Scene) -> Motion:
    assert isinstance(scene.animations[0], Motion)
    return scene.animations[0]


def test_versions_two_and_four_say_the_same(tmp_path: Path) -> None:
    old, new = load(tmp_path, osim_2()), load(tmp_path, osim_4())
    a, b = old.character, new.character
    assert a.skeleton.names == b.skeleton.names == ("pelvis", "thigh", "shin", "foot", "torso")
    assert a.skeleton.parents.tolist() == b.skeleton.parents.tolist() == [-1, 0, 1, 2, 0]
    for part in ("translations", "rotations"):
        assert np.array_equal(getattr(a.skeleton.rest, part), getattr(b.skeleton.rest, part))
    assert a.extras["opensim"] == b.extras["opensim"]
    assert a.skeleton.end_offsets == b.skeleton.end_offsets
    ends = dict(a.skeleton.end_offsets)
    assert set(ends) == {a.skeleton.index("foot"), a.skeleton.index("torso")}
    assert np.allclose(ends[a.skeleton.index("torso")], [0.0, -0.2, 0.0])
    assert old.format == new.format == "osim"


def reference(values: dict[str, float]) -> dict[str, np.ndarray]:
    """The world transforms of the bodies (4, 4) as OpenSim puts a joint together, with SciPy's rotations."""

    def frame(place: list[float], turn: list[float]) -> np.ndarray:
        out = np.eye(4)
        out[:3, :3], out[:3, 3] = Rotation.from_euler("XYZ", turn).as_matrix(), place
        return out

    def moved(order: str, angles: list[float], place: list[float]) -> np.ndarray:
        out = np.eye(4)
        out[:3, :3], out[:3, 3] = Rotation.from_euler(order, angles).as_matrix(), place
        return out

    v = values
    pelvis = moved("ZXY", [v["tilt"], v["list"], v["turn"]], [v["tx"], v["ty"], v["tz"]])
    hip = frame([-0.07, -0.06, 0.08], [0, 0, 0]) @ moved("XYZ", [v["flex"], v["add"], v["rot"]], [0, 0, 0])
    thigh = pelvis @ hip @ np.linalg.inv(frame([0, 0.05, 0], [0, 0, 0.3]))
    slide = 1.5 * float(spline_through(np.array(SPLINE[0]), np.array(SPLINE[1]))(np.array([v["knee"]]))[0])
    shin = thigh @ moved("ZXY", [v["knee"], 0, 0], [0, slide, 0])
    ankle = frame([0, -0.4, 0], [0.2, 0.3, -0.1]) @ moved("ZXY", [v["ankle"], 0, 0], [0, 0, 0])
    foot = shin @ ankle @ np.linalg.inv(frame([0.01, 0.02, -0.03], [0, 0.1, 0]))
    return {"pelvis": pelvis, "foot": foot, "torso": pelvis @ frame([-0.1, 0.08, 0], [0, 0, 0])}


def test_bodies_are_where_their_joints_put_them(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    names = ["tilt", "list", "turn", "tx", "ty", "tz", "flex", "add", "rot", "knee", "ankle"]
    rows = rng.uniform(-0.9, 0.9, (20, len(names)))
    table = "\n".join("\t".join(f"{v:.15g}" for v in (0.1 * n, *row)) for n, row in enumerate(rows))
    load(tmp_path, osim_4())
    scene = load(tmp_path, f"x\nversion=1\ninDegrees=no\nendheader\ntime\t{chr(9).join(names)}\n{table}\n", "take.sto")
    body, motion = scene.character.skeleton, motion_of(scene)
    turned, places = (np.asarray(a) for a in evaluate.world_rotations_positions(body, motion.pose))
    for marker, body_name in (("Heel", "foot"), ("Top", "torso")):
        held = scene.character.extras["opensim"]["markers"][marker]
        joint = body.index(held["joint"])
        in_body = np.array([-0.02, 0.01, 0, 1]) if marker == "Heel" else np.array([0.1, 0.69, 0, 1])
        for n, row in enumerate(rows):
            expected = reference(dict(zip(names, row, strict=True)))[body_name] @ in_body
            w, x, y, z = turned[n, joint]
            found = places[n, joint] + Rotation.from_quat([x, y, z, w]).apply(held["offset"])
            np.testing.assert_allclose(found, expected[:3], atol=1e-12)


def test_a_joint_turns_about_itself(tmp_path: Path) -> None:
    """Where a child's frame is away from its body, the joint is at the frame: turning it does not move it."""
    load(tmp_path, osim_2())
    scene = load(tmp_path, MOT.replace("flex", "ankle"), "take.mot")
    places = np.asarray(motion_of(scene).pose.translations)
    foot = scene.character.skeleton.index("foot")
    assert np.ptp(places[:, foot], axis=0).max() < 1e-15
    assert np.ptp(np.asarray(motion_of(scene).pose.rotations)[:, foot], axis=0).max() > 0.05


def test_a_table_is_a_motion_of_the_model_beside_it(tmp_path: Path) -> None:
    load(tmp_path, osim_4())
    scene = load(tmp_path, MOT, "take.mot")
    motion = motion_of(scene)
    assert (motion.frame_count, motion.rate_hz, motion.start_s) == (4, 100.0, 0.5)
    assert np.allclose(motion.pose.translations[:, 0], [[0.1 * k, 0.9, 0.0] for k in (1, 2, 3, 4)])
    assert scene.signals[0].names == ("tx", "flex", "knee", "unknown")
    assert scene.signals[0].units == ("", "deg", "deg", "")
    assert "skeleton: leg.osim" in scene.notes
    assert any("coordinates have no column and stay as they start" in note for note in scene.notes)
    flex = np.asarray(motion.pose.rotations)[:, 1]
    turned = Rotation.from_quat(flex[:, [1, 2, 3, 0]]) * Rotation.from_quat(flex[0, [1, 2, 3, 0]]).inv()
    np.testing.assert_allclose(np.rad2deg(turned.magnitude()), [0, 10, 20, 30], atol=1e-9)


def test_a_table_without_a_model_is_signals_and_a_model_can_be_named(tmp_path: Path) -> None:
    alone = tmp_path / "alone"
    alone.mkdir()
    scene = load(alone, MOT, "take.mot")
    assert not scene.characters and not scene.animations
    assert scene.signals[0].kind == "scalar" and scene.signals[0].values.shape == (4, 4)
    assert any(note.startswith("skeleton: no model") for note in scene.notes)
    load(tmp_path, osim_4())
    named = keypose.io.load(alone / "take.mot", skeleton=tmp_path / "leg.osim")
    assert motion_of(named).frame_count == 4
    forces = MOT.replace("tx\tflex\tknee\tunknown", "force_x\tforce_y\tforce_z\tmoment")
    assert not load(tmp_path, forces, "forces.mot").animations
    with pytest.raises(FormatError, match=r"none of its columns is a coordinate of leg\.osim"):
        keypose.io.load(tmp_path / "forces.mot", skeleton=tmp_path / "leg.osim")


def test_angles_of_simm_are_degrees_and_states_have_paths(tmp_path: Path) -> None:
    load(tmp_path, osim_4())
    simm = MOT.replace("inDegrees=yes\n", "").replace("nColumns=5", "datacolumns 5").replace("nRows=4", "datarows 4")
    plain, old = load(tmp_path, MOT, "a.mot"), load(tmp_path, simm, "b.mot")
    assert np.array_equal(motion_of(plain).pose.rotations, motion_of(old).pose.rotations)
    states = MOT.replace(
        "tx\tflex\tknee\tunknown",
        "/jointset/root/tx/value\t/jointset/hip/flex/value\t/jointset/knee/knee/value\t/jointset/hip/flex/speed",
    )
    path = load(tmp_path, states, "c.sto")
    assert np.array_equal(motion_of(plain).pose.rotations, motion_of(path).pose.rotations)


def test_uneven_times_are_made_even_and_rounded_ones_are_not(tmp_path: Path) -> None:
    load(tmp_path, osim_4())
    rounded = (
        MOT.replace("0.5\t", "0.5\t")
        .replace("0.51\t", "0.517\t")
        .replace("0.52\t", "0.533\t")
        .replace("0.53\t", "0.550\t")
    )
    scene = load(tmp_path, rounded, "rounded.mot")
    assert motion_of(scene).rate_hz == 60.0 and motion_of(scene).frame_count == 4
    uneven = MOT.replace("0.53\t", "0.55\t")
    scene = load(tmp_path, uneven, "uneven.mot")
    assert motion_of(scene).frame_count == 6 and abs(motion_of(scene).rate_hz - 100) < 1e-9
    assert np.allclose(motion_of(scene).pose.translations[:, 0, 0], [0.1, 0.2, 0.3, 0.3 + 0.1 / 3, 0.3 + 0.2 / 3, 0.4])
    assert any(note.startswith("frame rate: times are uneven") for note in scene.notes)


def test_gaps_in_coordinates_are_bridged_and_told(tmp_path: Path) -> None:
    load(tmp_path, osim_4())
    scene = load(tmp_path, MOT.replace("0.51\t0.2\t", "0.51\tNaN\t"), "take.mot")
    assert np.allclose(motion_of(scene).pose.translations[:, 0, 0], [0.1, 0.2, 0.3, 0.4])
    assert np.isnan(scene.signals[0].values[1, 0])
    assert any("have gaps" in note for note in scene.notes)


def test_the_spline_is_that_of_forsythe_malcolm_and_moler() -> None:
    """Cubics are kept, curvature has no jumps, the ends bend as the cubics of their four points do, and go on straight."""
    rng = np.random.default_rng(1)
    x = np.sort(rng.uniform(-2, 2, 9))
    cubic = np.polynomial.Polynomial(rng.normal(size=4))
    at = np.linspace(x[0], x[-1], 500)
    np.testing.assert_allclose(spline_through(x, cubic(x))(at), cubic(at), atol=1e-12)
    y = rng.normal(size=9)
    found = spline_through(x, y)
    np.testing.assert_allclose(found(x), y, atol=1e-12)
    small = 1e-4
    bend = (found(x[1:-1] + small) - 2 * found(x[1:-1]) + found(x[1:-1] - small)) / small**2
    for k, here in enumerate(x[1:-1]):
        for side in (-1, 1):
            near = here + side * 5e-3
            beside = (
                found(np.array([near + small])) - 2 * found(np.array([near])) + found(np.array([near - small]))
            ) / small**2
            nearer = here + side * 2.5e-3
            halfway = (
                found(np.array([nearer + small])) - 2 * found(np.array([nearer])) + found(np.array([nearer - small]))
            ) / small**2
            assert abs(2 * halfway[0] - beside[0] - bend[k]) < 1e-3 * (1 + abs(bend[k]))  # a line from there on
    for part, points in ((slice(0, 4), (x[0], x[1])), (slice(-4, None), (x[-2], x[-1]))):
        third = np.polynomial.Polynomial.fit(x[part], y[part], 3).deriv(3)(0.0)
        s = np.linspace(points[0], points[1], 4)
        piece = np.polynomial.Polynomial.fit(s, found(s), 3).deriv(3)(0.0)
        assert abs(piece - third) < 1e-6 * (1 + abs(third))
    beyond = np.array([x[-1] + 0.3, x[-1] + 0.6, x[-1] + 0.9])
    assert abs(np.diff(found(beyond), 2)[0]) < 1e-12


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("PinJoint", "EllipsoidJoint"), "a kind of joint that is not read"),
        (("/bodyset/shin", "/bodyset/sin"), "there is no body 'sin'"),
        (("/bodyset/thigh", "/bodyset/foot"), "a second joint of the body"),
        (("<axis>0 0 1</axis>", "<axis>0 0 0</axis>"), "its axis has no length"),
        (("<coordinates>knee<", "<coordinates>kne<"), "there is no coordinate 'kne'"),
        (("LinearFunction", "SineFunction"), "a kind of function that is not read"),
        (("-2.0 -1.2", "-1.2 -2.0"), "the x of its points do not rise"),
        (("meters", "inches"), "lengths are in 'inches'"),
        (("Model", "IKTaskSet"), "expected <OpenSimDocument> with a <Model>, found <OpenSimDocument> with <IKTaskSet>"),
    ],
)  # fmt: skip
def test_what_is_refused_says_where(tmp_path: Path, change: tuple[str, str], message: str) -> None:
    with pytest.raises(FormatError, match=re.escape(message)) as caught:
        load(tmp_path, osim_4().replace(*change))
    assert re.search(r"line \d+", str(caught.value))


def test_bodies_that_hang_on_themselves_are_refused(tmp_path: Path) -> None:
    text = osim_2().replace("<parent_body>pelvis</parent_body>", "<parent_body>foot</parent_body>", 1)
    with pytest.raises(FormatError, match="it hangs on itself"):
        load(tmp_path, text.replace("<parent_body>ground</parent_body>", "<parent_body>foot</parent_body>"))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (MOT.replace("endheader\n", ""), "expected a header that ends with 'endheader'"),
        (MOT.replace("time\t", "frame\t"), "expected labels that begin with 'time'"),
        (MOT.replace("\t-25\t", "\tx\t"), "line 10: expected a number, found 'x'"),
        (MOT.replace("0.52\t", "0.50\t"), "line 11: times must be numbers that rise"),
        (MOT[: MOT.index("time")], "ends before the labels"),
    ],
)  # fmt: skip
def test_tables_that_are_refused_say_where(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(FormatError, match=re.escape(message)):
        load(tmp_path, text, "take.mot")


def test_six_hundred_damaged_models(tmp_path: Path) -> None:
    files = [tmp_path / "old.osim", tmp_path / "new.osim"]
    files[0].write_text(osim_2())
    files[1].write_text(osim_4())
    folder = tmp_path / "damaged"
    folder.mkdir()
    result = load_damaged(files, 600, folder)
    assert result["wrong"] == []
    assert result["slowest_s"] < 2, result["slowest"]
    assert result["peak_mib"] < 1024
    assert result["loaded"] > 50 and result["refused"] > 150


def test_six_hundred_damaged_tables(tmp_path: Path) -> None:
    """Beside a sound model, which the search finds."""
    files = [tmp_path / "small.mot", tmp_path / "plain.sto"]
    files[0].write_text(MOT)
    files[1].write_text(MOT.replace("\t", " "))
    folder = tmp_path / "damaged"
    folder.mkdir()
    (folder / "leg.osim").write_text(osim_4())
    result = load_damaged(files, 600, folder)
    assert result["wrong"] == []
    assert result["slowest_s"] < 2, result["slowest"]
    assert result["peak_mib"] < 1024
    assert result["loaded"] > 50 and result["refused"] > 150


def test_the_page() -> None:
    result = doctest.testfile(str(ROOT / "docs/formats/opensim.md"), module_relative=False, encoding="utf-8")
    assert result.attempted and not result.failed
