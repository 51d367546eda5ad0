"""Envelope of a command: how much it may change at most. Beyond it a command is refused, never clipped."""

from typing import Annotated, NamedTuple

import numpy as np

from service.core.control.slew_schedule import Effect, Triple

#: rounding of sums that stand just at a limit
_ROUNDING = 1e-9
_AXES = ("yaw", "roll", "pitch")


class Envelope(NamedTuple):
    """Limits about each axis."""

    #: greatest change of an angle, on the way or at the end
    angle_change_deg: float = 0.1
    rate_change_deg_s: float = 3e-4
    impulse_n_m_s: Annotated[float, "Sum of the sizes of a command's pulses."] = 0.02
    impulse_an_hour_n_m_s: Annotated[float, "The same over everything that was sent within an hour."] = 0.1

    def is_within(self, other: "Envelope") -> bool:
        """Return whether no limit is wider than another envelope's, and each is a positive number."""
        return all(0.0 < own <= limit for own, limit in zip(self, other, strict=True))


class Excess(NamedTuple):
    """One limit that a command exceeds."""

    #: yaw, roll or pitch
    axis: str
    #: name of the limit
    quantity: str
    value: float
    limit: float

    def __str__(self) -> str:
        """Return the excess in words."""
        return f"{self.axis} {self.quantity} {self.value:.3g} of {self.limit:g}"


def envelope_excesses(effect: Effect, sent_n_m_s: Triple, envelope: Envelope) -> tuple[Excess, ...]:
    """Return the limits of the envelope that a command exceeds; none: it may be released.

    Parameters
    ----------
    effect : Effect
        Of `slew_schedule.predicted_effect`.
    sent_n_m_s : tuple of float, N m s
        Yaw, roll, pitch: sum of the sizes of the impulses sent within the hour before.
    envelope : Envelope
        The limits.

    Notes
    -----
    Each change is taken at its greatest, on the way as well as at the end: a pair of pulses that nulls itself would
    otherwise count for nothing. What is not a number is beyond every limit.
    """
    measured = {
        "angle_change_deg": np.maximum(np.abs(effect.peak_angle_deg), np.abs(effect.angle_change_deg)),
        "rate_change_deg_s": np.maximum(np.abs(effect.peak_rate_deg_s), np.abs(effect.rate_change_deg_s)),
        "impulse_n_m_s": np.array(effect.gross_impulse_n_m_s),
        "impulse_an_hour_n_m_s": np.add(sent_n_m_s, effect.gross_impulse_n_m_s),
    }
    found = []
    for (quantity, values), limit in zip(measured.items(), envelope, strict=True):
        for axis, value in zip(_AXES, values.tolist(), strict=True):
            # negated, so that a value that is no number is beyond
            if not value <= limit * (1.0 + _ROUNDING):
                found.append(Excess(axis, quantity, value, limit))
    return tuple(found)
