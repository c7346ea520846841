"""Registers the package in the ament index; everything else is in setup.cfg."""

from setuptools import setup

setup(
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/oaisys_gym"]),
        ("share/oaisys_gym", ["package.xml", "README.md", "CHANGELOG.rst"]),
    ],
)
