"""A thousand damaged C3D files: each is refused with one clear line, or loads as sound data."""

from __future__ import annotations

from pathlib import Path

import keypose.io
from tests.conftest import find_data_dir
from tests.io.c3d_files import lab
from tests.io.damage import load_damaged


def sound_files(folder: Path) -> list[Path]:
    """Small files made here, and the smallest real ones of each kind of number."""
    made = folder / "lab.c3d"
    keypose.io.save(lab(), made)
    data = find_data_dir()
    names = (
        "misc/MyCube.c3d",
        "c3d_org_sample10/TYPE-4.C3D",
        "misc/badParameterOffset.c3d",
        "c3d_org_sample01/Eb015si.c3d",
    )
    return [made] + [data / "c3d" / name for name in names if data]


def test_a_thousand_damaged_files(tmp_path: Path) -> None:
    result = load_damaged(sound_files(tmp_path), 1000, tmp_path)
    assert result["wrong"] == []
    assert result["slowest_s"] < 2, result["slowest"]
    assert result["peak_mib"] < 1024
    # most damage hits the data, where every number is as good as another
    assert result["loaded"] > 200 and result["refused"] > 100


def test_damaged_heads(tmp_path: Path) -> None:
    """Damage where it hurts: the header and the parameters of a small file alone."""
    import random

    from keypose.errors import FormatError

    keypose.io.save(lab(), tmp_path / "lab.c3d")
    content = (tmp_path / "lab.c3d").read_bytes()
    target = tmp_path / "damaged.c3d"
    outcomes = {"loaded": 0, "refused": 0}
    for seed in range(1000):
        dice = random.Random(seed)
        changed = bytearray(content)
        for _ in range(dice.choice((1, 2, 8))):
            at = dice.randrange(24) if dice.random() < 0.3 else dice.randrange(512, 512 * content[514] + 512)
            changed[at] = dice.choice((0, 1, 127, 128, 255, dice.randrange(256)))
        target.write_bytes(bytes(changed))
        try:
            scene = keypose.io.load(target)
            outcomes["loaded"] += 1
            if scene.markers or scene.signals:
                keypose.io.save(scene, tmp_path / "again.c3d")  # what was read can be written
        except FormatError as error:
            outcomes["refused"] += 1
            assert "\n" not in str(error) and len(str(error)) < 600
    assert min(outcomes.values()) > 50, outcomes
