"""A format of data sets with one NumPy archive for each frame."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from oaisys_dataset import Dataset
from oaisys_dataset.formats.base import DatasetFormat, ExportOptions, FormatConventions


class NpzFormat(DatasetFormat):
    """All images of a frame, its K and its pose in ``SPLIT/FRAME.npz``."""

    name = "npz"
    conventions = FormatConventions(layout="`SPLIT/FRAME.npz` holds every image, K and the pose.")

    def write(self, dataset: Dataset, target: Path, options: ExportOptions) -> dict[str, int]:
        """Write every frame, and return how many there are."""
        for number, sample in enumerate(dataset.stream(), start=1):
            folder = target / sample.record.split
            folder.mkdir(exist_ok=True)
            camera = {"K": sample.K, "T_map_camera": sample.T_map_camera}
            np.savez_compressed(folder / sample.record.frame_id, **sample.arrays, **camera)
            options.progress(number)
        return {"frames": len(dataset)}
