"""Every file of the data folder against the facts that other tools found in it; the table in the docs is made here.

``KEYPOSE_UPDATE=1`` writes `docs/formats/files.md` anew.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from keypose import io
from keypose.errors import FormatError, MissingExtra
from keypose.evaluate import key_rate
from keypose.io.registry import format_of_suffix
from keypose.model import Clip, Motion, Scene

PAGE = Path(__file__).resolve().parents[2] / "docs" / "formats" / "files.md"
ROW = re.compile(r"^\| `([^`]+\.[A-Za-z0-9]+)` \|")


def facts_of_readme(data_dir: Path) -> dict[str, str]:
    """Path -> known facts, of every row of the folder's own tables."""
    found: dict[str, str] = {}
    for line in (data_dir / "README.md").read_text().splitlines():
        match = ROW.match(line)
        if match:
            found[match[1]] = line.replace("\\|", "/").rstrip("| ").rpartition("|")[2].strip()
    return found


def rate_of(animation: Clip | Motion) -> float | None:
    return animation.rate_hz if isinstance(animation, Motion) else key_rate(animation)


def frames_of(scene: Scene) -> int | None:
    if scene.markers:
        return scene.markers[0].frame_count
    if scene.animations and isinstance(scene.animations[0], Motion):
        return scene.animations[0].frame_count
    return None


def close(rate: float | None, text: str) -> bool:
    """Facts give rates to a few digits; a frame time is a rounded rate."""
    return rate is not None and abs(rate / float(text) - 1) < 2e-3


Check = Callable[[Scene, re.Match[str]], bool]

CHECKS: tuple[tuple[str, str, Check], ...] = (
    (r"\.bvh$", r"(\d+) joints, \d+ channels", lambda s, m: s.character.skeleton.joint_count >= int(m[1])),
    (r"\.bvh$", r"channels, (\d+) frames", lambda s, m: (frames_of(s) or 0) == int(m[1])),
    (r"\.bvh$", r"frames, ([\d.]+) fps", lambda s, m: close(rate_of(s.animations[0]), m[1])),
    (r"\.c3d$", r"(\d+) points, frames", lambda s, m: _points(s) == int(m[1])),
    (r"\.c3d$", r"frames (-?\d+)-\d+ \(", lambda s, m: not s.markers or s.markers[0].start_frame == int(m[1])),
    (r"\.c3d$", r"frames -?\d+-\d+ \((\d+)\)", lambda s, m: frames_of(s) in (int(m[1]), None)),
    (r"\.c3d$", r"\), ([\d.]+) Hz", lambda s, m: not s.markers or close(s.markers[0].rate_hz, m[1])),
    (r"\.trc$", r"DataRate ([\d.]+)", lambda s, m: close(s.markers[0].rate_hz, m[1])),
    (r"\.trc$", r"NumMarkers ([1-9]\d*)", lambda s, m: len(s.markers[0].names) == int(m[1])),
    (r"\.csm$", r"^(\d+) markers", lambda s, m: len(s.markers[0].names) == int(m[1])),
    (r"\.csm$", r"frames (-?\d+)-", lambda s, m: s.markers[0].start_frame == int(m[1])),
    (r"\.amc$", r"^(\d+) frames", lambda s, m: frames_of(s) == int(m[1])),
    (r"\.asf$", r"(\d+) bones", lambda s, m: s.character.skeleton.joint_count >= int(m[1])),
    (r"\.(gltf|glb|vrm|vrma)$", r"(\d+) animations", lambda s, m: len(s.animations) == int(m[1])),
    (r"\.(gltf|glb|vrm)$", r"(\d+) skins", lambda s, m: any(p.skin for c in s.characters for p in c.parts)),
    (r"\.(gltf|glb|vrm|vrma)$", r"^(\d+) nodes", lambda s, m: _joints(s) + _dropped(s) >= int(m[1])),
    (r"\.obj$", r"^(\d+) vertices", lambda s, m: _fits(s, int(m[1]))),
    (r"\.dae$", r"(\d+) joints", lambda s, m: _joints(s) >= int(m[1])),
    (r"\.dae$", r"up (X|Y|Z)_UP", lambda s, m: s.up == m[1]),
    (r"\.dae$", r"unit ([\d.]+) m", lambda s, m: close(s.unit_m, m[1])),
    (r"\.usd[az]?$", r"up (X|Y|Z)", lambda s, m: s.up == m[1]),
    (r"\.usd[az]?$", r"([\d.]+) m/unit", lambda s, m: close(s.unit_m, m[1])),
    (r"\.usd[az]?$", r"time (\d+)-(\d+) at (\d+)/s", lambda s, m: _lasts(s, int(m[1]), int(m[2]), int(m[3]))),
    (r"\.usd[az]?$", r"\((\d+) joints\)", lambda s, m: _joints(s) >= int(m[1])),
    (r"\.usd[az]?$", r"(\d+) meshes \((\d+) points\)", lambda s, m: _fits(s, int(m[2]))),
    (r"\.usd[az]?$", r"(\d+) blend shapes", lambda s, m: len(s.character.morph_names) >= int(m[1])),
    (r"\.mot$", r"nRows=(\d+)", lambda s, m: frames_of(s) == int(m[1])),
    (r"\.fbx$", r"LimbNode ([1-9]\d*)", lambda s, m: _joints(s) > 1),
)


def _points(scene: Scene) -> int:
    """Trajectories of the file: markers, and what was computed from them."""
    computed = sum(len(signals.names) for signals in scene.signals if np.ndim(signals.values) == 3)
    return sum(len(markers.names) for markers in scene.markers) + computed


def _joints(scene: Scene) -> int:
    return sum(c.skeleton.joint_count for c in scene.characters)


def _dropped(scene: Scene) -> int:
    """Nodes that are outside the file's scene, as the notes say."""
    return sum(int(m[1]) for note in scene.notes if (m := re.match(r"(\d+) root nodes outside", note)))


def _lasts(scene: Scene, first: int, last: int, rate: int) -> bool:
    """Whether the clips, if there are any, go from one time code to another; some files end before their last frame."""
    return all(
        abs(a.start_s * rate - first) < 1e-6 and (a.start_s + a.duration_s) * rate < last + 1e-6
        for a in scene.animations
    )


def _fits(scene: Scene, points: int) -> bool:
    """Whether the meshes may have that many points: some may coincide, one with several normals is several vertices."""
    parts = [p for c in scene.characters for p in c.parts]
    places = np.concatenate([np.asarray(p.mesh.positions) for p in parts]) if parts else np.zeros((0, 3))
    return len(np.unique(places, axis=0)) <= points <= max(len(places), points if not parts else 0)


@dataclass(frozen=True)
class Row:
    path: str
    format: str
    result: str
    facts: int


def look(data_dir: Path, path: str, facts: str) -> Row:
    """Load a file and check what is known of it; raises AssertionError where a fact is not met."""
    chosen = format_of_suffix(Path(path))
    assert chosen is not None
    try:
        scene = io.load(data_dir / path)
    except MissingExtra as error:
        pytest.skip(str(error))
    except FormatError as error:
        return Row(path, chosen.name, f"refused: {error.where + ': ' if error.where else ''}{error.what}", 0)
    met = 0
    for suffix, pattern, check in CHECKS:
        match = re.search(pattern, facts)
        if match and re.search(suffix, path, re.IGNORECASE):
            assert check(scene, match), f"{path}: {match[0]!r} is not what was loaded"
            met += 1
    return Row(path, scene.format, summary(scene), met)


def summary(scene: Scene) -> str:
    pieces: list[str] = []
    joints = _joints(scene)
    if joints > 1:
        pieces.append(f"{joints} joints")
    vertices = sum(c.vertex_count for c in scene.characters)
    if vertices:
        pieces.append(f"{vertices:,} vertices")
    morphs = sum(len(c.morph_names) for c in scene.characters)
    if morphs:
        pieces.append(f"{morphs} morphs")
    if scene.animations:
        first = scene.animations[0]
        rate = rate_of(first)
        length = f"{first.frame_count:,} frames" if isinstance(first, Motion) else f"{first.duration_s:.4g} s"
        more = f"{len(scene.animations)} clips, the first " if len(scene.animations) > 1 else ""
        pieces.append(f"{more}{length}{f' at {rate:.6g} Hz' if rate else ''}")
    pieces += [f"{len(m.names)} markers, {m.frame_count:,} frames at {m.rate_hz:.6g} Hz" for m in scene.markers]
    pieces += [f"{len(signals.names)} {signals.kind}" for signals in scene.signals]
    if scene.tiers:
        pieces.append(f"{len(scene.tiers)} tiers")
    if scene.plates:
        pieces.append(f"{len(scene.plates)} force plates")
    return "; ".join(pieces) or "empty"


def known_files(data_dir: Path) -> list[tuple[str, str]]:
    """Files whose suffix names a format that is read, with their facts."""
    return [
        (path, facts)
        for path, facts in sorted(facts_of_readme(data_dir).items())
        # Tables of numbers are also named .csv; no Live Link take is in the folder.
        if format_of_suffix(Path(path)) is not None and not path.endswith(".csv") and (data_dir / path).exists()
    ]


@pytest.mark.data
@pytest.mark.slow
def test_every_file_is_what_others_say_or_is_refused_with_a_reason(data_dir: Path) -> None:
    files = known_files(data_dir)
    assert len(files) > 60
    rows, wrong = [], []
    for path, facts in files:
        try:
            rows.append(look(data_dir, path, facts))
        except AssertionError as error:
            wrong.append(str(error))
    assert not wrong, "\n".join(wrong)
    for row in rows:  # what is refused says where it is malformed
        assert not row.result.startswith("refused") or len(row.result) > 20, row
    assert sum(row.facts for row in rows) > 150
    text = page(rows)
    if os.environ.get("KEYPOSE_UPDATE"):
        PAGE.write_text(text)
    assert PAGE.read_text() == text, "docs/formats/files.md is not of today; run with KEYPOSE_UPDATE=1"


def page(rows: list[Row]) -> str:
    refused = sum(row.result.startswith("refused") for row in rows)
    lines = [
        "# Files",
        "",
        f"What becomes of {len(rows)} real files made by other programs: {len(rows) - refused} are read, {refused} are refused with the",
        f"place where they are malformed. {sum(row.facts for row in rows)} facts that other tools measured in them are met. A test makes this page.",
        "",
        "| file | format | what is in it |",
        "|---|---|---|",
    ]
    lines += [f"| `{row.path}` | {row.format} | {row.result.replace('|', '/')} |" for row in rows]
    return "\n".join(lines) + "\n"
