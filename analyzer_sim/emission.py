"""Emission at the analyzer input at one instant: the only data that the world hands to the instrument.

The world gives the power at each frequency; the instrument draws a trace of it. Nothing else crosses this
boundary, so a client can learn a carrier's power only by measuring it.
"""

from dataclasses import dataclass
from typing import Protocol


@dataclass(frozen=True, slots=True)
class Signal:
    """One carrier at the analyzer input."""

    #: name of the carrier; serves the truth log only, the instrument never tells it
    carrier: str
    #: centre frequency at the analyzer input, Hz
    center_hz: float
    #: symbol rate, Hz; 0 = an unmodulated line
    symbol_rate_hz: float
    #: roll-off of the raised-cosine spectrum, 0..1
    rolloff: float
    #: power at the analyzer input, dBm
    power_dbm: float


@dataclass(frozen=True, slots=True)
class NoiseHump:
    """Noise of an amplifier, or what its distortion leaves, above the floor of the receiving chain: a Gaussian bump."""

    center_hz: float
    #: width at half of the peak, Hz
    width_hz: float
    #: density at the peak, dBm/Hz
    peak_dbm_hz: float


@dataclass(frozen=True, slots=True)
class Emission:
    """Emission at the analyzer input during one row."""

    #: middle of the dwell, microseconds UTC since 1970-01-01
    epoch_us: int
    #: carriers that are on; a carrier that is off is left out
    signals: tuple[Signal, ...]
    #: noise density of the receiving chain, dBm/Hz
    noise_dbm_hz: float
    #: noise that is not flat; each adds to the floor
    humps: tuple[NoiseHump, ...] = ()
    #: how far the oscillator of the receiving chain is off: all that arrives is seen this much higher, Hz
    frequency_offset_hz: float = 0.0


class EndOfScenario(Exception):  # noqa: N818 - it ends a story, as StopIteration ends a loop, and is no error
    """The last row of the scenario has been swept; there is none after it."""


class EmissionSource(Protocol):
    """A world seen from the instrument."""

    def advance(self) -> Emission:
        """Move the virtual clock to the next row and return what arrives there."""

    def current(self) -> Emission:
        """Return what arrives at the present instant without moving the clock."""
