"""Tones: flexible modes of the panels as they move the hub, each an oscillator pushed by the torque on the body.

    q'' + 2 zeta omega q' + omega^2 q = coupling T / J        the hub turns by the rigid angle plus the sum of its q

Stepped exactly for a torque that is constant over the step. Tones do not act back on the loop on board.
"""

import cmath
import math
from dataclasses import dataclass

AXES = ("roll", "pitch", "yaw")


@dataclass(slots=True)
class HubTone:
    """One mode."""

    #: place among x roll, y pitch, z yaw
    axis: int
    omega_rad_s: float
    damping_ratio: float
    coupling: float
    angle_rad: float = 0.0
    rate_rad_s: float = 0.0

    def push(self, acceleration_rad_s2: float, span_s: float) -> None:
        """Go on for a span under the rigid body's acceleration."""
        rest = self.coupling * acceleration_rad_s2 / self.omega_rad_s**2
        pole = complex(-self.damping_ratio, math.sqrt(1.0 - self.damping_ratio**2)) * self.omega_rad_s
        # the solution Re(c exp(pole t)) + rest whose start has the present angle and rate
        away = self.angle_rad - rest
        across = (pole.real * away - self.rate_rad_s) / pole.imag
        moved = complex(away, across) * cmath.exp(pole * span_s)
        self.angle_rad = rest + moved.real
        self.rate_rad_s = (pole * moved).real


def parse_tone(text: str) -> HubTone:
    """Return a tone written AXIS:OMEGA:DAMPING:COUPLING.

    Raises
    ------
    ValueError
        The text is no tone, or no oscillation.
    """
    parts = text.split(":")
    if len(parts) != 4 or parts[0] not in AXES:
        raise ValueError(f"{text!r}: a tone is AXIS:OMEGA:DAMPING:COUPLING with an axis of {', '.join(AXES)}")
    omega, damping, coupling = (float(part) for part in parts[1:])
    if not (0.0 < omega < 100.0 and 0.0 < damping < 1.0 and abs(coupling) <= 10.0):
        raise ValueError(f"{text!r}: 0 < omega < 100 rad/s, 0 < damping < 1, |coupling| <= 10")
    return HubTone(AXES.index(parts[0]), omega, damping, coupling)
