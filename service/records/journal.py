"""The journal: every accepted input of one spacecraft in the one order in which the chain consumes it."""

from dataclasses import dataclass, field
from typing import NamedTuple

from service.records.inputs import (
    AlignmentSet,
    AttitudeReference,
    CalibrationActivation,
    Correction,
    EphemerisChange,
    Operation,
    PlanChange,
    PolarizationRecord,
    SourceSelection,
    SpacecraftChange,
    TelemetryRecord,
    WeatherReport,
)
from service.records.levels.attitude import AppliedCommand, ReleasedCommand, ReportedCommand
from service.records.levels.measurement import Measurement
from service.records.operations.release import InterlockHold

#: an input other than a row of carrier powers
SlowInput = (
    AttitudeReference
    | Correction
    | TelemetryRecord
    | WeatherReport
    | PolarizationRecord
    | Operation
    | PlanChange
    | EphemerisChange
    | CalibrationActivation
    | AlignmentSet
    | SourceSelection
    | SpacecraftChange
    | AppliedCommand
    | ReleasedCommand
    | ReportedCommand
    | InterlockHold
)

#: name of each kind of slow input in the tables and in the journal
KINDS: dict[str, type[SlowInput]] = {
    "reference": AttitudeReference,
    "correction": Correction,
    "telemetry": TelemetryRecord,
    "weather": WeatherReport,
    "polarization": PolarizationRecord,
    "operation": Operation,
    "spacecraft": SpacecraftChange,
    "plan": PlanChange,
    "ephemeris": EphemerisChange,
    "activation": CalibrationActivation,
    "alignment": AlignmentSet,
    "source": SourceSelection,
    "applied_command": AppliedCommand,
    "released_command": ReleasedCommand,
    "reported_command": ReportedCommand,
    "interlock": InterlockHold,
}
KIND_OF = {record: kind for kind, record in KINDS.items()}


@dataclass(frozen=True, slots=True)
class JournalEntry:
    """One numbered input."""

    number: int
    content: Measurement | SlowInput
    #: where it stands in time, microseconds UTC: its own start, or the newest epoch when it entered; None = not read
    start_us: int | None = field(default=None, compare=False)
    stop_us: int | None = field(default=None, compare=False)


class JournalHead(NamedTuple):
    """Newest entry of a journal."""

    spacecraft_id: str
    number: int
    #: of what the entry says, 16 hexadecimal digits
    digest: str
