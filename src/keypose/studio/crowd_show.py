"""A crowd that the browser shows: its levels of detail, its steps as messages. It knows no clock and no socket."""

from __future__ import annotations

import itertools
import threading
from collections import deque
from dataclasses import dataclass
from functools import lru_cache
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from keypose.arrays import Array, Floats
from keypose.errors import KeyposeError, ShapeError, UnknownName
from keypose.model import Character, Material, Pose
from keypose.play import detail as lod
from keypose.play import graph as g
from keypose.play import steering
from keypose.play.levels import Level, build
from keypose.studio import messages
from keypose.studio.container import Body, pack

if TYPE_CHECKING:
    from keypose.studio.graphs import Stage

MOST_CHARACTERS = 4000

_SEEN = 0.02  # a morph weight that is never larger is left out
_EXAMPLES = 12  # poses of each clip
_ROOM_M2 = 7.5  # of ground for each character
_KEPT = 4  # characters whose levels are kept
_NUMBERS = itertools.count(1)
_levels: dict[int, tuple[Character, tuple[Level, ...]]] = {}
_levels_lock = threading.Lock()


def levels_of(character: Character, program: g.Program) -> tuple[Level, ...]:
    """Levels of detail of a character, built when they are first asked for; the graph's clips are the examples."""
    from keypose import samples
    from keypose.samples import crowds as built_in

    with _levels_lock:
        found = _levels.get(id(character))
        if found is None:
            if len(_levels) >= _KEPT:
                del _levels[next(iter(_levels))]
            own = character is samples.load("human").character
            found = _levels[id(character)] = (
                character,
                built_in.levels() if own else build(character, examples=_examples(program)),
            )
        return found[1]


def _examples(program: g.Program) -> Pose | None:
    found: list[Pose] = []
    for clip in program.assets:
        frames = np.unique(np.linspace(0, len(clip.rotations) - 1, _EXAMPLES).astype(int))
        found.append(Pose(clip.translations[frames], clip.rotations[frames], clip.scales[frames]))
    if not found:
        return None
    joined = (np.concatenate([getattr(p, field) for p in found]) for field in ("translations", "rotations", "scales"))
    return Pose(*joined)


@dataclass(slots=True)
class View:
    """Where the page looks from."""

    eye: tuple[float, float, float] = (0.0, 6.0, 20.0)
    fov_deg: float = 35.0


@lru_cache(maxsize=_KEPT)
def _first(program: g.Program, dropped: tuple[tuple[str, ...], ...]) -> g.GraphCrowd:
    """A crowd of one, whose compiled clips all others take over."""
    return g.prepare_crowd(program, 1, levels=dropped)


class CrowdShow:
    """A crowd and its steps as messages. It knows no clock and no socket."""

    def __init__(self, stage: Stage, name: str, count: int, behaviour: str, seed: int) -> None:
        program, character = stage.program, stage.character
        if not 1 <= count <= MOST_CHARACTERS:
            raise ShapeError(f"count: expected 1 to {MOST_CHARACTERS} characters, got {count}")
        if behaviour not in steering.BEHAVIOURS:
            raise UnknownName("behaviour", behaviour, steering.BEHAVIOURS)
        _check_driven(program)
        self.number = next(_NUMBERS)
        self.count, self.name, self.character = count, name, character
        self.radius_m = max(7.0, float(np.sqrt(count * _ROOM_M2 / np.pi)))
        self.levels = levels_of(character, program)
        heights = np.asarray(self.levels[-1].mesh.positions)[:, 1]
        self.height_m = float(heights.max() - min(heights.min(), 0.0))
        self.unit_m = 2.0 * max(self.height_m, 1e-3) / 32767
        self.steering = steering.init(count, self.radius_m, behaviour, seed)
        joints = character.skeleton.names
        dropped = tuple(_dropped(joints, level, character.skeleton.parents) for level in self.levels[1:])
        roots = steering.place(count, self.radius_m, seed)
        self.crowd = g.prepare_crowd(program, count, roots=roots, levels=dropped, like=_first(program, dropped))
        self.detail = lod.prepare(self.levels, count)
        self.seed = seed
        self._morphs = _used_morphs(program, character)
        self.time_s, self._frames = 0.0, 0
        self._costs: deque[tuple[float, float]] = deque(maxlen=30)

    def ready(self) -> bytes:
        """Everything about the crowd that stays as it is."""
        body = Body()
        materials = list(dict.fromkeys(part.material for part in self.character.parts))
        number = {id(material): n for n, material in enumerate(materials)}
        of_part = np.array([number[id(part.material)] for part in self.character.parts])
        header = messages.CrowdReady(
            type="crowd_ready",
            crowd=self.number,
            graph=self.name,
            count=self.count,
            radius_m=self.radius_m,
            height_m=self.height_m,
            unit_m=self.unit_m,
            behaviours=list(steering.BEHAVIOURS),
            behaviour=self.steering.behaviour,
            materials=[
                messages.CrowdMaterial(m.name, float(m.roughness), float(m.metallic), [float(c) for c in m.emissive])
                for m in materials
            ],
            colors=body.add(np.rint(255 * _srgb(self._colors(materials))), "uint8"),
            morphs=len(self._morphs),
            levels=[self._level(level, of_part, body) for level in self.levels],
        )
        return pack(header, body)

    def _level(self, level: Level, of_part: Array, body: Body) -> messages.CrowdLevel:
        shades = np.ones((level.mesh.vertex_count, 3), np.float32)
        for n, part in enumerate(self.character.parts):
            mine = level.parts == n
            if part.mesh.colors is not None:
                shades[mine] = part.mesh.colors[level.vertices[mine], :3]
        motion = level.motion_error
        return messages.CrowdLevel(
            positions=body.add(level.mesh.positions, "float32"),
            normals=body.add(level.mesh.normals, "float32"),
            triangles=body.add(level.mesh.triangles, "uint32"),
            joints=body.add(level.skin.joints, "uint8"),
            weights=body.add(level.skin.weights, "float32"),
            materials=body.add(of_part[level.parts], "uint8"),
            shades=body.add(shades, "float32"),
            morphs=self._level_morphs(level, body) if level is self.levels[0] and self._morphs else None,
            palette=len(level.skin.palette),
            joint_count=level.joint_count,
            above=level.spec.above,
            every=level.spec.every,
            error_mm=1e3 * level.error.max_m,
            motion_error_mm=0.0 if motion is None else 1e3 * motion.max_m,
        )

    def _level_morphs(self, level: Level, body: Body) -> messages.MorphData:
        """What the graph's curves move, for the finest level, which has all vertices where they are."""
        names, rows = self.character.morph_names, dict[str, list[tuple[Array, Array, Array]]]()
        for n, part in enumerate(self.character.parts):
            if part.morphs is None or part.morph_channels is None:
                continue
            place = np.full(part.mesh.vertex_count, -1)
            place[level.vertices[level.parts == n]] = np.nonzero(level.parts == n)[0]
            for target, channel in enumerate(part.morph_channels):
                at = slice(int(part.morphs.starts[target]), int(part.morphs.starts[target + 1]))
                moved, turned = part.morphs.position_deltas[at], part.morphs.normal_deltas
                vertices = place[part.morphs.vertices[at]]
                turned = np.zeros_like(moved) if turned is None else turned[at]
                shown = vertices >= 0
                rows.setdefault(names[channel], []).append((vertices[shown], moved[shown], turned[shown]))
        starts, found = [0], list[tuple[Array, Array, Array]]()
        for name in self._morphs:
            found += rows[name]
            starts.append(starts[-1] + sum(len(r[0]) for r in rows[name]))
        vertices, moved, turned = (np.concatenate([r[k] for r in found]) for k in range(3))
        return messages.MorphData(
            channels=body.add(np.arange(len(self._morphs)), "int32"),
            starts=body.add(starts, "uint32"),
            vertices=body.add(vertices, "uint32"),
            position_deltas=body.add(moved, "float32"),
            normal_deltas=body.add(turned, "float32"),
        )

    def _colors(self, materials: list[Material]) -> Floats:
        from keypose.samples import crowds as built_in
        from keypose.samples.human import NAME

        if self.character.name == NAME:
            return built_in.outfits(materials, self.count, self.seed)
        return varied(materials, self.count, self.seed)

    def step(self, dt_s: float, view: View) -> bytes:
        """Move everybody on by a time, 0 to stand; the frame as it is sent."""
        began = perf_counter()
        heights = lod.view_heights(self.crowd.roots[:, :2], np.array(view.eye), self.height_m, view.fov_deg)
        changed = lod.choose(self.detail, heights)
        if len(changed):
            self._drop_joints()
        chosen = perf_counter()
        if dt_s > 0 or self._frames == 0:
            self._move(dt_s or 1e-3)
        moved = perf_counter()
        updates = lod.matrices(self.detail, self.crowd.models, self.crowd.roots, self._due(dt_s), self.unit_m)
        body = Body()
        self._frames += 1
        steer_us, animate_us = np.mean(self._costs, axis=0).tolist()
        header = messages.CrowdFrame(
            type="crowd_frame",
            crowd=self.number,
            number=self._frames,
            time_s=self.time_s,
            dt_s=dt_s,
            roots=body.add(self.crowd.roots, "float32"),
            levels=body.add(self.detail.level, "uint8"),
            updates=[
                messages.CrowdUpdate(
                    body.add(who, "uint16"),
                    body.add(small.view(np.uint16), "uint16"),
                    body.add(self._weights(who if n == 0 else who[:0]), "uint8"),
                )
                for n, (who, small) in enumerate(updates)
            ],
            steer_us=steer_us,
            animate_us=animate_us,
            pack_us=1e6 * (perf_counter() - moved + chosen - began),
        )
        return pack(header, body)

    def _weights(self, who: Array) -> Array:
        weights = self.crowd.morph_weights[who][:, list(self._morphs.values())]
        return np.rint(255 * np.clip(weights, 0.0, 1.0))

    def _due(self, dt_s: float) -> list[Any]:
        """Whose joints are sent: where time stands, only those of characters with a new level."""
        if dt_s > 0 or self._frames == 0:
            return lod.begin(self.detail)
        fresh = [np.nonzero(f)[0] for f in self.detail.fresh]
        for flags in self.detail.fresh:
            flags[:] = False
        return fresh

    def _move(self, dt_s: float) -> None:
        began = perf_counter()
        s, crowd = self.steering, self.crowd
        if steering.step(s, crowd.roots, dt_s):
            known = crowd.program.inputs
            for name in ("speed", "turn", "wave", "look", "look_at"):
                if name in known:
                    g.set_parameter(crowd, name, getattr(s, name))
            if "jump" in known and s.jump.any():
                g.set_parameter(crowd, "jump", 1.0, np.nonzero(s.jump)[0])
        steered = perf_counter()
        g.animate_crowd(crowd, dt_s)
        self.time_s += dt_s
        done = perf_counter()
        if self._frames == 2:
            self._costs.clear()  # the first steps also load the kernels
        self._costs.append((1e6 * (steered - began), 1e6 * (done - steered)))

    def _drop_joints(self) -> None:
        """A block of the crowd needs the joints of its finest character."""
        blocks = len(self.crowd.level)
        finest = np.full(blocks * self.crowd.models.shape[-1], len(self.levels) - 1)
        finest[: self.count] = self.detail.level
        self.crowd.level[:] = finest.reshape(blocks, -1).min(axis=1)


def _check_driven(program: g.Program) -> None:
    """Raises `KeyposeError` for a graph that cannot be steered."""
    for name in ("speed", "turn"):
        if name not in program.inputs or program.inputs[name].definition.kind != "float":
            raise KeyposeError(
                f"a crowd is steered by the parameters 'speed' (m/s) and 'turn' (degrees per second); the graph has "
                f"{', '.join(repr(n) for n in program.inputs) or 'none'}"
            )


def _used_morphs(program: g.Program, character: Character) -> dict[str, int]:
    """The curves that a clip ever moves and a part has morphs for, and their numbers."""
    driven = {
        character.morph_names[channel]
        for part in character.parts
        if part.morph_channels is not None
        for channel in part.morph_channels
    }
    peaks = np.max([np.abs(clip.curves).max(axis=0) for clip in program.assets], axis=0) if program.assets else ()
    return {
        name: n
        for n, (name, peak) in enumerate(zip(program.curve_names, peaks, strict=False))
        if peak > _SEEN and name in driven
    }


def _dropped(names: tuple[str, ...], level: Level, parents: Array) -> tuple[str, ...]:
    """Joints that no vertex of the level needs, neither itself nor for a joint below."""
    needed = np.zeros(len(names), bool)
    needed[level.skin.palette] = True
    needed |= np.asarray(parents) < 0
    for joint in range(len(names) - 1, -1, -1):
        if needed[joint] and parents[joint] >= 0:
            needed[parents[joint]] = True
    return tuple(name for name, kept in zip(names, needed, strict=True) if not kept)


def varied(materials: list[Material], count: int, seed: int) -> Floats:
    """Colours of each material for each of ``count`` characters, linear RGB (count, M, 3): the own ones, lighter, darker and
    turned a little in hue, the first as they are."""
    rng = np.random.default_rng(seed)
    own = np.array([m.base_color[:3] for m in materials], np.float64)
    gray = own.mean(axis=1, keepdims=True)
    angle = rng.normal(0.0, 0.5, (count, len(materials), 1))
    angle[0] = 0.0
    # Turned about the grey axis, light kept.
    away = own - gray
    axis = np.full(3, 3**-0.5)
    turned = away * np.cos(angle) + np.cross(np.broadcast_to(axis, away.shape), away) * np.sin(angle)
    light = np.exp(rng.normal(0.0, 0.2, (count, 1, 1)))
    light[0] = 1.0
    return np.clip((gray + turned) * light, 0.0, 1.0)


def _srgb(linear: Floats) -> Floats:
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055)
