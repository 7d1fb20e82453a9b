"""The benchmark's arithmetic, its JSON, its names, and its refusal to time wrong results."""

from __future__ import annotations

import importlib.util
import json
import time

import pytest

from keypose import bench
from keypose.bench import data
from keypose.bench.suite import BenchmarkError, Suite
from keypose.errors import UnknownName

STUDY_ROWS = {
    ("chain, 1 character, call from Python", "ns/character"),
    ("chain, 1 character, call inside a kernel", "ns/character"),
    ("chain, 16 characters", "ns/character"),
    ("chain, 256 characters", "ns/character"),
    ("chain, 4096 characters", "ns/character"),
    ("sample + blend only, float32 clips", "ns/character"),
    ("sample + blend only, int16 clips", "ns/character"),
    ("skinning, crowd, position + normal", "ns/vertex"),
    ("skinning, crowd, position only", "ns/vertex"),
    ("skinning, crowd of 64, separate outputs, pos + normal", "ns/vertex"),
    ("skinning, 1 character, position + normal", "ns/vertex"),
    ("skinning, 1 character, position only", "ns/vertex"),
    ("BVH motion parse", "MB/s"),
    ("BVH motion write", "MB/s"),
    ("clip FK, 26 joints, [frame, joint]", "frames/s"),
    ("clip FK, 26 joints, lanes", "frames/s"),
    ("slerp, [n, 4]", "slerps/s"),
    ("slerp, lanes", "slerps/s"),
    ("limit: read 0.5 MB (L2)", "GB/s"),
    ("limit: store 0.5 MB (L2)", "GB/s"),
    ("limit: read 16 MB (L3)", "GB/s"),
    ("limit: store 16 MB (L3)", "GB/s"),
    ("limit: read 256 MB (RAM)", "GB/s"),
    ("limit: store 256 MB (RAM)", "GB/s"),
    ("limit: multiply-add", "Gflop/s"),
}


IK_ROWS = {
    ("two-bone IK", "ns/limb"),
    ("full-body IK, 26 joints, 5 effectors, 10 steps", "us/solve"),
    ("full-body IK, 26 joints, 25 effectors, 10 steps", "us/solve"),
    ("retargeting, 61 joints, with contacts", "frames/s"),
}


def busy(seconds):
    def call():
        end = time.thread_time() + seconds
        while time.thread_time() < end:
            pass

    return call


def test_ratios_say_how_far_ahead_for_times_and_for_rates(tmp_path, capsys):
    suite = Suite()
    suite.case("a time", "ms", 1, busy(0.001), busy(0.004), against="other")
    suite.case("a rate", "frames/s", 100, busy(0.001), busy(0.004), against="other", reference_count=200)
    suite.case("alone", "GB/s", 1e6, busy(0.001))
    suite.absent("not there", "ms", "missing library")
    results = suite.run(3, tmp_path / "out.json")
    assert results[0].ratio == pytest.approx(4, rel=0.3) and results[0].value == pytest.approx(1, rel=0.3)
    assert results[1].ratio == pytest.approx(2, rel=0.3) and results[1].value == pytest.approx(1e5, rel=0.3)
    assert results[2].ratio is None and results[2].reference is None
    stored = json.loads((tmp_path / "out.json").read_text())
    assert set(stored) == {"host", "results"}
    assert {"name", "unit", "value", "median", "reference", "ratio"} <= set(stored["results"][0])
    assert stored["results"][3]["note"] == "not installed" and stored["results"][3]["ratio"] is None
    assert "not installed" in capsys.readouterr().out


def test_wrong_results_are_not_timed():
    suite = Suite()
    suite.check("right", 0.0, 0.0)
    for error in (1.1, float("nan")):
        with pytest.raises(BenchmarkError, match="wrong: differs"):
            suite.check("wrong", error, 1.0)


def test_unknown_suites_are_named():
    with pytest.raises(UnknownName, match="kernels"):
        bench.run("kernel")


def test_the_body_is_a_tree_of_67_joints_whose_first_26_stand_alone():
    parents, offsets = data.body()
    assert len(parents) == len(offsets) == 67 and data.BODY_JOINTS == 26
    assert all(parent < joint for joint, parent in enumerate(parents))
    assert parents[:26].max() < 26


@pytest.mark.slow
def test_every_row_of_the_kernels_is_there_and_ahead_of_numpy(tmp_path):
    results = bench.run("kernels", tmp_path / "kernels.json", rounds=3)
    assert {(r.name, r.unit) for r in results} == STUDY_ROWS
    assert all(r.value and r.value > 0 for r in results)
    assert all(r.ratio is not None and r.ratio > 2 for r in results if not r.name.startswith("limit"))


@pytest.mark.slow
def test_the_run_time_measures_the_same_rows_on_compressed_clips(tmp_path):
    results = bench.run("runtime", tmp_path / "runtime.json", rounds=2)
    rows = [(r.name, r.unit) for r in results]
    assert len(set(rows)) == len(rows) and {r.suite for r in results} == {"runtime"}
    assert {row for row in STUDY_ROWS if row[0].startswith(("chain", "limit"))} <= set(rows)
    assert {unit for name, unit in rows if name.startswith("compression, ")} == {":1"}
    assert all(r.value and r.value > 0 for r in results)


@pytest.mark.slow
def test_inverse_kinematics_are_beside_numpy_mink_and_published_figures(tmp_path):
    results = bench.run("ik", tmp_path / "ik.json", rounds=2)
    rows = [(r.name, r.unit) for r in results]
    assert len(set(rows)) == len(rows) and {r.suite for r in results} == {"ik"}
    assert set(rows) >= IK_ROWS
    assert all(r.value and r.value > 0 for r in results)
    assert all(r.ratio > 2 for r in results if r.against == "NumPy" or r.against.startswith("published"))
    if importlib.util.find_spec("mink"):
        assert {r.name.split(" joints, ")[1][:2] for r in results if r.against == "mink"} == {"5 ", "25"}


def test_a_published_figure_is_a_reference():
    suite = Suite()
    suite.case("a rate", "frames/s", 100, busy(0.001), published=50_000.0, against="a paper")
    (result,) = suite.run(2)
    assert result.reference == 50_000 and result.ratio == pytest.approx(2, rel=0.3) and result.against == "a paper"


def test_rows_of_two_suites_may_have_one_name(tmp_path, capsys):
    suite = Suite()
    for name in ("one", "two"):
        suite.begin(name)
        suite.case("the same", "ms", 1, busy(0.0001))
    suite.known("a size", ":1", 20.0, 10.0, "other")
    results = suite.run(1, tmp_path / "out.json")
    assert [(r.name, r.suite, r.ratio) for r in results] == [
        ("the same", "one", None), ("the same", "two", None), ("a size", "two", 2.0),
    ]  # fmt: skip
    assert [r["suite"] for r in json.loads((tmp_path / "out.json").read_text())["results"]] == ["one", "two", "two"]
    lines = [line.split()[0] for line in capsys.readouterr().out.splitlines()]
    assert lines[1] == "one" and lines[3] == "two"
