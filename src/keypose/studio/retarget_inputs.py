"""What a page's request for retargeting names besides the two bodies: poses that stand, props, somebody else's result."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from keypose.errors import FormatError, KeyposeError, ShapeError
from keypose.model import Character, Clip, Motion, Pose, Scene
from keypose.studio.edit_wire import complaint
from keypose.studio.retarget_messages import RetargetBeside, RetargetRequest

if TYPE_CHECKING:
    from keypose.analysis import RoleMap
    from keypose.retarget import Prop, RetargetResult


def named_scenes(asked: RetargetRequest) -> set[str]:
    """The ids of the further scenes that a request names."""
    stands = (reference.rpartition(":")[0] for reference in (asked.source_reference, asked.target_reference))
    return {id for id in (*stands, asked.against) if id}


def source_stand(
    character: Character, animation: Motion | Clip, reference: str, scenes: Mapping[str, Scene]
) -> Pose | None:
    """The source's pose that is taken for an upright stand; None leaves it to retargeting."""
    return _named_pose(character, [animation], reference, scenes) if reference else None


def target_stand(
    character: Character,
    animations: Sequence[Motion | Clip],
    roles: RoleMap | None,
    reference: str,
    scenes: Mapping[str, Scene],
) -> tuple[Pose | None, tuple[str, ...]]:
    """The same of the target, and what is to be said about it."""
    from keypose.retarget import bind_stand

    if reference:
        return _named_pose(character, animations, reference, scenes), ()
    bound = None if roles is None or roles.missing else bind_stand(character, roles.roles)
    said = "target: the rest pose is no upright stand; the pose in which the skin was bound is taken for one"
    return bound, () if bound is None else (said,)


def _named_pose(
    character: Character, animations: Sequence[Motion | Clip], reference: str, scenes: Mapping[str, Scene]
) -> Pose:
    from keypose.retarget import pose_of_other

    id, _, moment = reference.rpartition(":")
    time_s = None if moment == "rest" else _seconds(moment, reference)
    if not id:
        return _pose(character, animations, time_s, character.name)
    scene = scenes[id]
    if not scene.characters:
        raise FormatError("it has no skeleton", path=id)
    body = scene.characters[0]
    return pose_of_other(character.skeleton, body.skeleton, _pose(body, scene.animations, time_s, body.name))


def _seconds(text: str, reference: str) -> float:
    try:
        number = float(text)
    except ValueError:
        number = np.nan
    if not np.isfinite(number):
        raise ShapeError(f"reference pose: expected SECONDS, SCENE:SECONDS or rest, got '{reference[:60]}'")
    return number


def _pose(character: Character, animations: Sequence[Motion | Clip], time_s: float | None, name: str) -> Pose:
    """A pose at a time of the first of some animations, or at rest; of frames it is the nearest."""
    from keypose.evaluate import match, sample

    skeleton = character.skeleton
    if time_s is None:
        return skeleton.rest
    if not animations:
        raise FormatError("it has no motion whose moment could be the reference pose", path=name)
    animation = animations[0]
    if isinstance(animation, Clip):
        return sample(animation, skeleton, float(np.clip(time_s, animation.start_s, animation.end_s)))
    motion = match(animation, skeleton)
    frame = int(np.clip(round((time_s - motion.start_s) * motion.rate_hz), 0, motion.frame_count - 1))
    pose = motion.pose.broadcast()
    return Pose(pose.translations[frame], pose.rotations[frame], pose.scales[frame])


def props_of(asked: RetargetRequest) -> list[Prop]:
    """The places that hands keep to."""
    from keypose.retarget import Prop

    for numbers in asked.props:
        if len(numbers) not in (3, 6):
            raise ShapeError(f"prop: expected 3 or 6 numbers in metres, got {len(numbers)}")
    return [Prop(*(np.array(numbers[n : n + 3]) for n in range(0, len(numbers), 3))) for numbers in asked.props]


def placed_props(props: Sequence[Prop], source: Motion, result: RetargetResult, ratio: float) -> list[list[float]]:
    """Where props are in both worlds, six numbers each."""
    from keypose.evaluate import world_rotations_positions
    from keypose.retarget.hands import prop_places

    if not props:
        return []
    own, other = result.source, result.target
    places = np.asarray(world_rotations_positions(own.skeleton, source.pose.broadcast())[1], np.float64)
    both = (prop_places(prop, own, places, other, ratio) for prop in props)
    return [[float(x) for place in pair for x in place[0]] for pair in both]


def beside(result: RetargetResult, character: Character, scene: Scene, name: str) -> RetargetBeside:
    """A retargeted motion beside somebody else's."""
    from keypose.retarget.scenes import compare_with_scene

    try:
        if not (scene.characters and scene.animations):
            raise FormatError("it has no skeleton with a motion")
        report = compare_with_scene(result, character.skeleton, scene.characters[0], scene.animations[0])
    except KeyposeError as error:
        return RetargetBeside(name, complaint(error), {}, 0.0, 0.0, 0.0, 0.0, 0)
    return RetargetBeside(
        name=name,
        error="",
        direction_deg={group: float(angle) for group, angle in report.direction_deg.items()},
        mean_direction_deg=float(report.mean_direction_deg),
        turned_deg=float(report.turned_deg),
        shift_s=float(report.shift_s),
        slide_cm_s=float(report.reference_slide_cm_s),
        frames=int(report.frame_count),
    )
