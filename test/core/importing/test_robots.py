"""The visuals of robots as movers: trimesh's scene graph places them."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
import yaml
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from oaisys_core.cli.sensors import sensors_app
from oaisys_core.config import config_from_mapping, load_config
from oaisys_core.errors import InvalidInputError
from oaisys_core.files.calibrations.reading import read_robot_file
from oaisys_core.importing.robot_mesh import robot_mesh
from oaisys_core.procedural.meshes.files import load_mesh
from oaisys_core.simulation import Simulation
from oaisys_core.types import ModuleMetadata, Pose

CAMERA = """<gazebo reference="base_link"><sensor name="cam" type="camera"><update_rate>5
</update_rate><camera><horizontal_fov>1.2</horizontal_fov><image><width>64</width><height>48
</height></image></camera></sensor></gazebo>"""

ROBOT = """<robot name="rover">
<material name="red"><color rgba="0.8 0.1 0.05 1"/></material>
<link name="base_link">
  <visual><origin xyz="0 0 0.3"/><geometry><box size="0.8 0.5 0.2"/></geometry>
    <material name="red"/></visual>
</link>
<link name="wheel">
  <visual><origin rpy="1.5707963267948966 0 0"/>
    <geometry><cylinder radius="0.15" length="0.1"/></geometry></visual>
</link>
<link name="head">
  <visual><origin xyz="0 0 0.1" rpy="0 0 0.5"/><geometry>
    <mesh filename="{uri}" scale="0.001 -0.002 0.001"/></geometry>
    <material name="own"><color rgba="0 1 0 1"/></material></visual>
</link>
<joint name="axle" type="continuous"><origin xyz="0.2 0.3 0.15" rpy="0.1 0 0.2"/>
  <parent link="base_link"/><child link="wheel"/></joint>
<joint name="neck" type="fixed"><origin xyz="0.3 0 0.5" rpy="0 0.2 0"/>
  <parent link="base_link"/><child link="head"/></joint>
{sensors}</robot>"""


def write_robot(folder: Path, uri: str = "package://rover_pkg/meshes/head.stl") -> Path:
    """Write a package with a robot, whose head is a box in millimetres, off its origin."""
    package = folder / "rover_pkg"
    (package / "urdf").mkdir(parents=True)
    (package / "meshes").mkdir()
    (package / "package.xml").write_text("<package><name>rover_pkg</name></package>")
    head().export(package / "meshes/head.stl")
    file = package / "urdf/rover.urdf"
    file.write_text(ROBOT.format(uri=uri, sensors=CAMERA))
    return file


def head() -> trimesh.Trimesh:
    box = trimesh.creation.box((100, 60, 40))
    box.apply_translation((30, 10, 20))
    return box


def pose(xyz: tuple[float, ...], rpy: tuple[float, ...] = (0, 0, 0)) -> NDArray[np.float64]:
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("xyz", rpy).as_matrix()
    T[:3, 3] = xyz
    return T


def expected() -> trimesh.Trimesh:
    """Return the robot as trimesh's scene graph builds it."""
    scene = trimesh.Scene(base_frame="base_link")
    scene.graph.update("wheel", "base_link", matrix=pose((0.2, 0.3, 0.15), (0.1, 0, 0.2)))
    scene.graph.update("head", "base_link", matrix=pose((0.3, 0, 0.5), (0, 0.2, 0)))
    body = trimesh.creation.box((0.8, 0.5, 0.2))
    scene.add_geometry(body, parent_node_name="base_link", transform=pose((0, 0, 0.3)))
    wheel = trimesh.creation.cylinder(0.15, 0.1, 48)
    turn = pose((0, 0, 0), (np.pi / 2, 0, 0))
    scene.add_geometry(wheel, parent_node_name="wheel", transform=turn)
    scaled = head()
    scaled.apply_transform(np.diag((0.001, -0.002, 0.001, 1)))
    place = pose((0, 0, 0.1), (0, 0, 0.5))
    scene.add_geometry(scaled, parent_node_name="head", transform=place)
    found = scene.to_geometry()
    assert isinstance(found, trimesh.Trimesh)
    return found


def run(*arguments: object) -> Any:
    return CliRunner().invoke(sensors_app, ["import", *map(str, arguments)])


def test_the_mesh_is_what_trimesh_builds(tmp_path: Path) -> None:
    out = tmp_path / "world.yaml"
    result = run(write_robot(tmp_path), "--out", out)
    assert result.exit_code == 0, result.output
    found = load_mesh(tmp_path / "world_visuals.glb")
    wanted = expected()
    assert found.vertices_m.min(axis=0) == pytest.approx(wanted.bounds[0], abs=1e-6)
    assert found.vertices_m.max(axis=0) == pytest.approx(wanted.bounds[1], abs=1e-6)
    closed = trimesh.Trimesh(found.vertices_m, found.triangles)
    closed.merge_vertices()
    # A volume is positive only if each surface has its outside outside, the mirrored one, too.
    assert closed.is_watertight
    assert closed.volume == pytest.approx(wanted.volume, rel=1e-5)
    np.testing.assert_allclose(closed.center_mass, wanted.center_mass, atol=1e-6)
    colors = {tuple(np.round(material.color_srgb, 4)) for material in found.materials}
    assert colors == {(0.8, 0.1, 0.05), (0.5, 0.5, 0.5), (0.0, 1.0, 0.0)}


def test_the_configuration_has_the_robot_as_a_mover(tmp_path: Path) -> None:
    out = tmp_path / "world.yaml"
    assert run(write_robot(tmp_path), "--out", out).exit_code == 0
    text = out.read_text()
    assert "# At zero are the joints axle." in text
    config = load_config(out)
    (mover,) = config.assets.movers
    assert (mover.name, mover.anchor) == ("rover", "base")
    assert config.sensors.cameras[0].name == "cam"


def test_the_robot_is_seen(tmp_path: Path) -> None:
    """It stands on level ground ahead, as high and as wide as its mesh."""
    out = tmp_path / "world.yaml"
    assert run(write_robot(tmp_path), "--out", out).exit_code == 0
    world = yaml.safe_load(out.read_text())
    world |= {
        "backend": "analytic",
        "stage": {"preset": "plane", "extent_m": 40.0, "resolution_px": 33},
        "render": {"quality": "geometry"},
    }
    world["assets"]["rocks"] = []
    camera = {"width_px": 320, "height_px": 240, "fx_px": 300.0, "fy_px": 300.0}
    world["sensors"]["cameras"][0] |= {**camera, "modalities": ["semantic_0", "depth"]}
    simulation = Simulation(config_from_mapping(world, tmp_path))
    simulation.step_batch()
    pose = Pose((0.0, 0.0, 0.5), (0.0, 0.0, 0.0, 1.0))
    sample = simulation.step_sample(ModuleMetadata(sensor={"pose": pose}))
    rows, columns = np.nonzero(sample.frame("cam", "semantic_0").data == 60)
    depth_m = sample.frame("cam", "depth").data[rows, columns]
    y = -(columns - 159.5) * depth_m / 300
    z = 0.5 - (rows - 119.5) * depth_m / 300
    low, high = expected().bounds
    # A pixel is 1.4 cm there; the centre of the base is on the way, y = 0.
    assert (z.min(), z.max()) == pytest.approx((0, high[2] - low[2]), abs=0.015)
    wide_m = (high[1] - low[1]) / 2
    assert (y.min(), y.max()) == pytest.approx((-wide_m, wide_m), abs=0.015)


def test_without_out_visuals_are_counted_and_none_is_written(tmp_path: Path) -> None:
    file = write_robot(tmp_path)
    result = run(file)
    assert result.exit_code == 0
    assert "# Its 3 visuals become a mover with --out FILE." in result.output
    assert yaml.safe_load(result.output).keys() == {"sensors"}
    assert not list(tmp_path.glob("*.glb"))


@pytest.mark.parametrize(
    "uri",
    [
        "package://rover_pkg/meshes/head.stl",
        "model://rover_pkg/meshes/head.stl",
        "../meshes/head.stl",
        "file://{package}/meshes/head.stl",
        "package://other_name/head.stl",
    ],
)
def test_paths_of_meshes(tmp_path: Path, uri: str) -> None:
    package = tmp_path / "rover_pkg"
    file = write_robot(tmp_path, uri.format(package=package))
    (tmp_path / "more/other_name").mkdir(parents=True)
    head().export(tmp_path / "more/other_name/head.stl")
    out = tmp_path / "o.yaml"
    assert run(file, "--out", out, "--packages", tmp_path / "more").exit_code == 0
    assert "Not shown" not in out.read_text()


def test_a_package_may_be_in_a_folder_of_another_name(tmp_path: Path) -> None:
    file = write_robot(tmp_path)
    (tmp_path / "rover_pkg").rename(tmp_path / "checkout-main")
    out = tmp_path / "o.yaml"
    assert run(tmp_path / "checkout-main/urdf" / file.name, "--out", out).exit_code == 0
    assert "Not shown" not in out.read_text()


@pytest.mark.parametrize(
    ("uri", "message"),
    [
        ("package://nowhere/head.stl", "a package that can be found; --packages"),
        ("package://rover_pkg/meshes/none.stl", "an existing file; --packages"),
        ("package://rover_pkg/../secret.stl", "a file in the robot's package"),
        ("../../secret.stl", "a file in the robot's package"),
        ("file:///etc/hostname", "a file in the robot's package"),
        ("https://localhost/head.stl", "download what is in the net"),
        ("../meshes/head.fbx", "a file that ends in"),
    ],
)
def test_a_mesh_that_cannot_be_used_is_named(tmp_path: Path, uri: str, message: str) -> None:
    """The rest of the robot is there without it."""
    head().export(tmp_path / "secret.stl")
    file = write_robot(tmp_path, uri)
    (tmp_path / "rover_pkg/meshes/head.fbx").write_bytes(b"FBX")
    out = tmp_path / "o.yaml"
    assert run(file, "--out", out).exit_code == 0
    (line,) = [line for line in out.read_text().splitlines() if "Not shown" in line]
    assert message in line
    assert len(load_mesh(tmp_path / "o_visuals.glb").materials) == 2


def test_sdf_has_the_same_shapes(tmp_path: Path) -> None:
    package = write_robot(tmp_path).parents[1]
    sdf = """<sdf version="1.9"><model name="rover"><link name="base_link">
    <visual name="a"><pose>0 0 0.3 0 0 0</pose><geometry><box><size>0.8 0.5 0.2</size></box>
    </geometry><material><diffuse>0.8 0.1 0.05 1</diffuse></material></visual></link>
    <link name="wheel"><pose>0.2 0.3 0.15 0.1 0 0.2</pose><visual name="b">
    <pose>0 0 0 1.5707963267948966 0 0</pose><geometry><cylinder><radius>0.15</radius>
    <length>0.1</length></cylinder></geometry></visual></link>
    <link name="head"><pose>0.3 0 0.5 0 0.2 0</pose><visual name="c"><pose>0 0 0.1 0 0 0.5</pose>
    <geometry><mesh><uri>model://rover_pkg/meshes/head.stl</uri><scale>0.001 -0.002 0.001</scale>
    </mesh></geometry></visual>
    <visual name="sky"><geometry><plane><normal>0 0 1</normal></plane></geometry></visual></link>
    </model></sdf>"""
    (package / "model.sdf").write_text(sdf)
    out = tmp_path / "o.yaml"
    assert run(package / "model.sdf", "--out", out).exit_code == 0
    found, wanted = load_mesh(tmp_path / "o_visuals.glb"), expected()
    assert found.vertices_m.min(axis=0) == pytest.approx(wanted.bounds[0], abs=1e-6)
    assert found.vertices_m.max(axis=0) == pytest.approx(wanted.bounds[1], abs=1e-6)
    assert "# Not shown: sky, whose shape is plane." in out.read_text()


COLLADA = """<?xml version="1.0" encoding="utf-8"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1"><asset>
<created>2020-01-01T00:00:00</created><modified>2020-01-01T00:00:00</modified>
<unit name="half" meter="0.5"/>{up}</asset><library_geometries><geometry id="g" name="g"><mesh>
<source id="p"><float_array id="a" count="9">2 0 0 0 4 0 0 0 6</float_array><technique_common>
<accessor source="#a" count="3" stride="3"><param name="X" type="float"/><param name="Y"
type="float"/><param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices><triangles count="1">
<input semantic="VERTEX" source="#v" offset="0"/><p>0 1 2</p></triangles></mesh></geometry>
</library_geometries><library_visual_scenes><visual_scene id="s"><node id="n" name="n">
<instance_geometry url="#g"/></node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#s"/></scene></COLLADA>"""


@pytest.mark.parametrize("up", ["", "<up_axis>Y_UP</up_axis>", "<up_axis>Z_UP</up_axis>"])
def test_axes_of_collada_are_those_of_rviz_and_gazebo(tmp_path: Path, up: str) -> None:
    """They ignore ``up_axis``, and use the unit: the triangle's corners are on x, y and z."""
    (tmp_path / "a.dae").write_text(COLLADA.format(up=up))
    visual = '<visual><geometry><mesh filename="a.dae"/></geometry></visual>'
    (tmp_path / "r.urdf").write_text(
        f'<robot name="r"><link name="base_link">{visual}</link></robot>'
    )
    robot = read_robot_file(tmp_path / "r.urdf")
    assert robot is not None
    mesh, notes = robot_mesh(robot, tmp_path / "r.urdf")
    if mesh is None:  # Blender from 5.0 on has no importer
        assert "save it as .glb" in notes[0]
        return
    np.testing.assert_allclose(mesh.vertices_m, np.diag((1.0, 2.0, 3.0)), atol=1e-6)


def test_a_visual_that_is_wrong_does_not_hide_the_sensors(tmp_path: Path) -> None:
    file = write_robot(tmp_path)
    wrong = file.read_text().replace('size="0.8 0.5 0.2"', 'size="0.8 0.5"')
    file.write_text(wrong.replace('<material name="red"/>', '<material name="rde"/>'))
    out = tmp_path / "o.yaml"
    assert run(file, "--out", out).exit_code == 0
    assert "# Not shown: robot: line 4: <box>: received '0.8 0.5', expected 3" in out.read_text()
    assert "# The material 'rde' has no colour anywhere." in out.read_text()
    assert load_config(out).sensors.cameras[0].name == "cam"
    assert len(load_mesh(tmp_path / "o_visuals.glb").materials) == 2


def test_a_material_may_be_defined_by_a_later_visual(tmp_path: Path) -> None:
    """That of the body is the head's: urdfdom looks for names once it has read all links."""
    file = write_robot(tmp_path)
    file.write_text(file.read_text().replace('<material name="red"/>', '<material name="own"/>'))
    out = tmp_path / "o.yaml"
    assert run(file, "--out", out).exit_code == 0
    first = load_mesh(tmp_path / "o_visuals.glb").materials[0]
    assert first.color_srgb == pytest.approx((0, 1, 0), abs=1e-6)


def test_what_is_transparent_is_not_shown(tmp_path: Path) -> None:
    file = write_robot(tmp_path)
    red = 'rgba="0.8 0.1 0.05 1"'
    hidden = file.read_text().replace(red, 'rgba="0.8 0.1 0.05 0"')
    file.write_text(hidden.replace('rgba="0 1 0 1"', 'rgba="0 1 0 0.4"'))
    out = tmp_path / "o.yaml"
    assert run(file, "--out", out).exit_code == 0
    assert "# Not shown: a visual of base_link, which is transparent." in out.read_text()
    assert "A visual of head is see-through in the file, and opaque here." in out.read_text()
    assert len(load_mesh(tmp_path / "o_visuals.glb").materials) == 2


def test_links_without_sensors_are_listed_not_guessed(tmp_path: Path) -> None:
    links = '<link name="base_link"/><link name="left_camera_link"/><link name="imu_link"/>'
    joint = '<joint name="{0}" type="fixed"><parent link="base_link"/><child link="{0}"/></joint>'
    joints = joint.format("left_camera_link") + joint.format("imu_link")
    (tmp_path / "r.urdf").write_text(f'<robot name="r">{links}{joints}</robot>')
    result = run(tmp_path / "r.urdf")
    assert isinstance(result.exception, InvalidInputError)
    assert re.search(r"may hold sensors are left_camera_link, imu_link", str(result.exception))


def test_options_of_robots_are_refused_for_calibrations(tmp_path: Path) -> None:
    (tmp_path / "cameras.txt").write_text("1 PINHOLE 640 480 500 500 320 240\n")
    result = run(tmp_path / "cameras.txt", "--base", "mast")
    assert isinstance(result.exception, InvalidInputError)
    assert "it is for robots" in str(result.exception)
