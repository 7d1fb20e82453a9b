"""AMASS takes: poses of the SMPL family as rotation vectors, with the joints' standard names and parents.

A take holds no lengths of bones: those follow from ``betas`` through the body model, whose files are not free. The
skeleton here has the proportions of an average adult, so directions are exact and positions approximate.

Source: N. Mahmood et al., "AMASS: Archive of Motion Capture as Surface Shapes", ICCV 2019; M. Loper et al., "SMPL: A
Skinned Multi-Person Linear Model", 2015; J. Romero et al., "Embodied Hands" (SMPL-H), 2017. Lengths: R. Drillis and
R. Contini, "Body Segment Parameters", 1966, for a stature of 1.7 m.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from keypose.errors import FormatError
from keypose.io.axes import turn_roots, y_up_rotation
from keypose.math import quat
from keypose.model import Character, Motion, Pose, Scene, Skeleton

# name, parent, offset from the parent in metres in the T pose (Y up, facing +Z), role; the left side is mirrored
_TRUNK = (
    ("pelvis", "", (0.0, 0.0, 0.0), "hips"),
    ("left_hip", "pelvis", (0.09, -0.08, 0.0), "left_upper_leg"),
    ("right_hip", "pelvis", (-0.09, -0.08, 0.0), "right_upper_leg"),
    ("spine1", "pelvis", (0.0, 0.11, -0.02), "spine"),
    ("left_knee", "left_hip", (0.0, -0.41, 0.0), "left_lower_leg"),
    ("right_knee", "right_hip", (0.0, -0.41, 0.0), "right_lower_leg"),
    ("spine2", "spine1", (0.0, 0.13, 0.0), "chest"),
    ("left_ankle", "left_knee", (0.0, -0.41, -0.02), "left_foot"),
    ("right_ankle", "right_knee", (0.0, -0.41, -0.02), "right_foot"),
    ("spine3", "spine2", (0.0, 0.06, 0.01), "upper_chest"),
    ("left_foot", "left_ankle", (0.02, -0.06, 0.13), "left_toes"),
    ("right_foot", "right_ankle", (-0.02, -0.06, 0.13), "right_toes"),
    ("neck", "spine3", (0.0, 0.2, -0.02), "neck"),
    ("left_collar", "spine3", (0.07, 0.11, -0.01), "left_shoulder"),
    ("right_collar", "spine3", (-0.07, 0.11, -0.01), "right_shoulder"),
    ("head", "neck", (0.0, 0.1, 0.03), "head"),
    ("left_shoulder", "left_collar", (0.11, 0.03, -0.01), "left_upper_arm"),
    ("right_shoulder", "right_collar", (-0.11, 0.03, -0.01), "right_upper_arm"),
    ("left_elbow", "left_shoulder", (0.28, 0.0, 0.0), "left_lower_arm"),
    ("right_elbow", "right_shoulder", (-0.28, 0.0, 0.0), "right_lower_arm"),
    ("left_wrist", "left_elbow", (0.25, 0.0, 0.0), "left_hand"),
    ("right_wrist", "right_elbow", (-0.25, 0.0, 0.0), "right_hand"),
)
_PALMS = (("left_hand", "left_wrist", (0.08, 0.0, 0.0), ""), ("right_hand", "right_wrist", (-0.08, 0.0, 0.0), ""))
_FACE = (
    ("jaw", "head", (0.0, 0.0, 0.03), "jaw"),
    ("left_eye_smplhf", "head", (0.03, 0.06, 0.07), "left_eye"),
    ("right_eye_smplhf", "head", (-0.03, 0.06, 0.07), "right_eye"),
)
_FINGERS = {  # the hand's first joint from the wrist, then the length of a phalanx; in the order of SMPL-H
    "index": ((0.095, 0.0, 0.025), 0.03),
    "middle": ((0.1, 0.0, 0.005), 0.032),
    "pinky": ((0.085, 0.0, -0.035), 0.022),
    "ring": ((0.095, 0.0, -0.015), 0.03),
    "thumb": ((0.03, -0.01, 0.035), 0.03),
}
_ROLES = {"index": "index", "middle": "middle", "pinky": "little", "ring": "ring", "thumb": "thumb"}
_LARGEST_ANGLE = 1e4
_KEYS = ("poses", "trans")


def _hands() -> list[tuple[str, str, tuple[float, float, float], str]]:
    found: list[tuple[str, str, tuple[float, float, float], str]] = []
    for side, sign in (("left", 1.0), ("right", -1.0)):
        for finger, ((x, y, z), length) in _FINGERS.items():
            segments = (
                ("metacarpal", "proximal", "distal") if finger == "thumb" else ("proximal", "intermediate", "distal")
            )
            parent, offset = f"{side}_wrist", (sign * x, y, z)
            for number, segment in enumerate(segments, 1):
                name = f"{side}_{finger}{number}"
                found.append((name, parent, offset, f"{side}_{_ROLES[finger]}_{segment}"))
                parent, offset = name, (sign * length, 0.0, 0.0)
    return found


LAYOUTS: Mapping[int, tuple[str, tuple[tuple[str, str, tuple[float, float, float], str], ...]]] = {
    66: ("SMPL body", _TRUNK),
    72: ("SMPL", (*_TRUNK, *_PALMS)),
    156: ("SMPL-H", (*_TRUNK, *_hands())),
    165: ("SMPL-X", (*_TRUNK, *_FACE, *_hands())),
}
"""Width of ``poses`` -> the body model's name, and its joints: name, parent, offset, role."""


def is_amass(arrays: Mapping[str, Any]) -> bool:
    """Whether the arrays of an .npz file are a take of AMASS."""
    return all(key in arrays for key in _KEYS)


def to_scene(arrays: Mapping[str, Any], name: str, up: str, rate_hz: float | None) -> Scene:
    """The scene of a take; ``up`` is the axis of the file's world that points up.

    Raises:
        FormatError: where an array is missing, has another shape or holds no numbers; it names the array.
    """
    notes: list[str] = []
    poses, trans = _numbers(arrays, "poses"), _numbers(arrays, "trans")
    if poses.ndim == 3 and poses.shape[2] == 3:
        poses = poses.reshape(len(poses), -1)
    if poses.ndim != 2 or poses.shape[1] not in LAYOUTS:
        widths = ", ".join(f"{width} ({model})" for width, (model, _) in LAYOUTS.items())
        raise FormatError(f"expected (T, N) with N one of {widths}, got {poses.shape}", where="poses")
    frames = len(poses)
    if not frames or trans.shape != (frames, 3):
        raise FormatError(f"expected ({frames}, 3) and at least one frame, got {trans.shape}", where="trans")
    if np.any(np.abs(poses) > _LARGEST_ANGLE):
        raise FormatError("an angle is out of range", where="poses")
    if np.any(np.abs(trans) > 1e9):
        raise FormatError("a position is out of range", where="trans")
    model, joints = LAYOUTS[poses.shape[1]]
    notes.append(
        f"a take of {model} without its body model: names, parents and rotations are exact, lengths of bones those of an "
        "average adult of 1.7 m; the pelvis is at the model's origin, which is up to 0.3 m from its true place"
    )
    skeleton, roles = _skeleton(joints)
    rotations = np.asarray(quat.from_rotation_vector(poses.reshape(frames, -1, 3).astype(np.float64)))
    translations = np.repeat(skeleton.rest.translations[None], frames, axis=0)
    translations[:, 0] = trans
    pose = Pose(translations, rotations, skeleton.rest.scales)
    if up != "Y":
        pose = turn_roots(pose, skeleton.parents, y_up_rotation(up))
    rate = _rate(arrays, rate_hz, notes)
    motion = Motion(skeleton.names, pose, rate, name)
    character = Character(skeleton, name=name, roles=roles, extras={"amass": _kept(arrays, model, up)})
    return Scene((character,), (motion,), "npz", 1.0, up, tuple(notes))


def _skeleton(joints: tuple[tuple[str, str, tuple[float, float, float], str], ...]) -> tuple[Skeleton, dict[str, int]]:
    names = [name for name, _, _, _ in joints]
    parents = [names.index(parent) if parent else -1 for _, parent, _, _ in joints]
    offsets = np.array([offset for _, _, offset, _ in joints])
    rest = Pose(offsets, np.tile((1.0, 0.0, 0.0, 0.0), (len(names), 1)), np.ones((len(names), 3)))
    return Skeleton(tuple(names), np.array(parents), rest), {role: i for i, (*_, role) in enumerate(joints) if role}


def _numbers(arrays: Mapping[str, Any], key: str) -> Any:
    array = np.asarray(arrays[key])
    if array.dtype.kind not in "fiu" or array.dtype.itemsize > 8:
        raise FormatError(f"expected numbers, got {array.dtype}", where=key)
    array = array.astype(np.float64)
    if not np.all(np.isfinite(array)):
        raise FormatError("expected finite numbers", where=key)
    return array


def _rate(arrays: Mapping[str, Any], given: float | None, notes: list[str]) -> float:
    if given is not None:
        return given
    for key in ("mocap_framerate", "mocap_frame_rate", "fps", "framerate"):
        if key in arrays:
            value = _numbers(arrays, key)
            if value.size != 1 or not 0 < float(value.ravel()[0]) < 1e6:
                raise FormatError("expected one positive number", where=key)
            return float(value.ravel()[0])
    notes.append("the file names no rate; taken as 60 Hz (rate_hz)")
    return 60.0


def _kept(arrays: Mapping[str, Any], model: str, up: str) -> dict[str, Any]:
    """What a body model needs besides the poses, as plain lists."""
    kept: dict[str, Any] = {"model": model, "up": up}
    if "betas" in arrays:
        betas = _numbers(arrays, "betas")
        if betas.size <= 4096:
            kept["betas"] = betas.ravel().tolist()
    if "gender" in arrays:
        gender = np.asarray(arrays["gender"])
        if gender.dtype.kind in "US" and gender.size == 1:
            word = gender.ravel()[0]
            kept["gender"] = (word.decode("latin-1") if isinstance(word, bytes) else str(word))[:40]
    return kept


def to_arrays(scene: Scene) -> tuple[dict[str, Any], tuple[str, ...]]:
    """A motion of a skeleton of the SMPL family as AMASS has it (Z up, or the axis its file had).

    Raises:
        FormatError: where the first animation's joints are not those of a body model.
    """
    motion = next((a for a in scene.animations if isinstance(a, Motion)), None)
    layout = (
        None if motion is None else next((w for w, (_, j) in LAYOUTS.items() if _names(j) == motion.joint_names), None)
    )
    if motion is None or layout is None:
        raise FormatError("the AMASS layout holds motions of the joints of SMPL, SMPL-H or SMPL-X only")
    kept: Any = scene.characters[0].extras.get("amass", {}) if scene.characters else {}
    up = kept.get("up", "Z") if kept.get("up") in ("X", "Y", "Z") else "Z"
    pose = motion.pose.broadcast()
    if up != "Y":
        parents = _skeleton(LAYOUTS[layout][1])[0].parents
        pose = turn_roots(pose, parents, quat.conjugate(y_up_rotation(up)))
    vectors = np.asarray(quat.to_rotation_vector(np.asarray(pose.rotations, np.float64)))
    arrays: dict[str, Any] = {
        "poses": vectors.reshape(len(vectors), -1),
        "trans": np.asarray(pose.translations[:, 0], np.float64),
        "mocap_framerate": np.array(motion.rate_hz),
        "betas": np.array(kept.get("betas", [0.0] * 16), np.float64),
        "gender": np.array(str(kept.get("gender", "neutral"))),
    }
    notes = ["only rotations and the root's position were written; lengths of bones follow from betas"]
    return arrays, tuple(notes)


def _names(joints: tuple[tuple[str, str, tuple[float, float, float], str], ...]) -> tuple[str, ...]:
    return tuple(name for name, *_ in joints)
