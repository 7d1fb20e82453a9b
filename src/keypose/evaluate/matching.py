"""Matching of motions and clips to a skeleton by the names of joints."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import overload

import numpy as np

from keypose.arrays import Array, namespace, unified
from keypose.model import Channel, Clip, Motion, Pose, Property, Skeleton


@dataclass(frozen=True, slots=True)
class MatchReport:
    """Which joint of an animation drives which joint of a skeleton."""

    sources: dict[str, str]  # joint of the skeleton -> joint of the animation
    missing: tuple[str, ...]  # joints of the skeleton that nothing drives; they stay at rest
    unused: tuple[str, ...]  # joints of the animation that drive nothing

    @property
    def renamed(self) -> dict[str, str]:
        """The pairs whose names differ."""
        return {own: other for own, other in self.sources.items() if own != other}

    @property
    def notes(self) -> tuple[str, ...]:
        """The same in words, one sentence each; empty where every joint is driven under its own name."""
        lines: list[str] = []
        if self.renamed:
            own, other = next(iter(self.renamed.items()))
            lines.append(f"{len(self.renamed)} joints matched by similar names, such as '{other}' to '{own}'")
        if self.missing:
            lines.append(f"{len(self.missing)} joints stay at rest: {_listed(self.missing)}")
        if self.unused:
            lines.append(f"{len(self.unused)} animated joints are not in the skeleton: {_listed(self.unused)}")
        return tuple(lines)

    def __str__(self) -> str:
        return "; ".join(self.notes) or f"all {len(self.sources)} joints match by name"


def match_report(animation: Motion | Clip, skeleton: Skeleton) -> MatchReport:
    """How the joints of a motion or clip map onto a skeleton.

    An exact name wins; else the same name in other upper and lower case; else the same after a namespace such as
    ``mixamorig:`` or ``Armature|`` is cut off. A similar name that fits two joints fits none.
    """
    names = animation.joint_names if isinstance(animation, Motion) else _animated_joints(animation)
    known = set(names)
    sources = {own: own for own in skeleton.names if own in known}
    for fold in (str.casefold, _bare):
        theirs = _unique((n for n in names if n not in set(sources.values())), fold)
        ours = _unique((n for n in skeleton.names if n not in sources), fold)
        sources.update({own: theirs[key] for key, own in ours.items() if key in theirs})
    used = set(sources.values())
    return MatchReport(
        {own: sources[own] for own in skeleton.names if own in sources},
        tuple(own for own in skeleton.names if own not in sources),
        tuple(n for n in names if n not in used),
    )


@overload
def match(animation: Motion, skeleton: Skeleton) -> Motion: ...
@overload
def match(animation: Clip, skeleton: Skeleton) -> Clip: ...
def match(animation: Motion | Clip, skeleton: Skeleton) -> Motion | Clip:
    """The animation with the joints of a skeleton.

    A motion gets the skeleton's joints in its order, at rest where the motion has none of that name; a clip gets its
    channels renamed, and channels of joints that are not in the skeleton are left out. Names are matched as in
    `match_report`, which says what was done. Transforms are not changed: this is no retargeting.
    """
    report = match_report(animation, skeleton)
    if isinstance(animation, Clip):
        names = {other: own for own, other in report.sources.items()}
        curves = {
            replace(channel, target=names[channel.target]) if _moves_a_joint(channel) else channel: curve
            for channel, curve in animation.curves.items()
            if not _moves_a_joint(channel) or channel.target in names
        }
        orders = {names[other]: order for other, order in animation.euler_orders.items() if other in names}
        return replace(animation, curves=curves, euler_orders=orders)
    if animation.joint_names == skeleton.names:
        return animation
    index = {name: j for j, name in enumerate(animation.joint_names)}
    rows = [index.get(report.sources.get(name, ""), -1) if name in report.sources else -1 for name in skeleton.names]
    pose, rest = animation.pose.broadcast(), skeleton.rest
    return replace(
        animation,
        joint_names=skeleton.names,
        pose=Pose(
            _reordered(pose.translations, rest.translations, rows),
            _reordered(pose.rotations, rest.rotations, rows),
            _reordered(pose.scales, rest.scales, rows),
        ),
    )


def _reordered(array: Array, rest: Array, rows: Sequence[int]) -> Array:
    """Rows of (T, N, C), and those of rest (J, C) where the row is -1: (T, J, C)."""
    index = np.asarray(rows, np.intp)
    if isinstance(array, np.ndarray) and isinstance(rest, np.ndarray):
        result = np.empty((array.shape[0], *rest.shape), array.dtype)
        result[:, index >= 0] = array[:, index[index >= 0]]
        result[:, index < 0] = rest[index < 0]
        result.setflags(write=False)
        return result
    array, rest = unified(array, rest)
    xp = namespace(array)
    columns = [
        array[:, r, :] if r >= 0 else xp.broadcast_to(rest[j, :], (array.shape[0], rest.shape[1]))
        for j, r in enumerate(rows)
    ]
    return xp.stack(columns, axis=1)


def _animated_joints(clip: Clip) -> tuple[str, ...]:
    return tuple(dict.fromkeys(c.target for c in clip.curves if _moves_a_joint(c)))


def _moves_a_joint(channel: Channel) -> bool:
    return channel.property not in (Property.WEIGHT, Property.VALUE)


def _bare(name: str) -> str:
    return name.replace("|", ":").rsplit(":", 1)[-1].casefold()


def _unique(names: Iterable[str], fold: object) -> dict[str, str]:
    """Folded name -> name, for those that fold to something of their own."""
    found: dict[str, list[str]] = {}
    for name in names:
        found.setdefault(fold(name), []).append(name)  # type: ignore[operator]
    return {key: group[0] for key, group in found.items() if len(group) == 1}


def _listed(names: Sequence[str], shown: int = 5) -> str:
    return ", ".join(names[:shown]) + (f" and {len(names) - shown} more" if len(names) > shown else "")
