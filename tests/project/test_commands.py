"""Laws of commands and history: all or none, exact undo, and the same again out of JSON."""

from __future__ import annotations

import json

import numpy as np
import pytest

from keypose.errors import KeyposeError, ShapeError, UnknownName
from keypose.io.json_values import Json
from keypose.io.native import Storing, document_bytes, fetching
from keypose.model import Channel, Clip, Curve, CurveKind, Document, Layer, Placement, Property, Timeline
from keypose.project import commands as c
from keypose.project.document import difference
from keypose.project.history import MERGE_S, History
from tests.project.edits import random_commands, random_curve, random_document, small_character


@pytest.mark.parametrize("seed", range(25))
def test_undoing_any_sequence_gives_every_document_back_to_the_byte(seed: int) -> None:
    rng = np.random.default_rng([seed, 1])
    history = History(random_document(seed, 2))
    seen = [document_bytes(history.document)]
    for n in range(30):
        history.do(c.apply_all(history.document, random_commands(rng, history.document)), f"step {n}")
        seen.append(document_bytes(history.document))
    at = len(seen) - 1
    for _ in range(80):
        if rng.random() < 0.6:
            at -= bool(history.undo())
        else:
            at += bool(history.redo())
        assert document_bytes(history.document) == seen[at]
    while history.undo():
        at -= 1
    assert at == 0
    assert document_bytes(history.document) == seen[0]


@pytest.mark.parametrize("seed", range(25))
def test_commands_do_the_same_after_they_were_written_as_json(seed: int) -> None:
    rng = np.random.default_rng([seed, 2])
    document = other = random_document(seed, 2)
    for _ in range(20):
        commands = random_commands(rng, document)
        store = Storing()
        text = json.dumps([command.to_json(store) for command in commands])
        read = [c.read_command(Json(item, f"[{n}]"), fetching(store.arrays)) for n, item in enumerate(json.loads(text))]
        document, other = c.apply_all(document, commands), c.apply_all(other, read)
        assert document_bytes(document) == document_bytes(other)


@pytest.mark.parametrize("seed", range(10))
def test_the_difference_of_two_documents_is_empty_only_for_equal_ones_and_names_what_changed(seed: int) -> None:
    rng = np.random.default_rng([seed, 1])
    before = random_document(seed, 4)
    after = c.apply_all(before, random_commands(rng, before))
    found = difference(before, after)
    clips = {name: clip for name, clip in before.clips.items() if name not in found.removed_clips}
    for change in found.clips:
        old = clips.get(change.clip.name, Clip({}, change.clip.name))
        kept = {channel: curve for channel, curve in old.curves.items() if channel not in change.removed}
        assert {**kept, **change.curves}.keys() == change.clip.curves.keys()
        clips[change.clip.name] = change.clip
    assert {name: clip.name for name, clip in clips.items()} == {name: name for name in after.clips}
    assert {t.name for t in found.timelines} >= set(after.timelines) - set(before.timelines)
    nothing = difference(after, c.apply_all(after, []))
    assert not (nothing.clips or nothing.timelines or nothing.poses or nothing.characters or nothing.settings)


def test_a_curve_with_the_same_numbers_is_no_change() -> None:
    rng = np.random.default_rng(0)
    curve = random_curve(rng)
    channel = Channel("Root", Property.TRANSLATION)
    before = c.SetCurves("arm", {channel: curve}).apply(Document())
    copy = Curve(curve.times_s.copy(), curve.values.copy(), curve.modes.copy(), curve.in_tangents, curve.out_tangents, curve.kind,
                 curve.before, curve.after, curve.in_handles, curve.out_handles, curve.tangent_types)  # fmt: skip
    after = c.SetCurves("arm", {channel: copy}).apply(before)
    assert [change.curves for change in difference(before, after).clips] == [{}]


def test_an_edit_is_all_or_none() -> None:
    document = random_document(3)
    good = c.SetCurves("new", {Channel("Root", Property.TRANSLATION): random_curve(np.random.default_rng(1))})
    lost = c.SetTimeline(Timeline((Layer("a", (Placement("nwe"),)),), "t"))
    with pytest.raises(UnknownName, match="nearest: 'new'"):
        c.apply_all(document, [good, lost])
    assert "new" not in document.clips
    # the clip may come after the timeline that places it
    made = c.apply_all(document, [c.SetTimeline(Timeline((Layer("a", (Placement("new"),)),), "t")), good])
    assert "new" in made.clips


@pytest.mark.parametrize(
    ("command", "what"),
    [
        ("set_clip", "commands: expected SetCurves, .* got str"),
        (c.SetClip(Timeline((), "t")), r"set_clip\.clip: expected Clip, got Timeline"),  # pyright: ignore[reportArgumentType]
        (c.SetCurves("arm", {"Root": 1}), r"set_curves\.curves: expected Mapping\[Channel, Curve\], got"),  # pyright: ignore[reportArgumentType]
        (c.SetCurves("arm", {}, ("Root",)), r"set_curves\.removed: expected tuple\[Channel, \.\.\.\], got"),  # pyright: ignore[reportArgumentType]
        (c.RemoveClip(3), r"remove_clip\.name: expected str, got 3"),  # pyright: ignore[reportArgumentType]
        (c.SetSettings({"a": [1]}), r"set_settings\.settings: expected Mapping\[str, Setting \| None\], got"),  # pyright: ignore[reportArgumentType]
    ],
)
def test_a_command_made_in_python_holds_what_it_should(command: c.Command, what: str) -> None:
    document = random_document(3)
    with pytest.raises(ShapeError, match=what):
        c.apply_all(document, [command])


def test_what_is_removed_or_renamed_takes_its_mentions_along() -> None:
    document = c.AddCharacter(small_character()).apply(Document())
    renamed = c.apply_all(
        document,
        [c.Rename("clip", "tube", "arm"), c.Rename("timeline", "tube", "take"), c.Rename("character", "tube", "Anna")],
    )
    assert renamed.timelines["take"].layers[0].placements[0].animation == "arm"
    assert dict(renamed.performs) == {"Anna": "take"}
    assert renamed.characters["Anna"].parts is document.characters["tube"].parts
    empty = c.apply_all(renamed, [c.RemoveClip("arm")])
    assert empty.timelines["take"].layers[0].placements == ()
    assert dict(c.apply_all(empty, [c.RemoveTimeline("take")]).performs) == {}


@pytest.mark.parametrize(
    ("command", "what"),
    [
        (c.RemoveClip("tub"), "no clip 'tub'; nearest: 'tube'"),
        (c.RemovePose("x"), "no pose 'x'; there are none"),
        (c.SetPerformance("tube", "t"), "no timeline 't'"),
        (c.Rename("clip", "tube", ""), "clip: expected a name, got nothing"),
        (c.Rename("clip", "tube", "a\nb"), "characters that cannot be shown"),
        (c.Rename("clip", "tube", "x" * 300), "a name of 300 characters; at most 200"),
        (c.Rename("house", "tube", "x"), "expected project, character"),
        (c.SetSettings({"a": float("nan")}), "expected a finite number"),
    ],
)
def test_what_cannot_be_done_is_refused_by_name(command: c.Command, what: str) -> None:
    document = c.AddCharacter(small_character()).apply(Document())
    with pytest.raises(KeyposeError, match=what):
        c.apply_all(document, [command])


def test_a_joint_turns_by_rotation_or_euler_angles_but_not_both() -> None:
    rng = np.random.default_rng(5)
    both = {
        Channel("Mid", Property.ROTATION): random_curve(rng, CurveKind.ROTATION),
        Channel("Mid", Property.EULER, 2): random_curve(rng, CurveKind.SCALAR),
    }
    with pytest.raises(ShapeError, match=r"joint 'Mid'.*only one can drive it"):
        c.apply_all(Document(), [c.SetCurves("arm", both)])


def test_quick_edits_of_one_key_are_one_step_and_others_are_not() -> None:
    history = History(Document("0"))
    for n, (merge, at_s) in enumerate(
        [("drag", 0.0), ("drag", 0.5), ("drag", 1.4), ("drag", 1.4 + MERGE_S), ("", 2.5), ("", 2.5), ("nudge", 2.6)]
    ):
        history.do(Document(str(n + 1)), f"step {n}", merge=merge, at_s=at_s)
    names = [history.document.name]
    while history.undo():
        names.append(history.document.name)
    assert names == ["7", "6", "5", "4", "3", "0"]
    # what was undone is not joined with what comes next, and saving ends a step
    history.do(Document("a"), "a", merge="drag", at_s=1.0)
    history.seal()
    history.do(Document("b"), "b", merge="drag", at_s=1.1)
    assert (history.steps, history.redo_steps, history.revision) == (2, 0, 7 + 5 + 2)


def test_ten_thousand_steps_share_what_they_do_not_change() -> None:
    import tracemalloc

    rng = np.random.default_rng(0)
    curves = {
        Channel(f"joint {n}", Property.TRANSLATION, 0): Curve(
            np.arange(500.0), rng.normal(size=(500, 1)), kind=CurveKind.SCALAR
        )
        for n in range(200)
    }
    document = c.SetCurves("arm", curves).apply(Document())
    one = Curve(np.arange(20.0), rng.normal(size=(20, 1)), kind=CurveKind.SCALAR)
    whole = len(document_bytes(document))
    history = History(document)
    tracemalloc.start()
    before = tracemalloc.get_traced_memory()[0]
    for n in range(500):
        channel = Channel(f"joint {n % 200}", Property.TRANSLATION, 0)
        history.do(c.SetCurves("arm", {channel: one}).apply(history.document), "key")
    cost = (tracemalloc.get_traced_memory()[0] - before) / 500
    tracemalloc.stop()
    assert cost < whole / 50, (cost, whole)
