"""Events that each row brings about: the interlock gets it, the law may send, a sign check goes on, angles go up."""

import logging
import math

from service.core.control.slew_schedule import Effect
from service.pipeline.control.release.command_states import OPEN, UNREPORTED
from service.pipeline.control.release.events import (
    AnglesFit,
    Applied,
    Automatic,
    ResponseJudged,
    RowSeen,
    StoredRow,
)
from service.pipeline.control.release.interlock import Instant
from service.pipeline.control.release.interlock_states import State
from service.pipeline.control.release.proposals import effect_of_law, proposal_of
from service.pipeline.control.release.settings import microseconds
from service.pipeline.control.release.sign_checks import is_running
from service.records.catalogue import ControlMode, Spacecraft
from service.records.levels.attitude import AttitudeRow
from service.records.levels.command import TorqueCommand
from service.records.operations.release import ProductForm, UplinkProduct
from service.runtime.control.proposals import computed_command, soonest_start_us
from service.runtime.control.refusal_errors import release_refusal
from service.runtime.control.release_context import ReleaseContext
from service.runtime.control.sign_checks import continue_sign_check

_LOG = logging.getLogger("soo.release")

_UNKNOWN = (math.nan, math.nan, math.nan)
#: of a schedule that cannot be followed: beyond every envelope
_BOUNDLESS = Effect(_UNKNOWN, _UNKNOWN, _UNKNOWN, _UNKNOWN, _UNKNOWN, _UNKNOWN, ())
_REASON = "standing authorisation"


def handle_row(context: ReleaseContext, stored: StoredRow, row: AttitudeRow, at: Instant, *, may_send: bool) -> None:
    """Handle what follows from a row of the method that drives control."""
    release, spacecraft = context.release, context.spacecraft
    release.handle(RowSeen(at, context.row_facts(row)))
    if stored.outcome.applied is not None:
        release.handle(Applied(at, _effect(stored.outcome.applied.command, spacecraft)))
    evidence = stored.evidence
    if evidence is not None and not evidence.missed_log_ratio <= context.settings.missed_log_ratio:
        release.handle(ResponseJudged(at, evidence.missed_log_ratio))
    if evidence is not None and context.sign_rows is not None:
        context.sign_rows.append(row.epoch_us, evidence.model, evidence.deviation_db)
    continue_sign_check(context, at)
    if may_send:
        _send(context, at)
        _give_angles(context, row, at)


def _send(context: ReleaseContext, at: Instant) -> None:
    """Offer the law's command to a standing authorisation, once a command period, while nothing else is out."""
    spacecraft, state = context.spacecraft, context.state
    is_checking = is_running(state.sign_check)
    if state.interlock.state is not State.ENGAGED or release_refusal(spacecraft) or is_checking:
        return
    period_s = spacecraft.control.command_period_s
    newest_us = max([context.asked_us, *(each.released_us or 0 for each in state.commands)])
    is_busy = any(each.state in OPEN or each.state in UNREPORTED for each in state.commands)
    if is_busy or at.now_us - newest_us < microseconds(period_s):
        return
    context.asked_us = at.now_us
    computed = computed_command(context, soonest_start_us(at.now_us, context.settings), period_s)
    if not computed.schedule:
        return
    step = context.release.handle(Automatic(at, proposal_of(computed, spacecraft, _REASON)))
    if step.refusal is not None:
        _LOG.warning("automatic command of %s refused: %s (%s)", spacecraft.id, step.refusal.detail, step.refusal.code)


def _give_angles(context: ReleaseContext, row: AttitudeRow, at: Instant) -> None:
    """Store angles for a spacecraft that computes its torques itself, while nothing stands against them."""
    spacecraft, interlock = context.spacecraft, context.state.interlock
    is_fit = row.control_allowed and not interlock.inhibiting and interlock.state is not State.TRIPPED
    if spacecraft.control.mode is not ControlMode.ONBOARD or not is_fit:
        return
    newest = context.storage.releases.newest_product(spacecraft.id, ProductForm.ATTITUDE)
    counter = 1 if newest is None else newest.counter + 1
    product = UplinkProduct(
        form=ProductForm.ATTITUDE,
        counter=counter,
        created_us=at.now_us,
        valid_from_us=row.epoch_us,
        valid_until_us=row.epoch_us + context.stale_us,
        attitude_epoch_us=row.epoch_us,
        is_simulated=spacecraft.simulated,
        attitude_deg=row.attitude_deg,
        sigma_deg=row.sigma_deg,
    )
    context.release.handle(AnglesFit(at, product))


def _effect(command: TorqueCommand, spacecraft: Spacecraft) -> Effect:
    """Return the effect of a computed command; one that cannot be predicted is beyond every envelope."""
    try:
        return effect_of_law(command, spacecraft)
    except ValueError:
        return _BOUNDLESS
