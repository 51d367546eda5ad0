"""Antenna patterns: gain of a receive beam over the antenna frame, `G(az, el)` in dB, angles in deg.

    G = -c_az u^2 / 2 - c_el v^2 / 2 + c_x u v + sum_k a_k cos(p_k u + q_k v + s_k),   u = az - az0, v = el - el0

The patterns are invented: a curvature nearly common to all carriers (1.5 dB/deg^2 along pitch, 2.7 along roll) and a
weak ripple that no quadratic describes, as shaped reflectors have it.
"""

from dataclasses import dataclass

import numpy as np

from analyzer_sim.streams import FloatArray


@dataclass(frozen=True, slots=True)
class Ripple:
    """One wave of the shaped pattern."""

    #: amplitude, dB
    amplitude_db: float
    #: wave numbers along azimuth and elevation, rad/deg
    azimuth_rad_deg: float
    elevation_rad_deg: float
    #: phase at the centre, rad
    phase_rad: float


@dataclass(frozen=True, slots=True)
class Beam:
    """One shaped beam of the satellite."""

    name: str
    #: centre in the antenna frame, deg
    azimuth_deg: float
    elevation_deg: float
    #: curvatures, dB/deg^2, positive = falling away from the centre
    azimuth_curvature: float = 1.5
    elevation_curvature: float = 2.7
    cross_curvature: float = 0.0
    ripples: tuple[Ripple, ...] = ()

    def gain_db(self, azimuth_deg: FloatArray, elevation_deg: FloatArray) -> FloatArray:
        """Return the gain relative to the centre, dB, for any shape of angles."""
        u = azimuth_deg - self.azimuth_deg
        v = elevation_deg - self.elevation_deg
        gain = (
            -0.5 * self.azimuth_curvature * u**2 - 0.5 * self.elevation_curvature * v**2 + self.cross_curvature * u * v
        )
        for wave in self.ripples:
            phase = wave.azimuth_rad_deg * u + wave.elevation_rad_deg * v + wave.phase_rad
            gain = gain + wave.amplitude_db * np.cos(phase)
        return np.asarray(gain)
