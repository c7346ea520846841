"""Cameras and poses as JSON, for later evaluations."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.documents import parse_json, read_text
from oaisys_core.files.whole_files import write_whole_text
from oaisys_core.types import PinholeIntrinsics
from oaisys_mapping.evaluation.visibility import PosedCamera

MAX_VIEWS_BYTES = 64_000_000
"""Size of a file of views; one of them takes half a kilobyte."""


def write_views(path: Path, views: Sequence[PosedCamera]) -> None:
    """Write cameras and poses to a JSON file; inverse: `read_views`."""
    write_whole_text(path, json.dumps({"views": views_to_json(views)}, indent=1))


def read_views(path: Path) -> list[PosedCamera]:
    """Return the views in a JSON file.

    Raises:
        InvalidInputError: The file cannot be read, or a view is incomplete or invalid.
    """
    try:
        data = parse_json(read_text(path, MAX_VIEWS_BYTES))
        views = list(data["views"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        expected = f'a JSON file {{"views": [...]}} ({error})'
        raise InvalidInputError("poses", str(path), expected) from error
    return views_from_json(views, f"{path}: views")


def views_to_json(views: Sequence[PosedCamera]) -> list[dict[str, Any]]:
    """Return views as JSON values; inverse: `views_from_json`."""
    return [
        {
            "width_px": view.intrinsics.width_px,
            "height_px": view.intrinsics.height_px,
            "K": view.intrinsics.K.tolist(),
            "T_map_camera": view.T_map_camera.tolist(),
        }
        for view in views
    ]


def views_from_json(items: Sequence[Any], field: str) -> list[PosedCamera]:
    """Return views from JSON values; inverse: `views_to_json`.

    Args:
        items: The JSON values.
        field: Name of the list in error messages.

    Raises:
        InvalidInputError: A view is incomplete or invalid.
    """
    return [_view(item, f"{field}.{index}") for index, item in enumerate(items)]


def _view(item: Any, field: str) -> PosedCamera:
    try:
        K = np.asarray(item["K"], np.float64)
        T_map_camera = np.asarray(item["T_map_camera"], np.float64)
        size = (int(item["width_px"]), int(item["height_px"]))
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        expected = "width_px, height_px, K and T_map_camera"
        raise InvalidInputError(field, item, expected) from error
    if K.shape != (3, 3) or T_map_camera.shape != (4, 4):
        raise InvalidInputError(field, (K.shape, T_map_camera.shape), "K (3, 3), pose (4, 4)")
    fx_px, fy_px, cx_px, cy_px = (float(K[place]) for place in ((0, 0), (1, 1), (0, 2), (1, 2)))
    if not (np.isfinite(K).all() and fx_px > 0 and fy_px > 0 and min(size) > 0):
        raise InvalidInputError(field, (size, K.tolist()), "a camera with a size and focal lengths")
    R = T_map_camera[:3, :3]
    if not (np.isfinite(T_map_camera).all() and np.allclose(R @ R.T, np.eye(3), atol=1e-4)):
        raise InvalidInputError(field, T_map_camera.tolist(), "a finite, rigid T_map_camera")
    return PosedCamera(PinholeIntrinsics(*size, fx_px, fy_px, cx_px, cy_px), T_map_camera)
