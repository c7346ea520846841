"""What a render of Blender has returned: its passes, by name, and statistics."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import RenderError
from oaisys_core.sensing.render_settings import RenderSettings

Image = NDArray[np.float32]


@dataclass
class RenderResult:
    """Passes and statistics of a render.

    Attributes:
        passes: (H, W, channels) scene-linear float32 by Blender's name, top row first.
        samples: Samples per pixel that were taken; 0: not reported.
        sampling_began_s, sampling_ended_s: By `time.perf_counter`; 0: not reported.
        errors: What Cycles has logged as errors.
    """

    passes: dict[str, Image] = field(default_factory=dict)
    samples: int = 0
    sampling_began_s: float = 0.0
    sampling_ended_s: float = 0.0
    errors: list[str] = field(default_factory=list)

    def samples_per_pixel(self, settings: RenderSettings) -> int:
        """Return how many samples per pixel an image has that was rendered with these settings.

        Without a time limit it has all, whichever of them Cycles has reported in time.
        """
        is_limited = settings.time_budget_s is not None
        return (self.samples if is_limited else 0) or settings.samples


def pass_of(rendered: RenderResult, name: str) -> Image:
    """Return a pass by Blender's name.

    Raises:
        RenderError: It was not rendered.
    """
    if name not in rendered.passes:
        raise RenderError(f"Blender rendered no pass {name}, only {sorted(rendered.passes)}")
    return rendered.passes[name]
