"""An independent mapper: it reads a survey's bag alone and compares its meshes with the survey's.

    python -m tools.second_mapper out/survey/bag --mesh out/survey/mesh.ply

``rosbags`` decodes the messages, and scipy composes the poses from /tf and /tf_static. The surface
is reconstructed twice: by dense volumes of Open3D's legacy pipelines, tile by tile (independent
code: distances along rays, samples at voxel centres), and by ``VoxelBlockGrid`` as in Open3D's
tutorial. Prints the Chamfer distances between all three meshes as JSON; exits with 1 if one exceeds
half a voxel. (``vdbfusion`` has no wheels for Python 3.11 or later; the legacy
``ScalableTSDFVolume`` of Open3D 0.20 stays empty.)
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import open3d as o3d
from numpy.typing import NDArray
from rosbags.highlevel import AnyReader
from scipy.spatial.transform import Rotation

MAP_FRAME = "map"
TRUNCATION_VOXELS = 3.0
TILE_VOXELS = 128
SAMPLES = 300_000

BagView = tuple[NDArray[np.float32], NDArray[np.uint8], NDArray[np.float64], NDArray[np.float64]]
"""Depth in metres, colour, K and ``T_map_camera``."""


def views(bag: Path, camera: str) -> Iterator[BagView]:
    """Yield the views in a bag, ordered by stamp."""
    messages: dict[str, dict[int, Any]] = {"depth": {}, "color": {}, "info": {}}
    edges: dict[str, tuple[str, dict[int | None, NDArray[np.float64]]]] = {}
    topics = {
        f"/{camera}/depth/image_raw": "depth",
        f"/{camera}/color/image_raw": "color",
        f"/{camera}/depth/camera_info": "info",
        "/tf": "tf",
        "/tf_static": "tf_static",
    }
    with AnyReader([bag]) as reader:
        wanted = [one for one in reader.connections if one.topic in topics]
        for connection, _, raw in reader.messages(connections=wanted):
            message: Any = reader.deserialize(raw, connection.msgtype)
            kind = topics[connection.topic]
            if kind in messages:
                messages[kind][_stamp(message.header)] = message
                continue
            for one in message.transforms:
                at = None if kind == "tf_static" else _stamp(one.header)
                known = edges.setdefault(one.child_frame_id, (one.header.frame_id, {}))
                known[1][at] = _matrix(one.transform)
    for stamp in sorted(messages["depth"]):
        depth, color, info = (messages[kind][stamp] for kind in ("depth", "color", "info"))
        T = _pose(depth.header.frame_id, stamp, edges)
        shape = (depth.height, depth.width)
        depth_m = np.frombuffer(depth.data.tobytes(), "<f4").reshape(shape)
        rgb = np.frombuffer(color.data.tobytes(), np.uint8).reshape(*shape, 3)
        yield depth_m, rgb, np.reshape(info.k, (3, 3)), T


def _stamp(header: Any) -> int:
    return int(header.stamp.sec) * 10**9 + int(header.stamp.nanosec)


def _matrix(transform: Any) -> NDArray[np.float64]:
    q, t = transform.rotation, transform.translation
    T = np.eye(4)
    T[:3, :3] = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix()
    T[:3, 3] = (t.x, t.y, t.z)
    return T


def _pose(frame: str, stamp: int, edges: Any) -> NDArray[np.float64]:
    T = np.eye(4)
    while frame != MAP_FRAME:
        frame, known = edges[frame]
        T = known.get(None, known.get(stamp)) @ T
    return T


def mesh_by_tiles(seen: list[BagView], voxel_size_m: float, max_range_m: float) -> Any:
    """Return the mesh of Open3D's legacy dense volumes, one for each tile with points."""
    pipelines = o3d.pipelines.integration
    # Neighbouring tiles share one layer of samples, so that their meshes meet.
    step_m = (TILE_VOXELS - 1) * voxel_size_m
    rows = [_legacy_view(view, max_range_m) for view in seen]
    whole = o3d.geometry.TriangleMesh()
    tiles = [np.unique(np.floor(points_m / step_m), axis=0) for _, _, _, points_m in rows]
    for tile in np.unique(np.concatenate(tiles), axis=0):
        volume = pipelines.UniformTSDFVolume(
            length=TILE_VOXELS * voxel_size_m,
            resolution=TILE_VOXELS,
            sdf_trunc=TRUNCATION_VOXELS * voxel_size_m,
            color_type=pipelines.TSDFVolumeColorType.RGB8,
            origin=tile * step_m,
        )
        for (image, camera, T_camera_map, _), own in zip(rows, tiles, strict=True):
            if (np.abs(own - tile).max(axis=1) <= 1).any():
                volume.integrate(image, camera, T_camera_map)
        whole += volume.extract_triangle_mesh()
    return whole


def _legacy_view(view: BagView, max_range_m: float) -> tuple[Any, Any, Any, NDArray[np.float64]]:
    """Return a view in the types of Open3D's legacy pipelines, and its points in the map."""
    depth_m, rgb, K, T = view
    near = np.where(np.isfinite(depth_m) & (depth_m < max_range_m), depth_m, 0)
    image = o3d.geometry.RGBDImage.create_from_color_and_depth(
        o3d.geometry.Image(np.ascontiguousarray(rgb)),
        o3d.geometry.Image(near.astype(np.float32)),
        depth_scale=1.0,
        depth_trunc=max_range_m,
        convert_rgb_to_intensity=False,
    )
    height, width = depth_m.shape
    camera = o3d.camera.PinholeCameraIntrinsic(width, height, K[0, 0], K[1, 1], K[0, 2], K[1, 2])
    T_camera_map = np.linalg.inv(T)
    cloud = o3d.geometry.PointCloud.create_from_depth_image(
        image.depth, camera, T_camera_map, 1.0, max_range_m, 4
    )
    return image, camera, T_camera_map, np.asarray(cloud.points)


def plain_mesh(seen: list[BagView], voxel_size_m: float, max_range_m: float) -> Any:
    """Return the mesh of Open3D's ``VoxelBlockGrid``."""
    kind = o3d.core.float32
    grid = o3d.t.geometry.VoxelBlockGrid(
        ("tsdf", "weight", "color"), (kind, kind, kind), ((1), (1), (3)), voxel_size_m, 16, 10_000
    )
    for depth_m, rgb, K, T in seen:
        near = np.where(np.isfinite(depth_m) & (depth_m < max_range_m), depth_m, 0)
        depth = o3d.t.geometry.Image(near.astype(np.float32))
        color = o3d.t.geometry.Image(rgb.astype(np.float32) / 255)
        T_camera_map = o3d.core.Tensor(np.linalg.inv(T))
        # Block search unprojects pixel centres; integration truncates coordinates to pixels.
        half_px = np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
        search, cut = o3d.core.Tensor(K), o3d.core.Tensor(K + half_px)
        far = (1.0, max_range_m, TRUNCATION_VOXELS)
        blocks = grid.compute_unique_block_coordinates(depth, search, T_camera_map, *far)
        grid.integrate(blocks, depth, color, cut, cut, T_camera_map, *far)
    return grid.extract_triangle_mesh(0.5).to_legacy()


def chamfer_m(one: Any, other: Any) -> float:
    """Return the mean of the mean distances from points on each mesh to the other."""
    o3d.utility.random.seed(0)
    ways = []
    for mesh, target in ((one, other), (other, one)):
        scene = o3d.t.geometry.RaycastingScene()
        scene.add_triangles(o3d.t.geometry.TriangleMesh.from_legacy(target))
        points = np.asarray(mesh.sample_points_uniformly(SAMPLES).points, np.float32)
        ways.append(float(scene.compute_distance(o3d.core.Tensor(points)).numpy().mean()))
    return sum(ways) / 2


def main(arguments: list[str] | None = None) -> int:
    """Compare the meshes; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("bag", type=Path, help="folder of the bag")
    parser.add_argument("--mesh", type=Path, required=True, help="our mesh")
    parser.add_argument("--camera", default="camera", help="prefix of the camera's topics")
    parser.add_argument("--voxel-size", type=float, default=0.1, help="metres")
    parser.add_argument("--max-range", type=float, default=60.0, help="metres")
    chosen = parser.parse_args(arguments)
    seen = list(views(chosen.bag, chosen.camera))
    meshes = {
        "ours": o3d.io.read_triangle_mesh(str(chosen.mesh)),
        "second": mesh_by_tiles(seen, chosen.voxel_size, chosen.max_range),
        "plain": plain_mesh(seen, chosen.voxel_size, chosen.max_range),
    }
    found = {f"{a}_{b}": chamfer_m(meshes[a], meshes[b]) for a, b in combinations(meshes, 2)}
    limit_m = chosen.voxel_size / 2
    sizes = {name: len(mesh.triangles) for name, mesh in meshes.items()}
    agrees = max(found.values()) <= limit_m
    report = {"views": len(seen), "triangles": sizes, "chamfer_m": found, "limit_m": limit_m}
    sys.stdout.write(json.dumps(report | {"agrees": agrees}, indent=1) + "\n")
    return 0 if agrees else 1


if __name__ == "__main__":
    sys.exit(main())
