"""Of what browsers send to a live page, viser gets what the page uses, and not too much at once."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from typing import Any

import msgspec
import pytest
import viser
from raw_browser import CAMERA, RawBrowser
from waiting import PATIENCE_S, wait_until

from oaisys_mapping.private import viser_server
from oaisys_mapping.report.browser_messages import MAX_TEXT, fault_of
from oaisys_mapping.report.web_viewer import WebViewer


def change(**updates: Any) -> dict[str, Any]:
    return {"type": "GuiUpdateMessage", "uuid": "x", "updates": updates}


def camera(**changes: Any) -> dict[str, Any]:
    return {"type": "ViewerCameraMessage", **CAMERA, **changes}


NESTED: Any = 1
for _ in range(200):
    NESTED = [NESTED]


@pytest.mark.parametrize(
    ("message", "fault"),
    [
        ({"type": "ShareUrlRequest"}, "kind 'ShareUrlRequest'"),
        ({"type": "FileTransferStartUpload", "part_count": 0}, "kind 'FileTransferStartUpload'"),
        ({"type": ["GuiUpdateMessage"]}, "which the page does not use"),
        ({}, "kind None"),
        (change(props=1), "a change of {'props': 1}, expected one of a field's value"),
        (change(value=1, update_cb=None), "expected one of a field's value"),
        ({"type": "GuiUpdateMessage", "updates": 7}, "a change of 7"),
        (change(value=NESTED), "expected a number or a text"),
        (change(value="x" * (MAX_TEXT + 1)), f"a text of {MAX_TEXT + 1} letters"),
        (camera(look_at=(math.nan, 0.0, 3.0)), "a camera with look_at [nan, 0.0, 3.0], expected 3"),
        (camera(position=(0.0, -math.inf, 3.0)), "a camera with position [0.0, -inf, 3.0]"),
        (camera(position=(1e8, 0.0, 3.0)), "expected 3 numbers up to 1e+07"),
        (camera(position=(0.0, 3.0)), "a camera with position [0.0, 3.0]"),
        (camera(look_at="abc"), "a camera with look_at 'abc'"),
        (camera(look_at=CAMERA["position"]), "a camera at the point that it looks at"),
        (camera(up_direction=(0.0, 0.0, 0.0)), "a camera with up_direction [0.0, 0.0, 0.0]"),
        (camera(up_direction=None), "a camera with up_direction None"),
        (camera(wxyz=(math.nan,) * 4), "a camera with wxyz [nan, nan, nan, nan], expected 4"),
    ],
)
def test_what_the_page_does_not_use_is_dropped_for_a_reason(
    message: dict[str, Any], fault: str
) -> None:
    assert fault in fault_of(msgspec.msgpack.encode(message))


@pytest.mark.parametrize(
    "message",
    [
        camera(),
        camera(position=(0, 0, 3), look_at=(0, 0, 0)),
        camera(image_width=0, image_height=0),
        {"type": "SceneNodeClickMessage", "name": "/cameras/1.1 camera"},
        change(value=True),
        change(value="x" * MAX_TEXT),
    ],
)
def test_what_the_page_uses_is_handed_on(message: dict[str, Any]) -> None:
    assert fault_of(msgspec.msgpack.encode(message)) == ""


@pytest.fixture
def viewer(monkeypatch: pytest.MonkeyPatch) -> Iterator[WebViewer]:
    monkeypatch.setattr(viser_server, "BURST", 20)
    with WebViewer("127.0.0.1", 0, 10.0) as started:
        yield started


def test_a_browser_neither_opens_a_tunnel_nor_breaks_a_field(
    viewer: WebViewer, monkeypatch: pytest.MonkeyPatch
) -> None:
    """viser opened a public tunnel for whoever asked, and one message ended ``oaisys live``."""
    tunnels: list[Any] = []
    monkeypatch.setattr(viser.ViserServer, "request_share_url", tunnels.append)
    slider = viewer.server.gui.add_slider("speed", min=0.5, max=40.0, step=0.5, initial_value=6.0)
    with RawBrowser(viewer.url) as browser:
        browser.look()
        browser.read_until(lambda: "speed" in browser.labels, PATIENCE_S)
        uuid = browser.labels["speed"]
        browser.send("ShareUrlRequest")
        for updates in ({"props": "x"}, {"update_cb": None}, {"removed": True}):
            browser.send("GuiUpdateMessage", uuid=uuid, updates=updates)
        upload = {"transfer_uuid": "t", "filename": "f", "mime_type": "x"}
        browser.send(
            "FileTransferStartUpload",
            source_component_uuid=uuid,
            part_count=0,
            size_bytes=0,
            **upload,
        )
        browser.send("GuiUpdateMessage", uuid=uuid, updates={"value": 7})
        wait_until(lambda: slider.value == 7.0)
    assert (slider.min, slider.max) == (0.5, 40.0)
    assert viewer._bad_messages.count == 5
    assert not tunnels


def test_a_browser_that_sends_too_much_is_read_at_a_pace(viewer: WebViewer) -> None:
    """Each message became a task and a thread's job at once, as many as were sent."""
    count = 60
    with RawBrowser(viewer.url) as browser:
        began_s = time.monotonic()
        for number in range(count):
            browser.look(look_at=(float(number), 0.0, 0.0))

        def is_last() -> bool:
            clients = viewer.server.get_clients().values()
            return any(client.camera.look_at[0] == count - 1 for client in clients)

        wait_until(is_last)
    assert time.monotonic() - began_s > 0.9 * (count - 20) / viser_server.MAX_RATE_HZ
