"""What the gizmos do to local transforms, against forward kinematics in Python; left and right as Python reads names."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from client_node import answers, client_program
from scipy.spatial.transform import Rotation

from keypose import evaluate, samples
from keypose.analysis.anatomy import find_body, side_of
from keypose.model import Pose, Skeleton

SCRIPT = """
import { Rig } from "@/anim/rig";
import { move, rotate, scale, startOf } from "@/edit/viewport/manipulate";
import { mirrorPairs, sideOf } from "@/edit/viewport/sides";

const direct = { int32: (a) => Int32Array.from(a), float64: (a) => Float64Array.from(a.flat()), float32: (a) => Float32Array.from(a.flat()) };
function answer({ names, rest, act, joints, amount, axis, setting }) {
  if (act === "sides") return { sides: names.map(sideOf), pairs: [...mirrorPairs(names)] };
  const rig = new Rig({ ...rest, end_offsets: [], end_joints: [], controls: 0 }, direct, []);
  const start = startOf(rig, rig.pose, rig.world);
  const found = act === "move" ? move(start, joints, amount, setting) : act === "rotate" ? rotate(start, joints, axis, amount, setting) : scale(start, joints, amount, setting);
  return [...found];
}
"""

NAMES = ("root", "upper", "lower", "hand", "finger")
COMMON = {"space": "global", "pivot": "common", "detach": True}
EACH = {"space": "global", "pivot": "individual", "detach": True}


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return client_program(SCRIPT, tmp_path_factory.mktemp("manipulate"))


def chain(seed: int, kind: str) -> Skeleton:
    """Joints one after the other, turned and scaled: evenly, with a mirrored one among them, or unevenly."""
    rng = np.random.default_rng(seed)
    scales = np.exp(rng.normal(0, 0.3, (len(NAMES), 1))) * np.ones(3)
    if kind == "mirrored":
        scales[1, 0] *= -1
    elif kind == "uneven":
        scales = np.exp(rng.normal(0, 0.3, (len(NAMES), 3)))
    rotations = np.roll(Rotation.random(len(NAMES), rng=rng).as_quat(), 1, -1)
    return Skeleton(NAMES, np.arange(-1, 4), Pose(rng.normal(size=(len(NAMES), 3)), rotations, scales))


def manipulated(program: Path, skeleton: Skeleton, **question: Any) -> tuple[np.ndarray, np.ndarray, dict[int, Any]]:
    """model_from_joint before and after, and what was changed."""
    rest = skeleton.rest
    data = {
        "names": list(skeleton.names),
        "parents": np.asarray(skeleton.parents).tolist(),
        "translations": np.asarray(rest.translations).tolist(),
        "rotations": np.asarray(rest.rotations).tolist(),
        "scales": np.asarray(rest.scales).tolist(),
    }
    (found,) = answers(program, {"rest": data, **question})
    changed = {int(joint): local for joint, local in found}
    arrays = [np.array(a) for a in (rest.translations, rest.rotations, rest.scales)]
    for joint, local in changed.items():
        for array, name in zip(arrays, ("translation", "rotation", "scale"), strict=True):
            if name in local:
                array[joint] = local[name]
    before = np.asarray(evaluate.world(skeleton, rest))
    return before, np.asarray(evaluate.world(skeleton, Pose(*arrays))), changed


@pytest.mark.parametrize("kind", ["even", "mirrored"])
@pytest.mark.parametrize("seed", range(5))
def test_a_joint_turns_about_the_axis_that_was_asked_for(program: Path, kind: str, seed: int) -> None:
    axis = np.array([0.6, -0.48, 0.64])
    skeleton = chain(seed, kind)
    before, after, changed = manipulated(
        program, skeleton, act="rotate", joints=[3], axis=axis.tolist(), amount=0.7, setting=EACH
    )
    turn = Rotation.from_rotvec(0.7 * axis).as_matrix()
    np.testing.assert_allclose(after[3, :3, :3], turn @ before[3, :3, :3], atol=1e-12)
    np.testing.assert_allclose(after[3, :3, 3], before[3, :3, 3], atol=1e-12)
    assert list(changed) == [3]
    np.testing.assert_allclose(after[:3], before[:3], atol=0)


@pytest.mark.parametrize("kind", ["even", "mirrored"])
def test_about_a_common_point_all_turn_and_scale_as_one_body(program: Path, kind: str) -> None:
    skeleton = chain(3, kind)
    # the hand hangs on the upper arm, so it is not moved twice
    before, after, changed = manipulated(
        program, skeleton, act="rotate", joints=[3, 1], axis=[0, 0, 1], amount=-0.9, setting=COMMON
    )
    turn = Rotation.from_rotvec([0, 0, -0.9]).as_matrix()
    assert list(changed) == [1]
    centre = before[1, :3, 3]
    for joint in range(1, 5):
        np.testing.assert_allclose(after[joint, :3, :3], turn @ before[joint, :3, :3], atol=1e-12)
        np.testing.assert_allclose(after[joint, :3, 3], centre + turn @ (before[joint, :3, 3] - centre), atol=1e-12)
    before, after, _ = manipulated(program, skeleton, act="scale", joints=[2], amount=[1.7, 1.7, 1.7], setting=COMMON)
    np.testing.assert_allclose(after[4, :3, :3], 1.7 * before[4, :3, :3], atol=1e-12)


@pytest.mark.parametrize("kind", ["even", "mirrored", "uneven"])
@pytest.mark.parametrize("seed", range(3))
def test_a_joint_moves_by_what_was_asked_for_even_through_shear(program: Path, kind: str, seed: int) -> None:
    delta = np.array([0.3, -1.1, 0.25])
    before, after, _ = manipulated(
        program, chain(seed, kind), act="move", joints=[3], amount=delta.tolist(), setting=EACH
    )
    np.testing.assert_allclose(after[3, :3, 3] - before[3, :3, 3], delta, atol=1e-10)
    np.testing.assert_allclose(after[4, :3, 3] - before[4, :3, 3], delta, atol=1e-10)


def test_through_uneven_scale_a_turn_about_an_own_axis_leaves_that_axis_where_it_is(program: Path) -> None:
    own = {"space": "local", "pivot": "individual", "detach": False}
    for seed in range(4):
        before, after, changed = manipulated(
            program, chain(seed, "uneven"), act="rotate", joints=[3], axis=1, amount=1.2, setting=own
        )
        np.testing.assert_allclose(after[3, :3, 1], before[3, :3, 1], atol=1e-12)
        assert not np.allclose(after[3, :3, 0], before[3, :3, 0])
        assert set(changed[3]) == {"rotation"}


def test_sides_and_pairs_are_those_of_python(program: Path) -> None:
    human = samples.open_scene("sample:human").characters[0].skeleton.names
    cmu = ("root", "lhipjoint", "lfemur", "lfoot", "rhipjoint", "rfemur", "rfoot", "lowerback", "lhumerus", "rhumerus", "lthumb")  # fmt: skip
    mixamo = ("mixamorig:Hips", "mixamorig:LeftUpLeg", "mixamorig:RightUpLeg", "mixamorig:LeftHandThumb1")
    others = ("Bip01 L Clavicle", "Bip01 R Clavicle", "J_Bip_L_Hand", "J_Bip_R_Hand", "hand.L", "hand.R", "LEFT_EYE", "RIGHT_EYE", "leg_l", "leg_r", "Ribs", "Lamp")  # fmt: skip
    for names in (human, cmu, mixamo, others):
        (found,) = answers(program, {"act": "sides", "names": list(names)})
        assert found["sides"] == [side_of(name) for name in names]
        pairs = dict(found["pairs"])
        for left, right in find_body(names).pairs:
            assert pairs[names[left]] == names[right] and pairs[names[right]] == names[left]
        assert all(pairs[name] == name for name in names if not side_of(name))
