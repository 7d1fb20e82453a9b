"""Retargeting over real sockets: what a page gets is what the library makes, and it ends in files and in the project."""

from __future__ import annotations

import json
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from studio_scenes import Start, arm_scene
from test_server import request, with_token
from typer.testing import CliRunner

from keypose import io, samples
from keypose.analysis import find_roles
from keypose.analysis.roles import ROLES
from keypose.cli.app import app
from keypose.evaluate import bake, sample_timeline, world
from keypose.model import Motion, Pose
from keypose.project.file import from_bytes
from keypose.retarget import ground_under, retarget
from keypose.studio import StudioServer
from keypose.studio.container import unpack
from keypose.studio.requests import parse_retarget_request

PLAIN: dict[str, Any] = {
    "type": "retarget",
    "source": "sample:walk",
    "source_character": 0,
    "animation": 0,
    "target": "sample:human",
    "target_character": 0,
    "source_roles": None,
    "target_roles": None,
    "source_reference": "",
    "target_reference": "",
    "scale": None,
    "plant": True,
    "keep_hands": False,
    "props": [],
    "rate_hz": None,
    "against": "",
}


@pytest.fixture(scope="module")
def server(start: Start) -> StudioServer:
    return start(("arm.glb", arm_scene()))


def ask(server: StudioServer, **fields: Any) -> Any:
    body = json.dumps(fields).encode()
    status, headers, data = request(server, "POST", "/api/retarget", body, with_token(server))
    assert headers["content-type"].startswith("application/json"), data
    assert status == 200
    return json.loads(data)


def opened(server: StudioServer, *ids: str) -> StudioServer:
    """The server once it has these scenes: they come after it listens."""
    for id in ids:
        for _ in range(400):
            if not ask(server, type="retarget_subject", scene=id)["error"]:
                break
            time.sleep(0.05)
    return server


def motion_of(server: StudioServer, id: str) -> tuple[dict[str, Any], Any]:
    status, _, data = request(server, "GET", f"/api/scenes/{id}", headers=with_token(server))
    assert status == 200
    header, body = unpack(data)

    def read(ref: dict[str, Any]) -> np.ndarray:
        return np.frombuffer(body[ref["offset"] : ref["offset"] + ref["bytes"]], ref["element"]).reshape(ref["shape"])

    return header, read


def test_a_subject_comes_with_the_roles_of_its_characters(server: StudioServer) -> None:
    told = ask(server, type="retarget_subject", scene="sample:human")
    assert told["error"] == ""
    skeleton = samples.load("human").character.skeleton
    found = find_roles(skeleton)
    assert told["characters"][0]["roles"] == {role: skeleton.names[j] for role, j in found.roles.items()}
    assert told["characters"][0]["missing"] == []
    header, _ = motion_of(server, told["scene"]["id"])
    assert header["characters"][0]["skeleton"]["names"] == list(skeleton.names)


def test_what_is_no_humanoid_says_what_is_missing(server: StudioServer) -> None:
    told = ask(server, type="retarget_subject", scene="s1")
    assert told["scene"]["id"] == "s1" and "hips" in told["characters"][0]["missing"]
    done = ask(server, **{**PLAIN, "target": "s1"})
    assert done["scene"] is None and "no humanoid" in done["error"]
    assert "scene" in ask(server, type="retarget_subject", scene="s77")["error"]


def test_the_motion_is_the_librarys(server: StudioServer) -> None:
    done = ask(server, **{**PLAIN, "scale": 0.8, "rate_hz": 30.0})
    assert done["error"] == "" and done["scale"] == 0.8
    walk, body = samples.load("walk"), samples.load("human").character
    expected = retarget(
        walk.animations[0],
        walk.character.skeleton,
        body.skeleton,
        scale=0.8,
        rate_hz=30.0,
        target_ground_m=ground_under(body),
    )
    assert done["frames"] == expected.motion.frame_count and done["rate_hz"] == 30.0
    assert done["direction_deg"] == pytest.approx(expected.report.direction_deg, abs=1e-6)
    assert done["slide_cm_s"] == pytest.approx(expected.report.slide_cm_s, abs=1e-6)
    header, read = motion_of(server, done["id"])
    sent = header["animations"][0]
    assert header["characters"] == [] and sent["name"] == walk.animations[0].name
    assert np.abs(read(sent["rotations"]) - expected.motion.pose.broadcast().rotations).max() < 1e-6
    assert np.abs(read(sent["translations"]) - expected.motion.pose.broadcast().translations).max() < 1e-6


def test_steps_are_where_feet_are_down(server: StudioServer) -> None:
    done = ask(server, **PLAIN)
    header, _ = motion_of(server, done["id"])
    assert header["animations"][0]["frames"] == done["frames"]
    status, _, data = request(server, "GET", f"/api/retarget/{done['id']}/glb", headers=with_token(server))
    assert status == 200
    walked = _loaded(data)
    names = walked.character.skeleton.names
    places = np.asarray(world(walked.character.skeleton, _motion(walked).pose))[..., :3, 3]
    assert [foot["role"] for foot in done["feet"]] == ["left_foot", "right_foot"]
    slides = []
    for foot in done["feet"]:
        ankle, ball = (places[:, names.index(joint)] for joint in foot["target"])
        steps = np.reshape(foot["steps"], (-1, 2))
        assert len(steps) > 0 and steps.max() < done["frames"] and np.all(steps[:, 0] <= steps[:, 1])
        down = np.zeros(done["frames"], bool)
        for first, last in steps:
            down[first : last + 1] = True
        assert ankle[down, 1].mean() + 0.02 < ankle[~down, 1].mean()
        speed = 100.0 * done["rate_hz"] * np.linalg.norm(np.diff(ball[:, [0, 2]], axis=0), axis=1)
        assert speed[down[1:] & down[:-1]].mean() < 0.3 * speed[~(down[1:] | down[:-1])].mean()
        assert len(foot["source_slides_cm_s"]) == len(foot["target_slides_cm_s"]) == len(steps)
        slides += foot["target_slides_cm_s"]
    assert max(slides) <= done["worst_slide_cm_s"] + 1e-6 and done["worst_slide_cm_s"] < 1.0


def _loaded(data: bytes) -> Any:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "a.glb")
        path.write_bytes(data)
        return io.load(path)


def _motion(scene: Any, rate_hz: float = 60.0) -> Motion:
    found = scene.animations[0]
    return found if isinstance(found, Motion) else bake(found, scene.character.skeleton, rate_hz)


def test_hands_are_kept_where_that_is_asked(server: StudioServer) -> None:
    assert ask(server, **{**PLAIN, "source": "sample:talk"})["hands_off_cm"] is None
    done = ask(server, **{**PLAIN, "source": "sample:talk", "keep_hands": True})
    assert done["error"] == "" and done["hands_off_cm"] >= 0.0


def test_a_map_counts_and_a_wrong_one_is_told(server: StudioServer) -> None:
    told = ask(server, type="retarget_subject", scene="sample:human")["characters"][0]
    without = {role: joint for role, joint in told["roles"].items() if not role.startswith("left_index")}
    done = ask(server, **{**PLAIN, "target_roles": without})
    assert done["error"] == "" and any("left_index" in note for note in done["notes"])
    wrong = ask(server, **{**PLAIN, "target_roles": {**without, "hips": "Hisp"}})
    assert wrong["scene"] is None and "Hips" in wrong["error"]
    kept = ask(server, type="retarget_roles", scene="sample:human", character=0, known={"jaw": "Head"})
    assert kept["roles"]["jaw"] == "Head" and kept["confidence"]["jaw"] == 1.0
    assert set(kept["roles"]) <= set(ROLES)


def test_what_is_no_request_is_refused(server: StudioServer) -> None:
    for body in (b"", b"{", b"[]", json.dumps({**PLAIN, "scale": "two"}).encode(), json.dumps({"type": "x"}).encode()):
        status, _, _ = request(server, "POST", "/api/retarget", body, with_token(server))
        assert status == 400
        assert parse_retarget_request(body.decode()) is None
    assert request(server, "POST", "/api/retarget", json.dumps(PLAIN).encode())[0] == 403
    assert request(server, "GET", "/api/retarget/r99/glb", headers=with_token(server))[0] == 422
    done = ask(server, **PLAIN)
    assert request(server, "GET", f"/api/retarget/{done['id']}/exe", headers=with_token(server))[0] == 422
    assert ask(server, **{**PLAIN, "animation": 9})["error"]
    assert "scale" in ask(server, **{**PLAIN, "scale": -1.0})["error"]


def test_it_goes_into_the_project_as_one_step(server: StudioServer) -> None:
    done = ask(server, **PLAIN)
    body = json.dumps({}).encode()
    status, _, data = request(server, "POST", f"/api/retarget/{done['id']}/edit", body, with_token(server))
    result = json.loads(data)
    assert status == 200 and result["error"] == ""
    status, _, project = request(server, "GET", "/api/project/export/keypose", headers=with_token(server))
    document = from_bytes(project)
    (name,) = document.characters
    timeline = document.timeline(document.performs[name])
    (placement,) = timeline.layers[0].placements
    clip = document.clip(placement.animation)
    assert list(document.clips) == [clip.name] == [done["name"]]
    assert timeline.end_s == pytest.approx(clip.start_s + clip.duration_s)
    header, read = motion_of(server, done["id"])
    sent = read(header["animations"][0]["rotations"])
    skeleton = document.character(name).skeleton
    for frame in (0, 7, done["frames"] - 1):
        time_s = clip.start_s + frame / done["rate_hz"]
        shown = sample_timeline(timeline, document.clips, skeleton, time_s)
        assert np.abs(np.sum(shown.rotations * sent[frame], axis=-1)).min() > 1 - 1e-6


def test_a_stand_may_be_a_moment_of_a_motion_or_of_another_file(start: Start) -> None:
    walk = samples.load("walk")
    take, skeleton = walk.animations[0], walk.character.skeleton
    assert isinstance(take, Motion)
    server = opened(start(("walk.glb", walk), ("human.glb", samples.open_scene("sample:human"))), "s1", "s2")
    pose = take.pose.broadcast()
    stand = Pose(pose.translations[12], pose.rotations[12], pose.scales[12])
    expected = retarget(take, skeleton, skeleton, source_reference=stand, target_ground_m=ground_under(walk.character))

    def places(**fields: Any) -> np.ndarray:
        done = ask(server, **{**PLAIN, "source": "s1", "target": "s2", **fields})
        assert done["error"] == ""
        header, read = motion_of(server, done["id"])
        return read(header["animations"][0]["rotations"])

    moment = str(take.start_s + 12 / take.rate_hz)
    own = places(source_reference=moment)
    np.testing.assert_allclose(own, expected.motion.pose.broadcast().rotations, atol=1e-6)
    assert np.abs(own - places()).max() > 0.01
    # of another file of the same rig it is the same pose
    np.testing.assert_allclose(places(source_reference=f"s1:{moment}"), own, atol=1e-5)
    np.testing.assert_allclose(places(target_reference="s1:rest"), places(target_reference="rest"), atol=1e-5)
    for wrong in ("now", "s1:", "s9:0", "s1:nan", "-"):
        assert ask(server, **{**PLAIN, "source_reference": wrong})["error"], wrong


def test_hands_keep_to_props(server: StudioServer) -> None:
    free = ask(server, **PLAIN)
    walk = samples.load("walk")
    hand = walk.character.skeleton.names.index("LeftHand")
    at = np.asarray(world(walk.character.skeleton, _motion(walk).pose))[30, hand, :3, 3].tolist()
    held = ask(server, **{**PLAIN, "scale": 1.0, "props": [at]})
    assert held["error"] == "" and free["hands_off_cm"] is None and held["hands_off_cm"] >= 0.0
    # on the same body in the same place, over the ground of each
    body = walk.character
    same = retarget(walk.animations[0], body.skeleton, body.skeleton, scale=1.0, target_ground_m=ground_under(body))
    lifted = [at[0], at[1] + same.target.ground_m - same.source.ground_m, at[2]]
    assert np.ravel(held["props"]) == pytest.approx([*at, *lifted], abs=1e-6)
    moved = [lifted[0] + 0.05, lifted[1] + 0.05, lifted[2]]
    there = ask(server, **{**PLAIN, "scale": 1.0, "props": [at + moved]})
    assert np.ravel(there["props"]) == pytest.approx(at + moved)

    def reached(done: dict[str, Any]) -> np.ndarray:
        header, read = motion_of(server, done["id"])
        sent = header["animations"][0]
        pose = Pose(read(sent["translations"])[30], read(sent["rotations"])[30], body.skeleton.rest.scales)
        return np.asarray(world(body.skeleton, pose))[hand, :3, 3]

    np.testing.assert_allclose(reached(there) - reached(held), np.subtract(moved, lifted), atol=0.01)
    assert "prop" in ask(server, **{**PLAIN, "props": [[0.0, 1.0]]})["error"]


def test_a_result_is_set_beside_somebody_elses(start: Start) -> None:
    server = opened(start(("walk.glb", samples.load("walk")), ("arm.glb", arm_scene())), "s1", "s2")
    done = ask(server, **{**PLAIN, "source": "s1", "against": "s1"})
    assert done["error"] == ""
    beside = done["beside"]
    assert beside["name"] == "walk.glb" and beside["error"] == ""
    assert abs(beside["turned_deg"]) < 0.1 and beside["shift_s"] == 0.0
    assert beside["direction_deg"]["arms"] < 0.1 and beside["frames"] == done["frames"]
    assert ask(server, **{**PLAIN, "source": "s1"})["beside"] is None
    # what cannot be compared leaves the motion as it is
    other = ask(server, **{**PLAIN, "source": "s1", "against": "s2"})
    assert other["error"] == "" and other["scene"] and other["beside"]["error"]
    assert ask(server, **{**PLAIN, "source": "s1", "against": "s9"})["error"]


@pytest.mark.data
def test_a_real_pair_as_the_command_makes_it(start: Start, data_dir: Path, tmp_path: Path) -> None:
    take, cast = data_dir / "asf_amc" / "cmu_02" / "02_01.amc", data_dir / "fbx" / "ozz_pab" / "arnaud.fbx"
    server = opened(start(("02_01.amc", io.load(take)), ("arnaud.fbx", io.load(cast))), "s1", "s2")
    done = ask(server, **{**PLAIN, "source": "s1", "target": "s2"})
    assert done["error"] == ""
    assert done["slide_cm_s"] < 1.0 < done["loose_slide_cm_s"]
    assert done["mean_direction_deg"] < 8.0
    written = tmp_path / "made.glb"
    assert CliRunner().invoke(app, ["retarget", str(take), "--to", str(cast), str(written)]).exit_code == 0
    status, _, data = request(server, "GET", f"/api/retarget/{done['id']}/glb", headers=with_token(server))
    assert status == 200
    ours, theirs = _loaded(data), io.load(written)
    places = [np.asarray(world(s.character.skeleton, _motion(s, 120.0).pose))[..., :3, 3] for s in (ours, theirs)]
    assert np.abs(places[0] - places[1]).max() < 1e-5
