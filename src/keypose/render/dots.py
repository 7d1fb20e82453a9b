"""Markers as dots: a character with a sphere for each marker, and the motion that carries the spheres."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from keypose.arrays import Array, Floats, Ints
from keypose.errors import ShapeError
from keypose.model import Character, Markers, Motion, Pose, Scene, Skeleton
from keypose.render.bones import dots, side_of
from keypose.render.settings import Theme

# of what the markers span: large enough to be seen, small enough that hands stay apart
_RADIUS = 0.009
_HIDDEN = 1e-4  # the size of what is not seen; nothing at all would have no directions


def marker_scene(markers: Markers, theme: Theme) -> Scene:
    """The scene that shows the markers: coloured by side, gone while they are not seen.

    Raises:
        ShapeError: where no marker is ever seen.
    """
    visible = np.asarray(markers.visible)
    # trajectories that nobody labelled, "*3", are mostly reflections that lie about
    labelled = np.array([not name.rsplit(":", 1)[-1].startswith("*") for name in markers.names], bool)
    places = np.nonzero(visible.any(axis=0) & (labelled if labelled.any() else True))[0]
    if not len(places):
        raise ShapeError("render: the scene holds no character to draw, and none of its markers is ever seen")
    visible = visible[:, places]
    positions = _filled(np.asarray(markers.positions, np.float64)[:, places], visible)
    spans = np.linalg.norm(np.ptp(positions, axis=1), axis=-1)
    radius = _RADIUS * max(float(np.median(spans)), 1e-3)
    by_side = {1: theme.bone_left, -1: theme.bone_right, 0: theme.bone_center}
    names = [markers.names[i] for i in places]
    figure = dots(radius, np.array([by_side[side_of(name.rsplit(":", 1)[-1])] for name in names], np.float64))
    character, frames = _with_middle(figure, names), len(positions)
    middle = np.median(positions, axis=1, keepdims=True)
    scales = np.ones((frames, len(places) + 1, 3))
    scales[:, 1:] = np.where(visible, 1.0, _HIDDEN)[..., None]
    pose = Pose(
        np.concatenate([middle, positions], axis=1),
        np.broadcast_to((1.0, 0.0, 0.0, 0.0), (frames, len(places) + 1, 4)),
        scales,
    )
    motion = Motion(character.skeleton.names, pose, markers.rate_hz, name=markers.name)
    return Scene((character,), (motion,))


def _with_middle(figure: Character, names: list[str]) -> Character:
    """The figure with a joint in front of all others that stands in their middle: the path a camera follows."""
    count = len(names) + 1
    rest = Pose(np.zeros((count, 3)), np.tile([1.0, 0, 0, 0], (count, 1)), np.ones((count, 3)))
    unlike = [f"{i} {name}" for i, name in enumerate(("middle", *names))]
    (part,) = figure.parts
    skin = part.skin
    if skin is None:
        raise ShapeError("dots are bound to joints")
    shifted = replace(part, skin=replace(skin, palette=np.asarray(skin.palette) + 1))
    return Character(Skeleton(tuple(unlike), np.full(count, -1), rest), (shifted,), name="markers")


def _filled(positions: Floats, visible: Array) -> Floats:
    """Positions (T, N, 3) with those of the nearest frame in which the marker was seen where it was not."""
    frames = len(positions)
    index: Ints = np.arange(frames)[:, None]
    last = np.maximum.accumulate(np.where(visible, index, -1), axis=0)
    following = np.minimum.accumulate(np.where(visible, index, 2 * frames)[::-1], axis=0)[::-1]
    nearest = np.where((last >= 0) & ((index - last <= following - index) | (following >= frames)), last, following)
    return positions[nearest, np.arange(positions.shape[1])[None]]
