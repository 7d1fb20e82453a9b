# pyright: basic
"""Whole bodies that reach for targets, beside mink on the same problem: same skeleton, targets and accuracy asked for."""

from __future__ import annotations

import contextlib
import importlib.util
from collections.abc import Callable
from typing import Any

import numpy as np

from keypose.bench import data, plain
from keypose.bench.suite import Suite
from keypose.ik import CenterOfMassTask, PositionTask, SolveOptions, Task, prepare_solver
from keypose.math import quat
from keypose.model import Pose, Skeleton

_ASKED, _ASKED_M = "0.1 mm", 1e-4
_STEPS, _DAMPING = 10, 1e-4
_POSES = 2048  # solved at once: half a minute of frames, or a crowd
_BESIDE = 8  # of them also given to mink


def add(suite: Suite, rng: np.random.Generator) -> None:
    """Five effectors, with their balance or without, and 25 markers of 26 joints, from the rest pose; the root moves freely."""
    parents, offsets = data.body(data.BODY_JOINTS)
    joints = len(parents)
    bent = np.asarray(quat.from_rotation_vector(rng.normal(0, 0.15, (joints, 3))))
    moved = offsets.copy()
    moved[0] += rng.normal(0, 0.02, 3)
    goals = plain.kinematics(parents, bent[None], moved[None])[1]
    more = np.asarray(quat.from_rotation_vector(rng.normal(0, 0.15, (_POSES, joints, 3))))
    moved = np.tile(offsets, (_POSES, 1, 1))
    moved[:, 0] += rng.normal(0, 0.02, (_POSES, 3))
    many = plain.kinematics(parents, more, moved)[1]
    ends = np.setdiff1d(np.arange(joints), parents)
    for effectors, balanced in ((ends, False), (np.arange(1, joints), False), (ends, True)):
        _one(suite, parents, offsets, effectors, goals, many, balanced)


def _one(suite: Suite, parents: Any, offsets: Any, effectors: Any, goal: Any, many: Any, balanced: bool) -> None:
    """The rows of one set of effectors; balanced: with the centre of mass, as if all joints weighed the same."""
    joints, count = len(parents), len(effectors)
    name = f"full-body IK, {joints} joints, {count} effectors{' and balance' if balanced else ''}"
    rest = Pose(offsets, np.tile([1.0, 0, 0, 0], (joints, 1)), np.ones((joints, 3)))
    skeleton = Skeleton(tuple(f"joint{j}" for j in range(joints)), parents, rest)
    at_rest: list[Task] = [PositionTask(int(e), np.zeros(3)) for e in effectors]
    at_rest += [CenterOfMassTask(np.zeros(3), np.ones(joints))] if balanced else []
    whole = SolveOptions(iterations=_STEPS, tolerance_m=1e-15, settled_rad=1e-15, still_m=1e-300)
    asked = SolveOptions(iterations=100, tolerance_m=_ASKED_M)

    def missed(result: Any, places: Any) -> float:
        turns, bones = (np.reshape(a, (-1, *a.shape[-2:])) for a in (result.pose.rotations, result.pose.translations))
        reached = plain.kinematics(parents, turns, bones)[1]
        return float(np.linalg.norm(asked_of(reached) - asked_of(places), axis=-1).max())

    def asked_of(places: Any) -> Any:
        """Where the effectors are, and the centre of mass if it is asked for too."""
        parts = [places[..., effectors, :], places.mean(axis=-2, keepdims=True)]
        return np.concatenate(parts if balanced else parts[:1], axis=-2)

    one, every = asked_of(goal[0]), list(np.ascontiguousarray(np.moveaxis(asked_of(many), 1, 0)))
    beside = min(_BESIDE, len(many))
    full, near, said = _beside(parents, offsets, effectors, many[:beside], balanced)
    for words, options, peer, note, limit in (
        (f"at most {_STEPS} steps", whole, full, said[0], 1e-8), (f"to {_ASKED}", asked, near, said[1], 1.001 * _ASKED_M),
    ):  # fmt: skip
        solver = prepare_solver(skeleton, at_rest, options=options)
        for targets, places, together in ((every, many, f"{len(many)} at once"), (one, goal[0], "one alone")):
            found = solver.solve(targets=targets)
            left, steps = missed(found, places), float(np.mean(found.iterations))
            suite.check(f"{name}, {words}, {together}: distance left (m)", left, limit)
            # the first is the row that the speed study has too, under its name
            own = f"{name}, {_STEPS} steps" if options is whole and targets is every else f"{name}, {words}, {together}"
            suite.case(
                own, "us/solve", found.cost.size,
                lambda solver=solver, targets=targets: solver.solve(targets=targets), peer, "mink", beside,
                f"{steps:.3g} steps, {1e3 * left:.1g} mm off; {note}",
            )  # fmt: skip


def _beside(parents: Any, offsets: Any, effectors: Any, many: Any, balanced: bool) -> tuple[Any, Any, tuple[str, str]]:
    """What mink does, all its steps and only those that the accuracy takes, and how far off that leaves it."""
    if not _installed("mink"):
        return None, None, ("mink not installed", "mink not installed")
    peer = _Mink(parents, offsets, effectors, balanced)
    every, needed = [_STEPS] * len(many), [peer.steps_for(place, _ASKED_M) for place in many]
    off = [max(peer.solved(place, n) for place, n in zip(many, each, strict=True)) for each in (every, needed)]

    def solve(each: list[int]) -> None:
        for place, n in zip(many, each, strict=True):
            peer.solve(place, n)

    said = f"mink {1e3 * off[0]:.1g} mm off", f"mink {1e3 * off[1]:.2g} mm in {np.mean(needed):.1f} steps"
    return lambda: solve(every), lambda: solve(needed), said


class _Mink:
    """The body as a MuJoCo model of ball joints, whose effectors mink brings to targets by Gauss-Newton steps."""

    def __init__(self, parents: Any, offsets: Any, effectors: Any, balanced: bool) -> None:
        import mink  # pyright: ignore[reportMissingImports]
        import mujoco  # pyright: ignore[reportMissingImports]

        self._mink, self._threads = mink, _one_thread()
        models: Any = mujoco
        model = models.MjModel.from_xml_string(_mjcf(parents, offsets))
        self._configuration = mink.Configuration(model)
        self._start = self._configuration.q.copy()
        self._tasks = {
            int(e): mink.FrameTask(f"j{e}", "body", position_cost=1.0, orientation_cost=0.0) for e in effectors
        }
        self._balance = mink.ComTask(cost=1.0) if balanced else None

    def solve(self, goal: Any, steps: int) -> None:
        """So many steps from the rest pose towards places (J, 3)."""
        mink, configuration = self._mink, self._configuration
        with self._threads():
            tasks: list[Any] = list(self._tasks.values())
            for e, task in self._tasks.items():
                task.set_target(mink.SE3.from_translation(goal[e]))
            if self._balance is not None:
                self._balance.set_target(goal.mean(axis=0))
                tasks.append(self._balance)
            configuration.update(self._start)
            for _ in range(steps):
                velocity = mink.solve_ik(configuration, tasks, 1.0, "daqp", damping=_DAMPING, limits=[])
                configuration.integrate_inplace(velocity, 1.0)

    def missed(self, goal: Any) -> float:
        """How far the worst effector, or the centre of mass, is off now."""
        frames = [self._configuration.get_transform_frame_to_world(f"j{e}", "body") for e in self._tasks]
        off = [frame.translation() - goal[e] for frame, e in zip(frames, self._tasks, strict=True)]
        if self._balance is not None:
            off.append(self._balance.compute_error(self._configuration))
        return max(float(np.linalg.norm(each)) for each in off)

    def solved(self, goal: Any, steps: int) -> float:
        """The same after so many steps."""
        self.solve(goal, steps)
        return self.missed(goal)

    def steps_for(self, goal: Any, asked_m: float) -> int:
        """The fewest steps after which every effector is there."""
        return next(n for n in range(1, 1000) if self.solved(goal, n) <= asked_m or n == 999)


def _mjcf(parents: Any, offsets: Any) -> str:
    below: dict[int, list[int]] = {}
    for joint, parent in enumerate(parents):
        below.setdefault(int(parent), []).append(joint)

    def body(joint: int) -> str:
        moves = "<freejoint/>" if parents[joint] < 0 else '<joint type="ball"/>'
        place = " ".join(repr(float(x)) for x in offsets[joint])
        inertia = '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
        return f'<body name="j{joint}" pos="{place}">{moves}{inertia}{"".join(map(body, below.get(joint, [])))}</body>'

    return f"<mujoco><worldbody>{''.join(map(body, below[-1]))}</worldbody></mujoco>"


def _installed(package: str) -> bool:
    return importlib.util.find_spec(package) is not None


def _one_thread() -> Callable[[], Any]:
    """A context that keeps linear algebra on one thread: small matrices on several take mink up to seven times as long."""
    if not _installed("threadpoolctl"):
        return contextlib.nullcontext
    from threadpoolctl import ThreadpoolController  # pyright: ignore[reportMissingImports]

    controller = ThreadpoolController()
    return lambda: controller.limit(limits=1)
