"""Design of the control of a spacecraft, its mean torque, inhibitions, and the record of a command."""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from service.core.control.gyro_orbitant import does_rate_show_yaw, gyro_orbitant_law, gyro_orbitant_torque
from service.core.control.quaternion_law import GEOSTATIONARY_RATE_RAD_S, Gains, feedback_torque, loop_gains
from service.core.control.slew_schedule import AxisPulse, Drive, Envelope, shape_pulses
from service.core.control.wheel_allocation import Allocation, Wheels, body_torque_limit_n_m, wheel_set
from service.core.dynamics.orbital_frame_model import Law, OrbitalFrameGains
from service.pipeline.config import TorqueConfig
from service.records.catalogue import ControlLaw, ControlMode, Release, Spacecraft
from service.records.epoch import US_PER_S
from service.records.levels.attitude import (
    NO_AXES,
    AttitudeRow,
    Axes,
    Disturbance,
    FloatArray,
    Pulse,
    TorqueCommand,
    named_axes,
)

_ZERO = Axes(0.0, 0.0, 0.0)
_HOUR_S = 3600.0


class Span(NamedTuple):
    """Time of a command, and the envelope that the law keeps to."""

    epoch_us: int
    period_s: float
    envelope: Envelope = Envelope()

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
    said = {"control_allowed": False, "inhibitions": inhibitions, "balance_allowed_axes": NO_AXES}
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


#: a drive without steps is given these shares of its limit as steps: finer than any torque that is asked for
_FINE_SHARE = 1e-6
#: body axes x roll, y pitch, z yaw in the order yaw, roll, pitch
_ANGLES_FROM_BODY = [2, 0, 1]


class ControlDesign(NamedTuple):
    """The law of one spacecraft."""

    gains: Gains
    #: (3, 3) inverse of the tensor of inertia in the order yaw, roll, pitch
    inverse_1_kg_m2: FloatArray
    drive: Drive
    wheels: Wheels


@lru_cache(maxsize=64)
def control_design(spacecraft: Spacecraft, config: TorqueConfig) -> ControlDesign:
    """Return the law of a spacecraft; the catalogue hardly ever changes.

    Raises
    ------
    ValueError
        Inertia, wheels, period and damping make no law, or its torque is beyond the limit; the message says why.
    """
    axes = np.array(spacecraft.wheels.axes, dtype=np.float64)
    limit_n_m = min(spacecraft.torque_limit_n_m, body_torque_limit_n_m(axes, spacecraft.wheels.torque_limit_n_m))
    gains = loop_gains(
        np.array(spacecraft.inertia_kg_m2),
        period_s=spacecraft.control.period_s,
        damping=spacecraft.control.damping,
        torque_limit_n_m=limit_n_m,
        command_period_s=None,
        orbital_rate_rad_s=GEOSTATIONARY_RATE_RAD_S if spacecraft.onboard.roll_yaw_coupling else 0.0,
    )
    quantum_n_m = spacecraft.wheels.torque_quantum_n_m or _FINE_SHARE * limit_n_m
    wheels = wheel_set(
        axes[:, _ANGLES_FROM_BODY],
        spacecraft.wheels.torque_limit_n_m,
        spacecraft.wheels.momentum_limit_n_m_s,
        min(config.least_wheel_momentum_n_m_s, 0.5 * spacecraft.wheels.momentum_limit_n_m_s),
    )
    drive = Drive(limit_n_m, quantum_n_m, config.min_pulse_s, config.time_step_s)
    inverse = np.asarray(np.linalg.inv(gains.inertia_kg_m2), dtype=np.float64)
    return ControlDesign(gains, inverse, drive, wheels)


def gyro_design(spacecraft: Spacecraft, config: TorqueConfig, period_s: float | None = None) -> Law:
    """Return the gyro-orbitant law of a spacecraft.

    Parameters
    ----------
    spacecraft : Spacecraft
        With the gains of the law.
    config : TorqueConfig
        The period of commands under release ``automatic`` until rows tell it.
    period_s : float, optional, s
        Time between commands; None: as the catalogue has it.

    Raises
    ------
    ValueError
        There are no gains, or they are none for this craft and period; the message says why.
    """
    if period_s is None:
        is_automatic = spacecraft.control.release is Release.AUTOMATIC
        period_s = config.default_period_s if is_automatic else spacecraft.control.command_period_s
    return _gyro_design(spacecraft, math.ceil(period_s))


@lru_cache(maxsize=64)
def _gyro_design(spacecraft: Spacecraft, period_s: int) -> Law:
    reported = spacecraft.control.gyro_orbitant
    if reported is None:
        raise ValueError("the law gyro_orbitant has no gains: state control.gyro_orbitant")
    gains = OrbitalFrameGains(
        roll_stiffness=reported.roll_stiffness_n_m,
        roll_damping=reported.roll_damping_n_m_s,
        pitch_stiffness=reported.pitch_stiffness_n_m,
        pitch_damping=reported.pitch_damping_n_m_s,
        yaw_stiffness=reported.yaw_stiffness_n_m,
        yaw_damping=reported.yaw_damping_n_m_s,
    )
    axes = np.array(spacecraft.wheels.axes, dtype=np.float64)
    limit_n_m = min(spacecraft.torque_limit_n_m, body_torque_limit_n_m(axes, spacecraft.wheels.torque_limit_n_m))
    tensor = np.array(spacecraft.inertia_kg_m2)
    return gyro_orbitant_law(tensor, gains, torque_limit_n_m=limit_n_m, command_period_s=float(period_s))


class MeanPulses(NamedTuple):
    """Pulses whose mean is the torque, what they leave for later, and whether the law wanted more."""

    pulses: tuple[AxisPulse, ...]
    #: (3,) N m s
    carry_n_m_s: FloatArray
    is_cut: bool


def is_gyro_orbitant(spacecraft: Spacecraft) -> bool:
    """Return whether the catalogue chose the gyro-orbitant law."""
    return spacecraft.control.law is ControlLaw.GYRO_ORBITANT


def rate_inhibition(body_rate_deg_s: Axes | None) -> str | None:
    """Return why the gyro-orbitant law has no torque at these rates; None where it has one."""
    if body_rate_deg_s is None or not np.isfinite(body_rate_deg_s).all():
        return "no_body_rate"
    return None if does_rate_show_yaw(np.array(body_rate_deg_s), GEOSTATIONARY_RATE_RAD_S) else "law_beyond"


def mean_pulses(
    row: AttitudeRow,
    spacecraft: Spacecraft,
    span: Span,
    carry_n_m_s: FloatArray,
    config: TorqueConfig,
    design: ControlDesign,
    disturbance: Disturbance | None,
    body_rate_deg_s: Axes | None,
) -> MeanPulses:
    """Return the pulses whose mean over a command's span is the law's torque.

    Parameters
    ----------
    row : AttitudeRow
        That allows control.
    span : Span
        Epoch and period of the command.
    carry_n_m_s : ndarray, shape (3,), N m s
        Left over from earlier commands.
    body_rate_deg_s : Axes or None
        Of the gyro-orbitant law: finite, and within it.

    Raises
    ------
    ValueError
        The catalogue makes no law for this period.
    """
    wanted = _wanted(row, spacecraft, span, config, design, disturbance, body_rate_deg_s)
    is_allowed = np.array(row.control_allowed_axes)
    wanted = np.where(is_allowed, wanted, 0.0)
    shares, is_automatic = np.ones(3), spacecraft.control.release is Release.AUTOMATIC
    if not (is_gyro_orbitant(spacecraft) and is_automatic):
        shares = _shares_within_envelope(wanted, design, span, config.envelope_share)
    if is_gyro_orbitant(spacecraft):
        # its axes belong together
        shares = np.full(3, shares.min())
    train = shape_pulses(
        shares * wanted,
        np.where(is_allowed, carry_n_m_s, 0.0),
        period_s=span.period_s,
        limit_n_m=design.drive.limit_n_m,
        quantum_n_m=design.drive.quantum_n_m,
        min_pulse_s=config.min_pulse_s,
        time_step_s=config.time_step_s,
    )
    reported = enumerate(zip(train.duration_s.tolist(), train.torque_n_m.tolist(), strict=True))
    pulses = tuple(AxisPulse(axis, 0.0, duration_s, torque) for axis, (duration_s, torque) in reported if duration_s)
    return MeanPulses(pulses, train.carry_n_m_s, bool((shares < 1.0).any() or train.is_saturated.any()))


def _wanted(
    row: AttitudeRow,
    spacecraft: Spacecraft,
    span: Span,
    config: TorqueConfig,
    design: ControlDesign,
    disturbance: Disturbance | None,
    body_rate_deg_s: Axes | None,
) -> FloatArray:
    """Return the torque (3,), N m, of the law that the catalogue chose, the known torque taken away."""
    middle_us = (span.epoch_us + span.stop_us) // 2
    pushed = np.zeros(3) if disturbance is None else np.array(disturbance.torque_n_m(middle_us))
    if is_gyro_orbitant(spacecraft):
        law = gyro_design(spacecraft, config, span.period_s)
        rate = np.array(body_rate_deg_s, dtype=np.float64)
        return gyro_orbitant_torque(row.steered_deg.roll, row.steered_deg.pitch, rate, law, math.inf) - pushed
    rates = np.zeros(3) if row.rates_deg_s is None else np.array(row.rates_deg_s)
    return feedback_torque(design.gains, row.steered_deg, rates, disturbance_n_m=pushed)


def _shares_within_envelope(
    torque_n_m: FloatArray, design: ControlDesign, span: Span, of_envelope: float
) -> FloatArray:
    """Return the share (3,) of a mean torque that every command of an hour may give, whenever it acts."""
    impulse = np.abs(torque_n_m) * span.period_s
    rate_deg_s = np.degrees(np.abs(design.inverse_1_kg_m2) @ impulse)
    asked = np.array([rate_deg_s * span.period_s, rate_deg_s, impulse, impulse * max(1.0, _HOUR_S / span.period_s)])
    limits = of_envelope * np.array(span.envelope)[:, None]
    return np.asarray(np.minimum(1.0, limits / np.maximum(asked, limits)).min(axis=0))


#: reasons beside those of the interlock for which a command stays zero, with what each one says
CONTROL_INHIBITIONS: dict[str, str] = {
    "mode_onboard": "torques are computed on board",
    "mode_off": "attitude control is switched off",
    "no_fast_loop": "the catalogue states no fast loop or no Forecast mode on board",
    "no_rate": "the row has no angular rate, as a late one",
    "no_law": "inertia, wheels, period and damping of the catalogue give no control law; see the service log",
    "no_body_rate": "the law gyro_orbitant needs body rates about all axes in telemetry that is not too old",
    "law_beyond": "the roll rate exceeds the orbital rate, or the spacecraft turns against its orbit: no yaw follows",
    "tripped": "control has tripped; torques are withheld until ten good minutes after the reset",
}


def control_inhibitions(
    row: AttitudeRow, spacecraft: Spacecraft, *, is_withheld: bool = False, body_rate_deg_s: Axes | None = None
) -> tuple[str, ...]:
    """Return why this row may not lead to a torque: the row's reasons and those of the spacecraft's settings."""
    reasons = list(row.inhibitions)
    if spacecraft.control.mode is not ControlMode.GROUND:
        reasons.append(f"mode_{spacecraft.control.mode.value}")
    elif not (spacecraft.onboard.fast_loop and spacecraft.onboard.forecast_mode):
        reasons.append("no_fast_loop")
    lacking = _rate_inhibition(row, spacecraft, body_rate_deg_s)
    if not row.inhibitions and lacking is not None:
        reasons.append(lacking)
    if is_withheld:
        reasons.append("tripped")
    return tuple(reasons)


def _rate_inhibition(row: AttitudeRow, spacecraft: Spacecraft, body_rate_deg_s: Axes | None) -> str | None:
    """Return why the law of the spacecraft has no rates that it can use."""
    if is_gyro_orbitant(spacecraft):
        return rate_inhibition(body_rate_deg_s)
    return "no_rate" if row.rates_deg_s is None else None
