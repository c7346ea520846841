"""The most recent samples, for clients that fetch them later."""

from __future__ import annotations

import threading
from collections import OrderedDict

from oaisys_core.errors import NotFoundError
from oaisys_grpc.contract.sample_messages import SampleMessages

MAX_SAMPLES = 16
MAX_BYTES = 512 * 1024 * 1024


class SampleStore:
    """Keeps the most recent samples within bounds of number and memory; safe for any thread."""

    def __init__(self, max_samples: int = MAX_SAMPLES, max_bytes: int = MAX_BYTES) -> None:
        self._max_samples = max_samples
        self._max_bytes = max_bytes
        self._samples: OrderedDict[tuple[int, int], SampleMessages] = OrderedDict()
        self._lock = threading.Lock()

    def add(self, sample: SampleMessages) -> None:
        """Keep a sample; drop the oldest ones if there are too many, but never this one."""
        with self._lock:
            key = (sample.batch_id, sample.sample_id)
            self._samples.pop(key, None)
            self._samples[key] = sample
            while len(self._samples) > 1 and self._is_full():
                self._samples.popitem(last=False)

    def get(self, batch_id: int, sample_id: int) -> SampleMessages:
        """Return a sample.

        Raises:
            NotFoundError: It was never rendered, or has been dropped.
        """
        with self._lock:
            sample = self._samples.get((batch_id, sample_id))
        if sample is None:
            raise NotFoundError(
                f"sample {sample_id} of batch {batch_id} is not here; "
                f"at most {self._max_samples} are kept"
            )
        return sample

    def _is_full(self) -> bool:
        size = sum(sample.nbytes for sample in self._samples.values())
        return len(self._samples) > self._max_samples or size > self._max_bytes
