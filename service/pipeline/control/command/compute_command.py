"""Wheel torques, L4 to L5: the control law's torque as pulses that end by themselves, and each wheel's share.

Release ``automatic``: every row has its command, the mean torque of the law until the next one; the impulse that is too
small for a pulse is carried. Release ``two_step``: a command is a slew that takes its own rate away and the pulses that
balance the known torque until its horizon ends, so that the spacecraft is at rest whatever happens to the link.

Whenever an inhibition stands the command is zero, says why, and the carry is dropped: a wish from before an inhibition
is not given after it. Where the inhibition doubts only the angles of the present, the command balances instead what
was learned before them.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from service.core.control.command_plan import Horizon, KnownTorque, Situation, compiled_allocation, compiled_plan
from service.core.control.quaternion_law import inertia_about_angles, inverse_of
from service.core.control.slew_schedule import Envelope
from service.pipeline.config import TorqueConfig
from service.pipeline.control.command.control_design import (
    NOTHING,
    ControlDesign,
    PanelSwing,
    Span,
    command_of,
    control_design,
    control_inhibitions,
    is_gyro_orbitant,
    mean_pulses,
    schedule_verdict,
    zero_command,
)
from service.pipeline.estimation.row_inhibitions import BALANCED
from service.records.catalogue import Release, Spacecraft
from service.records.epoch import US_PER_S
from service.records.levels.attitude import (
    NO_ANGLES,
    NO_AXES,
    AttitudeRow,
    Axes,
    BalanceBasis,
    Disturbance,
    FloatArray,
    Pulse,
    TorqueCommand,
)

#: sigmas between the angle that is seen and the predicted one
_SIGMAS = 4.0


def basis_of(row: AttitudeRow, disturbance: Disturbance | None) -> BalanceBasis | None:
    """Return what a row that control could use lets be balanced after it; None where nothing is known for it."""
    if row.rates_deg_s is None:
        return None
    return BalanceBasis(
        epoch_us=row.epoch_us,
        axes=row.control_allowed_axes,
        attitude_deg=row.steered_deg,
        sigma_deg=row.steered_sigma_deg,
        rates_deg_s=row.rates_deg_s,
        disturbance=disturbance,
    )


def with_executed(basis: BalanceBasis, pulses: Sequence[Pulse]) -> BalanceBasis:
    """Return a basis after pulses that its row did not know; they replace all older ones from the first of them on."""
    first_us = min((pulse.start_us for pulse in pulses), default=None)
    before = (pulse for pulse in basis.executed if first_us is None or pulse.start_us < first_us)
    return replace(basis, executed=(*before, *pulses))


def basis_at(basis: BalanceBasis, row: AttitudeRow, spacecraft: Spacecraft, hold_s: float) -> BalanceBasis | None:
    """Return a basis as it holds at a row that control may not use; None: it is too old, or the row contradicts it."""
    if row.epoch_us - basis.epoch_us > hold_s * US_PER_S:
        return None
    ahead_s = (row.epoch_us - basis.epoch_us) / US_PER_S
    apart_deg = np.abs(np.array(row.steered_deg) - predicted_deg(basis, row.epoch_us, spacecraft))
    variance_deg2 = np.square(basis.sigma_deg) + np.square(row.steered_sigma_deg)
    if basis.disturbance is not None:
        turned_deg = np.degrees(_inverse_1_kg_m2(spacecraft) @ basis.disturbance.sigma_n_m) * 0.5 * ahead_s**2
        variance_deg2 = variance_deg2 + turned_deg**2
    # an angle that is not known contradicts nothing
    return None if (apart_deg > _SIGMAS * np.sqrt(variance_deg2)).any() else basis


def predicted_deg(basis: BalanceBasis, at_us: int, spacecraft: Spacecraft) -> FloatArray:
    """Return the angles (3,), deg, predicted for an instant from what the basis knows."""
    ahead_s = (at_us - basis.epoch_us) / US_PER_S
    moment = np.zeros(3)
    if basis.disturbance is not None:
        moment = 0.5 * np.array(basis.disturbance.torque_n_m((basis.epoch_us + at_us) // 2)) * ahead_s**2
    for pulse in basis.executed:
        lasting_s = min(pulse.duration_s, (at_us - pulse.start_us) / US_PER_S)
        if lasting_s > 0.0:
            turning_s = min(ahead_s, (at_us - pulse.start_us) / US_PER_S - 0.5 * lasting_s)
            moment = moment + np.array(pulse.torque_n_m) * lasting_s * turning_s
    drift_deg = np.array(basis.rates_deg_s) * ahead_s
    return np.array(basis.attitude_deg) + drift_deg + np.degrees(_inverse_1_kg_m2(spacecraft) @ moment)


def balance_axes(inhibitions: tuple[str, ...], basis: BalanceBasis | None) -> tuple[bool, bool, bool]:
    """Return the axes whose known torque may be balanced: nothing but doubt about the angles of the present stands."""
    return basis.axes if basis is not None and inhibitions and BALANCED.issuperset(inhibitions) else NO_AXES


def balance_row(row: AttitudeRow, axes: tuple[bool, bool, bool]) -> AttitudeRow:
    """Return a row for a command that balances: its rates, and no angle that asks for a correction."""
    still = Axes(0.0, 0.0, 0.0)
    return replace(
        row,
        attitude_deg=still,
        steering_deg=NO_ANGLES,
        rates_deg_s=row.rates_deg_s or still,
        control_allowed=True,
        control_allowed_axes=axes,
        inhibitions=(),
    )


@lru_cache(maxsize=64)
def _inverse_1_kg_m2(spacecraft: Spacecraft) -> FloatArray:
    """Return the inverse (3, 3) of the tensor of inertia; the catalogue hardly ever changes."""
    return inverse_of(inertia_about_angles(np.array(spacecraft.inertia_kg_m2)))


NO_CARRY = NOTHING
_ENVELOPE = Envelope()


class TorqueOutcome(NamedTuple):
    """A command and the impulse that it leaves for later."""

    command: TorqueCommand
    #: (3,) N m s, yaw, roll, pitch
    carry_n_m_s: FloatArray


def compute_command(
    row: AttitudeRow,
    spacecraft: Spacecraft,
    carry_n_m_s: FloatArray,
    period_s: float,
    config: TorqueConfig,
    disturbance: Disturbance | None = None,
    momentum_n_m_s: tuple[float, ...] | None = None,
    *,
    swing: PanelSwing | None = None,
    is_withheld: bool = False,
    body_rate_deg_s: Axes | None = None,
    basis: BalanceBasis | None = None,
) -> TorqueOutcome:
    """Return the command that follows from one attitude row.

    Parameters
    ----------
    row : AttitudeRow
        Of the method that drives control.
    spacecraft : Spacecraft
        Law, wheels, modes and the way of release.
    carry_n_m_s : ndarray, shape (3,), N m s
        Left over from earlier commands; release ``automatic`` alone has it.
    period_s : float, s
        Expected time to the next command.
    disturbance : Disturbance, optional
        Torque that nobody commanded, fed forward.
    momentum_n_m_s : tuple of float, optional
        Momentum of each wheel; None: not known, and its limit is not looked at.
    swing : PanelSwing, optional
        What earlier schedules have left in the flexible modes.
    is_withheld : bool
        Whether control has tripped.
    body_rate_deg_s : Axes, optional
        Rate of the body against inertial space, for the law gyro_orbitant; None: not told, or too old.
    basis : BalanceBasis, optional
        What may be balanced while an inhibition stands; None: nothing.
    """
    span = _span(row, spacecraft, period_s)
    inhibitions = control_inhibitions(row, spacecraft, is_withheld=is_withheld, body_rate_deg_s=body_rate_deg_s)
    axes = balance_axes(inhibitions, basis)
    used = row
    if inhibitions:
        # the gyro-orbitant law has no torque of its own without angles, and of a computed command that counts as
        # applied nobody says whether a centre flies it that looks at `control_allowed`
        is_automatic = spacecraft.control.release is Release.AUTOMATIC
        if not any(axes) or is_automatic or is_gyro_orbitant(spacecraft):
            return TorqueOutcome(zero_command(row, spacecraft, span, inhibitions), NO_CARRY)
        used = balance_row(row, axes)
    given = config, disturbance, momentum_n_m_s, body_rate_deg_s
    if spacecraft.control.release is Release.AUTOMATIC:
        command, carry_n_m_s = _mean_command(used, spacecraft, span, carry_n_m_s, *given)
    else:
        command, carry_n_m_s = _released_command(used, spacecraft, span, None, *given), NO_CARRY
    command = _checked(command, spacecraft, config, swing)
    return TorqueOutcome(_as_balance(command, inhibitions, axes) if inhibitions else command, carry_n_m_s)


def _checked(
    command: TorqueCommand, spacecraft: Spacecraft, config: TorqueConfig, swing: PanelSwing | None
) -> TorqueCommand:
    verdict = schedule_verdict(command.schedule, spacecraft, config, swing)
    return command if verdict is None else replace(command, schedule_check=verdict)


def _as_balance(command: TorqueCommand, inhibitions: tuple[str, ...], axes: tuple[bool, bool, bool]) -> TorqueCommand:
    """Return a computed command as one that balances; one that the law could not make stays zero."""
    if not command.control_allowed:
        return replace(command, inhibitions=(*inhibitions, *command.inhibitions))
    return replace(command, control_allowed=False, inhibitions=inhibitions, balance_allowed_axes=axes)


def ended_command(row: AttitudeRow, spacecraft: Spacecraft, period_s: float, *, is_withheld: bool) -> TorqueCommand:
    """Return the zero command, with its reasons, of a row that ends the command before it."""
    inhibitions = control_inhibitions(row, spacecraft, is_withheld=is_withheld, body_rate_deg_s=None)
    return zero_command(row, spacecraft, _span(row, spacecraft, period_s), inhibitions)


def _span(row: AttitudeRow, spacecraft: Spacecraft, period_s: float) -> Span:
    """Return when a command acts: a simulated spacecraft lives on its own epochs, a real one from the receipt on."""
    return Span(row.epoch_us if spacecraft.simulated else max(row.epoch_us, row.received_at_us), period_s)


def command_for(
    row: AttitudeRow,
    spacecraft: Spacecraft,
    start_us: int,
    duration_s: float,
    max_torque_n_m: float | None,
    config: TorqueConfig,
    disturbance: Disturbance | None = None,
    momentum_n_m_s: tuple[float, ...] | None = None,
    *,
    swing: PanelSwing | None = None,
    body_rate_deg_s: Axes | None = None,
    balance: tuple[bool, bool, bool] | None = None,
    envelope: Envelope = _ENVELOPE,
) -> TorqueCommand:
    """Return the command that would be released: from a start that lies ahead, for a whole horizon.

    Parameters
    ----------
    row : AttitudeRow
        Newest row of the method that drives control; its angles are carried on to the start.
    start_us : int
        When the first pulse may begin.
    duration_s : float, s
        Horizon. The slew takes its part of a command period, or of the horizon where that is shorter; what follows is
        as long as the envelope allows.
    max_torque_n_m : float or None
        Greatest torque of a pulse; None: what the spacecraft has.
    body_rate_deg_s : Axes, optional
        As `compute_command` has it.
    balance : tuple of bool, optional
        Axes whose known torque and rate the command shall balance, whatever the row forbids; None: it controls.
    envelope : Envelope
        Limits of this command; the law keeps its share of them.

    Returns
    -------
    TorqueCommand
        ``command_period_s`` is the horizon that the envelope has room for; zero with the reasons where the row or the
        settings forbid control.
    """
    span = Span(start_us, float(duration_s), Envelope(*map(float, envelope)))
    used = row if balance is None else balance_row(row, balance)
    inhibitions = control_inhibitions(used, spacecraft, body_rate_deg_s=body_rate_deg_s)
    if inhibitions:
        return zero_command(row, spacecraft, span, inhibitions)
    command = _released_command(
        used, spacecraft, span, max_torque_n_m, config, disturbance, momentum_n_m_s, body_rate_deg_s
    )
    command = _checked(command, spacecraft, config, swing)
    return command if balance is None else _as_balance(command, row.inhibitions, balance)


def _released_command(
    row: AttitudeRow,
    spacecraft: Spacecraft,
    span: Span,
    max_torque_n_m: float | None,
    config: TorqueConfig,
    disturbance: Disturbance | None,
    momentum_n_m_s: tuple[float, ...] | None,
    body_rate_deg_s: Axes | None,
) -> TorqueCommand:
    """Return a command that persons release: a slew with what follows, or a period of the gyro-orbitant law."""
    if not is_gyro_orbitant(spacecraft):
        return _forecast_command(row, spacecraft, span, max_torque_n_m, config, disturbance, momentum_n_m_s)
    span = span._replace(period_s=min(span.period_s, spacecraft.control.command_period_s))
    return _mean_command(
        row, spacecraft, span, NO_CARRY, config, disturbance, momentum_n_m_s, body_rate_deg_s, max_torque_n_m
    ).command


def _mean_command(
    row: AttitudeRow,
    spacecraft: Spacecraft,
    span: Span,
    carry_n_m_s: FloatArray,
    config: TorqueConfig,
    disturbance: Disturbance | None,
    momentum_n_m_s: tuple[float, ...] | None,
    body_rate_deg_s: Axes | None,
    max_torque_n_m: float | None = None,
) -> TorqueOutcome:
    """Return the command whose mean is the law's torque."""
    try:
        design = _design(spacecraft, config, max_torque_n_m)
        mean = mean_pulses(row, spacecraft, span, carry_n_m_s, config, design, disturbance, body_rate_deg_s)
    except ValueError:
        return TorqueOutcome(zero_command(row, spacecraft, span, ("no_law",)), NO_CARRY)
    momentum = _momentum(design, momentum_n_m_s)
    allocated = compiled_allocation(
        mean.pulses, design.gains, design.drive, design.wheels, momentum, float(span.period_s)
    )
    is_saturated = bool(mean.is_cut or allocated.is_cut)
    return TorqueOutcome(command_of(row, spacecraft, span, allocated, is_saturated=is_saturated), mean.carry_n_m_s)


def _forecast_command(
    row: AttitudeRow,
    spacecraft: Spacecraft,
    span: Span,
    max_torque_n_m: float | None,
    config: TorqueConfig,
    disturbance: Disturbance | None,
    momentum_n_m_s: tuple[float, ...] | None,
) -> TorqueCommand:
    """Return the command of a slew and of what balances the known torque after it."""
    try:
        design = _design(spacecraft, config, max_torque_n_m)
        allocated, period_s = compiled_plan(
            design.gains,
            design.drive,
            design.wheels,
            _situation(row, span.epoch_us),
            _known_torque(disturbance, span.epoch_us),
            _horizon(spacecraft, span, config),
            span.envelope,
            config.envelope_share,
            _momentum(design, momentum_n_m_s),
            float(span.period_s),
        )
    except ValueError:
        return zero_command(row, spacecraft, span, ("no_law",))
    if math.isnan(period_s):
        return zero_command(row, spacecraft, span, ("no_law",))
    return command_of(row, spacecraft, span._replace(period_s=period_s), allocated, is_saturated=allocated.is_cut)


def _design(spacecraft: Spacecraft, config: TorqueConfig, max_torque_n_m: float | None) -> ControlDesign:
    """Return the law's numbers, with pulses no stronger than somebody wants; ValueError as `control_design`."""
    design = control_design(spacecraft, config)
    if max_torque_n_m is None:
        return design
    return design._replace(drive=design.drive._replace(limit_n_m=float(min(design.drive.limit_n_m, max_torque_n_m))))


def _situation(row: AttitudeRow, start_us: int) -> Situation:
    """Return the spacecraft of a row, and how long after it a command begins."""
    rates = NOTHING if row.rates_deg_s is None else np.array(row.rates_deg_s, dtype=np.float64)
    ahead_s = max(0.0, (start_us - row.epoch_us) / US_PER_S)
    return Situation(np.array(row.steered_deg, dtype=np.float64), rates, np.array(row.control_allowed_axes), ahead_s)


def _known_torque(disturbance: Disturbance | None, start_us: int) -> KnownTorque:
    """Return the torque that is expected while a command lasts."""
    if disturbance is None:
        return KnownTorque(np.zeros((3, 3)), 1.0, 0.0)
    parts_n_m = np.array((disturbance.constant_n_m, disturbance.cosine_n_m, disturbance.sine_n_m), dtype=np.float64)
    return KnownTorque(parts_n_m, float(disturbance.period_s), (start_us - disturbance.epoch_us) / US_PER_S)


def _horizon(spacecraft: Spacecraft, span: Span, config: TorqueConfig) -> Horizon:
    # a longer horizon may become as short as the slew, and the command's span with it
    period_s, usual_s = float(span.period_s), spacecraft.control.command_period_s
    least_s = period_s if period_s <= usual_s else 0.0
    slew_s = config.slew_share * min(period_s, usual_s)
    left_s = period_s - slew_s
    # slices of a whole period where there is room, else one for what is left of the only period
    slices = max(1, int(left_s / config.balance_s)) if left_s > 0.0 else 0
    slice_s = left_s / slices if slices else float(config.balance_s)
    return Horizon(slew_s, slice_s, slices, least_s)


def _momentum(design: ControlDesign, momentum_n_m_s: tuple[float, ...] | None) -> FloatArray:
    """Return the momentum of each wheel (W,); what is usual where it is not known."""
    usual = design.usual_momentum_n_m_s
    if momentum_n_m_s is None or len(momentum_n_m_s) != len(usual):
        return usual
    return np.array(momentum_n_m_s, dtype=np.float64)
