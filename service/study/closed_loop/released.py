"""Control over a link, released in two steps: what the centre does with the commands of the service.

Every command period, while nothing is inhibited or the known torque may be balanced, one command goes out for its whole
horizon; beyond 0.4 deg of roll or pitch it is a person who releases it (RECOVERY), up to 0.6 deg. From its release to
its report the chain takes its effect for uncertain. The report comes when the slew has been told by the spacecraft, or
when it should have been and was not: then nothing of it was executed, as far as anybody knows. What the spacecraft
executes afterwards, the pulses against the known torque, the chain hears of as it is told.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from service.pipeline.chain import Chain
from service.pipeline.config import TorqueConfig
from service.pipeline.control.command.compute_command import command_for
from service.ports import Outcome
from service.records.catalogue import Spacecraft
from service.records.epoch import US_PER_S
from service.records.levels.attitude import (
    NO_AXES,
    AppliedCommand,
    AttitudeRow,
    Pulse,
    ReleasedCommand,
    ReportedCommand,
    TorqueCommand,
)
from service.records.levels.measurement import Measurement
from service.study.closed_loop.plant_process import CommandReport

#: a report that has not come so long after the end of the slew does not come any more, s
_REPORT_TIMEOUT_S = 60.0
#: up to which roll and pitch a person may bring back a spacecraft that has left the range of automatic release, deg
_RECOVERY_DEG = 0.6
_EXECUTED = frozenset({"executed", "executing"})


@dataclass
class Released:
    """A command that has gone out."""

    counter: int
    command: TorqueCommand
    #: when the slew is over
    slew_stop_us: int
    is_reported: bool = False
    #: pulses that the chain has heard of as executed
    announced: int = 0

    def executed(self, until_us: int) -> tuple[Pulse, ...]:
        """Return what has begun by an epoch."""
        return tuple(pulse for pulse in self.command.schedule if pulse.start_us < until_us)

    @property
    def slew_end_us(self) -> int:
        """When the last pulse ends that the next command waits for; 0 = there is none."""
        due = [pulse for pulse in self.command.schedule if pulse.start_us <= self.slew_stop_us]
        return max((pulse.start_us + round(pulse.duration_s * US_PER_S) for pulse in due), default=0)


@dataclass
class Releaser:
    """Release of the chain's commands to the spacecraft.

    Parameters
    ----------
    chain : Chain
        Of the spacecraft.
    spacecraft : Spacecraft
        Release in two steps.
    lead_s : float, s
        The slowest way to the spacecraft.
    config : TorqueConfig
        Of the chain.
    """

    chain: Chain
    spacecraft: Spacecraft
    lead_s: float
    config: TorqueConfig
    _flying: list[Released] = field(default_factory=list)
    _due_us: int = 0

    def wanted(self, outcome: Outcome, row: AttitudeRow, measurement: Measurement, counter: int) -> tuple[Pulse, ...]:
        """Return the schedule that goes out under a counter after a row; empty: nothing does."""
        now_us = measurement.epoch_us
        self._give_up(now_us)
        is_waiting = any(not flying.is_reported for flying in self._flying)
        row = _as_recovery(row)
        axes = NO_AXES if outcome.command is None else outcome.command.balance_allowed_axes
        if (row.inhibitions and not any(axes)) or is_waiting or now_us < self._due_us:
            return ()
        command = command_for(
            row,
            self.spacecraft,
            now_us + round(self.lead_s * US_PER_S),
            self.spacecraft.control.forecast_horizon_s,
            None,
            self.config,
            outcome.disturbance,
            balance=axes if row.inhibitions else None,
        )
        if not command.schedule:
            return ()
        slew_s = self.config.slew_share * self.spacecraft.control.command_period_s
        self._flying.append(Released(counter, command, command.epoch_us + round(slew_s * US_PER_S)))
        self._due_us = now_us + round(self.spacecraft.control.command_period_s * US_PER_S)
        self.chain.update(ReleasedCommand(counter, now_us, command.schedule))
        return command.schedule

    def on_input(self, reports: Sequence[CommandReport]) -> None:
        """Tell the chain what the spacecraft has told."""
        for report in reports:
            for flying in self._flying:
                if flying.counter == report.counter and report.state != "repeated":
                    self._consume(flying, report)

    def _consume(self, flying: Released, report: CommandReport) -> None:
        """Take one report of one command."""
        if report.state not in _EXECUTED or report.executed_until_us is None:
            self._report(flying, (), report.reported_us)
            self._flying.remove(flying)
            return
        executed = flying.executed(report.executed_until_us)
        if flying.is_reported:
            later = executed[flying.announced :]
            flying.announced = len(executed)
            if later:
                self.chain.update(AppliedCommand(replace(flying.command, schedule=later)))
        elif report.state == "executed" or report.executed_until_us >= flying.slew_end_us:
            self._report(flying, executed, report.reported_us)
        if report.state == "executed":
            self._flying.remove(flying)

    def _report(self, flying: Released, executed: tuple[Pulse, ...], reported_us: int) -> None:
        """Report a command to the chain, once."""
        if not flying.is_reported:
            flying.is_reported, flying.announced = True, len(executed)
            self.chain.update(ReportedCommand(flying.counter, reported_us, executed))

    def _give_up(self, now_us: int) -> None:
        """Report what the spacecraft should have told and has not: nothing of it was executed."""
        for flying in list(self._flying):
            if not flying.is_reported and now_us >= flying.slew_stop_us + round(_REPORT_TIMEOUT_S * US_PER_S):
                self._report(flying, (), now_us)
                # of one that has not begun yet the pulses still come
                if flying.slew_end_us:
                    self._flying.remove(flying)


def _as_recovery(row: AttitudeRow) -> AttitudeRow:
    """Return the row as a person who releases single commands takes it: roll and pitch may be led back."""
    is_in_reach = max(abs(row.attitude_deg.roll), abs(row.attitude_deg.pitch)) <= _RECOVERY_DEG
    if row.inhibitions != ("beyond_validity",) or not is_in_reach:
        return row
    return replace(row, inhibitions=(), control_allowed=True, control_allowed_axes=(False, True, True))
