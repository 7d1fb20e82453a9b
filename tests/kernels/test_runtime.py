"""Widths, processors, the code cache, and what importing costs."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from keypose import play
from keypose.kernels.runtime import FEATURES
from keypose.samples import performances
from keypose.samples import skeleton as samples_skeleton

HERE = Path(__file__).parent

SMOKE = """
import numpy as np, sys
sys.path.insert(0, {tests!r})
from kernels.conftest import chained, random_motion, unit
from kernels.test_sample import expected, scene
from kernels.test_skin import applied, random_mesh
from keypose.kernels import fk, sample, skin, skincrowd, text
from keypose.kernels.runtime import WIDTH

motion = random_motion(37, 19, seed=1)
for dtype, limit in ((np.float32, 1e-4), (np.float64, 1e-11)):
    arguments = [a.astype(dtype) for a in (motion.rotations, motion.translations)]
    assert abs(fk.matrices(motion.parents, *arguments) - motion.models).max() < limit
    assert abs(fk.rotations_positions(motion.parents, *arguments)[1] - motion.models[..., :3, 3]).max() < limit
parents, clips, places, weights = scene(23, 2 * WIDTH + 1, seed=4)
for quantized, limit in ((False, 1e-4), (True, 2e-3)):
    made = sample.compile_clips(parents, clips, quantized)
    state = sample.mix(made, np.arange(3), places, weights)
    wanted = chained(parents, *expected(clips, places, weights))
    crowd = sample.animate_crowd(made, state)
    assert abs(crowd.transpose(0, 3, 1, 2).reshape(-1, 23, 3, 4)[: len(places)] - wanted[:, :, :3]).max() < limit
    assert abs(sample.animate_one(made, state) - wanted[0]).max() < limit
joints, weights, positions, normals = random_mesh(90, 5, 23, seed=2)
bind = np.tile(np.eye(4), (23, 1, 1))
mesh = skin.compile_mesh(joints, weights.astype(np.float32), positions.astype(np.float32), normals, np.arange(23), bind)
moved = skincrowd.skin_crowd(mesh, crowd).transpose(0, 3, 1, 2).reshape(-1, 90, 3)
assert abs(moved[: len(places)] - applied(wanted, joints, weights, positions)).max() < 1e-2
assert abs(skin.skin(mesh, wanted[0])[0] - applied(wanted[0], joints, weights, positions)).max() < 1e-4
a = unit(np.random.default_rng(0).normal(size=(50, 4)))
assert abs(sample.slerp(a, a, np.full(50, 0.5)) - a).max() < 1e-6
assert text.parse_numbers(b"1 -2.5 1e300 0.1 nan")[0].tolist() == [1, -2.5, 1e300, 0.1]
assert text.format_numbers([[1.5, -2.25]], 2) == b"1.50 -2.25\\n"
print(WIDTH)
"""


DECODE = """
import numpy as np, sys
from keypose import play
pose = play.sample(play.from_bytes(open(sys.argv[1] + "/clip", "rb").read()), np.load(sys.argv[1] + "/times.npy"))
parts = np.concatenate([pose.rotations, pose.translations, pose.scales], axis=-1)
print(abs(parts - np.load(sys.argv[1] + "/wanted.npy")).max())
"""
AVX2 = "+sse4.2,+ssse3,+avx,+avx2,+fma,+bmi,+bmi2,+popcnt,+lzcnt,+f16c"


def run(code, *arguments, **environment):
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    return done.returncode, done.stdout.strip(), done.stderr


@pytest.mark.slow
@pytest.mark.parametrize(
    ("environment", "width"),
    [
        ({"KEYPOSE_SIMD_WIDTH": "4"}, "4"),
        ({"KEYPOSE_SIMD_WIDTH": "8"}, "8"),
        ({"KEYPOSE_SIMD_WIDTH": "16"}, "16"),
        ({"NUMBA_CPU_NAME": "generic"}, "4"),
        ({"NUMBA_CPU_NAME": "generic", "KEYPOSE_SIMD_WIDTH": "8"}, "8"),
    ],
)
def test_every_width_works_on_every_processor(environment, width):
    code, printed, errors = run(SMOKE.format(tests=str(HERE.parent)), **environment)
    assert code == 0, errors
    assert printed == width


@pytest.mark.slow
@pytest.mark.parametrize(
    "environment",
    [
        {"NUMBA_CPU_NAME": "generic"},
        {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": "+sse4.2,+ssse3"},
        pytest.param(
            {"NUMBA_CPU_NAME": "haswell", "NUMBA_CPU_FEATURES": AVX2},
            marks=pytest.mark.skipif("avx2" not in FEATURES, reason="the processor has no AVX2"),
        ),
    ],
    ids=["generic", "ssse3", "avx2"],
)
def test_clips_decode_alike_on_every_processor(environment, tmp_path):
    motion, skeleton = performances.make("walk"), samples_skeleton.skeleton()
    clip = play.compile_clip(motion, skeleton)
    times = np.random.default_rng(6).uniform(clip.start_s - 0.1, clip.end_s + 0.1, 200)
    pose = play.sample(clip, times)
    (tmp_path / "clip").write_bytes(play.to_bytes(clip))
    np.save(tmp_path / "times.npy", times)
    np.save(tmp_path / "wanted.npy", np.concatenate([pose.rotations, pose.translations, pose.scales], axis=-1))
    code, printed, errors = run(DECODE, str(tmp_path), **environment)
    assert code == 0, errors
    assert float(printed) < 2e-6


def test_a_width_that_does_not_exist_is_refused():
    code, _, errors = run("import keypose.kernels.runtime", KEYPOSE_SIMD_WIDTH="5")
    assert code == 1 and "KEYPOSE_SIMD_WIDTH: expected 4, 8 or 16" in errors


def test_importing_the_package_loads_no_compiler():
    code, printed, errors = run("import sys, keypose.kernels; print('numba' in sys.modules)")
    assert (code, printed) == (0, "False"), errors


COMPILE = """
import numpy as np
from keypose.kernels import runtime, slerp
q = np.array([[0.6, 0.8, 0, 0]])
assert abs(slerp.slerp(q, q, [0.5]) - q).max() < 1e-4
print(runtime.cache_folder())
"""


def test_compiled_code_is_kept_in_the_users_cache_and_used_again(tmp_path):
    code, folder, errors = run(COMPILE, XDG_CACHE_HOME=str(tmp_path), NUMBA_CACHE_DIR="")
    assert code == 0, errors
    if sys.platform == "linux":
        assert Path(folder).is_relative_to(tmp_path)
    kept = {path: path.stat().st_mtime_ns for path in Path(folder).glob("*.nbc")}
    assert kept
    assert run(COMPILE, XDG_CACHE_HOME=str(tmp_path), NUMBA_CACHE_DIR="")[0] == 0
    assert kept == {path: path.stat().st_mtime_ns for path in Path(folder).glob("*.nbc")}


def test_numbas_own_setting_names_the_cache(tmp_path):
    code, folder, errors = run(COMPILE, NUMBA_CACHE_DIR=str(tmp_path))
    assert code == 0, errors
    assert Path(folder).is_relative_to(tmp_path) and list(Path(folder).glob("*.nbc"))


def test_a_cache_that_cannot_be_written_only_costs_time(tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("not a folder")
    code, _, errors = run(COMPILE, NUMBA_CACHE_DIR=str(blocked))
    assert code == 0, errors


def test_damaged_cache_files_only_cost_time(tmp_path):
    _, folder, _ = run(COMPILE, NUMBA_CACHE_DIR=str(tmp_path))
    for path in Path(folder).iterdir():
        path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    code, _, errors = run(COMPILE, NUMBA_CACHE_DIR=str(tmp_path))
    assert code == 0, errors


def test_width_and_sources_name_the_folder(tmp_path):
    folders = {run(COMPILE, NUMBA_CACHE_DIR=str(tmp_path), KEYPOSE_SIMD_WIDTH=width)[1] for width in ("4", "8")}
    assert len(folders) == 2


def test_vectors_of_both_types_move_numbers_as_their_names_say():
    from keypose.kernels import vectors
    from keypose.kernels.runtime import aligned, kernel

    @kernel
    def rearrange(source, quads, triples, tile):
        count = vectors.lanes(source)
        a, b, c, d = vectors.load_quads(source, 0)
        vectors.store(quads, 0, a)
        vectors.store(quads, 3 * count, d)
        vectors.store_quads(quads, 4 * count, a, b, c, d)
        a, b, c = vectors.load_triples(source, 0)
        vectors.store(triples, 2 * count, c)
        vectors.store_triples(triples, 3 * count, a, b, c)
        vectors.transpose(source, 0, count, tile, 0, count)

    for dtype in (np.float32, np.float64):
        count = vectors.FLOATS.lanes if dtype == np.float32 else vectors.DOUBLES.lanes
        source = np.arange(max(count * count, 4 * count)).astype(dtype)
        quads, triples, tile = (aligned(count * max(count, 8), dtype) for _ in range(3))
        rearrange(source, quads, triples, tile)
        assert np.array_equal(quads[:count], source[: 4 * count : 4])
        assert np.array_equal(quads[3 * count : 4 * count], source[3 : 4 * count : 4])
        assert np.array_equal(quads[4 * count : 8 * count], source[: 4 * count])
        assert np.array_equal(triples[2 * count : 3 * count], source[2 : 3 * count : 3])
        assert np.array_equal(triples[3 * count : 6 * count], source[: 3 * count])
        square = source[: count * count].reshape(count, count)
        assert np.array_equal(tile[: count * count].reshape(count, count), square.T)


def test_arithmetic_keeps_nan_and_infinity():
    from keypose.kernels import vectors
    from keypose.kernels.runtime import aligned_copy, kernel

    @kernel
    def compute(source, out):
        count = vectors.lanes(source)
        v = vectors.load(source, 0)
        vectors.store(out, 0, v * 0.0)
        vectors.store(out, count, vectors.sqrt(vectors.absolute(v)))
        vectors.store(out, 2 * count, vectors.flip_sign(v, -1.0 * v))
        vectors.store(out, 3 * count, vectors.maximum(v, vectors.fill(source, 1.0)) / 2.0)

    count = vectors.FLOATS.lanes
    source = aligned_copy(np.resize([np.nan, np.inf, 4.0, -9.0], count))
    out = aligned_copy(np.zeros(4 * count))
    compute(source, out)
    zero, root, flipped, largest = out.reshape(4, count)[:, :4]
    assert np.isnan(zero[:2]).all() and not zero[2:].any()
    assert np.isnan(root[0]) and root[1:].tolist() == [np.inf, 2, 3]
    assert flipped[1:].tolist() == [-np.inf, -4, -9]
    assert largest[1:].tolist() == [np.inf, 2, 0.5]
