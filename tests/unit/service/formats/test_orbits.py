"""Orbits from messages, elements and tracks: the same orbit in any notation, and what is refused."""

import csv
import io
import json
import re
from functools import cache

import numpy as np
import pytest
from foreign_orbits import elements, omm_kvn, omm_xml, tle
from hypothesis import given, settings
from hypothesis import strategies as st

from service.errors import InvalidInputError
from service.formats.ephemeris import (
    earth_fixed_km,
    ephemeris_from_nodes,
    ephemeris_from_positions,
    find_nodes,
    leap_seconds_at,
    read_oem,
    read_tle,
    times_of,
    timescale,
)
from service.formats.foreign.messages import read_orbit_file
from service.formats.foreign.table import ForeignTableError
from service.records.catalogue import Track
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
        (lambda t: bad(t, "META_START", "COMMENT"), "oem.malformed", "META_STOP"),
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


@pytest.mark.parametrize("factor", [0.0, -1.0, 1e-3, 1.02, 1000.0])
@pytest.mark.parametrize("step", [1, 2])
def test_velocities_that_contradict_the_positions_are_refused(states, factor, step):
    epochs_us, array = states
    # every second state where the step is two: hours that differ
    keep = np.ones(len(epochs_us), dtype=bool) if step == 1 else np.arange(len(epochs_us)) != 40
    scaled = np.hstack([array[:, :3], array[:, 3:] * factor])
    with pytest.raises(InvalidInputError, match="the velocity at 2026-11-2"):
        read_oem(HEAD + segment(epochs_us[: len(keep)][keep][:40], scaled[keep][:40]))


def test_a_single_wrong_velocity_is_named_by_its_epoch(states):
    epochs_us, array = states
    spoiled = array.copy()
    spoiled[30, 3:] *= -1.0
    with pytest.raises(InvalidInputError, match="1 of 92 states contradict"):
        read_oem(HEAD + segment(epochs_us, spoiled))


def test_useable_spans_objects_and_interpolation_are_obeyed(states):
    epochs_us, array = states
    spoiled = array.copy()
    spoiled[:3, :3] += 1000.0
    start = format_epoch(epochs_us[3])[:-1]
    useable = read_oem(HEAD + segment(epochs_us, spoiled, USEABLE_START_TIME=start, INTERPOLATION="Lagrange"))
    assert useable == read_oem(HEAD + segment(epochs_us[3:], array[3:]))
    for text, word in (
        (segment(*states, INTERPOLATION="CHEBYSHEV"), "INTERPOLATION is CHEBYSHEV"),
        (segment(*states) + segment(*states, OBJECT_ID="1999-001A"), "1999-001A"),
        (segment(*states, USEABLE_STOP_TIME="later"), "useable span"),
    ):
        with pytest.raises(InvalidInputError, match=word):
            read_oem(HEAD + text)


def test_a_message_of_one_state_has_no_track(states):
    epochs_us, array = states
    with pytest.raises(InvalidInputError) as caught:
        read_oem(HEAD + segment(epochs_us[:1], array[:1]))
    assert caught.value.code == "oem.gap"


DAY_US = 86_400_000_000
STEP_US = 600_000_000


def circular(period_s: float, inclination_deg: float, node_us: float, days: int, longitude_deg: float = 90.0):
    """Positions of an inclined circular orbit over a fixed longitude; the node is exact by construction."""
    epochs_us = T0_US + np.arange(0, days * DAY_US, STEP_US, dtype=np.int64)
    phase = 2 * np.pi * (epochs_us - node_us) / (period_s * 1e6)
    latitude = np.radians(inclination_deg) * np.sin(phase)
    longitude = np.radians(longitude_deg)
    xyz = np.array([np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)])
    return epochs_us, 42_164.0 * xyz


@pytest.mark.parametrize("offset_s", [601.0, 12_345.678, 40_000.0, 86_000.0])
def test_nodes_between_samples_are_found_within_two_milliseconds(offset_s):
    period_s = 86_164.0905
    node_us = T0_US + offset_s * 1e6
    epochs_us, xyz_km = circular(period_s, 5.9, node_us, 4)
    nodes_us = find_nodes(epochs_us, xyz_km[2])
    expected_us = node_us + np.arange(len(nodes_us)) * period_s * 1e6
    # the cubic through four samples of a sine 2.5 deg apart errs by 1e-7 of its amplitude, 1.2 ms
    np.testing.assert_allclose(nodes_us, expected_us, atol=2000)
    assert len(nodes_us) >= 3


def test_positions_give_period_track_and_validity():
    epochs_us, xyz_km = circular(86_164.0, 2.0, T0_US + 5e9, 5, longitude_deg=179.99)
    ephemeris = ephemeris_from_positions("oem", epochs_us, xyz_km)
    # two nodes of 1.2 ms over four days
    assert ephemeris.nodal_period_s == pytest.approx(86_164.0, abs=1e-3)
    assert (ephemeris.valid_start_us, ephemeris.valid_stop_us) == (epochs_us[0], epochs_us[-1])
    assert ephemeris.form == "oem"
    # rounded to 1e-7 deg
    np.testing.assert_allclose(ephemeris.track.longitude_deg, 179.99, atol=1e-7)
    assert max(ephemeris.track.latitude_deg) == pytest.approx(2.0, abs=1e-3), "samples 2.5 deg of phase apart"


def test_a_track_across_the_date_line_does_not_jump():
    epochs_us, xyz_km = circular(86_164.0, 2.0, T0_US + 5e9, 3, longitude_deg=0.0)
    swing = np.radians(180.0 + 0.05 * np.sin(np.arange(len(epochs_us)) / 20))
    r = np.hypot(xyz_km[0], xyz_km[1])
    track = ephemeris_from_positions(
        "oem", epochs_us, np.array([r * np.cos(swing), r * np.sin(swing), xyz_km[2]])
    ).track
    assert np.max(np.abs(np.diff(track.longitude_deg))) < 0.01


@pytest.mark.parametrize(
    ("scale", "inclination_deg", "days", "code"),
    [
        (0.2, 5.0, 4, "ephemeris.not_geosynchronous"),
        (1.2, 5.0, 4, "ephemeris.not_geosynchronous"),
        (1.0, 0.001, 4, "ephemeris.no_nodes"),
        (1.0, 5.0, 1, "ephemeris.no_nodes"),
    ],
)
def test_orbits_without_nodes_of_use_are_refused(scale, inclination_deg, days, code):
    epochs_us, xyz_km = circular(86_164.0, inclination_deg, T0_US + 5e9, days)
    with pytest.raises(InvalidInputError) as caught:
        ephemeris_from_positions("oem", epochs_us, xyz_km * scale)
    assert caught.value.code == code


def test_nodes_with_gaps_give_the_period_of_one_revolution():
    period_us = 86_328_000_000
    nodes_us = [T0_US + k * period_us for k in (0, 1, 4, 6)]
    ephemeris = ephemeris_from_nodes(nodes_us, None)
    assert ephemeris.nodal_period_s == 86_328.0
    assert (ephemeris.valid_start_us, ephemeris.valid_stop_us) == (nodes_us[0] - period_us, nodes_us[-1] + period_us)


@pytest.mark.parametrize(
    ("nodes_us", "period_s", "code"),
    [
        ([], 86_164.0, "ephemeris.nodes"),
        ([T0_US], None, "ephemeris.period_missing"),
        ([T0_US], 79_999.0, "ephemeris.period"),
        ([T0_US], float("nan"), "ephemeris.period"),
        ([T0_US, T0_US + DAY_US // 2], None, "ephemeris.period"),
        ([T0_US, T0_US + DAY_US // 3], 86_164.0, "ephemeris.nodes"),
        ([T0_US + 1, T0_US], 86_164.0, "ephemeris.nodes"),
    ],
)
def test_node_lists_that_cannot_be_are_refused(nodes_us, period_s, code):
    with pytest.raises(InvalidInputError) as caught:
        ephemeris_from_nodes(nodes_us, period_s)
    assert caught.value.code == code


@pytest.mark.parametrize(
    "track", [Track((1, 2), (0.0,), (0.0, 0.0)), Track((1,), (0.0,), (0.0,)), Track((2, 1), (0.0, 0.0), (0.0, 0.0))]
)
def test_tracks_whose_columns_do_not_belong_together_are_refused(track):
    with pytest.raises(InvalidInputError) as caught:
        ephemeris_from_nodes([T0_US], 86_164.0, track)
    assert caught.value.code == "ephemeris.track"


# a geosynchronous orbit of 5.9 deg, made up; the columns follow Celestrak's description of the format
TLE_LINES = (
    "1 28089U 03053F   24100.50000000 -.00000100  00000-0  00000+0 0  9991",
    "2 28089   5.9000  60.0000 0003000 100.0000 260.0000  1.00270000 75003",
)


def test_nodes_are_where_sgp4_crosses_the_equator_and_the_track_is_its_direction():
    from skyfield.api import EarthSatellite

    ephemeris = read_tle(TLE_LINES)
    satellite = EarthSatellite(*TLE_LINES, None, timescale())
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
        (TLE_LINES[:1], "tle.malformed"),
        (TLE_LINES[::-1], "tle.malformed"),
        ((TLE_LINES[0], TLE_LINES[0]), "tle.malformed"),
        ((TLE_LINES[0][:-1], TLE_LINES[1]), "tle.malformed"),
        ((TLE_LINES[0] + "1", TLE_LINES[1]), "tle.malformed"),
        ((TLE_LINES[0][:-1] + "2", TLE_LINES[1]), "tle.checksum"),
        ((changed(TLE_LINES[0], 10, "\u0660"), TLE_LINES[1]), "tle.malformed"),
        ((TLE_LINES[0], changed(TLE_LINES[1], 3, "28090")), "tle.malformed"),
        ((TLE_LINES[0], changed(TLE_LINES[1], 9, "  x.9000")), "tle.malformed"),
        ((TLE_LINES[0], changed(TLE_LINES[1], 53, "15.00270000")), "ephemeris.not_geosynchronous"),
        ((TLE_LINES[0], changed(TLE_LINES[1], 27, "9999999")), "tle.propagation"),
    ],
)
def test_elements_that_cannot_be_used_are_refused(lines, code):
    with pytest.raises(InvalidInputError) as caught:
        read_tle(lines)
    assert caught.value.code == code


KNOWN = elements(49.0)


def omm_csv(known: dict[str, str]) -> str:
    """Return an OMM as CSV."""
    text = io.StringIO()
    table = csv.writer(text)
    table.writerows([list(known), list(known.values())])
    return text.getvalue()


@pytest.mark.parametrize(
    ("text", "form"),
    [
        ("\n".join(tle(KNOWN)), "TLE"),
        ("\r\n".join(["YAMAL 202", *tle(KNOWN), ""]), "TLE"),
        ("\n".join(["0 YAMAL 202", *tle(KNOWN)]), "TLE"),
        (omm_kvn(KNOWN), "OMM"),
        (omm_xml(KNOWN), "OMM"),
        (json.dumps(KNOWN), "OMM"),
        ("\ufeff" + json.dumps([KNOWN]), "OMM"),
        (omm_csv(KNOWN), "OMM"),
        (json.dumps({"tle": tle(KNOWN)}), "interface document"),
    ],
)
def test_every_notation_gives_the_orbit(text: str, form: str) -> None:
    found = read_orbit_file(text)
    assert found.form == form
    assert found.cospar_id == "2003-053F"
    track = (found.ephemeris or read_tle(found.body["tle"])).track
    assert track is not None
    assert np.mean(track.longitude_deg[: 7 * 144]) == pytest.approx(49.0, abs=0.3)
    assert max(track.latitude_deg[: 7 * 144]) == pytest.approx(3.0, abs=0.05)


def ordinal(known: dict[str, str]) -> dict[str, str]:
    """Return elements with the day of the year."""
    return known | {"EPOCH": known["EPOCH"].replace("2026-03-01", "2026-060")}


PREFIXED = re.sub(r"<(/?)(?=\w)", r"<\1n:", omm_xml(KNOWN)).replace(
    "<n:ndm>", '<n:ndm xmlns:n="urn:ccsds:schema:ndmxml">'
)


@cache
def known_orbit() -> object:
    """Return the orbit of the known elements."""
    return read_orbit_file(omm_kvn(KNOWN)).ephemeris


@pytest.mark.parametrize(
    "text",
    [
        omm_kvn(ordinal(KNOWN)),
        json.dumps(ordinal(KNOWN)),
        omm_xml(KNOWN).replace("<ndm>", '<?xml version="1.0" encoding="UTF-8"?><ndm xmlns="urn:ccsds:schema:ndmxml">'),
        PREFIXED,
        omm_xml(KNOWN).replace("<INCLINATION>", '<INCLINATION units="deg">'),
        json.dumps(KNOWN | {"CLASSIFICATION_TYPE": "UNCLASSIFIED"}),
        json.dumps(KNOWN | {"CLASSIFICATION_TYPE": "\u0421", "NORAD_CAT_ID": "799999999"}),
        json.dumps(KNOWN | {"EPHEMERIS_TYPE": 0, "MEAN_MOTION": 1.0027}),
        omm_kvn(KNOWN).replace("OBJECT_NAME", "COMMENT недельный выпуск\nOBJECT_NAME"),
        omm_kvn({name: f"{value} [deg]" if name == "INCLINATION" else value for name, value in KNOWN.items()}),
        omm_csv(KNOWN).replace(",", ";"),
    ],
)
def test_forms_that_providers_write_give_the_same_orbit(text: str) -> None:
    assert read_orbit_file(text).ephemeris == known_orbit()


def test_an_oem_in_xml_is_that_of_keywords(states) -> None:
    epochs_us, array = states
    names = ("X", "Y", "Z", "X_DOT", "Y_DOT", "Z_DOT")
    vectors = ""
    for epoch_us, state in zip(epochs_us.tolist(), array, strict=True):
        numbers = "".join(f"<{name}>{value:.9f}</{name}>" for name, value in zip(names, state, strict=True))
        vectors += f"<stateVector><EPOCH>{format_epoch(epoch_us)[:-1]}</EPOCH>{numbers}</stateVector>"
    meta = "".join(f"<{name}>{value}</{name}>" for name, value in META.items())
    text = f'<oem version="2.0"><body><segment><metadata>{meta}</metadata><data>{vectors}</data></segment></body></oem>'
    assert read_orbit_file(text).ephemeris == read_oem(HEAD + segment(*states))
    with pytest.raises(ForeignTableError, match="X is in m"):
        read_orbit_file(text.replace("<X>", '<X units="m">'))


@settings(max_examples=3, deadline=None)
@given(st.floats(-180.0, 180.0))
def test_an_omm_and_the_tle_of_the_same_elements_agree(longitude_deg: float) -> None:
    known = elements(longitude_deg)
    by_message = read_orbit_file(json.dumps(known)).ephemeris
    by_lines = read_tle(tle(known))
    assert by_message.track is not None
    assert by_lines.track is not None
    np.testing.assert_allclose(by_message.track.longitude_deg, by_lines.track.longitude_deg, atol=1e-3)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no TLE, OMM, OEM or JSON"),
        ("hello\nworld", "no TLE, OMM, OEM or JSON"),
        ("\n".join([*tle(KNOWN), *tle(KNOWN)]), "holds 2 element sets"),
        (json.dumps([KNOWN, KNOWN]), "holds 2 objects"),
        (json.dumps([]), "no JSON object"),
        ("{", "is no JSON"),
        ("<ndm>", "is no XML"),
        ('<!DOCTYPE a [<!ENTITY b "c">]><ndm/>', "no document type"),
        ("<ndm/>", "holds 0 messages"),
        (omm_kvn(KNOWN | {"REF_FRAME": "EME2000"}), "REF_FRAME = EME2000"),
        (omm_kvn(KNOWN | {"MEAN_ELEMENT_THEORY": "DSST"}), "MEAN_ELEMENT_THEORY = DSST"),
        (omm_kvn(KNOWN | {"TIME_SYSTEM": "GPS"}), "TIME_SYSTEM = GPS"),
        (omm_kvn(KNOWN | {"EPHEMERIS_TYPE": "4"}), "SGP4-XP"),
        ("\n".join([changed(tle(KNOWN)[0], 63, "4"), tle(KNOWN)[1]]), "SGP4-XP"),
        (omm_kvn({name: value for name, value in KNOWN.items() if name != "BSTAR"} | {"BTERM": "0.01"}), "SGP4-XP"),
        (omm_kvn(KNOWN) + omm_kvn(KNOWN | {"INCLINATION": "0.1"}), "one object"),
        (omm_kvn(KNOWN | {"INCLINATION": "0.05 [rad]"}), "is in rad"),
        (omm_xml(KNOWN).replace("</ndm>", omm_xml(KNOWN)[5:]), "2 messages"),
        (omm_kvn(KNOWN | {"INCLINATION": "steep"}), "no number or epoch"),
        (omm_kvn(KNOWN | {"EPOCH": "yesterday"}), "no number or epoch"),
        (omm_kvn({name: value for name, value in KNOWN.items() if name != "MEAN_ANOMALY"}), "no MEAN_ANOMALY"),
    ],
)
def test_what_is_no_single_orbit_is_refused(text: str, message: str) -> None:
    with pytest.raises(ForeignTableError, match=message):
        read_orbit_file(text)
