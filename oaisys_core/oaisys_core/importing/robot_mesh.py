"""The visuals of a robot as one mesh in the frame of its base, joints at zero."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from oaisys_core.errors import BackendUnavailableError, InvalidInputError
from oaisys_core.files.calibrations.robots import Robot, Shape, Visual
from oaisys_core.files.calibrations.robots.resources import MeshResources
from oaisys_core.files.references import allow_references
from oaisys_core.procedural.meshes.files import R_Z_UP_FROM_Y_UP, load_mesh
from oaisys_core.procedural.meshes.loaded import LoadedMesh, merge_parts
from oaisys_core.scene import MeshMaterial
from oaisys_core.types import FloatArray

ROUND_SIDES, SPHERE_DIVISIONS = 48, 3
GREY = (0.5, 0.5, 0.5)
MOST_VISUALS = 2000

TURNS = {
    "X_UP": np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]),
    "Y_UP": R_Z_UP_FROM_Y_UP,
}
"""How Blender turns COLLADA files with such an axis, without which it takes y, to z up."""

_UP_AXIS = re.compile(rb"<up_axis>\s*([XYZ]_UP)\s*</up_axis>")
_HEADER_BYTES = 65_536


def robot_mesh(
    robot: Robot, file: Path, packages: Sequence[Path] = ()
) -> tuple[LoadedMesh | None, list[str]]:
    """Return the visuals of a robot as one mesh, and notes about those that are left out.

    A mesh's own colours count; one without any has that of its visual.

    Args:
        robot: It.
        file: Its file, from which paths start.
        packages: Folders that are packages or models, or contain them.

    Raises:
        InvalidInputError: It has more than `MOST_VISUALS` visuals.
    """
    if len(robot.visuals) > MOST_VISUALS:
        raise InvalidInputError("robot.visuals", len(robot.visuals), f"at most {MOST_VISUALS}")
    meshes = _Meshes(MeshResources(file, packages))
    parts, notes = [], []
    for visual in robot.visuals:
        try:
            parts.append(_part(visual, meshes))
        except (InvalidInputError, BackendUnavailableError) as error:
            notes.append(f"not shown: {error}")
    merged = merge_parts(robot.name, parts) if parts else None
    return merged, list(dict.fromkeys(notes))


class _Meshes:
    """The meshes of files, each read once."""

    def __init__(self, resources: MeshResources) -> None:
        self._resources = resources
        self._found: dict[tuple[str, str | None], LoadedMesh | Exception] = {}

    def load(self, shape: Shape) -> LoadedMesh:
        """Return the mesh of a shape in its own units, z up."""
        key = (shape.uri, shape.object_name)
        if key not in self._found:
            try:
                path, root = self._resources.find(shape.uri)
                with allow_references(root):
                    found = load_mesh(path, shape.object_name, "robot.mesh")
                self._found[key] = _without_up_axis(found, path)
            except (InvalidInputError, BackendUnavailableError) as error:
                self._found[key] = error
        known = self._found[key]
        if isinstance(known, Exception):
            raise known
        return known


def _without_up_axis(mesh: LoadedMesh, path: Path) -> LoadedMesh:
    """Return the mesh of a COLLADA file in the file's axes, as RViz and Gazebo take them."""
    if path.suffix.lower() != ".dae":
        return mesh
    with path.open("rb") as file:
        found = _UP_AXIS.search(file.read(_HEADER_BYTES))
    turn = TURNS.get("Y_UP" if found is None else found[1].decode())
    return mesh if turn is None else replace(mesh, vertices_m=mesh.vertices_m @ turn)


def _part(visual: Visual, meshes: _Meshes) -> LoadedMesh:
    shape = visual.shape
    is_mesh = shape.kind == "mesh"
    mesh = meshes.load(shape) if is_mesh else _primitive(shape)
    if not mesh.materials and mesh.vertex_colors_srgb is None:
        color = MeshMaterial(visual.where, color_srgb=visual.color_srgb or GREY)
        mesh = replace(mesh, materials=(color,))
    scale = np.array(shape.size_m if is_mesh else (1.0, 1.0, 1.0))
    return _place(mesh, visual.T_base_visual, scale)


def _place(mesh: LoadedMesh, T: FloatArray, scale: FloatArray) -> LoadedMesh:
    """Return a scaled mesh at a pose; one that is mirrored keeps its outside outside."""
    vertices_m = (mesh.vertices_m.astype(np.float64) * scale) @ T[:3, :3].T + T[:3, 3]
    triangles, uv = mesh.triangles, mesh.uv
    if np.prod(scale) < 0:
        triangles = np.ascontiguousarray(triangles[:, ::-1])
        uv = None if uv is None else np.ascontiguousarray(uv[:, ::-1])
    return replace(mesh, vertices_m=vertices_m, triangles=triangles, uv=uv)


def _primitive(shape: Shape) -> LoadedMesh:
    from trimesh import creation

    size = shape.size_m
    if shape.kind == "box":
        found = creation.box(size)
    elif shape.kind == "cylinder":
        found = creation.cylinder(size[0], size[1], ROUND_SIDES)
    elif shape.kind == "capsule":
        found = creation.capsule(size[1], size[0], (ROUND_SIDES, ROUND_SIDES))
        found.vertices[:, 2] -= found.bounds[:, 2].mean()
    else:
        found = creation.icosphere(SPHERE_DIVISIONS)
        found.vertices *= size if shape.kind == "ellipsoid" else size[0]
    return LoadedMesh(
        shape.kind,
        np.asarray(found.vertices, np.float64),
        np.asarray(found.faces, np.int32),
    )
