"""Wheel torques, L4 to L5: the control law's mean torque as pulses that end by themselves, and each wheel's share.

State kept: the impulse not yet given. Whenever an inhibition stands the command is zero, says why, and the carry is
dropped: a wish from before an inhibition is not given after it.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from service.core.control.attitude_law import proportional_derivative_torque
from service.core.control.pulses import PulseTrain, shape_pulses
from service.core.control.wheels import allocate_to_wheels, body_torque_limit_n_m
from service.pipeline.config import TorqueConfig
from service.records.attitude import AttitudeRow, Axes, FloatArray, named_axes
from service.records.catalogue import ControlMode, Spacecraft, WheelSet
from service.records.command import Pulse, TorqueCommand
from service.records.epoch import US_PER_S

#: reasons beside those of the interlock for which a command stays zero, with what each one says
CONTROL_INHIBITIONS: dict[str, str] = {
    "mode_onboard": "torques are computed on board",
    "mode_off": "attitude control is switched off",
    "no_fast_loop": "the catalogue states no fast loop or no Forecast mode on board",
    "no_rate": "too few fixes yet for an angular rate",
}

NO_CARRY = np.zeros(3)
_ZERO = Axes(0.0, 0.0, 0.0)
#: places of yaw, roll, pitch among the body axes x roll, y pitch, z yaw
_BODY_FROM_ANGLES = np.array([1, 2, 0])


@dataclass(frozen=True)
class TorqueOutcome:
    """A command and the impulse that it leaves for later."""

    command: TorqueCommand
    #: (3,) N m s, yaw, roll, pitch
    carry_n_m_s: FloatArray


def control_inhibitions(row: AttitudeRow, spacecraft: Spacecraft) -> tuple[str, ...]:
    """Return why this row may not lead to a torque: the row's reasons and those of the spacecraft's settings."""
    reasons = list(row.inhibitions)
    if spacecraft.control.mode is not ControlMode.GROUND:
        reasons.append(f"mode_{spacecraft.control.mode.value}")
    elif not (spacecraft.onboard.fast_loop and spacecraft.onboard.forecast_mode):
        reasons.append("no_fast_loop")
    if not row.inhibitions and row.rates_deg_s is None:
        reasons.append("no_rate")
    return tuple(reasons)


def compute_command(
    row: AttitudeRow, spacecraft: Spacecraft, carry_n_m_s: FloatArray, period_s: float, config: TorqueConfig
) -> TorqueOutcome:
    """Return the command that follows from one attitude row."""
    # a simulated spacecraft lives on its own epochs, a real one can be commanded only from the receipt on
    epoch_us = row.epoch_us if spacecraft.simulated else max(row.epoch_us, row.received_at_us)
    inhibitions = control_inhibitions(row, spacecraft)
    if inhibitions or row.rates_deg_s is None:
        return TorqueOutcome(_zero_command(row, spacecraft, epoch_us, period_s, inhibitions), NO_CARRY)
    wanted = proportional_derivative_torque(
        np.array(row.attitude_deg),
        np.array(row.rates_deg_s),
        _principal_inertia(spacecraft),
        spacecraft.control.period_s,
        spacecraft.control.damping,
    )
    is_allowed = np.array(row.control_allowed_axes)
    pulses = shape_pulses(
        np.where(is_allowed, wanted, 0.0),
        np.where(is_allowed, carry_n_m_s, 0.0),
        period_s=period_s,
        limit_n_m=min(spacecraft.torque_limit_n_m, _wheels_limit_n_m(spacecraft.wheels)),
        quantum_n_m=spacecraft.wheels.torque_quantum_n_m,
        min_pulse_s=config.min_pulse_s,
        time_step_s=config.time_step_s,
    )
    return TorqueOutcome(_command(row, spacecraft, epoch_us, period_s, pulses), pulses.carry_n_m_s)


@lru_cache(maxsize=64)
def _wheels_limit_n_m(wheels: WheelSet) -> float:
    """Return the body torque up to which no wheel exceeds its own limit; a set of wheels hardly ever changes."""
    return body_torque_limit_n_m(np.array(wheels.axes, dtype=np.float64), wheels.torque_limit_n_m)


@lru_cache(maxsize=64)
def _wheels_of_body(wheels: WheelSet) -> FloatArray:
    """Return the share (3, W) of each wheel in a torque about x roll, y pitch, z yaw; nobody may write it."""
    shares = allocate_to_wheels(np.array(wheels.axes, dtype=np.float64), np.eye(3))
    shares.setflags(write=False)
    return shares


def _principal_inertia(spacecraft: Spacecraft) -> FloatArray:
    """Return the inertia about yaw, roll and pitch."""
    x, y, z = (spacecraft.inertia_kg_m2[k][k] for k in range(3))
    return np.array([z, x, y])


def _command(
    row: AttitudeRow, spacecraft: Spacecraft, epoch_us: int, period_s: float, pulses: PulseTrain
) -> TorqueCommand:
    """Return the command of some pulses."""
    impulse = pulses.impulse_n_m_s
    rate_change_rad_s = impulse / _principal_inertia(spacecraft)
    # every pulse starts with the period and is short beside it: the gained rate turns the body until the period ends
    angle_change_rad = rate_change_rad_s * (period_s - pulses.duration_s / 2.0)
    wheel_impulse = impulse[_BODY_FROM_ANGLES] @ _wheels_of_body(spacecraft.wheels) + 0.0
    return TorqueCommand(
        epoch_us=epoch_us,
        number=row.number,
        attitude_epoch_us=row.epoch_us,
        mode=spacecraft.control.mode.value,
        torque_n_m=named_axes(impulse / period_s),
        wheels_n_m=tuple((wheel_impulse / period_s).tolist()),
        saturated=bool(pulses.is_saturated.any()),
        command_period_s=period_s,
        valid_until_us=epoch_us + round(period_s * US_PER_S),
        schedule=_schedule(epoch_us, pulses),
        impulse_n_m_s=named_axes(impulse),
        predicted_angle_change_deg=named_axes(np.rad2deg(angle_change_rad)),
        predicted_rate_change_deg_s=named_axes(np.rad2deg(rate_change_rad_s)),
        predicted_wheel_momentum_n_m_s=tuple(wheel_impulse.tolist()),
        control_allowed=True,
        inhibitions=(),
    )


def _zero_command(
    row: AttitudeRow, spacecraft: Spacecraft, epoch_us: int, period_s: float, inhibitions: tuple[str, ...]
) -> TorqueCommand:
    """Return the command that does nothing and says why."""
    wheels = tuple(0.0 for _ in spacecraft.wheels.axes)
    return TorqueCommand(
        epoch_us=epoch_us,
        number=row.number,
        attitude_epoch_us=row.epoch_us,
        mode=spacecraft.control.mode.value,
        torque_n_m=_ZERO,
        wheels_n_m=wheels,
        saturated=False,
        command_period_s=period_s,
        valid_until_us=epoch_us + round(period_s * US_PER_S),
        schedule=(),
        impulse_n_m_s=_ZERO,
        predicted_angle_change_deg=_ZERO,
        predicted_rate_change_deg_s=_ZERO,
        predicted_wheel_momentum_n_m_s=wheels,
        control_allowed=False,
        inhibitions=inhibitions,
    )


def _schedule(epoch_us: int, pulses: PulseTrain) -> tuple[Pulse, ...]:
    """Return one element an axis that has a pulse."""
    torques, durations = pulses.torque_n_m.tolist(), pulses.duration_s.tolist()
    return tuple(
        Pulse(epoch_us, duration_s, Axes(*(torque if place == axis else 0.0 for place, torque in enumerate(torques))))
        for axis, duration_s in enumerate(durations)
        if duration_s > 0.0
    )
