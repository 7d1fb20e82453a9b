"""The examples of the pages on marker files run, and show what they say."""

from __future__ import annotations

import doctest

import pytest

from tests.conftest import ROOT


@pytest.mark.parametrize("page", ["c3d.md", "trc.md", "csm.md"])
def test_pages(page: str) -> None:
    result = doctest.testfile(str(ROOT / "docs" / "formats" / page), module_relative=False, encoding="utf-8")
    assert result.attempted and not result.failed
