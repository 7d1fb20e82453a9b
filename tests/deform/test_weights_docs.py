"""The examples of the page on automatic weights run and print what it says."""

from __future__ import annotations

import doctest

import numpy as np

from tests.conftest import ROOT


def test_the_examples_of_the_page() -> None:
    with np.printoptions():
        result = doctest.testfile(
            str(ROOT / "docs" / "weights.md"), module_relative=False, optionflags=doctest.ELLIPSIS
        )
    assert result.attempted > 15
    assert result.failed == 0
