"""Inverse kinematics: closed-form limbs."""

from keypose.ik.limb import LimbResult, limb_rotations, rotation_between_frames, solve_limb

__all__ = ["LimbResult", "limb_rotations", "rotation_between_frames", "solve_limb"]
