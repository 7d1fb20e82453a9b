"""Pure functions of arrays: quaternions, Euler angles, dual quaternions, rigid transforms, splines."""
