"""Control centre of two persons: takes up released commands alone, and reports them sent and executed or failed.

The virtual clock runs fast until control is armed, then at a pace that persons can follow: slowest while a prepared
command waits for its confirmation, fast again once a released one is under way.
"""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import ClassVar, NamedTuple

from service.client.documents import Control
from service.client.problem import ProblemError
from service.client.service_client import ServiceClient
from service.records.epoch import parse_epoch
from service.study.demonstration.control_centre import ControlCentre, SentCommand
from service.study.demonstration.spacecraft_line import SpacecraftReport

#: interval between two requests for the state of control, s
_POLL_S = 0.25
#: reasons under which control can be armed: that it is not armed, and those that withhold yaw alone
_ARMABLE = {"not_armed", "sigma_yaw", "yaw_sign", "yaw_beyond"}
#: fates of a command of which the spacecraft executed nothing
_NOTHING_EXECUTED = {"late", "refused", "replaced"}


class RowPaces(NamedTuple):
    """Wall time of a row after control was armed, s."""

    #: nothing waits for a person
    idle_s: float = 5.0
    #: a prepared command waits; with 10 rows of waiting it can be read for 2.5 min
    prepared_s: float = 15.0
    #: a released command has not been reported
    under_way_s: float = 0.5


@dataclass
class TwoStepCentre(ControlCentre):
    """Takes released commands to the spacecraft.

    Parameters
    ----------
    client, line : ServiceClient, SpacecraftLine
        As of `ControlCentre`.
    operator : ServiceClient
        With the key of the operator, in whose name control is armed.
    paces : RowPaces
        Wall time of a row.
    """

    release: ClassVar[str] = "two_step"
    rows_a_scene: ClassVar[int] = 1

    operator: ServiceClient = field(kw_only=True)
    paces: RowPaces = field(default_factory=RowPaces)
    is_armed: bool = False

    def steer(self, spacecraft_id: str, epoch: str) -> None:
        """Report what the spacecraft says until a row, and take up what is released until the row's time is over.

        Raises
        ------
        SpacecraftLineError
            A schedule was refused.
        TimeoutError
            The service computed no row of this epoch.
        """
        began = time.monotonic()
        reports = self.line.await_flown(epoch)
        # reports name instants up to this row, which is the present of the service once it has computed it
        self._await_command(spacecraft_id, epoch)
        for report in reports:
            self._report(spacecraft_id, report)
        self.log.newest_us = parse_epoch(epoch)
        self.log.rows += 1
        control = self._send_released(spacecraft_id)
        self.log.inhibited_rows += not control["control"]["allowed"]
        self.log.inhibitions.update(control["reasons"] if not control["control"]["allowed"] else ())
        self._arm(spacecraft_id, control)
        while (wait_s := began + self._row_s(control) - time.monotonic()) > 0.0:
            time.sleep(min(wait_s, _POLL_S))
            control = self._send_released(spacecraft_id)

    def _arm(self, spacecraft_id: str, control: Control) -> None:
        """Arm control once, as soon as nothing else withholds roll and pitch; after a trip persons arm again."""
        if self.is_armed or control["armed"]:
            self.is_armed = True
        elif set(control["reasons"]) <= _ARMABLE:
            with _tolerated("interlock."):
                self.operator.order_control(spacecraft_id, "arm", "armed by the demonstration")
                self.is_armed = True

    def _row_s(self, control: Control) -> float:
        """Return the wall time of the present row."""
        if not self.is_armed:
            return 0.0
        if control["open_commands"]:
            return self.paces.prepared_s
        return self.paces.under_way_s if control["unreported_commands"] else self.paces.idle_s

    def _send_released(self, spacecraft_id: str) -> Control:
        """Send every command that was released, report it sent, and return the state of control before that."""
        control = self.client.control(spacecraft_id)
        for counter in control["unreported_commands"]:
            if counter not in self.log.sent:
                schedule = self.client.uplink(spacecraft_id, counter)["schedule"]
                self.log.sent[counter] = SentCommand(schedule)
                self.line.send(schedule, counter)
                with _tolerated("command."):
                    self.client.report_torques(spacecraft_id, counter, "sent")
        return control

    def _report(self, spacecraft_id: str, report: SpacecraftReport) -> None:
        """Report to the service what the spacecraft says of a command; only a part executed is stated as one."""
        self.log.on_input(report)
        counter = report.counter
        with _tolerated("command."):
            if report.state in _NOTHING_EXECUTED:
                self.client.report_torques(spacecraft_id, counter, "failed")
            elif report.state == "executed" and report.executed_until is not None:
                is_whole = parse_epoch(report.executed_until) >= self.log.sent[counter].stop_us
                until = None if is_whole else report.executed_until
                self.client.report_torques(spacecraft_id, counter, "executed", executed_until=until)


@contextmanager
def _tolerated(codes: str) -> Iterator[None]:
    """Pass over a refusal by these codes: a person at the console was faster, and the service keeps what it said."""
    try:
        yield
    except ProblemError as error:
        if not error.code.startswith(codes):
            raise
