"""Pure functions of arrays: quaternions, Euler angles, dual quaternions, rigid transforms, splines."""

from keypose.math import quat, rigid

__all__ = ["quat", "rigid"]
