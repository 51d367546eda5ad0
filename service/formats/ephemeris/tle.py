"""Two-line elements: read, checked, propagated by SGP4 through skyfield.

A set is good for weeks at geosynchronous height; beyond ``DAYS_AFTER`` a newer one is asked for by the end of the
ephemeris' validity.
"""

import re
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from sgp4.io import compute_checksum

from service.errors import InvalidInputError
from service.formats.ephemeris.earth_fixed import earth_fixed_km, times_of, timescale
from service.formats.ephemeris.orbit import STEP_S, US_PER_S, ephemeris_from_positions
from service.records.catalogue import Ephemeris

#: span of the ephemeris around the epoch of the elements
DAYS_BEFORE = 7
DAYS_AFTER = 30
_DAY_US = 86_400 * US_PER_S
_LENGTH = 69
_ANGLE = r"[ \d]{3}\.\d{4}"
_SMALL = r"[ +-]\d{5}[ +-]\d"
_LINES = (
    re.compile(
        rf"1 [ 0-9A-Z]\d{{4}}[A-Z ] [\d ]{{5}}[A-Z ]{{3}} \d\d[ \d]{{3}}\.\d{{8}} [ +-][ \d]?\.\d{{8}} "
        rf"{_SMALL} {_SMALL} [\d ] [ \d]{{4}}\d",
        re.ASCII,
    ),
    re.compile(
        rf"2 [ 0-9A-Z]\d{{4}} {_ANGLE} {_ANGLE} \d{{7}} {_ANGLE} {_ANGLE} [ \d]{{2}}\.\d{{8}}[ \d]{{5}}\d", re.ASCII
    ),
)


def read_tle(lines: Sequence[str]) -> Ephemeris:
    """Return the ephemeris of two-line elements.

    Parameters
    ----------
    lines : sequence of str
        The two lines.

    Raises
    ------
    InvalidInputError
        ``tle.malformed`` or ``tle.checksum``; ``tle.propagation`` when SGP4 gives up; those of
        ``ephemeris_from_positions``.
    """
    first, second = _checked(lines)
    from skyfield.api import EarthSatellite

    try:
        satellite = EarthSatellite(first, second, None, timescale())
    except ValueError as error:
        raise InvalidInputError("tle.malformed", f"the elements cannot be read: {error}") from None
    centre_us = _epoch_us(satellite)
    step_us = STEP_S * US_PER_S
    start_us = -(-(centre_us - DAYS_BEFORE * _DAY_US) // step_us) * step_us
    epochs_us = np.arange(start_us, centre_us + DAYS_AFTER * _DAY_US, step_us, dtype=np.int64)
    position_km = earth_fixed_km(satellite.at(times_of(epochs_us)))
    if not np.all(np.isfinite(position_km)):
        raise InvalidInputError("tle.propagation", "SGP4 cannot propagate these elements over the span of an ephemeris")
    return ephemeris_from_positions("tle", epochs_us, position_km)


def _checked(lines: Sequence[str]) -> tuple[str, str]:
    """Return the two lines when form, checksums and catalogue numbers are right."""
    stripped = [line.rstrip() for line in lines]
    if len(stripped) != len(_LINES):
        raise InvalidInputError("tle.malformed", "two-line elements are two lines")
    for number, (line, form) in enumerate(zip(stripped, _LINES, strict=True), start=1):
        if len(line) != _LENGTH or form.fullmatch(line) is None:
            raise InvalidInputError("tle.malformed", f"line {number} has not the {_LENGTH} columns of the format")
        if (computed := compute_checksum(line)) != int(line[-1]):
            detail = f"line {number} ends with checksum {line[-1]}, its content gives {computed}"
            raise InvalidInputError("tle.checksum", detail)
    if any(a[2:7] != b[2:7] for a, b in pairwise(stripped)):
        raise InvalidInputError("tle.malformed", "the two lines belong to different satellites")
    return stripped[0], stripped[1]


def _epoch_us(satellite: Any) -> int:
    """Return the epoch of the elements to the second."""
    return round(float(satellite.epoch.utc_datetime().timestamp())) * US_PER_S
