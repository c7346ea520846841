"""``oaisys live`` as a person uses it: in a real browser, with keys, fields and buttons."""

from __future__ import annotations

import csv
import json
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest
import yaml
from browser import PACE_S, Page, browser_page
from mcap_ros2.reader import read_ros2_messages
from numpy.typing import NDArray
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
CAMERA_HEIGHT_M = 1.5
"""Of the rover's camera above the ground, which is the plane z = 0."""

HAZE_M = 100.0
IN_THE_PICTURE_PX = (310, 300)
"""A place in the browser's window between the panels."""


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


def picture_of_which(
    page: Page, files: Path, holds: Callable[[NDArray[np.uint8]], bool]
) -> NDArray[np.uint8]:
    """Have the page take pictures until something holds of one, (H, W, 3), and return that."""

    def picture() -> tuple[NDArray[np.uint8]] | None:
        time.sleep(PACE_S)
        taken = len(list(files.glob("*.png")))
        page.click_button("Take a picture")
        path = files / f"picture_{taken + 1:04d}.png"
        wait_until(path.exists)
        with Image.open(path) as image:
            pixels = np.asarray(image, np.uint8)
        return (pixels,) if holds(pixels) else None

    return wait_until(picture)[0]


def horizon_contrast(picture: NDArray[np.uint8]) -> float:
    """How much darker the ground is than the sky, in a view whose horizon is between rows 8 and 12.

    Haze takes it away: contrast falls with the distance, to 2 % at the visual range.
    """
    sky, ground = picture[4:8].mean(), picture[12:16].mean()
    return float((sky - ground) / sky)


def ground_share(window: NDArray[np.uint8]) -> float:
    """The share of a window, (H, W, 3), in the browns of the ground: neither grey nor blue."""
    red, blue = window[..., 0].astype(int), window[..., 2].astype(int)
    return float(((red - blue) > 15).mean())


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


@pytest.mark.long
@pytest.mark.ros
def test_a_person_changes_the_light_drives_and_keeps_what_is_seen(tmp_path):
    config, files = tmp_path / "world.yaml", tmp_path / "files"
    config.write_text(yaml.safe_dump(FLAT_WORLD))
    with (
        live_page(tmp_path, "--config", str(config)) as (_, url),
        browser_page(tmp_path / "browser", (700, 560)) as page,
    ):
        page.open(url)
        shows(page, "draft in ")
        page.click_button("Record a bag")
        shows(page, "recording")
        page.unfold("Light")
        bright = picture_of_which(page, files, lambda picture: bool(np.ptp(picture) > 20))
        page.fill_in("exposure, stops", "-4")
        page.tick("automatic exposure")
        dark = picture_of_which(page, files, lambda each: each.mean() < 0.5 * bright.mean())
        page.fill_in("visibility, km", str(HAZE_M / 1000))
        step = horizon_contrast(dark)
        picture_of_which(page, files, lambda each: horizon_contrast(each) < 0.5 * step)
        page.fill_in("time", "2026-06-21T12:00:00")
        page.click_button("Sun by time and place")
        shows(page, "a time with its zone")
        page.fill_in("time", "2026-06-21T23:30:00+02:00")
        page.click_button("Sun by time and place")
        by_day = dark.mean()
        picture_of_which(page, files, lambda each: each.mean() < 0.1 * by_day)
        page.fill_in("sun height, deg", "12")
        low = picture_of_which(page, files, lambda each: each.mean() > 0.2 * by_day).astype(float)
        page.fill_in("sun azimuth, deg", "300")
        picture_of_which(page, files, lambda each: abs(each - low).mean() > 0.02 * low.mean())
        page.choose("vehicle", "drive the rover")
        shows(page, f", {CAMERA_HEIGHT_M}) m")
        page.click_at(*IN_THE_PICTURE_PX)
        page.hold_key("KeyW", "w", 1.0)
        page.wait_for("!document.body.innerText.includes('from (-9.0, -6.0,')")
        shows(page, f", {CAMERA_HEIGHT_M}) m")
        for count in ("1 pose", "2 poses"):
            page.click_button("Keep the pose for a survey")
            shows(page, count)
        page.click_button("Export the configuration")
        shows(page, "config_0001.yaml")
        page.click_button("End the bag")
        shows(page, "messages")
        assert page.errors == []
    exported = yaml.safe_load((files / "config_0001.yaml").read_text())
    assert exported["environment"]["sun_elevation_deg"] == 12
    assert exported["environment"]["sun_azimuth_deg"] == 300
    assert exported["environment"]["sun_from_time"] is None
    assert exported["environment"]["haze"]["visibility_m"] == HAZE_M
    assert exported["render"]["exposure_ev"] == -4
    rows = list(csv.DictReader((files / "survey_0001.csv").open(newline="")))
    assert [float(row["z_m"]) for row in rows] == [pytest.approx(CAMERA_HEIGHT_M)] * 2
    (bag,) = (files / "bag_0001" / "bag").glob("*.mcap")
    topics = Counter(each.channel.topic for each in read_ros2_messages(str(bag)))
    assert topics["/camera/color/image_raw"] == topics["/camera/depth/image_raw"] >= 4


@pytest.mark.long
def test_the_map_grows_where_the_camera_has_been(tmp_path):
    config = tmp_path / "world.yaml"
    config.write_text(yaml.safe_dump(WORLD))
    with (
        live_page(tmp_path, "--config", str(config)) as (_, url),
        browser_page(tmp_path / "browser", (700, 560)) as page,
    ):
        page.open(url)
        shows(page, "1 views; ")
        page.unfold("cloud")
        page.choose("window shows", "map")
        first = ground_share(page.wait_until_shown(lambda shown: ground_share(shown) > 0.02))
        page.choose("window shows", "picture")
        page.click_at(*IN_THE_PICTURE_PX)
        page.hold_key("KeyW", "w", 1.0)
        shows(page, "2 views; ")
        page.choose("window shows", "map")
        page.wait_until_shown(lambda shown: ground_share(shown) > 1.2 * first)
        assert page.errors == []


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
            window = ("map", "picture")[number % 2]
            driver.set_value("window shows", window, START_PATIENCE_S)
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
