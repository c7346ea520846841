"""Installs the launch files and configurations that lie beside the package, for ROS to find."""

from pathlib import Path

from setuptools import setup

HERE = Path(__file__).absolute().parent


def shared(folder: str) -> list[tuple[str, list[str]]]:
    """Return ``../folder`` as data files below the package's share folder.

    Sources are relative to the package, as setuptools demands.
    """
    root = HERE.parent / folder
    files_by_target: dict[str, list[str]] = {}
    for file in sorted(file for file in root.rglob("*") if file.is_file()):
        if "__pycache__" in file.parts:
            continue
        target = Path("share/oaisys_ros_bridge", folder, file.parent.relative_to(root))
        source = Path("..", folder, file.relative_to(root))
        files_by_target.setdefault(str(target), []).append(str(source))
    return sorted(files_by_target.items())


setup(
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/oaisys_ros_bridge"]),
        ("share/oaisys_ros_bridge", ["package.xml", "README.md", "CHANGELOG.rst"]),
        *shared("launch"),
        *shared("config"),
    ],
)
