"""CSV of measurements and attitude rows."""

import csv
import io
import math
from dataclasses import replace

import numpy as np
import pytest

from service.formats.csv_writer import ATTITUDE_COLUMNS, MeasurementCsv, attitude_header, attitude_lines
from service.records.attitude import Exclusion, Status, row_without_attitude
from service.records.catalogue import Method
from service.records.measurement import Measurement

PLANS = {1: ("c00", "c01"), 2: ("c02", "c00")}


def measurement(plan_id: int, *power_dbm: float, source: str = "sa-1") -> Measurement:
    """Return a row as the archive keeps it."""
    stored = np.array(power_dbm, dtype=np.float32).astype(np.float64)
    return Measurement(1_500_000, 2_000_000, 7, source, plan_id, stored, None)


def fields(raw: bytes) -> list[list[str]]:
    """Return what a reader of CSV sees."""
    return list(csv.reader(io.StringIO(raw.decode(), newline=""), strict=True))


def test_columns_are_the_union_in_order_of_appearance():
    writer = MeasurementCsv(list(PLANS.values()), PLANS.__getitem__)
    assert writer.header() == b"epoch,source,c00_dbm,c01_dbm,c02_dbm\r\n"
    assert writer.lines([measurement(1, -42.1, math.nan), measurement(2, -1.5, -2.25)]) == (
        b"1970-01-01T00:00:01.500000Z,sa-1,-42.1,,\r\n1970-01-01T00:00:01.500000Z,sa-1,-2.25,,-1.5\r\n"
    )


def test_carrier_without_a_column_is_left_out():
    writer = MeasurementCsv([PLANS[1]], PLANS.__getitem__)
    assert fields(writer.lines([measurement(2, -1.5, -2.25)])) == [["1970-01-01T00:00:01.500000Z", "sa-1", "-2.25", ""]]


def test_no_rows_are_no_lines():
    writer = MeasurementCsv([], PLANS.__getitem__)
    assert (writer.header(), writer.lines([])) == (b"epoch,source\r\n", b"")
    assert attitude_lines([]) == b""


@pytest.mark.parametrize("source", ['a "b"', "a,b", "a\nb", "a\r\nb"])
def test_text_that_would_break_a_line_is_quoted(source):
    writer = MeasurementCsv([PLANS[1]], PLANS.__getitem__)
    ((_, told, *_),) = fields(writer.lines([measurement(1, -1.0, -2.0, source=source)]))
    assert told == source


def test_row_without_attitude_has_empty_fields():
    row = row_without_attitude(1_500_000, 2_000_000, 7, Method.ROBUST, ("no_calibration",))
    header, line = fields(attitude_header() + attitude_lines([row]))
    assert tuple(header) == ATTITUDE_COLUMNS
    told = dict(zip(header, line, strict=True))
    absent = {name for name, text in told.items() if text == ""}
    assert absent == {*(f"{axis}_deg" for axis in ("yaw", "roll", "pitch"))} | {
        *(f"{axis}_sigma_deg" for axis in ("yaw", "roll", "pitch")),
        "downlink_fade_db",
        "common_db",
        "excluded",
    }
    assert (told["method"], told["status"], told["carriers_used"]) == ("robust", Status.INVALID.value, "0")
    assert (told["control_allowed"], told["downlink_fade"]) == ("false", "false")


def test_exclusions_stand_with_their_reasons():
    excluded = (Exclusion("c03", "uplink_fade"), Exclusion("c05", "absent"))
    row = replace(row_without_attitude(0, 0, 1, Method.PAPER, ()), excluded=excluded)
    (line,) = fields(attitude_lines([row]))
    assert line[ATTITUDE_COLUMNS.index("excluded")] == "c03:uplink_fade;c05:absent"
