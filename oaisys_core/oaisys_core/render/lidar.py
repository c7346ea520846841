"""Lidar scans by ray casting, shared by all backends.

**Intensity.** The lidar equation for a Lambertian surface that is larger than the beam's footprint
(B. Höfle and N. Pfeifer, "Correction of laser scanning intensity data", ISPRS Journal of
Photogrammetry and Remote Sensing 62, 2007)::

    intensity = 255 * rho * cos(theta) * (R0 / max(R, R0))**2

with reflectance rho, angle of incidence theta, range R and the lidar's reference range R0, up to
which receivers even out the range. rho is the mean of red, green and blue of the surface's linear
albedo, because textures say nothing about the infrared: of the ground's texture over the width of
the beam, of the image of a mesh from a file, or the mean of another object's texture.

**Two returns.** With beam divergence, five rays stand for the beam: its axis and four on the rim of
its cone, each with a fifth of the energy. The nearest hit makes the first return, at the mean range
of all hits that belong to it: those within the separation of returns, and those on the same plane
within the width of the beam, because a slope returns one long echo. The nearest hit of the others
makes the second return likewise. A beam that is only partly on a surface returns that share.

**Lost rays.** The share of lost rays rises linearly from 0 at a configured angle of incidence to 1
at 90 degrees: a simple model of receivers that need a least energy.
"""

from __future__ import annotations

from math import pi, tan
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from oaisys_core.raycast.surface import Surface
from oaisys_core.raycast.view import View
from oaisys_core.render.shading.photometry import to_source
from oaisys_core.render.shading.reflectance import Reflectance
from oaisys_core.scene import LidarErrors, PlacedLidar
from oaisys_core.scene.objects import ids_in_images
from oaisys_core.sensing.faults import CaptureId, generator
from oaisys_core.types import FloatArray, LidarScan, point_dtype

FULL_INTENSITY = 255.0
"""Intensity of a white surface that faces the lidar within its reference range."""

BEAM_RAYS = 5
"""Rays that stand for a beam with divergence."""


class Returns(NamedTuple):
    """What M returns of a scan say.

    Attributes:
        rays: (M,) indices of their rays.
        range_m: (M,) along the rays.
        energy: (M,) share of the energy that a white, facing surface returns: rho * cos(theta).
        cos_incidence: (M,) of the ray that stands for the return.
        hits: (M,) indices of these rays' hits.
    """

    rays: NDArray[np.int64]
    range_m: FloatArray
    energy: FloatArray
    cos_incidence: FloatArray
    hits: NDArray[np.int64]

    def of(self, chosen: NDArray[np.bool_] | NDArray[np.int64]) -> Returns:
        """Return some of them."""
        return Returns(
            self.rays[chosen],
            self.range_m[chosen],
            self.energy[chosen],
            self.cos_incidence[chosen],
            self.hits[chosen],
        )


class Hits(NamedTuple):
    """The N hits of rays: the surface there, normals, reflectance, cosine of incidence."""

    view: View
    normals: FloatArray
    reflectance: FloatArray
    cos_incidence: FloatArray


class LidarCaster:
    """Scans a surface; keeps the reflectance of its textures."""

    def __init__(self) -> None:
        self._reflectance: Reflectance | None = None

    def forget(self) -> None:
        """Drop the world."""
        self._reflectance = None

    def scan(self, surface: Surface, lidar: PlacedLidar, capture: CaptureId) -> LidarScan:
        """Return what a lidar measures.

        Args:
            surface: What there is.
            lidar: The lidar.
            capture: Identifies the scan, for its errors.
        """
        reflectance = self._reflectance_of(surface)
        if lidar.beam_divergence_rad > 0:
            returns, hits = _beam_returns(surface, reflectance, lidar)
        else:
            returns, hits = _ray_returns(surface, reflectance, lidar)
        returns = measure_returns(returns, lidar, capture)
        points = _points(returns, lidar)
        view = hits.view.rows(returns.hits)
        if "instance" in lidar.extra_fields:
            points["instance"] = ids_in_images(view.instance_ids[:, 0])
        if "label" in lidar.extra_fields:
            points["label"] = surface.semantic_ids(view)[:, 0]
        return LidarScan(lidar.name, points, lidar.T_map_lidar)

    def _reflectance_of(self, surface: Surface) -> Reflectance:
        if self._reflectance is None:
            self._reflectance = Reflectance(surface.scene)
        elif self._reflectance.scene is not surface.scene:
            self._reflectance.update(surface.scene)
        return self._reflectance


def rays_in_map(lidar: PlacedLidar, directions: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the rays of a scan in ``map``, each from the lidar's pose at the ray's own time.

    Args:
        lidar: The lidar.
        directions: (N, 3) in the lidar's frame, one for each ray of its pattern.

    Returns:
        Origins, (N, 3) or (3,) if the lidar stands still, and (N, 3) directions.
    """
    if lidar.pose_at is None:
        T = lidar.T_map_lidar
        return T[:3, 3], directions @ T[:3, :3].T
    times_s, which = np.unique(lidar.pattern.times_s, return_inverse=True)
    poses = lidar.pose_at(times_s)[which]
    return poses[:, :3, 3], np.einsum("nij,nj->ni", poses[:, :3, :3], directions)


def measure_returns(returns: Returns, lidar: PlacedLidar, capture: CaptureId) -> Returns:
    """Return what a lidar measures of true returns: with its errors, within its range."""
    errors = lidar.errors
    if errors.drop_from_rad is not None:
        returns = returns.of(~_is_lost(returns.cos_incidence, errors, capture))
    if errors.range_sigma_m > 0:
        rng = generator(errors.seed, "lidar range", *capture)
        error_m = errors.range_sigma_m * rng.standard_normal(len(returns.rays))
        returns = returns._replace(range_m=returns.range_m + error_m)
    inside = (returns.range_m >= lidar.min_range_m) & (returns.range_m <= lidar.max_range_m)
    return returns.of(inside)


def _is_lost(
    cos_incidence: FloatArray, errors: LidarErrors, capture: CaptureId
) -> NDArray[np.bool_]:
    start = errors.drop_from_rad or 0.0
    incidence = np.arccos(np.clip(cos_incidence, 0.0, 1.0))
    share = (incidence - start) / (pi / 2 - start)
    draws = generator(errors.seed, "lidar incidence", *capture).random(len(share))
    return np.asarray(draws < share)


def _hits(
    surface: Surface, reflectance: Reflectance, lidar: PlacedLidar, directions: FloatArray
) -> tuple[NDArray[np.int64], Hits]:
    """Cast one ray per direction; return the indices of those that hit, and their hits."""
    # With a margin, because noise may bring a point back into the lidar's range.
    limit_m = lidar.max_range_m + 5 * lidar.errors.range_sigma_m
    view = surface.cast(*rays_in_map(lidar, directions), limit_m)
    rays = np.flatnonzero(view.is_hit[:, 0])
    view = view.rows(rays)
    normals = surface.normals(view)[:, 0]
    cos_incidence = np.abs(np.einsum("ni,ni->n", normals, view.directions[:, 0]))
    width_m = view.depth_m[:, 0] * lidar.beam_divergence_rad
    of_hits, law = reflectance.at(view, width_m, surface), surface.scene.material.law
    if law is not None:
        on_ground = view.is_ground[:, 0]
        of_hits[on_ground] *= to_source(law, cos_incidence[on_ground])
    return rays, Hits(view, normals, of_hits, cos_incidence)


def _ray_returns(
    surface: Surface, reflectance: Reflectance, lidar: PlacedLidar
) -> tuple[Returns, Hits]:
    """Return one return per ray that hits."""
    rays, hits = _hits(surface, reflectance, lidar, lidar.pattern.directions)
    energy = hits.reflectance * hits.cos_incidence
    numbers = np.arange(len(rays))
    return Returns(rays, hits.view.depth_m[:, 0], energy, hits.cos_incidence, numbers), hits


class BeamHits:
    """The hits of the rays of N beams with divergence; rays that miss have the range ``+inf``.

    Attributes:
        hits: All hits, ray after ray.
    """

    def __init__(self, surface: Surface, reflectance: Reflectance, lidar: PlacedLidar) -> None:
        """Cast all rays of all beams."""
        shape = (BEAM_RAYS, len(lidar.pattern.directions))
        self._separation_m = lidar.return_separation_m
        self._divergence_rad = lidar.beam_divergence_rad
        self._range_m = np.full(shape, np.inf)
        self._energy = np.zeros(shape)
        self._cosines = np.zeros(shape)
        self._numbers = np.zeros(shape, np.int64)
        self._points_m = np.zeros((*shape, 3))
        self._normals = np.zeros((*shape, 3))
        parts, first = [], 0
        for row, directions in enumerate(beam(lidar.pattern.directions, self._divergence_rad)):
            rays, hits = _hits(surface, reflectance, lidar, directions)
            self._range_m[row, rays] = hits.view.depth_m[:, 0]
            self._energy[row, rays] = hits.reflectance * hits.cos_incidence / BEAM_RAYS
            self._cosines[row, rays] = hits.cos_incidence
            self._numbers[row, rays] = np.arange(first, first + len(rays))
            self._points_m[row, rays] = hits.view.points_m[:, 0]
            self._normals[row, rays] = hits.normals
            parts.append(hits)
            first += len(rays)
        self.hits = _join(parts)

    def take_nearest(self) -> Returns:
        """Return the nearest return of each beam that has one, and remove its hits."""
        nearest = self._range_m.argmin(axis=0)
        beams = np.flatnonzero(np.isfinite(self._range_m.min(axis=0)))
        chosen = (nearest[beams], beams)
        group = self._like(nearest)[:, beams]
        count = group.sum(axis=0)
        range_m = np.where(group, self._range_m[:, beams], 0.0).sum(axis=0) / count
        energy = np.where(group, self._energy[:, beams], 0.0).sum(axis=0)
        self._range_m[:, beams] = np.where(group, np.inf, self._range_m[:, beams])
        return Returns(beams, range_m, energy, self._cosines[chosen], self._numbers[chosen])

    def _like(self, nearest: NDArray[np.intp]) -> NDArray[np.bool_]:
        """Return (BEAM_RAYS, N) which hits belong to the same return as the beam's nearest one."""
        every = np.arange(self._range_m.shape[1])
        low_m = self._range_m[nearest, every]
        apart_m = self._points_m - self._points_m[nearest, every]
        off_nearest_m = np.abs(np.einsum("bni,ni->bn", apart_m, self._normals[nearest, every]))
        off_this_m = np.abs(np.einsum("bni,bni->bn", apart_m, self._normals))
        hit = np.isfinite(self._range_m)
        with np.errstate(invalid="ignore"):
            width_m = self._divergence_rad * low_m
            is_near = self._range_m <= low_m + self._separation_m
            is_coplanar = (off_nearest_m <= width_m) & (off_this_m <= width_m)
        return np.asarray(hit & (is_near | is_coplanar))


def _beam_returns(
    surface: Surface, reflectance: Reflectance, lidar: PlacedLidar
) -> tuple[Returns, Hits]:
    """Return the first and the second returns of beams with divergence, in the rays' order."""
    beams = BeamHits(surface, reflectance, lidar)
    first, second = beams.take_nearest(), beams.take_nearest()
    joined = Returns(*(np.concatenate(pair) for pair in zip(first, second, strict=True)))
    return joined.of(np.argsort(joined.rays, kind="stable")), beams.hits


def beam(directions: FloatArray, divergence_rad: float) -> FloatArray:
    """Return the (BEAM_RAYS, N, 3) unit rays of beams: axes, then four on the rim of the cone."""
    # Across the beam and level, or along y where the beam is vertical.
    across = np.stack((-directions[:, 1], directions[:, 0], np.zeros(len(directions))), axis=-1)
    across[np.linalg.norm(across, axis=1) < 1e-9] = (0.0, 1.0, 0.0)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    over = np.cross(directions, across)
    radius = tan(divergence_rad / 2)
    rim = [directions + radius * side for side in (across, -across, over, -over)]
    rays = np.stack((directions, *rim))
    return np.asarray(rays / np.linalg.norm(rays, axis=-1, keepdims=True))


def _join(parts: list[Hits]) -> Hits:
    names = View.__dataclass_fields__
    view = View(**{n: np.concatenate([getattr(p.view, n) for p in parts]) for n in names})
    normals, reflectance, cos_incidence = (
        np.concatenate([part[index] for part in parts]) for index in (1, 2, 3)
    )
    return Hits(view, normals, reflectance, cos_incidence)


def _points(returns: Returns, lidar: PlacedLidar) -> NDArray[np.void]:
    """Return points without the extra fields' values, see `point_dtype`."""
    pattern = lidar.pattern
    points = np.empty(len(returns.rays), point_dtype(lidar.extra_fields))
    xyz = pattern.directions[returns.rays] * returns.range_m[:, None]
    for axis, name in enumerate("xyz"):
        points[name] = xyz[:, axis]
    attenuation = lidar.reference_range_m / np.maximum(returns.range_m, lidar.reference_range_m)
    points["intensity"] = FULL_INTENSITY * returns.energy * attenuation**2
    points["ring"] = pattern.rings[returns.rays]
    points["time"] = pattern.times_s[returns.rays]
    return points
