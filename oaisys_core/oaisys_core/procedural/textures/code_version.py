"""The version of what makes the built-in texture sets: a hash of its code and its libraries."""

from __future__ import annotations

import hashlib
from functools import cache
from pathlib import Path

import numpy as np
import scipy

PACKAGE = Path(__file__).parents[2]

CODE = (
    "procedural/textures",
    "procedural/terrain/noise.py",
    "procedural/scatter/rocks.py",
    "raycast/triangles.py",
    "raycast/targets/ray_target.py",
    "raycast/open3d_bvh.py",
    "scene/objects.py",
    "types",
    "color.py",
    "randomness.py",
    "private/open3d_import.py",
)
"""Files and folders of the package with all code that runs while a set is made."""


def code_version() -> str:
    """Return the version, which is another one if a set might be."""
    return version_of(CODE)


@cache
def version_of(code: tuple[str, ...]) -> str:
    """Return a hash of files and folders of the package, and of the libraries they use."""
    import cv2

    digest = hashlib.sha256(repr((np.__version__, scipy.__version__, cv2.__version__)).encode())
    for path in code_files(code):
        digest.update(repr((path.relative_to(PACKAGE).as_posix(), path.read_bytes())).encode())
    return digest.hexdigest()


def code_files(code: tuple[str, ...] = CODE) -> list[Path]:
    """Return the given files of the package, and those in the given folders."""
    named = [PACKAGE / name for name in code]
    return [
        file
        for path in named
        for file in ([path] if path.is_file() else sorted(path.rglob("*.py")))
    ]
