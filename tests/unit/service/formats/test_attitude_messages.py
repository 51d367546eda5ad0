"""Attitude messages (AEM): quaternions and Euler angles, time systems, directions and XML."""

import re
from datetime import UTC, datetime

import numpy as np
import pytest
from foreign_orbits import attitude_message, quaternion
from hypothesis import given
from hypothesis import strategies as st

from service.core.geometry.frames import body_from_nadir
from service.formats.foreign.messages import read_attitude_message
from service.formats.foreign.table import ForeignTableError

FIRST = datetime(2026, 3, 21, tzinfo=UTC)


@given(st.tuples(st.floats(-20, 20), st.floats(-8, 8), st.floats(-8, 8)), st.booleans(), st.booleans())
def test_messages_give_the_attitude_in_every_form(
    angles: tuple[float, float, float], is_first: bool, is_reversed: bool
) -> None:
    x, y, z, w = quaternion(*angles)
    parts = (-x, -y, -z, w) if is_reversed else (x, y, z, w)
    ordered = (parts[3], *parts[:3]) if is_first else parts
    text = attitude_message(
        [(FIRST, ordered)], scalar="FIRST" if is_first else "LAST", direction="B2A" if is_reversed else "A2B"
    )
    epochs_us, (found,) = read_attitude_message(text)
    assert epochs_us.tolist() == [round(FIRST.timestamp() * 1e6)]
    np.testing.assert_allclose(np.array(found, dtype=float), angles, atol=1e-8)
    swapped = attitude_message([(FIRST, (x, y, z, w))], frames=("SC_BODY_1", "LVLH_ROTATING"))
    _, (other,) = read_attitude_message(swapped)
    np.testing.assert_allclose(quaternion(*other), np.array((-x, -y, -z, w)), atol=1e-8)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (attitude_message([(FIRST, (0, 0, 0, 1))], frames=("EME2000", "SC_BODY_1")), "turn inertial attitudes"),
        (
            attitude_message([(FIRST, (0, 0, 0, 1))], scalar="FIRST"),
            "states the scalar first, the numbers show it last",
        ),
        (attitude_message([(FIRST, (0, 0, 0, 0.5))]), "not of unit length"),
        (attitude_message([(FIRST, (0, 0, 1))]), "four parts"),
        (attitude_message([(FIRST, (0, 0, 0, 1))])[:-15], "ends before DATA_STOP"),
        ("CCSDS_OEM_VERS = 2.0\n", "must begin with CCSDS_AEM_VERS"),
    ],
)
def test_messages_that_mean_something_else_are_refused(text: str, message: str) -> None:
    with pytest.raises(ForeignTableError, match=message):
        list(read_attitude_message(text))


def euler_message(sequence: str, angles: str, system: str = "UTC", more: str = "") -> str:
    """Return an AEM of one row of Euler angles."""
    text = attitude_message([(FIRST, (0, 0, 0, 1))])
    text = text.replace("QUATERNION", f"EULER_ANGLE\nEULER_ROT_SEQ = {sequence}{more}").replace("= UTC", f"= {system}")
    return re.sub(r"0\.0+ 0\.0+ 0\.0+ 1\.0+", angles, text)


@pytest.mark.parametrize(
    ("sequence", "angles"),
    [("321", "3 2 -1"), ("ZYX", "3 2 -1"), ("123", None), ("213", None), ("313", None)],
)
def test_euler_angles_are_turns_one_after_the_other(sequence: str, angles: str | None) -> None:
    _, (found,) = read_attitude_message(euler_message(sequence, angles or "3 2 -1"))
    if angles is not None:
        # yaw about z, pitch about y, roll about x
        np.testing.assert_allclose(found, (3.0, -1.0, 2.0), atol=1e-9)
        return
    axes = ["XYZ"["123".index(each)] for each in sequence]
    turn = np.eye(3)
    for axis, angle in zip(axes, (3.0, 2.0, -1.0), strict=True):
        single = {"X": (0, angle, 0), "Y": (0, 0, angle), "Z": (angle, 0, 0)}[axis]
        turn = body_from_nadir(single) @ turn
    np.testing.assert_allclose(body_from_nadir(found), turn, atol=1e-9)


@pytest.mark.parametrize(("system", "ahead_s"), [("TAI", 37.0), ("GPS", 18.0), ("TT", 69.184)])
def test_epochs_of_other_time_systems_are_brought_to_utc(system: str, ahead_s: float) -> None:
    (epoch_us,), _ = read_attitude_message(euler_message("321", "0 0 0", system))
    assert epoch_us == round((FIRST.timestamp() - ahead_s) * 1e6)


def test_rows_outside_of_the_useable_span_are_left_out() -> None:
    epochs_us, _ = read_attitude_message(euler_message("321", "0 0 0", more="\nUSEABLE_START_TIME = 2099-001T00:00:00"))
    assert len(epochs_us) == 0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (euler_message("322", "0 0 0"), "three axes such as 321"),
        (euler_message("", "0 0 0"), "EULER_ROT_SEQ = nothing"),
        (euler_message("321", "0 0"), "three angles"),
        (euler_message("321", "0 0 0", "TDB"), "TIME_SYSTEM is TDB"),
        (euler_message("321", "0 0 0").replace("EULER_ANGLE", "SPIN"), "ATTITUDE_TYPE = SPIN"),
    ],
)
def test_attitudes_that_are_not_understood_are_refused(text: str, message: str) -> None:
    with pytest.raises(ForeignTableError, match=message):
        read_attitude_message(text)


def test_an_attitude_message_in_xml_is_that_of_keywords() -> None:
    meta = "".join(
        f"<{name}>{value}</{name}>"
        for name, value in {
            "OBJECT_ID": "2003-053F",
            "REF_FRAME_A": "LVLH",
            "REF_FRAME_B": "SC_BODY_1",
            "TIME_SYSTEM": "UTC",
            "ATTITUDE_TYPE": "EULER_ANGLE",
            "EULER_ROT_SEQ": "ZYX",
        }.items()
    )
    state = f"<EPOCH>{FIRST:%Y-%jT%H:%M:%S}</EPOCH><ANGLE_1>3</ANGLE_1><ANGLE_2>2</ANGLE_2><ANGLE_3>-1</ANGLE_3>"
    data = f"<attitudeState><eulerAngle>{state}</eulerAngle></attitudeState>"
    body = f"<body><segment><metadata>{meta}</metadata><data>{data}</data></segment></body>"
    (epoch_us,), (found,) = read_attitude_message(f'<aem xmlns="urn:x" version="2.0">{body}</aem>')
    assert epoch_us == round(FIRST.timestamp() * 1e6)
    np.testing.assert_allclose(found, (3.0, -1.0, 2.0), atol=1e-9)
