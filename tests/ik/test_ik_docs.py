"""The examples of the page on inverse kinematics run and print what it says."""

from __future__ import annotations

import doctest

import numpy as np

from tests.conftest import ROOT


def test_the_examples_of_the_page() -> None:
    with np.printoptions():
        result = doctest.testfile(str(ROOT / "docs" / "ik.md"), module_relative=False, optionflags=doctest.ELLIPSIS)
    assert result.attempted > 10
    assert result.failed == 0
