"""How large things are that are scattered."""

from __future__ import annotations

import numpy as np
from scipy.stats import truncnorm

from oaisys_core.config.sections.groups import GroupConfig
from oaisys_core.scatter.placement import power_law_sizes
from oaisys_core.types import FloatArray


def group_sizes_m(group: GroupConfig, count: int, rng: np.random.Generator) -> FloatArray:
    """Return (count,) sizes of a group's things, within its range, largest first."""
    low, high = group.size_m
    if low == high:
        return np.full(count, low)
    if group.size_distribution == "power_law":
        sizes_m = power_law_sizes(count, group.size_m, group.size_exponent, rng)
    elif group.size_distribution == "uniform":
        sizes_m = rng.uniform(low, high, count)
    else:
        mean_m = (low + high) / 2 if group.size_mean_m is None else group.size_mean_m
        std_m = (high - low) / 4 if group.size_std_m is None else group.size_std_m
        bounds = truncnorm((low - mean_m) / std_m, (high - mean_m) / std_m, mean_m, std_m)
        sizes_m = bounds.ppf(rng.uniform(size=count))
    return np.sort(np.clip(sizes_m, low, high))[::-1]
