"""Attitude messages: text as the standard has it, segments, and what is refused."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from aem_reader import read_aem

from service.formats.aem import AemWriter, AttitudeMessage, split_rows
from service.records.catalogue import Method
from service.records.epoch import US_PER_S, parse_epoch
from service.records.levels.attitude import AttitudeRow, Axes, Status, row_without_attitude

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
