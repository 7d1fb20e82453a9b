"""Pure functions of arrays: quaternions, Euler angles, dual quaternions, rigid transforms, splines, easings."""

from keypose.math import dualquat, ease, euler, quat, rigid, rotation_splines, spline, tangents

__all__ = ["dualquat", "ease", "euler", "quat", "rigid", "rotation_splines", "spline", "tangents"]
