"""Validity of what is newest: an old row, or one behind which others wait for a restarted chain, is not the present.

History is not rewritten: only the newest answer says EXPIRED, under the system clock from the limit on and until a
newer row comes, and catch_up while the chain is brought back.
"""

from dataclasses import replace

from service.api.context.dependencies import ApiContext
from service.pipeline.control.command.compute_command import ended_command
from service.ports import LIVE
from service.records.catalogue import Method, Spacecraft
from service.records.epoch import US_PER_S
from service.records.levels.attitude import AttitudeRow, Status
from service.records.levels.command import TorqueCommand

#: the reason of an answer that outlived its row
EXPIRED = "expired"
#: the reason of an answer while the chain is brought back after a restart
CATCH_UP = "catch_up"


def newest_attitude(context: ApiContext, spacecraft_id: str, method: Method) -> AttitudeRow | None:
    """Return the newest live row of a method as it holds now; None before the first."""
    row = context.storage.results.newest_attitude(spacecraft_id, LIVE, method)
    if row is None:
        return None
    if context.supervisor.is_catching_up(spacecraft_id):
        row = _not_present(row, row.status, CATCH_UP)
    return _not_present(row, Status.EXPIRED, EXPIRED) if _is_expired(context, spacecraft_id, row) else row


def newest_command(
    context: ApiContext, spacecraft: Spacecraft, row: AttitudeRow | None, *, is_withheld: bool
) -> TorqueCommand | None:
    """Return the newest command as it holds now, given the newest row of the method that drives control.

    A row from which nothing was computed stores no command, yet it ends the one before, and so does a trip: the answer
    is then the zero command that follows from that row, with its reasons. None before the first command.
    """
    # read after the row: a row and its command are stored together, so this one is as new as the row or newer
    command = context.storage.results.newest_command(spacecraft.id, LIVE)
    if command is None or row is None:
        return command
    is_ended = command.attitude_epoch_us < row.epoch_us and bool(row.inhibitions)
    is_present = {EXPIRED, CATCH_UP}.isdisjoint(row.inhibitions)
    if is_present and not is_ended and not (is_withheld and command.control_allowed):
        return command
    return ended_command(row, spacecraft, command.command_period_s, is_withheld=is_withheld)


def _is_expired(context: ApiContext, spacecraft_id: str, row: AttitudeRow) -> bool:
    """Return whether a row is too old to be the present."""
    if context.clock.is_data(spacecraft_id):
        return False
    now_us = context.clock.now_us(spacecraft_id)
    return now_us is not None and now_us - row.epoch_us > context.limits.expired_after_s * US_PER_S


def _not_present(row: AttitudeRow, status: Status, reason: str) -> AttitudeRow:
    """Return a row as it holds when it is not the present."""
    return replace(
        row,
        status=status,
        control_allowed=False,
        control_allowed_axes=(False, False, False),
        inhibitions=tuple(dict.fromkeys((*row.inhibitions, reason))),
    )
