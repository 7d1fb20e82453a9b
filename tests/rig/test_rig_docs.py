"""The examples of the page on rigs run and print what it says."""

from __future__ import annotations

import doctest

import numpy as np

from tests.conftest import ROOT


def test_the_examples_of_the_page() -> None:
    with np.printoptions():
        result = doctest.testfile(
            str(ROOT / "docs" / "rig.md"),
            module_relative=False,
            optionflags=doctest.ELLIPSIS,
        )
    assert result.attempted > 20
    assert result.failed == 0
