"""Rigs: controls over a skeleton, made for any humanoid, evaluated, fitted to motions and baked to joints."""

from keypose.rig.auto import auto_rig
from keypose.rig.baking import bake_rig, bake_rig_timeline, is_keyed, perform, rigged_skeleton, sample_rig
from keypose.rig.expressions import Expression, parse_expression
from keypose.rig.fitting import RigFit, fit_controls, match_fk_to_ik, match_ik_to_fk, switch_space
from keypose.rig.mirroring import mirror_controls
from keypose.rig.plan import check_rig
from keypose.rig.solve import RigResult, evaluate_rig, solve_rig

__all__ = [
    "Expression",
    "RigFit",
    "RigResult",
    "auto_rig",
    "bake_rig",
    "bake_rig_timeline",
    "check_rig",
    "evaluate_rig",
    "fit_controls",
    "is_keyed",
    "match_fk_to_ik",
    "match_ik_to_fk",
    "mirror_controls",
    "parse_expression",
    "perform",
    "rigged_skeleton",
    "sample_rig",
    "solve_rig",
    "switch_space",
]
