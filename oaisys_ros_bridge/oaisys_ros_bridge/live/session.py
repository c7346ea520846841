"""The session of a live page: renders where the driver looks, and does what the driver asks for."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from oaisys_core.errors import InvalidInputError, OaisysError
from oaisys_core.geometry import invert, pose_from_matrix, pose_to_matrix
from oaisys_core.types import (
    DEPTH,
    INSTANCE,
    RGB,
    SEMANTIC_0,
    FloatArray,
    ModuleMetadata,
    Progress,
    Sample,
)
from oaisys_mapping.report.web_viewer import WebViewer
from oaisys_ros_bridge.experiments.interruption import raise_if_interrupted
from oaisys_ros_bridge.live.bag import LiveBag
from oaisys_ros_bridge.live.camera import first_camera, images_of
from oaisys_ros_bridge.live.desk import Action, BrowserView, Desk
from oaisys_ros_bridge.live.map_builder import MapBuilder
from oaisys_ros_bridge.live.options import LiveOptions
from oaisys_ros_bridge.live.outputs import Outputs
from oaisys_ros_bridge.live.page import LivePage
from oaisys_ros_bridge.live.simulator import LiveSimulator
from oaisys_ros_bridge.live.vehicles import Flight, LiveRover, LiveVehicle, first_view

MOVING_QUALITY = "draft"
STILL_S = 0.4
"""How long the camera stands still before it takes a better picture."""

LOOK_PERIOD_S = 0.2
"""How often the session looks for signals and for the end of a move."""

STEP_TOLERANCE = 1e-4
"""Steps in metres, and entries of rotations, that browsers change by rounding."""

MODALITIES = (RGB, DEPTH, SEMANTIC_0, INSTANCE)


class _OvertakenError(Exception):
    """The driver asks for something else than what is being rendered."""


class LiveSession:
    """Serves one page.

    Args:
        simulator: The simulator; a world is made where it has none.
        viewer: The page with images and map.
        page: The driver's part of it.
        desk: What the page asks for.
        map_builder: Builds the map.
        options: Options.
    """

    def __init__(
        self,
        simulator: LiveSimulator,
        viewer: WebViewer,
        page: LivePage,
        desk: Desk,
        map_builder: MapBuilder,
        options: LiveOptions,
    ) -> None:
        self._simulator, self._client = simulator, simulator.client
        self._viewer, self._page, self._desk, self._map = viewer, page, desk, map_builder
        self._options = options
        self._outputs = Outputs(options.out)
        self._info = self._client.info()
        self._sensor = first_camera(self._info.sensors)
        self._vehicle: LiveVehicle = Flight()
        self._bag: LiveBag | None = None
        self._changes = ModuleMetadata()
        self._sample: Sample | None = None
        self._quality = ""
        self._moved_s = self._render_s = 0.0
        self._stops = 0
        self._T_map_camera = np.eye(4)
        self._actions: dict[Action, Callable[..., None]] = {
            "new_world": self._new_world,
            "choose_vehicle": self._choose_vehicle,
            "take_picture": self._take_picture,
            "keep_pose": self._keep_pose,
            "export_config": self._export_config,
            "start_bag": self._start_bag,
            "stop_bag": self._stop_bag,
        }

    def run(self) -> None:
        """Serve the page until a signal.

        Raises:
            OaisysError: The simulator has ended.
        """
        if self._info.stage_extent_m is None:
            self._client.step_batch(on_progress=self._show_building)
        self._begin_world()
        while True:
            raise_if_interrupted()
            self._desk.wait(LOOK_PERIOD_S)
            try:
                self._do_request()
                self._follow_driver()
                self._take_better_picture()
            except _OvertakenError:
                continue
            except (OaisysError, OSError) as error:
                self._simulator.check()
                self._tell(str(error))

    def close(self) -> None:
        """Close the bag if one is open."""
        if self._bag is not None:
            self._bag.close()

    def _begin_world(self) -> None:
        """Look from the start pose of a new world."""
        self._sample = None
        self._info = self._client.info()
        self._page.show_labels(self._info.semantic_labels)
        self._viewer.clear()
        self._map.reset()
        self._stops = 0
        if self._info.rig_pose is None:
            raise OaisysError("the simulator does not say where its rig is; expected a newer one")
        T_map_camera = pose_to_matrix(self._info.rig_pose) @ self._sensor.T_base_camera
        extent_m = self._info.stage_extent_m
        first = first_view(T_map_camera, self._ground_heights_m, extent_m)
        try:
            self._render(first, MOVING_QUALITY)
        except InvalidInputError:  # something stands there
            self._render(T_map_camera, MOVING_QUALITY)
        self._page.show_pose(self._T_map_camera)

    def _follow_driver(self) -> None:
        """Render where the driver looks now, and in the light that was chosen."""
        view = self._desk.take_view()
        target = self._T_map_camera if view is None else self._moved_by(view)
        if not np.allclose(target, self._T_map_camera, rtol=0, atol=STEP_TOLERANCE):
            self._moved_s = time.monotonic()
            self._render(target, MOVING_QUALITY)
        # By itself: a pose that is refused must not take the change with it.
        change = self._desk.take_change()
        if change is not None:
            self._moved_s = time.monotonic()
            self._render(self._T_map_camera, MOVING_QUALITY, change)

    def _moved_by(self, view: BrowserView) -> FloatArray:
        step_m = self._page.speed_ratio * view.step_m
        return self._vehicle.move(self._T_map_camera, step_m, view.R_map_camera)

    def _take_better_picture(self) -> None:
        """Render in the better quality once the camera stands still; a move interrupts it."""
        if self._sample is None or self._stops_are_taken():
            return
        if time.monotonic() - self._moved_s < STILL_S or self._desk.has_news():
            return
        if self._quality != self._options.still_quality:
            self._render(self._T_map_camera, self._options.still_quality, is_patient=False)
        self._stops = self._sample.sample_id
        images = images_of(self._sample)
        self._viewer.add_to_scene(images)
        self._map.add(images)

    def _stops_are_taken(self) -> bool:
        return self._sample is not None and self._stops == self._sample.sample_id

    def _render(
        self,
        T_map_camera: FloatArray,
        quality: str,
        change: ModuleMetadata | None = None,
        *,
        is_patient: bool = True,
    ) -> None:
        """Render from a pose, show it, and have it be the present one.

        Raises:
            OaisysError: It cannot be rendered; the present pose stays.
            _OvertakenError: The driver asks for something else, and ``is_patient`` is False.
        """

        def look_up(_progress: Progress) -> None:
            if not is_patient and self._desk.has_news():
                raise _OvertakenError

        began_s = time.monotonic()
        metadata = (change or ModuleMetadata()).with_update(
            ModuleMetadata(render={"quality": quality})
        )
        self._sample = sample = self._client.render_sample(
            pose_from_matrix(T_map_camera @ invert(self._sensor.T_base_camera)),
            metadata=metadata,
            modalities=[m for m in MODALITIES if m in self._sensor.modalities],
            sensors=(self._sensor.name,),
            on_progress=look_up,
        )
        self._T_map_camera, self._quality = T_map_camera, quality
        if change is not None:
            self._changes = self._changes.with_update(change)
        self._page.show_picture(images_of(sample))
        self._render_s = time.monotonic() - began_s
        self._say()
        self._record(sample)

    def _record(self, sample: Sample) -> None:
        """Write a sample into the bag that is open; one that cannot be written ends it."""
        if self._bag is None:
            return
        try:
            self._bag.write(sample)
        except OaisysError:
            self._end_bag().close()
            raise

    def _say(self) -> None:
        x_m, y_m, z_m = self._T_map_camera[:3, 3]
        sample = self._present_sample()
        world = f"world {sample.batch_id}, seed {sample.provenance.batch_seed}"
        seen = f"{self._quality} in {self._render_s:.2f} s from ({x_m:.1f}, {y_m:.1f}, {z_m:.1f}) m"
        self._page.say(f"{world}: {seen}{'' if self._bag is None else ', recording'}")

    def _tell(self, fault: str) -> None:
        """Say what went wrong, and drop where the driver has gone meanwhile."""
        self._desk.forget_view()
        self._page.say(f"refused: {fault}")
        self._page.note("Refused", fault, is_error=True)

    def _do_request(self) -> None:
        """Do one: many clicks must not hold up moves and changes of the light."""
        if (request := self._desk.take_request()) is not None:
            self._actions[request.action](**request.values)

    def _new_world(self, seed: int, preset: str) -> None:
        custom: dict[str, Any] = {"stage": {"preset": preset}} if preset else {}
        self._client.step_batch(
            seed=seed, metadata=ModuleMetadata(custom=custom), on_progress=self._show_building
        )
        self._changes = ModuleMetadata(custom=custom)
        self._begin_world()
        self._page.note("New world", f"seed {seed}")

    def _show_building(self, progress: Progress) -> None:
        raise_if_interrupted()
        self._page.say(f"building a world: {progress.stage}, {100 * progress.fraction:.0f} %")

    def _choose_vehicle(self, *, is_rover: bool, camera_height_m: float) -> None:
        if not is_rover:
            self._vehicle = Flight()
            return
        rover = LiveRover(self._ground_heights_m, camera_height_m)
        there = rover.move(self._T_map_camera, np.zeros(3), self._T_map_camera[:3, :3])
        self._vehicle = rover
        self._render(there, MOVING_QUALITY)
        self._moved_s = time.monotonic()

    def _ground_heights_m(self, points_m: FloatArray) -> FloatArray:
        return self._client.query_height(points_m).ground_height_m

    def _take_picture(self) -> None:
        sample = self._present_sample()
        path = self._outputs.write_picture(sample, sample.frame(self._sensor.name, RGB))
        self._page.note("Picture", str(path))

    def _keep_pose(self) -> None:
        path, count = self._outputs.keep_pose(self._present_sample().rig_pose)
        self._page.note("Pose kept", f"{path}: {count} pose{'' if count == 1 else 's'}")

    def _export_config(self) -> None:
        seed = self._present_sample().provenance.batch_seed
        path = self._outputs.write_config(self._client.config_json(), self._changes, seed)
        self._page.note("Configuration", str(path))

    def _start_bag(self) -> None:
        if self._bag is not None:
            raise OaisysError(f"a bag is being recorded already: {self._bag.folder}")
        self._bag = LiveBag(self._outputs.new_path("bag_", ""), self._client.info())
        self._page.show_recording(is_on=True)
        self._page.note("Recording", str(self._bag.folder))
        self._record(self._present_sample())
        self._say()

    def _stop_bag(self) -> None:
        if self._bag is not None:
            self._page.note("Bag", self._end_bag().finish())

    def _end_bag(self) -> LiveBag:
        bag, self._bag = self._bag, None
        assert bag is not None
        self._page.show_recording(is_on=False)
        self._say()
        return bag

    def _present_sample(self) -> Sample:
        if self._sample is None:
            raise OaisysError("nothing has been rendered yet")
        return self._sample
