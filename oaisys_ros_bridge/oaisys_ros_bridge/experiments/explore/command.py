"""The shell command ``oaisys explore``."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from oaisys_core.errors import InvalidInputError
from oaisys_ros_bridge.experiments.options import (
    BackendOption,
    BagOption,
    KeyOption,
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
    seeds_of,
)
from oaisys_ros_bridge.shared_memory import require_shared_memory

UNTIL, UNTIL_COMPARED = 0.95, 0.9
"""Coverage at which an exploration ends, with one planner and with several."""

ConfigOption = Annotated[
    Path | None, typer.Option(help="YAML configuration; otherwise a steep hill.")
]
PlannerOption = Annotated[
    str,
    typer.Option(
        help="next_best_view, frontier, grid, random, or an installed package's; several are "
        "separated by commas; all: these four."
    ),
]
NodeOption = Annotated[
    list[str] | None,
    typer.Option(
        metavar="NAME=COMMAND",
        help="A planner that is a program of its own, such as a ROS node; may be repeated.",
    ),
]
NodeSilenceOption = Annotated[
    float,
    typer.Option(help="A --node is done once it has commanded no view for so long, s.", min=1),
]
PlanTimeoutOption = Annotated[
    float,
    typer.Option(
        help="A planner of another package fails if a pose takes it longer than this, s.", min=0.1
    ),
]
CompareOption = Annotated[
    bool, typer.Option("--compare", help="Have all other planners explore the same worlds, too.")
]
SeedsOption = Annotated[
    str, typer.Option(help="Number of worlds, from --seed on, or their seeds: 1,2,5.")
]
ViewsOption = Annotated[int, typer.Option(help="Largest number of views of an exploration.", min=1)]
BaselineViewsOption = Annotated[
    int, typer.Option(help="Largest number of views of every planner but the first.", min=1)
]
UntilOption = Annotated[
    float | None,
    typer.Option(
        help="Coverage of the reachable surface at which an exploration ends; otherwise "
        f"{UNTIL:g}, or {UNTIL_COMPARED:g} with several planners.",
        min=0,
        max=1,
    ),
]
PathOption = Annotated[float, typer.Option(help="Longest path, metres.", min=0)]
PlanningVoxelOption = Annotated[
    float, typer.Option(help="Voxel size of the planner's map, metres.", min=0.05)
]


class RequestMethod(StrEnum):
    """How views are requested."""

    SERVICE = "service"
    TRAJECTORY = "trajectory"


RequestMethodOption = Annotated[
    RequestMethod,
    typer.Option(help="Request views by the set_pose service, or on command/trajectory."),
]


def explore(
    out: OutOption = Path("out/explore"),
    config: ConfigOption = None,
    planner: PlannerOption = "next_best_view",
    node: NodeOption = None,
    node_silence: NodeSilenceOption = 60.0,
    plan_timeout: PlanTimeoutOption = 120.0,
    compare: CompareOption = False,
    seeds: SeedsOption = "1",
    seed: SeedOption = None,
    views: ViewsOption = 60,
    baseline_views: BaselineViewsOption = 400,
    until: UntilOption = None,
    path: PathOption = 20_000.0,
    via: RequestMethodOption = RequestMethod.SERVICE,
    size: SizeOption = None,
    voxel_size: VoxelSizeOption = 0.10,
    planning_voxel: PlanningVoxelOption = 0.5,
    radius: Annotated[float, typer.Option(help="Radius of the vehicle, metres.", min=0.05)] = 1.0,
    camera_range: Annotated[
        float, typer.Option(help="Largest depth that is used, metres.", min=1)
    ] = 20.0,
    start_height: Annotated[
        float, typer.Option(help="Height of the first view above the ground, metres.")
    ] = 3.0,
    backend: BackendOption = None,
    quality: QualityOption = None,
    key: KeyOption = None,
    bag: BagOption = True,
    namespace: NamespaceOption = "",
    worker_python: WorkerPythonOption = None,
    params_file: ParamsFileOption = None,
    log_level: LogLevelOption = "",
    use_sim_time: UseSimTimeOption = False,
) -> None:
    """Explore a terrain view by view over ROS, reconstruct it, and measure the coverage.

    Exit 0 if the map of the first planner in the first world agrees with the true surface. With
    several planners, the report compares their coverage against views and path length, and what
    each needed for 90 %; after the first exploration only depth is rendered. A planner that fails
    ends its own exploration alone: the others go on, the report says why, and the exit code is 1.
    """
    require_shared_memory()  # before anything imports rclpy
    from oaisys_ros_bridge.experiments.explore.explore import run_explore
    from oaisys_ros_bridge.experiments.explore.node_planner import node_planner
    from oaisys_ros_bridge.experiments.explore.plan import (
        FIRST_SEED,
        ExploreOptions,
        default_config,
        planners_of,
        require_start_height,
    )
    from oaisys_ros_bridge.experiments.interruption import interrupt_on_signals
    from oaisys_ros_bridge.experiments.progress import Reporter

    if node and via != RequestMethod.SERVICE:
        raise InvalidInputError("--via", via.value, "service: a --node commands trajectories")
    require_start_height(start_height, radius)
    programs = [node_planner(text, node_silence) for text in node or ()]
    planners = planners_of(planner, [each.name for each in programs], compare=compare)
    worlds = seeds_of(seeds, FIRST_SEED if seed is None else seed)
    shared = experiment_options(
        out=out,
        config=config or default_config(),
        size=size,
        voxel_size=voxel_size,
        max_range=camera_range,
        seed=worlds[0],
        backend=backend,
        quality=quality,
        bag=bag,
        namespace=namespace,
        worker_python=worker_python,
        params_file=params_file,
        log_level=log_level,
        use_sim_time=use_sim_time,
        key=key,
    )
    goal = UNTIL if len(planners) == 1 else UNTIL_COMPARED
    options = ExploreOptions(
        **shared,
        bridge_parameters={"trajectory_points": "every" if programs else "last"},
        planners=planners,
        programs=programs,
        plan_timeout_s=plan_timeout,
        seeds=worlds,
        via=via,
        views=views,
        baseline_views=baseline_views,
        until=goal if until is None else until,
        path_m=path,
        planning_voxel_m=planning_voxel,
        vehicle_radius_m=radius,
        camera_range_m=camera_range,
        start_height_m=start_height,
    )
    interrupt_on_signals()
    if not run_explore(options, Reporter()):
        raise typer.Exit(1)
