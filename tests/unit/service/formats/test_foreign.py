"""Proposals and sensors of other programs: read back to what was written, asked about, or refused."""

import math
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from foreign_files import Writing, table, truth
from foreign_orbits import quaternion
from hypothesis import given
from hypothesis import strategies as st

from service.formats.foreign.layout import ForeignCellError, ForeignTableError, StatedLayout, formats_of
from service.formats.foreign.proposal import Sample, propose
from service.formats.foreign.sensor import StatedSensor, propose_sensor

CARRIERS = ("c00", "c01")
AS_USUAL, NOTHING = Writing(), StatedLayout()
PLAN = {"c00": "c00", "c01": "c01", "Rostov": "c01"}


def sample(writing: Writing = AS_USUAL, rows: int = 30, day: int = 21) -> Sample:
    """Return a sample of a table."""
    header, *lines = table(truth(CARRIERS, rows, datetime(2026, 3, day, tzinfo=UTC)), writing)
    return Sample(header, lines)


def asked(found: Sample, stated: StatedLayout = NOTHING) -> dict[str, tuple[str, ...]]:
    """Return the choices of the questions by option."""
    return {each.option: each.choices for each in propose(found, stated, PLAN).questions}


def test_zone_and_unit_are_asked_for() -> None:
    assert asked(sample()) == {"--tz": (), "--unit": ("dBm", "dBW")}
    assert asked(sample(), StatedLayout(tz="UTC")) == {"--unit": ("dBm", "dBW")}
    assert asked(sample(), StatedLayout(tz="UTC", unit="dBW")) == {}


@given(st.integers(1, 12), st.integers(1, 12))
def test_an_order_of_day_and_month_that_is_not_proven_is_asked_for(day: int, month: int) -> None:
    texts = [datetime(2026, month, day, hour, tzinfo=UTC).strftime("%d.%m.%Y %H:%M:%S") for hour in range(24)]
    assert set(formats_of(texts)) == {"%d.%m.%Y %H:%M:%S", "%m.%d.%Y %H:%M:%S"}


@given(st.integers(13, 28), st.integers(1, 12), st.sampled_from(["%d.%m.%Y %H:%M", "%m/%d/%Y %H:%M"]))
def test_one_day_above_the_twelfth_proves_the_order(day: int, month: int, pattern: str) -> None:
    days = [datetime(2026, month, each, 10, tzinfo=UTC) for each in (*range(2, 13), day)]
    assert formats_of([each.strftime(pattern) for each in days]) == [pattern]


def test_an_ambiguous_order_stays_a_question_of_the_table() -> None:
    found = sample(Writing(pattern="%d.%m.%Y %H:%M:%S"), day=2)
    assert set(asked(found)["--time-format"]) == {"%d.%m.%Y %H:%M:%S", "%m.%d.%Y %H:%M:%S"}
    assert "--time-format" not in asked(found, StatedLayout(time_format="%d.%m.%Y %H:%M:%S"))


@pytest.mark.parametrize(("level", "default"), [(-200.0, "dBW"), (-75.0, None), (10.0, "dBm")])
def test_a_unit_is_suggested_only_where_the_other_is_impossible(level: float, default: str | None) -> None:
    rows = [[f"2026-03-21 00:{k:02}:00", str(level + k / 100)] for k in range(20)]
    (question,) = propose(Sample(["t", "c00"], rows), StatedLayout(tz="UTC"), PLAN).questions
    assert (question.option, question.default) == ("--unit", default)


def test_columns_are_matched_by_id_and_name_and_never_by_likeness() -> None:
    rows = [[f"2026-03-21 00:{k:02}:00", "-60.5", "-61.5", "-62.5"] for k in range(20)]
    found = propose(Sample(["t", "C00 [dBm]", "rostov (dBW)", "c0"], rows), StatedLayout(tz="UTC"), PLAN)
    assert found.layout is not None
    assert dict(found.layout.carriers) == {"C00 [dBm]": "c00", "rostov (dBW)": "c01"}
    assert dict(found.layout.units) == {"C00 [dBm]": "dBm", "rostov (dBW)": "dBW"}
    assert asked(Sample(["t", "power 1", "power 2", "x"], rows), StatedLayout(tz="UTC")) == {
        "--map": ("power 1", "power 2", "x")
    }


@pytest.mark.parametrize(
    ("header", "stated", "message"),
    [
        (["t", "c00", "c00"], StatedLayout(), "occur twice: c00"),
        (["t", "c00", "C00"], StatedLayout(), "several columns are carrier c00"),
        (["t", "c01", "Rostov"], StatedLayout(), "several columns are carrier c01"),
        (["t", "c00", "x"], StatedLayout(carriers={"x": "c77"}), "no carrier of the plan"),
        (["t", "c00", "x"], StatedLayout(carriers={"y": "c01"}), "no column 'y'"),
        (["t", "c00 dBm", "x"], StatedLayout(unit="dBW"), "states dBm, --unit states dBW"),
        (["t", "c00", "x"], StatedLayout(time_columns=("time",)), "no column 'time'"),
        (["t", "c00", "x"], StatedLayout(tz="Mars/Olympus"), "no time zone"),
        (["t", "c00", "x"], StatedLayout(time_format="%d.%m.%Y"), "does not read the epochs"),
        (["t", "c00", "x"], StatedLayout(time_format="ddmmyy"), "--time-format 'ddmmyy' is unknown"),
    ],
)
def test_what_the_table_contradicts_is_refused(header: list[str], stated: StatedLayout, message: str) -> None:
    rows = [[f"2026-03-21 00:{k:02}:00", "-60.5", "-61.5"] for k in range(20)]
    with pytest.raises(ForeignTableError, match=message):
        propose(Sample(header, rows), stated, PLAN)


def test_decimals_of_two_kinds_are_refused() -> None:
    rows = [[f"2026-03-21 00:{k:02}:00", "-60.5", "-61,5"] for k in range(20)]
    with pytest.raises(ForeignTableError, match="decimals of two kinds"):
        propose(Sample(["t", "c00", "c01"], rows), StatedLayout(), PLAN)


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
