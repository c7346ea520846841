"""Generated files that replace missing files of an original configuration."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path, PurePosixPath
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from oaisys_core import randomness
from oaisys_core.errors import InvalidInputError
from oaisys_core.procedural.scatter.shapes import make_shape
from oaisys_core.procedural.textures import default_cache_dir, texture_set

SEED = 0
MAP_PX = 512
LABELS_PX = 256
SKY_PX = (128, 256)
GROUND_M, GROUND_POINTS = 200.0, 201


class StandIns:
    """Makes files in a folder, at the relative paths of the missing ones."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder.resolve()

    def material(self, name: str, texture: str) -> Path:
        """Return a folder with the maps of a built-in texture set."""
        folder = self._place(name)
        folder.mkdir(parents=True, exist_ok=True)
        maps = texture_set(texture, MAP_PX, SEED, default_cache_dir())
        height = np.rint(maps.height * 65535).astype(np.uint16)
        for kind, image in (
            ("diff", maps.color_srgb[..., ::-1]),
            ("disp", height),
            ("nor_gl", maps.normal_gl[..., ::-1]),
            ("rough", maps.roughness),
        ):
            _write_image(folder / f"{folder.name}_{kind}.png", image)
        return folder

    def mesh(self, name: str, shape: str) -> Path:
        """Return an OBJ file with a built-in shape, 1 m large."""
        path = self._place(name).with_suffix(".obj")
        made = make_shape(shape, randomness.stream(SEED, f"stand_in/{shape}"))
        _write_mesh(path, made.vertices_m, made.triangles)
        return path

    def ground(self, name: str) -> Path:
        """Return an OBJ file with a ground of hills, 200 m large."""
        path = self._place(name).with_suffix(".obj")
        along_m = np.linspace(-GROUND_M / 2, GROUND_M / 2, GROUND_POINTS)
        x, y = np.meshgrid(along_m, along_m)
        z = 1.5 * np.sin(x / 9) * np.cos(y / 13) + 0.4 * np.sin(x / 3.1 + y / 4.3)
        first = np.arange(GROUND_POINTS**2).reshape(GROUND_POINTS, GROUND_POINTS)[:-1, :-1].ravel()
        right, up = first + 1, first + GROUND_POINTS
        triangles = [[first, right, up + 1], [first, up + 1, up]]
        _write_mesh(
            path,
            np.column_stack((x.ravel(), y.ravel(), z.ravel())),
            np.concatenate([np.column_stack(corners) for corners in triangles]),
        )
        return path

    def label_image(self, name: str, mapping: Mapping[str, Any]) -> Path:
        """Return an image with one stripe for each colour of a mapping."""
        colors = [tuple(bytes.fromhex(code.removeprefix("#"))) for code in mapping] or [(0, 0, 0)]
        stripes = np.arange(LABELS_PX) * len(colors) // LABELS_PX
        image = np.broadcast_to(
            np.array(colors, np.uint8)[stripes][None, :, ::-1], (LABELS_PX, LABELS_PX, 3)
        )
        path = self._place(name).with_suffix(".png")
        _write_image(path, image)
        return path

    def sky(self, name: str) -> Path:
        """Return a panorama that is brighter towards the horizon, above grey ground."""
        rows, columns = SKY_PX
        up = np.cos(np.pi * (np.arange(rows) + 0.5) / rows)[:, None, None]
        sky = 0.3 + 0.5 * (1 - np.abs(up)) * np.array((0.9, 0.8, 0.7))
        image = np.where(up > 0, sky, 0.15) * np.ones((rows, columns, 3))
        path = self._place(name).with_suffix(".hdr")
        _write_image(path, image.astype(np.float32))
        return path

    def _place(self, name: str) -> Path:
        """Return the path for a name, which is always inside the folder."""
        parts = [part for part in PurePosixPath(name).parts if part not in ("/", "..")]
        return self._folder.joinpath(*parts)


def _prepare(path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)


def _write_mesh(
    path: Path, vertices_m: NDArray[np.floating[Any]], triangles: NDArray[np.integer[Any]]
) -> None:
    """Write an OBJ file of (N, 3) vertices and (M, 3) indices."""
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in vertices_m.tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (triangles + 1).tolist()]
    _prepare(path)
    path.write_text("\n".join(["# stand-in", *lines, ""]), encoding="ascii")


def _write_image(path: Path, image: Any) -> None:
    _prepare(path)
    if not cv2.imwrite(str(path), np.ascontiguousarray(image)):
        raise InvalidInputError("--stand-ins", str(path), "a file that can be written")
