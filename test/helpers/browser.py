"""A real browser without a screen, spoken to through its DevTools: what a page does, and shows.

Chromium, with a rasteriser in software in place of a GPU.
"""

from __future__ import annotations

import base64
import json
import os
import re
import shutil
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from waiting import PATIENCE_S, wait_until
from websockets.sync.client import connect
from websockets.sync.connection import Connection

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
OPTIONS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-dev-shm-usage",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--hide-scrollbars",
    "--no-first-run",
    "--disable-extensions",
    "--disable-background-networking",
    "--remote-debugging-port=0",
)

PACE_S = 0.3
"""Of a person. Of what happens within some 50 ms, viser's page sends the last event alone."""


@dataclass
class Page:
    """A page under test.

    Attributes:
        requests: Addresses of all that it asked for.
        errors: What it wrote to the console as errors, and exceptions that nobody caught.
    """

    _socket: Connection
    requests: list[str] = field(default_factory=list)
    errors: list[str] = field(default_factory=list)
    _last: int = 0

    def open(self, url: str) -> None:
        """Go there; what the page does then is recorded."""
        for domain in ("Page", "Network", "Runtime", "Log"):
            self._call(f"{domain}.enable")
        self._call("Page.navigate", url=url)

    def value(self, expression: str) -> Any:
        """Return what a JavaScript expression is worth in the page."""
        result = self._call("Runtime.evaluate", expression=expression, returnByValue=True)
        return result["result"].get("value")

    def wait_for(self, expression: str) -> Any:
        """Wait until an expression holds and return its value."""
        return wait_until(
            lambda: self.value(expression),
            explain=lambda: f"{expression}; {self.errors}",
            pause=_rest,
        )

    def wait_until_shown(self, is_so: Callable[[NDArray[np.uint8]], bool]) -> NDArray[np.uint8]:
        """Return the first picture of the page of which something holds."""
        shown: NDArray[np.uint8]
        (shown,) = wait_until(
            lambda: is_so(image := self.picture()) and (image,),
            explain=lambda: self.errors,
            pause=_rest,
        )
        return shown

    def resize(self, width_px: int, height_px: int) -> None:
        """Give the window another size."""
        size = {"width": width_px, "height": height_px, "deviceScaleFactor": 1, "mobile": False}
        self._call("Emulation.setDeviceMetricsOverride", **size)

    def hold_key(self, code: str, key: str, seconds: float) -> None:
        """Hold a key down, such as ``KeyW``, which types ``w``."""
        for kind, pause_s in (("keyDown", seconds), ("keyUp", 0.0)):
            self._call("Input.dispatchKeyEvent", type=kind, code=code, key=key)
            time.sleep(pause_s)

    def click_at(self, x_px: int, y_px: int) -> None:
        """Press and release the mouse at a place in the window."""
        for kind in ("mousePressed", "mouseReleased"):
            place = {"x": x_px, "y": y_px, "button": "left", "clickCount": 1}
            self._call("Input.dispatchMouseEvent", type=kind, **place)

    def click_button(self, label: str) -> None:
        """Click the button of a label, once there is one."""
        button = f"[...document.querySelectorAll('button')].find(b => b.innerText === {label!r})"
        self.wait_for(f"!!{button}")
        self.value(f"{button}.click()")

    def fill_in(self, label: str, text: str) -> None:
        """Type into the text field beside a label, as a person does, in place of what it has."""
        self.wait_for(  # a field that is still hidden cannot be focused
            f"""(label => {{
                const typed = "input:not([type=hidden])";
                let place = label;
                while (place && !place.querySelector(typed)) place = place.parentElement;
                const field = place?.querySelector(typed);
                field?.focus();
                field?.select();
                return !!field && document.activeElement === field;
            }})([...document.querySelectorAll("label")].find(l => l.innerText === {label!r}))"""
        )
        self._call("Input.insertText", text=text)
        time.sleep(PACE_S)

    def choose(self, label: str, option: str) -> None:
        """Choose an option of the list beside a label."""
        self.fill_in(label, option)
        options = "[...document.querySelectorAll('[role=option]')]"
        found = f"{options}.find(each => each.innerText === {option!r})"
        self.wait_for(f"!!{found}")
        self.value(f"{found}.click()")

    def tick(self, label: str) -> None:
        """Click the box beside a label."""
        self.value(
            f"""(label => {{
                let place = label;
                while (!place.querySelector("[type=checkbox]")) place = place.parentElement;
                place.querySelector("[type=checkbox]").click();
            }})([...document.querySelectorAll("label")].find(l => l.innerText === {label!r}))"""
        )
        time.sleep(PACE_S)

    def unfold(self, title: str) -> None:
        """Click a title that hides what is below it, and wait until that has moved to its place."""
        shown = f"[...document.querySelectorAll('*')].filter(e => e.innerText === {title!r})"
        self.wait_for(f"{shown}.length > 0")
        self.value(f"{shown}.pop().click()")
        self.wait_for("!document.getAnimations().some(each => each.playState === 'running')")

    def picture(self) -> NDArray[np.uint8]:
        """Return the window as (H, W, 3) RGB."""
        data = base64.b64decode(self._call("Page.captureScreenshot", format="png")["data"])
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
        return np.asarray(image[..., ::-1], np.uint8)

    def _call(self, method: str, **parameters: Any) -> dict[str, Any]:
        self._last += 1
        self._socket.send(json.dumps({"id": self._last, "method": method, "params": parameters}))
        while True:
            message = json.loads(self._socket.recv(timeout=PATIENCE_S))
            if message.get("id") == self._last:
                assert "error" not in message, message
                return dict(message["result"])
            self._note(message.get("method"), message.get("params", {}))

    def _note(self, method: str | None, told: dict[str, Any]) -> None:
        if method == "Network.requestWillBeSent":
            self.requests.append(told["request"]["url"])
        elif method == "Runtime.exceptionThrown":
            self.errors.append(json.dumps(told["exceptionDetails"])[:500])
        elif method == "Runtime.consoleAPICalled" and told["type"] in ("error", "assert"):
            self.errors.append(json.dumps(told["args"])[:500])
        elif method == "Log.entryAdded" and told["entry"]["level"] == "error":
            self.errors.append(told["entry"]["text"])


@contextmanager
def browser_page(profile: Path, size: tuple[int, int] = (1200, 900)) -> Iterator[Page]:
    """Start a browser with an empty page and end it; skip the test where there is none.

    Args:
        profile: An empty folder for all that it writes.
        size: Of its window in pixels.
    """
    program = next((found for name in NAMES if (found := shutil.which(name))), None)
    if program is None:
        pytest.skip(f"no browser: none of {', '.join(NAMES)} is installed")
    profile.mkdir(parents=True, exist_ok=True)
    window = f"--window-size={size[0]},{size[1]}"
    log = profile / "browser.log"
    with log.open("w") as output:
        process = subprocess.Popen(
            [program, *OPTIONS, window, f"--user-data-dir={profile / 'data'}", "about:blank"],
            stdout=subprocess.DEVNULL,
            stderr=output,
            start_new_session=True,
            env={**os.environ, "HOME": str(profile)},
        )
    try:
        port = _port(log, process)
        with connect(_page_address(port), max_size=None, open_timeout=PATIENCE_S) as socket:
            yield Page(socket)
    finally:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait(PATIENCE_S)


def _rest() -> None:
    """Leave the processor to the browser."""
    time.sleep(0.1)


def _port(log: Path, process: subprocess.Popen[bytes]) -> int:
    def said() -> str:
        return log.read_text(encoding="utf-8", errors="replace")

    listening = re.compile(r"DevTools listening on ws://127\.0\.0\.1:(\d+)/")
    found = wait_until(
        lambda: listening.search(said()), process=process, explain=lambda: said()[-800:]
    )
    return int(found[1])


def _page_address(port: int) -> str:
    """Return the socket of the browser's one page."""
    from urllib.request import urlopen

    def pages() -> list[dict[str, str]]:
        with urlopen(f"http://127.0.0.1:{port}/json/list", timeout=PATIENCE_S) as answer:
            return [page for page in json.load(answer) if page["type"] == "page"]

    return str(wait_until(pages)[0]["webSocketDebuggerUrl"])
