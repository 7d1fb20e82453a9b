"""Rigs in documents: commands, undo, journals, project files, damaged JSON, the command line."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import fields, is_dataclass, replace
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from keypose import io
from keypose.errors import FormatError, KeyposeError, ShapeError, UnknownName
from keypose.io import native
from keypose.io.json_values import Json
from keypose.io.native_rigs import read_rig, rig_json
from keypose.model import (
    Attribute,
    Channel,
    Constraint,
    ConstraintKind,
    Curve,
    CurveKind,
    Document,
    Driver,
    Motion,
    Pose,
    Property,
    Rig,
    Scene,
    Skeleton,
)
from keypose.project import commands as c
from keypose.project.document import add_character, difference
from keypose.project.file import from_bytes, load, save
from keypose.project.workspace import Workspace
from tests.cli.command import keypose, process, refused
from tests.rig.bodies import human, human_rig


def full_rig() -> Rig:
    """Every kind of module, constraint and driver."""
    curve = Curve([0.0, 1.0], [[0.0], [2.0]], kind=CurveKind.SCALAR)
    return replace(
        human_rig(),
        name="Robin",
        character="Robin",
        attributes=(*human_rig().attributes, Attribute("smile", "head_control", 0.25, -1, 1)),
        constraints=(
            Constraint("k", ConstraintKind.AIM, "elbow.L", ("look", "LeftEye"), (1.0, 0.5), 0.5, "smile", up_axis=(0, 1, 0)),
            Constraint("l", ConstraintKind.LIMIT_ROTATION, "hand.L", low=(-1, -2, -np.inf), axes=(True, False, True)),
        ),
        drivers=(
            Driver(Channel("smile", Property.VALUE), "foot.L.roll * 2", curve),
            Driver(Channel("LeftArmTwist", Property.EULER, 0), "{LeftArm}.twist.x / 2"),
        ),
    )  # fmt: skip


def same(one: Any, two: Any) -> bool:
    """Whether two values hold the same, however deep."""
    if isinstance(one, np.ndarray):
        return one.dtype == two.dtype and np.array_equal(one, two)
    if is_dataclass(one) and not isinstance(one, (type, Enum)):
        return type(one) is type(two) and all(same(getattr(one, f.name), getattr(two, f.name)) for f in fields(one))
    if isinstance(one, tuple):
        return len(one) == len(two) and all(map(same, one, two))
    return one == two


def rigged() -> Document:
    return c.SetRig(full_rig()).apply(add_character(Document("p"), human()))


def test_a_rig_comes_back_from_a_project_to_the_bit(tmp_path: Path) -> None:
    document = rigged()
    data = native.document_bytes(document)
    again = from_bytes(data)
    assert native.document_bytes(again) == data
    assert same(again.rigs["Robin"], document.rigs["Robin"])
    save(document, tmp_path / "p.keypose")
    assert same(load(tmp_path / "p.keypose").rig("Robin"), full_rig())
    assert io.load(tmp_path / "p.keypose").extras["project"]["rigs"] == [
        {"name": "Robin", "character": "Robin", "controls": full_rig().controls.joint_count}
    ]


def test_projects_without_rigs_stay_files_of_version_1() -> None:
    document = add_character(Document("p"), human())
    without, with_rig = (native.document_bytes(d) for d in (document, rigged()))
    assert b'\\"version\\":1,' in without
    assert b'\\"version\\":2,' in with_rig
    assert not from_bytes(without).rigs


def test_commands_are_written_read_and_undone(tmp_path: Path) -> None:
    space = Workspace(tmp_path)
    space.begin(add_character(Document("p"), human()))
    space.edit([c.SetRig(full_rig())], "Rig")
    rig = space.document.rig("Robin")
    assert space.document.rig_of("Robin") is rig
    assert space.undo() == "Rig"
    assert not space.document.rigs
    space.redo()
    space.edit([c.Rename("character", "Robin", "Anna"), c.Rename("rig", "Robin", "Anna's")], "Rename")
    assert space.document.rig_of("Anna") is space.document.rig("Anna's")
    space.edit([c.RemoveRig("Anna's")], "Remove")
    space.undo()
    space.sync()
    # another program finds the journal and has the same
    other = Workspace(tmp_path, locking=False)
    (found,) = other.recoverable()
    other.recover(found.id)
    assert same(other.document.rig("Anna's"), space.document.rig("Anna's"))
    space.edit([c.RemoveCharacter("Anna")], "Remove")
    assert not space.document.rigs
    space.close(discard=True)


def test_what_changed_between_documents_names_rigs() -> None:
    before = add_character(Document("p"), human())
    after = c.SetRig(full_rig()).apply(before)
    found = difference(before, after)
    assert (found.rigs, found.removed_rigs, found.characters) == ((after.rigs["Robin"],), (), False)
    back = difference(after, before)
    assert (back.rigs, back.removed_rigs) == ((), ("Robin",))
    assert difference(after, after).rigs == ()


def test_rigs_that_do_not_fit_are_refused() -> None:
    document = add_character(Document("p"), human())
    with pytest.raises(UnknownName, match="no character 'Robyn'; nearest: 'Robin'"):
        c.apply_all(document, [c.SetRig(replace(full_rig(), character="Robyn"))])
    with pytest.raises(ShapeError, match="both move character 'Robin'"):
        c.apply_all(document, [c.SetRig(full_rig()), c.SetRig(replace(full_rig(), name="second"))])
    tail = Skeleton(("a",), np.array([-1]), Pose(np.zeros((1, 3)), np.array([[1.0, 0, 0, 0]]), np.ones((1, 3))))
    other = add_character(Document("p"), replace(human(), skeleton=tail, parts=(), roles={}))
    with pytest.raises(UnknownName, match="no joint"):
        c.apply_all(other, [c.SetRig(full_rig())])
    with pytest.raises(ShapeError, match="'Robin' is kept under the name 'x'"):
        Document("p", rigs={"x": full_rig()})


def plain() -> dict[str, Any]:
    return json.loads(json.dumps(rig_json(full_rig(), lambda array: array.tolist())))


def read(value: Any) -> Rig:
    def fetch(item: Json) -> np.ndarray:
        numbers = item.value if isinstance(item.value, list) else item.fail("expected a list")
        try:
            return np.asarray(numbers, np.uint8 if "modes" in item.where else float)
        except (ValueError, TypeError, OverflowError):
            item.fail("expected numbers")

    return read_rig(Json(value, "rigs[0]"), fetch)


def test_its_json_is_readable_without_arrays() -> None:
    assert same(read(plain()), full_rig())


@pytest.mark.parametrize(
    ("change", "where"),
    [
        (lambda f: f.pop("name"), "rigs.0.: 'name' is missing"),
        (lambda f: f["controls"][3].update(rotation=[1, 2]), r"controls\[3\].rotation: expected 4 numbers"),
        (lambda f: f["controls"][3].pop("translation"), r"controls\[3\]: 'translation' is missing"),
        (lambda f: f["controls"][3].update(parent=9), "a parent must come before its child"),
        (lambda f: f["controls"][3].update(parent=-2), r"controls\[3\].parent: expected -1 to"),
        (lambda f: f["controls"][3].update(shape="star"), r"controls\[3\].shape: expected one of circle"),
        (lambda f: f["controls"][3].update(name="root"), "appears more than once"),
        (lambda f: f["controls"][3].update(size_m=-1), r"controls\[3\]: control 'spine.1': expected a size above 0"),
        (lambda f: f["controls"][3].update(moves=["fly"]), r"moves\[0\]: expected one of translation"),
        (lambda f: f["attributes"][0].update(default=7), r"attributes\[0\]: attribute 'pelvis.space': expected a default"),
        (lambda f: f["attributes"][0].update(control="nobody"), "no joint 'nobody'"),
        (lambda f: f["modules"][0].update(kind="wing"), r"modules\[0\].kind: no module 'wing'; known: follow"),
        (lambda f: f["modules"][0].update(joints=[]), "expected as many joints and controls"),
        (lambda f: f["modules"][0].update(joints=[5]), r"joints\[0\]: expected a text"),
        (lambda f: f["constraints"][0].update(kind="glue"), r"constraints\[0\].kind: expected one of copy_position"),
        (lambda f: f["constraints"][0].update(axes=[1, 2, 3]), r"axes\[0\]: expected true or false"),
        (lambda f: f["constraints"][1].update(low=[1]), r"low: expected 3 numbers, got 1"),
        (lambda f: f["constraints"][0].update(weight_attribute="x"), "no attribute 'x'"),
        (lambda f: f["drivers"][0].update(property="rotation"), "expected a value, a morph"),
        (lambda f: f["drivers"][0].update(expression=3), r"drivers\[0\].expression: expected a text"),
    ],
)  # fmt: skip
def test_damage_is_named_with_its_place(change: Callable[[dict[str, Any]], Any], where: str) -> None:
    value = plain()
    change(value)
    with pytest.raises(FormatError, match=where):
        read(value)


def test_a_thousand_kinds_of_damage_are_refused_clearly_or_read_as_something() -> None:
    rng = np.random.default_rng(2)
    junk = (None, -1, 1e300, "x", [], {}, True, [1, 2, 3], "root", 3.5)
    refused_count = 0
    for _ in range(1000):
        value = plain()
        at: Any = value
        while True:  # somewhere, at any depth
            keys = list(at) if isinstance(at, dict) else list(range(len(at)))
            key = keys[rng.integers(len(keys))]
            inside = at[key]
            if isinstance(inside, (dict, list)) and inside and rng.random() < 0.8:
                at = inside
                continue
            at[key] = junk[rng.integers(len(junk))]
            break
        try:
            document = replace(add_character(Document("p"), human()), rigs={"Robin": read(value)})
            c.apply_all(document, [])
        except KeyposeError as error:
            assert str(error)
            refused_count += 1
    assert refused_count > 500


# ---- the command line --------------------------------------------------------------------------------------------------


def test_controls_are_listed() -> None:
    shown = keypose("rig", "sample:human")
    assert shown.returncode == 0, shown.stderr
    assert "foot_ik.L" in shown.stdout and "leg.L.ik" in shown.stdout and "68 controls" in shown.stdout
    listed = json.loads(keypose("rig", "sample:human", "--json").stdout)
    assert len(listed["controls"]) == 68


def test_a_project_with_a_motion_on_controls_is_written_and_bakes_to_joints(tmp_path: Path) -> None:
    out = tmp_path / "walk.keypose"
    done = process("rig", "sample:human", out, "--motion", "sample:walk")
    assert done.returncode == 0, done.stderr
    assert "joints within" in done.stdout
    document = load(out)
    (rig,) = document.rigs.values()
    assert document.rig_of(rig.character) is rig
    baked = io.load(out).animations[0]
    assert isinstance(baked, Motion)
    walk = keypose("convert", out, tmp_path / "walk.bvh")
    assert walk.returncode == 0, walk.stderr


def test_what_cannot_be_rigged_is_refused(tmp_path: Path) -> None:
    assert "only a project keeps a rig" in refused(keypose("rig", "sample:human", tmp_path / "out.glb"))
    io.save(Scene((human(),)), tmp_path / "still.glb")
    asked = ("rig", "sample:human", tmp_path / "p.keypose", "--motion", tmp_path / "still.glb")
    assert "no motion" in refused(keypose(*asked))
    assert not (tmp_path / "p.keypose").exists()
    assert keypose("rig").returncode == 2
