"""A grid of heights, asked of the worker in pieces, so that other clients have their turns."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from oaisys_grpc.contract.arrays import array_chunks
from oaisys_grpc.pb.oaisys.v1 import simulator_pb2 as pb
from oaisys_grpc.worker.protocol import WorkerMessage


def height_field(
    request: pb.GetHeightFieldRequest, ask: Callable[[pb.HeightCellsRequest], WorkerMessage]
) -> Iterator[pb.GetHeightFieldResponse]:
    """Yield a grid's header, and then the chunks of its two arrays in turns.

    Args:
        request: Which grid.
        ask: Has the worker look up some cells, in turn with other jobs.

    Raises:
        OaisysError: The request is refused, or the surface changed before all cells came.
    """
    cells, begin = pb.HeightCellsRequest(grid=request), 0
    while True:
        answer = ask(cells)
        found = pb.HeightCells.FromString(answer.content)
        if not begin:
            yield pb.GetHeightFieldResponse(header=found.header)
        for index, data in enumerate(answer.arrays):
            for chunk in array_chunks(data, index, begin=begin):
                yield pb.GetHeightFieldResponse(chunk=chunk)
        begin += answer.arrays[0].size
        cells.first_cell, cells.surface = found.next_cell, found.surface
        if not found.next_cell:
            return
