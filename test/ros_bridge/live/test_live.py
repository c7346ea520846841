"""``oaisys live`` as a person uses it: in a real browser, with keys, fields and buttons."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest
import yaml
from browser import Page, browser_page
from PIL import Image
from raw_browser import RawBrowser
from served_simulator import FLAT_WORLD
from waiting import START_PATIENCE_S, wait_until
from websockets.exceptions import ConnectionClosed

NAN = float("nan")
HOSTILE = "<img src=x onerror=document.title='owned'>"
COMMAND = [sys.executable, "-P", "-m", "oaisys_core", "live", "--port", "0"]
LABEL = {"label": HOSTILE, "semantic_id": 7}
WORLD = FLAT_WORLD | {"environment": {"ground_beyond_label": LABEL}}


@contextmanager
def live_page(folder: Path, *options: str) -> Iterator[tuple[subprocess.Popen[bytes], str]]:
    """A running ``oaisys live`` and the address of its page."""
    out, err = folder / "live.out", folder / "live.err"
    command = [*COMMAND, "--out", str(folder / "files"), *options]
    with out.open("w") as output, err.open("w") as errors:
        process = subprocess.Popen(command, stdout=output, stderr=errors)

    def address() -> str | None:
        lines = out.read_text(encoding="utf-8").splitlines(keepends=True)
        found = [line for line in lines if line.startswith("live: ") and line.endswith("\n")]
        return found[0].removeprefix("live: ").strip() if found else None

    try:
        yield process, wait_until(address, START_PATIENCE_S, process=process, explain=err.read_text)
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(START_PATIENCE_S)


def shows(page: Page, text: str) -> None:
    page.wait_for(f"(document.body.innerText || '').includes({text!r})")


def side_image(page: Page) -> str:
    """The source of the first image beside the window."""
    return str(page.value("document.querySelector('img').src"))


@pytest.mark.long
def test_a_person_flies_makes_a_world_and_keeps_a_picture(tmp_path):
    config = tmp_path / "world.yaml"
    config.write_text(yaml.safe_dump(WORLD))
    with (
        live_page(tmp_path, "--config", str(config)) as (process, url),
        browser_page(tmp_path / "browser", (700, 560)) as page,
    ):
        page.open(url)
        shows(page, "draft in ")
        shows(page, HOSTILE)
        assert page.value("document.querySelectorAll(\"img[src='x']\").length") == 0
        shows(page, "from (-9.0, -6.0, 3.0) m")
        before = side_image(page)
        page.hold_key("KeyW", "w", 1.0)
        page.wait_for("!document.body.innerText.includes('from (-9.0, -6.0, 3.0) m')")
        page.wait_for(f"document.querySelector('img').src !== {before!r}")

        page.fill_in("preset", "planne")
        page.click_button("New world")
        shows(page, "Refused")
        shows(page, "'planne'")
        page.fill_in("preset", "plane")
        page.click_button("New world")
        shows(page, "world 2, seed 1: draft in")

        page.click_button("Take a picture")
        shows(page, "picture_0001.png")
        with Image.open(tmp_path / "files" / "picture_0001.png") as image:
            record = json.loads(image.info["oaisys"])
            assert np.ptp(np.asarray(image)) > 20
        assert (record["batch_id"], record["provenance"]["batch_seed"]) == (2, 1)
        assert record["provenance"]["quality"] == "draft"
        assert page.errors == []
        assert page.value("document.title") != "owned"
        hosts = {urlsplit(address).netloc for address in page.requests if address[:4] == "http"}
        assert hosts == {urlsplit(url).netloc}
        process.send_signal(signal.SIGINT)
        assert process.wait(START_PATIENCE_S) == 0


def hostile_cameras() -> Iterator[dict[str, Any]]:
    """Where no camera of a browser is; a window that is minimized has no height."""
    yield {"image_height": 0}
    yield {"image_width": 2**31, "image_height": 1}
    yield {"wxyz": (NAN,) * 4}
    yield {"wxyz": (0.0,) * 4}
    yield {"look_at": (NAN,) * 3}
    yield {"look_at": (1e308,) * 3}


HOSTILE_VALUES: dict[str, tuple[Any, ...]] = {
    "seed": (float("inf"), "x", 1e300, -5, "9" * 6000, None, {}),
    "preset": (HOSTILE, "../../../etc/passwd", "x" * 1_000_000, None, "plane\0"),
    "camera height, m": (NAN, 1e300),
    "vehicle": ("nonsense", "drive the rover"),
    "speed, m/s": (NAN, 1e308),
    "latitude, deg": (1e300,),
    "exposure, stops": (NAN,),
    "window shows": ("nonsense", "picture"),
}
"""What no browser would enter, by the field's label."""


@pytest.mark.long
def test_what_no_browser_says_does_not_end_the_page(tmp_path):
    config = tmp_path / "world.yaml"
    config.write_text(yaml.safe_dump(WORLD))
    with (
        live_page(tmp_path, "--config", str(config)) as (process, url),
        RawBrowser(url) as driver,
    ):
        driver.look()
        driver.shows("draft in", START_PATIENCE_S)
        for number, changes in enumerate(hostile_cameras()):
            driver.look(look_at=(0.1 + number, 0.0, 3.0))
            driver.look(**changes)
        for label, values in HOSTILE_VALUES.items():
            for value in values:
                driver.set_value(label, value, START_PATIENCE_S)
                for button in ("New world", "Sun by time and place", "Keep the pose for a survey"):
                    driver.set_value(button, True, START_PATIENCE_S)
        for data in (b"", b"\xff" * 100, "text", b"\x91" * 100_000, b"\0" * 60_000_000):
            with RawBrowser(url) as other, suppress(ConnectionClosed):
                other.look(look_at="here", wxyz=[1], image_width="wide")
                other.send_bytes(data)
                other.read_until(lambda: False, START_PATIENCE_S)
        with ExitStack() as stack:
            crowd = [stack.enter_context(RawBrowser(url)) for _ in range(60)]
            for browser in crowd:
                browser.look()
            driver.texts.clear()
            driver.set_value("seed", 7, START_PATIENCE_S)
            driver.set_value("preset", "plane", START_PATIENCE_S)
            driver.set_value("New world", True, START_PATIENCE_S)
            driver.shows("seed 7: draft in", START_PATIENCE_S)
        assert process.poll() is None
    assert process.returncode == 0
    errors = (tmp_path / "live.err").read_text(encoding="utf-8")
    assert "Traceback" not in errors, errors
    assert "messages to the page that cannot be used" in errors
    assert len(errors.splitlines()) < 10, errors


@pytest.mark.long
def test_a_running_server_cannot_be_configured(tmp_path):
    result = subprocess.run(
        [*COMMAND, "--address", "127.0.0.1:9", "--seed", "3", "--out", str(tmp_path)],
        capture_output=True,
        text=True,
        timeout=START_PATIENCE_S,
        check=False,
    )
    assert result.returncode == 2
    assert result.stderr.splitlines() == [
        "oaisys: --address: received '127.0.0.1:9', expected none with --seed"
    ]
