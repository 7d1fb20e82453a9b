"""The pages on contacts and on checks run as they stand."""

from __future__ import annotations

import doctest
from pathlib import Path

import numpy as np
import pytest

DOCS = Path(__file__).resolve().parents[2] / "docs"


@pytest.mark.parametrize(("page", "least"), [("contacts.md", 20)])
def test_the_page_runs(page: str, least: int) -> None:
    with np.printoptions():
        failed, tried = doctest.testfile(str(DOCS / page), module_relative=False, encoding="utf-8")
    assert failed == 0 and tried > least
