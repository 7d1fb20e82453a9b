"""From a definition, a skeleton and clips to a graph that can run."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from keypose.arrays import Floats
from keypose.errors import UnknownName
from keypose.model import Clip, Motion, Skeleton
from keypose.play.graph import control
from keypose.play.graph import definition as d
from keypose.play.graph.assets import ClipAsset, make_asset, marker_pattern
from keypose.play.graph.checking import GraphError, check
from keypose.play.graph.control import RtNode, Value
from keypose.play.graph.machine import RtCondition, RtMachine, RtTransition
from keypose.play.graph.poses import Buffer, Layout, Resources, Solver, clip_rows, sample
from keypose.play.graph.program import Look, PlantFeet, Reach
from keypose.play.graph.solvers import Limb, LookSolver, PlantSolver, ReachSolver, descends, make_limb
from keypose.play.graph.spaces import bands, line, plane
from keypose.play.graph.synchrony import CLOSEST_S, SyncTable, period, table_for


@dataclass(frozen=True, slots=True, eq=False)
class Input:
    """A parameter at run time: the slot of its value (three for vectors), and behind it the slot of what was set."""

    definition: d.Parameter
    slot: int
    width: int


@dataclass(frozen=True, slots=True, eq=False)
class Program:
    """A graph that can run: the tree of nodes, the first state, and what pose programs refer to."""

    graph: d.Graph
    skeleton: Skeleton
    assets: tuple[ClipAsset, ...]
    root: RtNode
    nodes: tuple[RtNode, ...]
    inputs: Mapping[str, Input]
    floats: tuple[float, ...]
    ints: tuple[int, ...]
    memories: int
    curve_names: tuple[str, ...]
    resources: Resources
    dtype: Any


@dataclass(slots=True)
class _Sync:
    """A synchronised group: what its clips must have, and the sequence that the first of them showed."""

    mode: str
    names: tuple[str, ...]
    owner: str
    pattern: tuple[str, ...] = ()


@dataclass(slots=True)
class _Builder:
    graph: d.Graph
    skeleton: Skeleton
    assets: dict[str, ClipAsset]
    layout: Layout
    rest: Buffer
    floats: list[float] = field(default_factory=list[float])
    ints: list[int] = field(default_factory=list[int])
    inputs: dict[str, Input] = field(default_factory=dict[str, Input])
    nodes: list[RtNode] = field(default_factory=list[RtNode])
    memories: int = 0
    masks: list[tuple[Floats, Floats]] = field(default_factory=list["tuple[Floats, Floats]"])
    mask_index: dict[str, int] = field(default_factory=dict[str, int])
    references: list[Buffer] = field(default_factory=list[Buffer])
    solvers: list[Solver] = field(default_factory=list[Solver])


def build(
    graph: d.Graph,
    skeleton: Skeleton,
    clips: Mapping[str, Motion | Clip],
    *,
    morph_names: Sequence[str] | None = None,
    rest_morph_weights: Any = None,
    dtype: Any = None,
) -> Program:
    """Check a graph against a skeleton and clips, and make it ready to run.

    ``clips`` gives an animation for every name of ``graph.clips``. ``morph_names`` are the morph weights that come out
    (those of all clips if not given); ``dtype`` is the precision of the poses that come out (the skeleton's if not given);
    inside, everything is float64.

    Raises:
        GraphError: where the definition is wrong by itself, or names a clip, joint or marker that is not there.
    """
    check(graph)
    names = _curve_names(graph, clips, morph_names)
    rest_curves = np.zeros(len(names)) if rest_morph_weights is None else np.asarray(rest_morph_weights, np.float64)
    if rest_curves.shape != (len(names),):
        raise GraphError(
            "", "rest_morph_weights", f"expected ({len(names)},) to match morph_names, got {rest_curves.shape}"
        )
    root = _joint(skeleton, "", "root", graph.root) if graph.root else 0
    for name, contact in graph.contacts.items():
        _joint(skeleton, "", f"contacts['{name}'].joint", contact.joint)
    assets: dict[str, ClipAsset] = {}
    for name, source in graph.clips.items():
        if name not in clips:
            raise GraphError("", f"clips['{name}']", str(UnknownName("animation", name, clips)))
        if source.root:
            _joint(skeleton, "", f"clips['{name}'].root", source.root)
        assets[name] = make_asset(
            name,
            clips[name],
            source,
            skeleton,
            root=root,
            contacts=graph.contacts,
            curve_names=names,
            rest_curves=rest_curves,
        )
    layout = Layout(skeleton.joint_count, len(names), len(graph.contacts))
    b = _Builder(graph, skeleton, assets, layout, _rest(skeleton, layout, rest_curves, graph))
    _make_inputs(b)
    _make_masks(b, names)
    top = _make(b, graph.output, None)
    nodes = tuple(sorted(b.nodes, key=lambda n: n.index))
    resources = Resources(
        skeleton,
        layout,
        clip_rows(list(assets.values()), layout),
        b.rest,
        tuple(b.masks),
        tuple(b.references),
        tuple(b.solvers),
    )
    kind = skeleton.rest.rotations.dtype if dtype is None else np.dtype(dtype)
    return Program(
        graph,
        skeleton,
        tuple(assets.values()),
        top,
        nodes,
        b.inputs,
        tuple(b.floats),
        tuple(b.ints),
        b.memories,
        names,
        resources,
        kind,
    )


# --- tables -------------------------------------------------------------------------------------------------------------


def _curve_names(graph: d.Graph, clips: Mapping[str, Motion | Clip], wanted: Sequence[str] | None) -> tuple[str, ...]:
    if wanted is not None:
        return tuple(wanted)
    found: dict[str, None] = {}
    for name in graph.clips:
        animation = clips.get(name)
        if isinstance(animation, Motion):
            found.update(dict.fromkeys(animation.morph_names))
        elif animation is not None:
            found.update(dict.fromkeys(c.target for c in animation.curves if c.property.value == "weight"))
    return tuple(found)


def _rest(skeleton: Skeleton, layout: Layout, curves: Floats, graph: d.Graph) -> Buffer:
    from keypose.evaluate import world_rotations_positions

    rest = skeleton.rest
    _, places = world_rotations_positions(skeleton, rest)
    index = [skeleton.index(c.joint) for c in graph.contacts.values()]
    row = layout.row(rest.translations, rest.scales, curves, np.asarray(places)[index], np.zeros(len(index)))
    return Buffer(np.asarray(rest.rotations, np.float64), row)


def _make_inputs(b: _Builder) -> None:
    for name, p in b.graph.parameters.items():
        width = 3 if p.kind == "vector" else 1
        default = p.default if isinstance(p.default, tuple) else (float(p.default),) * width
        slot = len(b.floats)
        b.floats += [*default, *default]
        b.inputs[name] = Input(p, slot, width)


def _make_masks(b: _Builder, curve_names: Sequence[str]) -> None:
    for name, mask in b.graph.masks.items():
        where = f"masks['{name}']"
        joints = np.zeros(b.layout.joints)
        for joint, weight in mask.branches.items():
            top = _joint(b.skeleton, "", f"{where}.branches", joint)
            below = np.zeros(b.layout.joints, bool)
            below[top] = True
            for child, parent in enumerate(b.skeleton.parents):
                below[child] = below[child] or (parent >= 0 and below[parent])
            joints[below] = weight
        for joint, weight in mask.joints.items():
            joints[_joint(b.skeleton, "", f"{where}.joints", joint)] = weight
        if np.any(joints < 0):
            raise GraphError("", where, "expected weights >= 0")
        curves = np.full(len(curve_names), mask.curves.get("*", 0.0))
        for curve, weight in mask.curves.items():
            if curve == "*":
                continue
            if curve not in curve_names:
                raise GraphError("", f"{where}.curves", str(UnknownName("morph", curve, curve_names)))
            curves[curve_names.index(curve)] = weight
        contacts = joints[[b.skeleton.index(c.joint) for c in b.graph.contacts.values()]]
        row = np.concatenate(
            [np.repeat(joints, 3), np.repeat(joints, 3), curves, np.repeat(contacts, 3), contacts, contacts]
        )
        b.mask_index[name] = len(b.masks)
        b.masks.append((np.minimum(joints, 1.0), np.minimum(row, 1.0)))


def _joint(skeleton: Skeleton, node: str, field: str, name: str) -> int:
    try:
        return skeleton.index(name)
    except UnknownName as error:
        raise GraphError(node, field, str(error)) from None


# --- nodes --------------------------------------------------------------------------------------------------------------


def _slots(b: _Builder, floats: int, ints: int) -> tuple[int, int]:
    at = len(b.floats), len(b.ints)
    b.floats += [0.0] * floats
    b.ints += [0] * ints
    return at


def _value(b: _Builder, number: d.Number) -> Value:
    return Value(b.inputs[number].slot, 0.0) if isinstance(number, str) else Value(-1, float(number))


def _keep(b: _Builder, node: RtNode) -> RtNode:
    b.nodes.append(node)
    return node


def _make(b: _Builder, name: str, sync: _Sync | None) -> RtNode:
    node = b.graph.nodes[name]
    index = list(b.graph.nodes).index(name)
    match node:
        case d.ClipNode():
            return _keep(b, _clip(b, name, index, node, sync))
        case d.RestNode():
            return _keep(b, control.RtRest(name, index, False))
        case d.Blend1D() | d.Blend2D() | d.Blend():
            return _keep(b, _mix(b, name, index, node, sync))
        case d.Layer():
            base, top = _make(b, node.base, sync), _make(b, node.layer, None)
            mask = b.mask_index[node.mask] if node.mask else -1
            return _keep(b, control.RtTop(name, index, base.synced, base, top, _value(b, node.weight), mask, -1, 1.0))
        case d.Additive():
            base, top = _make(b, node.base, sync), _make(b, node.delta, None)
            mask = b.mask_index[node.mask] if node.mask else -1
            weight = _value(b, node.weight)
            reference = len(b.references)
            b.references.append(_reference(b, name, node))
            return _keep(b, control.RtTop(name, index, base.synced, base, top, weight, mask, reference, 10.0))
        case d.TimeWarp():
            base = _make(b, node.input, sync)
            return _keep(b, control.RtWarp(name, index, base.synced, base, _value(b, node.speed)))
        case d.Steer():
            base = _make(b, node.input, sync)
            way, _ = _slots(b, 3, 0)
            return _keep(b, control.RtSteer(name, index, base.synced, base, _value(b, node.turn_deg_s), way))
        case d.StateMachine():
            return _keep(b, _machine(b, name, index, node))
        case d.LookAt():
            solver: Solver = _look(b, name, node)
            kind, target = Look, b.inputs[node.target].slot
        case d.TwoBone():
            chain = [_joint(b.skeleton, name, f, getattr(node, f)) for f in ("upper", "middle", "end")]
            solver = ReachSolver(b.skeleton, b.layout, _limb(b, name, "end", chain, node.softness_m))
            kind, target = Reach, b.inputs[node.target].slot
        case d.Plant():
            solver = _plant(b, name, node)
            kind, target = PlantFeet, -1
    base = _make(b, node.input, sync)
    b.solvers.append(solver)
    aim = control.RtAim(name, index, base.synced, base, kind, len(b.solvers) - 1, target, _value(b, node.weight))
    return _keep(b, aim)


def _clip(b: _Builder, name: str, index: int, node: d.ClipNode, sync: _Sync | None) -> RtNode:
    asset = b.assets[node.clip]
    number = list(b.assets).index(node.clip)
    table = _table(name, asset, node, sync) if sync and node.sync else None
    time, loop = _slots(b, 2, 1)
    return control.RtClip(
        name,
        index,
        table is not None,
        asset,
        number,
        _value(b, node.speed),
        node.loops,
        node.start,
        node.warp,
        table,
        time,
        time + 1,
        loop,
    )


def _table(name: str, asset: ClipAsset, node: d.ClipNode, sync: _Sync) -> SyncTable | None:
    if asset.duration_s <= 0:
        return None
    if sync.mode == "phase":
        sync.pattern = ("start",)
        return SyncTable((0.0,), asset.duration_s)
    markers = [(t, n) for t, n in marker_pattern(asset.markers, sync.names) if t < asset.duration_s]
    if not markers:
        return None
    names = [n for _, n in markers]
    if not sync.pattern:
        sync.pattern = period(names)
    # Times as they are played, before the warp bends them.
    played = [(_unwarped(node.warp, t / asset.duration_s) * asset.duration_s, n) for t, n in markers]
    for (a, first), (b, second) in itertools.pairwise(played):
        if b - a < CLOSEST_S:
            raise GraphError(name, "", f"clip '{asset.name}': markers '{first}' and '{second}' are {b - a:g} s apart")
    table = table_for(played, sync.pattern, asset.duration_s)
    if table is None:
        raise GraphError(
            name,
            "",
            f"clip '{asset.name}' has the sync markers {', '.join(names)}; the group of '{sync.owner}' repeats "
            + ", ".join(sync.pattern),
        )
    return table


def _unwarped(warp: tuple[tuple[float, float], ...], share: float) -> float:
    for (x0, y0), (x1, y1) in itertools.pairwise(warp):
        if share <= y1:
            return x0 + (x1 - x0) * (share - y0) / (y1 - y0)
    return share


def _group(name: str, node: d.Blend1D | d.Blend2D | d.Blend | d.StateMachine, above: _Sync | None) -> _Sync | None:
    """The group its children belong to: that above, unless the node opens one of its own."""
    if isinstance(node, d.StateMachine):
        above = None
    if node.sync == "none":
        return above
    names = node.markers or ("*.down",)
    if above is not None and above.mode == node.sync and (node.sync == "phase" or above.names == names):
        return above
    return _Sync(node.sync, names, name)


def _mix(b: _Builder, name: str, index: int, node: d.Blend1D | d.Blend2D | d.Blend, above: _Sync | None) -> RtNode:
    sync = _group(name, node, above)
    entries = node.inputs if isinstance(node, d.Blend) else node.samples
    children = tuple(_make(b, entry.node, sync) for entry in entries)
    grouped = any(c.synced for c in children)
    if sync is not None and sync is not above and not grouped:
        raise GraphError(name, "sync", f"none of its clips has the markers {', '.join(sync.names)}")
    match node:
        case d.Blend1D():
            weigher: control.Weigher = LineWeigher(line([float(s.at) for s in node.samples]), _value(b, node.parameter))
        case d.Blend2D():
            places = [(float(s.at[0]), float(s.at[1])) for s in node.samples]
            space = plane(places) if node.method == "delaunay" else bands(places)
            weigher = PlaneWeigher(space, _value(b, node.x), _value(b, node.y))
        case d.Blend():
            weigher = ShareWeigher(tuple(_value(b, i.weight) for i in node.inputs))
    share, interval = _slots(b, 1, 2)
    pattern = len(sync.pattern) if sync is not None and grouped else 1
    return control.RtMix(
        name,
        index,
        grouped and sync is above,
        children,
        weigher,
        grouped and sync is not None,
        max(pattern, 1),
        interval,
        interval + 1,
        share,
    )


def _machine(b: _Builder, name: str, index: int, node: d.StateMachine) -> RtNode:
    sync = _group(name, node, None)
    states = tuple(_make(b, below, sync) for below in node.states.values())
    names = tuple(node.states)
    if sync is not None and not any(s.synced for s in states):
        raise GraphError(name, "sync", f"none of its states has the markers {', '.join(sync.names)}")
    transitions = tuple(
        RtTransition(
            -1 if t.source == "*" else names.index(t.source),
            names.index(t.target),
            tuple(
                RtCondition(_value(b, c.parameter), c.test, c.value, b.graph.parameters[c.parameter].kind == "trigger")
                for c in t.conditions
            ),
            t.exit_time,
            t.kind,
            t.duration_s,
            t.interrupt,
            t.sync,
        )
        for t in node.transitions
    )
    floats, ints = _slots(b, 7, 6)
    b.memories += 1
    entry = names.index(node.entry) if node.entry else 0
    return RtMachine(name, index, False, states, names, transitions, entry, b.memories - 1, ints, floats)


def _reference(b: _Builder, name: str, node: d.Additive) -> Buffer:
    if node.reference == "rest":
        return b.rest
    asset = b.assets[node.reference]
    if not 0 <= node.reference_s <= asset.duration_s:
        raise GraphError(
            name, "reference_s", f"{node.reference_s:g} s is outside clip '{asset.name}' of {asset.duration_s:g} s"
        )
    return sample(clip_rows([asset], b.layout), 0, node.reference_s)


def _look(b: _Builder, name: str, node: d.LookAt) -> Solver:
    chain = sorted((_joint(b.skeleton, name, "joints", joint), share) for joint, share in node.joints.items())
    joints, shares = tuple(j for j, _ in chain), tuple(float(s) for _, s in chain)
    if not descends(b.skeleton, joints):
        raise GraphError(name, "joints", "expected joints of one chain, each below the one before")
    forward = np.array(node.forward) / math.hypot(*node.forward)
    return LookSolver(b.skeleton, b.layout, joints, shares, forward, math.radians(node.limit_deg))


def _limb(b: _Builder, name: str, field: str, chain: Sequence[int], softness_m: float) -> Limb:
    if not descends(b.skeleton, chain):
        named = ", ".join(f"'{b.skeleton.names[j]}'" for j in chain)
        raise GraphError(name, field, f"expected three joints, each below the one before, got {named}")
    return make_limb(b.skeleton, chain, softness_m)


def _plant(b: _Builder, name: str, node: d.Plant) -> Solver:
    feet: list[tuple[int, int, Limb]] = []
    contacts = list(b.graph.contacts)
    chosen = node.contacts or tuple(c for c in contacts if b.graph.contacts[c].limb)
    if not chosen:
        raise GraphError(name, "contacts", "no contact of the graph names a limb")
    for contact in chosen:
        entry = b.graph.contacts[contact]
        joint = b.skeleton.index(entry.joint)
        upper = _joint(b.skeleton, name, f"contact '{contact}'", entry.limb)
        path = [joint]
        while path[-1] != upper:
            parent = int(b.skeleton.parents[path[-1]])
            if parent < 0:
                raise GraphError(name, "contacts", f"'{entry.joint}' does not hang below '{entry.limb}'")
            path.append(parent)
        path.reverse()
        if len(path) < 3:
            raise GraphError(name, "contacts", f"expected two bones between '{entry.limb}' and '{entry.joint}'")
        # Upper, middle and end are the first three of the chain: thigh, shin, foot; the contact may lie further out.
        feet.append((contacts.index(contact), joint, _limb(b, name, "contacts", path[:3], 0.0)))
    heights = [a.effectors[:, :, 1].min(axis=0) for a in b.assets.values()]
    floors = np.min(heights, axis=0) if heights else np.full(len(contacts), -np.inf)
    return PlantSolver(b.skeleton, b.layout, tuple(feet), floors)


# --- weights --------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class LineWeigher(control.Weigher):
    """A 1D blend space at a parameter."""

    space: Any
    at: Value

    def weights(self, m: control.Moment) -> list[float]:
        """One weight per sample."""
        return self.space.weights(self.at.of(m))


@dataclass(frozen=True, slots=True, eq=False)
class PlaneWeigher(control.Weigher):
    """A 2D blend space at two parameters."""

    space: Any
    x: Value
    y: Value

    def weights(self, m: control.Moment) -> list[float]:
        """One weight per sample."""
        return self.space.weights(self.x.of(m), self.y.of(m))


@dataclass(frozen=True, slots=True, eq=False)
class ShareWeigher(control.Weigher):
    """Weights as they are given, made to sum to 1."""

    values: tuple[Value, ...]

    def weights(self, m: control.Moment) -> list[float]:
        """One weight per input."""
        raw = [max(v.of(m), 0.0) for v in self.values]
        total = sum(raw)
        if not total > 0:
            return [1.0] + [0.0] * (len(raw) - 1)
        return [w / total for w in raw]
