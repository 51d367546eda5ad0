"""Inputs of the chain: everything that the journal numbers, besides carrier powers.

Each record knows its natural key: the same key with the same content again is a duplicate, with another content a
conflict.

The journal: every accepted input of one spacecraft in the one order in which the chain consumes it.
"""

from dataclasses import dataclass, field
from typing import Annotated, NamedTuple

from service.records.catalogue import Spacecraft
from service.records.levels.attitude import AppliedCommand, Axes, ReleasedCommand, ReportedCommand
from service.records.levels.measurement import Measurement
from service.records.operations.release import InterlockHold


@dataclass(frozen=True, slots=True)
class AttitudeReference:
    """Attitude measured by a sensor outside this service; NaN = the sensor does not measure this angle."""

    #: star_tracker, earth_sensor, radio_beacon or other
    source: str
    epoch_us: int
    attitude_deg: Axes
    sigma_deg: Axes

    @property
    def key(self) -> str:
        """Natural key within a spacecraft."""
        return f"{self.source}/{self.epoch_us}"


@dataclass(frozen=True, slots=True)
class Correction:
    """Attitude change commanded through other channels, total over the interval, spread evenly."""

    start_us: int
    stop_us: int
    change_deg: Axes

    @property
    def key(self) -> str:
        """Natural key within a spacecraft."""
        return f"{self.start_us}/{self.stop_us}"


@dataclass(frozen=True, slots=True)
class TelemetryRecord:
    """On-board state reported by the control centre."""

    epoch_us: int
    onboard_mode: str | None = None
    wheel_momentum_n_m_s: tuple[float, ...] | None = None
    wheel_speed_rpm: tuple[float, ...] | None = None
    thrusters_active: bool | None = None
    body_rate_deg_s: Axes | None = None

    @property
    def key(self) -> str:
        """Natural key within a spacecraft."""
        return str(self.epoch_us)


@dataclass(frozen=True, slots=True)
class WeatherReport:
    """Rain over an uplink station, by a gauge, a radar or a forecast centre."""

    #: gauge, radar or whatever tells
    source: Annotated[str, "Name of the gauge, radar or service that tells."]
    #: name of the station in the carrier plan
    station: Annotated[str, "Name of the station in the carrier plan."]
    epoch_us: int
    rain_rate_mm_h: float | None = None
    #: of the uplink path by the rain alone
    attenuation_db: Annotated[float | None, "Of the uplink path, by the rain alone."] = None

    @property
    def key(self) -> str:
        """Natural key within a spacecraft."""
        return f"{self.source}/{self.station}/{self.epoch_us}"


@dataclass(frozen=True, slots=True)
class PolarizationRecord:
    """Polarisation of the downlink at a polarimeter: ratio of its two ports, or its angle."""

    source: Annotated[str, "Name of the polarimeter in the catalogue."]
    epoch_us: int
    #: cross-polar port over co-polar port
    ratio_db: Annotated[float | None, "Power of the cross-polar port over that of the co-polar port."] = None
    co_power_dbm: Annotated[float | None, "Power of the co-polar port; a fade widens the angle."] = None
    feed_offset_deg: Annotated[float | None, "Turn of the feed at this record; null: as the catalogue states."] = None
    noise_db: Annotated[float | None, "One standard deviation of the ratio."] = None
    angle_deg: Annotated[float | None, "Angle against that at zero attitude, in place of a ratio."] = None
    sigma_deg: Annotated[float | None, "One standard deviation of the angle."] = None
    tec_tecu: Annotated[float | None, "Electron content along the path, for the Faraday rotation."] = None

    @property
    def key(self) -> str:
        """Natural key within a spacecraft."""
        return f"{self.source}/{self.epoch_us}"


#: kinds of operations in which the attitude walks
TURNING_KINDS = ("station_keeping", "momentum_unloading", "calibration_turn", "other")


@dataclass(frozen=True, slots=True)
class Operation:
    """A declared operation that explains or inhibits."""

    id: int
    kind: str
    start_us: int
    stop_us: int | None
    carriers: tuple[str, ...] | None = None
    transponders: tuple[str, ...] | None = None
    inhibit_control: bool = False
    attitude_uncertainty_deg: Axes | None = None
    comment: str = ""
    #: a change is a new journal entry
    revision: Annotated[int, "Rises with each change."] = 1

    @property
    def key(self) -> str:
        """Natural key within a spacecraft."""
        return f"{self.id}/{self.revision}"


@dataclass(frozen=True, slots=True)
class SpacecraftChange:
    """The catalogue's statement about the spacecraft changed; inertia and control settings reach the torques."""

    spacecraft: Spacecraft
    #: counts changes of this spacecraft, 1 = its creation
    count: int
    #: of the document that comes into force; the chain does not look at it
    digest: str = field(default="", compare=False, repr=False)

    @property
    def key(self) -> str:
        """Natural key within a spacecraft."""
        return str(self.count)


@dataclass(frozen=True, slots=True)
class PlanChange:
    """A carrier plan became known, or the newest one again because a later one was withdrawn."""

    plan_id: int
    after_withdrawal_of: int | None = None
    digest: str = field(default="", compare=False, repr=False)

    @property
    def key(self) -> str:
        """Natural key within a spacecraft."""
        after = self.after_withdrawal_of
        return str(self.plan_id) if after is None else f"{self.plan_id} after {after}"


@dataclass(frozen=True, slots=True)
class EphemerisChange:
    """A new ephemeris holds from here."""

    ephemeris_id: int
    digest: str = field(default="", compare=False, repr=False)

    @property
    def key(self) -> str:
        """Natural key within a spacecraft."""
        return str(self.ephemeris_id)


@dataclass(frozen=True, slots=True)
class CalibrationActivation:
    """A calibration was made the active one of its method."""

    calibration_id: int
    #: counts activations of this spacecraft: the same calibration may be activated again
    count: int
    digest: str = field(default="", compare=False, repr=False)

    @property
    def key(self) -> str:
        """Natural key within a spacecraft."""
        return str(self.count)


@dataclass(frozen=True, slots=True)
class AlignmentSet:
    """An alignment holds from here."""

    alignment_id: int
    digest: str = field(default="", compare=False, repr=False)

    @property
    def key(self) -> str:
        """Natural key within a spacecraft."""
        return str(self.alignment_id)


@dataclass(frozen=True, slots=True)
class SourceSelection:
    """A measurement source became the prime one."""

    source: str
    #: counts selections of this spacecraft
    count: int

    @property
    def key(self) -> str:
        """Natural key within a spacecraft."""
        return str(self.count)


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
