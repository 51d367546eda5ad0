"""The mean torque that a law wants for a command period, as pulses: by quaternion error, or gyro-orbitant.

The gyro-orbitant law takes roll and pitch of the attitude row and the rates of the newest telemetry, against inertial
space; the yaw of the row it does not use, the roll rate tells it. Released in two steps its torque is made smaller
where it would leave the envelope of one command, all axes alike.
"""

import math
from typing import NamedTuple

import numpy as np

from service.core.control.envelope import Envelope
from service.core.control.gyro_orbitant import does_rate_show_yaw, gyro_orbitant_torque
from service.core.control.pulses import shape_pulses
from service.core.control.quaternion_law import GEOSTATIONARY_RATE_RAD_S, feedback_torque
from service.core.control.slew_schedule import AxisPulse
from service.pipeline.config import TorqueConfig
from service.pipeline.control.command.command_record import Span
from service.pipeline.control.command.control_design import ControlDesign, gyro_design
from service.records.catalogue import ControlLaw, Release, Spacecraft
from service.records.levels.attitude import AttitudeRow, Axes, FloatArray
from service.records.levels.disturbance import Disturbance

_ENVELOPE = Envelope()


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
    wanted, share = _wanted(row, spacecraft, span, config, design, disturbance, body_rate_deg_s), 1.0
    is_allowed = np.array(row.control_allowed_axes)
    wanted = np.where(is_allowed, wanted, 0.0)
    if is_gyro_orbitant(spacecraft) and spacecraft.control.release is Release.TWO_STEP:
        share = _share_within_envelope(wanted, design, span.period_s, config.envelope_share)
    train = shape_pulses(
        share * wanted,
        np.where(is_allowed, carry_n_m_s, 0.0),
        period_s=span.period_s,
        limit_n_m=design.drive.limit_n_m,
        quantum_n_m=design.drive.quantum_n_m,
        min_pulse_s=config.min_pulse_s,
        time_step_s=config.time_step_s,
    )
    reported = enumerate(zip(train.duration_s.tolist(), train.torque_n_m.tolist(), strict=True))
    pulses = tuple(AxisPulse(axis, 0.0, duration_s, torque) for axis, (duration_s, torque) in reported if duration_s)
    return MeanPulses(pulses, train.carry_n_m_s, share < 1.0 or bool(train.is_saturated.any()))


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
        return gyro_orbitant_torque(row.attitude_deg.roll, row.attitude_deg.pitch, rate, law, math.inf) - pushed
    rates = np.zeros(3) if row.rates_deg_s is None else np.array(row.rates_deg_s)
    return feedback_torque(design.gains, row.attitude_deg, rates, disturbance_n_m=pushed)


def _share_within_envelope(torque_n_m: FloatArray, design: ControlDesign, period_s: float, of_envelope: float) -> float:
    """Return the share of a mean torque that one command may give, whenever within its period it acts."""
    impulse = np.abs(torque_n_m) * period_s
    rate_deg_s = np.degrees(np.abs(design.inverse_1_kg_m2) @ impulse)
    asked = (rate_deg_s * period_s, rate_deg_s, impulse)
    limits = (_ENVELOPE.angle_change_deg, _ENVELOPE.rate_change_deg_s, _ENVELOPE.impulse_n_m_s)
    greatest = max(float(value.max()) / limit for value, limit in zip(asked, limits, strict=True))
    return min(1.0, of_envelope / greatest) if greatest > 0.0 else 1.0
