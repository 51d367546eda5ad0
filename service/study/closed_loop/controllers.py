"""Controllers of the study: who decides what is sent to the craft, behind one small protocol.

``automatic`` sends what the chain computes; ``truth`` applies the chain's law to the true state, the best that the law
could do with perfect sensing; ``off`` sends nothing and has to fail.

A craft behind a link must have its commands before they begin: every pulse is sent a lead time ahead, and the chain
hears of it when the report of its execution has come, which is what release in two steps does. Over an ideal uplink
there is no lead, and a command counts as applied from its epoch (release ``automatic``).
"""

from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Protocol

import numpy as np

from service.pipeline.chain import Chain
from service.pipeline.config import TorqueConfig
from service.pipeline.wheel_torques import NO_CARRY, compute_command
from service.records.attitude import AttitudeRow, Axes, FloatArray, Status
from service.records.catalogue import Method, Spacecraft
from service.records.command import AppliedCommand, Pulse, TorqueCommand
from service.records.epoch import US_PER_S
from service.records.measurement import Measurement
from service.study.closed_loop.plant_process import CommandReport, CraftTruth

#: the slowest way to the craft takes two minutes
LEAD_S = 150.0


class Sensing(StrEnum):
    """What closes the loop."""

    AUTOMATIC = "automatic"
    TRUTH = "truth"
    OFF = "off"


@dataclass(frozen=True)
class Decision:
    """What a controller wants at one row."""

    schedule: tuple[Pulse, ...] = ()
    #: whether control was inhibited
    is_inhibited: bool = False
    #: what the ground believes; None = it did not look
    attitude_deg: Axes | None = None


class Controller(Protocol):
    """Decides, row by row, what is sent."""

    def decide(self, measurement: Measurement, truth: CraftTruth, counter: int) -> Decision:
        """Return what is to be sent under a counter; only a controller with perfect sensing may read the truth."""
        ...

    def hear(self, reports: tuple[CommandReport, ...]) -> None:
        """Take what the craft has told of commands."""
        ...


@dataclass
class Idle:
    """Nobody controls."""

    def decide(self, measurement: Measurement, truth: CraftTruth, counter: int) -> Decision:  # noqa: ARG002
        """Return nothing to send."""
        return Decision()

    def hear(self, reports: tuple[CommandReport, ...]) -> None:
        """Hear nothing: nothing was sent."""


@dataclass
class ByChain:
    """The service's chain and the law in it."""

    chain: Chain
    #: 0 = an ideal uplink
    lead_s: float
    _under_way: dict[int, AppliedCommand] = field(default_factory=dict)

    def decide(self, measurement: Measurement, truth: CraftTruth, counter: int) -> Decision:  # noqa: ARG002
        """Return what the chain computes from the powers of the row."""
        outcome = self.chain.step(measurement)
        if outcome is None or outcome.command is None:
            return Decision(is_inhibited=True)
        command = postponed(outcome.command, self.lead_s)
        if command.control_allowed and not self.lead_s:
            self.chain.learn(AppliedCommand(command))
        elif command.schedule:
            self._under_way[counter] = AppliedCommand(command)
        driving = next((row for row in outcome.rows if row.method is Method.ROBUST), None)
        angles = None if driving is None else driving.attitude_deg
        return Decision(command.schedule, not command.control_allowed, angles)

    def hear(self, reports: tuple[CommandReport, ...]) -> None:
        """Tell the chain what was executed."""
        for report in reports:
            applied = self._under_way.pop(report.counter, None) if report.state == "executed" else None
            if applied is not None:
                self.chain.learn(applied)


@dataclass
class ByTruth:
    """The law on the true state."""

    spacecraft: Spacecraft
    lead_s: float
    period_s: float
    _carry_n_m_s: FloatArray = field(default_factory=lambda: np.array(NO_CARRY))

    def decide(self, measurement: Measurement, truth: CraftTruth, counter: int) -> Decision:  # noqa: ARG002
        """Return what the law wants of the truth."""
        row = _row_of_truth(measurement, truth)
        told = compute_command(row, self.spacecraft, self._carry_n_m_s, self.period_s, TorqueConfig())
        self._carry_n_m_s = told.carry_n_m_s
        command = postponed(told.command, self.lead_s)
        return Decision(command.schedule, attitude_deg=truth.attitude_deg)

    def hear(self, reports: tuple[CommandReport, ...]) -> None:
        """Hear nothing: the truth tells it all."""


def postponed(command: TorqueCommand, lead_s: float) -> TorqueCommand:
    """Return a command whose pulses begin a lead time later."""
    schedule = tuple(replace(pulse, start_us=pulse.start_us + round(lead_s * US_PER_S)) for pulse in command.schedule)
    return replace(command, schedule=schedule)


def _row_of_truth(measurement: Measurement, truth: CraftTruth) -> AttitudeRow:
    """Return the row that perfect sensing would have led to."""
    return AttitudeRow(
        epoch_us=measurement.epoch_us,
        received_at_us=measurement.epoch_us,
        number=measurement.number,
        method=Method.ROBUST,
        attitude_deg=truth.attitude_deg,
        sigma_deg=Axes(0.0, 0.0, 0.0),
        rates_deg_s=truth.rates_deg_s,
        status=Status.ACQUIRED,
        control_allowed=True,
        control_allowed_axes=(True, True, True),
        inhibitions=(),
        carriers_used=0,
        excluded=(),
        downlink_fade=False,
        downlink_fade_db=0.0,
        common_db=0.0,
        residual_rms_db=0.0,
        calibration_id=None,
        alignment_id=None,
    )
