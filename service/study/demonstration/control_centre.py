"""Control centres of the demonstration, and the line of the simulator that takes their schedules."""

import json
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, ClassVar, NamedTuple

from service.client.documents import Control, Json
from service.client.problem import ProblemError
from service.client.service_client import ServiceClient
from service.records.epoch import US_PER_S, parse_epoch
from service.study.closed_loop.plant_process import CommandReport, read_report
from service.study.demonstration.processes import SimulatorLine

AXES = ("yaw", "roll", "pitch")


class SpacecraftLineError(Exception):
    """The line to the spacecraft broke, or it refused a schedule; the text gives the reason."""


class SpacecraftLine(SimulatorLine):
    """Client of the uplink port."""

    def __init__(self, host: str, port: int, timeout_s: float = 120.0) -> None:
        super().__init__(host, port, timeout_s)
        self._reports: list[CommandReport] = []
        self._flown = ""
        try:
            #: torque that the loop on board feeds forward, as the catalogue states one; None = nothing was said of it
            self.fed_forward: Json | None = self._consume("start").get("fed_forward_torque")
        except BaseException:
            self.close()
            raise

    def send(self, schedule: Sequence[Mapping[str, Any]], counter: int) -> None:
        """Hand a schedule to the channel.

        Raises
        ------
        SpacecraftLineError
            It was refused.
        """
        line = json.dumps({"schedule": list(schedule), "counter": counter})
        self._socket.sendall(line.encode() + b"\n")
        self._consume("taken")

    def await_flown(self, epoch: str) -> list[CommandReport]:
        """Wait until the spacecraft has come to the row of an epoch and return what it has told since the last call."""
        while self._flown < epoch:
            self._flown = self._consume("flown")["epoch"]
        reported, self._reports = self._reports, []
        return reported

    def _consume(self, wanted: str) -> Json:
        """Return the next line of a type; reports before it are kept."""
        while True:
            text = self._lines.readline()
            if not text:
                raise SpacecraftLineError("the spacecraft has closed its line")
            line: Json = json.loads(text)
            if line["type"] == "error":
                raise SpacecraftLineError(f"the spacecraft's line refused: {line['detail']}")
            if line["type"] == "report":
                self._reports.append(read_report(line))
            if line["type"] == "flown":
                self._flown = line["epoch"]
            if line["type"] == wanted:
                return line


#: bounds hangs: the first row may wait for the compiler on a busy machine
_COMMAND_TIMEOUT_S = 600.0
#: a row that waited for the compiler must not slow those after it
_LONGEST_WAIT_S = 0.25
#: a command of which nothing was heard so long after its end is lost
_OVERDUE_S = 300
#: time between two looks, of the time that a command usually takes, and the least of it, s
_POLL_SHARE, _LEAST_POLL_S = 0.2, 0.002


@dataclass
class SentCommand:
    """A command that went up."""

    schedule: list[Json]
    #: what the spacecraft told of it last, empty = nothing yet; a second arrival apart
    state: str = ""
    is_twice: bool = False

    @property
    def stop_us(self) -> int:
        """When its last element ends."""
        ends = (parse_epoch(one["start"]) + round(float(one["duration_s"]) * US_PER_S) for one in self.schedule)
        return max(ends)


@dataclass
class ControlLog:
    """Log of a control centre: rows, inhibitions, commands sent and impulses executed."""

    rows: int = 0
    inhibited_rows: int = 0
    #: rows by reason; a row may have several
    inhibitions: Counter[str] = field(default_factory=Counter)
    sent: dict[int, SentCommand] = field(default_factory=dict)
    #: N m s, sum of the sizes of all elements that were executed
    impulse_n_m_s: dict[str, float] = field(default_factory=lambda: dict.fromkeys(AXES, 0.0))
    newest_us: int = 0

    def on_input(self, report: CommandReport) -> None:
        """Take what the spacecraft tells of a command."""
        command = self.sent[report.counter]
        if report.state == "repeated":
            command.is_twice = True
            return
        command.state = report.state
        if report.state == "executed" and report.executed_until_us is not None:
            begun = [one for one in command.schedule if parse_epoch(one["start"]) < report.executed_until_us]
            for axis in AXES:
                self.impulse_n_m_s[axis] += sum(abs(one[f"{axis}_n_m"]) * one["duration_s"] for one in begun)

    def counts(self) -> dict[str, int]:
        """Return how many commands went up and what became of them."""
        states = Counter(command.state for command in self.sent.values())
        reported = {name: states[name] for name in ("executed", "executing", "replaced", "late", "refused")}
        overdue_us = self.newest_us - _OVERDUE_S * US_PER_S
        silent = [command for command in self.sent.values() if not command.state]
        lost = sum(command.stop_us <= overdue_us for command in silent)
        twice = sum(command.is_twice for command in self.sent.values())
        return {"sent": len(self.sent), **reported, "lost": lost, "under_way": len(silent) - lost, "twice": twice}


@dataclass
class ControlCentre:
    """Takes commands from the service to the spacecraft.

    Parameters
    ----------
    client : ServiceClient
        Of the service.
    line : SpacecraftLine
        Way to the spacecraft.
    """

    #: release of the spacecraft's commands, and rows between two scenes
    release: ClassVar[str] = "automatic"
    rows_a_scene: ClassVar[int] = 60

    client: ServiceClient
    line: SpacecraftLine
    log: ControlLog = field(default_factory=ControlLog)
    #: time that a command usually takes, s
    _usual_s: float = 0.02

    def is_shown(self) -> bool:
        """Return whether the display follows the newest row."""
        return self.log.rows > 0 and (self.log.rows - 1) % self.rows_a_scene == 0

    def steer(self, spacecraft_id: str, epoch: str) -> None:
        """Hear what the spacecraft tells until a row, and send the command that follows from the row.

        Raises
        ------
        SpacecraftLineError
            The schedule was refused.
        TimeoutError
            The service computed no command of this row.
        """
        for report in self.line.await_flown(epoch):
            self.log.on_input(report)
        command = self._await_command(spacecraft_id, epoch)
        self.log.newest_us = parse_epoch(epoch)
        self.log.rows += 1
        control = command["control"]
        self.log.inhibited_rows += not control["allowed"]
        self.log.inhibitions.update(reason["code"] for reason in control["reasons"] if not control["allowed"])
        if control["allowed"] and command["schedule"]:
            counter = len(self.log.sent) + 1
            self.log.sent[counter] = SentCommand(command["schedule"])
            self.line.send(command["schedule"], counter)

    def _await_command(self, spacecraft_id: str, epoch: str) -> Json:
        """Return the command of a row as soon as it is there; looking earlier would cost the service time."""
        began = time.monotonic()
        wait_s = min(0.7 * self._usual_s, _LONGEST_WAIT_S)
        while time.monotonic() < began + _COMMAND_TIMEOUT_S:
            time.sleep(wait_s)
            command = self.client.torques(spacecraft_id)
            if command["attitude_epoch"] is not None and command["attitude_epoch"] >= epoch:
                self._usual_s += 0.1 * (time.monotonic() - began - self._usual_s)
                return command
            wait_s = max(_POLL_SHARE * self._usual_s, _LEAST_POLL_S)
        message = f"no command of {epoch} within {_COMMAND_TIMEOUT_S:.0f} s"
        raise TimeoutError(message)


#: interval between two requests for the state of control, s
_POLL_S = 0.25
#: reasons under which control can be armed: that it is not armed, and those that withhold yaw alone
_ARMABLE = {"not_armed", "yaw_uncertain", "yaw_sign"}
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

    def _report(self, spacecraft_id: str, report: CommandReport) -> None:
        """Report to the service what the spacecraft says of a command; only a part executed is stated as one."""
        self.log.on_input(report)
        counter = report.counter
        with _tolerated("command."):
            if report.state in _NOTHING_EXECUTED:
                self.client.report_torques(spacecraft_id, counter, "failed")
            elif report.state == "executed" and report.executed_until_us is not None:
                is_whole = report.executed_until_us >= self.log.sent[counter].stop_us
                until_us = None if is_whole else report.executed_until_us
                self.client.report_torques(spacecraft_id, counter, "executed", executed_until=until_us)


@contextmanager
def _tolerated(codes: str) -> Iterator[None]:
    """Pass over a refusal by these codes: a person at the console was faster, and the service keeps what it said."""
    try:
        yield
    except ProblemError as error:
        if not error.code.startswith(codes):
            raise
