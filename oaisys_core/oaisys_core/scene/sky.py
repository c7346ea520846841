"""Sun, sky and air of a world, and the labels of rays that hit nothing."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, sin
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from oaisys_core.scene.terrain_material import id_of_level
from oaisys_core.types import FloatArray

Color = tuple[float, float, float]
"""Linear red, green and blue."""

SkyModel = Literal["atmosphere", "plain", "none"]

CloudKind = Literal["cumulus", "stratocumulus"]


@dataclass(frozen=True)
class Gradient:
    """A sky of plain colours, for worlds whose atmosphere cannot be computed.

    Attributes:
        zenith, horizon: Radiance at ``sky_strength`` 1.
        glow: Radiance added around the sun.
        glow_rad: Angle from the sun at which the glow has fallen to 1 / e.
        power: Of the sine of the elevation, by which the zenith's colour takes over.
    """

    zenith: Color = (0.14, 0.28, 0.60)
    horizon: Color = (0.55, 0.65, 0.75)
    glow: Color = (0.0, 0.0, 0.0)
    glow_rad: float = 0.2
    power: float = 0.5


def gradient_radiance(gradient: Gradient, directions: FloatArray, to_sun: FloatArray) -> FloatArray:
    """Return the (N, 3) radiance along (N, 3) unit vectors; ``to_sun`` is one, too."""
    up = np.maximum(directions[:, 2], 0.0)
    # A square root has the same bytes everywhere; powers need not.
    share = (np.sqrt(up) if gradient.power == 0.5 else up**gradient.power)[:, None]
    color = np.array(gradient.horizon) * (1 - share) + np.array(gradient.zenith) * share
    angle = np.arccos(np.clip(directions @ to_sun, -1.0, 1.0))
    glow = np.exp(-angle / gradient.glow_rad)[:, None] * np.array(gradient.glow)
    return np.asarray(color + glow)


@dataclass(frozen=True)
class Haze:
    """Haze that attenuates distant objects and adds light of its own (Koschmieder).

    Over a distance d, a colour becomes colour * exp(-b d) + veil * (1 - exp(-b d)). The sky is seen
    through a layer of finite thickness.

    Attributes:
        extinction_per_m: b for red, green and blue.
        thickness_m: Thickness of the layer towards the zenith; towards the horizon it is infinite.
        tint: Colour of the veil, relative to the brightness of the sky at the horizon.
        veil: Radiance of an infinite depth of haze; None derives it from ``tint``.
    """

    extinction_per_m: Color
    thickness_m: float = 0.0
    tint: Color = (1.0, 1.0, 1.0)
    veil: Color | None = None


@dataclass(frozen=True)
class Clouds:
    """Clouds, which cameras and reflections see.

    Below broken ones, the sky's light on the ground is as without them; below a closed layer, it is
    theirs.

    Attributes:
        cover: Share of what is straight above that they hide.
        base_m: Height of their flat undersides above the ground.
        size_m: Distance from one to the next, about.
        thickness_m: Height of the highest tops above the base.
        seed: Of where they are.
        kind: Heaps, or a layer of rolls.
        shadows: Whether they cast shadows.
    """

    cover: float
    base_m: float
    size_m: float
    thickness_m: float
    seed: int
    kind: CloudKind = "cumulus"
    shadows: bool = True


@dataclass(frozen=True, eq=False)
class SkyImage:
    """An equirectangular image of all directions, with label maps of the same layout.

    The middle column looks along +x, columns further left towards +y; the top row is the zenith.
    Two images are equal only if they are the same object.

    Attributes:
        name: Name in messages and cache keys.
        radiance: (H, 2H) or any (H, W, 3) float32, linear.
        label_maps: Pairs of a level and its (Hl, Wl) uint16 ids; levels may be missing.
    """

    name: str
    radiance: NDArray[np.float32]
    label_maps: tuple[tuple[int, NDArray[np.uint16]], ...] = ()

    def label_map(self, level: int) -> NDArray[np.uint16] | None:
        """Return the ids of a level, or None if the image has none."""
        return dict(self.label_maps).get(level)


@dataclass(frozen=True)
class Hdri:
    """A sky image around the world.

    Attributes:
        rotation_rad: Azimuth of the middle column, counter-clockwise from +x.
        strength: Factor on the radiance.
        keeps_sun: Whether the sun lamp is on in addition.
        semantic_ids: Ids from level 0 on, used for levels without a label map.
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
        sun_elevation_rad: Elevation above the horizon.
        sun_azimuth_rad: Azimuth in ``map``, from +x (east) counter-clockwise.
        sun_strength_w_m2: Irradiance of the sun on a surface facing it.
        sun_angular_diameter_rad: Angular diameter; a larger sun casts softer shadows.
        sky_strength: Factor on the sky's radiance.
        air, dust, ozone: Densities of the atmosphere; 1 is a clear day on Earth.
        semantic_ids: Ids of pixels that hit nothing, from level 0 on.
        altitude_m: Height above sea level from which the atmosphere is seen.
        sun_disc: Brightness of the visible disc relative to the sun's strength; 0 hides it.
        model: ``atmosphere`` (scattered sunlight), ``plain`` (``gradient``) or ``none`` (black).
        hdri: Image that replaces the sky, and the ground below the horizon.
        haze: Haze between the camera and the scene; it changes colour only.
        clouds: Clouds before the sky; not with ``hdri``.
        has_plain: Whether the ground continues beyond the stage to the horizon; not with ``hdri``.
        ground_semantic_ids: Ids of the ground beyond the stage, and of pixels below the horizon
            that hit nothing. None uses those of the ground's material and of the sky.
        dips: Whether the ground ends at a horizon that lies lower the higher one looks from, so
            that the sky reaches below the horizontal.
        unit_w_m2: Irradiance in red, green and blue of one scene unit, for radiance images.
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
    clouds: Clouds | None = None
    has_plain: bool = False
    ground_semantic_ids: tuple[int, ...] | None = None
    dips: bool = False
    unit_w_m2: Color = (1.0, 1.0, 1.0)

    @property
    def shows_plain(self) -> bool:
        """Whether the ground beyond the stage is visible."""
        return self.has_plain and self.hdri is None

    @property
    def shows_clouds(self) -> bool:
        """Whether there are clouds before the sky."""
        return self.clouds is not None and self.hdri is None

    @property
    def to_sun(self) -> Color:
        """Unit vector in ``map`` towards the sun."""
        elevation, azimuth = self.sun_elevation_rad, self.sun_azimuth_rad
        return (cos(elevation) * cos(azimuth), cos(elevation) * sin(azimuth), sin(elevation))

    @property
    def lamp_w_m2(self) -> float:
        """Irradiance of the sun lamp: 0 at night, and if a sky image contains the sun."""
        is_out = self.sun_elevation_rad <= 0 or (self.hdri and not self.hdri.keeps_sun)
        return 0.0 if is_out else self.sun_strength_w_m2

    def semantic_ids_at(self, directions: FloatArray, level: int) -> NDArray[np.uint16]:
        """Return the (N,) ids of rays that hit nothing, along (N, 3) directions in ``map``."""
        if self.hdri is not None:
            return self._ids_in_image(self.hdri, directions, level)
        ids = np.full(len(directions), id_of_level(self.semantic_ids, level), np.uint16)
        if self.ground_semantic_ids is not None and not (self.shows_plain and self.dips):
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
    """Return the (N,) rows and columns at which (N, 3) rays meet an equirectangular image."""
    x, y, z = np.asarray(directions, dtype=np.float64).T
    azimuth = np.arctan2(y, x) - rotation_rad
    across = np.mod(0.5 - azimuth / (2 * np.pi), 1.0)
    down = 0.5 - np.arctan2(z, np.hypot(x, y)) / np.pi
    rows = np.minimum((down * shape[0]).astype(np.intp), shape[0] - 1)
    cols = np.minimum((across * shape[1]).astype(np.intp), shape[1] - 1)
    return rows, cols
