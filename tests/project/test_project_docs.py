"""The page about projects is true, and the public names are these."""

from __future__ import annotations

import doctest
from pathlib import Path

import pytest

from keypose import project
from tests.conftest import ROOT


def test_the_page_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    result = doctest.testfile(str(ROOT / "docs" / "project.md"), module_relative=False)
    assert result.attempted > 20
    assert result.failed == 0


def test_the_public_names() -> None:
    assert sorted(project.__all__) == [
        "History", "Locked", "NotSaved", "Unsaved", "Workspace", "add_character", "apply_all", "difference", "import_animation",
        "load", "save", "state_folder",
    ]  # fmt: skip
    assert all(hasattr(project, name) for name in project.__all__)
