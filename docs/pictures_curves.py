"""Draws the picture of docs/curve-editor.md: ``python docs/pictures_curves.py`` (needs the packages of client/, Playwright, Chromium)."""

from __future__ import annotations

import functools
import http.server
import shutil
import sys
import tempfile
import threading
from io import BytesIO
from pathlib import Path
from typing import Any

from PIL import Image

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
from curve_editor import NEXT, build

IMAGES = Path(__file__).parent / "images"
SELECT = """() => {
  const { editor } = keypose.test.curves.session();
  const of = (target, keys) => [[...editor.clip.curves.keys()].find((key) => key.startsWith(`${target}\\u0000euler`)), Uint32Array.from(keys)];
  editor.selection = new Map([of("LeftArm", [1, 2, 3])]);
  editor.seek(0.72);
}"""


class _Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, *_: Any) -> None:
        pass


def main() -> None:
    """The graph over the dope sheet."""
    from playwright.sync_api import sync_playwright

    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        build(folder)
        server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(_Quiet, directory=folder))
        threading.Thread(target=server.serve_forever, daemon=True).start()
        executable = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
        browser = playwright.chromium.launch(executable_path=executable, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1100, "height": 330}, device_scale_factor=1.5)
        page.goto(f"http://127.0.0.1:{server.server_port}/index.html")
        page.evaluate(NEXT)
        for row, modifiers in (("t:LeftArm", []), ("t:LeftHand", ["Control"])):
            page.click(f"[data-row='{row}'] .name", modifiers=modifiers)
        page.evaluate("keypose.test.curves.frame('all')")
        page.evaluate(SELECT)
        page.mouse.move(600, 320)
        pictures: list[Image.Image] = []
        for view in ("graph", "dope"):
            page.get_by_test_id(f"show-{view}").click()
            page.mouse.move(2, 2)
            page.evaluate(NEXT)
            pictures.append(Image.open(BytesIO(page.screenshot())))
        browser.close()
        server.shutdown()
    width, height = pictures[0].size
    sheet = Image.new("RGB", (width, 2 * height + 12), (38, 40, 46))
    for n, picture in enumerate(pictures):
        sheet.paste(picture.convert("RGB"), (0, n * (height + 12)))
    sheet.quantize(200).save(IMAGES / "curve-editor.png", optimize=True)


if __name__ == "__main__":
    main()
