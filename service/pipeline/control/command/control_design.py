"""Design of the control of a spacecraft, its mean torque, inhibitions, and the record of a command."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from service.core.control.command_plan import AllocatedPulses, MeanPulses, compiled_law, compiled_mean
from service.core.control.gyro_orbitant import does_rate_show_yaw, gyro_orbitant_law, gyro_orbitant_torque
from service.core.control.quaternion_law import GEOSTATIONARY_RATE_RAD_S, Gains, loop_gains
from service.core.control.slew_schedule import Drive, Envelope
from service.core.control.wheel_allocation import Wheels, body_torque_limit_n_m, wheel_set
from service.core.dynamics.orbital_frame_model import Law, OrbitalFrameGains
from service.core.flexible.schedule import (
    ScheduleCheck,
    ScheduleLimits,
    Suggestion,
    TorquePulse,
    carry_phasor,
    check_schedule,
    ordered_schedule,
    schedule_response,
)
from service.core.flexible.spacecraft import HubMode
from service.pipeline.config import TorqueConfig
from service.records import catalogue
from service.records.catalogue import ControlLaw, ControlMode, Release, Spacecraft
from service.records.epoch import US_PER_S
from service.records.levels.attitude import (
    NO_AXES,
    AttitudeRow,
    Axes,
    Disturbance,
    FloatArray,
    Pulse,
    ScheduleVerdict,
    TorqueCommand,
)

_ZERO = Axes(0.0, 0.0, 0.0)
#: (3,) no torque, rate or impulse about any axis
NOTHING = np.zeros(3)


class Span(NamedTuple):
    """Time of a command, and the envelope that the law keeps to."""

    epoch_us: int
    period_s: float
    envelope: Envelope = Envelope()

    @property
    def stop_us(self) -> int:
        """Return its end."""
        return self.epoch_us + round(self.period_s * US_PER_S)


def command_of(
    row: AttitudeRow,
    spacecraft: Spacecraft,
    span: Span,
    allocated: AllocatedPulses,
    *,
    is_saturated: bool,
) -> TorqueCommand:
    """Return the command of some pulses."""
    impulse, angle_deg, rate_deg_s = map(Axes._make, allocated.effect.tolist())
    wheels_n_m, period_s = allocated.wheels_n_m.tolist(), span.period_s
    return TorqueCommand(
        epoch_us=span.epoch_us,
        number=row.number,
        attitude_epoch_us=row.epoch_us,
        mode=spacecraft.control.mode.value,
        torque_n_m=Axes(impulse.yaw / period_s, impulse.roll / period_s, impulse.pitch / period_s),
        wheels_n_m=tuple(wheels_n_m),
        saturated=is_saturated,
        command_period_s=period_s,
        valid_until_us=span.stop_us,
        schedule=tuple(
            [
                Pulse(span.epoch_us + round(start_s * US_PER_S), duration_s, _about(axis, torque_n_m))
                for axis, start_s, duration_s, torque_n_m in allocated.pulses.tolist()
            ]
        ),
        impulse_n_m_s=impulse,
        predicted_angle_change_deg=angle_deg,
        predicted_rate_change_deg_s=rate_deg_s,
        predicted_wheel_momentum_n_m_s=tuple([torque_n_m * period_s for torque_n_m in wheels_n_m]),
        control_allowed=True,
        inhibitions=(),
    )


def _about(axis: float, torque_n_m: float) -> Axes:
    if axis == 0.0:
        return Axes(torque_n_m, 0.0, 0.0)
    return Axes(0.0, torque_n_m, 0.0) if axis == 1.0 else Axes(0.0, 0.0, torque_n_m)


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


#: a drive without steps is given these shares of its limit as steps: finer than any torque that is asked for
_FINE_SHARE = 1e-6
#: body axes x roll, y pitch, z yaw in the order yaw, roll, pitch
_ANGLES_FROM_BODY = [2, 0, 1]


class ControlDesign(NamedTuple):
    """The law of one spacecraft."""

    gains: Gains
    drive: Drive
    wheels: Wheels
    #: (W,) N m s, of wheels whose momentum nobody tells: from there null motion does not move them
    usual_momentum_n_m_s: FloatArray


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
    drive = Drive(*map(float, (limit_n_m, quantum_n_m, config.min_pulse_s, config.time_step_s)))
    return ControlDesign(gains, drive, wheels, np.full(wheels.size, wheels.least_momentum_n_m_s))


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
    if not np.isfinite(wanted).all():
        raise ValueError("the law has no finite torque for these angles and rates")
    are_axes_together, is_automatic = is_gyro_orbitant(spacecraft), spacecraft.control.release is Release.AUTOMATIC
    own_share = math.inf if are_axes_together and is_automatic else config.envelope_share
    mean: MeanPulses = compiled_mean(
        design.gains,
        design.drive,
        wanted,
        np.array(carry_n_m_s),
        np.array(row.control_allowed_axes),
        float(span.period_s),
        Envelope(*(own_share * limit for limit in span.envelope)),
        are_axes_together,
    )
    return mean


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
    pushed = NOTHING if disturbance is None else np.array(disturbance.torque_n_m(middle_us), dtype=np.float64)
    if is_gyro_orbitant(spacecraft):
        law = gyro_design(spacecraft, config, span.period_s)
        rate = np.array(body_rate_deg_s, dtype=np.float64)
        return gyro_orbitant_torque(row.steered_deg.roll, row.steered_deg.pitch, rate, law, math.inf) - pushed
    rates = NOTHING if row.rates_deg_s is None else np.array(row.rates_deg_s, dtype=np.float64)
    torque_n_m: FloatArray = compiled_law(
        design.gains, np.array(row.steered_deg, dtype=np.float64), rates, NOTHING, pushed
    )
    return torque_n_m


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


#: places of the axes in the order yaw, roll, pitch, and of each among the body axes
_POSITIONS = {"yaw": 0, "roll": 1, "pitch": 2}
_BODY = {"yaw": 2, "roll": 0, "pitch": 1}
#: every panel damps; a catalogue that says nothing of it is given this
_LEAST_DAMPING = 1e-4
_WORDS = {
    "split": "split each pulse into two halves {:.3g} s apart",
    "width": "make each pulse {:.3g} s long with the same impulse",
    "interval": "space the pulses {:.3g} s apart",
    "wait": "send it {:.3g} s later",
}


@dataclass(frozen=True, slots=True)
class PanelSwing:
    """Oscillation of the modes of the catalogue after earlier schedules, in their order."""

    at_us: int
    #: hub angle, rad; turns and decays from `at_us` on
    phasor_rad: tuple[complex, ...]


def schedule_verdict(
    schedule: Sequence[Pulse], spacecraft: Spacecraft, config: TorqueConfig, swing: PanelSwing | None = None
) -> ScheduleVerdict | None:
    """Return the verdict on a schedule; None without modes or without pulses.

    Parameters
    ----------
    schedule : sequence of Pulse
        Not empty for a verdict.
    spacecraft : Spacecraft
        Modes and inertia.
    config : TorqueConfig
        What panels may add.
    swing : PanelSwing, optional
        What earlier schedules have left; none: at rest.

    Notes
    -----
    Each axis is judged by its own peak; the greatest one counts. The jitter of the hub is the only limit.
    """
    if not spacecraft.modes or not schedule:
        return None
    start_us = min(pulse.start_us for pulse in schedule)
    found = [
        (check, positions)
        for axis, positions in _modes_by_axis(spacecraft).items()
        if (check := _checked(schedule, axis, positions, spacecraft, config, swing, start_us)) is not None
    ]
    if not found:
        return None
    check, positions = max(found, key=lambda one: one[0].metrics.peak_rad)
    worst = check.metrics
    return ScheduleVerdict(
        verdict=check.verdict,
        peak_deg=math.degrees(worst.peak_rad),
        residual_deg=math.degrees(worst.residual_rad),
        margin=1.0 - math.degrees(worst.peak_rad) / config.panel_peak_limit_deg,
        worst_mode=positions[worst.worst_mode],
        suggestion=_in_words(check.suggestions),
    )


def swing_after(swing: PanelSwing | None, schedule: Sequence[Pulse], spacecraft: Spacecraft) -> PanelSwing | None:
    """Return the oscillation of the modes after a schedule that counts as executed; None without modes."""
    if not spacecraft.modes:
        return None
    if not schedule:
        return swing
    start_us = min(pulse.start_us for pulse in schedule)
    stop_us = max(pulse.start_us + round(pulse.duration_s * US_PER_S) for pulse in schedule)
    left = []
    for position, mode in enumerate(spacecraft.modes):
        tone, carried = _tone(mode), _carried(swing, spacecraft, position, start_us)
        pulses = _pulses(schedule, mode.axis, start_us)
        response = schedule_response(pulses, tone, _inertia(spacecraft, mode.axis), carried_rad=carried)
        rest_s = (stop_us - start_us) / US_PER_S - response.end_s
        left.append(carry_phasor(complex(response.phasor_rad[0]), tone, rest_s))
    return PanelSwing(stop_us, tuple(left))


def _checked(
    schedule: Sequence[Pulse],
    axis: str,
    positions: list[int],
    spacecraft: Spacecraft,
    config: TorqueConfig,
    swing: PanelSwing | None,
    start_us: int,
) -> ScheduleCheck | None:
    """Return the check of one axis; None where nothing is commanded about it."""
    pulses = _pulses(schedule, axis, start_us)
    if not pulses:
        return None
    limits = ScheduleLimits(
        _inertia(spacecraft, axis),
        tuple(_tone(spacecraft.modes[position]) for position in positions),
        math.radians(config.panel_peak_limit_deg),
    )
    carried = tuple(_carried(swing, spacecraft, position, start_us) for position in positions)
    return check_schedule(pulses, limits, carried)


def _modes_by_axis(spacecraft: Spacecraft) -> dict[str, list[int]]:
    positions: dict[str, list[int]] = {}
    for position, mode in enumerate(spacecraft.modes):
        positions.setdefault(mode.axis, []).append(position)
    return positions


def _pulses(schedule: Sequence[Pulse], axis: str, start_us: int) -> tuple[TorquePulse, ...]:
    position = _POSITIONS[axis]
    return ordered_schedule(
        tuple(
            TorquePulse((pulse.start_us - start_us) / US_PER_S, pulse.duration_s, pulse.torque_n_m[position])
            for pulse in schedule
            if pulse.torque_n_m[position] and pulse.duration_s > 0.0
        )
    )


def _carried(swing: PanelSwing | None, spacecraft: Spacecraft, position: int, at_us: int) -> complex:
    """Return the oscillation of one mode at an instant, not before the end of the last schedule; 0 for other modes."""
    if swing is None or len(swing.phasor_rad) != len(spacecraft.modes):
        return 0j
    elapsed_s = max(0.0, (at_us - swing.at_us) / US_PER_S)
    return carry_phasor(swing.phasor_rad[position], _tone(spacecraft.modes[position]), elapsed_s)


def _tone(mode: "catalogue.FlexibleMode") -> HubMode:
    return HubMode(mode.omega_rad_s, max(mode.damping_ratio, _LEAST_DAMPING), mode.coupling)


def _inertia(spacecraft: Spacecraft, axis: str) -> float:
    return float(np.array(spacecraft.inertia_kg_m2)[_BODY[axis], _BODY[axis]])


def _in_words(suggestions: tuple[Suggestion, ...]) -> str | None:
    if not suggestions:
        return None
    best = suggestions[0]
    return f"{_WORDS[best.kind].format(best.value_s)}: {best.verdict}"
