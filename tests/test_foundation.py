"""The foundation: errors that teach, array checks, and a package that costs nothing to import."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

import keypose
from keypose.arrays import as_float, checked, finite, frozen
from keypose.errors import FormatError, KeyposeError, MissingExtra, ShapeError, UnknownName


def test_every_error_is_a_keypose_error_and_a_standard_one() -> None:
    assert issubclass(ShapeError, (KeyposeError, ValueError)) and issubclass(FormatError, (KeyposeError, ValueError))
    assert issubclass(UnknownName, KeyError) and issubclass(MissingExtra, ImportError)
    for kind in (ShapeError, FormatError, UnknownName, MissingExtra):
        assert issubclass(kind, KeyposeError)


def test_unknown_name_gives_the_nearest_or_lists_what_there_is() -> None:
    assert str(UnknownName("joint", "LeftHnad", ["Hips", "LeftHand"])) == "no joint 'LeftHnad'; nearest: 'LeftHand'"
    assert str(UnknownName("joint", "xyzzy", ["Hips", "Head"])) == "no joint 'xyzzy'; known: 'Hips', 'Head'"
    assert str(UnknownName("clip", "walk", [])) == "no clip 'walk'; there are none"


def test_format_error_names_file_and_place() -> None:
    error = FormatError("expected a number, found 'x'", where="line 12")
    assert str(error) == "line 12: expected a number, found 'x'"
    assert str(error.at("walk.bvh")) == "walk.bvh: line 12: expected a number, found 'x'"


def test_missing_extra_says_how_to_install() -> None:
    assert str(MissingExtra("Draco meshes", "compression")).endswith("pip install 'keypose[compression]'")


def test_checked_shapes() -> None:
    array = np.zeros((90, 21, 4))
    assert checked(array, (..., "J", 4), "rotations") is array
    assert checked(array, (..., 21, 4), "rotations") is array
    with pytest.raises(ShapeError) as caught:
        checked(array, (..., 22, 4), "rotations", "skeleton 'anna'")
    assert str(caught.value) == "rotations: expected (*B, 22, 4) to match skeleton 'anna', got (90, 21, 4)"
    with pytest.raises(ShapeError, match=r"expected \(N, N\), got \(3, 4\)"):
        checked(np.zeros((3, 4)), ("N", "N"), "matrix")
    with pytest.raises(ShapeError, match=r"expected \(K,\), got \(\)"):
        checked(np.float64(1), ("K",), "times_s")


def test_frozen_copies_and_protects() -> None:
    array = np.arange(6.0).reshape(2, 3)
    copy = frozen(array)
    array[0, 0] = 9
    assert copy[0, 0] == 0
    with pytest.raises(ValueError, match="read-only"):
        copy[0, 0] = 1
    assert frozen(copy) is copy
    view = array[:1]
    view.setflags(write=False)
    array[0, 1] = 5
    assert frozen(view) is not view, "a read-only view of writable memory is no frozen array"


def test_as_float_keeps_precision() -> None:
    assert as_float(np.zeros(2, np.float32)).dtype == np.float32
    assert as_float([1, 2]).dtype == np.float64
    assert as_float(np.zeros(2, np.int32)).dtype == np.float64


def test_lazy_names_exist_and_wrong_ones_are_told() -> None:
    assert keypose.load is keypose.io.load
    assert "model" in dir(keypose)
    assert (
        callable(keypose.retarget.retarget) and callable(keypose.rig.auto_rig) and keypose.editing and keypose.project
    )
    with pytest.raises(AttributeError, match="nothing_here"):
        keypose.nothing_here  # noqa: B018


def test_what_measures_does_not_load_the_solver_for_whole_bodies() -> None:
    code = "import sys, keypose.analysis, keypose.retarget; print([m for m in sys.modules if 'fullbody' in m])"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip()
    assert found == "[]"
    from keypose import ik

    assert all(hasattr(ik, name) for name in ik.__all__)
    with pytest.raises(AttributeError, match="nothing_here"):
        ik.nothing_here  # noqa: B018


@pytest.mark.parametrize("module", ["keypose", "keypose.model", "keypose.io", "keypose.cli.app", "keypose.samples"])
def test_import_does_no_heavy_work(module: str) -> None:
    heavy = ("numba", "scipy", "moderngl", "av", "PIL", "starlette", "uvicorn", "torch", "jax")
    code = f"import sys, {module}; print([m for m in {heavy!r} if m in sys.modules])"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip()
    assert found == "[]"


def test_what_is_not_finite_is_told_with_its_place() -> None:
    places = np.zeros((3, 2, 3))
    assert finite(places, "places") is places
    places[1, 0, 2] = np.nan
    with pytest.raises(ShapeError, match=r"places: expected finite numbers, got nan at \[1, 0, 2\]"):
        finite(places, "places")
    walk = keypose.samples.load("walk")
    body, motion = walk.character.skeleton, walk.animations[0]
    turned = np.array(motion.pose.rotations)
    turned[30, 5, 1] = np.nan
    damaged = replace(motion, pose=replace(motion.pose, rotations=turned))
    from keypose.analysis import find_roles, measure_quality
    from keypose.editing.constraints import Place
    from keypose.editing.paths import extract_path
    from keypose.editing.planting import plant_feet
    from keypose.editing.reach import Reach, reach
    from keypose.editing.spacetime import solve_spacetime
    from keypose.retarget import retarget
    from keypose.rig import auto_rig, fit_controls

    with pytest.raises(ShapeError, match=r"finite numbers, got nan at \[30"):
        measure_quality(damaged, body)
    with pytest.raises(ShapeError, match=r"finite numbers, got nan at \[30"):
        plant_feet(damaged, body, find_roles(body).roles)
    with pytest.raises(ShapeError, match=r"finite numbers, got nan at \[30"):
        retarget(damaged, body, body)
    with pytest.raises(ShapeError, match=r"rotations of the motion: .* got nan at \[30, 5"):
        fit_controls(auto_rig(body), body, damaged)
    told = r"rotations of the motion: .* got nan at \[30, 5, 1\]"
    with pytest.raises(ShapeError, match=told):
        reach(damaged, body, [Reach("left_hand", 10, offset=(0, 0.1, 0))])
    with pytest.raises(ShapeError, match=told):
        solve_spacetime(damaged, body, (0, 20), [Place("left_hand", np.array([10]), (0.3, 1.2, 0.2))])
    with pytest.raises(ShapeError, match=told):
        extract_path(damaged, body)
    endless = np.array(motion.pose.broadcast().translations)
    endless[4, 0, 2] = np.inf
    far = replace(motion, pose=replace(motion.pose, translations=endless))
    with pytest.raises(ShapeError, match=r"translations of the motion: .* got inf at \[4, 0, 2\]"):
        extract_path(far, body)
