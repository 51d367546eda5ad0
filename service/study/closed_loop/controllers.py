"""Controllers of the study: who decides what is sent to the spacecraft, behind one small protocol.

``automatic`` sends what the chain computes; ``truth`` applies the chain's law to the true state, the best that the law
could do with perfect sensing; ``off`` sends nothing and has to fail.

A spacecraft behind a link must have its commands before they begin: they are released in two steps
(`released.Releaser`), a lead time ahead and for a whole horizon. Over an ideal uplink there is no lead, and a command
counts as applied from its epoch (release ``automatic``).
"""

from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Protocol

import numpy as np

from service.core.control.quaternion_law import GEOSTATIONARY_RATE_RAD_S
from service.pipeline.chain import Chain
from service.pipeline.config import TorqueConfig
from service.pipeline.control.command.compute_command import NO_CARRY, compute_command
from service.records.catalogue import Method, Spacecraft
from service.records.epoch import US_PER_S
from service.records.levels.attitude import (
    AppliedCommand,
    AttitudeRow,
    Axes,
    FloatArray,
    Pulse,
    Status,
    TorqueCommand,
    fit_angles_deg,
    row_without_attitude,
)
from service.records.levels.measurement import Measurement
from service.study.closed_loop.plant_process import CommandReport, SpacecraftTruth
from service.study.closed_loop.released import Releaser

#: a command goes out so long before its first pulse and the slowest way to the spacecraft; that way takes two minutes
LEAD_MARGIN_S = 30.0
LEAD_S = 120.0 + LEAD_MARGIN_S


class Sensing(StrEnum):
    """Attitude source that closes the loop."""

    AUTOMATIC = "automatic"
    TRUTH = "truth"
    OFF = "off"


@dataclass(frozen=True)
class ControllerOutput:
    """Output of a controller at one row."""

    schedule: tuple[Pulse, ...] = ()
    #: whether control was inhibited
    is_inhibited: bool = False
    #: estimate of the ground; None = it made none
    attitude_deg: Axes | None = None
    #: against control, or against an axis of it
    reasons: tuple[str, ...] = ()


class Controller(Protocol):
    """Controller that decides row by row which command is sent."""

    def decide(self, measurement: Measurement, truth: SpacecraftTruth, counter: int) -> ControllerOutput:
        """Return what is to be sent under a counter; only a controller with perfect sensing may read the truth."""

    def on_input(self, reports: tuple[CommandReport, ...]) -> None:
        """Take what the spacecraft has told of commands."""


@dataclass
class Idle:
    """Nobody controls."""

    def decide(self, measurement: Measurement, truth: SpacecraftTruth, counter: int) -> ControllerOutput:  # noqa: ARG002
        """Return nothing to send."""
        return ControllerOutput()

    def on_input(self, reports: tuple[CommandReport, ...]) -> None:
        """Hear nothing: nothing was sent."""


@dataclass
class ByChain:
    """The service's chain and the law in it."""

    chain: Chain
    #: None = an ideal uplink: what the chain computes counts as applied from its epoch
    release: Releaser | None = None

    def decide(self, measurement: Measurement, truth: SpacecraftTruth, counter: int) -> ControllerOutput:  # noqa: ARG002
        """Return what the chain computes from the powers of the row, or what is released of it."""
        outcome = self.chain.step(measurement)
        if outcome is None or outcome.command is None:
            return ControllerOutput(is_inhibited=True)
        driving = next(iter(outcome.rows), None)
        angles = None if driving is None else driving.steered_deg
        command, schedule = outcome.command, outcome.command.schedule
        if self.release is not None and driving is not None:
            schedule = self.release.wanted(outcome, driving, measurement, counter)
        elif outcome.applied is not None:
            self.chain.update(outcome.applied)
        reasons = () if driving is None else driving.inhibitions
        return ControllerOutput(schedule, not command.control_allowed, angles, reasons)

    def on_input(self, reports: tuple[CommandReport, ...]) -> None:
        """Take what the spacecraft has told of released commands."""
        if self.release is not None:
            self.release.on_input(reports)


@dataclass
class ByAngles:
    """The service's chain, whose angles go up; what the loop on board does with them it tells itself."""

    chain: Chain
    _command: TorqueCommand | None = None

    def decide(self, measurement: Measurement, truth: SpacecraftTruth, counter: int) -> ControllerOutput:  # noqa: ARG002
        """Return the angles of the row, inhibited where they are not fit for use."""
        outcome = self.chain.step(measurement)
        driving = None if outcome is None else next(iter(outcome.rows), None)
        if outcome is None or driving is None:
            return ControllerOutput(is_inhibited=True)
        self._command = outcome.command or self._command
        return ControllerOutput((), not driving.control_allowed, fit_angles_deg(driving), driving.inhibitions)

    def on_input(self, reports: tuple[CommandReport, ...]) -> None:
        """Tell the chain the mean torque of the pulses that were executed."""
        for report in reports:
            start_us, stop_us = report.executed_from_us, report.executed_until_us
            if report.state != "executed" or self._command is None or start_us is None or stop_us is None:
                continue
            seconds = (stop_us - start_us) / US_PER_S
            pulse = Pulse(start_us, seconds, Axes(*(impulse / seconds for impulse in report.impulse_n_m_s)))
            self.chain.update(AppliedCommand(replace(self._command, schedule=(pulse,))))


@dataclass
class ByTruth:
    """The law on the true state."""

    spacecraft: Spacecraft
    lead_s: float
    period_s: float
    _carry_n_m_s: FloatArray = field(default_factory=lambda: np.array(NO_CARRY))

    def decide(self, measurement: Measurement, truth: SpacecraftTruth, counter: int) -> ControllerOutput:  # noqa: ARG002
        """Return what the law wants of the truth."""
        row = _row_of_truth(measurement, truth)
        announced = compute_command(row, self.spacecraft, self._carry_n_m_s, self.period_s, TorqueConfig())
        self._carry_n_m_s = announced.carry_n_m_s
        command = postponed(announced.command, self.lead_s)
        return ControllerOutput(command.schedule, attitude_deg=truth.attitude_deg)

    def on_input(self, reports: tuple[CommandReport, ...]) -> None:
        """Hear nothing: the truth tells it all."""


def postponed(command: TorqueCommand, lead_s: float) -> TorqueCommand:
    """Return a command whose pulses begin a lead time later."""
    schedule = tuple(replace(pulse, start_us=pulse.start_us + round(lead_s * US_PER_S)) for pulse in command.schedule)
    return replace(command, schedule=schedule)


def _row_of_truth(measurement: Measurement, truth: SpacecraftTruth) -> AttitudeRow:
    """Return the row that perfect sensing would have led to."""
    epoch_us = measurement.epoch_us
    return replace(
        row_without_attitude(epoch_us, epoch_us, measurement.number, Method.ROBUST, ()),
        attitude_deg=truth.attitude_deg,
        sigma_deg=Axes(0.0, 0.0, 0.0),
        rates_deg_s=_rates_of_angles(truth),
        status=Status.ACQUIRED,
        control_allowed=True,
        control_allowed_axes=(True, True, True),
        downlink_fade_db=0.0,
        common_db=0.0,
        residual_rms_db=0.0,
    )


def _rates_of_angles(truth: SpacecraftTruth) -> Axes:
    """Return how the angles turn: what torques have given, and the exchange of roll and yaw."""
    rates, exchange = truth.rates_deg_s, GEOSTATIONARY_RATE_RAD_S
    yaw_deg, roll_deg, _ = truth.attitude_deg
    return Axes(rates.yaw - exchange * roll_deg, rates.roll + exchange * yaw_deg, rates.pitch)
