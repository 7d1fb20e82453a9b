"""Real captures on real bodies, with the figures that the docs print; an independent result of the same performances.

``KEYPOSE_UPDATE=1`` writes `docs/retarget-figures.md` anew. Its numbers are compared with a tolerance: other processors round
in other ways.
"""

from __future__ import annotations

import os
import re
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from keypose import evaluate, samples
from keypose.analysis import find_roles, measure_quality
from keypose.editing.planting import PlantOptions
from keypose.model import Motion, Pose, Scene
from keypose.retarget import (
    BodyFrames,
    ReferenceReport,
    RetargetResult,
    bind_stand,
    compare_with_reference,
    ground_under,
    pose_of_other,
    retarget,
)
from tests.conftest import ROOT

PAGE = ROOT / "docs" / "retarget-figures.md"
TAKES = {"02_01": "walk", "02_02": "walk", "02_03": "run", "02_04": "jump, balance"}
BODIES = {
    "sample:human": "built-in human",
    "makehuman/default.mhskel": "MakeHuman",
    "vrm/basic_armature.vrm": "VRM",
    "fbx/geno/Geno.fbx": "Geno (FBX)",
    "fbx/ozz_pab/arnaud.fbx": "Biped (FBX)",
    "fbx/ufbx_skin/maya_kenney_character_7700_binary.fbx": "Kenney (FBX, saved in mid-step)",
    "gltf/cc0/Knight.glb": "KayKit knight (glTF)",
    "gltf/cc0/robot.glb": "robot with goals for feet (glTF)",
    "asf_amc/cmu_02/02.asf": "the captured body itself",
}
NUMBER = re.compile(r"-?\d+\.\d+")


@cache
def opened(path: str) -> Scene:
    return samples.open_scene(path)


def on_reference_rig(
    data_dir: Path, take: str, plant: bool = True, spread: bool = True
) -> tuple[RetargetResult, ReferenceReport]:
    """``spread``: with the T pose that the rig has in the first frame of another file for its reference pose."""
    source = opened(str(data_dir / f"asf_amc/cmu_02/{take}.amc"))
    theirs = opened(str(data_dir / f"bvh/cmu_iclone_002/0{take}.bvh"))
    rig, motion = theirs.character.skeleton, theirs.animations[0]
    assert isinstance(motion, Motion)
    stand = None
    if spread:
        other = opened(str(data_dir / "bvh/cmu_iclone_007/007_05.bvh"))
        first = other.animations[0]
        assert isinstance(first, Motion)
        pose = first.pose.broadcast()
        frame = Pose(pose.translations[0], pose.rotations[0], pose.scales[0])
        stand = pose_of_other(rig, other.character.skeleton, frame)
    done = retarget(
        source.animations[0],
        source.character.skeleton,
        rig,
        target_motion=motion,
        target_reference=stand,
        plant=PlantOptions() if plant else None,
    )
    roles = done.target.roles
    return done, compare_with_reference(done.motion, rig, roles, motion, rig, roles, done.touching)


def on_body(data_dir: Path, take: str, body: str) -> RetargetResult:
    source = opened(str(data_dir / f"asf_amc/cmu_02/{take}.amc"))
    character = opened(body if body.startswith("sample:") else str(data_dir / body)).character
    stand = bind_stand(character, find_roles(character.skeleton).roles)
    return retarget(
        source.animations[0],
        source.character.skeleton,
        character.skeleton,
        target_reference=stand,
        target_ground_m=ground_under(character, stand),
    )


@pytest.mark.data
@pytest.mark.parametrize("take", TAKES)
def test_against_an_independent_result(data_dir: Path, take: str) -> None:
    """The reference shows in its frame k, counted from 1, what the capture shows in its frame 2k - 1, counted from 0."""
    report = on_reference_rig(data_dir, take)[1]
    assert report.shift_s == pytest.approx(1 / 120)
    assert report.turned_deg == pytest.approx(-60.3 if take == "02_04" else 0.0, abs=1.0)
    assert report.direction_deg["arms"] < 0.6
    assert report.direction_deg["trunk"] < 0.2
    assert report.direction_deg["head"] < 0.4
    assert report.direction_deg["shoulders"] < 1.0
    assert report.direction_deg["legs"] < 4.5
    assert report.mean_direction_deg < 2.5
    assert report.slide_cm_s < 0.1 < 5.0 < report.reference_slide_cm_s
    loose = on_reference_rig(data_dir, take, plant=False)[1]
    assert loose.direction_deg["legs"] < 2.0  # what is more comes from planting the feet
    assert loose.slide_cm_s > 5.0
    own = on_reference_rig(data_dir, take, spread=False)[1]
    assert own.direction_deg["arms"] < 0.6 and own.mean_direction_deg < 4.0


@pytest.mark.data
@pytest.mark.parametrize("take", TAKES)
@pytest.mark.parametrize("body", BODIES)
def test_feet_hold_on_other_bodies(data_dir: Path, take: str, body: str) -> None:
    done = on_body(data_dir, take, body)
    assert done.report.slide_cm_s < 1.0
    assert done.report.sink_cm < 0.1
    assert done.report.mean_direction_deg < 5.0
    assert max(done.report.direction_deg[f"{s}_{b}_arm"] for s in ("left", "right") for b in ("upper", "lower")) < 0.1


@pytest.mark.data
@pytest.mark.parametrize("take", TAKES)
@pytest.mark.parametrize("body", BODIES)
def test_the_meter_that_looks_for_contacts_anew_says_so_too(data_dir: Path, take: str, body: str) -> None:
    """Not only in the contacts of the source: whatever low and slow the meter finds on the other body holds as well."""
    done = on_body(data_dir, take, body)
    found = measure_quality(done.motion, done.target.skeleton, done.target.roles)
    assert found.skate_cm_s is not None
    assert found.skate_cm_s < 0.1


@pytest.mark.data
@pytest.mark.parametrize("take", TAKES)
@pytest.mark.parametrize("body", BODIES)
def test_knees_do_not_jump(data_dir: Path, take: str, body: str) -> None:
    """Their largest angular acceleration is no more than 1.5 times what the capture has."""
    done = on_body(data_dir, take, body)
    animation = opened(str(data_dir / f"asf_amc/cmu_02/{take}.amc")).animations[0]
    assert isinstance(animation, Motion)
    mine, theirs = (
        np.abs(np.diff(knees(frames, motion), 2, axis=0)).max()
        for frames, motion in ((done.target, done.motion), (done.source, animation))
    )
    # legs that are short for the body land with knees that are bent further
    assert mine < (3.0 if "robot" in body or "kenney" in body else 1.5) * theirs


def knees(body: BodyFrames, motion: Motion) -> np.ndarray:
    """Angles of both knees in radians (T, 2)."""
    at = np.asarray(evaluate.world_rotations_positions(body.skeleton, motion.pose.broadcast())[1], np.float64)
    found: list[np.ndarray] = []
    for side in ("left", "right"):
        hip, knee, foot = (at[:, body.roles[f"{side}_{part}"]] for part in ("upper_leg", "lower_leg", "foot"))
        u, v = hip - knee, foot - knee
        cosine = np.sum(u * v, -1) / np.linalg.norm(u, axis=-1) / np.linalg.norm(v, axis=-1)
        found.append(np.arccos(np.clip(cosine, -1.0, 1.0)))
    return np.stack(found, axis=-1)


@pytest.mark.data
@pytest.mark.slow
def test_the_figures_of_the_docs(data_dir: Path) -> None:
    lines = [
        "# Retargeting in figures",
        "",
        "The captures of CMU's subject 02 on other bodies, as `keypose retarget` prints it. A test makes this page.",
        "",
        "## Beside an independent result",
        "",
        "Somebody else put the same four performances on Character Creator's rig. The BVH shows in its frame k (from 1) the capture's",
        "frame 2k - 1 (from 0), and one take of it is turned by 60 degrees about the vertical: both are found and taken out. Mean angles",
        "between bones in degrees, with the rig's T pose (frame 0 of `007_05.bvh`) for its reference:",
        "",
        "```",
        "keypose retarget 02_01.amc --to 002_01.bvh out.bvh --target-reference 007_05.bvh:0 --against 002_01.bvh",
        "```",
        "",
        "The reference's feet slide; ours are planted and lie level where they stand, which moves the legs by a degree or two (*legs,",
        "loose* is without). Without the T pose (*all, no T pose*) the stand is taken from the rig's own motion.",
        "",
        "| take | arms | shoulders | trunk | head | legs | legs, loose | feet | all | all, no T pose | turned | slide, cm/s | its slide, cm/s |",
        "|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for take, what in TAKES.items():
        report, loose = on_reference_rig(data_dir, take)[1], on_reference_rig(data_dir, take, plant=False)[1]
        own = on_reference_rig(data_dir, take, spread=False)[1]
        at = report.direction_deg
        figures = [
            *(at[group] for group in ("arms", "shoulders", "trunk", "head", "legs")),
            *(loose.direction_deg["legs"], at["feet"], report.mean_direction_deg, own.mean_direction_deg),
            *(report.turned_deg, report.slide_cm_s, report.reference_slide_cm_s),
        ]
        lines.append(f"| {take}, {what} | " + " | ".join(f"{figure:.2f}" for figure in figures) + " |")
    lines += [
        "",
        "## On other bodies",
        "",
        "Mean angle between the bones of both bodies in degrees / mean slide of feet in contact in cm/s / deepest place of a foot under",
        "the ground in cm. The last row is the slide of the captured feet in the same contacts.",
        "",
        "| body | " + " | ".join(f"{take}, {what}" for take, what in TAKES.items()) + " |",
        "|---|" + "---:|" * len(TAKES),
    ]
    for body, title in BODIES.items():
        reports = [on_body(data_dir, take, body).report for take in TAKES]
        cells = [f"{r.mean_direction_deg:.1f} / {r.slide_cm_s:.2f} / {r.sink_cm:.2f}" for r in reports]
        lines.append(f"| {title} | " + " | ".join(cells) + " |")
    captured = [on_body(data_dir, take, "sample:human").report.source_slide_cm_s for take in TAKES]
    lines.append("| *captured* | " + " | ".join(f"{slide:.2f}" for slide in captured) + " |")
    text = "\n".join(lines) + "\n"
    if os.environ.get("KEYPOSE_UPDATE"):
        PAGE.write_text(text)
    there = PAGE.read_text()
    assert NUMBER.sub("#", there) == NUMBER.sub("#", text), (
        "docs/retarget-figures.md is not of today; run with KEYPOSE_UPDATE=1"
    )
    apart = [abs(float(a) - float(b)) for a, b in zip(NUMBER.findall(there), NUMBER.findall(text), strict=True)]
    assert max(apart) < 0.16, "docs/retarget-figures.md is not of today; run with KEYPOSE_UPDATE=1"
