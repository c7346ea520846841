"""The ways in which a report colours its mesh: as seen, by its error, by its classes."""

from __future__ import annotations

from collections.abc import Mapping

import matplotlib as mpl
import numpy as np

from oaisys_mapping.evaluation.metrics import Evaluation
from oaisys_mapping.mesh import ColoredMesh
from oaisys_mapping.report import pictures
from oaisys_mapping.report.mesh_viewer import Layer, nearest

IMAGE_SHADING = 0.3
"""How much light is drawn on top of what images already hold."""


def layers_of(mesh: ColoredMesh, evaluation: Evaluation, labels: Mapping[int, str]) -> list[Layer]:
    """Return the layers that a mesh has colours for."""
    note = "Colours from the images."
    layers = [Layer("colour", note, mesh.colors_rgb, IMAGE_SHADING), _errors(mesh, evaluation)]
    if mesh.class_ids is not None:
        ids = mesh.class_ids[None]
        note = "The class that the most views gave a place; its colour is that of the label images."
        layers.append(Layer("classes", note, pictures.semantic_picture(ids, labels)[0]))
    return layers


def _errors(mesh: ColoredMesh, evaluation: Evaluation) -> Layer:
    """Colour each vertex by the distance to the truth that was measured nearest to it."""
    limit_m = evaluation.metrics.voxel_size_m / 2
    place = nearest(evaluation.reconstruction.points_m, mesh.vertices_m)
    share = np.minimum(evaluation.reconstruction_distance_m[place] / limit_m, 1.0)
    colors_rgb = (mpl.colormaps["magma_r"](share)[:, :3] * 255).astype(np.uint8)
    far = f"half a voxel, {100 * limit_m:.3g} cm, and above (black)"
    note = f"Distance to the true surface, from 0 (pale) to {far}."
    return Layer("error", note, colors_rgb, 0.6)
