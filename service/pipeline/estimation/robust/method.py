"""The robust method from L1 to L4: expected level, attitude filter, integrity, with its state made explicit.

The state is a value: a step takes one and returns the next. A late row gets a snapshot fix of its own and leaves the
state alone. Without an ephemeris that reaches the row, or with fewer than four carriers, the filter coasts: angles go
on with an honest sigma, and control waits.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from service.core.estimation.filtering.advance import advance
from service.core.estimation.filtering.filter_model import (
    FREE_REFERENCE_DB2,
    hidden_count,
    initial_gaussian,
    no_motion,
)
from service.core.estimation.filtering.filter_state import initial_sensors, start
from service.core.estimation.filtering.prediction import site_level_db
from service.core.estimation.filtering.readings import frozen_readings, no_readings, standing_readings
from service.core.estimation.filtering.row_block import (
    LOST,
    RowBlock,
    empty_block,
    empty_result,
    empty_trace,
    write_declared,
    write_known,
)
from service.core.estimation.filtering.state_changes import (
    carry_over,
    sensors_of,
    with_stated_torque,
    with_torque,
    without_rates,
)
from service.core.estimation.snapshot import Snapshots, solve_snapshots
from service.pipeline.carrier_model.level_control import without_group_gain
from service.pipeline.config import ChainConfig
from service.pipeline.estimation.method import CarrierLevels
from service.pipeline.estimation.robust.attitude_rows import filtered_rows, late_row, torque_of
from service.pipeline.estimation.robust.model import RobustModel, signals
from service.pipeline.estimation.robust.robust_state import RobustState, RobustStep
from service.pipeline.estimation.robust.row_recorder import RowRecorder
from service.pipeline.estimation.robust.sensor_records import due_records
from service.pipeline.inputs.declared_operations import declared_between, with_chain_step
from service.pipeline.inputs.knowledge import Knowledge
from service.pipeline.inputs.known_motion import CommandedMotion, consume
from service.pipeline.inputs.sensor_angles import usual_sigma_deg
from service.records.calibration import Alignment
from service.records.epoch import US_PER_S
from service.records.levels.attitude import FloatArray
from service.records.levels.measurement import Measurement


def initial_state(
    model: RobustModel, alignment: Alignment, commanded: CommandedMotion, config: ChainConfig
) -> RobustState:
    """Return the state at an alignment; a carrier without a reference must show its level before it counts."""
    sigma_db = np.where(model.is_referenced, model.reference_sigma_db, np.sqrt(FREE_REFERENCE_DB2))
    gaussian = initial_gaussian(
        model.filter,
        np.array(alignment.attitude_deg, dtype=np.float64),
        usual_sigma_deg(np.array(alignment.sigma_deg)),
        sigma_db,
        drift_deg_h=model.settings.drift_deg_h,
        chain_sigma_db=config.robust.common_reference_sigma_db,
    )
    state = start(
        model.filter,
        alignment.epoch_us,
        with_torque(model.filter, gaussian, model.settings),
        len(model.polarimeters),
    )
    # a carrier that nobody knows has no level to come back to
    known_db = np.where(model.is_referenced, 0.0, np.nan)
    state = state.with_carriers(
        is_flagged=~model.is_referenced, saved_reference_db=known_db, aligned_reference_db=known_db
    )
    commanded = replace(commanded, since_us=alignment.epoch_us)
    return RobustState(state, commanded, no_readings(len(model.carrier_ids)))


def carried_state(state: RobustState, old: RobustModel, new: RobustModel) -> RobustState:
    """Return the state under another calibration; what is known of spacecraft and remaining carriers is kept."""
    if torque_of(old.settings) != torque_of(new.settings):
        pushed = with_stated_torque(old.filter, state.filter, len(state.released), old.settings, new.settings)
        state = replace(state, filter=pushed)
    if sensors_of(old.settings) != sensors_of(new.settings):
        # the sensors' states begin again together
        sensors = initial_sensors(len(new.polarimeters), state.filter.epoch_us)
        state = replace(state, filter=state.filter._replace(sensors=sensors))
    if old.rate_sensor != new.rate_sensor:
        state = replace(state, filter=without_rates(state.filter))
    if old.carrier_ids == new.carrier_ids and old.calibration_id == new.calibration_id:
        return state
    position_of = {signal: k for k, signal in enumerate(signals(old.carrier_ids, old.fit))}
    position = np.array([position_of.get(signal, -1) for signal in signals(new.carrier_ids, new.fit)], dtype=np.int64)
    carried = carry_over(
        old.filter,
        new.filter,
        state.filter,
        position,
        np.zeros(len(position)),
        np.where(new.is_referenced, new.reference_sigma_db, np.sqrt(FREE_REFERENCE_DB2)),
        ~new.is_referenced,
    )
    return replace(state, filter=carried, readings=no_readings(len(position)))


def carrier_levels(found: RobustStep, model: RobustModel) -> CarrierLevels:
    """Return the figures of the carriers in the outcome of a row; they are not copied."""
    figures_db = (found.deviation_db, found.residual_db, model.sigma_db)
    return CarrierLevels(model.carrier_ids, *figures_db, model.is_used, found.hypothesis)


def step_late(state: RobustState, model: RobustModel, measurement: Measurement, power_dbm: FloatArray) -> RobustStep:
    """Return the outcome of a row that is late: the fix of the row alone; the state stays."""
    expected_dbm = model.expected_rows_dbm(np.array([measurement.epoch_us], dtype=np.int64))
    is_frozen = standing_readings(state.readings, measurement.epoch_us)
    deviation_db = _deviations_db(state, model, np.where(is_frozen, np.nan, power_dbm[None, :]), expected_dbm)
    fixes = _snapshot(model, deviation_db[0])
    row = late_row(measurement, model, fixes, is_absent=np.isnan(deviation_db[0]))
    return RobustStep(
        row,
        expected_dbm[0],
        deviation_db[0],
        fixes.residual_db[0],
        state,
        np.zeros(len(model.carrier_ids), dtype=np.int64),
        np.zeros((4, 3)),
    )


def take_rows(
    state: RobustState,
    model: RobustModel,
    knowledge: Knowledge,
    measurements: Sequence[Measurement],
    power_dbm: FloatArray,
    *,
    is_catch_up: bool,
    config: ChainConfig,
    recorder: RowRecorder | None = None,
) -> list[RobustStep]:
    """Take rows in time in order, whose powers (T, N) stand in the calibration's order; return their outcomes.

    The state before rows that a recorder keeps, or whose levels depend on it, is that of one row: those are taken alone
    (`taken_alone`). A recorder changes no bit.

    Raises
    ------
    ArithmeticError
        The numbers of the filter were lost in a row; the state is as before the first.
    """
    count, carriers = power_dbm.shape
    epochs_us = np.array([each.epoch_us for each in measurements], dtype=np.int64)
    expected_dbm = model.expected_rows_dbm(epochs_us)
    readings, is_frozen = frozen_readings(state.readings, epochs_us, power_dbm)
    block, result = empty_block(count, carriers, len(state.released)), empty_result(count, carriers)
    block.rows["epoch_us"], block.carriers["is_frozen"] = epochs_us, is_frozen
    deviation_db = _deviations_db(state, model, np.where(is_frozen, np.nan, power_dbm), expected_dbm)
    block.carriers["deviation_db"] = deviation_db
    commanded, released = _write_inputs(state, model, knowledge, measurements, block, config)
    if model.has_sensors:
        # such rows are taken alone
        block = block._replace(records=due_records(state.filter, model, knowledge, measurements[0].epoch_us))
    trace = None if recorder is None else empty_trace(*_sizes(model, state), carriers, len(block.records))
    after = advance(model.arrays, state.filter, block, result, trace)
    if (result.rows["status"] == LOST).any():
        message = "the filter lost its numbers; the state before this row is kept"
        raise ArithmeticError(message)
    if recorder is not None and trace is not None:
        recorder.push(model, state.filter, after, result.rows[0], trace)
    last = RobustState(after, commanded, readings, released, measurements[-1].source)
    is_without_orbit = np.asarray(~np.isfinite(expected_dbm).any(axis=1))
    rows = filtered_rows(
        measurements, model, knowledge, result, is_without_orbit, is_catch_up=is_catch_up, config=config
    )
    found = result.carriers
    return [
        RobustStep(
            rows[number],
            expected_dbm[number],
            deviation_db[number],
            found["residual_db"][number],
            last,
            found["hypothesis"][number],
            result.rows["torque_deg_h2"][number],
            float(result.rows["missed_log_ratio"][number]),
            not result.rows["has_event"][number],
        )
        for number in range(count)
    ]


def taken_alone(state: RobustState, model: RobustModel, recorder: RowRecorder | None) -> bool:
    """Return whether each row must be taken by itself: something looks at the state between two rows."""
    return bool(model.has_sensors or model.groups or state.released or recorder is not None)


def _write_inputs(
    state: RobustState,
    model: RobustModel,
    knowledge: Knowledge,
    measurements: Sequence[Measurement],
    block: RowBlock,
    config: ChainConfig,
) -> tuple[CommandedMotion, tuple[tuple[int, CommandedMotion], ...]]:
    """Write what was commanded, declared and reported before each row; return what is left of commands."""
    commanded, released, source = state.commanded, state.released, state.source
    from_us = state.filter.epoch_us
    operations = knowledge.live_operations(from_us)
    for number, measurement in enumerate(measurements):
        to_us = measurement.epoch_us
        known, commanded = consume(commanded, from_us, to_us)
        if released:
            unreported, released = _unreported(released, from_us, to_us)
            known = known._replace(unreported=unreported)
        if known is not no_motion():
            write_known(block, number, known)
        declared = declared_between(operations, model.names, from_us, to_us, config.operations)
        if source is not None and source != measurement.source:
            # another measuring source is a step of the receiving chain
            declared = with_chain_step(declared, model.names, config.operations.gain_step_db)
        if declared is not None:
            write_declared(model.arrays, block, number, declared)
        if knowledge.weather and (wet := knowledge.reported_wet(model.carrier_ids, to_us)) is not None:
            block.carriers["reported_wet"][number] = wet
        from_us, source = to_us, measurement.source
    return commanded, released


def _sizes(model: RobustModel, state: RobustState) -> tuple[int, int]:
    """Return the numbers of a state, and the hidden ones among them."""
    states = len(state.filter.mean)
    return states, hidden_count(model.filter, states)


def _deviations_db(
    state: RobustState, model: RobustModel, power_dbm: FloatArray, expected_dbm: FloatArray
) -> FloatArray:
    """Return measured minus expected of the carriers used (T, N), dB, groups under level control by differences."""
    deviation_db = np.where(model.is_used, power_dbm - expected_dbm, np.nan)
    if not model.groups:
        return deviation_db
    return without_group_gain(deviation_db, site_level_db(model.arrays, state.filter.mean), model.groups)


def _unreported(
    released: tuple[tuple[int, CommandedMotion], ...], from_us: int, to_us: int
) -> tuple[FloatArray, tuple[tuple[int, CommandedMotion], ...]]:
    """Return the effect of each unreported command between two epochs (n, 2, 3), deg and deg/h, and the rest."""
    effects, left = np.zeros((len(released), 2, 3)), []
    half_h = 0.5 * (to_us - from_us) / US_PER_S / 3600.0
    for position, (counter, motion) in enumerate(released):
        known, rest = consume(motion, from_us, to_us)
        rate = known.rate_change_deg_h
        effects[position] = known.correction_deg + known.late_correction_deg + half_h * rate, rate
        left.append((counter, rest))
    return effects, tuple(left)


def _snapshot(model: RobustModel, deviation_db: FloatArray) -> Snapshots:
    """Return the fix of a row alone."""
    found = model.filter
    variance = found.white_sigma_db**2 + (found.coloured_sigma_db**2).sum(axis=1) + model.reference_sigma_db**2
    return solve_snapshots(
        model.response,
        deviation_db[None, :],
        np.sqrt(variance),
        model.orders,
        group=found.transponder,
    )
