"""FBX 3 to 5, whose layout differs from all later ones: no file of it is at hand, so small ones are written here."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from keypose import io
from keypose.deform import deform_part
from keypose.errors import FormatError
from keypose.evaluate import sample, world
from keypose.math import quat
from keypose.model import Clip, Property

pytest.importorskip("ufbx")

TICKS_PER_S = 46_186_158_000
Track = float | Sequence[tuple[float, float]]


def channel(axis: str, track: Track) -> str:
    if isinstance(track, (int, float)):
        return f'Channel: "{axis}" {{\n Default: {track}\n Color: 1,1,1\n }}\n'
    keys = ",".join(f"{round(t * TICKS_PER_S)},{value},L" for t, value in track)
    return f'Channel: "{axis}" {{\n Default: {track[0][1]}\n KeyVer: 4005\n KeyCount: {len(track)}\n Key: {keys}\n }}\n'


def take(name: str, *properties: Sequence[Track]) -> str:
    """Translation, rotation and scale of one model."""
    text = ""
    for layer, (letter, tracks) in enumerate(zip("TRS", properties, strict=True), 1):
        channels = "".join(channel(axis, track) for axis, track in zip("XYZ", tracks, strict=True))
        text += f'Channel: "{letter}" {{\n {channels} LayerType: {layer}\n }}\n'
    return f'Model: "Model::{name}" {{\n Version: 1.1\n Channel: "Transform" {{\n {text} }}\n }}\n'


def document(version: int) -> str:
    """A bone with a child that bends, and a square that follows both."""
    identity = "1,0,0,0,0,1,0,0,0,0,1,0,0,0,0,1"
    at_bend, from_bend = (f"1,0,0,0,0,1,0,0,0,0,1,0,0,{y},0,1" for y in (5, -5))
    still = (0, 0, 0), (1, 1, 1)
    return f"""; FBX {str(version)[0]}.{str(version)[1]}.0 project file
FBXHeaderExtension:  {{
    FBXHeaderVersion: 1003
    FBXVersion: {version}
    Creator: "by hand"
}}
Model: "Model::root" {{
    Version: 194
    Type: "Limb"
    TypeFlags: "Skeleton"
    Children: "Model::bend"
}}
Model: "Model::bend" {{
    Version: 194
    Type: "Limb"
    TypeFlags: "Skeleton"
}}
Model: "Model::sheet" {{
    Version: 194
    Material: "Material::red" {{
        Version: 100
        ShadingModel: "phong"
        Diffuse: 0.8,0.1,0.1
    }}
    GeometryVersion: 123
    Vertices: 0,0,0,1,0,0,1,10,0,0,10,0
    Normals: 0,0,1,0,0,1,0,0,1,0,0,1
    MaterialAssignation: "AllSame"
    Materials: 0
    PolygonVertexIndex: 0,1,2,-4
    Link: "Model::root" {{
        Version: 100
        Mode: "Total1"
        Indexes: 0,1
        Weights: 1,1
        Transform: {identity}
        TransformLink: {identity}
    }}
    Link: "Model::bend" {{
        Version: 100
        Mode: "Total1"
        Indexes: 2,3
        Weights: 1,1
        Transform: {from_bend}
        TransformLink: {at_bend}
    }}
}}
Takes:  {{
    Current: "turn"
    Take: "turn" {{
        FileName: "turn.tak"
        LocalTime: 0,{TICKS_PER_S}
        ReferenceTime: 0,{TICKS_PER_S}
        {take("root", (0, 0, 0), *still)}
        {take("bend", (0, 5, 0), (0, 0, [(0.0, 0.0), (1.0, 90.0)]), (1, 1, 1))}
        {take("sheet", (0, 0, 0), *still)}
    }}
}}
Settings:  {{
    TimeMode: 3
    FrameRate: "30"
}}
"""


@pytest.mark.parametrize("version", [3000, 5000, 5800])
def test_skeleton_skin_and_take(version: int, tmp_path: Path) -> None:
    path = tmp_path / "old.fbx"
    path.write_text(document(version))
    scene = io.load(path)
    character = scene.character
    assert scene.extras["fbx"]["version"] == version and scene.unit_m == 0.01
    assert character.skeleton.names[:2] == ("root", "bend")
    np.testing.assert_allclose(character.skeleton.rest.translations[1], [0, 0.05, 0], atol=1e-7)
    clip = scene.animation("turn")
    assert isinstance(clip, Clip) and clip.rate_hz == 30
    assert quat.angle_between(clip.curve("bend", Property.ROTATION).values[-1], [2**-0.5, 0, 0, 2**-0.5]) < 1e-6
    (part,) = character.parts
    np.testing.assert_allclose(part.material.base_color[:3], (0.8, 0.1, 0.1), atol=1e-6)
    pose = sample(clip, character.skeleton, np.array([0.0, 1.0]))
    points = deform_part(character, part, world(character.skeleton, pose))
    np.testing.assert_allclose(points[0], part.mesh.positions, atol=1e-7)
    np.testing.assert_allclose(points[1], [[0, 0, 0], [0.01, 0, 0], [-0.05, 0.06, 0], [-0.05, 0.05, 0]], atol=1e-7)


def test_what_is_older_than_known_is_said(tmp_path: Path) -> None:
    path = tmp_path / "old.fbx"
    path.write_text(document(2000))
    assert any("2000" in note for note in io.load(path).notes)


def test_cut_files_are_refused_with_their_line(tmp_path: Path) -> None:
    path, text = tmp_path / "old.fbx", document(5800)
    lines = text.splitlines(keepends=True)
    refused = 0
    for count in range(12, len(lines), 9):
        path.write_text("".join(lines[:count]))
        try:
            io.load(path)
        except FormatError as error:
            refused += 1
            assert f"line {count + 1}" in str(error)
    assert refused > 5
