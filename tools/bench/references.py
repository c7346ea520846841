"""Converged images, kept between runs because they take minutes each, and similarity to them."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from tools.bench.figures import write_json

Image = NDArray[np.uint8]

WHITE = 255.0


@dataclass(frozen=True)
class ReferenceImage:
    """A converged image.

    Attributes:
        image: (H, W, 3) sRGB.
        seconds: Time of its rendering.
        is_reused: Whether it was rendered in an earlier run.
    """

    image: Image
    seconds: float
    is_reused: bool


class ReferenceImages:
    """A folder of reference images, named by a hash of everything that they depend on."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def get(
        self, name: str, key: Mapping[str, Any], render: Callable[[], tuple[float, Image]]
    ) -> ReferenceImage:
        """Return the reference image of a view, and render it if it is not in the folder.

        Args:
            name: Of the view.
            key: Everything that the image depends on; JSON-able.
            render: Returns seconds and image.
        """
        text = json.dumps(key, sort_keys=True)
        stem = self._folder / f"{name}_{hashlib.sha256(text.encode()).hexdigest()[:16]}"
        picture, facts = stem.with_suffix(".png"), stem.with_suffix(".json")
        if facts.is_file():
            image = cv2.imread(str(picture), cv2.IMREAD_COLOR)
            if image is not None:
                seconds = float(json.loads(facts.read_text(encoding="utf-8"))["seconds"])
                return ReferenceImage(
                    np.ascontiguousarray(image[..., ::-1]), seconds, is_reused=True
                )
        seconds, rendered = render()
        self._folder.mkdir(parents=True, exist_ok=True)
        if not cv2.imwrite(str(picture), rendered[..., ::-1]):
            raise OSError(f"cannot write {picture}")
        # Written last, so that an image without this file counts as incomplete.
        write_json(facts, {"view": name, "seconds": seconds, "key": dict(key)})
        return ReferenceImage(rendered, seconds, is_reused=False)


def sha256(image: Image) -> str:
    """Return the hash of an image's pixels."""
    return hashlib.sha256(np.ascontiguousarray(image).tobytes()).hexdigest()


def psnr_db(image: Image, reference: Image) -> float:
    """Return the peak signal-to-noise ratio of (H, W, 3) images; ``inf`` where they are equal."""
    error = image.astype(np.float64) - reference.astype(np.float64)
    mean_square = float(np.mean(error**2))
    return float("inf") if mean_square == 0 else 10 * float(np.log10(WHITE**2 / mean_square))


def ssim(image: Image, reference: Image) -> float:
    """Return the structural similarity (Wang et al., IEEE TIP 13(4), 2004), mean of channels."""
    per_channel, _ = cv2.quality.QualitySSIM_compute(image, reference)
    return float(np.mean(per_channel[:3]))
