"""Fixes of satellite receivers, against PROJ on the ground's own numbers."""

from __future__ import annotations

import numpy as np
import pytest
from pyproj import CRS, Transformer
from std_msgs.msg import Header

from oaisys_core.types import Georeference, Pose
from oaisys_ros_bridge.publishing.place_topics import fix_msg, is_on_earth

UTM = CRS.from_epsg(32633)
HERE = Georeference(UTM.to_wkt(), (1.0, 0.0, 500_100.0, 0.0, 1.0, 5_300_200.0), -640.0)


def test_a_fix_is_where_the_projection_has_it() -> None:
    pose = Pose((30.0, -40.0, 12.0), (0.0, 0.0, 0.0, 1.0))
    found = fix_msg(pose, HERE, Header(frame_id="base_link"))
    to_utm = Transformer.from_crs(UTM.geodetic_crs, UTM, always_xy=True)
    x, y = to_utm.transform(found.longitude, found.latitude)
    np.testing.assert_allclose((x, y), (500_130.0, 5_300_160.0), atol=1e-6)
    assert found.altitude == pytest.approx(652.0)
    assert found.header.frame_id == "base_link"


def test_other_bodies_have_no_fix() -> None:
    moon = CRS.from_user_input("+proj=stere +lat_0=-90 +R=1737400 +units=m")
    assert is_on_earth(HERE)
    assert not is_on_earth(Georeference(moon.to_wkt(), HERE.map_to_system, 0.0))
