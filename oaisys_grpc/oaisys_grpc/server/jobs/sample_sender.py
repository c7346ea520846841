"""A sample on its way to one client, as far as it exists."""

from __future__ import annotations

from collections.abc import Iterator

from oaisys_core.types import Frame, FrameName, Sample, SampleOutline, early_first
from oaisys_grpc.contract.array_messages import Part, SinglePart
from oaisys_grpc.contract.chunks import (
    frame_parts,
    grouped,
    sample_end_part,
    sample_header_part,
)
from oaisys_grpc.contract.transfer import Transfer


class SampleSender:
    """Makes parts of frames as they become ready; each frame goes once."""

    def __init__(self, transfer: Transfer) -> None:
        self._transfer = transfer
        self._outline: SampleOutline | None = None
        self._sent: set[FrameName] = set()

    def early(self, outline: SampleOutline, frames: tuple[Frame, ...]) -> Iterator[Part]:
        """Yield parts of frames that are ready before the sample is."""
        yield from grouped(self._parts(outline, frames, 0.0), self._transfer)

    def rest(self, sample: Sample) -> Iterator[Part]:
        """Yield all that was not sent yet of a complete sample, and its end."""

        def parts() -> Iterator[SinglePart]:
            yield from self._parts(sample.outline, sample.frames, sample.render_time_s)
            yield sample_end_part(sample)

        yield from grouped(parts(), self._transfer)

    def _parts(
        self, outline: SampleOutline, frames: tuple[Frame, ...], render_time_s: float
    ) -> Iterator[SinglePart]:
        if self._outline is None:
            self._outline = outline
            yield sample_header_part(outline, render_time_s)
        for frame in early_first(frames):
            name = FrameName(frame.sensor, frame.modality)
            if name not in self._sent:
                self._sent.add(name)
                index = self._outline.frames.index(name)
                yield from frame_parts(frame, index, outline.provenance, self._transfer)
