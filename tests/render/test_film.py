"""Films, contact sheets and pictures as files, read back with other tools."""

import numpy as np
import pytest
from PIL import Image as Pillow

from keypose.errors import FormatError, ShapeError, UnknownName
from keypose.model import Character, Pose, Scene, Skeleton
from keypose.render import REST, Camera, RenderSettings, contact_sheet, film, render_file, render_frames, render_image
from keypose.render.sheet import layout
from tests.render.conftest import arm, wave


def decoded(path):
    import av

    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        pictures = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
        return pictures, stream.average_rate, float(container.duration) / 1e6


def settings_of(**changes):
    return RenderSettings(**{"width": 96, "height": 64, "rate_hz": 12.0, "backend": "cpu", "supersample": 1, **changes})


@pytest.mark.parametrize("suffix", [".mp4", ".webm", ".gif"])
def test_films_have_every_frame_at_its_rate_and_size(arm_scene, tmp_path, suffix):
    path = tmp_path / f"arm{suffix}"
    progress = []
    notes = render_file(arm_scene, path, settings=settings_of(), progress=lambda *p: progress.append(p))
    assert notes == ()
    pictures, rate, duration = decoded(path)
    assert len(pictures) == 12  # the motion's own frames, the first and the last included
    assert pictures[0].shape == (64, 96, 3)
    assert duration == pytest.approx(1.0, abs=0.05)
    if suffix != ".gif":
        assert float(rate) == 12
    assert progress == [(n + 1, 12) for n in range(12)]
    frames = [picture for _, picture in render_frames(arm_scene, settings=settings_of())]
    for shown, drawn in zip(pictures, frames, strict=True):
        assert np.abs(shown.astype(int) - drawn[..., :3]).mean() < 4
        assert np.abs(shown.mean(axis=(0, 1)) - drawn[..., :3].mean(axis=(0, 1))).max() < 2.5


@pytest.mark.parametrize(("suffix", "size"), [(".mp4", (98, 66)), (".webm", (98, 66)), (".gif", (97, 65))])
def test_odd_sizes_are_told(arm_scene, tmp_path, suffix, size):
    path = tmp_path / f"odd{suffix}"
    notes = render_file(arm_scene, path, settings=settings_of(width=97, height=65, end_s=0.2))
    assert decoded(path)[0][0].shape[:2] == size[::-1]
    assert bool(notes) == (suffix != ".gif")


def test_a_stretch_of_time_and_another_rate(arm_scene, tmp_path):
    path = tmp_path / "part.mp4"
    render_file(arm_scene, path, settings=settings_of(start_s=0.25, end_s=0.75, rate_hz=24))
    pictures, rate, _ = decoded(path)
    assert (len(pictures), float(rate)) == (13, 24)


def test_a_gif_uses_one_palette_and_its_colours(arm_scene, tmp_path):
    path = tmp_path / "arm.gif"
    render_file(arm_scene, path, settings=settings_of())
    with Pillow.open(path) as picture:
        assert picture.n_frames == 12
        assert picture.info["loop"] == 0  # for ever
    pictures, _, _ = decoded(path)
    colors = np.unique(np.concatenate([p.reshape(-1, 3) for p in pictures]), axis=0)
    assert 100 < len(colors) <= 256


def test_a_turntable_goes_round_once(arm_scene, tmp_path):
    path = tmp_path / "turn.mp4"
    render_file(arm_scene, path, time_s=0.2, settings=settings_of(turntable_s=1.0), turntable=True)
    pictures, _, _ = decoded(path)
    assert len(pictures) == 12
    steps = [np.abs(a.astype(int) - b).mean() for a, b in zip(pictures, pictures[1:] + pictures[:1], strict=True)]
    assert max(steps) < 3 * np.median(steps)  # from the last picture to the first is one step more, not a jump


@pytest.mark.parametrize("count", [1, 5, 12])
def test_contact_sheets_have_the_size_asked_for(arm_scene, tmp_path, count):
    path = tmp_path / "sheet.png"
    render_file(arm_scene, path, settings=settings_of(width=500, height=333, sheet_frames=count), sheet=True)
    with Pillow.open(path) as page:
        assert page.size == (500, 333)
    still = Scene(arm_scene.characters)
    assert contact_sheet(still, settings=settings_of(width=300, height=200, sheet_frames=count)).shape == (200, 300, 4)


@pytest.mark.parametrize("count", [1, 2, 7, 12, 100])
@pytest.mark.parametrize("size", [(1280, 720), (300, 900), (64, 64)])
@pytest.mark.parametrize("aspect", [0.3, 1.0, 3.0])
def test_places_on_a_sheet_do_not_overlap_or_stick_out(count, size, aspect):
    grid = layout(count, *size, aspect)
    taken = np.zeros(size[::-1], int)
    for index in range(count):
        left, top = grid.place(index)
        assert left >= 0
        assert top >= 0
        assert left + grid.cell[0] <= size[0]
        assert top + grid.cell[1] <= size[1]
        taken[top : top + grid.cell[1], left : left + grid.cell[0]] += 1
    assert taken.max() == 1


def test_tall_subjects_stand_side_by_side():
    tall, wide = layout(12, 1280, 720, 0.4), layout(12, 1280, 720, 2.5)
    assert tall.columns > wide.columns


def test_pngs_are_what_was_drawn(arm_scene, tmp_path):
    settings = settings_of(transparent=True)
    render_file(arm_scene, tmp_path / "arm.png", time_s=0.4, settings=settings)
    with Pillow.open(tmp_path / "arm.png") as picture:
        np.testing.assert_array_equal(np.asarray(picture), render_image(arm_scene, None, 0.4, settings))
    render_file(arm_scene, tmp_path / "arm.png", time_s=0.4, settings=settings_of())
    with Pillow.open(tmp_path / "arm.png") as picture:
        assert picture.mode == "RGB"


def test_rest_pose_and_named_animations(arm_scene, small):
    character = arm_scene.character
    bent, still = (render_image(s, a, 0.3, small) for s, a in ((arm_scene, "wave"), (arm_scene, REST)))
    np.testing.assert_array_equal(still, render_image(Scene((character,)), None, 0.0, small))
    np.testing.assert_array_equal(bent, render_image(arm_scene, wave(character), 0.3, small))
    assert np.abs(bent.astype(int) - still).mean() > 0.3
    with pytest.raises(UnknownName, match="nearest: 'wave'"):
        render_image(arm_scene, "wavee", 0.0, small)


def test_several_characters_stand_side_by_side(arm_scene):
    settings = settings_of(width=200, height=100, transparent=True, ground=False, camera=Camera.front())
    three = Scene(arm_scene.characters * 3, arm_scene.animations)
    alpha = render_image(three, None, 0.0, settings)[..., 3] > 127
    columns = alpha.any(axis=0).astype(int)
    assert (np.diff(columns) == 1).sum() == 3
    as_is = render_image(three, None, 0.0, settings_of(arrangement="as_is", transparent=True, ground=False))
    alone = render_image(arm_scene, None, 0.0, settings_of(transparent=True, ground=False))
    assert np.abs(as_is.astype(int) - alone).mean() < 1
    with pytest.raises(ShapeError, match="3 characters"):
        render_image(three, [REST], 0.0, settings)


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("out.avi", {}, r"\.png, \.mp4, \.webm, \.gif.*'\.avi'"),
        ("out", {}, "expected a file name ending in"),
        ("sheet.mp4", {"sheet": True}, "contact sheet"),
        ("no/such/folder/out.png", {}, "does not exist"),
        ("no/such/folder/out.mp4", {}, "does not exist"),
    ],
)
def test_impossible_files_are_refused_by_name(arm_scene, tmp_path, name, options, message):
    with pytest.raises(FormatError, match=message) as caught:
        render_file(arm_scene, tmp_path / name, settings=settings_of(), **options)
    assert str(caught.value).startswith(str(tmp_path))


def test_a_missing_encoder_is_named_before_anything_is_drawn(arm_scene, tmp_path, monkeypatch):
    monkeypatch.setitem(film._ENCODERS, ".mp4", ("no_such_encoder",))
    with pytest.raises(FormatError, match=r"no encoder for \.mp4 \(no_such_encoder\); write \.webm or \.gif"):
        render_file(arm_scene, tmp_path / "out.mp4", settings=settings_of())
    assert list(tmp_path.iterdir()) == []


def test_a_failure_leaves_the_old_file(arm_scene, tmp_path, monkeypatch):
    path = tmp_path / "out.mp4"
    path.write_bytes(b"old")

    def fails(done, total):
        if done == 3:
            raise RuntimeError("stop")

    with pytest.raises(RuntimeError, match="stop"):
        render_file(arm_scene, path, settings=settings_of(), progress=fails)
    monkeypatch.setattr(film.Film, "_encode", lambda *_: (_ for _ in ()).throw(ValueError("broken codec")))
    with pytest.raises(FormatError, match="broken codec"):
        render_file(arm_scene, path, settings=settings_of())
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_nothing_to_draw_is_said():
    with pytest.raises(ShapeError, match="no character"):
        render_image(Scene())
    nobody = Skeleton((), np.zeros(0, np.int32), Pose(np.zeros((0, 3)), np.zeros((0, 4)), np.zeros((0, 3))))
    with pytest.raises(ShapeError, match="no mesh and no joints"):
        render_image(Scene((Character(nobody),)))


def test_positions_that_are_not_finite_are_said():
    character = arm()
    motion = wave(character)
    translations = np.array(motion.pose.translations)
    translations[:, 0] = np.nan
    broken = motion.with_pose(Pose(translations, motion.pose.rotations, motion.pose.scales))
    with pytest.raises(ShapeError, match="not finite"):
        render_image(Scene((character,), (broken,)))


def test_importing_is_light():
    import subprocess
    import sys

    code = "import sys, keypose.render; print([m for m in ('moderngl', 'numba', 'av', 'PIL', 'scipy') if m in sys.modules])"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert found.stdout.strip() == "[]"
