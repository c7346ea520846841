"""Arrays, and texts that show their sizes only."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

Extent = tuple[float, float, float, float]
"""(min_x, min_y, max_x, max_y) in ``map``, metres."""


class ShortRepr:
    """Base of dataclasses with arrays (``repr=False``): shows the arrays' types and shapes only."""

    def __repr__(self) -> str:
        shown = ", ".join(f"{f.name}={_show(getattr(self, f.name))}" for f in fields(self))  # type: ignore[arg-type]
        return f"{type(self).__name__}({shown})"


def _show(value: object) -> str:
    if isinstance(value, np.ndarray):
        return f"<{value.dtype} {value.shape}>"
    return repr(value)
