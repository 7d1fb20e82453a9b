"""OpenGL and the software rasteriser draw the same picture."""

import io as bytes_io
from dataclasses import replace

import numpy as np
import pytest

from keypose import io, samples
from keypose.errors import KeyposeError
from keypose.model import Character, Image, Material, Mesh, Part, Pose, Scene, Skeleton
from keypose.render import Camera, RenderSettings, render_image
from keypose.render.settings import encoded
from tests.conftest import data_files
from tests.render.conftest import arm, wave


def both(scene, time_s=0.3, **changes):
    settings = RenderSettings(**{"width": 240, "height": 200, "supersample": 1, **changes})
    return [render_image(scene, None, time_s, replace(settings, backend=b)).astype(int) for b in ("gl", "cpu")]


def assert_alike(scene, mean=1.0, iou=0.97, **changes):
    gl, cpu = both(scene, **changes)
    assert np.abs(gl - cpu).mean() < mean
    # thin bones have as much rim as inside: fine enough samples, or their number decides
    gl, cpu = both(scene, **{**changes, "transparent": True, "ground": False, "supersample": 2})
    gl, cpu = gl[..., 3] > 127, cpu[..., 3] > 127
    assert cpu.any()
    assert (gl & cpu).sum() / (gl | cpu).sum() > iou


@pytest.mark.gl
@pytest.mark.parametrize("theme", ["light", "dark"])
@pytest.mark.parametrize(
    "camera", [Camera(), Camera.back(), Camera.top(), Camera(orthographic=True), Camera(elevation_deg=-20)]
)
def test_alike_from_all_sides(arm_scene, theme, camera):
    assert_alike(arm_scene, theme=theme, camera=camera)


@pytest.mark.gl
@pytest.mark.parametrize(
    "changes",
    [
        {"skeleton": True, "joint_axes": True},
        {"ghosts_s": (-0.3, 0.3)},
        {"mesh": False},
        {"shadows": False},
        {"ground": False},
        {"grid": False},
        {"width": 121, "height": 333},
        {"supersample": 2},
    ],
    ids=str,
)
def test_alike_with_every_option(arm_scene, changes):
    assert_alike(arm_scene, **changes)


@pytest.mark.gl
def test_alike_for_the_built_in_human():
    assert_alike(samples.load("walk"), width=320, height=320)


@pytest.mark.gl
@pytest.mark.data
@pytest.mark.parametrize(
    "path",
    [p for stem in ("khronos/Fox.glb", "khronos/cesium_man.gltf", "cc0/robot.glb", "cc0/Knight.glb", "khronos/MorphStressTest.gltf", "khronos/AnimatedMorphCube/AnimatedMorphCube.gltf") for p in data_files(f"gltf/{stem}")]
    + data_files("bvh/geno/*.bvh")[:1],
    ids=lambda p: p.stem,
)  # fmt: skip
def test_alike_and_well_framed_for_real_files(path):
    scene = io.load(path)
    side = 200 if scene.character.parts else 400  # bones are thin
    assert_alike(scene, width=side, height=side)
    shown = both(scene, width=200, height=200, transparent=True, ground=False)[1][..., 3] > 0
    rows, columns = np.nonzero(shown.any(axis=1))[0], np.nonzero(shown.any(axis=0))[0]
    assert max(np.ptp(rows), np.ptp(columns)) > 0.35 * 200  # one moment of a performance that fits as a whole
    assert rows[0] > 0
    assert columns[0] > 0
    assert rows[-1] < 199
    assert columns[-1] < 199


@pytest.mark.parametrize("backend", [pytest.param("gl", marks=pytest.mark.gl), "cpu"])
class TestEachBackend:
    def test_the_same_again(self, arm_scene, backend):
        settings = RenderSettings(width=100, height=80, backend=backend)
        first, second = (render_image(arm_scene, None, 0.4, settings) for _ in range(2))
        np.testing.assert_array_equal(first, second)
        assert first.shape == (80, 100, 4)
        assert first.dtype == np.uint8
        assert (first[..., 3] == 255).all()

    def test_a_moved_arm_is_another_picture(self, arm_scene, backend):
        settings = RenderSettings(width=100, height=80, backend=backend)
        pictures = [render_image(arm_scene, None, t, settings).astype(int) for t in (0.0, 0.25)]
        assert np.abs(pictures[0] - pictures[1]).mean() > 0.3

    def test_unlit_colours_are_exact(self, backend):
        wanted = (0.1, 0.5, 0.8)
        card = card_scene(Material("card", (*wanted, 1.0), unlit=True))
        color = middle(card, backend)
        np.testing.assert_allclose(color[:3], np.array(encoded(wanted)) * 255, atol=1.5)

    def test_textures_and_vertex_colours_multiply(self, backend):
        image = picture_of([[(255, 0, 0, 255), (0, 255, 0, 255)], [(0, 0, 255, 255), (188, 188, 188, 255)]], 16)
        material = Material("card", (1, 1, 1, 1), base_color_image=image, unlit=True)
        corners = quadrants(card_scene(material), backend)
        for color, expected in zip(corners, [(255, 0, 0), (0, 255, 0), (0, 0, 255), (188, 188, 188)], strict=True):
            np.testing.assert_allclose(color[:3], expected, atol=3)
        half = card_scene(material, colors=np.tile([0.5, 0.5, 0.5, 1], (4, 1)))
        np.testing.assert_allclose(quadrants(half, backend)[0][:3], (188, 0, 0), atol=3)

    def test_masks_cut_and_blends_let_through(self, backend):
        image = picture_of([[(255, 255, 255, 255), (255, 255, 255, 40)]] * 2, 16)
        masked = card_scene(Material("m", base_color_image=image, alpha_mode="MASK", unlit=True))
        left, right = quadrants(masked, backend)[:2]
        assert left[3] == 255
        assert right[3] == 0
        glass = card_scene(Material("g", (1, 1, 1, 1), base_color_image=image, alpha_mode="BLEND", unlit=True))
        left, right = quadrants(glass, backend)[:2]
        assert left[3] == 255
        assert abs(int(right[3]) - 40) < 4
        opaque = card_scene(Material("o", (1, 1, 1, 0.2), base_color_image=image, unlit=True))
        assert [c[3] for c in quadrants(opaque, backend)] == [255] * 4  # OPAQUE does not look at alpha

    def test_backs_show_only_of_double_sided_surfaces(self, backend):
        for double_sided in (False, True):
            scene = card_scene(Material("card", unlit=True, double_sided=double_sided))
            assert (middle(scene, backend, Camera.back())[3] > 0) == double_sided
        # a mirrored part shows the same side as before
        scene = card_scene(Material("card", unlit=True), scale=(-1, 1, 1))
        assert middle(scene, backend)[3] == 255
        assert middle(scene, backend, Camera.back())[3] == 0

    def test_a_broken_texture_leaves_the_plain_colour(self, backend):
        image = Image("broken", data=b"\x89PNG\r\n\x1a\nnonsense")
        scene = card_scene(Material("card", (0.2, 0.2, 0.2, 1), base_color_image=image, unlit=True))
        np.testing.assert_allclose(middle(scene, backend)[:3], np.array(encoded((0.2,) * 3)) * 255, atol=1.5)

    def test_the_subject_throws_a_shadow(self, arm_scene, backend):
        settings = RenderSettings(width=160, height=160, backend=backend, grid=False)
        with_shadow, without = (
            render_image(arm_scene, None, 0.0, replace(settings, shadows=s)).astype(int) for s in (True, False)
        )
        darker = (without - with_shadow)[..., :3].min(axis=-1)
        assert (darker > 20).mean() > 0.004
        assert (darker >= -2).mean() > 0.999

    def test_transparent_pictures_hold_only_subject_and_shadow(self, arm_scene, backend):
        settings = RenderSettings(width=120, height=120, backend=backend, transparent=True)
        alpha = render_image(arm_scene, None, 0.0, settings)[..., 3]
        assert alpha[0].max() == 0
        assert (alpha == 255).any()
        assert ((alpha > 10) & (alpha < 200)).mean() > 0.01

    def test_what_is_under_the_floor_is_hidden(self, backend):
        card = card_scene(Material("card", (1, 0, 0, 1), unlit=True))
        settings = RenderSettings(
            width=80, height=80, backend=backend, floor=0.0, shadows=False, camera=Camera(elevation_deg=10)
        )
        red = [
            (picture[..., 0] > 200) & (picture[..., 1] < 60)
            for picture in (render_image(card, settings=replace(settings, ground=g)) for g in (True, False))
        ]
        assert 0.35 < red[0].sum() / red[1].sum() < 0.65

    def test_overlays_show_through_the_mesh(self, arm_scene, backend):
        settings = RenderSettings(width=160, height=160, backend=backend, shadows=False)
        plain, over = (
            render_image(arm_scene, None, 0.0, replace(settings, skeleton=s)).astype(int) for s in (False, True)
        )
        assert (np.abs(plain - over).max(axis=-1) > 30).mean() > 0.005


def test_without_a_driver_auto_takes_the_software_rasteriser(arm_scene, small, monkeypatch):
    from keypose.render import gl

    def nothing():
        raise gl.NoDriverError("no OpenGL driver")

    monkeypatch.setattr(gl, "context", nothing)
    expected = render_image(arm_scene, None, 0.2, replace(small, backend="cpu"))
    np.testing.assert_array_equal(render_image(arm_scene, None, 0.2, small), expected)
    with pytest.raises(KeyposeError, match="no OpenGL driver"):
        render_image(arm_scene, None, 0.2, replace(small, backend="gl"))


def test_threads_do_not_disturb_each_other(arm_scene):
    from concurrent.futures import ThreadPoolExecutor

    settings = RenderSettings(width=64, height=64, backend="cpu")
    expected = render_image(arm_scene, None, 0.4, settings)
    with ThreadPoolExecutor(3) as pool:
        for picture in pool.map(lambda _: render_image(arm_scene, None, 0.4, settings), range(6)):
            np.testing.assert_array_equal(picture, expected)


def card_scene(material, colors=None, scale=(1, 1, 1)):
    """A square of 2 m in the XY plane that faces the camera in front."""
    positions = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], np.float32)
    uvs = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], np.float32)
    mesh = Mesh(positions, [[0, 1, 2], [0, 2, 3]], np.tile([0, 0, 1.0], (4, 1)), uvs, colors)
    rest = Pose(np.zeros((1, 3)), np.array([[1.0, 0, 0, 0]]), np.array([scale], float))
    return Scene((Character(Skeleton(("card",), [-1], rest), (Part("card", mesh, material, joint=0),)),))


def picture_of(quarters, size):
    """A PNG of size x size pixels in four quarters of one colour each."""
    from PIL import Image as Pillow

    pixels = np.kron(np.array(quarters, np.uint8), np.ones((size // 2, size // 2, 1), np.uint8))
    data = bytes_io.BytesIO()
    Pillow.fromarray(pixels).save(data, "png")
    return Image("quarters", data=data.getvalue())


def shown(scene, backend, camera=None):
    settings = RenderSettings(
        width=96,
        height=96,
        backend=backend,
        camera=camera or Camera.front(elevation_deg=0),
        transparent=True,
        ground=False,
    )
    return render_image(scene, settings=settings)


def middle(scene, backend, camera=None):
    return shown(scene, backend, camera)[48, 40]


def quadrants(scene, backend):
    picture = shown(scene, backend)
    return [picture[y, x] for y in (30, 66) for x in (30, 66)]


@pytest.mark.gl
def test_the_arm_is_drawn_where_its_vertices_are():
    # an independent check of the projection: every vertex's pixel lies in or beside the silhouette
    from keypose import deform
    from keypose.render.camera import Framing
    from keypose.render.stage import Stage

    character = arm()
    scene = Scene((character,), (wave(character),))
    settings = RenderSettings(width=200, height=160, transparent=True, ground=False, start_s=0.3, end_s=0.3)
    stage = Stage(scene, None, settings)
    view = Framing(stage, settings.camera, 1.25).views(np.array([0.3]))[0]
    moment = stage.moments(np.array([0.3]))[0]
    points = deform.deform_part(character, character.parts[0], moment.matrices[0], moment.morph_weights[0])
    clip = np.concatenate([points, np.ones((len(points), 1))], axis=1) @ view.clip_from_world.T
    x = ((clip[:, 0] / clip[:, 3] + 1) * 100).astype(int)
    y = ((1 - clip[:, 1] / clip[:, 3]) * 80).astype(int)
    for backend in ("gl", "cpu"):
        alpha = render_image(scene, None, 0.3, replace(settings, backend=backend))[..., 3]
        near = np.stack([alpha[np.clip(y + j, 0, 159), np.clip(x + i, 0, 199)] for i in (-1, 0, 1) for j in (-1, 0, 1)])
        assert (near.max(axis=0) > 0).all()
        assert abs((alpha > 127).any(axis=0).sum() - (np.ptp(x) + 1)) <= 2
        assert abs((alpha > 127).any(axis=1).sum() - (np.ptp(y) + 1)) <= 2
