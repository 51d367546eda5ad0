"""Coupling: how roll and yaw exchange while the spacecraft keeps its axes in inertial space; deg and deg/h."""

import numpy as np

from analyzer_sim.streams import FloatArray
from analyzer_sim.world.orbit.orbit import EARTH_RATE_RAD_S

#: exchange of roll and yaw, 1/h
ORBITAL_RATE_PER_H = EARTH_RATE_RAD_S * 3600.0


def coupling_step(hours: float, *, is_coupled: bool) -> tuple[FloatArray, FloatArray]:
    """Return (phi, gamma): attitude after `hours` = phi @ attitude + gamma @ constant rate in deg/h."""
    rate = ORBITAL_RATE_PER_H if is_coupled else 0.0
    angle = rate * hours
    cosine, sine = np.cos(angle), np.sin(angle)
    phi = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    along = hours * np.sinc(angle / np.pi)
    across = 0.5 * hours * angle * np.sinc(0.5 * angle / np.pi) ** 2
    gamma = np.array([[along, -across, 0.0], [across, along, 0.0], [0.0, 0.0, hours]])
    return phi, gamma
