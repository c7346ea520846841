"""Descriptions of robots as people bring them: a URDF with meshes and sensors, a Kalibr rig."""

from __future__ import annotations

from pathlib import Path

import yaml
from scipy.spatial.transform import Rotation

from tools.gallery.imports.meshes import write_rover

PACKAGE = "scout_description"

URDF = """<?xml version="1.0"?>
<robot name="scout">
  <material name="orange"><color rgba="0.9 0.42 0.05 1"/></material>
  <material name="rubber"><color rgba="0.05 0.05 0.055 1"/></material>
  <material name="metal"><color rgba="0.55 0.57 0.6 1"/></material>
  <link name="base_link">
    <visual><origin xyz="0 0 0.32"/><geometry><box size="0.95 0.55 0.16"/></geometry>
      <material name="orange"/></visual>
    <visual><origin xyz="0.1 0 0.44"/><geometry><box size="0.5 0.4 0.1"/></geometry>
      <material name="metal"/></visual>
  </link>
  <link name="model">
    <visual><geometry><mesh filename="package://{package}/meshes/rover.glb" scale="0.5 0.5 0.5"/>
    </geometry></visual>
  </link>
  <joint name="cargo" type="fixed"><origin xyz="-0.25 0 0.4"/>
    <parent link="base_link"/><child link="model"/></joint>
  <link name="mast">
    <visual><origin xyz="0 0 0.3"/><geometry><cylinder radius="0.025" length="0.6"/></geometry>
      <material name="metal"/></visual>
  </link>
  <joint name="pan" type="revolute"><origin xyz="0.38 0 0.4"/>
    <parent link="base_link"/><child link="mast"/><axis xyz="0 0 1"/></joint>
  <link name="camera_link">
    <visual><geometry><box size="0.08 0.24 0.09"/></geometry><material name="rubber"/></visual>
    <visual><origin xyz="0.05 0.08 0" rpy="0 1.5707963 0"/>
      <geometry><cylinder radius="0.03" length="0.04"/></geometry><material name="metal"/></visual>
    <visual><origin xyz="0.05 -0.08 0" rpy="0 1.5707963 0"/>
      <geometry><cylinder radius="0.03" length="0.04"/></geometry><material name="metal"/></visual>
  </link>
  <joint name="tilt" type="revolute"><origin xyz="0.02 0 0.64" rpy="0 0.25 0"/>
    <parent link="mast"/><child link="camera_link"/><axis xyz="0 1 0"/></joint>
  <link name="lidar_link">
    <visual><geometry><cylinder radius="0.06" length="0.1"/></geometry>
      <material name="rubber"/></visual>
  </link>
  <joint name="lidar" type="fixed"><origin xyz="0.2 0 0.55"/>
    <parent link="base_link"/><child link="lidar_link"/></joint>
{wheels}
  <gazebo reference="camera_link">
    <sensor name="mast" type="rgbd_camera"><update_rate>15</update_rate>
      <camera><horizontal_fov>1.25</horizontal_fov>
        <image><width>{width}</width><height>{height}</height></image>
        <clip><near>0.3</near><far>30</far></clip></camera>
    </sensor>
  </gazebo>
  <gazebo reference="lidar_link">
    <sensor name="scanner" type="gpu_lidar"><update_rate>10</update_rate>
      <lidar>
        <scan><horizontal><samples>720</samples><min_angle>0</min_angle><max_angle>6.2744</max_angle>
          </horizontal><vertical><samples>32</samples><min_angle>-0.6</min_angle>
          <max_angle>0.2</max_angle></vertical></scan>
        <range><min>0.4</min><max>60</max></range>
        <noise><type>gaussian</type><mean>0</mean><stddev>0.01</stddev></noise>
      </lidar>
    </sensor>
  </gazebo>
  <gazebo reference="base_link">
    <sensor name="imu" type="imu"><update_rate>200</update_rate></sensor>
  </gazebo>
</robot>
"""

WHEEL = """  <link name="wheel_{name}">
    <visual><origin rpy="1.5707963 0 0"/>
      <geometry><cylinder radius="0.2" length="0.14"/></geometry><material name="rubber"/></visual>
    <visual><origin rpy="1.5707963 0 0"/>
      <geometry><cylinder radius="0.09" length="0.16"/></geometry><material name="metal"/></visual>
  </link>
  <joint name="axle_{name}" type="continuous"><origin xyz="{x} {y} 0.2"/>
    <parent link="base_link"/><child link="wheel_{name}"/><axis xyz="0 1 0"/></joint>
"""


def write_urdf(folder: Path, size_px: tuple[int, int]) -> Path:
    """Write a ROS package with a rover of four wheels; return its URDF file."""
    package = folder / PACKAGE
    for name in ("urdf", "meshes"):
        (package / name).mkdir(parents=True, exist_ok=True)
    (package / "package.xml").write_text(f"<package><name>{PACKAGE}</name></package>\n")
    write_rover(package / "meshes/rover.glb")
    wheels = "".join(
        WHEEL.format(name=f"{end}{side}", x=x, y=y)
        for end, x in (("front", 0.33), ("rear", -0.33))
        for side, y in (("_left", 0.37), ("_right", -0.37))
    )
    file = package / "urdf/scout.urdf"
    width, height = size_px
    file.write_text(URDF.format(package=PACKAGE, wheels=wheels, width=width, height=height))
    return file


def write_camchain(path: Path) -> None:
    """Write a chain of Kalibr: a camera with radtan distortion, and a fisheye beside it."""
    to_fisheye = Rotation.from_euler("xyz", (1.0, -2.0, 0.5), degrees=True).as_matrix()
    baseline_m = (-0.12, 0.002, 0.001)
    rows = [[*map(float, row), at] for row, at in zip(to_fisheye, baseline_m, strict=True)]
    chain = {
        "cam0": {
            "camera_model": "pinhole",
            "intrinsics": [230.4, 230.1, 237.2, 150.9],
            "distortion_model": "radtan",
            "distortion_coeffs": [-0.283, 0.074, 0.0002, 0.00002],
            "resolution": [480, 300],
        },
        "cam1": {
            "camera_model": "pinhole",
            "intrinsics": [160.5, 160.3, 241.0, 148.8],
            "distortion_model": "equidistant",
            "distortion_coeffs": [-0.012, 0.004, -0.001, 0.0002],
            "resolution": [480, 300],
            "T_cn_cnm1": [*rows, [0.0, 0.0, 0.0, 1.0]],
        },
    }
    path.write_text(yaml.safe_dump(chain))
