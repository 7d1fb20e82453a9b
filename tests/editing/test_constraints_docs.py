"""The examples of docs/constraints.md run and print what they say."""

from __future__ import annotations

import doctest
from pathlib import Path

import numpy as np

PAGE = Path(__file__).resolve().parents[2] / "docs" / "constraints.md"


def test_the_page_on_constraints_runs():
    with np.printoptions():  # the page sets its own; give the old ones back
        failed, tried = doctest.testfile(str(PAGE), module_relative=False, encoding="utf-8")
    assert tried > 30
    assert failed == 0
    pictures = [line.split("(")[1].rstrip(")") for line in PAGE.read_text().splitlines() if line.startswith("![")]
    assert len(pictures) == 3 and all((PAGE.parent / p).is_file() for p in pictures)
