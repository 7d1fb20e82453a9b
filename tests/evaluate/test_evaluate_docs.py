"""The examples of the documentation pages run and print what the pages say."""

from __future__ import annotations

import doctest

import numpy as np
import pytest

from tests.conftest import ROOT


@pytest.mark.parametrize("page", ["curves.md", "evaluate.md", "skinning.md", "timeline.md"])
def test_the_examples_of_a_page(page: str) -> None:
    with np.printoptions():
        result = doctest.testfile(str(ROOT / "docs" / page), module_relative=False)
    assert result.attempted > 10
    assert result.failed == 0
