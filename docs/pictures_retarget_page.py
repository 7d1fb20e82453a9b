"""Draws the pictures of the retarget page: ``python docs/pictures_retarget_page.py`` (needs the folder of real files, KEYPOSE_DATA)."""

from __future__ import annotations

import os
from pathlib import Path

from pictures import photograph, studio_page, until

from keypose import io

DATA = Path(os.environ.get("KEYPOSE_DATA", Path(__file__).parents[2] / "shared" / "data"))


def retarget_page() -> None:
    """A capture of CMU on the built-in human, and the picker of roles."""
    opened = (("02_01.amc", io.load(DATA / "asf_amc" / "cmu_02" / "02_01.amc")),)
    with studio_page(graph=False, theme="dark", opened=opened) as page:
        page.click("[data-testid=page-retarget]")
        until(page, "keypose.test.retarget().settled")
        page.evaluate("keypose.retarget.pause(); keypose.retarget.seekFrame(166)")
        photograph(page, "retarget-page.jpg")
        page.click("[data-testid=tab-roles]")
        page.click("[data-testid=role-left_lower_arm]")
        photograph(page, "retarget-roles.jpg")


if __name__ == "__main__":
    retarget_page()
