"""Knowledge of the chain besides carrier powers: slow inputs of the journal, documents, reports of rain."""

import math
from bisect import bisect_left, bisect_right, insort
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

import numpy as np

from service.pipeline.inputs.polarization import PolarizationRecords, with_polarization_record
from service.records.calibration import Alignment, Calibration, CalibrationMethod
from service.records.catalogue import Carrier, CarrierPlan, Ephemeris, Method, Spacecraft
from service.records.epoch import US_PER_S
from service.records.inputs import (
    TURNING_KINDS,
    AlignmentSet,
    CalibrationActivation,
    EphemerisChange,
    Operation,
    PlanChange,
    PolarizationRecord,
    SlowInput,
    SpacecraftChange,
    TelemetryRecord,
    WeatherReport,
)
from service.records.levels.attitude import Axes, FloatArray
from service.records.operations.release import InterlockHold


@dataclass
class JournalDocuments:
    """Documents that journal entries name by number."""

    plans: dict[int, CarrierPlan] = field(default_factory=dict)
    ephemerides: dict[int, Ephemeris] = field(default_factory=dict)
    calibrations: dict[int, Calibration] = field(default_factory=dict)
    alignments: dict[int, Alignment] = field(default_factory=dict)

    def plan(self, plan_id: int) -> CarrierPlan:
        """Return a carrier plan."""
        return self.plans[plan_id]

    def ephemeris(self, ephemeris_id: int) -> Ephemeris:
        """Return an ephemeris."""
        return self.ephemerides[ephemeris_id]

    def calibration(self, calibration_id: int) -> Calibration:
        """Return a calibration."""
        return self.calibrations[calibration_id]

    def alignment(self, alignment_id: int) -> Alignment:
        """Return an alignment."""
        return self.alignments[alignment_id]

    def add_plan(self, carriers: tuple[Carrier, ...]) -> PlanChange:
        """Keep a plan and return its journal entry."""
        number = len(self.plans) + 1
        self.plans[number] = CarrierPlan(number, "", carriers)
        return PlanChange(number)

    def add_ephemeris(self, ephemeris: Ephemeris) -> EphemerisChange:
        """Keep an ephemeris and return its journal entry."""
        number = len(self.ephemerides) + 1
        self.ephemerides[number] = ephemeris
        return EphemerisChange(number)


#: so long reports are kept
KEPT_US = 6 * 3600 * US_PER_S
#: a report holds, and an antenna stays wet
_HOLDS_US, _WET_US = 1800 * US_PER_S, 2 * 3600 * US_PER_S
#: rain rate and attenuation from which a report says rain
_RAIN_MM_H, _RAIN_DB = 0.5, 0.15
#: reports of one station and source, one a minute for six hours and some
_MOST = 400


class StationReports(NamedTuple):
    """Reports of one source about one station, in order of epoch, microseconds UTC."""

    epochs_us: tuple[int, ...]
    #: those that say rain
    rain_us: tuple[int, ...]


#: by name of the station, then by source
WeatherReports = dict[str, dict[str, StationReports]]


def with_report(reports: WeatherReports, report: WeatherReport) -> WeatherReports:
    """Return the reports with one more; those more than six hours older than the newest of their kind are left out."""
    of_station = reports.get(report.station, {})
    before = of_station.get(report.source, StationReports((), ()))
    after = StationReports(
        _inserted(before.epochs_us, report.epoch_us),
        _inserted(before.rain_us, report.epoch_us) if _is_rain(report) else before.rain_us,
    )
    return {**reports, report.station: {**of_station, report.source: after}}


def reported_wet(reports: WeatherReports, stations: Sequence[str], epoch_us: int) -> FloatArray:
    """Return for carriers of some stations (N,) 1 where rain is reported, 0 where none is, NaN where nobody says."""
    verdicts = {name: _verdict(of_station, epoch_us) for name, of_station in reports.items()}
    return np.array([verdicts.get(name, np.nan) for name in stations])


def _verdict(of_station: dict[str, StationReports], epoch_us: int) -> float:
    """Return 1 where a source reports rain, 0 where one reports none, NaN where none reports."""
    if any(_is_within(each.rain_us, epoch_us, _WET_US) for each in of_station.values()):
        return 1.0
    return 0.0 if any(_is_within(each.epochs_us, epoch_us, _HOLDS_US) for each in of_station.values()) else np.nan


def _is_within(epochs_us: tuple[int, ...], epoch_us: int, age_us: int) -> bool:
    """Return whether the newest epoch that is not later than another is within an age of it."""
    position = bisect_right(epochs_us, epoch_us)
    return position > 0 and epoch_us - epochs_us[position - 1] <= age_us


def _inserted(epochs_us: tuple[int, ...], epoch_us: int) -> tuple[int, ...]:
    every = list(epochs_us)
    insort(every, epoch_us)
    return tuple(each for each in every[-_MOST:] if every[-1] - each <= KEPT_US)


def _is_rain(report: WeatherReport) -> bool:
    return (report.rain_rate_mm_h or 0.0) >= _RAIN_MM_H or (report.attenuation_db or 0.0) >= _RAIN_DB


#: records of momentum, and of rates, that are kept for rows that come after them: more than an hour of one a second
_MOST_RECORDS = 4000

#: a rate that was told longer before, or after, is none of the present, s
_RATE_S = 600.0
#: thrusters that telemetry said longer ago to act are not known to act, us
_THRUSTERS_US = 600 * US_PER_S


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


#: nobody may write to it
_NOTHING: dict[Any, Any] = {}


class Knowledge(NamedTuple):
    """Slow inputs in force now."""

    spacecraft: Spacecraft | None = None
    plan: CarrierPlan | None = None
    ephemeris: Ephemeris | None = None
    #: active calibration of each kind of fit
    active: dict[CalibrationMethod, Calibration] = _NOTHING
    alignment: Alignment | None = None
    #: newest revision of each operation, by id
    operations: dict[int, Operation] = _NOTHING
    #: newest records of the momentum of the wheels, in order of epochs
    momenta: tuple[TelemetryRecord, ...] = ()
    #: newest records that say whether thrusters act, in order of epochs
    thrusters: tuple[TelemetryRecord, ...] = ()
    #: newest records of the rate of the body about every axis, in order of epochs
    rates: tuple[TelemetryRecord, ...] = ()
    #: reports of rain, by station and source
    weather: WeatherReports = _NOTHING
    #: records of polarimeters, by source
    polarization: PolarizationRecords = _NOTHING
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

    def is_thrusting_undeclared(self, epoch_us: int) -> bool:
        """Return whether thrusters act by the newest record of ten minutes and no operation that turns is declared."""
        records = records_between(self.thrusters, epoch_us - _THRUSTERS_US, epoch_us)
        if not records or not records[-1].thrusters_active:
            return False
        return not any(
            one.kind in TURNING_KINDS
            and one.start_us <= epoch_us
            and (one.stop_us is None or records[-1].epoch_us < one.stop_us)
            for one in self.operations.values()
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
            return knowledge._replace(spacecraft=content.spacecraft)
        case PlanChange():
            return knowledge._replace(plan=lookup.plan(content.plan_id))
        case EphemerisChange():
            return knowledge._replace(ephemeris=lookup.ephemeris(content.ephemeris_id))
        case CalibrationActivation():
            calibration = lookup.calibration(content.calibration_id)
            return knowledge._replace(active={**knowledge.active, calibration.request.method: calibration})
        case AlignmentSet():
            return knowledge._replace(alignment=lookup.alignment(content.alignment_id))
        case Operation():
            return knowledge._replace(operations={**knowledge.operations, content.id: content})
        case TelemetryRecord() | WeatherReport() | PolarizationRecord() | InterlockHold():
            return _with_word(knowledge, content)
        case _:
            return knowledge


def _with_word(
    knowledge: Knowledge, reported: TelemetryRecord | WeatherReport | PolarizationRecord | InterlockHold
) -> Knowledge:
    """Return the knowledge with a word of the interlock or a record of a sensor."""
    if isinstance(reported, PolarizationRecord):
        return knowledge._replace(polarization=with_polarization_record(knowledge.polarization, reported))
    if isinstance(reported, WeatherReport):
        return knowledge._replace(weather=with_report(knowledge.weather, reported))
    if isinstance(reported, InterlockHold):
        return knowledge._replace(hold=reported)
    momenta, rates, thrusters = knowledge.momenta, knowledge.rates, knowledge.thrusters
    if reported.wheel_momentum_n_m_s is not None:
        momenta = _with_telemetry(momenta, reported)
    if has_body_rate(reported):
        rates = _with_telemetry(rates, reported)
    if reported.thrusters_active is not None:
        thrusters = _with_telemetry(thrusters, reported)
    return knowledge._replace(momenta=momenta, rates=rates, thrusters=thrusters)


def _with_telemetry(records: tuple[TelemetryRecord, ...], record: TelemetryRecord) -> tuple[TelemetryRecord, ...]:
    """Return the newest records with one more; of two of one epoch the first counts."""
    if not records or record.epoch_us > records[-1].epoch_us:
        # thousands of them: an unpacked tuple would be copied twice
        return (records if len(records) < _MOST_RECORDS else records[1:]) + (record,)
    k = bisect_left(records, record.epoch_us, key=_epoch_us)
    if records[k].epoch_us == record.epoch_us:
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
