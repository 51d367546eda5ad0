"""Pulses as the torque command that is stored, shown and released."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from service.core.control.slew_schedule import AxisPulse
from service.core.control.wheel_allocation import Allocation
from service.records.catalogue import Spacecraft
from service.records.epoch import US_PER_S
from service.records.levels.attitude import AttitudeRow, Axes, FloatArray, named_axes
from service.records.levels.command import Pulse, TorqueCommand

_ZERO = Axes(0.0, 0.0, 0.0)


class Span(NamedTuple):
    """For when a command is meant."""

    epoch_us: int
    period_s: float

    @property
    def stop_us(self) -> int:
        """Return its end."""
        return self.epoch_us + round(self.period_s * US_PER_S)


class Prediction(NamedTuple):
    """Change of angle and rate at the end of the pulses; (3,) yaw, roll, pitch."""

    angle_change_rad: FloatArray
    rate_change_rad_s: FloatArray


def command_of(
    row: AttitudeRow,
    spacecraft: Spacecraft,
    span: Span,
    pulses: Sequence[AxisPulse],
    prediction: Prediction,
    shares: Allocation,
    *,
    is_saturated: bool,
) -> TorqueCommand:
    """Return the command of some pulses; ``shares`` are the wheels' shares of their mean torque."""
    impulse = impulse_of(pulses)
    return TorqueCommand(
        epoch_us=span.epoch_us,
        number=row.number,
        attitude_epoch_us=row.epoch_us,
        mode=spacecraft.control.mode.value,
        torque_n_m=named_axes(impulse / span.period_s),
        wheels_n_m=tuple((shares.wheels_n_m + 0.0).tolist()),
        saturated=is_saturated,
        command_period_s=span.period_s,
        valid_until_us=span.stop_us,
        schedule=tuple(_pulse(span.epoch_us, pulse) for pulse in pulses),
        impulse_n_m_s=named_axes(impulse),
        predicted_angle_change_deg=named_axes(np.rad2deg(prediction.angle_change_rad)),
        predicted_rate_change_deg_s=named_axes(np.rad2deg(prediction.rate_change_rad_s)),
        predicted_wheel_momentum_n_m_s=tuple((shares.wheels_n_m * span.period_s + 0.0).tolist()),
        control_allowed=True,
        inhibitions=(),
    )


def zero_command(row: AttitudeRow, spacecraft: Spacecraft, span: Span, inhibitions: tuple[str, ...]) -> TorqueCommand:
    """Return the command that does nothing and says why."""
    return TorqueCommand(
        epoch_us=span.epoch_us,
        number=row.number,
        attitude_epoch_us=row.epoch_us,
        mode=spacecraft.control.mode.value,
        command_period_s=span.period_s,
        valid_until_us=span.stop_us,
        **_nothing(len(spacecraft.wheels.axes), inhibitions),
    )


def withheld_command(command: TorqueCommand) -> TorqueCommand:
    """Return a command as one that does nothing because control had tripped before its row."""
    return replace(command, **_nothing(len(command.wheels_n_m), ("tripped",)))


def _nothing(wheels: int, inhibitions: tuple[str, ...]) -> dict[str, Any]:
    """Return the fields of a command that does nothing."""
    names = ("torque_n_m", "impulse_n_m_s", "predicted_angle_change_deg", "predicted_rate_change_deg_s")
    still = dict.fromkeys(("wheels_n_m", "predicted_wheel_momentum_n_m_s"), (0.0,) * wheels)
    said = {"control_allowed": False, "inhibitions": inhibitions}
    return {**dict.fromkeys(names, _ZERO), **still, **said, "saturated": False, "schedule": (), "schedule_check": None}


def impulse_of(pulses: Sequence[AxisPulse]) -> FloatArray:
    """Return the impulse (3,) of some pulses, N m s."""
    impulse = np.zeros(3)
    for pulse in pulses:
        impulse[pulse.axis] += pulse.impulse_n_m_s
    return impulse


def predicted(pulses: Sequence[AxisPulse], inverse_1_kg_m2: FloatArray, period_s: float) -> Prediction:
    """Return the exact effect of pulses at the end of their span: each one's rate turns the body from its middle on."""
    turned = np.zeros(3)
    for pulse in pulses:
        turned[pulse.axis] += pulse.impulse_n_m_s * (period_s - pulse.start_s - 0.5 * pulse.duration_s)
    return Prediction(inverse_1_kg_m2 @ turned, inverse_1_kg_m2 @ impulse_of(pulses))


def _pulse(epoch_us: int, pulse: AxisPulse) -> Pulse:
    torque = [0.0, 0.0, 0.0]
    torque[pulse.axis] = pulse.torque_n_m
    return Pulse(epoch_us + round(pulse.start_s * US_PER_S), pulse.duration_s, Axes._make(torque))
