"""Two-line elements: form, checksum, and agreement with SGP4 itself."""

import numpy as np
import pytest

from service.errors import InvalidInputError
from service.formats.ephemeris.earth_fixed import earth_fixed_km, leap_seconds_at, times_of, timescale
from service.formats.ephemeris.tle import read_tle

# a geosynchronous orbit of 5.9 deg, made up; the columns follow Celestrak's description of the format
LINES = (
    "1 28089U 03053F   24100.50000000 -.00000100  00000-0  00000+0 0  9991",
    "2 28089   5.9000  60.0000 0003000 100.0000 260.0000  1.00270000 75003",
)


def test_nodes_are_where_sgp4_crosses_the_equator_and_the_track_is_its_direction():
    from skyfield.api import EarthSatellite

    ephemeris = read_tle(LINES)
    satellite = EarthSatellite(*LINES, None, timescale())
    nodes_us = np.array(ephemeris.ascending_nodes_us)
    north_km = earth_fixed_km(satellite.at(times_of(nodes_us)))[2]
    # at 0.31 km/s, one millisecond
    np.testing.assert_allclose(north_km, 0.0, atol=3e-4)
    later_km = earth_fixed_km(satellite.at(times_of(nodes_us + 1_000_000)))[2]
    assert np.all(later_km > 0.3), "northward"
    epochs_us = np.array(ephemeris.track.epochs_us)
    x, y, z = earth_fixed_km(satellite.at(times_of(epochs_us)))
    # the track is rounded to 1e-7 deg
    np.testing.assert_allclose(ephemeris.track.latitude_deg, np.degrees(np.arctan2(z, np.hypot(x, y))), atol=1e-7)
    np.testing.assert_allclose(ephemeris.track.longitude_deg, np.degrees(np.arctan2(y, x)), atol=1e-7)
    assert np.all(np.diff(epochs_us) == 600_000_000)
    assert ephemeris.valid_start_us <= epochs_us[0] < epochs_us[-1] <= ephemeris.valid_stop_us


def test_leap_seconds_are_counted_by_the_day():
    # 2016-12-31T23:59:59Z and the next second but one
    assert (leap_seconds_at(1_483_228_799_000_000), leap_seconds_at(1_483_228_800_000_000)) == (36, 37)
    texts = times_of(np.array([1_483_228_799_000_000, 1_760_000_000_123_456])).utc_iso(places=6)
    assert texts == ["2016-12-31T23:59:59.000000Z", "2025-10-09T08:53:20.123456Z"]


def changed(line: str, column: int, text: str) -> str:
    """A line with text in some columns (counted from one) and its checksum made right."""
    body = line[: column - 1] + text + line[column - 1 + len(text) : 68]
    return body + str(sum(int(c) if c.isdigit() else c == "-" for c in body) % 10)


@pytest.mark.parametrize(
    ("lines", "code"),
    [
        ((), "tle.malformed"),
        (LINES[:1], "tle.malformed"),
        (LINES[::-1], "tle.malformed"),
        ((LINES[0], LINES[0]), "tle.malformed"),
        ((LINES[0][:-1], LINES[1]), "tle.malformed"),
        ((LINES[0] + "1", LINES[1]), "tle.malformed"),
        ((LINES[0][:-1] + "2", LINES[1]), "tle.checksum"),
        ((changed(LINES[0], 10, "\u0660"), LINES[1]), "tle.malformed"),
        ((LINES[0], changed(LINES[1], 3, "28090")), "tle.malformed"),
        ((LINES[0], changed(LINES[1], 9, "  x.9000")), "tle.malformed"),
        ((LINES[0], changed(LINES[1], 53, "15.00270000")), "ephemeris.not_geosynchronous"),
        ((LINES[0], changed(LINES[1], 27, "9999999")), "tle.propagation"),
    ],
)
def test_elements_that_cannot_be_used_are_refused(lines, code):
    with pytest.raises(InvalidInputError) as caught:
        read_tle(lines)
    assert caught.value.code == code
