"""Stages that are kept in files, so that later batches and later runs stand on the same ground.

A file holds the ground itself and the seeds of what was drawn on it: material and scattered
things are drawn again from them, which gives the same ones under the same configuration.
"""

from __future__ import annotations

import hashlib
import json
import os
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import InvalidInputError
from oaisys_core.scene import Ground, HeightField
from oaisys_core.terrain.mesh_ground import MeshGround

FORMAT = 1
SUFFIX = ".npz"


@dataclass(frozen=True)
class StageRecord:
    """A stage, and what stood on it.

    Attributes:
        stage_hash: Of the ground, see `content_hash`.
        ground: As its module drew it, before materials displaced it.
        stage_seed: What its material is drawn from.
        asset_seed: What its things are drawn from.
        assets_sha256: Of the configuration of assets, without which they would be others.
        asset_metadata: What was set of assets when the batch began.
    """

    stage_hash: str
    ground: Ground
    stage_seed: int
    asset_seed: int
    assets_sha256: str
    asset_metadata: Mapping[str, Any] = field(default_factory=dict)


def content_hash(ground: Ground) -> str:
    """Return a hash that two grounds share only if they are the same surface."""
    if isinstance(ground, HeightField):
        arrays: tuple[NDArray[Any], ...] = (ground.elevation_m,)
        shape = repr((ground.elevation_m.shape, ground.origin_xy_m, ground.spacing_m))
    else:
        arrays = (ground.vertices_m(), ground.triangles())
        shape = repr([array.shape for array in arrays])
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(np.ascontiguousarray(array).tobytes())
    digest.update(shape.encode())
    return digest.hexdigest()


def save_stage(path: Path, record: StageRecord) -> None:
    """Write a stage; another process never sees half of it. Inverse: `load_stage`.

    Raises:
        InvalidInputError: It cannot be written there.
    """
    text = json.dumps(
        {
            "format": FORMAT,
            "hash": record.stage_hash,
            # JSON readers elsewhere may round whole numbers beyond 2**53.
            "stage_seed": str(record.stage_seed),
            "asset_seed": str(record.asset_seed),
            "assets_sha256": record.assets_sha256,
            "asset_metadata": dict(record.asset_metadata),
        }
    )
    partial = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with partial.open("wb") as file:
            np.savez_compressed(file, record=np.array(text), **_arrays(record.ground))
        partial.replace(path)
    except OSError as error:
        partial.unlink(missing_ok=True)
        raise InvalidInputError("stage.store", str(path), f"a place to write ({error})") from error


def load_stage(path: Path, field: str = "stage.reuse.file") -> StageRecord:
    """Return the stage in a file, checked against its hash.

    Raises:
        InvalidInputError: It is not such a file, or is damaged.
    """
    expected = "a stage that stage.store kept"
    try:
        with np.load(path, allow_pickle=False) as arrays:
            found = dict(arrays)
        data = json.loads(str(found["record"]))
        if data["format"] != FORMAT:
            raise InvalidInputError(field, data["format"], f"a stage of format {FORMAT}")
        record = StageRecord(
            stage_hash=data["hash"],
            ground=_ground(found),
            stage_seed=int(data["stage_seed"]),
            asset_seed=int(data["asset_seed"]),
            assets_sha256=data["assets_sha256"],
            asset_metadata=data["asset_metadata"],
        )
    except (OSError, KeyError, TypeError, ValueError, zipfile.BadZipFile) as error:
        raise InvalidInputError(field, str(path), f"{expected} ({error!r})") from error
    if content_hash(record.ground) != record.stage_hash:
        raise InvalidInputError(field, str(path), f"{expected} (its hash is another)")
    return record


def _arrays(ground: Ground) -> dict[str, Any]:
    if isinstance(ground, HeightField):
        grid = np.array([*ground.origin_xy_m, ground.spacing_m], np.float64)
        return {"elevation_m": ground.elevation_m, "grid": grid}
    return {"points_m": ground.vertices_m(), "corners": ground.triangles()}


def _ground(arrays: Mapping[str, Any]) -> Ground:
    if "elevation_m" in arrays:
        x0, y0, spacing_m = (float(value) for value in arrays["grid"])
        return HeightField(arrays["elevation_m"], (x0, y0), spacing_m)
    return MeshGround(arrays["points_m"], arrays["corners"])
