"""The shell command ``oaisys explore``."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from oaisys_core.errors import InvalidInputError

BASELINES = ("random", "grid", "frontier")


def explore(
    out: Annotated[Path, typer.Option(help="Folder for report, mesh, pictures and bag.")] = Path(
        "out/explore"
    ),
    config: Annotated[
        Path | None, typer.Option(help="YAML file; a steep hill where none is given.")
    ] = None,
    planner: Annotated[
        str,
        typer.Option(help="next_best_view, frontier, grid, random, or an installed package's."),
    ] = "next_best_view",
    compare: Annotated[
        bool, typer.Option("--compare", help="Let the baselines explore the same worlds too.")
    ] = False,
    seeds: Annotated[int, typer.Option(help="Worlds, from --seed on.", min=1)] = 1,
    seed: Annotated[int | None, typer.Option(help="Of the first world.", min=0)] = None,
    views: Annotated[int, typer.Option(help="Most views of an exploration.", min=1)] = 60,
    until: Annotated[
        float, typer.Option(help="Share of the reachable surface to see.", min=0, max=1)
    ] = 0.95,
    path: Annotated[float, typer.Option(help="Longest path, metres.", min=0)] = 5000.0,
    size: Annotated[
        str | None, typer.Option(help="WIDTHxHEIGHT of the images, for a quick look.")
    ] = None,
    voxel_size: Annotated[float, typer.Option(help="Of the map, metres.", min=1e-3)] = 0.10,
    planning_voxel: Annotated[
        float, typer.Option(help="Of the map that plans are made on, metres.", min=0.05)
    ] = 0.5,
    radius: Annotated[float, typer.Option(help="Of the vehicle, metres.", min=0.05)] = 1.0,
    camera_range: Annotated[float, typer.Option(help="Depth that is used, metres.", min=1)] = 20.0,
    start_height: Annotated[float, typer.Option(help="Metres over the ground at the start.")] = 3.0,
    backend: Annotated[str | None, typer.Option(help="blender or analytic.")] = None,
    quality: Annotated[
        str | None, typer.Option(help="Of colour: preview, standard, high or final.")
    ] = None,
    bag: Annotated[bool, typer.Option(help="Record everything as a rosbag2 MCAP.")] = True,
    namespace: Annotated[
        str, typer.Option(help="Of all ROS nodes, TF included: two at once on one machine.")
    ] = "",
    worker_python: Annotated[
        Path | None, typer.Option(help="Interpreter that has bpy; this one if not given.")
    ] = None,
) -> None:
    """Explore a terrain view by view over ROS, rebuild it, and count what was seen.

    Exit 0 if the map closes. With --compare all planners explore the same worlds, and the report
    shows coverage against views and against the path flown.
    """
    from oaisys_ros_bridge.explore import run_explore
    from oaisys_ros_bridge.explore_plan import FIRST_SEED, ExploreOptions, default_config
    from oaisys_ros_bridge.interruption import interrupt_on_signals
    from oaisys_ros_bridge.progress import Reporter

    if config is not None and not config.is_file():
        raise InvalidInputError("--config", str(config), "an existing file")
    chosen = {"seed": seed, "backend": backend, "quality": quality, "size": size}
    first = FIRST_SEED if seed is None else seed
    options = ExploreOptions(
        out=out,
        config=config or default_config(),
        overrides={name: str(value) for name, value in chosen.items() if value is not None},
        voxel_size_m=voxel_size,
        max_range_m=camera_range,
        record=bag,
        worker_python=worker_python,
        namespace=namespace,
        command=["oaisys", *sys.argv[1:]],
        planners=tuple(dict.fromkeys((planner, *(BASELINES if compare else ())))),
        seeds=range(first, first + seeds),
        views=views,
        until=until,
        path_m=path,
        planning_voxel_m=planning_voxel,
        vehicle_radius_m=radius,
        camera_range_m=camera_range,
        start_height_m=start_height,
    )
    interrupt_on_signals()
    if not run_explore(options, Reporter()):
        raise typer.Exit(1)
