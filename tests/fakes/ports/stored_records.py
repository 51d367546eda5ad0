"""Records that many tests store: an alarm, a command, and the results of a row, with plain figures."""

import math
from dataclasses import replace

import numpy as np

from service.records.catalogue import Method
from service.records.levels.attitude import AttitudeRow, Axes, Exclusion, Pulse, Status, TorqueCommand
from service.records.levels.measurement import Measurement, MeasurementBatch
from service.records.operations.access import AuditEvent
from service.records.operations.alarms import Alarm, Cover, Process, Severity
from service.records.operations.release import Command, CommandCheck, CommandState, Purpose

S = 1_000_000
ALARM = Alarm(
    id=0,
    spacecraft_id="craft",
    condition="carrier_absent",
    thing="c01",
    process=Process.UNACKNOWLEDGED,
    cover=Cover.NONE,
    severity=Severity.WARNING,
    since_us=5 * S,
    raised_at_us=7 * S,
    changed_at_us=7 * S,
    value=120.5,
    limit=math.inf,
    unit="s",
    detail="carrier c01: nothing found\n\u0000 \u20ac",
)
AUDIT_EVENT = AuditEvent(
    at_us=5,
    who="anna",
    key_id="k1",
    role="operator",
    address="127.0.0.1",
    action="create",
    target="/spacecraft/",
    outcome="done",
    request_id="r-1",
    body_sha256="ab" * 32,
)
AXES = Axes(0.001, -0.0, math.nan)
PULSES = (Pulse(900 * S, 2.5, Axes(0.0, 0.002, 0.0)), Pulse(990 * S, 2.5, Axes(0.0, -0.002, 0.0)))
COMMAND = Command(
    counter=1,
    state=CommandState.PREPARED,
    digest="ab",
    purpose=Purpose.CONTROL,
    is_automatic=False,
    is_simulated=True,
    reason="station \u0000 \u20ac",
    prepared_by="ann",
    prepared_us=700 * S,
    expires_us=900 * S,
    attitude_epoch_us=690 * S,
    start_us=900 * S,
    stop_us=993 * S,
    schedule=PULSES,
    impulse_n_m_s=AXES,
    gross_impulse_n_m_s=AXES,
    angle_change_deg=AXES,
    rate_change_deg_s=AXES,
    peak_angle_deg=AXES,
    peak_rate_deg_s=AXES,
    wheel_momentum_n_m_s=(0.1, -0.2),
    checks=(CommandCheck("envelope", True, ""),),
)


def attitude_row(of: Measurement, **changes: object) -> AttitudeRow:
    """Return a row with plain figures of the paper method."""
    row = AttitudeRow(
        epoch_us=of.epoch_us,
        received_at_us=of.received_at_us,
        number=of.number,
        method=Method.PAPER,
        attitude_deg=Axes(0.1, -0.02, 0.03),
        sigma_deg=Axes(0.2, 0.01, 0.02),
        rates_deg_s=Axes(1e-6, -2e-6, 3e-6),
        status=Status.ACQUIRED,
        control_allowed=True,
        control_allowed_axes=(False, True, True),
        inhibitions=(),
        carriers_used=14,
        excluded=(Exclusion("c03", "uplink_fade"), Exclusion("c05", "absent")),
        downlink_fade=False,
        downlink_fade_db=0.0,
        common_db=0.02,
        residual_rms_db=0.15,
        calibration_id=1,
        alignment_id=1,
    )
    return replace(row, **changes)  # type: ignore[arg-type]


def torque_command(of: Measurement, **changes: object) -> TorqueCommand:
    """Return a command with plain figures."""
    command = TorqueCommand(
        epoch_us=of.epoch_us,
        number=of.number,
        attitude_epoch_us=of.epoch_us,
        mode="ground",
        torque_n_m=Axes(0.0, -0.002, 0.003),
        wheels_n_m=(0.002, -0.003, 0.0),
        saturated=False,
        command_period_s=60.0,
        valid_until_us=of.epoch_us + 60 * S,
        schedule=(Pulse(of.epoch_us, 2.5, Axes(0.0, -0.05, 0.0)),),
        impulse_n_m_s=Axes(0.0, -0.12, 0.18),
        predicted_angle_change_deg=Axes(0.0, -0.1, 0.2),
        predicted_rate_change_deg_s=Axes(0.0, -1e-5, 2e-5),
        predicted_wheel_momentum_n_m_s=(0.12, -0.18, 0.0),
        control_allowed=True,
        inhibitions=(),
    )
    return replace(command, **changes)  # type: ignore[arg-type]


def zeros(rows: int, spacecraft_id: str = "sc") -> MeasurementBatch:
    """Return a batch of rows a second apart, two carriers at 0 dBm."""
    epochs_us, powers = S * np.arange(rows), np.zeros((rows, 2), dtype=np.float32)
    return MeasurementBatch(
        spacecraft_id, "sa-1", 1, 5, np.arange(rows), epochs_us, powers, (None,) * rows, np.zeros(rows, bool)
    )
