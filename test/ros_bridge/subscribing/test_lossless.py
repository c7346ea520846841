"""Nothing is lost without a word: mapper and recorder take all samples, or tell what they lack."""

from __future__ import annotations

import json
import signal
import subprocess
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

import pytest
import yaml
from commands import oaisys_here
from diagnostic_msgs.msg import DiagnosticArray
from explore_runs import recorder_of
from geometry_msgs.msg import PoseArray
from mcap.reader import make_reader
from rclpy.qos import QoSProfile
from ros_peer import LATCHED_TYPES, SAMPLE_TYPES, NodeProcess, Stage, stamped
from served_simulator import FLAT_WORLD, MOUNDS
from std_msgs.msg import Header
from waiting import LOAD_FACTOR, START_PATIENCE_S, wait_until

from oaisys_core.geometry import pose_looking_down
from oaisys_msgs.action import Sweep
from oaisys_msgs.msg import MapStatus, SampleInfo, SampleReceipt
from oaisys_msgs.srv import Evaluate, SaveMesh
from oaisys_ros_bridge.bags.losses import METADATA_NAME, BagLosses
from oaisys_ros_bridge.qos import LATCHED_HISTORY_QOS, LATCHED_QOS, SMALL_MESSAGE_QOS
from tools.soak.counts import busy_loops, stamps_of

pytestmark = pytest.mark.ros

SWEPT, ASKED = 20, 5
VIEWS = SWEPT + ASKED
FIRST = 2
"""Samples before a node is stopped. A recorder cannot tell whether messages of its first one were
sent before it was there, and need not wait for them. It has taken them once it has the second."""
PUBLISHED = FIRST + VIEWS + 1
"""Samples of a test with a node that is stopped in the middle."""
MANY_VIEWS = 80
"""More than the middleware's shared memory keeps for a node that is stopped: 43 samples may fit."""
MANY_PUBLISHED = FIRST + MANY_VIEWS + 1
WAIT_S = 2.0
"""Of the bridge, for a reader that takes nothing."""
MAPPER_INPUTS = ("/camera/depth/image_raw", "/camera/depth/camera_info", "/tf")
RECORDED = {
    *SAMPLE_TYPES,
    "/camera/detections",
    "/camera/detections_3d",
    "/camera/instance/camera_info",
    "/camera/semantic_0/camera_info",
    "/camera/transform",
    "/odometry",
    "/path",
    "/viewpoints",
}
"""Of times on a machine that does something else as well."""


class Crew:
    """A bridge, the mapper, a recorder of everything, and a user who listens to none of it."""

    def __init__(self, stage: Stage, folder: Path, *bridge_parameters: str) -> None:
        self.user, self.bag = stage.user, folder / "bag"
        self.user.listen(SampleInfo, "oaisys_bridge/sample_info", SMALL_MESSAGE_QOS)
        self.user.listen(SampleReceipt, "oaisys_bridge/receipts", LATCHED_HISTORY_QOS)
        self.user.listen(MapStatus, "oaisys_mapper/metrics", LATCHED_QOS)
        address = stage.start_world(FLAT_WORLD).address
        options = [o for p in (f"address:={address}", *bridge_parameters) for o in ("-p", p)]
        self.bridge = stage.start_node("bridge", "--ros-args", *options)
        self.mapper = stage.start_node("mapper", "--ros-args", "-p", "mesh_period:=0.0")
        self.user.wait_until(lambda: self.user.received["oaisys_mapper/metrics"], START_PATIENCE_S)
        topics = [*SAMPLE_TYPES, *LATCHED_TYPES]
        self.recorder = stage.start_node(
            "recorder", "--out", str(self.bag), "--all", "--topics", *topics
        )
        self.user.wait_until_ready()
        self.user.wait_until(lambda: "recording:" in self.recorder.log.read_text())
        self.user.wait_until_matched(RECORDED)
        # The mapper beside the recorder; of samples, the user and the recorder's own count, too.
        self.user.wait_until_matched(MAPPER_INPUTS, subscribers=2)
        self.user.wait_until_matched(["/oaisys_bridge/sample_info"], subscribers=4)

    def sweep(self, views: int) -> Sweep.Result:
        """Look from many poses as fast as it goes."""
        client = self.user.action_client(Sweep, "oaisys_bridge/sweep")
        poses = [stamped(pose_looking_down(0.01 * i, 0.0, 5.0)).pose for i in range(views)]
        goal = Sweep.Goal(poses=PoseArray(header=Header(frame_id="map"), poses=poses))
        accepted = self.user.answer(client.send_goal_async(goal))
        result: Sweep.Result = self.user.answer(accepted.get_result_async()).result
        assert result.success, result.message
        assert len(result.sample_ids) == views
        return result

    @property
    def map(self) -> MapStatus:
        return self.user.received["oaisys_mapper/metrics"][-1]

    def save_mesh(self, path: Path) -> SaveMesh.Response:
        client = self.user.client(SaveMesh, "oaisys_mapper/save_mesh")
        return self.user.answer(client.call_async(SaveMesh.Request(path=str(path))))

    def receipt_of(self, node: str) -> SampleReceipt:
        sent = self.user.received["oaisys_bridge/receipts"]
        return next((r for r in reversed(sent) if r.node == node), SampleReceipt())

    def has_taken(self, node: str, samples: int) -> bool:
        return self.receipt_of(node).samples == samples

    def end_recorder(self) -> BagLosses:
        """End the recorder and return what its bag says it lacks."""
        assert self.recorder.end() == 0
        with next(self.bag.glob("*.mcap")).open("rb") as stream:
            (record,) = (r for r in make_reader(stream).iter_metadata() if r.name == METADATA_NAME)
        description = yaml.safe_load((self.bag / "metadata.yaml").read_text())
        custom = description["rosbag2_bagfile_information"]["custom_data"]
        assert custom == record.metadata
        return BagLosses.read(custom)


def messages_of_samples(bag: Path) -> Mapping[str, int]:
    """Return how many samples a bag has a message of, by topic; repeated transforms are of none."""
    stamps, announced = stamps_of(bag)
    return {topic: len(stamps[topic] & announced.keys()) for topic in RECORDED}


@pytest.mark.long
def test_mapper_and_recorder_lose_nothing_of_a_sweep_on_a_busy_machine(
    stage: Stage, tmp_path: Path
) -> None:
    crew = Crew(stage, tmp_path)
    with busy_loops(3):
        result = crew.sweep(SWEPT)
        for index in range(ASKED):
            assert crew.user.set_pose(pose_looking_down(0.0, 0.01 * index, 6.0)).success
        saved = crew.save_mesh(tmp_path / "mesh.ply")

    assert result.message == ""
    assert (saved.success, saved.message, saved.frames) == (True, "", VIEWS)
    crew.user.wait_until(lambda: crew.map.frames_integrated == VIEWS)
    assert (crew.map.samples_announced, crew.map.samples_incomplete) == (VIEWS, 0)
    assert crew.map.frames_dropped == 0
    losses = crew.end_recorder()
    assert (losses.announced, losses.incomplete, losses.lost) == (VIEWS, 0, {})
    assert losses.lost_by_middleware == {}
    assert crew.map.lost_by_middleware == []
    assert messages_of_samples(crew.bag) == dict.fromkeys(RECORDED, VIEWS)
    assert f"{VIEWS} samples, none of them incomplete" in crew.recorder.log.read_text()
    told = oaisys_here("bag", "info", crew.bag)
    assert f"{VIEWS} samples, none of them incomplete" in told.stdout
    assert "/receipts" not in told.stdout, "a bag that is played must not speak for a recorder"


def incomplete_samples(bag: Path) -> int:
    """Return how many samples a bag lacks a message of, whichever topic's it is."""
    stamps, announced = stamps_of(bag)
    return len(announced.keys() - set.intersection(*(stamps[topic] for topic in RECORDED)))


def stop_in_the_middle(crew: Crew, nodes: Sequence[NodeProcess], views: int) -> Sweep.Result:
    """Stop nodes while a sweep goes on, and let them go on afterwards."""
    for index in range(FIRST):
        assert crew.user.set_pose(pose_looking_down(0.0, 0.01 * index, 6.0)).success
    for reader in ("/oaisys_mapper", "/oaisys_recorder"):
        crew.user.wait_until(partial(crew.has_taken, reader, FIRST))
    for node in nodes:
        node.process.send_signal(signal.SIGSTOP)
    try:
        return crew.sweep(views)
    finally:
        for node in nodes:
            node.process.send_signal(signal.SIGCONT)


@pytest.mark.long
def test_what_a_stopped_mapper_and_a_stopped_recorder_lose_is_reported_exactly(
    stage: Stage, tmp_path: Path
) -> None:
    crew = Crew(stage, tmp_path, "readers.when_behind:=drop")
    crew.user.listen(DiagnosticArray, "/diagnostics", QoSProfile(depth=100))

    result = stop_in_the_middle(crew, [crew.mapper, crew.recorder], MANY_VIEWS)
    assert "/oaisys_recorder has not taken" in result.message
    assert crew.user.set_pose(pose_looking_down(1.0, 0.0, 6.0)).success
    check_what_a_mapper_lost(crew, tmp_path)
    check_what_a_recorder_lost(crew)


def check_what_a_recorder_lost(crew: Crew) -> None:
    """Its bag, its receipts, its last line and `bag info` tell the same."""
    crew.user.wait_until(lambda: crew.has_taken("/oaisys_recorder", MANY_PUBLISHED))
    receipt = crew.receipt_of("/oaisys_recorder")
    losses = crew.end_recorder()

    missing = {
        topic: MANY_PUBLISHED - count
        for topic, count in messages_of_samples(crew.bag).items()
        if count < MANY_PUBLISHED
    }
    assert missing["/camera/depth/image_raw"] > MANY_VIEWS / 4, "it was stopped"
    assert losses.lost == missing
    assert {loss.what: loss.count for loss in receipt.lost} == missing
    assert losses.announced == receipt.samples == MANY_PUBLISHED
    # Not every topic lacks the same samples.
    assert losses.incomplete == incomplete_samples(crew.bag) >= max(missing.values())
    said = crew.recorder.log.read_text()
    assert f"{losses.incomplete} of {MANY_PUBLISHED} samples are incomplete; lost:" in said
    told = oaisys_here("bag", "info", crew.bag)
    assert f"/camera/depth/image_raw {missing['/camera/depth/image_raw']}" in told.stdout


def check_what_a_mapper_lost(crew: Crew, folder: Path) -> None:
    """Its metrics, the answers of its services and the bridge's diagnostics tell the same."""
    saved = crew.save_mesh(folder / "mesh.ply")
    # The answer may overtake the metrics of the frame that was fused last.
    crew.user.wait_until(lambda: crew.map.frames_integrated == saved.frames)

    lost = Counter({loss.what: loss.count for loss in crew.map.lost})
    assert saved.success
    assert 0 < saved.frames < MANY_PUBLISHED
    assert crew.map.samples_announced == MANY_PUBLISHED
    # A sample that lacks no more than its colour is in the map as well.
    without_color = saved.frames + crew.map.samples_incomplete - MANY_PUBLISHED
    assert 0 <= without_color <= lost["/camera/color/image_raw"]
    assert MANY_VIEWS / 4 < lost["/camera/depth/image_raw"] <= MANY_PUBLISHED - saved.frames
    incomplete = f"{crew.map.samples_incomplete} of {MANY_PUBLISHED} samples are incomplete"
    assert incomplete in saved.message
    assert (folder / "mesh.ply").stat().st_size > 0
    # It says nothing of a reader that it gave up: one that was stopped for longer than its lease.
    by_middleware = crew.map.lost_by_middleware
    assert ("the middleware lost messages of" in saved.message) == bool(by_middleware)
    client = crew.user.client(Evaluate, "oaisys_mapper/evaluate")
    truth = str(folder / "mesh.ply")
    evaluated = crew.user.answer(client.call_async(Evaluate.Request(truth_path=truth)))
    assert (evaluated.success, evaluated.message) == (True, saved.message)
    assert json.loads(evaluated.metrics_json)
    warnings = crew.user.wait_until(
        lambda: [
            status.message
            for array in crew.user.received["/diagnostics"]
            for status in array.status
            if status.name == "/oaisys_bridge: readers"
            and f"/oaisys_mapper: {incomplete}" in status.message
        ]
    )
    told = warnings[-1].partition("/oaisys_mapper")[2].partition("/oaisys_recorder")[0]
    assert ("the middleware lost messages of" in told) == bool(by_middleware)


@pytest.mark.long
def test_a_stopped_reader_holds_the_bridge_up_once_and_no_longer_than_it_may(
    stage: Stage, tmp_path: Path
) -> None:
    crew = Crew(stage, tmp_path, f"readers.timeout_s:={WAIT_S}")
    begun_s = time.monotonic()

    result = stop_in_the_middle(crew, [crew.recorder], VIEWS)
    seconds = time.monotonic() - begun_s

    assert "/oaisys_recorder has not taken" in result.message
    assert WAIT_S <= seconds < LOAD_FACTOR * (WAIT_S + 0.2 * VIEWS)
    assert crew.bridge.log.read_text().count("it is not waited for any more") == 1
    # It comes to itself again, and is waited for again.
    assert crew.user.set_pose(pose_looking_down(1.0, 0.0, 6.0)).success
    crew.user.wait_until(lambda: crew.has_taken("/oaisys_recorder", PUBLISHED))
    crew.user.wait_until(lambda: "takes samples again" in crew.bridge.log.read_text())
    assert crew.sweep(20).message == ""
    assert crew.end_recorder().incomplete > 0


LOSING_VIEWS = 14
EXPERIMENTS = {
    "survey": ("--no-faults", "--voxel-size", "0.3"),
    # Without an end at a coverage; from grid poses, so that planning takes no time.
    "explore": ("--planner", "grid", "--until", "1", "--voxel-size", "0.3"),
}


@pytest.mark.soak
@pytest.mark.parametrize("kind", ["survey", "explore"])
def test_an_experiment_whose_recorder_loses_messages_says_so_and_fails(
    kind: str, tmp_path: Path, ros_domain_id: int, no_process_left: None
) -> None:
    out, said, parameters = tmp_path / kind, tmp_path / "said", tmp_path / "parameters.yaml"
    bridge = {"ros__parameters": {"readers": {"timeout_s": 2 * WAIT_S}}}
    parameters.write_text(yaml.safe_dump({"oaisys_bridge": bridge}))
    command = ["oaisys", kind, "--backend", "analytic", "--size", "64x48", *EXPERIMENTS[kind]]
    if kind == "survey":
        world = tmp_path / "world.yaml"
        world.write_text(yaml.safe_dump(MOUNDS), encoding="utf-8")
        command += ["--config", str(world)]
    command += ["--params-file", str(parameters)]
    with said.open("w") as output:
        experiment = subprocess.Popen(
            [*command, "--views", str(LOSING_VIEWS), "--out", str(out)],
            stdout=output,
            stderr=output,
        )

    def wait_for_views(number: int) -> None:
        wait_until(
            lambda: said.read_text().count("rendered in") >= number,
            START_PATIENCE_S,
            process=experiment,
            explain=said.read_text,
        )

    try:
        wait_for_views(1)
        recorder = recorder_of(experiment)
        recorder.suspend()
        try:
            # The bridge waits for it for a while, then goes on without. The middleware forgets a
            # process that is silent for 20 s, and the recorder could not learn what it lost.
            wait_for_views(LOSING_VIEWS - 4)
        finally:
            recorder.resume()
        code = experiment.wait(START_PATIENCE_S)
    finally:
        experiment.kill()
        experiment.wait()

    assert code == 1, said.read_text()
    report = json.loads((out / "report.json").read_text())
    assert not report["closed"]
    (sentence,) = report["lost"]
    assert sentence.startswith("/oaisys_recorder: ")
    assert f"of {LOSING_VIEWS} samples are incomplete; lost: " in sentence
    assert f"missed: {sentence}" in said.read_text()
