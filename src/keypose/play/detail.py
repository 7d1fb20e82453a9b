"""Crowds with level of detail: who is shown at which level, who is due in this step, and the skins of those who are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from types import ModuleType
from typing import Any

import numpy as np

from keypose.arrays import Array, Floats, Ints
from keypose.errors import ShapeError
from keypose.play.levels import Level

HYSTERESIS = 0.15
_SPARSE = 1.25  # blocks in use for each that is needed, before the members close up


@dataclass(slots=True, eq=False)
class Detail:
    """A crowd's levels of detail; made by `prepare`, written by `choose` and `skin`: one thread at a time.

    Each level has blocks of W places, and ``members[level]`` says which character is in which (-1: none). A block is the
    unit of work: all of it is updated in the same step, every n-th step at a level that says so, and the blocks of a
    level take turns, so that all steps cost the same.

    Shapes and units:
        level: (count,) the level of each character; place: (count,) where it is among the level's members.
        vertices: of each level (blocks, V, 6, W) float32, position and normal, characters in the lanes.
        updated: of each level (blocks,) the step in which each block was last skinned, -1 at first.
    """

    levels: tuple[Level, ...]
    count: int
    level: Ints
    place: Ints
    members: list[Ints]
    vertices: list[Array] = field(repr=False)
    updated: list[Ints] = field(repr=False)
    fresh: list[Array] = field(repr=False)  # blocks that somebody new is in
    kernel: ModuleType = field(repr=False)
    step: int = 0

    @property
    def shown(self) -> list[int]:
        """How many characters are at each level."""
        return np.bincount(self.level[self.level >= 0], minlength=len(self.levels)).tolist()


def prepare(levels: Sequence[Level], count: int) -> Detail:
    """Levels of detail for ``count`` characters, none of which is at a level before `choose` has said so.

    Raises:
        ShapeError: where there is no level or no character.
    """
    from keypose.kernels import skincrowd
    from keypose.kernels.runtime import WIDTH

    if not levels or count < 1:
        raise ShapeError(f"detail: expected at least one level and one character, got {len(levels)} and {count}")
    nobody = np.full(count, -1, np.int64)
    members: list[Ints] = [np.full(WIDTH, -1, np.int64) for _ in levels]
    made = Detail(tuple(levels), count, nobody, nobody.copy(), members, [], [], [], skincrowd)
    for n in range(len(levels)):
        made.vertices.append(_room(made, n, 1))
        made.updated.append(np.full(1, -1, np.int64))
        made.fresh.append(np.zeros(1, bool))
    return made


def view_heights(places: Floats, eye: Floats, height_m: float, fov_deg: float) -> Floats:
    """How tall characters look from ``eye`` (3,), as shares of the view's height, (N,).

    Shapes and units: ``places`` (N, 2 or 3) metres, of the ground (x, z) or in space; ``fov_deg`` is vertical.
    """
    places, eye = np.asarray(places, np.float64), np.asarray(eye, np.float64)
    if places.shape[-1] == 2:
        away = np.sqrt(np.sum((places - eye[[0, 2]]) ** 2, axis=-1) + (eye[1] - height_m / 2) ** 2)
    else:
        away = np.sqrt(np.sum((places - eye) ** 2, axis=-1))
    return height_m / (2 * np.tan(np.radians(fov_deg) / 2) * np.maximum(away, 1e-3))


def choose(detail: Detail, heights: Floats, hysteresis: float = HYSTERESIS) -> Ints:
    """Give each character its level by how tall it looks, and a place there; returns who changed, (N,).

    A character goes to a finer level where it is taller than the level asks for, and leaves that only where it is
    smaller by the share ``hysteresis``, so nobody flickers between two. Where a level has more than its capacity,
    the tallest stay. Raises `ShapeError` where there is not one finite height >= 0 for each character.
    """
    heights = np.asarray(heights, np.float64)
    if heights.shape != (detail.count,) or not np.all(np.isfinite(heights) & (heights >= 0)):
        raise ShapeError(f"heights: expected {detail.count} finite numbers >= 0, got {heights.shape}")
    if not 0 <= hysteresis < 1:
        raise ShapeError(f"hysteresis: expected a number from 0 to under 1, got {hysteresis}")
    wanted = levels_of([level.spec.above for level in detail.levels], heights, detail.level, hysteresis)
    for n, level in enumerate(detail.levels):
        capacity = level.spec.capacity
        if capacity is None:
            continue
        here = np.nonzero(wanted == n)[0]
        if len(here) > capacity:
            # Who is here already has the advantage of the hysteresis over who wants to come.
            rank = heights[here] * np.where(detail.level[here] == n, 1 + hysteresis, 1.0)
            wanted[here[np.argsort(-rank, kind="stable")[capacity:]]] = n + 1
    changed = np.nonzero(wanted != detail.level)[0]
    if len(changed):
        _move(detail, changed, wanted[changed])
    return changed


def levels_of(above: Sequence[float], heights: Floats, now: Ints, hysteresis: float) -> Ints:
    """The level of each height (N,), the finest first; ``now`` (N,) is where each is, -1 nowhere."""
    found = np.full(len(heights), len(above) - 1, np.int64)
    for n in range(len(above) - 2, -1, -1):
        stays = (now >= 0) & (now <= n)
        found[heights > np.where(stays, above[n] * (1 - hysteresis), above[n])] = n
    return found


def due(detail: Detail) -> list[Ints]:
    """The blocks of each level that the next step will update: those whose turn it is, and those with somebody new."""
    found: list[Ints] = []
    for n, level in enumerate(detail.levels):
        blocks = len(detail.fresh[n])
        turn = (detail.step + np.arange(blocks)) % level.spec.every == 0
        used = np.any(detail.members[n].reshape(blocks, -1) >= 0, axis=1)
        found.append(np.nonzero((turn | detail.fresh[n]) & used)[0])
    return found


def begin(detail: Detail) -> list[Ints]:
    """Start the next step without skinning here (a graphics card may do that); returns the blocks that are `due`."""
    blocks = due(detail)
    for n, at in enumerate(blocks):
        detail.updated[n][at] = detail.step
        detail.fresh[n][at] = False
    detail.step += 1
    return blocks


def skin(detail: Detail, models: Array) -> list[Ints]:
    """Skin the blocks that are due, positions and normals, into ``detail.vertices``; returns them, level by level.

    Shapes and units: ``models`` (blocks, J, 12, W) float32 of all characters, as `keypose.play.crowd.animate` and
    `keypose.play.graph.animate_crowd` leave them. Raises `ShapeError` where they do not fit.
    """
    from keypose.kernels.runtime import WIDTH

    if models.ndim != 4 or len(models) * WIDTH < detail.count:
        raise ShapeError(f"models: expected (blocks, J, 12, {WIDTH}) for {detail.count} characters, got {models.shape}")
    blocks = begin(detail)
    for n, (level, at) in enumerate(zip(detail.levels, blocks, strict=True)):
        if len(at):
            detail.kernel.skin_members(level.compiled, models, detail.members[n], at, True, detail.vertices[n])
    return blocks


def matrices(
    detail: Detail, models: Array, roots: Floats, blocks: Sequence[Ints], unit_m: float
) -> list[tuple[Ints, Array]]:
    """Skin matrices of the characters in some blocks, for a graphics card that skins them itself.

    Shapes and units: ``models`` as in `skin`; ``roots`` (count, 3), x m, z m, yaw rad; ``blocks`` level by level, as
    `begin` returns them. For each level the characters (N,) and their matrices model_from_mesh, seen from the
    character's root, (N, P, 12) int16: rows of 3x4 matrices in the order of the level's palette, turns and scales in units of
    2^-14, places in units of ``unit_m``; what is farther off than 32,767 of them is cut off.

    Raises:
        ShapeError: where models or roots do not fit.
    """
    roots = np.ascontiguousarray(roots, np.float64)
    if roots.shape != (detail.count, 3):
        raise ShapeError(f"roots: expected {(detail.count, 3)}, got {roots.shape}")
    found: list[tuple[Ints, Array]] = []
    for level, members, at in zip(detail.levels, detail.members, blocks, strict=True):
        width = detail.vertices[0].shape[-1]
        who = members.reshape(-1, width)[at].ravel()
        both = detail.kernel.quantized_members(level.compiled, models, members, at, roots, unit_m)
        found.append((who[who >= 0], both[who >= 0]))
    return found


def vertices_of(detail: Detail, character: int) -> tuple[Array, Array]:
    """Positions and normals (V, 3) of one character as last skinned, at its level; copies.

    Raises `ShapeError` for a character that is not there or at no level.
    """
    if not 0 <= character < detail.count or detail.level[character] < 0:
        raise ShapeError(f"character: expected one of {detail.count} that `choose` has placed, got {character}")
    block, lane = divmod(int(detail.place[character]), detail.vertices[0].shape[-1])
    both = detail.vertices[int(detail.level[character])][block, :, :, lane]
    return both[:, :3].copy(), both[:, 3:].copy()


# --- places ---------------------------------------------------------------------------------------------------------------


def _room(detail: Detail, level: int, blocks: int) -> Array:
    from keypose.kernels.runtime import WIDTH, aligned

    shape = (blocks, detail.levels[level].mesh.vertex_count, 6, WIDTH)
    return aligned(int(np.prod(shape))).reshape(shape)


def _move(detail: Detail, who: Ints, to: Ints) -> None:
    """Characters leave their places and get new ones; a level with many gaps closes up."""
    for n in range(len(detail.levels)):
        leaving = who[detail.level[who] == n]
        detail.members[n][detail.place[leaving]] = -1
    detail.level[who] = to
    for n in range(len(detail.levels)):
        entering = who[to == n]
        free = np.nonzero(detail.members[n] < 0)[0]
        if len(entering) > len(free):
            _grow(detail, n, len(detail.members[n]) + len(entering) - len(free))
            free = np.nonzero(detail.members[n] < 0)[0]
        _seat(detail, n, entering, free[: len(entering)])
        _close_up(detail, n)


def _seat(detail: Detail, level: int, who: Ints, places: Ints) -> None:
    detail.members[level][places] = who
    detail.place[who] = places
    detail.fresh[level][places // detail.vertices[level].shape[-1]] = True


def _close_up(detail: Detail, level: int) -> None:
    """Fill the gaps with the last members, where they take up more blocks than they need."""
    members = detail.members[level]
    width = detail.vertices[level].shape[-1]
    taken = np.nonzero(members >= 0)[0]
    needed = -(-len(taken) // width)
    used = len(np.unique(taken // width))
    if used <= max(needed, int(_SPARSE * needed)):
        return
    late = taken[taken >= len(taken)]
    gaps = np.nonzero(members[: len(taken)] < 0)[0]
    moving = members[late]
    members[late] = -1
    _seat(detail, level, moving, gaps)


def _grow(detail: Detail, level: int, places: int) -> None:
    """More blocks; twice as many at least, so that growing stays cheap."""
    old = detail.vertices[level]
    width = old.shape[-1]
    blocks = min(max(-(-places // width), 2 * len(old)), -(-detail.count // width))
    blocks = max(blocks, -(-places // width))
    room = _room(detail, level, blocks)
    room[: len(old)] = old
    detail.vertices[level] = room
    for held, empty in ((detail.members, -1), (detail.updated, -1), (detail.fresh, 0)):
        more: Any = np.full(blocks * (width if held is detail.members else 1), empty, held[level].dtype)
        more[: len(held[level])] = held[level]
        held[level] = more
