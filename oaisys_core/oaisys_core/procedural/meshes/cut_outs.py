"""Where a material's alpha cuts holes into a mesh."""

from __future__ import annotations

import logging

import numpy as np
from numpy.typing import NDArray

LOG = logging.getLogger(__name__)


def cut_out(
    alpha: NDArray[np.uint8] | None, factor: float, cutoff: float, where: str, *, is_mask: bool
) -> NDArray[np.uint8] | None:
    """Return the (H, W) opacity of a material, before ``factor``; None: nothing is cut out.

    A surface that is see-through everywhere, such as glass, is shown without holes, and the log
    says so: neither depth nor labels are known behind it.

    Args:
        alpha: (H, W) of its image; None without one.
        factor: On alpha, 0 to 1.
        cutoff: Least alpha, after ``factor``, of a surface.
        where: Names the material in the log.
        is_mask: Whether holes are wanted even where they are all of it.
    """
    lowest = factor * (1.0 if alpha is None else float(alpha.min()) / 255)
    highest = factor * (1.0 if alpha is None else float(alpha.max()) / 255)
    if lowest >= cutoff:
        return None
    if highest < cutoff and not is_mask:
        LOG.warning("%s: is see-through (opacity %.2g) and shown as if it were not", where, highest)
        return None
    return np.full((1, 1), 255, np.uint8) if alpha is None else alpha
