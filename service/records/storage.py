"""Records about the archive itself: maintenance, backups, checkpoints, diagnoses, its state."""

import json
from dataclasses import asdict, dataclass, field
from typing import Literal
from urllib.parse import quote

from service.records.setting import CHOSEN, setting


def sqlite_url(path: str) -> str:
    """Return the URL of the archive in a file, whatever characters its path has."""
    return f"sqlite:///{quote(path)}"


@dataclass(frozen=True, slots=True)
class SealedPart:
    """Rows that one transaction moved into a segment."""

    source: str
    plan_id: int
    #: microseconds UTC
    first_epoch_us: int
    last_epoch_us: int
    #: rows moved
    rows: int
    #: rows of the segments that were written, those that were sealed before included
    rows_of_segments: int


@dataclass(frozen=True, slots=True)
class SealedResults:
    """Results that one transaction moved into a segment."""

    #: attitude or torque
    series: str
    version: str
    #: None for torques
    method: str | None
    #: microseconds UTC
    first_epoch_us: int
    #: rows moved
    rows: int
    #: rows of the segments that were written, those that were sealed before included
    rows_of_segments: int


@dataclass(frozen=True, slots=True)
class RetiredRows:
    """Rows that one transaction of retention took away."""

    #: measurements, attitude, torques or traces
    series: str
    rows: int
    #: nothing older is kept now, microseconds UTC
    kept_from_us: int


@dataclass(frozen=True, slots=True)
class SealingConfig:
    """Times of sealing closed days."""

    quiet_s: float = setting(900.0, "a day is packed this long after its end and after its last row came in, s", CHOSEN)
    period_s: float = setting(600.0, "between two looks for days to pack and rows to drop, s", CHOSEN)
    pause_s: float = setting(
        0.05, "between two transactions of that work, so that rows come in between them, s", CHOSEN
    )


@dataclass(frozen=True, slots=True)
class RetentionConfig:
    """Retention time and size of the series; 0 = no limit."""

    measurements_days: float = setting(
        0.0, "measurements older than this are dropped and refused; 0 = kept for ever", CHOSEN
    )
    attitude_days: float = setting(0.0, "attitude older than this is dropped; 0 = kept for ever", CHOSEN)
    torques_days: float = setting(0.0, "torque commands older than this are dropped; 0 = kept for ever", CHOSEN)
    traces_days: float = setting(
        0.0, "evidence traces older than this are dropped; 0 = kept while the ring has place", CHOSEN
    )
    alarms_days: float = setting(0.0, "closed alarms raised longer ago are dropped; 0 = kept for ever", CHOSEN)
    notes_days: float = setting(0.0, "notes about instants longer ago are dropped; 0 = kept for ever", CHOSEN)
    replays_days: float = setting(0.0, "versions of replays made longer ago are deleted; 0 = kept for ever", CHOSEN)
    measurements_bytes: int = setting(0, "measurements of one spacecraft take this much at most; 0 = no limit", CHOSEN)
    attitude_bytes: int = setting(0, "attitude of one spacecraft takes this much at most; 0 = no limit", CHOSEN)
    torques_bytes: int = setting(0, "torque commands of one spacecraft take this much at most; 0 = no limit", CHOSEN)

    def days(self, series: str) -> float:
        """Return how many days of a series are kept, 0 = all."""
        return float(getattr(self, f"{series}_days"))

    def size_bytes(self, series: str) -> int:
        """Return how many bytes of a series are kept, 0 = all."""
        return int(getattr(self, f"{series}_bytes", 0))


#: what retention knows of each spacecraft
SERIES = ("measurements", "attitude", "torques", "traces")
#: what it knows of each spacecraft and of the service as a whole
LOGS = ("alarms", "notes")


class BackupError(Exception):
    """A backup cannot be made, trusted or restored; the text gives the reason and the remedy."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SpacecraftCount:
    """Row counts and positions of one spacecraft in a backup."""

    newest_number: int
    consumed_number: int
    newest_epoch_us: int | None
    result_sequence: int
    #: rows of each table that names a spacecraft
    rows: dict[str, int]


@dataclass(frozen=True, slots=True, kw_only=True)
class Manifest:
    """Manifest of a backup: origin, file, hash and row counts."""

    made_at_us: int
    #: `sqlite` or `postgresql`
    made_from: str
    #: layout of the archive, and of this manifest
    layout: int
    #: name of the file beside the manifest
    file: str
    size_bytes: int
    sha256: str
    #: rows of each table
    tables: dict[str, int]
    spacecraft: dict[str, SpacecraftCount]
    #: damaged rows when the backup was made, in words, table by table
    damaged: list[str] = field(default_factory=list)

    def as_text(self) -> str:
        """Return the manifest as JSON."""
        return json.dumps(asdict(self), indent=2, sort_keys=True) + "\n"


@dataclass(frozen=True, slots=True)
class Checkpoint:
    """State of a chain as the archive keeps it."""

    #: journal number of the last entry that the state knows
    number: int
    #: newest consumed epoch, microseconds UTC
    epoch_us: int
    #: layout and configuration, which must be the same where it is taken up
    fingerprint: str
    content: bytes


State = Literal["ok", "warning", "fault"]


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """One thing that was looked at."""

    #: what was looked at, one word
    check: str
    state: State
    #: what is there
    detail: str
    #: what to do; empty where nothing has to be done
    advice: str = ""


def worst(diagnoses: list[Diagnosis]) -> State:
    """Return the worst state among diagnoses.

    Examples
    --------
    >>> worst([Diagnosis("disk", "warning", "little room"), Diagnosis("clock", "ok", "agrees")])
    'warning'
    """
    states = {diagnosis.state for diagnosis in diagnoses}
    if "fault" in states:
        return "fault"
    return "warning" if "warning" in states else "ok"


@dataclass(frozen=True, slots=True)
class StorageState:
    """State of the storage, queried just now."""

    #: writes that wait for the writer
    queued_writes: int
    #: free bytes beside the database and whether it can be written there; None where it is on another machine
    free_bytes: int | None = None
    is_writable: bool | None = None
