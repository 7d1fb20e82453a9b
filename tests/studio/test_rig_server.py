"""Rigs over real sockets: what a page asks becomes the document's, and poses are what the library makes of them."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any
from urllib.parse import quote

import numpy as np
import pytest
from edit_page import EditPage
from studio_scenes import Start, arm_scene
from test_server import request, with_token

from keypose import evaluate, samples
from keypose.model import Pose
from keypose.project.file import from_bytes
from keypose.rig import (
    bake_rig_timeline,
    evaluate_rig,
    is_keyed,
    match_ik_to_fk,
    mirror_controls,
    solve_rig,
    switch_space,
)
from keypose.studio import StudioServer
from keypose.studio.container import Body, pack, unpack
from keypose.studio.rig_messages import RigPoseRequest

sync = pytest.importorskip("websockets.sync.client")


@pytest.fixture(scope="module")
def server(start: Start) -> StudioServer:
    return start(("arm.glb", arm_scene()))


@contextmanager
def rigged(server: StudioServer, *, motion: str = "") -> Iterator[EditPage]:
    """A project with the built-in human, moved by a motion, and a rig."""
    with sync.connect(f"ws://127.0.0.1:{server.port}/api/events?token={server.token}", max_size=None) as socket:
        page = EditPage(socket, server)
        page.hello = page.until("hello")
        page.say("project_watch")
        page.until("project_state")
        page.say("project_new", name="Rigged", character="sample:human", discard=True)
        state = page.until("project_state")
        page.who = state["characters"][0]["name"]
        page.line = state["characters"][0]["timeline"]
        if motion:
            walk = samples.load(motion).animations[0]
            clip = walk if not hasattr(walk, "pose") else evaluate.to_clip(walk)
            name = state["timelines"][0]["layers"][0]["placements"][0]["animation"]
            assert not page.set_curves(name, dict(clip.curves), label="Walk")["error"]
            page.until("project_changed")
        answer = ask(server, type="rig_add", character=page.who, fit=True)
        assert answer["error"] == "", answer
        changed = page.until("project_changed")
        page.rig = changed["rigs"][0]
        page.report = answer["report"]
        yield page


def ask(server: StudioServer, **fields: Any) -> Any:
    status, _, data = request(server, "POST", "/api/project/rig", json.dumps(fields).encode(), with_token(server))
    assert status in (200, 400), data
    return json.loads(data)


def document(server: StudioServer) -> Any:
    return from_bytes(request(server, "GET", "/api/project/export/keypose", headers=with_token(server))[2])


def arrays(data: bytes) -> dict[str, Any]:
    header, body = unpack(data)
    for key, ref in header.items():
        if isinstance(ref, dict):
            flat = np.frombuffer(body[ref["offset"] : ref["offset"] + ref["bytes"]], ref["element"])
            header[key] = flat.reshape(ref["shape"])
    return header


def numbers(pose: Pose) -> np.ndarray:
    return np.concatenate([pose.translations, pose.rotations, pose.scales], axis=-1)


def pose_request(name: str, controls: Any, joints: Any, values: Any, **wish: Any) -> bytes:
    body = Body()
    refs = [body.add(a, "float64") for a in (controls, joints, values)]
    fields: dict[str, Any] = {"wish": "none", "modules": [], "control": "", "space": 0, **wish}
    return pack(RigPoseRequest("rig_pose", name, *refs, **fields), body)


def posed(server: StudioServer, *arguments: Any, **wish: Any) -> dict[str, Any]:
    data = pose_request(*arguments, **wish)
    status, _, answer = request(server, "POST", "/api/project/rig/pose", data, with_token(server))
    assert status == 200, answer
    return arrays(answer)


def test_a_rig_is_added_as_one_step_and_undone(server: StudioServer) -> None:
    with rigged(server) as page:
        rig = document(server).rig_of(page.who)
        assert [c["name"] for c in page.rig["controls"]] == list(rig.controls.names)
        assert [a["name"] for a in page.rig["attributes"]] == [a.name for a in rig.attributes]
        switches = {m["name"]: m["switch"] for m in page.rig["modules"]}
        assert switches and all(not s or s in {a.name for a in rig.attributes} for s in switches.values())
        assert any(switches.values())
        assert "already" in ask(server, type="rig_add", character=page.who, fit=True)["error"]
        page.say("project_undo")
        assert page.until("project_changed")["rigs"] == []
        page.say("project_redo")
        again = page.until("project_changed")["rigs"][0]
        assert again["controls"] == page.rig["controls"]


def test_poses_are_the_librarys(server: StudioServer) -> None:
    rng = np.random.default_rng(4)
    with rigged(server) as page:
        kept = document(server)
        rig, who = kept.rig_of(page.who), kept.character(page.who)
        controls = np.repeat(numbers(rig.controls.rest)[None], 3, axis=0)
        controls[..., :3] += 0.02 * rng.normal(size=controls[..., :3].shape)
        controls[..., 3:7] += 0.1 * rng.normal(size=controls[..., 3:7].shape)
        controls[..., 3:7] /= np.linalg.norm(controls[..., 3:7], axis=-1, keepdims=True)
        joints = np.repeat(numbers(who.skeleton.rest)[None], 3, axis=0)
        values = np.array([[a.default for a in rig.attributes]] * 3)
        pose = Pose(controls[..., :3], controls[..., 3:7], controls[..., 7:])
        base = Pose(joints[..., :3], joints[..., 3:7], joints[..., 7:])
        named = {a.name: values[:, n] for n, a in enumerate(rig.attributes)}
        got = posed(server, rig.name, controls, joints, values)
        np.testing.assert_allclose(
            got["joints"], numbers(evaluate_rig(rig, who.skeleton, pose, named, base)), atol=1e-12
        )
        want = solve_rig(rig, who.skeleton, pose, named, base)
        np.testing.assert_allclose(got["model_from_control"], want.model_from_control, atol=1e-12)
        matched, after = match_ik_to_fk(rig, who.skeleton, pose, named, base)
        got = posed(server, rig.name, controls, joints, values, wish="match_ik_to_fk")
        np.testing.assert_allclose(got["controls"], numbers(matched), atol=1e-12)
        np.testing.assert_allclose(got["values"], np.stack([after[a.name] for a in rig.attributes], -1), atol=1e-12)
        other, after = mirror_controls(rig, pose, named)
        got = posed(server, rig.name, controls, joints, values, wish="mirror")
        np.testing.assert_allclose(got["controls"], numbers(other), atol=1e-12)
        np.testing.assert_allclose(got["values"], np.stack([after[a.name] for a in rig.attributes], -1), atol=1e-12)
        look = next(c for c in rig.looks if len(c.spaces) > 1)
        moved, _ = switch_space(rig, who.skeleton, look.name, look.spaces[1].name, pose, named, base)
        got = posed(server, rig.name, controls, joints, values, wish="switch_space", control=look.name, space=1)
        np.testing.assert_allclose(got["controls"], numbers(moved), atol=1e-12)


def test_a_motion_goes_to_controls_to_a_track_and_back_to_joints(server: StudioServer) -> None:
    with rigged(server, motion="walk") as page:
        kept = document(server)
        rig, who, line = kept.rig_of(page.who), kept.character(page.who), kept.timeline(page.line)
        assert is_keyed(rig, line, kept.clips) and "the motion stays as it was" in page.report
        path = f"/api/project/rig/track?rig={quote(rig.name)}&timeline={quote(page.line)}"
        status, _, data = request(server, "GET", path, headers=with_token(server))
        assert status == 200
        track = arrays(data)
        want = bake_rig_timeline(rig, who.skeleton, line, kept.clips)
        assert track["keyed"] and track["revision"] == page.rig["revision"]
        np.testing.assert_allclose(track["joints"], numbers(want.pose.broadcast()), atol=1e-6)
        # what the motion was before the rig
        page.say("project_undo")
        page.until("project_changed")
        before = document(server)
        page.say("project_redo")
        page.until("project_changed")
        answer = ask(server, type="rig_remove", rig=rig.name, bake=True)
        assert answer["error"] == "", answer
        after = document(server)
        assert not after.rigs
        motions = [
            evaluate.bake_timeline(d.timeline(page.line), d.clips, who.skeleton).pose.broadcast()
            for d in (before, after)
        ]
        places = [evaluate.world_rotations_positions(who.skeleton, m)[1] for m in motions]
        assert np.abs(places[0] - places[1]).max() < 2e-4


@pytest.mark.parametrize(
    "wrong",
    [
        {"type": "rig_add", "character": "nobody", "fit": True},
        {"type": "rig_fit", "rig": "nothing"},
        {"type": "rig_remove", "rig": "nothing", "bake": False},
    ],
)
def test_what_is_not_there_is_named(server: StudioServer, wrong: dict[str, Any]) -> None:
    assert ("nobody" if wrong["type"] == "rig_add" else "nothing") in ask(server, **wrong)["error"]


def test_damaged_poses_are_refused(server: StudioServer) -> None:
    with rigged(server) as page:
        kept = document(server)
        rig, who = kept.rig_of(page.who), kept.character(page.who)
        controls, joints = numbers(rig.controls.rest)[None], numbers(who.skeleton.rest)[None]
        values = np.array([[a.default for a in rig.attributes]])
        flat = controls.copy()
        flat[..., 3:7] = 0.0
        short = pose_request(rig.name, controls, joints, values)[:-64]
        for data in (
            pose_request("nothing", controls, joints, values),
            pose_request(rig.name, controls[:, :-1], joints, values),
            pose_request(rig.name, flat, joints, values),
            pose_request(rig.name, np.repeat(controls, 2, 0), joints, values),
            pose_request(rig.name, controls, joints, values[:, :-1]),
            pose_request(rig.name, controls, joints, values, wish="dance"),
            pose_request(rig.name, controls, joints, values, wish="switch_space", control="nobody"),
            pose_request(rig.name, controls, joints, values, wish="match_ik_to_fk", modules=["nobody"]),
            short,
            b"KPS1",
        ):
            status, _, answer = request(server, "POST", "/api/project/rig/pose", data, with_token(server))
            assert status == 422 and answer.strip() and b"Traceback" not in answer
