"""The live page in the hands of several people, and how a picture fills their windows."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from browser import Page, browser_page
from numpy.typing import NDArray
from waiting import wait_until

from oaisys_core.geometry import T_LINK_OPTICAL
from oaisys_core.types import PinholeIntrinsics
from oaisys_mapping.evaluation.visibility import PosedCamera
from oaisys_mapping.report.web_viewer import PosedImages, WebViewer
from oaisys_ros_bridge.live.desk import Desk
from oaisys_ros_bridge.live.page import LivePage, letterbox

SIZE = (480, 360)


def shows(page: Page, text: str) -> None:
    page.wait_for(f"(document.body.innerText || '').includes({text!r})")


@pytest.mark.long
def test_several_look_and_one_drives(tmp_path):
    desk = Desk()
    with WebViewer("127.0.0.1", 0, 10.0) as viewer, browser_page(tmp_path / "a", SIZE) as first:
        page = LivePage(viewer, desk, "not without ROS")
        first.open(viewer.url)
        shows(first, "New world")
        with browser_page(tmp_path / "b", SIZE) as second:
            second.open(viewer.url)
            shows(second, "Take the wheel")
            assert "New world" not in second.value("document.body.innerText")
            page.show_pose(T_LINK_OPTICAL)
            second.click_button("Take the wheel")
            shows(second, "New world")
            shows(first, "Take the wheel")
            assert "New world" not in first.value("document.body.innerText")
            second.click_button("Keep the pose for a survey")
            # The new panel says that the vehicle flies, whatever it was before.
            assert wait_until(desk.take_request).values["is_rover"] is False
            assert wait_until(desk.take_request).action == "keep_pose"
        # The driver's page is closed: nobody drives until somebody does.
        first.click_button("Take the wheel")
        shows(first, "New world")


def shape_of_largest(window: NDArray[np.uint8]) -> float:
    """The width over the height of the largest part of a window that is magenta; 0 without one."""
    red, green, blue = (window[..., channel].astype(int) for channel in range(3))
    is_magenta = (red - green > 90) & (blue - green > 90)
    _, _, found, _ = cv2.connectedComponentsWithStats(is_magenta.astype(np.uint8))
    parts = found[1:]
    if not len(parts):
        return 0.0
    largest = parts[parts[:, cv2.CC_STAT_AREA].argmax()]
    return float(largest[cv2.CC_STAT_WIDTH] / largest[cv2.CC_STAT_HEIGHT])


@pytest.mark.long
def test_the_window_shows_the_picture_s_shape_whatever_its_own(tmp_path):
    magenta = np.full((90, 120, 3), (200, 0, 200), np.uint8)
    camera = PosedCamera(PinholeIntrinsics(120, 90, 100.0, 100.0, 59.5, 44.5), T_LINK_OPTICAL)

    def is_in_shape(window: NDArray[np.uint8]) -> bool:
        return abs(shape_of_largest(window) - 120 / 90) < 0.05

    with WebViewer("127.0.0.1", 0, 10.0) as viewer, browser_page(tmp_path, (1000, 560)) as person:
        page = LivePage(viewer, Desk(), "")
        person.open(viewer.url)
        shows(person, "New world")
        page.show_picture(PosedImages("camera", magenta, None, None, camera))
        page.show_pose(T_LINK_OPTICAL)
        person.wait_until_shown(is_in_shape)
        person.resize(900, 900)
        person.wait_until_shown(lambda window: window.shape[0] == 900 and is_in_shape(window))


def test_a_picture_keeps_its_shape_between_black_bars():
    picture = np.full((30, 40, 3), 200, np.uint8)
    wide = letterbox(picture, 2.0)
    assert wide.shape == (30, 60, 3)
    np.testing.assert_array_equal(wide[:, 10:50], picture)
    assert not wide[:, :10].any()
    assert not wide[:, 50:].any()
    tall = letterbox(picture, 0.5)
    assert tall.shape == (80, 40, 3)
    np.testing.assert_array_equal(tall[25:55], picture)
    assert letterbox(picture, 4 / 3, 20).shape == (15, 20, 3)
