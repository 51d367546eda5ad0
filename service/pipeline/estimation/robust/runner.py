"""The robust method in the chain: its model, its state, commanded motion, and what is known of each carrier."""

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from service.core.estimation.filtering.anchor.anchor_watch import carrier_hypotheses
from service.core.estimation.filtering.model.filter_state import core_size
from service.core.estimation.filtering.model.hidden_motion import SHARE_SIGMA
from service.core.estimation.filtering.watches.command_watch import missed_log_ratio, share_log_ratio
from service.pipeline.config import ChainConfig
from service.pipeline.estimation.method import CalibratedColumns, CarrierLevels, CommandEvidence
from service.pipeline.estimation.robust.attitude_rows import known_disturbance
from service.pipeline.estimation.robust.method import (
    RobustState,
    RobustStep,
    carried_state,
    carrier_levels,
    initial_state,
)
from service.pipeline.estimation.robust.model import RobustModel, robust_model
from service.pipeline.estimation.robust.motion_records import step_with_record
from service.pipeline.estimation.robust.row_recorder import RowRecorder
from service.pipeline.estimation.robust.saved_state import SavedRobust, newest_row, saved_robust
from service.pipeline.estimation.robust.unreported_commands import (
    MAX_ROWS,
    Branch,
    Motion,
    ReportedMotion,
    Step,
    apply_report,
    closed,
    open_branch,
    reported,
    stepped,
)
from service.pipeline.inputs.knowledge import Knowledge, Lookup
from service.pipeline.inputs.known_motion import CommandedMotion, end_us, heard
from service.records.calibration import Alignment, Calibration
from service.records.catalogue import CarrierPlan, Ephemeris, Method, Spacecraft
from service.records.epoch import US_PER_S
from service.records.inputs import Correction
from service.records.journal import SlowInput
from service.records.levels.attitude import (
    AppliedCommand,
    AttitudeRow,
    CarrierState,
    Disturbance,
    ReleasedCommand,
    ReportedCommand,
)
from service.records.levels.measurement import Measurement, QualityFlag

#: a level with one of these is not used
_UNFIT = int(
    QualityFlag.OVERRANGE
    | QualityFlag.UNCAL
    | QualityFlag.NO_CARRIER
    | QualityFlag.INTERFERENCE
    | QualityFlag.EXPIRED
    | QualityFlag.SETTING_MISMATCH
    | QualityFlag.STALE_TRACE
    | QualityFlag.NONFINITE_VALUE
    | QualityFlag.NOT_MEASURED
)
#: commanded motion is kept this long for alignments that reach back, us
_KEPT_US = 7 * 86_400 * US_PER_S


class RobustRunner:
    """Runs the robust method; `MethodRunner`."""

    method = Method.ROBUST

    def __init__(self, lookup: Lookup, config: ChainConfig) -> None:
        self._lookup = lookup
        self._config = config
        self._model: RobustModel | None = None
        self._state: RobustState | None = None
        self._columns: CalibratedColumns | None = None
        self._last: tuple[RobustStep, RobustModel] | None = None
        self.recorder: RowRecorder | None = None  # keeps effective rows for a smoother; no part of the state
        self.rows_by_kind = {True: 0, False: 0}  # in time, by whether they were ordinary; no part of the state
        self._reported: list[tuple[Motion, Spacecraft | None]] = []
        #: released and not reported, by counter
        self._open: dict[int, tuple[ReleasedCommand, Spacecraft | None]] = {}
        self._branch: Branch | None = None
        #: orbit that held at the alignment; references are re-derived under it
        self._aligned_under: Ephemeris | None = None

    @property
    def is_running(self) -> bool:
        """Return whether rows lead to angles."""
        return self._model is not None

    def on_input(self, content: SlowInput, knowledge: Knowledge) -> None:
        """Take in a correction, a command that counts as applied, a release or a report."""
        record = knowledge.spacecraft
        if isinstance(content, ReleasedCommand) and content.counter not in self._open:
            self._open[content.counter] = content, record
            self._uncertain(content, record)
        elif isinstance(content, ReportedCommand) and content.counter in self._open:
            self._reported.append((content, self._open.pop(content.counter)[1]))
            if self._branch is not None:
                self._state, self._branch = reported(self._branch, content)
        elif isinstance(content, Correction | AppliedCommand):
            self._reported.append((content, record))
            self._known(content, record)

    def _known(self, content: Correction | AppliedCommand, record: Spacecraft | None) -> None:
        """Let the filter know of a motion."""
        if self._state is None or self._model is None:
            return
        announced = ReportedMotion(content, record, self._model)
        self._state = apply_report(self._state, announced)
        if self._branch is not None:
            self._branch = open_branch(self._branch, self._state, announced)
        self._forget(self._state.filter.epoch_us - _KEPT_US)

    def _uncertain(self, content: ReleasedCommand, record: Spacecraft | None) -> None:
        """Let the effect of a released command be uncertain from now on."""
        if self._state is None or self._model is None:
            return
        announced = ReportedMotion(content, record, self._model)
        self._branch = open_branch(self._branch, self._state, announced)
        self._state = apply_report(self._state, announced)

    def _applied(self, taken: Step) -> None:
        """Keep what is to be done again when a report comes; after too many rows powers have told it."""
        if self._branch is None or self._state is None or self._model is None:
            return
        if self._branch.rows >= MAX_ROWS:
            self._state, self._branch = closed(self._state, self._model), None
        else:
            self._branch = stepped(self._branch, taken)

    def start(self, knowledge: Knowledge) -> None:
        """Begin at the alignment that holds."""
        self._aligned_under = knowledge.ephemeris
        self._model, self._columns = self._model_of(knowledge)
        self._state, self._last, self._branch = None, None, None
        if self._model is not None and knowledge.alignment is not None:
            self._state = self._initial(self._model, knowledge.alignment)

    def rebuild(self, knowledge: Knowledge) -> None:
        """Take over a change of calibration, ephemeris or spacecraft; attitude and references are kept."""
        former = self._model
        self._model, self._columns = self._model_of(knowledge)
        if self._model is None or knowledge.alignment is None:
            return
        if self._state is None or former is None:
            self._state = self._initial(self._model, knowledge.alignment)
        else:
            taken = partial(carried_state, old=former, new=self._model)
            self._state = taken(self._state)
            self._applied(taken)

    def step(
        self, measurement: Measurement, plan: CarrierPlan, knowledge: Knowledge, *, is_late: bool, is_catch_up: bool
    ) -> AttitudeRow:
        """Return the row of a measurement; the state moves on unless the row is late."""
        if self._model is None or self._state is None or self._columns is None:
            message = "the robust method was stepped without a model"
            raise ValueError(message)
        consume = partial(
            step_with_record,
            model=self._model,
            knowledge=knowledge,
            measurement=measurement,
            power_dbm=self._columns.fit_power_dbm(measurement, plan, _UNFIT),
            is_late=is_late,
            is_catch_up=is_catch_up,
            config=self._config,
            recorder=self.recorder,
        )
        outcome = consume(self._state)
        self._state = outcome.state
        if not is_late:
            self._last = (outcome, self._model)
            self.rows_by_kind[outcome.is_ordinary] += 1
            self._applied(partial(_again, consume))
        return outcome.row

    @property
    def is_waiting(self) -> bool:
        """Return whether rows are kept to be taken again when a command is reported."""
        return self._branch is not None

    def saved(self) -> SavedRobust | None:
        """Return what `restore` goes on from; None while nothing runs."""
        last = self._last[0] if self._last is not None and self._last[1] is self._model else None
        return None if self._state is None else saved_robust(self._state, self._aligned_under, last)

    def restore(self, saved: SavedRobust, knowledge: Knowledge) -> None:
        """Go on from a saved state under the knowledge of then."""
        self._aligned_under = None if (under := saved.aligned_under_id) is None else self._lookup.ephemeris(under)
        self._model, self._columns = self._model_of(knowledge)
        self._state, self._last = saved.state, newest_row(saved, self._model)

    def carrier_states(self) -> dict[str, CarrierState]:
        """Return the state of each carrier of the calibration after the newest row."""
        if self._last is None:
            return {}
        outcome, model = self._last
        out = {item.carrier for item in outcome.row.excluded}
        sigma_db = model.filter.sigma_db
        hypotheses = carrier_hypotheses(outcome.state.filter.anchor)
        return {
            name: CarrierState(
                carrier=name,
                power_dbm=float("nan"),
                expected_dbm=float(outcome.expected_dbm[k]),
                deviation_db=float(outcome.deviation_db[k]),
                residual_db=float(outcome.residual_db[k]),
                sigma_db=float(sigma_db[k]),
                flags=0,
                state="unselected" if not model.is_used[k] else ("excluded" if name in out else "used"),
                hypothesis=hypotheses[k].name,
                hypothesis_probability=hypotheses[k].probability,
                hypothesis_since_us=hypotheses[k].since_us,
            )
            for k, name in enumerate(model.carrier_ids)
        }

    def carrier_levels(self) -> CarrierLevels | None:
        """Return the figures of the newest row that was not late, None before it; they are not copied."""
        return None if self._last is None else carrier_levels(*self._last)

    def command_evidence(self) -> CommandEvidence | None:
        """Return the evidence of the newest row in time on commands, None before it."""
        if self._last is None or self._state is None:
            return None
        outcome, model = self._last
        gaussian, position = self._state.filter.gaussian, core_size(model.filter)
        unreported = None
        if self._state.released:
            mean, variance = float(gaussian.mean[position]), float(gaussian.covariance[position, position])
            unreported = share_log_ratio(mean, variance, SHARE_SIGMA)
        return CommandEvidence(
            model.filter,
            np.where(model.is_used, outcome.deviation_db, np.nan),
            missed_log_ratio(self._state.filter.command),
            unreported,
        )

    def disturbance(self) -> Disturbance | None:
        """Return the torque that acts without being fed forward; None where the catalogue states none."""
        if self._model is None or self._state is None:
            return None
        return known_disturbance(self._state.filter, self._model, len(self._state.released))

    def _forget(self, before_us: int) -> None:
        """Let go of the oldest motions; torques come with every row, and an alignment may be months away."""
        self._open = {n: kept for n, kept in self._open.items() if kept[0].stop_us > before_us}
        while self._reported and end_us(self._reported[0][0]) <= before_us:
            del self._reported[0]

    def _initial(self, model: RobustModel, alignment: Alignment) -> RobustState:
        """Return the state at an alignment, with what was commanded after its epoch."""
        since_us = alignment.epoch_us
        self._reported = [announced for announced in self._reported if end_us(announced[0]) > since_us - _KEPT_US]
        commanded = CommandedMotion(since_us)
        for content, record in _as_released(self._reported):
            commanded = heard(commanded, content, record, since_us)
        state = initial_state(model, alignment, commanded, self._config)
        for released, record in self._open.values():
            if released.stop_us > since_us:
                announced = ReportedMotion(released, record, model)
                self._branch = open_branch(self._branch, state, announced)
                state = apply_report(state, announced)
        return state

    def _model_of(self, knowledge: Knowledge) -> tuple[RobustModel | None, CalibratedColumns | None]:
        """Return the model that holds and the order of its carriers."""
        calibration = knowledge.calibration_for(Method.ROBUST)
        aligned_with = self._aligned_with(knowledge.alignment)
        model = robust_model(knowledge, aligned_with, self._config, self._aligned_under)
        if model is None or calibration is None:
            return None, None
        return model, CalibratedColumns(model.carrier_ids, self._lookup.plan(calibration.plan_id))

    def _aligned_with(self, alignment: Alignment | None) -> Calibration | None:
        """Return the calibration that the references were made with, None where the method had none."""
        if alignment is None or Method.ROBUST.value not in alignment.calibration_by_method:
            return None
        return self._lookup.calibration(alignment.calibration_by_method[Method.ROBUST.value])


def _as_released(announced: Sequence[tuple[Motion, Spacecraft | None]]) -> list[tuple[Motion, Spacecraft | None]]:
    """Return motions with reports in the order of their releases: a later command ends an earlier one."""
    reports = [(content, record) for content, record in announced if isinstance(content, ReportedCommand)]
    in_order = iter(sorted(reports, key=lambda each: each[0].counter))
    return [next(in_order) if isinstance(each[0], ReportedCommand) else each for each in announced]


def _again(consume: Callable[[RobustState], RobustStep], state: RobustState) -> RobustState:
    """Return the state after a row that is taken again; one that breaks the numbers is left out as ever."""
    try:
        return consume(state).state
    except ArithmeticError:
        return state
