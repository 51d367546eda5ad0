"""The chain: one journal entry in, its outcome out; the order of the stages is written here once.

::

    slow input  -> knowledge
    measurement -> each method: deviation, fix, attitude row -> wheel torques of the method that drives control

The chain reads no clock and no random number: what it returns follows from the journal alone, bit for bit. A method
that fails on a row says so in its row and goes on with the next; the other method is not touched.
"""

import logging
import math
import statistics
from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from service.pipeline.checkpoints import ChainState
from service.pipeline.config import ChainConfig
from service.pipeline.control.command.compute_command import (
    NO_CARRY,
    basis_at,
    basis_of,
    compute_command,
    with_executed,
)
from service.pipeline.control.command.control_design import PanelSwing, is_gyro_orbitant, swing_after
from service.pipeline.estimation.method import (
    CarrierLevels,
    CommandEvidence,
    MethodRow,
    MethodRunner,
    RowEvidence,
    carrier_results,
    carrier_state,
    nothing_known,
)
from service.pipeline.estimation.paper.runner import PaperRunner
from service.pipeline.estimation.robust.row_recorder import RowRecorder
from service.pipeline.estimation.robust.runner import RobustRunner
from service.pipeline.estimation.row_inhibitions import Disagreement, compare
from service.pipeline.inputs.knowledge import Knowledge, Lookup, update
from service.ports.archive import Outcome
from service.records.calibration import Calibration
from service.records.catalogue import CarrierPlan, Method, Release, Spacecraft
from service.records.epoch import US_PER_S
from service.records.inputs import AlignmentSet, CalibrationActivation, EphemerisChange, SlowInput, SpacecraftChange
from service.records.levels.attitude import (
    AppliedCommand,
    AttitudeRow,
    BalanceBasis,
    CarrierResults,
    CarrierState,
    Disturbance,
    ReleasedCommand,
    ReportedCommand,
    row_without_attitude,
)
from service.records.levels.measurement import Measurement

_LOG = logging.getLogger("soo.chain")

_RUNNERS: dict[Method, type[RobustRunner | PaperRunner]] = {Method.ROBUST: RobustRunner, Method.PAPER: PaperRunner}
#: errors of numbers that break a computation
_BROKEN = (ArithmeticError, ValueError, LookupError)
#: in the order in which their rows are written
METHODS = tuple(_RUNNERS)


class ChainRow(NamedTuple):
    """Row of powers, with what the chain makes of it."""

    measurement: Measurement
    #: None: nothing runs, or the row does not feed the estimator
    outcome: Outcome | None
    #: of the first method that runs, None of a late row
    levels: CarrierLevels | None = None
    #: returns the evidence of a row in time on commands, None where no method has any
    command_evidence: Callable[[], CommandEvidence | None] = nothing_known


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
    methods : sequence of Method
        Methods to run.
    has_commands : bool
        False leaves out the torques; with them the method that drives control must be among the methods.
    recorder : RowRecorder, optional
        Keeps what the filter of the robust method did with each row.
    """

    def __init__(
        self,
        lookup: Lookup,
        config: ChainConfig,
        calibration: Calibration | None = None,
        methods: Sequence[Method] = METHODS,
        *,
        has_commands: bool = True,
        recorder: RowRecorder | None = None,
    ) -> None:
        self._lookup = lookup
        self._config = config
        self._override = calibration
        self._has_commands = has_commands
        self._knowledge = Knowledge()
        self._runners: tuple[MethodRunner, ...] = tuple(_RUNNERS[m](lookup, config) for m in METHODS if m in methods)
        self._methods = tuple([runner.method for runner in self._runners])
        for runner in self._runners:
            if isinstance(runner, RobustRunner):
                runner.recorder = recorder
        self._carry_n_m_s = NO_CARRY
        self._basis: BalanceBasis | None = None
        self._swing: PanelSwing | None = None
        self._newest_us: int | None = None
        #: epochs from which the row period is taken
        self._recent_us: deque[int] = deque(maxlen=config.torque.period_rows + 1)
        self._disagreement = Disagreement()
        self._last: tuple[Measurement, bool] | None = None

    @property
    def knowledge(self) -> Knowledge:
        """Return the knowledge from the slow inputs."""
        return self._knowledge

    @property
    def is_running(self) -> bool:
        """Return whether rows lead to angles."""
        return any(runner.is_running for runner in self._runners)

    @property
    def is_disagreeing(self) -> bool:
        """Return whether the methods have told different roll or pitch angles for long."""
        return self._disagreement.is_standing

    def update(self, content: SlowInput) -> None:
        """Consume a slow input; an alignment starts the methods again, an activation keeps their state."""
        self._knowledge = update(self._knowledge, content, self._lookup)
        if self._override is not None:
            active = {**self._knowledge.active, self._override.request.method: self._override}
            self._knowledge = self._knowledge._replace(active=active)
        for runner in self._runners:
            runner.on_input(content, self._knowledge)
        self._remember_command(content)
        alignment = self._knowledge.alignment
        if alignment is None:
            return
        if isinstance(content, AlignmentSet):
            self._newest_us = alignment.epoch_us
            self._carry_n_m_s, self._basis = NO_CARRY, None
            self._recent_us.clear()
            self._disagreement = Disagreement()
            for runner in self._runners:
                runner.start(self._knowledge)
        elif isinstance(content, CalibrationActivation | EphemerisChange | SpacecraftChange):
            for runner in self._runners:
                runner.rebuild(self._knowledge)

    def step(self, measurement: Measurement, *, is_catch_up: bool = False) -> Outcome | None:
        """Consume a row of powers; None while nothing can be computed or the row does not feed the estimator."""
        return self.rows([measurement], is_catch_up=is_catch_up)[0].outcome

    def rows(self, measurements: Sequence[Measurement], *, is_catch_up: bool = False) -> list[ChainRow]:
        """Consume rows of powers with nothing between them; what comes of each is the same as of `step`, row by row."""
        rows: list[ChainRow] = []
        block: list[Measurement] = []
        newest_us = self._newest_us or 0
        for each in measurements:
            # of two rows of one epoch, from two sources, the second is late also where rows are caught up with
            is_late = each.epoch_us <= newest_us or (each.is_late and not is_catch_up)
            is_next = each.feeds_estimator and self.is_running and not is_late
            if block and not (is_next and each.plan_id == block[0].plan_id):
                rows += self._block(block, is_catch_up=is_catch_up)
                block = []
            if is_next:
                block.append(each)
                newest_us = each.epoch_us
            else:
                rows.append(ChainRow(each, self._apart(each, is_catch_up=is_catch_up)))
        return rows + self._block(block, is_catch_up=is_catch_up)

    def _apart(self, measurement: Measurement, *, is_catch_up: bool) -> Outcome | None:
        """Return the outcome of a row that is late, feeds nothing, or comes while nothing runs."""
        if not measurement.feeds_estimator:
            return None
        if not self.is_running:
            self._last = (measurement, False)
            return None
        plan = self._lookup.plan(measurement.plan_id)
        by_method = self._rows([measurement], plan, is_late=True, is_catch_up=is_catch_up)
        return Outcome(tuple(each.row for rows in by_method for each in rows), None)

    def _block(self, measurements: list[Measurement], *, is_catch_up: bool) -> list[ChainRow]:
        """Return what comes of rows in time of one plan."""
        if not measurements:
            return []
        plan = self._lookup.plan(measurements[0].plan_id)
        by_method = self._rows(measurements, plan, is_late=False, is_catch_up=is_catch_up)
        carriers = [carrier_results(rows, measurements, plan) for rows in by_method]
        rows = []
        for number, measurement in enumerate(measurements):
            self._last = (measurement, True)
            self._newest_us = measurement.epoch_us
            self._recent_us.append(measurement.epoch_us)
            method_rows = [each[number] for each in by_method]
            self._disagreement = compare(self._disagreement, [each.row for each in method_rows], self._config.robust)
            outcome = self._with_command(method_rows, tuple([each[number] for each in carriers]))
            evidence = next(
                (each.command_evidence for each in method_rows if each.command_evidence is not nothing_known),
                nothing_known,
            )
            rows.append(ChainRow(measurement, outcome, method_rows[0].levels, evidence))
        return rows

    def _rows(
        self, measurements: list[Measurement], plan: CarrierPlan, *, is_late: bool, is_catch_up: bool
    ) -> list[list[MethodRow]]:
        """Return the rows that each method that runs makes of measurements of one plan."""
        return [
            self._rows_of(runner, measurements, plan, is_late=is_late, is_catch_up=is_catch_up)
            for runner in self._runners
            if runner.is_running
        ]

    def saved(self) -> ChainState | None:
        """Return the state after the newest entry; None where the chain cannot be saved now.

        Nothing runs, or a released command is not reported. A chain that goes on from it must have been made alike.
        """
        alignment = self._knowledge.alignment
        if alignment is None or not self.is_running:
            return None
        if any(runner.is_waiting for runner in self._runners):
            return None
        kept = {runner.method: runner.saved() for runner in self._runners}
        return ChainState(
            alignment.id,
            kept.get(Method.ROBUST),
            kept.get(Method.PAPER),
            self._carry_n_m_s,
            self._basis,
            self._swing,
            self._newest_us,
            np.array(self._recent_us, dtype=np.int64),
            self._disagreement,
            self._last,
        )

    def restore(self, state: ChainState) -> None:
        """Go on from a saved state; the slow inputs of before, but for the alignment, are known already."""
        alignment = self._lookup.alignment(state.alignment_id)
        self._knowledge = self._knowledge._replace(alignment=alignment)
        for runner in self._runners:
            saved = state.robust if runner.method is Method.ROBUST else state.paper
            if saved is not None:
                runner.restore(saved, self._knowledge)
        self._carry_n_m_s, self._basis, self._swing = state.carry_n_m_s, state.basis, state.swing
        self._recent_us.clear()
        self._recent_us.extend(state.recent_us.tolist())
        self._newest_us, self._disagreement, self._last = state.newest_us, state.disagreement, state.last

    def carrier_states(self) -> tuple[Measurement, tuple[CarrierState, ...]] | None:
        """Return the newest consumed row and what is known of each of its carriers; None before the first."""
        if self._last is None:
            return None
        measurement, is_computed = self._last
        plan = self._lookup.plan(measurement.plan_id)
        running = [runner for runner in self._runners if runner.is_running]
        known = running[0].carrier_states() if is_computed and running else {}
        return measurement, tuple(carrier_state(measurement, k, name, known) for k, name in enumerate(plan.carrier_ids))

    def rows_by_kind(self) -> dict[bool, int]:
        """Return how many rows the robust method has taken since the start, by whether they were ordinary."""
        return next((dict(each.rows_by_kind) for each in self._runners if isinstance(each, RobustRunner)), {})

    def facts(self, row: ChainRow) -> RowEvidence:
        """Return what alarms look at in a row, under what is known now."""
        spacecraft, outcome = self._knowledge.spacecraft, row.outcome
        return RowEvidence(
            measurement=row.measurement,
            plan=self._lookup.plan(row.measurement.plan_id),
            rows=() if outcome is None else outcome.rows,
            disagreement_deg=math.nan if outcome is None else outcome.disagreement_deg,
            method=Method.ROBUST if spacecraft is None else spacecraft.control.method,
            levels=row.levels,
            operations=self._knowledge.operations,
        )

    def _rows_of(
        self,
        runner: MethodRunner,
        measurements: list[Measurement],
        plan: CarrierPlan,
        *,
        is_late: bool,
        is_catch_up: bool,
    ) -> list[MethodRow]:
        """Return a method's rows; numbers that break the computation of one make a row that says so."""
        take = partial(runner.steps, plan=plan, knowledge=self._knowledge, is_late=is_late, is_catch_up=is_catch_up)
        if len(measurements) > 1:
            try:
                return take(measurements)
            except _BROKEN:
                _LOG.info("a block of %d rows breaks the numbers: its rows are taken one by one", len(measurements))
        return [self._row(runner.method, take, each) for each in measurements]

    def _row(
        self, method: Method, take: Callable[[Sequence[Measurement]], list[MethodRow]], measurement: Measurement
    ) -> MethodRow:
        try:
            return take([measurement])[0]
        except _BROKEN:
            _LOG.exception(
                "method %s failed at journal number %d; the row has no attitude (internal_error)",
                method,
                measurement.number,
            )
            number, epoch_us, received_us = measurement.number, measurement.epoch_us, measurement.received_at_us
            return MethodRow(row_without_attitude(epoch_us, received_us, number, method, ("internal_error",)))

    def _remember_command(self, content: SlowInput) -> None:
        """Let what was executed move the spacecraft that is balanced, and what was sent swing the flexible modes."""
        if self._basis is not None and isinstance(content, AppliedCommand | ReportedCommand):
            pulses = content.command.schedule if isinstance(content, AppliedCommand) else content.executed
            self._basis = with_executed(self._basis, pulses)
        spacecraft = self._knowledge.spacecraft
        if spacecraft is None or not spacecraft.modes:
            return
        if isinstance(content, AppliedCommand):
            self._swing = swing_after(self._swing, content.command.schedule, spacecraft)
        elif isinstance(content, ReleasedCommand):
            self._swing = swing_after(self._swing, content.schedule, spacecraft)

    def _row_period_s(self) -> float:
        """Return the median time between rows."""
        if len(self._recent_us) < 2:
            return self._config.torque.default_period_s
        # numpy costs ten times as much on so few
        periods_us = [later - earlier for earlier, later in pairwise(self._recent_us)]
        return float(statistics.median(periods_us)) / US_PER_S

    def _with_command(self, method_rows: Sequence[MethodRow], carriers: tuple[CarrierResults | None, ...]) -> Outcome:
        """Return the outcome of a row with the torque command that follows from it."""
        rows = tuple([each.row for each in method_rows])
        spacecraft, apart_deg = self._knowledge.spacecraft, self._disagreement.apart_deg
        if spacecraft is None or not self._has_commands:
            return Outcome(rows, None, disagreement_deg=apart_deg, carriers=carriers)
        wanted = spacecraft.control.method
        if wanted not in self._methods:
            return Outcome(rows, None, disagreement_deg=apart_deg, carriers=carriers)
        source = next((each for each in method_rows if each.row.method is wanted), None)
        driving = self._row_of_silent(rows[0], wanted) if source is None else source.row
        config, disturbance = self._config.torque, None if source is None else source.disturbance()
        is_automatic, body_rate_deg_s = spacecraft.control.release is Release.AUTOMATIC, None
        if is_gyro_orbitant(spacecraft):
            rate_age_s = config.rate_stale_periods * self._row_period_s() + config.rate_stale_margin_s
            body_rate_deg_s = self._knowledge.body_rate_deg_s(driving.epoch_us, rate_age_s)
        self._basis = self._basis_at(driving, spacecraft, disturbance)
        torque = compute_command(
            driving,
            spacecraft,
            self._carry_n_m_s,
            self._row_period_s() if is_automatic else spacecraft.control.command_period_s,
            config,
            disturbance,
            self._knowledge.momentum_n_m_s(driving.epoch_us, config.telemetry_age_s),
            swing=self._swing,
            is_withheld=self._knowledge.is_withheld,
            body_rate_deg_s=body_rate_deg_s,
            basis=self._basis,
        )
        self._carry_n_m_s = torque.carry_n_m_s
        applied = AppliedCommand(torque.command) if torque.command.control_allowed and is_automatic else None
        return Outcome(rows, torque.command, applied, disturbance, apart_deg, carriers)

    def _basis_at(
        self, row: AttitudeRow, spacecraft: Spacecraft, disturbance: Disturbance | None
    ) -> BalanceBasis | None:
        """Return what may be balanced from a row on; a trip ends it."""
        if self._knowledge.is_withheld:
            return None
        if any(runner.is_waiting for runner in self._runners):
            # what an unreported command has moved is not known
            return self._basis
        if row.control_allowed:
            return basis_of(row, disturbance)
        return self._basis and basis_at(self._basis, row, spacecraft, self._config.torque.hold_s)

    def _row_of_silent(self, row: AttitudeRow, method: Method) -> AttitudeRow:
        """Return the row of a method that cannot run on the measurement of a row of another."""
        is_calibrated = self._knowledge.calibration_for(method) is not None
        reason = "not_aligned" if is_calibrated else "no_calibration"
        return row_without_attitude(row.epoch_us, row.received_at_us, row.number, method, (reason,))
