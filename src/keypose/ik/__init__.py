"""Inverse kinematics: closed-form limbs, joints and chains that look at something, chains that reach (CCD, FABRIK), limits of joints."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from keypose.ik.aim import AimChainResult, AimResult, aim_chain, aim_joint
from keypose.ik.chains import ChainResult, chain_between, solve_ccd, solve_fabrik
from keypose.ik.limb import LimbResult, LimbTurns, limb_rotations, rotation_between_frames, solve_limb, solve_limbs
from keypose.ik.limits import (
    Cone,
    EulerRange,
    Hinge,
    JointLimit,
    LimitBreak,
    clamp_pose,
    clamp_rotation,
    find_limit_breaks,
    limit_violation,
)
from keypose.ik.tasks import (
    CenterOfMassTask,
    ContactTask,
    LookAtTask,
    OrientationTask,
    PosePrior,
    PositionTask,
    RelativeTask,
    Smoothness,
    Task,
)

if TYPE_CHECKING:
    from keypose.ik.fullbody import PoseSolver, prepare_solver, solve_pose
    from keypose.ik.fullbody_problem import RootMotion, RootPolicy
    from keypose.ik.fullbody_result import OUTCOMES, IkResult, SolveOptions, TaskResidual
    from keypose.ik.fullbody_window import solve_window

# The solver for whole bodies is loaded on first use: what only asks for limits or limbs does not wait for it.
_SOLVER = {
    "OUTCOMES": "fullbody_result",
    "IkResult": "fullbody_result",
    "RootMotion": "fullbody_problem",
    "RootPolicy": "fullbody_problem",
    "SolveOptions": "fullbody_result",
    "TaskResidual": "fullbody_result",
    "PoseSolver": "fullbody",
    "prepare_solver": "fullbody",
    "solve_pose": "fullbody",
    "solve_window": "fullbody_window",
}

__all__ = [
    "OUTCOMES",
    "AimChainResult",
    "AimResult",
    "CenterOfMassTask",
    "ChainResult",
    "Cone",
    "ContactTask",
    "EulerRange",
    "Hinge",
    "IkResult",
    "JointLimit",
    "LimbResult",
    "LimbTurns",
    "LimitBreak",
    "LookAtTask",
    "OrientationTask",
    "PosePrior",
    "PoseSolver",
    "PositionTask",
    "RelativeTask",
    "RootMotion",
    "RootPolicy",
    "Smoothness",
    "SolveOptions",
    "Task",
    "TaskResidual",
    "aim_chain",
    "aim_joint",
    "chain_between",
    "clamp_pose",
    "clamp_rotation",
    "find_limit_breaks",
    "limb_rotations",
    "limit_violation",
    "prepare_solver",
    "rotation_between_frames",
    "solve_ccd",
    "solve_fabrik",
    "solve_limb",
    "solve_limbs",
    "solve_pose",
    "solve_window",
]


def __getattr__(name: str) -> Any:
    if name in _SOLVER:
        return getattr(importlib.import_module(f"keypose.ik.{_SOLVER[name]}"), name)
    raise AttributeError(f"module 'keypose.ik' has no attribute '{name}'")
