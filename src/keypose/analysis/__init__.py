"""Measurements: which joint is which, where feet touch the ground, what a conversion changed, what is wrong with a file."""

from keypose.analysis.contacts import (
    Footing,
    contact_changes,
    contact_spans,
    find_contacts,
    find_footing,
    foot_contacts,
)
from keypose.analysis.doctor import Examination, Finding, examine
from keypose.analysis.ground import Ground
from keypose.analysis.limits import human_limits
from keypose.analysis.masses import BodyMasses, human_masses
from keypose.analysis.proof import SceneError, scene_error
from keypose.analysis.quality import Quality, TakeDifference, compare_takes, measure_quality
from keypose.analysis.roles import RoleMap, find_roles, roles_from_json
from keypose.analysis.roundtrip import RoundtripError, roundtrip_error

__all__ = [
    "BodyMasses",
    "Examination",
    "Finding",
    "Footing",
    "Ground",
    "Quality",
    "RoleMap",
    "RoundtripError",
    "SceneError",
    "TakeDifference",
    "compare_takes",
    "contact_changes",
    "contact_spans",
    "examine",
    "find_contacts",
    "find_footing",
    "find_roles",
    "foot_contacts",
    "human_limits",
    "human_masses",
    "measure_quality",
    "roles_from_json",
    "roundtrip_error",
    "scene_error",
]
