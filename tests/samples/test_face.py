"""The 67 face shapes of the built-in human: complete, in the right place, and doing what their names say."""

from __future__ import annotations

import numpy as np
import pytest

from keypose.model import Character
from keypose.samples.human import human
from keypose.samples.human_face import ARKIT, MORPHS, VISEMES
from keypose.samples.human_head import MOUTH_HALF, mouth_line
from keypose.samples.skeleton import EYE_CENTRE as LIFE_SIZE_EYE
from keypose.samples.skeleton import EYE_RADIUS as LIFE_SIZE_RADIUS
from keypose.samples.skeleton import HEAD_SCALE, enlarged
from tests.samples.geometry import depth_from_front, face_normals, seen_from_front

EYE_CENTRE = enlarged(np.array(LIFE_SIZE_EYE))
EYE_RADIUS = HEAD_SCALE * LIFE_SIZE_RADIUS
MOUTH_Y = float(enlarged(np.array([0.0, float(mouth_line(np.zeros(1))[0]), 0.1]))[1])
CORNER = enlarged(np.array([MOUTH_HALF, float(mouth_line(np.array([MOUTH_HALF]))[0]), 0.1]))

_EYES = ("eyeBlink", "eyeLookDown", "eyeLookIn", "eyeLookOut", "eyeLookUp", "eyeSquint", "eyeWide")
_MOUTH = ("Smile", "Frown", "Dimple", "Stretch", "Press", "LowerDown", "UpperUp")
EXPECTED_ARKIT = {
    *(f"{n}{s}" for n in _EYES for s in ("Left", "Right")),
    *(f"mouth{n}{s}" for n in _MOUTH for s in ("Left", "Right")),
    *(f"{n}{s}" for n in ("browDown", "browOuterUp", "cheekSquint", "noseSneer") for s in ("Left", "Right")),
    "jawForward", "jawLeft", "jawRight", "jawOpen", "mouthClose", "mouthFunnel", "mouthPucker", "mouthLeft", "mouthRight",
    "mouthRollLower", "mouthRollUpper", "mouthShrugLower", "mouthShrugUpper", "browInnerUp", "cheekPuff", "tongueOut",
}  # fmt: skip
EXPECTED_VISEMES = {
    f"viseme_{v}" for v in ("sil", "PP", "FF", "TH", "DD", "kk", "CH", "SS", "nn", "RR", "aa", "E", "I", "O", "U")
}


def test_all_names_are_there() -> None:
    assert set(ARKIT) == EXPECTED_ARKIT and len(ARKIT) == 52
    assert set(VISEMES) == EXPECTED_VISEMES and len(VISEMES) == 15
    assert human().morph_names == MORPHS and len(MORPHS) == 67


@pytest.fixture(scope="module")
def offsets(character: Character) -> dict[str, dict[str, np.ndarray]]:
    """Offsets by morph and part, (V, 3); parts that a morph leaves alone are missing."""
    found: dict[str, dict[str, np.ndarray]] = {name: {} for name in MORPHS}
    for part in character.parts:
        if part.morphs is None:
            continue
        dense, _ = part.morphs.dense(part.mesh.vertex_count)
        for channel, delta in zip(part.morph_channels, dense, strict=True):
            found[MORPHS[channel]][part.name] = delta
    return found


def _points(character: Character, name: str) -> np.ndarray:
    return next(p for p in character.parts if p.name == name).mesh.positions


@pytest.mark.parametrize("name", MORPHS)
def test_every_shape_moves_the_face_and_only_the_face(character: Character, offsets, name: str) -> None:
    moved = offsets[name]
    assert set(moved) <= {
        "head",
        "mouth",
        "brows",
        "eyes",
        "catchlights",
        "upper_teeth",
        "lower_teeth",
        "tongue",
        "lashes",
    }
    largest = max(np.linalg.norm(d, axis=1).max() for d in moved.values())
    assert (0.0003 if name == "viseme_sil" else 0.002) < largest < 0.06
    if "head" in moved:
        still = _points(character, "head")[:, 2] < -0.03
        assert np.all(moved["head"][still] == 0), "the back of the head and the neck stay"


@pytest.mark.parametrize(
    "name", [n for n in ARKIT if n.endswith("Left") and n.startswith(("eye", "brow", "cheek", "nose"))]
)
def test_shapes_of_the_left_side_stay_there(character: Character, offsets, name: str) -> None:
    for part, delta in offsets[name].items():
        far = _points(character, part)[:, 0] < -0.02
        assert np.all(delta[far] == 0), part


@pytest.mark.parametrize("name", [n for n in ARKIT if n.endswith("Left")])
def test_right_shapes_mirror_the_left(character: Character, offsets, name: str) -> None:
    other = name.replace("Left", "Right")
    for part, delta in offsets[name].items():
        if part == "catchlights":
            continue  # reflections of the light are not mirror images of each other
        points = _points(character, part).astype(np.float64)
        flip = np.array([-1.0, 1, 1])
        size = np.linalg.norm(delta, axis=1)
        assert part in offsets[other]
        mirrored = np.linalg.norm(offsets[other][part], axis=1)
        assert np.isclose(size.sum(), mirrored.sum(), rtol=1e-3)
        centre = (points * size[:, None]).sum(0) / size.sum()
        centre_other = (points * mirrored[:, None]).sum(0) / mirrored.sum()
        assert np.allclose(centre_other, centre * flip, atol=1e-4)


def _front_of_eye() -> np.ndarray:
    """Places over the left eye's opening."""
    x, y = np.meshgrid(np.linspace(-0.0225, 0.0225, 31), np.linspace(-0.0160, 0.0185, 27))
    inside = (x / 0.0232) ** 2 + (y / np.where(y > 0, 0.0188, 0.0160)) ** 2 < 1
    return HEAD_SCALE * np.stack([x[inside], y[inside]], 1) + EYE_CENTRE[:2]


def _depths(character: Character, posed, places: np.ndarray, **morphs: float) -> tuple[np.ndarray, np.ndarray]:
    vertices = posed(morphs=morphs)
    by_name = {p.name: p.mesh.triangles for p in character.parts}
    skin = depth_from_front(vertices["head"], by_name["head"], places)
    ball = depth_from_front(vertices["eyes"], by_name["eyes"], places)
    return skin, ball


def test_the_open_eye_shows_the_ball(character: Character, posed) -> None:
    middle = np.array(EYE_CENTRE[:2])
    skin, ball = _depths(character, posed, middle + 0.82 * (_front_of_eye() - middle))
    assert np.all(ball > skin)


def test_the_closed_lid_covers_the_ball(character: Character, posed) -> None:
    skin, ball = _depths(character, posed, _front_of_eye(), eyeBlinkLeft=1.0)
    assert np.all(skin > ball)


@pytest.mark.parametrize("weight", [0.2, 0.4, 0.5, 0.6, 0.8])
def test_the_closing_lid_does_not_sink_into_the_ball(character: Character, posed, weight: float) -> None:
    """Going down, the ball is seen below the upper lid's rim and nowhere above it."""
    places = _front_of_eye()
    skin, ball = _depths(character, posed, places, eyeBlinkLeft=weight)
    visible = ball > skin
    column = np.round(places[:, 0], 6)
    broken = 0
    for x in np.unique(column):
        seen = visible[column == x][np.argsort(places[column == x][:, 1])]
        broken += int(np.sum(np.diff(seen.astype(int)) == 1) > 1)
    assert broken == 0


@pytest.mark.parametrize(("way", "axis", "sign"), [("Up", 1, 1), ("Down", 1, -1), ("Out", 0, 1), ("In", 0, -1)])
def test_looking_turns_the_ball(character: Character, posed, way: str, axis: int, sign: int) -> None:
    rest, turned = posed()["eyes"], posed(morphs={f"eyeLook{way}Left": 1.0})["eyes"]
    pupil = np.argmax(rest[:, 2] + 10 * (rest[:, 0] > 0))
    assert sign * (turned - rest)[pupil, axis] > 0.010
    left = rest[:, 0] > 0
    radius = np.linalg.norm(turned[left] - EYE_CENTRE, axis=1)
    assert np.allclose(radius, EYE_RADIUS, atol=2e-5), "a turned ball is the same ball"
    assert np.allclose(turned[~left], rest[~left])


@pytest.mark.parametrize("name", [n for n in MORPHS if n != "mouthClose"])
def test_no_shape_turns_the_skin_inside_out(character: Character, posed, name: str) -> None:
    """Seen from the front, the skin around eyes and mouth shows its outside (mouthClose alone is half a pair)."""
    triangles = next(p for p in character.parts if p.name == "head").mesh.triangles
    points = posed(morphs={name: 1.0})["head"]
    front = triangles[np.min(points[triangles][:, :, 2], axis=1) > 0.03]
    eye, mouth = EYE_CENTRE[:2], np.array([0.0, MOUTH_Y])
    x, y = np.meshgrid(np.linspace(-1, 1, 23), np.linspace(-1, 1, 17))
    grid = np.stack([x.ravel(), y.ravel()], 1)
    places = np.vstack(
        [eye + grid * (0.033, 0.024), eye * (-1, 1) + grid * (0.033, 0.024), mouth + grid * (0.036, 0.024)]
    )
    z, face = seen_from_front(points, front, places + 1.3e-5)
    turned = (face_normals(points, front)[face, 2] < 0) & np.isfinite(z)
    assert turned.mean() < 0.004


def test_jaw_open_lowers_teeth_tongue_and_chin(character: Character, offsets) -> None:
    moved = offsets["jawOpen"]
    assert moved["lower_teeth"][:, 1].max() < -0.015
    assert moved["tongue"][:, 1].max() < -0.005
    assert "upper_teeth" not in moved
    head = _points(character, "head")
    chin = np.argmin(np.abs(head[:, 0]) + np.abs(head[:, 1] - 1.43) + np.abs(head[:, 2] - 0.095))
    assert moved["head"][chin, 1] < -0.02
    forehead = head[:, 1] > 1.535
    assert np.all(moved["head"][forehead] == 0)


def _gap(character: Character, posed, **morphs: float) -> float:
    """Height of the opening in the middle of the mouth, by what is seen from the front."""
    y = np.linspace(MOUTH_Y - 0.06, MOUTH_Y + 0.02, 400)
    places = np.stack([np.full_like(y, 0.0007), y], 1)
    vertices = posed(morphs=morphs)
    triangles = {p.name: p.mesh.triangles for p in character.parts}
    skin = depth_from_front(vertices["head"], triangles["head"], places)
    behind = np.max(
        [
            depth_from_front(vertices[n], triangles[n], places)
            for n in ("mouth", "upper_teeth", "lower_teeth", "tongue")
        ],
        axis=0,
    )
    return float(np.sum(behind > skin) * (y[1] - y[0]))


def test_mouth_openings(character: Character, posed) -> None:
    assert _gap(character, posed) < 0.001, "the mouth is closed at rest"
    opened = _gap(character, posed, jawOpen=1.0)
    assert opened > 0.025
    assert _gap(character, posed, jawOpen=1.0, mouthClose=1.0) < 0.15 * opened, (
        "mouthClose seals the lips over an open jaw"
    )
    assert (
        _gap(character, posed, viseme_aa=1.0)
        > _gap(character, posed, viseme_E=1.0)
        > _gap(character, posed, viseme_nn=1.0)
    )
    assert _gap(character, posed, viseme_PP=1.0) < 0.001
    for viseme in ("FF", "TH", "DD", "kk", "CH", "SS", "RR", "I", "O", "U"):
        assert _gap(character, posed, **{f"viseme_{viseme}": 1.0}) > 0.0015, viseme


def test_corners_of_the_mouth(character: Character, offsets) -> None:
    head = _points(character, "head")
    corner = np.argmin(np.linalg.norm(head[:, :2] - CORNER[:2], axis=1) - 5 * (head[:, 2] > 0.09))
    at = {name: offsets[name]["head"][corner] for name in MORPHS if "head" in offsets[name]}
    assert at["mouthSmileLeft"][0] > 0.004 and at["mouthSmileLeft"][1] > 0.004
    assert at["mouthFrownLeft"][1] < -0.004
    assert at["mouthStretchLeft"][0] > 0.006
    assert at["mouthPucker"][0] < -0.006 and at["mouthFunnel"][0] < -0.004
    assert at["mouthLeft"][0] > 0.005 and at["mouthRight"][0] < -0.005


def test_brows_go_where_they_are_told(character: Character, offsets) -> None:
    brows = _points(character, "brows")
    inner, outer = (brows[:, 0] > 0) & (brows[:, 0] < 0.026), brows[:, 0] > 0.05
    assert offsets["browInnerUp"]["brows"][inner, 1].mean() > 0.005
    assert offsets["browOuterUpLeft"]["brows"][outer, 1].mean() > 0.005
    assert offsets["browDownLeft"]["brows"][inner, 1].mean() < -0.003


@pytest.mark.parametrize("name", ["mouthFunnel", "mouthPucker", "viseme_O", "viseme_U", "viseme_CH", "viseme_RR"])
def test_rounded_lips_cover_the_teeth(character: Character, offsets, name: str) -> None:
    """The teeth part and stay behind while the lips come forward."""
    moved = offsets[name]
    assert moved["upper_teeth"][:, 1].min() > 0.001 and moved["upper_teeth"][:, 2].max() < -0.001
    assert moved["lower_teeth"][:, 1].max() < -0.001
    head = _points(character, "head")
    lip = np.argmin(np.linalg.norm(head - [0.0, MOUTH_Y + 0.003, head[:, 2].max()], axis=1))
    assert moved["head"][lip, 2] > 0.003


def test_an_open_o_is_round(character: Character, posed) -> None:
    """The opening of "O" is about as high as it is wide."""
    vertices = posed(morphs={"viseme_O": 1.0})
    step = 0.0008
    x, y = np.meshgrid(np.arange(-0.025, 0.025, step), np.arange(MOUTH_Y - 0.035, MOUTH_Y + 0.018, step))
    places = np.stack([x.ravel(), y.ravel()], 1) + 1.3e-5
    triangles = {p.name: p.mesh.triangles for p in character.parts}
    skin = depth_from_front(vertices["head"], triangles["head"], places)
    inside = depth_from_front(vertices["mouth"], triangles["mouth"], places)
    hole = (inside > skin).reshape(x.shape)
    wide, high = np.sum(hole.any(0)), np.sum(hole.any(1))
    assert 0.7 < wide / high < 1.5
    assert hole.sum() / (wide * high) > 0.7, "an ellipse fills 0.785 of its box, a triangle 0.5"


def test_lashes_lie_along_the_closed_lids(character: Character, posed) -> None:
    """No tick stands out beyond the corners of a closed eye."""
    closed = posed(morphs={"eyeBlinkLeft": 1.0})["lashes"]
    rest = posed()["lashes"]
    left = rest[:, 0] > 0
    end = left & (rest[:, 0] > EYE_CENTRE[0] + 0.022)
    assert closed[end, 0].max() < rest[end, 0].max() - 0.001
    assert np.ptp(closed[left, 1]) < 0.65 * np.ptp(rest[left, 1])


def test_tongue_comes_out(character: Character, offsets) -> None:
    tip = np.argmax(_points(character, "tongue")[:, 2])
    assert offsets["tongueOut"]["tongue"][tip, 2] > 0.03


def test_visemes_add_up_from_elementary_shapes(offsets) -> None:
    recipe = VISEMES["viseme_E"]
    total = sum(
        offsets[n]["head"] * amount
        for name, amount in recipe.items()
        for n in ((name,) if name in MORPHS else (name + "Left", name + "Right"))
    )
    assert np.allclose(total, offsets["viseme_E"]["head"], atol=2e-5)


def test_normals_follow_the_shapes(character: Character) -> None:
    """Moved normals are those of the moved surface."""
    part = next(p for p in character.parts if p.name == "eyes")
    positions, normals = part.morphs.dense(part.mesh.vertex_count)
    k = part.morphs.index("eyeLookUpLeft")
    moved = part.mesh.positions + positions[k]
    expected = (moved - EYE_CENTRE) / EYE_RADIUS
    left = part.mesh.positions[:, 0] > 0
    found = part.mesh.normals + normals[k]
    assert np.abs(np.sum(found[left] * expected[left], 1) - 1).max() < 0.02
