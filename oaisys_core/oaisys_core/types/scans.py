"""What a lidar measures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.types.arrays import FloatArray, ShortRepr
from oaisys_core.types.modalities import POINTS

_POINT = (("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("ring", "<u2"))

_POINT_TIME = ("time", "<f4")

_EXTRA_POINT_FIELDS = {"label": "<u2", "instance": "<u4"}


def point_dtype(extra_fields: Sequence[str] = ()) -> np.dtype[Any]:
    """Return the dtype, without padding, of a lidar's points.

    * ``x``, ``y``, ``z``: metres, in the lidar's frame at the time of the ray.
    * ``intensity``: 0 to 255.
    * ``ring``: the channel, 0 is the lowest.
    * ``time``: seconds since the beginning of the scan.
    * ``label``, ``instance``: semantic id on level 0, and instance id, if named.
    """
    extra = [(name, _EXTRA_POINT_FIELDS[name]) for name in extra_fields]
    return np.dtype([*_POINT, _POINT_TIME, *extra])


@dataclass(frozen=True, repr=False)
class LidarScan(ShortRepr):
    """The points of one scan of one lidar.

    Attributes:
        sensor: Name of the lidar.
        data: (N,) points in the order of their times, see `point_dtype`. They are not corrected for
            the motion during the scan.
        T_map_lidar: (4, 4) pose of the lidar at the beginning of the scan (x forward, z up).
    """

    sensor: str
    data: NDArray[Any]
    T_map_lidar: FloatArray

    @property
    def modality(self) -> str:
        """`POINTS`."""
        return POINTS

    @property
    def points_m(self) -> FloatArray:
        """(N, 3) points in the lidar's frame."""
        return np.stack([self.data[axis].astype(np.float64) for axis in "xyz"], axis=-1)
