"""Control centre of the demonstration: takes the service's commands to the spacecraft, over the public interface alone.

Release ``automatic``: the command of each row goes up as soon as it is computed, and counts as applied from its epoch.
"""

import time
from collections import Counter
from dataclasses import dataclass, field
from typing import ClassVar

from service.client.documents import Json
from service.client.service_client import ServiceClient
from service.records.epoch import US_PER_S, parse_epoch
from service.study.demonstration.merit import AXES
from service.study.demonstration.spacecraft_line import SpacecraftLine, SpacecraftReport

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

    def on_input(self, report: SpacecraftReport) -> None:
        """Take what the spacecraft tells of a command."""
        command = self.sent[report.counter]
        if report.state == "repeated":
            command.is_twice = True
            return
        command.state = report.state
        if report.state == "executed" and report.executed_until is not None:
            begun = [one for one in command.schedule if one["start"] < report.executed_until]
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
