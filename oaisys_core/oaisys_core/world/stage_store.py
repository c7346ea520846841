"""Stages stored in files, so that later batches and runs can use the same ground.

A file contains the ground and the seeds of its material and objects. With the same configuration,
drawing from these seeds again gives the same material and objects.
"""

from __future__ import annotations

import hashlib
import json
import secrets
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import InvalidInputError, quote
from oaisys_core.files.arrays import load_arrays
from oaisys_core.files.documents import parse_json
from oaisys_core.procedural.terrain.mesh_ground import MeshGround
from oaisys_core.scene import Ground, HeightField
from oaisys_core.system.ending.leftovers import remove_when_killed

FORMAT = 1

MAX_STAGE_BYTES = 4_000_000_000
"""Size of the arrays in a file."""
SUFFIX = ".npz"


@dataclass(frozen=True)
class StageRecord:
    """A stage and the seeds of what was drawn on it.

    Attributes:
        stage_hash: Hash of the ground, see `content_hash`.
        ground: The ground before materials displace it.
        stage_seed: Seed of its material.
        asset_seed: Seed of its objects.
        assets_sha256: Hash of the asset configuration that the objects were drawn with.
        asset_metadata: Asset metadata at the start of the batch.
    """

    stage_hash: str
    ground: Ground
    stage_seed: int
    asset_seed: int
    assets_sha256: str
    asset_metadata: Mapping[str, Any] = field(default_factory=dict)


def content_hash(ground: Ground) -> str:
    """Return a hash of the surface: only identical grounds have the same one."""
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
    """Write a stage atomically; inverse: `load_stage`.

    Raises:
        InvalidInputError: The file cannot be written.
    """
    text = json.dumps(
        {
            "format": FORMAT,
            "hash": record.stage_hash,
            # Some JSON readers round integers beyond 2**53.
            "stage_seed": str(record.stage_seed),
            "asset_seed": str(record.asset_seed),
            "assets_sha256": record.assets_sha256,
            "asset_metadata": dict(record.asset_metadata),
        }
    )
    partial = path.with_name(f".{path.name}.{secrets.token_hex(8)}")  # nobody can foresee it
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with remove_when_killed(partial), partial.open("xb") as file:
            np.savez_compressed(file, record=np.array(text), **_arrays(record.ground))
            partial.replace(path)
    except OSError as error:
        partial.unlink(missing_ok=True)
        raise InvalidInputError("stage.store", str(path), f"a place to write ({error})") from error


def load_stage(path: Path, field: str = "stage.reuse.file") -> StageRecord:
    """Return the stage in a file, after checking its hash.

    Raises:
        InvalidInputError: The file is not a stored stage, or is damaged.
    """
    expected = "a stage that stage.store wrote"
    try:
        found = load_arrays(path, MAX_STAGE_BYTES)
        data = parse_json(str(found["record"]))
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
        raise InvalidInputError(field, str(path), f"{expected} ({quote(error)})") from error
    if content_hash(record.ground) != record.stage_hash:
        raise InvalidInputError(field, str(path), f"{expected} (its hash does not match)")
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
