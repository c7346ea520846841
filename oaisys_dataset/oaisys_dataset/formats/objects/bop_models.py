"""The models of BOP: shapes in millimetres, and masks of whole objects cast at them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import OaisysError, RenderError
from oaisys_core.output.records import write_json
from oaisys_core.types import FloatArray, TriangleMesh
from oaisys_dataset.formats.base import write_file

if TYPE_CHECKING:
    from oaisys_dataset.manifest import DatasetInfo, FrameRecord
    from oaisys_dataset.objects import ObjectRow

SCALE_DIGITS = 9
"""Of the scale by which objects of one shape are told apart."""

MM = 1000.0


class BopModels:
    """Numbers the shapes of a data set and writes them; a context manager."""

    def __init__(self, info: DatasetInfo, target: Path, has_models: bool) -> None:
        """Write into ``models/`` of ``target``; without models, only their boxes."""
        self._info = info
        self._target = target
        self._has_models = has_models
        self._ids: dict[tuple[str, float], int] = {}
        self._infos: dict[str, Any] = {}
        self._objects: dict[str, Any] = {}
        self._world: int | None = None
        self._simulation: Any = None
        self._first_world = 0
        self._finder: Any = None
        self._open = ExitStack()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._open.close()

    def masks(
        self, record: FrameRecord, rows: Sequence[ObjectRow]
    ) -> Mapping[int, NDArray[np.bool_]]:
        """Return the (H, W) mask of each whole object of a frame by id; none without models.

        Raises:
            RenderError: The frame's world cannot be made again.
        """
        if not self._has_models:
            return {}
        self._rebuild(record)
        poses = {row.instance_id: _scaled(row) for row in rows}
        scene = self._simulation.scene
        found: Mapping[int, NDArray[np.bool_]] = self._finder.masks(
            scene, record.camera, record.pose, poses
        )
        return found

    def obj_id(self, record: FrameRecord, row: ObjectRow) -> int:
        """Return the number of an object's shape; a new one is written."""
        key = row.mesh_sha256, round(row.scale, SCALE_DIGITS)
        if key not in self._ids:
            self._ids[key] = len(self._ids) + 1
            self._add(str(self._ids[key]), row, record)
        return self._ids[key]

    def finish(self) -> int:
        """Write the tables of all models, and return their number."""
        (self._target / "models").mkdir(parents=True, exist_ok=True)
        write_json(self._target / "models/models_info.json", self._infos)
        write_json(self._target / "objects.json", self._objects)
        return len(self._ids)

    def _add(self, name: str, row: ObjectRow, record: FrameRecord) -> None:
        size_mm = MM * row.size_m
        self._infos[name] = {
            "diameter": MM * row.diameter_m,
            **{f"min_{axis}": -half for axis, half in zip("xyz", size_mm / 2, strict=True)},
            **{f"size_{axis}": size for axis, size in zip("xyz", size_mm, strict=True)},
        }
        self._objects[name] = {
            "label": row.label,
            "semantic_id": row.semantic_id,
            "mesh_sha256": row.mesh_sha256,
            "scale": row.scale,
            "first": {"frame_id": record.frame_id, "name": row.name},
        }
        if self._has_models:
            self._rebuild(record)
            mesh = self._finder.mesh(self._simulation.scene, row.instance_id)
            vertices_mm = MM * (mesh.vertices_m * row.scale - row.box_center_object_m)
            data = ply_text(TriangleMesh(vertices_mm, mesh.triangles))
            write_file(self._target, f"models/obj_{int(name):06d}.ply", data.encode())

    def _rebuild(self, record: FrameRecord) -> None:
        """Make the world of a frame again, unless it is there."""
        if self._world == record.world:
            return
        from oaisys_core.config import config_from_mapping
        from oaisys_core.raycast.objects.views import ObjectFinder
        from oaisys_core.render.analytic import AnalyticBackend
        from oaisys_core.simulation import Simulation
        from oaisys_core.world.batch import state_of

        try:
            part = self._info.part_of(record.world)
            if self._simulation is None or self._first_world != part.first_world:
                self._open.close()
                config = config_from_mapping(part.info.config)
                self._simulation = Simulation(config, AnalyticBackend())
                self._open.callback(self._simulation.close)
                self._first_world = part.first_world
                self._finder = ObjectFinder()
            self._simulation.restore(state_of(record.outline()))
        except OaisysError as error:
            text = f"its world cannot be made again for models: {error}; --set models=no needs none"
            raise RenderError(f"{record.frame_id}: {text}") from error
        self._world = record.world


def _scaled(row: ObjectRow) -> FloatArray:
    """Return the (4, 4) matrix from an object's shape at a scale of 1 to ``map``."""
    T = row.T_map_object.copy()
    T[:3, :3] *= row.scale
    return T


def ply_text(mesh: TriangleMesh) -> str:
    """Return an ASCII PLY file of a mesh with the normals of its vertices."""
    vertices, triangles = mesh.vertices_m, mesh.triangles
    a, b, c = (vertices[corner] for corner in triangles.T)
    across = np.cross(b - a, c - a)
    normals = np.zeros_like(vertices)
    for corner in triangles.T:
        np.add.at(normals, corner, across)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.divide(normals, lengths, out=normals, where=lengths > 0)
    head = (
        f"ply\nformat ascii 1.0\nelement vertex {len(vertices)}\n"
        + "".join(f"property float {name}\n" for name in ("x", "y", "z", "nx", "ny", "nz"))
        + f"element face {len(triangles)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    points = (" ".join(f"{v:.6g}" for v in line) for line in np.hstack((vertices, normals)))
    faces = (f"3 {i} {j} {k}" for i, j, k in triangles.tolist())
    return head + "\n".join((*points, *faces)) + "\n"
