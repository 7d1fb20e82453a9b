"""The table of operators: every one runs with its defaults, says what is wrong, and gives the same clip again."""

from __future__ import annotations

import numpy as np
import pytest

from keypose import samples
from keypose.editing.operators import OPERATORS, run_operator
from keypose.editing.selection import Selection, chosen_keys, chosen_spans
from keypose.errors import ShapeError, UnknownName
from keypose.evaluate import sample_clip
from keypose.math import quat
from keypose.model import Channel, Clip, Curve, CurveKind, Property

PATH, SPIN = Channel("Ball", Property.TRANSLATION), Channel("Spin", Property.ROTATION)
ANGLES = Channel("Level", Property.EULER)
SHOWN = Channel("shown", Property.VALUE)


def clip():
    bounce = samples.load("bounce").animations[0]
    return Clip(
        {
            PATH: bounce.curves[PATH],
            SPIN: bounce.curves[SPIN],
            ANGLES: Curve([0, 1, 2.5], np.radians([[0.0, 0, 0], [170, 20, 30], [-170, 10, 0]]), kind=CurveKind.EULER),
            SHOWN: Curve([0, 1], [[0.0], [1]], 0, kind=CurveKind.BOOLEAN),
        },
        "ball",
        rate_hz=25,
    )


def body():
    return samples.load("ball").character.skeleton


@pytest.mark.parametrize("name", OPERATORS)
def test_every_operator_runs_with_its_defaults_and_repeats_itself(name):
    made, again = (run_operator(name, clip(), body()) for _ in "ab")
    assert made.report == again.report
    for channel, curve in made.clip.curves.items():
        np.testing.assert_array_equal(curve.times_s, again.clip.curves[channel].times_s)
        np.testing.assert_array_equal(curve.values, again.clip.curves[channel].values)
        assert np.all(np.isfinite(curve.values))
    assert made.clip.name == "ball" and made.clip.rate_hz == 25
    pose = sample_clip(made.clip, body(), np.linspace(-0.5, 5, 200))
    assert np.all(np.isfinite(pose.translations))
    np.testing.assert_allclose(np.linalg.norm(pose.rotations, axis=-1), 1, atol=1e-6)


@pytest.mark.parametrize("name", [n for n in OPERATORS if n not in ("squash_and_stretch", "follow_through")])
def test_nothing_outside_the_selection_changes(name):
    before = clip()
    made = run_operator(name, before, body(), Selection(channels=(PATH,)), {}).clip
    for channel in before.curves:
        if channel != PATH and name != "arcs":
            assert made.curves[channel] is before.curves[channel]
    nothing = run_operator(name, before, body(), Selection(channels=())).clip
    assert all(nothing.curves[c] is before.curves[c] for c in before.curves)


@pytest.mark.parametrize("name", OPERATORS)
def test_every_operator_is_described(name):
    operator = OPERATORS[name]
    assert operator.name == name and operator.label and operator.description.endswith(".")
    for parameter in operator.parameters:
        assert parameter.description.endswith(".") and parameter.label
        if parameter.type == "choice":
            assert parameter.default in parameter.choices
        if parameter.type in ("number", "integer"):
            low = -np.inf if parameter.minimum is None else parameter.minimum
            high = np.inf if parameter.maximum is None else parameter.maximum
            assert low <= parameter.default <= high
    assert len({p.name for p in operator.parameters}) == len(operator.parameters)


def test_parameters_are_checked_before_anything_happens():
    run = lambda name, **p: run_operator(name, clip(), body(), parameters=p)  # noqa: E731
    with pytest.raises(UnknownName, match="nearest: 'overshoot'"):
        run("overshot")
    with pytest.raises(UnknownName, match="nearest: 'damping'"):
        run("overshoot", dampin=0.2)
    with pytest.raises(ShapeError, match=r"damping: expected 0\.05 to 0\.95, got 4"):
        run("overshoot", damping=4)
    with pytest.raises(ShapeError, match="whole number"):
        run("stop_motion", hold_frames=1.5)
    with pytest.raises(ShapeError, match="expected a number, got 'two'"):
        run("stop_motion", hold_frames="two")
    with pytest.raises(UnknownName, match="nearest: 'bounce_out'"):
        run("ease", easing="bouncy_out")
    with pytest.raises(ShapeError, match="true or false"):
        run("arcs", whole_chain=1)
    with pytest.raises(UnknownName, match="channel"):
        run_operator("ease", clip(), body(), Selection(channels=(Channel("no", Property.SCALE),)))


def test_selections():
    curve = Curve(np.arange(6), np.zeros((6, 1)), kind=CurveKind.SCALAR)
    c = Channel("a", Property.WEIGHT)
    assert list(chosen_keys(c, curve, Selection(start_s=1.0, end_s=3.0))) == [1, 2, 3]
    assert list(chosen_spans(c, curve, Selection(start_s=1.0, end_s=3.0))) == [1, 2]
    assert list(chosen_spans(c, curve, Selection())) == [0, 1, 2, 3, 4]
    assert list(chosen_spans(c, curve, Selection(keys={c: (0, 1, 4, 5)}))) == [0, 4]
    assert list(chosen_spans(c, curve, Selection(keys={c: (2, 5)}))) == [2]  # single keys: the span that follows
    with pytest.raises(ShapeError, match="indices below 6, got 9"):
        chosen_keys(c, curve, Selection(keys={c: (9,)}))
    with pytest.raises(ShapeError, match="end_s"):
        Selection(start_s=2.0, end_s=1.0)


def test_the_sample_is_what_its_operators_make():
    bounce, ball = samples.load("bounce").animations[0], samples.load("ball").character
    assert bounce.curves[PATH].key_count < 20
    at = np.linspace(0, bounce.end_s, 2000)
    pose = sample_clip(bounce, ball.skeleton, at)
    height = pose.translations[:, 0, 1]
    assert height.min() > 0.25 - 1e-6  # never in the ground
    # in flight it falls as things fall
    second = np.diff(height[(at > 0.65) & (at < 1.4)], 2) / np.diff(at)[0] ** 2
    np.testing.assert_allclose(second, -9.81, rtol=1e-3)
    # and while it rolls out it does not slip
    rolling = at > 3.1
    turned = np.cumsum(
        np.append(0, quat.angle_between(pose.rotations[rolling][:-1, 3], pose.rotations[rolling][1:, 3]))
    )
    gone = pose.translations[rolling, 0, 0] - pose.translations[rolling, 0, 0][0]
    np.testing.assert_allclose(turned * 0.25, gone, atol=1e-3)


@pytest.mark.parametrize(
    "name", ["separate", "join", "resample", "to_euler", "to_rotations", "reorder_euler", "filter_euler"]
)
def test_what_only_changes_the_form_keeps_the_motion_at_frames(name):
    before = clip()
    if name == "join":
        before = run_operator("separate", before, body()).clip
    made = run_operator(
        name, before, body(), parameters={"order": "ZXY"} if "euler" in name and "filter" not in name else {}
    )
    at = np.arange(60) / 25
    old, new = (sample_clip(c, body(), at) for c in (before, made.clip))
    # Between keys the filter goes another way, which is what it is for.
    keys = np.isin(at, [0, 1]) if name == "filter_euler" else at >= 0
    np.testing.assert_allclose(new.translations[keys], old.translations[keys], atol=1e-6)
    assert quat.angle_between(new.rotations[keys], old.rotations[keys]).max() < 2e-4
