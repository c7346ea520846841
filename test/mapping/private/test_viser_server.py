"""A viser that starts its server in another way has no page, rather than one without a guard."""

from __future__ import annotations

import socket

import pytest

from oaisys_core.errors import OaisysError
from oaisys_mapping.private import viser_server
from oaisys_mapping.report.web_viewer import WebViewer


def test_a_page_without_a_guard_is_not_left_open(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(viser_server, "SERVE", "gone")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    with pytest.raises(OaisysError, match="the page has no guard"):
        WebViewer("127.0.0.1", port, 10.0)
    with socket.socket() as again:
        again.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        again.bind(("127.0.0.1", port))
