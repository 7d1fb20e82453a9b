"""Reach edits: exact where asked for, untouched elsewhere, smooth in between, honest where nothing reaches."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from keypose import io, samples
from keypose.editing.limb_pose import bend_direction, limb_above
from keypose.editing.reach import Reach, changed_frames, found_roles, joint_of, reach
from keypose.errors import ShapeError, UnknownName
from keypose.evaluate import world
from keypose.model import Motion, Pose, Skeleton


@pytest.fixture(scope="module")
def cast():
    scene = samples.load("human")
    skeleton = scene.character.skeleton
    return {a.name: a for a in scene.animations}, skeleton, found_roles(skeleton)


def places(skeleton, motion):
    # by matrices, which the edits themselves do not use
    return np.asarray(world(skeleton, motion.pose.broadcast()), np.float64)[..., :3, 3]


def test_hands_feet_fingers_head_and_root_are_where_they_should_be(cast):
    motions, skeleton, roles = cast
    idle = motions["idle"]
    before = places(skeleton, idle)
    wanted = [
        Reach("left_hand", 60, target=(0.35, 1.3, 0.3)),
        Reach("left_hand", 200, 220, target=(0.2, 1.1, 0.35)),
        Reach("right_foot", 30, 60, offset=(0, 0.1, 0.05)),
        Reach("head", 100, offset=(0.05, -0.03, 0.02)),
        Reach("hips", 20, 25, offset=(0.02, -0.05, 0)),
        Reach("right_index_distal", 80, 90, target=(-0.3, 1.3, 0.35)),
    ]
    done = reach(idle, skeleton, wanted, ease_s=0.3)
    after = places(skeleton, done.motion)
    assert done.converged and max(e.max() for e in done.error_m) < 1e-5
    for r in wanted:
        joint = roles[r.joint]
        target = r.target if r.offset is None else before[r.frames, joint] + r.offset
        assert np.linalg.norm(after[r.frames, joint] - target, axis=-1).max() < 1e-4
    near = np.zeros(idle.frame_count, bool)
    ease = round(0.3 * idle.rate_hz)
    for r in wanted:
        near[max(r.first - ease + 1, 0) : r.last + ease] = True
    assert not (done.changed & ~near).any()
    assert np.array_equal(done.changed, changed_frames(idle, done.motion))
    assert done.motion.pose.rotations.dtype == idle.pose.rotations.dtype
    # only what carries the ends moves
    other = [roles["right_upper_arm"], roles["neck"]]
    assert np.array_equal(done.motion.pose.rotations[200:220, other], idle.pose.rotations[200:220, other])


def test_feet_keep_their_turn_and_hands_may_follow_or_be_turned(cast):
    motions, skeleton, roles = cast
    walk = motions["walk"]

    def turned(motion, joint, frame):
        return Rotation.from_matrix(np.asarray(world(skeleton, motion.pose)[frame, joint, :3, :3], np.float64))

    foot, hand, forearm = (roles[r] for r in ("left_foot", "left_hand", "left_lower_arm"))
    done = reach(walk, skeleton, [Reach("left_foot", 40, offset=(0.05, 0.1, 0.1))]).motion
    assert (turned(done, foot, 40) * turned(walk, foot, 40).inv()).magnitude() < 1e-5
    target = places(skeleton, walk)[40, hand] + [0.1, 0.2, 0.1]
    follows = reach(walk, skeleton, [Reach("left_hand", 40, target=target)]).motion
    local = [turned(m, forearm, 40).inv() * turned(m, hand, 40) for m in (walk, follows)]
    assert (local[0].inv() * local[1]).magnitude() < 1e-5
    kept = reach(walk, skeleton, [Reach("left_hand", 40, target=target, keep_rotation=True)]).motion
    assert (turned(kept, hand, 40) * turned(walk, hand, 40).inv()).magnitude() < 1e-5
    q = Rotation.from_euler("xyz", [0.3, 1.0, -0.4])
    asked = Reach("left_hand", 40, target=target, rotation=q.as_quat(scalar_first=True))
    done = reach(walk, skeleton, [asked])
    assert done.converged and (turned(done.motion, hand, 40) * q.inv()).magnitude() < 1e-5


def test_nothing_asked_for_changes_no_bit(cast):
    import keypose.kernels.fk  # noqa: F401  # rounds otherwise than NumPy, and a straight elbow shows that

    motions, skeleton, _ = cast
    walk = motions["walk"]
    assert reach(walk, skeleton, []).motion is walk
    done = reach(walk, skeleton, [Reach("left_hand", 40, offset=(0, 0, 0)), Reach("right_foot", 60, offset=(0, 0, 0))])
    before, after = places(skeleton, walk), places(skeleton, done.motion)
    assert np.abs(before - after).max() < 1e-5


def test_the_way_there_is_smooth(cast):
    """Where the hand is asked to go half a metre away in 0.4 s, nothing jerks more than a smooth move of that size needs."""
    motions, skeleton, roles = cast
    idle = motions["idle"]
    hand, elbow = roles["left_hand"], roles["left_lower_arm"]
    done = reach(idle, skeleton, [Reach("left_hand", 100, 130, offset=(0.1, 0.35, 0.3))], ease_s=0.4).motion
    after = places(skeleton, done)
    for joint, size in ((hand, 0.47), (elbow, 0.3)):
        acceleration = np.linalg.norm(np.diff(after[:, joint], 2, axis=0), axis=-1) * idle.rate_hz**2
        assert acceleration.max() < 2.5 * 12 * size / 0.4**2 / 4 + 10


def test_an_elbow_never_bends_backwards_on_the_way(cast):
    """A hand that must be at the end of the arm's length while the body walks on: angles alone would swing beyond straight."""
    motions, skeleton, roles = cast
    walk = motions["walk"]
    done = reach(walk, skeleton, [Reach("left_hand", 60, 66, target=(0.34, 1.3, 1.6))], ease_s=0.45).motion
    side = limb_above(skeleton, roles["left_hand"], roles)
    usual = bend_direction(walk, skeleton, side)
    frames = np.asarray(world(skeleton, done.pose.broadcast()), np.float64)[30:100]
    start, middle, end = (frames[:, j, :3, 3] for j in (side.upper, side.lower, side.end))
    along = (end - start) / np.linalg.norm(end - start, axis=-1, keepdims=True)
    out = (middle - start) - along * np.sum((middle - start) * along, axis=-1, keepdims=True)
    out = np.einsum("fij,fi->fj", frames[:, side.upper, :3, :3], out)
    assert np.all(out @ usual > -1e-3)
    turned = np.abs(np.diff(np.float64(done.pose.rotations[30:100, side.lower]), 2, axis=0)).max()
    assert turned < 0.04  # of a quaternion in a sixtieth of a second


def test_targets_out_of_reach_settle(cast):
    motions, skeleton, roles = cast
    idle = motions["idle"]
    hand, shoulder = roles["left_hand"], roles["left_upper_arm"]
    before = places(skeleton, idle)
    bones = [(shoulder, roles["left_lower_arm"]), (roles["left_lower_arm"], hand)]
    length = sum(np.linalg.norm(before[50, a] - before[50, b]) for a, b in bones)
    ends = []
    for far in (1.0, 1.001, 3.0):
        target = before[50, shoulder] + far * np.array([1.0, 1.5, 1.0])
        done = reach(idle, skeleton, [Reach("left_hand", 50, target=target)])
        after = places(skeleton, done.motion)
        assert not done.converged
        reached = np.linalg.norm(after[50, hand] - after[50, shoulder])
        np.testing.assert_allclose(reached, length, rtol=1e-5)
        missing = np.linalg.norm(target - before[50, shoulder]) - length
        np.testing.assert_allclose(done.error_m[0], missing, atol=1e-4)
        assert np.all(np.isfinite(done.motion.pose.rotations))
        ends.append(after[50])
    assert np.abs(ends[0] - ends[1]).max() < 1e-3


@pytest.mark.parametrize(
    ("frames", "target"), [((60, 66), (0.3, 0.25, 0.5)), ((100, 100), (0.4, 1.3, 0.75)), ((0, 3), (0.6, 0.4, 0.3))]
)
def test_the_whole_body_helps_where_an_arm_is_too_short(cast, frames, target):
    motions, skeleton, roles = cast
    idle = motions["idle"]
    wanted = [Reach("left_hand", *frames, target=target), Reach("right_hand", 200, offset=(0.05, 0.1, 0.1))]
    assert not reach(idle, skeleton, wanted, ease_s=0.6).converged
    done = reach(idle, skeleton, wanted, ease_s=0.6, whole_body=True)
    assert done.converged and done.kept_m < 1e-4
    before, after = places(skeleton, idle), places(skeleton, done.motion)
    assert np.linalg.norm(after[frames[0] : frames[1] + 1, roles["left_hand"]] - target, axis=-1).max() < 1e-4
    for foot in ("left_foot", "right_foot"):
        np.testing.assert_allclose(after[:, roles[foot]], before[:, roles[foot]], atol=2e-5)
    assert np.abs(after[frames[0], roles["chest"]] - before[frames[0], roles["chest"]]).max() > 0.05
    # what the other hand reaches alone leaves the trunk alone
    assert np.array_equal(after[200, roles["chest"]], before[200, roles["chest"]])
    ease = round(0.6 * idle.rate_hz)
    far = np.ones(idle.frame_count, bool)
    far[max(frames[0] - ease, 0) : frames[1] + ease + 1] = far[200 - ease : 200 + ease] = False
    assert not done.changed[far].any()


def test_any_chain_without_roles():
    """A tentacle that plays no role: the two bones above the joint reach, a short one moves its root."""
    count = 6
    offsets = np.zeros((count, 3))
    offsets[1:, 1] = 0.3
    rest = Pose(offsets, np.tile([1.0, 0, 0, 0], (count, 1)), np.ones((count, 3)))
    skeleton = Skeleton(tuple(f"b{n}" for n in range(count)), [-1, 0, 1, 2, 3, 4], rest)
    assert limb_above(skeleton, 5, {}).upper == 3 and limb_above(skeleton, 1, {}) is None
    motion = Motion(
        skeleton.names, Pose(rest.translations, np.broadcast_to(rest.rotations, (60, count, 4)), rest.scales), 30.0
    )
    done = reach(motion, skeleton, [Reach("b5", 30, target=(0.2, 1.3, 0.1)), Reach("b0", 50, target=(0.5, 0, 0))])
    assert done.converged
    after = places(skeleton, done.motion)
    np.testing.assert_allclose(after[30, 5], [0.2, 1.3, 0.1], atol=1e-6)
    np.testing.assert_allclose(after[50, 0], [0.5, 0, 0], atol=1e-12)


def test_wrong_input_is_told(cast):
    motions, skeleton, roles = cast
    walk = motions["walk"]
    with pytest.raises(UnknownName, match="nearest: 'left_hand'"):
        joint_of(skeleton, "left_hnd", roles)
    with pytest.raises(ShapeError, match="up to 124, got 500"):
        reach(walk, skeleton, [Reach("left_hand", 500, offset=(0, 0, 0))])
    with pytest.raises(ShapeError, match="a target or an offset"):
        Reach("left_hand", 5)
    with pytest.raises(ShapeError, match="first <= last"):
        Reach("left_hand", 5, 4, offset=(0, 0, 0))
    with pytest.raises(ShapeError, match=r"\(3,\) or \(2, 3\)"):
        Reach("left_hand", 5, 6, target=np.zeros((3, 3)))
    twice = [Reach("left_hand", 5, 9, offset=(0, 0, 0)), Reach("LeftHand", 9, 12, offset=(0, 0, 0))]
    with pytest.raises(ShapeError, match="wanted twice between frames 9 and 9"):
        reach(walk, skeleton, twice)
    far = [Reach("left_hand", 60, target=(0.3, 0.2, 2.0))]
    with pytest.raises(UnknownName, match="joint or role"):
        reach(walk, skeleton, far, whole_body=True, keep=["left_foto"])
    with pytest.raises(ShapeError, match="end of a limb"):
        reach(walk, skeleton, far, whole_body=True, keep=["Hips"])
    with pytest.raises(ShapeError, match="ease_s"):
        reach(walk, skeleton, [], ease_s=-1)


def test_progress_is_told(cast):
    motions, skeleton, _ = cast
    seen = []
    wanted = [Reach("left_hand", 20, offset=(0, 0.1, 0)), Reach("hips", 60, offset=(0, -0.02, 0))]
    reach(motions["walk"], skeleton, wanted, progress=lambda done, total: seen.append((done, total)))
    assert seen[-1] == (2, 2) and seen == sorted(seen)


@pytest.mark.data
@pytest.mark.parametrize(
    "take", ["asf_amc/cmu_02/02_01.amc", "asf_amc/cmu_02/02_05.amc", "bvh/cmu_iclone_002/002_Walk.bvh"]
)
def test_captures_of_other_skeletons(data_dir, take):
    """Hands go up, a foot is lifted, on whatever bones a capture has."""
    paths = [data_dir / take] if (data_dir / take).is_file() else sorted((data_dir / take).parent.glob("*" + take[-4:]))
    scene = io.load(paths[0])
    skeleton, motion = scene.character.skeleton, scene.animations[0]
    roles = found_roles(skeleton)
    middle = motion.frame_count // 2
    size = 0.05 * np.ptp(places(skeleton, motion)[middle, :, 1])
    wanted = [
        Reach("left_hand", middle, middle + 5, offset=(0.0, size, size)),
        Reach("right_hand", middle, offset=(0.0, size, 0.5 * size)),
        Reach("left_foot", middle + 2, offset=(0.0, size, 0.0)),
        Reach("head", middle, offset=(0.2 * size, 0.0, 0.2 * size)),
    ]
    done = reach(motion, skeleton, wanted)
    before, after = places(skeleton, motion), places(skeleton, done.motion)
    assert done.converged
    for r in wanted:
        moved = after[r.frames, roles[r.joint]] - before[r.frames, roles[r.joint]]
        np.testing.assert_allclose(moved, r.offset, atol=2e-4)
    near = np.zeros(motion.frame_count, bool)
    ease = round(0.4 * motion.rate_hz)
    near[max(middle - ease, 0) : middle + 6 + ease] = True
    assert not done.changed[~near].any() and done.changed.any()
