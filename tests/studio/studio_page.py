"""A page of the studio, as the tests see it."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

# A software renderer takes up to half a second for a picture that most tests never look at. All else is done: shaders
# are compiled, buffers filled, states set.
UNDRAWN = """(() => {
  const gl = WebGL2RenderingContext.prototype;
  for (const name of ["drawArrays", "drawElements", "drawRangeElements", "drawArraysInstanced", "drawElementsInstanced"]) {
    const draw = gl[name];
    gl[name] = function (...given) { if (window.drawn) draw.apply(this, given); };
  }
})()"""


class StudioPage:
    """A page of the studio and the questions that tests ask it."""

    def __init__(self, page: Any) -> None:
        self.page = page
        self.complaints: list[str] = []
        page.on("pageerror", lambda error: self.complaints.append(f"exception: {error}"))
        page.on("console", self._listen)

    def _listen(self, message: Any) -> None:
        # SwiftShader warns about reading pixels back, which screenshots do
        if message.type == "error" or (message.type == "warning" and "ReadPixels" not in message.text):
            self.complaints.append(f"{message.type}: {message.text}")

    def ask(self, name: str, *arguments: Any) -> Any:
        """Call a test hook of the page."""
        return self.page.evaluate("([name, given]) => window.keypose.test[name](...given)", [name, list(arguments)])

    def state(self, key: str) -> Any:
        """One entry of the page's state."""
        return self.ask("state")[key]

    def until(self, condition: Callable[[], Any], what: str, seconds: float = 15.0) -> Any:
        """Wait for something to become true."""
        # the page's policy forbids eval, which wait_for_function needs, so we ask again and again
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            if value := condition():
                return value
            self.page.wait_for_timeout(25)
        raise AssertionError(f"waited {seconds} s in vain: {what}; state: {self.ask('state')}")

    def ready(self, actors: int | None = None) -> None:
        """Wait until everything is loaded."""
        self.until(lambda: self.page.evaluate("Boolean(window.keypose?.test.ready())"), "the page is ready", 30)
        if actors is not None:
            self.until(lambda: len(self.state("actors")) == actors, f"{actors} characters")

    def reset(self) -> None:
        """Back to how the page was when it had loaded."""
        self.complaints.clear()
        self.page.set_viewport_size({"width": 1000, "height": 640})
        self.page.evaluate(
            """() => {
              const s = keypose.studio;
              window.drawn = false;
              s.pause(); s.setMode("loop"); s.setSpeed(1); s.select(-1); s.help = false; s.readout = "frames";
              s.perform(s.active, s.offered[0]); s.seekFrame(0);
              s.toasts = []; s.setTheme("dark", false);
              for (const name of ["bones", "axes", "weights", "ghosts", "follow"]) s.show(name, false);
              s.show("grid", true); s.show("shadows", true);
              s.resetMorphs(s.active, s.active.morphNames.map((_, m) => m));
              s.view.frameAll("three-quarter", true);
              document.activeElement?.blur();
            }"""
        )

    def draw(self, on: bool = True) -> None:
        """Draw from now on, or no longer: pages begin with empty pictures."""
        self.page.evaluate("(on) => (window.drawn = on)", on)

    def drawn(self) -> None:
        """Wait until what is set now has come to the picture."""
        self.page.evaluate("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")

    def test_id(self, name: str) -> Any:
        """An element by its test id."""
        return self.page.get_by_test_id(name)
