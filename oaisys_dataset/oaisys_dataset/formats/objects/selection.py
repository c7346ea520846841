"""Which objects of a frame an export describes, by size and by what hides them."""

from __future__ import annotations

from collections import Counter
from types import MappingProxyType
from typing import TYPE_CHECKING

from oaisys_core.errors import InvalidInputError, NotFoundError
from oaisys_dataset.formats.base import ExportOptions

if TYPE_CHECKING:
    from oaisys_dataset.manifest import FrameRecord
    from oaisys_dataset.objects import ObjectRow
    from oaisys_dataset.reader import Dataset

SETTINGS = MappingProxyType(
    {
        "min_area": "pixels that an object must show to count; 0",
        "min_visible": "share of its silhouette, 0 to 1, that an object must show to count; 0",
    }
)

TOO_SMALL = "objects below min_area, left out"
TOO_HIDDEN = "objects below min_visible, left out"


class ObjectSelection:
    """Chooses objects by the settings ``min_area`` and ``min_visible``, and counts the others."""

    def __init__(self, dataset: Dataset, options: ExportOptions, counts: Counter[str]) -> None:
        """Take the settings.

        Raises:
            InvalidInputError: One of them is no number in its range.
        """
        self._dataset = dataset
        self._counts = counts
        self._min_area = options.number("min_area", 0.0)
        self._min_visible = options.number("min_visible", 0.0)
        if self._min_visible > 1:
            received = options.settings["min_visible"]
            raise InvalidInputError("settings.min_visible", received, "a number from 0 to 1")

    def choose(self, record: FrameRecord, visible_px: dict[int, int]) -> set[int]:
        """Return the ids of the objects of a frame that count.

        Args:
            record: The frame.
            visible_px: Number of pixels of each object that shows in it.

        Raises:
            InvalidInputError: ``min_visible`` is given, and the frame's world has no table.
        """
        large = {i for i, pixels in visible_px.items() if pixels >= self._min_area}
        self._count(TOO_SMALL, len(visible_px) - len(large))
        if not self._min_visible:
            return large
        rows = object_rows(self._dataset, record, "settings.min_visible")
        hidden = {row.instance_id for row in rows if row.visible_share < self._min_visible}
        self._count(TOO_HIDDEN, len(large & hidden))
        return large - hidden

    def _count(self, what: str, number: int) -> None:
        if number:
            self._counts[what] += number


def object_rows(dataset: Dataset, record: FrameRecord, field: str) -> list[ObjectRow]:
    """Return the rows of a frame in the table of objects; errors name a field.

    Raises:
        InvalidInputError: The frame's world has no table.
    """
    try:
        return dataset.objects(record)
    except NotFoundError as error:
        expected = "worlds with a table of objects, which earlier versions did not write"
        raise InvalidInputError(field, f"{record.frame_id}: {error}", expected) from error
