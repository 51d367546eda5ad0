"""Attitude and tracking messages, carrier plans and numbers as text: what is written, and what is refused."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import pytest
from aem_reader import read_aem
from hypothesis import given
from hypothesis import strategies as st

from service.errors import InvalidInputError
from service.formats.carrier_plan_csv import COLUMNS, read_carrier_plan, write_carrier_plan
from service.formats.ccsds import AemWriter, AttitudeMessage, split_rows
from service.formats.numbers import shortest_float32, text_of_float, text_of_float32
from service.formats.tdm import SEGMENT_ROWS, TdmWriter, TrackingMessage, read_tdm
from service.records.catalogue import Carrier, Method, Station
from service.records.epoch import US_PER_S, parse_epoch
from service.records.levels.attitude import AttitudeRow, Axes, Status, row_without_attitude
from service.records.levels.measurement import Measurement, QualityFlag

START_US = parse_epoch("2026-11-21T00:00:00Z")
MESSAGE = AttitudeMessage("YAMAL-202", "2003-053B", "m-1", START_US, "robust 1")


def _row(k: int, yaw: float = 0.0, roll: float = 0.0, pitch: float = 0.0) -> AttitudeRow:
    blank = row_without_attitude(START_US + 60 * US_PER_S * k, START_US, k + 1, Method.ROBUST, ())
    return replace(
        blank,
        attitude_deg=Axes(yaw, roll, pitch),
        sigma_deg=Axes(0.08, 0.014, 0.02),
        status=Status.ACQUIRED,
        control_allowed=True,
        calibration_id=7,
        alignment_id=4,
    )


def _written(pages: Sequence[Sequence[AttitudeRow]]) -> str:
    writer = AemWriter(MESSAGE)
    return (writer.header() + b"".join(writer.segments(pages))).decode("ascii")


def test_message_of_two_rows_line_by_line() -> None:
    assert _written([[_row(0, yaw=90.0), _row(1, roll=0.2)]]).splitlines() == [
        "CCSDS_AEM_VERS = 2.0",
        "CREATION_DATE = 2026-11-21T00:00:00.000000",
        "ORIGINATOR = SOO",
        "MESSAGE_ID = m-1",
        "META_START",
        "COMMENT estimator=robust 1 source=RF_CARRIER_POWER",
        "COMMENT calibration=7 alignment=4 status=ACQUIRED",
        "COMMENT largest 1-sigma, deg: yaw=0.0800 roll=0.0140 pitch=0.0200",
        "COMMENT control allowed in 2 of 2 rows",
        "OBJECT_NAME = YAMAL-202",
        "OBJECT_ID = 2003-053B",
        "CENTER_NAME = EARTH",
        "REF_FRAME_A = LVLH_ROTATING",
        "REF_FRAME_B = SC_BODY_1",
        "TIME_SYSTEM = UTC",
        "START_TIME = 2026-11-21T00:00:00.000000",
        "STOP_TIME = 2026-11-21T00:01:00.000000",
        "ATTITUDE_TYPE = QUATERNION",
        "INTERPOLATION_METHOD = LINEAR",
        "INTERPOLATION_DEGREE = 1",
        "META_STOP",
        "DATA_START",
        # a quarter turn about z: half angle 45 degrees, scalar last
        "2026-11-21T00:00:00.000000 0.000000000000 0.000000000000 0.707106781187 0.707106781187",
        # 0.2 deg about x: sin and cos of 0.1 deg
        "2026-11-21T00:01:00.000000 0.001745328366 0.000000000000 0.000000000000 0.999998476913",
        "DATA_STOP",
    ]


def test_what_is_read_is_what_was_written() -> None:
    rng = np.random.default_rng(5)
    rows = [_row(k, *rng.uniform(-3.0, 3.0, 3)) for k in range(50)]
    (track,) = read_aem(_written([rows[:20], rows[20:]]))
    assert track.object_name == "YAMAL-202"
    assert track.epochs_us.tolist() == [row.epoch_us for row in rows]
    assert np.abs(track.attitude_deg - np.array([row.attitude_deg for row in rows])).max() < 1e-9


@pytest.mark.parametrize(
    ("rows", "sizes"),
    [
        ([_row(k) for k in range(6)], [6]),
        ([_row(0), _row(1), _row(2), _row(9), _row(10)], [3, 2]),
        ([_row(0), _row(1), replace(_row(2), calibration_id=8), replace(_row(3), calibration_id=8)], [2, 2]),
        ([_row(0), replace(_row(1), status=Status.EXPIRED), _row(2)], [1, 1, 1]),
        ([_row(0), row_without_attitude(START_US + 60 * US_PER_S, 0, 9, Method.ROBUST, ()), _row(2)], [1, 1]),
        ([_row(0), _row(0), _row(1)], [2]),
        ([], []),
    ],
    ids=["whole", "gap", "calibration", "status", "without attitude", "two sources", "nothing"],
)
def test_segments_end_where_nobody_may_interpolate(rows: list[AttitudeRow], sizes: list[int]) -> None:
    assert [len(run) for run in split_rows([rows])] == sizes


def test_one_row_names_no_interpolation() -> None:
    text = _written([[_row(0)]])
    assert "INTERPOLATION" not in text
    assert "START_TIME = 2026-11-21T00:00:00.000000\nSTOP_TIME = 2026-11-21T00:00:00.000000" in text


def test_names_of_any_script_stay_within_the_standard() -> None:
    writer = AemWriter(replace(MESSAGE, object_name="Ямал\t202 " + "x" * 400))
    text = b"".join(writer.segments([[_row(0), _row(1)]])).decode("ascii")
    assert max(map(len, text.splitlines())) <= 254
    assert "\t" not in text


def test_ordinal_dates_are_read() -> None:
    text = _written([[_row(0), _row(1)]]).replace("2026-11-21T", "2026-325T")
    assert read_aem(text)[0].epochs_us[0] == START_US


TDM_MESSAGE = TrackingMessage("YAMAL-202", "Moscow", "m-2", START_US)
CARRIERS = [Carrier(f"c{k}", "Ku", "Ku1", 11.0e9 + 1e6 * k, 1.25e6) for k in range(2)]


def _tdm_row(k: int, powers: list[float], flags: list[int] | None = None, source: str = "sa-1") -> Measurement:
    epoch_us = START_US + 60 * US_PER_S * k
    stored = np.array(powers, dtype=np.float32).astype(np.float64)
    return Measurement(
        epoch_us, epoch_us, k + 1, source, 1, stored, None if flags is None else np.array(flags, dtype=np.int64)
    )


def _tdm_written(rows: list[Measurement]) -> str:
    writer = TdmWriter(TDM_MESSAGE, lambda _plan: CARRIERS)
    return (writer.header() + b"".join(writer.segments([rows]))).decode("ascii")


def test_message_of_one_carrier_line_by_line() -> None:
    assert _tdm_written([_tdm_row(0, [-42.1, np.nan]), _tdm_row(1, [-42.25, np.nan])]).splitlines() == [
        "CCSDS_TDM_VERS = 2.0",
        "CREATION_DATE = 2026-11-21T00:00:00.000000",
        "ORIGINATOR = SOO",
        "MESSAGE_ID = m-2",
        "META_START",
        "COMMENT carrier=c0 name=c0 transponder=Ku1",
        "COMMENT downlink_hz=11000000000 bandwidth_hz=1250000",
        "COMMENT time tags are the middle of the dwell",
        "TRACK_ID = sa-1/c0",
        "DATA_TYPES = CARRIER_POWER",
        "TIME_SYSTEM = UTC",
        "START_TIME = 2026-11-21T00:00:00.000000",
        "STOP_TIME = 2026-11-21T00:01:00.000000",
        "PARTICIPANT_1 = YAMAL-202",
        "PARTICIPANT_2 = Moscow",
        "MODE = SEQUENTIAL",
        "PATH = 1,2",
        "RECEIVE_BAND = KU",
        "TIMETAG_REF = RECEIVE",
        "DATA_QUALITY = RAW",
        "META_STOP",
        "DATA_START",
        "CARRIER_POWER = 2026-11-21T00:00:00.000000 -72.1",
        "CARRIER_POWER = 2026-11-21T00:01:00.000000 -72.25",
        "DATA_STOP",
    ]


def test_powers_come_back_bit_for_bit() -> None:
    rng = np.random.default_rng(8)
    levels = rng.uniform(-120.0, 10.0, (40, 2)).round(5)
    rows = [_tdm_row(k, [*level]) for k, level in enumerate(levels.tolist())]
    tracks = read_tdm(_tdm_written(rows))
    assert [track.track_id for track in tracks] == ["sa-1/c0", "sa-1/c1"]
    for position, track in enumerate(tracks):
        assert track.epochs_us.tolist() == [row.epoch_us for row in rows]
        stored = np.array([row.power_dbm[position] for row in rows], dtype=np.float32)
        assert track.power_dbm.astype(np.float32).tobytes() == stored.tobytes()


def test_doubtful_rows_stand_apart() -> None:
    overrange = int(QualityFlag.OVERRANGE)
    simulated = int(QualityFlag.SIMULATED)
    rows = [
        _tdm_row(0, [-40, -50], [0, simulated]),
        _tdm_row(1, [-41, -51], [overrange, 0]),
        _tdm_row(2, [-42, np.nan], [0, 16]),
    ]
    reported = [(track.track_id, track.quality, track.power_dbm.tolist()) for track in read_tdm(_tdm_written(rows))]
    assert reported == [
        ("sa-1/c0", "VALIDATED", [-40.0, -42.0]),
        ("sa-1/c0", "DEGRADED", [-41.0]),
        ("sa-1/c1", "VALIDATED", [-50.0, -51.0]),
    ]


def test_two_sources_never_share_a_segment() -> None:
    rows = [_tdm_row(0, [-40, -50]), _tdm_row(0, [-40.5, -50.5], source="sa-2")]
    assert [track.track_id for track in read_tdm(_tdm_written(rows))] == ["sa-1/c0", "sa-1/c1", "sa-2/c0", "sa-2/c1"]


def test_memory_is_that_of_one_stretch() -> None:
    row = _tdm_row(0, [-40.0, -50.0])
    taken = 0

    def pages() -> Iterator[list[Measurement]]:
        nonlocal taken
        for _ in range(30):
            taken += 1
            yield [row] * 1000

    next(TdmWriter(TDM_MESSAGE, lambda _plan: CARRIERS).segments(pages()))
    assert taken == SEGMENT_ROWS // 1000


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("CARRIER_POWER = 2026", "CARRIER_POWER 2026"),
        ("-72.1", "minus"),
        ("-72.1", "nan"),
        ("T00:00:00.000000 -72.1", "T25:00:00.000000 -72.1"),
        ("CCSDS_TDM_VERS", "CCSDS_AEM_VERS"),
    ],
)
def test_malformed_lines_are_named(old: str, new: str) -> None:
    text = _tdm_written([_tdm_row(0, [-42.1, -50.0])])
    with pytest.raises(InvalidInputError) as refusal:
        read_tdm(text.replace(old, new, 1))
    assert refusal.value.code == "ccsds.malformed"


def test_epochs_of_other_systems_doubts_and_second_values_are_not_passed_over() -> None:
    text = _tdm_written([_tdm_row(0, [-42.1, -50.0])])
    (utc_us, *_), (tai_us, *_) = (read_tdm(each)[0].epochs_us for each in (text, text.replace("= UTC", "= TAI")))
    assert utc_us - tai_us == 37_000_000
    power = next(line for line in text.splitlines() if line.startswith("CARRIER_POWER"))
    for other, message in (
        (text.replace(power, f"{power}\n{power[:-1]}9"), "a second power of"),
        (text.replace("MODE =", "CORRECTIONS_APPLIED = NO\nCORRECTION_RANGE = 1\nMODE ="), "CORRECTION_RANGE = 1"),
        (text.replace("= UTC", "= UT1"), "TIME_SYSTEM is UT1"),
    ):
        with pytest.raises(InvalidInputError, match=message):
            read_tdm(other)
    assert read_tdm(text.replace(power, f"{power}\n{power}"))[0].power_dbm.tolist() == [-42.1]


PLAN = (
    Carrier(
        "c00", "Ku", "Ku1", 11200.25e6, 1.25e6, Station(55.5, 37.0, 'A "b", c'), 14250e6, "line\nfeed", "H", 958.2e6
    ),
    Carrier("c01", "C", "C1", 0.1 + 0.2, 5e-324, Station(-1.0, -179.5), 1e12, kind="pilot", enabled=False),
    Carrier("b0", "Ku", "Ku1", 11199e6, 1e3, kind="beacon", uplink_power_control="none", transponder_mode="alc"),
)


def test_what_is_written_reads_back_equal():
    documents = read_carrier_plan(write_carrier_plan(PLAN).encode())
    back = tuple(
        Carrier(
            **{k: v for k, v in document.items() if k != "station"},
            station=Station(**document["station"]) if "station" in document else None,
        )
        for document in documents
    )
    assert back == PLAN


def test_the_file_is_rfc_4180_with_plain_whole_numbers():
    lines = write_carrier_plan(PLAN[2:]).split("\r\n")
    assert lines[0] == ",".join(COLUMNS)
    assert lines[1] == "b0,,,,,Ku,Ku1,,,11199000000,,1000,beacon,none,alc,true"
    assert lines[2] == ""


def test_columns_may_stand_in_any_order_and_blank_lines_do_not_count():
    text = "bandwidth_hz , id,downlink_hz,transponder,band\n\n 1e3 , c0 ,11.2e9,T1,Ku\n,,,,\n"
    assert read_carrier_plan(text.encode()) == [
        {"id": "c0", "band": "Ku", "transponder": "T1", "downlink_hz": 11.2e9, "bandwidth_hz": 1000.0}
    ]


def test_a_half_stated_station_is_passed_on_for_the_interface_to_judge():
    text = "id,band,transponder,downlink_hz,bandwidth_hz,station_name\nc0,Ku,T1,1,1,Dubna\n"
    assert read_carrier_plan(text.encode())[0]["station"] == {"name": "Dubna"}


@pytest.mark.parametrize(
    ("raw", "pointer", "word"),
    [
        (b"", "", "missing"),
        (b"\xc3", "", "UTF-8"),
        (b"id,band,transponder,downlink_hz,bandwidth_hz,power\n", "", "'power'"),
        (b"id,band,transponder,downlink_hz,bandwidth_hz,band\n", "", "twice"),
        (b"id,band,transponder,downlink_hz\n", "", "'bandwidth_hz'"),
        (b"id,band,transponder,downlink_hz,bandwidth_hz\nc0,Ku,T,1\n", "/carriers/0", "4 cells"),
        (b"id,band,transponder,downlink_hz,bandwidth_hz\nc0,Ku,T,1,1\nc1,Ku,T,x,1\n", "/carriers/1/downlink_hz", "'x'"),
        (b'id,band,transponder,downlink_hz,bandwidth_hz\nc0,"Ku,T,1,1\n', "", "CSV"),
        (b"id,band,transponder,downlink_hz,bandwidth_hz\nc0,Ku," + b"x" * 5000 + b",1,1\n", "", "4096"),
        (b"id,band,transponder,downlink_hz,bandwidth_hz\nc0,Ku," + b"x" * 200_000 + b",1,1\n", "", "CSV"),
    ],
)
def test_what_is_wrong_is_named_with_its_place(raw, pointer, word):
    with pytest.raises(InvalidInputError) as caught:
        read_carrier_plan(raw)
    assert caught.value.code == "csv.malformed"
    assert caught.value.fields[0].pointer == pointer
    assert word in caught.value.detail


def test_names_that_a_spreadsheet_would_compute_are_guarded_and_read_back():
    names = ("=HYPERLINK(1)", "+7", "-1", "@sum", "'=1", "''@x", "'quoted'", "O'Brien")
    plan = [
        Carrier(f"c{k}", "Ku", "T", 1e10, 1e6, Station(-1.5, -7.0, name), 1e10, name) for k, name in enumerate(names)
    ]
    text = write_carrier_plan(plan)
    cells = [line.split(",") for line in text.splitlines()[1:]]
    assert [line[1] for line in cells][:5] == ["'=HYPERLINK(1)", "'+7", "'-1", "'@sum", "''=1"]
    # numbers stay numbers
    assert {(line[3], line[4]) for line in cells} == {("-1.5", "-7")}
    documents = read_carrier_plan(text.encode())
    assert [(each["name"], each["station"]["name"]) for each in documents] == [(name, name) for name in names]


FLOAT32 = st.floats(width=32, allow_nan=False, allow_infinity=False)


@given(st.lists(FLOAT32, max_size=8))
def test_float32_reads_back_exactly(values):
    stored = np.array(values, dtype=np.float64)
    # exact: the promise is the stored bits, not something near them
    assert np.array_equal(np.array(shortest_float32(stored), dtype=np.float32), stored.astype(np.float32))
    assert [float(text) for text in text_of_float32(stored)] == shortest_float32(stored)


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_float64_reads_back_exactly(value):
    assert float(text_of_float(value)) == value


CASES = {-42.1: "-42.1", 0.0: "0.0", -250.0: "-250.0", 1e-20: "1e-20", 16777216.0: "1.6777216e+07", math.nan: ""}


@pytest.mark.parametrize(("value", "text"), CASES.items(), ids=str)
def test_few_digits(value, text):
    stored = np.array([np.float32(value)], dtype=np.float64)
    assert text_of_float32(stored) == [text]
    assert shortest_float32(stored) == [float(text) if text else None]


def test_absent_is_empty():
    assert text_of_float(math.nan) == ""
    assert text_of_float(np.float64(0.1)) == "0.1", "a number of numpy is written as a number"
    assert text_of_float32(np.zeros(0)) == []
