"""Command-line options that the experiments share."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.numbers import whole_of

if TYPE_CHECKING:
    from oaisys_mapping.certificate.light_audit import LightAudit
    from oaisys_mapping.certificate.signature import PrivateKey

MOST_WORLDS = 10_000
"""Worlds of one survey or comparison."""

OutOption = Annotated[
    Path, typer.Option(help="Output folder: report, certificate, mesh, pictures and bag.")
]
ConfigOption = Annotated[
    Path | None, typer.Option("--config", help="YAML configuration; otherwise the default world.")
]
SizeOption = Annotated[
    str | None, typer.Option(help="Size of the images, WIDTHxHEIGHT, for a quick run.")
]
VoxelSizeOption = Annotated[float, typer.Option(help="Voxel size of the map, metres.", min=1e-3)]
SeedOption = Annotated[int | None, typer.Option(help="Seed of the (first) world.", min=0)]
BackendOption = Annotated[str | None, typer.Option(help="Renderer: blender or analytic.")]
QualityOption = Annotated[
    str | None,
    typer.Option(
        help="Quality of colour: draft, preview, standard, high, final or geometry (none)."
    ),
]
BagOption = Annotated[bool, typer.Option(help="Record all topics to a rosbag2 MCAP bag.")]
NamespaceOption = Annotated[
    str, typer.Option(help="ROS namespace of all nodes and of TF, to run several side by side.")
]
WorkerPythonOption = Annotated[
    Path | None, typer.Option(help="Python interpreter that has bpy; otherwise this one.")
]
ParamsFileOption = Annotated[
    Path | None,
    typer.Option(help="YAML file of ROS parameters of bridge, mapper and recorder."),
]
LogLevelOption = Annotated[
    str, typer.Option(help="Log level of the ROS nodes: debug, info, warn, error or fatal.")
]
UseSimTimeOption = Annotated[
    bool, typer.Option("--use-sim-time", help="Have all nodes follow /clock except its publisher.")
]
KeyOption = Annotated[
    Path | None,
    typer.Option(help="PEM file of an Ed25519 key that signs the certificate."),
]
LightOption = Annotated[
    Path | None,
    typer.Option(
        help="JSON file of `oaisys audit --light --out FILE`; the certificate carries its figures."
    ),
]


def experiment_options(
    *,
    out: Path,
    config: Path | None,
    size: str | None,
    voxel_size: float,
    max_range: float,
    seed: int | None,
    backend: str | None,
    quality: str | None,
    bag: bool,
    namespace: str,
    worker_python: Path | None,
    params_file: Path | None,
    log_level: str,
    use_sim_time: bool,
    key: Path | None,
    light: Path | None = None,
) -> dict[str, Any]:
    """Return the fields of `ExperimentOptions` by name, from the command line.

    Raises:
        InvalidInputError: A file does not exist or cannot be used, or there is no such log level.
    """
    # Not for `oaisys --help`.
    from oaisys_ros_bridge.parameters.node_settings import node_settings

    if config is not None and not config.is_file():
        raise InvalidInputError("--config", str(config), "an existing file")
    chosen = {"seed": seed, "backend": backend, "quality": quality, "size": size}
    return {
        "out": out,
        "config": config,
        "overrides": {name: str(value) for name, value in chosen.items() if value is not None},
        "voxel_size_m": voxel_size,
        "max_range_m": max_range,
        "record": bag,
        "worker_python": worker_python,
        "namespace": namespace,
        "nodes": node_settings(str(params_file or ""), log_level, use_sim_time=use_sim_time),
        "command": ["oaisys", *sys.argv[1:]],
        "key": None if key is None else _private_key(key),
        "light": None if light is None else _light_audit(light),
    }


def _light_audit(path: Path) -> LightAudit:
    from oaisys_mapping.certificate.light_audit import read_light_audit

    return read_light_audit(path)


def _private_key(path: Path) -> PrivateKey:
    from oaisys_mapping.certificate.signature import read_private_key

    return read_private_key(path)


def seeds_of(text: str, first: int) -> tuple[int, ...]:
    """Return the seeds that ``--seeds`` names: ``3``, three from ``first`` on, or ``4,7``.

    Raises:
        InvalidInputError: It is neither.
    """
    found = [whole_of(part.strip()) for part in text.split(",") if part.strip()]
    numbers = [number for number in found if number is not None]
    is_list = "," in text
    if not numbers or None in found or not (is_list or 1 <= numbers[0] <= MOST_WORLDS):
        expected = f"how many worlds, 1 to {MOST_WORLDS}, or their seeds with commas between them"
        raise InvalidInputError("--seeds", text, expected)
    return tuple(dict.fromkeys(numbers)) if is_list else tuple(range(first, first + numbers[0]))
