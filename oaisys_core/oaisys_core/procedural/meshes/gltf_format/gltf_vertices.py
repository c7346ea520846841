"""Vertices of glTF primitives: attributes, morph targets and skins (glTF 2.0, §3.7.2, §3.7.3)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.geometry import transform_points
from oaisys_core.procedural.meshes.checks import NOT_COARSE, Float32Step, float32_step
from oaisys_core.procedural.meshes.gltf_format.gltf_accessors import Accessors
from oaisys_core.procedural.meshes.gltf_format.gltf_nodes import poses_of_nodes
from oaisys_core.types import FloatArray

TYPES = {
    "POSITION": ("VEC3",),
    "TEXCOORD": ("VEC2",),
    "COLOR": ("VEC3", "VEC4"),
    "JOINTS": ("VEC4",),
    "WEIGHTS": ("VEC4",),
}
"""What accessors of attributes hold, by their names without the number."""

SHARES = ("COLOR", "WEIGHTS")
"""Attributes from 0 to 1, whose integers are normalised."""

FLOAT = 5126
"""Component type of float32."""
TOLERANCE = 0.001
"""Colours may be rounded up in their last digit."""

BLOCK = 100_000
"""Vertices that are posed at once."""


class Vertices:
    """The vertices of a primitive."""

    def __init__(
        self,
        document: Mapping[str, Any],
        accessors: Accessors,
        primitive: Mapping[str, Any],
        weights: Sequence[float] | None,
        where: str,
    ) -> None:
        """Check the attributes.

        Args:
            document: The file's JSON, checked.
            accessors: Of the document.
            primitive: With POSITION.
            weights: Of the morph targets; None: all are 0.
            where: Names the mesh in errors.

        Raises:
            ValueError: An attribute has another number of elements than POSITION, or another type.
        """
        self._document, self._accessors, self._where = document, accessors, where
        self._attributes: Mapping[str, int] = primitive["attributes"]
        self._targets: Sequence[Mapping[str, int]] = primitive.get("targets") or ()
        given = weights if weights and self._targets else [0.0] * len(self._targets)
        self._weights = np.array(given, np.float64)
        if self._weights.shape != (len(self._targets),) or not np.isfinite(self._weights).all():
            expected = f"{len(self._targets)} weights, one of each morph target"
            raise ValueError(f"{expected}, not {len(self._weights)}: {where}")
        entries = document["accessors"]
        count = entries[self._attributes["POSITION"]]["count"]
        for group in (self._attributes, *self._targets):
            for name, index in group.items():
                if entries[index]["count"] != count:
                    expected = f"as many elements of {name} as of POSITION, {count}"
                    raise ValueError(f"{expected}, not {entries[index]['count']}: {where}")
                self._check_type(name, entries[index])

    def floats(self, name: str) -> FloatArray | None:
        """Return the (V, C) numbers of an attribute, with its morph targets; None: it has none."""
        if name not in self._attributes:
            return None
        found = self._accessors.floats(self._attributes[name])
        for weight, target in zip(self._weights, self._targets, strict=True):
            if weight and name in target:
                more = self._accessors.floats(target[name])
                found[:, : more.shape[1]] += weight * more
        return found

    def colors(self) -> FloatArray | None:
        """Return the (V, 3) linear colours of ``COLOR_0``; None: there are none.

        Raises:
            ValueError: They are not from 0 to 1.
        """
        found = self.floats("COLOR_0")
        if found is None:
            return None
        found = found[:, :3]
        bad = ~((found >= -TOLERANCE) & (found <= 1 + TOLERANCE)).all(axis=1)
        # The standard clamps what morph targets have changed.
        if bad.any() and not self._weights.any():
            shown = ", ".join(f"{value:g}" for value in found[bad][0])
            raise ValueError(
                f"COLOR_0 from 0 to 1, not ({shown}): {self._where}, vertex {int(np.argmax(bad))}"
            )
        return found.clip(0, 1)

    def points(self, T: FloatArray, joints: FloatArray | None) -> tuple[FloatArray, bool]:
        """Return the (V, 3) vertices in the scene, and whether they are mirrored.

        Args:
            T: (4, 4) pose of the node, which counts only without a skin.
            joints: (J, 4, 4) poses of the skin's joints, see `Skins`; None: it has no skin.

        Raises:
            ValueError: It lacks joints or weights, or they are of no joint.
        """
        found = self.floats("POSITION")
        assert found is not None
        if joints is None:
            return transform_points(T, found), bool(np.linalg.det(T[:3, :3]) < 0)
        of_vertex, weights = self._influences(len(joints))
        # Of the joint that counts most, for one winding.
        main = joints[of_vertex[np.arange(len(found)), weights.argmax(axis=1)], :3, :3]
        mirrored = bool(np.median(np.linalg.det(main)) < 0) if len(main) else False
        for first in range(0, len(found), BLOCK):
            rows = slice(first, first + BLOCK)
            pose = np.einsum("vk,vkij->vij", weights[rows], joints[of_vertex[rows]])
            found[rows] = np.einsum("vij,vj->vi", pose[:, :3, :3], found[rows]) + pose[:, :3, 3]
        return found, mirrored

    def float32_step(self, poses: FloatArray, triangles: NDArray[Any]) -> Float32Step:
        """Return how fine POSITION is in the scene, under one or several (..., 4, 4) poses."""
        index = self._attributes["POSITION"]
        if self._document["accessors"][index]["componentType"] != FLOAT:
            return NOT_COARSE
        scale = np.linalg.norm(poses.reshape(-1, 4, 4)[:, :3, :3], ord=2, axis=(1, 2)).max()
        return float32_step(self._accessors.floats(index), triangles, float(scale))

    def _influences(self, count: int) -> tuple[NDArray[np.int64], FloatArray]:
        """Return the (V, K) joints of each vertex, and their weights, whose sum is 1."""
        sets = [name.partition("_")[2] for name in self._attributes if name.startswith("JOINTS_")]
        missing = [each for each in sets or ["0"] if f"WEIGHTS_{each}" not in self._attributes]
        if missing or not sets:
            raise ValueError(
                f"JOINTS_n and WEIGHTS_n, which a node with a skin needs: {self._where}"
            )
        joints = [self._accessors.floats(self._attributes[f"JOINTS_{each}"]) for each in sets]
        weights = [self._accessors.floats(self._attributes[f"WEIGHTS_{each}"]) for each in sets]
        of_vertex, of_joint = np.concatenate(joints, axis=1), np.concatenate(weights, axis=1)
        total = of_joint.sum(axis=1, keepdims=True)
        bad = ~((of_joint >= 0).all(axis=1, keepdims=True) & (total > 0) & (total < np.inf))
        if bad.any():
            row = int(np.argmax(bad))
            expected = f"weights of 0 or more, and not all 0: {self._where}, vertex {row}"
            raise ValueError(expected)
        of_vertex = np.where(of_joint > 0, of_vertex, 0)
        if len(of_vertex) and of_vertex.max() >= count:
            most = int(of_vertex.max())
            raise ValueError(f"joints below {count}, as its skin has, not {most}: {self._where}")
        return of_vertex.astype(np.int64), of_joint / total

    def _check_type(self, name: str, accessor: Mapping[str, Any]) -> None:
        kind = name.partition("_")[0]
        if kind not in TYPES:
            return
        if accessor["type"] not in TYPES[kind]:
            expected = f"{name} of type {' or '.join(TYPES[kind])}"
            raise ValueError(f"{expected}, not {accessor['type']}: {self._where}")
        is_plain = accessor["componentType"] != FLOAT and not accessor.get("normalized")
        if kind in SHARES and is_plain:
            raise ValueError(f"{name} of floats or normalized integers: {self._where}")


class Skins:
    """The skins of a document."""

    def __init__(self, document: Mapping[str, Any], accessors: Accessors) -> None:
        """Take a document that has been checked, and read its skins when they are asked for."""
        self._document, self._accessors = document, accessors
        self._nodes: Mapping[int, FloatArray] = {}

    def poses(self, index: int) -> FloatArray:
        """Return the (J, 4, 4) matrices of a skin's joints, from the mesh to the scene.

        That is the joint's global pose times its inverse bind matrix: without animation the mesh
        stands as it was bound, and the pose of its own node counts for nothing.

        Raises:
            ValueError: A matrix is missing, or is none of a pose.
        """
        skin = self._document["skins"][index]
        joints = [int(joint) for joint in skin["joints"]]
        self._nodes = self._nodes or poses_of_nodes(self._document)
        found = np.array([self._nodes[joint] for joint in joints]).reshape(-1, 4, 4)
        if skin.get("inverseBindMatrices") is None:
            return found
        inverse = self._accessors.matrices(int(skin["inverseBindMatrices"]))
        if len(inverse) < len(joints):
            expected = f"an inverse bind matrix of each of {len(joints)} joints"
            raise ValueError(f"{expected}, not {len(inverse)}: skin {index}")
        if not np.allclose(inverse[:, 3], (0, 0, 0, 1), rtol=0, atol=1e-6):
            expected = "inverse bind matrices that end with 0, 0, 0, 1 in their last row"
            raise ValueError(f"{expected}: skin {index}")
        return np.asarray(found @ inverse[: len(joints)])
