"""Measurements on motion: what a conversion changed."""

from keypose.analysis.roundtrip import RoundtripError, roundtrip_error

__all__ = ["RoundtripError", "roundtrip_error"]
