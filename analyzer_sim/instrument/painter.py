"""Emission and settings -> one displayed trace, dBm: mean trace, statistics, instrument errors, overload.

Order of the signal path: input, attenuator and own noise, resolution filter, detector, gain errors, clipping.
"""

import math
from collections.abc import Callable
from enum import Enum
from functools import lru_cache, partial, reduce
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from analyzer_sim.emission import Emission
from analyzer_sim.instrument.detectors import (
    FAST_DRAWS,
    MAX_SAMPLES,
    MAX_SAMPLES_ALL_SWEEPS,
    Dwell,
    draw_envelope,
    draw_rms,
    sample_count,
)
from analyzer_sim.instrument.imperfections import Imperfections, LevelErrors
from analyzer_sim.instrument.instrument_settings import Settings
from analyzer_sim.instrument.spectrum import MeanTrace, SweepGrid, mean_trace, milliwatts, too_fast_line_loss
from analyzer_sim.streams import stream

FloatArray = NDArray[np.float64]

#: level at the mixer above which it is overloaded, dBm
MIXER_OVERLOAD_DBM = -10.0
#: the input may exceed the reference level by this much, dB
HEADROOM_DB = 10.0
#: bits of QUEStionable:POWer
RF_OVERLOAD = 1 << 0
IF_OVERLOAD = 1 << 2
_LEAST_MW = 1e-30


class Detail(Enum):
    """Detail of the statistics of a trace."""

    #: Gamma draws for the RMS detector, the envelope for the others
    FAST = "fast"
    #: the envelope for every detector
    ENVELOPE = "envelope"


class Trace(NamedTuple):
    """One displayed trace."""

    #: shape (B,), dBm, the level offset included
    level_dbm: FloatArray
    #: bits of QUEStionable:POWer
    overload: int
    epoch_us: int
    #: where it was taken and with which filter
    grid: SweepGrid


class TracePainter:
    """Draws traces of emissions as one instrument shows them.

    Parameters
    ----------
    seed : int
        Seed of statistics and instrument errors.
    imperfections : Imperfections, optional
        Figures of the instrument.
    detail : Detail
        Method of the statistics.
    """

    def __init__(self, seed: int, imperfections: Imperfections | None = None, detail: Detail = Detail.FAST) -> None:
        self._errors = LevelErrors(imperfections or Imperfections(), seed)
        self._rng = stream(seed, "analyzer", "trace statistics")
        self._detail = detail
        self._ripple_gain = lru_cache(maxsize=8)(self._compute_ripple_gain)

    def paint(self, emission: Emission, settings: Settings) -> Trace:
        """Return the trace of one measurement; ``settings.sweeps`` sweeps are combined."""
        grid = SweepGrid(settings.start_hz, settings.stop_hz, settings.points, settings.rbw_hz)
        attenuation_db = settings.attenuation_db
        own_noise = self._errors.own_noise_dbm_hz(attenuation_db, is_preamplifier_on=settings.is_preamplifier_on)
        loss = 1.0 if settings.is_fft else too_fast_line_loss(settings.span_hz, settings.rbw_hz, settings.time_s)
        mean = mean_trace(emission, grid, own_noise, loss)
        power_mw = self._statistics(mean, grid, settings)
        overload = Overload.of(emission, settings)
        error_db = self._errors.sweep_error_db(emission.epoch_us, settings.rbw_hz, attenuation_db)
        power_mw *= self._ripple_gain(grid) * milliwatts(error_db - overload.compression_db)
        level_dbm = 10.0 * np.log10(np.maximum(power_mw, _LEAST_MW))
        np.minimum(level_dbm, settings.reference_dbm + HEADROOM_DB, out=level_dbm)
        level_dbm += settings.level_offset_db
        return Trace(level_dbm, overload.bits, emission.epoch_us, grid)

    def _statistics(self, mean: MeanTrace, grid: SweepGrid, settings: Settings) -> FloatArray:
        """Draw the sweeps of one measurement and combine them, mW."""
        dwell = _dwell(grid, settings)
        if self._wants_envelope(grid, settings):
            figures = settings.time_s, settings.detector, settings.vbw_hz
            return _combined(partial(draw_envelope, mean, grid, *figures, self._rng), settings)
        if settings.combination == "POW" and settings.detector == "RMS":
            return draw_rms(mean, dwell, self._rng, settings.sweeps)
        return _combined(partial(FAST_DRAWS[settings.detector], mean, dwell, self._rng), settings)

    def _wants_envelope(self, grid: SweepGrid, settings: Settings) -> bool:
        """Tell whether statistics are drawn in time: wanted or needed, and not beyond the longest envelope."""
        samples = sample_count(grid, settings.time_s)
        if settings.is_fft or samples > MAX_SAMPLES or samples * settings.sweeps > MAX_SAMPLES_ALL_SWEEPS:
            return False
        return self._detail is Detail.ENVELOPE or settings.detector != "RMS"

    def _compute_ripple_gain(self, grid: SweepGrid) -> FloatArray:
        return np.asarray(10.0 ** (0.1 * self._errors.ripple_db(grid.frequency_hz)))


def _combined(draw: Callable[[], FloatArray], settings: Settings) -> FloatArray:
    """Draw the sweeps and combine them by the average type or the hold."""
    if settings.sweeps == 1:
        return draw()
    if settings.combination in HOLDS:
        return reduce(HOLDS[settings.combination], (draw() for _ in range(settings.sweeps)))
    to_scale, from_scale = COMBINATIONS[settings.combination]
    total = to_scale(draw())
    for _ in range(settings.sweeps - 1):
        total = total + to_scale(draw())
    return from_scale(total / settings.sweeps)


def _dwell(grid: SweepGrid, settings: Settings) -> Dwell:
    dwell_s = settings.time_s if settings.is_fft else settings.time_s / grid.points
    return Dwell(grid.rbw_hz, dwell_s, grid.spacing_hz, settings.is_fft, settings.vbw_hz)


class Overload(NamedTuple):
    """Overload of the mixer or of the reference level by too strong an input."""

    #: bits of QUEStionable:POWer
    bits: int
    #: how much the whole trace is too low, dB
    compression_db: float

    @classmethod
    def of(cls, emission: Emission, settings: Settings) -> "Overload":
        """Compare the sum of all signals with the mixer and with the reference level.

        A mixer driven beyond its limit passes that power and no more, so that all levels fall together.
        """
        total_mw = sum(milliwatts(signal.power_dbm) for signal in emission.signals)
        total_dbm = 10.0 * math.log10(max(total_mw, _LEAST_MW))
        excess_db = max(total_dbm - settings.attenuation_db - MIXER_OVERLOAD_DBM, 0.0)
        bits = RF_OVERLOAD if excess_db > 0.0 else 0
        if total_dbm > settings.reference_dbm + HEADROOM_DB:
            bits |= IF_OVERLOAD
        return cls(bits, excess_db)


def _decibels(power_mw: FloatArray) -> FloatArray:
    return np.log(np.maximum(power_mw, _LEAST_MW))


#: average type -> the scale on which sweeps are averaged, and back
COMBINATIONS: dict[str, tuple[Callable[[FloatArray], FloatArray], Callable[[FloatArray], FloatArray]]] = {
    "POW": (np.asarray, np.asarray),
    "LIN": (np.sqrt, np.square),
    "VID": (_decibels, np.exp),
}

#: hold -> what it keeps of two sweeps
HOLDS: dict[str, np.ufunc] = {"MAXH": np.maximum, "MINH": np.minimum}
