"""Registers the package in the ament index; everything else is in setup.cfg."""

from setuptools import setup

setup(
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/oaisys_core"]),
        ("share/oaisys_core", ["package.xml", "README.md", "CHANGELOG.rst"]),
    ],
)
