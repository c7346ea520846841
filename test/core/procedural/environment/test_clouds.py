"""Clouds with volume: closed forms of their light, their cover, and the picture of the dome."""

from collections.abc import Iterator
from dataclasses import replace
from math import exp, pi, sin

import cv2
import numpy as np
import pytest
from coarse_clouds import coarse_clouds
from numpy.typing import NDArray
from synthetic_worlds import SUNNY

from oaisys_core.procedural.environment.clouds import dome
from oaisys_core.procedural.environment.clouds.billows import LEVELS, PERIOD, billows, nearest
from oaisys_core.procedural.environment.clouds.depths import Depths
from oaisys_core.procedural.environment.clouds.field import FORMS, GRID, SLABS, CloudField
from oaisys_core.procedural.environment.clouds.scattering import (
    diffuse_share,
    in_scattering,
    order_phases,
    phase,
)
from oaisys_core.procedural.environment.clouds.shadows import CloudShadows, cloud_shadows
from oaisys_core.procedural.environment.clouds.tile import Tile
from oaisys_core.scene.sky import CloudKind, Clouds
from oaisys_core.types import FloatArray

FAIR = Clouds(0.3, 1400.0, 1800.0, 800.0, seed=3)
WHITE = 0.75
"""Albedo of white ground, such as fresh snow in the visible."""


@pytest.fixture
def small_dome() -> Iterator[None]:
    """A dome with a sixteenth of the pixels."""
    with coarse_clouds():
        yield


def extinctions_per_m(field: CloudField, points: int) -> FloatArray:
    """Extinction of all slabs above random places, finer lobes included: (SLABS, points)."""
    x, y = np.random.default_rng(1).uniform(0, GRID, (2, points)).astype(np.float32)
    excess = Tile(field.excess).at(x, y)
    return np.array([field.slab(index).at(excess, x, y) for index in range(SLABS)])


def rays_of(rows: NDArray[np.intp], columns: NDArray[np.intp]) -> FloatArray:
    """Unit vectors through the middles of a dome's pixels."""
    up_rad = dome.cloud_elevations_rad()[rows]
    azimuth_rad = 2 * pi * (columns + 0.5) / dome.COLUMNS
    level = np.cos(up_rad)
    return np.column_stack(
        (level * np.cos(azimuth_rad), level * np.sin(azimuth_rad), np.sin(up_rad))
    )


@pytest.mark.parametrize("narrowness", [0.0, 0.5, 1.0])
def test_all_light_is_scattered_somewhere(narrowness: float) -> None:
    cosines = (np.arange(20_000, dtype=np.float32) + 0.5) / 10_000 - 1
    total = 4 * pi * phase(cosines, narrowness).mean(dtype=np.float64)
    assert total == pytest.approx(1, abs=1e-3)


def test_a_thick_cloud_that_faces_the_sun_is_as_bright_as_white_ground() -> None:
    """From behind the observer or from the side, and darker on the side away from the sun."""
    edges = np.linspace(0, 60, 6001)
    depth = ((edges[1:] + edges[:-1]) / 2).astype(np.float32)
    for cosine in (-1.0, -0.5, 0.0):
        phases = np.broadcast_to(order_phases(np.array([cosine], np.float32)), (8, len(depth)))
        # The observer looks in where the sun shines in.
        held = np.exp(-edges[:-1]) - np.exp(-edges[1:])
        reflected = pi * float((in_scattering(depth, phases) * held).sum())
        assert 0.65 < reflected < 0.85
        behind = pi * float(in_scattering(np.array([40], np.float32), phases[:, :1])[0])
        assert 0.1 < behind < 0.25
    assert diffuse_share(np.array([0, 40], np.float32)) == pytest.approx([1, 1 / 5.5], rel=1e-6)


def test_lobes_repeat_without_a_seam() -> None:
    lobes = billows()
    assert lobes.shape == (LEVELS, PERIOD, PERIOD)
    assert lobes.std() == pytest.approx(1, abs=1e-3)
    for axis in range(3):
        step = np.abs(np.diff(lobes, axis=axis)).mean()
        seam = np.abs(lobes.take(0, axis) - lobes.take(-1, axis)).mean()
        assert seam == pytest.approx(step, rel=0.1)


def test_the_nearest_point_is_found_across_cells() -> None:
    found = nearest(2, 4, 16, np.random.default_rng(5))
    points = np.random.default_rng(5).random((3, 2, 4, 4), dtype=np.float32)
    cells = np.array(np.meshgrid(range(2), range(4), range(4), indexing="ij"))
    points = (points + cells).reshape(3, -1)
    voxels = (np.array(np.meshgrid(range(8), range(16), range(16), indexing="ij")) + 0.5) / 4
    away = np.abs(voxels.reshape(3, -1, 1) - points[:, None])
    size = np.array((2, 4, 4)).reshape(3, 1, 1)
    away = np.sqrt((np.minimum(away, size - away) ** 2).sum(axis=0)).min(axis=1)
    np.testing.assert_allclose(found.ravel(), away, rtol=1e-4)


def test_a_tile_goes_on_beyond_its_edges() -> None:
    image = np.random.default_rng(2).random((8, 8)).astype(np.float32)
    x, y = np.array([3, 11, -5, 7.5, 2], np.float32), np.array([2, -6, 18, 0, 7.5], np.float32)
    expected = [image[2, 3]] * 3 + [image[0, [7, 0]].mean(), image[[7, 0], 2].mean()]
    np.testing.assert_allclose(Tile(image).at(x, y), expected, rtol=1e-5)


@pytest.mark.parametrize("kind", FORMS)
@pytest.mark.parametrize("cover", [0.15, 0.4, 0.8])
def test_clouds_hide_the_share_of_the_sky_that_was_asked_for(kind: CloudKind, cover: float) -> None:
    field = CloudField(replace(FAIR, kind=kind, cover=cover, seed=round(100 * cover)))
    through = np.exp(-extinctions_per_m(field, 20_000).sum(axis=0) * field.slab_m)
    assert 1 - through.mean() == pytest.approx(cover, abs=0.03)


def test_bases_are_flat_and_tops_are_not() -> None:
    field = CloudField(FAIR)
    is_cloud = extinctions_per_m(field, 20_000) > 0
    above = is_cloud.any(axis=0)
    base, top = is_cloud[:, above].argmax(axis=0), SLABS - is_cloud[::-1, above].argmax(axis=0)
    assert (base < SLABS / 4).mean() > 0.85
    assert top.std() > SLABS / 8


@pytest.mark.usefixtures("small_dome")
def test_an_even_layer_weakens_light_by_beer_and_lamberts_law() -> None:
    """Clouds without a gap, so thin that they are the same all over, before sky and sun."""
    clouds = Clouds(1.0, 1000.0, 1000.0, 10.0, seed=1)
    field = CloudField(clouds)
    values = extinctions_per_m(field, 50)
    assert np.ptp(values, axis=1).max() == 0
    depth = float(values[:, 0].sum() * field.slab_m)
    found = dome.cloud_dome(clouds, 0.5, 1.0)
    assert found.sunlit == pytest.approx(exp(-depth / sin(0.5)), rel=1e-3)
    up_rad = dome.cloud_elevations_rad()
    rows = np.flatnonzero(up_rad > 0.3)[::20]
    clear = dome.air_clearness(dome.distances_m(up_rad[rows], 1005.0))
    through = (found.lights[3, rows, 7] - (1 - clear)) / clear
    np.testing.assert_allclose(through, np.exp(-depth / np.sin(up_rad[rows])), rtol=0.01)


def test_depths_towards_the_sun_are_those_of_a_walk_to_it() -> None:
    field = CloudField(FAIR)
    elevation_rad, azimuth_rad = 0.9, 2.2
    depths = Depths(field, elevation_rad, azimuth_rad)
    for index in reversed(range(SLABS)):
        depths.next_slab(index, field.slab(index))
    # Texels on the base from which one walks, slab by slab.
    x, y = np.random.default_rng(4).integers(0, GRID, (2, 4000)).astype(np.float32)
    walked = np.zeros(len(x))
    for index in range(SLABS):
        away = (index + 0.5) * field.slab_m / np.tan(elevation_rad) / field.texel_m
        at = x + np.float32(away * np.cos(azimuth_rad)), y + np.float32(away * np.sin(azimuth_rad))
        of_slab = Tile(field.slab(index).on_grid(field.excess)).at(*at)
        walked += of_slab * field.slab_m / sin(elevation_rad)
    found = np.exp(-Tile(depths.to_sun).at(x, y).astype(float))
    # The sum goes in steps of whole texels.
    assert np.abs(found - np.exp(-walked)).mean() < 0.02
    assert np.corrcoef(found, np.exp(-walked))[0, 1] > 0.98


@pytest.mark.usefixtures("small_dome")
class TestDome:
    sky = replace(SUNNY, clouds=FAIR)

    def test_a_direction_shows_its_pixel(self) -> None:
        image = dome.cloud_image(self.sky)
        rows, columns = np.random.default_rng(3).integers(0, (dome.ROWS, dome.COLUMNS), (500, 2)).T
        seen = dome.before_sky(self.sky, 3 * rays_of(rows, columns), np.full((500, 3), 2.0))
        expected = image[rows, columns, :3] + 2 * image[rows, columns, 3:]
        np.testing.assert_allclose(seen, expected, atol=0.02 * image.max())
        assert np.abs(seen - expected).mean() < 1e-3 * image[..., :3].mean() + 1e-4

    def test_tops_are_as_bright_as_white_ground_and_bases_darker(self) -> None:
        image = dome.cloud_image(self.sky)
        is_opaque = image[..., 3] < 0.5
        up_rad = dome.cloud_elevations_rad()[:, None]
        azimuth_rad = 2 * pi * (np.arange(dome.COLUMNS) + 0.5) / dome.COLUMNS
        from_sun = np.cos(azimuth_rad - self.sky.sun_azimuth_rad)
        # Opposite to the sun one sees sunlit sides, overhead the bases.
        sides = image[is_opaque & (from_sun < -0.7) & (up_rad > 0.1) & (up_rad < 0.5)][:, 1]
        bases = image[is_opaque & (up_rad > 0.6)][:, 1]
        white = WHITE * 4.0 * sin(self.sky.sun_elevation_rad) / pi
        assert 0.7 * white < np.quantile(sides, 0.9) < 1.4 * white
        assert np.median(bases) < np.quantile(sides, 0.9)
        assert np.quantile(bases, 0.1) < 0.6 * np.quantile(sides, 0.9)

    def test_the_disc_is_hidden_by_thick_clouds_and_seen_beside_them(self) -> None:
        image = dome.cloud_image(self.sky)
        row = int(np.argmin(np.abs(dome.cloud_elevations_rad() - self.sky.sun_elevation_rad)))
        columns = np.arange(dome.COLUMNS)
        seen = dome.sun_through_clouds(self.sky, rays_of(np.full_like(columns, row), columns))
        assert seen.min() == pytest.approx(0, abs=0.02)
        assert seen.max() == pytest.approx(1, abs=1e-6)
        assert (seen[image[row, :, 3] == 1] == 1).all()

    def test_a_sun_that_moves_a_little_keeps_the_clouds_light(self) -> None:
        found = dome.cloud_image(self.sky)
        later = replace(self.sky, sun_azimuth_rad=self.sky.sun_azimuth_rad + 1e-3)
        assert (dome.cloud_image(later) == found).all()

    def test_threads_do_not_change_a_byte(self) -> None:
        args = FAIR, 0.5, 2.0
        before = cv2.getNumThreads()
        try:
            cv2.setNumThreads(1)
            found = dome.cloud_dome.__wrapped__(*args).lights
            cv2.setNumThreads(4)
            again = dome.cloud_dome.__wrapped__(*args).lights
        finally:
            cv2.setNumThreads(before)
        assert (found == again).all()


def test_shadows_lie_where_clouds_hide_the_sun(small_dome: None) -> None:
    """Against rays of the dome, which are marched from the eye."""
    for elevation_deg in (30.0, 60.0):
        sky = replace(SUNNY, sun_elevation_rad=np.radians(elevation_deg), clouds=FAIR)
        shadows = cloud_shadows(sky)
        assert shadows is not None
        share = float(shadows.at(np.zeros((1, 3)))[0])
        through = float(dome.sun_through_clouds(sky, np.array([sky.to_sun]))[0])
        # Where a hundredth of the direct light gets through, depth is 4.6.
        assert (share > 0.95) == (through > 0.6)
        assert (share < 1 / (1 + 0.1125 * 4.6)) == (through < 0.02)


def test_shadows_are_shifted_by_height_and_end_above_the_clouds() -> None:
    share = np.random.default_rng(1).random((GRID, GRID)).astype(np.float32)
    shadows = CloudShadows(share, 300.0, 100.0, (2.0, -1.0), (0.0, 0.0))
    texel_m = 300.0 / GRID
    undersides_m = np.array(((5 * texel_m, 7 * texel_m, 100.0), (-texel_m, 301 * texel_m, 100.0)))
    undersides_m[:, 2] -= 1e-9
    expected = [share[7, 5], share[301 % GRID, -1]]
    np.testing.assert_allclose(shadows.at(undersides_m), expected, atol=1e-3)
    below_m = undersides_m - 60.0 * np.array((2.0, -1.0, 1.0))
    np.testing.assert_allclose(shadows.at(below_m), expected, atol=1e-3)
    np.testing.assert_array_equal(shadows.at(undersides_m + np.array((0, 0, 1))), 1)


@pytest.mark.usefixtures("small_dome")
def test_no_shadows_without_a_sun_that_shines_through_clouds() -> None:
    sky = replace(SUNNY, clouds=FAIR)
    assert cloud_shadows(sky) is not None
    for other in (
        replace(sky, clouds=None),
        replace(sky, clouds=replace(FAIR, shadows=False)),
        replace(sky, sun_strength_w_m2=0.0),
        replace(sky, sun_elevation_rad=0.001),
    ):
        assert cloud_shadows(other) is None
