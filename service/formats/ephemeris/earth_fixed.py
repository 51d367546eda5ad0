"""From inertial positions to the rotating Earth, by skyfield and the tables it carries; nothing is downloaded.

skyfield costs a third of a second to import, so it is imported by the first call.
"""

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
_DAY_US = 86_400_000_000
_KM_PER_AU = 149_597_870.7


@lru_cache(maxsize=1)
def timescale() -> Any:  # skyfield has no types
    """Return the time scale with built-in leap seconds and Earth rotation."""
    from skyfield.api import load

    return load.timescale(builtin=True)


def times_of(epochs_us: IntArray) -> Any:
    """Return skyfield times.

    Parameters
    ----------
    epochs_us : ndarray, shape (T,)
        Microseconds UTC.
    """
    days, rest_us = np.divmod(epochs_us, _DAY_US)
    # whole days as days of January 1970 and seconds within the day: leap seconds are counted by the day
    return timescale().utc(1970, 1, 1 + days, 0, 0, rest_us / 1e6)


def earth_fixed_km(position: Any) -> FloatArray:
    """Return the Earth-fixed (ITRS) coordinates of a skyfield position, shape (3, T), km."""
    from skyfield.framelib import itrs

    return np.asarray(position.frame_xyz(itrs).km, dtype=np.float64)


def inertial_to_earth_fixed_km(epochs_us: IntArray, position_km: FloatArray) -> FloatArray:
    """Return Earth-fixed coordinates of ICRF positions.

    Parameters
    ----------
    epochs_us : ndarray, shape (T,)
        Microseconds UTC.
    position_km : ndarray, shape (3, T), km
        Geocentric, ICRF or EME2000 (they differ by 0.02 arc seconds).
    """
    from skyfield.positionlib import Geocentric

    return earth_fixed_km(Geocentric(position_km / _KM_PER_AU, t=times_of(epochs_us)))


def leap_seconds_at(epoch_us: int) -> int:
    """Return TAI - UTC in whole seconds at an instant."""
    moment = times_of(np.array([epoch_us], dtype=np.int64))
    tai_days = float(moment.tai[0])
    utc_days = 2_440_587.5 + epoch_us / _DAY_US
    return round((tai_days - utc_days) * 86_400)
