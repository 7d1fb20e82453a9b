"""A thousand damaged BVH files: each is refused with one clear line, or loads as sound data."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.conftest import find_data_dir
from tests.io.bvh_files import SMALL, moving_figure
from tests.io.damage import damaged, load_damaged


def sound_files(folder: Path) -> list[Path]:
    """Small files made here, and real ones where the folder of real files is there."""
    made = {"small": SMALL, "crlf": SMALL.replace("\n", "\r\n"), "moving": moving_figure()}
    files = []
    for name, text in made.items():
        files.append(folder / f"{name}.bvh")
        files[-1].write_text(text, newline="")
    data = find_data_dir()
    names = ("bvh/pybvh_edge/rotation_first_root.bvh", "makehuman/walk1.bvh", "bvh/geno/Geno_bind.bvh")
    return files + [data / name for name in names if data]


def test_a_thousand_damaged_files(tmp_path: Path) -> None:
    result = load_damaged(sound_files(tmp_path), 1000, tmp_path)
    assert result["wrong"] == []
    assert result["slowest_s"] < 2, result["slowest"]
    assert result["peak_mib"] < 1024
    # damage that changes nothing, or always everything, would test little
    assert result["loaded"] > 50 and result["refused"] > 400


def test_damage_is_the_same_for_the_same_seed() -> None:
    data = SMALL.encode()
    assert all(damaged(data, seed) == damaged(data, seed) for seed in range(200))
    assert len({damaged(data, seed) for seed in range(200)}) > 150
    binary = b"glTF" + bytes(range(256)) * 9
    assert len({damaged(binary, seed) for seed in range(100)}) > 80
    for seed in range(300):
        damaged(b"", seed)


@pytest.mark.parametrize(
    "letter", ["{", "[", "}", "\n", " ", "\t", "\r", "ROOT a\n{\n", "End Site\n{\n", "MOTION\n", "#"]
)
def test_floods_of_one_thing(tmp_path: Path, letter: str) -> None:
    """A megabyte of the same at four places: no quadratic time, no recursion."""
    flood = (letter * (1_000_000 // len(letter))).encode()
    data = SMALL.encode()
    files = []
    for number, place in enumerate((b"HIERARCHY\n", b"Hips", b"MOTION\n", b"0.0333333\n")):
        at = data.index(place) + len(place)
        path = tmp_path / f"{number}.bvh"
        path.write_bytes(data[:at] + flood + data[at:])
        files.append(path)
    import time

    import keypose.io
    from keypose.errors import FormatError

    for path in files:
        start = time.process_time()
        try:
            keypose.io.load(path)
        except FormatError as error:
            assert len(str(error)) < 600
        assert time.process_time() - start < 5, path.name
