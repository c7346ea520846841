"""Data sets whose views would all be the same are refused; whatever changes them is not."""

from __future__ import annotations

from typing import Any

import pytest

from oaisys_core.config import config_from_mapping
from oaisys_core.errors import InvalidInputError
from oaisys_dataset.rendering.views import check_views_differ, check_views_have_frames

MOVER = {
    "name": "rover",
    "shape": "rover",
    "label": "rover",
    "semantic_id": 24,
    "trajectory": {"waypoints_m": [[0.0, 0.0], [3.0, 0.0]], "step_m": 0.5},
}
SUN = {
    "date_time": "2026-06-21T10:00:00Z",
    "latitude_deg": 47.0,
    "longitude_deg": 11.0,
    "s_per_sample": 600.0,
}


def test_a_rig_that_nothing_moves_is_refused() -> None:
    with pytest.raises(InvalidInputError, match=r"sensors\.motion\.kind.*all 20 views"):
        check_views_differ(config_from_mapping({}), 20)
    check_views_differ(config_from_mapping({}), 1)


@pytest.mark.parametrize(
    "sections",
    [
        {"sensors": {"motion": {"kind": "hover"}}},
        {"assets": {"movers": [MOVER]}},
        {"environment": {"redraw": "sample"}},
        {"environment": {"sun_from_time": SUN}},
        {"render": {"camera_look": "machine_vision"}},
        {"render": {"effects": {"sensor_noise": {}}}},
        {"sensors": {"faults": {"depth_noise": "gaussian"}}},
        {"sensors": {"cameras": [{"modalities": ["mono16"]}]}},
        {"variants": [{"name": "a", "motion": {"kind": "hover"}}]},
    ],
    ids=lambda sections: next(iter(sections)),
)
def test_what_changes_from_view_to_view_is_not(sections: dict[str, Any]) -> None:
    check_views_differ(config_from_mapping(sections), 20)


LIDAR = {"name": "lid", "scan": {"kind": "rotating", "channels": 8, "azimuth_steps": 90}}


@pytest.mark.parametrize(
    ("sensors", "render", "message"),
    [
        (
            {"cameras": [{"step_offset": 2}], "lidars": [LIDAR]},
            {},
            r"sensors\.cameras\.step_offset: received {'camera': 2}, expected .* less than 2",
        ),
        ({"stereo": [{"step_offset": 9}]}, {}, r"step_offset: received {'stereo_left': 9, 'ste"),
        (
            {"cameras": [{"modalities": ["rgb"]}], "lidars": [LIDAR]},
            {"quality": "geometry"},
            r"sensors\.cameras\.modalities: received \['rgb'\]",
        ),
    ],
)
def test_views_without_images_are_refused(
    sensors: dict[str, Any], render: dict[str, Any], message: str
) -> None:
    config = config_from_mapping({"sensors": sensors, "render": render})
    with pytest.raises(InvalidInputError, match=message):
        check_views_have_frames(config, 2)


def test_one_image_of_one_camera_is_enough() -> None:
    cameras = [{"name": "late", "step_offset": 9}, {"name": "last", "step_offset": 1}]
    check_views_have_frames(config_from_mapping({"sensors": {"cameras": cameras}}), 2)
