"""Measurements on motion: where feet touch the ground, what a conversion changed."""

from keypose.analysis.contacts import contact_changes, find_contacts
from keypose.analysis.roundtrip import RoundtripError, roundtrip_error

__all__ = ["RoundtripError", "contact_changes", "find_contacts", "roundtrip_error"]
