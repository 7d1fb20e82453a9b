"""The real-time runtime: compiled clips, sampled at any time; crowds of them; the animation graph."""

from keypose.play import crowd, graph
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
    "crowd",
    "from_bytes",
    "graph",
    "sample",
    "sample_rows",
    "sample_weights",
    "to_bytes",
]
