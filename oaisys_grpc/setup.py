"""Generates the gRPC code before the package is built, and registers it in the ament index."""

import subprocess
import sys
from pathlib import Path

from setuptools import find_packages, setup
from setuptools.command.build_py import build_py
from setuptools.command.develop import develop

HERE = Path(__file__).resolve().parent


def generate_protos() -> None:
    """Run the generator; it does nothing where the generated code is up to date."""
    subprocess.run([sys.executable, HERE / "generate_protos.py"], check=True)


class BuildPy(build_py):
    """Generates the code and takes it into the package."""

    def run(self) -> None:
        """Build."""
        generate_protos()
        self.packages = find_packages(str(HERE), include=["oaisys_grpc*"])
        self.data_files = self._get_data_files()
        super().run()


class Develop(develop):
    """Generates the code that a link to the sources then finds."""

    def run(self) -> None:
        """Link."""
        generate_protos()
        super().run()


setup(
    cmdclass={"build_py": BuildPy, "develop": Develop},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/oaisys_grpc"]),
        ("share/oaisys_grpc", ["package.xml", "README.md", "CHANGELOG.rst"]),
    ],
)
