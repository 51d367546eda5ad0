"""Sign checks on the service: legs are prepared as commands, persons confirm them, the rows decide."""

from dataclasses import replace

import numpy as np

from service.core.control.quaternion_law import inertia_about_angles
from service.core.control.sign_check import SignDecision, SignState
from service.errors import ConflictError, InvalidInputError
from service.pipeline.config import TorqueConfig
from service.pipeline.control.command.control_design import control_design
from service.pipeline.control.command.schedule_check import schedule_verdict
from service.pipeline.control.release.command_states import OPEN, UNREPORTED, CommandState
from service.pipeline.control.release.command_transitions import command_of
from service.pipeline.control.release.events import (
    Cancel,
    Prepare,
    Proposal,
    Refusal,
    SignJudged,
)
from service.pipeline.control.release.interlock import Instant
from service.pipeline.control.release.interlock_states import State
from service.pipeline.control.release.proposals import effect_of_pulses, schedule_of
from service.pipeline.control.release.settings import ReleaseSettings
from service.ports import Storage
from service.records.operations.release import SignCheckView, SignRatios
from service.runtime.control.persisted_release import Annex
from service.runtime.control.proposals import soonest_start_us, swing_left
from service.runtime.control.refusal_errors import error_of
from service.runtime.control.release_inputs import KnownFacts, read_telemetry
from service.runtime.control.sign_check_run import AXES, SignCheckRun
from service.runtime.control.spacecraft_release import SpacecraftRelease, Stepper
from service.runtime.control.views import Dress

_RUNNING = "running"
_INTERRUPTED = "interrupted"
#: verdicts that the interlock is told
_TOLD = frozenset({SignState.PLUS, SignState.MINUS, SignState.NOTHING})
#: a check of yaw, with hours of rows, is judged once in so many
_YAW_ROWS = 30


class SignChecks:
    """Sign checks of all spacecraft, one at a time of each.

    Parameters
    ----------
    storage : Storage
        Where telemetry and released commands lie.
    settings : ReleaseSettings
        Times and the error of telemetry.
    torque : TorqueConfig
        Of the control law, for the drive.
    step : Stepper
        Judges and stores.
    """

    def __init__(self, storage: Storage, settings: ReleaseSettings, torque: TorqueConfig, step: Stepper) -> None:
        self._storage = storage
        self._settings = settings
        self._torque = torque
        self._step = step

    def begin(self, release: SpacecraftRelease, facts: KnownFacts, axis: str, by: str, at: Instant) -> None:
        """Prepare the first leg, or raise why it cannot be."""
        if axis not in AXES:
            raise InvalidInputError("sign_check.axis", "axis must be yaw, roll or pitch")
        if release.run is not None:
            raise ConflictError("sign_check.running", f"the sign check of {release.run.axis} is under way")
        if release.row is None or release.seen is None or release.seen.evidence is None:
            detail = "there are no rows of the robust method yet, whose model a sign check needs"
            raise ConflictError("sign_check.no_rows", detail)
        craft = facts.spacecraft
        release.run = SignCheckRun(
            axis=axis,
            by=by,
            started_us=at.now_us,
            attitude_deg=release.row.attitude_deg,
            inertia_kg_m2=inertia_about_angles(np.array(craft.inertia_kg_m2)),
            has_coupling=craft.onboard.roll_yaw_coupling is True,
            settings=self._settings,
        )
        try:
            refusal = self._prepare_leg(release, facts, at)
        except BaseException:
            release.run = None
            raise
        if refusal is not None:
            release.run = None
            raise error_of(refusal)
        release.case.put(at, _view(release.run, _RUNNING, None))

    def go_on(self, release: SpacecraftRelease, facts: KnownFacts, at: Instant) -> None:
        """Take in what became of the leg that is out, judge, and prepare the next one."""
        run = release.run
        if run is None:
            return
        problem = _take_in(run, release)
        decision = self._decision(run)
        wheels = self._wheels(run, facts) if run.axis == "yaw" else None
        powers = SignState.OPEN if decision is None else decision.verdict
        verdict = run.verdict(powers, wheels, at.now_us)
        if problem:
            self._finish(release, facts, _view(run, _INTERRUPTED, decision, wheels, problem), at)
        elif verdict is not SignState.OPEN:
            self._finish(release, facts, _view(run, verdict.value, decision, wheels), at)
        elif at.now_us >= run.until_us:
            self._finish(release, facts, _view(run, verdict.value, decision, wheels, "its time is over"), at)
        else:
            refusal = self._prepare_leg(release, facts, at)
            detail = "" if refusal is None else f"{refusal.code}: {refusal.detail}"
            self._show(release, _view(run, _RUNNING, decision, wheels, detail), at)

    def _decision(self, run: SignCheckRun) -> SignDecision | None:
        """Return what the powers say; hours of rows are not weighed with every one of them."""
        if run.axis == "yaw" and len(run.epochs_us) % _YAW_ROWS:
            return None
        return run.decision()

    def _wheels(self, run: SignCheckRun, facts: KnownFacts) -> SignState:
        """Return what wheel telemetry says of a check of yaw."""
        if not run.done or len(run.epochs_us) % _YAW_ROWS:
            return SignState.OPEN
        telemetry = read_telemetry(self._storage, facts.spacecraft.id, run.started_us)
        return run.wheel_verdict(telemetry, control_design(facts.spacecraft, self._torque).wheels.axes)

    def _prepare_leg(self, release: SpacecraftRelease, facts: KnownFacts, at: Instant) -> Refusal | None:
        """Prepare the next leg if it is due; return why it cannot be."""
        run, row, craft = release.run, release.row, facts.spacecraft
        start_us = soonest_start_us(at.now_us, self._settings, self._settings.sign_confirm_s)
        if run is None or row is None or not run.is_leg_due(start_us):
            return None
        try:
            pulses = run.leg(control_design(craft, self._torque).drive)
        except ValueError as error:
            return Refusal("command.empty", str(error))
        schedule = schedule_of(pulses, start_us)
        swing = swing_left(self._storage.releases, craft, start_us)
        checked = schedule_verdict(schedule, craft, self._torque, swing)
        proposal = Proposal(
            attitude_epoch_us=row.epoch_us,
            start_us=start_us,
            pulses=pulses,
            effect=effect_of_pulses(pulses, craft, 0.0),
            schedule_verdict="accept" if checked is None else checked.verdict,
            reason=f"sign check of {run.axis}, leg {len(run.done) + 1} of {len(run.profile.legs)}",
            is_sign_check=True,
        )
        counter = release.case.state.next_counter
        step = self._step(release, craft, Prepare(at, run.by, proposal), Annex(Dress(craft)))
        if step.refusal is None:
            run.pending, run.pending_us = counter, start_us
        return step.refusal

    def _finish(self, release: SpacecraftRelease, facts: KnownFacts, view: SignCheckView, at: Instant) -> None:
        """End a check: what is prepared is taken back, the verdict told to the interlock, the result stored."""
        run, release.run = release.run, None
        if run is None:
            return
        command = None if run.pending is None else command_of(release.case.state, run.pending)
        if command is not None and command.life in OPEN:
            self._step(release, facts.spacecraft, Cancel(at, run.by, command.counter))
        if view.state in {verdict.value for verdict in _TOLD}:
            self._step(release, facts.spacecraft, SignJudged(at, run.axis, SignState(view.state)))
        release.case.put(at, view)

    def _show(self, release: SpacecraftRelease, view: SignCheckView, at: Instant) -> None:
        """Store how far a check is, where that is news: what the likelihoods do from row to row is none."""
        told = release.case.sign_check
        if told is None or replace(told, log_ratio=None) != replace(view, log_ratio=None):
            release.case.put(at, view)


def _take_in(run: SignCheckRun, release: SpacecraftRelease) -> str:
    """Take in what became of the leg that is out; return what ends the check, if anything does."""
    if release.case.state.interlock.state is State.TRIPPED:
        return "control tripped"
    command = None if run.pending is None else command_of(release.case.state, run.pending)
    if command is None or command.life in OPEN or command.life in UNREPORTED:
        return ""
    run.pending = None
    if command.life is CommandState.EXECUTED:
        run.done.append(schedule_of(command.executed, command.proposal.start_us))
    elif command.executed:
        return f"leg {command.counter} was carried out in part"
    return ""


def _view(
    run: SignCheckRun, state: str, decision: SignDecision | None, wheels: SignState | None = None, detail: str = ""
) -> SignCheckView:
    """Return a check as it is told."""
    ratio = None if decision is None else SignRatios(*decision.log_ratio)
    return SignCheckView(
        axis=run.axis,
        state=state,
        started_us=run.started_us,
        started_by=run.by,
        until_us=run.until_us,
        legs=len(run.profile.legs),
        legs_done=len(run.done),
        log_ratio=ratio,
        wheels=None if wheels is None else wheels.value,
        detail=detail,
    )
