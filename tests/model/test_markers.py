"""Markers, signals and force plates: what they accept, what they find out, what they refuse."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from keypose.errors import ShapeError, UnknownName
from keypose.model import ForcePlate, Markers, Scene, Signals


def test_unseen_markers_are_not_numbers() -> None:
    positions = np.zeros((4, 2, 3))
    positions[1, 0] = np.nan
    positions[2, 1, 2] = np.nan
    markers = Markers(("a", "b"), positions, 100.0)
    assert markers.visible is not None
    assert markers.visible.tolist() == [[True, True], [False, True], [True, False], [True, True]]
    assert markers.frame_count == 4 and markers.duration_s == pytest.approx(0.03)
    assert markers.index("b") == 1
    with pytest.raises(UnknownName, match="marker 'c'"):
        markers.index("c")


def test_arrays_are_frozen_and_keep_their_precision() -> None:
    positions = np.zeros((2, 1, 3), np.float32)
    markers = Markers(("a",), positions, 50.0, residuals=np.zeros((2, 1), np.float32), cameras=np.ones((2, 1)))
    positions[:] = 1
    assert markers.positions.dtype == np.float32 and not markers.positions.any()
    assert markers.cameras is not None and markers.cameras.dtype == np.int32
    with pytest.raises(ValueError, match="read-only"):
        markers.positions[0] = 1


@pytest.mark.parametrize(
    "make",
    [
        lambda: Markers(("a",), np.zeros((2, 2, 3)), 100.0),
        lambda: Markers(("a",), np.zeros((2, 1, 3)), 0.0),
        lambda: Markers(("a",), np.zeros((2, 1, 3)), 100.0, visible=np.ones((3, 1))),
        lambda: Markers(("a",), np.zeros((2, 1, 3)), 100.0, residuals=np.ones((2, 2))),
        lambda: Signals(("a",), np.zeros((2, 2)), 100.0),
        lambda: Signals(("a",), np.zeros((2, 1, 2)), 100.0),
        lambda: Signals(("a",), np.zeros((2, 1)), float("nan")),
        lambda: Signals(("a",), np.zeros((2, 1)), 100.0, units=("N", "N")),
        lambda: ForcePlate(np.zeros((3, 3)), np.zeros(3), 2),
    ],
)
def test_what_does_not_fit_is_refused(make) -> None:
    with pytest.raises(ShapeError):
        make()


def test_scenes_carry_them_to_other_processes() -> None:
    plate = ForcePlate(np.eye(4, 3), np.zeros(3), 2, ("Fx1",))
    scene = Scene(
        markers=(Markers(("a",), np.ones((2, 1, 3)), 100.0),),
        signals=(Signals(("Fx1",), np.ones((20, 1)), 1000.0, ("N",)),),
        plates=(plate,),
    )
    back = pickle.loads(pickle.dumps(scene))
    np.testing.assert_array_equal(back.markers[0].positions, scene.markers[0].positions)
    assert back.signals[0].units == ("N",) and back.plates[0].channels == ("Fx1",)
