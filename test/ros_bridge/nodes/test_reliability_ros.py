"""Faults injected into nodes, their server and their disk; see docs/reliability.md."""

from __future__ import annotations

import contextlib
import os
import resource
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import psutil
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from leak_check import LeakCheck
from mcap.exceptions import McapError
from mcap.reader import NonSeekingReader
from ros_peer import NodeProcess, Stage, User, nanoseconds, stamped
from rosbags.rosbag2 import Reader
from sensor_msgs.msg import Image
from served_simulator import FLAT_WORLD, ROCKY_WORLD
from std_msgs.msg import Bool
from waiting import PATIENCE_S, SHUTDOWN_S, within

from oaisys_core.geometry import pose_looking_at, pose_looking_down
from oaisys_core.types import Pose
from oaisys_msgs.msg import MapStatus
from oaisys_msgs.srv import SetPose, StepBatch
from oaisys_ros_bridge.bags.reading import recover
from oaisys_ros_bridge.qos import LATCHED_QOS, SENSOR_QOS

pytestmark = pytest.mark.ros

DEPTH = "camera/depth/image_raw"
FAULTY = {"OAISYS_TEST_BUILD": "1"}
LONGER_THAN_ANY_TEST_S = 2 * PATIENCE_S
DISK_BYTES = 80 * 2**20
MAPPER_INPUTS = ["/camera/depth/image_raw", "/camera/depth/camera_info", "/camera/color/image_raw"]


@pytest.fixture
def stage(tmp_path: Path, ros_domain_id: int, leaks: LeakCheck) -> Iterator[Stage]:
    with Stage(tmp_path) as stage:
        yield stage


def pose(index: int) -> Pose:
    return pose_looking_down(float(index), 0.0, 5.0)


def statuses(user: User) -> list[DiagnosticStatus]:
    return [m.status[0] for m in user.received["/diagnostics"]]


def value_of(status: DiagnosticStatus, key: str) -> str:
    return next((v.value for v in status.values if v.key == key), "")


def begin_set_pose(user: User, where: Pose, **fields: Any) -> Any:
    return user.begin(SetPose, "set_pose", SetPose.Request(pose=stamped(where), **fields))


@pytest.mark.long
def test_diagnostics_tell_of_a_worker_that_crashed_and_of_its_end(stage: Stage) -> None:
    user = stage.user
    user.listen(DiagnosticArray, "/diagnostics", SENSOR_QOS)
    user.listen(Image, DEPTH, SENSOR_QOS)
    fault = f"late-slow:{LONGER_THAN_ANY_TEST_S}@2"
    server = stage.start_world(FLAT_WORLD, OAISYS_FAULT=fault, **FAULTY)
    bridge = stage.start_bridge(server.address)
    user.wait_until_ready()
    assert user.set_pose(pose(0)).success
    rendering = begin_set_pose(user, pose(1))
    user.wait_until(lambda: len(user.received[DEPTH]) == 2)
    user.received["/diagnostics"].clear()
    server.worker().send_signal(signal.SIGSEGV)

    answer = user.answer(rendering)

    assert not answer.success
    assert "SIGSEGV" in answer.message
    user.wait_until(
        lambda: statuses(user) and value_of(statuses(user)[-1], "worker_restarts") == "1"
    )
    user.wait_until(lambda: statuses(user)[-1].level == DiagnosticStatus.OK)
    assert DiagnosticStatus.ERROR in {status.level for status in statuses(user)}
    again = user.set_pose(pose(1))
    assert (again.success, again.sample_id) == (True, 2)
    assert "Traceback" not in bridge.log.read_text()


@contextmanager
def small_disk(folder: Path) -> Iterator[None]:
    """Mount a small file system of its own; skip where this user must not."""
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", f"size={DISK_BYTES}", "tmpfs", str(folder)]
    if os.geteuid() != 0 or subprocess.run(mount, capture_output=True, check=False).returncode:
        pytest.skip("this user must not mount a file system")
    try:
        yield
    finally:
        subprocess.run(["umount", str(folder)], check=True)


def fill(folder: Path) -> None:
    """Leave hardly any room on the file system of a folder."""
    disk = os.statvfs(folder)
    with (folder / "filler").open("wb") as filler:
        os.posix_fallocate(filler.fileno(), 0, disk.f_bavail * disk.f_frsize)


def limit_file_size(recorder: NodeProcess, file: Path) -> None:
    """Let writes fail a little further on, as they do on a full disk."""
    most = file.stat().st_size + 100
    psutil.Process(recorder.process.pid).rlimit(resource.RLIMIT_FSIZE, (most, most))


def messages_in(file: Path) -> int:
    count = 0
    with file.open("rb") as stream, contextlib.suppress(McapError):
        for _ in NonSeekingReader(stream).iter_messages(log_time_order=False):
            count += 1
    return count


def oblique(index: int) -> Pose:
    """A view over rocks, whose depth does not compress to nothing."""
    return pose_looking_at((-3.0 - index / 2, 1.0, 8.0), (2.0, -1.0, 0.0))


def record_until_full(stage: Stage, folder: Path, inject: Callable[[NodeProcess], None]) -> None:
    """Record three samples, and then some that cannot be written."""
    user = stage.user
    recording: list[Bool] = user.received["oaisys_recorder/recording"]
    recording.clear()
    recorder = stage.start_node("recorder", "--out", str(folder), "--topics", f"/{DEPTH}")
    user.wait_until(lambda: f"recording: {folder}" in recorder.log.read_text().splitlines())
    user.wait_until_matched([f"/{DEPTH}"], subscribers=2)
    for index in range(3):
        assert user.set_pose(oblique(index)).success
    file = folder / f"{folder.name}_0.mcap"
    user.wait_until(lambda: recording and messages_in(file) == 3)
    inject(recorder)
    for index in range(3, 6):
        assert user.set_pose(oblique(index)).success
    user.wait_until(lambda: not recording[-1].data)
    assert recorder.process.wait(PATIENCE_S) == 1
    said = recorder.log.read_text()
    assert said.count("has ended:") == 1
    last = said.splitlines()[-1]
    assert "the recording has failed: " in last
    assert "Traceback" not in said


@pytest.mark.long
def test_a_bag_that_cannot_be_written_ends_the_recording_alone(
    stage: Stage, tmp_path: Path
) -> None:
    user = stage.user
    user.listen(Image, DEPTH, SENSOR_QOS)
    user.listen(Bool, "oaisys_recorder/recording", LATCHED_QOS)
    stage.start_bridge(stage.start_world(ROCKY_WORLD).address)
    user.wait_until(lambda: user.received["oaisys_bridge/ready"][-1:] == [Bool(data=True)])
    limited = tmp_path / "limited"
    file = limited / "limited_0.mcap"
    record_until_full(stage, limited, lambda recorder: limit_file_size(recorder, file))
    assert recover(file, tmp_path / "saved") >= 3
    with small_disk(tmp_path / "disk"):
        full = tmp_path / "disk" / "full"
        record_until_full(stage, full, lambda _: fill(tmp_path / "disk"))
        assert recover(full / "full_0.mcap", tmp_path / "saved_too") >= 3
        log = (tmp_path / "recorder.log").read_text()
        assert f"the end came before messages of /{DEPTH} " in log.splitlines()[-1]
    gone = tmp_path / "gone"
    record_until_full(stage, gone, lambda _: shutil.rmtree(gone))
    assert f"messages in {gone} are gone" in (tmp_path / "recorder.log").read_text()


def test_a_recording_is_not_begun_where_there_is_no_room(stage: Stage) -> None:
    recorder = stage.start_node("recorder", "--out", "/proc/bag")

    assert recorder.process.wait(PATIENCE_S) == 2
    assert recorder.log.read_text().splitlines() == [
        "path: received '/proc/bag', expected 64 MB free, not 0"
    ]


@pytest.mark.long
def test_signals_end_all_nodes_while_they_work(stage: Stage, tmp_path: Path) -> None:
    user, bag = stage.user, tmp_path / "bag"
    user.listen(Image, DEPTH, SENSOR_QOS)
    fault = f"late-slow:{LONGER_THAN_ANY_TEST_S}@2"
    server = stage.start_world(FLAT_WORLD, OAISYS_FAULT=fault, **FAULTY)
    bridge = stage.start_bridge(server.address)
    mapper = stage.start_node("mapper")
    recorder = stage.start_node("recorder", "--out", str(bag), "--topics", f"/{DEPTH}")
    user.wait_until_ready()
    user.wait_until_matched([f"/{DEPTH}"], subscribers=3)
    assert user.set_pose(pose(0)).success
    begin_set_pose(user, pose(1))
    user.wait_until(lambda: len(user.received[DEPTH]) == 2)

    processes = [recorder.process, bridge.process, mapper.process, server.process]
    with within(SHUTDOWN_S):
        for process in processes:
            for number in [signal.SIGINT] * 2 + [signal.SIGTERM]:
                process.send_signal(number)

        assert [process.wait(PATIENCE_S) for process in processes] == [0, 0, 0, 0]
    with Reader(bag) as reader:
        assert reader.topics[f"/{DEPTH}"].msgcount == 2
    for log in (bridge.log, mapper.log, recorder.log, server.stderr):
        assert "Traceback" not in log.read_text()


SLOW_SUBSCRIBER = """
import sys
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from sensor_msgs.msg import Image
from oaisys_ros_bridge.qos import SENSOR_QOS
rclpy.init()
node = Node("slow")
def show(image):
    print(image.header.stamp.sec * 10**9 + image.header.stamp.nanosec, flush=True)
subscription = node.create_subscription(Image, sys.argv[1], show, SENSOR_QOS)
print("listening", flush=True)
try:
    rclpy.spin(node)
except (KeyboardInterrupt, ExternalShutdownException):
    node.destroy_node()
    rclpy.try_shutdown()
"""


@pytest.mark.long
def test_a_subscriber_that_is_stopped_costs_no_memory_and_misses_the_oldest(
    stage: Stage, tmp_path: Path
) -> None:
    """The bridge keeps the five newest of each topic for whoever is slow."""
    camera = {"width_px": 640, "height_px": 480, "fx_px": 541.0, "fy_px": 541.0}
    user = stage.user
    server = stage.start_world({**FLAT_WORLD, "sensors": {"cameras": [camera]}})
    bridge = stage.start_bridge(server.address)
    user.wait_until_ready()
    log = tmp_path / "slow.log"
    with log.open("w") as output:
        command = [sys.executable, "-c", SLOW_SUBSCRIBER, DEPTH]
        slow = subprocess.Popen(command, stdout=output, stderr=subprocess.STDOUT)
    try:
        user.wait_until_matched([f"/{DEPTH}"])
        node, held, sent = psutil.Process(bridge.process.pid), [], []
        for index in range(40):
            if index == 10:
                slow.send_signal(signal.SIGSTOP)
            answer = user.set_pose(pose(0), modalities=["depth"])
            assert answer.success, answer.message
            sent.append(nanoseconds(answer.stamp))
            held.append(node.memory_info().rss)
        slow.send_signal(signal.SIGCONT)
        user.wait_until(lambda: log.read_text().split()[-1] == str(sent[-1]))
        slow.send_signal(signal.SIGINT)
        assert slow.wait(PATIENCE_S) == 0
    finally:
        slow.kill()
        slow.wait()
    # The middleware may say something of its own between the stamps.
    got = [int(line) for line in log.read_text().splitlines() if line.isdecimal()]
    assert got == sorted(set(got))
    assert set(got) < set(sent)
    image_bytes = 640 * 480 * 4
    assert held[-1] - held[15] < 15 * image_bytes, "of the 24 images sent between them"


@pytest.mark.long
def test_a_batch_ends_the_sample_under_way_and_the_map(stage: Stage) -> None:
    user = stage.user
    user.listen(Image, DEPTH, SENSOR_QOS)
    user.listen(MapStatus, "oaisys_mapper/metrics", LATCHED_QOS)
    fault = f"late-slow:{LONGER_THAN_ANY_TEST_S}@3"
    server = stage.start_world(FLAT_WORLD, OAISYS_FAULT=fault, **FAULTY)
    stage.start_bridge(server.address)
    mapper = stage.start_node("mapper", "--ros-args", "-p", "mesh_period:=0.0")
    user.wait_until_ready()
    user.wait_until_matched(MAPPER_INPUTS[1:])
    user.wait_until_matched(MAPPER_INPUTS[:1], subscribers=2)
    user.wait_until_matched(["/tf", "/tf_static", "/oaisys_bridge/sample_info"])
    status: list[MapStatus] = user.received["oaisys_mapper/metrics"]
    for index in range(2):
        assert user.set_pose(pose(index)).success
    user.wait_until(lambda: status[-1].frames_integrated == 2)
    rendering = begin_set_pose(user, pose(2))
    user.wait_until(lambda: len(user.received[DEPTH]) == 3)

    stepped = user.call(StepBatch, "step_batch", StepBatch.Request(seed=-1))

    assert (stepped.success, stepped.batch_id) == (True, 2)
    answer = user.answer(rendering)
    assert not answer.success
    assert "overtaken" in answer.message
    user.wait_until(lambda: status[-1].frames_integrated == 0)
    after = user.set_pose(pose(0))
    assert (after.success, after.batch_id, after.sample_id) == (True, 2, 1)
    user.wait_until(lambda: status[-1].frames_integrated == 1)
    assert "cleared" in mapper.log.read_text()
