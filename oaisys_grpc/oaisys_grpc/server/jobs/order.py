"""Which of the waiting operations is next: batches in the order of requests, others in turns."""

from __future__ import annotations

from collections.abc import Sequence

from oaisys_grpc.contract.operation import Kind
from oaisys_grpc.server.jobs.job import Operation
from oaisys_grpc.server.jobs.turns import Turns


class JobOrder:
    """Chooses the next operation; not safe for several threads.

    A batch overtakes nothing. Other operations wait for batches that were requested before them,
    but for one of each other connection only, so that a client that requests many batches and
    leaves does not hold up all others.
    """

    def __init__(self, turns: Turns) -> None:
        self._turns = turns
        self._count_at_batch: dict[str, int] = {}

    def choose(self, waiting: Sequence[Operation], count: int) -> Operation:
        """Return the first operation of the connection whose turn it is.

        Args:
            waiting: At least one, in the order of their requests.
            count: Number of the last operation that was requested.
        """
        candidates = self._candidates(waiting)
        peers = {operation.job.peer for operation in waiting}
        peer = self._turns.next(dict.fromkeys(o.job.peer for o in candidates), peers)
        chosen = next(o for o in candidates if o.job.peer == peer)
        if chosen.job.kind is Kind.BATCH:
            kept = {p: number for p, number in self._count_at_batch.items() if p in peers}
            self._count_at_batch = {**kept, peer: count}
        return chosen

    def _candidates(self, waiting: Sequence[Operation]) -> list[Operation]:
        """Return what may be next."""
        candidates: list[Operation] = []
        batches: list[Operation] = []
        for operation in waiting:
            if operation.job.kind is Kind.BATCH:
                batches.append(operation)
                if operation is waiting[0]:
                    candidates.append(operation)
            elif all(self._has_had_turn(batch.job.peer, operation) for batch in batches):
                candidates.append(operation)
        return candidates

    def _has_had_turn(self, peer: str, operation: Operation) -> bool:
        """Return whether a batch of another connection has begun since an operation waits."""
        is_other = operation.job.peer != peer
        return is_other and operation.number <= self._count_at_batch.get(peer, 0)
