"""glTF 2.0: ``read`` and ``write``."""

from keypose.io.gltf.reader import read

__all__ = ["read"]
