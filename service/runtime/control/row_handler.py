"""What each row brings about: the interlock sees it, the law may send, a sign check goes on, angles go up."""

import logging
import math

from service.core.control.slew_schedule import Effect
from service.pipeline.config import TorqueConfig
from service.pipeline.control.release.command_states import OPEN, UNREPORTED
from service.pipeline.control.release.events import (
    Applied,
    Automatic,
    ResponseJudged,
    RowSeen,
)
from service.pipeline.control.release.interlock import Instant
from service.pipeline.control.release.interlock_states import State
from service.pipeline.control.release.proposals import effect_of, proposal_of
from service.pipeline.control.release.row_facts import SeenRow
from service.pipeline.control.release.settings import ReleaseSettings, microseconds
from service.ports import Storage
from service.records.catalogue import ControlMode, Release, Spacecraft
from service.records.levels.attitude import AttitudeRow
from service.records.levels.command import TorqueCommand
from service.records.operations.release import ProductForm
from service.runtime.control.persisted_release import Annex
from service.runtime.control.proposals import Proposals, soonest_start_us
from service.runtime.control.release_inputs import KnownFacts
from service.runtime.control.sign_checks import SignChecks
from service.runtime.control.spacecraft_release import SpacecraftRelease, Stepper
from service.runtime.control.views import Dress, attitude_product

_LOG = logging.getLogger("soo.release")

_UNKNOWN = (math.nan, math.nan, math.nan)
#: of a schedule that cannot be followed: beyond every envelope
_BOUNDLESS = Effect(_UNKNOWN, _UNKNOWN, _UNKNOWN, _UNKNOWN, _UNKNOWN, _UNKNOWN, ())
_REASON = "standing authorisation"


class RowHandler:
    """Work of the release service that rows and time bring about.

    Parameters
    ----------
    storage : Storage
        Where products and telemetry lie.
    settings : ReleaseSettings
        Limits and times.
    torque : TorqueConfig
        Of the control law.
    step : Stepper
        Judges and stores.
    proposals : Proposals
        Asks the law.
    """

    def __init__(
        self, storage: Storage, settings: ReleaseSettings, torque: TorqueConfig, step: Stepper, proposals: Proposals
    ) -> None:
        self._storage = storage
        self._settings = settings
        self._step = step
        self._proposals = proposals
        self.sign_checks = SignChecks(storage, settings, torque, step)

    def see(
        self,
        release: SpacecraftRelease,
        facts: KnownFacts,
        seen: SeenRow,
        row: AttitudeRow,
        at: Instant,
        *,
        may_send: bool,
    ) -> None:
        """Let a row of the method that drives control, with what came beside it, bring about what follows."""
        craft = facts.spacecraft
        self._step(release, craft, RowSeen(at, release.row_facts(row)))
        if seen.outcome.applied is not None:
            self._step(release, craft, Applied(at, _effect(seen.outcome.applied.command, craft)))
        evidence = seen.evidence
        if evidence is not None and not evidence.missed_log_ratio <= self._settings.missed_log_ratio:
            self._step(release, craft, ResponseJudged(at, evidence.missed_log_ratio))
        if evidence is not None and release.run is not None:
            release.run.see(row.epoch_us, evidence.model, evidence.deviation_db)
        self.sign_checks.go_on(release, facts, at)
        if may_send:
            self._send(release, facts, at)
            self._give_angles(release, facts, row, at)

    def go_on(self, release: SpacecraftRelease, facts: KnownFacts, at: Instant) -> None:
        """Let time, or a report, bring about what follows."""
        self.sign_checks.go_on(release, facts, at)

    def _send(self, release: SpacecraftRelease, facts: KnownFacts, at: Instant) -> None:
        """Offer what the law wants to a standing authorisation, once a command period, while nothing else is out."""
        craft, control = facts.spacecraft, facts.spacecraft.control
        if (
            release.case.state.interlock.state is not State.ENGAGED
            or not _is_for_release(craft)
            or release.run is not None
        ):
            return
        commands = release.case.state.commands
        newest_us = max([release.asked_us, *(each.released_us or 0 for each in commands)])
        is_busy = any(each.life in OPEN or each.life in UNREPORTED for each in commands)
        if is_busy or at.now_us - newest_us < microseconds(control.command_period_s):
            return
        release.asked_us = at.now_us
        start_us = soonest_start_us(at.now_us, self._settings)
        command = self._proposals.law(release, craft, start_us, control.command_period_s)
        if not command.schedule:
            return
        proposal = proposal_of(command, craft, _REASON)
        step = self._step(release, craft, Automatic(at, proposal), Annex(Dress(craft, computed=command)))
        if step.refusal is not None:
            _LOG.warning("release of %s: %s (%s)", craft.id, step.refusal.detail, step.refusal.code)

    def _give_angles(self, release: SpacecraftRelease, facts: KnownFacts, row: AttitudeRow, at: Instant) -> None:
        """Store angles for a craft that computes its torques itself, while nothing stands against them."""
        craft, interlock = facts.spacecraft, release.case.state.interlock
        is_fit = row.control_allowed and not interlock.inhibiting and interlock.state is not State.TRIPPED
        if craft.control.mode is not ControlMode.ONBOARD or not is_fit:
            return
        newest = self._storage.releases.newest_product(craft.id, ProductForm.ATTITUDE)
        stale_s = self._settings.stale_periods * release.period_s + self._settings.stale_margin_s
        product = attitude_product(
            row,
            1 if newest is None else newest.counter + 1,
            at.now_us,
            row.epoch_us + microseconds(stale_s),
            is_simulated=craft.simulated,
        )
        release.case.put(at, release.case.sign_check, product)


def _is_for_release(spacecraft: Spacecraft) -> bool:
    """Whether commands of a spacecraft are released one by one."""
    is_able = spacecraft.onboard.fast_loop and spacecraft.onboard.forecast_mode
    return is_able and spacecraft.control.mode is ControlMode.GROUND and spacecraft.control.release is Release.TWO_STEP


def _effect(command: TorqueCommand, spacecraft: Spacecraft) -> Effect:
    """Return what a computed command does; what cannot be told is beyond every envelope."""
    try:
        return effect_of(command, spacecraft)
    except ValueError:
        return _BOUNDLESS
