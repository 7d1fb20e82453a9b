"""The examples of docs/render.md."""

import doctest
from pathlib import Path


def test_the_page_is_true():
    page = Path(__file__).resolve().parents[2] / "docs" / "render.md"
    result = doctest.testfile(str(page), module_relative=False, optionflags=doctest.NORMALIZE_WHITESPACE)
    assert result.attempted > 10
    assert result.failed == 0
