"""The stage: who stands where, moving how, and the cast of meshes and bones that is drawn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np

from keypose import deform, evaluate
from keypose.arrays import Floats
from keypose.errors import ShapeError
from keypose.model import Character, Clip, Motion, Pose, Scene
from keypose.render.bones import Figure, axes_figure, bones_figure, figure_joints
from keypose.render.dots import marker_scene
from keypose.render.settings import RenderSettings

Animation: TypeAlias = Clip | Motion
REST = Clip(name="rest")  # animates nothing: everyone stands in the rest pose

_SURVEY_SAMPLES = 24  # moments at which a whole performance is measured
_SURVEY_POINTS = 3000  # vertices per mesh that are measured


@dataclass(frozen=True, slots=True, eq=False)
class Actor:
    """A character, what it plays (None: the rest pose) and how far it is moved aside."""

    character: Character
    animation: Animation | None
    offset: Floats = field(default_factory=lambda: np.zeros(3))

    def matrices(self, times_s: Floats) -> Floats:
        """World-from-joint matrices at T times, (T, J, 4, 4) float32."""
        skeleton = self.character.skeleton
        if self.animation is None:
            pose = skeleton.rest
            pose = Pose(*(np.asarray(a)[None] for a in (pose.translations, pose.rotations, pose.scales)))
        elif isinstance(self.animation, Motion):
            pose = evaluate.sample_motion(self.animation, times_s)
        else:
            pose = evaluate.sample_clip(self.animation, skeleton, times_s)
        world = np.asarray(evaluate.world(skeleton, pose), np.float32)
        world = np.array(np.broadcast_to(world, (len(times_s), *world.shape[1:])))
        world[..., :3, 3] += self.offset.astype(np.float32)
        return world

    def morph_weights(self, times_s: Floats) -> Floats:
        """Weights of the character's M morph channels at T times, (T, M) float32."""
        character = self.character
        rest = np.asarray(character.rest_morph_weights, np.float32)
        weights = np.repeat(rest[None], len(times_s), axis=0)
        if not character.morph_names or self.animation is None:
            return weights
        return np.asarray(evaluate.sample_morphs(self.animation, character.morph_names, times_s, rest), np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class Drawn:
    """Something to draw: an actor's own parts, or the figure of bones or axes that follows its joints.

    ``overlay`` draws over everything else; ``delay_s`` shows another moment (a ghost) with a faint ``tint``.
    """

    actor: int
    figure: Figure | None = None
    overlay: bool = False
    delay_s: float = 0.0
    ghost: float = 0.0  # how much is left of it: 0 is no ghost


@dataclass(frozen=True, slots=True, eq=False)
class Moment:
    """What one picture shows: for each drawn thing its character, joint matrices (J, 4, 4) and morph weights (M,)."""

    matrices: tuple[Floats, ...]
    morph_weights: tuple[Floats, ...]


class Stage:
    """A scene made ready to be drawn: actors, their cast, the time span, and measures of the whole performance."""

    def __init__(
        self,
        scene: Scene,
        animation: str | Animation | Sequence[Animation | None] | None,
        settings: RenderSettings,
    ) -> None:
        if not scene.characters and scene.markers:
            scene = marker_scene(scene.markers[0], settings.colors)
        if not scene.characters:
            raise ShapeError("render: the scene holds no character to draw, and no markers")
        self.settings = settings
        self.actors = _cast(scene, animation)
        self.start_s, self.end_s = _span(self.actors, settings)
        if settings.arrangement != "as_is" and len(self.actors) > 1:
            self.actors = self._arranged(settings.arrangement == "row")
        self.drawn = _drawn(self.actors, settings)
        if not self.drawn:
            raise ShapeError("render: the scene has no mesh and no joints to draw")
        self._survey()

    def character(self, drawn: Drawn) -> Character:
        """The character whose parts a drawn thing consists of."""
        return self.actors[drawn.actor].character if drawn.figure is None else drawn.figure.character

    def moments(self, times_s: Floats) -> list[Moment]:
        """The moments at T times."""
        matrices: list[Floats] = []
        weights: list[Floats] = []
        played: dict[tuple[int, float], tuple[Floats, Floats]] = {}
        for drawn in self.drawn:
            key = (drawn.actor, drawn.delay_s)
            if key not in played:
                actor, times = self.actors[drawn.actor], np.asarray(times_s, np.float64) + drawn.delay_s
                played[key] = actor.matrices(times), actor.morph_weights(times)
            world, morphs = played[key]
            matrices.append(world if drawn.figure is None else drawn.figure.matrices(world))
            weights.append(morphs if drawn.figure is None else np.zeros((len(times_s), 0), np.float32))
        return [Moment(tuple(m[t] for m in matrices), tuple(w[t] for w in weights)) for t in range(len(times_s))]

    def frame_times(self) -> Floats:
        """Times of a film's pictures: from the start to the end, both shown."""
        count = int(np.floor((self.end_s - self.start_s) * self.settings.rate_hz + 1e-6)) + 1
        return self.start_s + np.arange(count) / self.settings.rate_hz

    def path(self, times_s: Floats) -> Floats:
        """The middle of all actors' roots, (T, 3): what a following camera follows."""
        roots = [actor.matrices(times_s)[:, _root(actor.character), :3, 3] for actor in self.actors]
        return np.mean(np.asarray(roots, np.float64), axis=0)

    def _arranged(self, always: bool) -> tuple[Actor, ...]:
        """Side by side along X if they would stand inside each other."""
        times = np.linspace(self.start_s, self.end_s, 8)
        clouds = [_actor_points(actor, times) for actor in self.actors]
        boxes = [_bounds(points) for points in clouds]
        overlap = any(_overlapping(a, b) for i, a in enumerate(boxes) for b in boxes[:i])
        if not (always or overlap):
            return self.actors
        gap = 0.18 * float(np.median([(high - low)[1] for low, high in boxes]))
        widths = [float(max((high - low)[0], 1e-9)) for low, high in boxes]
        total, placed, cursor = sum(widths) + gap * (len(boxes) - 1), [], 0.0
        for actor, (low, high), width, points in zip(self.actors, boxes, widths, clouds, strict=True):
            # the first actor stands on the viewer's left, which is -X for a camera in front; all start abreast
            x, z = cursor - total / 2 + width / 2 - (low + high)[0] / 2, -float(np.mean(_bounds(points[0]), axis=0)[2])
            placed.append(Actor(actor.character, actor.animation, np.array([x, 0.0, z])))
            cursor += width + gap
        return tuple(placed)

    def _shape(self, drawn: Drawn, times_s: Floats) -> Floats:
        """World positions (T, N, 3) of what is drawn."""
        actor = self.actors[drawn.actor]
        if drawn.figure is None:
            return _actor_points(actor, times_s)
        matrices = drawn.figure.matrices(actor.matrices(times_s))
        points = _points(drawn.figure.character, matrices, np.zeros((len(times_s), 0)))
        return matrices[..., :3, 3] if points is None else points

    def _survey(self) -> None:
        """Measure the performance: points at several moments, size of the subject, floor, how far it travels."""
        times = np.linspace(self.start_s, self.end_s, _SURVEY_SAMPLES if self.end_s > self.start_s else 1)
        self.survey_times = times
        shown = [d for d in self.drawn if not d.overlay and d.ghost == 0]
        self.survey_points = np.concatenate([self._shape(d, times) for d in shown], axis=1)
        if not np.all(np.isfinite(self.survey_points)):
            raise ShapeError("render: the animation moves the character to places that are not finite numbers")
        low, high = self.survey_points.min(axis=1), self.survey_points.max(axis=1)
        extents = high - low
        self.size = max(float(np.median(np.linalg.norm(extents, axis=1))), 1e-9)
        self.height = max(float(np.median(extents[:, 1])), 0.2 * self.size)
        lowest = float(np.median(low[:, 1])) if len(times) > 2 else float(low[:, 1].min())
        lowest = min(lowest, float(np.quantile(low[:, 1], 0.15)))
        # feet that hang a little over or stick a little through the ground still stand on it
        self.floor = 0.0 if abs(lowest) < 0.06 * self.size else lowest
        if self.settings.floor is not None:
            self.floor = self.settings.floor
        middles = (low + high) / 2
        self.travel = float(np.linalg.norm(np.ptp(middles[:, [0, 2]], axis=0)))


def _cast(scene: Scene, animation: str | Animation | Sequence[Animation | None] | None) -> tuple[Actor, ...]:
    count = len(scene.characters)
    if animation is None:
        animation = scene.animations[0] if scene.animations else None
    elif isinstance(animation, str):
        animation = scene.animation(animation)
    plays: list[Animation | None]
    if animation is None or isinstance(animation, (Clip, Motion)):
        plays = [animation] * count
    else:
        plays = list(animation)
        if len(plays) != count:
            raise ShapeError(f"animation: expected one for each of {count} characters, got {len(plays)}")
    actors: list[Actor] = []
    for character, play in zip(scene.characters, plays, strict=True):
        if play is not None:
            play = evaluate.match(play, character.skeleton)
        actors.append(Actor(character, play))
    return tuple(actors)


def _span(actors: Sequence[Actor], settings: RenderSettings) -> tuple[float, float]:
    starts = [a.animation.start_s for a in actors if a.animation is not None]
    ends = [
        a.animation.end_s if isinstance(a.animation, Clip) else a.animation.start_s + a.animation.duration_s
        for a in actors
        if a.animation is not None
    ]
    start = min(starts, default=0.0) if settings.start_s is None else settings.start_s
    end = max(ends, default=0.0) if settings.end_s is None else settings.end_s
    return start, max(start, end)


def _drawn(actors: Sequence[Actor], settings: RenderSettings) -> tuple[Drawn, ...]:
    drawn: list[Drawn] = []
    for index, actor in enumerate(actors):
        has_mesh = settings.mesh and actor.character.triangle_count > 0
        bones = bones_figure(actor.character.skeleton, settings.colors) if settings.skeleton or not has_mesh else None
        axes = axes_figure(actor.character.skeleton) if settings.joint_axes else None
        figure = None if has_mesh else bones
        if has_mesh or figure is not None:
            count = len(settings.ghosts_s)
            far = max((abs(s) for s in settings.ghosts_s), default=0.0)
            for delay in sorted(settings.ghosts_s, key=abs, reverse=True):
                strength = 0.45 - 0.27 * (abs(delay) / far if far and count > 1 else 0)
                drawn.append(Drawn(index, figure, delay_s=delay, ghost=strength))
            drawn.append(Drawn(index, figure))
        if has_mesh and bones is not None:
            drawn.append(Drawn(index, bones, overlay=True))
        if axes is not None:
            drawn.append(Drawn(index, axes, overlay=True))
    return tuple(drawn)


def _actor_points(actor: Actor, times_s: Floats) -> Floats:
    """World positions (T, N, 3) that stand for the actor's shape at T times: of its mesh, or of its joints."""
    world = actor.matrices(times_s)
    points = _points(actor.character, world, actor.morph_weights(times_s))
    return world[..., figure_joints(actor.character.skeleton), :3, 3] if points is None else points


def _points(character: Character, world: Floats, weights: Floats) -> Floats | None:
    """World positions (T, N, 3) of some of a character's vertices; None where it has no triangles."""
    clouds: list[Floats] = []
    for part in character.parts:
        used = np.unique(part.mesh.triangles)
        if not len(used):
            continue
        used = used[:: max(1, len(used) // _SURVEY_POINTS)]
        positions = np.asarray(part.mesh.positions, np.float32)[used]
        if part.morphs is not None and np.any(weights):
            positions = np.stack([deform.morph(part.mesh, part.morphs, w[part.morph_channels])[used] for w in weights])
        if part.skin is None:
            blended = world[:, part.joint][:, None]
        else:
            palette = world[:, part.skin.palette] @ np.asarray(part.skin.joint_from_mesh, np.float32)
            rows = np.asarray(part.skin.weights, np.float32)[used]
            blended = np.einsum("vk,tvkij->tvij", rows, palette[:, part.skin.joints[used]], optimize=True)
        points = (blended[..., :3, :3] @ positions[..., None])[..., 0] + blended[..., :3, 3]
        clouds.append(np.broadcast_to(points, (len(world), *points.shape[1:])))
    return np.concatenate(clouds, axis=1) if clouds else None


def _root(character: Character) -> int:
    """The joint whose path is the character's path."""
    if "hips" in character.roles:
        return character.roles["hips"]
    parents = character.skeleton.parents
    joint = 0
    # a lone node above the hips often stands still at the origin
    while int(np.sum(parents == joint)) == 1 and joint < 4:
        joint = int(np.nonzero(parents == joint)[0][0])
    return joint


def _bounds(points: Floats) -> tuple[Floats, Floats]:
    flat = points.reshape(-1, 3).astype(np.float64)
    return flat.min(axis=0), flat.max(axis=0)


def _overlapping(a: tuple[Floats, Floats], b: tuple[Floats, Floats]) -> bool:
    """Whether two boxes share more than a tenth of the smaller one's footprint."""
    low, high = np.maximum(a[0], b[0]), np.minimum(a[1], b[1])
    if np.any(high < low):
        return False
    shared = float(np.prod((high - low)[[0, 2]]))
    smaller = min(float(np.prod((box[1] - box[0])[[0, 2]])) for box in (a, b))
    return shared > 0.1 * max(smaller, 1e-12)
