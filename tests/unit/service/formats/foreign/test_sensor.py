"""Angles and quaternions of a sensor are read back to the attitude that another program wrote, or refused."""

import math
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from foreign_orbits import attitude_message, quaternion
from hypothesis import given
from hypothesis import strategies as st

from service.formats.foreign.attitude_message import read_attitude_message
from service.formats.foreign.fault import ForeignCellError, ForeignTableError
from service.formats.foreign.layout import StatedLayout
from service.formats.foreign.proposal import Sample
from service.formats.foreign.sensor import StatedSensor, propose_sensor

UTC_ONLY = StatedLayout(tz="UTC")
FIRST = datetime(2026, 3, 21, tzinfo=UTC)
ANGLES = [(0.3 * math.sin(k), 0.2 * math.cos(k), 0.1 * math.sin(2 * k)) for k in range(30)]
EPOCHS = [FIRST + timedelta(minutes=k) for k in range(30)]


def texts(columns: list[list[float]]) -> list[list[str]]:
    """Return rows with an epoch before the numbers."""
    return [
        [epoch.strftime("%Y-%m-%d %H:%M:%S"), *(f"{value:.12f}" for value in values)]
        for epoch, values in zip(EPOCHS, columns, strict=True)
    ]


def read(header: list[str], rows: list[list[str]], stated: StatedSensor) -> np.ndarray:
    """Return the angles of all rows."""
    proposal = propose_sensor(Sample(header, rows), stated)
    assert proposal.reader is not None, proposal.questions
    found = [proposal.reader.read(row) for row in rows]
    assert [epoch_us for epoch_us, _ in found] == [round(epoch.timestamp() * 1e6) for epoch in EPOCHS]
    return np.array([angles for _, angles in found], dtype=np.float64)


@pytest.mark.parametrize(
    ("header", "order", "scale", "stated"),
    [
        (["t", "yaw_deg", "roll_deg", "pitch_deg"], (0, 1, 2), 1.0, StatedSensor(UTC_ONLY)),
        (["t", "Pitch [mrad]", "Roll [mrad]", "Yaw [mrad]"], (2, 1, 0), 0.18 / math.pi, StatedSensor(UTC_ONLY)),
        (["t", "Roll", "Pitch", "Yaw"], (1, 2, 0), 180 / math.pi, StatedSensor(UTC_ONLY, unit="rad")),
        (["t", "крен, °", "тангаж, °", "рыскание, °"], (1, 2, 0), 1.0, StatedSensor(UTC_ONLY)),
        (
            ["t", "a", "b", "c"],
            (2, 0, 1),
            1 / 60,
            StatedSensor(UTC_ONLY, unit="arcmin", columns={"a": "pitch", "b": "yaw", "c": "roll"}),
        ),
    ],
)
def test_angles_are_read_by_name(header: list[str], order: tuple[int, ...], scale: float, stated: StatedSensor) -> None:
    rows = texts([[angles[k] / scale for k in order] for angles in ANGLES])
    np.testing.assert_allclose(read(header, rows, stated), ANGLES, atol=1e-9)


@pytest.mark.parametrize(
    ("header", "is_first"),
    [(["q1", "q2", "q3", "q4"], False), (["q0", "q1", "q2", "q3"], True), (["qx", "qy", "qz", "qw"], False)],
)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_quaternions_are_read_whatever_their_sign_and_order(header: list[str], is_first: bool, sign: float) -> None:
    parts = [[sign * part for part in quaternion(*angles)] for angles in ANGLES]
    rows = texts([[each[3], *each[:3]] if is_first else each for each in parts])
    np.testing.assert_allclose(read(["t", *header], rows, StatedSensor(UTC_ONLY)), ANGLES, atol=1e-8)


def test_a_scalar_that_is_stated_against_the_numbers_is_refused() -> None:
    rows = texts([list(quaternion(*angles)) for angles in ANGLES])
    with pytest.raises(ForeignTableError, match="columns are exchanged"):
        propose_sensor(Sample(["t", "qw", "qx", "qy", "qz"], rows), StatedSensor(UTC_ONLY))
    with pytest.raises(ForeignTableError, match="first by statement"):
        propose_sensor(Sample(["t", "q1", "q2", "q3", "q4"], rows), StatedSensor(UTC_ONLY, scalar="first"))


def test_inertial_quaternions_are_refused() -> None:
    rows = texts([list(quaternion(12.0 * k, 80.0, 20.0)) for k in range(30)])
    with pytest.raises(ForeignTableError, match="inertial quaternions must"):
        propose_sensor(Sample(["t", "q1", "q2", "q3", "q4"], rows), StatedSensor(UTC_ONLY))


def test_units_and_axes_are_asked_for() -> None:
    rows = texts([list(angles) for angles in ANGLES])
    asked = propose_sensor(Sample(["t", "yaw", "roll", "pitch"], rows), StatedSensor()).questions
    assert [each.option for each in asked] == ["--tz", "--unit"]
    asked = propose_sensor(Sample(["t", "a", "b", "c"], rows), StatedSensor(UTC_ONLY)).questions
    assert [each.option for each in asked] == ["--map"]
    # a rate and a deviation are no angles
    asked = propose_sensor(Sample(["t", "yaw rate", "roll_sigma", "x"], rows), StatedSensor(UTC_ONLY)).questions
    assert [each.option for each in asked] == ["--map"]


@pytest.mark.parametrize(
    ("header", "stated", "message"),
    [
        (["t", "yaw deg", "Yaw_deg", "roll"], StatedSensor(UTC_ONLY), "are both yaw"),
        (["t", "yaw deg", "roll rad", "pitch deg"], StatedSensor(UTC_ONLY), "several units"),
        (["t", "yaw deg", "roll deg", "x"], StatedSensor(UTC_ONLY, unit="rad"), "several units"),
        (["t", "yaw", "roll", "x"], StatedSensor(UTC_ONLY, unit="gon"), "is unknown"),
        (["t", "a", "b", "x"], StatedSensor(UTC_ONLY, columns={"a": "pich"}), "the axes are yaw, roll, pitch"),
        (["t", "a", "b", "x"], StatedSensor(UTC_ONLY, columns={"z": "pitch"}), "no column 'z'"),
    ],
)
def test_contradictions_are_refused(header: list[str], stated: StatedSensor, message: str) -> None:
    with pytest.raises(ForeignTableError, match=message):
        propose_sensor(Sample(header, texts([list(angles) for angles in ANGLES])), stated)


def test_quaternions_of_another_length_are_kept_back() -> None:
    rows = texts([list(quaternion(*angles)) for angles in ANGLES])
    reader = propose_sensor(Sample(["t", "q1", "q2", "q3", "q4"], rows), StatedSensor(UTC_ONLY)).reader
    assert reader is not None
    with pytest.raises(ForeignCellError, match="not of unit length"):
        reader.read([rows[0][0], "0", "0", "0", "0.5"])


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
    ((epoch_us, found),) = read_attitude_message(text)
    assert epoch_us == round(FIRST.timestamp() * 1e6)
    np.testing.assert_allclose(np.array(found, dtype=float), angles, atol=1e-8)
    swapped = attitude_message([(FIRST, (x, y, z, w))], frames=("SC_BODY_1", "LVLH_ROTATING"))
    ((_, other),) = read_attitude_message(swapped)
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
