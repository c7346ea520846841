"""What holds for any pose, metadata and configuration that somebody may send, over gRPC."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from served_simulator import FLAT_WORLD, Server
from waiting import PATIENCE_S

from oaisys_core.errors import InvalidInputError
from oaisys_core.types import ModuleMetadata, Pose
from oaisys_grpc.client.simulator_client import SimulatorClient

CAMERA = {"width_px": 16, "height_px": 12, "fx_px": 14.0, "fy_px": 14.0}
MANY = settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
FEW = settings(max_examples=3, deadline=None, suppress_health_check=list(HealthCheck))

on_stage = st.floats(-19, 19)
above = st.floats(0.1, 4e4)
"""Up to a thousand edges of the stage, which is 40 m wide; nothing beyond is admitted."""
parts = st.floats(-1, 1)


@st.composite
def quaternions(draw: st.DrawFn) -> tuple[float, ...]:
    """Unit quaternions, some off by what is still normalised."""
    q = np.array(draw(st.tuples(parts, parts, parts, parts).filter(lambda q: math.hypot(*q) > 0.1)))
    norm = draw(st.sampled_from([1.0, 1.0, 1.0, 0.995, 1.005]))
    return tuple(float(v) for v in norm * q / np.linalg.norm(q))


poses = st.builds(Pose, st.tuples(on_stage, on_stage, above), quaternions())

not_finite = st.sampled_from([math.nan, math.inf, -math.inf])
off_stage = st.floats(20.5, 1e300) | st.floats(-1e300, -20.5)
bad_poses = st.one_of(
    st.builds(Pose, st.tuples(on_stage, on_stage, not_finite), quaternions()),
    st.builds(Pose, st.tuples(not_finite, on_stage, above), quaternions()),
    st.builds(Pose, st.tuples(on_stage, off_stage, above), quaternions()),
    st.builds(Pose, st.tuples(on_stage, on_stage, st.floats(-1e300, -0.1)), quaternions()),
    st.builds(
        lambda pose, factor: Pose(
            pose.position_m,
            tuple(v * factor for v in pose.quat_xyzw),
        ),
        poses,
        st.floats(0, 0.98) | st.floats(1.02, 1e200),
    ),
    st.builds(lambda p, q: Pose(p, (*q[:3], math.nan)), st.just((0.0, 0.0, 5.0)), quaternions()),
)

degrees = st.floats(0, 90)
good_changes = st.fixed_dictionaries(
    {},
    optional={
        "sun_elevation_deg": degrees | st.tuples(degrees, degrees).map(sorted).map(list),
        "sun_strength_w_m2": st.floats(0, 1000),
        "haze": st.none() | st.fixed_dictionaries({"visibility_m": st.floats(1, 1e6)}),
    },
)
json_values: st.SearchStrategy[Any] = st.recursive(
    st.none() | st.booleans() | st.floats() | st.text(max_size=20),
    lambda inner: (
        st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4)
    ),
    max_leaves=12,
)
bad_changes = st.one_of(
    st.dictionaries(st.text("xyz", min_size=1, max_size=9), json_values, min_size=1, max_size=3),
    st.fixed_dictionaries({"sun_elevation_deg": st.floats(91, 1e300) | st.text(max_size=5)}),
    st.fixed_dictionaries({"haze": st.fixed_dictionaries({"visibility_m": st.floats(-1e9, 0.9)})}),
)


@pytest.fixture(scope="module")
def simulator(tmp_path_factory: pytest.TempPathFactory) -> Any:
    world = {**FLAT_WORLD, "sensors": {"cameras": [CAMERA]}}
    folder = tmp_path_factory.mktemp("properties") / "server"
    with Server(folder, world) as server, server.client() as client:
        client.step_batch()
        client.render_sample(Pose((0, 0, 5), (0, math.sqrt(0.5), 0, math.sqrt(0.5))))
        yield client


def _unchanged_by(client: SimulatorClient, metadata: ModuleMetadata) -> InvalidInputError:
    """Send what must be refused; return how it was, once nothing has changed."""
    before, kept = client.render_sample(modalities=["depth"]), client.info()
    with pytest.raises(InvalidInputError) as refused:
        client.render_sample(metadata=metadata)
    info = client.info()
    assert (info.batch_id, info.sample_id) == (kept.batch_id, kept.sample_id)
    after = client.render_sample(modalities=["depth"])
    assert after.rig_pose == before.rig_pose
    assert after.sample_id == before.sample_id + 1
    assert np.array_equal(after.frames[0].data, before.frames[0].data)
    assert refused.value.expected
    return refused.value


@MANY
@given(pose=poses)
def test_a_valid_pose_comes_back_as_it_was_sent(simulator: SimulatorClient, pose: Pose) -> None:
    sample = simulator.render_sample(pose, modalities=["depth"])
    assert_allclose(sample.rig_pose.position_m, pose.position_m, rtol=0, atol=1e-9)
    unit = np.array(pose.quat_xyzw) / np.linalg.norm(pose.quat_xyzw)
    assert_allclose(sample.rig_pose.quat_xyzw, unit, rtol=0, atol=1e-9)
    T = sample.frame("camera", "depth").T_map_camera
    assert_allclose(T[:3, 3], pose.position_m, rtol=0, atol=1e-9)
    assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-9)


@MANY
@given(pose=bad_poses)
def test_a_bad_pose_is_refused_and_changes_nothing(simulator: SimulatorClient, pose: Pose) -> None:
    error = _unchanged_by(simulator, ModuleMetadata(sensor={"pose": pose}))
    assert ".pose." in f".{error.field}."


@MANY
@given(changes=good_changes)
def test_valid_metadata_are_taken(simulator: SimulatorClient, changes: dict[str, Any]) -> None:
    kept = simulator.info()
    metadata = ModuleMetadata(environment=changes)
    sample = simulator.render_sample(metadata=metadata, modalities=["depth"])
    assert sample.sample_id == kept.sample_id + 1


@MANY
@given(changes=bad_changes)
def test_bad_metadata_are_refused_and_change_nothing(
    simulator: SimulatorClient, changes: dict[str, Any]
) -> None:
    error = _unchanged_by(simulator, ModuleMetadata(environment=changes))
    assert error.field.startswith("metadata.environment")


@MANY
@given(part=st.sampled_from(["sensor", "environment", "asset", "render"]), values=json_values)
def test_no_metadata_are_an_error_of_the_server(
    simulator: SimulatorClient, part: str, values: Any
) -> None:
    """Whatever they are, they are taken or refused by field; anything else fails the test."""
    metadata = ModuleMetadata(**{part: values if isinstance(values, dict) else {"it": values}})
    kept = simulator.info().sample_id
    try:
        simulator.render_sample(metadata=metadata, modalities=["depth"])
    except InvalidInputError as error:
        assert error.field.startswith("metadata.")  # noqa: PT017 - it may as well be taken
        assert simulator.info().sample_id == kept


@pytest.mark.long
@FEW
@given(
    seed=st.integers(0, 2**63 - 1),
    extent_m=st.floats(10, 500),
    height_m=st.floats(0.5, 50),
    size_px=st.tuples(st.integers(1, 40), st.integers(1, 40)),
)
def test_a_valid_configuration_is_served(
    tmp_path_factory: pytest.TempPathFactory,
    seed: int,
    extent_m: float,
    height_m: float,
    size_px: tuple[int, int],
) -> None:
    """The plane's depth below a camera that looks down is its height, whatever the rest."""
    camera = {**CAMERA, "width_px": size_px[0], "height_px": size_px[1], "fx_px": 60, "fy_px": 60}
    world = {
        **FLAT_WORLD,
        "seed": seed,
        "stage": {**FLAT_WORLD["stage"], "extent_m": extent_m},
        "sensors": {"cameras": [camera]},
    }
    folder = tmp_path_factory.mktemp("configured") / "server"
    with Server(folder, world) as server, server.client() as client:
        client.wait_ready(PATIENCE_S)
        client.step_batch()
        down = Pose((0, 0, height_m), (0, math.sqrt(0.5), 0, math.sqrt(0.5)))
        depth_m = client.render_sample(down, modalities=["depth"]).frames[0].data
        assert depth_m.shape == size_px[::-1]
        seen = np.isfinite(depth_m)
        assert_allclose(depth_m[seen], height_m, rtol=1e-5)
        assert seen[size_px[1] // 2, size_px[0] // 2]
        assert client.info().seed == seed
