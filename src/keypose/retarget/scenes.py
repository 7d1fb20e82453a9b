"""What the scenes of files bring to retargeting: a motion of the target's own, somebody else's result."""

from __future__ import annotations

from collections.abc import Iterable

from keypose.evaluate import to_motion
from keypose.model import Character, Clip, Motion, Skeleton
from keypose.retarget.reference import ReferenceReport, compare_with_reference
from keypose.retarget.transfer import RetargetResult


def own_motion(character: Character, animations: Iterable[Motion | Clip]) -> Motion | None:
    """The first animation of a character's own file that moves all its joints: it may show a stand where the rest pose is none."""
    skeleton = character.skeleton
    for animation in animations:
        if isinstance(animation, Motion) and animation.joint_names == skeleton.names:
            return animation
        if isinstance(animation, Clip) and animation.duration_s > 0:
            return to_motion(animation, skeleton)
    return None


def compare_with_scene(
    result: RetargetResult, skeleton: Skeleton, body: Character, animation: Motion | Clip
) -> ReferenceReport:
    """What a retargeted motion is beside somebody else's result on a character; see `compare_with_reference`."""
    from keypose.analysis import find_roles

    found = find_roles(body.skeleton, known=body.roles or None)
    theirs = to_motion(animation, body.skeleton)
    return compare_with_reference(
        result.motion, skeleton, result.target.roles, theirs, body.skeleton, found.roles, result.touching
    )
