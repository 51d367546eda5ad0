"""Joined table: carriers of several plans by column, and cells of what is not there."""

import math

import numpy as np

from service.formats.tabular.joined_table import JoinedRow, joined_table
from service.formats.tabular.measurement_file import MeasurementColumns
from service.records.catalogue import Method
from service.records.levels.attitude import row_without_attitude
from service.records.levels.carrier_results import CARRIER_STATES, CarrierResults
from service.records.levels.measurement import Measurement

PLANS = {1: ("c00", "c01"), 2: ("c09", "c00")}
TABLE = joined_table(MeasurementColumns(list(PLANS.values()), PLANS.__getitem__))


def measurement(plan_id: int) -> Measurement:
    levels = np.array([np.float32(-42.1), np.nan], dtype=np.float64)
    return Measurement(1_000_000, 2_000_000, 7, "sa-1", plan_id, levels, None)


def cells(row: JoinedRow) -> dict[str, object]:
    return dict(zip((column.name for column in TABLE.columns), TABLE.values(row), strict=True))


def test_names_are_unique_and_begin_with_the_measurement() -> None:
    names = [column.name for column in TABLE.columns]
    assert len(set(names)) == len(names)
    assert names[:6] == ["epoch", "source", "c00_dbm", "c01_dbm", "c09_dbm", "c00_state"]


def test_a_measurement_alone_fills_no_other_cell() -> None:
    found = cells(JoinedRow(measurement(1), None, None, None))
    assert {name for name, value in found.items() if value is not None} == {"epoch", "source", "c00_dbm"}
    assert found["c00_dbm"] == -42.1


def test_results_stand_at_the_carriers_of_their_own_plan() -> None:
    results = CarrierResults(
        2, np.array([0.012, math.nan]), np.array([-0.004, 0.3]), np.array([0, 1]), np.zeros(2, int)
    )
    attitude = row_without_attitude(1_000_000, 2_000_000, 7, Method.PAPER, ("not_aligned",))
    found = cells(JoinedRow(measurement(2), attitude, results, None))
    assert [found[f"{carrier}_dbm"] for carrier in ("c00", "c01", "c09")] == [None, None, -42.1]
    assert [found[f"{carrier}_state"] for carrier in ("c00", "c01", "c09")] == [CARRIER_STATES[1], None, "used"]
    assert (found["c09_deviation_db"], found["c09_residual_db"], found["c00_residual_db"]) == (0.012, -0.004, 0.3)
    assert (found["method"], found["inhibitions"], found["command_epoch"]) == ("paper", "not_aligned", None)
