"""three.js interpolates, in a browser: its interpolants on random keys, and the tracks that it reads from real glTF files."""

from __future__ import annotations

import mimetypes
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from keypose.evaluate import sample_curve
from keypose.io.gltf import hierarchy, read
from keypose.io.gltf.container import open_container
from keypose.io.gltf.document import parse
from keypose.io.json_values import parse_json
from keypose.io.notes import Notes
from keypose.math import quat
from keypose.model import Channel, Curve, CurveKind, Interpolation, Property
from tests.conftest import find_data_dir
from tests.io.gltf_node import npm_package

pytestmark = pytest.mark.browser

PAGE = """<!doctype html><meta charset="utf-8"><title>reference</title>
<script type="importmap">{"imports": {
  "three": "/three/build/three.module.js", "three/addons/": "/three/examples/jsm/"}}</script>
<script type="module">
import * as THREE from "three";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";

window.interpolate = (name, times, values, size, at, inTangents, outTangents) => {
  const interpolant = new THREE[name](new Float64Array(times), new Float64Array(values), size, new Float64Array(size));
  if (inTangents) Object.assign(interpolant, { inTangents, outTangents });
  return at.map(t => [...interpolant.evaluate(t)]);
};

// Every track of a clip at the times: the node that it moves, the property, and the values.
window.tracks = async (url, clip, times) => {
  const gltf = await new GLTFLoader().loadAsync(url);
  const found = [];
  for (const track of gltf.animations[clip].tracks) {
    const { nodeName, propertyName } = THREE.PropertyBinding.parseTrackName(track.name);
    const object = THREE.PropertyBinding.findNode(gltf.scene, nodeName);
    const node = (gltf.parser.associations.get(object) || {}).nodes;
    const interpolant = track.createInterpolant();
    found.push({ node, property: propertyName, kind: interpolant.constructor.name,
                 values: times.map(t => [...interpolant.evaluate(t)]) });
  }
  return found;
};
window.ready = true;
</script>"""


@pytest.fixture(scope="module")
def page() -> Iterator[Any]:
    """A page with three.js; files of the data folder lie under /files/."""
    api = pytest.importorskip("playwright.sync_api")
    chromium = shutil.which("chromium") or shutil.which("chromium-browser")
    if chromium is None:
        pytest.skip("no Chromium on this machine")
    folders = {"three": npm_package("three"), "files": find_data_dir()}

    def serve(route: Any) -> None:
        head, _, rest = route.request.url.removeprefix("http://test.invalid/").partition("/")
        if not head:
            route.fulfill(body=PAGE, content_type="text/html")
            return
        folder = folders.get(head)
        path = None if folder is None else folder / rest
        if path is None or not path.is_file():
            route.fulfill(status=404)
            return
        kind = "text/javascript" if path.suffix == ".js" else mimetypes.guess_type(path.name)[0]
        route.fulfill(body=path.read_bytes(), content_type=kind or "application/octet-stream")

    with api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=chromium, args=["--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage"]
        )
        page = browser.new_page()
        page.route("**/*", serve)
        page.goto("http://test.invalid/")
        page.wait_for_function("window.ready === true", timeout=60_000)
        yield page
        browser.close()


def theirs(page: Any, name: str, times: Any, values: Any, at: Any, *handles: Any) -> np.ndarray:
    values = np.asarray(values, float)
    given = [times, values.ravel(), values.shape[1], at, *(h.ravel() for h in handles)]
    call = "given => window.interpolate(...given)"
    return np.array(page.evaluate(call, [name, *(g.tolist() if isinstance(g, np.ndarray) else g for g in given)]))


@pytest.fixture
def keys() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(5)
    times = np.cumsum(rng.uniform(0.1, 1.0, 12))
    return times, rng.normal(size=(12, 3)), np.linspace(times[0] - 0.2, times[-1] + 0.2, 300)


def test_linear(page: Any, keys: Any) -> None:
    times, values, at = keys
    expected = theirs(page, "LinearInterpolant", times, values, at)
    np.testing.assert_allclose(sample_curve(Curve(times, values), at), expected, atol=1e-12)


def test_steps(page: Any, keys: Any) -> None:
    times, values, at = keys
    expected = theirs(page, "DiscreteInterpolant", times, values, at)
    np.testing.assert_array_equal(sample_curve(Curve(times, values, Interpolation.STEP), at), expected)


def test_slerp(page: Any, keys: Any) -> None:
    times, _, at = keys
    rng = np.random.default_rng(6)
    rotations = quat.normalize(rng.normal(size=(len(times), 4)))
    expected = theirs(page, "QuaternionLinearInterpolant", times, rotations[:, [1, 2, 3, 0]], at)[:, [3, 0, 1, 2]]
    found = sample_curve(Curve(times, rotations, kind=CurveKind.ROTATION), at)
    assert quat.angle_between(found, quat.normalize(expected)).max() < 1e-7


def test_cubic(page: Any, keys: Any) -> None:
    """three.js's smooth interpolation: Hermite with the average of the speeds before and after as tangent."""
    times, values, at = keys
    expected = theirs(page, "CubicInterpolant", times, values, at)
    speeds = np.diff(values, axis=0) / np.diff(times)[:, None]
    slopes = np.concatenate([speeds[:1], 0.5 * (speeds[:-1] + speeds[1:]), speeds[-1:]])
    found = sample_curve(Curve(times, values, Interpolation.HERMITE, slopes, slopes), at)
    inside = (at > times[1]) & (at < times[-2])  # its ends are its own
    np.testing.assert_allclose(found[inside], expected[inside], atol=1e-11)


def test_bezier(page: Any, keys: Any) -> None:
    """Weighted handles, of any length up to the span's, against the solver of three.js (which stops at 1e-10)."""
    times, values, at = keys
    rng = np.random.default_rng(8)
    spans = np.diff(times)
    before, after = np.append(spans[:1], spans), np.append(spans, spans[-1:])
    seconds = rng.uniform(0.05, 0.95, (2, *values.shape)) * np.stack([-before, after])[..., None]
    back, out = np.stack([seconds, rng.normal(size=seconds.shape)], axis=-1)
    curve = Curve(times, values, Interpolation.BEZIER, in_handles=back, out_handles=out)
    places = np.stack([np.broadcast_to(times[:, None], values.shape), values], axis=-1)
    expected = theirs(page, "BezierInterpolant", times, values, at, places + back, places + out)
    np.testing.assert_allclose(sample_curve(curve, at), expected, atol=1e-6)


FILES = [
    "gltf/khronos/interpolation_test.gltf",
    "gltf/khronos/box_animated.gltf",
    "gltf/khronos/cesium_man.gltf",
    "gltf/khronos/Fox.glb",
    "gltf/castle_fox/Fox.gltf",
    "gltf/blender_io/03_all_animations/03_all_animations.gltf",
]
PROPERTIES = {"position": Property.TRANSLATION, "quaternion": Property.ROTATION, "scale": Property.SCALE}


@pytest.mark.data
@pytest.mark.parametrize("file", FILES)
def test_the_tracks_of_real_files(file: str, page: Any, data_dir: Path, record_property: Any) -> None:
    path = data_dir / file
    scene = read(path)
    tree, _ = hierarchy.build(parse(parse_json(open_container(path, Notes()).json)), Notes())
    kinds: set[str] = set()
    largest = 0.0
    for number, clip in enumerate(scene.animations):
        at = np.random.default_rng(number).uniform(clip.start_s, clip.end_s, 40)
        call = "([u, c, t]) => window.tracks(u, c, t)"
        for track in page.evaluate(call, [f"/files/{file}", number, at.tolist()]):
            if track["property"] not in PROPERTIES:
                continue
            name = tree.skeleton.names[tree.joint_of_node[track["node"]]]
            curve = clip.curves[Channel(name, PROPERTIES[track["property"]])]
            ours, expected = sample_curve(curve, at).astype(float), np.array(track["values"])
            kinds.add(track["kind"])
            if track["property"] == "quaternion":
                off = quat.angle_between(quat.normalize(ours), quat.normalize(expected[:, [3, 0, 1, 2]]))
                # three.js stores float32
                largest = max(largest, float(off.max()))
            else:
                size = max(float(np.abs(expected).max()), 1e-6)
                largest = max(largest, float(np.abs(ours - expected).max()) / size)
    record_property("kinds", sorted(kinds))
    record_property("error", largest)
    assert kinds and largest < 5e-6
    if "interpolation_test" in file:
        assert len(kinds) >= 4, kinds  # steps, lines and splines, of vectors and of rotations
