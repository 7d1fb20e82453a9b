"""The real-time runtime: compiled clips, sampled at any time; crowds of them, with level of detail; the animation graph."""

from keypose.play import crowd, detail, graph, levels, steering
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
    "detail",
    "from_bytes",
    "graph",
    "levels",
    "sample",
    "sample_rows",
    "sample_weights",
    "steering",
    "to_bytes",
]
