"""A running studio and a headless browser for the studio's tests."""

from __future__ import annotations

import shutil
import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from studio_page import UNDRAWN, StudioPage
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


class Chromium:
    """A browser whose pages draw nothing until `StudioPage.draw` asks them to."""

    def __init__(self, browser: Any) -> None:
        self.browser = browser

    def new_context(self, **options: Any) -> Any:
        """A window of its own; options as Playwright's."""
        context = self.browser.new_context(**options)
        context.add_init_script(UNDRAWN)
        return context


@pytest.fixture(scope="module")
def chromium() -> Iterator[Chromium]:
    """A headless Chromium, or a skip that says what is missing.

    For one module only: while Playwright's synchronous interface is open, no other test can run an event loop.
    """
    executable = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if executable is None:
        pytest.skip("no Chromium on this machine; on Debian: apt-get install chromium")
    api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed: pip install playwright")
    with api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=executable, args=ARGUMENTS)
        yield Chromium(browser)
        browser.close()


@pytest.fixture(scope="module")
def loaded(chromium: Chromium, start: Start) -> Iterator[Callable[[str], StudioPage]]:
    """Pages that tests share, by what they show: loading one costs more than most tests."""
    contexts: list[Any] = []
    pages: dict[str, StudioPage] = {}

    def page_of(name: str) -> StudioPage:
        if name not in pages:
            scene = arm_scene() if name == "arm.glb" else samples.open_scene(name)
            context = chromium.new_context(color_scheme="dark", reduced_motion="reduce", accept_downloads=True)
            contexts.append(context)
            context.set_default_timeout(30_000)
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
def visit(chromium: Chromium) -> Iterator[Callable[..., StudioPage]]:
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
        context.set_default_timeout(30_000)
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
