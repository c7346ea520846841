"""Samples as the files that a client of the original simulator reads."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from oaisys_core.config import SimulationConfig
from oaisys_core.errors import InvalidInputError
from oaisys_core.output.writer import SampleWriter
from oaisys_core.types import DEPTH, RGB, Sample

_LAST = {DEPTH: 1, RGB: 2}
"""What comes last among the files of a camera."""


class LegacyFiles:
    """Writes samples below a folder, which stays as it is until the first one.

    Files are named as the original names them, ``batch_0001/sensor_1/0001sensor_1_rgb_00.png``;
    cameras are called ``sensor_1``, ``sensor_2`` and so on, in the configuration's order. Where the
    folder holds an earlier run, this one goes into ``run_0002`` in it, or the next number.
    """

    def __init__(self, folder: Path, config: SimulationConfig) -> None:
        self._folder = folder
        self._config = config
        self._writer: SampleWriter | None = None

    def write(
        self, sample: Sample, cameras: Sequence[str], labels: Mapping[int, str]
    ) -> tuple[str, ...]:
        """Write a sample; return the absolute paths of its images, all complete.

        The last path that ends in ``exr`` is the first camera's depth, the last one that ends in
        ``png`` its colour image.

        Args:
            sample: What was rendered.
            cameras: Names of all cameras, in the configuration's order.
            labels: Name by semantic id.

        Raises:
            RenderError: A file could not be written.
        """
        self._writer = self._writer or self._begin()
        place = {name: index for index, name in enumerate(cameras)}
        frames = sorted(sample.frames, key=lambda f: (-place[f.sensor], _LAST.get(f.modality, 0)))
        renamed = [replace(frame, sensor=f"sensor_{place[frame.sensor] + 1}") for frame in frames]
        paths = self._writer.write(replace(sample, frames=tuple(renamed)), labels)
        return tuple(str(path) for path in paths)

    def _begin(self) -> SampleWriter:
        folder = self._folder.resolve()
        for number in itertools.count(1):
            writer = SampleWriter(folder if number == 1 else folder / f"run_{number:04d}")
            try:
                writer.begin(self._config)
            except InvalidInputError:  # it holds another run
                continue
            return writer
        raise AssertionError("itertools.count has no end")
