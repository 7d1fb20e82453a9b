"""FBX: read through ufbx in a process of its own, written as binary 7.4."""

from keypose.io.fbx.reader import read, read_many
from keypose.io.fbx.writer import write

__all__ = ["read", "read_many", "write"]
