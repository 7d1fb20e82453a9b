"""What the scenes of files bring to retargeting: motions in frames, a motion of the target's own, somebody else's result."""

from __future__ import annotations

from collections.abc import Iterable

from keypose.evaluate import bake, key_rate, match, resample
from keypose.model import Character, Clip, Motion, Skeleton
from keypose.retarget.reference import ReferenceReport, compare_with_reference
from keypose.retarget.transfer import RetargetResult

FALLBACK_RATE_HZ = 30.0
"""Frames a second of a clip that does not say its own and whose keys do not either."""


def frames_of(animation: Motion | Clip, skeleton: Skeleton, rate_hz: float | None = None) -> Motion:
    """An animation in frames of a skeleton's joints, at its own rate or another."""
    if isinstance(animation, Clip):
        return bake(animation, skeleton, rate_hz or animation.rate_hz or key_rate(animation) or FALLBACK_RATE_HZ)
    motion = match(animation, skeleton)
    return motion if rate_hz is None or rate_hz == motion.rate_hz else resample(motion, rate_hz)


def own_motion(character: Character, animations: Iterable[Motion | Clip]) -> Motion | None:
    """The first animation of a character's own file that moves all its joints: it may show a stand where the rest pose is none."""
    skeleton = character.skeleton
    for animation in animations:
        if isinstance(animation, Motion) and animation.joint_names == skeleton.names:
            return animation
        if isinstance(animation, Clip) and animation.duration_s > 0:
            return frames_of(animation, skeleton)
    return None


def compare_with_scene(
    result: RetargetResult, skeleton: Skeleton, body: Character, animation: Motion | Clip
) -> ReferenceReport:
    """What a retargeted motion is beside somebody else's result on a character; see `compare_with_reference`."""
    from keypose.analysis import find_roles

    found = find_roles(body.skeleton, known=body.roles or None)
    theirs = frames_of(animation, body.skeleton)
    return compare_with_reference(
        result.motion, skeleton, result.target.roles, theirs, body.skeleton, found.roles, result.touching
    )
