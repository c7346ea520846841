"""The module that draws sun, sky, air and lamps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from math import log, radians
from typing import TypeVar

import numpy as np

from oaisys_core import randomness
from oaisys_core.color import LUMINANCE, linear
from oaisys_core.config.sections.environment import (
    CloudsConfig,
    EnvironmentConfig,
    HazeConfig,
    HdriConfig,
    SkyConfig,
)
from oaisys_core.config.sections.stage import body_name
from oaisys_core.config.sections.sun import SunFromTimeConfig
from oaisys_core.errors import InvalidInputError
from oaisys_core.procedural.environment.dust import shares_under_dust
from oaisys_core.procedural.environment.earthshine import earthshine_lamp
from oaisys_core.procedural.environment.effects import load_effects
from oaisys_core.procedural.environment.hdri import SkyImages, images_of
from oaisys_core.procedural.environment.light import daylight, gradient_irradiance_w_m2
from oaisys_core.procedural.environment.overcast import OVERCAST, overcast_share
from oaisys_core.procedural.environment.radiometry import unit_w_m2
from oaisys_core.procedural.environment.sun_in_map import (
    SeenBody,
    map_axes,
    mean_sun_distance_au,
    sun_at,
    sun_diameter_rad,
)
from oaisys_core.scene import Lamp
from oaisys_core.scene.sky import CloudKind, Clouds, Color, Gradient, Haze, Hdri, Sky
from oaisys_core.world.module import Metadata, SectionModule, World, override
from oaisys_core.world.modules.lamps import check_changes, lamps_that_are_on

MIN_CONTRAST = 0.02
"""Contrast at the visual range, by definition of the term (Koschmieder 1924)."""

THICKNESS, MAX_THICKNESS_M = 0.1, 60.0
"""Default thickness of the haze layer below the sky: a share of the visual range, up to a limit.

With the limit, haze of kilometres pales the sky within a few degrees of the horizon only. Models of
the sky contain the air above it.
"""

CLOUD_THICKNESS: dict[CloudKind, float] = {"cumulus": 0.25, "stratocumulus": 0.2}
"""Default thickness of clouds, in sizes."""

WAVELENGTHS_NM = np.array((680.0, 550.0, 440.0))
"""Wavelengths of red, green and blue; the visual range refers to green."""

T = TypeVar("T")


@dataclass(frozen=True)
class NamedDraws:
    """The random draws of one redraw; draws with different names are independent.

    Attributes:
        seed: Seed of the batch.
        index: Index of the redraw within the batch, from 0.
    """

    seed: int
    index: int = 0

    def rng(self, name: str) -> np.random.Generator:
        """Return a new generator for a name."""
        return randomness.stream(self.seed, name, self.index)

    def number(self, name: str, bounds: tuple[float, float]) -> float:
        """Return a number drawn uniformly from a range."""
        least, most = bounds
        return least if least == most else float(self.rng(name).uniform(least, most))

    def pick(self, name: str, options: Sequence[T]) -> T:
        """Return one of the options, drawn uniformly."""
        return options[int(self.rng(name).integers(len(options)))]

    def pick_shuffled(self, name: str, options: Sequence[T]) -> T:
        """Return one option per redraw, in random order, none twice before all were returned."""
        turn, place = divmod(self.index, len(options))
        order = randomness.stream(self.seed, name, turn).permutation(len(options))
        return options[int(order[place])]


class EnvironmentModule(SectionModule[EnvironmentConfig]):
    """Draws the light of a batch; a step's metadata overrides any field of its configuration.

    A drawn value depends only on the batch's seed, the index of the redraw and the field's name.
    """

    name = "environment"
    metadata_part = "environment"

    def __init__(self, config: EnvironmentConfig) -> None:
        super().__init__(config)
        self._images = SkyImages()
        self._seed = 0

    def setup(self) -> None:
        """Raise if a file or an effect does not exist."""
        _check_names(self._config)

    def check(self, metadata: Metadata) -> None:
        """Raise on unknown keys, invalid values, and files, effects or lamps that do not exist."""
        check_changes(self._config.lamps, metadata)
        _check_names(override(self._config, metadata, self.metadata_part))

    def check_sample(self, metadata: Metadata) -> None:
        """Raise as `check` does, with the metadata applied to the current values."""
        check_changes(self._now.lamps, metadata)
        _check_names(override(self._now, metadata, self.metadata_part))

    def step_batch(self, world: World, metadata: Metadata, rng: np.random.Generator) -> None:
        """Start a batch with the configuration, changed by the metadata."""
        self._seed = int(rng.integers(2**63))
        super().step_batch(world, metadata, rng)

    def apply(self, world: World, section: EnvironmentConfig) -> None:
        """Set sun, sky and lamps."""
        sun = section.sun_from_time
        self.changes_by_itself = section.redraw == "sample" or bool(sun and sun.s_per_sample)
        draws = NamedDraws(self._seed, _redraw(section, world.sample_id))
        mean_au = section.sun_distance_au or mean_sun_distance_au(world.surroundings.body_radius_m)
        unit = section.unit_w_m2 or unit_w_m2(mean_au)
        sun_now = _sun(section, draws, world, mean_au)
        sky = self._sky(section, draws, sun_now, (mean_au / sun_now.distance_au) ** 2)
        sky = replace(sky, dips=world.is_in_land, unit_w_m2=unit)
        for index, effect in enumerate(load_effects(section.effects)):
            sky = effect.apply(sky, draws.rng(f"effects.{index}"))
        world.sky = sky
        strengths_w = {
            name: draws.number(f"lamps.{name}.strength_w", lamp.strength_w)
            for name, lamp in section.lamps.items()
        }
        world.lamps = lamps_that_are_on(section.lamps, strengths_w, world.ground)
        world.lamps += _earthshine(section, draws, world, sky.sun_strength_w_m2)
        for thing in section.items_with_labels:
            world.semantic_labels.update({i: name for i, name in thing.labels.items() if i})

    def _sky(
        self, config: EnvironmentConfig, draws: NamedDraws, sun: SeenBody, sunlight: float
    ) -> Sky:
        """Return the sky under the sun, whose light is ``sunlight`` times that of its mean."""
        elevation_rad = sun.elevation_rad
        diameter_rad = sun.angular_diameter_rad
        if config.sun_angular_diameter_deg is not None:
            name = "sun_angular_diameter_deg"
            diameter_rad = radians(draws.number(name, config.sun_angular_diameter_deg))
        ground = config.ground_beyond_label
        gradient = _gradient(config.sky)
        sun_w_m2 = draws.number("sun_strength_w_m2", config.sun_strength_w_m2) * sunlight
        sky_strength = draws.number("sky_strength", config.sky_strength)
        if config.optical_depth is not None:
            depth = draws.number("optical_depth", config.optical_depth)
            shares = shares_under_dust(depth, elevation_rad)
            sky_strength *= sun_w_m2 * _strength_of(shares.diffuse, gradient, elevation_rad)
            sun_w_m2 *= shares.direct
        elif config.sky.model == "overcast":
            share = overcast_share(elevation_rad)
            sky_strength *= sun_w_m2 * _strength_of(share, gradient, elevation_rad)
            sun_w_m2 = 0.0
        else:
            sky_strength *= sunlight
        return Sky(
            sun_elevation_rad=elevation_rad,
            sun_azimuth_rad=sun.azimuth_rad,
            sun_strength_w_m2=sun_w_m2,
            sun_angular_diameter_rad=diameter_rad,
            sky_strength=sky_strength,
            air=draws.number("air", config.air),
            dust=draws.number("dust", config.dust),
            ozone=draws.number("ozone", config.ozone),
            semantic_ids=config.sky_labels.semantic_ids,
            altitude_m=draws.number("altitude_m", config.altitude_m),
            sun_disc=draws.number("sun_disc", config.sun_disc),
            model="plain" if config.sky.model == "overcast" else config.sky.model,
            gradient=gradient,
            hdri=self._hdri(config.hdri, config.sky_labels.semantic_ids, draws),
            haze=_haze(config.haze, draws),
            clouds=_clouds(config.clouds, draws),
            has_plain=config.ground_beyond,
            ground_semantic_ids=ground.semantic_ids if ground else None,
        )

    def _hdri(
        self, config: HdriConfig | None, sky_ids: tuple[int, ...], draws: NamedDraws
    ) -> Hdri | None:
        if config is None:
            return None
        images = images_of(config)
        if config.use is not None:
            image = next(each for each in images if each.file.stem == config.use)
        elif config.choose == "random":
            image = draws.pick("hdri", images)
        elif config.choose == "shuffle":
            image = draws.pick_shuffled("hdri", images)
        else:
            image = images[draws.index % len(images)]
        ids = image.semantic_ids if any(image.semantic_ids) else sky_ids
        rotation_deg = image.rotation_deg or config.rotation_deg
        return Hdri(
            image=self._images.load(image, ids),
            rotation_rad=radians(draws.number("hdri.rotation_deg", rotation_deg)),
            strength=draws.number("hdri.strength", image.strength or config.strength),
            keeps_sun=config.keep_sun,
            semantic_ids=ids,
        )


def _redraw(config: EnvironmentConfig, sample_id: int) -> int:
    """Return the index of the redraw that a sample belongs to."""
    if config.redraw == "batch" or sample_id == 0:
        return 0
    return (sample_id - 1) // config.step_interval


def _sun(config: EnvironmentConfig, draws: NamedDraws, world: World, mean_au: float) -> SeenBody:
    """Return the sun by its angles, at its mean distance, or by time and place."""
    at = config.sun_from_time
    if at is None:
        elevation_deg = draws.number("sun_elevation_deg", config.sun_elevation_deg)
        azimuth_deg = draws.number("sun_azimuth_deg", config.sun_azimuth_deg)
        diameter_rad = sun_diameter_rad(mean_au)
        return SeenBody(radians(elevation_deg), radians(azimuth_deg), mean_au, diameter_rad)
    body_radius_m = world.surroundings.body_radius_m
    return sun_at(at, _time(at, draws, world), body_radius_m, world.georeference)


def _time(at: SunFromTimeConfig, draws: NamedDraws, world: World) -> datetime:
    elapsed_s = at.s_per_sample * max(world.sample_id - 1, 0)
    later_h = draws.number("sun_from_time.later_h", at.later_h)
    return at.date_time + timedelta(hours=later_h, seconds=elapsed_s)


def _earthshine(
    config: EnvironmentConfig, draws: NamedDraws, world: World, sun_w_m2: float
) -> tuple[Lamp, ...]:
    """Return the lamp that stands for Earth, if there is to be one and Earth is up.

    Raises:
        InvalidInputError: The body is not the Moon.
    """
    at, body_m = config.sun_from_time, world.surroundings.body_radius_m
    if at is None or not at.earthshine:
        return ()
    if body_name(body_m) != "moon":
        expected = "false: Earth lights the Moon alone (stage.body)"
        raise InvalidInputError("environment.sun_from_time.earthshine", True, expected)
    axes = map_axes(at, world.georeference, body_m)
    lamp = earthshine_lamp(axes, _time(at, draws, world), sun_w_m2)
    return () if lamp is None else (lamp,)


def _gradient(config: SkyConfig) -> Gradient:
    if config.model == "overcast":
        return OVERCAST
    return Gradient(
        zenith=_color(config.zenith_srgb),
        horizon=_color(config.horizon_srgb),
        glow=_color(config.glow_srgb),
        glow_rad=radians(config.glow_deg),
    )


def _strength_of(share: float, gradient: Gradient, sun_elevation_rad: float) -> float:
    """Return the strength at which a plain sky gives level ground a share of 1 W/m² of sunlight.

    After sunset it becomes darker as fast as Earth's.
    """
    irradiance_w_m2 = np.array(gradient_irradiance_w_m2(gradient, sun_elevation_rad))
    twilight = daylight(min(sun_elevation_rad, 0.0)) / daylight(0.0)
    luminance = float(irradiance_w_m2 @ LUMINANCE)
    return share * twilight / luminance if luminance > 0 else 0.0


def _haze(config: HazeConfig | None, draws: NamedDraws) -> Haze | None:
    """Return the haze of a configuration."""
    if config is None:
        return None
    visibility_m = draws.number("haze.visibility_m", config.visibility_m)
    exponent = draws.number("haze.angstrom_exponent", config.angstrom_exponent)
    at_green = -log(MIN_CONTRAST) / visibility_m
    red, green, blue = (at_green * (WAVELENGTHS_NM / WAVELENGTHS_NM[1]) ** -exponent).tolist()
    thickness_m = min(visibility_m * THICKNESS, MAX_THICKNESS_M)
    if config.thickness_m is not None:
        thickness_m = draws.number("haze.thickness_m", config.thickness_m)
    tint = linear(config.color_srgb)
    tint_red, tint_green, tint_blue = (tint / max(tint.mean(), 1e-6)).tolist()
    return Haze((red, green, blue), thickness_m, (tint_red, tint_green, tint_blue))


def _clouds(config: CloudsConfig | None, draws: NamedDraws) -> Clouds | None:
    """Return the clouds of a configuration."""
    if config is None:
        return None
    size_m = draws.number("clouds.size_m", config.size_m)
    thickness_m = CLOUD_THICKNESS[config.kind] * size_m
    if config.thickness_m is not None:
        thickness_m = draws.number("clouds.thickness_m", config.thickness_m)
    return Clouds(
        cover=draws.number("clouds.cover", config.cover),
        base_m=draws.number("clouds.base_m", config.base_m),
        size_m=size_m,
        thickness_m=thickness_m,
        seed=int(draws.rng("clouds").integers(2**31)),
        kind=config.kind,
        shadows=config.shadows,
    )


def _color(srgb: Color) -> Color:
    red, green, blue = linear(srgb).tolist()
    return (red, green, blue)


def _check_names(config: EnvironmentConfig) -> None:
    load_effects(config.effects)
    if config.hdri is not None:
        images_of(config.hdri)
