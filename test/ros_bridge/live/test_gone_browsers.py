"""Browsers that go without a word do not keep the wheel."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator
from urllib.parse import urlsplit

import numpy as np
import pytest
import viser
from raw_browser import CAMERA, RawBrowser, masked_frame
from waiting import PATIENCE_S, wait_until
from websockets.exceptions import ConnectionClosed

from oaisys_mapping.private.viser_server import MAX_MESSAGE_BYTES
from oaisys_mapping.report import page_guard
from oaisys_mapping.report.web_viewer import WebViewer
from oaisys_ros_bridge.live.desk import MAX_REQUESTS, Desk
from oaisys_ros_bridge.live.page import LivePage


@pytest.fixture
def viewer(monkeypatch: pytest.MonkeyPatch) -> Iterator[WebViewer]:
    monkeypatch.setattr(page_guard, "GONE_S", 1.0)
    with WebViewer("127.0.0.1", 0, 10.0) as started:
        yield started


def drives(url: str) -> bool:
    """Open the page; return whether this browser has the wheel."""
    with RawBrowser(url) as browser:
        browser.look()
        labels = browser.labels
        browser.read_until(lambda: {"New world", "Take the wheel"} & labels.keys(), PATIENCE_S)
        return "New world" in labels


def test_a_browser_that_is_gone_before_it_is_welcomed_does_not_drive(viewer: WebViewer) -> None:
    """The page took it for its driver, for ever."""
    found: list[viser.ClientHandle] = []
    viewer.server.on_client_connect(found.append)
    with RawBrowser(viewer.url) as browser:
        browser.look()
        wait_until(lambda: bool(found))
    wait_until(lambda: not viewer.server.get_clients())
    page = LivePage(viewer, Desk(), "")
    page._welcome(found[0])
    assert drives(viewer.url)


def test_who_drives_after_a_driver_who_left_begins_anew(viewer: WebViewer) -> None:
    """The new driver's panel said that the vehicle flies, while the rover went on."""
    desk = Desk()
    page = LivePage(viewer, desk, "")
    with RawBrowser(viewer.url) as browser:
        browser.look()
        browser.set_value("vehicle", "drive the rover", PATIENCE_S)
        for _ in range(3):
            browser.set_value("New world", True, PATIENCE_S)
        wait_until(lambda: len(desk._requests) == 5)
        panel = page._panel
        assert panel is not None
    wait_until(lambda: page._driver is None)
    panel._post("take_picture")  # a click that waited for a thread
    with RawBrowser(viewer.url) as browser:
        browser.look()
        # With the rover and three worlds, which nobody has asked for any more.
        browser.shows("4 requests of the driver before you will not be done", PATIENCE_S)
        browser.set_value("Take a picture", True, PATIENCE_S)
        wait_until(lambda: len(desk._requests) == 2)
    taken = [desk.take_request(), desk.take_request()]
    assert [each.action for each in taken if each] == ["choose_vehicle", "take_picture"]
    assert taken[0] is not None
    assert taken[0].values["is_rover"] is False


def test_too_many_requests_are_refused_in_words(viewer: WebViewer) -> None:
    desk = Desk()
    LivePage(viewer, desk, "")
    with RawBrowser(viewer.url) as browser:
        browser.look()
        for _ in range(MAX_REQUESTS):
            browser.set_value("Take a picture", True, PATIENCE_S)
        browser.shows(f"{MAX_REQUESTS} requests wait already", PATIENCE_S)


def test_a_huge_message_ends_its_connection_alone(viewer: WebViewer) -> None:
    LivePage(viewer, Desk(), "")
    with RawBrowser(viewer.url) as browser:
        browser.look()
        browser.send_bytes(bytes(MAX_MESSAGE_BYTES + 1))
        with pytest.raises(ConnectionClosed, match="1009"):
            browser.read_until(lambda: False, PATIENCE_S)
    wait_until(lambda: not viewer.server.get_clients())
    assert drives(viewer.url)


def test_a_driver_that_takes_nothing_more_is_gone(viewer: WebViewer) -> None:
    """Its connection was never ended: pings waited behind the pictures that nobody took."""
    page = LivePage(viewer, Desk(), "")
    address = urlsplit(viewer.url)
    with socket.create_connection((address.hostname, address.port)) as silent:
        silent.sendall(
            f"GET {address.path} HTTP/1.1\r\nHost: {address.netloc}\r\n"
            f"Origin: http://{address.netloc}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n"
            f"Sec-WebSocket-Protocol: viser-v{viser.__version__}\r\n\r\n".encode()
        )
        assert silent.recv(12, socket.MSG_PEEK).endswith(b"101")
        silent.sendall(masked_frame({"type": "ViewerCameraMessage", **CAMERA}))
        wait_until(lambda: page._driver is not None)
        is_over = threading.Event()

        def send_pictures() -> None:
            noise = np.random.default_rng(0).integers(0, 255, (480, 640, 3), np.uint8)
            while not is_over.wait(0.05):
                viewer.server.scene.set_background_image(noise)

        sender = threading.Thread(target=send_pictures)
        sender.start()
        try:
            wait_until(lambda: page._driver is None)
        finally:
            is_over.set()
            sender.join()
    assert drives(viewer.url)
