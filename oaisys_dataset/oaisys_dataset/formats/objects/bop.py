"""BOP: poses, masks and models of objects, in millimetres, in the layout of that benchmark."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.files.names import path_inside
from oaisys_core.output.images import encode_image
from oaisys_core.output.records import write_json
from oaisys_core.types import DEPTH, INSTANCE, RGB, FloatArray
from oaisys_dataset.formats.base import (
    FRAMES_WITHOUT,
    DatasetFormat,
    ExportOptions,
    FormatConventions,
    write_file,
)
from oaisys_dataset.formats.objects.bop_models import BopModels
from oaisys_dataset.formats.objects.kitti_object import check_rectified
from oaisys_dataset.formats.objects.selection import object_rows
from oaisys_dataset.formats.trajectories.sequences import LOST_DEPTH, depth_units
from oaisys_dataset.records import world_name

if TYPE_CHECKING:
    from oaisys_dataset.manifest import FrameRecord
    from oaisys_dataset.objects import ObjectRow
    from oaisys_dataset.reader import Dataset

MM = 1000.0
"""Millimetres in a metre."""

CONVENTIONS = FormatConventions(
    layout="""\
`SPLIT/000012/` holds the images of one camera in one world; `scenes.json` says which.

| file | holds |
|---|---|
| `SPLIT/000012/rgb/000003.png` | colour of view 3 |
| `SPLIT/000012/depth/000003.png` | depth in 16 bits: times `depth_scale` it is millimetres |
| `SPLIT/000012/mask/000003_000000.png` | the whole object 0 of view 3, also where others hide \
it: 255 |
| `SPLIT/000012/mask_visib/000003_000000.png` | the pixels that show it |
| `SPLIT/000012/scene_camera.json` | `cam_K`, `depth_scale`, `cam_R_w2c`, `cam_t_w2c` |
| `SPLIT/000012/scene_gt.json` | `obj_id`, `cam_R_m2c`, `cam_t_m2c` of each object |
| `SPLIT/000012/scene_gt_info.json` | `bbox_obj`, `bbox_visib`, `px_count_all`, `px_count_valid`, \
`px_count_visib`, `visib_fract` |
| `models/obj_000001.ply`, `models/models_info.json` | the shape of each object in millimetres, \
its box and diameter |
| `camera.json` | the first camera |
| `scenes.json`, `objects.json` | world and camera of each scene; label and name of each `obj_id` |

* A model's origin is the centre of its box, as in BOP, and its z axis points up. Objects of the
  same shape and size share an `obj_id`, in all worlds; rocks of random sizes have one each.
* `cam_t_m2c`, `cam_t_w2c` and models are in millimetres. The world is `map`.
* An object is listed in the frames that show at least one of its pixels. Its silhouette goes on
  beyond the image, by up to one image at each side, in `bbox_obj` and `px_count_all`; masks end
  with the image.
* Models and `mask/` need the world itself, which is made again without Blender. Without the files
  of the configuration, `--set models=no` leaves both out; `px_count_valid` then counts the pixels
  that show the object.""",
    reading="""\
```python
import json

poses = json.load(open("train/000000/scene_gt.json"))["0"]  # of view 0
```""",
    world_axes="`map`: right-handed, z up; here in millimetres",
    poses="`cam_R_m2c`, `cam_t_m2c` (row by row): X_camera = R X_model + t, in millimetres",
    depth="planar z in units of `depth_scale` millimetres",
    no_hit="0, which means no measurement; so does depth that does not fit into 16 bits (65.5 m at "
    "1 mm). Such pixels are counted below",
    labels="`obj_id`, see `objects.json`",
)


class BopFormat(DatasetFormat):
    """Poses, masks and models of objects, as in the BOP benchmark for 6D object poses."""

    name = "bop"
    modalities = (RGB, DEPTH, INSTANCE)
    settings = MappingProxyType(
        {
            "depth_scale": "millimetres in a unit of depth; 1, with which depth ends at 65.5 m",
            "models": "yes, or no to leave models and masks of whole objects out; yes",
        }
    )
    conventions = CONVENTIONS

    def images_needed(self, options: ExportOptions) -> tuple[str, ...]:
        """See `DatasetFormat.images_needed`."""
        return self.modalities

    def write(self, dataset: Dataset, target: Path, options: ExportOptions) -> Mapping[str, int]:
        """See `DatasetFormat.write`."""
        depth_scale = options.number("depth_scale", 1.0, least=1e-3)
        has_models = options.choice("models", ("yes", "no")) == "yes"
        counts: Counter[str] = Counter()
        scenes: dict[str, Any] = {}
        with BopModels(dataset.info, target, has_models) as models:
            for world in dataset.worlds:
                for records in _by_camera(dataset, world, counts):
                    first, scene = records[0], len(scenes)
                    folder = path_inside(target, first.split, f"{scene:06d}")
                    writer = _SceneWriter(dataset, folder, models, depth_scale, counts)
                    for record in records:
                        writer.add(record)
                        options.progress(counts["frames"])
                    writer.finish()
                    if not scenes:
                        write_json(target / "camera.json", _camera(first, depth_scale))
                    scenes[str(scene)] = {
                        "world": world_name(world),
                        "sensor": first.sensor,
                        "split": first.split,
                    }
            counts["models"] = models.finish()
        write_json(target / "scenes.json", scenes)
        return counts


def _by_camera(dataset: Dataset, world: int, counts: Counter[str]) -> list[list[FrameRecord]]:
    """Return the complete frames of a world, one list for each camera; the others are counted."""
    by_sensor: dict[str, list[FrameRecord]] = {}
    for record in dataset.of_world(world):
        if set(BopFormat.modalities) <= set(record.images):
            by_sensor.setdefault(record.sensor, []).append(record)
        else:
            counts[f"{FRAMES_WITHOUT} {', '.join(BopFormat.modalities)}, left out"] += 1
    return list(by_sensor.values())


def _camera(record: FrameRecord, depth_scale: float) -> dict[str, float]:
    camera = record.camera
    return {
        "cx": camera.cx_px,
        "cy": camera.cy_px,
        "depth_scale": depth_scale,
        "fx": camera.fx_px,
        "fy": camera.fy_px,
        "height": camera.height_px,
        "width": camera.width_px,
    }


class _SceneWriter:
    """Writes the frames of one camera in one world."""

    def __init__(
        self,
        dataset: Dataset,
        folder: Path,
        models: BopModels,
        depth_scale: float,
        counts: Counter[str],
    ) -> None:
        self._dataset = dataset
        self._folder = folder
        self._models = models
        self._depth_scale = depth_scale
        self._counts = counts
        self._cameras: dict[str, Any] = {}
        self._poses: dict[str, Any] = {}
        self._infos: dict[str, Any] = {}

    def add(self, record: FrameRecord) -> None:
        """Write one frame."""
        check_rectified(record, BopFormat.name)
        sample = self._dataset.sample(record, BopFormat.modalities)
        rows = object_rows(self._dataset, record, "objects")
        name, image = f"{record.view:06d}", str(record.view)
        depth, lost = depth_units(sample.arrays[DEPTH], MM / self._depth_scale)
        self._counts[LOST_DEPTH] += lost
        write_file(self._folder, f"rgb/{name}.png", encode_image(sample.arrays[RGB]))
        write_file(self._folder, f"depth/{name}.png", encode_image(depth))
        T_camera_map = np.linalg.inv(record.pose)
        self._cameras[image] = {
            "cam_K": sample.K.ravel().tolist(),
            "depth_scale": self._depth_scale,
            "cam_R_w2c": T_camera_map[:3, :3].ravel().tolist(),
            "cam_t_w2c": (MM * T_camera_map[:3, 3]).tolist(),
        }
        masks = self._models.masks(record, rows)
        self._poses[image], self._infos[image] = [], []
        for index, row in enumerate(rows):
            shown = sample.arrays[INSTANCE] == row.instance_id
            whole = masks.get(row.instance_id, shown) | shown
            if masks:
                self._write_mask("mask", f"{name}_{index:06d}", whole)
            self._write_mask("mask_visib", f"{name}_{index:06d}", shown)
            self._poses[image].append(_pose(row, self._models.obj_id(record, row)))
            self._infos[image].append(_info(row, int(np.count_nonzero(whole & (depth > 0)))))
        self._counts["object poses"] += len(rows)
        self._counts["frames"] += 1

    def finish(self) -> None:
        """Write the JSON files."""
        for name, data in (
            ("scene_camera.json", self._cameras),
            ("scene_gt.json", self._poses),
            ("scene_gt_info.json", self._infos),
        ):
            write_file(self._folder, name, (json.dumps(data) + "\n").encode())

    def _write_mask(self, kind: str, name: str, mask: NDArray[np.bool_]) -> None:
        file = encode_image(np.where(mask, 255, 0).astype(np.uint8))
        write_file(self._folder, f"{kind}/{name}.png", file)


def _pose(row: ObjectRow, obj_id: int) -> dict[str, Any]:
    T: FloatArray = row.T_camera_object
    center_m = T[:3, :3] @ row.box_center_object_m + T[:3, 3]
    return {
        "cam_R_m2c": T[:3, :3].ravel().tolist(),
        "cam_t_m2c": (MM * center_m).tolist(),
        "obj_id": obj_id,
    }


def _info(row: ObjectRow, valid_px: int) -> dict[str, Any]:
    return {
        "bbox_obj": list(row.box_amodal_px),
        "bbox_visib": list(row.box_visible_px),
        "px_count_all": row.silhouette_px,
        "px_count_valid": valid_px,
        "px_count_visib": row.visible_px,
        "visib_fract": row.visible_share,
    }
