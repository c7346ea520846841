"""A shape to scatter: hexagonal crystals with a pointed tip."""

from __future__ import annotations

import numpy as np

from oaisys_core.scene import MeshPrototype


def crystal(rng: np.random.Generator) -> MeshPrototype:
    """Return a crystal 1 m high whose base's centre is the origin."""
    angles = np.arange(6) * np.pi / 3
    radii = rng.uniform(0.14, 0.22, 6)
    ring = np.stack((radii * np.cos(angles), radii * np.sin(angles)), axis=-1)
    shoulder_m = rng.uniform(0.6, 0.8)
    bottom = np.column_stack((ring, np.zeros(6)))
    top = np.column_stack((ring * 0.9, np.full(6, shoulder_m)))
    tip, foot = np.array([[0.0, 0.0, 1.0]]), np.zeros((1, 3))
    triangles = []
    for i in range(6):
        j = (i + 1) % 6
        triangles += [(i, j, 6 + j), (i, 6 + j, 6 + i), (6 + i, 6 + j, 12), (j, i, 13)]
    return MeshPrototype(
        name="crystal",
        vertices_m=np.concatenate((bottom, top, tip, foot)).astype(np.float32),
        triangles=np.array(triangles, np.int32),
        color_srgb=(0.55, 0.7, 0.85),
    )
