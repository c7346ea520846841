"""The simulator: two verbs, `Simulation.step_batch` and `Simulation.step_sample`."""

from __future__ import annotations

import ctypes
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from oaisys_core import randomness
from oaisys_core.config import SimulationConfig, config_sha256
from oaisys_core.errors import InvalidInputError, NotReadyError
from oaisys_core.output.records import recorded_motion
from oaisys_core.procedural.environment.low_sun import LowSunWarning
from oaisys_core.render import make_backend
from oaisys_core.render.base import Backend
from oaisys_core.render.view_renderer import (
    FramesPlacement,
    SampleSteps,
    ViewRenderer,
    leave_frames,
)
from oaisys_core.scene import Scene
from oaisys_core.scene.rig_motion import RigMotion
from oaisys_core.sensing.render_settings import RenderSettings
from oaisys_core.types import (
    FloatArray,
    FrameName,
    HeightGrid,
    HeightQuery,
    ModuleMetadata,
    ObjectPage,
    ObjectQuery,
    ProgressCallback,
    Provenance,
    Sample,
    SampleOutline,
    SimulatorInfo,
    TriangleMesh,
    ignore_progress,
)
from oaisys_core.world.batch import (
    Batch,
    BatchSeeds,
    Snapshot,
    metadata_text,
    previous_poses_text,
    state_of,
)
from oaisys_core.world.height_grids import Extent, height_grid
from oaisys_core.world.module import World, drawn
from oaisys_core.world.module_set import DRAW_SHARE, ModuleSet
from oaisys_core.world.modules.sensors import DueSensors
from oaisys_core.world.reuse import batch_seeds, section_sha256, stage_record


class Simulation:
    """Draws worlds from a configuration's seed and renders them sample by sample."""

    def __init__(
        self,
        config: SimulationConfig,
        backend: Backend | None = None,
        *,
        pose_cache_bytes: int = 0,
        place_frames: FramesPlacement = leave_frames,
    ) -> None:
        """Set all modules up; nothing is rendered yet.

        Args:
            config: What worlds are drawn from.
            backend: A backend to use instead of a new one as configured.
            pose_cache_bytes: Largest size of images that are kept for repeated views; 0 for none.
            place_frames: Moves frames that become ready together, for instance into shared memory;
                samples and the cache hold the moved ones. It is called by the thread that asks a
                group for its result.

        Raises:
            ConfigError: The configuration names something that does not exist.
            BackendUnavailableError: The backend cannot run here.
        """
        self._config = config
        self._config_sha256 = config_sha256(config)
        self._assets_sha256 = section_sha256(config.assets)
        self._modules = ModuleSet.of(config)
        self._stage, self._sensors = self._modules.stage, self._modules.sensors
        self._backend = backend if backend is not None else make_backend(config.backend)
        self._views = ViewRenderer(self._backend, pose_cache_bytes, place_frames)
        self._low_sun = LowSunWarning()
        self._undo: Callable[[], None] | None = None
        self._batch: Batch | None = None
        self._last_batch_id = 0
        self._modules.setup()

    def step_batch(
        self,
        metadata: ModuleMetadata | None = None,
        *,
        seed: int | None = None,
        reuse_stage: bool = False,
        progress: ProgressCallback = ignore_progress,
    ) -> int:
        """Build a new world and return its batch id.

        Args:
            metadata: Parts for the modules; an absent part leaves a module its configuration.
            seed: Seed of this world; None derives it from the root seed and the batch id.
            reuse_stage: Keep the ground and its material, draw all else anew. Stages of earlier
                batches and runs are reused with ``custom={"stage": {"reuse": ...}}``.
            progress: Called with the progress; may raise `CancelledError`.

        Raises:
            InvalidInputError: The metadata cannot be applied; the old world stays.
            CancelledError: It was cancelled; the old world stays if the new one was still being
                drawn, else there is none.
            NotReadyError: ``reuse_stage`` before any batch.
            RenderError: The backend failed; there is no world until the next batch.
        """
        metadata = metadata or ModuleMetadata()
        batch_id = self._last_batch_id + 1
        if seed is None:
            seed = randomness.batch_seed(self._config.seed, batch_id)
        if not 0 <= seed < 2**63:
            raise InvalidInputError("seed", seed, "a whole number from 0 to 2**63 - 1")
        before = self._current() if reuse_stage else self._batch
        self._modules.check(metadata, is_batch=True)
        metadata_text(metadata)
        seeds, drawn_with = batch_seeds(
            self._stage, self._assets_sha256, metadata, seed, before, reuse_stage
        )
        batch = self._build(batch_id, seeds, drawn_with, progress)
        record = stage_record(batch, self._assets_sha256)
        self._stage.keep(record, metadata.part(self._stage.name))
        return batch_id

    def step_sample(
        self,
        metadata: ModuleMetadata | None = None,
        *,
        modalities: Sequence[str] = (),
        sensors: Sequence[str] = (),
        motion: RigMotion | None = None,
        progress: ProgressCallback = ignore_progress,
    ) -> Sample:
        """Move sensors and light as the metadata says, render, and return the frames.

        Args:
            metadata: What changes from here on; ``sensor["pose"]`` moves the rig, for this sample
                alone where it moves by itself.
            modalities: Modalities to render; none: all of each sensor that is due.
            sensors: Sensors to render; none: all that are due. Named sensors and sensors with a
                named modality render whether they are due or not.
            motion: Motion of the rig about the sample's pose, from which lidars cast each ray at
                its own time, whatever their ``sweep_share``, and cameras with ``readout_s`` or
                ``exposure_s`` see each row. Provenance holds it.
            progress: Called with the progress; may raise `CancelledError`.

        Raises:
            NotReadyError: Before the first batch.
            InvalidInputError: Metadata, pose, modality or sensor are refused, or the rig's motion
                finds no pose; nothing changed.
            CancelledError, RenderError: It was stopped; nothing changed.
        """
        return _returned(
            self.stream_sample(
                metadata,
                modalities=modalities,
                sensors=sensors,
                motion=motion,
                progress=progress,
            )
        )

    def stream_sample(
        self,
        metadata: ModuleMetadata | None = None,
        *,
        modalities: Sequence[str] = (),
        sensors: Sequence[str] = (),
        motion: RigMotion | None = None,
        progress: ProgressCallback = ignore_progress,
    ) -> SampleSteps:
        """Do as `step_sample`, and yield the frames in groups as they are rendered.

        Depth and labels come before any colour. Each group comes with the outline of the sample;
        the generator's return value is the complete sample. The sample counts, and its id is
        taken, when the generator ends. Closing it earlier leaves everything as before.

        Raises:
            OaisysError: See `step_sample`.
        """
        started_s = time.perf_counter()
        batch = self._current()
        metadata = metadata or ModuleMetadata()
        self._modules.check(metadata, is_batch=False)
        self._sensors.check_selection(batch.world, modalities, sensors)
        metadata = self._with_admitted_pose(batch, metadata)
        with self._undone_on_failure(batch):
            self._apply(batch, metadata)
            due = self._sensors.due(batch.world, batch.last_rig_poses, modalities, sensors)
            settings = drawn(batch.world.render)
            return (yield from self._sample(batch, due, settings, motion, progress, started_s))

    def _sample(
        self,
        batch: Batch,
        due: DueSensors,
        settings: RenderSettings,
        motion: RigMotion | None,
        progress: ProgressCallback,
        started_s: float,
    ) -> SampleSteps:
        """Render the world as it is, and count it as the next sample."""
        if motion is not None:
            due = self._sensors.following(due, motion)
            motion = motion if due.is_moving else None
        outline = self._outline(batch, due, settings, motion)
        faults = self._sensors.depth_faults
        sample = yield from self._views.sample(
            outline, batch.world.scene(), *due, settings, progress, faults, started_s
        )
        batch.sample_id += 1
        moved = {sensor.name: outline.rig_pose for sensor in due.all}
        batch.last_rig_poses = {**batch.last_rig_poses, **moved}
        return sample

    def repeat(
        self, outline: SampleOutline, progress: ProgressCallback = ignore_progress
    ) -> Sample:
        """Render a recorded sample again from its outline alone.

        Afterwards the simulation is as it was after that sample.

        Raises:
            InvalidInputError: The record is of another configuration or incomplete, or its metadata
                does not fit.
        """
        how = outline.provenance
        if how.config_sha256 != self._config_sha256:
            expected = f"{self._config_sha256}, which this configuration has"
            raise InvalidInputError("provenance.config_sha256", how.config_sha256, expected)
        state = state_of(outline)
        self.restore(state, progress)
        batch = self._current()
        due = self._sensors.named(batch.world, batch.last_rig_poses, outline.frames)
        settings = drawn(batch.world.render)
        if settings.time_budget_s is not None and how.render_samples:
            # How many samples there was time for is known now.
            counted = how.render_samples
            settings = replace(settings, time_budget_s=None, samples=counted, max_samples=counted)
        batch.sample_id = outline.sample_id - 1
        motion, started_s = recorded_motion(how), time.perf_counter()
        return _returned(self._sample(batch, due, settings, motion, progress, started_s))

    def withdraw_sample(self) -> None:
        """Undo the last sample, because nobody received it; the next one takes its id.

        Raises:
            NotReadyError: None was rendered since the last batch or withdrawal.
        """
        if self._undo is None:
            raise NotReadyError("there is no sample to withdraw")
        undo, self._undo = self._undo, None
        undo()
        self._backend.withdrawn()

    def info(self) -> SimulatorInfo:
        """Return what this simulator is and its current batch and sample."""
        batch = self._batch
        ground = batch.world.ground if batch else None
        render = batch.world.render if batch else None
        return SimulatorInfo(
            backend=self._backend.name,
            backend_version=self._backend.version,
            seed=self._config.seed,
            config_sha256=self._config_sha256,
            quality=render.quality if render else self._config.render.quality,
            sensors=self._sensors.sensors,
            lidars=self._sensors.lidars,
            imus=self._sensors.imus,
            semantic_labels=dict(batch.world.semantic_labels) if batch else {},
            batch_id=batch.id if batch else 0,
            sample_id=batch.sample_id if batch else 0,
            stage_extent_m=ground.extent_m if ground else None,
            device=self._backend.device,
            group_counts=batch.world.group_counts if batch else (),
        )

    @property
    def batch_seed(self) -> int:
        """Seed of the current world."""
        return self._current().seeds.seed

    @property
    def scene(self) -> Scene:
        """The current world, as the backend was given it."""
        return self._current().world.scene()

    def ground_truth_mesh(self) -> TriangleMesh:
        """Return the surface of the world as rendered, in ``map``."""
        self._current()
        return self._backend.ground_truth_mesh()

    def query_height(self, points_m: ArrayLike, *, on_stage: bool = False) -> HeightQuery:
        """Return the heights under (N, 3) points in ``map``; NaN where there is no ground.

        Args:
            points_m: The points.
            on_stage: Return NaN off the stage even where land surrounds it.

        Raises:
            InvalidInputError: The points have another shape or are not finite.
        """
        points = np.asarray(points_m, dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
            raise InvalidInputError("points_m", points.shape, "(N, 3) finite coordinates")
        world = self._current().world
        ground_m = world.surface.height_at(points[:, :2])
        far_ground = None if on_stage else world.scene().far_ground
        if far_ground is not None:
            ground_m = np.where(np.isnan(ground_m), far_ground.height_at(points[:, :2]), ground_m)
        surface_m: FloatArray = np.full(len(points), np.nan)
        inside = np.isfinite(ground_m)
        if inside.any():
            surface_m[inside] = self._backend.surface_height_m(points[inside, :2])
        return HeightQuery(ground_m, surface_m, points[:, 2] - surface_m)

    def list_objects(
        self, query: ObjectQuery, metadata: ModuleMetadata | None = None
    ) -> ObjectPage:
        """Return objects of the world that are shown; nothing changes.

        Args:
            query: Which of them.
            metadata: Return them as they will be after a sample with this metadata.

        Raises:
            InvalidInputError: The query cannot be answered, or the metadata applied.
            NotReadyError: There is no world yet.
        """
        batch = self._current()
        metadata = metadata or ModuleMetadata()
        self._modules.check(metadata, is_batch=False)
        return self._modules.assets.listed(batch.world, metadata.asset, query)

    def height_grid(
        self,
        resolution_m: float,
        extent_m: Extent | None = None,
        progress: ProgressCallback = ignore_progress,
    ) -> HeightGrid:
        """Return the heights of ground and topmost surface on a grid; NaN off the stage.

        Args:
            resolution_m: Edge of a cell.
            extent_m: (min_x, min_y, max_x, max_y) in ``map``; None: the whole stage.
            progress: Called with the progress; may raise `CancelledError`.

        Raises:
            InvalidInputError: It would have no cells, or too many.
            NotReadyError: Before the first batch.
        """
        extent_m = extent_m or drawn(self._current().world.ground).extent_m
        return height_grid(resolution_m, extent_m, self._stage_height, progress)

    def state(self) -> dict[str, Any]:
        """Return all that another process needs to continue from here, as JSON-able data."""
        pose = self._sensors.rig_pose
        batch, state = self._batch, None
        if batch is not None and pose is not None:
            state = batch.to_state(pose)
        return {"last_batch_id": self._last_batch_id, "batch": state}

    def restore(
        self, state: Mapping[str, Any], progress: ProgressCallback = ignore_progress
    ) -> None:
        """Build the world of a `state` again and continue as that simulation would have."""
        self._batch = None
        batch_state = state["batch"]
        if batch_state is not None:
            wanted = Batch.from_state(batch_state)
            batch = self._build(wanted.id, wanted.seeds, wanted.metadata, progress)
            if wanted.sample_id:
                # What moves or changes by itself is where the last sample left it.
                batch.sample_id = wanted.sample_id - 1
                self._apply(batch, ModuleMetadata(sensor=wanted.metadata.sensor))
            batch.sample_id, batch.last_rig_poses = wanted.sample_id, wanted.last_rig_poses
        self._last_batch_id = int(state["last_batch_id"])

    def save(self, path: Path) -> None:
        """Write the current world as a file of the backend's own kind (``.blend``).

        Raises:
            NotReadyError: Before the first batch.
            InvalidInputError: The backend has no such files.
        """
        self._current()
        self._backend.save(path)

    def close(self) -> None:
        """Release the backend; the simulation cannot be used afterwards."""
        self._batch = None
        self._backend.close()

    def _current(self) -> Batch:
        if self._batch is None:
            raise NotReadyError("there is no world yet: step a batch first (StepBatch)")
        return self._batch

    def _build(
        self,
        batch_id: int,
        seeds: BatchSeeds,
        metadata: ModuleMetadata,
        progress: ProgressCallback,
    ) -> Batch:
        """Draw a world and let the backend build it; if building fails there is no world."""
        _return_freed_memory()
        batch = self._modules.draw(batch_id, seeds, metadata, self._batch, progress)
        self._batch, self._undo = None, None
        self._views.forget_world()
        self._backend.build(
            batch.world.scene(),
            lambda p: progress(replace(p, fraction=DRAW_SHARE + (1 - DRAW_SHARE) * p.fraction)),
        )
        self._batch, self._last_batch_id = batch, batch_id
        self._low_sun.check(drawn(batch.world.sky), batch.world.scene().far_ground)
        _return_freed_memory()
        return batch

    @contextmanager
    def _undone_on_failure(self, batch: Batch) -> Iterator[None]:
        """Undo the sample if the block raises."""
        self._undo = None
        world = batch.world
        undo = partial(self._roll_back, world, Snapshot(batch, world, *self._modules.all))
        world.semantic_labels = dict(world.semantic_labels)  # modules change it in place
        try:
            yield
        except BaseException:
            undo()
            raise
        self._undo = undo

    def _roll_back(self, world: World, before: Snapshot) -> None:
        changed = world.scene()
        before.restore()
        if changed.differs_from(world.scene()):
            self._backend.update(world.scene())

    def _stage_height(self, points_m: FloatArray) -> HeightQuery:
        return self.query_height(points_m, on_stage=True)

    def _with_admitted_pose(self, batch: Batch, metadata: ModuleMetadata) -> ModuleMetadata:
        """Return the metadata with the admitted pose and without the pose policy."""
        sensor = dict(metadata.sensor or {})
        policy = sensor.pop("pose_policy", None)
        if "pose" not in sensor and self._sensors.moves_itself:
            return metadata if policy is None else replace(metadata, sensor=sensor)
        pose = sensor.get("pose") or drawn(self._sensors.rig_pose)
        sensor["pose"] = self._sensors.admitted(pose, batch.world, self._stage_height, policy)
        return replace(metadata, sensor=sensor)

    def _apply(self, batch: Batch, metadata: ModuleMetadata) -> None:
        before = batch.world.scene()
        self._modules.step_sample(batch, metadata)
        after = batch.world.scene()
        self._low_sun.check(after.sky, after.far_ground)
        if after.differs_from(before):
            self._backend.update(after)
        if "pose" not in (metadata.sensor or {}) and self._sensors.moves_itself:
            self._sensors.move(batch.world, batch.seeds.seed, self._stage_height)
        batch.world.refine()
        at_pose = batch.world.scene()
        if at_pose.differs_from(after):
            self._backend.update(at_pose)

    def _outline(
        self, batch: Batch, due: DueSensors, settings: RenderSettings, motion: RigMotion | None
    ) -> SampleOutline:
        """Return the outline of the next sample."""
        return SampleOutline(
            batch_id=batch.id,
            sample_id=batch.sample_id + 1,
            rig_pose=drawn(self._sensors.rig_pose),
            frames=tuple(FrameName(s.name, m) for s in due.all for m in s.modalities),
            odometry=self._sensors.odometry(batch.id, batch.sample_id + 1),
            provenance=Provenance(
                seed=self._config.seed,
                batch_seed=batch.seeds.seed,
                config_sha256=self._config_sha256,
                backend=self._backend.name,
                backend_version=self._backend.version,
                quality=settings.quality,
                render_samples=0,
                device=self._backend.device,
                stage_seed=batch.seeds.stage_seed,
                asset_seed=batch.seeds.asset_seed,
                metadata_json=metadata_text(batch.in_force),
                previous_poses_json=previous_poses_text(due.all, batch.last_rig_poses),
                motion_json="" if motion is None else motion.text(),
            ),
        )


def _return_freed_memory() -> None:
    """Return memory to the system that the old world or its making has freed.

    glibc keeps it otherwise, some 0.4 GB after the demo's second batch. With another C library
    nothing is done.
    """
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)


def _returned(steps: SampleSteps) -> Sample:
    """Run a generator to its end and return its return value."""
    while True:
        try:
            next(steps)
        except StopIteration as end:
            sample: Sample = end.value
            return sample
