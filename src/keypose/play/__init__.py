"""The real-time runtime: compiled clips, sampled at any time; the animation graph."""

from keypose.play import graph
from keypose.play.clip import (
    CompiledClip,
    CompileError,
    compile_clip,
    from_bytes,
    sample,
    sample_rows,
    sample_weights,
    to_bytes,
)

__all__ = [
    "CompileError",
    "CompiledClip",
    "compile_clip",
    "from_bytes",
    "graph",
    "sample",
    "sample_rows",
    "sample_weights",
    "to_bytes",
]
