"""Level errors of the analyzer: offset, gain wander, ripple, switching errors. All in dB, all seeded.

Law of this file: an error that is common to a whole trace is a number, one that depends on frequency an array; nothing
here depends on the emission. The defaults add 0.09 dB rms over a day beside the statistics of noise, 0.02 dB of it from
one sweep to the next; all of that is common to the carriers of a sweep.

Frequency response: flatness over the band (three long waves whose sum stays inside its bound) and ripple of the filters
(three waves of tens of MHz). Both are static: they belong to the instrument and to its seed.
"""

import math
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

import numpy as np

from analyzer_sim.streams import FloatArray, stream

_US_PER_HOUR = 3.6e9
_US_PER_DAY = 24 * _US_PER_HOUR
#: periods of the ripple of the IF filters, Hz
_RIPPLE_PERIODS_HZ = (61e6, 25e6, 11e6)
#: periods of the flatness over the band, Hz
_FLATNESS_PERIODS_HZ = (7.3e9, 2.9e9, 1.1e9)
#: an error of a switch stays inside this many sigmas: makers give bounds
_SWITCH_BOUND_SIGMAS = 2.0


@dataclass(frozen=True, slots=True)
class Imperfections:
    """Figures of one instrument (engineering values); sigmas are one standard deviation."""

    #: noise the analyzer adds at 0 dB attenuation, preamplifier off, dBm/Hz
    own_noise_dbm_hz: float = -150.0
    #: how much the preamplifier lowers it, dB
    preamplifier_gain_db: float = 15.0
    #: absolute level error, drawn once per instrument
    absolute_sigma_db: float = 0.25
    #: repeatability, drawn for each sweep
    repeatability_sigma_db: float = 0.02
    #: gain wander: first-order process, its sigma and correlation time
    wander_sigma_db: float = 0.05
    wander_tau_h: float = 1.0
    #: temperature: dB per degC and half the daily swing of the room
    temperature_db_per_deg_c: float = -0.02
    daily_swing_deg_c: float = 5.0
    #: ripple of the filters over tens of MHz, static, rms
    ripple_sigma_db: float = 0.05
    #: response over the whole band, static, bound
    flatness_bound_db: float = 0.3
    #: error of each resolution filter and each attenuator step; none is beyond twice its sigma
    rbw_switching_sigma_db: float = 0.05
    attenuator_sigma_db: float = 0.1


#: an instrument without errors of its own; statistics of noise remain
IDEAL = Imperfections(
    own_noise_dbm_hz=-400.0,
    absolute_sigma_db=0.0,
    repeatability_sigma_db=0.0,
    wander_sigma_db=0.0,
    daily_swing_deg_c=0.0,
    ripple_sigma_db=0.0,
    flatness_bound_db=0.0,
    rbw_switching_sigma_db=0.0,
    attenuator_sigma_db=0.0,
)


class LevelErrors:
    """The errors of one instrument along its virtual time.

    Parameters
    ----------
    figures : Imperfections
        Sizes of the errors.
    seed : int
        Two instruments of one seed err alike.
    """

    def __init__(self, figures: Imperfections, seed: int) -> None:
        self._figures = figures
        self._seed = seed
        self._rng = stream(seed, "analyzer", "level errors")
        self._absolute_db = figures.absolute_sigma_db * float(stream(seed, "analyzer", "absolute").standard_normal())
        self._ripple_phases = stream(seed, "analyzer", "ripple").uniform(0.0, 2.0 * math.pi, len(_RIPPLE_PERIODS_HZ))
        self._flatness_phases = stream(seed, "analyzer", "flatness").uniform(
            0.0, 2.0 * math.pi, len(_FLATNESS_PERIODS_HZ)
        )
        self._wander_db = figures.wander_sigma_db * float(self._rng.standard_normal())
        self._wander_epoch_us: int | None = None
        self._switches_db: dict[tuple[str, float], float] = {}

    def own_noise_dbm_hz(self, attenuation_db: float, *, is_preamplifier_on: bool) -> float:
        """Return the noise density the analyzer adds, referred to the input."""
        gain_db = self._figures.preamplifier_gain_db if is_preamplifier_on else 0.0
        return self._figures.own_noise_dbm_hz + attenuation_db - gain_db

    def sweep_error_db(self, epoch_us: int, rbw_hz: float, attenuation_db: float) -> float:
        """Return the error common to one sweep at this epoch; draws once per call."""
        figures = self._figures
        self._move_wander(epoch_us)
        phase = 2.0 * math.pi * (epoch_us % _US_PER_DAY) / _US_PER_DAY
        temperature_db = figures.temperature_db_per_deg_c * figures.daily_swing_deg_c * math.sin(phase)
        repeatability_db = figures.repeatability_sigma_db * float(self._rng.standard_normal())
        return (
            self._absolute_db
            + self._wander_db
            + temperature_db
            + repeatability_db
            + self._switching_db("rbw", rbw_hz, figures.rbw_switching_sigma_db)
            + self._switching_db("attenuator", attenuation_db, figures.attenuator_sigma_db)
        )

    def ripple_db(self, frequency_hz: FloatArray) -> FloatArray:
        """Return the static response at these frequencies, ripple and flatness together, shape (B,)."""
        ripple = self._figures.ripple_sigma_db * math.sqrt(2.0 / len(_RIPPLE_PERIODS_HZ))
        flatness = self._figures.flatness_bound_db / len(_FLATNESS_PERIODS_HZ)
        waves = [(ripple, *wave) for wave in zip(_RIPPLE_PERIODS_HZ, self._ripple_phases, strict=True)]
        waves += [(flatness, *wave) for wave in zip(_FLATNESS_PERIODS_HZ, self._flatness_phases, strict=True)]
        response_db = np.zeros_like(frequency_hz)
        for scale_db, period_hz, phase in waves:
            response_db += scale_db * np.cos(2.0 * math.pi * frequency_hz / period_hz + phase)
        return response_db

    def _move_wander(self, epoch_us: int) -> None:
        """Carry the gain wander to this epoch; time that stands still moves nothing."""
        last_us = epoch_us if self._wander_epoch_us is None else self._wander_epoch_us
        self._wander_epoch_us = epoch_us
        if epoch_us <= last_us:
            return
        keep = math.exp(-(epoch_us - last_us) / (self._figures.wander_tau_h * _US_PER_HOUR))
        shock = math.sqrt(1.0 - keep**2) * float(self._rng.standard_normal())
        self._wander_db = keep * self._wander_db + self._figures.wander_sigma_db * shock

    def _switching_db(self, part: str, value: float, sigma_db: float) -> float:
        """Return the fixed error of one position of a switch."""
        key = part, value
        if key not in self._switches_db:
            drawn = float(stream(self._seed, "analyzer", part, f"{value:g}").standard_normal())
            bound = _SWITCH_BOUND_SIGMAS
            self._switches_db[key] = sigma_db * min(max(drawn, -bound), bound)
        return self._switches_db[key]


#: every so many points a fault of values takes one, so that no carrier of a wide sweep is spared
_EVERY = 10
#: 1 mW in 50 ohm above 1 uV, dB
_DBUV_ABOVE_DBM = 106.9897


class TraceFault(Enum):
    """Faults in the numbers of one trace."""

    #: every tenth point is not a number
    NAN = "nan"
    #: every tenth point is -999, what some makers show where there is no result
    NO_RESULT = "no_result"
    #: every tenth point is 9.91E37, SCPI's number for "not a number" (SCPI-99, 7.2.1.5)
    SCPI_NAN = "scpi_nan"
    #: every tenth point is 9.9E37, SCPI's infinity
    SCPI_INFINITY = "scpi_infinity"
    #: the last point is missing
    SHORT = "short"
    #: one point too many
    LONG = "long"
    #: there is not a single point
    EMPTY = "empty"
    #: levels are in dBuV, whatever unit is set
    UNIT_DBUV = "unit_dbuv"
    #: levels are in W, whatever unit is set
    UNIT_WATT = "unit_watt"


_VALUES = {
    TraceFault.NAN: float("nan"),
    TraceFault.NO_RESULT: -999.0,
    TraceFault.SCPI_NAN: 9.91e37,
    TraceFault.SCPI_INFINITY: 9.9e37,
}

_SHAPES: dict[TraceFault, Callable[[FloatArray], FloatArray]] = {
    TraceFault.SHORT: lambda shown: shown[:-1],
    TraceFault.LONG: lambda shown: np.concatenate([shown, shown[-1:]]),
    TraceFault.EMPTY: lambda shown: shown[:0],
    TraceFault.UNIT_DBUV: lambda shown: shown + _DBUV_ABOVE_DBM,
    TraceFault.UNIT_WATT: lambda shown: np.asarray(10.0 ** (0.1 * shown - 3.0)),
}


class TraceFaults:
    """Faults to come, in order; may be armed from any thread.

    Examples
    --------
    >>> faults = TraceFaults()
    >>> faults.arm(TraceFault.SHORT)
    >>> faults.spoil(np.zeros(3)).shape, faults.spoil(np.zeros(3)).shape
    ((2,), (3,))
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._armed: deque[TraceFault] = deque()

    def arm(self, fault: TraceFault, times: int = 1) -> None:
        """Let the next traces read suffer this fault."""
        with self._lock:
            self._armed.extend([fault] * times)

    def disarm(self) -> None:
        """Forget all faults to come."""
        with self._lock:
            self._armed.clear()

    @property
    def remaining(self) -> int:
        """Faults armed and not yet spent."""
        with self._lock:
            return len(self._armed)

    def spoil(self, shown: FloatArray) -> FloatArray:
        """Return levels as they are shown, shape (B,), with the next fault in them, if there is one."""
        with self._lock:
            fault = self._armed.popleft() if self._armed else None
        return shown if fault is None else _spoiled(fault, shown)


def _spoiled(fault: TraceFault, shown: FloatArray) -> FloatArray:
    if fault in _VALUES:
        wrong = shown.copy()
        wrong[::_EVERY] = _VALUES[fault]
        return wrong
    return _SHAPES[fault](shown)
