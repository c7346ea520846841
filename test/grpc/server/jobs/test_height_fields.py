"""Grids of heights are looked up in pieces, between which others have their turns."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from oaisys_core.config import config_from_mapping
from oaisys_core.simulation import Simulation
from oaisys_core.types import ModuleMetadata, ObjectQuery
from oaisys_core.world import height_grids
from oaisys_grpc.contract.faults import OvertakenError
from oaisys_grpc.contract.world_messages import heights_from_parts
from oaisys_grpc.pb.oaisys.v1 import simulator_pb2 as pb
from oaisys_grpc.server.jobs.height_fields import height_field
from oaisys_grpc.worker.height_cells import SurfaceNames, height_cells
from oaisys_grpc.worker.protocol import WorkerMessage

CELLS = 700
BALL = {"shape": "sphere", "radius_m": 2.0, "position_m": [3.0, -1.0, 1.0]}


@pytest.fixture(autouse=True)
def small_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(height_grids, "BLOCK_CELLS", CELLS)


@pytest.fixture
def simulation() -> Simulation:
    config = {
        "backend": "analytic",
        "stage": {
            "surroundings": "plain",
            "preset": "mounds",
            "extent_m": 20.0,
            "resolution_px": 65,
        },
        "materials": {"texture_size_px": 32, "mask": {"size_px": 32, "relief": 0}},
        "assets": {"rocks": [], "primitives": [BALL]},
        "sensors": {"cameras": [{"width_px": 8, "height_px": 6}]},
    }
    simulation = Simulation(config_from_mapping(config))
    simulation.step_batch()
    return simulation


def parts_of(
    simulation: Simulation, request: pb.GetHeightFieldRequest, between: Callable[[int], object]
) -> list[pb.GetHeightFieldResponse]:
    """Ask for a grid; call ``between`` with the number of each piece before it is looked up."""
    names, count = SurfaceNames(), 0

    def ask(cells: pb.HeightCellsRequest) -> WorkerMessage:
        nonlocal count
        between(count)
        count += 1
        message, heights_m = height_cells(cells, simulation, names)
        assert max(len(each) for each in heights_m) <= CELLS
        raw = [each.view(np.uint8) for each in heights_m]
        return WorkerMessage({}, message.SerializeToString(), raw)

    return list(height_field(request, ask))


def test_a_grid_in_pieces_is_the_grid_while_others_look_around(simulation: Simulation) -> None:
    extent_m = (-10.5, -7.3, 8.0, 6.0)
    whole = simulation.height_grid(0.21, extent_m)
    request = pb.GetHeightFieldRequest(resolution_m=0.21)
    x0, y0, x1, y1 = extent_m
    request.extent.CopyFrom(pb.StageExtent(min_x_m=x0, min_y_m=y0, max_x_m=x1, max_y_m=y1))
    asked: list[int] = []

    def look(piece: int) -> None:
        asked.append(piece)
        simulation.step_sample(modalities=("depth",))

    found = heights_from_parts(parts_of(simulation, request, look))
    assert len(asked) == -(-whole.ground_m.size // CELLS) > 5
    np.testing.assert_array_equal(found.ground_m, whole.ground_m)
    np.testing.assert_array_equal(found.surface_m, whole.surface_m)
    assert found.origin_xy_m == whole.origin_xy_m


def _move(simulation: Simulation) -> None:
    (ball,) = simulation.list_objects(ObjectQuery(kinds=("solid",))).objects
    edits = {"objects": {str(ball.instance_id): {"position_m": [-3.0, 2.0, 1.0]}}}
    simulation.step_sample(ModuleMetadata(asset=edits), modalities=("depth",))


def _rebuild(simulation: Simulation) -> None:
    simulation.step_batch()


@pytest.mark.parametrize("change", [_move, _rebuild])
def test_heights_of_two_worlds_are_not_put_together(
    simulation: Simulation, change: Callable[[Simulation], None]
) -> None:
    request = pb.GetHeightFieldRequest(resolution_m=0.3)

    def change_once(piece: int) -> None:
        if piece == 2:
            change(simulation)

    with pytest.raises(OvertakenError, match="the world changed"):
        parts_of(simulation, request, change_once)
