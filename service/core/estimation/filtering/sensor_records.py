"""Records of sensors of motion that are due before a row: wheels, polarimeters, and the rate of the body.

They act on the state of the row before, in place and in the order of `RowBlock`; the functions are compiled as they
stand.
"""

import numpy as np

from service.core.estimation.filtering.filter_model import DRIFT, FIRST_COMMON, RATE
from service.core.estimation.filtering.filter_state import FilterState
from service.core.estimation.filtering.motion_sensor import sensor_advice
from service.core.estimation.filtering.plant import POLARIMETER, FilterModel
from service.core.estimation.filtering.polarimeter import AngleBlock, push_angle
from service.core.estimation.filtering.prediction import hidden_states
from service.core.estimation.filtering.rate_sensor import push_rates
from service.core.estimation.filtering.row_block import BODY_RATE, WHEELS, RowBlock, RowTrace
from service.core.estimation.filtering.wheel_momentum import WheelRecord, push_momentum, refuse_impossible


def take_records(model: FilterModel, state: FilterState, block: RowBlock, number: int, trace: RowTrace) -> None:
    """Take the records that are due before a row into the state, in place."""
    size, sensors, epoch_us = len(state.mean), model.plant[0]["sensor_states"], state.watch[0]["epoch_us"]
    first = FIRST_COMMON + len(model.common) + hidden_states(model, size) - sensors
    angles = first + sensors - POLARIMETER * len(model.feeds)
    for place in range(len(block.records)):
        record = block.records[place]
        if record["row"] != number or record["kind"] == BODY_RATE:
            continue
        trace_rows = trace.record_updates[place] if len(trace.record_updates) else np.zeros((0, 0))
        if record["kind"] != WHEELS:
            feed = record["feed"]
            push_angle(
                model.feeds[feed],
                state.sensors[1 + feed],
                state.mean,
                state.covariance,
                angles + POLARIMETER * feed,
                AngleBlock(record["epoch_us"], record["angle_deg"], record["variance_deg2"], record["co_power_dbm"]),
                epoch_us,
                trace_rows,
            )
        elif record["is_impossible"]:
            refuse_impossible(state.sensors[0])
        else:
            telemetry = WheelRecord(record["epoch_us"], record["momentum_n_m_s"], record["is_unloading"])
            begins = push_momentum(
                model, state.sensors[0], state.mean, state.covariance, first, telemetry, epoch_us, trace_rows
            )
            if begins and len(trace.record_updates):
                trace.is_restarted[place, first : first + 3] = True
    if len(model.plant) > 1:
        push_rates(model, state, block, number)
        if len(trace.factor):
            _write_restarted(state, trace)


def _write_restarted(state: FilterState, trace: RowTrace) -> None:
    """Write which drifts and rates began again by the rate of the body; the step knows one that is measured."""
    is_measured = state.rates[0]["is_measured"]
    for place in range(DRIFT.start, RATE.stop):
        together = 0
        for other in range(len(state.mean)):
            together += 1 if state.covariance[place, other] != 0.0 else 0
        trace.is_restarted[-1, place] = together <= 1 or (is_measured and place >= RATE.start)


def motion_advice(model: FilterModel, state: FilterState) -> int:
    """Return what is wrong with wheels (bits 0 to 2), polarimeters (3 to 5), and the rate of the body (6: refused)."""
    epoch_us, wheels = state.watch[0]["epoch_us"], 0
    if model.plant[0]["has_wheels"]:
        wheels = sensor_advice(state.sensors[:1], epoch_us)
    is_rate_refused = 1 if state.rates[0]["is_refused"] else 0
    return wheels | sensor_advice(state.sensors[1:], epoch_us) << 3 | is_rate_refused << 6


def model_of_step(model: FilterModel, state: FilterState) -> FilterModel:
    """Return the model of a step: that of the measured rate where one holds."""
    if not state.rates[0]["is_measured"]:
        return model
    return FilterModel(
        model.carriers, model.coloured_sigma_db, model.coloured_tau_s, model.common, model.plant[1:], model.feeds
    )
