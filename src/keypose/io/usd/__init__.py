"""USD: read through usd-core in a process of its own, written with it."""

from keypose.io.usd.reader import read, read_many
from keypose.io.usd.writer import write

__all__ = ["read", "read_many", "write"]
