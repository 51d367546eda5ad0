"""Columns of a calibration: powers and flags of any plan in the order of the calibrated carriers."""

from dataclasses import replace

import numpy as np
import pytest
from geometry_flight import START_US, FlightPayload

from service.pipeline.estimation.method import CalibratedColumns
from service.records.catalogue import CarrierPlan, Station
from service.records.levels.measurement import Measurement

PAYLOAD = FlightPayload.make(5)
PLAN = PAYLOAD.plan()


def row(power, flags=None):
    return Measurement(START_US, START_US, 1, "sa-1", 1, np.array(power, dtype=np.float64), flags)


def test_the_own_plan_passes_as_it_is():
    columns = CalibratedColumns(PAYLOAD.ids, PLAN)
    np.testing.assert_array_equal(columns.power_dbm(row([1, 2, np.nan, 4, 5]), PLAN), [1, 2, np.nan, 4, 5])
    np.testing.assert_array_equal(columns.fit_power_dbm(row([1, 2, 3, 4, 5]), PLAN, 16), [1, 2, 3, 4, 5])
    flagged = row([1, 2, 3, 4, 5], np.array([1, 0, 16, 0, 4]))
    np.testing.assert_array_equal(columns.fit_power_dbm(flagged, PLAN, 16 | 4), [1, 2, np.nan, 4, np.nan])


def test_carriers_are_found_by_id_whatever_their_place():
    carriers = PAYLOAD.carriers()
    newcomer = replace(carriers[0], id="new")
    plan = CarrierPlan(2, "sha-2", (carriers[3], newcomer, carriers[1], carriers[0]))
    columns = CalibratedColumns(PAYLOAD.ids, PLAN)
    np.testing.assert_array_equal(columns.power_dbm(row([30, 99, 10, 0]), plan), [0, 10, np.nan, 30, np.nan])
    flagged = row([30, 99, 10, 0], np.array([8, 64, 2, 1]))
    np.testing.assert_array_equal(columns.fit_power_dbm(flagged, plan, 8 | 2), [0, np.nan, np.nan, np.nan, np.nan])
    # what was found for one plan is not taken for another
    np.testing.assert_array_equal(columns.power_dbm(row([1, 2, 3, 4, 5]), PLAN), [1, 2, 3, 4, 5])


@pytest.mark.parametrize(
    "change",
    [
        {"station": Station(60.0, 40.0)},
        {"transponder": "Ku9"},
        {"band": "X"},
        {"uplink_hz": 14.0e9},
        {"downlink_hz": 11.0e9},
    ],
    ids=lambda change: next(iter(change)),
)
def test_an_id_that_was_given_to_another_signal_is_not_the_calibrated_carrier(change):
    carriers = list(PAYLOAD.carriers())
    carriers[2] = replace(carriers[2], **change)
    columns = CalibratedColumns(PAYLOAD.ids, PLAN)
    reported = columns.power_dbm(row([1, 2, 3, 4, 5]), CarrierPlan(2, "sha-2", tuple(carriers)))
    np.testing.assert_array_equal(reported, [1, 2, np.nan, 4, 5])


def test_a_new_name_or_bandwidth_leaves_a_carrier_itself():
    carriers = tuple(replace(one, name="other", bandwidth_hz=2e6, enabled=False) for one in PAYLOAD.carriers())
    reported = CalibratedColumns(PAYLOAD.ids, PLAN).power_dbm(row([1, 2, 3, 4, 5]), CarrierPlan(2, "sha-2", carriers))
    np.testing.assert_array_equal(reported, [1, 2, 3, 4, 5])
