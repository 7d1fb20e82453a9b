"""What the kernels of the full-body solver share with those who fill their tables: columns, kinds, slots of a joint."""

from __future__ import annotations

POSITION, ORIENTATION, LOOK_AT, CONTACT, PRIOR, ROOT_PRIOR, RELATIVE_PLACE, RELATIVE_TURN, CENTER = range(9)
HINGE, ANGLES, CONE = range(3)
FREE, FIXED, UPRIGHT = range(3)  # kinds of joints
# The state of a solve.
DAMPING, GROWTH, COST, MISS, DONE, CURVED, CALM, STEPS, STATES = range(9)
# Columns of the tables of joints, terms and limits.
J_PARENT, J_KIND, J_LIMIT, J_PRIOR, JOINT_COLUMNS = range(5)
T_KIND, T_JOINT, T_AT, T_OPTION, TERM_COLUMNS = range(5)
L_KIND, L_JOINT, L_HOME, L_I, L_J, L_K, LIMIT_COLUMNS = range(7)
LIMIT_NUMBERS = 20
# After the terms: how many of them couple several bodies and how many bodies that are together, for each such term its
# number, how many bodies and the first of them, and the bodies' joints.
C_COUNT, C_BODIES, C_TERMS = range(3)
C_TERM, C_BODY_COUNT, C_FIRST, COUPLING_COLUMNS = range(4)
WRENCHES = 18  # slots of a body of such a term: three forces and moments
EXTRA = 36  # slots of a solve beside its joints
# What `options` says.
O_TOLERANCE_M, O_TOLERANCE_RAD, O_SETTLED, O_SHRINK, O_GROWTH, O_LEAST = range(6)
O_MOST, O_FLOOR, O_SLOW, O_ROUNDING, O_PASSES, O_STILL, O_CALM, O_FIRM, OPTIONS = range(6, 15)
BOUND = 1e-7  # radians (shares of a cone) within which a joint stands at its bound
SAME = 0.03  # radians between directions that are one
NEAR = 0.05  # radians from a bound within which it is met where a joint stands, not where a step ended

# Slots of one joint, each a vector: rotation and place in the model's space; the sums of tasks, reduced on the way to the
# root (inertia 6, mixed 9, mass 6, torque 3, force 3); plain sums (moment, pull, virial 9); the answer to the parent's turn,
# motion and the pull; the best rotation; step and motion; what is forced; limits; priors; sums saved for a second pass.
TURN, PLACE, INERTIA, MIXED, MASS, TORQUE, FORCE, MOMENT, PULL, VIRIAL = 0, 4, 7, 13, 22, 28, 31, 34, 37, 40
BY_TURN, BY_MOVE, BY_PULL, BEST, STEP, MOTION, FORCED = 49, 58, 67, 70, 74, 77, 84
NORMALS, SIDE, BEST_SIDE, PRIOR_INERTIA, PRIOR_PULL, SAVED = 87, 96, 99, 102, 108, 111
EDGE = 138  # six entries: how a bound that is curved stiffens what is pulled against it, for the curvature
SLOTS, SUMS = 144, 27
