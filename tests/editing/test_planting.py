"""Planted feet: they stand still, a second time changes nothing, knees do not jump, on floors, slopes and stairs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from keypose import evaluate, samples
from keypose.analysis import find_roles, measure_quality
from keypose.analysis.contacts import contact_spans, find_footing
from keypose.analysis.ground import Ground, true_runs
from keypose.analysis.quality import carried_speeds
from keypose.editing.operators import run_operator
from keypose.editing.planting import PlantOptions, plant_feet, put_on_floor
from keypose.errors import KeyposeError, ShapeError
from keypose.math import quat
from keypose.model import Motion, Pose, Skeleton
from keypose.samples import performances

REAL = (
    *(f"bvh/cmu_iclone_007/007_{n:02d}.bvh" for n in range(1, 13)),
    *(f"bvh/cmu_iclone_002/002_{n:02d}.bvh" for n in range(1, 5)),
    *(f"asf_amc/cmu_02/02_{n:02d}.amc" for n in range(1, 6)),
    "cmu_01_01/01_01.amc", "cmu_01_01/01_01.bvh", "bvh/cmu_cgspeed/cmu_12_01_walk.bvh", "bvh/fair1/dab.bvh",
    "bvh/fair1/zombie.bvh", "bvh/freebvh/test_freebvh.bvh", "bvh/rokoko/jesse_dance.bvh", "makehuman/walk1.bvh",
    "fbx/ozz_pab/crossarms.fbx", "fbx/ozz_pab/jog.fbx", "fbx/ozz_pab/run.fbx", "fbx/ozz_pab/walk.fbx",
    "fbx/ufbx_skin/maya_kenney_character_7700_binary.fbx", "vrm/idle_loop.vrma", "gltf/cc0/Knight.glb", "gltf/cc0/robot.glb",
)  # fmt: skip


def body() -> Skeleton:
    return samples.load("human").character.skeleton


def roles_of(skeleton: Skeleton) -> dict[str, int]:
    return dict(find_roles(skeleton).roles)


def world(skeleton: Skeleton, motion: Motion) -> tuple[np.ndarray, np.ndarray]:
    turned, places = evaluate.world_rotations_positions(skeleton, motion.pose.broadcast())
    return np.asarray(turned, np.float64), np.asarray(places, np.float64)


def knee_peak(skeleton: Skeleton, motion: Motion, roles) -> float:
    places = world(skeleton, motion)[1]
    peaks = []
    for side in ("left", "right"):
        hip, knee, foot = (places[:, roles[f"{side}_{p}"]] for p in ("upper_leg", "lower_leg", "foot"))
        a, b = knee - hip, foot - knee
        angle = np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), np.sum(a * b, axis=-1))
        peaks.append(np.abs(np.diff(angle, 2)).max(initial=0.0) * motion.rate_hz**2)
    return float(max(peaks))


def slipping(name: str, drift_m_s: float = 0.12, bob_m: float = 0.01) -> Motion:
    """A built-in performance whose whole body drifts and bobs, so that its feet slide, sink and float."""
    motion = performances.make(name)
    pose = motion.pose.broadcast()
    moved = np.array(pose.translations, np.float64)
    t = np.arange(motion.frame_count) / motion.rate_hz
    moved[:, 0] += np.stack([drift_m_s * np.sin(2.0 * t), bob_m * np.sin(3.1 * t), drift_m_s * t], axis=-1)
    return replace(
        motion, pose=Pose(moved, np.asarray(pose.rotations, np.float64), np.asarray(pose.scales, np.float64))
    )


def slides(skeleton: Skeleton, motion: Motion, roles, touching) -> np.ndarray:
    return carried_speeds(roles, world(skeleton, motion)[1], touching, motion.rate_hz)


@pytest.mark.parametrize("hips", ["free", "upright", "still"])
@pytest.mark.parametrize("name", ["walk", "run", "idle", "wave", "jump"])
def test_slipping_feet_stand_still(name: str, hips: str) -> None:
    skeleton, motion = body(), slipping(name)
    roles = roles_of(skeleton)
    done = plant_feet(motion, skeleton, roles, options=PlantOptions(hips=hips))
    assert slides(skeleton, motion, roles, done.touching).mean() > 3.0
    if hips != "still":
        assert done.short_m < 1e-6
        assert slides(skeleton, done.motion, roles, done.touching).max() < 0.02
        # who stands has knees that do not move at all; to hold feet under a body that drifts they must, a little
        least = 20.0 if name in ("idle", "wave") else 0.0
        assert knee_peak(skeleton, done.motion, roles) <= max(least, 1.5 * knee_peak(skeleton, motion, roles))
    before, after = (world(skeleton, m)[1][:, roles["hips"]] for m in (motion, done.motion))
    # hips follow feet that were moved by more than a leaning body bears
    # a body leans by 5 cm at most after its feet; where they were moved further it goes along
    follow = max(0.05, done.moved_m.max() - 0.05)
    assert np.abs(after - before)[:, [0, 2]].max() < (follow if hips == "free" else 1e-9)
    if hips == "still":
        np.testing.assert_allclose(after, before, atol=1e-9)


def scaled(motion: Motion, skeleton: Skeleton, size: float) -> tuple[Motion, Skeleton]:
    pose, rest = motion.pose.broadcast(), skeleton.rest
    translations, rotations, scales = (np.asarray(a, float) for a in (pose.translations, pose.rotations, pose.scales))
    larger = replace(skeleton, rest=replace(rest, translations=size * np.asarray(rest.translations, float)))
    return replace(motion, pose=Pose(size * translations, rotations, scales)), larger


def assert_scale_is_free(motion: Motion, skeleton: Skeleton, roles, options: PlantOptions = PlantOptions()) -> None:
    results = []
    for size in (1.0, 0.01, 100.0, 1000.0):
        ground = options.ground
        if isinstance(ground, Ground):
            ground = replace(ground, height_m=size * ground.height_m)
        larger, body = scaled(motion, skeleton, size)
        done = plant_feet(larger, body, roles, options=replace(options, ground=ground))
        results.append((world(body, done.motion)[1] / size, done.knee_ratio, done.touching))
    for places, ratio, touching in results[1:]:
        np.testing.assert_allclose(places, results[0][0], atol=1e-7)
        assert ratio == pytest.approx(results[0][1], rel=1e-4)
        for point, flags in touching.items():
            np.testing.assert_array_equal(flags, results[0][2][point])


@pytest.mark.parametrize("name", ["walk", "run", "idle", "wave", "jump"])
def test_a_body_of_another_size_is_planted_alike(name: str) -> None:
    assert_scale_is_free(slipping(name), body(), roles_of(body()))


@pytest.mark.parametrize(
    "options",
    [
        PlantOptions(ground=Ground(0.02)),
        PlantOptions(ground=Ground(0.0, (0.0, 0.1))),
        PlantOptions(hips="upright"),
        PlantOptions(hips="still"),
        PlantOptions(loop=True),
    ],
    ids=["known", "slope", "upright", "still", "loop"],
)
def test_options_are_scale_free(options: PlantOptions) -> None:
    motion = performances.make("walk") if options.loop else slipping("walk")
    assert_scale_is_free(motion, body(), roles_of(body()), options)


@pytest.mark.data
@pytest.mark.parametrize("file", ["asf_amc/cmu_02/02_01.amc", "bvh/cmu_iclone_002/002_01.bvh"])
def test_knees_are_bounded_where_feet_are_moved_far(data_dir: Path, file: str) -> None:
    """Captures whose bodies drift by 12 cm/s: without the bound knees go to 1.6 and 1.8 times what they did."""
    scene = samples.open_scene(str(data_dir / file))
    skeleton, motion = scene.character.skeleton, scene.animations[0]
    roles = roles_of(skeleton)
    assert isinstance(motion, Motion)
    motion = evaluate.match(motion, skeleton)
    assert_scale_is_free(motion, skeleton, roles)
    t = np.arange(motion.frame_count) / motion.rate_hz
    drift = np.stack([0.12 * np.sin(2.0 * t), 0.01 * np.sin(3.1 * t), 0.12 * t], axis=-1)
    pose = motion.pose.broadcast()
    moved = np.array(pose.translations, np.float64)
    moved[:, int(np.flatnonzero(skeleton.parents < 0)[0])] += drift
    motion = replace(motion, pose=replace(pose, translations=moved))
    done = plant_feet(motion, skeleton, roles)
    assert done.settled and done.knee_ratio <= 1.41
    assert knee_peak(skeleton, done.motion, roles) <= 1.41 * knee_peak(skeleton, motion, roles)
    assert slides(skeleton, done.motion, roles, done.touching).max() < 0.02
    again = plant_feet(done.motion, skeleton, roles)
    assert np.abs(world(skeleton, again.motion)[1] - world(skeleton, done.motion)[1]).max() < 1e-6


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("name", ["walk", "run", "idle", "wave", "jump"])
def test_a_second_time_changes_nothing(name: str, dtype: type) -> None:
    skeleton, motion = body(), slipping(name)
    pose = motion.pose
    motion = replace(
        motion, pose=Pose(*(np.asarray(a, dtype) for a in (pose.translations, pose.rotations, pose.scales)))
    )
    roles = roles_of(skeleton)
    first = plant_feet(motion, skeleton, roles)
    second = plant_feet(first.motion, skeleton, roles)
    assert first.settled and second.settled and first.moved_m.max() > 1e-3
    assert first.motion.pose.rotations.dtype == dtype
    np.testing.assert_array_equal(second.motion.pose.rotations, first.motion.pose.rotations)
    np.testing.assert_array_equal(second.motion.pose.translations, first.motion.pose.translations)


def test_through_a_file_it_stays_planted(tmp_path: Path) -> None:
    import keypose

    scene = samples.load("walk")
    skeleton, roles = scene.character.skeleton, roles_of(scene.character.skeleton)
    planted = plant_feet(slipping("walk"), skeleton, roles).motion
    for suffix in (".glb", ".bvh"):
        path = tmp_path / f"walk{suffix}"
        keypose.save(replace(scene, animations=(replace(planted, events=()),)), path)
        back = keypose.load(path)
        again = back.animations[0]
        motion = again if isinstance(again, Motion) else evaluate.bake(again, back.character.skeleton, planted.rate_hz)
        motion = evaluate.match(motion, back.character.skeleton)
        second = plant_feet(motion, back.character.skeleton, roles_of(back.character.skeleton))
        moved = world(back.character.skeleton, second.motion)[1] - world(back.character.skeleton, motion)[1]
        assert np.abs(moved).max() < 1e-6, suffix


@pytest.mark.data
@pytest.mark.parametrize("file", REAL)
def test_real_motions_settle_and_spare_their_knees(
    data_dir: Path, file: str, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = samples.open_scene(str(data_dir / file))
    skeleton = scene.character.skeleton
    roles = dict(find_roles(skeleton, known=scene.character.roles or None).roles)
    rows = []
    for animation in scene.animations[:24]:
        if animation.duration_s <= 0:
            continue
        rate = animation.rate_hz or evaluate.key_rate(animation) or 30.0
        motion = animation if isinstance(animation, Motion) else evaluate.bake(animation, skeleton, rate)
        motion = evaluate.match(motion, skeleton)
        first = plant_feet(motion, skeleton, roles)
        second = plant_feet(first.motion, skeleton, roles)
        moved = np.abs(world(skeleton, second.motion)[1] - world(skeleton, first.motion)[1]).max()
        peaks = [knee_peak(skeleton, m, roles) for m in (motion, first.motion)]
        speeds = [slides(skeleton, m, roles, first.touching) for m in (motion, first.motion)]
        means = [float(s.mean()) if len(s) else 0.0 for s in speeds]
        rows.append(
            f"{file[-28:]:>28} {animation.name[-24:]:<24} again {moved:.1e} m  knees {peaks[1] / max(peaks[0], 1e-9):5.2f} times "
            f"{peaks[0]:7.0f} rad/s2  slide {means[0]:6.2f} to {means[1]:.3f} cm/s"
        )
        assert moved <= 1e-6, rows[-1]
        assert peaks[1] <= 1.5 * peaks[0] + 1e-6, rows[-1]
        assert means[1] <= 0.3, rows[-1]
        # hips do not pay for it: what a capture shakes is not made much worse
        hips = [np.diff(world(skeleton, m)[1][:, roles["hips"]], 2, axis=0) * rate**2 for m in (motion, first.motion)]
        shakes = [np.linalg.norm(h, axis=-1).max(initial=0.0) for h in hips]
        assert shakes[1] <= 2.2 * max(shakes[0], 20.0), rows[-1]
        assert first.short_m < 1e-4
    with capsys.disabled():
        print("\n" + "\n".join(rows))


def test_flat_feet_do_not_turn_and_lie_on_the_ground() -> None:
    skeleton = body()
    roles = roles_of(skeleton)
    motion = slipping("walk")
    rotations = np.array(motion.pose.rotations)
    wobble = 0.03 * np.sin(np.arange(motion.frame_count) / 3.0)
    for side in ("left", "right"):
        foot = roles[f"{side}_foot"]
        rotations[:, foot] = quat.multiply(rotations[:, foot], quat.from_axis_angle(np.array([0.0, 1.0, 0.0]), wobble))
    motion = replace(motion, pose=replace(motion.pose, rotations=rotations))
    done = plant_feet(motion, skeleton, roles)
    flat_frames = 0
    for side in ("left", "right"):
        flat = done.touching[f"{side}_heel"] & done.touching[f"{side}_ball"]
        turned = [world(skeleton, m)[0][:, roles[f"{side}_foot"]] for m in (motion, done.motion)]
        for start, stop in true_runs(flat):
            flat_frames += stop - start
            spread = [float(np.max(quat.angle_between(t[start], t[start:stop]))) for t in turned]
            assert spread[1] < 5e-6 < spread[0]
        for point in ("heel", "ball"):
            assert np.abs(done.footing.heights(f"{side}_{point}")[flat]).max() < 2e-3
    assert flat_frames > 20


def climbing(ground: Ground) -> tuple[Motion, Skeleton, dict[str, int]]:
    """The built-in walk, put on another ground with its own contacts."""
    skeleton = body()
    roles = roles_of(skeleton)
    walk = slipping("walk", 0.0, 0.0)
    flat = plant_feet(walk, skeleton, roles)
    return (
        plant_feet(walk, skeleton, roles, touching=flat.touching, options=PlantOptions(ground=ground)).motion,
        skeleton,
        roles,
    )


@pytest.mark.parametrize("degrees", [-12.0, 6.0, 15.0])
def test_slopes_are_found_and_kept(degrees: float) -> None:
    rise = float(np.tan(np.radians(degrees)))
    motion, skeleton, roles = climbing(Ground(0.1, (0.0, rise)))
    places = world(skeleton, motion)[1]
    footing = find_footing(roles, places, motion.rate_hz, 0.85)
    assert footing.ground.kind == "slope"
    # feet are pitched as the ground is where they are flat
    flat = find_footing(roles, world(skeleton, slipping("walk", 0.0, 0.0))[1], motion.rate_hz, 0.85)
    for side in ("left", "right"):
        pitch = footing.soles[side].flat - flat.soles[side].flat
        assert pitch == pytest.approx(np.radians(degrees), abs=0.02) and footing.lean[side] == pytest.approx(
            pitch, abs=0.02
        )
    assert footing.ground.slope[1] == pytest.approx(rise, abs=0.01)
    assert f"{abs(degrees):.0f}" in footing.ground.describe()
    done = plant_feet(motion, skeleton, roles)
    again = plant_feet(done.motion, skeleton, roles)
    assert done.settled
    assert np.abs(world(skeleton, again.motion)[1] - world(skeleton, done.motion)[1]).max() < 1e-6
    for name, flags in done.touching.items():
        if name.endswith("ball"):
            assert np.abs(done.footing.heights(name)[flags]).max() < 5e-3, name


def test_stairs_are_found_and_kept() -> None:
    def stairs(x: np.ndarray, z: np.ndarray) -> np.ndarray:
        return 0.16 * np.floor((z + 0.35) / 0.6) + 0.0 * x

    motion, skeleton, roles = climbing(Ground(function=stairs))
    footing = find_footing(roles, world(skeleton, motion)[1], motion.rate_hz, 0.85, ground="steps")
    assert footing.ground.kind == "steps" and footing.ground.steps is not None
    heights = np.unique(np.round(footing.ground.steps[:, 1], 3))
    np.testing.assert_allclose(np.diff(heights), 0.16, atol=0.02)
    done = plant_feet(motion, skeleton, roles, options=PlantOptions(ground="steps"))
    again = plant_feet(done.motion, skeleton, roles, options=PlantOptions(ground="steps"))
    assert np.abs(world(skeleton, again.motion)[1] - world(skeleton, done.motion)[1]).max() < 1e-6


def test_a_known_ground_is_stood_on() -> None:
    skeleton, motion = body(), slipping("walk")
    roles = roles_of(skeleton)
    done = plant_feet(motion, skeleton, roles, options=PlantOptions(ground=Ground(0.02)))
    down = done.touching["left_ball"]
    ball = world(skeleton, done.motion)[1][:, roles["left_toes"], 1]
    assert np.ptp(ball[down]) < 1e-6 and abs(ball[down][0] - 0.02 - done.footing.stand_m["left"]) < 1e-6
    up = put_on_floor(done.motion, skeleton, done.footing, 0.5)
    assert world(skeleton, up)[1][:, roles["left_toes"], 1][down][0] == pytest.approx(0.5, abs=0.02)


@pytest.mark.parametrize("name", ["walk", "run", "idle"])
def test_loops_stay_loops(name: str) -> None:
    skeleton, motion = body(), performances.make(name)
    pose = motion.pose.broadcast()
    # hips that are too high by a centimetre in the middle of a step, all round: feet float and sink
    moved = np.array(pose.translations, np.float64)
    round_s = 2.0 * np.pi * np.arange(motion.frame_count) / (motion.frame_count - 1)
    moved[:, 0, 1] += 0.012 * np.sin(3.0 * round_s)
    moved[:, 0, 0] += 0.02 * np.sin(2.0 * round_s)
    motion = replace(
        motion, pose=Pose(moved, np.asarray(pose.rotations, np.float64), np.asarray(pose.scales, np.float64))
    )
    roles = roles_of(skeleton)
    asked = PlantOptions(loop=True)
    done = plant_feet(motion, skeleton, roles, options=asked)
    before, after = measure_quality(motion, skeleton, roles), measure_quality(done.motion, skeleton, roles)
    assert done.moved_m.max() > 5e-3 and before.loop_cm < 1e-3
    assert after.loop_cm < 1e-3 and after.loop_deg < 1e-3
    assert slides(skeleton, done.motion, roles, done.touching).max() < 0.02
    again = plant_feet(done.motion, skeleton, roles, options=asked)
    assert done.settled and again.settled
    assert np.abs(world(skeleton, again.motion)[1] - world(skeleton, done.motion)[1]).max() < 1e-6
    with pytest.raises(ShapeError, match="last frame is not its first"):
        plant_feet(slipping("walk"), skeleton, roles, options=asked)


def test_contacts_as_a_table_cover_the_flags() -> None:
    skeleton, motion = body(), slipping("run")
    done = plant_feet(motion, skeleton, roles_of(skeleton))
    spans = contact_spans(done.footing, motion.start_s)
    flags = {p: np.zeros(motion.frame_count, bool) for p in done.footing.touching}
    for span in spans:
        flags[span.point][span.first : span.last + 1] = True
        assert span.end_s - span.start_s == pytest.approx((span.last - span.first) / motion.rate_hz)
    for point, found in done.footing.touching.items():
        np.testing.assert_array_equal(flags[point], found)


def test_the_operator_plants_a_clip_and_leaves_other_channels() -> None:
    skeleton = body()
    motion = slipping("walk")
    clip = evaluate.to_clip(motion)
    done = run_operator("plant_feet", clip, skeleton)
    assert "feet moved" in done.report
    arm = next(c for c in clip.curves if c.target == "LeftArm")
    assert done.clip.curves[arm] is clip.curves[arm]
    again = run_operator("plant_feet", done.clip, skeleton)
    assert "feet moved 0.0 cm" in again.report
    assert all(again.clip.curves[c] is done.clip.curves[c] for c in done.clip.curves)
    assert "no legs" in run_operator("plant_feet", clip, samples.load("ball").character.skeleton).report


def test_legs_that_hang_on_nothing_together_are_planted_by_themselves() -> None:
    """Every leg a tree of its own: no joint moves both hips."""
    skeleton, motion = body(), slipping("walk")
    roles = roles_of(skeleton)
    uppers = [roles[f"{side}_upper_leg"] for side in ("left", "right")]
    turned, places = world(skeleton, motion)
    pose = motion.pose.broadcast()
    translations, rotations = np.array(pose.translations), np.array(pose.rotations)
    translations[:, uppers], rotations[:, uppers] = places[:, uppers], turned[:, uppers]
    parents = np.array(skeleton.parents)
    parents[uppers] = -1
    apart = replace(skeleton, parents=parents)
    loose = replace(motion, pose=Pose(translations, rotations, pose.scales))
    np.testing.assert_allclose(world(apart, loose)[1], places, atol=1e-9)
    done = plant_feet(loose, apart, roles)
    still = plant_feet(motion, skeleton, roles, options=PlantOptions(hips="still"))
    assert not done.hips_m.any() and done.moved_m.max() > 1e-3
    np.testing.assert_allclose(world(apart, done.motion)[1], world(skeleton, still.motion)[1], atol=1e-6)


def test_only_legs_and_what_carries_them_are_touched() -> None:
    skeleton, motion = body(), slipping("walk")
    roles = roles_of(skeleton)
    done = plant_feet(motion, skeleton, roles)
    legs = [roles[f"{s}_{p}"] for s in ("left", "right") for p in ("upper_leg", "lower_leg", "foot")]
    others = [j for j in range(skeleton.joint_count) if j not in legs and j != roles["hips"]]
    for before, after in zip(
        (motion.pose.translations, motion.pose.rotations),
        (done.motion.pose.translations, done.motion.pose.rotations),
        strict=True,
    ):
        np.testing.assert_array_equal(after[:, others], before[:, others])
    assert done.moved_m.max() > 1e-3
    broken = np.array(motion.pose.rotations)
    broken[7, roles["head"], 2] = np.nan
    with pytest.raises(ShapeError, match=r"rotations of the motion: expected finite numbers, got nan at \[7"):
        plant_feet(replace(motion, pose=replace(motion.pose, rotations=broken)), skeleton, roles)


def test_wrong_input_is_refused() -> None:
    skeleton, motion = body(), slipping("walk")
    roles = roles_of(skeleton)
    with pytest.raises(KeyposeError, match="left_foot"):
        plant_feet(motion, skeleton, {r: j for r, j in roles.items() if r != "left_foot"})
    with pytest.raises(ShapeError, match="flags"):
        plant_feet(motion, skeleton, roles, touching={"left_ball": np.ones(3, bool)})
    for wrong in ({"ground": "hilly"}, {"hips": "loose"}, {"height_m": 0.0}, {"blend_s": -1.0}):
        with pytest.raises(ShapeError, match="options"):
            PlantOptions(**wrong)
    with pytest.raises(ShapeError, match="finite heights"):
        Ground(function=lambda x, z: x * np.nan).heights(np.zeros((4, 3)))
