"""Inverse kinematics: closed-form limbs, joints and chains that look at something, chains that reach (CCD, FABRIK), limits of joints."""

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

__all__ = [
    "AimChainResult",
    "AimResult",
    "ChainResult",
    "Cone",
    "EulerRange",
    "Hinge",
    "JointLimit",
    "LimbResult",
    "LimbTurns",
    "LimitBreak",
    "aim_chain",
    "aim_joint",
    "chain_between",
    "clamp_pose",
    "clamp_rotation",
    "find_limit_breaks",
    "limb_rotations",
    "limit_violation",
    "rotation_between_frames",
    "solve_ccd",
    "solve_fabrik",
    "solve_limb",
    "solve_limbs",
]
