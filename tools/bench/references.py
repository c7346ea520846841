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

KEY_SAMPLES = 8
"""Samples per pixel of the picture by which references are found again."""

WHITE = 255.0
TOP_OCTAVE = (0.25, 0.5)
"""Spatial frequencies from half of Nyquist's to Nyquist's, in cycles per pixel."""


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


def top_octave_share(image: Image, reference: Image) -> float:
    """Return how much of the reference's finest texture an image keeps: 1 all, below 1 smeared.

    It is the ratio of the power spectra's sums over the top octave (`TOP_OCTAVE`, by radius) of the
    images' luma, with a Hann window. The ratio of power spectra of a picture and of its known
    target is the square of the texture MTF by which losses of noise reduction are measured (Cao,
    Guichard, Hornung: Measuring texture sharpness of a digital camera, Proc. SPIE 7250, 2009).
    Noise adds energy, so it is above 1 where noise is left; noise of the reference itself lowers
    it.
    """
    return _top_octave_energy(image) / _top_octave_energy(reference)


def _top_octave_energy(image: Image) -> float:
    luma = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY).astype(np.float64)
    height, width = luma.shape
    window = np.outer(np.hanning(height), np.hanning(width))
    power = np.abs(np.fft.rfft2((luma - luma.mean()) * window)) ** 2
    # All but the first and, for even widths, the last column stand for two frequencies.
    weight = np.full(power.shape[1], 2.0)
    weight[0] = 1.0
    if width % 2 == 0:
        weight[-1] = 1.0
    radius = np.hypot(np.fft.fftfreq(height)[:, None], np.fft.rfftfreq(width)[None, :])
    inside = (radius >= TOP_OCTAVE[0]) & (radius <= TOP_OCTAVE[1])
    return float((power * weight)[inside].sum())
