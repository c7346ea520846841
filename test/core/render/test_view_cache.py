"""Views that come again: answered with the same bytes, and nothing else is as much as touched."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from oaisys_core.config import config_from_mapping
from oaisys_core.errors import CancelledError
from oaisys_core.geometry import pose_looking_down
from oaisys_core.render.analytic import AnalyticBackend
from oaisys_core.render.base import Backend, FrameGroup
from oaisys_core.render.view_cache import Fingerprints, RenderedView, ViewCache
from oaisys_core.simulation import Simulation
from oaisys_core.types import (
    Frame,
    FrameName,
    ModuleMetadata,
    PinholeIntrinsics,
    Pose,
    Sample,
    SampleOutline,
)

ROOM = 1 << 24
SIZE = {"width_px": 16, "height_px": 12, "fx_px": 12.0, "fy_px": 12.0}
WORLD: dict[str, Any] = {
    "backend": "analytic",
    "stage": {"preset": "mounds", "extent_m": 24.0, "resolution_px": 33, "surroundings": "plain"},
    "materials": {"texture_size_px": 32, "mask": {"size_px": 32, "relief": 0}},
    "assets": {"rocks": [{"count": [4, 8], "variants": 1}]},
    "sensors": {
        "cameras": [
            {**SIZE, "name": "left"},
            {**SIZE, "name": "right", "mount_position_m": [0.0, -0.3, 0.0]},
        ]
    },
}
ROVER = {
    "name": "rover",
    "shape": "rover",
    "label": "rover",
    "semantic_id": 24,
    "trajectory": {
        "waypoints_m": [[0.0, -3.0], [3.0, 0.0], [-3.0, 3.0]],
        "closed": True,
        "step_m": 0.5,
    },
}
HEADLIGHT = {"kind": "spot", "frame": "base_link", "position_m": [0.2, 0.3, 0.0]}
POSES = [pose_looking_down(x, 0.5, 8.0) for x in (-1.0, 0.0, 2.0)]


def simulation(size: int = ROOM, backend: Backend | None = None, **sections: Any) -> Simulation:
    made = Simulation(config_from_mapping({**WORLD, **sections}), backend, pose_cache_bytes=size)
    made.step_batch(seed=3)
    return made


def seen(sim: Simulation, pose: Pose = POSES[0], **parts: Any) -> Sample:
    asked = {key: parts.pop(key) for key in ("modalities", "sensors") if key in parts}
    sensor = {"pose": pose, **parts.pop("sensor", {})}
    return sim.step_sample(ModuleMetadata(sensor=sensor, **parts), **asked)


def images(sample: Sample) -> dict[FrameName, bytes]:
    return {FrameName(f.sensor, f.modality): f.data.tobytes() for f in sample.frames}


@pytest.mark.parametrize("surroundings", ["land", "plain"])
def test_a_view_that_comes_again_is_not_rendered_again(surroundings: str) -> None:
    class Counting(AnalyticBackend):
        renders = 0

        def render(self, *arguments: Any) -> Iterator[FrameGroup]:
            self.renders += 1
            return super().render(*arguments)

    backend = Counting()
    sim = simulation(backend=backend, stage={**WORLD["stage"], "surroundings": surroundings})
    first, other, again = (seen(sim, POSES[i]) for i in (0, 1, 0))
    assert backend.renders == 2
    assert [s.from_cache for s in (first, other, again)] == [False, False, True]
    assert [s.sample_id for s in (first, other, again)] == [1, 2, 3]
    assert images(again) == images(first) != images(other)
    assert again.provenance == first.provenance
    assert again.rig_pose == POSES[0]


def test_a_world_whose_views_cannot_be_found_again_says_so_once(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def is_drawn_by_an_extension(fingerprints: Fingerprints, value: Any) -> bytes:
        raise TypeError("a Cave has no digest")

    monkeypatch.setattr(Fingerprints, "of", is_drawn_by_an_extension)
    sim = simulation()
    assert not any(seen(sim).from_cache for _ in range(3))
    told = [r for r in caplog.records if "rendered again each time" in r.message]
    assert [r.levelname for r in told] == ["WARNING"]
    assert "a Cave has no digest" in told[0].message


def test_a_batch_of_the_same_seed_shows_the_same() -> None:
    sim = simulation()
    first = seen(sim)
    sim.step_batch(seed=4)
    assert not seen(sim).from_cache
    sim.step_batch(seed=3)
    again = seen(sim)
    assert again.from_cache
    assert (again.batch_id, again.sample_id) == (3, 1)
    assert images(again) == images(first)


@pytest.mark.parametrize(
    "change",
    [
        {"pose": replace(POSES[0], position_m=(-1.0, 0.5, 8.0 + 1e-12))},
        {"environment": {"sun_elevation_deg": 31.0}},
        {"environment": {"sky_strength": 0.5}},
        {"environment": {"lamps": {"mast": {"position_m": [1.0, 1.0, 4.0]}}}},
        {"render": {"exposure_ev": 0.5}},
        {"render": {"quality": "preview"}},
        {"render": {"samples": 7}},
        {"render": {"effects": {"vignetting": 0.5}}},
        {"render": {"view_transform": "raw"}},
        {"sensor": {"cameras": {"left": {"lens": {"f_number": 4.0}}}}},
        {"sensor": {"cameras": {"left": {"fx_px": 13.0}}}},
        {"modalities": ["depth"]},
        {"sensors": ["right"]},
    ],
)
def test_whatever_changes_the_view_has_it_rendered(change: dict[str, Any]) -> None:
    sim = simulation()
    seen(sim)
    pose = change.pop("pose", POSES[0])
    assert not seen(sim, pose, **change).from_cache
    assert seen(sim, pose, **change).from_cache


@pytest.mark.parametrize(
    "sections",
    [
        {"render": {"effects": {"sensor_noise": {"full_well_e": 2000.0}}}},
        {"render": {"time_budget_s": 5.0}},
        {"assets": {**WORLD["assets"], "movers": [ROVER]}},
        {"environment": {"redraw": "sample", "sun_elevation_deg": [20.0, 60.0]}},
        {"sensors": {"cameras": [{**SIZE, "modalities": ["rgb", "depth", "flow"]}]}},
    ],
)
def test_what_differs_from_sample_to_sample_is_rendered(sections: dict[str, Any]) -> None:
    sim = simulation(**sections)
    assert not any(seen(sim).from_cache for _ in range(3))


def test_labels_come_from_the_cache_where_only_colour_is_noisy() -> None:
    sim = simulation(render={"effects": {"sensor_noise": {"full_well_e": 2000.0}}})
    assert not seen(sim, modalities=["depth", "instance"]).from_cache
    assert seen(sim, modalities=["depth", "instance"]).from_cache


STEPS = st.lists(
    st.fixed_dictionaries(
        {"pose": st.sampled_from(POSES[:2])},
        optional={
            "environment": st.sampled_from(
                [
                    {"sun_elevation_deg": 20.0},
                    {"sky_strength": 0.5},
                    {"lamps": {"left": HEADLIGHT}},
                ]
            ),
            "render": st.sampled_from([{"exposure_ev": 1.0}, {"exposure_ev": 0.0}]),
            "modalities": st.sampled_from([["depth"], ["rgb", "flow"], ["rgb", "depth"]]),
            "sensors": st.sampled_from([["left"], ["right"]]),
        },
    ).filter(lambda step: step.get("sensors") != ["right"] or "flow" not in str(step)),
    min_size=3,
    max_size=8,
)
CAMERAS = {
    "cameras": [
        {**SIZE, "name": "left", "modalities": ["rgb", "depth", "instance", "flow"]},
        {**SIZE, "name": "right", "modalities": ["rgb", "depth", "normal"], "step_interval": 2},
    ]
}
STILL = {"sensors": CAMERAS}
MOVING = {"sensors": CAMERAS, "assets": {**WORLD["assets"], "movers": [ROVER]}}


@pytest.fixture(scope="module", params=[STILL, MOVING], ids=["still", "moving"])
def twins(request: pytest.FixtureRequest) -> tuple[Simulation, Simulation]:
    """The same simulation with a cache and without."""
    return simulation(ROOM, **request.param), simulation(0, **request.param)


@settings(
    max_examples=12, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(steps=STEPS)
def test_nobody_can_tell_that_there_is_a_cache(
    twins: tuple[Simulation, Simulation], steps: list[dict[str, Any]]
) -> None:
    cached, plain = twins
    for sim in twins:
        sim.step_batch(seed=3)
    for step in steps:
        mine, theirs = seen(cached, **step), seen(plain, **step)
        assert not theirs.from_cache
        assert images(mine) == images(theirs)
        assert replace(mine, frames=(), render_time_s=0, from_cache=False) == replace(
            theirs, frames=(), render_time_s=0
        )
    assert cached.state() == plain.state()


def test_memory_is_bounded_and_what_was_not_asked_for_longest_goes() -> None:
    camera = PinholeIntrinsics(10, 10, 9.0, 9.0, 4.5, 4.5)
    frame = Frame("camera", "depth", np.zeros((10, 10), np.float32), camera, np.eye(4))
    cache = ViewCache(1000)
    for name in (b"a", b"b"):
        cache.add(name, RenderedView((frame,), 4))
    assert cache.get(b"a") is not None
    cache.add(b"c", RenderedView((frame,), 4))
    assert [cache.get(name) is not None for name in (b"a", b"b", b"c")] == [True, False, True]
    assert cache.size_bytes == 800
    cache.add(b"c", RenderedView((frame,), 4))
    assert cache.size_bytes == 800
    cache.add(b"large", RenderedView((frame,) * 3, 4))
    assert cache.get(b"large") is None
    assert cache.size_bytes == 800


def test_without_room_nothing_is_kept() -> None:
    sim = simulation(0)
    assert not any(seen(sim).from_cache for _ in range(3))


def test_nobody_can_change_what_is_kept() -> None:
    sim = simulation()
    first = seen(sim)
    expected = images(first)
    for frame in first.frames:
        frame.data[:] = 0
    again = seen(sim)
    assert images(again) == expected
    with pytest.raises(ValueError, match="read-only"):
        again.frames[0].data[:] = 1


def test_a_view_that_is_given_up_is_not_kept_and_takes_no_id() -> None:
    sim = simulation()
    metadata = ModuleMetadata(sensor={"pose": POSES[0]})
    steps = sim.stream_sample(metadata)
    next(steps)
    steps.close()
    assert not seen(sim).from_cache
    steps = sim.stream_sample(metadata)
    next(steps)
    with pytest.raises(CancelledError):
        steps.throw(CancelledError("enough"))
    assert (seen(sim).sample_id, sim.info().sample_id) == (2, 2)


def test_depth_and_labels_of_all_cameras_come_before_any_colour() -> None:
    told: list[tuple[SampleOutline, tuple[Frame, ...]]] = []
    steps = simulation().stream_sample()
    while True:
        try:
            outline, group = next(steps)
        except StopIteration as end:
            sample = end.value
            break
        told.append((outline, group.result()))
    outlines = {id(outline): outline for outline, _ in told}
    (outline,) = outlines.values()
    assert (outline.sample_id, outline.rig_pose) == (sample.sample_id, sample.rig_pose)
    assert outline.frames == tuple(FrameName(f.sensor, f.modality) for f in sample.frames)
    assert [[f.modality == "rgb" for f in frames] for _, frames in told] == [
        [False] * 6,
        [True],
        [True],
    ]
    by_name = {FrameName(f.sensor, f.modality): f for _, frames in told for f in frames}
    assert all(by_name[FrameName(f.sensor, f.modality)] is f for f in sample.frames)


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ((1, 2), (12,)),
        (("a", "b"), ("ab",)),
        (1, 1.0),
        (True, 1),
        (None, "None"),
        (0.0, -0.0),
        (np.zeros(4, np.float32), np.zeros(2, np.float64)),
        (np.zeros((2, 3)), np.zeros((3, 2))),
        ({"a": 1, "b": 2}, {"a": 2, "b": 1}),
        (((1,), 2), (1, (2,))),
        (POSES[0], POSES[1]),
    ],
)
def test_different_things_have_different_digests(one: Any, other: Any) -> None:
    fingerprints = Fingerprints()
    assert fingerprints.of(one) != fingerprints.of(other)
    assert fingerprints.of(one) == Fingerprints().of(one)


def test_what_cannot_be_told_apart_is_refused() -> None:
    with pytest.raises(TypeError, match="object"):
        Fingerprints().of((1, object()))
