"""A running studio and a headless browser for the studio's tests."""

from __future__ import annotations

import shutil
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from studio_scenes import Start, arm_scene

from keypose import samples
from keypose.errors import KeyposeError
from keypose.model import Scene
from keypose.studio import StudioServer

ARGUMENTS = [
    "--no-sandbox",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-default-apps",
    "--disable-extensions",
    "--disable-sync",
    "--no-first-run",
    "--mute-audio",
    "--disable-dev-shm-usage",
]


@pytest.fixture(scope="session")
def start() -> Iterator[Start]:
    """Start studios that run until the tests end."""
    running: list[tuple[StudioServer, threading.Thread]] = []

    def run(*scenes: tuple[str, Scene], **options: Any) -> StudioServer:
        listening = threading.Event()
        try:
            server = StudioServer(scenes, ready=lambda _: listening.set(), **options)
        except KeyposeError as error:
            pytest.skip(str(error))
        thread = threading.Thread(target=server.run, daemon=True)
        thread.start()
        assert listening.wait(20), "the server does not listen"
        running.append((server, thread))
        return server

    yield run
    for server, _ in running:
        server.stop()
    for _, thread in running:
        thread.join(10)


@pytest.fixture(scope="session")
def chromium() -> Iterator[Any]:
    """A headless Chromium, or a skip that says what is missing."""
    executable = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if executable is None:
        pytest.skip("no Chromium on this machine; on Debian: apt-get install chromium")
    api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed: pip install playwright")
    with api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=executable, args=ARGUMENTS)
        yield browser
        browser.close()


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

    def test_id(self, name: str) -> Any:
        """An element by its test id."""
        return self.page.get_by_test_id(name)


@pytest.fixture(scope="module")
def loaded(chromium: Any, start: Start) -> Iterator[Callable[[str], StudioPage]]:
    """Pages that tests share, by what they show: loading one costs more than most tests."""
    contexts: list[Any] = []
    pages: dict[str, StudioPage] = {}

    def page_of(name: str) -> StudioPage:
        if name not in pages:
            scene = arm_scene() if name == "arm.glb" else samples.open_scene(name)
            context = chromium.new_context(color_scheme="dark", reduced_motion="reduce", accept_downloads=True)
            contexts.append(context)
            context.set_default_timeout(10_000)
            pages[name] = StudioPage(context.new_page())
            pages[name].page.goto(start((name, scene)).url)
            pages[name].ready(1)
        pages[name].reset()
        return pages[name]

    yield page_of
    for context in contexts:
        context.close()


@pytest.fixture
def studio(loaded: Callable[[str], StudioPage]) -> Iterator[StudioPage]:
    """A page with the tube, as if newly loaded; the test fails if it complains on its console."""
    page = loaded("arm.glb")
    yield page
    assert page.complaints == []


@pytest.fixture
def human(loaded: Callable[[str], StudioPage]) -> Iterator[StudioPage]:
    """The same with the built-in human and all its performances."""
    page = loaded("sample:human")
    yield page
    assert page.complaints == []


@pytest.fixture
def visit(chromium: Any) -> Iterator[Callable[..., StudioPage]]:
    """Open a studio's page; the test fails if the page complained on its console."""
    contexts: list[Any] = []
    pages: list[StudioPage] = []

    def opened(
        server: StudioServer, *, size: tuple[int, int] = (1000, 640), theme: str = "dark", actors: int | None = None
    ) -> StudioPage:
        # with reduced motion the studio does not start to play by itself, and the camera jumps instead of gliding
        context = chromium.new_context(
            viewport={"width": size[0], "height": size[1]}, color_scheme=theme, reduced_motion="reduce"
        )
        context.set_default_timeout(10_000)
        contexts.append(context)
        studio = StudioPage(context.new_page())
        pages.append(studio)
        studio.page.goto(server.url)
        studio.ready(actors)
        return studio

    yield opened
    for context in contexts:
        context.close()
    for studio in pages:
        assert studio.complaints == []
