"""The mapper as a process: images of a plane in, the plane's mesh out."""

import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import open3d as o3d
import pytest
import rclpy
from builtin_interfaces.msg import Time
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from ros_peer import wait_until_known
from sensor_msgs.msg import CameraInfo, Image, PointCloud2
from std_msgs.msg import Header
from std_srvs.srv import Trigger
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import Marker
from waiting import PATIENCE_S, wait_until

from oaisys_core.errors import quote
from oaisys_core.geometry import T_LINK_OPTICAL, pose_looking_down, pose_to_matrix
from oaisys_core.types import PinholeIntrinsics, Pose
from oaisys_mapping.mesh_io import read_class_names, read_ply
from oaisys_mapping.tsdf import TsdfConfig, TsdfVolume
from oaisys_msgs.msg import MapStatus, SampleInfo, SemanticLabel, SemanticLabels, SensorPose
from oaisys_msgs.srv import Evaluate, GetNewestSample, SaveMesh
from oaisys_ros_bridge.clouds import mesh_from_marker
from oaisys_ros_bridge.conversions import (
    image_to_msg,
    intrinsics_to_msg,
    stamp_from_nanoseconds,
    transform_to_msg,
)
from oaisys_ros_bridge.qos import LATCHED_QOS, SENSOR_QOS, SMALL_MESSAGE_QOS, TF_QOS

pytestmark = pytest.mark.ros

CAMERA = PinholeIntrinsics(160, 120, 135.0, 135.0, 79.5, 59.5)
SLOPE = 0.2
"""The plane is z = SLOPE * x."""
POSES = [pose_looking_down(x, y, 8.0, yaw_rad=x) for x in (-2.0, 0.0, 2.0) for y in (-1.0, 1.0)]
SLICE_M = 1.05
"""Height of the slice, between two layers of voxels."""
SLICE = ("esdf.length_m:=4.0", f"esdf.slice_level:={SLICE_M}", "esdf.max_distance_m:=0.7")
TOPICS = {
    "depth": "camera/depth/image_raw",
    "info": "camera/depth/camera_info",
    "color": "camera/color/image_raw",
    "color_info": "camera/color/camera_info",
}
NVBLOX_TOPICS = {
    "depth": "camera_0/depth/image",
    "info": "camera_0/depth/camera_info",
    "color": "camera_0/color/image",
    "color_info": "camera_0/color/camera_info",
    "semantic": "camera/semantic_0/image_raw",
}
"""Those of nvblox, by remapping alone, and one that it does not have."""


def plane_depth_m(T_map_camera: np.ndarray) -> np.ndarray:
    """Return the planar depth of z = SLOPE * x, where rays through pixel centres meet it."""
    u, v = np.meshgrid(np.arange(CAMERA.width_px), np.arange(CAMERA.height_px))
    x = (u - CAMERA.cx_px) / CAMERA.fx_px
    y = (v - CAMERA.cy_px) / CAMERA.fy_px
    rays = np.stack((x, y, np.ones_like(x)), axis=-1) @ T_map_camera[:3, :3].T
    normal = np.array([-SLOPE, 0.0, 1.0])
    return (-(T_map_camera[:3, 3] @ normal) / (rays @ normal)).astype(np.float32)


class Peer:
    """The mapper's process, and a node that plays camera, rig and user."""

    def __init__(self, *parameters: str, topics: Mapping[str, str] = TOPICS) -> None:
        command = [sys.executable, "-m", "oaisys_ros_bridge.nodes.mapper", "--ros-args"]
        for parameter in parameters:
            command += ["-p", parameter]
        for kind, topic in topics.items():
            if topic != TOPICS.get(kind, topic):
                command += ["-r", f"{TOPICS[kind]}:={topic}"]
        self.process = subprocess.Popen(
            command, stderr=subprocess.PIPE, text=True, start_new_session=True
        )
        self.context = rclpy.Context()
        rclpy.init(context=self.context)
        self.node = Node("peer", context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.latest: dict[str, Any] = {}
        for kind, topic in (
            (MapStatus, "metrics"),
            (Marker, "mesh"),
            (PointCloud2, "surface_points"),
            (PointCloud2, "esdf_slice"),
        ):
            self.node.create_subscription(
                kind,
                f"oaisys_mapper/{topic}",
                lambda message, topic=topic: self.latest.update({topic: message}),
                LATCHED_QOS,
            )
        self.publishers = {
            "static": self.node.create_publisher(TFMessage, "/tf_static", LATCHED_QOS),
            "tf": self.node.create_publisher(TFMessage, "/tf", TF_QOS),
        }
        for kind, topic in topics.items():
            message = CameraInfo if kind.endswith("info") else Image
            self.publishers[kind] = self.node.create_publisher(message, topic, SENSOR_QOS)
        base = Header(frame_id="base_link")
        link = Header(frame_id="camera_link")
        mounts = [
            transform_to_msg(np.eye(4), base, "camera_link"),
            transform_to_msg(T_LINK_OPTICAL, link, "camera_optical_frame"),
        ]
        self.publishers["static"].publish(TFMessage(transforms=mounts))
        self.wait_until(lambda: "metrics" in self.latest)
        self.wait_until(
            lambda: all(p.get_subscription_count() == 1 for p in self.publishers.values())
        )

    def wait_until(self, is_so: Callable[[], bool]) -> None:
        wait_until(
            is_so,
            process=self.process,
            pause=lambda: self.executor.spin_once(timeout_sec=0.1),
        )

    def show(self, pose: Pose, stamp: Time) -> None:
        """Publish what the camera sees of the plane, the transform last of all."""
        T_map_base = pose_to_matrix(pose)
        depth_m = plane_depth_m(T_map_base @ T_LINK_OPTICAL)
        optical = Header(stamp=stamp, frame_id="camera_optical_frame")
        rgb = np.full((*depth_m.shape, 3), (200, 100, 50), np.uint8)
        self.publishers["color"].publish(image_to_msg(rgb, "rgb8", optical))
        self.publishers["depth"].publish(image_to_msg(depth_m, "32FC1", optical))
        self.publishers["info"].publish(intrinsics_to_msg(CAMERA, optical))
        self.publishers["color_info"].publish(intrinsics_to_msg(CAMERA, optical))
        if "semantic" in self.publishers:
            labels = np.full(depth_m.shape, 4, np.uint16)
            labels[:, CAMERA.width_px // 2 :] = 9
            self.publishers["semantic"].publish(image_to_msg(labels, "16UC1", optical))
        transform = transform_to_msg(T_map_base, Header(stamp=stamp, frame_id="map"), "base_link")
        self.publishers["tf"].publish(TFMessage(transforms=[transform]))

    def show_all(self) -> None:
        for index, pose in enumerate(POSES):
            self.show(pose, Time(sec=1 + index))
            self.wait_for_frames(index + 1)

    def wait_for_frames(self, frames: int) -> None:
        self.wait_until(lambda: self.latest["metrics"].frames_integrated == frames)

    def call(self, kind: type[Any], name: str, request: Any) -> Any:
        client = self.node.create_client(kind, f"oaisys_mapper/{name}")
        self.wait_until(client.service_is_ready)
        wait_until_known(self.node, "oaisys_mapper", self.wait_until)
        future = client.call_async(request)
        self.wait_until(future.done)
        return future.result()

    def end(self) -> tuple[int, str]:
        """Interrupt the mapper as Ctrl-C does; return its exit code and what it said."""
        self.node.destroy_node()
        self.executor.shutdown()
        rclpy.shutdown(context=self.context)
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
        try:
            _, said = self.process.communicate(timeout=20)
        except subprocess.TimeoutExpired:
            self.process.kill()
            _, said = self.process.communicate()
        return self.process.returncode, said


@pytest.fixture(scope="module")
def shared_peer(ros_of_module: None) -> Iterator[Peer]:
    started = Peer("voxel_size:=0.1", "mesh_period:=0.0", *SLICE)
    yield started
    started.end()


@pytest.fixture
def peer(shared_peer: Peer) -> Peer:
    """Its map is empty."""
    assert shared_peer.call(Trigger, "reset", Trigger.Request()).success
    shared_peer.wait_for_frames(0)
    for topic in ("mesh", "surface_points", "esdf_slice"):
        shared_peer.latest.pop(topic, None)
    return shared_peer


@pytest.mark.long
def test_images_of_a_plane_become_that_plane(peer: Peer, tmp_path: Path) -> None:
    peer.show_all()

    saved = peer.call(SaveMesh, "save_mesh", SaveMesh.Request(path=str(tmp_path / "new" / "m.ply")))

    assert saved.success, saved.message
    assert saved.frames == len(POSES)
    mesh = o3d.io.read_triangle_mesh(str(tmp_path / "new" / "m.ply"))
    vertices_m = np.asarray(mesh.vertices)
    assert len(vertices_m) == saved.vertices > 1000
    assert len(mesh.triangles) == saved.triangles
    off_m = (vertices_m[:, 2] - SLOPE * vertices_m[:, 0]) / np.hypot(1, SLOPE)
    assert np.abs(off_m).max() < 0.01
    colors = np.rint(np.asarray(mesh.vertex_colors) * 255)
    assert (colors == (200, 100, 50)).all()

    # What RViz gets is the same surface.
    peer.wait_until(lambda: {"mesh", "surface_points"} <= peer.latest.keys())
    assert peer.latest["mesh"].header.frame_id == "map"
    corners_m, colors = mesh_from_marker(peer.latest["mesh"])
    assert len(corners_m) == saved.triangles
    assert np.abs(corners_m[..., 2] - SLOPE * corners_m[..., 0]).max() < 0.011
    assert (colors == (200, 100, 50)).all()
    assert peer.latest["surface_points"].width == saved.vertices


@pytest.mark.long
def test_a_slice_of_distances_is_that_of_the_plane(peer: Peer) -> None:
    peer.show_all()
    x, y, _ = POSES[-1].position_m

    def found() -> bool:
        message = peer.latest.get("esdf_slice")
        return message is not None and message.header.stamp.sec == len(POSES)

    peer.wait_until(found)
    message = peer.latest["esdf_slice"]
    assert message.header.frame_id == "map"
    assert [(f.name, f.offset, f.datatype) for f in message.fields] == [
        (name, 4 * i, 7) for i, name in enumerate(("x", "y", "z", "intensity"))
    ]
    points = np.frombuffer(message.data, "<f4").reshape(message.width, 4)
    # In a square of 4 m around the camera, at the voxels' places, 0.1 m apart.
    assert (np.abs(points[:, :2] - (x, y)) <= 2.0).all()
    assert 0.9 * 40**2 < len(points) <= 41**2
    np.testing.assert_allclose(points[:, :2] * 10, np.rint(points[:, :2] * 10), atol=1e-3)
    np.testing.assert_array_equal(points[:, 2], np.float32(SLICE_M))
    true_m = np.minimum((SLICE_M - SLOPE * points[:, 0]) / np.hypot(1, SLOPE), 0.7)
    # A tilted plane's nearest voxel is off by up to half a voxel's diagonal.
    assert np.abs(points[:, 3] - true_m).max() < 0.06
    assert (points[:, 3].max(), points[:, 3].min() < 0.35) == (np.float32(0.7), True)


@pytest.mark.long
def test_it_measures_its_map_against_the_truth(peer: Peer, tmp_path: Path) -> None:
    far = [(x, y, SLOPE * x) for x in (-30.0, 30.0) for y in (-30.0, 30.0)]
    truth = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(far), o3d.utility.Vector3iVector([(0, 2, 1), (1, 2, 3)])
    )
    o3d.io.write_triangle_mesh(str(tmp_path / "truth.ply"), truth)
    request = Evaluate.Request(truth_path=str(tmp_path / "truth.ply"))

    early = peer.call(Evaluate, "evaluate", request)
    assert not early.success
    assert "nothing has been mapped" in early.message
    peer.show_all()
    missing = peer.call(Evaluate, "evaluate", Evaluate.Request(truth_path="/nowhere.ply"))
    assert not missing.success
    assert "/nowhere.ply" in missing.message
    measured = peer.call(Evaluate, "evaluate", request)

    assert measured.success, measured.message
    figures = json.loads(measured.metrics_json)
    assert figures["rmse_m"] < 0.005
    assert figures["completion_ratio"] > 0.97
    assert figures["f_score"] > 0.98
    peer.wait_until(lambda: peer.latest["metrics"].metrics_json == measured.metrics_json)


def test_an_empty_map_replaces_no_mesh(peer: Peer, tmp_path: Path) -> None:
    peer.show_all()
    path = tmp_path / "m.ply"
    assert peer.call(SaveMesh, "save_mesh", SaveMesh.Request(path=str(path))).triangles > 0
    before = path.read_bytes()

    assert peer.call(Trigger, "reset", Trigger.Request()).success

    peer.wait_for_frames(0)
    for name in ("m.ply", "new/m.ply", "m.npz"):
        refused = peer.call(SaveMesh, "save_mesh", SaveMesh.Request(path=str(tmp_path / name)))
        assert (refused.success, refused.message) == (False, "nothing has been mapped yet")
    assert path.read_bytes() == before
    assert [each.name for each in tmp_path.iterdir()] == ["m.ply"]


def test_a_mesh_goes_only_into_a_file_of_its_format(peer: Peer, tmp_path: Path) -> None:
    """A file called .obj was a PLY file, with success; so was one called .NPZ."""
    peer.show_all()
    for name in ("m.obj", "m.glb", "m", "m.ply.gz"):
        path = str(tmp_path / name)
        refused = peer.call(SaveMesh, "save_mesh", SaveMesh.Request(path=path))
        expected = (
            f"path: received {quote(path)}, expected a file whose name ends with .ply or .npz"
        )
        assert (refused.success, refused.message) == (False, expected)
    for name, begin in (("m.PLY", b"ply\n"), ("m.NPZ", b"PK")):
        path = str(tmp_path / name)
        assert peer.call(SaveMesh, "save_mesh", SaveMesh.Request(path=path)).success
        assert (tmp_path / name).read_bytes().startswith(begin)
    assert {each.name for each in tmp_path.iterdir()} == {"m.PLY", "m.NPZ"}


def test_paths_that_no_file_can_have_are_refused_in_short(peer: Peer) -> None:
    """The answer had the whole path in it, 30 MB of it."""
    path = "x" * 1_000_000 + ".ply"
    expected = "at most 4095 bytes, and 255 for each name in it"
    saved = peer.call(SaveMesh, "save_mesh", SaveMesh.Request(path=path))
    found = peer.call(Evaluate, "evaluate", Evaluate.Request(truth_path=path))
    for answer, field in ((saved, "path"), (found, "truth_path")):
        message = f"{field}: received {quote(path)}, expected {expected}"
        assert (answer.success, answer.message) == (False, message)


class LateBridge:
    """A bridge whose second sample is published after what it says of it."""

    def __init__(self, peer: Peer) -> None:
        self._peer = peer
        self.node = Node("oaisys_bridge", context=peer.context)
        peer.executor.add_node(self.node)
        self._announced = self.node.create_publisher(SampleInfo, "~/sample_info", SMALL_MESSAGE_QOS)
        self._worlds = self.node.create_publisher(SampleInfo, "~/batch", LATCHED_QOS)
        self.asked = False
        self.batch_begin = Time()
        self.node.create_service(GetNewestSample, "~/get_newest_sample", self._answer)
        peer.wait_until(lambda: self._announced.get_subscription_count() == 1)

    def _answer(self, _: Any, answer: GetNewestSample.Response) -> GetNewestSample.Response:
        self.asked = True
        answer.success, answer.sequence = True, 2
        answer.batch_id, answer.sample_id, answer.stamp = 1, 2, Time(sec=2)
        answer.published = stamp_from_nanoseconds(time.time_ns())
        answer.batch_begin = self.batch_begin
        return answer

    def announce_world(self, number: int, begin: Time) -> None:
        self._worlds.publish(SampleInfo(header=Header(stamp=begin), batch_id=number))

    def publish(self, number: int) -> None:
        stamp = Time(sec=number)
        self._peer.show(POSES[number], stamp)
        sensor = SensorPose(sensor="camera", modalities=["rgb", "depth"])
        self._announced.publish(
            SampleInfo(
                header=Header(stamp=stamp),
                batch_id=1,
                sample_id=number,
                sensors=[sensor],
                sequence=number,
            )
        )

    def answer_late(
        self, kind: type[Any], name: str, request: Any, publish: Callable[[], None]
    ) -> Any:
        """Call a service of the mapper; publish what it has to wait for once it has asked."""
        client = self._peer.node.create_client(kind, f"oaisys_mapper/{name}")
        self._peer.wait_until(client.service_is_ready)
        wait_until_known(self._peer.node, "oaisys_mapper", self._peer.wait_until)
        future = client.call_async(request)
        self._peer.wait_until(lambda: self.asked)
        for _ in range(3):
            self._peer.executor.spin_once(timeout_sec=0.1)
        assert not future.done()
        publish()
        self._peer.wait_until(future.done)
        return future.result()


@pytest.fixture
def late_bridge(ros_domain_id: int, no_process_left: None) -> Iterator[LateBridge]:
    peer = Peer("voxel_size:=0.1", "mesh_period:=0.0")
    try:
        bridge = LateBridge(peer)
        bridge.publish(1)
        peer.wait_for_frames(1)
        yield bridge
        bridge.node.destroy_node()
    finally:
        peer.end()


def test_a_sample_whose_announcement_comes_after_the_request_is_in_the_mesh(
    late_bridge: LateBridge, tmp_path: Path
) -> None:
    """18 of 150 meshes that were saved right after a view did not have it."""
    request = SaveMesh.Request(path=str(tmp_path / "m.ply"))
    saved = late_bridge.answer_late(SaveMesh, "save_mesh", request, lambda: late_bridge.publish(2))
    assert (saved.success, saved.message, saved.frames) == (True, "", 2)


def test_the_map_of_a_world_is_not_saved_after_the_next_one_has_begun(
    late_bridge: LateBridge, tmp_path: Path
) -> None:
    late_bridge.announce_world(1, Time(sec=1))
    late_bridge.publish(2)
    late_bridge._peer.wait_for_frames(2)
    late_bridge.batch_begin = Time(sec=3)
    request = SaveMesh.Request(path=str(tmp_path / "m.ply"))
    saved = late_bridge.answer_late(
        SaveMesh, "save_mesh", request, lambda: late_bridge.announce_world(2, Time(sec=3))
    )
    assert (saved.success, saved.message) == (False, "nothing has been mapped yet")
    assert not list(tmp_path.iterdir())


def test_a_sample_whose_announcement_comes_after_a_reset_is_not_in_the_map(
    late_bridge: LateBridge, tmp_path: Path
) -> None:
    peer = late_bridge._peer
    request = Trigger.Request()
    answer = late_bridge.answer_late(Trigger, "reset", request, lambda: late_bridge.publish(2))
    assert answer.success
    late_bridge.publish(3)
    peer.wait_for_frames(1)
    peer.wait_until(lambda: peer.latest["metrics"].header.stamp == Time(sec=3))
    # It is announced after its images, which may be fused by then.
    peer.wait_until(lambda: peer.latest["metrics"].samples_announced)
    assert peer.latest["metrics"].samples_announced == 1


@pytest.mark.long
def test_topics_of_nvblox_with_labels_become_classes_and_the_same_frames_the_same_bytes(
    ros_domain_id: int, no_process_left: None, tmp_path: Path
) -> None:
    peer = Peer("mesh_period:=0.0", "use_semantics:=true", topics=NVBLOX_TOPICS)
    try:
        legend = peer.node.create_publisher(SemanticLabels, "camera/semantic_0/labels", LATCHED_QOS)
        names = [SemanticLabel(id=4, name="sand"), SemanticLabel(id=9, name="rock")]
        legend.publish(SemanticLabels(labels=names))
        peer.wait_until(lambda: legend.get_subscription_count() == 1)
        for name in ("one", "two"):
            peer.show_all()
            for path in (tmp_path / f"{name}.npz", tmp_path / f"{name}.ply"):
                saved = peer.call(SaveMesh, "save_mesh", SaveMesh.Request(path=str(path)))
                assert saved.success, saved.message
            assert peer.call(Trigger, "reset", Trigger.Request()).success
            peer.wait_for_frames(0)
    finally:
        peer.end()
    assert (tmp_path / "one.npz").read_bytes() == (tmp_path / "two.npz").read_bytes()
    mesh = read_ply(tmp_path / "one.ply")
    assert (mesh.colors_rgb == (200, 100, 50)).all()
    assert set(np.unique(mesh.class_ids).tolist()) == {4, 9}  # type: ignore[arg-type]
    assert read_class_names(tmp_path / "one.ply") == {4: "sand", 9: "rock"}
    volume = TsdfVolume(TsdfConfig(semantic=True))
    volume.load(tmp_path / "one.npz")
    assert volume.frames == len(POSES)
    assert len(volume.extract_mesh().triangles) == len(mesh.triangles)


def test_ctrl_c_ends_it_without_a_word(ros_domain_id: int, no_process_left: None) -> None:
    peer = Peer()
    peer.show(POSES[0], Time(sec=1))

    code, said = peer.end()

    assert code == 0, said
    assert "Traceback" not in said


@pytest.mark.parametrize(
    "parameter",
    [
        pytest.param("voxel_size:=-0.1", marks=pytest.mark.long),
        pytest.param("weighting:=heavy", marks=pytest.mark.soak),
        pytest.param("use_color:=perhaps", marks=pytest.mark.soak),
    ],
)
def test_a_wrong_parameter_is_told_in_one_line(ros_domain_id: int, parameter: str) -> None:
    command = [
        sys.executable,
        "-m",
        "oaisys_ros_bridge.nodes.mapper",
        "--ros-args",
        "-p",
        parameter,
    ]

    ended = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S, check=False)

    assert ended.returncode == 2
    assert len(ended.stderr.splitlines()) == 1
    assert parameter.split(":=")[0] in ended.stderr
