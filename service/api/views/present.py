"""The present of one spacecraft: newest row and command as they hold now, and the one verdict on control."""

from typing import NamedTuple

from service.api.context.dependencies import ApiContext
from service.api.views.newest import newest_attitude, newest_command
from service.errors import StorageError
from service.pipeline.control.release.control_verdict import ControlVerdict, ControlView, control_verdict
from service.records.catalogue import Spacecraft
from service.records.levels.attitude import AttitudeRow
from service.records.levels.command import TorqueCommand


class Present(NamedTuple):
    """State of the present that every answer about it shares."""

    #: of the method that drives control
    row: AttitudeRow | None
    command: TorqueCommand | None
    verdict: ControlVerdict


def present_of(context: ApiContext, spacecraft: Spacecraft, view: ControlView | None = None) -> Present:
    """Return the present; a view that an order has just given stands for the interlock."""
    row = newest_attitude(context, spacecraft.id, spacecraft.control.method)
    if view is None:
        try:
            view = context.release_service.control(spacecraft.id)
        except StorageError:
            # estimation can be read while nothing can be stored
            view = None
    command = newest_command(context, spacecraft, row, is_withheld=view is not None and view.is_withheld)
    return Present(row, command, control_verdict(view, row if command is None else command))
