"""What a browser says of its window, its camera and its fields, as viser hands it on."""

from __future__ import annotations

import logging
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from oaisys_core.errors import InvalidInputError
from oaisys_mapping.report.bad_messages import BadMessages
from oaisys_ros_bridge.live.browser_values import (
    MAX_ASPECT,
    MAX_TEXT,
    aspect_of,
    number_of,
    pose_of,
    text_of,
)

NAN = float("nan")


@pytest.mark.parametrize(
    ("size", "aspect"),
    [
        ((640, 480), 4 / 3),
        ((640, 0), 1.0),
        ((0, 0), 1.0),
        ((-5, 3), 1.0),
        ((2**31, 1), MAX_ASPECT),
        ((1, 2**31), 1 / MAX_ASPECT),
        ((NAN, 3), 1.0),
        (("wide", 3), 1.0),
        ((10**400, 3), 1.0),
    ],
)
def test_a_window_of_any_size_has_an_aspect(size: tuple[Any, Any], aspect: float) -> None:
    camera: Any = SimpleNamespace(image_width=size[0], image_height=size[1])
    assert aspect_of(camera) == pytest.approx(aspect)


def test_only_numbers_are_a_pose() -> None:
    half = np.sqrt(0.5)  # a quarter turn about x: y becomes z
    camera: Any = SimpleNamespace(look_at=(1.0, 2.0, 3.0), wxyz=(half, half, 0.0, 0.0))
    pose = pose_of(camera)
    assert pose is not None
    np.testing.assert_allclose(pose.R_map_camera @ (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), atol=1e-12)
    for look_at in ((NAN, 0, 0), (1e308, 0, 0), (0, 0), "here", None):
        wrong: Any = SimpleNamespace(look_at=look_at, wxyz=camera.wxyz)
        assert pose_of(wrong) is None
    for wxyz in ((0, 0, 0, 0), (NAN,) * 4, (1e300,) * 4, (1, 0, 0)):
        wrong = SimpleNamespace(look_at=camera.look_at, wxyz=wxyz)
        assert pose_of(wrong) is None


def test_fields_beyond_their_limits_are_refused_by_their_label() -> None:
    for value in (NAN, float("inf"), -1, 11, 1e300, 10**4000, None, "x"):
        field = SimpleNamespace(label="haze", value=value, min=0, max=10)
        with pytest.raises(InvalidInputError, match=r"haze.*a number from 0 to 10"):
            number_of(field)
    assert number_of(SimpleNamespace(label="haze", value=10, min=0, max=10)) == 10
    assert text_of(SimpleNamespace(label="preset", value=" plane ")) == "plane"
    with pytest.raises(InvalidInputError, match="preset"):
        text_of(SimpleNamespace(label="preset", value="x" * (MAX_TEXT + 1)))


def test_messages_that_cannot_be_used_are_one_line_a_minute(
    caplog: pytest.LogCaptureFixture,
) -> None:
    now_s = 1000.0
    bad = BadMessages(lambda: now_s)
    server = logging.getLogger("websockets.server")
    bad.start()
    try:
        for _ in range(500):
            try:
                int("x")
            except ValueError:
                server.exception("connection handler failed")
        server.error("something else")
    finally:
        bad.stop()
    assert bad.count == 500
    texts = [record.getMessage() for record in caplog.records]
    assert texts[1] == "something else"
    assert [text for text in texts if "cannot be used: 1," in text or ": 499," in text] == [
        texts[0],
        texts[2],
    ]
    assert all(record.exc_info is None for record in caplog.records)
