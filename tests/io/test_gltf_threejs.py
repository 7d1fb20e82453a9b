"""Skinned and morphed vertices equal what three.js computes in a browser, file by file and clip by clip."""

from __future__ import annotations

import base64
import http.server
import shutil
import threading
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
import pytest

from keypose import deform, evaluate
from keypose.io.gltf import hierarchy, read, write
from keypose.io.gltf.container import open_container
from keypose.io.gltf.document import parse
from keypose.io.json_values import parse_json
from keypose.io.notes import Notes
from tests.conftest import find_data_dir
from tests.io.gltf_node import npm_package

pytestmark = [pytest.mark.browser, pytest.mark.data]

TIMES_PER_CLIP = 12
TOLERANCE = 1e-4  # of the model's size
# Its rotations are unit quaternions to three digits only. We make them unit, three.js computes with them as they are.
LOOSER = {"gltf/khronos/SimpleSkin.gltf": 3e-4}

# File and the clips to compare (None: all).
FILES: dict[str, list[str] | None] = {
    "gltf/khronos/cesium_man.gltf": None,
    "gltf/khronos/Fox.glb": None,
    "gltf/castle_fox/Fox.gltf": None,
    "gltf/cc0/Knight.glb": ["Walking_A", "Running_A", "Idle", "Death_A", "1H_Melee_Attack_Chop"],
    "gltf/cc0/robot.glb": None,
    "gltf/cc0/greenman.glb": None,
    "gltf/khronos/SimpleSkin.gltf": None,
    "gltf/khronos/rigged_simple.gltf": None,
    "gltf/khronos/box_animated.gltf": None,
    "gltf/khronos/interpolation_test.gltf": None,
    "gltf/khronos/MorphStressTest.gltf": None,
    "gltf/khronos/AnimatedMorphCube/AnimatedMorphCube.gltf": None,
    "gltf/khronos/SimpleMorph/SimpleMorph.gltf": None,
    "gltf/tinygltf/singleBlendshapeCube_sparse.glb": None,
    "gltf/blender_io/01_morphed_cube/01_morphed_cube.gltf": None,
    "gltf/blender_io/03_all_animations/03_all_animations.gltf": None,
    "gltf/blender_io/03_skinned_cylinder/03_skinned_cylinder.gltf": None,
    "gltf/blender_io/06_parent-inverse-anim/06_parent-inverse-anim.gltf": None,
}

PAGE = """<!doctype html><meta charset="utf-8"><title>reference</title>
<script type="importmap">{"imports": {
  "three": "/three/build/three.module.js", "three/addons/": "/three/examples/jsm/"}}</script>
<script type="module">
import * as THREE from "three";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";

// All vertices in world space of every mesh at every time, [{node, primitive, data}] with data as base64 of float32.
window.sample = async (url, clip, times) => {
  const gltf = await new GLTFLoader().loadAsync(url);
  const animation = gltf.animations[clip];
  const mixer = new THREE.AnimationMixer(gltf.scene);
  const action = mixer.clipAction(animation);
  action.setLoop(THREE.LoopOnce);
  action.clampWhenFinished = true;
  action.play();
  const found = [];
  gltf.scene.traverse(object => {
    if (!object.isMesh) return;
    const own = gltf.parser.associations.get(object) || {};
    let holder = object;
    while ((gltf.parser.associations.get(holder) || {}).nodes === undefined) holder = holder.parent;
    const count = object.geometry.attributes.position.count;
    found.push({ object, node: gltf.parser.associations.get(holder).nodes, primitive: own.primitives || 0,
                 count, values: new Float32Array(times.length * count * 3) });
  });
  const point = new THREE.Vector3();
  times.forEach((time, t) => {
    mixer.setTime(time);
    gltf.scene.updateMatrixWorld(true);
    for (const { object, count, values } of found)
      for (let i = 0; i < count; i++)
        object.getVertexPosition(i, point).applyMatrix4(object.matrixWorld).toArray(values, (t * count + i) * 3);
  });
  return found.map(({ node, primitive, values }) => {
    const bytes = new Uint8Array(values.buffer);
    let text = "";
    for (let i = 0; i < bytes.length; i += 8192) text += String.fromCharCode(...bytes.subarray(i, i + 8192));
    return { node, primitive, data: btoa(text) };
  });
};
window.ready = true;
</script>"""


class _Handler(http.server.SimpleHTTPRequestHandler):
    """Serves the page, three.js and the files; nothing else."""

    def __init__(self, *args: Any, folders: dict[str, Path], **more: Any) -> None:
        self.folders = folders
        super().__init__(*args, **more)

    def do_GET(self) -> None:
        if self.path == "/":
            body = PAGE.encode()
            self.send_response(200)
            self.send_header("Content-Type", "text/html")
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)
        else:
            super().do_GET()

    def translate_path(self, path: str) -> str:
        head, _, rest = path.lstrip("/").partition("/")
        folder = self.folders.get(head)
        self.directory = str(folder or "/nonexistent")
        return super().translate_path("/" + rest)

    def log_message(self, format: str, *args: Any) -> None:
        """Quiet."""


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder for files that keypose writes, served as ``written/``."""
    return tmp_path_factory.mktemp("written")


@pytest.fixture(scope="module")
def reference(written: Path) -> Iterator[Any]:
    """``reference(file, clip, times)``: what three.js computes."""
    playwright_api = pytest.importorskip("playwright.sync_api")
    chromium = shutil.which("chromium") or shutil.which("chromium-browser")
    if chromium is None:
        pytest.skip("no Chromium on this machine")
    data = find_data_dir()
    if data is None:
        pytest.skip("the folder of real files is missing; set KEYPOSE_DATA to it")
    handler = partial(_Handler, folders={"three": npm_package("three"), "files": data, "written": written})
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    with playwright_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=chromium, args=["--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage"]
        )
        page = browser.new_page()
        page.goto(f"http://127.0.0.1:{server.server_port}/")
        page.wait_for_function("window.ready === true", timeout=60_000)

        def sample(file: str, clip: int, times: list[float]) -> list[dict[str, Any]]:
            return page.evaluate("([u, c, t]) => window.sample(u, c, t)", [f"/{quote(file)}", clip, times])

        yield sample
        browser.close()
    server.shutdown()
    server.server_close()
    thread.join(timeout=10)


def assert_equal(path: Path, served: str, clips: list[str] | None, tolerance: float, reference: Any) -> float:
    """The largest error of all vertices, as a share of the model's size."""
    scene = read(path)
    character = scene.character
    tree, _ = hierarchy.build(parse(parse_json(open_container(path, Notes()).json)), Notes())
    node_of_name = {tree.skeleton.names[joint]: node for node, joint in tree.joint_of_node.items()}
    compared, largest = 0, 0.0
    for number, clip in enumerate(scene.animations):
        if clips is not None and clip.name not in clips:
            continue
        rng = np.random.default_rng(number)
        inner = np.sort(rng.uniform(clip.start_s, clip.end_s, TIMES_PER_CLIP - 2))
        times = np.array([0.0, *inner, clip.end_s])
        expected = {(m["node"], m["primitive"]): m["data"] for m in reference(served, number, times.tolist())}
        pose = evaluate.sample_clip(clip, character.skeleton, times)
        model_from_joint = evaluate.world(character.skeleton, pose)
        weights = evaluate.sample_morphs(clip, character.morph_names, times, character.rest_morph_weights)
        primitives: dict[int, int] = {}
        results: list[tuple[str, Any, Any]] = []
        for part in character.parts:
            node = node_of_name[part.extras["gltf"]["node"]]
            primitive = primitives.get(node, 0)
            primitives[node] = primitive + 1
            ours = np.asarray(deform.deform_part(character, part, model_from_joint, weights))
            theirs = np.frombuffer(base64.b64decode(expected.pop((node, primitive))), np.float32).reshape(ours.shape)
            results.append((part.name, ours, theirs))
        assert not expected, f"three.js shows meshes that keypose does not: {sorted(expected)}"
        everything = np.concatenate([theirs.reshape(-1, 3) for _, _, theirs in results])
        size = float(np.linalg.norm(np.ptp(everything, axis=0)))
        for name, ours, theirs in results:
            error = float(np.max(np.linalg.norm(ours - theirs, axis=-1)))
            largest = max(largest, error / size)
            assert error <= tolerance * size, f"{clip.name}: part '{name}' is off by {error / size:.2e} of the size"
        compared += 1
    assert compared == (len(scene.animations) if clips is None else len(clips)) > 0
    return largest


@pytest.mark.parametrize("file", FILES)
def test_vertices_equal_those_of_threejs(file: str, data_dir: Path, reference: Any, record_property: Any) -> None:
    tolerance = LOOSER.get(file, TOLERANCE)
    record_property("error", assert_equal(data_dir / file, f"files/{file}", FILES[file], tolerance, reference))


@pytest.mark.parametrize("file", FILES)
def test_what_keypose_writes_is_the_same_in_threejs(
    file: str, data_dir: Path, written: Path, reference: Any, record_property: Any
) -> None:
    copy = written / f"{file.replace('/', '_')}.glb"
    write(read(data_dir / file), copy)
    record_property("error", assert_equal(copy, f"written/{copy.name}", FILES[file], TOLERANCE, reference))
