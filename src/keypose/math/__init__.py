"""Pure functions of arrays: quaternions, Euler angles, dual quaternions, rigid transforms, splines."""

from keypose.math import dualquat, euler, quat, rigid, spline

__all__ = ["dualquat", "euler", "quat", "rigid", "spline"]
