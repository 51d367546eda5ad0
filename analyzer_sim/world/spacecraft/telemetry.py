"""Telemetry: what the spacecraft says about itself once an hour: on-board mode, wheel momentum, thrusters.

    roll  h = a cos(w0 t + p)      what the Sun gives and takes in a day
    yaw   h = a sin(w0 t + p)
    pitch h = b + r t, back to b at each unloading by thrusters, twelve hours apart

None of it acts on the attitude; it only looks like the real thing. A story with wheels of its own has momentum that
follows from attitude and torques (`stored_momentum`), reported as often as it says. Where a rate sensor stands beside
the loop, every row has a record of its rates (`body_rates`), with the momentum where that is due too.
"""

from dataclasses import dataclass, replace

import numpy as np

from analyzer_sim.epochs import US_PER_H, US_PER_S
from analyzer_sim.streams import FloatArray, stream
from analyzer_sim.world.orbit.orbit import EARTH_RATE_RAD_S, EpochArray
from analyzer_sim.world.scenario.story import Scenario, WheelTelemetry
from analyzer_sim.world.spacecraft.body_rates import reported_rates
from analyzer_sim.world.spacecraft.stored_momentum import UNLOADING_H, reported_momentum, unloadings_us

#: time between two records, h
PERIOD_H = 1
#: mode of the phases with sensors, and of operation
SENSOR_MODE = "sensor_pointing"
FORECAST_MODE = "inertial_forecast"


@dataclass(frozen=True, slots=True)
class TelemetryRecord:
    """One record; the ground has it at its epoch."""

    reported_us: int
    onboard_mode: str
    #: wheels along roll, pitch, yaw; None = not in this record
    wheel_momentum_n_m_s: tuple[float, float, float] | None
    thrusters_active: bool
    #: inertial rate of the body about yaw, roll, pitch, deg/s
    body_rate_deg_s: tuple[float, float, float] | None = None


def telemetry(
    scenario: Scenario,
    seed: int,
    burns_us: tuple[int, ...],
    inertia_kg_m2: tuple[float, float, float],
    rows_us: EpochArray,
    attitude_deg: FloatArray,
) -> tuple[TelemetryRecord, ...]:
    """Return the records from the first row to the last; nothing is sent in a pause.

    They are hourly, or of the attitudes (T, 3) of rows (T,) where the story has wheels or a rate sensor of its own.
    """
    if scenario.wheels is not None:
        reported = reported_momentum(scenario, scenario.wheels, seed, inertia_kg_m2, rows_us, attitude_deg)
        records = _records(scenario, scenario.wheels, rows_us, reported)
    else:
        records = _hourly(scenario, seed, burns_us)
    if scenario.rates is None:
        return records
    rates = reported_rates(scenario.rates, seed, scenario.row_period_s, rows_us, attitude_deg)
    return _with_rates(scenario, records, rows_us, rates)


def _with_rates(
    scenario: Scenario, records: tuple[TelemetryRecord, ...], rows_us: EpochArray, rates: FloatArray
) -> tuple[TelemetryRecord, ...]:
    """Return a record with every row: those there are, and new ones, with the rates (T, 3)."""
    own = {record.reported_us: record for record in records}
    made = []
    for epoch_us, (yaw, roll, pitch) in zip(rows_us.tolist(), rates.tolist(), strict=True):
        mode = FORECAST_MODE if epoch_us >= scenario.operation_start_us else SENSOR_MODE
        record = own.pop(epoch_us, None) or TelemetryRecord(epoch_us, mode, None, False)
        made.append(replace(record, body_rate_deg_s=(yaw, roll, pitch)))
    return tuple(sorted((*made, *own.values()), key=lambda record: record.reported_us))


def is_unloaded(scenario: Scenario, from_us: int, to_us: int) -> bool:
    """Return whether thrusters unload the wheels of a story after an epoch and not after another."""
    epochs_us = unloadings_us(scenario)
    return bool(((epochs_us > from_us) & (epochs_us <= to_us)).any())


def _records(
    scenario: Scenario, figures: WheelTelemetry, rows_us: EpochArray, reported: FloatArray
) -> tuple[TelemetryRecord, ...]:
    """Return the records of what is reported (T, 3) with the rows, one a period."""
    period_us = round(60.0 * figures.period_min * US_PER_S)
    records, before_us = [], scenario.start_us
    for row in np.flatnonzero((rows_us - scenario.start_us) % period_us == 0).tolist():
        epoch_us = int(rows_us[row])
        roll, pitch, yaw = reported[row].tolist()
        is_unloading = figures.is_unloading_marked and is_unloaded(scenario, before_us, epoch_us)
        mode = FORECAST_MODE if epoch_us >= scenario.operation_start_us else SENSOR_MODE
        records.append(TelemetryRecord(epoch_us, mode, (roll, pitch, yaw), is_unloading))
        before_us = epoch_us
    return tuple(records)


def _hourly(scenario: Scenario, seed: int, burns_us: tuple[int, ...]) -> tuple[TelemetryRecord, ...]:
    """Return one record an hour that follows from nothing."""
    epochs_us = np.arange(scenario.start_us, scenario.stop_us, PERIOD_H * US_PER_H, dtype=np.int64)
    pauses = [phase for phase in scenario.phases if phase.name == "pause"]
    hours = (epochs_us - scenario.start_us) / US_PER_H
    rng = stream(seed, "telemetry")
    swing, bias, rate, phase_rad = (float(rng.uniform(*r)) for r in ((1.0, 2.0), (-9.0, -7.0), (0.02, 0.05), (0, 6.28)))
    angle = EARTH_RATE_RAD_S * 3600.0 * hours + phase_rad
    momentum = np.stack(
        [swing * np.cos(angle), bias + rate * (hours % UNLOADING_H), swing * np.sin(angle)], axis=1
    ) + 0.01 * rng.normal(size=(len(hours), 3))
    half_us = 20 * 60 * US_PER_S
    return tuple(
        TelemetryRecord(
            epoch_us,
            FORECAST_MODE if epoch_us >= scenario.operation_start_us else SENSOR_MODE,
            (round(roll, 3), round(pitch, 3), round(yaw, 3)),
            (number > 0 and number % UNLOADING_H == 0)
            or any(abs(epoch_us - burn_us) <= half_us for burn_us in burns_us),
        )
        for number, (epoch_us, (roll, pitch, yaw)) in enumerate(zip(epochs_us.tolist(), momentum.tolist(), strict=True))
        if not any(pause.start_us <= epoch_us < pause.stop_us for pause in pauses)
    )
