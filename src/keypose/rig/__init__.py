"""Rigs: controls over a skeleton, made for any humanoid, evaluated, fitted to motions and baked to joints."""

from keypose.rig.auto import auto_rig
from keypose.rig.expressions import Expression, parse_expression
from keypose.rig.plan import check_rig
from keypose.rig.solve import RigResult, evaluate_rig, solve_rig

__all__ = ["Expression", "RigResult", "auto_rig", "check_rig", "evaluate_rig", "parse_expression", "solve_rig"]
