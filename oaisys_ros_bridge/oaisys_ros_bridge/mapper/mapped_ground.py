"""The ground around the newest view as it is mapped, for its maps."""

from __future__ import annotations

import numpy as np

from oaisys_mapping.ground_grid import GridPlace, GroundGrid, grid_of_points
from oaisys_ros_bridge.mapper.fusion import Fusion
from oaisys_ros_bridge.publishing.map_schedule import NewestView


class MappedGround:
    """Makes grids of the surface that is fused so far.

    Args:
        fusion: Has the map.
    """

    def __init__(self, fusion: Fusion) -> None:
        self._fusion = fusion

    def newest_view(self) -> NewestView | None:
        """Return the newest view in the map; None: there is none."""
        state, view, resets = self._fusion.newest
        if view is None:
            return None
        x_m, y_m = (float(each) for each in view.T_map_camera[:2, 3])
        return NewestView(state.integrated, state.stamp_ns, (x_m, y_m), resets)

    def find(self, place: GridPlace) -> GroundGrid:
        """Return the topmost mapped surface in the cells."""
        mesh = self._fusion.visible_surface()
        middles_m = mesh.vertices_m[mesh.triangles].mean(axis=1)
        points_m = np.concatenate((mesh.vertices_m, middles_m))
        classes = mesh.class_ids
        if classes is not None:
            classes = np.concatenate((classes, classes[mesh.triangles[:, 0]]))
        return grid_of_points(place, points_m, classes)
