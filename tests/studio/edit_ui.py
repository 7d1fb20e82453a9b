"""The edit page, as an animator uses it: real keys and a real pointer, numbers through the test hooks."""

from __future__ import annotations

import http.client
from typing import Any, cast

from studio_page import StudioPage

from keypose.io.native import document_from_bytes
from keypose.model import Document
from keypose.studio import StudioServer


class EditUi:
    """One page that edits the project of a studio."""

    def __init__(self, studio: StudioPage, server: StudioServer) -> None:
        self.studio, self.server, self.page = studio, server, studio.page
        self.page.get_by_test_id("page-edit").click()
        self.studio.until(lambda: self.state()["open"], "the editor is open")

    def state(self) -> dict[str, Any]:
        """What the editor says of itself."""
        return cast(dict[str, Any], self.studio.ask("edit"))

    def settled(self) -> dict[str, Any]:
        """Wait until nothing is on its way to the server."""
        self.studio.until(lambda: self.state()["settled"], "everything has arrived")
        return self.state()

    def begin(self, character: str) -> None:
        """Another project with a built-in character, as if it had just been begun."""
        self.page.evaluate(
            """(character) => {
              const { editor, project, studio } = keypose;
              project.dialog = project.guarded = project.notSaved = null; studio.toasts = []; studio.help = false; studio.pause();
              editor.autoKey = false; editor.snap = true; editor.query = ""; editor.seek(0); editor.perform();
              studio.connection.send({ type: "project_new", name: "Test", character, discard: true });
            }""",
            character,
        )
        self.page.set_viewport_size({"width": 1280, "height": 720})
        self.studio.until(lambda: self.state()["name"] == "Test" and self.state()["revision"] == 0, "a new project")
        self.arrived()
        self.tab("joint")

    def arrived(self) -> None:
        """Wait until the project's characters stand on the stage."""
        self.studio.until(
            lambda: len(self.studio.state("actors")) == len(self.state()["characters"]) > 0 and self.state()["settled"],
            "the characters stand on the stage",
            30,
        )

    def test_id(self, name: str) -> Any:
        return self.page.get_by_test_id(name)

    def press(self, keys: str, over: str = "canvas") -> None:
        """Press a key while the pointer is over a part of the page: the stage or the curves."""
        box = self.test_id(over).bounding_box()
        self.page.mouse.move(box["x"] + 0.6 * box["width"], box["y"] + 0.8 * box["height"])
        self.page.keyboard.press(keys)

    def select(self, *joints: str) -> None:
        """Click joints in the list, holding Ctrl for the second and further ones."""
        for n, joint in enumerate(joints):
            row = self.page.locator(f"[data-testid=edit-tree] [data-name='{joint}']")
            row.click(modifiers=["Control"] if n else [])
        assert self.state()["selectedJoints"] == list(joints)

    def type(self, field: str, value: float | str) -> None:
        """Click a number and type another one."""
        self.test_id(field).click()
        self.page.keyboard.type(str(value))
        self.page.keyboard.press("Enter")
        self.settled()

    def frame(self, frame: float) -> None:
        """Go to a frame."""
        self.type("frame", frame)

    def key(self, what: str) -> None:
        """The menu that inserts keys."""
        self.press("i")
        self.page.get_by_role("menuitem", name=what, exact=True).click()
        self.settled()

    def tab(self, name: str) -> None:
        self.test_id(f"tab-{name}").click()

    def drag(self, selector: str, by: tuple[float, float]) -> None:
        """Press on the middle of an element, move in steps, let go."""
        box = self.page.locator(selector).first.bounding_box()
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        self.page.mouse.move(x, y)
        self.page.mouse.down()
        for step in (0.25, 0.5, 0.75, 1):
            self.page.mouse.move(x + step * by[0], y + step * by[1])
        self.page.mouse.up()
        self.settled()

    def curves(self) -> dict[str, Any]:
        """The curves of the active clip."""
        return cast(dict[str, Any], self.studio.ask("editCurves"))

    def click_key(self, channel: str, key: int, component: int = 0) -> None:
        """Click a key in the graph editor."""
        x, y = self.page.evaluate("(given) => keypose.test.curves.key(...given)", [channel, key, component])
        self.page.mouse.click(x, y)

    def curve_menu(self, keys: str, item: str) -> None:
        """Press the key of a menu of the graph editor and choose from it."""
        self.press(keys, "curves")
        self.test_id("curve-menu").get_by_role("menuitem", name=item, exact=True).click()
        self.settled()

    def local(self, joint: str, frame: float) -> dict[str, list[float]]:
        """A joint's local transform, and its place in the model, at a frame."""
        return cast(dict[str, list[float]], self.studio.ask("editLocal", joint, frame))

    def bytes(self) -> bytes:
        """The server's document as its file would hold it."""
        connection = http.client.HTTPConnection("127.0.0.1", self.server.port, timeout=30)
        connection.request("GET", "/api/project/export/keypose", headers={"X-Keypose-Token": self.server.token})
        response = connection.getresponse()
        data = response.read()
        connection.close()
        assert response.status == 200, data[:200]
        return data

    def document(self) -> Document:
        """The server's document."""
        return document_from_bytes(self.bytes())
