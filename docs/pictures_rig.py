"""Draws the picture of a rig on the edit page: ``python docs/pictures_rig.py``."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

from pictures import photograph, studio_page, until

from keypose import samples
from keypose.model import Document
from keypose.project import add_character
from keypose.project.commands import SetRig
from keypose.project.file import save
from keypose.rig import auto_rig, fit_controls


def rig() -> None:
    """The built-in human's walk on controls, a hand held by its IK."""
    scene = samples.load("walk")
    who = scene.character
    document = add_character(Document("Walk on controls"), who)
    (name,) = document.characters
    made = replace(auto_rig(who.skeleton, character=who), name=name, character=name)
    document = SetRig(made).apply(document)
    line = document.timeline(document.performs[name])
    placed = line.layers[0].placements[0].animation
    fit = fit_controls(made, who.skeleton, scene.animations[0])
    clip = replace(fit.clip, name=placed, rate_hz=line.rate_hz)
    line = replace(line, start_s=clip.start_s, end_s=clip.end_s)
    document = replace(
        document, clips={**document.clips, placed: clip}, timelines={**document.timelines, line.name: line}
    )
    with tempfile.TemporaryDirectory() as folder, studio_page(graph=False, theme="dark") as page:
        path = Path(folder, "walk.keypose")
        save(document, path)
        page.click("[data-testid=page-edit]")
        until(page, "keypose.test.edit().open")
        page.evaluate(
            "(path) => keypose.studio.connection.send({ type: 'project_open', path, discard: true })", str(path)
        )
        until(page, "Boolean(keypose.editor.rigging.active)")
        until(page, "keypose.editor.rigging.settled")
        page.evaluate("keypose.project.dialog = null")  # it may offer to recover what another studio left
        page.click("[data-testid=tab-rig]")
        page.evaluate("keypose.editor.seekFrame(9); keypose.test.viewport.viewTools({ tool: 'move', bones: false })")
        page.evaluate("keypose.test.viewport.selectJoints(['hand_ik.L'])")
        page.click("[data-testid=rig-ik]")
        until(page, "keypose.editor.rigging.settled")
        photograph(page, "rig.jpg")


if __name__ == "__main__":
    rig()
