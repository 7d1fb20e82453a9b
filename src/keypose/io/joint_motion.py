"""What formats of one skeleton and one motion (BVH, Acclaim) write of a scene."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from keypose import evaluate
from keypose.arrays import Ints
from keypose.model import Character, Clip, Motion, Pose, Scene


def motion_to_write(
    scene: Scene,
    character: Character,
    kind: str,
    default_rate_hz: float,
    rate_hz: float | None,
    animation: str | None,
    notes: list[str],
) -> Motion:
    """The chosen animation, or the first, as a motion of the character's joints; what a file of a kind lacks is told.

    Its rate is ``rate_hz``, else its own, else ``default_rate_hz``.

    Raises:
        UnknownName: for an animation that does not exist.
    """
    skeleton = character.skeleton
    if not scene.animations and animation is None:
        notes.append("there is no animation: one frame of the rest pose was written")
        rest = skeleton.rest
        pose = Pose(rest.translations[None], rest.rotations[None], rest.scales[None])
        return Motion(skeleton.names, pose, rate_hz or default_rate_hz)
    chosen = scene.animation(animation)
    notes += [f"animation '{a.name}' is not in the file: {kind} holds one" for a in scene.animations if a is not chosen]
    if isinstance(chosen, Clip):
        rate = rate_hz or evaluate.key_rate(chosen)
        if rate is None:
            rate = default_rate_hz
            notes.append(f"the clip's keys are at no steady rate; it was sampled at {rate:g} Hz")
        motion = evaluate.bake(evaluate.match(chosen, skeleton), skeleton, rate)
    else:
        motion = chosen
        if motion.joint_names != skeleton.names:
            notes += evaluate.match_report(motion, skeleton).notes
            motion = evaluate.match(motion, skeleton)
        if rate_hz is not None and rate_hz != motion.rate_hz:
            motion = evaluate.resample(motion, rate_hz)
    if motion.start_s:
        notes.append(f"the motion starts at {motion.start_s:g} s; {kind} files start at 0")
    if motion.morph_names or character.morph_names:
        notes.append(f"morph weights are not in the file: {kind} holds joints only")
    return motion


def depth_first(parents: Ints | Sequence[int]) -> Ints:
    """Joints in depth-first order, children in their old order."""
    children: list[list[int]] = [[] for _ in parents]
    stack: list[int] = []
    for joint, parent in enumerate(parents):
        (children[parent] if parent >= 0 else stack).append(joint)
    stack.reverse()
    order: list[int] = []
    while stack:
        order.append(stack.pop())
        stack.extend(reversed(children[order[-1]]))
    return np.array(order, np.intp)
