"""Knowledge of the chain besides carrier powers: read from the slow inputs of the journal, in their order.

Knowledge is immutable; ``learn`` returns the next one. Documents that entries name by number (plans, ephemerides,
calibrations, alignments) are immutable in the archive, so looking them up keeps a replay deterministic.
"""

import math
from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

from service.pipeline.inputs.polarization import PolarizationRecords, with_polarization_record
from service.pipeline.inputs.weather_reports import WeatherReports, reported_wet, with_report
from service.records.calibration import Alignment, Calibration, CalibrationMethod
from service.records.catalogue import CarrierPlan, Ephemeris, Method, Spacecraft
from service.records.epoch import US_PER_S
from service.records.inputs import (
    AlignmentSet,
    CalibrationActivation,
    EphemerisChange,
    Operation,
    PlanChange,
    PolarizationRecord,
    SpacecraftChange,
    TelemetryRecord,
    WeatherReport,
)
from service.records.journal import SlowInput
from service.records.levels.attitude import Axes, FloatArray
from service.records.operations.release import InterlockHold

#: records of momentum, and of rates, that are kept for rows that come after them: more than an hour of one a second
_MOST_RECORDS = 4000

#: a rate that was told longer before, or after, is none of the present, s
_RATE_S = 600.0


class Lookup(Protocol):
    """Documents of one spacecraft by number."""

    def plan(self, plan_id: int) -> CarrierPlan:
        """Return a carrier plan."""

    def ephemeris(self, ephemeris_id: int) -> Ephemeris:
        """Return an ephemeris."""

    def calibration(self, calibration_id: int) -> Calibration:
        """Return a calibration."""

    def alignment(self, alignment_id: int) -> Alignment:
        """Return an alignment."""


@dataclass(frozen=True)
class Knowledge:
    """Slow inputs in force now."""

    spacecraft: Spacecraft | None = None
    plan: CarrierPlan | None = None
    ephemeris: Ephemeris | None = None
    #: active calibration of each kind of fit
    active: dict[CalibrationMethod, Calibration] = field(default_factory=dict)
    alignment: Alignment | None = None
    #: newest revision of each operation, by id
    operations: dict[int, Operation] = field(default_factory=dict)
    #: newest records of the momentum of the wheels, in order of epochs
    momenta: tuple[TelemetryRecord, ...] = ()
    #: newest records of the rate of the body about every axis, in order of epochs
    rates: tuple[TelemetryRecord, ...] = ()
    #: reports of rain, by station and source
    weather: WeatherReports = field(default_factory=dict)
    #: records of polarimeters, by source
    polarization: PolarizationRecords = field(default_factory=dict)
    #: newest word of the interlock; none: it never withheld anything
    hold: InterlockHold | None = None

    @property
    def is_withheld(self) -> bool:
        """Return whether the interlock withholds torques."""
        return self.hold is not None and self.hold.is_withheld

    def momentum_n_m_s(self, epoch_us: int, age_s: float) -> tuple[float, ...] | None:
        """Return the newest momentum of each wheel of an age before an epoch; None without a record."""
        records = records_between(self.momenta, epoch_us - int(age_s * US_PER_S) - 1, epoch_us)
        return records[-1].wheel_momentum_n_m_s if records else None

    def body_rate_deg_s(self, epoch_us: int, age_s: float) -> Axes | None:
        """Return the newest rate of the body of an age before or after an epoch; None without a record."""
        age_us = int(age_s * US_PER_S)
        records = records_between(self.rates, epoch_us - age_us - 1, epoch_us + age_us)
        return records[-1].body_rate_deg_s if records else None

    def has_rate(self, epoch_us: int) -> bool:
        """Return whether the rate of the body was told within ten minutes."""
        return self.body_rate_deg_s(epoch_us, _RATE_S) is not None

    def reported_wet(self, carrier_ids: Sequence[str], epoch_us: int) -> FloatArray | None:
        """Return for carriers (N,) 1 where rain over the station is reported, 0 where none is, NaN where nobody says.

        None where nothing is reported of any station.
        """
        if self.plan is None or not self.weather:
            return None
        station_of = {carrier.id: carrier.station.name for carrier in self.plan.carriers if carrier.station}
        return reported_wet(self.weather, [station_of.get(name, "") for name in carrier_ids], epoch_us)

    def calibration_for(self, method: Method) -> Calibration | None:
        """Return the calibration of a method; a ``geometry`` one serves ``paper`` while no ``paper`` one is active."""
        geometry = self.active.get(CalibrationMethod.GEOMETRY)
        if method is Method.ROBUST:
            return geometry
        return self.active.get(CalibrationMethod.PAPER, geometry)

    def inhibiting_operations(self, epoch_us: int) -> tuple[Operation, ...]:
        """Return the declared operations that forbid control at an epoch."""
        return tuple(
            operation
            for operation in self.operations.values()
            if operation.inhibit_control
            and operation.start_us <= epoch_us
            and (operation.stop_us is None or epoch_us < operation.stop_us)
        )

    def live_operations(self, from_us: int) -> tuple[Operation, ...]:
        """Return the operations that had not ended an hour before an epoch: some leave their mark for that long."""
        return tuple(
            operation
            for operation in self.operations.values()
            if operation.stop_us is None or operation.stop_us + 3600 * US_PER_S > from_us
        )


def update(knowledge: Knowledge, content: SlowInput, lookup: Lookup) -> Knowledge:
    """Return the knowledge after one slow input; kinds that the present methods do not use leave it as it is."""
    match content:
        case SpacecraftChange():
            return replace(knowledge, spacecraft=content.spacecraft)
        case PlanChange():
            return replace(knowledge, plan=lookup.plan(content.plan_id))
        case EphemerisChange():
            return replace(knowledge, ephemeris=lookup.ephemeris(content.ephemeris_id))
        case CalibrationActivation():
            calibration = lookup.calibration(content.calibration_id)
            return replace(knowledge, active={**knowledge.active, calibration.request.method: calibration})
        case AlignmentSet():
            return replace(knowledge, alignment=lookup.alignment(content.alignment_id))
        case Operation():
            return replace(knowledge, operations={**knowledge.operations, content.id: content})
        case TelemetryRecord() | WeatherReport() | PolarizationRecord() | InterlockHold():
            return _with_word(knowledge, content)
        case _:
            return knowledge


def _with_word(
    knowledge: Knowledge, reported: TelemetryRecord | WeatherReport | PolarizationRecord | InterlockHold
) -> Knowledge:
    """Return the knowledge with a word of the interlock or a record of a sensor."""
    if isinstance(reported, PolarizationRecord):
        return replace(knowledge, polarization=with_polarization_record(knowledge.polarization, reported))
    if isinstance(reported, WeatherReport):
        return replace(knowledge, weather=with_report(knowledge.weather, reported))
    if isinstance(reported, InterlockHold):
        return replace(knowledge, hold=reported)
    momenta, rates = knowledge.momenta, knowledge.rates
    if reported.wheel_momentum_n_m_s is not None:
        momenta = _with_telemetry(momenta, reported)
    if has_body_rate(reported):
        rates = _with_telemetry(rates, reported)
    return replace(knowledge, momenta=momenta, rates=rates)


def _with_telemetry(records: tuple[TelemetryRecord, ...], record: TelemetryRecord) -> tuple[TelemetryRecord, ...]:
    """Return the newest records with one more; of two of one epoch the first counts."""
    k = bisect_left(records, record.epoch_us, key=_epoch_us)
    if k < len(records) and records[k].epoch_us == record.epoch_us:
        return records
    return (*records[:k], record, *records[k:])[-_MOST_RECORDS:]


def records_between(records: tuple[TelemetryRecord, ...], after_us: int, to_us: int) -> tuple[TelemetryRecord, ...]:
    """Return the records later than an epoch and not later than another, in order of epochs."""
    first = bisect_right(records, after_us, key=_epoch_us)
    return records[first : bisect_right(records, to_us, lo=first, key=_epoch_us)]


def _epoch_us(record: TelemetryRecord) -> int:
    return record.epoch_us


def has_body_rate(reported: TelemetryRecord) -> bool:
    """Return whether a record tells the rate of the body about every axis."""
    return reported.body_rate_deg_s is not None and all(map(math.isfinite, reported.body_rate_deg_s))
