"""The examples of the documentation of files run, and show what they say."""

from __future__ import annotations

import doctest

import pytest

import keypose.io
from tests.conftest import ROOT


def test_the_package_page() -> None:
    result = doctest.testmod(keypose.io)
    assert result.attempted and not result.failed


@pytest.mark.parametrize("page", ["bvh.md", "gltf.md"])
def test_pages(page: str) -> None:
    result = doctest.testfile(str(ROOT / "docs" / page), module_relative=False, encoding="utf-8")
    assert result.attempted and not result.failed
