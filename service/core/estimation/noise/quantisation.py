"""Step of power readings that stand on a grid, told by what a grid does to their distribution.

Readings on multiples of q repeat with the period q: the characteristic function ``R(f) = |mean exp(2 pi i f x)|`` of
their distribution, which falls to nothing within ``1 / spread``, rises again to one at f = 1 / q, and to
``exp(-2 pi^2 s^2 / q^2)`` where noise s was added after the rounding. The law of this file: a step is reported only
when the readings spread over more than one of it, and readings without a grid have the step zero.
"""

import math

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

#: dB, resolution of the histogram; steps from five of it up to ``_LARGEST_DB`` are looked for.
_BIN_DB = 0.002
_SMALLEST_DB = 0.01
_LARGEST_DB = 1.0
#: dB, readings further from the median belong to something else.
_REACH_DB = 4.0
#: Rows without which nothing is said.
_MIN_ROWS = 200
#: R that chance does not reach: at least this, and this many of its standard deviations.
_LEAST = 0.2
_CHANCE_SIGMAS = 8.0
_PADDED = 1 << 14


def quantisation_step_db(power_dbm: FloatArray) -> float:
    """Return the step of readings (T,), 0 where none is seen.

    Parameters
    ----------
    power_dbm : ndarray, shape (T,), dBm
        Readings; NaN = absent.

    Returns
    -------
    float, dB
        Good to about one per cent.

    Examples
    --------
    >>> level = np.random.default_rng(1).normal(-40.0, 0.2, 1000)
    >>> round(quantisation_step_db(np.round(level / 0.15) * 0.15), 2), quantisation_step_db(level)
    (0.15, 0.0)
    """
    known = power_dbm[np.isfinite(power_dbm)]
    if len(known) < _MIN_ROWS:
        return 0.0
    # relative to a whole number of bins, so that a grid keeps its place
    centre = round(float(np.median(known)) / _BIN_DB)
    position = np.round(known / _BIN_DB).astype(np.int64) - centre + round(_REACH_DB / _BIN_DB)
    bins = 2 * round(_REACH_DB / _BIN_DB) + 1
    near = position[(position >= 0) & (position < bins)]
    histogram = np.bincount(near, minlength=bins) / max(len(near), 1)
    found = np.abs(np.fft.rfft(histogram, n=_PADDED))
    frequency = np.arange(len(found)) / (_PADDED * _BIN_DB)
    least = max(_LEAST, _CHANCE_SIGMAS / math.sqrt(len(near)))
    # the distribution as a whole is one lobe from zero on; the grid shows after it has died away
    below = np.flatnonzero(found < 0.5 * least)
    if not len(below):
        return 0.0
    is_open = (np.arange(len(found)) > below[0]) & (frequency >= 1.0 / _LARGEST_DB) & (frequency <= 1.0 / _SMALLEST_DB)
    high = np.flatnonzero(is_open & (found >= least))
    if not len(high):
        return 0.0
    # harmonics of a sharp grid are as high as the first: the lowest peak is the grid
    last = high[0] + np.argmax(np.append(found[high[0] :] < 0.5 * least, True))
    peak = high[0] + int(np.argmax(found[high[0] : last]))
    return float(1.0 / frequency[peak])
