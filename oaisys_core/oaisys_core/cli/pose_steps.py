"""The steps of a run whose views have the poses of a file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from oaisys_core.cli.metadata_file import SampleRequest
from oaisys_core.files.poses import PoseSelection, of_rig, read_pose_table
from oaisys_core.types import ModuleMetadata

if TYPE_CHECKING:
    from oaisys_core.simulation import Simulation


class PoseSteps:
    """Views from the poses of a file.

    Args:
        path: The file.
        selection: What its name does not say.
        camera: See `of_rig`.

    Raises:
        InvalidInputError: The file cannot be read, or a pose is wrong.
    """

    batch = ModuleMetadata()

    def __init__(self, path: Path, selection: PoseSelection, camera: str | None) -> None:
        self._table = read_pose_table(path, selection)
        self._camera = camera

    @property
    def count(self) -> int:
        """Number of samples of each batch."""
        return len(self._table.places)

    def requests(self, simulation: Simulation) -> tuple[SampleRequest, ...]:
        """Return the samples in a simulation's current world.

        Raises:
            InvalidInputError: The rig has no such camera.
        """
        table = of_rig(self._table, simulation.info().sensors, self._camera)
        return tuple(SampleRequest(ModuleMetadata(sensor={"pose": pose})) for pose in table.poses)
