"""The borders between the packages, read from the source: who may import what."""

from __future__ import annotations

import ast
import functools
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from repository import REPOSITORY

PACKAGES = ("oaisys_core", "oaisys_grpc", "oaisys_mapping", "oaisys_ros_bridge")

BLENDER = {
    *("bpy", "bmesh", "mathutils", "bpy_extras", "gpu", "idprop", "cycles", "_cycles"),
    "PyOpenColorIO",
}
PLAIN_CORE = {
    "oaisys_core.types",
    "oaisys_core.geometry",
    "oaisys_core.errors",
    "oaisys_core.socket_paths",
    # The standard library and, on use, PyYAML: documents have the same bounds everywhere.
    "oaisys_core.files.documents",
    "oaisys_core.files.markdown",
    "oaisys_core.files.arrays",
    "oaisys_core.files.mesh_headers",
    # The standard library alone: how programs are started and end.
    "oaisys_core.cli.signals",
    "oaisys_core.private_files",
    "oaisys_core.python_programs",
    "oaisys_core.standard_streams",
    # Numpy and scipy alone: simulator and bridge must draw the same noise by the same code.
    "oaisys_core.sensing.faults",
    # Plain data: what `oaisys drive` gives to bags and reports.
    "oaisys_core.drive.outputs",
}
COMMAND_LINE = {"rich", "typer"}
CORE_LIBRARIES = {
    "OpenEXR",
    "cv2",
    "numpy",
    "open3d",
    "pydantic",
    "pydantic_core",
    "rasterio",
    "scipy",
    "trimesh",
    "yaml",
    "h5py",
}
DATASET_LIBRARIES = {
    "datasets",
    "fsspec",
    "mlcroissant",
    "pyarrow",
    "pycocotools",
    "pycolmap",
    "ray",
    "webdataset",
}
"""What only data sets need; imported where they are used, as they belong to an extra."""
GRPC_LIBRARIES = {
    "cv2",
    "google",
    "grpc",
    "grpc_health",
    "grpc_reflection",
    "grpc_status",
    "numpy",
    "yaml",
}
MAPPING_LIBRARIES = {"numpy", "open3d", "scipy"}
PRESENTATION = {
    "oaisys_mapping.report.page_guard",
    "oaisys_mapping.report.web_viewer",
    "oaisys_mapping.report.mesh_viewer",
    "oaisys_mapping.report.pictures",
    "oaisys_mapping.report.report",
    "oaisys_mapping.report.drive_report",
    "oaisys_mapping.report.drive_pictures",
}
PRESENTATION_LIBRARIES = {"cv2", "jinja2", "matplotlib", "trimesh", "viser", "websockets"}
"""What draws reports and pages may draw; the algorithms may not."""
ODOMETRY_PROGRAMS = {"oaisys_mapping.odometry.inertial"}
"""What runs in a process of its own."""
SIGNING = {"oaisys_mapping.certificate.signature"}
BRIDGE_LIBRARIES = {
    "cv2",
    "lz4",
    "matplotlib",
    "mcap",
    "numpy",
    "psutil",
    "scipy",
    "yaml",
    "zstandard",
}
ROS = {
    "action_msgs", "ament_index_python", "builtin_interfaces", "diagnostic_msgs", "geometry_msgs",
    "launch", "launch_ros", "lifecycle_msgs", "nav_msgs", "oaisys_msgs", "rcl_interfaces", "rclpy",
    "rosgraph_msgs",
    "sensor_msgs", "simulation_interfaces", "std_msgs", "std_srvs", "tf2_msgs", "trajectory_msgs",
    "visualization_msgs",
}  # fmt: skip
CLIENT_SIDE = (
    "oaisys_grpc.client.simulator_client",
    "oaisys_grpc.contract.world_messages",
    "oaisys_grpc.memory",
)


def modules() -> Iterator[tuple[str, Path]]:
    for package in PACKAGES:
        root = REPOSITORY / package
        for file in sorted((root / package).rglob("*.py")):
            parts = file.relative_to(root).with_suffix("").parts
            if "pb" in parts:
                continue  # generated
            yield ".".join(parts[:-1] if parts[-1] == "__init__" else parts), file


def imports(module: str, file: Path) -> set[str]:
    """Every module that ``file`` names, at the top or inside a function, as an absolute name."""
    package = module.split(".") if file.name == "__init__.py" else module.split(".")[:-1]
    found: set[str] = set()
    for node in ast.walk(ast.parse(file.read_text(), str(file))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else []
            prefix = ".".join([*base, *(node.module or "").split(".")]).strip(".")
            found |= {
                f"{prefix}.{alias.name}" if is_module(f"{prefix}.{alias.name}") else prefix
                for alias in node.names
            }
    return found


def is_module(name: str) -> bool:
    path = REPOSITORY.joinpath(name.split(".")[0], *name.split("."))
    return path.is_dir() or path.with_suffix(".py").is_file()


def is_below(name: str, allowed: set[str]) -> bool:
    return any(name == prefix or name.startswith(f"{prefix}.") for prefix in allowed)


@functools.cache
def client_modules() -> set[str]:
    """The client, the conversions, and every module of their package that these import."""
    files = {name: file for name, file in modules() if name.startswith("oaisys_grpc")}
    reached: set[str] = set()
    waiting = set(CLIENT_SIDE)
    while waiting:
        name = waiting.pop()
        reached.add(name)
        waiting |= (imports(name, files[name]) & files.keys()) - reached
    return reached


def allowed_for(module: str) -> set[str]:
    """What ``module`` may import besides the standard library and its own package."""
    package = module.split(".")[0]
    if package == "oaisys_core":
        blender = is_below(module, {"oaisys_core.backend.blender"})
        dataset = is_below(module, {"oaisys_core.dataset"})
        extra = (BLENDER if blender else set()) | (DATASET_LIBRARIES if dataset else set())
        return CORE_LIBRARIES | COMMAND_LINE | extra
    if package == "oaisys_mapping":
        drawing = PRESENTATION_LIBRARIES if is_below(module, PRESENTATION) else set()
        signing = {"cryptography"} if module in SIGNING else set()
        odometry = {"gtsam"} if module in ODOMETRY_PROGRAMS else set()
        return MAPPING_LIBRARIES | COMMAND_LINE | PLAIN_CORE | drawing | signing | odometry
    if package == "oaisys_ros_bridge":
        client = {"oaisys_grpc.client.options", "oaisys_grpc.client.simulator_client"}
        client |= {"oaisys_grpc.memory", "oaisys_mapping"}
        return BRIDGE_LIBRARIES | COMMAND_LINE | ROS | PLAIN_CORE | client
    if module in client_modules():
        return GRPC_LIBRARIES | PLAIN_CORE
    return GRPC_LIBRARIES | COMMAND_LINE | {"oaisys_core", "psutil"}


@pytest.mark.parametrize(("module", "file"), [pytest.param(*m, id=m[0]) for m in modules()])
def test_module_imports_only_what_its_side_may(module: str, file: Path) -> None:
    own = {module.split(".")[0]}
    forbidden = {
        name
        for name in imports(module, file)
        if name.split(".")[0] not in sys.stdlib_module_names
        and not is_below(name, own | allowed_for(module))
    }
    assert not forbidden, f"{module} must not import {sorted(forbidden)}"


def test_client_side_does_not_reach_the_server() -> None:
    server_side = {
        "oaisys_grpc.server.server",
        "oaisys_grpc.server.supervision.supervisor",
        "oaisys_grpc.worker.program",
    }
    assert server_side <= {module for module, _ in modules()}
    assert not client_modules() & server_side


def test_walk_finds_modules_of_every_package() -> None:
    assert {module.split(".")[0] for module, _ in modules()} == set(PACKAGES)
