"""The examples of the graph's page run and print what the page says."""

from __future__ import annotations

import doctest
from pathlib import Path

import numpy as np

PAGE = Path(__file__).resolve().parents[2] / "docs" / "graph.md"


def test_the_examples_of_the_page() -> None:
    with np.printoptions():
        result = doctest.testfile(str(PAGE), module_relative=False)
    assert result.attempted > 25
    assert result.failed == 0
