"""The proof of a conversion: a scene that was written against the one read back, and what the format could not hold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from keypose.analysis.roundtrip import RoundtripError, roundtrip_error
from keypose.arrays import Floats
from keypose.deform import deform_part
from keypose.evaluate import sample, sample_clip, sample_morphs, sample_motion, world
from keypose.model import Character, Clip, Markers, Motion, Pose, Scene, Skeleton

_MOMENTS = 5  # at which vertices and morph weights are compared
_NEAREST = 20_000  # vertices of a part that are looked for where their number has changed


@dataclass(frozen=True, slots=True)
class SceneError:
    """How far a copy of a scene is from the original; what does not apply is none.

    ``motion`` is the worst clip (the rest pose where there is none); ``vertex_mm`` the largest distance of a deformed vertex,
    ``morph`` of a morph weight, ``marker_mm`` of a marker, ``time_s`` of a clip's length. ``missing`` lists what the copy does not have.
    """

    motion: RoundtripError | None = None
    clips: int = 0
    vertex_mm: float | None = None
    vertex_part: str = ""
    morph: float | None = None
    morph_name: str = ""
    marker_mm: float | None = None
    time_s: float = 0.0
    missing: tuple[str, ...] = ()
    size_mm: float = 0.0  # the longest side of everything in the original

    def within(self, position_mm: float, rotation_deg: float, share_of_size: float = 0.0) -> bool:
        """Whether nothing is missing, no place is off by more, no angle, no morph weight by 1e-4, no length by 1e-4 s.

        Places may be off by ``share_of_size`` of the scene's size where that is more than ``position_mm``: single
        precision has seven digits, which in a scene of 100 m are hundredths of a millimetre.
        """
        position_mm = max(position_mm, share_of_size * self.size_mm)
        if self.missing or self.time_s > 1e-4 or (self.morph or 0.0) > 1e-4:
            return False
        if any((d or 0.0) > position_mm for d in (self.vertex_mm, self.marker_mm)):
            return False
        return self.motion is None or self.motion.within(position_mm, rotation_deg)

    def lines(self) -> list[str]:
        """What to tell people, a line each."""
        lines: list[str] = []
        if self.motion is not None:
            what = "rest pose, read back" if not self.clips else "read back"
            lines.append(f"{what if self.clips < 2 else f'{self.clips} clips read back, the worst'}: {self.motion}")
        if self.vertex_mm is not None:
            where = f" ({self.vertex_part})" if self.vertex_mm > 0 else ""
            lines.append(f"vertices, deformed, within {self.vertex_mm:.2g} mm{where}")
        if self.morph is not None:
            where = f" ({self.morph_name})" if self.morph > 0 else ""
            lines.append(f"morph weights within {self.morph:.2g}{where}")
        if self.marker_mm is not None:
            lines.append(f"markers within {self.marker_mm:.2g} mm")
        if self.time_s > 1e-6:  # times are stored in single precision
            lines.append(f"lengths within {self.time_s:.2g} s")
        return lines + [f"not kept: {what}" for what in self.missing]


def scene_error(original: Scene, copy: Scene) -> SceneError:
    """How far a scene read back is from the one that was written: joints, vertices, morph weights, markers, time.

    Characters are compared in their order, clips by name or order, parts by name or order. Where the number of a part's
    vertices has changed, each is compared with the nearest one.
    """
    missing: list[str] = []
    _missing(missing, "character", [c.name for c in original.characters], [c.name for c in copy.characters])
    pairs = _clip_pairs(original, copy, missing)
    motion = _worst_motion(original, copy, pairs, missing)
    vertex, part, morph, morph_name = _surfaces(original, copy, pairs, missing)
    marker_mm = None
    for number, markers in enumerate(original.markers):
        marker_mm = max(marker_mm or 0.0, _marker_distance(markers, copy.markers, number, missing))
    for kind in ("signals", "plates"):
        lost = len(getattr(original, kind)) - len(getattr(copy, kind))
        if lost > 0:
            missing.append(f"{lost} of {len(getattr(original, kind))} {kind}")
    times = [abs(a.duration_s - b.duration_s) for a, b in pairs]
    return SceneError(
        motion,
        len(pairs),
        vertex,
        part,
        morph,
        morph_name,
        marker_mm,
        max(times, default=0.0),
        tuple(missing),
        1000 * _size(original),
    )


def _size(scene: Scene) -> float:
    """The longest side in metres of a box round joints at rest, meshes and markers, each in its own space."""
    longest = 0.0
    clouds = [world(c.skeleton, _double(c.skeleton.rest))[:, :3, 3] for c in scene.characters]
    clouds += [np.asarray(p.mesh.positions, np.float64) for c in scene.characters for p in c.parts]
    clouds += [np.asarray(m.positions, np.float64)[np.asarray(m.visible)] for m in scene.markers]
    for cloud in clouds:
        points = cloud[np.isfinite(cloud).all(axis=-1)]
        if len(points):
            longest = max(longest, float(np.ptp(points, axis=0).max()))
    return longest


def _missing(missing: list[str], what: str, had: Sequence[str], has: Sequence[str]) -> None:
    lost = len(had) - len(has)
    if lost > 0:
        names = [name for name in had if name and name not in has][:3]
        missing.append(f"{lost} of {len(had)} {what}s" + (f" ({', '.join(names)})" if names else ""))


def _clip_pairs(original: Scene, copy: Scene, missing: list[str]) -> list[tuple[Clip | Motion, Clip | Motion]]:
    _missing(missing, "clip", [a.name for a in original.animations], [a.name for a in copy.animations])
    if len(original.animations) == len(copy.animations):
        return list(zip(original.animations, copy.animations, strict=True))
    by_name = {a.name: a for a in reversed(original.animations)}
    return [(by_name.get(b.name, a), b) for a, b in zip(original.animations, copy.animations, strict=False)]


def _worst_motion(
    original: Scene, copy: Scene, pairs: list[tuple[Clip | Motion, Clip | Motion]], missing: list[str]
) -> RoundtripError | None:
    if not original.characters or not copy.characters:
        return None
    source, result = original.character.skeleton, copy.character.skeleton
    if not set(source.names) & set(result.names):  # of formats that hold meshes only
        _missing(missing, "joint", source.names, ())
        return None
    errors = [roundtrip_error(a, b, source, result) for a, b in pairs]
    if not errors:
        errors = [roundtrip_error(_at_rest(source), _at_rest(result), source, result)]
        if copy.animations:  # a format whose rest pose has no rotations holds the pose as a motion of one frame
            start = _first_frame(copy.animations[0], result)
            errors.append(roundtrip_error(_at_rest(source), start, source, result))
        return min(errors, key=lambda e: (e.position_mm, e.rotation_deg))
    return max(errors, key=lambda e: (e.position_mm, e.rotation_deg))


def _at_rest(skeleton: Skeleton) -> Motion:
    rest = skeleton.rest
    return Motion(skeleton.names, Pose(rest.translations[None], rest.rotations[None], rest.scales[None]), 1.0)


def _first_frame(animation: Clip | Motion, skeleton: Skeleton) -> Motion:
    pose = sample(animation, skeleton, np.array([animation.start_s])).broadcast()
    return Motion(skeleton.names, pose, 1.0)


def _surfaces(
    original: Scene, copy: Scene, pairs: list[tuple[Clip | Motion, Clip | Motion]], missing: list[str]
) -> tuple[float | None, str, float | None, str]:
    """The largest distance of vertices in mm and their part, of morph weights and their name."""
    worst: tuple[float | None, str] = (None, "")
    weight: tuple[float | None, str] = (None, "")
    for number, (a, b) in enumerate(zip(original.characters, copy.characters, strict=False)):
        _missing(missing, "mesh part", [p.name for p in a.parts], [p.name for p in b.parts])
        lost = [name for name in a.morph_names if name not in b.morph_names]
        if lost:
            missing.append(f"{len(lost)} of {len(a.morph_names)} morphs ({', '.join(lost[:3])})")
        moments: list[tuple[Pose, Pose, Floats, Floats]] = [
            (a.skeleton.rest, b.skeleton.rest, _rest_weights(a), _rest_weights(b))
        ]
        if number == 0 and pairs:
            moments += _moments(a, b, pairs[0])
        common = [name for name in a.morph_names if name in b.morph_names]
        for pose_a, pose_b, weights_a, weights_b in moments:
            for name in common:
                apart = abs(float(weights_a[a.morph_index(name)]) - float(weights_b[b.morph_index(name)]))
                if weight[0] is None or apart > weight[0]:
                    weight = apart, name
            places_a, places_b = world(a.skeleton, _double(pose_a)), world(b.skeleton, _double(pose_b))
            for part, other in _part_pairs(a, b):
                points = np.asarray(deform_part(a, a.parts[part], places_a, weights_a), np.float64)
                copied = np.asarray(deform_part(b, b.parts[other], places_b, weights_b), np.float64)
                apart = _vertex_distance(points, copied)
                corners = a.parts[part].mesh.triangles, b.parts[other].mesh.triangles
                if apart > 0 and len(corners[0]) and len(corners[0]) == len(corners[1]):
                    # vertices may have changed their order; triangle by triangle they are the same
                    apart = min(apart, _vertex_distance(points[corners[0].ravel()], copied[corners[1].ravel()]))
                if worst[0] is None or apart > worst[0]:
                    worst = apart, a.parts[part].name
    return worst[0], worst[1], weight[0], weight[1]


def _double(pose: Pose) -> Pose:
    """In double precision: what is measured is the file, not the rounding of skinning."""
    return Pose(*(np.asarray(a, np.float64) for a in (pose.translations, pose.rotations, pose.scales)))


def _rest_weights(character: Character) -> Floats:
    return np.asarray(character.rest_morph_weights, np.float64)


def _part_pairs(a: Character, b: Character) -> list[tuple[int, int]]:
    names = [p.name for p in b.parts]
    own = [p.name for p in a.parts]
    if len(own) == len(names) and (sorted(own) != sorted(names) or len(set(own)) < len(own)):
        return [(i, i) for i in range(len(own))]  # renamed, or names that say nothing: by order
    return [(i, names.index(p.name)) for i, p in enumerate(a.parts) if p.name in names]


def _moments(
    a: Character, b: Character, pair: tuple[Clip | Motion, Clip | Motion]
) -> list[tuple[Pose, Pose, Floats, Floats]]:
    """Poses and morph weights of both at a few times from start to end."""
    first, second = pair
    shares = np.linspace(0, 1, _MOMENTS)
    times = first.start_s + shares * first.duration_s
    moved = times - first.start_s + second.start_s
    poses = _poses(first, a.skeleton, times), _poses(second, b.skeleton, moved)
    if poses[0] is None or poses[1] is None:
        return []
    weights = sample_morphs(first, a.morph_names, times, a.rest_morph_weights)
    copied = sample_morphs(second, b.morph_names, moved, b.rest_morph_weights)
    return [(poses[0][k], poses[1][k], np.asarray(weights[k]), np.asarray(copied[k])) for k in range(_MOMENTS)]


def _poses(animation: Clip | Motion, skeleton: Skeleton, times: Floats) -> Pose | None:
    if isinstance(animation, Clip):
        return sample_clip(animation, skeleton, times).broadcast()
    if animation.joint_names != skeleton.names:
        return None
    return sample_motion(animation, times).broadcast()


def _vertex_distance(points: Floats, copied: Floats) -> float:
    """The largest distance in mm, vertex by vertex, or to the nearest where their number has changed."""
    if not len(points) or not len(copied):
        return 0.0
    if points.shape == copied.shape:
        return 1000 * float(np.linalg.norm(points - copied, axis=-1).max())
    from scipy.spatial import KDTree

    chosen = points[:: -(-len(points) // _NEAREST)]
    return 1000 * float(np.max(KDTree(copied).query(chosen)[0]))


def _marker_distance(a: Markers, sets: Sequence[Markers], number: int, missing: list[str]) -> float:
    """The largest distance in mm of a set's markers from those of their names, in its own set of the copy or any other."""
    nearest = [*sets[number : number + 1], *sets[:number], *sets[number + 1 :]]
    found = {name: next((s for s in nearest if name in s.names), None) for name in dict.fromkeys(a.names)}
    lost = [name for name, place in found.items() if place is None]
    if lost:
        missing.append(f"{len(lost)} of {len(a.names)} markers ({', '.join(lost[:3])})")
    worst = 0.0
    for b in nearest:
        names = [name for name, place in found.items() if place is b]
        if names:
            worst = max(worst, _set_distance(a, b, names, missing))
    return worst


def _set_distance(a: Markers, b: Markers, names: Sequence[str], missing: list[str]) -> float:
    frames = min(a.frame_count, b.frame_count)
    if a.frame_count > b.frame_count:
        missing.append(f"{a.frame_count - b.frame_count} of {a.frame_count} frames of markers")
    if not frames:
        return 0.0
    first, second = [a.names.index(name) for name in names], [b.names.index(name) for name in names]
    places = (np.asarray(m.positions, np.float64)[:frames, index] for m, index in ((a, first), (b, second)))
    apart = np.linalg.norm(np.subtract(*places), axis=-1)
    gone = int(np.sum(np.asarray(a.visible)[:frames, first] & ~np.asarray(b.visible)[:frames, second]))
    if gone:
        missing.append(f"{gone} sightings of markers")
    return 1000 * float(np.nanmax(apart)) if np.isfinite(apart).any() else 0.0
