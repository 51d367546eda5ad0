"""Work that runs: jobs and replays that operators started, links with their front ends and analyzers."""

from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated, Any

from service.records.catalogue import Method
from service.records.epoch import US_PER_S


class JobState(StrEnum):
    """Life of a job."""

    QUEUED = "queued"
    RUNNING = "running"
    DONE = "done"
    FAILED = "failed"


class JobKind(StrEnum):
    """Kind of a job."""

    CALIBRATION = "calibration"
    SMOOTHING = "smoothing"
    SEALING = "sealing"
    REPLAY = "replay"


#: order of open jobs; between two pieces they yield to a calibration, and each kind to the others
PRIORITIES: dict[str, int] = {kind.value: number for number, kind in enumerate(JobKind)}
#: jobs that no person makes: one of a spacecraft, queued again and again
STANDING_KINDS = (JobKind.SMOOTHING, JobKind.SEALING)


@dataclass(frozen=True, slots=True)
class Job:
    """One piece of long work."""

    id: str
    kind: str
    state: JobState
    progress: Annotated[float, "0..1"]
    created_at_us: int
    error: Annotated[str | None, "Why it failed, and what to do."] = None
    spacecraft_id: Annotated[str | None, "Spacecraft that it is about."] = None
    subject: Annotated[str | None, "Number of the calibration, or version of the replay."] = None


@dataclass(frozen=True, slots=True)
class Replay:
    """One replay; its rows are read under the version ``replay-<id>``."""

    id: int
    start_us: int
    stop_us: int
    #: None = every method
    method: Method | None
    calibration_id: int | None
    alignment_id: int
    #: journal or epoch
    order: str
    job_id: str
    created_at_us: int
    commands: Annotated[bool, "False: without torques."] = True
    #: whether the alignment was asked for, so that later ones of the journal do not replace it
    is_fixed_alignment: bool = False
    #: newest journal number that it reads; None = of a version that did not state it
    until_number: int | None = None
    smooth: Annotated[bool, "True: with rows of method `robust_smoothed` beside those of the robust method."] = False

    @property
    def version(self) -> str:
        """Name of the version in the archive."""
        return f"replay-{self.id}"


@dataclass(frozen=True, slots=True)
class ReplayVersion:
    """A replay and what became of it."""

    replay: Replay
    state: JobState
    progress: Annotated[float, "0..1"]
    error: Annotated[str | None, "Why it failed, and what to do."]
    attitude_rows: Annotated[int, "Attitude rows that it wrote, of all methods."]
    torque_rows: Annotated[int, "Torque commands that it wrote."]
    size_bytes: Annotated[int, "About how much they take before their days are sealed."]


#: period of a link that has reported once and stated none, s
DEFAULT_PERIOD_S = 60.0
#: a link that has not reported for so many of its periods is silent
SILENT_PERIODS = 3.0
#: state of the last report of a front end that ends in good order; no further one is to be expected
STOPPED = "STOPPED"
#: states in which a link brings nothing and should
DOWN_STATES = frozenset({"BACKOFF", "FAULT", "FAILED", "STUCK", "SERVICE_AWAY", "UNAVAIL"})
#: how fast a learned period follows the times between reports, and the least and greatest it can become, s
_PERIOD_UPDATE_RATE = 0.25
_SHORTEST_PERIOD_S = 1.0
_LONGEST_PERIOD_S = 3600.0


@dataclass(frozen=True, slots=True)
class LinkWarning:
    """One thing that is not as it should be, in the words of the front end."""

    code: str
    detail: str
    since_us: int | None = None


@dataclass(frozen=True, slots=True)
class LinkReport:
    """One report of one link."""

    id: str
    #: analyzer or front_end
    kind: str
    spacecraft_id: str | None
    #: source of the measurements that come over it
    source: str | None
    #: where its state machine stands
    state: str
    #: anything that helps a reader; JSON
    detail: dict[str, Any]
    counters: dict[str, int]
    #: newest good row, microseconds UTC
    last_good_us: int | None
    warnings: tuple[LinkWarning, ...] = ()
    #: how many resets it has carried out
    reset_seen: int = 0
    #: time between reports as it states it, s
    period_s: float | None = None


@dataclass(frozen=True, slots=True)
class LinkState:
    """Newest report of a link, and its requested state."""

    report: LinkReport
    reported_at_us: int
    #: mean time between reports as it was seen, s; None after the first
    learned_period_s: float | None
    enabled: bool
    #: how many resets were asked for
    resets: int

    @property
    def period_s(self) -> float:
        """Time between reports: stated, else learned, else assumed."""
        return self.report.period_s or self.learned_period_s or DEFAULT_PERIOD_S

    def is_silent(self, now_us: int) -> bool:
        """Return whether the link has missed its reports; one that has said that it stops owes none."""
        return self.report.state != STOPPED and now_us - self.reported_at_us > SILENT_PERIODS * self.period_s * US_PER_S

    def is_down(self, now_us: int) -> bool:
        """Return whether a link that should work does not."""
        return self.enabled and (self.is_silent(now_us) or self.report.state in DOWN_STATES)


def update_period(before_s: float | None, interval_s: float) -> float:
    """Return the period of reports after one more interval.

    A silence counts as three periods at most, so one outage does not make a link look slow, while one that really
    reports more seldom is known after a few reports.

    Examples
    --------
    >>> update_period(None, 10.0), update_period(10.0, 3600.0)
    (10.0, 15.0)
    """
    known_s = interval_s if before_s is None else before_s
    change_s = min(interval_s, SILENT_PERIODS * known_s) - known_s
    return min(max(known_s + _PERIOD_UPDATE_RATE * change_s, _SHORTEST_PERIOD_S), _LONGEST_PERIOD_S)
