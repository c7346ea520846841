"""The live page answers only those who know its address, and no page of somebody else."""

from __future__ import annotations

import http.client
import logging
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import pytest
import viser
from browser import browser_page
from numpy.typing import NDArray
from waiting import PATIENCE_S
from websockets.datastructures import Headers
from websockets.exceptions import InvalidStatus
from websockets.http11 import Request
from websockets.sync.client import connect
from websockets.typing import Origin, Subprotocol

from oaisys_core.errors import OaisysError
from oaisys_mapping.mesh import ColoredMesh
from oaisys_mapping.report.page_guard import PageGuard
from oaisys_mapping.report.web_viewer import WebViewer

VISER = [Subprotocol(f"viser-v{viser.__version__}")]


@pytest.fixture(scope="module")
def page() -> Iterator[str]:
    """The address of a page."""
    with WebViewer("127.0.0.1", 0, 10.0) as viewer:
        yield viewer.url


def answer(url: str, path: str | None = None, host: str | None = None) -> tuple[int, bytes]:
    """Ask for a path of the page, under the name of a host; return status and text."""
    parts = urlsplit(url)
    connection = http.client.HTTPConnection(parts.netloc, timeout=PATIENCE_S)
    headers = {} if host is None else {"Host": host}
    try:
        connection.request("GET", parts.path if path is None else path, headers=headers)
        answered = connection.getresponse()
        return answered.status, answered.read()
    finally:
        connection.close()


def is_let_in(url: str, origin: str | None = None, host: str | None = None) -> bool:
    """Open a WebSocket as a page of ``origin`` does; return whether it sends anything."""
    headers = {} if host is None else {"Host": host}
    address = url.replace("http://", "ws://").rstrip("/")
    try:
        with connect(
            address,
            origin=None if origin is None else Origin(origin),
            additional_headers=headers,
            subprotocols=VISER,
            max_size=None,
            open_timeout=PATIENCE_S,
        ) as socket:
            return len(socket.recv(timeout=PATIENCE_S)) > 0
    except InvalidStatus as refused:
        return refused.response.status_code != 403


def test_the_page_and_its_socket_are_served_at_the_address_with_the_token(page: str) -> None:
    netloc = urlsplit(page).netloc
    status, text = answer(page)
    assert status == 200
    assert b"<html" in text
    assert answer(page, urlsplit(page).path.rstrip("/"))[0] == 302
    assert is_let_in(page, origin=f"http://{netloc}")
    assert is_let_in(page)  # no browser: the token alone


def test_without_the_token_nothing_is_served(page: str) -> None:
    """The page, and all that it showed, was everybody's who guessed the port."""
    netloc = urlsplit(page).netloc
    right = urlsplit(page).path
    for path in ("/", "/index.html", "/x/", right[:-2] + "/", right[:-1] + "x/", "//" + right[1:]):
        assert answer(page, path)[0] == 403
        assert not is_let_in(f"http://{netloc}{path}", origin=f"http://{netloc}")


@pytest.mark.parametrize(
    "origin",
    ["http://evil.example", "null", "http://127.0.0.1:1", "https://127.0.0.1", "file://", ""],
)
def test_pages_of_others_open_no_socket(page: str, origin: str) -> None:
    """It was accepted from any page that the user had open."""
    assert not is_let_in(page, origin=origin)


@pytest.mark.parametrize("host", ["evil.example", "evil.example:80", "127.0.0.1.evil.example", ""])
def test_a_foreign_name_that_points_here_is_refused(page: str, host: str) -> None:
    """DNS rebinding: for the browser, page and socket are then of one site."""
    if host:
        assert not is_let_in(page, origin=f"http://{host}", host=host)
    assert answer(page, host=host)[0] == 403


def test_addresses_and_names_of_this_machine_may_be_used_on_any_forwarded_port() -> None:
    guard = PageGuard("0.0.0.0")
    for host in ("localhost:9000", "127.0.0.1", "192.168.0.7:8080", "[::1]:8080", "LOCALHOST:1"):
        asked = Headers(Host=host, Origin=f"http://{host}")
        assert guard.fault(Request(f"/{guard.token}/", asked)) == ""
    twice = Headers([("Host", "localhost"), ("Host", "evil.example")])
    assert "Host" in guard.fault(Request(f"/{guard.token}/", twice))
    assert "Host" in guard.fault(Request(f"/{guard.token}/", Headers()))


def test_tokens_are_random_and_long() -> None:
    tokens = {PageGuard("127.0.0.1").token for _ in range(100)}
    assert len(tokens) == 100
    assert all(len(token) >= 32 for token in tokens)


def test_refusals_are_counted_and_told_once_a_minute(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING), WebViewer("127.0.0.1", 0, 10.0) as viewer:
        for _ in range(20):
            assert answer(viewer.url, "/")[0] == 403
        assert len(caplog.records) == 1
        assert viewer._guard.refused == 20
    first, last = (record.getMessage() for record in caplog.records)
    assert "refused: 1, the last because the token in the address is missing or wrong" in first
    assert "refused: 19" in last
    assert viewer._guard.token not in caplog.text


def test_a_server_without_a_guard_is_not_begun() -> None:
    with (
        pytest.raises(OaisysError, match="no guard"),
        PageGuard("127.0.0.1").install(lambda _data: True),
    ):
        pass


@pytest.mark.long
def test_a_browser_shows_the_page(page: str, tmp_path) -> None:
    with browser_page(tmp_path, (320, 240)) as browser:
        browser.open(page)
        browser.wait_for("document.body.innerText.includes('Waiting for a view.')")
        assert browser.errors == []


COLOR = (180, 120, 60)
TONE_TOLERANCE = 20
"""By how much the page's tone mapping changes a colour; lit once more, it was changed by 185."""


def test_a_mesh_is_shown_in_the_colours_that_it_has(tmp_path: Path) -> None:
    corners_m = 40.0 * np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)])
    triangles = np.array([(0, 1, 2), (0, 2, 3)], np.int32)
    colors_rgb = np.full((4, 3), COLOR, np.uint8)

    def has_color(shown: NDArray[np.uint8]) -> bool:
        off = np.abs(shown.astype(int) - COLOR).max(axis=-1)
        return bool((off <= TONE_TOLERANCE).mean() > 0.1)

    with (
        WebViewer("127.0.0.1", 0, 10.0) as viewer,
        browser_page(tmp_path, (500, 400)) as browser,
    ):
        viewer.set_mesh(ColoredMesh(corners_m, triangles, colors_rgb))
        browser.open(viewer.url)
        browser.wait_for("document.body.innerText.includes('Waiting for a view.')")
        browser.wait_until_shown(has_color)
