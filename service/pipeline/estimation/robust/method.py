"""The robust method from L1 to L4: expected level, attitude filter, integrity, with its state made explicit.

The state is a value: a step takes one and returns the next. A late row gets a snapshot fix of its own and leaves the
state alone. Without an ephemeris that reaches the row, or with fewer than four carriers, the filter coasts: angles go
on with an honest sigma, and control waits.
"""

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from service.core.estimation.filtering.attitude_filter import FilterStep, step
from service.core.estimation.filtering.declared import Declared
from service.core.estimation.filtering.filter_model import (
    FREE_REFERENCE_DB2,
    KnownMotion,
    initial_gaussian,
    no_motion,
    rates_deg_h,
)
from service.core.estimation.filtering.filter_state import FilterState, start
from service.core.estimation.filtering.motion_sensor import SensorWatch
from service.core.estimation.filtering.polarimeter import polarimeter_advice
from service.core.estimation.filtering.prediction import site_level_db
from service.core.estimation.filtering.rate_sensor import RateWatch, fresh_rates
from service.core.estimation.filtering.state_changes import (
    carry_over,
    sensors_of,
    with_stated_torque,
    with_torque,
    without_rates,
)
from service.core.estimation.snapshot.snapshot import Snapshots, solve_snapshots
from service.pipeline.carrier_model.level_control import without_group_gain
from service.pipeline.config import ChainConfig
from service.pipeline.estimation.method import CarrierLevels
from service.pipeline.estimation.robust.attitude_rows import (
    Fixed,
    LastReadings,
    filtered_row,
    frozen,
    is_torque_shown,
    late_row,
    no_readings,
    push_readings,
    telemetry_advice,
    torque_of,
)
from service.pipeline.estimation.robust.model import RobustModel, signals
from service.pipeline.estimation.robust.row_recorder import RowRecorder
from service.pipeline.inputs.declared_operations import declared_between, with_chain_step
from service.pipeline.inputs.knowledge import Knowledge
from service.pipeline.inputs.known_motion import CommandedMotion, consume
from service.pipeline.inputs.sensor_angles import usual_sigma_deg
from service.records.calibration import Alignment
from service.records.epoch import US_PER_S
from service.records.levels.attitude import AttitudeRow, FloatArray
from service.records.levels.measurement import Measurement


@dataclass(frozen=True)
class RobustState:
    """State of the robust method between two rows."""

    filter: FilterState
    commanded: CommandedMotion
    readings: LastReadings
    #: effect of each unreported command, by counter; one share each in the filter's state
    released: tuple[tuple[int, CommandedMotion], ...] = ()
    #: source of the newest row, None before the first
    source: str | None = None
    #: judgement of the records of wheel momentum
    momentum: SensorWatch = field(default_factory=SensorWatch)
    #: judgement of the records of the rate of the body
    rates: RateWatch = field(default_factory=fresh_rates)
    #: judgement of the angles of each polarimeter
    polarimeters: tuple[SensorWatch, ...] = ()


class RobustStep(NamedTuple):
    """One row's outcome and the state after it."""

    row: AttitudeRow
    #: (N,) dBm and dB
    expected_dbm: FloatArray
    deviation_db: FloatArray
    residual_db: FloatArray
    state: RobustState
    #: whether nothing was found or declared, so that compiled stages carried the row
    is_ordinary: bool = True


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
    state = start(model.filter, alignment.epoch_us, with_torque(model.filter, gaussian, model.settings))
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
    # the sensors' states begin again together
    is_same = sensors_of(old.settings) == sensors_of(new.settings)
    state = state if is_same else replace(state, momentum=SensorWatch(), polarimeters=())
    if old.rate_sensor != new.rate_sensor:
        state = replace(state, filter=without_rates(state.filter, state.rates), rates=fresh_rates())
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
    carriers = found.state.filter.carriers
    hypothesis = np.where(np.isnan(carriers["probability"]), 0, carriers["hypothesis"] + 1)
    figures_db = (found.deviation_db, found.residual_db, model.filter.sigma_db)
    return CarrierLevels(model.carrier_ids, *figures_db, model.is_used, hypothesis)


def step_robust(
    state: RobustState,
    model: RobustModel,
    knowledge: Knowledge,
    measurement: Measurement,
    power_dbm: FloatArray,
    *,
    is_late: bool,
    is_catch_up: bool,
    config: ChainConfig,
    recorder: RowRecorder | None = None,
) -> RobustStep:
    """Take one row whose powers stand in the calibration's order and return its outcome and the next state.

    A recorder keeps what the filter did to the state; it changes no bit.
    """
    expected_dbm = model.expected_dbm(measurement.epoch_us)
    readings = state.readings if is_late else push_readings(state.readings, power_dbm, measurement.epoch_us)
    is_frozen = frozen(readings, measurement.epoch_us)
    deviation_db = _deviation_db(state, model, np.where(is_frozen, np.nan, power_dbm), expected_dbm)
    if is_late:
        return _late_step(state, model, measurement, expected_dbm, deviation_db)
    known, commanded = consume(state.commanded, state.filter.epoch_us, measurement.epoch_us)
    unreported, released = _unreported(state.released, state.filter.epoch_us, measurement.epoch_us)
    declared = _declared(state, model, knowledge, measurement, config)
    if released:
        known = known._replace(unreported=unreported)
    if state.rates.is_measured:
        # the measured rate holds all of it
        known = no_motion()
    found = _filtered(state, model, knowledge, measurement.epoch_us, deviation_db, known, declared, recorder)
    is_without_orbit = not np.isfinite(expected_dbm).any()
    residual_db = found.residual_db
    rates = rates_deg_h(found.state.mean, model.settings.coupling_per_h) / 3600.0
    fixed = Fixed(found, deviation_db, is_frozen, rates, declared, is_without_orbit, residual_db)
    row = filtered_row(
        measurement,
        model,
        fixed,
        is_catch_up=is_catch_up,
        has_inhibiting_operation=bool(knowledge.inhibiting_operations(measurement.epoch_us)),
        is_thrusting_undeclared=knowledge.is_thrusting_undeclared(measurement.epoch_us),
        range_deg=config.interlock.model_range_deg,
        given={
            "state_torque": model.is_torque_unknown and is_torque_shown(found.state, model, len(released)),
            **telemetry_advice(
                model, knowledge, state.momentum, state.rates, state.commanded.since_us, measurement.epoch_us
            ),
            **polarimeter_advice(state.polarimeters, measurement.epoch_us),
        },
    )
    watches = state.momentum, state.rates, state.polarimeters
    after = RobustState(found.state, commanded, readings, released, measurement.source, *watches)
    return RobustStep(row, expected_dbm, deviation_db, residual_db, after, found.is_ordinary)


def _filtered(
    state: RobustState,
    model: RobustModel,
    knowledge: Knowledge,
    epoch_us: int,
    deviation_db: FloatArray,
    known: KnownMotion,
    declared: Declared | None,
    recorder: RowRecorder | None,
) -> FilterStep:
    """Return the filter after a row; ArithmeticError where its numbers are lost."""
    found = step(
        model.arrays,
        state.filter,
        epoch_us,
        deviation_db,
        known,
        declared=declared,
        reported_wet=knowledge.reported_wet(model.carrier_ids, epoch_us),
        is_traced=recorder is not None,
    )
    if recorder is not None:
        recorder.push(model, state.filter, found)
    return found


def _late_step(
    state: RobustState,
    model: RobustModel,
    measurement: Measurement,
    expected_dbm: FloatArray,
    deviation_db: FloatArray,
) -> RobustStep:
    """Return the outcome of a row that is late: the fix of the row alone; the state stays."""
    fixes = _snapshot(model, deviation_db)
    row = late_row(measurement, model, fixes, is_absent=np.isnan(deviation_db))
    return RobustStep(row, expected_dbm, deviation_db, fixes.residual_db[0], state)


def _deviation_db(
    state: RobustState, model: RobustModel, power_dbm: FloatArray, expected_dbm: FloatArray
) -> FloatArray:
    """Return measured minus expected of the carriers used (N,), dB, groups under level control by their differences."""
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


def _declared(
    state: RobustState, model: RobustModel, knowledge: Knowledge, measurement: Measurement, config: ChainConfig
) -> Declared | None:
    """Return the declarations for the step, a change of the measuring source included."""
    declared = declared_between(
        knowledge.live_operations(state.filter.epoch_us),
        model.names,
        state.filter.epoch_us,
        measurement.epoch_us,
        config.operations,
    )
    if state.source is None or state.source == measurement.source:
        return declared
    return with_chain_step(declared, model.names, config.operations.gain_step_db)


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
