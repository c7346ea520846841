"""Stages stored in files, so that later batches and runs can use the same ground.

A file contains the ground and the seeds of its material and objects. With the same configuration,
drawing from these seeds again gives the same material and objects.
"""

from __future__ import annotations

import hashlib
import json
import secrets
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, ConfigDict, Strict

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.arrays import load_arrays
from oaisys_core.files.documents import MAX_TEXT_BYTES, DocumentError, parse_plain_json
from oaisys_core.files.numbers import whole_of
from oaisys_core.output.record_types import Sha256, check_as
from oaisys_core.procedural.terrain.ground_checks import check_grid, check_triangles
from oaisys_core.procedural.terrain.mesh_ground import MeshGround
from oaisys_core.scene import Ground, HeightField
from oaisys_core.system.ending.leftovers import remove_when_killed

FORMAT = 1

MAX_STAGE_BYTES = 1_000_000_000
"""Size of the arrays in a file; the largest mesh has half of that."""
SUFFIX = ".npz"

_EXPECTED = "a stage that stage.store wrote"


def _format(number: int) -> int:
    if number != FORMAT:
        raise ValueError(f"expected a stage of format {FORMAT}")
    return number


def _seed(digits: str) -> str:
    if whole_of(digits) is None:
        raise ValueError("expected a whole number from 0 to 2**63 - 1, as text")
    return digits


_SeedText = Annotated[str, Strict(), AfterValidator(_seed)]
"""Some JSON readers round integers beyond 2**53."""


@dataclass(frozen=True)
class _StageFields:
    """What a file says beside the ground."""

    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(extra="forbid")

    format: Annotated[int, Strict(), AfterValidator(_format)]
    hash: Sha256
    stage_seed: _SeedText
    asset_seed: _SeedText
    assets_sha256: Sha256 | Literal[""]
    asset_metadata: dict[str, Any]
    has_rock_walls: Annotated[bool, Strict()] = False


@dataclass(frozen=True)
class StageRecord:
    """A stage and the seeds of what was drawn on it.

    Attributes:
        stage_hash: Hash of the ground, see `content_hash`.
        ground: The ground before materials displace it.
        stage_seed: Seed of its material.
        asset_seed: Seed of its objects.
        assets_sha256: Hash of the asset configuration that the objects were drawn with; empty of a
            stage without objects.
        asset_metadata: Asset metadata at the start of the batch.
        has_rock_walls: Whether it is of a preset with walls of rock.
    """

    stage_hash: str
    ground: Ground
    stage_seed: int
    asset_seed: int
    assets_sha256: str
    asset_metadata: Mapping[str, Any] = field(default_factory=dict)
    has_rock_walls: bool = False


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
            "stage_seed": str(record.stage_seed),
            "asset_seed": str(record.asset_seed),
            "assets_sha256": record.assets_sha256,
            "asset_metadata": dict(record.asset_metadata),
            "has_rock_walls": record.has_rock_walls,
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
    """Return the stage in a file, which is checked as a new one is.

    Its hash says that it is whole, not that it is a stage: whoever changes a file can make another.

    Args:
        path: The file.
        field: Name of the field in errors.

    Raises:
        InvalidInputError: The file is not a stored stage, or is damaged.
    """
    try:
        arrays = load_arrays(path, MAX_STAGE_BYTES)
        data = parse_plain_json(_text(arrays))
        ground = _ground(arrays)
    except (OSError, ValueError) as error:
        raise InvalidInputError(field, str(path), f"{_EXPECTED} ({error})") from error
    found = check_as(_StageFields, data, f"{field}: {path.name}")
    if isinstance(ground, HeightField):
        check_grid(ground, path, field)
    else:
        check_triangles(ground, path, field)
    if content_hash(ground) != found.hash:
        raise InvalidInputError(field, str(path), f"{_EXPECTED} (its hash does not match)")
    return StageRecord(
        stage_hash=found.hash,
        ground=ground,
        stage_seed=int(found.stage_seed),
        asset_seed=int(found.asset_seed),
        assets_sha256=found.assets_sha256,
        asset_metadata=found.asset_metadata,
        has_rock_walls=found.has_rock_walls,
    )


def _arrays(ground: Ground) -> dict[str, Any]:
    if isinstance(ground, HeightField):
        grid = np.array([*ground.origin_xy_m, ground.spacing_m], np.float64)
        return {"elevation_m": ground.elevation_m, "grid": grid}
    return {"points_m": ground.vertices_m(), "corners": ground.triangles()}


def _text(arrays: Mapping[str, NDArray[Any]]) -> str:
    record = _array(arrays, "record")
    if record.dtype.kind != "U" or record.ndim or record.nbytes > 4 * MAX_TEXT_BYTES:
        found = f"{record.dtype.name} {record.shape}"
        raise DocumentError(f"its record is {found}, not a text of {MAX_TEXT_BYTES} characters")
    return str(record)


def _ground(arrays: Mapping[str, NDArray[Any]]) -> HeightField | MeshGround:
    if "elevation_m" not in arrays:
        return MeshGround(_array(arrays, "points_m"), _array(arrays, "corners"))
    grid = _array(arrays, "grid")
    if grid.dtype != np.float64 or grid.shape != (3,):
        found = f"{grid.dtype} {grid.shape}"
        raise DocumentError(f"its grid is {found}, not x, y and the spacing as float64")
    x0, y0, spacing_m = (float(value) for value in grid)
    return HeightField(_array(arrays, "elevation_m"), (x0, y0), spacing_m)


def _array(arrays: Mapping[str, NDArray[Any]], name: str) -> NDArray[Any]:
    """Return an array by its name, row by row in memory."""
    if name not in arrays:
        raise DocumentError(f"it has no {name}")
    return np.asarray(arrays[name], order="C")
