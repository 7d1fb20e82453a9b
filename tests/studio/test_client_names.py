"""Which names of a clip move which joints and controls: the page's answer is `keypose.rig.baking.bound`'s."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from client_node import answers, client_program

from keypose.math import quat
from keypose.model import Channel, Clip, Control, Curve, CurveKind, Pose, Property, Rig, Skeleton
from keypose.rig import rigged_skeleton
from keypose.rig.baking import bound

SCRIPT = """
import { matchRig } from "@/anim/matching";
function answer({ names, controls, animated }) {
  return { found: [...matchRig(animated, { names, jointCount: names.length - controls })] };
}
"""
CONTROLS = ("head", "hand.L", "Root", "spine.1")
BODIES = (
    ("Hips", "Head", "mixamorig:Spine", "hand_l"),
    ("Bip|Hips", "Bip|HEAD", "b:root"),
)


def test_names_of_joints_and_controls_agree(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    words = (
        "head",
        "Head",
        "x:head",
        "Armature|Head",
        "hand.L",
        "Hand.l",
        "a:hand.L",
        "Root",
        "root",
        "b:root",
        "Hips",
        "HIPS",
        "Spine",
    )
    asked, expected = list[Any](), list[Any]()
    for n in range(60):
        names = BODIES[n % 2]
        animated = [str(w) for w in rng.permutation(words)[: rng.integers(1, len(words))]]
        skeleton, rig = _chain(names), Rig("r", "c", _chain(CONTROLS), tuple(Control(c) for c in CONTROLS))
        turn = Curve([0.0], [[1.0, 0.0, 0.0, 0.0]], kind=CurveKind.ROTATION)
        # a curve of its own for every name tells which one is left under which
        curves = {
            Channel(w, Property.ROTATION): Curve([float(k)], turn.values, kind=CurveKind.ROTATION)
            for k, w in enumerate(animated)
        }
        found = bound(Clip(curves, "c"), rig, skeleton)
        assert isinstance(found, Clip)
        expected.append({c.target: animated[int(v.times_s[0])] for c, v in found.curves.items()})
        asked.append(
            {"names": list(rigged_skeleton(rig, skeleton).names), "controls": len(CONTROLS), "animated": animated}
        )
    program = client_program(SCRIPT, tmp_path)
    for got, wanted in zip(answers(program, *asked), expected, strict=True):
        assert dict(got["found"]) == wanted
    assert any("hand.L" in wanted for wanted in expected)


def _chain(names: tuple[str, ...]) -> Skeleton:
    count = len(names)
    rest = Pose(np.zeros((count, 3)), quat.identity((count,)), np.ones((count, 3)))
    return Skeleton(names, np.arange(-1, count - 1, dtype=np.int32), rest)
