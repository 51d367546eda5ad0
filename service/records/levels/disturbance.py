"""Disturbance torque that the loop on board does not feed forward, as the filter knows it."""

import math
from dataclasses import dataclass

from service.records.epoch import US_PER_S
from service.records.levels.attitude import Axes


@dataclass(frozen=True, slots=True)
class Disturbance:
    """A constant torque on the body and one that goes round once a period, by yaw, roll and pitch."""

    #: where the phase of the periodic part is zero
    epoch_us: int
    period_s: float
    constant_n_m: Axes
    cosine_n_m: Axes
    sine_n_m: Axes
    #: one standard deviation of the torque at the epoch
    sigma_n_m: Axes

    def torque_n_m(self, at_us: int) -> Axes:
        """Return the torque expected at an instant."""
        phase = 2.0 * math.pi * (at_us - self.epoch_us) / (self.period_s * US_PER_S)
        cosine, sine = math.cos(phase), math.sin(phase)
        parts = zip(self.constant_n_m, self.cosine_n_m, self.sine_n_m, strict=True)
        return Axes(*(constant + cosine * c + sine * s for constant, c, s in parts))
