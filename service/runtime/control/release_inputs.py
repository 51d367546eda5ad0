"""Inputs of the interlock other than the rows, read from the archive."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from hashlib import sha256

from service.errors import NotFoundError
from service.pipeline.control.release.interlock_conditions import InterlockInputs
from service.pipeline.inputs.knowledge import has_body_rate
from service.ports import Storage
from service.records.calibration import CalibrationMethod, CalibrationState, Window
from service.records.catalogue import Method, Release, Spacecraft
from service.records.epoch import US_PER_S
from service.records.inputs import Operation, TelemetryRecord
from service.records.levels.attitude import Axes

#: operations are looked for so far back: a burn of then without a new ephemeris still counts
_OPERATIONS_BACK_US = 60 * 86_400 * US_PER_S
#: older telemetry says nothing of the present
_TELEMETRY_US = 600 * US_PER_S
_AHEAD_US = 86_400 * US_PER_S
_AT_ONCE = 1000
_EVERY_NUMBER = 1 << 62
#: an operation of this kind changes the orbit
_BURN = "station_keeping"


@dataclass(frozen=True, slots=True)
class KnownFacts:
    """Facts of the archive about a spacecraft."""

    spacecraft: Spacecraft
    #: of the interlock, but for what depends on the instant
    inputs: InterlockInputs
    operations: tuple[Operation, ...]
    #: newest
    telemetry: TelemetryRecord | None
    #: newest with the rate of the body about every axis
    rated: TelemetryRecord | None = None

    def body_rate_deg_s(self, epoch_us: int, age_s: float) -> Axes | None:
        """Return the rate of the body from telemetry within an age of an epoch; None without."""
        if self.rated is None or abs(epoch_us - self.rated.epoch_us) > age_s * US_PER_S:
            return None
        return self.rated.body_rate_deg_s

    def momentum_n_m_s(self, now_us: int) -> tuple[float, ...] | None:
        """Return the momentum of each wheel, None without recent telemetry."""
        telemetry = self.telemetry_at(now_us)
        return None if telemetry is None else telemetry.wheel_momentum_n_m_s

    def telemetry_at(self, now_us: int) -> TelemetryRecord | None:
        """Return the newest telemetry unless it is too old."""
        if self.telemetry is None or now_us - self.telemetry.epoch_us > _TELEMETRY_US:
            return None
        return self.telemetry


def read_facts(storage: Storage, spacecraft_id: str, now_us: int) -> KnownFacts:
    """Return what the archive says; NotFoundError ``spacecraft.unknown``."""
    spacecraft = storage.catalogue.spacecraft(spacecraft_id)
    received_us, stop_us = _ephemeris(storage, spacecraft_id)
    window = Window(now_us - _OPERATIONS_BACK_US, now_us + _AHEAD_US)
    telemetry = read_telemetry(storage, spacecraft_id, now_us - _TELEMETRY_US)
    operations = [entry.content for entry in storage.archive.inputs(spacecraft_id, "operation", window, _AT_ONCE, None)]
    inputs = InterlockInputs(
        is_aligned=bool(storage.results.alignments(spacecraft_id)),
        ephemeris_received_us=received_us,
        ephemeris_stop_us=stop_us,
        calibration_id=_calibration_id(storage, spacecraft),
        plan_id=_plan_id(storage, spacecraft_id),
        spacecraft_version=version_of(*_mechanics(spacecraft)),
        control_version=version_of(spacecraft.control),
        is_automatic=spacecraft.control.release is Release.AUTOMATIC,
    )
    known = tuple(each for each in operations if isinstance(each, Operation))
    rated = (each for each in reversed(telemetry) if has_body_rate(each))
    return KnownFacts(spacecraft, inputs, known, next(reversed(telemetry), None), next(rated, None))


def read_telemetry(storage: Storage, spacecraft_id: str, from_us: int) -> tuple[TelemetryRecord, ...]:
    """Return telemetry since an instant, in order of epoch."""
    window, after = Window(from_us, _EVERY_NUMBER), None
    found: list[TelemetryRecord] = []
    while True:
        page = storage.archive.inputs(spacecraft_id, "telemetry", window, _AT_ONCE, after)
        found += [entry.content for entry in page if isinstance(entry.content, TelemetryRecord)]
        if len(page) < _AT_ONCE:
            return tuple(found)
        after = (found[-1].epoch_us, page[-1].number)


def interlock_inputs(facts: KnownFacts, now_us: int, *, lease_holders: int, is_disagreeing: bool) -> InterlockInputs:
    """Return what the interlock must know at an instant."""
    telemetry = facts.telemetry_at(now_us)
    burns_us = [
        each.stop_us for each in facts.operations if each.kind == _BURN and each.stop_us and each.stop_us <= now_us
    ]
    return replace(
        facts.inputs,
        onboard_mode=None if telemetry is None else telemetry.onboard_mode,
        has_inhibiting_operation=any(_is_inhibiting(each, now_us) for each in facts.operations),
        burn_stop_us=max(burns_us, default=None),
        momentum_share=_momentum_share(facts.spacecraft, facts.momentum_n_m_s(now_us)),
        lease_holders=lease_holders,
        is_disagreeing=is_disagreeing,
    )


def _mechanics(spacecraft: Spacecraft) -> tuple[object, ...]:
    """Return all that a torque's effect depends on: a sign is proven for these."""
    limits = spacecraft.inertia_kg_m2, spacecraft.torque_limit_n_m, spacecraft.wheels
    return *limits, spacecraft.modes, spacecraft.onboard


def version_of(*parts: object) -> int:
    """Return a number that changes with some parts of the catalogue, and with nothing else."""
    return int.from_bytes(sha256(repr(parts).encode()).digest()[:6], "big")


def _is_inhibiting(operation: Operation, now_us: int) -> bool:
    is_over = operation.stop_us is not None and operation.stop_us <= now_us
    return operation.inhibit_control and operation.start_us <= now_us and not is_over


def _momentum_share(spacecraft: Spacecraft, momentum_n_m_s: Sequence[float] | None) -> float | None:
    """Return how full the fullest wheel is; infinite for NaN, by which inputs would differ from themselves."""
    if not momentum_n_m_s:
        return None
    fullest_n_m_s = max(math.inf if math.isnan(each) else abs(each) for each in momentum_n_m_s)
    return fullest_n_m_s / spacecraft.wheels.momentum_limit_n_m_s


def _ephemeris(storage: Storage, spacecraft_id: str) -> tuple[int | None, int | None]:
    """Return when the newest ephemeris came, by the rows, and when it ends."""
    try:
        stop_us = storage.catalogue.ephemeris(spacecraft_id).valid_stop_us
    except NotFoundError:
        return None, None
    entries = storage.archive.slow_inputs_before(spacecraft_id, _EVERY_NUMBER, ("ephemeris",))
    return (entries[-1].start_us if entries else None), stop_us


def _plan_id(storage: Storage, spacecraft_id: str) -> int | None:
    try:
        return storage.catalogue.plan(spacecraft_id).id
    except NotFoundError:
        return None


def _calibration_id(storage: Storage, spacecraft: Spacecraft) -> int | None:
    """Return the active calibration of the method that drives control."""
    active = {
        one.request.method: one.id for one in storage.results.calibrations(spacecraft.id, CalibrationState.ACTIVE)
    }
    geometry = active.get(CalibrationMethod.GEOMETRY)
    return geometry if spacecraft.control.method is Method.ROBUST else active.get(CalibrationMethod.PAPER, geometry)
