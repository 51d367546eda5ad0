"""Robust statistics of values some of which are absent (NaN): middle values, spread, Tukey's weight."""

import numpy as np

from service.core.arrays import FloatArray

#: Sigma of a normal law over its median size.
MAD_TO_SIGMA = 1.4826
#: Sigmas at which Tukey's weight becomes zero; 95 % efficient on normal noise.
TUKEY_SIGMAS = 4.685


def middle_values(values: FloatArray, axis: int = 0) -> tuple[FloatArray, FloatArray]:
    """Return the lower and the upper middle value along an axis, whose mean is the median; NaN where all is absent.

    Examples
    --------
    >>> middle_values(np.array([4.0, 1.0, np.nan, 2.0, 3.0]))
    (array(2.), array(3.))
    """
    ordered, count = np.sort(values, axis=axis), np.isfinite(values).sum(axis=axis, keepdims=True)
    places = np.maximum(count - 1, 0) // 2, np.minimum(count // 2, np.maximum(count - 1, 0))
    lower, upper = (np.take_along_axis(ordered, place, axis=axis).squeeze(axis) for place in places)
    return lower, upper


def tukey_weight(standardised: FloatArray) -> FloatArray:
    """Return Tukey's biweight, 1 in the middle and 0 from ``TUKEY_SIGMAS`` on.

    Examples
    --------
    >>> tukey_weight(np.array([0.0, 4.685, 9.0]))
    array([1., 0., 0.])
    """
    return np.square(np.maximum(1.0 - np.square(standardised / TUKEY_SIGMAS), 0.0))
