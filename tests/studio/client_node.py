"""The client's own TypeScript, run in Node, so that its numbers can be compared with Python's."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

from tests.conftest import ROOT
from tests.io.gltf_node import node_executable, npm_package


def client_program(script: str, folder: Path) -> Path:
    """A script that imports modules of ``client/src`` as "@/anim/curve", bundled into one file for `answers`.

    The script gives ``answer``: a function from one JSON value to another.
    """
    package = npm_package("rolldown")
    entry, out, bundle = folder / "entry.ts", folder / "bundle.mjs", folder / "bundle.config.mjs"
    source = ROOT / "client" / "src"
    entry.write_text(
        script
        + "\nimport * as readline from 'node:readline';\n"
        + "for await (const line of readline.createInterface({ input: process.stdin }))\n"
        + "  process.stdout.write(JSON.stringify(await answer(JSON.parse(line))) + '\\n');\n"
    )
    bundle.write_text(
        f"import {{ rolldown }} from {json.dumps((package / 'dist' / 'index.mjs').as_uri())};\n"
        f"const made = await rolldown({{ input: {json.dumps(str(entry))}, platform: 'node', logLevel: 'silent',"
        f" resolve: {{ alias: {{ '@': {json.dumps(str(source))} }} }} }});\n"
        f"await made.write({{ file: {json.dumps(str(out))}, format: 'esm' }});\n"
    )
    subprocess.run([node_executable(), str(bundle)], check=True, capture_output=True, text=True, timeout=120)
    return out


def answers(program: Path, *questions: Any) -> list[Any]:
    """What a program of `client_program` answers to each question."""
    asked = "".join(json.dumps(question) + "\n" for question in questions)
    done = subprocess.run(
        [node_executable(), str(program)], input=asked, capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr
    return [json.loads(line) for line in done.stdout.splitlines()]
