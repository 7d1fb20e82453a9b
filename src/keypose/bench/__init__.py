"""Benchmarks that print ratios: our kernels beside other libraries, plain NumPy and the machine's own limits.

run("kernels")   every kernel against the same work in plain NumPy, and what the machine can do at best
run("bvh")       reading and writing BVH files against pybvh and PyMotion
run("fk")        forward kinematics of a clip against PyMotion
run("runtime")   compiled clips: their size and error, the time to decode one pose, and crowds that play them; the same
                 rows as of "kernels" where it is the same work, here on compressed clips with scale
run("ik")        limbs, whole bodies and retargeting: against NumPy, mink and published figures
run("io")        reading and writing capture files: C3D against ezc3d and c3d
"""

from __future__ import annotations

from pathlib import Path

from keypose.bench.suite import Result, Suite
from keypose.errors import UnknownName

__all__ = ["SUITES", "Result", "run"]

SUITES = ("kernels", "bvh", "fk", "runtime", "io", "curves", "ik")


def run(name: str | None = None, json_path: str | Path | None = None, rounds: int = 15) -> list[Result]:
    """Run one suite, or all of them, print a table and write the results as JSON if asked.

    A result's ``ratio`` is above 1 where keypose is ahead of its reference. Every value is the 25th percentile over the
    rounds; the rounds run all cases in turn, so that a slow moment of the machine does not hit one case only.

    Raises:
        UnknownName: for a suite that does not exist.
    """
    if name is not None and name not in SUITES:
        raise UnknownName("benchmark", name, SUITES)
    suite = Suite()
    if name in (None, "kernels"):
        from keypose.bench import kernels

        suite.begin("kernels")
        kernels.add(suite)
    if name in (None, "runtime"):
        from keypose.bench import runtime

        suite.begin("runtime")
        runtime.add(suite)
    if name in (None, "bvh", "fk"):
        from keypose.bench import peers

        if name != "fk":
            suite.begin("bvh")
            peers.add_bvh(suite)
        if name != "bvh":
            suite.begin("fk")
            peers.add_fk(suite)
    if name in (None, "curves"):
        from keypose.bench import curves

        suite.begin("curves")
        curves.add(suite)
    if name in (None, "ik"):
        from keypose.bench import ik

        suite.begin("ik")
        ik.add(suite)
    if name in (None, "io"):
        from keypose.bench import io

        suite.begin("io")
        io.add(suite)
    if name in (None, "kernels", "runtime"):
        from keypose.bench import limits

        suite.begin(name or "limits")
        limits.add(suite)
    return suite.run(rounds, None if json_path is None else Path(json_path))
