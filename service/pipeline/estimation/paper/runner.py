"""The paper method from L1 to L4, and in the chain: its model, its state, and what is known of each carrier.

The published equations, with their state made explicit. Order: harmonic removal, downlink fade rule, trailing mean,
fix over the eight octants, rate, interlock verdict. The state is a value: a step takes one and returns the next, so
that a replay can start from any of them. A late row gets a fix of its own and leaves the state alone.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

from service.core.estimation.paper import downlink_fade
from service.core.estimation.paper.downlink_fade import (
    FadeTest,
    FadeWatch,
    TrailingMean,
    fade_sign_test,
    step_fade_watch,
)
from service.core.estimation.paper.loop_observer import LoopModel, linear_fix, loop_model, loop_slopes
from service.core.estimation.paper.rejection import reject_faded_carriers
from service.core.geometry.frames import AntennaDirection, station_direction
from service.pipeline.config import ChainConfig, RobustConfig
from service.pipeline.estimation.method import CalibratedColumns, CarrierLevels, CommandEvidence, MethodRow
from service.pipeline.estimation.paper.harmonic_removal import ExpectedPower, expected_power, remove_harmonic
from service.pipeline.estimation.paper.loop_state import (
    LoopState,
    RowsOfMean,
    Steering,
    initial_loop,
    loop_disturbance,
    loop_with_fade,
    loop_with_fix,
    loop_with_input,
    loop_with_torque,
    steering,
)
from service.pipeline.estimation.paper.snapshot_fix import (
    SensitivityModel,
    answer_db,
    sensitivity_model,
    solve_attitude,
)
from service.pipeline.estimation.row_inhibitions import RowContext, judge
from service.pipeline.inputs.knowledge import Knowledge, Lookup
from service.pipeline.inputs.known_motion import angle_inertia_kg_m2, motion_settings
from service.records.calibration import Calibration
from service.records.catalogue import CarrierPlan, Ephemeris, Method, Spacecraft
from service.records.epoch import US_PER_S
from service.records.inputs import Correction, SlowInput
from service.records.levels.attitude import (
    NO_ANGLES,
    AppliedCommand,
    AttitudeFix,
    AttitudeRow,
    CarrierState,
    Deviation,
    Disturbance,
    FloatArray,
    ReportedCommand,
    Status,
    named_axes,
)
from service.records.levels.measurement import Measurement


class PaperState(NamedTuple):
    """State of the paper method between two rows."""

    #: deviations of the averaging window
    window: TrailingMean
    fade_watch: FadeWatch
    #: the same for levels that have risen
    rise_watch: FadeWatch
    loop: LoopState
    #: epoch of the newest row, None before the first
    newest_us: int | None


@dataclass(frozen=True)
class PaperModel:
    """Model of the paper method from calibration and alignment; fixed until one of them changes."""

    expected: ExpectedPower
    sensitivity: SensitivityModel
    loop: LoopModel
    inertia_kg_m2: tuple[float, float, float] | None
    calibration_id: int
    alignment_id: int


class PaperStep(NamedTuple):
    """One row's outcome and the state after it."""

    row: AttitudeRow
    deviation: Deviation
    fix: AttitudeFix
    state: PaperState


def paper_model(
    knowledge: Knowledge, plan: CarrierPlan, aligned_with: Calibration, config: ChainConfig
) -> PaperModel | None:
    """Return the model that holds, or None while calibration, ephemeris or alignment is missing."""
    calibration = knowledge.calibration_for(Method.PAPER)
    if calibration is None or knowledge.ephemeris is None or knowledge.alignment is None:
        return None
    spacecraft = knowledge.spacecraft
    sensitivity = sensitivity_model(calibration)
    expected = expected_power(calibration, knowledge.alignment, Method.PAPER, knowledge.ephemeris, aligned_with)
    return PaperModel(
        expected,
        sensitivity,
        _loop_model(sensitivity, spacecraft, plan, config.robust),
        None if spacecraft is None else angle_inertia_kg_m2(spacecraft),
        calibration.id,
        knowledge.alignment.id,
    )


def _loop_model(
    sensitivity: SensitivityModel, spacecraft: Spacecraft | None, plan: CarrierPlan, config: RobustConfig
) -> LoopModel:
    """Return the model of the loop; a torque that was called small would hold the estimate where nobody is.

    The robust filter looks for a greater torque when motion contradicts the statement. Nothing does here.
    """
    motion = motion_settings(spacecraft, config)
    yaw, roll, pitch = map(max, motion.torque_deg_h2, motion.unknown_torque_deg_h2)
    direction = _station_directions(sensitivity.carrier_ids, spacecraft, plan)
    slope = loop_slopes(sensitivity.plus_db_per_deg, sensitivity.minus_db_per_deg, *direction)
    is_used = sensitivity.is_selected
    coloured_db = np.sqrt(np.square(sensitivity.sigma_coloured_db).sum(axis=1))[is_used]
    usual_db = float(np.median(coloured_db)) if len(coloured_db) else 0.0
    return loop_model(motion._replace(torque_deg_h2=(yaw, roll, pitch)), slope, is_used, usual_db)


def _station_directions(
    carrier_ids: tuple[str, ...], spacecraft: Spacecraft | None, plan: CarrierPlan
) -> AntennaDirection:
    """Return where the satellite sees the stations of some carriers; NaN where it does not."""
    stations = {carrier.id: carrier.station for carrier in plan.carriers}
    places = [
        (s.longitude_deg, s.latitude_deg) if (s := stations.get(name)) else (math.nan,) * 2 for name in carrier_ids
    ]
    longitude_deg, latitude_deg = np.array(places).reshape(-1, 2).T
    subsatellite_deg = math.nan if spacecraft is None else spacecraft.longitude_deg
    return station_direction(longitude_deg, latitude_deg, np.zeros(len(places)), subsatellite_deg)


def initial_state(carriers: int, config: ChainConfig, loop: LoopState) -> PaperState:
    """Return the state at an alignment."""
    return PaperState(_empty_window(carriers, config), FadeWatch(), FadeWatch(), loop, None)


def _empty_window(carriers: int, config: ChainConfig) -> TrailingMean:
    """Return a window that reaches back as far as the longest mean taken of it."""
    longest_s = max(config.estimation.averaging_window_s, config.fade.averaging_window_s)
    return downlink_fade.empty_window(carriers, longest_s)


def step_paper(
    state: PaperState,
    model: PaperModel,
    knowledge: Knowledge,
    ephemeris: Ephemeris,
    measurement: Measurement,
    power_dbm: FloatArray,
    *,
    is_late: bool,
    is_catch_up: bool,
    config: ChainConfig,
) -> PaperStep:
    """Take one row whose powers stand in the calibration's order and return its outcome and the next state."""
    deviation = remove_harmonic(power_dbm, measurement.epoch_us, model.expected, ephemeris)
    if is_late:
        after = state
        fix = solve_attitude(measurement.epoch_us, deviation.deviation_db, 1, 0.0, model.sensitivity, config.estimation)
    else:
        after = _remember_row(state, model, deviation, config)
        fix = _averaged_fix(after, model, deviation.epoch_us, config)
    context = RowContext(
        is_late=is_late,
        is_catch_up=is_catch_up,
        is_settled=is_late or _rows_in_window(after, config) >= config.estimation.min_rows,
        is_fading=after.fade_watch.is_stopped,
        is_risen=after.rise_watch.is_stopped,
        has_inhibiting_operation=bool(knowledge.inhibiting_operations(measurement.epoch_us)),
        is_thrusting_undeclared=knowledge.is_thrusting_undeclared(measurement.epoch_us),
    )
    inhibitions = judge(fix, context, config.interlock)
    steered = None
    if not is_late:
        after = after._replace(loop=_step_loop(after, model, fix, config))
        steered = steering(after.loop, model.loop, fix.epoch_us)
    row = _row(measurement, model, fix, inhibitions, steered, _fade_db(after, model, config))
    return PaperStep(row, deviation, fix, after)


def _remember_row(state: PaperState, model: PaperModel, deviation: Deviation, config: ChainConfig) -> PaperState:
    """Add a row to the window and step the fade rule; a long gap empties the window."""
    gap_us = 0 if state.newest_us is None else deviation.epoch_us - state.newest_us
    is_fresh = gap_us > config.estimation.max_gap_s * US_PER_S
    window = _empty_window(len(deviation.deviation_db), config) if is_fresh else state.window
    window = downlink_fade.push(window, deviation.epoch_us, deviation.deviation_db)
    change_db = _common_change_db(window, model, config)
    step = partial(
        step_fade_watch,
        dt_s=gap_us / US_PER_S,
        depth_db=config.fade.depth_db,
        stop_after_s=config.fade.entry_s,
        return_after_s=config.fade.exit_s,
        max_gap_s=config.fade.max_gap_s,
    )
    stops = state.fade_watch.is_stopped, state.rise_watch.is_stopped
    left_db = _left_db(change_db, state, model, deviation.epoch_us) if any(stops) else change_db
    test = partial(_test_change, change_db, left_db, model, config)
    fade = step(state.fade_watch, test=test(1.0, is_stopped=stops[0]))
    rise = step(state.rise_watch, test=test(-1.0, is_stopped=stops[1]))
    return PaperState(window, fade, rise, state.loop, deviation.epoch_us)


def _left_db(change_db: FloatArray, state: PaperState, model: PaperModel, epoch_us: int) -> FloatArray:
    """Return what the angles that are steered by leave of a change of levels."""
    attitude = steering(state.loop, model.loop, epoch_us).attitude_deg
    return change_db - answer_db(model.sensitivity, attitude)


def _test_change(
    change_db: FloatArray, left_db: FloatArray, model: PaperModel, config: ChainConfig, sign: float, *, is_stopped: bool
) -> FadeTest:
    """Apply the rule of one sign and near size, and ask whether a turn would not explain the row better.

    The print has the rule for fades alone, sign 1; a rise of all levels (-1) looks like attitude as well. A stop ends
    where the levels are back, or back but for a turn, which the dynamics predict or which explains them by itself: the
    spacecraft drifts during a stop.
    """
    rule = partial(
        fade_sign_test, depth_db=config.fade.depth_db, share=config.fade.share, spread_ratio=config.fade.spread_ratio
    )
    test = rule(sign * change_db)
    if not test.is_fade and not is_stopped:
        # the fix is costly and most rows need none
        return test
    turn = reject_faded_carriers(
        model.sensitivity.plus_db_per_deg,
        model.sensitivity.minus_db_per_deg,
        change_db,
        gate_db=config.estimation.uplink_gate_db,
        gate_sigma=config.estimation.gate_sigma,
        min_carriers=config.estimation.min_carriers,
    )
    test = rule(sign * change_db, fix_residual_db=turn.fix.residual_db)
    if not is_stopped:
        return test
    left = rule(sign * left_db, fix_residual_db=turn.fix.residual_db)
    return max(test, left._replace(is_turn=test.is_turn), key=lambda each: each.median_db)


def _step_loop(state: PaperState, model: PaperModel, fix: AttitudeFix, config: ChainConfig) -> LoopState:
    """Return the loop after a row and its fix; a row in a fade tells nothing."""
    if state.fade_watch.is_stopped or state.rise_watch.is_stopped:
        return loop_with_fade(state.loop, fix.epoch_us, config)
    epochs_us = state.window.epoch_us[-_rows_in_window(state, config) :]
    span_s = float(epochs_us[-1] - epochs_us[0]) / US_PER_S
    rows = RowsOfMean(fix.epoch_us, span_s, max(1.0, span_s / max(1, len(epochs_us) - 1)))
    is_enough = len(epochs_us) >= config.estimation.min_rows
    is_used = model.loop.is_used & ~np.isin(model.sensitivity.carrier_ids, [item.carrier for item in fix.excluded])
    linear = linear_fix(_mean_db(state, config), model.loop.slope_db_per_deg, is_used) if is_enough else None
    return loop_with_fix(state.loop, linear, rows, model.loop, config)


def _mean_db(state: PaperState, config: ChainConfig) -> FloatArray:
    """Return the trailing mean."""
    estimation = config.estimation
    return downlink_fade.mean(state.window, window_s=estimation.averaging_window_s, min_rows=estimation.min_rows)


def _averaged_fix(state: PaperState, model: PaperModel, epoch_us: int, config: ChainConfig) -> AttitudeFix:
    """Solve the trailing mean."""
    rows = _rows_in_window(state, config)
    epochs_us = state.window.epoch_us
    span_s = float(epochs_us[-1] - epochs_us[-rows]) / US_PER_S
    return solve_attitude(epoch_us, _mean_db(state, config), rows, span_s, model.sensitivity, config.estimation)


def _rows_in_window(state: PaperState, config: ChainConfig) -> int:
    """Return how many rows the trailing mean of a window with rows rests on."""
    epochs_us = state.window.epoch_us
    oldest_us = epochs_us[-1] - int(config.estimation.averaging_window_s * US_PER_S)
    return len(epochs_us) - downlink_fade.rows_until(epochs_us, oldest_us)


def _common_change_db(window: TrailingMean, model: PaperModel, config: ChainConfig) -> FloatArray:
    """Return the short mean of the selected carriers that the rules of fades and rises look at."""
    short_db = downlink_fade.mean(window, window_s=config.fade.averaging_window_s, min_rows=1)
    return np.where(model.sensitivity.is_selected, short_db, np.nan)


def _fade_db(state: PaperState, model: PaperModel, config: ChainConfig) -> float:
    """Return the size of a standing fade, 0 while none stands."""
    if not state.fade_watch.is_stopped:
        return 0.0
    present_db = _common_change_db(state.window, model, config)
    present_db = present_db[np.isfinite(present_db)]
    return max(0.0, -float(np.median(present_db))) if len(present_db) else 0.0


def _row(
    measurement: Measurement,
    model: PaperModel,
    fix: AttitudeFix,
    inhibitions: tuple[str, ...],
    steered: Steering | None,
    fade_db: float,
) -> AttitudeRow:
    """Return the archive's row of one outcome."""
    angles = named_axes(fix.attitude_deg)
    # what all levels have in common went into the angles
    is_told = all(map(math.isfinite, angles)) and "common_change" not in inhibitions
    used_db = fix.residual_db[np.isfinite(fix.residual_db)]
    return AttitudeRow(
        epoch_us=measurement.epoch_us,
        received_at_us=measurement.received_at_us,
        number=measurement.number,
        method=Method.PAPER,
        attitude_deg=angles,
        sigma_deg=named_axes(np.sqrt(fix.covariance_deg2.diagonal())),
        rates_deg_s=None if steered is None else named_axes(steered.rates_deg_s),
        status=Status.ACQUIRED if is_told else Status.INVALID,
        control_allowed=not inhibitions,
        # yaw follows from roll and from what was commanded, whatever the fix says of it
        control_allowed_axes=(not inhibitions,) * 3,
        inhibitions=inhibitions,
        carriers_used=fix.carriers_used,
        excluded=fix.excluded,
        downlink_fade="downlink_fade" in inhibitions,
        downlink_fade_db=fade_db,
        common_db=float("nan"),
        residual_rms_db=math.sqrt((used_db**2).sum() / len(used_db)) if len(used_db) else float("nan"),
        calibration_id=model.calibration_id,
        alignment_id=model.alignment_id,
        steering_deg=NO_ANGLES if steered is None else named_axes(steered.attitude_deg),
        steering_sigma_deg=NO_ANGLES if steered is None else named_axes(steered.sigma_deg),
    )


class SavedPaper(NamedTuple):
    """State of the method between two rows, and its newest row."""

    state: PaperState
    row: AttitudeRow | None
    deviation: Deviation | None
    fix: AttitudeFix | None


class PaperRunner:
    """Runs the paper method; `MethodRunner`."""

    method = Method.PAPER

    def __init__(self, lookup: Lookup, config: ChainConfig) -> None:
        self._lookup = lookup
        self._config = config
        self._model: PaperModel | None = None
        self._state: PaperState | None = None
        self._columns: CalibratedColumns | None = None
        self._last: tuple[PaperStep, PaperModel] | None = None

    @property
    def is_running(self) -> bool:
        """Return whether rows lead to angles."""
        return self._model is not None

    def on_input(self, content: SlowInput, knowledge: Knowledge) -> None:
        """Take in what moves the spacecraft."""
        if isinstance(content, Correction | AppliedCommand | ReportedCommand) and self._state is not None:
            loop = loop_with_input(self._state.loop, content, knowledge.spacecraft)
            self._state = self._state._replace(loop=loop)

    def start(self, knowledge: Knowledge) -> None:
        """Begin at the alignment that holds."""
        self._model, self._columns = self._model_of(knowledge)
        self._state = None
        if self._model is not None and knowledge.alignment is not None:
            loop = initial_loop(knowledge.alignment, self._model.loop)
            self._state = initial_state(len(self._model.expected.carrier_ids), self._config, loop)
        self._last = None

    def rebuild(self, knowledge: Knowledge) -> None:
        """Take over a change; another set of carriers starts the means again."""
        former = self._model
        self._model, self._columns = self._model_of(knowledge)
        if self._model is None:
            return
        carrier_ids = self._model.expected.carrier_ids
        if former is None or self._state is None:
            self.start(knowledge)
            return
        if former.loop.motion != self._model.loop.motion:
            self._state = self._state._replace(loop=loop_with_torque(self._state.loop, self._model.loop))
        if former.expected.carrier_ids != carrier_ids:
            self._state = initial_state(len(carrier_ids), self._config, self._state.loop)

    def step(
        self, measurement: Measurement, plan: CarrierPlan, knowledge: Knowledge, *, is_late: bool, is_catch_up: bool
    ) -> AttitudeRow:
        """Return the row of a measurement; the state moves on unless the row is late."""
        if self._model is None or self._state is None or self._columns is None or knowledge.ephemeris is None:
            message = "the paper method was stepped without a model"
            raise ValueError(message)
        outcome = step_paper(
            self._state,
            self._model,
            knowledge,
            knowledge.ephemeris,
            measurement,
            self._columns.power_dbm(measurement, plan),
            is_late=is_late,
            is_catch_up=is_catch_up,
            config=self._config,
        )
        self._state = outcome.state
        if not is_late:
            self._last = (outcome, self._model)
        return outcome.row

    def steps(
        self,
        measurements: Sequence[Measurement],
        plan: CarrierPlan,
        knowledge: Knowledge,
        *,
        is_late: bool,
        is_catch_up: bool,
    ) -> list[MethodRow]:
        """Return the rows of measurements in order; the state moves on unless they are late."""
        rows = []
        for each in measurements:
            row = self.step(each, plan, knowledge, is_late=is_late, is_catch_up=is_catch_up)
            found = partial(_disturbance, self._state, self._model)
            rows.append(MethodRow(row) if is_late else MethodRow(row, self.carrier_levels(), found))
        return rows

    @property
    def is_waiting(self) -> bool:
        """Return False: no row is ever taken again."""
        return False

    def saved(self) -> SavedPaper | None:
        """Return what `restore` goes on from; None while nothing runs."""
        if self._state is None:
            return None
        if self._last is None or self._last[1] is not self._model:
            return SavedPaper(self._state, None, None, None)
        last, _ = self._last
        return SavedPaper(self._state, last.row, last.deviation, last.fix)

    def restore(self, saved: SavedPaper, knowledge: Knowledge) -> None:
        """Go on from a saved state under the knowledge of then."""
        self._model, self._columns = self._model_of(knowledge)
        self._state = saved.state
        if saved.row is not None and saved.deviation is not None and saved.fix is not None and self._model is not None:
            self._last = PaperStep(saved.row, saved.deviation, saved.fix, saved.state), self._model

    def carrier_states(self) -> dict[str, CarrierState]:
        """Return the state of each carrier of the calibration after the newest row."""
        if self._last is None:
            return {}
        outcome, model = self._last
        sensitivity = model.sensitivity
        excluded = {item.carrier for item in outcome.fix.excluded}
        return {
            name: CarrierState(
                carrier=name,
                power_dbm=float("nan"),
                expected_dbm=float(outcome.deviation.expected_dbm[k]),
                deviation_db=float(outcome.deviation.deviation_db[k]),
                residual_db=float(outcome.fix.residual_db[k]),
                sigma_db=float(outcome.fix.sigma_db[k]),
                flags=0,
                state="unselected" if not sensitivity.is_selected[k] else ("excluded" if name in excluded else "used"),
            )
            for k, name in enumerate(sensitivity.carrier_ids)
        }

    def carrier_levels(self) -> CarrierLevels | None:
        """Return the figures of the newest row that was not late, None before it; they are not copied."""
        if self._last is None:
            return None
        outcome, model = self._last
        levels_db = (outcome.deviation.deviation_db, outcome.fix.residual_db, outcome.fix.sigma_db)
        sensitivity = model.sensitivity
        no_hypothesis = np.zeros(len(sensitivity.carrier_ids), dtype=np.int64)
        return CarrierLevels(sensitivity.carrier_ids, *levels_db, sensitivity.is_selected, no_hypothesis)

    def command_evidence(self) -> CommandEvidence | None:
        """Return None: the method has no model of the noise."""
        return None

    def _model_of(self, knowledge: Knowledge) -> tuple[PaperModel | None, CalibratedColumns | None]:
        """Return the model that holds and the order of its carriers."""
        alignment, calibration = knowledge.alignment, knowledge.calibration_for(Method.PAPER)
        if alignment is None or calibration is None:
            return None, None
        aligned_id = alignment.calibration_by_method.get(Method.PAPER.value, alignment.calibration_id)
        plan = self._lookup.plan(calibration.plan_id)
        model = paper_model(knowledge, plan, self._lookup.calibration(aligned_id), self._config)
        if model is None:
            return None, None
        return model, CalibratedColumns(model.expected.carrier_ids, plan)


def _disturbance(state: PaperState | None, model: PaperModel | None) -> Disturbance | None:
    """Return the torque that the loop has learned; None where it knows of none."""
    if model is None or model.inertia_kg_m2 is None or state is None:
        return None
    return loop_disturbance(state.loop, model.loop, model.inertia_kg_m2)
