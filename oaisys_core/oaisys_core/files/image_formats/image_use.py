"""What images from outside are used for: what bounds them, and what errors call them."""

from __future__ import annotations

from dataclasses import dataclass

from oaisys_core.errors import InvalidInputError
from oaisys_core.types import MAX_IMAGE_PX

BYTES_PER_PIXEL = 16
"""Of a file: four channels of 32 bits, uncompressed."""

_HEADER_BYTES = 1_000_000
"""What a file may have besides pixels."""


@dataclass(frozen=True)
class ImageUse:
    """What an image is used for, and how large it may be.

    Attributes:
        name: Of the use, in errors.
        most_px: Pixels that it may have.
        field: Name of the configuration field in errors.
        is_of_numbers: Whether pixels are ids or heights, so that they count as the file has them;
            else they are shares of white.
        has_voids: Whether transparent pixels have no value; of ids, opacity does not count.
    """

    name: str
    most_px: int
    field: str
    is_of_numbers: bool = False
    has_voids: bool = False

    @property
    def most_bytes(self) -> int:
        """Size of a file."""
        return self.most_px * BYTES_PER_PIXEL + _HEADER_BYTES

    def check(self, width: int, height: int, file: str) -> None:
        """Raise `InvalidInputError` if an image of this size must not be decoded."""
        if width * height > self.most_px:
            expected = (
                f"{self.name} of at most {self.most_px} pixels, not {width} x {height}"
                f" ({width * height})"
            )
            raise InvalidInputError(self.field, file, expected)

    def refusal(self, file: str, reason: object) -> InvalidInputError:
        """Return the error about a file that cannot be read."""
        return InvalidInputError(self.field, file, f"{self.name} that can be read ({reason})")


TEXTURE = ImageUse("a texture", 8192 * 8192, "folder")
MESH_TEXTURE = ImageUse("a mesh's texture", 8192 * 8192, "file")
LABEL_IMAGE = ImageUse("a label image", 8192 * 8192, "labels_from", is_of_numbers=True)
DENSITY = ImageUse("a density image", 8192 * 8192, "density.file")
SKY = ImageUse("a sky image", 16384 * 8192, "environment.hdri")
SKY_LABELS = ImageUse(
    "a sky's label image", 16384 * 8192, "environment.hdri.labels_from", is_of_numbers=True
)
ELEVATION = ImageUse("an elevation model", 100_000_000, "stage.dem.file", True, has_voids=True)
FRAME = ImageUse("a camera's image", MAX_IMAGE_PX, "image")
USES = (TEXTURE, MESH_TEXTURE, LABEL_IMAGE, DENSITY, SKY, SKY_LABELS, ELEVATION, FRAME)
