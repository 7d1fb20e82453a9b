"""Values through the layers of a timeline, against what each layer says in words."""

from __future__ import annotations

import numpy as np
import pytest

from keypose.errors import ShapeError, UnknownName
from keypose.evaluate import sample_timeline_values
from keypose.model import (
    Channel,
    Clip,
    Curve,
    CurveKind,
    Interpolation,
    Layer,
    LayerMode,
    Placement,
    Property,
    Timeline,
)

NAMES, REST = ("roll", "ik", "curl"), np.array([0.5, 1.0, 0.0])
TIMES = np.array([0.0, 0.25, 1.0, 2.0])


def clip(name: str, **values: tuple[float, float]) -> Clip:
    """A clip of one second in which each value goes from one number to another."""
    return Clip(
        {
            Channel(n, Property.VALUE): Curve([0.0, 1.0], [[a], [b]], kind=CurveKind.SCALAR)
            for n, (a, b) in values.items()
        },
        name,
    )


def sampled(*layers: Layer, **clips: Clip) -> np.ndarray:
    return sample_timeline_values(Timeline(layers), clips, NAMES, TIMES, REST)


def test_what_no_layer_drives_is_at_rest() -> None:
    found = sampled(Layer("a", (Placement("c"),)), c=clip("c", roll=(0.0, 1.0)))
    assert np.allclose(found, np.stack([[0.0, 0.25, 1.0, 1.0], [1.0] * 4, [0.0] * 4], axis=1))
    assert found.dtype == np.float64


def test_layers_replace_and_add_by_their_influence() -> None:
    below = clip("below", roll=(0.0, 1.0), curl=(1.0, 1.0))
    above = clip("above", roll=(2.0, 2.0))
    base, over = Layer("a", (Placement("below"),)), Layer("b", (Placement("above"),), influence=0.25)
    assert np.allclose(sampled(base, over, below=below, above=above)[:, 0], 0.75 * np.array([0, 0.25, 1, 1]) + 0.5)
    added = Layer("b", (Placement("above"),), LayerMode.ADD, 0.25)
    # an added value counts as how far it is from rest
    assert np.allclose(sampled(base, added, below=below, above=above)[:, 0], [0.375, 0.625, 1.375, 1.375])
    assert np.allclose(sampled(base, added, below=below, above=above)[:, 2], 1.0)


def test_layers_leave_alone_what_they_may_not_move() -> None:
    c = clip("c", roll=(1.0, 1.0), ik=(0.0, 0.0))
    for layer in (
        Layer("a", (Placement("c"),), muted=True),
        Layer("a", (Placement("c"),), properties=frozenset({Property.ROTATION})),
        Layer("a", (Placement("c"),), joints={"curl": 1.0}),
    ):
        assert np.allclose(sampled(layer, c=c), REST)
    part = sampled(Layer("a", (Placement("c"),), joints={"ik": 0.5}), c=c)
    assert np.allclose(part, [0.5, 0.5, 0.0])


def test_switches_step_and_colours_are_no_numbers() -> None:
    switch = Curve([0.0, 1.0], [[0.0], [2.0]], Interpolation.STEP, kind=CurveKind.SCALAR)
    colour = Curve([0.0], [[1.0, 0.0, 0.0]], kind=CurveKind.COLOR)
    both = Clip({Channel("ik", Property.VALUE): switch, Channel("curl", Property.VALUE): colour}, "c")
    found = sampled(Layer("a", (Placement("c"),)), c=both)
    assert found[:, 1].tolist() == [0.0, 0.0, 2.0, 2.0]
    assert found[:, 2].tolist() == [0.0] * 4


def test_wrong_input_is_named() -> None:
    with pytest.raises(UnknownName, match="no animation 'c'"):
        sampled(Layer("a", (Placement("c"),)))
    with pytest.raises(ShapeError, match="rest: expected"):
        sample_timeline_values(Timeline(()), {}, NAMES, TIMES, REST[:2])
    with pytest.raises(ShapeError, match="finite"):
        sample_timeline_values(Timeline(()), {}, NAMES, [np.nan], REST)
    assert sample_timeline_values(Timeline(()), {}, (), TIMES, np.zeros(0)).shape == (4, 0)
