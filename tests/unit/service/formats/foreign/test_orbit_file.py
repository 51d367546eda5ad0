"""Elements in every notation give the orbit that they were made of; what is another orbit is refused."""

import csv
import io
import json

import numpy as np
import pytest
from foreign_orbits import elements, omm_kvn, omm_xml, tle
from hypothesis import given, settings
from hypothesis import strategies as st

from service.formats.ephemeris.tle import read_tle
from service.formats.foreign.fault import ForeignTableError
from service.formats.foreign.orbit_file import read_orbit_file

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
    track = read_tle(found.body["tle"]).track
    assert track is not None
    assert np.mean(track.longitude_deg[: 7 * 144]) == pytest.approx(49.0, abs=0.3)
    assert max(track.latitude_deg[: 7 * 144]) == pytest.approx(3.0, abs=0.05)


@settings(max_examples=3, deadline=None)
@given(st.floats(-180.0, 180.0))
def test_an_omm_and_the_tle_of_the_same_elements_agree(longitude_deg: float) -> None:
    known = elements(longitude_deg)
    by_message = read_tle(read_orbit_file(json.dumps(known)).body["tle"])
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
        ("<ndm>", "no OMM in XML"),
        ('<!DOCTYPE a [<!ENTITY b "c">]><ndm/>', "no document type"),
        ("<ndm/>", "holds 0 objects"),
        (omm_kvn(KNOWN | {"REF_FRAME": "EME2000"}), "REF_FRAME = EME2000"),
        (omm_kvn(KNOWN | {"MEAN_ELEMENT_THEORY": "DSST"}), "MEAN_ELEMENT_THEORY = DSST"),
        (omm_kvn(KNOWN | {"TIME_SYSTEM": "GPS"}), "TIME_SYSTEM = GPS"),
        (omm_kvn(KNOWN | {"INCLINATION": "steep"}), "no number or epoch"),
        (omm_kvn(KNOWN | {"EPOCH": "yesterday"}), "no number or epoch"),
        (omm_kvn({name: value for name, value in KNOWN.items() if name != "MEAN_ANOMALY"}), "no MEAN_ANOMALY"),
    ],
)
def test_what_is_no_single_orbit_is_refused(text: str, message: str) -> None:
    with pytest.raises(ForeignTableError, match=message):
        read_orbit_file(text)
