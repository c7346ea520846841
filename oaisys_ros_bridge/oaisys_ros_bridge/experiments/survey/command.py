"""The shell command ``oaisys survey``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from oaisys_ros_bridge.experiments.options import (
    BackendOption,
    BagOption,
    ConfigOption,
    KeyOption,
    LightOption,
    LogLevelOption,
    NamespaceOption,
    OutOption,
    ParamsFileOption,
    QualityOption,
    SeedOption,
    SizeOption,
    UseSimTimeOption,
    VoxelSizeOption,
    WorkerPythonOption,
    experiment_options,
)
from oaisys_ros_bridge.shared_memory import require_shared_memory

ViewsOption = Annotated[int, typer.Option(help="Number of viewpoints in the grid.", min=1)]
AltitudeOption = Annotated[
    float, typer.Option(help="Height of the viewpoints above the ground, metres.")
]
OverlapOption = Annotated[
    float, typer.Option(help="Overlap of neighbouring images, as a share of their edge.")
]
MaxRangeOption = Annotated[
    float, typer.Option(help="Largest depth that is mapped, metres.", min=0.1)
]
FaultsOption = Annotated[
    bool, typer.Option(help="Evaluate maps with deliberate faults, too, which must be rejected.")
]


def survey(
    out: OutOption = Path("out/survey"),
    config: ConfigOption = None,
    views: ViewsOption = 30,
    size: SizeOption = None,
    altitude: AltitudeOption = 10.0,
    overlap: OverlapOption = 0.35,
    voxel_size: VoxelSizeOption = 0.10,
    max_range: MaxRangeOption = 60.0,
    seed: SeedOption = None,
    seeds: Annotated[
        str | None,
        typer.Option(
            help="Number of worlds, from --seed on, or their seeds: 1,2,5. Each in a folder seed_N."
        ),
    ] = None,
    backend: BackendOption = None,
    quality: QualityOption = None,
    faults: FaultsOption = True,
    key: KeyOption = None,
    light: LightOption = None,
    bag: BagOption = True,
    namespace: NamespaceOption = "",
    worker_python: WorkerPythonOption = None,
    params_file: ParamsFileOption = None,
    log_level: LogLevelOption = "",
    use_sim_time: UseSimTimeOption = False,
) -> None:
    """Survey a terrain over ROS, reconstruct it, evaluate and certify the map.

    Exit 0 if the map agrees with the true surface. With --seeds, exit 0 if it agrees in every
    world and every map with a deliberate fault is rejected.
    """
    require_shared_memory()  # before anything imports rclpy
    from oaisys_ros_bridge.experiments.interruption import interrupt_on_signals
    from oaisys_ros_bridge.experiments.progress import Reporter, seconds_since_start
    from oaisys_ros_bridge.experiments.survey.plan import SurveyOptions, check_grid
    from oaisys_ros_bridge.experiments.survey.seeds import run_seeds
    from oaisys_ros_bridge.experiments.survey.survey import run_survey

    check_grid(views, altitude, overlap)
    shared = experiment_options(
        out=out,
        config=config,
        size=size,
        voxel_size=voxel_size,
        max_range=max_range,
        seed=seed,
        backend=backend,
        quality=quality,
        bag=bag,
        namespace=namespace,
        worker_python=worker_python,
        params_file=params_file,
        log_level=log_level,
        use_sim_time=use_sim_time,
        key=key,
        light=light,
    )
    options = SurveyOptions(
        **shared, views=views, altitude_m=altitude, overlap=overlap, faults=faults
    )
    interrupt_on_signals()
    reporter = Reporter()
    seconds_since_start()  # a wrong start is refused at once
    if seeds:
        went_well = run_seeds(options, reporter, seeds)
    else:
        went_well = run_survey(options, reporter, seconds_since_start)
    if not went_well:
        raise typer.Exit(1)
