"""A session recorded by ``oaisys record`` is rendered again from its bag alone, and is equal."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest
from commands import oaisys
from geometry_msgs.msg import PoseArray
from ros_peer import SAMPLE_TYPES, Stage, stamped
from served_simulator import ROCKY_WORLD
from std_msgs.msg import Header
from waiting import PATIENCE_S

from oaisys_core.geometry import pose_looking_down
from oaisys_msgs.action import Sweep
from oaisys_msgs.srv import SetMetadata, StepBatch

SWEPT = 3
FAULTS = (
    "faults.seed:=3",
    "faults.depth_noise:=kinect",
    "faults.missing_ratio:=0.1",
    "faults.min_depth_m:=0.5",
    "faults.max_depth_m:=7.0",
    "faults.drift_m:=0.02",
)


def sweep(stage: Stage) -> None:
    client = stage.user.action_client(Sweep, "oaisys_bridge/sweep")
    poses = [stamped(pose_looking_down(0.5 * i, 0.0, 6.0)).pose for i in range(SWEPT)]
    goal = Sweep.Goal(poses=PoseArray(header=Header(frame_id="map"), poses=poses))
    accepted = stage.user.answer(client.send_goal_async(goal))
    result = stage.user.answer(accepted.get_result_async()).result
    assert (result.success, result.message) == (True, "")


@pytest.mark.long
@pytest.mark.ros
def test_what_a_bridge_published_is_rendered_again_from_its_bag(
    stage: Stage, tmp_path: Path
) -> None:
    address = stage.start_world(ROCKY_WORLD).address
    options = [o for p in (f"address:={address}", *FAULTS) for o in ("-p", p)]
    stage.start_node("bridge", "--ros-args", *options)
    stage.user.wait_until_ready()
    bag, log = tmp_path / "bag", tmp_path / "record.log"
    with log.open("w") as output:
        recorder = subprocess.Popen(
            ["oaisys", "record", "--out", str(bag)], stdout=output, stderr=output
        )
    try:
        stage.user.wait_until(lambda: f"recording: {bag}" in log.read_text())
        stage.user.wait_until_matched(SAMPLE_TYPES)
        dusk = SetMetadata.Request(module="environment", metadata_json='{"sun_elevation_deg": 8}')
        told = stage.user.call(SetMetadata, "set_metadata", dusk)
        assert told.success, told.message
        sweep(stage)
        told = stage.user.call(StepBatch, "step_batch", StepBatch.Request(seed=11))
        assert told.success, told.message
        answer = stage.user.set_pose(pose_looking_down(0.0, 1.0, 5.0))
        assert answer.success, answer.message
    finally:
        recorder.terminate()
        assert recorder.wait(PATIENCE_S) == 0
    assert f"{SWEPT + 1} samples, none of them incomplete" in log.read_text()

    done = oaisys("repeat", bag, "--all")
    assert done.returncode == 0, done.stdout + done.stderr
    heads = [line for line in done.stdout.splitlines() if line.startswith("batch")]
    assert len(heads) == SWEPT + 1
    assert all(line.endswith(": equal") for line in heads)
