"""The build hook: when it builds, when it does not, and what it says when it cannot."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def hook() -> ModuleType:
    path = ROOT / "hatch_build.py"
    if not path.is_file():
        pytest.skip("the build hook is part of a checkout only")
    spec = importlib.util.spec_from_file_location("keypose_hatch_build", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    client = tmp_path / "client"
    (client / "src").mkdir(parents=True)
    for name in (
        "index.html",
        "package.json",
        "package-lock.json",
        "vite.config.ts",
        "svelte.config.js",
        "src/main.ts",
    ):
        (client / name).write_text(name)
    return tmp_path


def stand_in(commands: list[list[str]], root: Path) -> Any:
    """Instead of npm and Vite: note the command and leave what it would."""

    def run(command: list[str], folder: Path, failure: str) -> None:
        commands.append(command)
        (folder / "node_modules").mkdir(exist_ok=True)
        static = root / "src/keypose/studio/static"
        static.mkdir(parents=True, exist_ok=True)
        (static / "index.html").write_text("built")

    return run


def test_the_client_is_built_once_and_again_when_a_source_changes(
    hook: ModuleType, checkout: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    commands: list[list[str]] = []
    monkeypatch.setattr(hook, "_node", lambda: Path("node"))
    monkeypatch.setattr(hook, "_npm_cli", lambda node: Path("npm-cli.js"))
    monkeypatch.setattr(hook, "_run", stand_in(commands, checkout))
    hook.build(checkout)
    assert ["ci" in c for c in commands] == [True, False], "first the packages, then the build"
    hook.build(checkout)
    assert len(commands) == 2, "nothing has changed"
    (checkout / "client/src/main.ts").write_text("changed")
    hook.build(checkout)
    assert len(commands) == 3, "the packages are still the right ones"
    (checkout / "client/package-lock.json").write_text("newer")
    hook.build(checkout)
    assert "ci" in commands[3]


def test_the_hash_knows_names_and_bytes(hook: ModuleType, checkout: Path) -> None:
    before = hook.source_hash(checkout / "client")
    (checkout / "client/src/main.ts").rename(checkout / "client/src/other.ts")
    renamed = hook.source_hash(checkout / "client")
    (checkout / "client/README").write_text("not a source")
    assert before != renamed == hook.source_hash(checkout / "client")


def test_an_archive_with_the_result_and_no_sources_is_taken_as_it_is(hook: ModuleType, tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match="neither"):
        hook.build(tmp_path)
    static = tmp_path / "src/keypose/studio/static"
    static.mkdir(parents=True)
    (static / "index.html").write_text("built")
    hook.build(tmp_path)


def test_a_failure_shows_what_the_tool_said_and_what_to_do(hook: ModuleType, tmp_path: Path) -> None:
    with pytest.raises(SystemExit) as error:
        hook._run(["sh", "-c", "echo ENOTFOUND; exit 1"], tmp_path, "is the npm registry reachable?")
    assert "ENOTFOUND" in str(error.value)
    assert "is the npm registry reachable?" in str(error.value)


def test_the_lock_file_names_no_registry() -> None:
    lock = ROOT / "client" / "package-lock.json"
    if not lock.is_file():
        pytest.skip("no checkout")
    assert "resolved" not in lock.read_text()
    assert "http" not in (ROOT / "client" / ".npmrc").read_text()
