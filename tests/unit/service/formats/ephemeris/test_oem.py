"""Orbit Ephemeris Messages: the same orbit in any frame, time system and segmentation."""

import numpy as np
import pytest

from service.errors import InvalidInputError
from service.formats.ephemeris.earth_fixed import earth_fixed_km, times_of, timescale
from service.formats.ephemeris.oem import read_oem
from service.records.epoch import format_epoch

T0_US = 1_795_230_000_000_000
LINES = (
    "1 28089U 03053F   26324.50000000 -.00000100  00000-0  00000+0 0  9995",
    "2 28089   5.9000  60.0000 0003000 100.0000 260.0000  1.00270000 75003",
)
META = {
    "OBJECT_NAME": "YAMAL",
    "OBJECT_ID": "2003-053F",
    "CENTER_NAME": "EARTH",
    "REF_FRAME": "EME2000",
    "TIME_SYSTEM": "UTC",
}


@pytest.fixture(scope="module")
def satellite():
    from skyfield.api import EarthSatellite

    return EarthSatellite(*LINES, None, timescale())


@pytest.fixture(scope="module")
def states(satellite):
    """Hourly states over four days in ICRF: epochs and (T, 6)."""
    epochs_us = T0_US + np.arange(0, 4 * 86_400, 3600, dtype=np.int64) * 1_000_000
    position = satellite.at(times_of(epochs_us))
    return epochs_us, np.vstack([position.position.km, position.velocity.km_per_s]).T


def segment(epochs_us, states, shift_us: int = 0, more: str = "", **meta: str) -> str:
    lines = ["META_START", *(f"{key} = {value}" for key, value in (META | meta).items()), "META_STOP", more]
    for epoch_us, state in zip(epochs_us.tolist(), states, strict=True):
        lines.append(format_epoch(epoch_us + shift_us)[:-1] + " " + " ".join(f"{value:.9f}" for value in state))
    return "\n".join(lines) + "\n"


HEAD = "CCSDS_OEM_VERS = 2.0\nCREATION_DATE = 2026-11-21T00:00:00\nORIGINATOR = SOO\n\n"


def test_hourly_inertial_states_give_the_orbit_they_were_taken_from(states, satellite):
    ephemeris = read_oem(HEAD + segment(*states))
    assert ephemeris.form == "oem"
    x, y, z = earth_fixed_km(satellite.at(times_of(np.array(ephemeris.track.epochs_us))))
    # Hermite over an hour of a geosynchronous orbit: (h w)^4 / 384 of the radius, 30 m or 4e-5 deg
    np.testing.assert_allclose(ephemeris.track.latitude_deg, np.degrees(np.arctan2(z, np.hypot(x, y))), atol=5e-5)
    np.testing.assert_allclose(ephemeris.track.longitude_deg, np.degrees(np.arctan2(y, x)), atol=5e-5)
    north_km = earth_fixed_km(satellite.at(times_of(np.array(ephemeris.ascending_nodes_us))))[2]
    np.testing.assert_allclose(north_km, 0.0, atol=0.03)
    assert (ephemeris.valid_start_us, ephemeris.valid_stop_us) == (states[0][0], states[0][-1])


def test_other_time_systems_are_brought_to_utc(states):
    reference = read_oem(HEAD + segment(*states))
    # 37 leap seconds hold in 2026 by the built-in table
    for system, shift_s in (("TAI", 37.0), ("TT", 37.0 + 32.184), ("GPS", 18.0)):
        other = read_oem(HEAD + segment(*states, shift_us=round(shift_s * 1e6), TIME_SYSTEM=system))
        assert other == reference, system


def test_earth_fixed_states_need_no_rotation(states, satellite):
    epochs_us, inertial = states
    before, after = (earth_fixed_km(satellite.at(times_of(epochs_us + s * 1_000_000))) for s in (-1, 1))
    fixed = np.vstack([earth_fixed_km(satellite.at(times_of(epochs_us))), (after - before) / 2]).T
    ours = read_oem(HEAD + segment(epochs_us, fixed, REF_FRAME="ITRF2000"))
    theirs = read_oem(HEAD + segment(epochs_us, inertial))
    # two interpolations, each within 4e-5 deg
    np.testing.assert_allclose(ours.track.latitude_deg, theirs.track.latitude_deg, atol=1e-4)


def test_segments_comments_covariances_accelerations_and_days_of_year_are_understood(states):
    epochs_us, array = states
    covariance = "COVARIANCE_START\nEPOCH = 2026-11-21T00:00:00\n1.0\n1.0 2.0\nCOVARIANCE_STOP\nCOMMENT hello\n"
    first = segment(epochs_us[:50], np.hstack([array, np.zeros((len(array), 3))])[:50]) + covariance
    overlapping = segment(epochs_us[48:], array[48:], more="COMMENT second arc")
    assert read_oem(HEAD + first + overlapping) == read_oem(HEAD + segment(epochs_us, array))
    text = segment(epochs_us, array)
    assert "2026-11-21T" in text
    assert read_oem(HEAD + text.replace("2026-11-21T", "2026-325T")) == read_oem(HEAD + text)


def bad(text: str, old: str, new: str) -> str:
    assert old in text
    return text.replace(old, new, 1)


@pytest.mark.parametrize(
    ("change", "code", "word"),
    [
        (lambda t: "", "oem.malformed", "CCSDS_OEM_VERS"),
        (lambda t: "CCSDS_OEM_VERS = 2.0\n", "oem.malformed", "no segment"),
        (lambda t: bad(t, "CENTER_NAME = EARTH", "CENTER_NAME = MOON"), "oem.unsupported", "CENTER_NAME"),
        (lambda t: bad(t, "EME2000", "TEME"), "oem.unsupported", "REF_FRAME"),
        (lambda t: bad(t, "REF_FRAME = EME2000", "COMMENT"), "oem.unsupported", "REF_FRAME"),
        (lambda t: bad(t, "= UTC", "= TDB"), "oem.unsupported", "TIME_SYSTEM"),
        (lambda t: bad(t, "OBJECT_NAME =", "OBJECT_NAME"), "oem.malformed", "line 6"),
        (lambda t: bad(t, "META_START", "COMMENT"), "oem.malformed", "META_START"),
        (lambda t: t + "2026-11-25T04:00:00 1 2 3\n", "oem.malformed", "three rates"),
        (lambda t: t + "2026-11-25T04:00:00 1 2 3 4 5 x\n", "oem.malformed", "number"),
        (lambda t: t + "2026-11-25T04:00:00 1 2 3 4 5 nan\n", "oem.malformed", "finite"),
        (lambda t: t + "2026-11-25T04:00:00 1 2 3 4 5 1e300\n", "oem.malformed", "finite"),
        (lambda t: t + "2026-13-25T04:00:00 1 2 3 4 5 6\n", "oem.malformed", "epoch"),
        (lambda t: t + "2026-999T04:00:00 1 2 3 4 5 6\n", "oem.malformed", "epoch"),
        (lambda t: t + "9999-366T04:00:00 1 2 3 4 5 6\n", "oem.malformed", "epoch"),
        (lambda t: t + "2026-11-20T04:00:00 1 2 3 4 5 6\n", "oem.malformed", "ascending"),
        (lambda t: t + "2026-11-25T04:00:01 42164 0 0 0 3 0\n", "oem.gap", "3600"),
    ],
)
def test_messages_that_cannot_be_used_are_refused_with_the_reason(states, change, code, word):
    with pytest.raises(InvalidInputError) as caught:
        read_oem(change(HEAD + segment(*states)))
    assert caught.value.code == code
    assert word in caught.value.detail


def test_a_message_of_one_state_has_no_track(states):
    epochs_us, array = states
    with pytest.raises(InvalidInputError) as caught:
        read_oem(HEAD + segment(epochs_us[:1], array[:1]))
    assert caught.value.code == "oem.gap"
