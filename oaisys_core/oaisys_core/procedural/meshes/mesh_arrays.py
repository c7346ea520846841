"""A loaded mesh as named arrays, which the process that reads files of Blender writes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from oaisys_core.procedural.meshes.checks import Float32Step
from oaisys_core.procedural.meshes.loaded import LoadedMesh
from oaisys_core.scene import MeshMaterial, Wrap

OPTIONAL = ("uv", "vertex_colors_srgb", "material_of")
WRAPS: tuple[Wrap, ...] = ("repeat", "clamp", "mirror")


def mesh_to_arrays(mesh: LoadedMesh) -> dict[str, NDArray[Any]]:
    """Return a mesh as arrays by name, without objects of Python; inverse: `mesh_from_arrays`."""
    found = {"vertices_m": mesh.vertices_m, "triangles": mesh.triangles}
    found["float32"] = np.array(mesh.float32, np.float64)
    for name in OPTIONAL:
        if (values := getattr(mesh, name)) is not None:
            found[name] = values
    materials = mesh.materials
    found["material_names"] = np.array([each.name for each in materials], dtype=np.str_)
    found["material_colors"] = np.array([each.color_srgb for each in materials], np.float64)
    found["material_cutoffs"] = np.array([each.cutoff for each in materials], np.float64)
    wraps = [[WRAPS.index(along) for along in each.wrap] for each in materials]
    found["material_wraps"] = np.array(wraps, np.int64)
    for index, material in enumerate(materials):
        if material.color_image_srgb is not None:
            found[f"image_{index}"] = material.color_image_srgb
        if material.opacity is not None:
            found[f"opacity_{index}"] = material.opacity
    return found


def mesh_from_arrays(name: str, arrays: Mapping[str, NDArray[Any]]) -> LoadedMesh:
    """Return the mesh of `mesh_to_arrays`, under another name."""
    materials = []
    for index, own in enumerate(arrays["material_names"].tolist()):
        red, green, blue = arrays["material_colors"][index].tolist()
        along_u, along_v = (WRAPS[number] for number in arrays["material_wraps"][index])
        materials.append(
            MeshMaterial(
                own,
                (red, green, blue),
                arrays.get(f"image_{index}"),
                arrays.get(f"opacity_{index}"),
                float(arrays["material_cutoffs"][index]),
                cast("tuple[Wrap, Wrap]", (along_u, along_v)),
            )
        )
    optional = {key: arrays[key] for key in OPTIONAL if key in arrays}
    return LoadedMesh(
        name,
        arrays["vertices_m"],
        arrays["triangles"],
        materials=tuple(materials),
        float32=Float32Step(*arrays["float32"].tolist()),
        **optional,
    )
