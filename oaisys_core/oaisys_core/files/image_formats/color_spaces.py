"""Which colours the values of an image stand for, as its file says; what is not sRGB is told."""

from __future__ import annotations

import io
import logging
import re
import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.image_formats.image_headers import is_png, png_chunks
from oaisys_core.files.image_formats.image_use import ImageUse

LOG = logging.getLogger(__name__)

PRIMARIES = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06)
"""x and y of sRGB's red, green and blue (ITU-R BT.709), which EXR and PNG have by default."""
_TOLERANCE = 0.02
"""Difference of a primary that no one sees; those of Radiance differ by 0.01."""

_SRGB_GAMMA = (0.45, 0.46)
"""Gammas by which PNG files say that they are about sRGB."""
_BT709, _LINEAR, _SRGB = 1, 8, 13
"""Numbers of primaries and transfer functions in ITU-T H.273."""

_SRGB_PROFILES = re.compile(rb"s\W*R\W*G\W*B|IEC\W*61966-?2", re.IGNORECASE)


def check_primaries(values: Sequence[float], use: ImageUse, name: str) -> None:
    """Raise `InvalidInputError` unless colours have the primaries of sRGB.

    Args:
        values: x and y of red, green and blue, perhaps more.
        use: What the image is for.
        name: Of the file in errors.
    """
    found = np.asarray(values, np.float64)[: len(PRIMARIES)]
    if found.shape != (len(PRIMARIES),) or not np.allclose(found, PRIMARIES, 0, _TOLERANCE):
        shown = ", ".join(f"{value:g}" for value in found)
        expected = f"{use.name} with the primaries of sRGB (ITU-R BT.709), not {shown}: convert it"
        raise InvalidInputError(use.field, name, expected)


def check_exr_primaries(path: Path, use: ImageUse) -> None:
    """Raise `InvalidInputError` if an EXR file says that its colours have other primaries."""
    import OpenEXR

    try:
        with OpenEXR.File(str(path), header_only=True) as file:
            values = file.header().get("chromaticities")
    except (OSError, RuntimeError, ValueError, TypeError) as error:
        raise use.refusal(str(path), error) from error
    if values is not None:
        check_primaries(values, use, str(path))


def gamma_of(data: bytes, name: str) -> float | None:
    """Return the exponent of light that made the values of a picture, 1 of linear ones.

    None: they are sRGB's, or what the file says of them is not used, of which the log warns.

    Args:
        data: The file; all but PNG have sRGB's.
        name: Of the file in warnings.
    """
    chunks = {name: content for name, content, _ in png_chunks(data)} if is_png(data) else {}
    if (codes := chunks.get(b"cICP")) is not None:
        if len(codes) == 4 and codes[0] == _BT709 and codes[1] in (_LINEAR, _SRGB):
            return 1.0 if codes[1] == _LINEAR else None
        shown = ", ".join(map(str, codes[:4]))
        LOG.warning("%s: its colours (cICP %s) are not sRGB's: save it as sRGB", name, shown)
        return None
    if profile := _profile(data):
        # Its description may be in UTF-16, with a zero between letters.
        if not _SRGB_PROFILES.search(profile.replace(b"\0", b"")):
            LOG.warning(
                "%s: its colour profile is not sRGB, and is not used: save it as sRGB", name
            )
        return None
    if b"sRGB" in chunks:
        return None
    _warn_of_primaries(chunks.get(b"cHRM", b""), name)
    (stored,) = struct.unpack(">I", chunks.get(b"gAMA", b"").rjust(4, b"\0")[:4])
    gamma = stored / 100_000
    is_srgb = not gamma or _SRGB_GAMMA[0] <= gamma <= _SRGB_GAMMA[1]
    return None if is_srgb else gamma


def _warn_of_primaries(chunk: bytes, name: str) -> None:
    if len(chunk) != 32:
        return
    values = np.array(struct.unpack(">8I", chunk)[2:]) / 100_000
    if not np.allclose(values, PRIMARIES, 0, _TOLERANCE):
        shown = ", ".join(f"{value:g}" for value in values)
        LOG.warning("%s: its primaries (cHRM %s) are not sRGB's: save it as sRGB", name, shown)


def _profile(data: bytes) -> bytes:
    from PIL import Image

    try:
        with Image.open(io.BytesIO(data)) as file:
            info: Mapping[Any, Any] = file.info
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError):
        return b""
    return info.get("icc_profile") or b""
