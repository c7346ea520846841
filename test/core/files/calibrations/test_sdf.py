"""Robots in SDF: frames as SDF 1.7 on has them, computed with SciPy."""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from oaisys_core.config import config_from_mapping
from oaisys_core.errors import InvalidInputError
from oaisys_core.files.calibrations import Calibration, read_calibration
from oaisys_core.files.calibrations.reading import read_robot_file
from oaisys_core.geometry import project
from oaisys_core.importing.robots import sensors_section

CAMERA = """
<sensor name="{name}" type="{kind}">{pose}<update_rate>10</update_rate>
  <camera name="eye"><horizontal_fov>1.0</horizontal_fov>
    <image><width>320</width><height>240</height></image>{more}
  </camera>
</sensor>"""


def camera(name: str = "cam", pose: str = "", kind: str = "camera", more: str = "") -> str:
    return CAMERA.format(name=name, kind=kind, pose=pose, more=more)


def model(content: str, name: str = "bot", version: str = "1.9") -> str:
    return f'<sdf version="{version}"><model name="{name}">{content}</model></sdf>'


def read(text: str, folder: Path) -> Calibration:
    (folder / "model.sdf").write_text(text)
    return read_calibration(folder / "model.sdf")


def pose(*values: float) -> Any:
    """Return the (4, 4) matrix of x, y, z, roll, pitch, yaw."""
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("xyz", values[3:]).as_matrix()
    T[:3, 3] = values[:3]
    return T


def check_mount(found: Calibration, expected: Any, index: int = 0) -> None:
    config = config_from_mapping({"sensors": sensors_section(found)}).sensors.cameras[index]
    np.testing.assert_allclose(config.mount_position_m, expected[:3, 3], atol=1e-12)
    turn = Rotation.from_quat(config.mount_quat_xyzw).as_matrix()
    np.testing.assert_allclose(turn, expected[:3, :3], atol=1e-12)


A, B, C, D = (
    (0.1, 0.2, 0.3, 0.4, 0.5, 0.6),
    (-0.3, 0.1, 0.2, -0.2, 0.7, -1.1),
    (0.05, 0.0, 0.4, 0.9, -0.4, 2.0),
    (1.0, -2.0, 0.5, 0.1, 0.2, -0.3),
)


def text_of(values: tuple[float, ...], attributes: str = "") -> str:
    return f"<pose {attributes}>{' '.join(map(str, values))}</pose>"


def test_a_sensor_is_on_its_link_in_the_models_frame(tmp_path: Path) -> None:
    """The pose of the model itself is where it stands in a world."""
    link = f'<link name="body">{text_of(A)}{camera(pose=text_of(B))}</link>'
    found = read(model(text_of(D) + link), tmp_path)
    check_mount(found, pose(*A) @ pose(*B))
    assert "the rig's base_link is the model's frame" in found.notes
    named = link.replace('"body"', '"base_link"')
    check_mount(read(model(named), tmp_path), pose(*B))


def test_frames_that_refer_to_each_other(tmp_path: Path) -> None:
    """A joint's frame is on its child; a frame's on what it is attached to, unless it says."""
    content = f"""
    <link name="body">{text_of(A)}</link>
    <link name="arm">{text_of(B, 'relative_to="body"')}</link>
    <joint name="hinge" type="revolute">{text_of(C)}<parent>body</parent><child>arm</child></joint>
    <frame name="tip" attached_to="hinge">{text_of(D)}</frame>
    <frame name="other" attached_to="arm">{text_of(D, 'relative_to="__model__"')}</frame>
    <link name="first">{text_of(B, 'relative_to="tip"')}{camera("one")}</link>
    <link name="second">{text_of(B, 'relative_to="other"')}
      {camera("two", text_of(C, 'relative_to="hinge"'))}
      {camera("three", text_of(C, 'relative_to="__model__"'))}{camera("four")}</link>"""
    found = read(model(content), tmp_path)
    arm = pose(*A) @ pose(*B)
    hinge = arm @ pose(*C)
    check_mount(found, hinge @ pose(*D) @ pose(*B), 0)
    check_mount(found, hinge @ pose(*C), 1)
    check_mount(found, pose(*C), 2)
    check_mount(found, pose(*D) @ pose(*B), 3)


def test_degrees_and_quaternions(tmp_path: Path) -> None:
    degrees = (0.1, 0.2, 0.3, 10, 20, 30)
    quat = Rotation.from_euler("xyz", A[3:]).as_quat()
    by_quat = text_of((*A[:3], *quat), 'rotation_format="quat_xyzw"')
    content = f"""<link name="a">{text_of(degrees, 'degrees="true"')}{camera("one")}</link>
    <link name="b">{by_quat}{camera("two")}</link>"""
    found = read(model(content), tmp_path)
    check_mount(found, pose(*degrees[:3], *np.radians(degrees[3:])), 0)
    check_mount(found, pose(*A), 1)


def test_nested_models_and_their_placement(tmp_path: Path) -> None:
    head = f"""<model name="head" placement_frame="foot">{text_of(D, 'relative_to="body"')}
      <link name="foot">{text_of(B)}</link>
      <link name="eye">{text_of(C, 'relative_to="foot"')}{camera("inner")}</link></model>"""
    content = f"""<link name="body">{text_of(A)}</link>{head}
    <link name="mast">{text_of(B, 'relative_to="head::eye"')}{camera("outer")}</link>"""
    found = read(model(content), tmp_path)
    foot = pose(*A) @ pose(*D)
    check_mount(found, foot @ pose(*C) @ pose(*B), 0)
    check_mount(found, foot @ pose(*C), 1)


def test_a_multicamera_has_several(tmp_path: Path) -> None:
    pair = camera("pair", text_of(A), "multicamera")
    second = camera().split("</update_rate>")[1].split("</sensor>")[0].replace("eye", "right")
    pair = pair.replace("</sensor>", second.replace("320", "640") + "</sensor>")
    pair = pair.replace('"right">', f'"right">{text_of(B)}')
    found = read(model(f'<link name="body">{pair}</link>'), tmp_path)
    assert [each.name for each in found.cameras] == ["pair_eye", "pair_right"]
    check_mount(found, pose(*A), 0)
    check_mount(found, pose(*A) @ pose(*B), 1)
    assert found.cameras[1].size_px == (640, 240)


def test_intrinsics_count_and_their_pixels_begin_at_0(tmp_path: Path) -> None:
    """The projection matrix of gz-sensors has its edges at -cx / fx and (width - cx) / fx."""
    more = """<lens><intrinsics><fx>300</fx><fy>310</fy><cx>150</cx><cy>130</cy><s>0</s>
    </intrinsics></lens>"""
    found = read(model(f'<link name="body">{camera(more=more)}</link>'), tmp_path)
    config = config_from_mapping({"sensors": sensors_section(found)}).sensors.cameras[0]
    K = np.array([[300, 0, 149.5], [0, 310, 129.5], [0, 0, 1.0]])
    points = np.array([[0.2, -0.1, 1.0], [-0.3, 0.2, 2.0]])
    pixels, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), K, None)
    np.testing.assert_allclose(project(points, config.intrinsics), pixels.reshape(-1, 2))
    # The left edge of the image, half a pixel left of the first centre, is seen at -cx / fx.
    edge = project(np.array([[-150 / 300, 0, 1.0]]), config.intrinsics)
    assert edge[0, 0] == pytest.approx(-0.5)


def wide(kind: str, fov: float) -> str:
    more = f"<lens><type>{kind}</type><cutoff_angle>2</cutoff_angle></lens>"
    text = camera(kind="wideanglecamera", more=more)
    return model(f'<link name="body">{text}</link>'.replace(">1.0<", f">{fov}<"))


def test_an_equidistant_lens(tmp_path: Path) -> None:
    """The angle at the image's left and right edge is half of the field of view."""
    found = read(wide("equidistant", 3.0), tmp_path)
    config = config_from_mapping({"sensors": sensors_section(found)}).sensors.cameras[0]
    edge = np.array([[math.sin(1.5), 0, math.cos(1.5)]])
    assert project(edge, config.intrinsics)[0, 0] == pytest.approx(319.5)
    plain = read(wide("gnomonical", 1.0), tmp_path).cameras[0]
    assert plain.fisheye is None
    assert plain.focal_px[0] == pytest.approx(160 / math.tan(0.5))


@pytest.mark.parametrize("kind", ["stereographic", "custom", "equisolid_angle"])
def test_other_lenses_are_refused_by_name(tmp_path: Path, kind: str) -> None:
    with pytest.raises(InvalidInputError, match=f"'{kind}'.*equidistant or gnomonical"):
        read(wide(kind, 1.0), tmp_path)


def test_a_model_of_a_world(tmp_path: Path) -> None:
    world = f"""<sdf version="1.6"><world name="w"><include><uri>model://sun</uri></include>
    <model name="ground"><link name="l"/></model>
    <model name="bot"><link name="body">{camera(kind="segmentation")}</link></model>
    </world></sdf>"""
    (tmp_path / "w.sdf").write_text(world)
    with pytest.raises(InvalidInputError, match=r"one of bot, ground.*--model"):
        read_robot_file(tmp_path / "w.sdf")
    found = read_robot_file(tmp_path / "w.sdf", model="bot")
    assert found is not None
    assert found.sensors.cameras[0].modalities == ("semantic_0",)


def test_a_long_chain_of_frames_takes_no_longer_than_its_length(tmp_path: Path) -> None:
    count = 20_000
    frames = [
        f'<frame name="f{n}"><pose relative_to="f{n + 1}">0 0 0.001 0 0 0</pose></frame>'
        for n in range(count)
    ]
    end = f'<frame name="f{count}"/>'
    link = f'<link name="l"><pose relative_to="f0"/>{camera()}</link>'
    start_s = time.process_time()
    found = read(model("".join(frames) + end + link), tmp_path)
    assert time.process_time() - start_s < 20
    check_mount(found, pose(0, 0, 0.001 * count, 0, 0, 0))


def test_what_else_a_model_has_is_named(tmp_path: Path) -> None:
    content = f"""<plugin filename="drive" name="d"/><link name="body">{camera()}
    <light name="lamp" type="spot"/><sensor name="gas" type="air_pressure"/></link>
    <link name="hand"/><joint name="wrist" type="fixed"><parent>body</parent><child>hand</child>
    <sensor name="f" type="force_torque"/></joint>"""
    notes = read(model(content), tmp_path).notes
    assert "not used: the force_torque sensor on the joint wrist" in notes
    assert "not used: the light 'lamp'; environment.lamps may be on base_link" in notes
    assert "not used: the air_pressure 'gas' on body: no such sensor here" in notes
    assert "not used: Gazebo's plugins drive" in notes


LINK = '<link name="body">{}</link>'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (model("<include><uri>model://arm</uri></include>"), "model://arm.*gz sdf -p"),
        (model(LINK.format(camera(pose="<pose>0 0 0</pose>"))), "<pose>.*6 finite numbers"),
        (model(LINK.format(camera(pose='<pose frame="a">0 0 0 0 0 0</pose>'))), 'frame="a"'),
        (model(LINK.format(camera(pose='<pose relative_to="x">0 0 0 0 0 0</pose>'))), "'x'.*body"),
        (model(LINK.format(camera(pose='<pose relativ_to="a">0 0 0 0 0 0</pose>'))),
         "'relativ_to'.*expected.*did you mean relative_to"),
        (model(LINK.format(camera(pose='<pose degree="true">0 0 0 0 0 90</pose>'))),
         "'degree'.*expected.*did you mean degrees"),
        (model(f'<link name="a"><pose relative_to="b"/>{camera()}</link>'
               '<frame name="b" attached_to="a"/>'),
         "a > b > a.*circle"),
        (model('<link name="a"/><link name="a"/>'), "'a'.*no other link"),
        (model(LINK.format(camera(more="<distortion><k1>1</k1><center>0 0</center></distortion>"))),
         "no other centre"),
        (model(LINK.format('<sensor name="c" type="camera"/>')), "0 <camera>"),
        ('<sdf version="1.9"><include><uri>model://x1</uri></include></sdf>', "model://x1"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_named(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InvalidInputError, match=message):
        read(text, tmp_path)
