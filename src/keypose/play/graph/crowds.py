"""Crowds of one graph: thousands of characters, each with its own parameters, states and place, stepped by kernels.

A crowd does what `step` does for one character, to a tenth of a millimetre, about a thousand times faster. Its clips are
compiled (`keypose.play.compile_clip`); its states are rows of plain numbers.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cache
from types import ModuleType
from typing import Any

import numpy as np

from keypose.arrays import Array
from keypose.errors import ShapeError, UnknownName
from keypose.math import quat
from keypose.model import Motion, Pose, Skeleton
from keypose.play import crowd as clip_crowd
from keypose.play.clip import CompiledClip, compile_clip, sample
from keypose.play.graph.build import Program
from keypose.play.graph.control import LONGEST_STEP_S, RtClip
from keypose.play.graph.machine import RtMachine
from keypose.play.graph.poses import Buffer, Clips
from keypose.play.graph.program import Change, Fired
from keypose.play.graph.tables import Tables, lower

TOLERANCE_M = 2e-5  # of the compiled clips: with everything else a crowd is within 1e-4 m of the reference
_MARGIN = 256  # room in the queue for events to begin with


@dataclass(frozen=True, slots=True, eq=False)
class GraphCrowd:
    """Characters of one graph and one skeleton; made by `prepare_crowd`, written by `set_parameter` and `animate_crowd`.

    Shapes and units:
        program: the graph with the crowd's compiled clips; `step` with it is the reference for what the crowd does;
            ``source`` is the program that it was made from.
        models: (blocks, J, 12, W) float32, rows of 3x4 matrices model_from_joint (with the character's place in the world,
            where the graph applies root motion), characters in the lanes, joints as in the skeleton.
        roots: (count, 3) float64, where each character is: x m, z m, yaw rad; may be written between steps.
        root_steps: (count, 3) the last step, seen from the root before it.
        morph_weights: (count, M) float32; contacts: (count, E) float32, 0 to 1.
        every: (blocks,) a block of W characters is animated at every so many calls of `animate_crowd`, then by all the time that
            has passed; may be written between steps.
        level: (blocks,) the level of detail of a block, see `prepare_crowd`; may be written between steps.
    """

    program: Program
    source: Program
    count: int
    threads: int
    models: Array = field(repr=False)
    roots: Array = field(repr=False)
    root_steps: Array = field(repr=False)
    morph_weights: Array = field(repr=False)
    contacts: Array = field(repr=False)
    every: Array = field(repr=False)
    level: Array = field(repr=False)
    clips: tuple[CompiledClip, ...] = field(repr=False)
    level_joints: tuple[tuple[str, ...], ...] = field(repr=False)
    tables: Tables = field(repr=False)
    parts: dict[str, Array] = field(repr=False)
    workers: tuple[_Worker, ...] = field(repr=False)
    kernel: ModuleType = field(repr=False)

    @property
    def floats(self) -> Array:
        """All numbers of the characters' states, (count, F) float64."""
        return self.parts["floats"].reshape(self.count, -1)

    @property
    def ints(self) -> Array:
        """All whole numbers of the characters' states, (count, I) int64."""
        return self.parts["ints"].reshape(self.count, -1)

    @property
    def pool_bytes(self) -> int:
        """Memory of decoded samples."""
        return sum(w.clips.pool_bytes for w in self.workers)


@dataclass(slots=True, eq=False)
class _Worker:
    """What one thread needs for itself: a pool of decoded samples, a stack of poses, a queue of events."""

    clips: clip_crowd.Crowd
    numbers: Array
    crowd: Array
    parts: dict[str, Array]
    first: int
    last: int


def prepare_crowd(
    program: Program,
    count: int,
    *,
    parameters: Mapping[str, Any] | None = None,
    roots: Any = None,
    levels: Sequence[Collection[str]] = (),
    threads: int = 1,
    tolerance_m: float = TOLERANCE_M,
    pool_bytes: int = 8 << 20,
    like: GraphCrowd | None = None,
) -> GraphCrowd:
    """A crowd of ``count`` characters that play a graph.

    Shapes and units: ``parameters`` as in `set_parameter`, used at once; ``roots`` (count, 3): x m, z m, yaw rad.
    ``levels``: per level of detail above 0 the joints that are left out (with all below them); each level leaves out at least
    what the one before does. Their matrices are then left as they were. ``threads`` share the characters, each with a pool of
    decoded samples of ``pool_bytes``; the result is the same. ``like``: a crowd of the same program and levels, whose compiled
    clips are taken over; that saves most of the time.

    Raises:
        ShapeError, UnknownName: for numbers that do not fit, parameters or joints that do not exist.
    """
    from keypose.kernels import graphcrowd as kernel
    from keypose.kernels.runtime import WIDTH, aligned

    for name, value in (("count", count), ("threads", threads), ("pool_bytes", pool_bytes)):
        if value < 1:
            raise ShapeError(f"{name}: expected a positive number, got {value}")
    places = np.zeros((count, 3)) if roots is None else np.array(np.broadcast_to(np.asarray(roots, float), (count, 3)))
    skeleton = program.skeleton
    order, kept = _order(skeleton, levels)
    place_of = np.argsort(order)
    bones = _reordered(skeleton, order, place_of)
    tables = lower(program, place_of, np.asarray(bones.parents))
    if like is not None and (like.source is not program or like.clips[0].joint_names != bones.names):
        raise ShapeError("like: expected a crowd of the same program and levels")
    compiled = like.clips if like is not None else tuple(_compiled(program, bones, order, tolerance_m))
    blocks = -(-count // WIDTH)
    threads = min(threads, blocks)
    curves, contacts = len(program.curve_names), len(program.graph.contacts)
    halves = [e.definition.half_life_s for e in program.inputs.values()]
    shared = {
        "floats": np.tile(np.array([*program.floats, 0.0]), count),
        "ints": np.tile(np.array([*program.ints, 0], np.int64), count),
        "numbers_of": np.zeros(count, np.int64),
        "waited": np.zeros(blocks),
        "every": np.ones(blocks, np.int64),
        "level": np.zeros(blocks, np.int64),
        "joints_of": np.full(blocks, skeleton.joint_count, np.int64),
        "kept": np.array(kept, np.int64),
        "half_lives": np.array([*halves, 0.0]),
        "inputs": np.array(
            [n for e in program.inputs.values() for n in (e.slot, e.width, e.definition.kind != "trigger")] + [0],
            np.int64,
        ),
        "roots": places,
        "root_steps": np.zeros((count, 3)),
        "models": aligned(blocks * skeleton.joint_count * 12 * WIDTH),
        "morphs": np.zeros((count, max(curves, 1)), np.float32),
        "touching": np.zeros((count, max(contacts, 1)), np.float32),
        "original": np.asarray(order, np.int64),
        "parents": np.asarray(bones.parents, np.int64),
    }
    extra_count = -(-(curves + 5 * contacts) // 16) * 16
    tables_of = [_extras(a, extra_count) for a in program.assets]
    shared["extra_rows"] = np.concatenate([t.ravel() for t in tables_of] or [np.zeros(1, np.float32)])
    starts = np.cumsum([0, *(t.size for t in tables_of)])[:-1]
    shared["extra_tables"] = (shared["extra_rows"].ctypes.data + 4 * starts).astype(np.int64)
    clip_nodes = sum(isinstance(n, RtClip) for n in tables.nodes)
    clips = [
        clip_crowd.prepare(compiled, bones, WIDTH, clips_each=max(clip_nodes, 1), loop=False, pool_bytes=pool_bytes)
        for _ in range(threads)
    ]
    layout = _RowLayout(clips[0], extra_count, curves, contacts, order)
    shared["resting"] = layout.row(program.resources.rest)
    shared["references"] = layout.rows([layout.row(b) for b in program.resources.references])
    shared["masks"] = layout.rows(layout.masks(program))
    size = layout.size
    memory_size = 2 * size + max(12 * layout.padded + 4 * (size - 4 * layout.padded), 0)
    shared["memories"] = aligned(max(count * tables.memories * memory_size, 1))
    shared["memory_numbers"] = np.zeros(max(count * tables.memories * 4, 1))
    edges = np.linspace(0, blocks, threads + 1).astype(int)
    workers: list[_Worker] = []
    for own, first, last in zip(clips, edges[:-1], edges[1:], strict=True):
        workers.append(_worker(program, tables, own, shared, layout, memory_size, count, int(first), int(last)))
    made = GraphCrowd(
        _playing(program, compiled, place_of),
        program,
        count,
        threads,
        shared["models"].reshape(blocks, skeleton.joint_count, 12, WIDTH),
        shared["roots"],
        shared["root_steps"],
        shared["morphs"][:, :curves],
        shared["touching"][:, :contacts],
        shared["every"],
        shared["level"],
        compiled,
        tuple(tuple(skeleton.names[order[j]] for j in range(n)) for n in kept),
        tables,
        shared,
        tuple(workers),
        kernel,
    )
    for name, values in (parameters or {}).items():
        set_parameter(made, name, values)
    for entry in program.inputs.values():
        at = entry.slot
        made.floats[:, at : at + entry.width] = made.floats[:, at + entry.width : at + 2 * entry.width]
    kernel.start_all(workers[0].crowd.ctypes.data)
    return made


def set_parameter(crowd: GraphCrowd, name: str, values: Any, characters: Any = None) -> None:
    """Set a parameter of all characters, or of some.

    Shapes: ``values`` one for all, or one per character: (), (n,); of vectors (3,), (n, 3). ``characters``: numbers or a mask.
    Values are kept within the parameter's limits; triggers stay set until a transition uses them.

    Raises:
        UnknownName, ShapeError: for a parameter that does not exist or values that do not fit.
    """
    inputs = crowd.program.inputs
    if name not in inputs:
        raise UnknownName("parameter", name, inputs)
    entry = inputs[name]
    p = entry.definition
    who = slice(None) if characters is None else np.asarray(characters)
    rows = crowd.floats[who] if characters is not None else crowd.floats
    shape = (len(rows), entry.width)
    numbers = np.asarray(values, np.float64)
    if entry.width == 1:
        numbers = numbers[..., None]
    try:
        numbers = np.broadcast_to(numbers, shape)
    except ValueError:
        wanted = f"({shape[0]}, 3) or (3,)" if entry.width == 3 else f"({shape[0]},) or a number"
        raise ShapeError(f"parameter '{name}': expected {wanted}, got {np.shape(values)}") from None
    if not np.all(np.isfinite(numbers)):
        raise ShapeError(f"parameter '{name}': expected finite numbers")
    if p.kind in ("bool", "trigger"):
        numbers = (numbers != 0).astype(np.float64)
    elif p.kind == "int" and np.any(numbers != np.floor(numbers)):
        raise ShapeError(f"parameter '{name}': expected whole numbers")
    low = -np.inf if p.minimum is None else p.minimum
    high = np.inf if p.maximum is None else p.maximum
    at = entry.slot + entry.width
    crowd.floats[who, at : at + entry.width] = np.clip(numbers, low, high)
    if p.kind == "trigger":
        crowd.floats[who, entry.slot] = crowd.floats[who, at]


def animate_crowd(crowd: GraphCrowd, dt_s: float) -> Array:
    """Move all characters on by a time above 0 s, up to 60 s; returns ``crowd.models``, which the next call writes again.

    Does for each character what `step` does. `crowd_events` and `crowd_changes` tell what happened.

    Raises:
        ShapeError: for a time that does not fit, or levels and rates (``crowd.level``, ``crowd.every``) that do not exist.
    """
    if not 0 < dt_s <= LONGEST_STEP_S:
        raise ShapeError(f"dt_s: expected a time above 0, up to {LONGEST_STEP_S:g} s, got {dt_s}")
    parts = crowd.parts
    if parts["level"].min() < 0 or parts["level"].max() >= len(parts["kept"]):
        raise ShapeError(f"level: expected 0 to {len(parts['kept']) - 1}, got {parts['level'].max()}")
    if parts["every"].min() < 1 or parts["every"].max() * dt_s > LONGEST_STEP_S:
        raise ShapeError(
            f"every: expected at least 1, and no more than {LONGEST_STEP_S:g} s, got {parts['every'].max()}"
        )
    np.take(parts["kept"], parts["level"], out=parts["joints_of"])
    if len(crowd.workers) == 1:
        _run(crowd, crowd.workers[0], dt_s)
    else:
        first, *others = crowd.workers
        waiting = [_threads(len(others)).submit(_run, crowd, w, dt_s) for w in others]
        _run(crowd, first, dt_s)
        for done in waiting:
            done.result()
    return crowd.models


def crowd_matrices(crowd: GraphCrowd) -> Array:
    """What `animate_crowd` made last, as model_from_joint (count, J, 4, 4) float32, a copy."""
    return clip_crowd.plain_matrices(crowd.models, crowd.count)


def crowd_events(crowd: GraphCrowd) -> list[tuple[int, Fired]]:
    """Events of the last step with the numbers of their characters, each character's in order."""
    from keypose.kernels import graphtables as k

    t = crowd.tables
    found: list[tuple[int, Fired]] = []
    for who, kind, what, node, weight in _queued(crowd):
        if kind == k.EVENT:
            name, data, clip = t.events[what]
            found.append((who, Fired(name, data, clip, t.nodes[node].name, weight)))
    return found


def crowd_changes(crowd: GraphCrowd) -> list[tuple[int, Change]]:
    """Transitions that began in the last step with the numbers of their characters."""
    from keypose.kernels import graphtables as k

    found: list[tuple[int, Change]] = []
    for who, kind, what, node, old in _queued(crowd):
        machine = crowd.tables.nodes[node]
        if kind != k.EVENT and isinstance(machine, RtMachine):
            t = machine.transitions[what]
            names = machine.state_names
            change = Change(machine.name, names[int(old)], names[t.target], t.kind, t.duration_s, kind == k.CUT_SHORT)
            found.append((who, change))
    return found


def _queued(crowd: GraphCrowd) -> list[tuple[int, int, int, int, float]]:
    from keypose.kernels import graphtables as k

    found: list[tuple[int, int, int, int, float]] = []
    for w in crowd.workers:
        used = int(w.numbers[k.QUEUED])
        rows = w.parts["queue"].reshape(-1, k.QUEUE_ROW)[:used].tolist()
        found += [(*row, weight) for row, weight in zip(rows, w.parts["queue_weights"][:used].tolist(), strict=True)]
    return found


@cache
def _threads(count: int) -> ThreadPoolExecutor:
    """Threads that stay: to start one takes as long as a hundred characters."""
    return ThreadPoolExecutor(count, "keypose crowd")


def _run(crowd: GraphCrowd, worker: _Worker, dt_s: float) -> None:
    from keypose.kernels import graphtables as k

    numbers, own, kernel = worker.numbers, worker.crowd, crowd.kernel
    numbers[k.QUEUED] = 0
    resume = kernel.DONE
    while True:
        resume = kernel.animate(own.ctypes.data, worker.first, worker.last, float(dt_s), resume)
        if resume == kernel.DONE:
            break
        # The character that had no room is done again with more.
        for name in ("queue", "queue_weights"):
            longer = np.zeros(2 * len(worker.parts[name]), worker.parts[name].dtype)
            longer[: len(worker.parts[name])] = worker.parts[name]
            worker.parts[name] = longer
        numbers[k.QUEUE], numbers[k.QUEUE_WEIGHTS] = (worker.parts[n].ctypes.data for n in ("queue", "queue_weights"))
        numbers[k.QUEUE_ROOM] *= 2
    own[kernel.CLOCK] += 1


# --- tables ---------------------------------------------------------------------------------------------------------------


def _order(skeleton: Skeleton, levels: Sequence[Collection[str]]) -> tuple[list[int], list[int]]:
    """Joints ordered so that each level of detail is a beginning of the list, parents first; and how many each keeps."""
    last = np.full(skeleton.joint_count, len(levels))
    for number, dropped in enumerate(levels, 1):
        index = {skeleton.index(name) for name in dropped}
        for joint, parent in enumerate(skeleton.parents):
            if joint in index or (parent >= 0 and last[parent] < number):
                last[joint] = min(last[joint], number - 1)
    order = sorted(range(skeleton.joint_count), key=lambda j: -last[j])
    kept = [int(np.sum(last >= number)) for number in range(len(levels) + 1)]
    if kept[-1] == 0:
        raise ShapeError("levels: a level leaves out every joint")
    return order, kept


def _reordered(skeleton: Skeleton, order: Sequence[int], place_of: Array) -> Skeleton:
    parents = [int(place_of[p]) if (p := int(skeleton.parents[j])) >= 0 else -1 for j in order]
    rest = skeleton.rest
    pose = Pose(*(np.asarray(a, np.float64)[list(order)] for a in (rest.translations, rest.rotations, rest.scales)))
    return Skeleton(tuple(skeleton.names[j] for j in order), np.array(parents, np.int64), pose)


def _compiled(program: Program, bones: Skeleton, order: Sequence[int], tolerance_m: float) -> list[CompiledClip]:
    """The graph's clips, and single poses which make room for all translations and scales that are not everywhere alike."""
    index = list(order)
    clips = [
        compile_clip(
            Motion(
                bones.names,
                Pose(a.translations[:, index], a.rotations[:, index], a.scales[:, index]),
                a.rate_hz,
                a.name,
            ),
            bones,
            tolerance_m=tolerance_m,
        )
        for a in program.assets
    ]
    layout = program.resources.layout
    single = [program.resources.rest, *program.resources.references]
    sunk = program.resources.rest.linear.copy()  # planted feet may move the roots
    for root in np.flatnonzero(program.skeleton.parents < 0):
        sunk[3 * int(root) : 3 * int(root) + 3] += 1.0
    single.append(Buffer(program.resources.rest.rotations, sunk))
    for number, buffer in enumerate(single):
        translations = buffer.linear[: 3 * layout.joints].reshape(1, -1, 3)[:, index]
        scales = buffer.linear[layout.scales].reshape(1, -1, 3)[:, index]
        pose = Pose(translations, buffer.rotations[None, index], scales)
        clips.append(compile_clip(Motion(bones.names, pose, 30.0, f"pose {number}"), bones, tolerance_m=tolerance_m))
    return clips


def _playing(program: Program, compiled: Sequence[CompiledClip], place_of: Array) -> Program:
    """The program with the compiled clips in place of those that it was built with."""
    resources = program.resources
    rotations: list[Array] = []
    linear: list[Array] = []
    for clip, old in zip(compiled, resources.clips.linear, strict=False):
        pose = sample(clip, clip.start_s + np.arange(len(old)) / clip.rate_hz, loop=False)
        row = old.copy()
        joints = 3 * len(place_of)
        row[:, :joints] = np.asarray(pose.translations)[:, place_of].reshape(len(old), -1)
        row[:, joints : 2 * joints] = np.asarray(pose.scales)[:, place_of].reshape(len(old), -1)
        rotations.append(quat.align_signs(quat.normalize(np.asarray(pose.rotations, np.float64)[:, place_of])))
        linear.append(row)
    clips = Clips(tuple(rotations), tuple(linear), resources.clips.rates_hz)
    return replace(program, resources=replace(resources, clips=clips))


def _extras(asset: Any, width: int) -> Array:
    """Per frame morph weights, then places, touch and turn of the contacts, (T, X)."""
    frames = len(asset.rotations)
    parts = [asset.curves, asset.effectors.reshape(frames, -1), asset.touching]
    rows = np.concatenate([np.reshape(p, (frames, -1)) for p in parts], axis=1)
    out = np.zeros((frames, width), np.float32)
    out[:, : rows.shape[1]] = rows
    return out


class _RowLayout:
    """Where the numbers of a pose are in a row of the crowd."""

    def __init__(self, clips: clip_crowd.Crowd, extras: int, curves: int, contacts: int, order: Sequence[int]) -> None:
        from keypose.kernels import crowd as k

        self.clips, self.extras, self.curves, self.contacts = clips, extras, curves, contacts
        self.order = np.asarray(order)
        handles = clips.handles
        self.joints, self.padded = int(handles[k.JOINTS]), int(handles[k.PADDED])
        self.moved, self.scaled = int(handles[k.MOVED]), int(handles[k.SCALED])
        self.linear = 3 * (self.moved + self.scaled)
        self.size = 4 * self.padded + self.linear + extras

    def numbers(self, translations: Array, scales: Array, extras: Array) -> Array:
        """The linear part of a row from (J, 3), (J, 3) in the skeleton's order and the extras."""
        row = np.zeros(self.linear + self.extras, np.float32)
        for values, places, width, first in (
            (translations, self.clips.parts["moved_at"], self.moved, 0),
            (scales, self.clips.parts["scaled_at"], self.scaled, 3 * self.moved),
        ):
            for j in range(self.joints):
                at = int(places[j // 16])
                if at >= 0:
                    row[first + np.arange(3) * width + at + j % 16] = values[self.order[j]]
        row[self.linear : self.linear + len(extras)] = extras
        return row

    def row(self, buffer: Buffer) -> Array:
        """A pose as a row."""
        j = self.joints
        rotations = np.zeros((4, self.padded), np.float32)
        rotations[0] = 1.0
        rotations[:, :j] = buffer.rotations[self.order].T
        linear = buffer.linear
        numbers = self.numbers(linear[: 3 * j].reshape(j, 3), linear[3 * j : 6 * j].reshape(j, 3), linear[6 * j :])
        return np.concatenate([rotations.ravel(), numbers])

    def masks(self, program: Program) -> list[Array]:
        """Two rows per mask, the first of all for "everywhere": for layers, and for what is added."""
        resources, rows = program.resources, list[Array]()
        everywhere = (np.ones(self.joints), np.ones(resources.layout.width))
        for joints, linear in (everywhere, *resources.masks):
            turned = np.zeros(self.padded, np.float32)
            turned[: self.joints] = joints[self.order]
            j = self.joints
            extras = linear[6 * j :].copy()
            for added in (False, True):
                if added:
                    extras[self.curves :] = 0.0
                shares = self.numbers(linear[: 3 * j].reshape(j, 3), linear[3 * j : 6 * j].reshape(j, 3), extras)
                rows.append(np.concatenate([turned, shares]))
        return rows

    @staticmethod
    def rows(rows: Sequence[Array]) -> Array:
        """Rows one after another, aligned."""
        from keypose.kernels.runtime import aligned_copy

        return aligned_copy(np.concatenate(rows) if rows else np.zeros(16))


def _worker(
    program: Program,
    tables: Tables,
    clips: clip_crowd.Crowd,
    shared: dict[str, Array],
    layout: _RowLayout,
    memory_size: int,
    count: int,
    first: int,
    last: int,
) -> _Worker:
    from keypose.kernels import graphcrowd as kernel
    from keypose.kernels import graphtables as k
    from keypose.kernels.runtime import WIDTH, aligned

    nodes = len(tables.nodes)
    depth = nodes + 2
    float_count, int_count = len(program.floats) + 1, len(program.ints) + 1
    own: dict[str, Array] = {
        name: np.zeros(nodes + 1, np.int64) for name in ("mode", "at", "order", "pending", "fresh", "seen", "opened")
    }
    own |= {
        name: np.zeros(nodes + 1)
        for name in ("dt", "weight", "at_share", "share", "used", "seconds", "local_dt", "fade", "before")
    }
    own |= {name: np.zeros(depth, np.int64) for name in ("value_a", "value_b", "extra_a", "extra_b")}
    own |= {name: np.zeros(depth) for name in ("value_t", "extra_t", "value_weight")}
    own |= {
        "travel": np.zeros(3 * nodes + 3),
        "queue": np.zeros(k.QUEUE_ROW * _MARGIN, np.int64),
        "queue_weights": np.zeros(_MARGIN),
        "stack": aligned(depth * layout.size),
        "chain": np.zeros(16 * tables.longest_path),
        "start_rows": aligned(max(tables.memories, 1) * layout.size),
        "backup": np.zeros(float_count + int_count),
        "finals": aligned(WIDTH * layout.size),
        "turned": aligned(10 * WIDTH * WIDTH),
        "output": aligned(4 * WIDTH),
        "keeps": np.zeros(len(program.inputs) + 1),
        "node_table": tables.node_table,
        "words": tables.words,
        "reals": tables.reals,
        "handles": clips.handles,
    }
    own["starts"] = (own["start_rows"].ctypes.data + 4 * layout.size * np.arange(max(tables.memories, 1))).astype(
        np.int64
    )
    h: dict[int, Any] = {
        k.NODE_COUNT: nodes, k.NODES: own["node_table"], k.WORDS: own["words"], k.REALS: own["reals"], k.MODE: own["mode"],
        k.DT: own["dt"], k.WEIGHT: own["weight"], k.AT: own["at"], k.AT_SHARE: own["at_share"], k.TRAVEL: own["travel"],
        k.SHARE: own["share"], k.USED: own["used"], k.SECONDS: own["seconds"], k.ORDER: own["order"],
        k.PENDING: own["pending"], k.LOCAL_DT: own["local_dt"], k.FADE: own["fade"], k.BEFORE: own["before"],
        k.FRESH: own["fresh"], k.QUEUE: own["queue"], k.QUEUE_WEIGHTS: own["queue_weights"], k.QUEUE_ROOM: _MARGIN,
        k.CLIP_HANDLES: own["handles"], k.VALUE_A: own["value_a"], k.VALUE_B: own["value_b"], k.EXTRA_A: own["extra_a"],
        k.EXTRA_B: own["extra_b"], k.VALUE_T: own["value_t"], k.EXTRA_T: own["extra_t"],
        k.VALUE_WEIGHT: own["value_weight"], k.STACK: own["stack"], k.POSE: layout.size, k.LINEAR: layout.linear,
        k.EXTRAS: layout.extras, k.SEEN: own["seen"], k.OPEN: own["opened"], k.MEMORIES: shared["memories"],
        k.MEMORY_SIZE: memory_size, k.MEMORY_COUNT: tables.memories, k.MEMORY_NUMBERS: shared["memory_numbers"],
        k.STARTS: own["starts"], k.MASKS: shared["masks"], k.REFERENCES: shared["references"],
        k.RESTING: shared["resting"], k.EXTRA_TABLES: shared["extra_tables"], k.JOINTS: layout.joints,
        k.JOINTS_NOW: layout.joints, k.EFFECTORS: layout.contacts, k.CURVES: layout.curves, k.CHAIN: own["chain"],
        k.PADDED: layout.padded, k.PARENTS: shared["parents"],
    }  # fmt: skip
    numbers = _numbers(h)
    g: dict[int, Any] = {
        kernel.GRAPH: numbers, kernel.CHARACTERS: count, kernel.BLOCKS: len(shared["every"]), kernel.FLOAT_COUNT: float_count,
        kernel.INT_COUNT: int_count, kernel.ALL_FLOATS: shared["floats"], kernel.ALL_INTS: shared["ints"],
        kernel.NUMBERS_OF: shared["numbers_of"], kernel.ROOTS: shared["roots"], kernel.ROOT_STEPS: shared["root_steps"],
        kernel.WAITED: shared["waited"], kernel.EVERY: shared["every"], kernel.JOINTS_OF: shared["joints_of"],
        kernel.INPUTS: shared["inputs"], kernel.INPUT_COUNT: len(program.inputs), kernel.HALF_LIVES: shared["half_lives"],
        kernel.KEEPS: own["keeps"], kernel.BACKUP: own["backup"], kernel.FINALS: own["finals"], kernel.TURNED: own["turned"],
        kernel.MODELS: shared["models"], kernel.MORPHS: shared["morphs"], kernel.TOUCHING: shared["touching"],
        kernel.APPLY_ROOT: int(program.graph.apply_root), kernel.CLOCK: 0, kernel.ORIGINAL: shared["original"],
        kernel.OUTPUT: own["output"],
    }  # fmt: skip
    own["numbers"] = numbers
    return _Worker(clips, numbers, _numbers(g), own, first, last)


def _numbers(values: Mapping[int, Any]) -> Array:
    """Sizes and addresses as one array."""
    out = np.zeros(max(values) + 1, np.int64)
    for at, value in values.items():
        out[at] = value.ctypes.data if isinstance(value, np.ndarray) else value
    return out
