"""Registers the package in the ament index and compiles the loop over rays; see setup.cfg."""

from setuptools import Extension, setup

# Where there is no compiler, rays take longer.
LOOP = Extension(
    "oaisys_core.private._embree_loop",
    ["oaisys_core/private/embree_loop.c"],
    optional=True,
)

setup(
    ext_modules=[LOOP],
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/oaisys_core"]),
        ("share/oaisys_core", ["package.xml", "README.md", "CHANGELOG.rst"]),
    ],
)
