"""glTF 2.0: ``read`` and ``write``."""

from keypose.io.gltf.reader import read
from keypose.io.gltf.writer import write

__all__ = ["read", "write"]
