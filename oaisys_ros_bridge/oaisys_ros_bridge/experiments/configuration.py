"""What an experiment runs: its options, and the configuration of its simulator."""

from __future__ import annotations

import json
import signal
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from oaisys_core.errors import ConfigError, OaisysError
from oaisys_core.files.folders import make_folder
from oaisys_core.system.ending.owner import owner_variables
from oaisys_core.system.python_programs import python_command, python_environment
from oaisys_core.types import DEPTH, is_rendered
from oaisys_ros_bridge.parameters.node_settings import NodeSettings

if TYPE_CHECKING:
    from oaisys_mapping.certificate.light_audit import LightAudit
    from oaisys_mapping.certificate.signature import PrivateKey

CONFIG_FILE = "config.yaml"
"""The complete configuration of an experiment, in its output folder."""

MESH_FILE, TRUTH_FILE, VOLUME_FILE = "mesh.ply", "truth.ply", "volume.npz"
"""The map's surface, the true one, and the map's voxels, in the output folder."""

CONFIG_TIMEOUT_S = 600.0


@dataclass(frozen=True)
class ExperimentOptions:
    """What runs in an experiment.

    Attributes:
        out: Folder for everything it writes.
        config: Configuration file; None: the default world.
        overrides: Options of ``oaisys config show`` that change the configuration.
        voxel_size_m, max_range_m: Of the map.
        record: Whether everything is recorded to a bag.
        worker_python: Interpreter that has ``bpy``; None: this one.
        command: The command line that started it.
        namespace: Of all ROS nodes, and of TF; empty: the root.
        server_options: Further options of ``oaisys serve``.
        bridge_parameters: Further ROS parameters of the bridge.
        nodes: Settings of all nodes.
        key: Signs the certificate; None: it is not signed.
        light: The audit of light that the certificate carries; None: none.
    """

    out: Path
    config: Path | None
    overrides: Mapping[str, str]
    voxel_size_m: float
    max_range_m: float
    record: bool
    worker_python: Path | None
    command: Sequence[str]
    namespace: str = field(default="", kw_only=True)
    server_options: Sequence[str] = field(default=(), kw_only=True)
    bridge_parameters: Mapping[str, Any] = field(default_factory=dict, kw_only=True)
    nodes: NodeSettings = field(default=NodeSettings(), kw_only=True)
    key: PrivateKey | None = field(default=None, kw_only=True)
    light: LightAudit | None = field(default=None, kw_only=True)


def write_config(options: ExperimentOptions) -> Path:
    """Write the complete, validated configuration to the output folder and return its path.

    Raises:
        ConfigError: The configuration cannot be used.
        OaisysError: It could not be read.
    """
    command = python_command("oaisys_core", "config", "show")
    if options.config is not None:
        command += ["--config", str(options.config)]
    for name, value in options.overrides.items():
        command += [f"--{name}", value]
    result = subprocess.run(
        command,
        env=python_environment() | owner_variables(signal.SIGKILL),
        capture_output=True,
        text=True,
        check=False,
        timeout=CONFIG_TIMEOUT_S,
    )
    if result.returncode != 0:
        message = result.stderr.strip().removeprefix("oaisys: ")
        raise ConfigError(message) if result.returncode == 2 else OaisysError(message)
    make_folder(options.out)
    path = options.out / CONFIG_FILE
    path.write_text(result.stdout, encoding="utf-8")
    return path


@dataclass(frozen=True)
class ConfiguredSensors:
    """The cameras of a simulator, before it runs.

    Attributes:
        names: In the order in which the simulator lists them.
        modalities: Of the first camera, without those that quality and passes leave out.
    """

    names: tuple[str, ...]
    modalities: tuple[str, ...]


def read_sensors(path: Path) -> ConfiguredSensors:
    """Return the cameras of a configuration that `write_config` has written.

    Raises:
        ConfigError: The first camera has no depth, without which there is no map.
    """
    config = json.loads(path.read_text(encoding="utf-8"))
    section, render = config["sensors"], config["render"]
    cameras, pairs = section["cameras"], section["stereo"]
    names = [camera["name"] for camera in cameras]
    names += [f"{pair['name']}_{side}" for pair in pairs for side in ("left", "right")]
    offered = [*cameras, *pairs][0]["modalities"]
    modalities = [m for m in offered if is_rendered(m, render["quality"], render["passes"])]
    if DEPTH not in modalities:
        expected = f"{DEPTH} among them and among render.passes, because a map is made of depth"
        raise ConfigError(f"modalities of {names[0]}: received {modalities}, expected {expected}")
    return ConfiguredSensors(tuple(names), tuple(modalities))
