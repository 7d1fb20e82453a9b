"""TextGrid and HTS labels: real files against praatio and plain parsing, both forms, round trips, damage."""

from __future__ import annotations

import doctest
import re
from pathlib import Path

import numpy as np
import pytest

import keypose.io
from keypose.errors import FormatError, ShapeError, UnknownName
from keypose.model import Scene, Tier
from tests.conftest import ROOT, data_files, find_data_dir
from tests.io.damage import load_damaged

GRIDS = data_files("speech/praatio/*.TextGrid")
SHORT = 'File type = "ooTextFile"\nObject class = "TextGrid"\n\n0\n2.5\n<exists>\n2\n' + (
    '"IntervalTier"\n"phone"\n0\n2.5\n2\n0\n1.25\n"a ""b"""\n1.25\n2.5\n""\n"TextTier"\n"marks"\n0\n2.5\n1\n0.5\n"x"\n'
)
HTS = "0 1300000 x^x-sil+hh=iy@x_x/A:0\n1300000 2050000 x^sil-hh+iy=t@1_2/A:0\n2050000 2700000 sil^hh-iy+t=er@2_1/A:0\n"


def tiers() -> tuple[Tier, ...]:
    return (
        Tier("phone", [0.1, 0.25, 0.25 + 1 / 3], [0.25, 0.25 + 1 / 3, 0.9], ("h", 'a "quoted" one', "ə")),
        Tier("marks", [0.2, 0.7], [0.2, 0.7], ("click", ""), is_points=True),
    )


# --- the type --------------------------------------------------------------------------------------------------------


def test_a_tier_knows_what_is_said_when() -> None:
    phone = tiers()[0]
    assert phone.start_s == 0.1 and phone.end_s == 0.9
    assert phone.at([0.0, 0.1, 0.2, 0.25, 0.5, 0.6, 0.9, 5.0]).tolist() == [-1, 0, 0, 1, 1, 2, -1, -1]
    assert Tier("none", [], [], ()).at([0.0, 1.0]).tolist() == [-1, -1]
    for starts, ends in (([0.0, 1.0], [1.0]), ([1.0], [0.5]), ([0.0, np.nan], [1.0, 2.0]), ([1.0, 0.0], [1.0, 2.0])):
        with pytest.raises(ShapeError):
            Tier("wrong", starts, ends, ("a", "b")[: len(starts)])


# --- TextGrid --------------------------------------------------------------------------------------------------------


@pytest.mark.data
@pytest.mark.parametrize("path", GRIDS, ids=lambda p: p.name)
def test_real_grids_are_what_praatio_reads(path: Path) -> None:
    praatio = pytest.importorskip("praatio.textgrid", reason="praatio is not installed")
    theirs = praatio.openTextgrid(str(path), includeEmptyIntervals=True)
    scene = keypose.io.load(path)
    assert scene.format == "textgrid" and scene.notes == ()
    assert [t.name for t in scene.tiers] == list(theirs.tierNames)
    for tier in scene.tiers:
        other = theirs.getTier(tier.name)
        rows = [(e[0], e[0], e[1]) if tier.is_points else tuple(e) for e in other.entries]
        mine = [(a, b, label.strip()) for a, b, label in zip(tier.starts_s, tier.ends_s, tier.labels, strict=True)]
        mine = [row for row in mine if row[2]]
        assert [r[2] for r in mine] == [r[2] for r in rows if r[2]]
        assert np.allclose([r[:2] for r in mine], [r[:2] for r in rows if r[2]], atol=1e-9)


@pytest.mark.data
def test_real_grids_have_the_stated_numbers(data_dir: Path) -> None:
    stated = {"bobby_phones.TextGrid": (1, 15), "bobby_words.TextGrid": (2, 9), "mary.TextGrid": (3, None)}
    for name, (count, labels) in stated.items():
        found = keypose.io.load(data_dir / "speech/praatio" / name).tiers
        assert len(found) == count and (labels is None or sum(len(t.labels) for t in found) == labels)


def test_both_forms_are_the_same_tokens(tmp_path: Path) -> None:
    scene = Scene(tiers=tiers())
    for form in ("long", "short"):
        keypose.io.save(scene, tmp_path / f"{form}.TextGrid", form=form)
    a, b = (keypose.io.load(tmp_path / f"{form}.TextGrid") for form in ("long", "short"))
    for mine, copy, source in zip(a.tiers, b.tiers, scene.tiers, strict=True):
        assert (mine.name, mine.labels, mine.is_points) == (copy.name, copy.labels, copy.is_points)
        assert np.array_equal(mine.starts_s, copy.starts_s) and np.array_equal(mine.ends_s, copy.ends_s)
        kept = [k for k, label in enumerate(mine.labels) if label or mine.is_points]
        assert [mine.labels[k] for k in kept] == list(source.labels)
        assert np.array_equal(mine.starts_s[kept], source.starts_s) and np.array_equal(mine.ends_s[kept], source.ends_s)
    with pytest.raises(UnknownName):
        keypose.io.save(scene, tmp_path / "x.TextGrid", form="binary")


@pytest.mark.data
def test_real_grids_come_back_and_praatio_reads_them(data_dir: Path, tmp_path: Path) -> None:
    praatio = pytest.importorskip("praatio.textgrid", reason="praatio is not installed")
    for path in GRIDS:
        scene = keypose.io.load(path)
        for form in ("long", "short"):
            keypose.io.save(scene, tmp_path / path.name, form=form)
            again = keypose.io.load(tmp_path / path.name)
            for a, b in zip(scene.tiers, again.tiers, strict=True):
                spoken = [
                    [(t.starts_s[k], t.ends_s[k], t.labels[k]) for k in range(len(t.labels)) if t.labels[k]]
                    for t in (a, b)
                ]
                assert spoken[0] == spoken[1]
            assert list(praatio.openTextgrid(str(tmp_path / path.name), False).tierNames) == [
                t.name for t in scene.tiers
            ]


def test_what_praat_allows(tmp_path: Path) -> None:
    path = tmp_path / "grid.TextGrid"
    for data in (
        SHORT.encode(), SHORT.encode("utf-16"), ("\ufeff" + SHORT).encode(), SHORT.replace("\n", "\r\n").encode(),
        SHORT.replace("<exists>", "<exists> ! a remark with 7 numbers").encode(), SHORT.replace('"a ""b"""', '"\xe9"').encode("latin-1"),
    ):  # fmt: skip
        path.write_bytes(data)
        scene = keypose.io.load(path)
        assert [t.name for t in scene.tiers] == ["phone", "marks"]
        assert scene.tiers[0].labels[0] in ('a "b"', "é") and scene.tiers[1].starts_s.tolist() == [0.5]
    path.write_text(SHORT.replace("<exists>\n2", "<absent>"))
    assert keypose.io.load(path).tiers == ()


@pytest.mark.parametrize(
    ("old", "new", "place"),
    [
        ('"TextGrid"', '"Pitch"', "line 2"),
        ("<exists>\n2", "<exists>\n3", "line 26"),
        ("2.5\n2\n0\n1.25", "2.5\n2\n3\n1.25", "line 14"),
        ("2.5\n2\n0", "2.5\n1000000\n0", "line 12"),
        ("2.5\n2\n0", "2.5\n-2\n0", "line 12"),
        ("2.5\n2\n0", "2.5\n2.5\n0", "line 12"),
        ('"IntervalTier"', '"FormantTier"', "line 9"),
        ("1.25\n2.5", '"1.25"\n2.5', "line 16"),
        ("1.25\n2.5", "1e300\n2.5", "line 16"),
    ],
)
def test_what_is_wrong_is_named_with_its_line(tmp_path: Path, old: str, new: str, place: str) -> None:
    assert old in SHORT
    (tmp_path / "wrong.TextGrid").write_text(SHORT.replace(old, new, 1))
    with pytest.raises(FormatError) as error:
        keypose.io.load(tmp_path / "wrong.TextGrid")
    assert error.value.where == place


def test_what_cannot_be_written_or_read(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match="no tiers"):
        keypose.io.save(Scene(), tmp_path / "a.TextGrid")
    overlapping = Tier("x", [0.0, 0.5], [1.0, 2.0], ("a", "b"))
    with pytest.raises(FormatError, match=r"0\.5 s overlaps"):
        keypose.io.save(Scene(tiers=(overlapping,)), tmp_path / "a.TextGrid")
    (tmp_path / "b.TextGrid").write_bytes(b"ooBinaryFile\x08TextGrid" + bytes(40))
    with pytest.raises(FormatError, match="binary"):
        keypose.io.load(tmp_path / "b.TextGrid")


# --- HTS -------------------------------------------------------------------------------------------------------------


@pytest.mark.data
def test_the_real_labels(data_dir: Path) -> None:
    path = data_dir / "speech/arctic/arctic_a0009_phone.lab"
    scene = keypose.io.load(path)
    lines = [line.split() for line in path.read_text().splitlines()]
    (tier,) = scene.tiers
    assert len(tier.labels) == len(lines) and scene.format == "hts"
    assert np.allclose(tier.starts_s, [int(a) / 1e7 for a, _, _ in lines]) and np.allclose(
        tier.ends_s, [int(b) / 1e7 for _, b, _ in lines]
    )
    assert list(tier.labels) == [re.search(r"-(.+?)\+", full)[1] for _, _, full in lines]  # type: ignore[index]
    assert scene.extras["hts"]["context"] == [full for _, _, full in lines]
    assert tier.end_s == pytest.approx(3.1, abs=0.05)  # the sound beside it lasts 3.10 s
    assert tier.labels[:4] == ("sil", "hh", "iy", "t")


def test_plain_labels_states_and_seconds(tmp_path: Path) -> None:
    path = tmp_path / "a.lab"
    path.write_text("0 100000 sil\n100000 350000 aa -12.5 word\n")
    scene = keypose.io.load(path)
    assert scene.tiers[0].labels == ("sil", "aa") and scene.tiers[0].ends_s[1] == 0.035 and "hts" not in scene.extras
    assert any("1 lines" in note for note in scene.notes)
    path.write_text("0 100000 x^x-sil+a=b@1[2]\r\n100000 200000 x^x-sil+a=b@1[3]\r\n")
    scene = keypose.io.load(path)
    assert scene.tiers[0].labels == ("sil", "sil") and any("2 labels are of states" in note for note in scene.notes)
    path.write_text("0.0 0.25 a\n0.25 0.5 b\n")
    scene = keypose.io.load(path)
    assert scene.tiers[0].ends_s.tolist() == [0.25, 0.5] and any("seconds" in note for note in scene.notes)


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("0 1 a\n1 b\n", "line 2"),
        ("0 1 a\n\n-1 2 b\n", "line 3"),
        ("0 1 a\n2 1 b\n", "line 2"),
        ("5 6 a\n1 2 b\n", "line 2"),
        ("0 999999999999999999 a\n", "line 1"),
        ("\n\n", "end of file"),
    ],
)
def test_wrong_labels_are_named_with_their_line(tmp_path: Path, text: str, place: str) -> None:
    (tmp_path / "wrong.lab").write_text(text)
    with pytest.raises(FormatError) as error:
        keypose.io.load(tmp_path / "wrong.lab")
    assert error.value.where == place


def test_labels_go_to_a_grid(tmp_path: Path) -> None:
    (tmp_path / "a.lab").write_text(HTS)
    scene = keypose.io.load(tmp_path / "a.lab")
    keypose.io.save(scene, tmp_path / "a.TextGrid")
    again = keypose.io.load(tmp_path / "a.TextGrid")
    assert again.tiers[0].labels == scene.tiers[0].labels and np.array_equal(
        again.tiers[0].ends_s, scene.tiers[0].ends_s
    )


# --- damage ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", [".TextGrid", ".lab"])
def test_a_thousand_damaged_files(tmp_path: Path, suffix: str) -> None:
    data = find_data_dir()
    if suffix == ".lab":
        files = [tmp_path / "small.lab", tmp_path / "plain.lab"]
        files[0].write_text(HTS)
        files[1].write_text("".join(f"{k * 1000} {k * 1000 + 1000} p{k}\n" for k in range(40)))
        files += [data / "speech/arctic/arctic_a0009_phone.lab"] if data else []
    else:
        files = [tmp_path / "short.TextGrid", tmp_path / "long.TextGrid", tmp_path / "wide.TextGrid"]
        files[0].write_text(SHORT)
        keypose.io.save(Scene(tiers=tiers()), files[1])
        files[2].write_bytes(SHORT.encode("utf-16"))
        files += GRIDS
    result = load_damaged(files, 1000, tmp_path)
    assert result["wrong"] == []
    assert result["slowest_s"] < 3, result["slowest"]
    assert result["peak_mib"] < 1024
    assert result["loaded"] > 50 and result["refused"] > 200


def test_the_page() -> None:
    result = doctest.testfile(str(ROOT / "docs/formats/speech.md"), module_relative=False, encoding="utf-8")
    assert result.attempted and not result.failed
