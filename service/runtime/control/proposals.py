"""Proposals for release: commands of the control law, for persons and for a standing authorisation."""

from dataclasses import replace

from service.errors import ConflictError, InvalidInputError
from service.pipeline.control.command.compute_command import command_for
from service.pipeline.control.command.schedule_check import PanelSwing, swing_after
from service.pipeline.control.release.advance import settled_at
from service.pipeline.control.release.interlock import Instant, Interlock
from service.pipeline.control.release.interlock_conditions import OWN_AFFAIR
from service.pipeline.control.release.proposals import proposal_of
from service.pipeline.control.release.release_checks import release_checks
from service.pipeline.control.release.settings import ReleaseSettings, microseconds
from service.ports import Releases
from service.records.calibration import Window
from service.records.catalogue import Spacecraft
from service.records.epoch import US_PER_S
from service.records.levels.attitude import AttitudeRow
from service.records.levels.command import TorqueCommand
from service.records.operations.release import Command, CommandRequest
from service.runtime.control.release_context import ReleaseContext

#: what was sent longer ago has left nothing in the flexible modes
_SWING_US = 3 * 3600 * US_PER_S
_COMMANDS_AT_ONCE = 500


def requested(context: ReleaseContext, request: CommandRequest, at: Instant) -> Command:
    """Return what a person requests as a proposal, with every check as it stands.

    ConflictError ``command.no_estimate``, ``command.estimate_stale``; InvalidInputError ``command.wish``.
    """
    row, settings, spacecraft = context.row, context.settings, context.spacecraft
    epoch_us = request.attitude_epoch_us
    if epoch_us is not None and not 0 <= row.epoch_us - epoch_us <= context.stale_us:
        raise ConflictError("command.estimate_stale", "attitude_epoch is not that of a recent estimate")
    start_us = request.start_us or soonest_start_us(at.now_us, settings, settings.confirm_s)
    duration_s = request.duration_s or spacecraft.control.forecast_horizon_s
    if not 0.0 < duration_s <= settings.latest_stop_s:
        raise InvalidInputError("command.wish", f"duration_s must lie between 0 and {settings.latest_stop_s:g} s")
    if not -US_PER_S <= start_us - at.now_us <= microseconds(settings.latest_stop_s):
        detail = f"start must lie ahead of the spacecraft's clock by at most {settings.latest_stop_s:g} s"
        raise InvalidInputError("command.wish", detail)
    computed = computed_command(context, start_us, duration_s, request.max_torque_n_m)
    try:
        command = proposal_of(computed, spacecraft, request.reason)
    except ValueError as error:
        raise InvalidInputError("command.wish", str(error)) from error
    settled = settled_at(context.state, at, settings)
    return replace(command, checks=release_checks(settled, command, at, settings))


def computed_command(
    context: ReleaseContext, start_us: int, duration_s: float, max_torque_n_m: float | None = None
) -> TorqueCommand:
    """Return the command of the law from an instant on, without what the interlock withholds."""
    row, facts = context.row, context.facts
    rate_age_s = context.torque.rate_stale_periods * context.period_s + context.torque.rate_stale_margin_s
    return command_for(
        allowed_row(row, context.state.interlock),
        context.spacecraft,
        start_us,
        duration_s,
        max_torque_n_m,
        context.torque,
        None if context.stored is None else context.stored.outcome.disturbance,
        facts.momentum_n_m_s(row.epoch_us),
        swing=swing_left(context.storage.releases, context.spacecraft, start_us),
        body_rate_deg_s=facts.body_rate_deg_s(row.epoch_us, rate_age_s),
    )


def allowed_row(row: AttitudeRow, interlock: Interlock) -> AttitudeRow:
    """Return a row with the reasons and axes that hold for the release.

    The interlock judges range and sigma itself, by limits that let an approver bring a spacecraft back from beyond the
    range of automatic control.
    """
    reasons = tuple(reason for reason in row.inhibitions if reason not in OWN_AFFAIR)
    yaw, roll, pitch = row.control_allowed_axes
    if not reasons:
        roll = pitch = True
    return replace(
        row,
        inhibitions=reasons,
        control_allowed=not reasons,
        control_allowed_axes=(yaw and not interlock.is_yaw_withheld, roll, pitch),
    )


def swing_left(releases: Releases, spacecraft: Spacecraft, now_us: int) -> PanelSwing | None:
    """Return what released schedules have left in the flexible modes; unreported ones count as carried out."""
    if not spacecraft.modes:
        return None
    swing = None
    window = Window(now_us - _SWING_US, now_us + 1)
    for command in releases.commands(spacecraft.id, window, _COMMANDS_AT_ONCE, None):
        if command.released_us is not None:
            schedule = command.schedule if command.reported_us is None else command.executed
            swing = swing_after(swing, schedule, spacecraft)
    return swing


def soonest_start_us(now_us: int, settings: ReleaseSettings, waiting_s: float = 0.0) -> int:
    """Return when a schedule may begin at the soonest; persons get so long to confirm it."""
    return now_us + microseconds(settings.uplink_lead_s + waiting_s)
