"""The project file: bit for bit, deterministic, opened for ever, refused clearly where it is damaged."""

from __future__ import annotations

import json
import os
import stat
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from keypose import io
from keypose.errors import FormatError, KeyposeError
from keypose.evaluate.performing import perform
from keypose.io import native
from keypose.model import (
    Channel,
    Curve,
    CurveKind,
    Document,
    FootPivots,
    Interpolation,
    LimbModule,
    Placement,
    Property,
    Scene,
)
from keypose.project import commands as c
from keypose.project.file import from_bytes, load, save
from tests.project.edits import random_document, small_character

GOLDEN = Path(__file__).with_name("golden_1.keypose")
GOLDEN_2 = Path(__file__).with_name("golden_2.keypose")


def rewritten(data: bytes, change: Callable[[dict], None]) -> bytes:
    """A project file with other JSON."""
    (length,) = struct.unpack_from("<Q", data)
    header = json.loads(data[8 : 8 + length])
    fields = json.loads(header["__metadata__"][native.KEY])
    change(fields)
    header["__metadata__"] = {native.KEY: json.dumps(fields)}  # who means to change it leaves the checksum out
    text = json.dumps(header).encode()
    return struct.pack("<Q", len(text)) + text + data[8 + length :]


@pytest.mark.parametrize("seed", range(20))
def test_a_document_comes_back_to_the_byte(seed: int) -> None:
    document = random_document(seed)
    data = native.document_bytes(document)
    again = from_bytes(data)
    assert native.document_bytes(again) == data
    assert native.document_bytes(random_document(seed)) == data
    for name, clip in document.clips.items():
        assert list(again.clips[name].curves) == list(clip.curves)
        for channel, curve in clip.curves.items():
            other = again.clips[name].curves[channel]
            for field in ("times_s", "values", "modes", "in_tangents", "out_handles", "tangent_types"):
                one, two = getattr(curve, field), getattr(other, field)
                assert (one is None) == (two is None)
                assert one is None or (one.dtype == two.dtype and one.tobytes() == two.tobytes())


def test_a_character_is_inside_with_all_that_hangs_on_it() -> None:
    character = small_character()
    document = c.AddCharacter(character).apply(Document("p"))
    read = from_bytes(native.document_bytes(document)).characters["tube"]
    assert read.parts[0].skin is read.parts[1].skin, "a shared skin is one again"
    image = read.parts[0].material.base_color_image
    assert image is not None
    assert image is read.parts[1].material.base_color_image
    assert image.data == bytes(range(64))
    assert read.parts[0].material.extras == {"ior": 1.5, "ids": (1, 2), "blob": b"\0\1"}
    assert np.array_equal(read.parts[2].extras["weights"], np.arange(4.0))
    assert read.extras == {"note": "äöü", "none": None}
    assert (read.roles, read.morph_names, read.parts[2].joint) == ({"hips": 0}, ("wide",), 2)
    for name in ("positions", "triangles", "uvs"):
        one, two = getattr(character.parts[0].mesh, name), getattr(read.parts[0].mesh, name)
        assert one.dtype == two.dtype
        assert np.array_equal(one, two)
    assert read.skeleton.end_offsets == character.skeleton.end_offsets


def test_the_safetensors_library_reads_the_arrays() -> None:
    safetensors = pytest.importorskip("safetensors.numpy")
    document = random_document(1)
    arrays = safetensors.load(native.document_bytes(document))
    values = next(iter(document.clips.values())).curves
    wanted = {curve.values.tobytes() for curve in values.values()}
    assert wanted <= {array.tobytes() for array in arrays.values()}


def test_version_1_is_opened_for_ever() -> None:
    document = load(GOLDEN)
    assert native.document_bytes(document) == GOLDEN.read_bytes()
    assert list(document.characters) == ["tube"]
    assert list(document.clips) == ["tube", "everything"]
    curve = document.clip("everything").curve("Tip", Property.SCALE, 1)
    assert [Interpolation(m) for m in curve.modes] == [Interpolation.BEZIER, Interpolation.HERMITE, Interpolation.STEP]
    assert np.array_equal(curve.times_s, [0.0, 0.1, 1 / 3])
    assert curve.kind is CurveKind.SCALAR
    assert document.timeline("tube").layer("Base").placements[0].animation == "tube"
    assert dict(document.settings) == {"grid": True, "zoom": 0.1, "look": "graph"}
    assert document.pose("fist").pose.rotations[1].tolist() == [0.5, -0.5, 0.5, -0.5]


def test_version_2_with_its_rig_is_opened_for_ever() -> None:
    document = load(GOLDEN_2)
    assert native.document_bytes(document) == GOLDEN_2.read_bytes()
    rig = document.rig("stick's rig")
    assert document.rig_of("stick") is rig
    assert [type(module).__name__ for module in rig.modules] == [
        "FollowModule", "LimbModule", "SpineModule", "HeadModule", "EyesModule", "FingersModule", "TwistModule",
    ]  # fmt: skip
    leg = rig.modules[1]
    assert isinstance(leg, LimbModule)
    assert leg.foot == FootPivots(
        "foot", (0, 0, -0.25), (0, 0, 0.25), (0, 0, 0.5), (0.125, 0, 0.25), (-0.125, 0, 0.25), "j4", "c4"
    )
    assert rig.controls.rest.translations[3].tolist() == [9 / 8, 10 / 8, 11 / 8]
    assert [s.target for s in rig.control("c13").spaces] == ["", "c0", "j0"]
    assert rig.attribute("c13.space").choices == ("a", "b", "c")
    limit = rig.constraints[1]
    assert (limit.low, limit.high) == ((-np.inf, 0.0, -1.5), (np.inf, 2.5, np.inf))
    curve = rig.drivers[0].curve
    assert curve is not None
    assert np.array_equal(curve.times_s, [0.0, 0.1, 1 / 3])
    assert rig.drivers[1].expression == "0.5 * {j12}.twist.y if leg.ik > 0.5 else 0"


def test_a_newer_version_is_refused_and_says_what_helps() -> None:
    data = rewritten(GOLDEN.read_bytes(), lambda fields: fields.update(version=native.VERSION + 1))
    with pytest.raises(FormatError, match=r"made by a newer keypose \(project version 3; this one knows 2\)"):
        from_bytes(data)


def test_an_older_version_is_migrated_step_by_step(monkeypatch: pytest.MonkeyPatch) -> None:
    data = GOLDEN.read_bytes()
    monkeypatch.setattr(native, "VERSION", 3)
    monkeypatch.setattr(
        native,
        "MIGRATIONS",
        {
            1: lambda f: {**f, "version": 2, "name": f["name"] + " 2"},
            2: lambda f: {**f, "version": 3, "name": f["name"] + " 3"},
        },
    )
    assert from_bytes(data).name == "golden 2 3"


def test_a_thousand_damaged_files_are_refused_clearly_or_read_as_something() -> None:
    data = native.document_bytes(random_document(4))
    (length,) = struct.unpack_from("<Q", data)
    rng = np.random.default_rng(0)
    refused = 0
    for n in range(1000):
        bad = bytearray(data)
        kind = n % 5
        if kind == 0:  # cut off
            del bad[rng.integers(0, len(bad)) :]
        elif kind == 1:  # a byte of the header
            bad[rng.integers(0, 8 + length)] = rng.integers(256)
        elif kind == 2:  # many bytes of the header
            for at in rng.integers(0, 8 + length, 20):
                bad[at] = rng.integers(256)
        elif kind == 3:  # any bytes
            for at in rng.integers(0, len(bad), 50):
                bad[at] = rng.integers(256)
        else:  # a number of the JSON
            digits = [i for i in range(8, 8 + length) if bad[i] in b"0123456789"]
            for at in rng.choice(digits, 3):
                bad[at] = ord(str(rng.integers(10)))
        try:
            from_bytes(bytes(bad))
        except KeyposeError as error:
            assert str(error)
            refused += 1
    assert refused > 500


@pytest.mark.parametrize(
    ("change", "where"),
    [
        (lambda f: f.update(version="1"), "version: expected an integer, got a text"),
        (lambda f: f.pop("name"), "'name' is missing"),
        (lambda f: f["clips"][1]["curves"][0].update(times="a999"), r"clips\[1\]\.curves\[0\]\.times: no array 'a999'"),
        (lambda f: f["clips"][1]["curves"][0].update(kind="colour"), r"curves\[0\]\.kind: expected one of scalar, vector"),
        (lambda f: f["clips"].append(f["clips"][0]), "clips: two have the same name"),
        (lambda f: f["timelines"][0]["layers"][0]["placements"][0].update(speed=0), "speed: expected a number other than 0"),
        (lambda f: f["timelines"][0]["layers"][0]["placements"][0].update(animation="tub"), "no clip 'tub'; nearest: 'tube'"),
        (lambda f: f["performs"].update(tube="x"), "no timeline 'x'"),
        (lambda f: f["characters"][0]["parts"][0].update(skin=7), r"skin 7 does not exist; the file has 1"),
        (lambda f: f["poses"][0]["joints"]["Mid"].update(rotation=[1, 2]), r"rotation: expected 4 numbers, got 2"),
    ],
)  # fmt: skip
def test_a_wrong_field_is_named_with_its_place(change: Callable[[dict], None], where: str, tmp_path: Path) -> None:
    path = tmp_path / "bad.keypose"
    path.write_bytes(rewritten(GOLDEN.read_bytes(), change))
    with pytest.raises(FormatError, match=where) as error:
        load(path)
    assert str(error.value).startswith(str(path))


def test_what_no_file_keeps_is_refused_before_anything_is_written(tmp_path: Path) -> None:
    path = tmp_path / "p.keypose"
    save(Document("good"), path)
    bad = Document("bad", settings={"zoom": float("inf")})
    with pytest.raises(KeyposeError, match="finite"):
        save(bad, path)
    assert load(path).name == "good"
    assert os.listdir(tmp_path) == ["p.keypose"]


def test_names_that_are_no_unicode_are_kept(tmp_path: Path) -> None:
    channel = Channel("half \ud800 a pair", Property.WEIGHT)
    curve = Curve([0.0], [[1.0]], kind=CurveKind.SCALAR)
    document = c.SetCurves("a", {channel: curve}).apply(Document())
    save(document, tmp_path / "p.keypose")
    assert list(load(tmp_path / "p.keypose").clips["a"].curves) == [channel]


def test_saving_keeps_links_and_permissions(tmp_path: Path) -> None:
    real, link = tmp_path / "real.keypose", tmp_path / "link.keypose"
    save(Document("one"), real)
    real.chmod(0o640)
    link.symlink_to(real)
    save(Document("two"), link)
    assert link.is_symlink()
    assert load(real).name == "two"
    assert stat.S_IMODE(real.stat().st_mode) == 0o640
    with pytest.raises(FormatError, match="cannot be written"):
        save(Document("three"), tmp_path / "none" / "x.keypose")


@pytest.mark.parametrize(
    ("make", "what"),
    [
        (lambda p: None, "no such file"),
        (lambda p: p.mkdir(), "is a folder"),
        (lambda p: p.write_bytes(b""), "ends within the length"),
        (lambda p: p.write_bytes(b"x" * 100), "header of"),
        (lambda p: (io.save(_motion(), p.with_suffix(".safetensors")) and None) or p.with_suffix(".safetensors").rename(p), "no keypose project"),
    ],
)  # fmt: skip
def test_what_is_no_project_is_refused(make: Callable[[Path], object], what: str, tmp_path: Path) -> None:
    path = tmp_path / "p.keypose"
    make(path)
    with pytest.raises(FormatError, match=what):
        load(path)


def _motion() -> Scene:
    from keypose.evaluate import bake

    document = _keyed()
    motion = bake(document.clips["tube"], document.characters["tube"].skeleton, 30.0)
    return Scene(tuple(document.characters.values()), (motion,))


def _keyed() -> Document:
    rng = np.random.default_rng(0)
    q = rng.normal(size=(4, 4))
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    curves = {
        Channel("Mid", Property.ROTATION): Curve([0.0, 0.2, 0.6, 1.0], q, kind=CurveKind.ROTATION),
        Channel("wide", Property.WEIGHT): Curve([0.0, 1.0], [[0.0], [1.0]], kind=CurveKind.SCALAR),
    }
    document = c.AddCharacter(small_character()).apply(Document("keyed"))
    return c.SetCurves("tube", curves).apply(document)


def test_a_project_is_a_format_like_any_other(tmp_path: Path) -> None:
    path = tmp_path / "p.keypose"
    save(_keyed(), path)
    scene = io.load(path)
    assert scene.format == "keypose"
    assert [a.name for a in scene.animations] == ["tube"]
    assert scene.animations[0].curves.keys() == _keyed().clips["tube"].curves.keys(), (
        "a clip that is only played keeps its keys"
    )
    io.save(scene, tmp_path / "p.glb")
    read = io.load(tmp_path / "p.glb")
    assert read.character.skeleton.joint_count == 3
    again = io.load(path.rename(tmp_path / "renamed.bin"))
    assert again.format == "keypose", "known by its content"
    io.save(scene, tmp_path / "q.keypose")
    assert perform(load(tmp_path / "q.keypose")).animations[0].name == "tube"


def test_a_timeline_that_does_more_is_baked() -> None:
    document = _keyed()
    track = document.timelines["tube"]
    assert type(perform(document).animations[0]).__name__ == "Clip"
    twice = Placement("tube", in_s=0.0, speed=2.0)
    from dataclasses import replace

    layer = replace(track.layers[0], placements=(twice,))
    faster = c.SetTimeline(replace(track, layers=(layer,))).apply(document)
    motion = perform(faster).animations[0]
    assert type(motion).__name__ == "Motion"
    assert (motion.rate_hz, motion.name) == (25.0, "tube")
    one = perform(faster, "tube", rate_hz=50.0)
    assert [a.rate_hz for a in one.animations] == [50.0]


def test_a_single_flipped_bit_is_told() -> None:
    """Every array and every number of the JSON is under the checksum."""
    data = GOLDEN.read_bytes()
    (length,) = struct.unpack_from("<Q", data)
    rng = np.random.default_rng(21)
    for at in rng.integers(8 + length, len(data), 150):
        flipped = bytearray(data)
        flipped[at] ^= 1 << int(rng.integers(8))
        with pytest.raises(FormatError, match="checksum"):
            native.document_from_bytes(bytes(flipped))
    numbers = data.replace(b'rate_hz\\":25.0', b'rate_hz\\":26.0')
    assert numbers != data
    with pytest.raises(FormatError, match="checksum"):
        native.document_from_bytes(numbers)
