"""Foot contacts: found where a point is low and slow, with hysteresis, over the seam of a cycle, in real walks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from keypose import samples
from keypose.analysis.contacts import Sole, contact_changes, find_contacts, find_footing
from keypose.errors import ShapeError
from keypose.evaluate import world_rotations_positions
from keypose.samples import performances
from keypose.samples.skeleton import skeleton


def path(heights, speeds, rate_hz=100.0) -> np.ndarray:
    """One point (T, 1, 3) with those heights, moving along X at those speeds."""
    x = np.concatenate([[0.0], np.cumsum(np.asarray(speeds, float))[:-1] / rate_hz])
    return np.stack([x, np.asarray(heights, float), 0 * x], axis=-1)[:, None]


def spans(touching: np.ndarray) -> list[tuple[int, int]]:
    edges = np.flatnonzero(np.diff(np.concatenate([[0], touching.astype(int), [0]])))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def test_low_and_slow() -> None:
    height = np.full(100, 0.2)
    height[20:50] = 0.0
    speed = np.full(100, 2.0)
    speed[30:80] = 0.0
    assert spans(find_contacts(path(height, speed), 100.0)[:, 0]) == [(30, 50)]


def test_hysteresis_bridges_a_flutter_around_the_limit() -> None:
    height = np.full(100, 0.2)
    height[20:60] = np.where(np.arange(40) % 2, 0.029, 0.034)  # around 0.03, below 0.045
    speed = np.zeros(100)
    floor = {"floor_m": 0.0, "shortest_s": 0.0}
    # The step up at frame 20 is a speed: the contact begins with the first slow frame below the limit.
    assert len(spans(find_contacts(path(height, speed), 100.0, speed_m_s=9.0, **floor)[:, 0])) == 1
    assert len(spans(find_contacts(path(height, speed), 100.0, speed_m_s=9.0, release=1.0, **floor)[:, 0])) == 20


def test_short_contacts_and_gaps_are_left_out() -> None:
    height = np.full(200, 0.3)
    height[20:80] = 0.0
    height[50:53] = 0.3  # a gap of 30 ms
    height[120:123] = 0.0  # a touch of 30 ms
    touching = find_contacts(path(height, np.zeros(200)), 100.0, speed_m_s=1e3)[:, 0]
    assert spans(touching) == [(20, 80)]


def test_cycles_go_over_the_seam() -> None:
    height = np.full(101, 0.3)
    height[:20] = height[90:] = 0.0
    points = path(height, np.zeros(101))
    touching = find_contacts(points, 100.0, speed_m_s=1e3, cyclic=True)[:, 0]
    begins, ends = contact_changes(touching, cyclic=True)
    assert begins.tolist() == [90] and ends.tolist() == [20]
    begins, ends = contact_changes(touching)
    assert begins.tolist() == [90] and ends.tolist() == [20]
    assert touching[0] == touching[-1]


@pytest.mark.parametrize(("name", "share"), [("walk", 0.55), ("run", 0.33), ("idle", 1.0)])
def test_share_of_contact_in_the_built_in_gaits(name: str, share: float) -> None:
    motion = performances.make(name)
    _, positions = world_rotations_positions(skeleton(), motion.pose)
    feet = positions[:, [skeleton().index("LeftToeBase"), skeleton().index("RightToeBase")]]
    touching = find_contacts(feet, motion.rate_hz, height_m=0.01, speed_m_s=0.3, cyclic=True)
    assert np.allclose(touching[:-1].mean(axis=0), share, atol=0.04)
    if name != "idle":
        for foot in touching.T:
            begins, ends = contact_changes(foot, cyclic=True)
            assert len(begins) == len(ends) == 2  # two cycles
        left, right = (contact_changes(foot, cyclic=True)[0] for foot in touching.T)
        half = (motion.frame_count - 1) / 4
        assert np.allclose((right - left) % (2 * half), half, atol=1.5)


def test_empty_and_wrong_input() -> None:
    assert find_contacts(np.zeros((0, 3, 3)), 60.0).shape == (0, 3)
    assert find_contacts(np.zeros((1, 2, 3)), 60.0).all()
    for positions, rate in ((np.zeros((5, 3)), 60.0), (np.zeros((5, 1, 3)), 0.0)):
        with pytest.raises(ShapeError):
            find_contacts(positions, rate)
    with pytest.raises(ShapeError, match="release"):
        find_contacts(np.zeros((5, 1, 3)), 60.0, release=0.5)


def test_float32_and_float64_agree() -> None:
    motion = performances.make("walk")
    _, positions = world_rotations_positions(skeleton(), motion.pose)
    a = find_contacts(positions.astype(np.float32), 60.0)
    assert np.array_equal(a, find_contacts(positions.astype(np.float64), 60.0))


# --- feet -------------------------------------------------------------------------------------------------------------


def steps(rate_hz: float = 100.0) -> np.ndarray:
    """A foot (ankle, ball) that stands flat, rolls over its ball, swings, and lands on its heel: (T, 2, 3)."""
    length, flat = 0.14, -0.4
    pitch = np.concatenate(
        [
            np.zeros(30),
            np.linspace(0, -0.8, 15),
            np.linspace(-0.8, 0.35, 35),
            np.full(5, 0.35),
            np.linspace(0.35, 0, 8),
            np.zeros(30),
        ]
    )
    ball_z = np.concatenate([np.zeros(45), 0.35 * (1 - np.cos(np.linspace(0, np.pi, 40))), np.full(38, 0.7)])
    ball_y = np.concatenate([np.zeros(45), 0.12 * np.sin(np.linspace(0, np.pi, 40)), np.zeros(38)])
    # landing: the heel stands, the ball comes down about it
    ankle = np.stack([0 * ball_z, ball_y, ball_z], -1)
    direction = np.stack([0 * pitch, np.sin(flat + pitch), np.cos(flat + pitch)], -1) * length
    ball = np.stack([0 * ball_z, ball_y, ball_z], -1)
    ankle = ball - direction
    sole = Sole(flat)
    heel = ankle + sole.heel_offsets(direction)
    end = slice(85, 123)
    shift = heel[122] - heel[end]
    ankle[end] += shift
    ball[end] += shift
    return np.stack([ankle, ball], axis=1)


def test_heel_and_ball_of_a_foot_that_rolls() -> None:
    path = steps()
    path[..., 1] += 0.03
    both = np.concatenate([path, path + np.array([0.2, 0.0, 0.0])], axis=1)
    roles = {"left_foot": 0, "left_toes": 1, "right_foot": 2, "right_toes": 3}
    footing = find_footing(roles, both, 100.0, 0.85)
    assert footing.ground.kind == "flat" and footing.ground.height_m == pytest.approx(0.03, abs=1e-6)
    assert footing.soles["left"].flat == pytest.approx(-0.4, abs=1e-6)
    heel, ball = spans(footing.touching["left_heel"]), spans(footing.touching["left_ball"])
    assert [len(heel), len(ball)] == [2, 2]
    assert heel[0][0] == 0 and abs(heel[0][1] - 31) <= 1  # lifted as soon as it rolls
    assert ball[0][0] == 0 and abs(ball[0][1] - 45) <= 2  # the ball stays down
    assert heel[1][0] < ball[1][0] and abs(heel[1][0] - 85) <= 1  # lands on the heel
    assert heel[1][1] == ball[1][1] == 123
    held = footing.points["left_heel"][86:123]
    assert np.ptp(held, axis=0).max() < 1e-9  # the heel, not the ankle, stands still while the foot comes down
    assert np.ptp(both[86:95, 0], axis=0).max() > 0.01


def test_a_foot_that_creeps_all_the_time_is_one_contact_and_an_exact_hold_is_its_own() -> None:
    frames = 120
    place = np.zeros((frames, 2, 3))
    place[:, 1, 0] = 0.2
    place[:, 0, 2] = 0.0005 * np.arange(frames)  # 5 cm/s
    place[60:, 0, 2] += np.concatenate([np.linspace(0, 0.6, 20), np.full(40, 0.6)])
    place[60:80, 0, 1] = 0.1 * np.sin(np.linspace(0, np.pi, 20))
    roles = {"left_foot": 0, "right_foot": 1}
    creeping = find_footing(roles, place, 100.0, 0.85).touching["left_heel"]
    assert creeping[:58].all() and creeping[82:].all() and not creeping[65:75].any()
    held = place.copy()
    held[20:40, 0] = held[20, 0]
    held[40:50, 0, 2] += 0.002 * np.arange(10)  # moved on slowly, from one exact hold
    held[50:58, 0] = held[50, 0]  # to another
    found = spans(find_footing(roles, held, 100.0, 0.85).touching["left_heel"])
    assert (50, 58) in found or any(a == 50 for a, _ in found)
    assert not any(a < 42 and b > 48 for a, b in found)


def test_an_empty_role_map_has_no_feet_and_short_takes_do() -> None:
    assert find_footing({}, np.zeros((10, 3, 3)), 60.0, 0.85).touching == {}
    roles = {"left_foot": 0, "right_foot": 1}
    for frames in (1, 2, 3):
        touching = find_footing(roles, np.zeros((frames, 2, 3)), 60.0, 0.85).touching
        assert all(flags.all() and len(flags) == frames for flags in touching.values())


PLATES = {
    "functional_calibration/FunctionalWalk.c3d": ("LANK", "LTOE", "RANK", "RTOE"),
    "c3d_org_sample09/PlugInC3D.c3d": ("LANK", "LTOE", "RANK", "RTOE"),
    "misc/Gait.c3d": ("LANK", "LTOE", "RANK", "RTOE"),
    "vicon_pig/PiG_Motion3_FF.c3d": ("LANK", "LTOE", "RANK", "RTOE"),
    "opensim/walking2.c3d": ("LCAL", "LMT2", "RCAL", "RMT2"),
    "misc/ADemo1_rewrite_c3d_pc_float.c3d": ("L.Ankle", "L.Toe", "R.Ankle", "R.Toe"),
    "c3d_org_sample01/Eb015pr.c3d": ("LFT1", "LFT3", "RFT1", "RFT3"),
}


def plate_loads(scene, frames: int, rate_hz: float):
    """Of every force plate its bounds (x, z) and whether more than a twentieth of its highest load is on it, by frame."""
    analog = next(g for g in scene.signals if g.kind == "analog")
    values = np.asarray(analog.values, np.float64)
    at = np.clip(np.round(np.arange(frames) * analog.rate_hz / rate_hz).astype(int), 0, len(values) - 1)
    for plate in scene.plates:
        channels = [analog.names.index(name) for name in plate.channels if name]
        if plate.kind == 4 and plate.calibration is not None:
            force = (values[:, channels] @ np.asarray(plate.calibration).T)[:, 2]
        else:
            force = values[:, channels[4:8]].sum(axis=1) if plate.kind == 3 else values[:, channels[2]]
        load = np.abs(force - np.median(force[: max(5, len(force) // 50)]))[at]
        corners = np.asarray(plate.corners)[:, [0, 2]]
        yield corners.min(axis=0) - 0.05, corners.max(axis=0) + 0.05, load > 0.05 * load.max()


@pytest.mark.data
def test_contacts_agree_with_force_plates(data_dir: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows, begins, ends, agreeing = [], [], [], []
    roles = {"left_foot": 0, "left_toes": 1, "right_foot": 2, "right_toes": 3}
    for file, names in PLATES.items():
        scene = samples.open_scene(str(data_dir / "c3d" / file))
        markers = scene.markers[0]
        rate = markers.rate_hz
        track = np.array(np.asarray(markers.positions, np.float64)[:, [markers.index(name) for name in names]])
        frames = np.arange(len(track))
        for joint in range(4):
            seen = np.isfinite(track[:, joint]).all(axis=-1)
            for axis in range(3):
                track[:, joint, axis] = np.interp(frames, frames[seen], track[seen, joint, axis])
        footing = find_footing(roles, track, rate, 0.85)
        for low, high, loaded in plate_loads(scene, len(track), rate):
            for start, stop in spans(loaded):
                if stop - start < 0.15 * rate:
                    continue
                middle = slice(start + (stop - start) // 3, stop - (stop - start) // 3)
                for side, toes in (("left", 1), ("right", 3)):
                    down = footing.touching[f"{side}_heel"] | footing.touching[f"{side}_ball"]
                    place = track[middle, toes][:, [0, 2]]
                    if not ((place > low) & (place < high)).all(axis=1).mean() > 0.8 or not down[middle].any():
                        continue
                    own = [s for s in spans(down) if s[0] < stop and s[1] > start]
                    begins.append(1000 * (own[0][0] - start) / rate)
                    ends.append(1000 * (own[-1][1] - stop) / rate)
                    around = slice(max(0, start - round(0.2 * rate)), stop + round(0.2 * rate))
                    agreeing.append(float((down[around] == loaded[around]).mean()))
                    rows.append(
                        f"{file:<42} {side:<5} begins {begins[-1]:+4.0f} ms  ends {ends[-1]:+4.0f} ms  {agreeing[-1]:.0%} agree"
                    )
    with capsys.disabled():
        print("\n" + "\n".join(rows))
        print(
            f"median: begins {np.median(begins):+.0f} ms, ends {np.median(ends):+.0f} ms, {np.median(agreeing):.0%} of frames agree"
        )
    assert len(rows) >= 12
    # a contact is told from the moment at which the foot stands still; the last push comes from the toes' tips
    assert abs(np.median(begins)) < 50 and np.abs(begins).max() < 160
    assert -90 < np.median(ends) < 10
    assert np.median(agreeing) > 0.85
