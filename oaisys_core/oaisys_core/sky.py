"""Sun, sky and air of a world, and which label a ray has that hits nothing."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, sin
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from oaisys_core.types import FloatArray
from oaisys_core.world.terrain_material import id_of_level

Color = tuple[float, float, float]
"""Linear red, green and blue."""

SkyModel = Literal["atmosphere", "plain", "none"]


@dataclass(frozen=True)
class Gradient:
    """A sky of plain colours, as on worlds whose air no sky model knows.

    Attributes:
        zenith, horizon: Radiance at a strength of 1.
        glow: Radiance that is added around the sun.
        glow_rad: Angle from the sun at which the glow has fallen to 1 / e.
    """

    zenith: Color = (0.14, 0.28, 0.60)
    horizon: Color = (0.55, 0.65, 0.75)
    glow: Color = (0.0, 0.0, 0.0)
    glow_rad: float = 0.2


@dataclass(frozen=True)
class Haze:
    """Air that dims what is far and veils it (Koschmieder).

    Along a distance d, colour becomes colour * exp(-b d) + veil * (1 - exp(-b d)). The sky lies
    behind a layer of it.

    Attributes:
        extinction_per_m: b of red, green and blue.
        thickness_m: Of the layer, seen upwards; towards the horizon it is endless.
        tint: Colour of a veil that is as bright as the sky at the horizon.
        veil: Radiance of an infinite depth of haze; None: by ``tint``.
    """

    extinction_per_m: Color
    thickness_m: float = 0.0
    tint: Color = (1.0, 1.0, 1.0)
    veil: Color | None = None


@dataclass(frozen=True, eq=False)
class SkyImage:
    """An equirectangular picture of all directions, with labels of the same layout.

    The middle column looks along +x, columns further left towards +y; the top row is the zenith.
    Two are the same only if they are one object: loaded images are kept, not compared.

    Attributes:
        name: For messages and caches.
        radiance: (H, 2H) or any (H, W, 3) float32, linear.
        label_maps: (Hl, Wl) uint16 ids by level; a level may be missing.
    """

    name: str
    radiance: NDArray[np.float32]
    label_maps: tuple[tuple[int, NDArray[np.uint16]], ...] = ()

    def label_map(self, level: int) -> NDArray[np.uint16] | None:
        """Return the ids of a level, None where the image has none."""
        return dict(self.label_maps).get(level)


@dataclass(frozen=True)
class Hdri:
    """A sky image as it hangs around the world.

    Attributes:
        rotation_rad: Counter-clockwise about z: the middle column looks along this azimuth.
        strength: Factor on its radiance.
        keeps_sun: Whether the sun lamp shines as well.
        semantic_ids: Labels where the image has no label map, from level 0 on.
    """

    image: SkyImage
    rotation_rad: float = 0.0
    strength: float = 1.0
    keeps_sun: bool = False
    semantic_ids: tuple[int, ...] = ()


@dataclass(frozen=True)
class Sky:
    """Sun and sky.

    Attributes:
        sun_elevation_rad: Above the horizon.
        sun_azimuth_rad: From +x (east) counter-clockwise towards +y (north), as in ``map``.
        sun_strength_w_m2: Irradiance of the sun on a surface facing it.
        sun_angular_diameter_rad: Sets how soft shadows are.
        sky_strength: Factor on the sky's radiance.
        air, dust, ozone: Densities of the atmosphere, 1 is Earth's on a clear day.
        semantic_ids: Labels of pixels that hit nothing, from level 0 on.
        altitude_m: Height above the sea from which the atmosphere is seen.
        sun_disc: Brightness of the sun's disc in the picture, 1 is that of its strength; 0: none.
        model: ``atmosphere`` computes scattered sunlight, ``plain`` is `gradient`, ``none`` black.
        hdri: Takes the sky's place, and the ground's below the horizon.
        haze: Between the camera and what it sees; in colour only.
        has_plain: Whether the ground goes on beyond the stage up to the horizon; not with ``hdri``.
        ground_semantic_ids: Labels of what lies beyond the stage, and of pixels that hit nothing
            below the horizon; None: the ground's and the sky's.
    """

    sun_elevation_rad: float
    sun_azimuth_rad: float
    sun_strength_w_m2: float
    sun_angular_diameter_rad: float
    sky_strength: float
    air: float
    dust: float
    ozone: float
    semantic_ids: tuple[int, ...] = ()
    altitude_m: float = 0.0
    sun_disc: float = 0.0
    model: SkyModel = "atmosphere"
    gradient: Gradient = Gradient()
    hdri: Hdri | None = None
    haze: Haze | None = None
    has_plain: bool = False
    ground_semantic_ids: tuple[int, ...] | None = None

    @property
    def shows_plain(self) -> bool:
        """Whether the ground is seen to go on beyond the stage."""
        return self.has_plain and self.hdri is None

    @property
    def to_sun(self) -> Color:
        """Unit vector in ``map`` towards the sun."""
        elevation, azimuth = self.sun_elevation_rad, self.sun_azimuth_rad
        return (cos(elevation) * cos(azimuth), cos(elevation) * sin(azimuth), sin(elevation))

    @property
    def lamp_w_m2(self) -> float:
        """Irradiance that the sun lamp gives: 0 by night, and where an image brings its own sun."""
        is_out = self.sun_elevation_rad <= 0 or (self.hdri and not self.hdri.keeps_sun)
        return 0.0 if is_out else self.sun_strength_w_m2

    def semantic_ids_at(self, directions: FloatArray, level: int) -> NDArray[np.uint16]:
        """Return the (N,) labels of rays along (N, 3) directions in ``map`` that hit nothing."""
        if self.hdri is not None:
            return self._ids_in_image(self.hdri, directions, level)
        ids = np.full(len(directions), id_of_level(self.semantic_ids, level), np.uint16)
        if self.ground_semantic_ids is not None:
            ids[directions[:, 2] < 0] = id_of_level(self.ground_semantic_ids, level)
        return ids

    def _ids_in_image(self, hdri: Hdri, directions: FloatArray, level: int) -> NDArray[np.uint16]:
        label_map = hdri.image.label_map(level)
        if label_map is None:
            ids = hdri.semantic_ids or self.semantic_ids
            return np.full(len(directions), id_of_level(ids, level), np.uint16)
        rows, cols = texels_at(directions, hdri.rotation_rad, label_map.shape)
        return np.asarray(label_map[rows, cols])


def texels_at(
    directions: FloatArray, rotation_rad: float, shape: tuple[int, ...]
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return (row, column) of the texels of an equirectangular image that (N, 3) rays point at."""
    x, y, z = np.asarray(directions, dtype=np.float64).T
    azimuth = np.arctan2(y, x) - rotation_rad
    across = np.mod(0.5 - azimuth / (2 * np.pi), 1.0)
    down = 0.5 - np.arctan2(z, np.hypot(x, y)) / np.pi
    rows = np.minimum((down * shape[0]).astype(np.intp), shape[0] - 1)
    cols = np.minimum((across * shape[1]).astype(np.intp), shape[1] - 1)
    return rows, cols
