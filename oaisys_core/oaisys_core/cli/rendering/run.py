"""``oaisys render``: renders batches and samples to files, without ROS and without a server."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from oaisys_core.cli.options import (
    BackendOption,
    ConfigOption,
    PosesCameraOption,
    PosesFrameOption,
    PosesOption,
    PosesTopicOption,
    QualityOption,
    SeedOption,
    SizeOption,
)
from oaisys_core.cli.standard_output import own_stdout
from oaisys_core.errors import ConfigError, InvalidInputError, RenderError

if TYPE_CHECKING:
    from oaisys_core.cli.rendering.metadata_file import SampleRequest, Steps
    from oaisys_core.cli.rendering.pose_steps import PoseSteps, ViewSteps
    from oaisys_core.cli.rendering.progress import RenderProgress
    from oaisys_core.config import SimulationConfig
    from oaisys_core.files.poses import PoseSelection
    from oaisys_core.output.writer import SampleWriter
    from oaisys_core.simulation import Simulation
    from oaisys_core.types import Sample


def render(
    out: Annotated[Path | None, typer.Option("--out", help="Output folder.")] = None,
    config: ConfigOption = None,
    batches: Annotated[int | None, typer.Option(help="Number of worlds.", min=1)] = None,
    samples: Annotated[
        int | None, typer.Option(help="Number of views of each world.", min=1)
    ] = None,
    poses: PosesOption = None,
    poses_camera: PosesCameraOption = None,
    poses_topic: PosesTopicOption = None,
    poses_frame: PosesFrameOption = None,
    position: Annotated[
        tuple[float, float, float] | None,
        typer.Option(
            metavar="X Y Z", help="Position of the rig in `map`, in metres; with --look-at."
        ),
    ] = None,
    look_at: Annotated[
        tuple[float, float, float] | None,
        typer.Option(metavar="X Y Z", help="Point in `map` at which the rig looks, in metres."),
    ] = None,
    on_ground: Annotated[
        bool,
        typer.Option(
            "--on-ground", help="Count Z of --position and --look-at from the surface below."
        ),
    ] = False,
    metadata: Annotated[
        Path | None,
        typer.Option(help="YAML or JSON list of metadata, one entry per view."),
    ] = None,
    seed: SeedOption = None,
    world_seed: Annotated[
        int | None,
        typer.Option(
            help="Seed of the one world, as a sample or the page of `oaisys live` tells it;"
            " default: drawn from the root seed.",
            min=0,
        ),
    ] = None,
    backend: BackendOption = None,
    quality: QualityOption = None,
    size: SizeOption = None,
    batch_offset: Annotated[
        int | None, typer.Option(help="Number added to the numbers of batch folders.", min=0)
    ] = None,
    save_blend: Annotated[
        bool | None,
        typer.Option("--save-blend/--no-save-blend", help="Save each world as a .blend file."),
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Continue the run in --out.")] = False,
) -> None:
    """Render batches and samples to files, without ROS and without a server.

    Without --look-at, --poses, --metadata and a motion in the configuration, the rig stays above
    the stage's centre, looking down.
    """
    # `oaisys --help` imports this module, so slow imports are done on use.
    from oaisys_core.cli.rendering.pose_steps import ViewSteps
    from oaisys_core.config import SimulationConfig, adjust, load_config
    from oaisys_core.files.folders import own_folder
    from oaisys_core.files.poses import PoseSelection
    from oaisys_core.output.writer import SampleWriter
    from oaisys_core.simulation import Simulation
    from oaisys_core.world.config_files import texture_notes

    loaded = load_config(config) if config else SimulationConfig()
    chosen = adjust(loaded, seed=seed, backend=backend, quality=quality, size=size)
    given = {"folder": out, "batches": batches, "samples": samples}
    given |= {"batch_offset": batch_offset, "save_blend": save_blend}
    output = chosen.output.model_copy(update={k: v for k, v in given.items() if v is not None})
    if output.folder is None:
        raise InvalidInputError("out", None, "a folder, as --out or output.folder")
    if output.save_blend and chosen.backend != "blender":
        expected = "the backend blender, or --no-save-blend"
        raise InvalidInputError("output.save_blend", chosen.backend, expected)
    if world_seed is not None and output.batches != 1:
        raise InvalidInputError("world-seed", world_seed, "none with several worlds (--batches)")
    if samples is not None and (poses is not None or metadata is not None):
        expected = "none with --poses or --metadata, which have one entry per view"
        raise InvalidInputError("samples", samples, expected)
    selection = PoseSelection(topic=poses_topic, frame=poses_frame)
    steps = _steps(poses, selection, poses_camera, metadata, output.samples)
    if position is not None or look_at is not None:
        if poses is not None or metadata is not None:
            expected = "none with --poses or --metadata"
            raise InvalidInputError("look-at", look_at or position, expected)
        steps = ViewSteps(position, look_at, output.samples, is_on_ground=on_ground)
    elif on_ground:
        raise InvalidInputError("on-ground", on_ground, "none without --position and --look-at")
    writer = SampleWriter(output.folder, output.batch_offset)
    with own_folder(output.folder), own_stdout():
        simulation = Simulation(chosen)
        for note in texture_notes(chosen):
            typer.echo(note, err=True)
        try:
            run = _Run(simulation, writer, steps, output.batches, output.save_blend, world_seed)
            run.start(chosen, is_resumed=resume)
            run.finish()
        except (ConfigError, InvalidInputError):
            writer.withdraw()
            raise
        finally:
            simulation.close()


def _steps(
    poses: Path | None,
    selection: PoseSelection,
    camera: str | None,
    metadata: Path | None,
    samples: int,
) -> Steps | PoseSteps | ViewSteps:
    from oaisys_core.cli.rendering.metadata_file import SampleRequest, Steps, load_steps
    from oaisys_core.cli.rendering.pose_steps import PoseSteps
    from oaisys_core.types import ModuleMetadata

    if poses is not None and metadata is not None:
        raise InvalidInputError("metadata", str(metadata), "either --poses or --metadata")
    if poses is not None:
        return PoseSteps(poses, selection, camera)
    for option, value in (
        ("--poses-camera", camera),
        ("--poses-topic", selection.topic),
        ("--poses-frame", selection.frame),
    ):
        if value is not None:
            raise InvalidInputError(option, value, "none without --poses")
    if metadata is not None:
        return load_steps(metadata)
    return Steps(ModuleMetadata(), tuple([SampleRequest()] * samples))


class _Run:
    """All batches and samples of one command."""

    def __init__(
        self,
        simulation: Simulation,
        writer: SampleWriter,
        steps: Steps | PoseSteps | ViewSteps,
        batches: int,
        saves_worlds: bool,
        world_seed: int | None,
    ) -> None:
        from rich.console import Console

        self._simulation = simulation
        self._writer = writer
        self._steps = steps
        self._batches = batches
        self._saves_worlds = saves_worlds
        self._world_seed = world_seed
        self._console = Console()

    def start(self, config: SimulationConfig, *, is_resumed: bool) -> None:
        """Prepare the folder; for a resumed run, restore the world in which it stopped."""
        if not is_resumed:
            self._writer.begin(config)
            return
        state = self._writer.resume(config)
        if state is not None:
            self._simulation.restore(state)

    def finish(self) -> None:
        """Render all missing views."""
        from oaisys_core.cli.rendering.progress import RenderProgress

        count = self._steps.count
        info = self._simulation.info()
        batch_id, done = info.batch_id, info.sample_id
        total = self._batches * count
        before = max(0, batch_id - 1) * count + done
        with RenderProgress(total, before, self._console) as shown:
            batch_id = batch_id or self._build(1, shown)
            while True:
                views = self._steps.requests(self._simulation)
                for number, view in enumerate(views[done:], start=done + 1):
                    shown.begin(f"world {batch_id}, view {number} of {count}")
                    self._render(view, shown)
                    shown.view_done()
                if self._saves_worlds:
                    self._save(batch_id)
                if batch_id >= self._batches:
                    break
                batch_id, done = self._build(batch_id + 1, shown), 0
        if not self._writer.has_measurements():
            text = f"nothing was rendered: no sensor was due at any of {count} views"
            raise RenderError(f"{text}; see step_offset and step_interval of sensors")

    def _build(self, batch_id: int, shown: RenderProgress) -> int:
        shown.begin(f"world {batch_id}")
        built = self._simulation.step_batch(
            self._steps.batch, seed=self._world_seed, progress=shown
        )
        counts = self._simulation.info().group_counts
        self._writer.write_counts(built, counts)
        if counts:
            placed = ", ".join(f"{c.placed} of {c.asked} {c.name}" for c in counts)
            self._console.print(f"batch {built}: placed {placed}", soft_wrap=True, highlight=False)
        return built

    def _render(self, view: SampleRequest, shown: RenderProgress) -> None:
        sample = self._simulation.step_sample(
            view.metadata, modalities=view.modalities, sensors=view.sensors, progress=shown
        )
        self._writer.write(sample, self._simulation.info().semantic_labels)
        self._writer.write_state(self._simulation.state())
        self._report(sample)

    def _save(self, batch_id: int) -> None:
        path = self._writer.blend_file(batch_id)
        if not path.exists():
            path.parent.mkdir(parents=True, exist_ok=True)
            self._simulation.save(path)

    def _report(self, sample: Sample) -> None:
        if not self._console.is_terminal:
            typer.echo(
                f"batch {sample.batch_id} sample {sample.sample_id}: {sample.render_time_s:.2f} s"
            )
