"""nerfstudio: ``transforms.json`` for each world, with images, depth and points."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from oaisys_core.geometry import T_OPTICAL_BLENDER
from oaisys_core.output.records import write_json
from oaisys_core.types import DEPTH, RGB, PinholeIntrinsics
from oaisys_dataset.formats.base import (
    DatasetFormat,
    ExportOptions,
    FormatConventions,
    write_file,
)
from oaisys_dataset.formats.reconstruction.colmap_model import PIXEL_CENTRE_PX
from oaisys_dataset.formats.reconstruction.depth_points import (
    POINTS_PER_VIEW,
    DepthPoints,
    world_points,
)
from oaisys_dataset.formats.trajectories.sequences import (
    LOST_DEPTH,
    worlds_with_color,
    write_depth_png,
)
from oaisys_dataset.records import world_name

if TYPE_CHECKING:
    from oaisys_dataset.manifest import FrameRecord
    from oaisys_dataset.reader import Dataset

UNITS_PER_M = 1000.0
"""nerfstudio reads depth in millimetres unless it is told otherwise."""

CONVENTIONS = FormatConventions(
    layout="""\
`world_000012/` is a scene for each world.

| file | holds |
|---|---|
| `transforms.json` | intrinsics, and for each frame its files and its pose |
| `images/FRAME.png` | colour |
| `depth/FRAME.png` | depth in 16 bits |
| `points3D.ply` | coloured points of the true surface, with which splatting begins |""",
    reading="""\
```bash
ns-train splatfacto --data world_000000
```""",
    camera_axes="x right, y up, z *backward* (OpenGL, Blender); negate y and z for OpenCV's",
    poses="`transform_matrix` takes points from the camera's frame (OpenGL's axes) to `map`",
    pixels="the upper left corner of the image is (0, 0), the centre of the first pixel "
    "(0.5, 0.5): half a pixel is added to `cx` and `cy`",
    depth="planar z in millimetres (`depth_unit_scale_factor` 0.001, nerfstudio's default)",
    no_hit="0; so does depth beyond 65.5 m. Such pixels are counted below",
    labels="not in this format",
)


class NerfstudioFormat(DatasetFormat):
    """Colour, depth and poses as nerfstudio's ``transforms.json``, world by world."""

    name = "nerfstudio"
    modalities = (RGB, DEPTH)
    images_beside = (DEPTH,)
    settings = MappingProxyType(
        {"points_per_view": f"points drawn from each depth image; {POINTS_PER_VIEW}"}
    )
    conventions = CONVENTIONS

    def images_needed(self, options: ExportOptions) -> tuple[str, ...]:
        """See `DatasetFormat.images_needed`."""
        return (RGB,)

    def write(self, dataset: Dataset, target: Path, options: ExportOptions) -> Mapping[str, int]:
        """See `DatasetFormat.write`."""
        points_per_view = options.count("points_per_view", POINTS_PER_VIEW, least=1)
        counts: Counter[str] = Counter()
        for world, frames in worlds_with_color(dataset.records):
            folder = target / world_name(world)
            for record in frames:
                files = dataset.files(record)
                write_file(folder, _file("images", record), files[RGB])
                if DEPTH in files:
                    name = _file("depth", record)
                    lost = write_depth_png(folder, name, record, files[DEPTH], UNITS_PER_M)
                    counts[LOST_DEPTH] += lost
                counts["frames"] += 1
                options.progress(counts["frames"])
            points = world_points(dataset, frames, points_per_view)
            write_file(folder, "points3D.ply", _ply(points))
            write_json(folder / "transforms.json", _transforms(frames))
            counts["points"] += len(points.points_m)
            counts["worlds"] += 1
        return counts


def _transforms(records: list[FrameRecord]) -> dict[str, Any]:
    """Return ``transforms.json``; each frame has its own intrinsics if they differ."""
    cameras = [_camera(record.camera) for record in records]
    is_one = all(camera == cameras[0] for camera in cameras)
    frames = [
        _frame(record) | ({} if is_one else camera)
        for record, camera in zip(records, cameras, strict=True)
    ]
    head = {"camera_model": "OPENCV", "ply_file_path": "points3D.ply"}
    return head | (cameras[0] if is_one else {}) | {"frames": frames}


def _camera(intrinsics: PinholeIntrinsics) -> dict[str, float]:
    k1, k2, p1, p2, k3 = intrinsics.distortion or (0.0,) * 5
    return {
        "w": intrinsics.width_px,
        "h": intrinsics.height_px,
        "fl_x": intrinsics.fx_px,
        "fl_y": intrinsics.fy_px,
        "cx": intrinsics.cx_px + PIXEL_CENTRE_PX,
        "cy": intrinsics.cy_px + PIXEL_CENTRE_PX,
        "k1": k1,
        "k2": k2,
        "k3": k3,
        "p1": p1,
        "p2": p2,
    }


def _frame(record: FrameRecord) -> dict[str, Any]:
    T_map_opengl = record.pose @ T_OPTICAL_BLENDER
    depth = {"depth_file_path": _file("depth", record)} if DEPTH in record.images else {}
    pose = {"transform_matrix": T_map_opengl.tolist()}
    return {"file_path": _file("images", record), **depth, **pose}


def _file(folder: str, record: FrameRecord) -> str:
    return f"{folder}/{record.frame_id}.png"


def _ply(points: DepthPoints) -> bytes:
    """Return a PLY file of coloured points; coordinates are float32."""
    layout = np.dtype([("xyz", "<f4", 3), ("rgb", "u1", 3)])
    vertices = np.empty(len(points.points_m), layout)
    vertices["xyz"], vertices["rgb"] = points.points_m, points.rgb
    floats, bytes_ = ("x", "y", "z"), ("red", "green", "blue")
    properties = [*(f"float {name}" for name in floats), *(f"uchar {name}" for name in bytes_)]
    lines = [
        "ply",
        "format binary_little_endian 1.0",
        f"element vertex {len(vertices)}",
        *(f"property {each}" for each in properties),
        "end_header",
    ]
    return "".join(f"{line}\n" for line in lines).encode() + vertices.tobytes()
