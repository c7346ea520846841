"""Robots in URDF: SciPy turns, OpenCV projects, and what cannot be read is refused by name."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from oaisys_core.config import config_from_mapping
from oaisys_core.config.sections.sensing.lidars import RotatingScanConfig
from oaisys_core.errors import InvalidInputError
from oaisys_core.files.calibrations import Calibration, read_calibration
from oaisys_core.files.calibrations.reading import read_robot_file
from oaisys_core.geometry import project
from oaisys_core.importing.robots import sensors_section

FOV_RAD = 1.2
CAMERA = f"""
<sensor name="Front-Cam" type="camera">
  <pose>0.01 0.02 0.03 0.1 0.2 0.3</pose><update_rate>15</update_rate><topic>image</topic>
  <camera>
    <horizontal_fov>{FOV_RAD}</horizontal_fov>
    <image><width>640</width><height>360</height><format>R8G8B8</format></image>
    <clip><near>0.1</near><far>50</far></clip>
    <noise><type>gaussian</type><mean>0</mean><stddev>0.007</stddev></noise>
    <distortion><k1>-0.25</k1><k2>0.08</k2><k3>0.01</k3><p1>0.001</p1><p2>-0.002</p2></distortion>
  </camera>
</sensor>"""

LIDAR = """
<sensor name="lidar" type="gpu_ray">
  <update_rate>20</update_rate>
  <ray>
    <scan>
      <horizontal>
        <samples>181</samples><min_angle>-1.5707963267948966</min_angle>
        <max_angle>1.5707963267948966</max_angle>
      </horizontal>
      <vertical>
        <samples>16</samples><min_angle>-0.2617993878</min_angle><max_angle>0.2617993878</max_angle>
      </vertical>
    </scan>
    <range><min>0.3</min><max>100</max><resolution>0.01</resolution></range>
    <noise><type>gaussian</type><mean>0</mean><stddev>0.02</stddev></noise>
  </ray>
</sensor>"""

AXIS = """<{0}><noise type="gaussian"><mean>{1}</mean><stddev>{2}</stddev>
<dynamic_bias_stddev>{3}</dynamic_bias_stddev>
<dynamic_bias_correlation_time>400</dynamic_bias_correlation_time></noise></{0}>"""
IMU = f"""
<sensor name="imu" type="imu">
  <update_rate>100</update_rate>
  <imu>
    <angular_velocity>{"".join(AXIS.format(axis, 0.001, 0.02, 0.0003) for axis in "xyz")}
    </angular_velocity>
    <linear_acceleration>{"".join(AXIS.format(axis, 0, 0.1, 0) for axis in "xyz")}
    </linear_acceleration>
  </imu>
</sensor>"""


def robot(sensors: str = "", links: str = "") -> str:
    """Return a robot whose head is on a turning mast, whose base is 0.2 m above its footprint."""
    return f"""<?xml version="1.0"?>
<robot name="rover one" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <link name="base_footprint"/><link name="base_link"/><link name="mast"/><link name="head"/>
  <link name="camera_optical_frame"/>
  <joint name="base" type="fixed">
    <origin xyz="0 0 0.2"/><parent link="base_footprint"/><child link="base_link"/>
  </joint>
  <joint name="turn" type="revolute">
    <origin xyz="0.3 0 0.5" rpy="0 0.1 0.7"/><parent link="base_link"/><child link="mast"/>
    <axis xyz="0 0 1"/>
  </joint>
  <joint name="head_joint" type="fixed">
    <origin xyz="0.05 -0.02 0.4" rpy="0.2 -0.3 1.1"/><parent link="mast"/><child link="head"/>
  </joint>
  <joint name="optical" type="fixed">
    <origin rpy="-1.5707963 0 -1.5707963"/><parent link="head"/>
    <child link="camera_optical_frame"/>
  </joint>
  {links}{sensors}
</robot>"""


def on(link: str, sensor: str) -> str:
    return f'<gazebo reference="{link}">{sensor}</gazebo>'


def read(text: str, folder: Path) -> Calibration:
    (folder / "robot.urdf").write_text(text)
    return read_calibration(folder / "robot.urdf")


def chain(*steps: tuple[tuple[float, float, float], tuple[float, float, float]]) -> Any:
    """Return position and rotation of poses in a row: SciPy's turns about fixed x, y and z."""
    position, turn = np.zeros(3), Rotation.identity()
    for xyz, rpy in steps:
        position = position + turn.apply(xyz)
        turn = turn * Rotation.from_euler("xyz", rpy)
    return position, turn


MAST, HEAD = ((0.3, 0, 0.5), (0, 0.1, 0.7)), ((0.05, -0.02, 0.4), (0.2, -0.3, 1.1))
POSE = ((0.01, 0.02, 0.03), (0.1, 0.2, 0.3))


def test_a_camera_is_where_the_joints_at_zero_put_it(tmp_path: Path) -> None:
    found = read(robot(on("head", CAMERA)), tmp_path)
    config = config_from_mapping({"sensors": sensors_section(found)}).sensors.cameras[0]
    position, turn = chain(MAST, HEAD, POSE)
    np.testing.assert_allclose(config.mount_position_m, position, atol=1e-12)
    assert (Rotation.from_quat(config.mount_quat_xyzw).inv() * turn).magnitude() < 1e-12
    assert (config.name, config.rate_hz, config.modalities) == ("front_cam", 15.0, ("rgb",))
    assert "front_cam: the revolute joint turn stands at zero" in found.notes
    assert "the rig's base_link is the file's link base_link" in found.notes
    assert "not used of front_cam: clip" in found.notes
    assert any("noise of 0.007 of white is not used" in note for note in found.notes)


def test_it_projects_as_opencv_does(tmp_path: Path) -> None:
    """SDF's field of view is that of the width; the middle of 640 columns is at 319.5."""
    found = read(robot(on("head", CAMERA)), tmp_path)
    config = config_from_mapping({"sensors": sensors_section(found)}).sensors.cameras[0]
    focal = 320 / math.tan(FOV_RAD / 2)
    K = np.array([[focal, 0, 319.5], [0, focal, 179.5], [0, 0, 1]])
    points = np.random.default_rng(0).uniform((-0.6, -0.3, 1), (0.6, 0.3, 1), (50, 3)) * 4
    zero = np.zeros(3)
    distortion = np.array([-0.25, 0.08, 0.001, -0.002, 0.01])
    pixels, _ = cv2.projectPoints(points, zero, zero, K, distortion)
    assert np.abs(project(points, config.intrinsics) - pixels.reshape(-1, 2)).max() < 1e-6


def test_another_base(tmp_path: Path) -> None:
    (tmp_path / "robot.urdf").write_text(robot(on("head", CAMERA)))
    found = read_robot_file(tmp_path / "robot.urdf", base="base_footprint")
    assert found is not None
    position, _ = chain(((0, 0, 0.2), (0, 0, 0)), MAST, HEAD, POSE)
    mount = found.sensors.cameras[0].config()["mount_position_m"]
    np.testing.assert_allclose(mount, position, atol=1e-12)
    with pytest.raises(InvalidInputError, match=r"base: received 'mst', expected one of .*mast"):
        read_robot_file(tmp_path / "robot.urdf", base="mst")


def test_without_base_link_the_root_is_the_base(tmp_path: Path) -> None:
    text = robot(on("head", CAMERA)).replace("base_link", "body")
    assert "the rig's base_link is the file's link base_footprint" in read(text, tmp_path).notes


def test_a_lidar_has_gazebos_rays(tmp_path: Path) -> None:
    """Gazebo's 181 rays from -90 to 90 degrees are 1 degree apart, the last one included."""
    from oaisys_core.procedural.lidar_patterns import scan_pattern

    found = read(robot(on("mast", LIDAR)), tmp_path)
    config = config_from_mapping({"sensors": sensors_section(found)}).sensors.lidars[0]
    azimuth, elevation = np.radians(
        np.meshgrid(np.linspace(-90, 90, 181), np.linspace(-15, 15, 16), indexing="ij")
    )
    expected = [
        Rotation.from_euler("yz", (-e, a)).apply((1, 0, 0))
        for a, e in zip(azimuth.ravel(), elevation.ravel(), strict=True)
    ]
    np.testing.assert_allclose(scan_pattern(config, 0).directions, expected, atol=1e-8)
    assert (config.min_range_m, config.max_range_m, config.rate_hz) == (0.3, 100.0, 20.0)
    assert config.faults.range_sigma_m == 0.02
    assert config.period_s == 0.05
    np.testing.assert_allclose(config.mount_position_m, chain(MAST)[0])


@pytest.mark.parametrize(
    ("samples", "least", "most", "columns", "end_deg"),
    [
        (360, 0.0, 2 * math.pi, 359, 360.0),
        (360, -math.pi, math.pi, 359, 180.0),
        (360, 0.0, 6.28, 359, 359 * math.degrees(6.28) / 359),
        (360, 0.0, math.radians(359), 360, 360.0),
        (1875, -3.1459, 3.1459, 1871, None),
        (1, 0.0, 0.0, 1, 1.0),
    ],
)
def test_a_turn_has_each_direction_once(
    tmp_path: Path, samples: int, least: float, most: float, columns: int, end_deg: float | None
) -> None:
    text = LIDAR.replace("<samples>181<", f"<samples>{samples}<")
    text = text.replace("-1.5707963267948966", repr(least)).replace(
        "1.5707963267948966", repr(most)
    )
    found = read(robot(on("mast", text)), tmp_path)
    scan = config_from_mapping({"sensors": sensors_section(found)}).sensors.lidars[0].scan
    assert isinstance(scan, RotatingScanConfig)
    assert scan.azimuth_steps == columns
    step = math.degrees(most - least) / max(samples - 1, 1)
    wide = scan.azimuth_max_deg - scan.azimuth_min_deg
    assert samples == 1 or wide / columns == pytest.approx(step, rel=1e-4)
    assert end_deg is None or scan.azimuth_max_deg == pytest.approx(end_deg)
    assert any("are left out" in note for note in found.notes) == (columns < samples)


def test_the_noise_of_an_imu_becomes_densities(tmp_path: Path) -> None:
    """0.02 rad/s of each measurement at 100 Hz is 0.02 / sqrt(100) rad/s/sqrt(Hz)."""
    found = read(robot(on("base_link", IMU)), tmp_path)
    config = config_from_mapping({"sensors": sensors_section(found)}).sensors.imus[0]
    assert config.gyroscope_noise_density == pytest.approx(0.002)
    assert config.gyroscope_random_walk == pytest.approx(0.0003)
    assert config.gyroscope_bias_rad_s == (0.001, 0.001, 0.001)
    assert config.accelerometer_noise_density == pytest.approx(0.01)
    assert config.accelerometer_random_walk == 0
    assert config.rate_hz == 100
    assert any("without dynamic_bias_correlation_time" in note for note in found.notes)


def test_axes_that_differ_and_the_older_spelling(tmp_path: Path) -> None:
    uneven = IMU.replace("<stddev>0.02<", "<stddev>0.05<", 1)
    found = read(robot(on("base_link", uneven)), tmp_path)
    rms = math.sqrt((0.05**2 + 2 * 0.02**2) / 3)
    assert found.imus[0]["gyroscope_noise_density"] == pytest.approx(rms / 10)
    assert any("0.05, 0.02, 0.02 become their root mean square" in note for note in found.notes)
    older = """<sensor name="imu" type="imu"><update_rate>25</update_rate><imu><noise>
    <type>gaussian</type><rate><mean>0</mean><stddev>0.1</stddev></rate>
    <accel><mean>0</mean><stddev>0.5</stddev></accel></noise></imu></sensor>"""
    (imu,) = read(robot(on("base_link", older)), tmp_path).imus
    assert imu["gyroscope_noise_density"] == pytest.approx(0.02)
    assert imu["accelerometer_noise_density"] == pytest.approx(0.1)


def test_depth_cameras_share_their_range(tmp_path: Path) -> None:
    depth = CAMERA.replace('"camera"', '"rgbd_camera"')
    found = read(robot(on("head", depth)), tmp_path)
    section = sensors_section(found)
    assert section["cameras"][0]["modalities"] == ["rgb", "depth"]
    assert section["faults"] == {"min_depth_m": 0.1, "max_depth_m": 50.0}
    config_from_mapping({"sensors": section})
    other = depth.replace("<far>50", "<far>9")
    both = read(robot(on("head", depth) + on("mast", other)), tmp_path)
    assert not both.faults
    assert [camera.name for camera in both.cameras] == ["front_cam", "front_cam_2"]
    assert any("front_cam_2: its clip of 0.1 to 9 m is not used" in note for note in both.notes)


def test_a_camera_on_an_optical_link_looks_along_x_and_says_so(tmp_path: Path) -> None:
    found = read(robot(on("camera_optical_frame", CAMERA)), tmp_path)
    optical = ((0, 0, 0), (-1.5707963, 0, -1.5707963))
    _, turn = chain(MAST, HEAD, optical, POSE)
    quat = found.cameras[0].config()["mount_quat_xyzw"]
    assert (Rotation.from_quat(quat).inv() * turn).magnitude() < 1e-9
    assert any("camera_optical_frame is an optical frame" in note for note in found.notes)


def test_sensors_and_plugins_that_we_lack_are_named(tmp_path: Path) -> None:
    extra = """<sensor name="here" type="navsat"><update_rate>1</update_rate></sensor>
    <plugin name="drive" filename="libdrive.so"><left>a</left></plugin>"""
    force = '<sensor name="wrist" type="force_torque"/>'
    sensors = on("head", CAMERA + extra) + on("turn", force) + '<sensor name="own"/>'
    notes = read(robot(sensors), tmp_path).notes
    assert "not used: the navsat 'here' on head: no such sensor here" in notes
    assert "not used: the force_torque 'wrist' on turn: no such sensor here" in notes
    assert "not used: Gazebo's plugins libdrive.so" in notes
    assert any("URDF's own <sensor> 'own'" in note for note in notes)


ORIGINS = {
    "xyz, misspelt": '<origin yyz="1 2 3"/>',
    "rpy, in degrees": '<origin xyz="1 2 3" rpy_deg="0 0 90"/>',
    "a quaternion": '<origin xyz="1 2 3" quat_xyzw="0 0 0 1"/>',
}


@pytest.mark.parametrize("origin", ORIGINS.values(), ids=list(ORIGINS))
def test_an_attribute_of_an_origin_that_nobody_reads_is_refused(
    tmp_path: Path, origin: str
) -> None:
    """The link would stand elsewhere."""
    joint = f'<joint name="j" type="fixed">{origin}<parent link="mast"/><child link="eye"/></joint>'
    with pytest.raises(InvalidInputError, match=r"line \d+: <origin>.*expected one of rpy, xyz"):
        read(robot(links='<link name="eye"/>' + joint), tmp_path)


def test_elements_that_urdf_does_not_have_are_named(tmp_path: Path) -> None:
    ends = '<parent link="mast"/><child link="eye"/>'
    joint = f'<joint name="j" type="fixed"><origi xyz="1 2 3"/>{ends}</joint>'
    notes = read(robot(links='<link name="eye"><visuel/></link><lnk/>' + joint), tmp_path).notes
    named = sorted(note.split(": ")[1] for note in notes if note.startswith("not used of "))
    assert named == ["lnk", "origi", "visuel"]


JOINT = '<joint name="j" type="fixed"><parent link="{}"/><child link="{}"/></joint>'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (robot('<xacro:wheel name="a"/>'), r"line 23: received '<xacro:wheel>'.*xacro -o|xacro"),
        (robot(on("head", CAMERA.replace("640", "${w}"))), r"\$\{w\}.*without xacro"),
        (robot('<link name="$(arg prefix)x"/>'), r"\$\(arg prefix\)x.*without xacro"),
        (robot(on("hed", CAMERA)), "reference 'hed'.*did you mean head"),
        (robot(on("head", CAMERA.replace("640", "six"))), "<width>: received .*'six'"),
        (robot(on("head", CAMERA.replace("<width>640", "<width>640.5"))), "whole pixels"),
        (robot(on("head", CAMERA.replace(str(FOV_RAD), "3.5"))), "horizontal_fov 3.5"),
        (robot(on("mast", LIDAR.replace("100</max>", "0.1</max>"))), "0.3 to 0.1.*min below max"),
        (robot(on("mast", LIDAR.replace("gaussian", "custom"))), "'custom'.*none, gaussian"),
        (robot(on("mast", LIDAR.replace("0.02</stddev>", "-1</stddev>"))), "stddev -1"),
        (robot(on("mast", LIDAR.replace("-1.5707963267948966", "-90"))), "angles in radians"),
        (robot(links='<link name="head"/>'), "head, on lines 3 and 19"),
        (robot(links=JOINT.format("mast", "hand")), "'hand'.*one of"),
        (robot(links=JOINT.format("base_link", "head")), "head, a child again"),
        (robot(links='<link name="lost"/>'), "base_footprint, lost"),
        (robot(links='<link name="a"/><link name="b"/>' + JOINT.format("a", "b")
               + JOINT.format("b", "a")), "a circle of joints"),
        ("<robot name='x'/>", "no <link>"),
        ("<html/>", "<html>"),
        ("<robot", "one that can be read"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_named(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InvalidInputError, match=message):
        read(text, tmp_path)


def test_empty_lines_before_the_declaration_are_read_and_counted(tmp_path: Path) -> None:
    found = read("\n\n" + robot(on("head", CAMERA)), tmp_path)
    assert found.cameras[0].name == "front_cam"
    with pytest.raises(InvalidInputError, match=r"lines 5 and 21"):
        read("\n\n" + robot(links='<link name="head"/>'), tmp_path)
    (tmp_path / "marked.urdf").write_text(robot(on("head", CAMERA)), encoding="utf-8-sig")
    assert len(read_calibration(tmp_path / "marked.urdf").cameras) == 1


BOMB = """<!DOCTYPE r [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">]>
<robot name="&b;"><link name="base_link"/></robot>"""
OUTSIDE = """<!DOCTYPE r [<!ENTITY x SYSTEM "file:///etc/hostname">]>
<robot name="r"><link name="base_link">&x;</link></robot>"""
FOREIGN = """<!DOCTYPE robot SYSTEM "http://localhost/robot.dtd">
<robot name="r"><link name="&x;"/></robot>"""


@pytest.mark.parametrize("text", [BOMB, OUTSIDE, FOREIGN, "<robot>" + "<a>" * 500, "<robot>"])
def test_hostile_xml_is_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(InvalidInputError, match=r"DOCTYPE|levels|read"):
        read(text, tmp_path)


@pytest.mark.parametrize("number", ["1_0", "１０", "0x10", "1,5"])
def test_numbers_that_xml_does_not_have_are_refused(tmp_path: Path, number: str) -> None:
    """XML Schema's double; Python's own numbers were read (1_0 as 10)."""
    for old, new in (
        ('xyz="0 0 0.2"', f'xyz="{number} 0 0"'),
        ("<width>640<", f"<width>{number}<"),
    ):
        text = robot(on("head", CAMERA))
        assert old in text
        with pytest.raises(InvalidInputError, match=number):
            read(text.replace(old, new), tmp_path)


def test_a_camera_of_a_configuration_may_come_from_a_robot(tmp_path: Path) -> None:
    (tmp_path / "robot.urdf").write_text(robot(on("head", CAMERA)))
    camera = {
        "name": "mast",
        "calibration": {"file": str(tmp_path / "robot.urdf"), "camera": "front_cam"},
        "modalities": ["rgb", "depth"],
    }
    found = config_from_mapping({"sensors": {"cameras": [camera]}}).sensors.cameras[0]
    assert (found.width_px, found.modalities, found.rate_hz) == (640, ("rgb", "depth"), 15.0)
