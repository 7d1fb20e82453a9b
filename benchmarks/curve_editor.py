"""Script time of one picture while keys are dragged in the curve views: 200 channels of 500 keys, 10,000 keys selected.

    python benchmarks/curve_editor.py [--rounds 5] [--size 1280x720]

Needs the packages of client/ (``make``), Playwright and Chromium. A picture is everything between two frames of the
browser: the moved curves are computed, shown to the rest of the page and drawn. 16.7 ms are one frame at 60 Hz. Processor
time of the page's main thread is what counts; the time by the clock holds what other programs took of a busy machine.
"""

from __future__ import annotations

import argparse
import functools
import http.server
import importlib.util
import json
import shutil
import subprocess
import tempfile
import threading
from pathlib import Path
from statistics import median
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
SELECT = """() => {
  const { editor } = keypose.test.curves.session();
  const keys = Uint32Array.from({ length: 50 }, (_, k) => 200 + k);
  editor.selection = new Map(editor.channels.map((c) => [c.channel.key, keys.slice()]));
}"""
NEXT = "() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => done(0))))"
CHANNEL = "joint_00\0translation\0"


def build(folder: str) -> None:
    """The curve views with a document of their own, built into a folder."""
    spec = importlib.util.spec_from_file_location("hatch_build", ROOT / "hatch_build.py")
    assert spec is not None
    assert spec.loader is not None
    hook = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(hook)
    vite = [str(hook._node()), "node_modules/vite/bin/vite.js", "build", "--config", "harness/vite.config.ts"]
    subprocess.run([*vite, "--outDir", folder, "--emptyOutDir", "--logLevel", "warn"], cwd=ROOT / "client", check=True)


class _Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, *_: Any) -> None:
        pass


def drag(page: Any, view: str, along: tuple[float, float], pictures: int) -> list[tuple[float, float]]:
    """Milliseconds of each picture of a drag of all selected keys: of the processor and by the clock."""

    def ask(name: str, *given: Any) -> Any:
        return page.evaluate("([name, given]) => keypose.test.curves[name](...given)", [name, list(given)])

    page.get_by_test_id(f"show-{view}").click()
    page.evaluate(SELECT)
    page.evaluate(NEXT)
    x, y = ask("key", CHANNEL, 220, 0) if view == "graph" else ask("row", "all", 440 / 25)
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 5 * along[0], y + 5 * along[1])
    page.evaluate(NEXT)
    page.context.browser.start_tracing(page=page, categories=["devtools.timeline"])
    for n in range(pictures):
        page.mouse.move(x + (6 + n) * along[0], y + (6 + n) * along[1])
        page.evaluate(NEXT)
    events = json.loads(page.context.browser.stop_tracing())["traceEvents"]
    # frames in which nothing was to be drawn take next to nothing
    drawn = [e for e in events if e["name"] == "FireAnimationFrame" and e.get("tdur", 0) > 400]
    page.keyboard.press("Escape")
    page.mouse.up()
    page.evaluate(NEXT)
    return [(e["tdur"] / 1000, e["dur"] / 1000) for e in drawn]


def main() -> None:
    """Print the table."""
    from playwright.sync_api import sync_playwright

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--size", default="1280x720")
    given = parser.parse_args()
    width, height = map(int, given.size.split("x"))
    cases = {
        "graph, values": ("graph", (0.0, -1.5)),
        "graph, times (past other keys)": ("graph", (2.0, 0.0)),
        "dope sheet": ("dope", (2.0, 0.0)),
    }
    found: dict[str, list[tuple[float, float]]] = {name: [] for name in cases}
    with tempfile.TemporaryDirectory() as folder:
        build(folder)
        server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(_Quiet, directory=folder))
        threading.Thread(target=server.serve_forever, daemon=True).start()
        executable = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=executable, args=["--no-sandbox"])
            page = browser.new_page(viewport={"width": width, "height": height})
            page.goto(f"http://127.0.0.1:{server.server_port}/index.html?scene=dense")
            page.evaluate(NEXT)
            for _ in range(given.rounds):
                for name, (view, along) in cases.items():
                    found[name] += drag(page, view, along, 30)
            browser.close()
        server.shutdown()
    print(f"{'dragging 10,000 of 100,000 keys':34}{'median':>9}{'p95':>9}{'by the clock':>18}   ms of script a picture")
    for name, times in found.items():
        (middle, late), (clock, _) = (
            (median(own), sorted(own)[int(len(own) * 0.95)]) for own in zip(*times, strict=True)
        )
        print(f"{name:34}{middle:9.1f}{late:9.1f}{clock:18.1f}")


if __name__ == "__main__":
    main()
