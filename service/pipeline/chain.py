"""The chain: one journal entry in, its outcome out; the order of the stages is written here once.

::

    slow input  -> knowledge
    measurement -> each method: deviation, fix, attitude row -> wheel torques of the method that drives control

The chain reads no clock and no random number: what it returns follows from the journal alone, bit for bit.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from service.pipeline.config import ChainConfig
from service.pipeline.knowledge import Knowledge, Lookup, learn
from service.pipeline.paper_method import PaperModel, PaperState, PaperStep, initial_state, paper_model, step_paper
from service.pipeline.solve import SensitivityModel
from service.pipeline.wheel_torques import NO_CARRY, compute_command
from service.ports import Outcome
from service.records.attitude import AttitudeRow, CarrierState, FloatArray, IntArray, row_without_attitude
from service.records.calibration import Alignment, Calibration
from service.records.catalogue import CarrierPlan, Method, Release
from service.records.command import AppliedCommand
from service.records.epoch import US_PER_S
from service.records.inputs import AlignmentSet, CalibrationActivation, EphemerisChange
from service.records.journal import SlowInput
from service.records.measurement import Measurement


class _Step(NamedTuple):
    """One row's outcome and the model that it was computed with, which a later activation may have replaced."""

    outcome: PaperStep
    sensitivity: SensitivityModel


class Chain:
    """Estimation and control of one spacecraft.

    Parameters
    ----------
    lookup : Lookup
        Documents that journal entries name by number.
    config : ChainConfig
        Every number of every stage.
    calibration : Calibration, optional
        Calibration that a replay uses in place of those the journal activates.
    """

    def __init__(self, lookup: Lookup, config: ChainConfig, calibration: Calibration | None = None) -> None:
        self._lookup = lookup
        self._config = config
        self._override = calibration
        self._knowledge = Knowledge()
        self._model: PaperModel | None = None
        self._state: PaperState | None = None
        self._carry_n_m_s = NO_CARRY
        self._newest_us: int | None = None
        self._recent_us: IntArray = np.zeros(0, dtype=np.int64)
        self._columns: dict[tuple[int, int], IntArray] = {}
        self._last: tuple[Measurement, _Step | None] | None = None

    @property
    def knowledge(self) -> Knowledge:
        """What the slow inputs have told."""
        return self._knowledge

    @property
    def is_running(self) -> bool:
        """Whether rows lead to angles."""
        return self._model is not None

    def learn(self, content: SlowInput) -> None:
        """Consume a slow input; an alignment starts the methods anew, an activation keeps their state."""
        self._knowledge = learn(self._knowledge, content, self._lookup)
        if self._override is not None:
            active = {**self._knowledge.active, self._override.request.method: self._override}
            self._knowledge = replace(self._knowledge, active=active)
        alignment = self._knowledge.alignment
        if alignment is None:
            return
        if isinstance(content, AlignmentSet):
            self._start(alignment)
        elif isinstance(content, CalibrationActivation | EphemerisChange):
            self._rebuild_model(alignment)

    def step(self, measurement: Measurement, *, is_catch_up: bool = False) -> Outcome | None:
        """Consume a row of powers; None while nothing can be computed or the row does not feed the estimator."""
        if not measurement.feeds_estimator:
            return None
        plan = self._lookup.plan(measurement.plan_id)
        if self._model is None or self._state is None or self._knowledge.ephemeris is None:
            self._last = (measurement, None)
            return None
        # of two rows of one epoch, from two sources, the second is late also where rows are caught up with
        is_late = measurement.epoch_us <= (self._newest_us or 0) or (measurement.is_late and not is_catch_up)
        outcome = step_paper(
            self._state,
            self._model,
            self._knowledge,
            self._knowledge.ephemeris,
            measurement,
            self._in_calibration_order(measurement, plan, self._model),
            is_late=is_late,
            is_catch_up=is_catch_up,
            config=self._config,
        )
        self._state = outcome.state
        if is_late:
            return Outcome((outcome.row,), None)
        self._last = (measurement, _Step(outcome, self._model.sensitivity))
        self._remember_epoch(measurement.epoch_us)
        return self._with_command(outcome.row)

    def carrier_states(self) -> tuple[Measurement, tuple[CarrierState, ...]] | None:
        """Return the newest consumed row and what is known of each of its carriers; None before the first."""
        if self._last is None:
            return None
        measurement, step = self._last
        plan = self._lookup.plan(measurement.plan_id)
        known = _known_states(*step) if step is not None else {}
        return measurement, tuple(
            _carrier_state(measurement, k, name, known) for k, name in enumerate(plan.carrier_ids)
        )

    def _start(self, alignment: Alignment) -> None:
        """Set the state of every method to an alignment."""
        self._newest_us = alignment.epoch_us
        self._carry_n_m_s = NO_CARRY
        self._recent_us = np.zeros(0, dtype=np.int64)
        self._model = paper_model(self._knowledge, self._lookup.calibration(alignment.calibration_id))
        self._state = (
            None if self._model is None else initial_state(len(self._model.expected.carrier_ids), self._config)
        )

    def _rebuild_model(self, alignment: Alignment) -> None:
        """Take over a change of calibration or ephemeris; another set of carriers starts the means anew."""
        former = self._model
        self._model = paper_model(self._knowledge, self._lookup.calibration(alignment.calibration_id))
        if self._model is None:
            return
        carrier_ids = self._model.expected.carrier_ids
        if former is None or former.expected.carrier_ids != carrier_ids:
            self._state = initial_state(len(carrier_ids), self._config)

    def _in_calibration_order(self, measurement: Measurement, plan: CarrierPlan, model: PaperModel) -> FloatArray:
        """Return the powers in the order of the calibration's carriers; NaN where the plan has no such carrier."""
        key = (plan.id, model.calibration_id)
        if key not in self._columns:
            place = {carrier: k for k, carrier in enumerate(plan.carrier_ids)}
            self._columns[key] = np.array([place.get(c, -1) for c in model.expected.carrier_ids], dtype=np.int64)
        columns = self._columns[key]
        return np.where(columns >= 0, np.append(measurement.power_dbm, np.nan)[columns], np.nan)

    def _remember_epoch(self, epoch_us: int) -> None:
        """Keep the newest epoch and the epochs from which the row period is taken."""
        self._newest_us = epoch_us
        self._recent_us = np.append(self._recent_us, np.int64(epoch_us))[-self._config.torque.period_rows - 1 :]

    def _command_period_s(self) -> float:
        """Return the expected time to the next command: the median row period."""
        if len(self._recent_us) < 2:
            return self._config.torque.default_period_s
        return float(np.median(np.diff(self._recent_us))) / US_PER_S

    def _with_command(self, row: AttitudeRow) -> Outcome:
        """Return the outcome of a row with the torque command that follows from it."""
        spacecraft = self._knowledge.spacecraft
        if spacecraft is None:
            return Outcome((row,), None)
        driving = (
            row if spacecraft.control.method is row.method else _row_of_other_method(row, spacecraft.control.method)
        )
        torque = compute_command(driving, spacecraft, self._carry_n_m_s, self._command_period_s(), self._config.torque)
        self._carry_n_m_s = torque.carry_n_m_s
        is_applied = torque.command.control_allowed and spacecraft.control.release is Release.AUTOMATIC
        return Outcome((row,), torque.command, AppliedCommand(torque.command) if is_applied else None)


def _known_states(outcome: PaperStep, sensitivity: SensitivityModel) -> dict[str, CarrierState]:
    """Return what the paper method says of each carrier of the calibration that a row was computed with."""
    excluded = {item.carrier for item in outcome.fix.excluded}
    return {
        name: CarrierState(
            carrier=name,
            power_dbm=float("nan"),
            expected_dbm=float(outcome.deviation.expected_dbm[k]),
            deviation_db=float(outcome.deviation.deviation_db[k]),
            residual_db=float(outcome.fix.residual_db[k]),
            sigma_db=float(outcome.fix.sigma_db[k]),
            c_n0_db_hz=float("nan"),
            flags=0,
            state="unselected" if not sensitivity.is_selected[k] else ("excluded" if name in excluded else "used"),
        )
        for k, name in enumerate(sensitivity.carrier_ids)
    }


def _row_of_other_method(row: AttitudeRow, method: Method) -> AttitudeRow:
    """Return the row of a method that cannot run on the measurement of a row of another."""
    return row_without_attitude(row.epoch_us, row.received_at_us, row.number, method, ("no_calibration",))


def _carrier_state(measurement: Measurement, k: int, name: str, known: dict[str, CarrierState]) -> CarrierState:
    """Return the state of the k-th carrier of a row."""
    power_dbm = float(measurement.power_dbm[k])
    flags = 0 if measurement.flags is None else int(measurement.flags[k])
    nan = float("nan")
    state = known.get(name) or CarrierState(name, nan, nan, nan, nan, nan, nan, 0, "uncalibrated")
    word = "absent" if np.isnan(power_dbm) else state.state
    return replace(state, power_dbm=power_dbm, flags=flags, state=word)
