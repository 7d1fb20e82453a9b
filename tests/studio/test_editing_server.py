"""Editing a project over real sockets: pages without a browser."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from edit_page import EditPage
from studio_scenes import Start, arm_scene

from keypose.model import Channel, Curve, CurveKind, Interpolation, Property
from keypose.studio import StudioServer

sync = pytest.importorskip("websockets.sync.client")


@pytest.fixture(scope="module")
def server(start: Start) -> StudioServer:
    return start(("arm.glb", arm_scene()))


@contextmanager
def page(server: StudioServer) -> Iterator[EditPage]:
    with sync.connect(f"ws://127.0.0.1:{server.port}/api/events?token={server.token}", max_size=None) as socket:
        plain = EditPage(socket, server)
        plain.say("project_watch")
        plain.until("project_state")
        yield plain


def bezier(seed: int = 0) -> Curve:
    rng = np.random.default_rng(seed)
    return Curve(
        np.cumsum(rng.random(5)),
        rng.normal(size=(5, 1)),
        Interpolation.BEZIER,
        kind=CurveKind.SCALAR,
        in_handles=rng.random((5, 1, 2)) * [-1, 1],
        out_handles=rng.random((5, 1, 2)),
        tangent_types=rng.integers(0, 6, (5, 2)),
    )


def test_a_curve_survives_the_way_to_the_server_and_to_every_page(server: StudioServer) -> None:
    with page(server) as one, page(server) as two:
        one.say("project_new", name="Bits", character="", discard=True)
        one.until("project_state")
        two.until("project_state")
        channel, curve = Channel("Joint1", Property.TRANSLATION, 1), bezier()
        assert one.set_curves("arm", {channel: curve}, label="Key")["revision"] == 1
        for each in (one, two):
            changed = each.until("project_changed")
            assert (changed["label"], changed["edit"], changed["cause"]) == ("Key", "e", "edit")
            got = each.clips["arm"].curves[channel]
            for name in ("times_s", "values", "in_handles", "out_handles", "modes", "tangent_types"):
                assert np.array_equal(getattr(got, name), getattr(curve, name)), name
        two.say("project_undo")
        assert one.until("project_changed")["removed_clips"] == ["arm"]
        assert one.status["redo"] == "Key"
