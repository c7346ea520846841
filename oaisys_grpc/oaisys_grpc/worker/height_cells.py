"""Heights of some cells of a grid, and how a worker knows that they are of one surface.

Must not import gRPC.
"""

from __future__ import annotations

import secrets

from oaisys_core.errors import InvalidInputError
from oaisys_core.scene import Scene
from oaisys_core.simulation import Simulation
from oaisys_grpc.contract.arrays import AnyArray
from oaisys_grpc.contract.faults import OvertakenError
from oaisys_grpc.contract.world_messages import extent_from_proto, height_field_header
from oaisys_grpc.pb.oaisys.v1 import simulator_pb2 as pb


class SurfaceNames:
    """Names the surface of the current world; after a change, it has another name.

    No two workers give the same name.
    """

    def __init__(self) -> None:
        self._worker = secrets.token_hex(8)
        self._count = 0
        self._scene: Scene | None = None

    def forget(self) -> None:
        """Drop the last surface, which may be large."""
        self._scene = None

    def name_of(self, scene: Scene) -> str:
        """Return the name of a scene's surface."""
        if self._scene is None or not _are_same(self._scene, scene):
            self._count += 1
        self._scene = scene
        return f"{self._worker}-{self._count}"


def _are_same(one: Scene, other: Scene) -> bool:
    """Return whether two scenes have the same surface."""
    parts = ("ground", "far_ground", "prototypes", "placements", "primitives")
    return all(getattr(one, part) is getattr(other, part) for part in parts)


def height_cells(
    request: pb.HeightCellsRequest, simulation: Simulation, surfaces: SurfaceNames
) -> tuple[pb.HeightCells, list[AnyArray]]:
    """Return the heights of the next cells of a grid: of the ground, and of the topmost surface.

    Raises:
        InvalidInputError: There is no such grid.
        OvertakenError: The cells before are those of another surface.
    """
    grid = request.grid
    extent_m = extent_from_proto(grid.extent) if grid.HasField("extent") else None
    plan = simulation.grid_plan(grid.resolution_m, extent_m)
    surface = surfaces.name_of(simulation.scene)
    if request.surface not in ("", surface):
        raise OvertakenError("the world changed while its heights were looked up: ask again")
    if request.first_cell >= plan.cells:
        raise InvalidInputError("first_cell", request.first_cell, f"less than {plan.cells}")
    block = plan.block(request.first_cell)
    message = pb.HeightCells(
        header=height_field_header((plan.rows, plan.columns), plan.origin_xy_m, plan.spacing_m),
        surface=surface,
        next_cell=block.stop % plan.cells,
    )
    return message, list(plan.heights_m(block, simulation.stage_heights))
