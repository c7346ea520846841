"""Installs the launch files and configurations that lie beside the package, for ROS to find."""

from pathlib import Path

from setuptools import setup

HERE = Path(__file__).absolute().parent


def share_files(folder: str) -> list[tuple[str, list[str]]]:
    """Return the files in a folder as data files below the package's share folder.

    The folder is a link to the repository's; sdists hold the files. Sources are relative to the
    package, as setuptools demands.
    """
    files_by_target: dict[str, list[str]] = {}
    for file in sorted(file for file in (HERE / folder).rglob("*") if file.is_file()):
        if "__pycache__" in file.parts:
            continue
        source = file.relative_to(HERE)
        target = Path("share/oaisys_ros_bridge", source.parent)
        files_by_target.setdefault(str(target), []).append(str(source))
    return sorted(files_by_target.items())


setup(
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/oaisys_ros_bridge"]),
        ("share/oaisys_ros_bridge", ["package.xml", "README.md", "CHANGELOG.rst"]),
        *share_files("launch"),
        *share_files("config"),
    ],
)
