"""Controllers of the study: who decides what is sent to the spacecraft, behind one small protocol.

``automatic`` is the service with its interlock (`centre.Centre`); ``truth`` applies the chain's law to the true state,
the best that the law could do with perfect sensing; ``off`` sends nothing and has to fail.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum

import numpy as np

from service.core.control.quaternion_law import GEOSTATIONARY_RATE_RAD_S
from service.pipeline.config import TorqueConfig
from service.pipeline.control.command.compute_command import NO_CARRY, compute_command
from service.records.catalogue import Method, Spacecraft
from service.records.epoch import US_PER_S
from service.records.inputs import SlowInput
from service.records.levels.attitude import (
    AttitudeRow,
    Axes,
    FloatArray,
    Pulse,
    Status,
    TorqueCommand,
    row_without_attitude,
)
from service.records.levels.measurement import Measurement
from service.records.operations.release import UplinkProduct
from service.study.closed_loop.plant_process import CommandReport, SpacecraftTruth

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
    #: given out for uplink; None: nothing, or a schedule that has no counter
    product: UplinkProduct | None = None


class Controller:
    """Controller that decides row by row which command is sent; this one sends none."""

    def decide(self, measurement: Measurement, truth: SpacecraftTruth) -> ControllerOutput:  # noqa: ARG002
        """Return what is to be sent; only a controller with perfect sensing may read the truth."""
        return ControllerOutput()

    def on_ground(self, content: SlowInput) -> None:
        """Take an input of the journal."""

    def on_input(self, reports: Sequence[CommandReport]) -> None:
        """Take what the spacecraft has reported of commands."""


@dataclass
class ByTruth(Controller):
    """The law on the true state."""

    spacecraft: Spacecraft
    lead_s: float
    period_s: float
    _carry_n_m_s: FloatArray = field(default_factory=lambda: np.array(NO_CARRY))

    def decide(self, measurement: Measurement, truth: SpacecraftTruth) -> ControllerOutput:
        """Return what the law wants of the truth."""
        row = _row_of_truth(measurement, truth)
        announced = compute_command(row, self.spacecraft, self._carry_n_m_s, self.period_s, TorqueConfig())
        self._carry_n_m_s = announced.carry_n_m_s
        command = postponed(announced.command, self.lead_s)
        return ControllerOutput(command.schedule, attitude_deg=truth.attitude_deg)


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
