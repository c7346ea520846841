"""Nodes of glTF files: where they lie in the scene, and what they are called (glTF 2.0, §3.5)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import scipy

from oaisys_core.types import FloatArray

Node = tuple[int, FloatArray, tuple[int, ...]]
"""Index, pose in the scene, and ancestors."""


def nodes_with_meshes(document: Mapping[str, Any]) -> Iterator[Node]:
    """Yield each node of the scene that has a mesh."""
    nodes = document.get("nodes", [])
    scenes = document.get("scenes", [])
    roots = scenes[int(document.get("scene", 0))].get("nodes", []) if scenes else _roots(document)
    for index, T, above in _below(document, roots):
        if "mesh" in nodes[index]:
            yield index, T, above


def poses_of_nodes(document: Mapping[str, Any]) -> dict[int, FloatArray]:
    """Return the global (4, 4) pose of each node, whether or not it is in the scene."""
    return {index: T for index, T, _ in _below(document, _roots(document))}


def _roots(document: Mapping[str, Any]) -> list[int]:
    nodes = document.get("nodes", [])
    below = {child for node in nodes for child in node.get("children", ())}
    return [index for index in range(len(nodes)) if index not in below]


def _below(document: Mapping[str, Any], roots: list[int]) -> Iterator[Node]:
    nodes = document.get("nodes", [])
    left: list[Node] = [(int(index), np.eye(4), ()) for index in reversed(roots)]
    while left:
        index, T_parent, above = left.pop()
        node = nodes[index]
        T = T_parent @ _pose(node)
        yield index, T, above
        children = reversed(node.get("children", ()))
        left.extend((int(child), T, (*above, index)) for child in children)


def _pose(node: Mapping[str, Any]) -> FloatArray:
    if "matrix" in node:
        T = np.array(node["matrix"], np.float64).reshape(4, 4).T
        if not np.allclose(T[3], (0, 0, 0, 1), rtol=0, atol=1e-6):
            raise ValueError("a node's matrix must end with 0, 0, 0, 1 in its last row")
        return T
    T = np.eye(4)
    R = scipy.spatial.transform.Rotation.from_quat(
        np.array(node.get("rotation", (0, 0, 0, 1)), np.float64)
    ).as_matrix()
    T[:3, :3] = R * np.array(node.get("scale", (1, 1, 1)), np.float64)
    T[:3, 3] = node.get("translation", (0, 0, 0))
    return T


def node_name(document: Mapping[str, Any], index: int) -> str:
    """Return the name of a node, or that of its mesh."""
    node = document["nodes"][index]
    mesh = document["meshes"][node["mesh"]] if "mesh" in node else {}
    return str(node.get("name") or mesh.get("name") or f"node {index}")
