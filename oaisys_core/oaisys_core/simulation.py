"""The simulator: two verbs, `Simulation.step_batch` and `Simulation.step_sample`."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

from oaisys_core import randomness
from oaisys_core.errors import InvalidInputError, NotReadyError
from oaisys_core.output.records import motion_to_record
from oaisys_core.render.built_world import BuiltWorld
from oaisys_core.render.view_renderer import SampleSteps
from oaisys_core.scene.rig_motion import RigMotion
from oaisys_core.sensing.render_settings import RenderSettings
from oaisys_core.types import (
    FrameName,
    ModuleMetadata,
    ProgressCallback,
    Provenance,
    Sample,
    SampleOutline,
    ignore_progress,
)
from oaisys_core.world.batch import Batch, metadata_text, previous_poses_text, state_of
from oaisys_core.world.module import require
from oaisys_core.world.modules.sensors import DueSensors
from oaisys_core.world.reuse import batch_seeds, stage_record


class Simulation(BuiltWorld):
    """Draws worlds from a configuration's seed and renders them sample by sample."""

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
            self._stage,
            self._modules.assets,
            self._assets_sha256,
            metadata,
            seed,
            before,
            reuse_stage,
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
        return complete(
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
            settings = require(batch.world.render)
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
        faults = self._sensors.depth_faults, self._sensors.fault_batch(batch.id)
        sample = yield from self._views.sample(
            outline, batch.world.scene(), *due, settings, progress, *faults, started_s
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
        due = self._sensors.sensors_of_frames(batch.world, batch.last_rig_poses, outline.frames)
        settings = require(batch.world.render)
        if settings.time_budget_s is not None and how.render_samples:
            # How many samples there was time for is known now.
            counted = how.render_samples
            settings = replace(settings, time_budget_s=None).with_samples(counted)
        batch.sample_id = outline.sample_id - 1
        motion, started_s = motion_to_record(how), time.perf_counter()
        return complete(self._sample(batch, due, settings, motion, progress, started_s))

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

    def _outline(
        self, batch: Batch, due: DueSensors, settings: RenderSettings, motion: RigMotion | None
    ) -> SampleOutline:
        """Return the outline of the next sample."""
        return SampleOutline(
            batch_id=batch.id,
            sample_id=batch.sample_id + 1,
            rig_pose=require(self._sensors.rig_pose),
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
                metadata_json=metadata_text(batch.in_force, batch.drawn),
                previous_poses_json=previous_poses_text(due.all, batch.last_rig_poses),
                motion_json="" if motion is None else motion.text(),
            ),
        )


def complete(steps: SampleSteps) -> Sample:
    """Run a generator to its end and return its return value."""
    while True:
        try:
            next(steps)
        except StopIteration as end:
            sample: Sample = end.value
            return sample
