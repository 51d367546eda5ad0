"""Records of sensors before rows: each before its own, as plain Python and compiled, and numbers of no use."""

import math

import filter_models
import numpy as np
import pytest
from filter_models import bits, copied
from filter_rows import records_of
from wheel_filter import WHEELS, H

from service.core.estimation.filtering import row_block
from service.core.estimation.filtering.advance import advance
from service.core.estimation.filtering.filter_model import FilterSettings, PolarimeterModel, RateSensorModel
from service.core.estimation.filtering.filter_state import start
from service.core.estimation.filtering.plant import filter_model
from service.core.estimation.filtering.row import take_rows
from service.core.estimation.filtering.row_block import empty_block, empty_result, empty_trace
from service.core.estimation.filtering.state_changes import with_torque

MINUTE_US, CARRIERS, ROWS = 60_000_000, 6, 40
SENSED = FilterSettings(momentum=WHEELS, polarimeters=(PolarimeterModel((0.99, -0.09, -0.13)),))


@pytest.fixture(scope="module")
def model():
    carriers = filter_models.carrier_model(carriers=CARRIERS)
    return filter_model(carriers, SENSED, rate_sensor=RateSensorModel(0.01, 8.0, 0.003))


@pytest.fixture(scope="module")
def begun():
    carriers = filter_models.carrier_model(carriers=CARRIERS)
    return start(carriers, 0, with_torque(carriers, filter_models.aligned(carriers), SENSED), 1)


@pytest.fixture(scope="module")
def block():
    """Return rows a minute apart with records of all kinds between them, an unloading and a wild angle among them."""
    rng, values = np.random.default_rng(20261129), []
    rows = empty_block(ROWS, CARRIERS)
    rows.rows["epoch_us"] = MINUTE_US * np.arange(1, ROWS + 1)
    rows.rows["correction_deg"][30:32, 1] = 0.002
    rows.carriers["deviation_db"] = rng.normal(0.0, 0.1, (ROWS, CARRIERS))
    for row in range(ROWS):
        before_us, unloaded = MINUTE_US * row - 20_000_000, np.array([0.4, 0.0, -0.2]) * (row >= 25)
        if row % 5 == 0 and row:
            momentum = {"momentum_n_m_s": H + unloaded + rng.normal(0.0, 0.01, 3), "is_unloading": row == 25}
            values.append({"row": row, "kind": row_block.WHEELS, "epoch_us": before_us, **momentum})
            angle = {"angle_deg": 0.3 + rng.normal(0.0, 0.02) + 3.0 * (row == 15), "co_power_dbm": -55.0}
            values.append({"row": row, "kind": row_block.ANGLE, "epoch_us": before_us, "variance_deg2": 4e-4, **angle})
        rate = {"epoch_us": MINUTE_US * row + 30_000_000, "rate_deg_h": rng.normal(0.0, 0.01, 3)}
        if not 12 <= row < 28:
            values.append({"row": row, "kind": row_block.BODY_RATE, **rate})
    return rows._replace(records=records_of(*values))


def taken(model, state, block):
    """Return state and results after a block, which is not written to."""
    result = empty_result(len(block.rows), CARRIERS)
    return advance(model, state, block._replace(rows=block.rows.copy()), result), result


def test_sensors_are_heard_and_the_rate_of_the_body_makes_steps(model, begun, block):
    state, result = taken(model, begun, block)
    assert (result.rows["status"] == row_block.TAKEN).all()
    assert state.sensors["newest_us"].tolist() == [35 * MINUTE_US - 20_000_000] * 2
    assert state.sensors["records"][1] > 6.0
    assert not state.sensors["is_refused"].any()
    assert state.rates["is_measured"][0]
    # ten minutes after the last record the inertial model goes on
    held, _ = taken(model, begun, row_block.RowBlock(*(each[:26] for each in block[:3]), block.records))
    assert not held.rates["is_measured"][0]


def test_each_record_counts_before_its_own_row_in_blocks_of_any_length(model, begun, block):
    whole, result = taken(model, begun, block)
    state, rows = begun, []
    for number in range(ROWS):
        records = block.records[block.records["row"] == number].copy()
        records["row"] = 0
        one = row_block.RowBlock(*(each[number : number + 1] for each in block[:3]), records)
        state, found = taken(model, state, one)
        rows.append(found.rows)
    assert bits(state) == bits(whole)
    np.testing.assert_array_equal(np.concatenate(rows)["attitude_deg"], result.rows["attitude_deg"])


@pytest.mark.timeout(600)
def test_plain_python_gives_what_the_compiled_filter_gives(model, begun, block):
    compiled, _ = taken(model, begun, block)
    one, other, result = copied(begun), copied(begun), empty_result(ROWS, CARRIERS)
    rows = block._replace(rows=block.rows.copy())
    newest = take_rows(model, begun, one, other, rows, result, empty_trace(0, 0, 0))
    plain = (begun, one, other)[newest]
    for each, wanted in zip(plain, compiled, strict=True):
        for name in each.dtype.names or (...,):
            np.testing.assert_allclose(each[name], wanted[name], rtol=1e-8, atol=1e-11, err_msg=str(name))


@pytest.mark.parametrize("number", [math.nan, math.inf, -math.inf, 1e200])
@pytest.mark.parametrize(
    ("kind", "name"),
    [
        (row_block.WHEELS, "momentum_n_m_s"),
        (row_block.ANGLE, "angle_deg"),
        (row_block.ANGLE, "variance_deg2"),
        (row_block.ANGLE, "co_power_dbm"),
        (row_block.BODY_RATE, "rate_deg_h"),
    ],
)
def test_a_record_of_no_use_leaves_no_number_that_is_none(model, begun, block, kind, name, number):
    # a row whose numbers are lost leaves the state as before it
    state, _ = taken(model, begun, block)
    epoch_us = state.epoch_us + (MINUTE_US // 2 if kind == row_block.BODY_RATE else 0)
    record = {"kind": kind, "epoch_us": epoch_us, "variance_deg2": 4e-4, "co_power_dbm": -55.0, name: number}
    row = empty_block(1, CARRIERS)._replace(records=records_of(record))
    row.rows["epoch_us"], row.carriers["deviation_db"] = state.epoch_us + MINUTE_US, 0.01
    after, result = taken(model, state, row)
    is_lost = result.rows["status"][0] == row_block.LOST
    assert (after is state) == is_lost
    assert np.isfinite(after.mean).all()
    assert np.isfinite(after.covariance).all()
    np.testing.assert_allclose(after.mean[:3], state.mean[:3], atol=0.05)
