"""Laws by which the ground of planets reflects sunlight, beside Lambert's.

They are bidirectional reflectances relative to Lambert's law, which are 1 at an incidence of 30
degrees, seen from above: there, a surface of each law is as bright as one of Lambert's law of the
same albedo. For formulas and sources see `oaisys_core.render.shading.photometry`.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class LommelSeeliger:
    """Single isotropic scattering in a dark, powdery ground."""


@dataclass(frozen=True)
class LunarLambert:
    """A mixture of the laws of Lommel and Seeliger and of Lambert, by the phase angle."""


@dataclass(frozen=True)
class Hapke:
    """Hapke's law, with the opposition surge and macroscopic roughness.

    Attributes:
        w: Albedo of single scattering, which here is only of influence on the form of the law: how
            bright the ground is, its textures say.
        b, c: Of the phase function of two lobes (Henyey and Greenstein): width of the lobes, and
            from -1 (forwards) to 1 (back to the sun).
        b0: Amplitude of the opposition surge.
        h: Its width, as the tangent of half the phase angle.
        theta_bar_rad: Mean angle of the slopes within a pixel.
    """

    w: float
    b: float
    c: float
    b0: float
    h: float
    theta_bar_rad: float


PhotometricLaw = LommelSeeliger | LunarLambert | Hapke
