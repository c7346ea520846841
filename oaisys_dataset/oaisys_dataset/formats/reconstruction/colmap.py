"""COLMAP: a model for each world, with true poses and points of the true surface."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

from oaisys_core.errors import InvalidInputError
from oaisys_core.types import DEPTH, RGB
from oaisys_dataset.formats.base import (
    DatasetFormat,
    ExportOptions,
    FormatConventions,
    write_file,
)
from oaisys_dataset.formats.reconstruction.colmap_model import ColmapImage, ColmapModel, write_model
from oaisys_dataset.formats.reconstruction.depth_points import POINTS_PER_VIEW, world_points
from oaisys_dataset.formats.trajectories.sequences import (
    worlds_with_color,
)
from oaisys_dataset.records import world_name

if TYPE_CHECKING:
    from oaisys_dataset.manifest import FrameRecord
    from oaisys_dataset.reader import Dataset

CONVENTIONS = FormatConventions(
    layout="""\
`world_000012/` is a model for each world.

| file | holds |
|---|---|
| `images/SENSOR/FRAME.png` | colour |
| `sparse/0/cameras.bin`, `images.bin`, `points3D.bin` | the model; text files with \
`model=text` |

* Cameras are PINHOLE, OPENCV (`k1 k2 p1 p2`) or, with a third radial coefficient, FULL_OPENCV; \
fisheyes are OPENCV_FISHEYE (`k1 k2 k3 k4`).
* Points are drawn from the depth of every view and observed in each view that sees them: they \
are the true surface, not a reconstruction. Their error is 0.""",
    reading="""\
```python
import pycolmap

model = pycolmap.Reconstruction("world_000000/sparse/0")
```""",
    poses="images hold the pose of `map` in the camera's frame (`cam_from_world`): a quaternion "
    "w, x, y, z and a translation in metres",
    pixels="the upper left corner of the image is (0, 0), the centre of the first pixel "
    "(0.5, 0.5), as in COLMAP: half a pixel is added to the principal point",
    depth="not in this format; points lie at the depth of their pixel's centre",
    no_hit="no point",
    labels="not in this format",
)


class ColmapFormat(DatasetFormat):
    """Colour images and a COLMAP model with points from depth, world by world."""

    name = "colmap"
    modalities = (RGB, DEPTH)
    images_beside = (DEPTH,)
    settings = MappingProxyType(
        {
            "model": "binary (the default) or text",
            "points_per_view": f"points drawn from each depth image; {POINTS_PER_VIEW}",
        }
    )
    conventions = CONVENTIONS
    has_fisheye = True

    def images_needed(self, options: ExportOptions) -> tuple[str, ...]:
        """See `DatasetFormat.images_needed`."""
        return (RGB,)

    def write(self, dataset: Dataset, target: Path, options: ExportOptions) -> Mapping[str, int]:
        """See `DatasetFormat.write`."""
        kind = options.settings.get("model", "binary")
        if kind not in ("binary", "text"):
            raise InvalidInputError("settings.model", kind, "binary or text")
        points_per_view = options.count("points_per_view", POINTS_PER_VIEW, least=1)
        counts: Counter[str] = Counter()
        for world, frames in worlds_with_color(dataset.records):
            folder = target / world_name(world)
            for record in frames:
                write_file(folder / "images", _image_name(record), dataset.files(record)[RGB])
                counts["frames"] += 1
                options.progress(counts["frames"])
            model = _model(dataset, frames, points_per_view)
            write_model(folder / "sparse" / "0", model, as_text=kind == "text")
            counts["points"] += len(model.points.points_m)
            counts["worlds"] += 1
        return counts


def _image_name(record: FrameRecord) -> str:
    """Return the file of a frame's colour below the folder of images."""
    return f"{record.sensor}/{record.frame_id}.png"


def _model(dataset: Dataset, frames: Sequence[FrameRecord], points_per_view: int) -> ColmapModel:
    cameras = [(record.sensor, record.camera) for record in frames]
    different = list(dict.fromkeys(cameras))
    images = [
        ColmapImage(_image_name(record), different.index(camera), record.pose)
        for record, camera in zip(frames, cameras, strict=True)
    ]
    points = world_points(dataset, frames, points_per_view)
    return ColmapModel([camera for _, camera in different], images, points)
