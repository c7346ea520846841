"""Colours and cut-outs of meshes at points on their triangles."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from oaisys_core.color import linear
from oaisys_core.scene import MeshMaterial, MeshPrototype, Wrap
from oaisys_core.types import FloatArray

LINEAR: FloatArray = linear(np.arange(256) / 255)
"""Linear values of bytes in sRGB."""


class MeshTextures:
    """The materials of a prototype, looked up by triangle and point."""

    def __init__(self, prototype: MeshPrototype) -> None:
        self._prototype = prototype
        self._materials = prototype.image_materials

    @property
    def has_any(self) -> bool:
        """Whether there are materials; without them a prototype has one colour for this."""
        return bool(self._materials)

    @property
    def has_cut_outs(self) -> bool:
        """Whether rays may go through some of its triangles."""
        return any(each.opacity is not None for each in self._materials)

    def is_solid(self, triangles: NDArray[np.int64], points_m: FloatArray) -> NDArray[np.bool_]:
        """Return (N,) whether there is a surface at (N, 3) points on (N,) triangles.

        Args:
            triangles: Indices.
            points_m: In the prototype's frame.
        """
        solid = np.ones(len(triangles), np.bool_)
        which = self._material_of(triangles)
        for index, material in enumerate(self._materials):
            rows = np.flatnonzero(which == index)
            if material.opacity is None or not len(rows):
                continue
            uv = self._uv_at(triangles[rows], self._shares(triangles[rows], points_m[rows]))
            values = interpolate(material.opacity[..., None].astype(np.float64), uv, material.wrap)
            solid[rows] = values[:, 0] >= material.cutoff
        return solid

    def albedo(self, triangles: NDArray[np.int64], points_m: FloatArray) -> FloatArray:
        """Return the (N, 3) linear albedo likewise."""
        shares = self._shares(triangles, points_m)
        albedo = np.ones((len(triangles), 3))
        which = self._material_of(triangles)
        for index, material in enumerate(self._materials):
            rows = np.flatnonzero(which == index)
            if len(rows):
                albedo[rows] = self._of_material(material, triangles[rows], shares[rows])
        colors = self._prototype.vertex_colors_srgb
        if colors is not None and self._prototype.materials:
            corners = LINEAR[colors[self._prototype.triangles[triangles]]]
            albedo *= np.einsum("nc,nci->ni", shares, corners)
        return albedo

    def _of_material(
        self, material: MeshMaterial, triangles: NDArray[np.int64], shares: FloatArray
    ) -> FloatArray:
        if material.color_image_srgb is None:
            return linear(material.color_srgb)
        uv = self._uv_at(triangles, shares)
        return interpolate(material.color_image_srgb, uv, material.wrap, LINEAR)

    def _material_of(self, triangles: NDArray[np.int64]) -> NDArray[np.int64]:
        if self._prototype.material_of is None:
            return np.zeros(len(triangles), np.int64)
        return self._prototype.material_of[triangles].astype(np.int64)

    def _uv_at(self, triangles: NDArray[np.int64], shares: FloatArray) -> FloatArray:
        if self._prototype.uv is None:
            return np.zeros((len(triangles), 2))
        return np.asarray(np.einsum("nc,nci->ni", shares, self._prototype.uv[triangles]))

    def _shares(self, triangles: NDArray[np.int64], points_m: FloatArray) -> FloatArray:
        """Return (N, 3) barycentric coordinates of points on triangles."""
        corners = self._prototype.triangles[triangles]
        a, b, c = (self._prototype.vertices_m[each].astype(np.float64) for each in corners.T)
        u, v, w = b - a, c - a, points_m - a
        uu, uv, vv = (np.einsum("ni,ni->n", *pair) for pair in ((u, u), (u, v), (v, v)))
        wu, wv = np.einsum("ni,ni->n", w, u), np.einsum("ni,ni->n", w, v)
        area = uu * vv - uv * uv
        area[area <= 0] = np.inf
        second, third = (vv * wu - uv * wv) / area, (uu * wv - uv * wu) / area
        # The point may lie outside by a rounding error.
        second, third = np.clip(second, 0, 1), np.clip(third, 0, 1)
        return np.stack((1 - second - third, second, third), axis=1)


def interpolate(
    image: NDArray[np.generic],
    uv: FloatArray,
    wrap: tuple[Wrap, Wrap],
    values: FloatArray | None = None,
) -> FloatArray:
    """Return (N, C) values of an image at (N, 2) texture coordinates, as Cycles does.

    They are interpolated linearly between the centres of pixels.

    Args:
        image: (H, W, C), row 0 on top, where v is 1.
        uv: Coordinates.
        wrap: How the image goes on, along u and v.
        values: Of bytes; None: the image's own.
    """
    places = []
    for axis, size in ((0, image.shape[1]), (1, image.shape[0])):
        at = _wrap(uv[:, axis], wrap[axis], size) * size - 0.5
        first = np.floor(at)
        index = first.astype(np.int64)
        places.append((index % size, (index + 1) % size, (at - first)[:, None]))
    (left, right, x), (low, high, y) = places
    last = image.shape[0] - 1
    corners = [image[last - row, column] for row in (low, high) for column in (left, right)]
    a, b, c, d = corners if values is None else (values[corner] for corner in corners)
    return np.asarray((1 - y) * ((1 - x) * a + x * b) + y * ((1 - x) * c + x * d))


def _wrap(at: FloatArray, wrap: Wrap, size: int) -> FloatArray:
    """Return coordinates from 0 to 1 at which an image that repeats shows the same."""
    if wrap == "repeat":
        return np.asarray(at - np.floor(at))
    if wrap == "mirror":
        at = 1 - np.abs(at - 2 * np.floor(at / 2) - 1)
    return np.asarray(np.clip(at, 0.5 / size, 1 - 0.5 / size))
