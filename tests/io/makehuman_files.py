"""A tiny figure in MakeHuman's files: a box for a body, a helper box, two joint cubes, two bones."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

SIGNS = np.array([[x, y, z] for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)], float)
FACES = ((1, 3, 4, 2), (5, 6, 8, 7), (1, 2, 6, 5), (3, 7, 8, 4), (1, 5, 7, 3), (2, 4, 8, 6))
BOXES = (
    ("body", (0, 0, 0), (2, 8, 1)),
    ("helper-l-eye", (0.5, 6, 1), (0.2, 0.2, 0.2)),
    ("helper-skirt", (0, -4, 0), (3, 3, 3)),
    ("joint-low", (0, -6, 0), (0.1, 0.1, 0.1)),
    ("joint-high", (0, 2, 0), (0.1, 0.1, 0.1)),
    ("joint-tip", (0, 7, 0), (0.1, 0.1, 0.1)),
)
BVH = """HIERARCHY
ROOT low
{
OFFSET 0 0 -6
CHANNELS 6 Xposition Yposition Zposition Xrotation Yrotation Zrotation
JOINT high
{
OFFSET 0 0 8
CHANNELS 3 Xrotation Yrotation Zrotation
End Site
{
OFFSET 0 0 5
}
}
}
MOTION
Frames: 2
Frame Time: 0.041667
0 0 0 0 0 0 0 0 0
0 0 0 0 0 0 90 0 0
"""


def skeleton() -> dict[str, object]:
    cubes = {name: list(range(8 * k, 8 * k + 8)) for k, (name, _, _) in enumerate(BOXES)}
    return {
        "name": "tiny",
        "bones": {
            "high": {"head": "h", "tail": "t", "parent": "low", "rotation_plane": "p"},
            "low": {"head": "l", "tail": "h", "parent": None, "rotation_plane": "p"},
        },
        "joints": {"l": cubes["joint-low"], "h": cubes["joint-high"], "t": cubes["joint-tip"]},
        "planes": {"p": ["l", "h", "t"]},
        "weights_file": "tiny.mhw",
    }


def weights() -> dict[str, object]:
    low, high = [], []
    for vertex in range(16):  # body and eye
        top = SIGNS[vertex % 8, 1] > 0 or vertex >= 8
        (high if top else low).append([vertex, 0.5])
    return {"name": "tiny weights", "weights": {"low": low, "high": high}}


def write_figure(folder: Path) -> Path:
    """All files; the path of the skeleton."""
    lines: list[str] = []
    for _, middle, size in BOXES:
        lines += ["v {:.4f} {:.4f} {:.4f}".format(*(np.array(middle) + SIGNS[i] * size)) for i in range(8)]
    for k, (name, _, _) in enumerate(BOXES):
        lines += [f"g {name}", *("f " + " ".join(str(8 * k + i) for i in face) for face in FACES)]
    (folder / "base.obj").write_text("\n".join(lines) + "\n")
    (folder / "tiny.mhskel").write_text(json.dumps(skeleton(), indent=1))
    (folder / "tiny.mhw").write_text(json.dumps(weights(), indent=1))
    (folder / "targets").mkdir(exist_ok=True)
    (folder / "targets" / "grow.target").write_text("# basemesh tiny\n2 0 1 0\n3 0 1 0\n6 0 1 0\n7 0 1 0\n")
    (folder / "face-poseunits.json").write_text(json.dumps({"framemapping": ["Rest", "Nod"]}, indent=1))
    (folder / "face-poseunits.bvh").write_text(BVH)
    return folder / "tiny.mhskel"
