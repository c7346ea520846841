"""The true ground around the rig, for its maps."""

from __future__ import annotations

import numpy as np

from oaisys_core.types import TriangleMesh
from oaisys_mapping.ground_grid import GridPlace, GroundGrid
from oaisys_mapping.surface_labels import labels_at
from oaisys_ros_bridge.bridge.render_queue import RenderQueue
from oaisys_ros_bridge.publishing.map_schedule import NewestView


class TrueGround:
    """Asks the simulator for heights and labels; changes nothing.

    Heights are those of now. Labels are those of the world's mesh when its first map was made:
    a thing that is added later has the label of what was there.

    Args:
        render_queue: Knows the simulator, and where the rig is.
    """

    def __init__(self, render_queue: RenderQueue) -> None:
        self._render_queue = render_queue
        self._mesh: tuple[int, TriangleMesh] | None = None

    def newest_view(self) -> NewestView | None:
        """Return the newest sample; None: there is none in this world."""
        pose, counts = self._render_queue.rig_pose, self._render_queue.counts
        if pose is None or not counts.last_stamp_ns:
            return None
        x_m, y_m, _ = pose.position_m
        return NewestView(counts.rendered, counts.last_stamp_ns, (x_m, y_m))

    def find(self, place: GridPlace) -> GroundGrid:
        """Return the topmost surface, objects included, at the cells' centres.

        Raises:
            OaisysError: As the simulator says, or there is none.
        """
        link = self._render_queue.require_link()
        heights = link.height_grid(place.cell_m, place.extent_m)
        shape = (place.count, place.count)
        elevation_m = np.full(shape, np.nan, np.float32)
        # Rounding may have added a row and a column, or lost them.
        found_m = heights.surface_m[: place.count, : place.count]
        elevation_m[: found_m.shape[0], : found_m.shape[1]] = found_m
        if self._mesh is None or self._mesh[0] != link.info.batch_id:
            self._mesh = link.ground_truth_mesh()
        points_m = np.dstack((place.centres_m(), elevation_m)).reshape(-1, 3).astype(np.float64)
        labels = labels_at(self._mesh[1], points_m, place.cell_m / 2)
        return GroundGrid(place, elevation_m, labels.reshape(shape))
