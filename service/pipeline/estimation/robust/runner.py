"""The robust method in the chain: its model, its state, commanded motion, and what is known of each carrier.

Released commands that nobody has reported: where the filter goes back to when a report comes.

Between release and report a command's whole effect is uncertain: its pulses act by a share among the filter's states.
When the report comes the filter goes back to where the command was released, takes what was executed as known from then
on and the rows again, so that detectors and faults too are those of a filter that always knew. Rows already told stay
as they were told. A command that takes the place of one before it, on board, takes it here: what that one had left
stays known until the new one is reported, and is part of what is uncertain. The law of this file: entries in the order
of the journal; the same entries give the same state.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from service.core.estimation.filtering.anchor import HYPOTHESES
from service.core.estimation.filtering.command_watch import share_log_ratio
from service.core.estimation.filtering.filter_model import core_size
from service.core.estimation.filtering.state_changes import SHARE_SIGMA, with_share, without_shares
from service.pipeline.config import ChainConfig
from service.pipeline.estimation.method import CalibratedColumns, CommandEvidence, MethodRow
from service.pipeline.estimation.robust.attitude_rows import known_disturbance
from service.pipeline.estimation.robust.method import (
    carried_state,
    carrier_levels,
    initial_state,
    step_late,
    take_rows,
    taken_alone,
)
from service.pipeline.estimation.robust.model import RobustModel, robust_model
from service.pipeline.estimation.robust.robust_state import (
    RobustState,
    RobustStep,
    SavedRobust,
    newest_row,
    saved_robust,
)
from service.pipeline.estimation.robust.row_recorder import RowRecorder
from service.pipeline.inputs.knowledge import Knowledge, Lookup
from service.pipeline.inputs.known_motion import (
    CommandedMotion,
    end_us,
    heard,
    motions_of_released,
    without_replaced,
)
from service.records.calibration import Alignment, Calibration
from service.records.catalogue import CarrierPlan, Ephemeris, Method, Spacecraft
from service.records.epoch import US_PER_S
from service.records.inputs import Correction, SlowInput
from service.records.levels.attitude import (
    AppliedCommand,
    CarrierState,
    Disturbance,
    FloatArray,
    Pulse,
    ReleasedCommand,
    ReportedCommand,
)
from service.records.levels.measurement import Measurement, QualityFlag

#: rows that are kept to be taken again, an hour of rows a second; behind them the powers have told what happened
MAX_ROWS = 3600

#: what the filter did with a row or a change of its model
Step = Callable[[RobustState], RobustState]
Motion = Correction | AppliedCommand | ReportedCommand


@dataclass(frozen=True)
class ReportedMotion:
    """Motion or release known from the ground."""

    content: Motion | ReleasedCommand
    record: Spacecraft | None
    model: RobustModel


@dataclass(frozen=True)
class Branch:
    """State before the oldest command that is not reported, and all that happened since."""

    base: RobustState
    entries: tuple[ReportedMotion | Step, ...] = ()
    rows: int = 0


def open_branch(branch: Branch | None, state: RobustState, announced: ReportedMotion) -> Branch:
    """Return the branch with a release, begun at the state before it where there was none."""
    branch = branch or Branch(state)
    return replace(branch, entries=(*branch.entries, announced))


def stepped(branch: Branch, taken: Step) -> Branch:
    """Return the branch with a row, or a change of the model."""
    return replace(branch, entries=(*branch.entries, taken), rows=branch.rows + 1)


def apply_report(state: RobustState, announced: ReportedMotion) -> RobustState:
    """Return the state that has heard of a motion, or of a release whose effect is uncertain."""
    content, newest_us = announced.content, state.filter.epoch_us
    if isinstance(content, ReportedCommand):
        state = _with_replaced(state, content.counter, content.executed)
    if not isinstance(content, ReleasedCommand):
        return replace(state, commanded=heard(state.commanded, content, announced.record, newest_us))
    state = _with_replaced(state, content.counter, content.schedule)
    motion = motions_of_released(state.commanded, content, announced.record, newest_us)
    widened = with_share(announced.model.filter, state.filter, len(state.released))
    return replace(state, filter=widened, released=(*state.released, (content.counter, motion)))


def _with_replaced(state: RobustState, counter: int, schedule: Sequence[Pulse]) -> RobustState:
    """Return the state in which what is uncertain of earlier commands ends where the pulses of a later one begin."""
    newest_us = state.filter.epoch_us
    ended = ((n, without_replaced(motion, counter, schedule, newest_us)) for n, motion in state.released)
    return replace(state, released=tuple(ended))


def reported(branch: Branch, report: ReportedCommand) -> tuple[RobustState, Branch | None]:
    """Return state and branch after a report; the branch is None where nothing is uncertain any longer."""
    entries: list[ReportedMotion | Step] = []
    for entry in branch.entries:
        if not _is_release(entry, report.counter):
            entries.append(entry)
        elif isinstance(entry, ReportedMotion) and report.executed:
            entries.append(replace(entry, content=report))
    first = next((position for position, entry in enumerate(entries) if _is_release(entry)), len(entries))
    base = _taken(branch.base, entries[:first])
    if first == len(entries):
        return base, None
    left = tuple(entries[first:])
    return _taken(base, left), Branch(base, left, sum(not isinstance(entry, ReportedMotion) for entry in left))


def closed(state: RobustState, model: RobustModel) -> RobustState:
    """Return the state without its shares: what they have done stays uncertain until powers tell."""
    return replace(state, filter=without_shares(model.filter, state.filter, len(state.released)), released=())


def _taken(state: RobustState, entries: Sequence[ReportedMotion | Step]) -> RobustState:
    for entry in entries:
        state = apply_report(state, entry) if isinstance(entry, ReportedMotion) else entry(state)
    return state


def _is_release(entry: "ReportedMotion | Step", counter: int | None = None) -> bool:
    if not isinstance(entry, ReportedMotion) or not isinstance(entry.content, ReleasedCommand):
        return False
    return counter is None or entry.content.counter == counter


def steps_in_time(
    state: RobustState,
    *,
    model: RobustModel,
    knowledge: Knowledge,
    measurements: Sequence[Measurement],
    power_dbm: FloatArray,
    is_catch_up: bool,
    config: ChainConfig,
    recorder: RowRecorder | None = None,
) -> list[RobustStep]:
    """Take rows in time, whose powers are (T, N), in as few blocks as they need."""
    if len(measurements) > 1 and taken_alone(state, model, recorder):
        steps: list[RobustStep] = []
        for number, measurement in enumerate(measurements):
            steps += steps_in_time(
                steps[-1].state if steps else state,
                model=model,
                knowledge=knowledge,
                measurements=[measurement],
                power_dbm=power_dbm[number : number + 1],
                is_catch_up=is_catch_up,
                config=config,
                recorder=recorder,
            )
        return steps
    return take_rows(
        state,
        model,
        knowledge,
        measurements,
        power_dbm,
        is_catch_up=is_catch_up,
        config=config,
        recorder=recorder,
    )


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
        model, columns = self._model, self._columns
        if model is None or self._state is None or columns is None:
            message = "the robust method was stepped without a model"
            raise ValueError(message)
        power_dbm = np.array([columns.fit_power_dbm(each, plan, _UNFIT) for each in measurements])
        if is_late:
            late = [step_late(self._state, model, each, power_dbm[k]) for k, each in enumerate(measurements)]
            return [MethodRow(each.row) for each in late]
        take = partial(
            steps_in_time,
            model=model,
            knowledge=knowledge,
            measurements=measurements,
            power_dbm=power_dbm,
            is_catch_up=is_catch_up,
            config=self._config,
            recorder=self.recorder,
        )
        found = take(self._state)
        self._state, self._last = found[-1].state, (found[-1], model)
        for each in found:
            self.rows_by_kind[each.is_ordinary] += 1
        self._applied(partial(_again, take))
        return [_method_row(each, model) for each in found]

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
        carriers = outcome.state.filter.carriers
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
                **_hypothesis(carriers[k]),
            )
            for k, name in enumerate(model.carrier_ids)
        }

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


def _hypothesis(carrier: np.void) -> dict[str, Any]:
    """Return the likeliest hypothesis of a record of `CARRIER`; None and NaN before it was asked."""
    probability = float(carrier["probability"])
    is_known = not math.isnan(probability)
    return {
        "hypothesis": tuple(HYPOTHESES)[carrier["hypothesis"]] if is_known else None,
        "hypothesis_probability": probability,
        "hypothesis_since_us": int(carrier["hypothesis_since_us"]) if is_known else None,
    }


def _as_released(announced: Sequence[tuple[Motion, Spacecraft | None]]) -> list[tuple[Motion, Spacecraft | None]]:
    """Return motions with reports in the order of their releases: a later command ends an earlier one."""
    reports = [(content, record) for content, record in announced if isinstance(content, ReportedCommand)]
    in_order = iter(sorted(reports, key=lambda each: each[0].counter))
    return [next(in_order) if isinstance(each[0], ReportedCommand) else each for each in announced]


def _again(take: Callable[[RobustState], list[RobustStep]], state: RobustState) -> RobustState:
    """Return the state after rows that are taken again; one that breaks the numbers is left out as ever."""
    try:
        return take(state)[-1].state
    except ArithmeticError:
        return state


def _method_row(found: RobustStep, model: RobustModel) -> MethodRow:
    """Return a row in time as the chain takes it."""
    given = found, model
    return MethodRow(found.row, carrier_levels(*given), partial(_disturbance, *given), partial(_evidence, *given))


def _disturbance(found: RobustStep, model: RobustModel) -> Disturbance | None:
    """Return the torque that acts at a row without being fed forward; None where the catalogue states none."""
    return known_disturbance(found.torque_deg_h2, model, found.row.epoch_us)


def _evidence(found: RobustStep, model: RobustModel) -> CommandEvidence:
    """Return the evidence of a row on commands; with unreported ones a row is a block of its own."""
    state, unreported = found.state, None
    # under a torque that nobody states its step, as at the edge of a shadow, explains as much as a lost command
    if state.released and not model.is_torque_unknown:
        position, (mean, covariance) = core_size(model.filter), state.filter.gaussian
        unreported = share_log_ratio(float(mean[position]), float(covariance[position, position]), SHARE_SIGMA)
    deviation_db = np.where(model.is_used, found.deviation_db, np.nan)
    return CommandEvidence(model.filter, deviation_db, found.missed_log_ratio, unreported)
